//! Checks that every movement in the log of a robot has one reason. The simulation and the tests with real processes use it.

use std::collections::HashMap;

use downbeat_robot::set_log::{LogEntry, MotionKind};
use urrcp::{ControlType, DeviceId, Robot, Script, Span, Timestamp};

/// The largest relative difference, by rounding, between two computations of the same value.
const ROUNDING: f64 = 1e-6;

/// Distance from a value above which a device jumps to it: twice its granularity.
pub const JUMP: f64 = 2.0;

/// The longest time in which a device slows down, or goes home at its own speed.
const SLOWS_DOWN_MAX: Span = Span::from_millis(600_000);

/// A script that was promised to a device of the robot.
#[derive(Clone, Copy, Debug)]
pub struct Promised<'a> {
    /// The device to which the script was sent.
    pub device: &'a DeviceId,
    /// The script of the plan. `None` if the plan has no such script.
    pub written: Option<&'a Script>,
}

/// The last movement of a device. Times are those of its robot's clock.
#[derive(Clone, Copy)]
struct Movement {
    /// `None` if the start of the movement is unknown, as for the first movement of a process.
    from: Option<f64>,
    since: Timestamp<Robot>,
    to: f64,
    until: Timestamp<Robot>,
}

impl Movement {
    const fn at(value: f64, since: Timestamp<Robot>) -> Self {
        Self { from: Some(value), since, to: value, until: since }
    }

    fn value(&self, at: Timestamp<Robot>) -> Option<f64> {
        if at >= self.until {
            return Some(self.to);
        }
        let from = self.from?;
        let part = (at - self.since).as_millis_f64() / (self.until - self.since).as_millis_f64();
        Some(from + (self.to - from) * part)
    }
}

/// A jump of a device from the position at which a stop has left it.
#[derive(Clone, Copy, Debug)]
pub struct JumpAfterStop<'a> {
    /// The entry of the stop.
    pub stop: &'a LogEntry,
    /// The entry with which the device jumps.
    pub entry: &'a LogEntry,
}

/// The jumps after stops in the log of one process. The log contains a stop only if the device was moving.
pub fn jumps_after_stops<'a>(log: impl IntoIterator<Item = &'a LogEntry>) -> Vec<JumpAfterStop<'a>> {
    let mut stopped: HashMap<&DeviceId, &LogEntry> = HashMap::new();
    let mut jumps = Vec::new();
    for entry in log {
        if entry.control_type != ControlType::Position.to_string() {
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

/// Describes the movements without a reason in the log of one process of a robot. `promised` returns the script that a request id
/// names. `goes_home` returns whether an entry follows from a request for the default state.
pub fn unexplained<'a>(
    log: impl IntoIterator<Item = &'a LogEntry>,
    promised: impl Fn(&str) -> Option<Promised<'a>>,
    goes_home: impl Fn(&LogEntry) -> bool,
) -> Vec<String> {
    let mut last: HashMap<&DeviceId, Movement> = HashMap::new();
    let mut unexplained = Vec::new();
    for entry in log {
        let script = entry.request_id.as_deref().and_then(&promised);
        match movement(entry, script, last.get(&entry.device).copied(), goes_home(entry)) {
            Ok(movement) => drop(last.insert(&entry.device, movement)),
            Err(why) => unexplained.push(format!("{why}: {entry:?}")),
        }
    }
    unexplained
}

/// Returns the new movement of the device if it has a reason, or else a description of the violation.
fn movement(
    entry: &LogEntry,
    script: Option<Promised<'_>>,
    before: Option<Movement>,
    goes_home: bool,
) -> Result<Movement, String> {
    let resting = match entry.motion {
        // The log does not contain the time of arrival.
        MotionKind::Slow => {
            Movement { from: None, until: entry.due + SLOWS_DOWN_MAX, ..Movement::at(entry.value, entry.due) }
        }
        _ => Movement::at(entry.value, entry.due),
    };
    match entry.motion {
        MotionKind::Set | MotionKind::Ramp => of_a_step(entry, script, before),
        // A device that goes home may be sent home again, and a device that slows down may be stopped again.
        _ if goes_home => Ok(resting),
        MotionKind::Default => Err("went to its default state, and no stop said home".to_owned()),
        MotionKind::Rest | MotionKind::Slow if entry.control_type != ControlType::Position.to_string() => {
            match entry.value {
                0.0 => Ok(resting),
                _ => Err("came to rest at a speed".to_owned()),
            }
        }
        MotionKind::Rest | MotionKind::Slow => {
            let before = before.filter(|movement| entry.due < movement.until);
            let movement = before.ok_or("was moved by a stop although it rested")?;
            let Some(value) = movement.value(entry.due) else { return Ok(resting) };
            let off = entry.value - value;
            let rounded = off.abs() <= ROUNDING * (1.0 + value.abs());
            let goes_on = entry.motion == MotionKind::Slow && off * (movement.to - value) >= 0.0;
            if rounded || goes_on { Ok(resting) } else { Err(format!("was at {value} when a stop moved it")) }
        }
    }
}

fn of_a_step(
    entry: &LogEntry,
    script: Option<Promised<'_>>,
    before: Option<Movement>,
) -> Result<Movement, String> {
    let script = script.ok_or("moved without a script of this mission")?;
    if *script.device != entry.device {
        return Err("moved by a script of another device".to_owned());
    }
    let index = entry.step.unwrap_or_default() as usize;
    let Some(written) = script.written else { return Ok(Movement::at(entry.value, entry.due)) };
    let step = written.steps().get(index).ok_or("did a step that was not written")?;
    if (step.setpoint.value - entry.value).abs() > 0.0 {
        return Err(format!("did step {index}, written as {}", step.setpoint.value));
    }
    if entry.is_set() {
        return Ok(Movement::at(entry.value, entry.due));
    }
    let previous = index.checked_sub(1).and_then(|previous| written.steps().get(previous));
    let offset = step.offset.span() - previous.map_or(Span::ZERO, |previous| previous.offset.span());
    let from = before.and_then(|movement| movement.value(entry.due));
    Ok(Movement { from, since: entry.due, to: entry.value, until: entry.due + offset })
}
