//! An external program as a driver: it receives one line per value on its standard input and answers each with one line.
//!
//! | line | answer |
//! |---|---|
//! | `hello` | `ok`, or `ok ramps` if the hardware moves linearly by itself |
//! | `set DEVICE CONTROL_TYPE VALUE...` | `ok` |
//! | `ramp DEVICE CONTROL_TYPE VALUE MILLISECONDS` | `ok` |
//! | `read SENSOR` | the reading, a number |
//! | `ping` | `ok`, or `ok MILLISECONDS` since the hardware last showed a sign of life |
//!
//! A program that answers `hello` with `ok 2` speaks version 2. It then receives `init JSON` with the robot's description, and answers
//! `ok JSON` with its capabilities. It may write `reading SENSOR VALUE` and `fault REASON` at any time. If it takes frames (several
//! values at once), it receives `frame JSON` instead of `set`.
//!
//! A program that times scripts by itself receives `plan JSON`, `more JSON` and `cancel JSON`. It reports `started PLAN NS`, `step PLAN
//! INDEX NS`, `done PLAN NS`, `failed PLAN NS REASON` and `cancelled PLAN NS`. NS is a time in nanoseconds; the word `assumed` after it
//! marks events that the hardware has not shown.
//!
//! Any line may be answered with `error REASON`. The program's standard error goes to the edge's standard error.

use std::collections::{BTreeMap, HashSet};
use std::fmt::Write as _;
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::time::Duration;

use serde::Deserialize;
use serde_json::json;
use urrcp::{ControlType, DeviceId, InitializationBlock, LATENCY_MS_MAX, Setpoint, Span};

use super::running::{NoAnswer, Running, UnsolicitedInput};
use super::{
    Driver, DriverError, Lifeline, PINGS_BOUNDS, Pushes, READINGS_BOUNDS, Ramp, Rates, SAMPLES_BOUNDS,
};
use crate::clock::SystemClock;
use crate::plans::{Lookahead, PlanCancel, PlanPart, PlanStep};

/// Time limits for the answers of a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timeouts {
    /// Time limit for the answer to the first line and, in version 2, for starting the hardware. Interpreters start slowly.
    pub start: Duration,
    /// Time limit for the answer to any other line.
    pub answer: Duration,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self { start: Duration::from_secs(10), answer: Duration::from_secs(1) }
    }
}

/// Capabilities that a program of version 2 declares.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Declared {
    /// Whether the hardware moves linearly by itself.
    ramps: bool,
    /// Whether the program receives all values that are due at the same instant in one line.
    frames: bool,
    /// Latency from a value to the first visible motion, in milliseconds, by device.
    latency_ms: BTreeMap<DeviceId, f64>,
    /// Devices whose scripts the program times by itself and wants to receive whole. `None`: no device.
    lookahead: Option<Of<Whole>>,
    /// Devices whose scripts the program times by itself, with how many milliseconds ahead it wants to receive the steps. `None`: no
    /// device.
    lookahead_ms: Option<Of<f64>>,
    /// Preferred number of samples (intermediate values) of a movement per second.
    samples_per_second: Option<Of<f64>>,
    pings_per_second: Option<f64>,
    /// Maximum time without a sign of life from the hardware, in milliseconds. Set by a program that answers `ping` with the age of the
    /// last sign of life.
    hardware_silence_ms: Option<f64>,
    /// Maximum number of readings of a sensor per second.
    readings_per_second: Option<Of<f64>>,
}

/// One value for all devices, or one value per device id.
#[derive(Debug, Deserialize)]
#[serde(
    untagged,
    expecting = "expected one value for all devices, or an object with a value for each device"
)]
enum Of<T> {
    All(T),
    Each(BTreeMap<DeviceId, T>),
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Whole {
    Script,
}

impl<T: Copy> Of<T> {
    /// Returns the values by device. A value for all devices is assigned to each device in `all`.
    fn each<'a>(&self, all: impl Iterator<Item = &'a DeviceId>) -> BTreeMap<DeviceId, T> {
        match self {
            Self::All(of_all) => all.map(|device| (device.clone(), *of_all)).collect(),
            Self::Each(each) => each.clone(),
        }
    }
}

