//! A link to one robot on which the scheduler is flooded with messages once that is asked for.

use std::io::{BufRead, BufReader, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

/// An answer to nothing that was asked.
const NOISE: &str = r#"{"control_response":{"timestamp":"2026-01-01T00:00:00Z","device_id":"d","status":"Accepted","request_id":"noise"}}"#;

pub struct Flood {
    pub port: u16,
    begun: Arc<AtomicBool>,
    over: Arc<AtomicBool>,
}

impl Flood {
    pub fn before(robot: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let (begun, over) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        let (begin, end) = (Arc::clone(&begun), Arc::clone(&over));
        std::thread::spawn(move || {
            for client in listener.incoming().map_while(Result::ok) {
                if end.load(Ordering::Relaxed) {
                    return;
                }
                let Ok(robot) = TcpStream::connect(("127.0.0.1", robot)) else { continue };
                carry(client, robot, &begin, &end);
            }
        });
        Self { port, begun, over }
    }

    pub fn begin(&self) {
        self.begun.store(true, Ordering::Relaxed);
    }
}

impl Drop for Flood {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        let _wakes_it = TcpStream::connect(("127.0.0.1", self.port));
    }
}

fn carry(client: TcpStream, robot: TcpStream, begun: &Arc<AtomicBool>, over: &Arc<AtomicBool>) {
    client.set_nodelay(true).unwrap();
    robot.set_nodelay(true).unwrap();
    let copy = |stream: &TcpStream| stream.try_clone().unwrap();
    let to_client = Arc::new(Mutex::new(copy(&client)));
    let (from_client, to_robot, from_robot) = (copy(&client), Mutex::new(copy(&robot)), copy(&robot));
    std::thread::spawn(move || pump(from_client, &to_robot));
    let answers = Arc::clone(&to_client);
    std::thread::spawn(move || pump(from_robot, &answers));
    let (begun, over) = (Arc::clone(begun), Arc::clone(over));
    std::thread::spawn(move || {
        let noise = format!("{NOISE}\n").repeat(50);
        while !over.load(Ordering::Relaxed) {
            if !begun.load(Ordering::Relaxed) {
                std::thread::sleep(std::time::Duration::from_millis(5));
            } else if to_client.lock().unwrap().write_all(noise.as_bytes()).is_err() {
                return;
            }
        }
        let _closed = client.shutdown(Shutdown::Both);
        let _closed = robot.shutdown(Shutdown::Both);
    });
}

/// Line by line, so that two writers do not mix theirs.
fn pump(from: TcpStream, to: &Mutex<TcpStream>) {
    let end = from.try_clone().unwrap();
    let mut lines = BufReader::new(from);
    let mut line = Vec::new();
    while lines.read_until(b'\n', &mut line).is_ok_and(|n| n > 0) {
        if to.lock().unwrap().write_all(&line).is_err() {
            break;
        }
        line.clear();
    }
    let _closed = end.shutdown(Shutdown::Both);
    let _closed = to.lock().unwrap().shutdown(Shutdown::Both);
}
