//! Robots and schedulers as processes on the loopback interface, the robots' logs, and links that fail on command.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![expect(clippy::print_stderr, reason = "missions that are played again are counted")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]
#![expect(missing_docs, clippy::new_without_default, reason = "a crate of the tests")]

pub mod busy;
pub mod compiled;
pub mod editor;
pub mod held_up;
pub mod meddler;
pub mod operators;
pub mod play;
mod proxy;
pub mod quiet;
pub mod raw;
pub mod schema;
pub mod session;
pub mod site;
pub mod standstill;
pub mod terminal;
pub mod thrift_robot;

use std::fmt;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

pub use proxy::Proxy;
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process, waitid};
use serde_json::Value;
use tempfile::TempDir;

use crate::session::program;

/// A process that is killed when it is dropped.
pub struct Process(pub Child);

impl Process {
    pub fn signal(&self, signal: Signal) {
        self::signal(&self.0, signal);
    }

    /// Returns the peak memory usage of the process, in megabytes; 0 once the process has ended.
    pub fn memory(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.0.id())).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kilobytes = line.and_then(|line| line.trim().split(' ').next()?.parse::<u64>().ok());
        kilobytes.unwrap_or(0) / 1024
    }

    /// Ends the process without warning, like a power cut.
    pub fn kill(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _reaped = self.0.wait();
    }
}

/// Sends a signal to a process. After STOP, waits until the process has stopped, because the system stops its threads one by one.
pub fn signal(child: &Child, signal: Signal) {
    let pid = Pid::from_child(child);
    kill_process(pid, signal).unwrap();
    if signal == Signal::STOP {
        let stands = WaitIdOptions::STOPPED | WaitIdOptions::EXITED | WaitIdOptions::NOWAIT;
        waitid(WaitId::Pid(pid), stands).unwrap();
    }
}

/// How the scheduler reaches a robot: directly or through a proxy.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Via {
    Direct,
    Proxy,
}

/// A robot: its current process, and the logs of this and of earlier processes.
pub struct Robot {
    pub id: String,
    pub link: Option<Proxy>,
    process: Process,
    init: String,
    /// Further command-line arguments of the robot's process.
    args: Vec<String>,
    /// Further keys of the robot in the fleet file, as YAML.
    keys: &'static str,
    port: u16,
    logs: Vec<PathBuf>,
}

/// Environment variable that makes robots accept only TLS, so that any test can also run with TLS.
const BY_TLS: &str = "DOWNBEAT_TLS";

/// A folder that contains a fleet file and scenarios, and the running robots that the fleet file lists.
pub struct Stage {
    folder: TempDir,
    pub robots: Vec<Robot>,
    by_tls: bool,
}

impl Stage {
    pub fn new() -> Self {
        Self::by(std::env::var_os(BY_TLS).is_some())
    }

    /// Creates a stage whose robots have keys and accept only the operator that the fleet file names.
    pub fn with_keys() -> Self {
        Self::by(true)
    }

    fn by(by_tls: bool) -> Self {
        let stage = Self { folder: TempDir::new().unwrap(), robots: Vec::new(), by_tls };
        if by_tls {
            stage.keys(&["init"]);
            stage.keys(&["operator", "anna", "--role", "observe,drive,stop"]);
        }
        stage
    }

    fn keys(&self, args: &[&str]) {
        let made = self.command(&[&["keys"], args].concat()).output().unwrap();
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    }

