//! A TCP proxy in front of one robot. Its link stalls, breaks and recovers on command.

use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use serde_json::Value;

/// State of the link through the proxy.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Flow {
    /// All messages pass.
    Open,
    /// Connections stay open, and no messages pass. Messages are delivered when the link opens.
    Frozen,
    /// Connections stay open. Messages from the robot pass, but messages to it do not.
    Deaf,
    /// Connections stay open. Messages to the robot pass, but messages from it do not.
    Dumb,
    /// All connections are closed. New connections stay open and carry nothing.
    Interrupted,
    /// All connections are closed, and new connections are refused, as if no process listened.
    Cut,
    /// The proxy has been dropped.
    Ended,
}

struct Link {
    flow: Flow,
    /// Port of the robot behind the proxy.
    robot: u16,
    connections: Vec<TcpStream>,
    /// A text and a duration. The next line to the robot that contains the text is lost, and the link is interrupted for the duration.
    lose: Option<(String, Duration)>,
    /// A text and a delay. The next line to the robot that contains the text, and every later line, is delayed.
    slows: Option<(String, Duration)>,
    /// Number of connections that will still be reset after the first write to the robot.
    resets: u32,
    lines_lost: u32,
    /// Number of the current generation of connections, which [`Proxy::strand`] increases. Connections of earlier generations stay open,
    /// but no longer carry anything.
    generation: u32,
    /// Keys that are removed from the robot's messages.
    without: &'static [&'static str],
    /// Delay of each line, in each direction.
    delay: Duration,
    /// Function that modifies each message from the robot.
    rewrite: Option<fn(&mut Value)>,
    /// Whether the link is encrypted, so that neither lines nor their content can be recognised.
    encrypted: bool,
}

struct Shared {
    link: Mutex<Link>,
    changed: Condvar,
}

/// A proxy in front of one robot, whose link fails on command.
pub struct Proxy {
    /// Port on which the proxy listens.
    pub port: u16,
    shared: Arc<Shared>,
}

impl Proxy {
    pub fn to(robot: u16) -> Self {
        Self::carrying(robot, false)
    }

    /// Creates a proxy that, like an attacker, sees only encrypted bytes. It cannot rewrite messages, and loses arbitrary bytes instead
    /// of a line.
    pub fn encrypted_to(robot: u16) -> Self {
        Self::carrying(robot, true)
    }

    fn carrying(robot: u16, encrypted: bool) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let link = Link {
            flow: Flow::Open,
            robot,
            connections: Vec::new(),
            lose: None,
            slows: None,
            resets: 0,
            lines_lost: 0,
            generation: 0,
            without: &[],
            delay: Duration::ZERO,
            rewrite: None,
            encrypted,
        };
        let shared = Arc::new(Shared { link: Mutex::new(link), changed: Condvar::new() });
        let own = Arc::clone(&shared);
        std::thread::spawn(move || own.listen(listener, port));
        Self { port, shared }
    }

    /// Blocks all messages. Connections stay open.
    pub fn freeze(&self) {
        self.shared.set(Flow::Frozen);
    }

    /// Blocks messages to the robot. Messages from the robot pass.
    pub fn deafen(&self) {
        self.shared.set(Flow::Deaf);
    }

    /// Blocks messages from the robot. Messages to the robot pass.
    pub fn silence(&self) {
        self.shared.set(Flow::Dumb);
    }

    /// Makes the present connections permanently dead: messages on them are lost without an error on either side. Later connections work.
    pub fn strand(&self) {
        self.shared.lock().generation += 1;
    }

    /// Closes all connections. Later connections stay open but carry nothing, as if the robot were out of reach.
    pub fn interrupt(&self) {
        self.shared.set(Flow::Interrupted);
    }

    /// Closes all connections and refuses later ones, as if the robot's process had ended.
    pub fn cut(&self) {
        self.shared.set(Flow::Cut);
    }

    /// Delivers the delayed messages, and accepts connections again.
    pub fn open(&self) {
        self.shared.set(Flow::Open);
    }

    /// Directs later connections to the robot at this port, as if it had taken over the address.
    pub fn lead_to(&self, robot: u16) {
        self.shared.lock().robot = robot;
    }

    /// Loses the next line to the robot that contains `text`, and interrupts the link for `away`.
    pub fn lose(&self, text: &str, away: Duration) {
        self.shared.lock().lose = Some((text.to_owned(), away));
    }

    /// Returns the number of lines that [`Proxy::lose`] has lost.
    pub fn lines_lost(&self) -> u32 {
        self.shared.lock().lines_lost
    }

    /// Whether the proxy can read and change messages.
    pub fn reads(&self) -> bool {
        !self.shared.lock().encrypted
    }

    /// Removes these keys from all messages of the robot, as if the robot supported only a part of the protocol.
    pub fn leave_out(&self, keys: &'static [&'static str]) {
        assert!(self.reads(), "what is encrypted cannot be changed");
        self.shared.lock().without = keys;
    }

    /// Delays every line by `delay`, in each direction.
    pub fn delay(&self, delay: Duration) {
        self.shared.lock().delay = delay;
    }

    /// Delays the next line to the robot that contains `text`, and every later line, by `delay`.
    pub fn slow_down_at(&self, text: &str, delay: Duration) {
        assert!(self.reads(), "lines of an encrypted link cannot be distinguished");
        self.shared.lock().slows = Some((text.to_owned(), delay));
    }

    /// Whether the line that [`Proxy::slow_down_at`] waits for has arrived.
    pub fn has_slowed_down(&self) -> bool {
        let link = self.shared.lock();
        link.slows.is_none() && !link.delay.is_zero()
    }

    /// Modifies all messages from the robot with `rewrite`.
    pub fn rewrite(&self, rewrite: fn(&mut Value)) {
        assert!(self.reads(), "what is encrypted cannot be changed");
        self.shared.lock().rewrite = Some(rewrite);
    }

    /// Closes the next `connections` connections as soon as data is written to the robot. The robot never receives that data.
    pub fn reset_first(&self, connections: u32) {
        self.shared.lock().resets = connections;
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.shared.set(Flow::Ended);
    }
}

