//! How closely six robots start: deferred start against start on receipt and tokio's timer, side by side in one run, idle and
//! with all cores busy.
//!
//! Six robot processes on TCP, each with a clock of its own up to 300 ms off. True starts are read from the robots' own
//! logs, by the one clock of the host.
#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a program that measures, and stops if it cannot"
)]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]
#![expect(clippy::cast_precision_loss, reason = "figures for people")]

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use downbeat::drive::{Happened, LinkNumber, Urgency};
use downbeat::link::{Endpoint, Link, Speech};
use downbeat::mission::{Event, Mission, MissionOptions, Participant};
use downbeat::server_clock::ServerClock;
use downbeat_scripts::{DeviceScript, Plan, RobotPlan};
use tokio::sync::mpsc;
use urrcp::{
    Command as Control, ControlRequest, ControlType, DeviceId, InitializationBlock, Message, Millis, RobotId,
    Script, Setpoint, Span, Status, Step, StopCondition,
};

const ROBOTS: usize = 6;
const MISSIONS: usize = 100;

const ROBOT: &str = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [
  {"id": "d", "name": "d", "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 1},
     "script": {"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 8}}}]}"#;

/// How the robots of a fleet run.
#[derive(Clone, Copy)]
struct Settings {
    delay: &'static str,
    ntp_error: &'static str,
    realtime: bool,
}

struct Fleet {
    folder: PathBuf,
    robots: Vec<Child>,
    ports: Vec<u16>,
}

impl Fleet {
    fn start(folder: &Path, settings: Settings) -> Self {
        std::fs::write(folder.join("robot.json"), ROBOT).unwrap();
        let mut fleet = Self { folder: folder.to_path_buf(), robots: Vec::new(), ports: Vec::new() };
        for id in 0..ROBOTS {
            let mut command = Command::new(env!("CARGO_BIN_EXE_downbeat"));
            command.args(["robot", "--listen", "127.0.0.1:0", "--id", &format!("r{id}"), "--init"]);
            command.arg(folder.join("robot.json")).arg("--log-file").arg(fleet.log(id));
            command.args(["--clock-offset", &format!("{}ms", id * 60), "--ntp-error", settings.ntp_error]);
            command.args(["--delay-max", settings.delay, "--seed", &id.to_string()]);
            command.args(settings.realtime.then_some("--realtime"));
            let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
            let mut line = String::new();
            BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
            fleet.ports.push(line.trim().rsplit(':').next().unwrap().parse().unwrap());
            fleet.robots.push(child);
        }
        fleet
    }

    fn log(&self, id: usize) -> PathBuf {
        self.folder.join(format!("r{id}.jsonl"))
    }

    fn endpoint(&self, id: usize) -> Endpoint {
        Endpoint::Tcp { host: "127.0.0.1".into(), port: self.ports[id], speech: Speech::default() }
    }

    /// True instants at which a robot began a script, in nanoseconds.
    fn starts(&self, id: usize) -> Vec<i64> {
        let log = std::fs::read_to_string(self.log(id)).unwrap();
        let entries = log.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
        let first = entries.filter(|entry| entry["motion"] == "set" && entry["step"] == 0);
        first.map(|entry| entry["true_ns"].as_i64().unwrap()).collect()
    }

    /// Spread of each mission's starts in milliseconds, sorted.
    fn spreads(&self, missions: std::ops::Range<usize>) -> Vec<f64> {
        let starts: Vec<_> = (0..ROBOTS).map(|id| self.starts(id)).collect();
        let spread = |mission: usize| {
            let instants = || starts.iter().map(|starts| starts[mission]);
            (instants().max().unwrap() - instants().min().unwrap()) as f64 / 1e6
        };
        let mut spreads: Vec<_> = missions.map(spread).collect();
        spreads.sort_by(f64::total_cmp);
        spreads
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        for robot in &mut self.robots {
            let _gone = robot.kill();
            let _reaped = robot.wait();
        }
    }
}

fn script() -> Script {
    let step = |millis, value| Step {
        offset: Millis::new(millis).unwrap(),
        setpoint: Setpoint::new(ControlType::Position, value),
        stop_condition: None,
    };
    Script::new(vec![step(0.0, 45.0), step(20.0, 0.0), step(40.0, 45.0)]).unwrap()
}

fn plan() -> Plan {
    let stop_condition = StopCondition { pending: None, running: Millis::new(2_000.0).ok() };
    let device = DeviceId::new("d").unwrap();
    let script = DeviceScript { device, start: Millis::ZERO, stop_condition, script: script() };
    let robot =
        |id| RobotPlan { robot: RobotId::new(format!("r{id}")).unwrap(), scripts: vec![script.clone()] };
    let robots = (0..ROBOTS).map(robot).collect();
    let start_tolerance = Span::from_millis(200);
    Plan { scenario: "spread".into(), start_tolerance, lead: None, stop_condition, robots }
}

/// One mission by Downbeat.
async fn deferred(fleet: &Fleet) {
    let block: InitializationBlock = serde_json::from_str(ROBOT).unwrap();
    let participant = |id| Participant::new(RobotId::new(format!("r{id}")).unwrap(), Some(block.clone()));
    let clock = ServerClock::anchored(Span::ZERO);
    let participants = (0..ROBOTS).map(participant).collect();
    let mission = Mission::of_plan(plan(), participants, MissionOptions::default(), clock.now()).unwrap();
    let endpoints = (0..ROBOTS).map(|id| fleet.endpoint(id)).collect();
    let (_operator, said) = mpsc::channel(1);
    let report = downbeat::run::run(mission, endpoints, clock, said, |_, _| {}).await;
    assert!(report.is_done(), "{}: {:?}", report.outcome, report.failures);
}

/// The same script sent to all at once, each starting when it receives it.
async fn on_receipt(fleet: &Fleet) {
    let (events, mut happened) = mpsc::channel(1_024);
    let clock = ServerClock::anchored(Span::ZERO);
    let links: Vec<_> = (0..ROBOTS)
        .map(|id| {
            let link = (id, LinkNumber(id as u64));
            Link::open(link, fleet.endpoint(id), clock, events.clone(), std::time::Duration::ZERO)
        })
        .collect();
    let (mut up, mut ended) = (0, 0);
    while ended < ROBOTS {
        let Happened::OnLink { event, .. } = happened.recv().await.unwrap() else { continue };
        match *event {
            Event::LinkUp { .. } => {
                up += 1;
                if up == ROBOTS {
                    links.iter().for_each(send_at_once);
                }
            }
            Event::Received { message: Message::ControlResponse(response), .. } => {
                assert_ne!(response.status, Status::Failed, "{response:?}");
                ended += usize::from(response.status == Status::Ok);
            }
            _ => {}
        }
    }
}

fn send_at_once(link: &Link) {
    let command = Control::Script(script());
    let request = ControlRequest::immediate(DeviceId::new("d").unwrap(), command);
    link.send(Message::ControlRequest(request), Urgency::InOrder).unwrap();
}

fn row(name: &str, spreads: &[f64]) {
    let count = spreads.len();
    // Nearest rank: the p99 of 100 is the largest but one.
    let rank = |percent: usize| spreads[(count * percent).div_ceil(100) - 1];
    println!("{name:<44}{:>12.3}{:>12.3}{:>12.3}", rank(50), rank(99), rank(100));
}

/// Six processes that wait for an instant by tokio's timer, as one would without a thread of one's own.
struct Timers(Vec<Child>);

impl Timers {
    fn start() -> Self {
        let start = |_| {
            let mut command = Command::new(std::env::current_exe().unwrap());
            command.env("TIMER", "1").stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap()
        };
        Self((0..ROBOTS).map(start).collect())
    }

    /// Spread of each round's wake-ups in milliseconds, sorted.
    fn spreads(&mut self) -> Vec<f64> {
        let mut inputs: Vec<_> = self.0.iter_mut().map(|child| child.stdin.take().unwrap()).collect();
        let mut outputs: Vec<_> =
            self.0.iter_mut().map(|child| BufReader::new(child.stdout.take().unwrap())).collect();
        let mut spreads = Vec::new();
        for _ in 0..MISSIONS {
            let target = epoch_nanos() + 150_000_000;
            inputs.iter_mut().for_each(|input| writeln!(input, "{target}").unwrap());
            let woken: Vec<i64> = outputs
                .iter_mut()
                .map(|output| {
                    let mut line = String::new();
                    output.read_line(&mut line).unwrap();
                    line.trim().parse().unwrap()
                })
                .collect();
            spreads.push((woken.iter().max().unwrap() - woken.iter().min().unwrap()) as f64 / 1e6);
        }
        spreads.sort_by(f64::total_cmp);
        spreads
    }
}

impl Drop for Timers {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _gone = child.kill();
            let _reaped = child.wait();
        }
    }
}

fn epoch_nanos() -> i64 {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    i64::try_from(now.as_nanos()).unwrap()
}

fn be_a_timer() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
    runtime.block_on(async {
        for line in std::io::stdin().lock().lines() {
            let target: i64 = line.unwrap().trim().parse().unwrap();
            let ahead = u64::try_from(target - epoch_nanos()).unwrap_or(0);
            tokio::time::sleep(Duration::from_nanos(ahead)).await;
            println!("{}", epoch_nanos());
        }
    });
}

