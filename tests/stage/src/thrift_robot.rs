//! A small robot that speaks the Thrift variant of URRCP, the robots' protocol. It implements the protocol byte by byte, so that the
//! driver is not tested against the library that it uses. It supports the strict binary protocol and one connection at a time.

use std::fs::File;
use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime};

const CALL: u8 = 1;
const REPLY: u8 = 2;
const EXCEPTION: u8 = 3;
const BOOL: u8 = 2;
const DOUBLE: u8 = 4;
const STRING: u8 = 11;

/// A robot that speaks the Thrift variant of URRCP and runs in a thread.
pub struct ThriftRobot {
    port: u16,
    stopped: Arc<AtomicBool>,
    frozen: Arc<AtomicBool>,
    talking: Arc<Mutex<Option<TcpStream>>>,
    thread: Option<JoinHandle<()>>,
}

impl ThriftRobot {
    pub fn start(port: u16, schema: &str, log: &Path) -> Self {
        let listener = TcpListener::bind(("127.0.0.1", port)).unwrap();
        let port = listener.local_addr().unwrap().port();
        let (stopped, talking) = (Arc::new(AtomicBool::new(false)), Arc::new(Mutex::new(None)));
        let frozen = Arc::new(AtomicBool::new(false));
        let ice = Arc::clone(&frozen);
        let mut log = File::options().create(true).append(true).open(log).unwrap();
        let (schema, end, stream) = (schema.to_owned(), Arc::clone(&stopped), Arc::clone(&talking));
        // This thread ends with the next connection after `stop`.
        let thread = std::thread::spawn(move || {
            for connection in listener.incoming() {
                if end.load(Ordering::SeqCst) {
                    return;
                }
                let Ok(mut connection) = connection else { continue };
                *stream.lock().unwrap() = connection.try_clone().ok();
                while answer(&mut connection, &schema, &mut log, &ice).is_ok() {}
            }
        });
        Self { port, stopped, frozen, talking, thread: Some(thread) }
    }

    pub fn port(&self) -> u16 {
        self.port
    }

    /// Makes the robot keep its connection without answering, until it is stopped.
    pub fn freeze(&self) {
        self.frozen.store(true, Ordering::SeqCst);
    }

    pub fn stop(&mut self) {
        self.frozen.store(false, Ordering::SeqCst);
        self.stopped.store(true, Ordering::SeqCst);
        if let Some(stream) = self.talking.lock().unwrap().take() {
            let _already_gone = stream.shutdown(Shutdown::Both);
        }
        let _wakes_it = TcpStream::connect(("127.0.0.1", self.port));
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

/// Reads one call of the driver. Logs the value if the call sets one, otherwise answers the call.
fn answer(stream: &mut TcpStream, schema: &str, log: &mut File, frozen: &AtomicBool) -> io::Result<()> {
    let [a, b, _, kind] = take(stream)?;
    while frozen.load(Ordering::SeqCst) {
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!([a, b], [0x80, 0x01], "strict binary protocol");
    let name = text(stream)?;
    let sequence = take::<4>(stream)?;
    let (mut words, mut numbers) = (Vec::new(), Vec::new());
    loop {
        match take::<1>(stream)? {
            [0] => break,
            [kind] => {
                let _id = take::<2>(stream)?;
                match kind {
                    STRING => words.push(text(stream)?),
                    DOUBLE => numbers.push(f64::from_be_bytes(take(stream)?)),
                    other => panic!("an argument of kind {other}"),
                }
            }
        }
    }
    let result = match name.as_str() {
        "ping" => Ok((BOOL, vec![1])),
        "get_init_schema" => Ok((STRING, string(schema))),
        "set_device_double_value" => {
            assert_ne!(kind, CALL, "a one-way call");
            let time = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_secs_f64();
            // Written as a whole, for tests that read the log meanwhile.
            return log.write_all(format!("{time:.6} {} {}\n", words[0], numbers[0]).as_bytes());
        }
        "get_sensor_double_value" if words[0] == "battery" => Ok((DOUBLE, 12.5_f64.to_be_bytes().to_vec())),
        _ => Err("Internal error"),
    };
    let mut bytes = vec![0x80, 0x01, 0, if result.is_ok() { REPLY } else { EXCEPTION }];
    bytes.extend(string(&name));
    bytes.extend(sequence);
    match result {
        Ok((kind, value)) => {
            bytes.extend([kind, 0, 0]);
            bytes.extend(value);
        }
        Err(message) => {
            bytes.extend([STRING, 0, 1]);
            bytes.extend(string(message));
        }
    }
    bytes.push(0);
    stream.write_all(&bytes)
}

fn take<const N: usize>(stream: &mut TcpStream) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    stream.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn text(stream: &mut TcpStream) -> io::Result<String> {
    let length = u32::from_be_bytes(take(stream)?);
    let mut bytes = vec![0; usize::try_from(length).unwrap()];
    stream.read_exact(&mut bytes)?;
    Ok(String::from_utf8(bytes).unwrap())
}

fn string(text: &str) -> Vec<u8> {
    let mut bytes = u32::try_from(text.len()).unwrap().to_be_bytes().to_vec();
    bytes.extend(text.as_bytes());
    bytes
}
