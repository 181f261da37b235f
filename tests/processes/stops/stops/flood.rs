//! A proxy between the scheduler and one robot that floods the scheduler with messages on command.

use std::io::{BufRead, BufReader, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};

use stage::quiet::await_that;

/// A response to a request that was never sent.
const NOISE: &str = r#"{"control_response":{"timestamp":"2026-01-01T00:00:00Z","device_id":"d","status":"Accepted","request_id":"noise"}}"#;

/// Number of repetitions of `NOISE` in one write.
const REPEATED: usize = 50;
/// Number of writes after which the scheduler counts as flooded.
const WRITES: u32 = 20;

pub struct Flood {
    pub port: u16,
    state: Arc<State>,
}

#[derive(Default)]
struct State {
    begun: AtomicBool,
    over: AtomicBool,
    /// Number of writes of the flood that the scheduler has taken.
    taken: AtomicU32,
    /// Whether the scheduler has disconnected.
    hung_up: AtomicBool,
}

impl Flood {
    pub fn before(robot: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let state = Arc::<State>::default();
        let own = Arc::clone(&state);
        std::thread::spawn(move || {
            for client in listener.incoming().map_while(Result::ok) {
                if own.over.load(Ordering::Relaxed) {
                    return;
                }
                let Ok(robot) = TcpStream::connect(("127.0.0.1", robot)) else { continue };
                carry(client, robot, &own);
            }
        });
        Self { port, state }
    }

    /// Begins the flood. Returns once the scheduler has taken `WRITES` writes or has disconnected.
    pub fn begin(&self) {
        let State { begun, taken, hung_up, .. } = &*self.state;
        begun.store(true, Ordering::Relaxed);
        await_that("the flood", || {
            taken.load(Ordering::Relaxed) >= WRITES || hung_up.load(Ordering::Relaxed)
        });
    }
}

impl Drop for Flood {
    fn drop(&mut self) {
        self.state.over.store(true, Ordering::Relaxed);
        let _wakes_it = TcpStream::connect(("127.0.0.1", self.port));
    }
}

fn carry(client: TcpStream, robot: TcpStream, state: &Arc<State>) {
    client.set_nodelay(true).unwrap();
    robot.set_nodelay(true).unwrap();
    let copy = |stream: &TcpStream| stream.try_clone().unwrap();
    let to_client = Arc::new(Mutex::new(copy(&client)));
    let (from_client, to_robot, from_robot) = (copy(&client), Mutex::new(copy(&robot)), copy(&robot));
    std::thread::spawn(move || pump(from_client, &to_robot));
    let answers = Arc::clone(&to_client);
    std::thread::spawn(move || pump(from_robot, &answers));
    let state = Arc::clone(state);
    std::thread::spawn(move || {
        let noise = format!("{NOISE}\n").repeat(REPEATED);
        while !state.over.load(Ordering::Relaxed) {
            if !state.begun.load(Ordering::Relaxed) {
                std::thread::sleep(std::time::Duration::from_millis(5));
            } else if to_client.lock().unwrap().write_all(noise.as_bytes()).is_err() {
                state.hung_up.store(true, Ordering::Relaxed);
                return;
            } else {
                state.taken.fetch_add(1, Ordering::Relaxed);
            }
        }
        let _closed = client.shutdown(Shutdown::Both);
        let _closed = robot.shutdown(Shutdown::Both);
    });
}

/// Forwards a stream line by line, so that the lines of two writers to the same socket do not mix.
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
