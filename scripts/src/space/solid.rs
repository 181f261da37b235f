//! The size of a body, as the distances between bodies need it.

use parry3d_f64::math::{Pose, Rotation, Vector};
use parry3d_f64::query::PointQuery;
use parry3d_f64::query::details::distance_support_map_support_map;
use parry3d_f64::shape::{Ball, Cuboid};

use super::{Shape, Volume};

/// Where a volume has no side, it is taken to be this far away, in metres.
const FAR: f64 = 1e5;

/// A body without its place.
#[derive(Clone, Debug)]
pub(crate) enum Solid {
    Ball(Ball),
    Box(Cuboid),
}

impl Solid {
    pub(crate) fn of(shape: &Shape) -> Self {
        match shape {
            Shape::Ball { radius } => Self::Ball(Ball::new(*radius)),
            Shape::Box { size: [x, y, z] } => Self::Box(Cuboid::new(Vector::new(*x, *y, *z) / 2.0)),
        }
    }

    /// A volume as a body that stays where it is.
    pub(crate) fn of_volume(volume: &Volume) -> (Self, [f64; 4]) {
        let least = volume.least.map(|side| side.max(-FAR));
        let most = volume.most.map(|side| side.min(FAR));
        let size = std::array::from_fn(|i| most[i] - least[i]);
        let middle = |i| f64::midpoint(least[i], most[i]);
        (Self::of(&Shape::Box { size }), [middle(0), middle(1), middle(2), 0.0])
    }

    /// The radius of a ball about its middle that holds all of it.
    pub(super) fn reach(&self) -> f64 {
        match self {
            Self::Ball(ball) => ball.radius,
            Self::Box(cuboid) => cuboid.half_extents.length(),
        }
    }

    /// How far a point of it moves at most while it turns by one radian about z.
    pub(super) fn lever(&self) -> f64 {
        match self {
            Self::Ball(_) => 0.0,
            Self::Box(cuboid) => cuboid.half_extents.x.hypot(cuboid.half_extents.y),
        }
    }

    /// Half of its extent along x, y and z when it has turned by this angle about z.
    pub(super) fn extent(&self, yaw: f64) -> [f64; 3] {
        match self {
            Self::Ball(ball) => [ball.radius; 3],
            Self::Box(cuboid) => {
                let (half, (sin, cos)) = (cuboid.half_extents, yaw.sin_cos());
                let along = |a: f64, b: f64| half.x * a.abs() + half.y * b.abs();
                [along(cos, sin), along(sin, cos), half.z]
            }
        }
    }
}

fn from_ball(ball: &Ball, at: &[f64; 4], cuboid: &Cuboid, at_cuboid: &[f64; 4]) -> f64 {
    let middle = Vector::new(at[0], at[1], at[2]);
    (cuboid.distance_to_point(&pose(at_cuboid), middle, true) - ball.radius).max(0.0)
}

fn pose(place: &[f64; 4]) -> Pose {
    Pose::from_parts(Vector::new(place[0], place[1], place[2]), Rotation::from_rotation_z(place[3]))
}

/// From surface to surface; 0 where two bodies touch or overlap.
pub(super) fn distance((a, at_a): (&Solid, &[f64; 4]), (b, at_b): (&Solid, &[f64; 4])) -> f64 {
    match (a, b) {
        (Solid::Ball(a), Solid::Ball(b)) => {
            let way: [f64; 3] = std::array::from_fn(|i| at_b[i] - at_a[i]);
            (way.iter().map(|way| way * way).sum::<f64>().sqrt() - a.radius - b.radius).max(0.0)
        }
        // Not `query::distance`: what it does with two cuboids is too long by up to half their size (parry3d 0.31.1).
        (Solid::Box(a), Solid::Box(b)) => {
            distance_support_map_support_map(&pose(at_a).inv_mul(&pose(at_b)), a, b)
        }
        (Solid::Ball(ball), Solid::Box(cuboid)) => from_ball(ball, at_a, cuboid, at_b),
        (Solid::Box(cuboid), Solid::Ball(ball)) => from_ball(ball, at_b, cuboid, at_a),
    }
}
