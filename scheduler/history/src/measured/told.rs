//! Measures broken connections, sensor readings and waits for the operator from the messages to the operator.

use downbeat_mission::Progress;
use serde::Serialize;
use urrcp::{ControlType, RobotId, Server, Span, Timestamp};

use crate::history::{History, KnownRobot};

/// The text that identifies the operator's go in the message about an act that waits.
const OPERATOR: &str = "the operator's go";

/// A connection to a robot that broke.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Break {
    /// When the connection broke, as the time since the start of the mission.
    #[serde(rename = "at_ms")]
    pub at: Span,
    /// Time until the robot returned on a new connection, or until the end of the file.
    #[serde(rename = "lasted_ms")]
    pub lasted: Span,
    /// Whether the robot returned.
    pub back: bool,
}

/// The readings of a sensor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SensorMeasured {
    /// The id of the robot that has the sensor.
    pub robot: String,
    /// The id of the sensor's device.
    pub sensor: String,
    /// Number of all readings, including repeated ones.
    pub readings: usize,
    /// The readings that differ from the previous reading, each with the time since the start of the mission (milliseconds in JSON).
    pub values: Vec<(Span, f64)>,
}

/// How long acts waited for the operator's go.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct OperatorMeasured {
    /// The durations of the waits that ended with a go.
    #[serde(rename = "waits_ms")]
    pub waits: Vec<Span>,
    /// Number of waits that ended without a go.
    pub unanswered: usize,
}

pub(super) fn breaks(
    history: &History,
    robot: &RobotId,
    began: Timestamp<Server>,
    ended: Timestamp<Server>,
) -> Vec<Break> {
    let mut breaks: Vec<Break> = Vec::new();
    for (at, told) in &history.told {
        let open = breaks.last_mut().filter(|last| !last.back);
        match (told, open) {
            (Progress::LinkLost { robot: of, .. }, None) if of == robot => {
                breaks.push(Break { at: *at - began, lasted: ended - *at, back: false });
            }
            (Progress::Reattached { robot: of }, Some(open)) if of == robot => {
                (open.lasted, open.back) = (*at - (began + open.at), true);
            }
            _ => {}
        }
    }
    breaks
}

/// Returns the readings of devices that only sense. The readings of devices that move are omitted, because they are positions.
pub(super) fn sensors(robot: &KnownRobot, began: Timestamp<Server>) -> Vec<SensorMeasured> {
    let moves = |device: &str| {
        let described = robot.init.as_ref().and_then(|init| init.device(device));
        described.is_some_and(|device| {
            device.available_control_types.iter().any(|(control, _)| control != ControlType::Sensor)
        })
    };
    let only_read = robot.readings.iter().filter(|(device, values)| !moves(device) && !values.is_empty());
    let measured = |(device, values): (&String, &Vec<(Timestamp<Server>, f64)>)| {
        let mut changes: Vec<(Span, f64)> = values.iter().map(|(at, value)| (*at - began, *value)).collect();
        changes.dedup_by(|(_, value), (_, before)| value == before);
        // The file has a resolution of one microsecond. Of several readings within one microsecond, the first is used.
        changes.dedup_by_key(|(at, _)| at.as_nanos() / 1_000);
        SensorMeasured {
            robot: robot.id.to_string(),
            sensor: device.clone(),
            readings: values.len(),
            values: changes,
        }
    };
    only_read.map(measured).collect()
}

pub(super) fn operator(history: &History) -> OperatorMeasured {
    let mut measured = OperatorMeasured::default();
    let mut waiting: Option<(&str, Timestamp<Server>)> = None;
    for (at, told) in &history.told {
        match told {
            Progress::Waiting { act, awaits, .. } if awaits.starts_with(OPERATOR) => {
                measured.unanswered += usize::from(waiting.is_some());
                waiting = Some((act, *at));
            }
            Progress::Preparing { act, .. } => {
                let own = waiting.take_if(|(name, _)| name == act);
                measured.waits.extend(own.map(|(_, since)| *at - since));
            }
            _ => {}
        }
    }
    measured.unanswered += usize::from(waiting.is_some());
    measured
}
