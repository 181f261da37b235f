//! The page's data format. `viewer/src/mission.ts` is the counterpart of these types, and a test of the viewer compares both.

use downbeat_mission::ActNumber;
use downbeat_scripts::WrittenRelation;
use serde::Serialize;
use serde_json::Value;

use super::columns::Series;
use crate::history::Fate;

/// The version of the page's data format.
pub(super) const VERSION: u32 = 1;

#[derive(Debug, Serialize)]
pub(super) struct Mission {
    pub(super) version: u32,
    pub(super) program: &'static str,
    pub(super) kind: DocumentKind,
    /// The reason why the file of the mission is incomplete; `None` if it is complete.
    pub(super) cut_off: Option<String>,
    pub(super) scenario: String,
    /// The absolute time that corresponds to 0 ms on the page, as text.
    pub(super) epoch: String,
    pub(super) from: f64,
    pub(super) to: f64,
    /// The time of the last entry of the file. Later parts of the plan may not have been played yet.
    pub(super) known_until: f64,
    pub(super) report: Option<Value>,
    pub(super) sources: Vec<Source>,
    pub(super) robots: Vec<Robot>,
    pub(super) groups: Vec<Group>,
    pub(super) space: Space,
    pub(super) plans: Vec<Plan>,
    pub(super) acts: Vec<Played>,
    pub(super) events: Vec<MissionEvent>,
    pub(super) findings: Vec<Finding>,
    /// The values that robots set, and the readings of sensors.
    pub(super) set: Vec<DeviceSeries>,
    pub(super) read: Vec<DeviceSeries>,
    pub(super) clocks: Vec<Clock>,
    /// Late steps, as robots reported them while they played; empty unless the mission was recorded.
    pub(super) late: Vec<Late>,
    /// The comparison with another plan or mission, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) compared: Option<Compared>,
}

/// The plan or mission that the page's own plan or mission is compared with.
#[derive(Debug, Serialize)]
pub(super) struct Compared {
    /// The name of the file that contains the other plan or mission.
    pub(super) with: String,
    pub(super) differences: Vec<Difference>,
    pub(super) ghosts: Vec<Ghost>,
}

/// A difference in words.
#[derive(Debug, Serialize)]
pub(super) struct Difference {
    /// Index of the act's plan on the page. `None` if only the other plan or mission has the act, or if the difference concerns no act.
    pub(super) plan: Option<usize>,
    /// Time in milliseconds from the act's start; `None` if the difference has no time.
    pub(super) at: Option<f64>,
    pub(super) robot: Option<usize>,
    pub(super) device: Option<usize>,
    pub(super) subject: String,
    pub(super) text: String,
}

/// What the other plan or mission contains for an act of the page's own plan or mission.
#[derive(Debug, Serialize)]
pub(super) struct Ghost {
    pub(super) plan: usize,
    /// Cues of the page's own plan whose times differ in the other plan.
    pub(super) cues: Vec<GhostCue>,
    pub(super) lanes: Vec<Lane>,
}

#[derive(Debug, Serialize)]
pub(super) struct GhostCue {
    /// Index of the cue in the page's own plan.
    pub(super) cue: usize,
    pub(super) start: f64,
    pub(super) end: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum DocumentKind {
    DryRun,
    Recording,
    Journal,
    Trials,
}

#[derive(Debug, Serialize)]
pub(super) struct Source {
    pub(super) name: String,
    pub(super) text: String,
}

#[derive(Debug, Serialize)]
pub(super) struct Robot {
    pub(super) id: String,
    pub(super) devices: Vec<Device>,
    pub(super) body: Option<Body>,
}

#[derive(Debug, Serialize)]
pub(super) struct Group {
    pub(super) name: String,
    pub(super) robots: Vec<usize>,
}

/// The requirements of the fleet file on the space of all bodies, in metres. Sides without a limit are infinite, which is `null` in JSON.
#[derive(Debug, Default, Serialize)]
pub(super) struct Space {
    /// Least distance between the surfaces of two bodies.
    pub(super) distance: Option<f64>,
    pub(super) keep_in: Option<Volume>,
    pub(super) keep_out: Vec<NamedVolume>,
}

#[derive(Debug, Serialize)]
pub(super) struct Volume {
    pub(super) least: [f64; 3],
    pub(super) most: [f64; 3],
}

#[derive(Debug, Serialize)]
pub(super) struct NamedVolume {
    pub(super) name: String,
    pub(super) volume: Volume,
}

#[derive(Debug, Serialize)]
pub(super) struct Device {
    pub(super) id: String,
    pub(super) name: String,
    pub(super) unit: String,
    pub(super) interpolation: &'static str,
    pub(super) granularity: Option<f64>,
    pub(super) min: Option<f64>,
    pub(super) max: Option<f64>,
    pub(super) default: Option<f64>,
    pub(super) sensor: bool,
}

#[derive(Debug, Serialize)]
pub(super) struct Body {
    pub(super) x: Coordinate,
    pub(super) y: Coordinate,
    pub(super) z: Coordinate,
    pub(super) yaw: Coordinate,
    pub(super) shape: Shape,
    pub(super) joints: Vec<Joint>,
    /// The fleet file's limits of the middle's speed in m/s and its acceleration in m/s².
    pub(super) speed: Option<f64>,
    pub(super) acceleration: Option<f64>,
}

/// A coordinate, computed as `offset + scale * value of the device`. Without a device, it is always `offset`.
#[derive(Debug, Serialize)]
pub(super) struct Coordinate {
    pub(super) device: Option<usize>,
    pub(super) scale: f64,
    pub(super) offset: f64,
}

#[derive(Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Shape {
    Ball(f64),
    Box([f64; 3]),
}

