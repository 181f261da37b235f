//! The operator's stop, with robots and scheduler as processes, while one thing after another in and round the scheduler
//! stands still: every robot that can be reached is at rest at once by its own log, and the others are named.

mod flood;

use std::fs::File;
use std::io::{PipeReader, PipeWriter, Read, Write, pipe};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

use crate::robots::{Process, Stage, Via, epoch_nanos, one_device};
use flood::Flood;

/// How the operator stops.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    CtrlC,
    Terminate,
    HangUp,
    /// `downbeat stop`.
    Command,
    /// `downbeat stop` after the scheduler was killed.
    AfterCrash,
    /// `downbeat stop` while the scheduler's process is stopped.
    WhileFrozen,
}

/// What stands still, is full, has changed or is gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Trouble {
    Terminal,
    Pipes,
    StdoutFull,
    DiskFull,
    DiskStalled,
    FleetChanged,
    FleetDeleted,
    Flood,
    Dead,
}

const TROUBLES: [Trouble; 9] = [
    Trouble::Terminal,
    Trouble::Pipes,
    Trouble::StdoutFull,
    Trouble::DiskFull,
    Trouble::DiskStalled,
    Trouble::FleetChanged,
    Trouble::FleetDeleted,
    Trouble::Flood,
    Trouble::Dead,
];

/// Cells that are played at once.
const AT_ONCE: usize = 3;
/// A machine that is busy for a moment proves nothing.
const TRIES: usize = 3;
/// Within which every robot has to be at rest.
const AT_REST: Duration = Duration::from_millis(300);
/// When a scheduler that does not answer is given up by `downbeat stop`.
const GIVEN_UP: Duration = Duration::from_secs(1);
/// However busy the machine is: a stop that waits for a disk of six seconds is found out.
const AT_REST_MAX: Duration = Duration::from_secs(3);
/// By then it has to have ended, or is killed.
const ENDS_WITHIN: Duration = Duration::from_secs(12);

/// Slows down by 10 a second, every second: from 5 to 0 in 0.5 s.
const WHEEL: &str = "id: wheel
api_version: '1'
reports: true
devices:
  - id: w
    name: w
    default_value: 0
    available_control_types:
      speed: {min_value: -20, max_value: 20, granularity: 0.1}
      acceleration: {min_value: -10, max_value: 10, granularity: 0.1}
      script: {min_value: -20, max_value: 20, granularity: 0.1, max_number_of_steps: 600, control_types: [speed]}
";
/// The robot with the wheel.
const WHEELED: usize = 4;
/// The robot that floods or is dead.
const ODD: usize = 5;

/// A value each 20 ms for ten seconds, without a lease: only a stop ends it.
fn scenario() -> String {
    let frames = |value: &dyn Fn(u32) -> f64| {
        let frame = |step: u32| format!("{{at: {}ms, to: {}}}", step * 20, value(step));
        (0..500).map(frame).collect::<Vec<_>>().join(", ")
    };
    let positions = frames(&|step| f64::from(step + 1));
    let speeds = frames(&|step| 5.0 - f64::from(step % 2) / 10.0);
    format!(
        "scenario: play
start_tolerance: 1s
on_failure: without
stop_condition: {{running: none}}
cues:
  - {{at: 0s, robots: [r0, r1, r2, r3, r5], tracks: {{d: [{positions}]}}}}
  - {{at: 0s, robots: r4, stop_condition: {{running: 9s}}, tracks: {{w: {{control: speed, keyframes: [{speeds}]}}}}}}
"
    )
}

/// The program of this file, compiled once.
fn compiled(name: &str, flags: &[&str]) -> &'static Path {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    static DISK: OnceLock<PathBuf> = OnceLock::new();
    static TERMINAL: OnceLock<PathBuf> = OnceLock::new();
    let once = if name == "disk" { &DISK } else { &TERMINAL };
    once.get_or_init(|| {
        let folder = FOLDER.get_or_init(|| tempfile::TempDir::new().unwrap());
        let path = folder.path().join(name);
        let source = crate::session::root().join("tests/stops").join(format!("{name}.c"));
        let mut compiler = Command::new("cc");
        compiler.arg("-O1").args(flags).arg("-o").arg(&path).arg(source).arg("-ldl");
        assert!(compiler.status().unwrap().success(), "a C compiler is needed");
        path
    })
}

