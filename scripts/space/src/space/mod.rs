//! Bodies in space: their movements, their distances from each other, and the volumes in which they must stay.
//!
//! The fleet file maps the devices of a robot to coordinates (`body`) and contains the limits (`space`). `path` follows a body through
//! the steps of an act, `drive` integrates speeds, `chain` follows an arm. `closest` and `way` find the closest approach, including the
//! time between steps; `compile/check_space.rs` turns the results into findings. Lengths are in metres, angles in radians, times in
//! seconds.

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

/// The limits in the space that all robots share.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Space {
    /// Least distance between any two bodies, from surface to surface.
    pub distance: Option<f64>,
    /// The volume in which all bodies must stay.
    pub keep_in: Option<Volume>,
    /// Volumes in which no body may be, by name.
    pub keep_out: BTreeMap<String, Volume>,
}

/// A box whose sides are parallel to the axes; infinite where no limit is given.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Volume {
    /// The least x, y and z.
    pub least: [f64; 3],
    /// The largest x, y and z.
    pub most: [f64; 3],
}

/// The position and size of a robot in space, as a function of its devices.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Body {
    /// x, y, z, and the rotation about z, counted from x to y. For a body with a drive, x, y and the rotation are its start.
    pub coordinates: [Coordinate; 4],
    /// Its drive, if it is driven by speeds.
    pub drive: Option<Drive>,
    /// Its shape, centred at x, y and z. If the body has joints, a ball of radius 0 is no shape; otherwise it is a point.
    pub shape: Shape,
    /// Its arm, from the base to the tip; empty for most bodies.
    pub joints: Vec<Joint>,
    /// The end of the last link, in metres in the frame of the last joint.
    pub tip: [f64; 3],
    /// Largest speed of its middle in any direction.
    pub speed: Option<f64>,
    /// Largest acceleration of its middle in any direction.
    pub acceleration: Option<f64>,
}

/// The movement of a body whose devices are driven by speed: forward along its yaw, and about itself.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Drive {
    /// The meaning of its devices.
    pub steering: Steering,
    /// x and y in metres and yaw in radians at the beginning of the first act.
    pub start: [f64; 3],
}

/// The speeds that drive a body. Here, the value of a coordinate is a speed, with a scale from the device's unit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum Steering {
    /// Two wheels or tracks side by side: the body moves forward at the mean of their speeds. It turns at their difference divided by the
    /// distance between them.
    Wheels {
        /// Rolling speed of the left wheel, in m/s.
        left: Coordinate,
        /// Rolling speed of the right wheel, in m/s.
        right: Coordinate,
        /// The distance between the wheels, in metres.
        track: f64,
    },
    /// The robot itself converts the received values to wheel speeds.
    Twist {
        /// Forward speed, in m/s.
        speed: Coordinate,
        /// Turn rate from x to y, in rad/s.
        turn: Coordinate,
    },
}

/// A joint of an arm, with the link from it to the next joint or to the tip.
///
/// Its frame is that of the previous link (for the first joint, that of the body, which turns with `yaw`), moved by `xyz` and turned by
/// `rpy`, as in URDF. The link is a capsule: all points within `radius` of the line to the next joint.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Joint {
    /// Its name: that of its device, or of the joint in a URDF.
    pub name: String,
    /// Kind of its movement.
    pub kind: JointKind,
    /// Its position, in metres in the frame of the previous link.
    pub xyz: [f64; 3],
    /// Roll, pitch and yaw about the fixed axes x, y and z of the previous link, one after another, in radians.
    pub rpy: [f64; 3],
    /// Its axis of rotation or translation, of length 1, in its own frame.
    pub axis: [f64; 3],
    /// Its rotation in radians, or its translation in metres.
    pub value: Coordinate,
    /// The radius about its link, in metres.
    pub radius: f64,
}

/// The kind of movement of a joint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum JointKind {
    /// It turns about its axis.
    #[default]
    Revolute,
    /// It slides along its axis.
    Prismatic,
}

/// The source of a coordinate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum Coordinate {
    /// It never changes.
    Fixed(f64),
    /// `offset + scale * value of the device`.
    Device {
        /// The device of the robot.
        device: DeviceId,
        /// Metres, or radians, per unit of the device.
        scale: f64,
        /// The coordinate at the device's zero.
        offset: f64,
    },
}

/// The shape of a body about its middle.
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
    /// Returns the radius of the enclosing ball about its middle, in metres.
    pub fn outer_radius(&self) -> f64 {
        match *self {
            Self::Ball { radius } => radius,
            Self::Box { size: [x, y, z] } => x.hypot(y).hypot(z) / 2.0,
        }
    }

    /// Returns half of its least width, in metres: in any rotation, no other body comes closer to its middle.
    pub fn inner_radius(&self) -> f64 {
        match *self {
            Self::Ball { radius } => radius,
            Self::Box { size } => size.into_iter().fold(f64::INFINITY, f64::min) / 2.0,
        }
    }
}

/// The bodies' movements in an act, if the fleet file describes bodies.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InSpace {
    /// The closest approach of two bodies.
    pub closest: Option<Closest>,
    /// The largest speed and acceleration of each body.
    pub bodies: Vec<BodyUse>,
    /// The paths of bodies that are driven by speeds, for drawing.
    pub driven: Vec<DrivenPath>,
    /// Robots that play and whose place is unknown all the time. While it is unknown, they are ignored here.
    pub unknown: Vec<RobotId>,
}

/// The path of a body that is driven by speeds. It moves evenly between two points, with an accuracy of [`DrivenPath::DRAWN`].
#[derive(Clone, Debug, PartialEq)]
pub struct DrivenPath {
    /// Id of the robot.
    pub robot: RobotId,
    /// In order of time.
    pub points: Vec<DrivenPoint>,
}

/// The pose of a body at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DrivenPoint {
    /// Since the act's start.
    pub at: Span,
    /// x and y in metres, and yaw in radians.
    pub pose: [f64; 3],
}

impl DrivenPath {
    /// Permitted deviation of a drawing of the path, in metres or radians. The checks follow the body more closely.
    pub const DRAWN: f64 = 2e-3;
}

/// The largest speed and acceleration of a body's middle in an act, over all directions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BodyUse {
    /// Id of the robot.
    pub robot: RobotId,
    /// In metres per second, without the possible increase by rounding of steps.
    #[serde(rename = "speed_m_s")]
    pub speed: f64,
    /// In metres per second squared, without the possible increase by rounding of steps.
    #[serde(rename = "acceleration_m_s2")]
    pub acceleration: f64,
}

/// Factor by which rounding may increase a rate.
pub const DUST: f64 = 1.0 + 1e-6;

/// The closest approach of two bodies in an act.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Closest {
    /// The ids of both robots.
    pub robots: [RobotId; 2],
    /// Since the act's start.
    #[serde(rename = "at_ms")]
    pub at: Span,
    /// From surface to surface, in metres; 0 if they touch or overlap.
    #[serde(rename = "distance_m")]
    pub distance: f64,
}

impl Space {
    /// Whether any limit is set.
    #[must_use]
    pub fn is_checked(&self) -> bool {
        self.distance.is_some() || self.keep_in.is_some() || !self.keep_out.is_empty()
    }

    /// Returns the least permitted distance between the middles of any two of these bodies, in metres, using the radii of the two
    /// smallest.
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
