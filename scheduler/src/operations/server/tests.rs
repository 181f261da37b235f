//! Tests of the endpoint with clients, including misbehaving ones.

use std::future::Future;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::pin::Pin;

use super::super::names;
use super::*;

struct One(Result<String, String>);

impl Source for One {
    fn write(&self, page: &mut Page) {
        page.each(&names::R_LINKED, [("arm \"1\"", 1.0), ("unknown", f64::NAN)].into_iter());
    }
}

impl Health for One {
    fn now(&self) -> Pin<Box<dyn Future<Output = Checked> + Send + '_>> {
        let checked = Checked { alive: Ok("one: lives".to_owned()), ready: self.0.clone() };
        Box::pin(std::future::ready(checked))
    }
}

fn served(ready: &[Result<&str, &str>]) -> SocketAddr {
    let board = Board::default();
    ready.iter().for_each(|ready| board.add(One(ready.map(str::to_owned).map_err(str::to_owned))));
    serve("127.0.0.1:0".parse().unwrap(), board).unwrap()
}

fn said(address: SocketAddr, request: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

fn got(address: SocketAddr, path: &str) -> String {
    said(address, &format!("GET {path} HTTP/1.1\r\nHost: here\r\n\r\n"))
}

#[test]
fn metrics_use_the_prometheus_text_format() {
    let page = got(served(&[Ok("")]), "/metrics");
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    assert!(page.contains("content-type: text/plain; version=0.0.4"), "{page}");
    assert!(page.contains("# TYPE downbeat_robot_link_up gauge\n"), "{page}");
    assert!(page.contains("downbeat_robot_link_up{robot=\"arm \\\"1\\\"\"} 1\n"), "{page}");
    assert!(!page.contains("unknown"), "a value that is unknown is left out: {page}");
}

#[test]
fn readiness_fails_and_lists_every_part_that_is_not_ready() {
    let address = served(&[Ok("one: ready"), Err("two: away"), Err("three: away")]);
    let (alive, ready) = (got(address, "/healthz"), got(address, "/readyz"));
    assert!(
        alive.starts_with("HTTP/1.1 200") && alive.ends_with("one: lives\none: lives\none: lives\n"),
        "{alive}"
    );
    assert!(ready.starts_with("HTTP/1.1 503") && ready.ends_with("\r\ntwo: away\nthree: away\n"), "{ready}");
}

#[test]
fn other_paths_and_methods_are_refused() {
    let address = served(&[]);
    assert!(got(address, "/").starts_with("HTTP/1.1 404"));
    assert!(
        said(address, "POST /metrics HTTP/1.1\r\nHost: here\r\nContent-Length: 0\r\n\r\n")
            .starts_with("HTTP/1.1 405")
    );
    assert!(said(address, "nonsense\r\n\r\n").starts_with("HTTP/1.1 400"));
    let long = "a".repeat(4 * HEAD_BYTES_MAX);
    let mut stream = TcpStream::connect(address).unwrap();
    // The response or the end of the connection may arrive before the whole request is written.
    let _ended = stream.write_all(format!("GET /{long} HTTP/1.1\r\n\r\n").as_bytes());
    let mut answer = Vec::new();
    let _ended = stream.read_to_end(&mut answer);
    assert!(!answer.starts_with(b"HTTP/1.1 200"), "{}", String::from_utf8_lossy(&answer));
}

#[test]
fn silent_connections_are_closed_and_others_served_again() {
    let address = served(&[Ok("")]);
    let silent: Vec<_> = (0..2 * CONNECTIONS_MAX).map(|_| TcpStream::connect(address).unwrap()).collect();
    for mut stream in silent {
        let mut rest = Vec::new();
        // Admitted connections are closed after a while, all others immediately.
        let _reset = stream.read_to_end(&mut rest);
    }
    assert!(got(address, "/healthz").starts_with("HTTP/1.1 200"));
}
