//! A simulated robot behind a proxy, which plants one fault in its messages or connections.

use std::collections::{HashMap, HashSet};
use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

use downbeat_robot::simulated::{Settings, SimulatedRobot};
use downbeat_robot::{Host, HostOptions, serve};
use serde_json::Value;

/// The direction of a line through the proxy.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Way {
    ToRobot,
    ToServer,
}

/// A line of the protocol on its way through the proxy.
pub struct Passing {
    pub way: Way,
    /// Number of the connection on which the line arrived, from 1.
    pub link: u64,
    pub raw: Vec<u8>,
    /// The line as JSON; null if it is not JSON. If a fault changes this value, the changed value is sent instead of the line.
    pub json: Value,
}

impl Passing {
    /// Returns the content of the line, if it is a control request on its way to the robot.
    pub fn request(&mut self) -> Option<&mut Value> {
        let request = (self.way == Way::ToRobot).then(|| self.json.get_mut("control_request")).flatten();
        request.filter(|request| request.is_object())
    }

    /// Returns the content of the line, if it is a control response.
    pub fn response(&mut self) -> Option<&mut Value> {
        self.json.get_mut("control_response")
    }

    pub fn is_from_server(&self, text: &str) -> bool {
        self.way == Way::ToRobot && String::from_utf8_lossy(&self.raw).contains(text)
    }
}

/// What the proxy does with a line.
pub enum Then {
    Pass,
    Drop,
    /// Sends this value back to the sender, and does not pass the line.
    Answer(Value),
    /// Passes these bytes in place of the line.
    Instead(Vec<u8>),
    After(Duration),
    /// Passes the line, and sends further lines.
    With(Vec<More>),
    /// Passes the line in the same direction on the connection with this number.
    On(u64),
    HangUp,
}

/// A line that the proxy itself sends to the robot.
pub struct More {
    pub after: Duration,
    /// Number of the connection on which the line is sent.
    pub link: u64,
    pub line: Value,
}

/// What a planted fault remembers about earlier lines.
#[derive(Default)]
pub struct Memory {
    pub seen: HashSet<(u64, String)>,
    pub count: HashMap<u64, usize>,
    pub running: bool,
    /// Ids of requests, devices or sessions (depending on the fault), in the order of their arrival.
    pub order: Vec<String>,
    /// For each session name or request id, the connection on which it was last received, and the time.
    pub heard: HashMap<String, (u64, Instant)>,
}

pub type Fault = fn(&mut Memory, &mut Passing) -> Then;

/// How the proxy serves its connections.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Serving {
    All,
    /// Serves one connection at a time.
    OneByOne,
    /// Serves this number of connections in total, and none after them.
    AtMost(u64),
    /// Serves at most this number of connections at the same time, each until its peer closes it. Closes further ones.
    AtATime(usize),
    /// Treats each received piece of data as a complete line.
    WithoutBuffer,
    /// Serves no other peer while one peer does not read.
    UnderOneLock,
}

/// Starts a simulated robot on a socket of its own and returns the address. The robot lives as long as the process.
pub fn robot(yaml: &str, settings: Settings) -> SocketAddr {
    static RUNTIME: OnceLock<tokio::runtime::Runtime> = OnceLock::new();
    let runtime = RUNTIME.get_or_init(|| {
        tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap()
    });
    let block = serde_yaml::from_str(yaml).unwrap();
    let host = Host::start(vec![SimulatedRobot::new(block, settings)], HostOptions::default()).unwrap();
    runtime.block_on(async {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        tokio::spawn(async move {
            let _ended = serve(listener, host.handle(), 0).await;
            host.stop();
        });
        address
    })
}

/// Starts a proxy with a planted fault in front of a robot. Returns the address of the proxy.
pub fn faulty(robot: SocketAddr, serving: Serving, fault: Fault) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let memory = Arc::new(Mutex::new(Memory::default()));
    let (one_lock, links) = (Arc::new(Mutex::new(())), Links::default());
    let open = Arc::new(AtomicUsize::new(0));
    std::thread::spawn(move || {
        for (link, server) in (1..).zip(listener.incoming()) {
            if matches!(serving, Serving::AtMost(most) if link > most) {
                return;
            }
            let Ok(server) = server else { continue };
            if matches!(serving, Serving::AtATime(most) if open.load(Ordering::Relaxed) >= most) {
                continue;
            }
            open.fetch_add(1, Ordering::Relaxed);
            let lock = (serving == Serving::UnderOneLock).then(|| Arc::clone(&one_lock));
            let (memory, links, open) = (Arc::clone(&memory), Arc::clone(&links), Arc::clone(&open));
            let carrier = Carrier { serving, fault, link, memory, links, open, lock };
            let carrying = carrier.start(server, robot);
            if serving == Serving::OneByOne {
                carrying.join().unwrap();
            }
        }
    });
    address
}

#[derive(Clone)]
struct Carrier {
    serving: Serving,
    fault: Fault,
    link: u64,
    memory: Arc<Mutex<Memory>>,
    links: Links,
    open: Arc<AtomicUsize>,
    lock: Option<Arc<Mutex<()>>>,
}