/// A mission of six robots that plays, in trouble soon.
struct Show {
    stage: Stage,
    trouble: Trouble,
    scheduler: Process,
    /// Its process, which may be behind a terminal.
    pid: Pid,
    flood: Option<Flood>,
    out: Option<PipeReader>,
    /// Kept so that it can be filled.
    full: Option<PipeWriter>,
}

impl Show {
    fn begin(trouble: Trouble) -> Self {
        Self::begin_by(trouble, &[])
    }

    /// Started by another program, which becomes it.
    fn begin_by(trouble: Trouble, starter: &[&str]) -> Self {
        let mut stage = Stage::new();
        stage.file("arm.yaml", one_device(1, 600, 600)).file("wheel.yaml", WHEEL);
        for robot in 0..6 {
            stage.robot(if robot == WHEELED { "wheel.yaml" } else { "arm.yaml" }, Via::Direct);
        }
        stage.file("play.yaml", scenario());
        let fleet = std::fs::read_to_string(stage.path("fleet.yaml")).unwrap();
        let flood = (trouble == Trouble::Flood).then(|| {
            let port = port_of(&fleet, ODD);
            let flood = Flood::before(port);
            stage.file("fleet.yaml", fleet.replace(&port.to_string(), &flood.port.to_string()));
            flood
        });
        let mut command = program(&stage, &["run", "play.yaml", "--patience", "2s"], trouble);
        if let [program, args @ ..] = starter {
            let mut by = Command::new(program);
            by.args(args).arg(command.get_program()).args(command.get_args());
            by.envs(command.get_envs().filter_map(|(name, value)| Some((name, value?))));
            by.current_dir(command.get_current_dir().unwrap()).stdin(Stdio::null());
            command = by;
        }
        let (mut out, mut full) = (None, None);
        match trouble {
            Trouble::Terminal => {
                command.stdout(Stdio::null()).stderr(Stdio::null());
            }
            Trouble::Pipes => {
                let (reader, writer) = pipe().unwrap();
                command.stdout(writer.try_clone().unwrap()).stderr(writer.try_clone().unwrap());
                (out, full) = (Some(reader), Some(writer));
            }
            _ => {
                let (reader, writer) = pipe().unwrap();
                let stdout = if trouble == Trouble::StdoutFull {
                    Stdio::from(File::options().write(true).open("/dev/full").unwrap())
                } else {
                    Stdio::from(writer)
                };
                command.stdout(stdout).stderr(File::create(stage.path("told")).unwrap());
                out = Some(reader);
            }
        }
        let scheduler = Process(command.spawn().unwrap());
        drop(command);
        let pid = match trouble {
            Trouble::Terminal => pid_in(&stage.path("pid")),
            _ => Pid::from_child(&scheduler.0),
        };
        let show = Self { stage, trouble, scheduler, pid, flood, out, full };
        show.stage.robots.iter().for_each(|robot| robot.await_sets(8, Duration::from_secs(30)));
        show
    }

