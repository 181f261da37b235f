//! A mission of six robots as processes, and the trouble that it gets into.

use std::ffi::{OsStr, OsString};
use std::fs::File;
use std::io::{PipeReader, PipeWriter, Write, pipe};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

use super::flood::Flood;
use stage::compiled::{SHARED, compiled};
use stage::quiet::await_that;
use stage::{Process, Stage, Via, one_device, with_devices};

/// What goes wrong during a mission: something stalls, is full, has changed or is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trouble {
    Nothing,
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

/// The troubles with which each way to stop a mission is tested.
pub const TROUBLES: [Trouble; 9] = [
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

/// Returns the description of a robot with a wheel that slows down by 10 per second squared: from 5 to 0 in 0.5 s.
pub fn wheel() -> String {
    with_devices(
        "  - id: w
    name: w
    default_value: 0
    available_control_types:
      speed: {min_value: -20, max_value: 20, granularity: 0.1}
      acceleration: {min_value: -10, max_value: 10, granularity: 0.1}
      script: {min_value: -20, max_value: 20, granularity: 0.1, max_number_of_steps: 600, control_types: [speed]}
",
    )
}

const RECORDING: &str = "play.mcap";
/// Number of values of each script; the last position is the same number.
pub const STEPS: u32 = 200;
/// Index of the robot with the wheel.
pub const WHEELED: usize = 4;
/// Index of the robot that floods the scheduler or is dead.
pub const ODD: usize = 5;

/// Returns a scenario with one value every 50 ms for 10 s. It has no running lease, so that only a stop ends it. The robots of many shows
/// share the cores, and each robot keeps a core busy for about 1 ms before each of its steps. The pending lease and the lead are longer
/// than the delays of a busy machine.
pub fn scenario() -> String {
    let frames = |value: &dyn Fn(u32) -> f64| {
        let frame = |step: u32| format!("{{at: {}ms, to: {}}}", step * 50, value(step));
        (0..STEPS).map(frame).collect::<Vec<_>>().join(", ")
    };
    let positions = frames(&|step| f64::from(step + 1));
    let speeds = frames(&|step| 5.0 - f64::from(step % 2) / 10.0);
    format!(
        "scenario: play
lead: 4s
start_tolerance: 1s
on_failure: without
stop_condition: {{pending: 2s, running: none}}
cues:
  - {{at: 0s, robots: [r0, r1, r2, r3, r5], tracks: {{d: [{positions}]}}}}
  - {{at: 0s, robots: r4, stop_condition: {{pending: 2s, running: 9s}}, tracks: {{w: {{control: speed, keyframes: [{speeds}]}}}}}}
"
    )
}

/// A mission of six robots that plays, and the trouble that it will get into.
pub struct Show {
    pub stage: Stage,
    pub trouble: Trouble,
    /// The process that was started. It ends with the exit code of the scheduler.
    pub started: Process,
    /// The scheduler's process, which a terminal program may have started.
    pub pid: Pid,
    flood: Option<Flood>,
    /// Pipe with the scheduler's output; `None` if the output is not read.
    pub out: Option<PipeReader>,
    /// Writing end of the pipe for the scheduler's output, kept so that [`Self::strike`] can fill the pipe.
    full: Option<PipeWriter>,
}

impl Show {
    pub fn begin(trouble: Trouble) -> Self {
        Self::begin_by(trouble, &[])
    }

    /// Begins a show. Another program (`starter`) starts the scheduler by replacing itself. If a busy machine prevents the start of the
    /// mission, it is begun again: nothing has been stopped yet.
    pub fn begin_by(trouble: Trouble, starter: &[&str]) -> Self {
        let mut told = Vec::new();
        for _ in 0..3 {
            match Self::try_to_begin(trouble, starter) {
                Ok(show) => return show,
                Err(why) => {
                    assert!(stage::held_up::reason(&why).is_some(), "no mission begins:\n{why}");
                    told.push(why);
                }
            }
        }
        panic!("no mission begins:\n{}", told.join("\n"))
    }

    /// Begins a show once. Returns the scheduler's output as the error if the robots do not start.
    fn try_to_begin(trouble: Trouble, starter: &[&str]) -> Result<Self, String> {
        let mut stage = Stage::new();
        stage.file("arm.yaml", one_device(1, 600, 600)).file("wheel.yaml", wheel());
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
        let mut args = vec!["run", "play.yaml", "--patience", "4s"];
        if matches!(trouble, Trouble::Terminal | Trouble::Pipes) {
            // Its output is not read, and a journal contains no failures.
            args.extend(["--record", RECORDING]);
        }
        let mut command = program(&stage, &args, trouble);
        if !starter.is_empty() {
            let mut args: Vec<_> = command.get_args().map(OsStr::to_owned).collect();
            let program = args.iter().position(|arg| arg == stage::session::program()).unwrap();
            args.splice(program..program, starter.iter().map(OsString::from));
            let mut by = Command::new(command.get_program());
            by.args(args);
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
        let started = Process(command.spawn().unwrap());
        drop(command);
        let pid = match trouble {
            Trouble::Terminal => pid_in(&stage.path("pid")),
            _ => Pid::from_child(&started.0),
        };
        let mut show = Self { stage, trouble, started, pid, flood, out, full };
        let began = Instant::now();
        while !show.stage.robots.iter().all(|robot| robot.sets().len() >= 4) {
            let over = show.started.0.try_wait().unwrap().is_some();
            if over || began.elapsed() > Duration::from_secs(30) {
                return Err(super::text(&show.stage, "told") + &reported(&show.stage));
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        Ok(show)
    }

    /// Causes the trouble, and returns once it has begun.
    pub fn strike(&mut self) {
        let fleet = || std::fs::read_to_string(self.stage.path("fleet.yaml")).unwrap();
        match self.trouble {
            Trouble::Terminal => {
                self.started.signal(Signal::USR1);
                await_that("the terminal's stop", || self.stage.path("pid.stopped").exists());
            }
            Trouble::Pipes => fill(self.full.as_ref().unwrap()),
            Trouble::Nothing | Trouble::StdoutFull => {}
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
    }

    /// Kills the scheduler, which ends as in a power cut.
    pub fn kill(&mut self) {
        kill_process(self.pid, Signal::KILL).unwrap();
        self.started.0.wait().unwrap();
    }
}

impl Drop for Show {
    fn drop(&mut self) {
        let _gone = kill_process(self.pid, Signal::KILL);
    }
}

/// Returns a command that runs Downbeat in a stage, with what this trouble requires: a terminal program, or a library that makes the disk
/// fail.
pub fn program(stage: &Stage, args: &[&str], trouble: Trouble) -> Command {
    let plain = stage.command(args);
    let mut command = match trouble {
        Trouble::Terminal => {
            let mut command = Command::new(compiled("processes/stops/terminal.c", &[]));
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
        command.env("LD_PRELOAD", compiled("processes/stops/disk.c", SHARED));
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
        assert!(began.elapsed() < Duration::from_secs(60), "no terminal");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Writes to a pipe until it accepts no further bytes.
pub fn fill(mut pipe: &PipeWriter) {
    rustix::io::ioctl_fionbio(pipe, true).unwrap();
    for size in [4_096, 1] {
        while pipe.write(&vec![b'.'; size]).is_ok() {}
    }
    rustix::io::ioctl_fionbio(pipe, false).unwrap();
}

/// Returns the reports of all missions of the stage, from their journals or their recording.
fn reported(stage: &Stage) -> String {
    if stage.path(RECORDING).exists() {
        return stage.run(&["report", RECORDING, "--partial"]).out;
    }
    let Ok(missions) = std::fs::read_dir(stage.path("state")) else { return String::new() };
    let journals = missions.map(|mission| mission.unwrap().path().join("journal"));
    let journals = journals.filter(|journal| journal.exists());
    journals.map(|journal| stage.run(&["report", journal.to_str().unwrap()]).out).collect()
}
