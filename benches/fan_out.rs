//! Measures the time from the first request of a mission to its decision, at which all robots have accepted. Thousands of robots on
//! loopback play the same script, or each plays its own. The first baseline is a raw exchange of messages of the same size over tokio's
//! TCP. In the second one, these messages are also encoded and parsed as URRCP requires. The third one is MQTT through mosquitto, if it
//! is installed. Robots are simulated in a separate process.
//!
//! `cargo bench --bench fan_out`; numbers as arguments set the sizes of the fleets: `cargo bench --bench fan_out -- 1000 4000`.
#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    clippy::panic,
    reason = "a program that measures, and stops if it cannot"
)]
#![expect(clippy::disallowed_methods, reason = "real sockets take real time")]
#![expect(clippy::cast_precision_loss, reason = "figures for people")]

use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use downbeat::link::{Endpoint, LinkEncoding, Security};
use downbeat::mission::{Mission, MissionOptions, Participant, Progress};
use downbeat::server_clock::ServerClock;
use downbeat_scripts::{DeviceScript, Plan, RobotPlan};
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader as AsyncBufReader};
use tokio::net::{TcpListener, TcpStream};
use urrcp::{
    Command as Control, ControlRequest, ControlResponse, ControlType, Decoder, DeviceId, InitializationBlock,
    Message, Millis, RequestId, RobotId, Script, Setpoint, Span, Status, StatusValue, Step, StopCondition,
    Timestamp, encode,
};

/// The allocator that the `downbeat` program also uses.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const STEPS: u32 = 20;
const ROUNDS: usize = 7;

fn block(id: usize) -> InitializationBlock {
    let json = format!(
        r#"{{"id": "r{id}", "api_version": "1", "reports": true, "devices": [{{"id": "d", "name": "d", "available_control_types": {{
        "position": {{"min_value": 0, "max_value": 90, "granularity": 1}},
        "script": {{"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 20}}}}}}]}}"#
    );
    serde_json::from_str(&json).unwrap()
}

/// Returns a script. Each `number` gives a different script of the same length.
fn script(number: usize) -> Script {
    let places = [number % 90, number / 90 % 90, number / 8_100];
    let step = |i: u32| Step {
        offset: Millis::new(f64::from(i) * 5.0).unwrap(),
        setpoint: Setpoint::new(
            ControlType::Position,
            places.get(i as usize).map_or_else(|| f64::from(i), |place| *place as f64),
        ),
        stop_condition: None,
    };
    Script::new((0..STEPS).map(step).collect()).unwrap()
}

/// Which scripts the robots play.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Plays {
    /// All robots play the same script.
    InUnison,
    /// Each robot plays a script of its own.
    ItsOwn,
}

fn plan(robots: usize, plays: Plays) -> Plan {
    let stop_condition = StopCondition { pending: None, running: Millis::new(20_000.0).ok() };
    // Staggered: a process that moves eight thousand robots at one instant moves the last one late.
    let script = |id: usize| DeviceScript {
        device: DeviceId::new("d").unwrap(),
        start: Millis::new(id as f64 * 0.25).unwrap(),
        stop_condition,
        script: script(if plays == Plays::ItsOwn { id } else { 0 }),
        rest: Span::ZERO,
    };
    let robot =
        |id: usize| RobotPlan { robot: RobotId::new(format!("r{id}")).unwrap(), scripts: vec![script(id)] };
    Plan {
        scenario: "crowd".into(),
        start_tolerance: Span::from_millis(60_000),
        lead: None,
        stop_condition,
        robots: (0..robots).map(robot).collect(),
    }
}

/// Robots, echo servers or MQTT clients in another process.
struct Peers {
    child: Child,
    ports: Vec<u16>,
}

impl Drop for Peers {
    fn drop(&mut self) {
        let _gone = self.child.kill();
        let _reaped = self.child.wait();
    }
}

/// Starts this program again as `count` peers in the given role.
fn peers(role: &str, count: usize) -> Peers {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.env("FAN_OUT_ROLE", role).env("FAN_OUT_COUNT", count.to_string());
    let mut child = command.stdout(Stdio::piped()).stdin(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let ports = lines.take(count).map(|line| line.unwrap().parse().unwrap()).collect();
    Peers { child, ports }
}

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap()
}

async fn be_robots(count: usize) {
    let machines = (0..count)
        .map(|id| {
            downbeat_robot::simulated::SimulatedRobot::new(
                block(id),
                downbeat_robot::simulated::Settings::default(),
            )
        })
        .collect();
    let host = downbeat_robot::Host::start(machines, downbeat_robot::HostOptions::default()).unwrap();
    for index in 0..count {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        println!("{}", listener.local_addr().unwrap().port());
        tokio::spawn(downbeat_robot::serve(listener, host.handle(), index));
    }
    std::io::stdout().flush().unwrap();
    std::future::pending::<()>().await;
}

/// What the messages of the raw exchange contain.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Carries {
    /// Fixed bytes, which neither side parses.
    Bytes,
    /// Messages, which both sides encode and parse.
    Messages,
}