/// Minimum and maximum of the declared `lookahead_ms`: how many milliseconds ahead a program may request the steps of scripts.
const LOOKAHEAD_MS: RangeInclusive<f64> = 20.0..=60_000.0;
/// Minimum and maximum of the declared `hardware_silence_ms`, in milliseconds.
const HARDWARE_SILENCE_MS: RangeInclusive<f64> = 50.0..=60_000.0;
/// If the edge is silent for longer than the first time, a program starts no script; after the second, it ends a running script. Both are
/// in milliseconds.
const EDGE_SILENCE_MS: (u32, u32) = (400, 3_000);

/// A program that drives a robot's devices.
pub struct Program {
    command: String,
    block: InitializationBlock,
    timeouts: Timeouts,
    running: Option<Running>,
    declared: Declared,
    ear: Option<UnsolicitedInput>,
    /// Time between the hardware's last sign of life and the last ping, if the program reports it.
    last_sign: Option<Duration>,
    /// If the edge is silent for longer than the first time, the program starts no script; after the second, it ends a running script.
    /// Both are in milliseconds.
    edge_silence_ms: (u32, u32),
}

impl Program {
    /// Creates a driver for the devices of this robot, without starting the program.
    ///
    /// # Errors
    /// [`DriverError::Refused`] for a device whose id contains a space, which the line format does not permit.
    pub fn new(command: &str, block: &InitializationBlock) -> Result<Self, DriverError> {
        let spaced = |device: &&urrcp::Device| {
            device.id.as_str().chars().any(|char| char.is_whitespace() || char.is_control())
        };
        if let Some(device) = block.devices.iter().find(spaced) {
            let message = format!(
                "the id of device `{}` contains a space or a control character, which driver programs do not support",
                device.id
            );
            return Err(DriverError::Refused(message));
        }
        Ok(Self {
            command: command.to_owned(),
            block: block.clone(),
            timeouts: Timeouts::default(),
            running: None,
            declared: Declared::default(),
            ear: None,
            last_sign: None,
            edge_silence_ms: EDGE_SILENCE_MS,
        })
    }

    /// Sets the time limits of the program's answers.
    #[must_use]
    pub const fn within(mut self, timeouts: Timeouts) -> Self {
        self.timeouts = timeouts;
        self
    }

    /// Sets both limits of the edge's silence to an hour, so that a program keeps its scripts while the edge is silent.
    #[cfg(test)]
    pub(super) const fn borne_in_silence(mut self) -> Self {
        self.edge_silence_ms = (3_600_000, 3_600_000);
        self
    }

    /// Sends a line to the program and returns its answer. Ends the program if it does not answer within `wait`.
    fn ask(&mut self, line: &str, wait: Duration) -> Result<String, DriverError> {
        let away = || DriverError::Away("the program is not running".to_owned());
        let answer = self.running.as_mut().ok_or_else(away)?.ask(line, wait);
        self.answered(answer)
    }

    /// Like `ask`, for the first lines to a program. Since nothing has moved yet, an edge that shuts down does not wait for the answer.
    fn ask_at_start(&mut self, line: &str) -> Result<String, DriverError> {
        let away = || DriverError::Away("the program is not running".to_owned());
        let running = self.running.as_mut().ok_or_else(away)?;
        let is_over = || self.ear.as_ref().is_some_and(|ear| ear.pushes.is_over());
        let answer = running.ask_unless(line, self.timeouts.start, &is_over);
        self.answered(answer)
    }

    fn answered(&mut self, answer: Result<String, NoAnswer>) -> Result<String, DriverError> {
        let answer = answer.map_err(|reason| {
            self.running = None;
            DriverError::Away(format!("the program `{}` {reason}", self.command))
        })?;
        match answer.strip_prefix("error") {
            Some(reason) => Err(DriverError::Refused(format!("the program reported: {}", reason.trim()))),
            None => Ok(answer),
        }
    }

