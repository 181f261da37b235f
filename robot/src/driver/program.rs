//! An external program as a driver: it is told one line a value on its standard input and answers each with one line.
//!
//! | line | answer |
//! |---|---|
//! | `hello` | `ok`, or `ok ramps` where it moves linearly by itself |
//! | `set DEVICE CONTROL_TYPE VALUE...` | `ok` |
//! | `ramp DEVICE CONTROL_TYPE VALUE MILLISECONDS` | `ok` |
//! | `read SENSOR` | the reading, a number |
//! | `ping` | `ok` |
//!
//! Anything may be answered with `error REASON`. What it writes to its standard error goes to the edge's.

use std::fmt::Write as _;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

use urrcp::{DeviceId, InitializationBlock, Setpoint};

use super::{Driver, DriverError, Lifeline, Ramp};

/// How long the program may take to answer its first line: interpreters start slowly.
const START_WAIT: Duration = Duration::from_secs(10);
/// How long it may take to answer any other.
const ANSWER_WAIT: Duration = Duration::from_secs(1);
/// Longest answer, in bytes.
const ANSWER_BYTES_MAX: u64 = 4_096;
/// How long it may take to end once its input has ended.
const END_WAIT: Duration = Duration::from_secs(1);

/// A program that drives a robot's devices.
pub struct Program {
    command: String,
    running: Option<Running>,
    takes_ramps: bool,
}

impl Program {
    /// For the devices of this robot. Starts nothing yet.
    ///
    /// # Errors
    /// [`DriverError::Refused`] for a device whose id has a space in it, which no line could carry.
    pub fn new(command: &str, block: &InitializationBlock) -> Result<Self, DriverError> {
        let spaced = |device: &&urrcp::Device| {
            device.id.as_str().chars().any(|char| char.is_whitespace() || char.is_control())
        };
        if let Some(device) = block.devices.iter().find(spaced) {
            let message =
                format!("device `{}` has a space in its id, which a program's lines cannot carry", device.id);
            return Err(DriverError::Refused(message));
        }
        Ok(Self { command: command.to_owned(), running: None, takes_ramps: false })
    }

    /// Sends a line and returns the answer. The program is ended when it gives none.
    fn ask(&mut self, line: &str, wait: Duration) -> Result<String, DriverError> {
        let away = || DriverError::Away("the program does not run".to_owned());
        let answer = self.running.as_mut().ok_or_else(away)?.ask(line, wait);
        let answer = answer.map_err(|reason| {
            self.running = None;
            DriverError::Away(format!("the program `{}` {reason}", self.command))
        })?;
        match answer.strip_prefix("error") {
            Some(reason) => Err(DriverError::Refused(format!("the program says: {}", reason.trim()))),
            None => Ok(answer),
        }
    }

    fn ask_ok(&mut self, line: &str) -> Result<(), DriverError> {
        match self.ask(line, ANSWER_WAIT)?.as_str() {
            "ok" => Ok(()),
            answer => Err(self.misunderstood(line, answer)),
        }
    }

    /// The program is out of step, so that no further answer could be trusted either.
    fn misunderstood(&mut self, line: &str, answer: &str) -> DriverError {
        self.running = None;
        let command = &self.command;
        DriverError::Away(format!("the program `{command}` answers `{line}` with `{answer}`"))
    }
}

impl Driver for Program {
    fn connect(&mut self) -> Result<(), DriverError> {
        self.running = None;
        let started = Running::start(&self.command);
        self.running = Some(started.map_err(|error| {
            DriverError::Away(format!("the program `{}` does not start: {error}", self.command))
        })?);
        self.takes_ramps = match self.ask("hello", START_WAIT)?.as_str() {
            "ok" => false,
            "ok ramps" => true,
            answer => return Err(self.misunderstood("hello", answer)),
        };
        Ok(())
    }

    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError> {
        let mut line = format!("set {device} {} {}", setpoint.control_type, setpoint.value);
        for value in &setpoint.more {
            let _never_fails = write!(line, " {value}");
        }
        self.ask_ok(&line)
    }

