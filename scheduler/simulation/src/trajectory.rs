//! Checks that every movement in the log of a robot has a reason. The simulation and the tests with real processes use this check.

use std::collections::HashMap;

use downbeat_robot::set_log::{LogEntry, MotionKind};
use urrcp::{ControlType, Device, DeviceId, Robot, Script, Span, Timestamp};

use crate::braking::{self, Braking, is_of};

/// The largest relative difference, due to rounding, between two computations of the same value.
const ROUNDING: f64 = 1e-6;

/// Distance in the device's unit by which a movement must differ from the current position to count as a jump: twice the granularity.
pub const JUMP: f64 = 2.0;

/// A script that was promised to a device of a robot.
#[derive(Clone, Copy, Debug)]
pub struct Promised<'a> {
    /// The device that received the script.
    pub device: &'a DeviceId,
    /// The script as planned. `None` if the plan does not contain it.
    pub written: Option<&'a Script>,
}

/// The limits and the braking of a device that comes to rest.
#[derive(Clone, Copy, Debug)]
pub struct Resting<'a> {
    /// The device, with the limits that it declares.
    pub device: &'a Device,
    /// The movement of the device to rest. `None` if it is unknown or takes no time.
    pub braking: Option<&'a Braking>,
}

/// The last movement of one signal (position, speed or acceleration) of a device. Times are by the robot's clock.
#[derive(Clone, Copy)]
struct Movement<'a> {
    /// The value at the start of the movement. `None` if it is unknown, as for the first movement of a process.
    from: Option<f64>,
    since: Timestamp<Robot>,
    to: f64,
    until: Timestamp<Robot>,
    braking: Option<&'a Braking>,
}

impl Movement<'_> {
    const fn at(value: f64, since: Timestamp<Robot>) -> Self {
        Self { from: Some(value), since, to: value, until: since, braking: None }
    }

    /// Whether the movement is over. A movement that takes no time is over even if the clock has been set back since then.
    fn rests(&self, at: Timestamp<Robot>) -> bool {
        at >= self.until || self.until <= self.since
    }

    /// The change of the value per second, and the error of that rate. `None` if the rate is unknown.
    fn rate(&self, at: Timestamp<Robot>) -> Option<(f64, f64)> {
        if self.rests(at) {
            return Some((0.0, 0.0));
        }
        if let Some(braking) = self.braking {
            return braking.rate(at);
        }
        let seconds = (self.until - self.since).as_millis_f64() / 1_000.0;
        self.from.map(|from| ((self.to - from) / seconds, 0.0))
    }

    fn value(&self, at: Timestamp<Robot>) -> Option<f64> {
        if self.rests(at) {
            return Some(self.to);
        }
        let from = self.from?;
        let part = (at - self.since).as_millis_f64() / (self.until - self.since).as_millis_f64();
        Some(from + (self.to - from) * part)
    }
}

/// A jump of a device away from the position at which a stop had left it.
#[derive(Clone, Copy, Debug)]
pub struct JumpAfterStop<'a> {
    /// The log entry of the stop.
    pub stop: &'a LogEntry,
    /// The log entry with which the device jumps.
    pub entry: &'a LogEntry,
}

/// Finds the jumps after stops in the log of one process. The log contains a stop only if the device was moving.
pub fn jumps_after_stops<'a>(log: impl IntoIterator<Item = &'a LogEntry>) -> Vec<JumpAfterStop<'a>> {
    let mut stopped: HashMap<&DeviceId, &LogEntry> = HashMap::new();
    let mut jumps = Vec::new();
    for entry in log {
        if !is_of(entry, ControlType::Position) {
            continue;
        }
        let stop = stopped.remove(&entry.device);
        match entry.motion {
            MotionKind::Rest | MotionKind::Slow => _ = stopped.insert(&entry.device, entry),
            MotionKind::Set => {
                let jumped = stop.filter(|stop| (entry.value - stop.value).abs() > JUMP);
                jumps.extend(jumped.map(|stop| JumpAfterStop { stop, entry }));
            }
            MotionKind::Ramp | MotionKind::Default => {}
        }
    }
    jumps
}

/// Finds movements without a reason in the log of one process of a robot, and describes them. `promised` returns the script that a
/// request id names. `goes_home` returns whether an entry follows from a request for the default state. `resting` returns the limits and
/// the braking of the device if an entry brings it to rest.
pub fn unexplained<'a>(
    log: impl IntoIterator<Item = &'a LogEntry>,
    promised: impl Fn(&str) -> Option<Promised<'a>>,
    goes_home: impl Fn(&LogEntry) -> bool,
    resting: impl Fn(&LogEntry) -> Option<Resting<'a>>,
) -> Vec<String> {
    let mut last: HashMap<(&DeviceId, &str), Movement<'_>> = HashMap::new();
    let mut unexplained = Vec::new();
    for entry in log {
        let signal = (&entry.device, entry.control_type.as_str());
        let script = entry.request_id.as_deref().and_then(&promised);
        let before = last.get(&signal).copied();
        let movement = match entry.motion {
            MotionKind::Set | MotionKind::Ramp => of_a_step(entry, script, before),
            _ => to_rest(entry, before, goes_home(entry), resting(entry)),
        };
        match movement {
            Ok(movement) => drop(last.insert(signal, movement)),
            Err(why) => unexplained.push(format!("{why}: {entry:?}")),
        }
    }
    unexplained
}