    fn strike(&mut self) {
        let fleet = || std::fs::read_to_string(self.stage.path("fleet.yaml")).unwrap();
        match self.trouble {
            Trouble::Terminal => self.scheduler.signal(Signal::USR1),
            Trouble::Pipes => fill(self.full.as_ref().unwrap()),
            Trouble::StdoutFull => {}
            Trouble::DiskFull => {
                self.stage.file("disk-full", "");
            }
            Trouble::DiskStalled => {
                self.stage.file("disk-stalled", "");
            }
            Trouble::FleetChanged => {
                // Two robots are swapped, and one is gone.
                let fleet = fleet();
                let (one, two) = (port_of(&fleet, 0).to_string(), port_of(&fleet, 1).to_string());
                let swapped = fleet.replace(&one, "ONE").replace(&two, &one).replace("ONE", &two);
                let kept = |line: &&str| !line.starts_with("  r2:");
                let text: Vec<_> = swapped.lines().filter(kept).collect();
                self.stage.file("fleet.yaml", text.join("\n").replace(" r2,", ""));
            }
            Trouble::FleetDeleted => std::fs::remove_file(self.stage.path("fleet.yaml")).unwrap(),
            Trouble::Flood => self.flood.as_ref().unwrap().begin(),
            Trouble::Dead => self.stage.robots[ODD].kill(),
        }
        std::thread::sleep(Duration::from_millis(200));
    }

    /// What the operator reads, and its exit code.
    fn stop(&mut self, way: Way) -> Stopped {
        let at = epoch_nanos();
        match way {
            Way::CtrlC => self.signalled(at, Signal::INT),
            Way::Terminate => self.signalled(at, Signal::TERM),
            Way::HangUp => self.signalled(at, Signal::HUP),
            Way::Command => self.told(at),
            Way::AfterCrash => {
                kill_process(self.pid, Signal::KILL).unwrap();
                std::thread::sleep(Duration::from_millis(50));
                self.told(epoch_nanos())
            }
            Way::WhileFrozen => {
                kill_process(self.pid, Signal::STOP).unwrap();
                self.told(epoch_nanos())
            }
        }
    }

    fn signalled(&mut self, at: i64, signal: Signal) -> Stopped {
        kill_process(self.pid, signal).unwrap();
        if matches!(self.trouble, Trouble::Terminal | Trouble::Pipes) {
            // Nobody reads what it says, so it may wait for ever to say it.
            std::thread::sleep(Duration::from_millis(1_500));
            return Stopped { at, said: None, code: None };
        }
        let code = ended(&mut self.scheduler.0);
        let mut said = String::new();
        if let Some(mut out) = self.out.take() {
            out.read_to_string(&mut said).unwrap();
        }
        let readable = self.trouble != Trouble::StdoutFull;
        Stopped { at, said: readable.then_some(said), code }
    }

    fn told(&mut self, at: i64) -> Stopped {
        let full = self.trouble == Trouble::StdoutFull;
        let mut command = program(
            &self.stage,
            &["stop", "--patience", "2s"],
            match self.trouble {
                // The operator has another terminal.
                Trouble::Terminal | Trouble::Pipes => Trouble::Dead,
                trouble => trouble,
            },
        );
        if full {
            command.stdout(File::options().write(true).open("/dev/full").unwrap());
        } else {
            command.stdout(Stdio::piped());
        }
        command.stderr(File::create(self.stage.path("stop-told")).unwrap());
        let mut child = Process(command.spawn().unwrap());
        let code = ended(&mut child.0);
        let mut said = String::new();
        if let Some(out) = child.0.stdout.as_mut().filter(|_| code.is_some()) {
            out.read_to_string(&mut said).unwrap();
        }
        Stopped { at, said: (!full).then_some(said), code }
    }
}

impl Drop for Show {
    fn drop(&mut self) {
        let _gone = kill_process(self.pid, Signal::KILL);
    }
}

/// How a stop went.
struct Stopped {
    /// When it was given, in nanoseconds since the epoch.
    at: i64,
    said: Option<String>,
    code: Option<i32>,
}