    fn ask_ok(&mut self, line: &str) -> Result<(), DriverError> {
        match self.ask(line, self.timeouts.answer)?.as_str() {
            "ok" => Ok(()),
            answer => Err(self.misunderstood(line, answer)),
        }
    }

    /// Ends a program whose answer does not match the line that it received, because its further answers cannot be trusted.
    fn misunderstood(&mut self, line: &str, answer: &str) -> DriverError {
        self.running = None;
        let command = &self.command;
        DriverError::Away(format!(
            "the program `{command}` sent an unexpected answer to `{line}`: `{answer}`"
        ))
    }

    /// Sends the robot's description to a program of version 2, and returns its capabilities.
    fn introduce(&mut self) -> Result<Declared, DriverError> {
        if let Some(running) = &self.running {
            running.may_tell();
        }
        let init = json!({ "version": 2, "block": self.block });
        let answer = self.ask_at_start(&format!("init {init}"))?;
        let declared = match answer.strip_prefix("ok").map(str::trim) {
            Some("") => Ok(Declared::default()),
            Some(json) => serde_json::from_str(json).map_err(InvalidDeclaration::Json),
            None => Err(InvalidDeclaration::NotOk),
        };
        let declared = declared.and_then(|declared| declared.checked(&self.block));
        declared.map_err(|error| {
            self.running = None;
            let command = &self.command;
            DriverError::Away(format!(
                "the program `{command}` sent an invalid answer to `init`: `{answer}`: {error}"
            ))
        })
    }
}

/// The fault in a program's answer to `init`.
#[derive(Debug, thiserror::Error)]
enum InvalidDeclaration {
    #[error("expected `ok` and a JSON object")]
    NotOk,
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    #[error("{key} names `{device}`, which this robot does not have")]
    NoDevice { key: &'static str, device: DeviceId },
    #[error("lookahead names `{0}`, which is not a moving device of this robot")]
    NotMoving(DeviceId),
    #[error("{what} is {number}, expected {least} to {most}")]
    OutOfRange { what: String, number: f64, least: f64, most: f64 },
    #[error("`{0}` has both lookahead and lookahead_ms, expected only one of them")]
    TwoLookaheads(DeviceId),
    /// Contains the declared latency in milliseconds.
    #[error("a latency of {0} ms, expected 0 to {LATENCY_MS_MAX} ms")]
    Latency(f64),
}

impl Declared {
    /// Returns how far ahead the program receives each device's scripts.
    fn lookahead(&self, block: &InitializationBlock) -> BTreeMap<DeviceId, Lookahead> {
        let whole = self.lookahead.iter().flat_map(|of| of.each(driven(block)));
        let whole = whole.map(|(device, Whole::Script)| (device, Lookahead::Script));
        let ahead = self.lookahead_ms.iter().flat_map(|of| of.each(driven(block)));
        let ahead = ahead.map(|(device, ms)| (device, Lookahead::Horizon(Span::from_millis_f64(ms))));
        whole.chain(ahead).collect()
    }

    fn rates(&self, block: &InitializationBlock) -> Rates {
        let all = || block.devices.iter().map(|device| &device.id);
        let each = |of: &Option<Of<f64>>| of.as_ref().map(|of| of.each(all())).unwrap_or_default();
        Rates {
            samples_per_second: each(&self.samples_per_second),
            pings_per_second: self.pings_per_second,
            readings_per_second: each(&self.readings_per_second),
            silence_max: self.hardware_silence_ms.map(|ms| Duration::from_secs_f64(ms / 1_000.0)),
        }
    }

