//! Bodies in space: where robots are while they move, how close they come to each other, and which volumes they stay in.
//!
//! The fleet file says which device of a robot means which coordinate (`body`), and what has to hold (`space`). `path` follows a
//! body through the steps of an act, `drive` integrates speeds, `chain` follows an arm. `closest` and `way` find the closest
//! approach, also between the steps; `compile/check_space.rs` turns what they find into findings. Lengths are in metres, angles in radians, times in seconds.

mod chain;
mod closest;
mod drive;
mod part;
mod path;
mod place;
mod solid;
#[cfg(test)]
mod tests;
mod volume;
mod way;

use std::collections::BTreeMap;

use serde::Serialize;
use urrcp::{DeviceId, RobotId, Span};

pub use closest::{Mover, closest, depth, first_contact};
pub use drive::Pose;
pub use path::{Axis, Knot, Path, Peak, Played, peaks};
pub use solid::Solid;
pub use volume::furthest_out;

/// What has to hold in the space that all robots share.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Space {
    /// Least distance between any two bodies, from surface to surface.
    pub distance: Option<f64>,
    /// Where all bodies have to stay.
    pub keep_in: Option<Volume>,
    /// Where no body may be, by name.
    pub keep_out: BTreeMap<String, Volume>,
}

/// A box whose sides are parallel to the axes; infinite where nothing is said.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Volume {
    /// The least x, y and z.
    pub least: [f64; 3],
    /// The largest x, y and z.
    pub most: [f64; 3],
}

/// What a robot's devices mean in space, and how large it is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Body {
    /// x, y, z, and the rotation about z, counted from x to y. Of a body with a drive, x, y and the rotation are where it starts.
    pub coordinates: [Coordinate; 4],
    /// What drives it, if that is speeds.
    pub drive: Option<Drive>,
    /// Its size about x, y and z. A ball of radius 0 is nothing if the body has joints, otherwise a point.
    pub shape: Shape,
    /// Its arm, from the base to the tip; most bodies have none.
    pub joints: Vec<Joint>,
    /// The end of the last link, in metres in the frame of the last joint.
    pub tip: [f64; 3],
    /// Largest speed of its middle, whatever the direction.
    pub speed: Option<f64>,
    /// Largest acceleration of its middle, whatever the direction.
    pub acceleration: Option<f64>,
}

/// How a body moves whose devices are driven by speed: ahead along its yaw, and about itself.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Drive {
    /// What its devices mean.
    pub steering: Steering,
    /// x and y in metres and yaw in radians at the beginning of the first act.
    pub start: [f64; 3],
}

/// The speeds that drive a body. The value of a coordinate is one speed here, with a scale from the device's unit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum Steering {
    /// Two wheels, or tracks, side by side: the body goes ahead at the mean of their speeds, and turns at their difference over
    /// the distance between them.
    Wheels {
        /// How fast the left wheel rolls, in m/s.
        left: Coordinate,
        /// How fast the right wheel rolls, in m/s.
        right: Coordinate,
        /// The distance between the wheels, in metres.
        track: f64,
    },
    /// The robot itself translates what it is sent into the speeds of its wheels.
    Twist {
        /// How fast it goes ahead, in m/s.
        speed: Coordinate,
        /// How fast it turns from x to y, in rad/s.
        turn: Coordinate,
    },
}

/// A joint of an arm, with the link from it to the next joint or to the tip.
///
/// Its frame is that of the link before (for the first joint that of the body, which turns with `yaw`), moved by `xyz` and turned
/// by `rpy`, as in URDF. The link is a capsule: all points within `radius` of the line to where the next joint is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Joint {
    /// Its name: that of its device, or of the joint in a URDF.
    pub name: String,
    /// How it moves.
    pub kind: JointKind,
    /// Where it is, in metres in the frame of the link before.
    pub xyz: [f64; 3],
    /// Roll, pitch and yaw about the fixed axes x, y and z of the link before, one after another, in radians.
    pub rpy: [f64; 3],
    /// What it turns about or slides along, of length 1, in its own frame.
    pub axis: [f64; 3],
    /// How far it has turned, in radians, or slid, in metres.
    pub value: Coordinate,
    /// The radius about its link, in metres.
    pub radius: f64,
}

/// How a joint moves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum JointKind {
    /// It turns about its axis.
    #[default]
    Revolute,
    /// It slides along its axis.
    Prismatic,
}