    fn read(&mut self, sensor: &DeviceId) -> Result<f64, DriverError> {
        let line = format!("read {sensor}");
        let answer = self.ask(&line, ANSWER_WAIT)?;
        answer.parse().map_err(|_| self.misunderstood(&line, &answer))
    }

    fn ping(&mut self) -> Result<(), DriverError> {
        self.ask_ok("ping")
    }

    fn ramp(&mut self, device: &DeviceId, ramp: Ramp) -> Result<(), DriverError> {
        let milliseconds = ramp.duration.as_secs_f64() * 1_000.0;
        self.ask_ok(&format!("ramp {device} {} {} {milliseconds}", ramp.control_type, ramp.to))
    }

    fn lifeline(&self) -> Option<Lifeline> {
        let ended = format!("the program `{}` has ended", self.command);
        Lifeline::of(&self.running.as_ref()?.output, ended)
    }

    fn takes_ramps(&self) -> bool {
        self.takes_ramps
    }
}

/// The program at work. Dropping it ends the program.
struct Running {
    child: Child,
    input: Option<ChildStdin>,
    /// A copy of its output, to be watched alone.
    output: OwnedFd,
    answers: Receiver<String>,
}

impl Running {
    fn start(command: &str) -> std::io::Result<Self> {
        let mut shell = Command::new("sh");
        shell.arg("-c").arg(command).stdin(Stdio::piped()).stdout(Stdio::piped());
        // A group of its own: Ctrl-C is for the edge, which then has its devices brought to rest.
        let mut child = shell.process_group(0).spawn()?;
        let no_pipe = || std::io::Error::other("no pipe");
        let output = child.stdout.take().ok_or_else(no_pipe)?;
        let input = Some(child.stdin.take().ok_or_else(no_pipe)?);
        let watched = output.as_fd().try_clone_to_owned()?;
        // One answer belongs to one line; a program that says more is soon out of step.
        let (sender, answers) = sync_channel(1);
        // Ends with the program's output, or when the receiver is gone.
        std::thread::Builder::new().name("program".into()).spawn(move || {
            let mut output = BufReader::new(output);
            loop {
                let mut line = Vec::new();
                match output.by_ref().take(ANSWER_BYTES_MAX).read_until(b'\n', &mut line) {
                    Ok(0) | Err(_) => return,
                    Ok(_) => {}
                }
                let line = String::from_utf8_lossy(&line).trim().to_owned();
                if sender.send(line).is_err() {
                    return;
                }
            }
        })?;
        Ok(Self { child, input, output: watched, answers })
    }

    /// One line at a time is on the way, so a pipe is never full and this never hangs.
    fn ask(&mut self, line: &str, wait: Duration) -> Result<String, String> {
        let Some(input) = &mut self.input else { return Err("has ended".to_owned()) };
        // Together in one write: a program may read in pieces.
        let written = input.write_all(format!("{line}\n").as_bytes()).and_then(|()| input.flush());
        written.map_err(|error| format!("takes no line: {error}"))?;
        self.answers.recv_timeout(wait).map_err(|error| match error {
            RecvTimeoutError::Timeout => format!("did not answer `{line}` within {} s", wait.as_secs()),
            RecvTimeoutError::Disconnected => "has ended".to_owned(),
        })
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.input = None;
        // Its output ends with it; what it still says is of no more use, and too much of it is no end.
        let last = (0..16).find_map(|_| self.answers.recv_timeout(END_WAIT).err());
        let ended = last == Some(RecvTimeoutError::Disconnected);
        if !ended
            && let Some(group) = i32::try_from(self.child.id()).ok().and_then(rustix::process::Pid::from_raw)
        {
            let _already_gone = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
        }
        let _already_gone = self.child.kill();
        let _reaped = self.child.wait();
    }
}