    /// Checks that the program's look-aheads and rates name existing devices and contain valid numbers.
    fn check_numbers(&self, block: &InitializationBlock) -> Result<(), InvalidDeclaration> {
        let rates = self.rates(block);
        let ms = self.lookahead_ms.iter().flat_map(|of| of.each(driven(block)));
        let numbers = [
            ("lookahead_ms", LOOKAHEAD_MS, ms.collect()),
            ("samples_per_second", SAMPLES_BOUNDS, rates.samples_per_second),
            ("readings_per_second", READINGS_BOUNDS, rates.readings_per_second),
        ];
        for (key, bounds, numbers) in numbers {
            for (device, number) in numbers {
                if block.device(device.as_str()).is_none() {
                    return Err(InvalidDeclaration::NoDevice { key, device });
                }
                if !bounds.contains(&number) {
                    let (least, most) = bounds.into_inner();
                    return Err(InvalidDeclaration::OutOfRange {
                        what: format!("{key} of `{device}`"),
                        number,
                        least,
                        most,
                    });
                }
            }
        }
        let rate = self.pings_per_second;
        if let Some(pings) = rate.filter(|pings| !PINGS_BOUNDS.contains(pings)) {
            let (least, most) = PINGS_BOUNDS.into_inner();
            let what = "pings_per_second".to_owned();
            return Err(InvalidDeclaration::OutOfRange { what, number: pings, least, most });
        }
        let silence = self.hardware_silence_ms;
        if let Some(ms) = silence.filter(|ms| !HARDWARE_SILENCE_MS.contains(ms)) {
            let (least, most) = HARDWARE_SILENCE_MS.into_inner();
            let what = "hardware_silence_ms".to_owned();
            return Err(InvalidDeclaration::OutOfRange { what, number: ms, least, most });
        }
        let each = |device: &DeviceId| driven(block).any(|driven| driven == device);
        if let Some(device) = self.lookahead(block).keys().find(|device| !each(device)) {
            return Err(InvalidDeclaration::NotMoving(device.clone()));
        }
        let whole = self.lookahead.as_ref().map(|of| of.each(driven(block))).unwrap_or_default();
        let ahead = self.lookahead_ms.as_ref().map(|of| of.each(driven(block))).unwrap_or_default();
        match whole.keys().find(|device| ahead.contains_key(*device)) {
            Some(device) => Err(InvalidDeclaration::TwoLookaheads(device.clone())),
            None => Ok(()),
        }
    }

