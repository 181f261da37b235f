//! The endpoint: metrics and health over HTTP/1.1, on a low-priority thread with its own runtime. Clients do not slow down a mission:
//! connections are few and short, requests are small, and a page is cached for a while.
#![expect(clippy::disallowed_methods, reason = "paces those who ask in real time")]

use std::convert::Infallible;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{ALLOW, CACHE_CONTROL, CONTENT_TYPE, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::sync::Semaphore;

use super::exposition::{self, Page, Source};
use super::health::{Checked, Health};

/// Maximum number of simultaneous connections. Further connections are closed immediately.
const CONNECTIONS_MAX: usize = 8;
/// Minimum interval between two accepted connections. Further connections wait in the system's queue.
const ACCEPT_EVERY: Duration = Duration::from_millis(4);
/// Maximum time until the header of a request has arrived.
const HEAD_MAX: Duration = Duration::from_secs(2);
/// Maximum duration of a connection, however slowly the client reads.
const CONNECTION_MAX: Duration = Duration::from_secs(10);
/// Maximum size of a request's header in bytes.
const HEAD_BYTES_MAX: usize = 8_192;
/// Time for which a metrics page is cached.
const PAGE_EVERY: Duration = Duration::from_millis(250);
/// Nice value of the endpoint's thread, for a lower priority than that of ordinary threads.
const NICE: i32 = 10;

/// The sources of metrics and health that the endpoint shows. Sources can be added while the endpoint serves.
#[derive(Clone, Default)]
pub(crate) struct Board(Arc<Mutex<Vec<Arc<dyn BoardSource>>>>);

/// A source of both metrics and health checks.
trait BoardSource: Source + Health {}
impl<T: Source + Health> BoardSource for T {}

impl Board {
    pub(crate) fn add(&self, told: impl Source + Health + 'static) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(Arc::new(told));
    }

    fn all(&self) -> Vec<Arc<dyn BoardSource>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn page(&self) -> String {
        let all = self.all();
        Page::text(all.iter().map(|told| &**told as &dyn Source))
    }

    async fn checked(&self) -> Checked {
        let (mut alive, mut ready) = (Ok(String::new()), Ok(String::new()));
        for told in self.all() {
            let checked = told.now().await;
            alive = both(alive, checked.alive);
            ready = both(ready, checked.ready);
        }
        Checked { alive, ready }
    }
}

/// Combines two results of health checks. The combined result is an error if either of them is.
fn both(one: Result<String, String>, other: Result<String, String>) -> Result<String, String> {
    match (one, other) {
        (Ok(one), Ok(other)) => Ok(format!("{one}{other}\n")),
        (Err(one), Err(other)) => Err(format!("{one}{other}\n")),
        (Err(wrong), Ok(_)) => Err(wrong),
        (Ok(_), Err(wrong)) => Err(format!("{wrong}\n")),
    }
}

/// Serves a board until the process ends. Returns the address with the actual port, which the system may have chosen.
///
/// # Errors
/// Fails if the process cannot listen on the address, or if the operating system provides no thread or runtime.
pub(crate) fn serve(address: SocketAddr, board: Board) -> io::Result<SocketAddr> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    let address = listener.local_addr()?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    // This thread ends with the process. It holds no resources that must be released.
    std::thread::Builder::new().name("metrics".to_owned()).spawn(move || {
        // On Linux, this applies to the current thread only.
        if let Err(error) = rustix::process::setpriority_process(None, NICE) {
            tracing::warn!("cannot lower the priority of the metrics thread: {error}");
        }
        runtime.block_on(accept_all(listener, Arc::new(Desk { board, page: Mutex::default() })));
    })?;
    Ok(address)
}

/// State that all connections of the endpoint share.
struct Desk {
    board: Board,
    /// The cached page, and the time at which it was created. `None` before the first request.
    page: Mutex<Option<(Instant, Bytes)>>,
}

async fn accept_all(listener: TcpListener, desk: Arc<Desk>) {
    let listener = match tokio::net::TcpListener::from_std(listener) {
        Ok(listener) => listener,
        Err(error) => return tracing::warn!("metrics are not served: {error}"),
    };
    let places = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    loop {
        match listener.accept().await {
            Ok((stream, _)) => {
                if let Ok(place) = Arc::clone(&places).try_acquire_owned() {
                    let desk = Arc::clone(&desk);
                    // The task ends when the response is sent, or after the maximum duration.
                    tokio::spawn(async move {
                        let _over = tokio::time::timeout(CONNECTION_MAX, converse(stream, desk)).await;
                        drop(place);
                    });
                }
            }
            Err(error) => tracing::debug!("cannot accept a connection for metrics: {error}"),
        }
        tokio::time::sleep(ACCEPT_EVERY).await;
    }
}

/// Handles one HTTP request on a connection.
async fn converse(stream: tokio::net::TcpStream, desk: Arc<Desk>) {
    let answer = service_fn(move |request: Request<Incoming>| {
        let desk = Arc::clone(&desk);
        async move { Ok::<_, Infallible>(desk.answer(request.method(), request.uri().path()).await) }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD_MAX)
        .max_buf_size(HEAD_BYTES_MAX)
        .keep_alive(false)
        .serve_connection(TokioIo::new(stream), answer);
    if let Err(error) = connection.await {
        tracing::debug!("a connection for metrics ended: {error}");
    }
}

impl Desk {
    async fn answer(&self, method: &Method, path: &str) -> Response<Full<Bytes>> {
        if !matches!(*method, Method::GET | Method::HEAD) {
            let mut answer = text(StatusCode::METHOD_NOT_ALLOWED, "expected GET or HEAD\n".into());
            answer.headers_mut().insert(ALLOW, HeaderValue::from_static("GET, HEAD"));
            return answer;
        }
        match path {
            "/metrics" => {
                let mut answer = text(StatusCode::OK, self.page());
                answer.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(exposition::CONTENT_TYPE));
                answer
            }
            "/healthz" => judged(self.board.checked().await.alive),
            "/readyz" => judged(self.board.checked().await.ready),
            _ => text(StatusCode::NOT_FOUND, "expected /metrics, /healthz or /readyz\n".into()),
        }
    }

    fn page(&self) -> Bytes {
        let mut page = self.page.lock().unwrap_or_else(PoisonError::into_inner);
        match &*page {
            Some((written, page)) if written.elapsed() < PAGE_EVERY => page.clone(),
            _ => {
                let written = Bytes::from(self.board.page());
                *page = Some((Instant::now(), written.clone()));
                written
            }
        }
    }
}

fn judged(checked: Result<String, String>) -> Response<Full<Bytes>> {
    match checked {
        Ok(told) => text(StatusCode::OK, format!("ok\n{told}").into()),
        Err(wrong) => text(StatusCode::SERVICE_UNAVAILABLE, wrong.into()),
    }
}

fn text(status: StatusCode, text: Bytes) -> Response<Full<Bytes>> {
    let mut answer = Response::new(Full::new(text));
    *answer.status_mut() = status;
    let headers = answer.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static("text/plain; charset=utf-8"));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    answer
}

#[cfg(test)]
mod tests;