/// Returns the movement of a device that comes to rest or goes home. Returns a description of the violation if the movement has no
/// reason.
fn to_rest<'a>(
    entry: &LogEntry,
    before: Option<Movement<'a>>,
    goes_home: bool,
    resting: Option<Resting<'a>>,
) -> Result<Movement<'a>, String> {
    let is_position = is_of(entry, ControlType::Position);
    // A signal that the process has not driven is at rest.
    let before = before.or_else(|| (!is_position).then(|| Movement::at(0.0, entry.due)));
    let braking = resting.and_then(|resting| resting.braking);
    if let Some(flaw) = resting.and_then(|resting| flaw(entry, before, resting, goes_home)) {
        return Err(flaw);
    }
    let rests = match entry.motion {
        // The log does not contain the time of arrival.
        MotionKind::Slow => {
            let lasts = braking.map_or(braking::LASTS_MAX, |braking| braking.lasts);
            let rests = Movement::at(entry.value, entry.due);
            Movement { from: None, until: entry.due + lasts, braking, ..rests }
        }
        _ => Movement::at(entry.value, entry.due),
    };
    match entry.motion {
        // A device that goes home may be sent home again, and a device that slows down may be stopped again.
        _ if goes_home => Ok(rests),
        MotionKind::Default => Err("went to its default state, but no stop requested that".to_owned()),
        _ if !is_position => match entry.value {
            0.0 => Ok(rests),
            _ => Err("came to rest with a speed other than zero".to_owned()),
        },
        _ => {
            let before = before.filter(|movement| entry.due < movement.until);
            let movement = before.ok_or("was moved by a stop although it was at rest")?;
            let Some(value) = movement.value(entry.due) else { return Ok(rests) };
            let off = entry.value - value;
            let goes_on = entry.motion == MotionKind::Slow && off * (movement.to - value) >= 0.0;
            if is_rounded(off, value) || goes_on {
                Ok(rests)
            } else {
                Err(format!("was at {value}, but a stop moved it elsewhere"))
            }
        }
    }
}

fn is_rounded(off: f64, value: f64) -> bool {
    off.abs() <= ROUNDING * (1.0 + value.abs())
}

/// Describes the fault of a movement to rest: it does not start at the position of the device, or it violates the declared acceleration.
/// `None` if the movement is correct.
fn flaw(
    entry: &LogEntry,
    before: Option<Movement<'_>>,
    resting: Resting<'_>,
    goes_home: bool,
) -> Option<String> {
    let Resting { device, braking } = resting;
    let is_position = is_of(entry, ControlType::Position);
    let value = before.and_then(|before| before.value(entry.due));
    let rate = before.and_then(|before| before.rate(entry.due));
    let Some(braking) = braking else {
        let limited = braking::acceleration(device)?;
        let moves = if is_position { rate.map(|(rate, _)| rate)? } else { value? };
        let at_once = entry.motion == MotionKind::Rest && moves.abs() > ROUNDING;
        return at_once.then(|| {
            format!("stopped at once from {moves}, although it declares a maximum acceleration of {limited}")
        });
    };
    let begins = braking.values.first().copied().unwrap_or_default();
    if let Some(value) = value.filter(|value| !is_rounded(begins - value, *value)) {
        return Some(format!("was at {value}, but slowed down from {begins}"));
    }
    braking.flaw(device, rate, !goes_home)
}

fn of_a_step<'a>(
    entry: &LogEntry,
    script: Option<Promised<'_>>,
    before: Option<Movement<'_>>,
) -> Result<Movement<'a>, String> {
    let script = script.ok_or("moved without a script of this mission")?;
    if *script.device != entry.device {
        return Err("moved because of a script for another device".to_owned());
    }
    let index = entry.step.unwrap_or_default() as usize;
    let Some(written) = script.written else { return Ok(Movement::at(entry.value, entry.due)) };
    let step = written.steps().get(index).ok_or("executed a step that is not in its script")?;
    let same_type = is_of(entry, step.setpoint.control_type);
    if !same_type || (step.setpoint.value - entry.value).abs() > 0.0 {
        return Err(format!("executed step {index}, but the script contains {:?} there", step.setpoint));
    }
    if entry.is_set() {
        return Ok(Movement::at(entry.value, entry.due));
    }
    let previous = index.checked_sub(1).and_then(|previous| written.steps().get(previous));
    let offset = step.offset.span() - previous.map_or(Span::ZERO, |previous| previous.offset.span());
    let from = before.and_then(|movement| movement.value(entry.due));
    Ok(Movement { from, since: entry.due, to: entry.value, until: entry.due + offset, braking: None })
}
