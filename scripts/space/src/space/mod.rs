//! Bodies in space: their movements, the distances between them, and the volumes in which they must stay.
//!
//! The fleet file maps the devices of a robot to coordinates (`body`) and contains the limits (`space`). `path` follows a body through
//! the steps of an act, `drive` integrates speeds, `chain` computes an arm. `closest` and `way` find the closest approach, also at times
//! between steps; `compile/check_space.rs` turns the results into findings. Lengths are in metres, angles in radians, times in seconds.

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

/// The limits in the space that all robots share. A limit that is `None` does not apply.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Space {
    /// Least distance between any two bodies, from surface to surface, in metres.
    pub distance: Option<f64>,
    /// Volume in which all bodies must stay.
    pub keep_in: Option<Volume>,
    /// Volumes in which no body may be, by name.
    pub keep_out: BTreeMap<String, Volume>,
}

/// A box whose sides are parallel to the axes, in metres; a side without a limit is infinite.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Volume {
    /// Least x, y and z.
    pub least: [f64; 3],
    /// Largest x, y and z.
    pub most: [f64; 3],
}

/// The position and shape of a robot in space, as a function of its devices' values.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Body {
    /// x, y, z, and the rotation about z, from x to y. For a body with a drive, x, y and the rotation are those of its start.
    pub coordinates: [Coordinate; 4],
    /// Drive of a body that is moved by speeds; `None` for other bodies.
    pub drive: Option<Drive>,
    /// Shape of the base, centred at x, y and z. A ball of radius 0 is a point or, if the body has joints, no shape.
    pub shape: Shape,
    /// Joints of the body's arm, from the base to the tip; empty for most bodies.
    pub joints: Vec<Joint>,
    /// Position of the arm's tip, in metres in the frame of the last joint.
    pub tip: [f64; 3],
    /// Largest speed of the body's middle in any direction, in m/s; `None` for no limit.
    pub speed: Option<f64>,
    /// Largest acceleration of the body's middle in any direction, in m/s²; `None` for no limit.
    pub acceleration: Option<f64>,
}

/// How a body moves whose devices set speeds: forward along its yaw, and around its middle.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Drive {
    /// Meaning of the devices' speeds.
    pub steering: Steering,
    /// Pose at the beginning of the first act: x and y in metres, and yaw in radians.
    pub start: [f64; 3],
}

/// The speeds that drive a body. Here, the value of a coordinate is a speed, scaled from the device's unit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum Steering {
    /// Two wheels or tracks side by side. The body moves forward at the mean of their speeds. It turns at their difference divided by
    /// the distance between them.
    Wheels {
        /// Rolling speed of the left wheel, in m/s.
        left: Coordinate,
        /// Rolling speed of the right wheel, in m/s.
        right: Coordinate,
        /// Distance between the wheels, in metres.
        track: f64,
    },
    /// A forward speed and a turn rate, which the robot itself converts to wheel speeds.
    Twist {
        /// Forward speed, in m/s.
        speed: Coordinate,
        /// Turn rate from x to y, in rad/s.
        turn: Coordinate,
    },
}

/// A joint of an arm, with the link from this joint to the next one or to the tip.
///
/// The joint's frame is the frame of the previous link (for the first joint, that of the body, which turns with `yaw`), moved by `xyz`
/// and turned by `rpy`, as in URDF. The link is a capsule: all points within `radius` of the line to the next joint.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Joint {
    /// Name of the joint: that of its device, or of the joint in a URDF.
    pub name: String,
    /// Whether the joint turns or slides.
    pub kind: JointKind,
    /// Position of the joint, in metres in the frame of the previous link.
    pub xyz: [f64; 3],
    /// Roll, pitch and yaw of the joint's frame about the fixed axes x, y and z of the previous link, one after another, in radians.
    pub rpy: [f64; 3],
    /// Axis of rotation or translation, of length 1, in the joint's own frame.
    pub axis: [f64; 3],
    /// Rotation of the joint in radians, or its translation in metres.
    pub value: Coordinate,
    /// Radius about the link, in metres.
    pub radius: f64,
}

/// The kind of movement of a joint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum JointKind {
    /// The joint turns about its axis.
    #[default]
    Revolute,
    /// The joint slides along its axis.
    Prismatic,
}

