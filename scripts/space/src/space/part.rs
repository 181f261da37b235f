//! The convex parts of a body at one moment: points, segments and boxes, each with a radius about it.

use parry3d_f64::math::{Pose, Vector};
use parry3d_f64::query::PointQuery;
use parry3d_f64::query::details::{
    ClosestPoints, closest_points_segment_segment, closest_points_support_map_support_map,
};
use parry3d_f64::shape::{Cuboid, Segment, SupportMap};

/// Distance in metres below which two cores (parts without their radii) touch, so that no direction separates them.
const TOUCH: f64 = 1e-12;

/// All points within a radius of a core, which form a ball, a capsule, or a box.
#[derive(Clone, Copy, Debug)]
pub(super) struct BodyPart {
    pub(super) core: Core,
    pub(super) radius: f64,
}

/// A part of a body without its radius.
#[derive(Clone, Copy, Debug)]
pub(super) enum Core {
    Point(Vector),
    Segment(Segment),
    Box(Pose, Cuboid),
}

/// The distance between two parts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gap {
    /// Distance from surface to surface, in metres; 0 if the parts touch or overlap.
    pub(super) distance: f64,
    /// Direction from the first core to the second, of length 1; `None` if the cores touch.
    pub(super) normal: Option<Vector>,
}

impl BodyPart {
    /// Returns the smallest and the largest coordinates of the core.
    pub(super) fn hull(&self) -> [Vector; 2] {
        match &self.core {
            Core::Point(point) => [*point; 2],
            Core::Segment(segment) => [segment.a.min(segment.b), segment.a.max(segment.b)],
            Core::Box(pose, cuboid) => {
                let along = |axis: Vector| support(pose, cuboid, axis).dot(axis);
                let most = Vector::new(along(Vector::X), along(Vector::Y), along(Vector::Z));
                [2.0 * pose.translation - most, most]
            }
        }
    }

    /// Returns the middle and the radius of a ball that encloses the part.
    fn ball(&self) -> (Vector, f64) {
        match &self.core {
            Core::Point(point) => (*point, self.radius),
            Core::Segment(segment) => {
                (segment.a.midpoint(segment.b), segment.a.distance(segment.b) / 2.0 + self.radius)
            }
            Core::Box(pose, cuboid) => (pose.translation, cuboid.half_extents.length() + self.radius),
        }
    }

    /// Returns the distance between the enclosing balls of two parts, which is a lower bound on the distance between the parts.
    pub(super) fn at_least(&self, other: &Self) -> f64 {
        let ((a, reach), (b, other_reach)) = (self.ball(), other.ball());
        (a.distance(b) - reach - other_reach).max(0.0)
    }

    /// Returns the distance between two parts along `normal`, a direction of length 1 from this part to the other. It is a lower bound
    /// on their distance.
    pub(super) fn apart(&self, other: &Self, normal: Vector) -> f64 {
        -other.furthest(-normal) - self.furthest(normal) - self.radius - other.radius
    }

    /// Returns the largest coordinate of the core along a direction of length 1.
    fn furthest(&self, direction: Vector) -> f64 {
        match &self.core {
            Core::Point(point) => point.dot(direction),
            Core::Segment(segment) => segment.a.dot(direction).max(segment.b.dot(direction)),
            Core::Box(pose, cuboid) => support(pose, cuboid, direction).dot(direction),
        }
    }

    pub(super) fn gap(&self, other: &Self) -> Gap {
        let Some([from, to]) = closest_points(&self.core, &other.core) else {
            return Gap { distance: 0.0, normal: None };
        };
        let apart = (to - from).length();
        let normal = (apart > TOUCH).then(|| (to - from) / apart);
        Gap { distance: (apart - self.radius - other.radius).max(0.0), normal }
    }
}

fn support(pose: &Pose, cuboid: &Cuboid, direction: Vector) -> Vector {
    pose.transform_point(cuboid.local_support_point(pose.rotation.inverse() * direction))
}

/// Returns the points at which two cores are closest to each other; `None` if they overlap.
fn closest_points(a: &Core, b: &Core) -> Option<[Vector; 2]> {
    match (a, b) {
        (Core::Point(a), Core::Point(b)) => Some([*a, *b]),
        (Core::Point(a), Core::Segment(b)) => Some([*a, on_segment(b, *a)]),
        (Core::Segment(a), Core::Point(b)) => Some([on_segment(a, *b), *b]),
        (Core::Segment(a), Core::Segment(b)) => of_segments(a, b),
        (Core::Point(a), Core::Box(pose, b)) => Some([*a, b.project_point(pose, *a, true).point]),
        (Core::Box(pose, a), Core::Point(b)) => Some([a.project_point(pose, *b, true).point, *b]),
        // Not `query::distance`: its result for two cuboids is too large by up to half of their size (parry3d 0.31.1).
        (Core::Box(pose, a), Core::Box(other, b)) => of_supports(pose, a, other, b),
        (Core::Segment(a), Core::Box(pose, b)) => of_supports(&Pose::identity(), a, pose, b),
        (Core::Box(pose, a), Core::Segment(b)) => of_supports(pose, a, &Pose::identity(), b),
    }
}

fn on_segment(segment: &Segment, point: Vector) -> Vector {
    let way = segment.b - segment.a;
    let squared = way.length_squared();
    let share = if squared > 0.0 { (point - segment.a).dot(way) / squared } else { 0.0 };
    segment.a + share.clamp(0.0, 1.0) * way
}

fn of_segments(a: &Segment, b: &Segment) -> Option<[Vector; 2]> {
    match closest_points_segment_segment(&Pose::identity(), a, b, f64::MAX) {
        ClosestPoints::WithinMargin(a, b) => Some([a, b]),
        ClosestPoints::Intersecting | ClosestPoints::Disjoint => None,
    }
}

fn of_supports(
    pose_a: &Pose,
    a: &impl SupportMap,
    pose_b: &Pose,
    b: &impl SupportMap,
) -> Option<[Vector; 2]> {
    match closest_points_support_map_support_map(&pose_a.inv_mul(pose_b), a, b, f64::MAX) {
        ClosestPoints::WithinMargin(a, b) => Some([pose_a.transform_point(a), pose_b.transform_point(b)]),
        ClosestPoints::Intersecting | ClosestPoints::Disjoint => None,
    }
}