fn program(stage: &Stage, args: &[&str], trouble: Trouble) -> Command {
    let plain = stage.command(args);
    let mut command = match trouble {
        Trouble::Terminal => {
            let mut command = Command::new(compiled("terminal", &[]));
            command.arg(stage.path("pid")).arg(plain.get_program()).args(plain.get_args());
            command.current_dir(plain.get_current_dir().unwrap());
            command
                .envs(plain.get_envs().filter_map(|(name, value)| Some((name, value?))))
                .stdin(Stdio::null());
            command
        }
        _ => plain,
    };
    if matches!(trouble, Trouble::DiskFull | Trouble::DiskStalled) {
        command.env("LD_PRELOAD", compiled("disk", &["-shared", "-fPIC"]));
        command.env("FULL_DISK", stage.path("disk-full")).env("STALL_DISK", stage.path("disk-stalled"));
    }
    command
}

fn port_of(fleet: &str, robot: usize) -> u16 {
    let line = fleet.lines().find(|line| line.starts_with(&format!("  r{robot}:"))).unwrap();
    let port = line.split("127.0.0.1:").nth(1).unwrap();
    port.trim_end_matches(|c: char| !c.is_ascii_digit()).parse().unwrap()
}

fn pid_in(path: &Path) -> Pid {
    let began = Instant::now();
    loop {
        let text = std::fs::read_to_string(path).unwrap_or_default();
        if let Some(pid) = text.trim().parse().ok().filter(|_| text.ends_with('\n')).and_then(Pid::from_raw) {
            return pid;
        }
        assert!(began.elapsed() < Duration::from_secs(10), "no terminal");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Until nothing more goes in.
fn fill(mut pipe: &PipeWriter) {
    rustix::io::ioctl_fionbio(pipe, true).unwrap();
    for size in [4_096, 1] {
        while pipe.write(&vec![b'.'; size]).is_ok() {}
    }
    rustix::io::ioctl_fionbio(pipe, false).unwrap();
}

/// Its exit code; `None` when it hangs.
fn ended(child: &mut Child) -> Option<i32> {
    let began = Instant::now();
    while began.elapsed() < ENDS_WITHIN {
        if let Some(status) = child.try_wait().unwrap() {
            return status.code();
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    None
}

/// How long a thread of this process was kept from running at most, while something was done.
fn held_up<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let (over, longest) = (AtomicBool::new(false), AtomicU64::new(0));
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !over.load(Ordering::Relaxed) {
                let began = Instant::now();
                std::thread::sleep(Duration::from_millis(5));
                let late = u64::try_from(began.elapsed().as_millis()).unwrap().saturating_sub(5);
                longest.fetch_max(late, Ordering::Relaxed);
            }
        });
        let done = work();
        over.store(true, Ordering::Relaxed);
        (done, Duration::from_millis(longest.load(Ordering::Relaxed)))
    })
}

/// One cell: what was wrong, if anything.
fn play(way: Way, trouble: Trouble) -> Result<Duration, String> {
    let mut show = Show::begin(trouble);
    show.strike();
    let uses_command = matches!(way, Way::Command | Way::AfterCrash | Way::WhileFrozen);
    let process = Instant::now();
    let version = show.stage.command(&["--version"]).output().unwrap();
    let process = process.elapsed();
    assert!(version.status.success());
    let (stopped, held_up) = held_up(|| show.stop(way));
    let mut bound = AT_REST + held_up * 2;
    if uses_command {
        bound += process * 2;
    }
    if way == Way::WhileFrozen {
        bound += GIVEN_UP;
    }
    let bound = bound.min(AT_REST_MAX);
    // Logs are written within 50 ms.
    std::thread::sleep(Duration::from_millis(300));
    let mut longest = Duration::ZERO;
    for (index, robot) in show.stage.robots.iter().enumerate() {
        if trouble == Trouble::Dead && index == ODD {
            continue;
        }
        let log = robot.log();
        let last = log.last().unwrap();
        // Where it slows down, this is where it begins to.
        let came_to_rest = log.iter().rev().take_while(|entry| entry.motion != "set").last().unwrap_or(last);
        let after = Duration::from_nanos(u64::try_from(came_to_rest.at - stopped.at).unwrap_or(0));
        longest = longest.max(after);
        if after > bound || last.motion == "set" {
            let told = text(&show.stage, "told") + &text(&show.stage, "stop-told");
            let said = stopped.said.unwrap_or_default();
            return Err(format!(
                "{} still moved {after:?} after the stop ({bound:?} allowed), last {} {}; exit code {:?}\n{told}{said}",
                robot.id, last.motion, last.value, stopped.code
            ));
        }
    }
    told(way, trouble, &stopped).map(|()| longest)
}

