//! Compares plain TCP with Zenoh through a router, in one run. Measures the round trip of one message and the bytes per second on one
//! connection. Also measures the time from the first request of a mission to its decision. In these missions, each robot has its own
//! script, or all robots share a script that is published once. Robots are simulated in a separate process.
//!
//! `ZENOHD=path/of/zenohd cargo bench --features zenoh --bench zenoh`; numbers as arguments set the sizes of the fleets: `-- 100 1000`.
//! `ZENOH_STEPS=8,2000` sets the lengths of scripts.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a program that measures, and stops if it cannot"
)]
#![expect(clippy::disallowed_methods, reason = "real sockets take real time")]
#![expect(clippy::cast_precision_loss, reason = "figures for people")]

use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use downbeat::link::{Endpoint, LinkEncoding, Security};
use downbeat::mission::{Mission, MissionOptions, Participant, Progress};
use downbeat::server_clock::ServerClock;
use downbeat::stop_lane::Operator;
use downbeat_robot::simulated::{Settings, SimulatedRobot};
use downbeat_robot::zenoh::{Key, Listener, Network, Networks, Urgency, connect};
use downbeat_robot::{Host, HostOptions, serve, serve_zenoh};
use downbeat_scripts::{DeviceScript, Plan, RobotPlan};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use urrcp::{
    ControlType, DeviceId, InitializationBlock, Millis, RobotId, Script, Setpoint, Span, Step, StopCondition,
};

const ROUNDS: usize = 3;
const EXCHANGES: usize = 3_000;
const BYTES: usize = 128 * 1024 * 1024;