/// Runs `count` servers that answer every line: with the line itself or, for [`Carries::Messages`], with an acceptance.
async fn be_echoes(count: usize, carries: Carries) {
    for _ in 0..count {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        println!("{}", listener.local_addr().unwrap().port());
        tokio::spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                tokio::spawn(async move {
                    let (reader, mut writer) = stream.into_split();
                    let mut lines = AsyncBufReader::new(reader).lines();
                    while let Ok(Some(line)) = lines.next_line().await {
                        let answer = match carries {
                            Carries::Bytes => (line + "\n").into_bytes(),
                            Carries::Messages => acceptance(&line),
                        };
                        if writer.write_all(&answer).await.is_err() {
                            return;
                        }
                    }
                });
            }
        });
    }
    std::io::stdout().flush().unwrap();
    std::future::pending::<()>().await;
}

/// Returns the response of a robot that accepts the request in `line`.
fn acceptance(line: &str) -> Vec<u8> {
    let Message::ControlRequest(request) = serde_json::from_str(line).unwrap() else { panic!("{line}") };
    let content_hash = Some(request.command.content_hash());
    assert_eq!(request.content_hash, content_hash);
    let Control::Script(script) = request.command else { panic!("{line}") };
    let (now, status_value) = (Timestamp::from_nanos(1_700_000_000_000_000_000), StatusValue::Script(script));
    let response = ControlResponse {
        status_value,
        request_id: request.request_id,
        content_hash,
        ..ControlResponse::new(now, request.device_id, Status::Accepted)
    };
    let mut line = Vec::new();
    encode(&Message::ControlResponse(response), &mut line);
    line
}

/// Plays a mission. Returns the time from the timestamp of its requests to its decision, at which all robots have accepted.
fn downbeat(count: usize, plays: Plays) -> Duration {
    let peers = peers("robots", count);
    runtime().block_on(async {
        let clock = ServerClock::anchored(Span::ZERO);
        let participants = (0..count).map(|id| Participant::new(block(id).id, Some(block(id)))).collect();
        let options = MissionOptions { patience: Span::from_millis(60_000), ..MissionOptions::default() };
        let mission = Mission::of_plan(plan(count, plays), participants, options, clock.now()).unwrap();
        let endpoints = peers
            .ports
            .iter()
            .map(|port| Endpoint::Tcp {
                host: "127.0.0.1".into(),
                port: *port,
                encoding: LinkEncoding::default(),
                security: Security::Plain,
            })
            .collect();
        let (_operator, said) = tokio::sync::mpsc::channel(1);
        let (mut sent, mut decided) = (None, None);
        let report = downbeat::run::run(mission, endpoints, clock, said, |at, progress| match progress {
            Progress::Preparing { .. } => sent = Some(at),
            Progress::Decided { .. } => decided = Some(at),
            _ => {}
        })
        .await;
        assert!(report.is_done(), "{}: {:?}", report.outcome, report.failures.first());
        let took: urrcp::Span = decided.unwrap() - sent.unwrap();
        took.to_duration()
    })
}

