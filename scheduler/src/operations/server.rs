//! The endpoint: metrics and health over HTTP/1.1, on a thread with a runtime of its own that runs after all others. Whoever asks costs
//! a mission nothing: connections are few and short, requests small, and a page is written again only after a while.
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

/// Connections at the same time; more are closed at once.
const CONNECTIONS_MAX: usize = 8;
/// From one connection to the next: more wait in the system's queue.
const ACCEPT_EVERY: Duration = Duration::from_millis(4);
/// The head of a request has to come within this time.
const HEAD_MAX: Duration = Duration::from_secs(2);
/// A connection ends after this time, however slowly its peer reads.
const CONNECTION_MAX: Duration = Duration::from_secs(10);
/// Bytes of the head of a request.
const HEAD_BYTES_MAX: usize = 8_192;
/// A page serves everyone who asks within this time.
const PAGE_EVERY: Duration = Duration::from_millis(250);
/// Ordinary threads run before this one.
const NICE: i32 = 10;

/// What the endpoint tells of. More can be added while it serves.
#[derive(Clone, Default)]
pub(crate) struct Board(Arc<Mutex<Vec<Arc<dyn Told>>>>);

/// What has both metrics and health.
trait Told: Source + Health {}
impl<T: Source + Health> Told for T {}

impl Board {
    pub(crate) fn add(&self, told: impl Source + Health + 'static) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(Arc::new(told));
    }

    fn all(&self) -> Vec<Arc<dyn Told>> {
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

/// What is wrong with one is wrong with both.
fn both(one: Result<String, String>, other: Result<String, String>) -> Result<String, String> {
    match (one, other) {
        (Ok(one), Ok(other)) => Ok(format!("{one}{other}\n")),
        (Err(one), Err(other)) => Err(format!("{one}{other}\n")),
        (Err(wrong), Ok(_)) => Err(wrong),
        (Ok(_), Err(wrong)) => Err(format!("{wrong}\n")),
    }
}

/// Serves a board until the process ends. Returns the address, where the port may have been any.
///
/// # Errors
/// The address cannot be listened on, or the system gives no thread and no runtime.
pub(crate) fn serve(address: SocketAddr, board: Board) -> io::Result<SocketAddr> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    let address = listener.local_addr()?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    // Ends with the process: it holds nothing that has to be let go.
    std::thread::Builder::new().name("metrics".to_owned()).spawn(move || {
        // On Linux this is of the thread alone.
        if let Err(error) = rustix::process::setpriority_process(None, NICE) {
            tracing::warn!("metrics are served with the priority of the others: {error}");
        }
        runtime.block_on(accept_all(listener, Arc::new(Desk { board, page: Mutex::default() })));
    })?;
    Ok(address)
}

/// What all connections share.
struct Desk {
    board: Board,
    /// The last page, and when it was written.
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
                    // Ends when the answer is sent, or its time is over.
                    tokio::spawn(async move {
                        let _over = tokio::time::timeout(CONNECTION_MAX, converse(stream, desk)).await;
                        drop(place);
                    });
                }
            }
            Err(error) => tracing::debug!("a connection for metrics was not accepted: {error}"),
        }
        tokio::time::sleep(ACCEPT_EVERY).await;
    }
}

/// One request, and its answer.
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