    fn checked(self, block: &InitializationBlock) -> Result<Self, InvalidDeclaration> {
        self.check_numbers(block)?;
        for (device, ms) in &self.latency_ms {
            if block.device(device.as_str()).is_none() {
                return Err(InvalidDeclaration::NoDevice { key: "latency_ms", device: device.clone() });
            }
            if !(*ms >= 0.0 && *ms <= LATENCY_MS_MAX) {
                return Err(InvalidDeclaration::Latency(*ms));
            }
        }
        Ok(self)
    }
}

/// Returns the ids of the devices that can be moved.
fn driven(block: &InitializationBlock) -> impl Iterator<Item = &DeviceId> {
    let moves = |device: &&urrcp::Device| {
        let mut types = device.available_control_types.iter().map(|(control_type, _)| control_type);
        types.any(|control_type| !matches!(control_type, ControlType::Script | ControlType::Sensor))
    };
    block.devices.iter().filter(moves).map(|device| &device.id)
}

/// Parses a program's duration, a number of milliseconds.
fn milliseconds(text: &str) -> Option<Duration> {
    let milliseconds: f64 = text.parse().ok().filter(|milliseconds: &f64| milliseconds.is_finite())?;
    // A program that takes timestamps from another clock may report a slightly negative duration.
    Duration::try_from_secs_f64(milliseconds.max(0.0) / 1_000.0).ok()
}

fn all_values(setpoint: &Setpoint) -> Vec<f64> {
    std::iter::once(setpoint.value).chain(setpoint.more.iter().copied()).collect()
}

impl Driver for Program {
    fn connect(&mut self) -> Result<(), DriverError> {
        self.running = None;
        self.last_sign = None;
        let started = Running::start(&self.command, self.ear.clone());
        self.running = Some(started.map_err(|error| {
            DriverError::Away(format!("cannot start the program `{}`: {error}", self.command))
        })?);
        self.declared = match self.ask_at_start("hello")?.as_str() {
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
        let answer = self.ask("ping", self.timeouts.answer)?;
        let age = answer.strip_prefix("ok").map(str::trim);
        let sign = age.and_then(|age| if age.is_empty() { Some(None) } else { milliseconds(age).map(Some) });
        self.last_sign = sign.ok_or_else(|| self.misunderstood("ping", &answer))?;
        Ok(())
    }

    fn last_sign(&self) -> Option<Duration> {
        self.last_sign
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
        let value = |(device, setpoint): &(DeviceId, Setpoint)| json!({ "device": device, "control_type": setpoint.control_type, "values": all_values(setpoint) });
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

    fn lookahead(&self) -> BTreeMap<DeviceId, Lookahead> {
        self.declared.lookahead(&self.block)
    }

    fn rates(&self) -> Rates {
        self.declared.rates(&self.block)
    }

    fn plan(&mut self, part: &PlanPart<SystemClock>) -> Result<(), DriverError> {
        let step = |(index, step): (usize, &PlanStep<SystemClock>)| {
            json!({ "step": index, "at": step.at.as_nanos(), "control_type": step.setpoint.control_type,
                    "values": all_values(&step.setpoint) })
        };
        let steps: Vec<_> = (part.first..).zip(&part.steps).map(step).collect();
        if part.first > 0 {
            let more = json!({ "plan": part.plan.0, "steps": steps, "last": part.is_last });
            return self.ask_ok(&format!("more {more}"));
        }
        let plan = json!({
            "plan": part.plan.0, "device": part.device, "start": part.start.as_nanos(),
            "begin_by": part.begin_by.as_nanos(), "interpolation": part.interpolation,
            "silence_ms": { "start": self.edge_silence_ms.0, "running": self.edge_silence_ms.1 },
            "steps": steps, "last": part.is_last,
        });
        self.ask_ok(&format!("plan {plan}"))
    }

    fn cancel(&mut self, cancel: &PlanCancel) -> Result<(), DriverError> {
        let cancel = json!({ "plan": cancel.plan.0, "then": cancel.then.as_str(), "why": cancel.why });
        self.ask_ok(&format!("cancel {cancel}"))
    }

    fn take_pushes(&mut self, pushes: Pushes) {
        let sensors =
            self.block.devices.iter().filter(|device| device.available_control_types.sensor().is_some());
        let sensors = Arc::new(sensors.map(|device| device.id.clone()).collect::<HashSet<_>>());
        self.ear = Some(UnsolicitedInput { pushes, sensors });
    }

    fn set_is_acknowledged(&self) -> bool {
        true
    }

    fn takes_ramps(&self) -> bool {
        self.declared.ramps
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLOCK: &str = r#"{"id": "r", "api_version": "1", "devices": [
      {"id": "arm", "name": "arm", "available_control_types": {
         "position": {"min_value": 0, "max_value": 9, "granularity": 1}}},
      {"id": "eye", "name": "eye", "available_control_types": {"sensor": {"min_value": 0, "max_value": 9}}}]}"#;

    fn declared(json: &str) -> Result<(Declared, InitializationBlock), InvalidDeclaration> {
        let block: InitializationBlock = serde_json::from_str(BLOCK).unwrap();
        let declared: Declared = serde_json::from_str(json)?;
        Ok((declared.checked(&block)?, block))
    }

    #[test]
    fn lookahead_applies_to_all_moving_devices_or_to_the_named_ones() {
        let arm = DeviceId::new("arm").unwrap();
        for (json, expected) in [
            (r#"{"lookahead": "script"}"#, Lookahead::Script),
            (r#"{"lookahead": {"arm": "script"}}"#, Lookahead::Script),
            (r#"{"lookahead_ms": 500}"#, Lookahead::Horizon(Span::from_millis(500))),
        ] {
            let (declared, block) = declared(json).unwrap();
            assert_eq!(declared.lookahead(&block), BTreeMap::from([(arm.clone(), expected)]), "{json}");
        }
        let (none, block) = declared("{}").unwrap();
        assert!(none.lookahead(&block).is_empty());
    }

    #[test]
    fn error_for_an_invalid_declaration_states_the_reason() {
        for (json, why) in [
            (r#"{"lookahead": "film"}"#, "expected one value for all devices"),
            (
                r#"{"lookahead": {"eye": "script"}}"#,
                "lookahead names `eye`, which is not a moving device of this robot",
            ),
            (r#"{"lookahead": "script", "lookahead_ms": 500}"#, "`arm` has both"),
            (r#"{"lookahead_ms": 1}"#, "expected 20 to 60000"),
            (r#"{"samples_per_second": {"leg": 5}}"#, "which this robot does not have"),
            (r#"{"samples_per_second": 5000}"#, "expected 0.1 to 1000"),
            (r#"{"readings_per_second": {"eye": 0}}"#, "expected 0.01 to 1000"),
            (r#"{"pings_per_second": 1}"#, "expected 10 to 200"),
            (r#"{"hardware_silence_ms": 5}"#, "expected 50 to 60000"),
        ] {
            let error = declared(json).map(|_| ()).unwrap_err().to_string();
            assert!(error.contains(why), "{json}: {error}");
        }
    }

    use std::path::PathBuf;

    use urrcp::{ControlType, Timestamp};

    use crate::PlanId;
    use crate::plans::Then;

    /// A program for a test that logs the lines that it receives and answers them as the test specifies.
    struct Logged {
        program: Program,
        log: PathBuf,
    }

    impl Logged {
        /// Creates the program. `answers` contains branches of a shell `case`; any other line is answered with `ok`.
        fn new(test: &str, answers: &str) -> Self {
            let log = std::env::temp_dir().join(format!("downbeat-program-{}-{test}", std::process::id()));
            let shown = log.display();
            let command = format!(
                "while read -r line; do printf '%s\\n' \"$line\" >> '{shown}'; \
                 case \"$line\" in {answers} *) echo ok;; esac; done"
            );
            let block: InitializationBlock = serde_json::from_str(BLOCK).unwrap();
            let answer = Duration::from_secs(60);
            let timeouts = Timeouts { start: answer, answer };
            Self { program: Program::new(&command, &block).unwrap().within(timeouts), log }
        }

        fn lines(&self) -> Vec<String> {
            std::fs::read_to_string(&self.log).unwrap().lines().map(str::to_owned).collect()
        }

        /// Parses the JSON that follows `word` in the logged line with index `line`.
        fn json(&self, line: usize, word: &str) -> serde_json::Value {
            serde_json::from_str(self.lines()[line].strip_prefix(word).unwrap()).unwrap()
        }
    }

    impl Drop for Logged {
        fn drop(&mut self) {
            let _never_written = std::fs::remove_file(&self.log);
        }
    }

    fn arm() -> DeviceId {
        DeviceId::new("arm").unwrap()
    }

    fn position(value: f64) -> Setpoint {
        Setpoint::new(ControlType::Position, value)
    }

    #[test]
    fn program_of_version_1_receives_one_line_per_call() {
        let mut logged = Logged::new("calls", "hello) echo ok ramps;; 'read eye') echo ' 4.5 ';;");
        let program = &mut logged.program;
        assert!(!program.takes_ramps() && program.lifeline().is_none(), "nothing runs yet");
        program.connect().unwrap();
        assert!(program.takes_ramps() && !program.takes_frames() && program.set_is_acknowledged());
        assert!(program.lifeline().is_some() && program.latency().is_empty());
        program.set(&arm(), &Setpoint { more: [6.5, 7.0].into(), ..position(5.0) }).unwrap();
        let duration = Duration::from_millis(1_500);
        let ramp = Ramp { control_type: ControlType::Position, to: 9.0, duration };
        program.ramp(&arm(), ramp).unwrap();
        assert_eq!(program.read(&DeviceId::new("eye").unwrap()), Ok(4.5));
        program.ping().unwrap();
        assert_eq!(program.last_sign(), None);
        let told = ["hello", "set arm position 5 6.5 7", "ramp arm position 9 1500", "read eye", "ping"];
        assert_eq!(logged.lines(), told);
    }

    #[test]
    fn program_may_answer_a_ping_with_the_age_of_the_last_sign_of_life() {
        let mut logged = Logged::new(
            "signs",
            "ping) n=$((n+1)); case $n in 1) echo ok 40.5;; 2) echo ok;; *) echo ok soon;; esac;;",
        );
        let program = &mut logged.program;
        program.connect().unwrap();
        for sign in [Some(Duration::from_micros(40_500)), None] {
            program.ping().unwrap();
            assert_eq!(program.last_sign(), sign);
        }
        let error = program.ping().unwrap_err();
        assert!(error.to_string().ends_with("sent an unexpected answer to `ping`: `ok soon`"), "{error}");
    }

    #[test]
    fn refusal_keeps_the_program_and_unexpected_answer_makes_it_unavailable() {
        let answers = "'set arm position 8') echo error  too hot;; 'set arm position 9') echo what;;";
        let mut logged = Logged::new("errors", answers);
        let program = &mut logged.program;
        program.connect().unwrap();
        assert!(!program.takes_ramps());
        let refused = DriverError::Refused("the program reported: too hot".to_owned());
        assert_eq!(program.set(&arm(), &position(8.0)), Err(refused));
        program.ping().unwrap();
        let out_of_step = program.set(&arm(), &position(9.0)).unwrap_err();
        assert!(matches!(&out_of_step, DriverError::Away(_)), "{out_of_step:?}");
        assert!(
            out_of_step.to_string().ends_with("sent an unexpected answer to `set arm position 9`: `what`"),
            "{out_of_step}"
        );
        assert_eq!(program.ping(), Err(DriverError::Away("the program is not running".to_owned())));
        program.connect().unwrap();
        program.ping().unwrap();
        assert!(program.read(&arm()).is_err_and(|error| {
            error.to_string().ends_with("sent an unexpected answer to `read arm`: `ok`")
        }));
        assert!(program.lifeline().is_none());
    }

    #[test]
    fn program_of_version_2_receives_the_block_and_declares_capabilities() {
        let declares = r#"{"frames": true, "latency_ms": {"arm": 12.5}, "lookahead": "script",
            "samples_per_second": 20, "pings_per_second": 30, "readings_per_second": {"eye": 2}}"#;
        let declares = declares.replace('\n', " ");
        let answers = format!("hello) echo ok 2;; init*) echo 'ok {declares}';;");
        let mut logged = Logged::new("declares", &answers);
        let program = &mut logged.program;
        program.connect().unwrap();
        assert!(program.takes_frames() && !program.takes_ramps());
        assert_eq!(program.latency(), BTreeMap::from([(arm(), Duration::from_micros(12_500))]));
        assert_eq!(program.lookahead(), BTreeMap::from([(arm(), Lookahead::Script)]));
        let (rates, eye) = (program.rates(), DeviceId::new("eye").unwrap());
        assert_eq!((rates.samples_per_second.get(&arm()), rates.pings_per_second), (Some(&20.0), Some(30.0)));
        assert_eq!(rates.readings_per_second, BTreeMap::from([(eye, 2.0)]));
        program.set_frame(&[(arm(), Setpoint { more: [6.0].into(), ..position(5.0) })]).unwrap();
        let init = logged.json(1, "init ");
        assert_eq!((&init["version"], &init["block"]["id"]), (&json!(2), &json!("r")));
        let frame = json!([{ "device": "arm", "control_type": "position", "values": [5.0, 6.0] }]);
        assert_eq!(logged.json(2, "frame "), frame);
    }

    #[test]
    fn script_is_sent_with_step_indices_and_continued_by_its_number() {
        let mut logged = Logged::new("plans", "");
        let step = |at: i64, value| PlanStep { at: Timestamp::from_nanos(at), setpoint: position(value) };
        let part = |first, is_last| PlanPart {
            plan: PlanId(7),
            device: arm(),
            start: Timestamp::from_nanos(100),
            begin_by: Timestamp::from_nanos(150),
            interpolation: urrcp::Interpolation::Linear,
            first,
            steps: vec![step(100, 5.0), step(200, 6.0)],
            is_last,
        };
        let program = &mut logged.program;
        program.connect().unwrap();
        program.plan(&part(0, false)).unwrap();
        program.plan(&part(2, true)).unwrap();
        let cancel = PlanCancel { plan: PlanId(7), device: arm(), then: Then::Hold, why: "stop".to_owned() };
        program.cancel(&cancel).unwrap();
        let steps = |first: u32| {
            let step = |index: u32, at: i64, value: f64| json!({ "step": index, "at": at, "control_type": "position", "values": [value] });
            json!([step(first, 100, 5.0), step(first + 1, 200, 6.0)])
        };
        let plan = json!({ "plan": 7, "device": "arm", "start": 100, "begin_by": 150, "interpolation": "linear",
            "silence_ms": { "start": 400, "running": 3_000 }, "steps": steps(0), "last": false });
        assert_eq!(logged.json(1, "plan "), plan);
        assert_eq!(logged.json(2, "more "), json!({ "plan": 7, "steps": steps(2), "last": true }));
        assert_eq!(logged.json(3, "cancel "), json!({ "plan": 7, "then": "hold", "why": "stop" }));
    }

    #[test]
    fn invalid_answer_to_the_first_lines_is_reported_and_ends_the_program() {
        for (test, answers, why) in [
            ("greets", "hello) echo hi;;", "sent an unexpected answer to `hello`: `hi`"),
            ("three", "hello) echo ok 3;;", "sent an unexpected answer to `hello`: `ok 3`"),
            (
                "init",
                "hello) echo ok 2;; init*) echo yes;;",
                "sent an invalid answer to `init`: `yes`: expected `ok` and a JSON object",
            ),
            (
                "json",
                "hello) echo ok 2;; init*) echo 'ok {';;",
                "sent an invalid answer to `init`: `ok {`: EOF",
            ),
            (
                "latency",
                r#"hello) echo ok 2;; init*) echo 'ok {"latency_ms": {"leg": 1}}';;"#,
                "latency_ms names `leg`, which this robot does not have",
            ),
        ] {
            let mut logged = Logged::new(test, answers);
            let error = logged.program.connect().unwrap_err();
            assert!(matches!(&error, DriverError::Away(_)) && error.to_string().contains(why), "{error}");
            assert!(logged.program.lifeline().is_none(), "{test}");
        }
        let mut silent = Logged::new("nothing", "hello) echo ok 2;;");
        silent.program.connect().unwrap();
        assert!(!silent.program.takes_frames(), "`ok` alone declares nothing");
    }

    #[test]
    fn program_that_does_not_answer_in_time_is_terminated() {
        let mut logged = Logged::new("late", "ping) ;;");
        logged.program.connect().unwrap();
        logged.program.timeouts.answer = Duration::from_millis(50);
        let error = logged.program.ping().unwrap_err().to_string();
        assert!(error.ends_with("did not answer `ping` within 0.05 s"), "{error}");
        assert!(logged.program.lifeline().is_none());
    }

    #[test]
    fn device_id_with_space_or_control_character_is_refused() {
        for (id, is_taken) in [("left arm", false), ("left\\u0007arm", false), ("left-arm", true)] {
            let block = BLOCK.replace(r#""id": "arm""#, &format!(r#""id": "{id}""#));
            let block: InitializationBlock = serde_json::from_str(&block).unwrap();
            assert_eq!(Program::new("true", &block).is_ok(), is_taken, "{id}");
        }
    }

    #[test]
    fn bounds_of_declared_values_are_inclusive() {
        for json in [
            r#"{"lookahead_ms": 20}"#,
            r#"{"lookahead_ms": 60000}"#,
            r#"{"samples_per_second": {"arm": 0.1, "eye": 1000}}"#,
            r#"{"pings_per_second": 10}"#,
            r#"{"pings_per_second": 200}"#,
            r#"{"latency_ms": {"arm": 0, "eye": 1}}"#,
        ] {
            assert!(declared(json).is_ok(), "{json}: {:?}", declared(json).map(|_| ()));
        }
        for json in [
            r#"{"lookahead_ms": 60001}"#,
            r#"{"lookahead_ms": {"eye": 100}}"#,
            r#"{"pings_per_second": 201}"#,
            r#"{"latency_ms": {"arm": -1}}"#,
            r#"{"latency_ms": {"arm": 1e9}}"#,
        ] {
            assert!(declared(json).is_err(), "{json}");
        }
    }
}
