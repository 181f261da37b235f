//! The solid of a body: a ball or a box about its base, and the links of its arm.

use parry3d_f64::math::Vector;
use parry3d_f64::shape::{Cuboid, Segment};

use super::chain::{Chain, Sway, base};
use super::part::{BodyPart, Core};
use super::place::Place;
use super::{Body, Shape, Volume};

/// Distance in metres at which a volume ends on a side without a limit.
const FAR: f64 = 1e5;

/// The shape of a body with its arm, at any place.
#[derive(Clone, Debug)]
pub struct Solid {
    /// Shape of the base; `None` if the body consists only of its arm.
    base: Option<Shape>,
    chain: Chain,
    /// Possible deviation of the whole body from its path, in metres; it enlarges the body.
    margin: f64,
}

impl Solid {
    /// Creates the solid of a body. `margin` is the possible deviation of the body from its path, in metres, which enlarges the solid.
    pub fn of(body: &Body, margin: f64) -> Self {
        let is_nothing = matches!(body.shape, Shape::Ball { radius } if radius <= 0.0);
        let base = Some(body.shape).filter(|_| !is_nothing || body.joints.is_empty());
        Self { base, chain: Chain::of(&body.joints, body.tip), margin }
    }

    /// Turns a volume into a stationary solid.
    pub fn of_volume(volume: &Volume) -> (Self, Place) {
        let least = volume.least.map(|side| side.max(-FAR));
        let most = volume.most.map(|side| side.min(FAR));
        let size = std::array::from_fn(|i| most[i] - least[i]);
        let middle = |i| f64::midpoint(least[i], most[i]);
        let solid = Self { base: Some(Shape::Box { size }), chain: Chain::default(), margin: 0.0 };
        (solid, Place::of([middle(0), middle(1), middle(2), 0.0]))
    }

    /// Returns the radius if the body is only a ball; `None` for other bodies.
    pub(super) fn ball(&self) -> Option<f64> {
        match self.base {
            Some(Shape::Ball { radius }) if self.chain.is_empty() => Some(radius + self.margin),
            _ => None,
        }
    }

    /// Returns the largest radius of the body's parts, in metres. A part consists of all points within its radius of a core.
    pub(super) fn reach(&self) -> f64 {
        let ball = match self.base {
            Some(Shape::Ball { radius }) => radius,
            _ => 0.0,
        };
        self.margin + self.chain.radii().fold(ball, f64::max)
    }

    /// Returns the largest distance of the cores (the body's parts without their radii) from the vertical line through the body's middle,
    /// in metres. `largest` contains the largest absolute value of each joint.
    pub fn lever(&self, largest: &[f64]) -> f64 {
        self.base.map_or(0.0, Shape::lever).max(self.chain.reach(largest))
    }

    /// Returns all parts of the body at a place: the base first, then the links from the base to the tip.
    pub(super) fn parts(&self, place: &Place) -> Vec<BodyPart> {
        let shape = self.base.map(|shape| shape.part(place));
        let points = self.chain.points(place);
        let link = |(ends, radius): (&[Vector], f64)| {
            let core = Core::Segment(Segment::new(ends[0], ends[1]));
            BodyPart { core, radius }
        };
        let parts = shape.into_iter().chain(points.windows(2).zip(self.chain.radii()).map(link));
        parts.map(|part| BodyPart { radius: part.radius + self.margin, ..part }).collect()
    }

    /// Returns upper bounds on the movement of each part's points between two places, in addition to the movement of the base in x, y
    /// and z.
    pub(super) fn sways(&self, from: &Place, to: &Place) -> Vec<Sway> {
        let turned = (to.base[3] - from.base[3]).abs();
        let shape = self.base.map(|shape| {
            let lever = shape.lever();
            Sway { length: lever * turned, bend: lever * turned * turned }
        });
        shape.into_iter().chain(self.chain.sways(from, to)).collect()
    }
}

impl Shape {
    fn part(self, place: &Place) -> BodyPart {
        let pose = base(place);
        match self {
            Self::Ball { radius } => BodyPart { core: Core::Point(pose.translation), radius },
            Self::Box { size } => {
                BodyPart { core: Core::Box(pose, Cuboid::new(Vector::from_array(size) / 2.0)), radius: 0.0 }
            }
        }
    }

    /// Returns the largest movement of a point of the shape while the shape turns by one radian about z, in metres.
    fn lever(self) -> f64 {
        match self {
            Self::Ball { .. } => 0.0,
            Self::Box { size: [length, width, _] } => length.hypot(width) / 2.0,
        }
    }
}