/// The source of a coordinate's value.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum Coordinate {
    /// A constant value.
    Fixed(f64),
    /// `offset + scale * value of the device`
    Device {
        /// Id of the device on the robot.
        device: DeviceId,
        /// Metres, or radians, per unit of the device.
        scale: f64,
        /// Coordinate at the device's zero, in metres or radians.
        offset: f64,
    },
}

/// The shape of a body's base about its middle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Shape {
    /// A ball, or a point if the radius is 0.
    Ball {
        /// Radius in metres.
        radius: f64,
    },
    /// A box that turns with the body about the vertical.
    Box {
        /// Length, width and height in metres.
        size: [f64; 3],
    },
}

impl Shape {
    /// Returns the radius of the ball about the shape's middle that encloses the shape, in metres.
    pub fn outer_radius(&self) -> f64 {
        match *self {
            Self::Ball { radius } => radius,
            Self::Box { size: [x, y, z] } => x.hypot(y).hypot(z) / 2.0,
        }
    }

    /// Returns half of the shape's least width, in metres. However the shape is rotated, another body that is closer to its middle
    /// overlaps it.
    pub fn inner_radius(&self) -> f64 {
        match *self {
            Self::Ball { radius } => radius,
            Self::Box { size } => size.into_iter().fold(f64::INFINITY, f64::min) / 2.0,
        }
    }
}

/// The movements of bodies in an act; empty if the fleet file describes no bodies.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InSpace {
    /// The closest approach of two bodies; `None` if no two bodies have known places.
    pub closest: Option<Closest>,
    /// The largest speed and acceleration of each body.
    pub bodies: Vec<BodyUse>,
    /// The paths of bodies that are driven by speeds, for drawing.
    pub driven: Vec<DrivenPath>,
    /// Robots that play and whose place is never known in the act. While a robot's place is unknown, the other fields ignore the robot.
    pub unknown: Vec<RobotId>,
}

/// The path of a body that is driven by speeds. Between two points, the body moves evenly, with an accuracy of [`DrivenPath::DRAWN`].
#[derive(Clone, Debug, PartialEq)]
pub struct DrivenPath {
    /// Id of the robot.
    pub robot: RobotId,
    /// Poses along the path, in order of time.
    pub points: Vec<DrivenPoint>,
}

/// The pose of a body at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DrivenPoint {
    /// Time of the pose, since the act's start.
    pub at: Span,
    /// Pose of the body: x and y in metres, and yaw in radians.
    pub pose: [f64; 3],
}

impl DrivenPath {
    /// Largest deviation of a drawing of the path, in metres or radians. The checks follow the body more closely.
    pub const DRAWN: f64 = 2e-3;
}

/// The largest speed and acceleration of a body's middle in an act, in any direction.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BodyUse {
    /// Id of the robot.
    pub robot: RobotId,
    /// Largest speed in m/s. It does not include a possible increase by the rounding of steps.
    #[serde(rename = "speed_m_s")]
    pub speed: f64,
    /// Largest acceleration in m/s². It does not include a possible increase by the rounding of steps.
    #[serde(rename = "acceleration_m_s2")]
    pub acceleration: f64,
}

/// Factor by which a rate may exceed its limit because of rounding.
pub const DUST: f64 = 1.0 + 1e-6;

/// The closest approach of two bodies in an act.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Closest {
    /// Ids of the two robots.
    pub robots: [RobotId; 2],
    /// Time of the approach, since the act's start.
    #[serde(rename = "at_ms")]
    pub at: Span,
    /// Distance from surface to surface, in metres; 0 if the bodies touch or overlap.
    #[serde(rename = "distance_m")]
    pub distance: f64,
}

impl Space {
    /// Whether any limit of the space is set.
    #[must_use]
    pub fn is_checked(&self) -> bool {
        self.distance.is_some() || self.keep_in.is_some() || !self.keep_out.is_empty()
    }

    /// Returns the least permitted distance between the middles of any two of the given bodies, in metres. It depends on the inner radii
    /// of the two smallest ones.
    pub fn between_middles<'b>(&self, bodies: impl Iterator<Item = &'b Body>) -> f64 {
        let mut radii: Vec<f64> = bodies.map(|body| body.shape.inner_radius()).collect();
        radii.sort_unstable_by(f64::total_cmp);
        self.distance.unwrap_or(0.0) + radii.iter().take(2).sum::<f64>()
    }
}

/// The default is a point at the origin that never moves.
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