/// The direction of lines through the proxy.
#[derive(Clone, Copy)]
enum Way {
    ToRobot,
    FromRobot,
}

/// The sender of delayed lines, each with the time at which it is due, and the thread that delivers them.
type UnderWay = (Sender<(Instant, Vec<u8>)>, std::thread::JoinHandle<()>);

/// One direction of a connection. It writes lines at once; after the first delay, a thread writes them in order.
struct Outlet {
    to: TcpStream,
    later: Option<UnderWay>,
}

impl Outlet {
    const fn new(to: TcpStream) -> Self {
        Self { to, later: None }
    }

    /// Writes a line, now or after `delay`. Returns whether the connection is still open, as far as is known.
    fn write(&mut self, line: Vec<u8>, delay: Duration) -> bool {
        if self.later.is_none() && delay.is_zero() {
            return self.to.write_all(&line).is_ok();
        }
        let to = &self.to;
        let (sender, _) = self.later.get_or_insert_with(|| {
            let (sender, lines) = channel();
            let to = to.try_clone().unwrap();
            (sender, std::thread::spawn(move || deliver(&lines, to)))
        });
        sender.send((Instant::now() + delay, line)).is_ok()
    }

    /// Ends the outlet. Lines in flight still arrive.
    fn end(self) {
        if let Some((sender, thread)) = self.later {
            drop(sender);
            thread.join().unwrap();
        }
    }
}

fn deliver(lines: &Receiver<(Instant, Vec<u8>)>, mut to: TcpStream) {
    for (due, line) in lines {
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        if to.write_all(&line).is_err() {
            let _closed = to.shutdown(Shutdown::Both);
            return;
        }
    }
}

/// How the proxy handles a line.
enum Pass {
    On,
    Break,
    Lose(Duration),
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Link> {
        self.link.lock().unwrap()
    }

    fn set(&self, flow: Flow) {
        let mut link = self.lock();
        link.flow = flow;
        if matches!(flow, Flow::Interrupted | Flow::Cut | Flow::Ended) {
            for end in link.connections.drain(..) {
                let _closed = end.shutdown(Shutdown::Both);
            }
        }
        drop(link);
        self.changed.notify_all();
    }

    fn listen(self: &Arc<Self>, first: TcpListener, port: u16) {
        let mut listener = Some(first);
        loop {
            let flow = self.lock().flow;
            match flow {
                Flow::Ended => return,
                Flow::Cut => listener = None,
                _ if listener.is_none() => listener = TcpListener::bind(("127.0.0.1", port)).ok(),
                _ => {}
            }
            if let Some(listener) = listener.as_ref().filter(|_| flow != Flow::Interrupted) {
                listener.set_nonblocking(true).unwrap();
                match listener.accept() {
                    Ok((client, _)) => self.carry(&client),
                    Err(error) => assert_eq!(error.kind(), ErrorKind::WouldBlock, "{error}"),
                }
            }
            std::thread::sleep(Duration::from_millis(3));
        }
    }