/// A joint in the frame of the previous link.
#[derive(Debug, Serialize)]
pub(super) struct Joint {
    pub(super) name: String,
    pub(super) kind: &'static str,
    pub(super) xyz: [f64; 3],
    pub(super) rpy: [f64; 3],
    pub(super) axis: [f64; 3],
    pub(super) value: Coordinate,
    pub(super) radius: f64,
}

#[derive(Debug, Serialize)]
pub(super) struct Plan {
    pub(super) name: String,
    pub(super) duration: f64,
    pub(super) start_tolerance: f64,
    pub(super) cues: Vec<Cue>,
    pub(super) lanes: Vec<Lane>,
    pub(super) closest: Option<Closest>,
    pub(super) bodies: Vec<BodyUse>,
    pub(super) budgets: Vec<StepBudget>,
    pub(super) waits: String,
}

/// The largest speed in m/s and acceleration in m/s² of a body's middle.
#[derive(Debug, Serialize)]
pub(super) struct BodyUse {
    pub(super) robot: usize,
    pub(super) speed: f64,
    pub(super) acceleration: f64,
}

/// The number of steps of a device, and the largest number that it can hold.
#[derive(Debug, Serialize)]
pub(super) struct StepBudget {
    pub(super) robot: usize,
    pub(super) device: usize,
    pub(super) steps: usize,
    pub(super) budget: u64,
}

#[derive(Debug, Serialize)]
pub(super) struct Cue {
    pub(super) name: String,
    pub(super) start: f64,
    pub(super) end: f64,
    pub(super) slack: f64,
    /// Whether the cue is on the critical path, which determines when the act ends.
    pub(super) critical: bool,
    /// The choreographer's remark.
    pub(super) note: Option<String>,
    pub(super) robots: Vec<usize>,
    pub(super) source: usize,
    pub(super) first_line: usize,
    pub(super) last_line: usize,
    pub(super) relations: Vec<WrittenRelation>,
}

#[derive(Debug, Serialize)]
pub(super) struct Lane {
    pub(super) robot: usize,
    pub(super) device: usize,
    pub(super) control: String,
    /// Index of the lane's value within a step, from 0.
    pub(super) value: usize,
    pub(super) worst_error: f64,
    pub(super) worst_at: f64,
    pub(super) scripts: Vec<Script>,
}

#[derive(Debug, Serialize)]
pub(super) struct Script {
    pub(super) start: f64,
    pub(super) steps: Series,
}

#[derive(Debug, Serialize)]
pub(super) struct Closest {
    pub(super) robots: [usize; 2],
    pub(super) at: f64,
    pub(super) distance: f64,
}

#[derive(Debug, Serialize)]
pub(super) struct Played {
    pub(super) name: String,
    pub(super) number: ActNumber,
    pub(super) plan: Option<usize>,
    pub(super) start: f64,
    pub(super) end: f64,
    pub(super) sent: Option<f64>,
    pub(super) decided: Option<f64>,
    pub(super) committed: Option<f64>,
    pub(super) no_return: Option<f64>,
    pub(super) lease: Option<f64>,
    pub(super) fate: Fate,
    /// When the act ended or a stop of all robots began, whichever came first, in milliseconds on the page. `None` if neither happened.
    pub(super) over: Option<f64>,
    pub(super) robots: Vec<PlayedRobot>,
}

#[derive(Debug, Serialize)]
pub(super) struct PlayedRobot {
    pub(super) robot: usize,
    pub(super) left_out: bool,
    pub(super) started: Option<f64>,
    pub(super) ended: Option<f64>,
}

#[derive(Debug, Serialize)]
pub(super) struct MissionEvent {
    pub(super) at: f64,
    pub(super) kind: String,
    pub(super) robot: Option<usize>,
    pub(super) text: String,
}

#[derive(Debug, Serialize)]
pub(super) struct Finding {
    pub(super) code: &'static str,
    pub(super) severity: &'static str,
    pub(super) message: String,
    pub(super) hint: Option<String>,
    pub(super) source: Option<usize>,
    pub(super) line: usize,
    pub(super) column: usize,
}

#[derive(Debug, Serialize)]
pub(super) struct DeviceSeries {
    pub(super) robot: usize,
    pub(super) device: usize,
    pub(super) act: Option<ActNumber>,
    pub(super) series: Series,
}

#[derive(Debug, Serialize)]
pub(super) struct Clock {
    pub(super) robot: usize,
    pub(super) offset: Series,
    pub(super) uncertainty: Series,
}

/// Steps of a device that were late.
#[derive(Debug, Serialize)]
pub(super) struct Late {
    pub(super) robot: usize,
    pub(super) device: usize,
    /// Number of the act.
    pub(super) act: ActNumber,
    /// The steps were due within this time.
    pub(super) from: f64,
    pub(super) to: f64,
    pub(super) steps: u32,
    /// The largest lateness in milliseconds; `None` if the robot does not report it.
    pub(super) most: Option<f64>,
}
