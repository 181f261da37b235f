//! An arm: the places of its links, and upper bounds on the movement and curvature of their points while its joints move linearly.
//!
//! A joint's frame is the frame of the previous link, moved by `xyz` and turned by `rpy` about fixed axes. The joint then turns about
//! its `axis`, or slides along it, as in URDF (<http://wiki.ros.org/urdf/XML/joint>).

use parry3d_f64::math::{Pose, Rotation, Vector};

use super::place::Place;
use super::{Joint, JointKind};

/// The links and the tip of an arm, without the values of its joints.
#[derive(Clone, Debug, Default)]
pub(super) struct Chain {
    links: Vec<Link>,
    tip: Vector,
}

#[derive(Clone, Debug)]
struct Link {
    kind: JointKind,
    origin: Pose,
    axis: Vector,
    radius: f64,
}

/// Upper bounds on the movement of a point between two places, relative to the base of the point's body.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sway {
    /// Length of the point's path, in metres.
    pub(super) length: f64,
    /// Second derivative of the point's position with respect to the share of the movement (from 0 to 1), in metres.
    pub(super) bend: f64,
}

impl Chain {
    pub(super) fn of(joints: &[Joint], tip: [f64; 3]) -> Self {
        let link = |joint: &Joint| Link {
            kind: joint.kind,
            origin: Pose::from_parts(Vector::from_array(joint.xyz), rotation(joint.rpy)),
            axis: Vector::from_array(joint.axis),
            radius: joint.radius,
        };
        Self { links: joints.iter().map(link).collect(), tip: Vector::from_array(tip) }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.links.is_empty()
    }

    /// Returns the radius about each link, in metres.
    pub(super) fn radii(&self) -> impl Iterator<Item = f64> + '_ {
        self.links.iter().map(|link| link.radius)
    }

    /// Returns the largest possible distance of the tip or a joint from the base, in metres. `largest` contains the largest absolute
    /// value of each joint.
    pub(super) fn reach(&self, largest: &[f64]) -> f64 {
        let far = |(link, value): (&Link, &f64)| {
            let slides = if link.kind == JointKind::Prismatic { *value } else { 0.0 };
            link.origin.translation.length() + slides
        };
        self.tip.length() + self.links.iter().zip(largest).map(far).sum::<f64>()
    }

    /// Returns the positions of all joints and of the tip; empty if the arm has no joints.
    pub(super) fn points(&self, place: &Place) -> Vec<Vector> {
        if self.is_empty() {
            return Vec::new();
        }
        let mut points = Vec::with_capacity(self.links.len() + 1);
        let mut pose = base(place);
        for (link, value) in self.links.iter().zip(&place.joints) {
            pose *= link.origin;
            points.push(pose.translation);
            pose *= link.motion(*value);
        }
        points.push(pose.transform_point(self.tip));
        points
    }

    /// Returns upper bounds on the movement of each link's points between two places. They are the larger bounds of the link's two ends.
    ///
    /// Let a point `p` depend on joints `i`, which turn about axes `z` through their origins `o`. Then `dp/di = z × (p - o)`. The second
    /// derivative by joints `i` and `j`, where `j` is the outer one, is `z_i × (z_j × (p - o_j))`, or `z_i × z_j` if `j` slides
    /// (Siciliano and others, Robotics, 2009, section 3.1). Parts of the arm between joints that do not move keep their lengths.
    pub(super) fn sways(&self, from: &Place, to: &Place) -> Vec<Sway> {
        if self.is_empty() {
            return Vec::new();
        }
        let ends = [self.points(from), self.points(to)];
        let origins = [from, to].map(|place| base(place).translation);
        let mut moving = Moving::default();
        moving.add(Turn { by: to.base[3] - from.base[3], kind: JointKind::Revolute, at: origins });
        let at = |k: usize| ends.each_ref().map(|points| points[k]);
        let mut sways = Vec::with_capacity(self.links.len());
        for (k, link) in self.links.iter().enumerate() {
            let near = moving.sway(at(k));
            moving.add(Turn { by: to.joints[k] - from.joints[k], kind: link.kind, at: at(k) });
            sways.push(near.or(moving.sway(at(k + 1))));
        }
        sways
    }
}

impl Sway {
    /// Returns the larger length and the larger bend of the two.
    fn or(self, other: Self) -> Self {
        Self { length: self.length.max(other.length), bend: self.bend.max(other.bend) }
    }
}

impl Link {
    fn motion(&self, value: f64) -> Pose {
        match self.kind {
            JointKind::Revolute => Pose::from_rotation(Rotation::from_axis_angle(self.axis, value)),
            JointKind::Prismatic => Pose::from_translation(value * self.axis),
        }
    }
}

/// A joint that moves between two places of its body.
#[derive(Clone, Copy, Debug)]
struct Turn {
    by: f64,
    kind: JointKind,
    /// Position of the joint at both ends of the movement.
    at: [Vector; 2],
}

/// The joints that move between two places, starting at the base.
#[derive(Default)]
struct Moving {
    turns: Vec<Turn>,
}

impl Moving {
    fn add(&mut self, turn: Turn) {
        if turn.by != 0.0 {
            self.turns.push(turn);
        }
    }

    /// Returns the bounds for a point beyond all of these joints, given its positions at both ends of the movement.
    fn sway(&self, mut point: [Vector; 2]) -> Sway {
        let mut before: f64 = self.turning().sum();
        let (mut sway, mut reach) = (Sway::default(), 0.0);
        for turn in self.turns.iter().rev() {
            // Only the joint of this turn changes this distance, which is constant, or convex if the joint slides.
            reach += (0..2).map(|end| point[end].distance(turn.at[end])).fold(0.0, f64::max);
            let by = turn.by.abs();
            match turn.kind {
                JointKind::Revolute => {
                    before -= by;
                    sway.length += by * reach;
                    sway.bend += by * reach * (by + 2.0 * before.max(0.0));
                }
                JointKind::Prismatic => {
                    sway.length += by;
                    sway.bend += 2.0 * by * before.max(0.0);
                }
            }
            point = turn.at;
        }
        sway
    }

    fn turning(&self) -> impl Iterator<Item = f64> + '_ {
        self.turns.iter().filter(|turn| turn.kind == JointKind::Revolute).map(|turn| turn.by.abs())
    }
}

pub(super) fn base(place: &Place) -> Pose {
    let [x, y, z, yaw] = place.base;
    Pose::from_parts(Vector::new(x, y, z), Rotation::from_rotation_z(yaw))
}

/// Returns the rotation by roll about x, then by pitch about y, then by yaw about z, where all axes are fixed.
fn rotation([roll, pitch, yaw]: [f64; 3]) -> Rotation {
    Rotation::from_rotation_z(yaw) * Rotation::from_rotation_y(pitch) * Rotation::from_rotation_x(roll)
}