/// Keeps every core busy.
struct Load(Vec<Child>);

impl Load {
    fn start() -> Self {
        let cores = std::thread::available_parallelism().map_or(1, Into::into);
        let busy = |_| Command::new("sh").args(["-c", "while :; do :; done"]).spawn().unwrap();
        Self((0..cores).map(busy).collect())
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _gone = child.kill();
            let _reaped = child.wait();
        }
    }
}

/// So many missions of a fleet, and their spreads.
fn missions(settings: Settings, deferred_start: bool) -> Vec<f64> {
    let folder = tempfile::tempdir().unwrap();
    let fleet = Fleet::start(folder.path(), settings);
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    runtime.block_on(async {
        for _ in 0..MISSIONS {
            match deferred_start {
                true => deferred(&fleet).await,
                false => on_receipt(&fleet).await,
            }
        }
    });
    // The logs are written within 50 ms.
    std::thread::sleep(Duration::from_millis(200));
    fleet.spreads(0..MISSIONS)
}

fn main() {
    if std::env::var_os("TIMER").is_some() {
        return be_a_timer();
    }
    println!("spread of true starts of {ROBOTS} processes over {MISSIONS} missions, ms");
    println!("{:<44}{:>12}{:>12}{:>12}", "", "p50", "p99", "max");
    let middle = |spreads: &[f64]| spreads[spreads.len() / 2];
    // `-- one-host` leaves the slow part out.
    if !std::env::args().any(|arg| arg == "one-host") {
        let network = Settings { delay: "80ms", ntp_error: "40us", realtime: false };
        println!("clocks known to 40 us, answers up to 80 ms late");
        let by_time = missions(network, true);
        let by_receipt = missions(network, false);
        row("  deferred start", &by_time);
        row("  start on receipt (baseline)", &by_receipt);
        println!("  ratio of medians, receipt / deferred: {:.0}", middle(&by_receipt) / middle(&by_time));
    }
    let one_host = Settings { delay: "1ms", ntp_error: "0s", realtime: false };
    let loads: &[bool] = if std::env::args().any(|arg| arg == "idle") { &[false] } else { &[false, true] };
    for &loaded in loads {
        println!("one clock, {}", if loaded { "all cores busy" } else { "idle" });
        let _load = loaded.then(Load::start);
        let ours = missions(one_host, true);
        row("  deferred start", &ours);
        row("  deferred start, --realtime", &missions(Settings { realtime: true, ..one_host }, true));
        row("  start on receipt (baseline)", &missions(one_host, false));
        let timers = Timers::start().spreads();
        row("  tokio's timer (baseline)", &timers);
        println!("  ratio of medians, tokio's timer / deferred: {:.1}", middle(&timers) / middle(&ours));
    }
}