fn block(id: usize) -> InitializationBlock {
    let json = format!(
        r#"{{"id": "r{id}", "api_version": "1", "reports": true, "devices": [{{"id": "d", "name": "d", "available_control_types": {{
        "position": {{"min_value": 0, "max_value": 90, "granularity": 1}},
        "script": {{"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 10000}}}}}}]}}"#
    );
    serde_json::from_str(&json).unwrap()
}

/// Scripts that the robots of a mission receive.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Scripts {
    /// A different script for each robot.
    Own,
    /// The same script for all robots.
    Same,
}

/// Returns a plan whose scripts have 83 to 90 bytes per step.
fn plan(robots: usize, steps: u32, scripts: Scripts) -> Plan {
    let step = |i: u32, value: u32| Step {
        offset: Millis::new(f64::from(i) * 5.0).unwrap(),
        setpoint: Setpoint::new(ControlType::Position, f64::from(value)),
        stop_condition: None,
    };
    // The last steps are the digits of the robot's number.
    let steps_of = |id: usize| {
        let digit = |i: u32| match scripts {
            Scripts::Own => u32::try_from(id).unwrap() / 10_u32.pow(steps - 1 - i) % 10,
            Scripts::Same => 7,
        };
        (0..steps).map(|i| step(i, if i + 4 < steps { i % 90 } else { digit(i) })).collect()
    };
    let lease = Millis::new(20_000.0).ok();
    let stop_condition = StopCondition { pending: lease, running: lease };
    let script = |id: usize| DeviceScript {
        device: DeviceId::new("d").unwrap(),
        start: Millis::new(id as f64 * 0.25).unwrap(),
        stop_condition,
        script: Script::new(steps_of(id)).unwrap(),
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

struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _reaped = self.0.wait();
    }
}

fn configuration(port: u16) -> String {
    format!(r#"{{mode: "client", connect: {{endpoints: ["tcp/127.0.0.1:{port}"]}}}}"#)
}

/// Starts a Zenoh router on a free port. Returns the router and the port.
fn router() -> (Killed, u16) {
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let mut command = Command::new(std::env::var("ZENOHD").unwrap_or_else(|_| "zenohd".to_owned()));
    command.args(["--no-multicast-scouting", "--listen", &format!("tcp/127.0.0.1:{port}")]);
    let router = Killed(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap());
    while std::net::TcpStream::connect(("127.0.0.1", port)).is_err() {
        std::thread::sleep(Duration::from_millis(5));
    }
    (router, port)
}

/// Starts this program again in another role, such as `count` robots. Returns the port that it prints for each of them, or 0 if it uses
/// `router`.
fn others(role: &str, count: usize, router: u16) -> (Killed, Vec<u16>) {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command
        .env("ZENOH_ROLE", role)
        .env("ZENOH_COUNT", count.to_string())
        .env("ZENOH_ROUTER", router.to_string());
    let mut child = command.stdout(Stdio::piped()).stdin(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let ports = lines.take(count).map(|line| line.unwrap().parse().unwrap()).collect();
    (Killed(child), ports)
}

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap()
}

fn key(id: usize) -> Key {
    format!("bench/r{id}").parse().unwrap()
}

async fn be_robots(count: usize, router: Option<u16>) {
    let machines = (0..count).map(|id| SimulatedRobot::new(block(id), Settings::default())).collect();
    let host = Host::start(machines, HostOptions::default()).unwrap();
    let networks = router.map(|port| Networks::open_with(&configuration(port)).unwrap());
    for index in 0..count {
        match &networks {
            None => {
                let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
                println!("{}", listener.local_addr().unwrap().port());
                tokio::spawn(serve(listener, host.handle(), index));
            }
            Some(networks) => {
                let listener = Listener::bind(&networks.for_one_more(), key(index)).await.unwrap();
                println!("0");
                tokio::spawn(serve_zenoh(listener, host.handle(), index));
            }
        }
    }
    std::io::stdout().flush().unwrap();
    std::future::pending::<()>().await;
}

/// Serves one connection. If its first byte is `e`, echoes all further bytes. Otherwise, answers with one byte when all data has arrived.
async fn echo(stream: impl AsyncRead + AsyncWrite) {
    let (mut reader, mut writer) = tokio::io::split(stream);
    let Ok(first) = reader.read_u8().await else { return };
    let mut bytes = vec![0; 64 * 1024];
    let mut came = 0;
    while let Ok(n @ 1..) = reader.read(&mut bytes).await {
        came += n;
        let said = match first {
            b'e' => writer.write_all(&bytes[..n]).await,
            _ if came == BYTES => writer.write_all(b"!").await,
            _ => Ok(()),
        };
        if said.is_err() {
            return;
        }
    }
}

async fn be_echo(router: Option<u16>) {
    match router {
        None => {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            println!("{}", listener.local_addr().unwrap().port());
            while let Ok((stream, _)) = listener.accept().await {
                stream.set_nodelay(true).unwrap();
                tokio::spawn(echo(stream));
            }
        }
        Some(port) => {
            let network = Network::open_with(&configuration(port)).unwrap();
            let mut listener = Listener::bind(&network, key(0)).await.unwrap();
            println!("0");
            while let Ok(stream) = listener.accept().await {
                tokio::spawn(echo(stream));
            }
        }
    }
}

/// Measures round trips of 200 bytes. Returns them in ascending order.
async fn round_trips(stream: &mut (impl AsyncRead + AsyncWrite + Unpin)) -> Vec<Duration> {
    let (message, mut answer) = ([7; 200], [0; 200]);
    let mut trips = Vec::new();
    stream.write_all(b"e").await.unwrap();
    for _ in 0..EXCHANGES {
        let began = Instant::now();
        stream.write_all(&message).await.unwrap();
        stream.read_exact(&mut answer).await.unwrap();
        trips.push(began.elapsed());
    }
    trips.sort();
    trips
}

/// Measures the throughput in one direction, in megabytes per second.
async fn throughput(mut stream: impl AsyncRead + AsyncWrite + Unpin) -> f64 {
    let piece = vec![7; 64 * 1024];
    stream.write_all(b"s").await.unwrap();
    let began = Instant::now();
    for _ in 0..BYTES / piece.len() {
        stream.write_all(&piece).await.unwrap();
    }
    stream.read_u8().await.unwrap();
    BYTES as f64 / 1e6 / began.elapsed().as_secs_f64()
}

fn one_connection(router: Option<u16>) {
    let role = if router.is_some() { "echo at a key" } else { "echo" };
    let (_other, ports) = others(role, 1, router.unwrap_or(0));
    let (trips, rate) = runtime().block_on(async {
        match router {
            None => {
                let open = async || {
                    let stream = TcpStream::connect(("127.0.0.1", ports[0])).await.unwrap();
                    stream.set_nodelay(true).unwrap();
                    stream
                };
                (round_trips(&mut open().await).await, throughput(open().await).await)
            }
            Some(port) => {
                let network = Network::open_with(&configuration(port)).unwrap();
                let open = async || connect(&network, &key(0), Urgency::None).await.unwrap();
                (round_trips(&mut open().await).await, throughput(open().await).await)
            }
        }
    });
    println!(
        "{:<24} round trip p50 {:>5} us, p99 {:>5} us; {rate:.0} MB/s one way",
        way(router),
        trips[EXCHANGES / 2].as_micros(),
        trips[EXCHANGES * 99 / 100].as_micros()
    );
}

const fn way(router: Option<u16>) -> &'static str {
    if router.is_some() { "Zenoh through a router" } else { "TCP" }
}

/// Returns the time from the first request of a mission to its decision. The robots connect to port `router`; the scheduler connects to
/// port `through`.
fn decision(
    (count, steps, scripts): (usize, u32, Scripts),
    router: Option<u16>,
    through: Option<u16>,
) -> Duration {
    let role = if router.is_some() { "robots at keys" } else { "robots" };
    let (_robots, ports) = others(role, count, router.unwrap_or(0));
    runtime().block_on(async {
        let clock = ServerClock::anchored(Span::ZERO);
        let participants = (0..count).map(|id| Participant::new(block(id).id, Some(block(id)))).collect();
        let options = MissionOptions { patience: Span::from_millis(60_000), ..MissionOptions::default() };
        let mission =
            Mission::of_plan(plan(count, steps, scripts), participants, options, clock.now()).unwrap();
        let networks = through.map(|port| Networks::open_with(&configuration(port)).unwrap());
        let endpoint = |(id, port): (usize, &u16)| match &networks {
            None => Endpoint::Tcp {
                host: "127.0.0.1".into(),
                port: *port,
                encoding: LinkEncoding::default(),
                security: Security::Plain,
            },
            Some(networks) => Endpoint::Zenoh {
                network: networks.for_one_more(),
                key: key(id),
                encoding: LinkEncoding::default(),
            },
        };
        let endpoints = ports.iter().enumerate().map(endpoint).collect();
        let (operator, said) = tokio::sync::mpsc::channel(1);
        let (mut sent, mut decided) = (None, None);
        let report = downbeat::run::run(mission, endpoints, clock, said, |at, progress| match progress {
            Progress::Preparing { .. } => sent = Some(at),
            Progress::Decided { .. } => {
                decided = Some(at);
                let _leaves = operator.try_send(Operator::Leave);
            }
            _ => {}
        })
        .await;
        // Only the time up to the decision is measured.
        let decided = decided.unwrap_or_else(|| panic!("{}: {:?}", report.outcome, report.failures.first()));
        (decided - sent.unwrap()).to_duration()
    })
}

/// Starts a relay to the router. Returns its port and a counter of the bytes that the connecting side sends.
fn relay(router: u16) -> (u16, Arc<AtomicU64>) {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let (port, counted) = (listener.local_addr().unwrap().port(), Arc::new(AtomicU64::new(0)));
    let count = Arc::clone(&counted);
    std::thread::spawn(move || {
        for near in listener.incoming().map_while(Result::ok) {
            let far = std::net::TcpStream::connect(("127.0.0.1", router)).unwrap();
            let (back, count) = ((far.try_clone().unwrap(), near.try_clone().unwrap()), Arc::clone(&count));
            std::thread::spawn(move || carry(back, &AtomicU64::new(0)));
            std::thread::spawn(move || carry((near, far), &count));
        }
    });
    (port, counted)
}

fn carry((mut from, mut to): (std::net::TcpStream, std::net::TcpStream), counted: &AtomicU64) {
    let mut bytes = vec![0; 64 * 1024];
    to.set_nodelay(true).unwrap();
    while let Ok(came @ 1..) = from.read(&mut bytes) {
        counted.fetch_add(came as u64, Ordering::Relaxed);
        if to.write_all(&bytes[..came]).is_err() {
            return;
        }
    }
    let _gone = to.shutdown(std::net::Shutdown::Both);
}

/// Prints the time from the first request of a mission to its decision, and the number of bytes that the scheduler sends through the
/// router.
fn missions(of: (usize, u32, Scripts), router: Option<u16>) {
    let mut times: Vec<_> = (0..ROUNDS).map(|_| decision(of, router, router)).collect();
    times.sort();
    let sent = router.map_or_else(String::new, |port| {
        let (through, counted) = relay(port);
        decision(of, router, Some(through));
        format!("; the scheduler sends {:.2} MB", counted.load(Ordering::Relaxed) as f64 / 1e6)
    });
    let (count, steps, scripts) = of;
    println!(
        "{:<24} {count} robots, {steps} steps, {}: decided after {:.1} ms, best {:.1} ms{sent}",
        way(router),
        if scripts == Scripts::Own { "each its own" } else { "all the same" },
        times[ROUNDS / 2].as_secs_f64() * 1e3,
        times[0].as_secs_f64() * 1e3
    );
}

fn main() {
    downbeat::open_files::raise_limit();
    if let Ok(role) = std::env::var("ZENOH_ROLE") {
        let number = |name| std::env::var(name).unwrap().parse::<usize>().unwrap();
        let (count, router) = (number("ZENOH_COUNT"), u16::try_from(number("ZENOH_ROUTER")).ok());
        return runtime().block_on(async {
            match role.as_str() {
                "robots" => be_robots(count, None).await,
                "robots at keys" => be_robots(count, router).await,
                "echo" => be_echo(None).await,
                _ => be_echo(router).await,
            }
        });
    }
    let (_router, port) = router();
    one_connection(None);
    one_connection(Some(port));
    let mut counts: Vec<usize> = std::env::args().filter_map(|arg| arg.parse().ok()).collect();
    if counts.is_empty() {
        counts = vec![100, 1_000];
    }
    let steps = std::env::var("ZENOH_STEPS").unwrap_or_else(|_| "20,2000".to_owned());
    for steps in steps.split(',').map(|steps| steps.parse().unwrap()) {
        for count in &counts {
            missions((*count, steps, Scripts::Own), None);
            missions((*count, steps, Scripts::Own), Some(port));
            missions((*count, steps, Scripts::Same), Some(port));
        }
    }
}