/// Whether what the operator reads is what happened.
fn told(way: Way, trouble: Trouble, stopped: &Stopped) -> Result<(), String> {
    let Some(said) = &stopped.said else { return Ok(()) };
    let dead = (trouble == Trouble::Dead).then_some(ODD);
    for robot in 0..6 {
        let of_robot = |line: &&str| line.trim_start().starts_with(&format!("r{robot}"));
        let confirmed = said.lines().filter(of_robot).any(|line| line.contains("default state confirmed"));
        let named = said.contains(&format!("r{robot}"));
        if confirmed == (dead == Some(robot)) || !named {
            let told = if confirmed { "confirmed" } else { "not confirmed" };
            return Err(format!("r{robot} is told as {told}; exit code {:?}\n{said}", stopped.code));
        }
    }
    let expected = match (dead, way) {
        (Some(_), _) => Some(4),
        (None, Way::CtrlC | Way::Terminate | Way::HangUp) => Some(3),
        (None, _) => Some(0),
    };
    match stopped.code == expected {
        true => Ok(()),
        false => Err(format!("exit code {:?}, expected {expected:?}\n{said}", stopped.code)),
    }
}

/// Plays the cells of one row, a few at a time, and shows what each took.
#[track_caller]
#[expect(clippy::print_stdout, reason = "how long each cell took is shown where it is asked for")]
fn check_row(way: Way) {
    let only = std::env::var("DOWNBEAT_TROUBLE").ok();
    let troubles =
        TROUBLES.iter().filter(|trouble| only.as_ref().is_none_or(|only| *only == format!("{trouble:?}")));
    let troubles: Vec<Trouble> = troubles.copied().collect();
    let mut wrong = Vec::new();
    for cells in troubles.chunks(AT_ONCE) {
        let results: Vec<_> = std::thread::scope(|scope| {
            let playing: Vec<_> = cells.iter().map(|trouble| scope.spawn(|| best(way, *trouble))).collect();
            playing.into_iter().map(|cell| cell.join().unwrap()).collect()
        });
        for (trouble, result) in cells.iter().zip(results) {
            match result {
                Ok(longest) => println!("{way:?} x {trouble:?}: at rest after {longest:?}"),
                Err(why) => wrong.push(format!("{way:?} x {trouble:?}: {why}")),
            }
        }
    }
    assert!(wrong.is_empty(), "{} of {} cells:\n{}", wrong.len(), troubles.len(), wrong.join("\n"));
}

fn best(way: Way, trouble: Trouble) -> Result<Duration, String> {
    let mut last = Err("not played".to_owned());
    for _ in 0..TRIES {
        last = play(way, trouble);
        if last.is_ok() {
            break;
        }
    }
    last
}

fn text(stage: &Stage, name: &str) -> String {
    std::fs::read_to_string(stage.path(name)).unwrap_or_default()
}