fn request_line() -> Vec<u8> {
    let mut line = Vec::new();
    encode(&Message::ControlRequest(request(0, script(0))), &mut line);
    line
}

fn request(id: usize, script: Script) -> ControlRequest {
    let clock = ServerClock::anchored(Span::ZERO);
    let command = Control::Script(script);
    let mut request = ControlRequest::immediate(DeviceId::new("d").unwrap(), command.clone());
    request.timestamp = Some(clock.now());
    request.time_offset_to_start = Some(Millis::new(1_000.0).unwrap());
    request.request_id = Some(RequestId::new(format!("crowd-0123456789abcdef-r{id}")).unwrap());
    request.content_hash = Some(command.content_hash());
    request
}

/// Sends a request to every peer at once, on open connections. Returns the time until all peers have answered.
fn raw(count: usize, carries: Carries) -> Duration {
    let peers = peers(if carries == Carries::Bytes { "echoes" } else { "readers" }, count);
    runtime().block_on(async {
        let line = request_line();
        let mut streams = Vec::with_capacity(count);
        for port in &peers.ports {
            let stream = TcpStream::connect(("127.0.0.1", *port)).await.unwrap();
            stream.set_nodelay(true).unwrap();
            // A mission also compiles and hashes its scripts before it begins.
            streams.push((stream, request(streams.len(), script(streams.len()))));
        }
        let began = Instant::now();
        let mut exchanges = tokio::task::JoinSet::new();
        for (stream, request) in streams {
            let line = line.clone();
            exchanges.spawn(async move {
                let (reader, mut writer) = stream.into_split();
                if carries == Carries::Bytes {
                    writer.write_all(&line).await.unwrap();
                    AsyncBufReader::new(reader).lines().next_line().await.unwrap().unwrap();
                } else {
                    let mut line = Vec::new();
                    encode(&Message::ControlRequest(request), &mut line);
                    writer.write_all(&line).await.unwrap();
                    assert_eq!(read_one(reader).await, Status::Accepted);
                }
            });
        }
        while exchanges.join_next().await.is_some() {}
        began.elapsed()
    })
}

async fn read_one(mut reader: tokio::net::tcp::OwnedReadHalf) -> Status {
    let (mut decoder, mut bytes) = (Decoder::default(), vec![0; 8 * 1024]);
    loop {
        let came = reader.read(&mut bytes).await.unwrap();
        assert!(came > 0);
        decoder.push(&bytes[..came]);
        if let Some(message) = decoder.next_message() {
            let Message::ControlResponse(response) = message.unwrap() else { panic!() };
            return response.status;
        }
    }
}

/// The part of MQTT 3.1.1 that this comparison needs: every robot is a client that subscribes to its own topic and answers on another.
mod mqtt {
    use super::*;

    fn packet(kind: u8, body: &[u8]) -> Vec<u8> {
        let mut bytes = vec![kind];
        let mut left = body.len();
        loop {
            let more = left > 127;
            bytes.push((left % 128) as u8 | if more { 0x80 } else { 0 });
            left /= 128;
            if !more {
                break;
            }
        }
        bytes.extend_from_slice(body);
        bytes
    }

    fn text(text: &str) -> Vec<u8> {
        [&(text.len() as u16).to_be_bytes(), text.as_bytes()].concat()
    }

    async fn read_packet(stream: &mut AsyncBufReader<TcpStream>) -> Option<(u8, Vec<u8>)> {
        use tokio::io::AsyncReadExt;
        let kind = stream.read_u8().await.ok()?;
        let (mut length, mut shift) = (0_usize, 0);
        loop {
            let byte = stream.read_u8().await.ok()?;
            length |= usize::from(byte & 0x7f) << shift;
            shift += 7;
            if byte & 0x80 == 0 {
                break;
            }
        }
        let mut body = vec![0; length];
        stream.read_exact(&mut body).await.ok()?;
        Some((kind, body))
    }

