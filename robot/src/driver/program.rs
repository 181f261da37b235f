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
//! A program that answers `hello` with `ok 2` speaks version 2. It is then told `init JSON` with the robot's description, answers
//! `ok JSON` with what it can do, and may write `reading SENSOR VALUE` and `fault REASON` at any time. If it takes frames, it is told
//! `frame JSON` in place of `set`.
//!
//! Anything may be answered with `error REASON`. What it writes to its standard error goes to the edge's.

use std::collections::{BTreeMap, HashSet};
use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Duration;

use serde::Deserialize;
use serde_json::json;
use urrcp::{DeviceId, InitializationBlock, LATENCY_MS_MAX, Setpoint};

use super::running::{Ear, Running};
use super::{Driver, DriverError, Lifeline, Pushes, Ramp};

/// How long a program may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timeouts {
    /// To answer its first line, and to start its hardware in version 2: interpreters start slowly.
    pub start: Duration,
    /// To answer any other line.
    pub answer: Duration,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self { start: Duration::from_secs(10), answer: Duration::from_secs(1) }
    }
}

/// What a program of version 2 can do.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Declared {
    /// It moves linearly by itself.
    ramps: bool,
    /// It takes all values of one instant at a time.
    frames: bool,
    /// From a value to visible motion, in milliseconds, by device.
    latency_ms: BTreeMap<DeviceId, f64>,
}

/// A program that drives a robot's devices.
pub struct Program {
    command: String,
    block: InitializationBlock,
    timeouts: Timeouts,
    running: Option<Running>,
    declared: Declared,
    ear: Option<Ear>,
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
        Ok(Self {
            command: command.to_owned(),
            block: block.clone(),
            timeouts: Timeouts::default(),
            running: None,
            declared: Declared::default(),
            ear: None,
        })
    }

    /// The same with other times to answer.
    #[must_use]
    pub const fn within(mut self, timeouts: Timeouts) -> Self {
        self.timeouts = timeouts;
        self
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
        match self.ask(line, self.timeouts.answer)?.as_str() {
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

    /// Tells a program of version 2 what it drives, and learns what it can do.
    fn introduce(&mut self) -> Result<Declared, DriverError> {
        if let Some(running) = &self.running {
            running.may_tell();
        }
        let init = json!({ "version": 2, "block": self.block });
        let answer = self.ask(&format!("init {init}"), self.timeouts.start)?;
        let declared = match answer.strip_prefix("ok").map(str::trim) {
            Some("") => Ok(Declared::default()),
            Some(json) => serde_json::from_str(json).map_err(|error| error.to_string()),
            None => Err("expected `ok` and a JSON object".to_owned()),
        };
        let declared = declared.and_then(|declared| declared.checked(&self.block));
        declared.map_err(|error| {
            self.running = None;
            let command = &self.command;
            DriverError::Away(format!("the program `{command}` answers `init` with `{answer}`: {error}"))
        })
    }
}

impl Declared {
    fn checked(self, block: &InitializationBlock) -> Result<Self, String> {
        for (device, ms) in &self.latency_ms {
            if block.device(device.as_str()).is_none() {
                return Err(format!("a latency of `{device}`, which this robot does not have"));
            }
            if !(*ms >= 0.0 && *ms <= LATENCY_MS_MAX) {
                return Err(format!("a latency of {ms} ms, expected 0 to {LATENCY_MS_MAX} ms"));
            }
        }
        Ok(self)
    }
}

impl Driver for Program {
    fn connect(&mut self) -> Result<(), DriverError> {
        self.running = None;
        let started = Running::start(&self.command, self.ear.clone());
        self.running = Some(started.map_err(|error| {
            DriverError::Away(format!("the program `{}` does not start: {error}", self.command))
        })?);
        self.declared = match self.ask("hello", self.timeouts.start)?.as_str() {
            "ok" => Declared::default(),
            "ok ramps" => Declared { ramps: true, ..Declared::default() },
            "ok 2" => self.introduce()?,
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
        let answer = self.ask(&line, self.timeouts.answer)?;
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

    fn set_frame(&mut self, values: &[(DeviceId, Setpoint)]) -> Result<(), DriverError> {
        let value = |(device, setpoint): &(DeviceId, Setpoint)| {
            let values: Vec<f64> =
                std::iter::once(setpoint.value).chain(setpoint.more.iter().copied()).collect();
            json!({ "device": device, "control_type": setpoint.control_type, "values": values })
        };
        let frame: Vec<_> = values.iter().map(value).collect();
        self.ask_ok(&format!("frame {}", serde_json::Value::from(frame)))
    }

    fn takes_frames(&self) -> bool {
        self.declared.frames
    }

    fn latency(&self) -> BTreeMap<DeviceId, Duration> {
        let time = |(device, ms): (&DeviceId, &f64)| (device.clone(), Duration::from_secs_f64(ms / 1_000.0));
        self.declared.latency_ms.iter().map(time).collect()
    }

    fn take_pushes(&mut self, pushes: Pushes) {
        let sensors =
            self.block.devices.iter().filter(|device| device.available_control_types.sensor().is_some());
        let sensors = Arc::new(sensors.map(|device| device.id.clone()).collect::<HashSet<_>>());
        self.ear = Some(Ear { pushes, sensors });
    }

    fn set_is_acknowledged(&self) -> bool {
        true
    }

    fn takes_ramps(&self) -> bool {
        self.declared.ramps
    }
}