/// Beginning of the line in which the conformance test sends the same key twice.
pub const TWICE: &str = "{\"control_request\":{\"control_value\":0,";

type Writer = Arc<Mutex<TcpStream>>;
/// For each connection, the writers to the robot and to the server.
type Links = Arc<Mutex<HashMap<u64, (Writer, Writer)>>>;

impl Carrier {
    /// Starts to carry lines in both directions. The returned thread ends when both directions have ended.
    fn start(self, server: TcpStream, robot: SocketAddr) -> std::thread::JoinHandle<()> {
        let robot = TcpStream::connect(robot).unwrap();
        server.set_nodelay(true).unwrap();
        robot.set_nodelay(true).unwrap();
        let to_robot = Arc::new(Mutex::new(robot.try_clone().unwrap()));
        let to_server = Arc::new(Mutex::new(server.try_clone().unwrap()));
        self.links.lock().unwrap().insert(self.link, (Arc::clone(&to_robot), Arc::clone(&to_server)));
        let (inward, writers) = (self.clone(), (Arc::clone(&to_robot), Arc::clone(&to_server)));
        let reading = std::thread::spawn(move || inward.carry(Way::ToRobot, server, &writers.0, &writers.1));
        std::thread::spawn(move || {
            self.carry(Way::ToServer, robot, &to_server, &to_robot);
            reading.join().unwrap();
        })
    }

    fn carry(&self, way: Way, mut from: TcpStream, to: &Writer, back: &Writer) {
        let cut_anywhere = self.serving == Serving::WithoutBuffer && way == Way::ToRobot;
        if cut_anywhere {
            from.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
        }
        let (mut buffer, mut bytes): (Vec<u8>, _) = (Vec::new(), vec![0; 64 * 1024]);
        'reading: loop {
            let searched = buffer.len();
            match from.read(&mut bytes) {
                Ok(0) => break,
                Ok(read) => buffer.extend_from_slice(&bytes[..read]),
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock && cut_anywhere => {
                    if !buffer.is_empty() {
                        buffer.push(b'\n');
                    }
                }
                Err(_) => break,
            }
            if !buffer[searched..].contains(&b'\n') {
                continue;
            }
            let mut rest = buffer.as_slice();
            while let Some(newline) = rest.iter().position(|byte| *byte == b'\n') {
                let (line, behind) = rest.split_at(newline + 1);
                rest = behind;
                if !self.pass(way, line, to, back) {
                    break 'reading;
                }
            }
            buffer = rest.to_vec();
        }
        self.links.lock().unwrap().remove(&self.link);
        match way {
            Way::ToRobot => drop(self.open.fetch_sub(1, Ordering::Relaxed)),
            // Its place stays taken.
            Way::ToServer if matches!(self.serving, Serving::AtATime(_)) => return,
            Way::ToServer => {}
        }
        for stream in [to, back] {
            let _closed = stream.lock().unwrap().shutdown(Shutdown::Both);
        }
    }

    fn pass(&self, way: Way, line: &[u8], to: &Writer, back: &Writer) -> bool {
        // Neither a huge line nor one with a duplicate key would survive parsing unchanged.
        let huge = line.len() > 1_000_000;
        let twice = String::from_utf8_lossy(line).contains(TWICE);
        let json = if huge || twice { Value::Null } else { serde_json::from_slice(line).unwrap_or_default() };
        let mut passing = Passing { way, link: self.link, raw: line.to_vec(), json: json.clone() };
        let then = (self.fault)(&mut self.memory.lock().unwrap(), &mut passing);
        let edited =
            || if passing.json == json { line.to_vec() } else { format!("{}\n", passing.json).into_bytes() };
        let _serving_nobody_else = self.lock.as_ref().map(|lock| lock.lock().unwrap());
        let write = |writer: &Writer, bytes: &[u8]| writer.lock().unwrap().write_all(bytes).is_ok();
        match then {
            Then::Pass => write(to, &edited()),
            Then::Drop => true,
            Then::Answer(answer) => write(back, format!("{answer}\n").as_bytes()),
            Then::Instead(bytes) => write(to, &bytes),
            Then::After(delay) => {
                std::thread::sleep(delay);
                write(to, &edited())
            }
            Then::With(more) => {
                let passed = write(to, &edited());
                for more in more {
                    let robot = self.links.lock().unwrap().get(&more.link).map(|link| Arc::clone(&link.0));
                    let Some(robot) = robot else { continue };
                    std::thread::spawn(move || {
                        std::thread::sleep(more.after);
                        let _gone = robot.lock().unwrap().write_all(format!("{}\n", more.line).as_bytes());
                    });
                }
                passed
            }
            Then::On(link) => {
                let other = self.links.lock().unwrap().get(&link).map(|(robot, server)| match way {
                    Way::ToRobot => Arc::clone(robot),
                    Way::ToServer => Arc::clone(server),
                });
                other.is_some_and(|other| {
                    let _gone = write(&other, &edited());
                    true
                })
            }
            Then::HangUp => false,
        }
    }
}