    async fn connect(name: &str, topic: &str) -> AsyncBufReader<TcpStream> {
        let stream = TcpStream::connect(("127.0.0.1", PORT)).await.unwrap();
        stream.set_nodelay(true).unwrap();
        let mut stream = AsyncBufReader::new(stream);
        let hello = [text("MQTT"), vec![4, 2, 0, 60], text(name)].concat();
        stream.get_mut().write_all(&packet(0x10, &hello)).await.unwrap();
        assert_eq!(read_packet(&mut stream).await.unwrap().0, 0x20);
        let subscribe = [vec![0, 1], text(topic), vec![0]].concat();
        stream.get_mut().write_all(&packet(0x82, &subscribe)).await.unwrap();
        assert_eq!(read_packet(&mut stream).await.unwrap().0, 0x90);
        stream
    }

    pub(super) const PORT: u16 = 18_883;

    pub(super) async fn be_clients(count: usize) {
        for id in 0..count {
            let mut stream = connect(&format!("r{id}"), &format!("r/{id}/request")).await;
            tokio::spawn(async move {
                while let Some((_, body)) = read_packet(&mut stream).await {
                    let topic = usize::from(u16::from_be_bytes([body[0], body[1]]));
                    let answer = [text(&format!("a/{id}")), body[2 + topic..].to_vec()].concat();
                    stream.get_mut().write_all(&packet(0x30, &answer)).await.unwrap();
                }
            });
            println!("0");
        }
        std::io::stdout().flush().unwrap();
        std::future::pending::<()>().await;
    }

    /// Publishes to every robot's topic and counts the answers on a wildcard topic, as a user would. Returns the time that this takes;
    /// `None` if mosquitto cannot be started or does not deliver all answers.
    pub(super) fn exchange(count: usize) -> Option<Duration> {
        let folder = std::env::temp_dir().join("downbeat-fan-out-mosquitto.conf");
        let config = format!(
            "listener {PORT} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\nset_tcp_nodelay true\n"
        );
        std::fs::write(&folder, config).unwrap();
        let names = ["mosquitto", "/usr/sbin/mosquitto"];
        let start =
            |name: &&str| Command::new(name).arg("-c").arg(&folder).stderr(Stdio::null()).spawn().ok();
        let child = names.iter().find_map(start)?;
        let _broker = Peers { child, ports: Vec::new() };
        std::thread::sleep(Duration::from_millis(500));
        let _clients = peers("mqtt", count);
        runtime().block_on(async {
            let stream = connect("scheduler", "a/#").await;
            let line = request_line();
            let began = Instant::now();
            let (mut reader, mut writer) = tokio::io::split(stream.into_inner());
            let sending = tokio::spawn(async move {
                for id in 0..count {
                    let body = [text(&format!("r/{id}/request")), line.clone()].concat();
                    writer.write_all(&packet(0x30, &body)).await.unwrap();
                }
                writer
            });
            let mut answers = 0;
            let mut bytes = Vec::new();
            let mut buffer = vec![0; 64 * 1024];
            while answers < count {
                use tokio::io::AsyncReadExt;
                let read = tokio::time::timeout(Duration::from_secs(30), reader.read(&mut buffer)).await;
                let read = read.ok()?.unwrap();
                if read == 0 {
                    return None;
                }
                bytes.extend_from_slice(&buffer[..read]);
                answers += take_packets(&mut bytes);
            }
            let _writer = sending.await.unwrap();
            Some(began.elapsed())
        })
    }