fn await_that(what: &str, mut holds: impl FnMut() -> bool) {
    let began = Instant::now();
    while !holds() {
        assert!(began.elapsed() < Duration::from_secs(20), "{what} never came");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_disk_that_stands_still_before_the_mission_has_begun_keeps_nobody_from_ending_it() {
    let mut stage = Stage::new();
    stage.file("arm.yaml", one_device(1, 600, 600)).file("disk-stalled", "");
    for _ in 0..6 {
        stage.robot("arm.yaml", Via::Direct);
    }
    stage.file(
        "play.yaml",
        scenario().lines().filter(|line| !line.contains("r4,")).collect::<Vec<_>>().join("\n"),
    );
    let mut command = program(&stage, &["run", "play.yaml"], Trouble::DiskStalled);
    let mut running = Process(command.stderr(Stdio::piped()).spawn().unwrap());
    await_that("the journal", || stage.path("state").is_dir());
    std::thread::sleep(Duration::from_millis(300));
    running.signal(Signal::TERM);
    let code = ended(&mut running.0);
    let mut said = String::new();
    running.0.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert_eq!(code, Some(3), "{said}");
    assert!(said.contains("nothing was sent"), "{said}");
}

#[test]
fn a_report_is_printed_while_the_disk_stands_still() {
    let mut show = Show::begin(Trouble::DiskStalled);
    show.strike();
    let stopped = show.stop(Way::Terminate);
    let said = stopped.said.unwrap();
    assert!(
        said.contains("stopped by the operator") && said.contains("r0: default state confirmed"),
        "{said}"
    );
    assert_eq!(stopped.code, Some(3));
}

#[test]
fn a_mission_in_the_background_outlives_its_terminal_and_is_stopped_by_command() {
    let mut stage = Stage::new();
    stage.file("arm.yaml", one_device(1, 600, 600)).file("wheel.yaml", WHEEL).file("play.yaml", scenario());
    for robot in 0..6 {
        stage.robot(if robot == WHEELED { "wheel.yaml" } else { "arm.yaml" }, Via::Direct);
    }
    let detached = stage.run(&["--format", "json", "run", "play.yaml", "--detach"]);
    assert_eq!(detached.code, Some(0), "{detached}");
    let told: serde_json::Value = serde_json::from_str(&detached.out).unwrap();
    let process = Pid::from_raw(told["process"].as_i64().unwrap().try_into().unwrap()).unwrap();
    let log = PathBuf::from(told["log"].as_str().unwrap());
    assert!(
        log.starts_with(stage.path("state")) && log.parent().unwrap().join("journal").exists(),
        "{log:?}"
    );
    stage.robots[0].await_sets(5, Duration::from_secs(30));
    assert_eq!(rustix::process::getsid(Some(process)).unwrap(), process, "it belongs to a terminal");
    kill_process(process, Signal::HUP).unwrap();
    std::thread::sleep(Duration::from_millis(200));
    let before = stage.robots[0].sets().len();
    stage.robots[0].await_sets(before + 5, Duration::from_secs(5));
    let stopped = stage.run(&["stop", told["mission"].as_str().unwrap()]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    await_that("its report", || std::fs::read_to_string(&log).unwrap().contains("\"outcome\": \"stopped\""));
}

#[test]
fn a_stop_leaves_where_it_is_what_a_failure_holds_there() {
    let mut stage = Stage::new();
    let arm = one_device(1, 600, 600).replace("    name: d\n", "    name: d\n    default_value: 0\n");
    stage.file("arm.yaml", arm);
    stage.robot("arm.yaml", Via::Direct);
    stage.robot("arm.yaml", Via::Direct);
    let keys = (0..100)
        .map(|step| format!("{{at: {}ms, to: {}}}", step * 50, step + 1))
        .collect::<Vec<_>>()
        .join(", ");
    stage.file("play.yaml", format!("scenario: play\nstart_tolerance: 1s\non_failure: hold\nstop_condition: {{running: none}}\ncues:\n  - {{at: 0s, robots: all, tracks: {{d: [{keys}]}}}}\n"));
    let mut running = stage.start(&["run", "play.yaml", "--patience", "2s"]);
    stage.robots[1].await_sets(5, Duration::from_secs(30));
    stage.robots[1].kill();
    assert!(running.line("stopping all robots").is_some());
    std::thread::sleep(Duration::from_millis(100));
    running.process.signal(Signal::INT);
    let ended = running.ended();
    assert!(ended.out.contains("r0: held where it was"), "{ended}");
    let log = stage.robots[0].log();
    let held = log.iter().rfind(|entry| entry.motion == "set").unwrap().value;
    let moved = log.iter().find(|entry| entry.motion == "default" && (entry.value - held).abs() > 0.5);
    assert!(moved.is_none(), "{moved:?}, it stood at {held}\n{ended}");
}

#[test]
fn what_a_killed_scheduler_has_moved_is_stopped_while_the_one_that_takes_over_stands_still() {
    let show = Show::begin(Trouble::FleetChanged);
    kill_process(show.pid, Signal::KILL).unwrap();
    std::thread::sleep(Duration::from_millis(100));
    let (_kept, full) = pipe().unwrap();
    fill(&full);
    let mut resume = show.stage.command(&["resume"]);
    resume.stdout(full.try_clone().unwrap()).stderr(full);
    let resume = Process(resume.spawn().unwrap());
    await_that("its socket", || {
        let folders = std::fs::read_dir(show.stage.path("state")).unwrap();
        let log = |folder: std::fs::DirEntry| {
            std::fs::metadata(folder.path().join("control")).ok()?.modified().ok()
        };
        let latest = folders.flatten().filter_map(log).max().unwrap();
        latest > std::fs::metadata(show.stage.path("told")).unwrap().modified().unwrap()
    });
    std::thread::sleep(Duration::from_millis(500));
    let at = epoch_nanos();
    let ((), held_up) = held_up(|| {
        resume.signal(Signal::TERM);
        std::thread::sleep(Duration::from_secs(2));
    });
    let bound = i64::try_from((Duration::from_secs(1) + held_up * 2).min(AT_REST_MAX).as_nanos()).unwrap();
    for robot in &show.stage.robots {
        let log = robot.log();
        let moved = log.iter().rev().find(|entry| entry.motion == "set").unwrap().at;
        assert!(moved < at + bound, "{} still moved {} ms later", robot.id, (moved - at) / 1_000_000);
        assert_ne!(log.last().unwrap().motion, "set", "{}", robot.id);
    }
}

#[test]
fn what_keeps_a_mission_from_running_in_the_background_is_told_at_once() {
    let mut stage = Stage::new();
    stage.file("arm.yaml", one_device(1, 600, 600)).file(
        "play.yaml",
        "scenario: play\nstart_tolerance: 1s\ncues: [{at: 0s, robots: r0, tracks: {d: [{at: 0s, to: 1}]}}]\n",
    );
    stage.robot("arm.yaml", Via::Direct);
    stage.file("state", "no folder");
    let detached = stage.run(&["run", "play.yaml", "--detach"]);
    assert_eq!(detached.code, Some(1), "{detached}");
    assert!(detached.told.contains("cannot start a mission in the background"), "{detached}");
}

#[test]
fn a_program_that_was_told_to_ignore_the_end_of_its_terminal_goes_on() {
    let mut show = Show::begin_by(Trouble::Dead, &["nohup"]);
    kill_process(show.pid, Signal::HUP).unwrap();
    let before = show.stage.robots[0].sets().len();
    show.stage.robots[0].await_sets(before + 5, Duration::from_secs(5));
    let stopped = show.stop(Way::Terminate);
    assert_eq!(stopped.code, Some(3), "{}", text(&show.stage, "told"));
}

#[test]
fn ctrl_c_stops_every_robot_whatever_else_stands_still() {
    check_row(Way::CtrlC);
}

#[test]
fn sigterm_stops_every_robot_whatever_else_stands_still() {
    check_row(Way::Terminate);
}

#[test]
fn a_terminal_that_is_closed_stops_every_robot_whatever_else_stands_still() {
    check_row(Way::HangUp);
}

#[test]
fn the_command_stop_stops_every_robot_whatever_else_stands_still() {
    check_row(Way::Command);
}

#[test]
fn the_command_stop_stops_every_robot_of_a_scheduler_that_was_killed() {
    check_row(Way::AfterCrash);
}

#[test]
fn the_command_stop_stops_every_robot_of_a_scheduler_that_is_frozen() {
    check_row(Way::WhileFrozen);
}