    fn carry(self: &Arc<Self>, client: &TcpStream) {
        let link = self.lock();
        let (robot, generation) = (link.robot, link.generation);
        drop(link);
        client.set_nonblocking(false).unwrap();
        let Ok(robot) = TcpStream::connect(("127.0.0.1", robot)) else { return };
        let copy = |stream: &TcpStream| stream.try_clone().unwrap();
        for stream in [client, &robot] {
            stream.set_nodelay(true).unwrap();
            self.lock().connections.push(copy(stream));
        }
        let (to, back) = (Arc::clone(self), Arc::clone(self));
        let (client_in, robot_out) = (copy(client), copy(&robot));
        let (robot_in, client_out) = (copy(&robot), copy(client));
        std::thread::spawn(move || to.pump(Way::ToRobot, generation, client_in, robot_out));
        std::thread::spawn(move || back.pump(Way::FromRobot, generation, robot_in, client_out));
    }

    fn pump(self: &Arc<Self>, way: Way, generation: u32, from: TcpStream, to: TcpStream) {
        let ends = [from.try_clone().unwrap(), to.try_clone().unwrap()];
        let mut lines = BufReader::new(from);
        let mut line = Vec::new();
        let mut outlet = Outlet::new(to);
        let encrypted = self.lock().encrypted;
        while next(&mut lines, encrypted, &mut line).is_ok_and(|n| n > 0) {
            let link = self.lock();
            let mut link = self.changed.wait_while(link, |link| link.holds_back(way)).unwrap();
            if matches!(link.flow, Flow::Interrupted | Flow::Cut | Flow::Ended) {
                break;
            }
            if link.generation != generation {
                line.clear();
                continue;
            }
            let pass = match way {
                Way::ToRobot => link.said_to_robot(&line),
                Way::FromRobot => link.said_by_robot(&mut line),
            };
            let delay = link.delay;
            drop(link);
            match pass {
                Pass::On if outlet.write(std::mem::take(&mut line), delay) => {}
                Pass::On | Pass::Break => break,
                Pass::Lose(away) => {
                    self.interrupt_for(away);
                    break;
                }
            }
        }
        outlet.end();
        // The other end of a dead connection must not learn that this end has been closed.
        if self.lock().generation == generation {
            for end in ends {
                let _closed = end.shutdown(Shutdown::Both);
            }
        }
    }

    fn interrupt_for(self: &Arc<Self>, away: Duration) {
        self.set(Flow::Interrupted);
        let own = Arc::clone(self);
        std::thread::spawn(move || {
            std::thread::sleep(away);
            if own.lock().flow == Flow::Interrupted {
                own.set(Flow::Open);
            }
        });
    }
}

/// Reads a line, or any available bytes if lines cannot be recognised.
fn next(from: &mut BufReader<TcpStream>, encrypted: bool, into: &mut Vec<u8>) -> std::io::Result<usize> {
    if !encrypted {
        return from.read_until(b'\n', into);
    }
    let bytes = from.fill_buf()?.to_vec();
    from.consume(bytes.len());
    into.extend_from_slice(&bytes);
    Ok(bytes.len())
}

impl Link {
    fn holds_back(&self, way: Way) -> bool {
        match way {
            Way::ToRobot => matches!(self.flow, Flow::Frozen | Flow::Deaf),
            Way::FromRobot => matches!(self.flow, Flow::Frozen | Flow::Dumb),
        }
    }

    fn said_by_robot(&mut self, line: &mut Vec<u8>) -> Pass {
        if (!self.without.is_empty() || self.rewrite.is_some())
            && let Ok(mut message) = serde_json::from_slice::<Value>(line)
        {
            take_out(&mut message, self.without);
            self.rewrite.iter().for_each(|rewrite| rewrite(&mut message));
            *line = format!("{message}\n").into_bytes();
        }
        Pass::On
    }

    fn said_to_robot(&mut self, line: &[u8]) -> Pass {
        let line = String::from_utf8_lossy(line);
        if self.resets > 0 {
            self.resets -= 1;
            return Pass::Break;
        }
        if let Some((_, delay)) = self.slows.take_if(|(text, _)| line.contains(text.as_str())) {
            self.delay = delay;
        }
        let encrypted = self.encrypted;
        match self.lose.take_if(|(text, _)| encrypted || line.contains(text.as_str())) {
            Some((_, away)) => {
                self.lines_lost += 1;
                Pass::Lose(away)
            }
            None => Pass::On,
        }
    }
}

fn take_out(value: &mut Value, keys: &[&str]) {
    match value {
        Value::Object(map) => {
            map.retain(|key, _| !keys.contains(&key.as_str()));
            map.values_mut().for_each(|value| take_out(value, keys));
        }
        Value::Array(values) => values.iter_mut().for_each(|value| take_out(value, keys)),
        _ => {}
    }
}