    fn take_packets(bytes: &mut Vec<u8>) -> usize {
        let (mut at, mut packets) = (0, 0);
        loop {
            let (mut length, mut shift, mut next) = (0_usize, 0, at + 1);
            let whole = loop {
                let Some(byte) = bytes.get(next) else { break false };
                length |= usize::from(byte & 0x7f) << shift;
                shift += 7;
                next += 1;
                if byte & 0x80 == 0 {
                    break bytes.len() >= next + length;
                }
            };
            if !whole {
                bytes.drain(..at);
                return packets;
            }
            at = next + length;
            packets += 1;
        }
    }
}

/// The shortest, median and longest of several times, in milliseconds.
struct Times {
    least: f64,
    median: f64,
    most: f64,
}

impl Times {
    /// Summarizes `durations`; `None` if there are none.
    fn of(mut durations: Vec<Duration>) -> Option<Self> {
        durations.sort();
        let at = |index: usize| durations.get(index).map(|time| time.as_secs_f64() * 1e3);
        let last = durations.len().checked_sub(1)?;
        Some(Self { least: at(0)?, median: at(last / 2)?, most: at(last)? })
    }
}

fn main() {
    downbeat::open_files::raise_limit();
    if let Ok(role) = std::env::var("FAN_OUT_ROLE") {
        let count = std::env::var("FAN_OUT_COUNT").unwrap().parse().unwrap();
        // Exits with the process that started it.
        std::thread::spawn(|| {
            let _closed = std::io::stdin().read(&mut [0]);
            std::process::exit(0);
        });
        return runtime().block_on(async {
            match role.as_str() {
                "robots" => be_robots(count).await,
                "echoes" => be_echoes(count, Carries::Bytes).await,
                "readers" => be_echoes(count, Carries::Messages).await,
                "mqtt" => mqtt::be_clients(count).await,
                other => panic!("role {other}"),
            }
        });
    }
    let asked: Vec<usize> = std::env::args().filter_map(|arg| arg.parse().ok()).collect();
    let fleets = if asked.is_empty() { vec![1_000, 4_000, 9_900] } else { asked };
    println!(
        "medians of {ROUNDS} rounds, least and most; requests of {} bytes, {STEPS} steps",
        request_line().len()
    );
    let columns = ["raw tokio", "in unison", "own scripts", "read, written", "mosquitto"];
    println!("{:>7}{}", "robots", columns.map(|column| format!(" {column:>22}")).concat());
    let mut growth: Vec<(f64, f64)> = Vec::new();
    for count in fleets {
        let mut rows = [const { Vec::new() }; 5];
        for _ in 0..ROUNDS {
            // All in turn, so that they run under the same conditions.
            let times = [
                Some(raw(count, Carries::Bytes)),
                Some(downbeat(count, Plays::InUnison)),
                Some(downbeat(count, Plays::ItsOwn)),
                Some(raw(count, Carries::Messages)),
                mqtt::exchange(count),
            ];
            for (row, time) in rows.iter_mut().zip(times) {
                row.extend(time);
            }
        }
        let times = rows.map(Times::of);
        let told = times.each_ref().map(|times| {
            times.as_ref().map_or_else(
                || format!(" {:>22}", "-"),
                |times| format!(" {:>6.1} ({:>5.1} to {:>5.1})", times.median, times.least, times.most),
            )
        });
        println!("{count:>7}{}", told.concat());
        let [Some(raw), Some(unison), Some(own), _, mosquitto] = &times else { continue };
        let ratio = |name: &str, base: &Times| {
            let (unison, own) = (unison.median / base.median, own.median / base.median);
            format!("; of {name}: in unison {unison:.2}, own scripts {own:.2}")
        };
        let of_mosquitto = mosquitto.as_ref().map_or_else(String::new, |base| ratio("mosquitto", base));
        println!("        ms{}{of_mosquitto}", ratio("raw", raw));
        growth.push(((count as f64).ln(), own.median.ln()));
    }
    if let [first, .., last] = growth.as_slice() {
        println!("growth of the decision with the fleet: N^{:.2}", (last.1 - first.1) / (last.0 - first.0));
    }
}
