//! What a body consists of: a ball or a box about its base, and the links of its arm.

use parry3d_f64::math::Vector;
use parry3d_f64::shape::{Cuboid, Segment};

use super::chain::{Chain, Sway, base};
use super::part::{Core, Part};
use super::place::Place;
use super::{Body, Shape, Volume};

/// Where a volume has no side, it is taken to be this far away, in metres.
const FAR: f64 = 1e5;

/// A body without its place.
#[derive(Clone, Debug)]
pub struct Solid {
    /// None where all of the body is its arm.
    base: Option<Shape>,
    chain: Chain,
    /// How far all of it may be off, in metres.
    margin: f64,
}

impl Solid {
    /// `margin`: how far all of it may be off from its path, in metres; it counts as so much larger.
    pub fn of(body: &Body, margin: f64) -> Self {
        let is_nothing = matches!(body.shape, Shape::Ball { radius } if radius <= 0.0);
        let base = Some(body.shape).filter(|_| !is_nothing || body.joints.is_empty());
        Self { base, chain: Chain::of(&body.joints, body.tip), margin }
    }

    /// A volume as a body that stays where it is.
    pub fn of_volume(volume: &Volume) -> (Self, Place) {
        let least = volume.least.map(|side| side.max(-FAR));
        let most = volume.most.map(|side| side.min(FAR));
        let size = std::array::from_fn(|i| most[i] - least[i]);
        let middle = |i| f64::midpoint(least[i], most[i]);
        let solid = Self { base: Some(Shape::Box { size }), chain: Chain::default(), margin: 0.0 };
        (solid, Place::of([middle(0), middle(1), middle(2), 0.0]))
    }

    /// Its radius if it is nothing but a ball.
    pub(super) fn ball(&self) -> Option<f64> {
        match self.base {
            Some(Shape::Ball { radius }) if self.chain.is_empty() => Some(radius + self.margin),
            _ => None,
        }
    }

    /// The largest radius about a core of its parts.
    pub(super) fn reach(&self) -> f64 {
        let ball = match self.base {
            Some(Shape::Ball { radius }) => radius,
            _ => 0.0,
        };
        self.margin + self.chain.radii().fold(ball, f64::max)
    }

    /// How far its cores are from the vertical line through its middle at most, in metres, if no joint goes further than these
    /// values, either way.
    pub fn lever(&self, largest: &[f64]) -> f64 {
        self.base.map_or(0.0, Shape::lever).max(self.chain.reach(largest))
    }

    /// All of it: first its base, then the links from the base to the tip.
    pub(super) fn parts(&self, place: &Place) -> Vec<Part> {
        let shape = self.base.map(|shape| shape.part(place));
        let points = self.chain.points(place);
        let link = |(ends, radius): (&[Vector], f64)| {
            let core = Core::Segment(Segment::new(ends[0], ends[1]));
            Part { core, radius }
        };
        let parts = shape.into_iter().chain(points.windows(2).zip(self.chain.radii()).map(link));
        parts.map(|part| Part { radius: part.radius + self.margin, ..part }).collect()
    }

    /// How the points of each part move at most between two places, beyond what x, y and z of the base move.
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
    fn part(self, place: &Place) -> Part {
        let pose = base(place);
        match self {
            Self::Ball { radius } => Part { core: Core::Point(pose.translation), radius },
            Self::Box { size } => {
                Part { core: Core::Box(pose, Cuboid::new(Vector::from_array(size) / 2.0)), radius: 0.0 }
            }
        }
    }

    /// How far a point of it moves at most while it turns by one radian about z.
    fn lever(self) -> f64 {
        match self {
            Self::Ball { .. } => 0.0,
            Self::Box { size: [length, width, _] } => length.hypot(width) / 2.0,
        }
    }
}