    /// If the stage uses TLS, adds the robot's key to the arguments of its process.
    fn with_key(&self, id: &str, mut args: Vec<String>) -> Vec<String> {
        let key = format!("keys/robots/{id}.pem");
        if self.by_tls && !args.contains(&key) {
            if !self.path(&key).exists() {
                self.keys(&["robot", id]);
            }
            args.extend(["--identity".to_owned(), key]);
        }
        args
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn file(&self, name: &str, content: impl AsRef<[u8]>) -> &Self {
        std::fs::write(self.path(name), content).unwrap();
        self
    }

    /// Starts a robot with this initialization block and adds it to the fleet file. Returns the robot's index.
    pub fn robot(&mut self, init: &str, via: Via) -> usize {
        self.robot_with(init, via, Vec::new(), "")
    }

    /// Like [`Stage::robot`], with further arguments for the robot's process and further keys in the fleet file.
    pub fn robot_with(&mut self, init: &str, via: Via, args: Vec<String>, keys: &'static str) -> usize {
        let id = format!("r{}", self.robots.len());
        let log = self.path(&format!("{id}-0.jsonl"));
        let args = self.with_key(&id, args);
        let (process, port) = start(self.folder.path(), init, &args, &id, 0, &log);
        let proxy = if self.by_tls { Proxy::encrypted_to } else { Proxy::to };
        let link = (via == Via::Proxy).then(|| proxy(port));
        let (init, logs) = (init.to_owned(), vec![log]);
        self.robots.push(Robot { id, link, process, init, args, keys, port, logs });
        self.write_fleet();
        self.robots.len() - 1
    }

    /// Starts a robot with this id, which is not listed in the fleet file. Returns the robot's port.
    pub fn robot_called(&mut self, id: &str, init: &str, args: Vec<String>) -> u16 {
        // The name of the log is unique, because another robot may have the same id.
        let log = self.path(&format!("{id}-called-{}.jsonl", self.robots.len()));
        let args = self.with_key(id, args);
        let (process, port) = start(self.folder.path(), init, &args, id, 0, &log);
        let (id, init, logs) = (id.to_owned(), init.to_owned(), vec![log]);
        self.robots.push(Robot { id, link: None, process, init, args, keys: "", port, logs });
        port
    }

    fn write_fleet(&self) {
        let (scheme, identity) =
            if self.by_tls { ("tls", "identity: keys/operators/anna.pem\n") } else { ("tcp", "") };
        let row = |robot: &Robot| {
            let port = robot.link.as_ref().map_or(robot.port, |link| link.port);
            let Robot { id, init, keys, .. } = robot;
            format!("  {id}: {{init: {init}, address: \"{scheme}://127.0.0.1:{port}\"{keys}}}\n")
        };
        let rows: String = self.robots.iter().map(row).collect();
        let ids: Vec<_> = self.robots.iter().map(|robot| robot.id.as_str()).collect();
        self.file("fleet.yaml", format!("{identity}robots:\n{rows}groups:\n  all: [{}]\n", ids.join(", ")));
    }

    /// Ends a robot's process, and starts it again on the same port. The new process knows nothing of what the old one received.
    pub fn restart(&mut self, index: usize) {
        let id = self.robots[index].id.clone();
        self.replace(index, &id);
    }

    /// Ends a robot's process, and starts a robot with this id on the same port. The log of the new process is added to the robot's logs.
    pub fn replace(&mut self, index: usize, id: &str) {
        let args = self.robots[index].args.clone();
        self.replace_with(index, id, args);
    }

    /// Like [`Stage::replace`], with other arguments for the new process.
    pub fn replace_with(&mut self, index: usize, id: &str, args: Vec<String>) {
        self.robots[index].kill();
        let mut args = args;
        if self.robots[index].id != id {
            args.truncate(args.iter().position(|arg| arg == "--identity").unwrap_or(args.len()));
        }
        let args = self.with_key(id, args);
        let robot = &self.robots[index];
        let log = self.path(&format!("{}-{}.jsonl", robot.id, robot.logs.len()));
        let (process, _) = start(self.folder.path(), &robot.init, &args, id, robot.port, &log);
        let robot = &mut self.robots[index];
        (robot.process, robot.args) = (process, args);
        robot.logs.push(log);
    }

    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = ended_by_a_hang_up();
        command.args(args).args(session::figures(args)).current_dir(self.folder.path());
        command.env("DOWNBEAT_STATE", self.path("state")).env("DOWNBEAT_KEYS", "keys");
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// Starts Downbeat in the background.
    pub fn start(&self, args: &[&str]) -> Running {
        Running::new(self.command(args))
    }

    /// Starts a mission. Returns once each of `robots` has set `sets` more values than before.
    #[track_caller]
    pub fn begin(&self, args: &[&str], robots: impl IntoIterator<Item = usize>, sets: usize) -> Running {
        let robots: Vec<usize> = robots.into_iter().collect();
        self.start_in_time(args, |running| {
            let counts = || robots.iter().map(|robot| self.robots[*robot].sets().len());
            let (before, started): (Vec<_>, _) = (counts().collect(), Instant::now());
            while !running.has_ended() {
                if counts().zip(&before).all(|(count, before)| count >= before + sets) {
                    return true;
                }
                let waited = started.elapsed();
                assert!(waited < play::SOON, "after {waited:?}, not every robot has set {sets} values");
                std::thread::sleep(Duration::from_millis(2));
            }
            false
        })
    }

    /// Starts a mission. Returns once the mission has printed a line that contains `text`.
    #[track_caller]
    pub fn start_until(&self, args: &[&str], text: &str) -> Running {
        self.start_in_time(args, |running| running.find(text).is_some())
    }

    /// Starts a mission, and returns it when `has_begun` returns true. Starts it again if it ends before that and reports that this
    /// machine was too slow.
    #[track_caller]
    fn start_in_time(&self, args: &[&str], has_begun: impl Fn(&mut Running) -> bool) -> Running {
        for _ in 0..held_up::ATTEMPTS {
            let mut running = self.start(args);
            if has_begun(&mut running) {
                return running;
            }
            running.ended().assert_held_up();
        }
        panic!("this machine was too slow to begin {} times", held_up::ATTEMPTS);
    }

    /// Runs Downbeat to its end. If it plays a mission, plays the mission again if this machine was too slow to start it.
    #[track_caller]
    pub fn run(&self, args: &[&str]) -> Ended {
        let run = || self.start(args).ended();
        if args.first() == Some(&"run") {
            held_up::begun_in(&self.path("state"), run, Ended::said)
        } else {
            run()
        }
    }

    /// Plays a mission to its end. Plays the mission again if this machine was too slow for it.
    #[track_caller]
    pub fn play(&self, args: &[&str]) -> Ended {
        held_up::played_in(&self.path("state"), || self.start(args).ended(), Ended::said)
    }
}

/// Returns a command that runs Downbeat with the default action for SIGHUP. This matters if `nohup` runs the tests, because the programs
/// that it starts ignore SIGHUP.
pub fn ended_by_a_hang_up() -> Command {
    let mut command = Command::new("env");
    command.args(["--default-signal=HUP", program()]);
    command
}

fn start(folder: &Path, init: &str, args: &[String], id: &str, port: u16, log: &Path) -> (Process, u16) {
    let mut command = Command::new(program());
    command.args(["robot", "--init", init, "--id", id, "--listen", &format!("127.0.0.1:{port}")]).args(args);
    command.arg("--log-file").arg(log).current_dir(folder).env("DOWNBEAT_STATE", folder.join("state"));
    command.stdout(Stdio::piped()).stderr(Stdio::null());
    let mut process = Process(command.spawn().unwrap());
    let mut line = String::new();
    BufReader::new(process.0.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let port = line.trim().rsplit(':').next().unwrap().parse();
    (process, port.unwrap_or_else(|_| panic!("no port in `{line}`")))
}

impl Robot {
    /// Returns the port on which the robot itself listens, behind its proxy.
    pub const fn port(&self) -> u16 {
        self.port
    }

    /// Returns the peak memory usage of the robot's process, in megabytes.
    pub fn memory(&self) -> u64 {
        self.process.memory()
    }

    /// Ends the robot's process without warning, like a power cut.
    pub fn kill(&mut self) {
        self.process.kill();
    }

    /// Suspends the robot's process by SIGSTOP until [`Robot::thaw`] is called.
    pub fn freeze(&self) {
        self.process.signal(Signal::STOP);
    }

    pub fn thaw(&self) {
        self.process.signal(Signal::CONT);
    }

    /// Returns the log of each of the robot's processes, in order.
    pub fn logs(&self) -> impl Iterator<Item = String> {
        self.logs.iter().map(|path| std::fs::read_to_string(path).unwrap())
    }

    /// Returns all entries of the robot's logs, including those from before a restart. The last line of a killed process may be
    /// incomplete and is then skipped.
    pub fn log(&self) -> Vec<Logged> {
        self.logs().flat_map(|text| text.lines().filter_map(Logged::read).collect::<Vec<_>>()).collect()
    }

    /// Returns the log entries that follow the first `lines` entries.
    pub fn log_since(&self, lines: usize) -> Vec<Logged> {
        self.log().split_off(lines)
    }

    /// Returns the log entries of kind `set`: the script values that the robot has set.
    pub fn sets(&self) -> Vec<Logged> {
        self.log().into_iter().filter(|entry| entry.motion == "set").collect()
    }

    /// Returns the values that the robot has set on one device, in order.
    pub fn values(&self, device: &str) -> Vec<f64> {
        self.sets().iter().filter(|entry| entry.device == device).map(|entry| entry.value).collect()
    }

    /// Waits until the last entry of the robot's log has this kind of movement.
    #[track_caller]
    pub fn await_logged(&self, motion: &str, within: Duration) {
        let began = Instant::now();
        while self.log().last().is_none_or(|line| line.motion != motion) {
            assert!(began.elapsed() < within, "{} logged last: {:?}", self.id, self.log().last());
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Waits until the robot has logged `count` script values.
    #[track_caller]
    pub fn await_sets(&self, count: usize, within: Duration) {
        let began = Instant::now();
        while self.sets().len() < count {
            assert!(began.elapsed() < within, "{} set only {} values", self.id, self.sets().len());
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

/// One line of a robot's log.
#[derive(Clone, Debug)]
pub struct Logged {
    /// Id that the robot's process reports.
    pub robot: String,
    /// Time when the value was set, by the host's clock, in nanoseconds since the Unix epoch.
    pub at: i64,
    /// Time when the value was set, by the robot's own clock, in nanoseconds. `due` uses the same clock.
    pub set_at: i64,
    pub due: i64,
    pub device: String,
    /// Kind of movement: `set`, `ramp`, `slow` or `default`.
    pub motion: String,
    pub value: f64,
    pub step: Option<u64>,
    pub request: String,
}

impl Logged {
    pub fn read(line: &str) -> Option<Self> {
        let entry: Value = serde_json::from_str(line).ok()?;
        let text = |key: &str| entry[key].as_str().unwrap_or_default().to_owned();
        Some(Self {
            robot: text("robot"),
            at: entry["true_ns"].as_i64()?,
            set_at: nanos(entry["set_at"].as_str()?),
            due: nanos(entry["due"].as_str()?),
            device: text("device"),
            motion: text("motion"),
            value: entry["value"].as_f64()?,
            step: entry["step"].as_u64(),
            request: text("request_id"),
        })
    }
}

/// Returns the description of a robot that makes reports and has the device `d`. `queue` is the number of scripts that the device holds,
/// `largest` the largest position, and `steps` the maximum number of steps of a script.
pub fn one_device(queue: impl fmt::Display, largest: u32, steps: impl fmt::Display) -> String {
    with_devices(&format!(
        "  - id: d
    name: d
    script_queue: {queue}
    available_control_types:
      position: {{min_value: 0, max_value: {largest}, granularity: 1}}
      script: {{min_value: 0, max_value: {largest}, granularity: 1, max_number_of_steps: {steps}}}
"
    ))
}

/// Returns the description of a robot that makes reports and has these devices, given in YAML.
pub fn with_devices(devices: &str) -> String {
    format!("id: robot\napi_version: '1'\nreports: true\ndevices:\n{devices}")
}

/// Converts an RFC 3339 timestamp to nanoseconds since the Unix epoch.
pub fn nanos(text: &str) -> i64 {
    let at: urrcp::Timestamp<urrcp::Server> = serde_json::from_value(Value::String(text.to_owned())).unwrap();
    at.as_nanos()
}

/// Converts a local time of day to nanoseconds since the Unix epoch. Of yesterday, today and tomorrow, chooses the day for which the
/// result is closest to now.
pub fn today(text: &str) -> i64 {
    let time: chrono::NaiveTime = text.parse().unwrap_or_else(|_| panic!("no time of day: {text}"));
    let now = chrono::DateTime::from_timestamp_nanos(epoch_nanos()).with_timezone(&chrono::Local);
    let days = [-1, 0, 1].map(|days| now.date_naive() + chrono::TimeDelta::days(days));
    let instants = days.map(|day| day.and_time(time).and_local_timezone(chrono::Local).earliest());
    let nanos = instants.into_iter().flatten().filter_map(|instant| instant.timestamp_nanos_opt());
    nanos.min_by_key(|instant| (instant - epoch_nanos()).abs()).unwrap()
}

/// Returns the current time, in nanoseconds since the Unix epoch.
pub fn epoch_nanos() -> i64 {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    i64::try_from(now.as_nanos()).unwrap()
}

pub fn sleep_until(at: i64) {
    let ahead = u64::try_from(at - epoch_nanos()).unwrap_or(0);
    std::thread::sleep(Duration::from_nanos(ahead));
}

/// A run of Downbeat in the background, whose output is read as it arrives.
pub struct Running {
    pub process: Process,
    lines: Receiver<String>,
    told: String,
    out: JoinHandle<String>,
}

/// The result of a run of Downbeat that has ended.
#[derive(Clone)]
pub struct Ended {
    pub code: Option<i32>,
    pub out: String,
    /// Messages that Downbeat printed while it ran.
    pub told: String,
}

impl Ended {
    /// Returns all output of Downbeat, including its report.
    pub fn said(&self) -> String {
        format!("{}{}", self.told, self.out)
    }
}

impl Running {
    fn new(mut command: Command) -> Self {
        let mut child = command.spawn().unwrap();
        let (mut stdout, stderr) = (child.stdout.take().unwrap(), child.stderr.take().unwrap());
        let (tell, lines) = channel();
        std::thread::spawn(move || {
            for line in BufReader::new(stderr).lines().map_while(Result::ok) {
                if tell.send(line).is_err() {
                    return;
                }
            }
        });
        let out = std::thread::spawn(move || {
            let mut out = String::new();
            stdout.read_to_string(&mut out).unwrap();
            out
        });
        Self { process: Process(child), lines, told: String::new(), out }
    }

    /// Returns the next line of Downbeat's messages that contains `text`. Panics with the report if Downbeat ends without printing such a
    /// line.
    #[track_caller]
    pub fn line(&mut self, text: &str) -> String {
        self.find(text).unwrap_or_else(|| {
            let out = std::mem::replace(&mut self.out, std::thread::spawn(String::new));
            panic!("no line contains `{text}`: {}{}", self.told, out.join().unwrap())
        })
    }

    fn find(&mut self, text: &str) -> Option<String> {
        while let Ok(line) = self.lines.recv() {
            self.told.push_str(&line);
            self.told.push('\n');
            if line.contains(text) {
                return Some(line);
            }
        }
        None
    }

    /// Waits until the mission prepares the next act, and returns its planned start, in nanoseconds since the Unix epoch.
    #[track_caller]
    pub fn start(&mut self) -> i64 {
        start_in(&self.line("start at "))
    }

    /// Like [`Running::start`], but returns `None` if the mission ends before it prepares an act.
    pub fn start_if_prepared(&mut self) -> Option<i64> {
        self.find("start at ").map(|line| start_in(&line))
    }

    fn has_ended(&mut self) -> bool {
        self.process.0.try_wait().unwrap().is_some()
    }

    /// Waits until Downbeat ends, and returns its result. Panics after a minute.
    #[track_caller]
    pub fn ended(self) -> Ended {
        self.ended_within(Duration::from_secs(60)).unwrap_or_else(|told| panic!("the program hangs: {told}"))
    }

    /// Waits until Downbeat ends, and returns its result. If it does not end within `patience`, kills it and returns its messages as the
    /// error.
    pub fn ended_within(mut self, patience: Duration) -> Result<Ended, String> {
        let began = Instant::now();
        let code = loop {
            if let Some(status) = self.process.0.try_wait().unwrap() {
                break status.code();
            }
            if began.elapsed() > patience {
                self.told.extend(self.lines.try_iter().map(|line| line + "\n"));
                return Err(self.told);
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        self.told.extend(self.lines.iter().map(|line| line + "\n"));
        Ok(Ended { code, out: self.out.join().unwrap(), told: self.told })
    }
}

fn start_in(line: &str) -> i64 {
    let time = line.split("start at ").nth(1).unwrap();
    today(time.split([' ', ',']).next().unwrap())
}

impl Ended {
    /// Panics unless the report states that this machine was too slow for the mission.
    #[track_caller]
    pub fn assert_held_up(&self) {
        let reason = held_up::reason(&self.said());
        let reason = reason.unwrap_or_else(|| panic!("it ended before its robots moved: {self}"));
        eprintln!("started again at {}: {reason}", std::panic::Location::caller());
    }

    /// Parses the report of a run with `--format json`.
    #[track_caller]
    pub fn report(&self) -> Value {
        serde_json::from_str(&self.out).unwrap_or_else(|e| panic!("{e}: {}{}", self.out, self.told))
    }
}

impl fmt::Display for Ended {
    /// Displays the result for the message of a failed test. A report is reduced to its outcome, its failures, and the main figures of
    /// each robot.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "exit code {:?}\n{}", self.code, self.told)?;
        let report: Value = serde_json::from_str(&self.out).unwrap_or_default();
        if report["outcome"].is_null() {
            return f.write_str(&self.out);
        }
        write!(f, "outcome {}", report["outcome"])?;
        report["failures"]
            .as_array()
            .into_iter()
            .flatten()
            .try_for_each(|failure| write!(f, "\n{failure}"))?;
        for row in report["robots"].as_array().into_iter().flatten() {
            let (robot, stop) = (&row["robot"], &row["stop"]);
            let counts = ["started", "scripts", "steps_done", "steps_planned", "unaccounted", "reconnects"];
            let counts = counts.map(|key| format!("{key} {}", row[key])).join(", ");
            write!(f, "\n{robot}: {counts}, stop {stop}")?;
        }
        Ok(())
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        // Ends the robots before the folder is removed. Frozen processes are killed, too.
        self.robots.clear();
    }
}

/// Returns a port of this machine on which no process listens.
pub fn free_port() -> u16 {
    std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}
