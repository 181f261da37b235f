//! How closely six robots start, and how late: deferred start with and without real-time scheduling, start on receipt, and
//! tokio's timer, in turn within one run, idle and with all cores busy.
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
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use downbeat::drive::{Happened, LinkNumber, Urgency};
use downbeat::link::{Endpoint, Link, LinkEncoding, Security};
use downbeat::mission::{Event, Mission, MissionOptions, Participant};
use downbeat::server_clock::ServerClock;
use downbeat_scripts::{DeviceScript, Plan, RobotPlan};
use tokio::sync::mpsc;
use urrcp::{
    Command as Control, ControlRequest, ControlType, DeviceId, InitializationBlock, Message, Millis, RobotId,
    Script, Setpoint, Span, Status, Step, StopCondition,
};

const ROBOTS: usize = 6;
/// Starts that are further apart belong to two missions.
const BETWEEN_MISSIONS_NS: i64 = 100_000_000;
/// Missions that were played again.
static REPEATED: AtomicUsize = AtomicUsize::new(0);
const MISSIONS: usize = 100;
/// A robot that has nothing else to write has written its log by then.
const LOGS_WRITTEN: Duration = Duration::from_millis(200);

const ROBOT: &str = r#"{"id": "r", "api_version": "1", "reports": true, "devices": [
  {"id": "d", "name": "d", "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 1},
     "script": {"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 8}}}]}"#;

/// How the robots of a fleet run.
#[derive(Clone, Copy)]
struct Settings {
    delay: &'static str,
    ntp_error: &'static str,
    realtime: &'static str,
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
            command.args(["--realtime", settings.realtime]);
            let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
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
        Endpoint::Tcp {
            host: "127.0.0.1".into(),
            port: self.ports[id],
            encoding: LinkEncoding::default(),
            security: Security::Plain,
        }
    }

    /// When a robot began its scripts.
    fn starts(&self, id: usize) -> Vec<Start> {
        let log = std::fs::read_to_string(self.log(id)).unwrap();
        let entries = log.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
        let first = entries.filter(|entry| entry["motion"] == "set" && entry["step"] == 0);
        let at = |time: &serde_json::Value| {
            let time = chrono::DateTime::parse_from_rfc3339(time.as_str().unwrap()).unwrap();
            time.timestamp_nanos_opt().unwrap()
        };
        first
            .map(|entry| Start {
                true_ns: entry["true_ns"].as_i64().unwrap(),
                late_ms: (at(&entry["set_at"]) - at(&entry["due"])) as f64 / 1e6,
            })
            .collect()
    }

    /// What became of its missions: those that all robots started.
    fn measured(&self) -> Measured {
        let mut starts: Vec<_> = (0..ROBOTS).flat_map(|id| self.starts(id)).collect();
        starts.sort_by_key(|start| start.true_ns);
        let missions = starts.chunk_by(|a, b| b.true_ns - a.true_ns < BETWEEN_MISSIONS_NS);
        let whole = missions.filter(|starts| starts.len() == ROBOTS);
        let late = starts.iter().map(|start| start.late_ms).collect();
        Measured::of(late, whole.map(|starts| starts.iter().map(|start| start.true_ns).collect()))
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

/// One mission by Downbeat; one that was not done, because the scheduler was held up, is played again.
async fn deferred(fleet: &Fleet) {
    while !was_played(fleet).await {
        REPEATED.fetch_add(1, Ordering::Relaxed);
    }
}

async fn was_played(fleet: &Fleet) -> bool {
    let block: InitializationBlock = serde_json::from_str(ROBOT).unwrap();
    let participant = |id| {
        let id = RobotId::new(format!("r{id}")).unwrap();
        Participant::new(id.clone(), Some(InitializationBlock { id, ..block.clone() }))
    };
    let clock = ServerClock::anchored(Span::ZERO);
    let participants = (0..ROBOTS).map(participant).collect();
    let mission = Mission::of_plan(plan(), participants, MissionOptions::default(), clock.now()).unwrap();
    let endpoints = (0..ROBOTS).map(|id| fleet.endpoint(id)).collect();
    let (_operator, said) = mpsc::channel(1);
    let report = downbeat::run::run(mission, endpoints, clock, said, |_, _| {}).await;
    let again = REPEATED.load(Ordering::Relaxed);
    assert!(report.is_done() || again < MISSIONS, "{}: {:?}", report.outcome, report.failures);
    report.is_done()
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

/// When a robot began a script, and how late that was by its own clock.
struct Start {
    true_ns: i64,
    late_ms: f64,
}

/// In milliseconds, each sorted.
struct Measured {
    /// Of every robot in every mission; empty where nothing was due.
    late: Vec<f64>,
    /// First start to last of every mission.
    spreads: Vec<f64>,
}

impl Measured {
    fn of(mut late: Vec<f64>, rounds: impl Iterator<Item = Vec<i64>>) -> Self {
        let spread = |instants: Vec<i64>| {
            (instants.iter().max().unwrap() - instants.iter().min().unwrap()) as f64 / 1e6
        };
        let mut spreads: Vec<_> = rounds.map(spread).collect();
        spreads.sort_by(f64::total_cmp);
        late.sort_by(f64::total_cmp);
        Self { late, spreads }
    }

    fn row(&self, name: &str) {
        println!("{name:<36}{}   {}", percentiles(&self.spreads), percentiles(&self.late));
    }

    fn middle(&self) -> f64 {
        self.spreads[self.spreads.len() / 2]
    }
}

fn percentiles(sorted: &[f64]) -> String {
    if sorted.is_empty() {
        return format!("{:>36}", "-");
    }
    // Nearest rank: the p99 of 100 is the largest but one.
    let rank = |percent: usize| sorted[(sorted.len() * percent).div_ceil(100) - 1];
    [50, 90, 99, 100].map(|percent| format!("{:>9.3}", rank(percent))).concat()
}

/// Six processes that wait for an instant by tokio's timer, as one would without a thread of one's own.
struct Timers {
    children: Vec<Child>,
    inputs: Vec<ChildStdin>,
    outputs: Vec<BufReader<ChildStdout>>,
    late: Vec<f64>,
    rounds: Vec<Vec<i64>>,
}

impl Timers {
    fn start() -> Self {
        let start = |_| {
            let mut command = Command::new(std::env::current_exe().unwrap());
            command.env("TIMER", "1").stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap()
        };
        let mut children: Vec<_> = (0..ROBOTS).map(start).collect();
        let inputs = children.iter_mut().map(|child| child.stdin.take().unwrap()).collect();
        let outputs = children.iter_mut().map(|child| BufReader::new(child.stdout.take().unwrap())).collect();
        Self { children, inputs, outputs, late: Vec::new(), rounds: Vec::new() }
    }

    fn round(&mut self) {
        let target = epoch_nanos() + 150_000_000;
        self.inputs.iter_mut().for_each(|input| writeln!(input, "{target}").unwrap());
        let woken = self.outputs.iter_mut().map(|output| {
            let mut line = String::new();
            output.read_line(&mut line).unwrap();
            line.trim().parse().unwrap()
        });
        let woken: Vec<i64> = woken.collect();
        self.late.extend(woken.iter().map(|woken| (woken - target) as f64 / 1e6));
        self.rounds.push(woken);
    }

    fn measured(&mut self) -> Measured {
        Measured::of(std::mem::take(&mut self.late), std::mem::take(&mut self.rounds).into_iter())
    }
}

impl Drop for Timers {
    fn drop(&mut self) {
        for child in &mut self.children {
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

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap()
}

/// Over a network that delays: starts by time and on receipt.
fn over_a_network() {
    let network = Settings { delay: "80ms", ntp_error: "40us", realtime: "auto" };
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let fleets = folders.each_ref().map(|folder| Fleet::start(folder.path(), network));
    runtime().block_on(async {
        for _ in 0..MISSIONS {
            deferred(&fleets[0]).await;
            on_receipt(&fleets[1]).await;
        }
    });
    std::thread::sleep(LOGS_WRITTEN);
    let [by_time, by_receipt] = fleets.each_ref().map(|fleet| fleet.measured());
    by_time.row("  deferred start");
    Measured { late: Vec::new(), ..by_receipt }.row("  start on receipt (baseline)");
}

/// On one host: with real-time scheduling where it is permitted, without it, on receipt, and by tokio's timer, in turn, so that
/// whatever else runs meets all of them alike.
fn on_one_host() {
    let settings = |realtime| Settings { delay: "1ms", ntp_error: "0s", realtime };
    let folders: Vec<_> = (0..3).map(|_| tempfile::tempdir().unwrap()).collect();
    let auto = Fleet::start(folders[0].path(), settings("auto"));
    let off = Fleet::start(folders[1].path(), settings("off"));
    let receiving = Fleet::start(folders[2].path(), settings("auto"));
    let mut timers = Timers::start();
    let runtime = runtime();
    for _ in 0..MISSIONS {
        runtime.block_on(deferred(&auto));
        runtime.block_on(deferred(&off));
        runtime.block_on(on_receipt(&receiving));
        timers.round();
    }
    std::thread::sleep(LOGS_WRITTEN);
    let (off, timers) = (off.measured(), timers.measured());
    auto.measured().row("  deferred start, --realtime auto");
    off.row("  deferred start, --realtime off");
    Measured { late: Vec::new(), ..receiving.measured() }.row("  start on receipt (baseline)");
    timers.row("  tokio's timer (baseline)");
    println!("  not done and played again: {}", REPEATED.swap(0, Ordering::Relaxed));
    println!("  ratio of medians, tokio's timer / --realtime off: {:.1}", timers.middle() / off.middle());
}

fn main() {
    if std::env::var_os("TIMER").is_some() {
        return be_a_timer();
    }
    println!("{ROBOTS} processes, {MISSIONS} missions, ms");
    println!("{:<36}{:>36}   {:>36}", "", "apart: p50, p90, p99, max", "late: p50, p90, p99, max");
    // `-- one-host` leaves the slow part out.
    if !std::env::args().any(|arg| arg == "one-host") {
        println!("clocks known to 40 us, answers up to 80 ms late");
        over_a_network();
    }
    let loads: &[bool] = if std::env::args().any(|arg| arg == "idle") { &[false] } else { &[false, true] };
    for &loaded in loads {
        println!("one clock, {}", if loaded { "all cores busy" } else { "idle" });
        let _load = loaded.then(Load::start);
        on_one_host();
    }
}