/// Where a coordinate comes from.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum Coordinate {
    /// It never changes.
    Fixed(f64),
    /// `offset + scale * value of the device`.
    Device {
        /// Which device of the robot.
        device: DeviceId,
        /// Metres, or radians, in one unit of the device.
        scale: f64,
        /// Where the device's zero is.
        offset: f64,
    },
}

/// The size of a body, about its middle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Shape {
    /// A ball; a point if its radius is 0.
    Ball {
        /// Its radius.
        radius: f64,
    },
    /// A box that turns with the body.
    Box {
        /// Its whole length, width and height.
        size: [f64; 3],
    },
}

impl Shape {
    /// Of the ball about its middle that holds it, in metres.
    pub fn outer_radius(&self) -> f64 {
        match *self {
            Self::Ball { radius } => radius,
            Self::Box { size: [x, y, z] } => x.hypot(y).hypot(z) / 2.0,
        }
    }

    /// Half of what it is wide at least, in metres: whatever way it is turned, no other one comes nearer to its middle.
    pub fn inner_radius(&self) -> f64 {
        match *self {
            Self::Ball { radius } => radius,
            Self::Box { size } => size.into_iter().fold(f64::INFINITY, f64::min) / 2.0,
        }
    }
}

/// What the bodies of an act do, where the fleet file describes bodies.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InSpace {
    /// The closest that two of them come.
    pub closest: Option<Closest>,
    /// How fast each of them moves.
    pub bodies: Vec<BodyUse>,
    /// The paths of those that are driven by speeds, to be drawn.
    pub driven: Vec<DrivenPath>,
    /// Robots that play and whose place is not known all the time. They count for nothing here as long as it is not.
    pub unknown: Vec<RobotId>,
}

/// Where a body is that is driven by speeds. Between two points it moves evenly, to within [`DrivenPath::DRAWN`].
#[derive(Clone, Debug, PartialEq)]
pub struct DrivenPath {
    /// Of which robot.
    pub robot: RobotId,
    /// In order of time.
    pub points: Vec<DrivenPoint>,
}

/// Where a body is at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DrivenPoint {
    /// From the act's start.
    pub at: Span,
    /// x and y in metres, and yaw in radians.
    pub pose: [f64; 3],
}

impl DrivenPath {
    /// Metres by which, or radians, a picture of the path may be off. The checks follow the body more closely.
    pub const DRAWN: f64 = 2e-3;
}

/// How fast the middle of a body moves at most in an act, in all directions together.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BodyUse {
    /// Of which robot.
    pub robot: RobotId,
    /// In metres a second, without what the rounding of steps may have added.
    #[serde(rename = "speed_m_s")]
    pub speed: f64,
    /// In metres a second squared, without the same.
    #[serde(rename = "acceleration_m_s2")]
    pub acceleration: f64,
}

/// What rounding may add to a rate.
pub const DUST: f64 = 1.0 + 1e-6;

/// The closest that two bodies come in an act.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Closest {
    /// Between whom.
    pub robots: [RobotId; 2],
    /// From the act's start.
    #[serde(rename = "at_ms")]
    pub at: Span,
    /// From surface to surface, in metres; 0 if they touch or overlap.
    #[serde(rename = "distance_m")]
    pub distance: f64,
}

impl Space {
    /// Whether anything has to hold.
    #[must_use]
    pub fn is_checked(&self) -> bool {
        self.distance.is_some() || self.keep_in.is_some() || !self.keep_out.is_empty()
    }

    /// How near the middles of any two of these bodies may come at most, in metres: with the radii of the two smallest.
    pub fn between_middles<'b>(&self, bodies: impl Iterator<Item = &'b Body>) -> f64 {
        let mut radii: Vec<f64> = bodies.map(|body| body.shape.inner_radius()).collect();
        radii.sort_unstable_by(f64::total_cmp);
        self.distance.unwrap_or(0.0) + radii.iter().take(2).sum::<f64>()
    }
}

/// A point at 0 that never moves.
impl Default for Body {
    fn default() -> Self {
        Self {
            coordinates: [const { Coordinate::Fixed(0.0) }; 4],
            drive: None,
            shape: Shape::Ball { radius: 0.0 },
            joints: Vec::new(),
            tip: [0.0; 3],
            speed: None,
            acceleration: None,
        }
    }
}

impl Default for Volume {
    fn default() -> Self {
        Self { least: [f64::NEG_INFINITY; 3], most: [f64::INFINITY; 3] }
    }
}
