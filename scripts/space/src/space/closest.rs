//! The closest approach of two bodies during an act, also at times between their steps.
//!
//! A tree of boxes over time contains each body: the root covers the whole act, its children one half each, and so on. The search
//! follows a pair of bodies only into times in which their boxes are closer than the best approach so far (branch and bound). Within a
//! leaf, the coordinates of both bodies change linearly from knot to knot. There, `way` bounds the distance, down to an accuracy of a
//! tenth of a millimetre. For two balls, a closed form gives the distance.

use parry3d_f64::math::Vector;

use super::path::{self, Knot, Path};
use super::solid::Solid;
use super::way::{Best, PairMovement};

/// Approximate number of knots per leaf of the tree.
const LEAF: usize = 8;
const DEPTH_MAX: u32 = 12;

/// The closest approach of two bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Approach {
    /// Time of the closest approach, in seconds since the act's start.
    pub at: f64,
    /// Distance from surface to surface, in metres.
    pub distance: f64,
}

/// A moving body, with the boxes that contain its parts over time.
#[derive(Clone, Debug)]
pub struct Mover {
    path: Path,
    solid: Solid,
    /// Boxes in heap order: 1 is the root, 2n and 2n + 1 are the halves of n. While the body's place is unknown, boxes are empty.
    boxes: Vec<Held>,
    depth: u32,
    ends: f64,
}

/// A box that contains the cores of a body's parts (the parts without their radii) over some time.
#[derive(Clone, Copy, Debug)]
struct Held {
    least: [f64; 3],
    most: [f64; 3],
}

impl Held {
    const NOTHING: Self = Self { least: [f64::INFINITY; 3], most: [f64::NEG_INFINITY; 3] };

    fn with(mut self, least: &[f64; 3], most: &[f64; 3]) -> Self {
        for i in 0..3 {
            self.least[i] = self.least[i].min(least[i]);
            self.most[i] = self.most[i].max(most[i]);
        }
        self
    }

    /// Extends the box by everything that the cores of a body's parts (the parts without their radii) pass between two knots.
    fn passing(self, solid: &Solid, from: &Knot, to: &Knot) -> Self {
        if solid.ball().is_some() {
            let middles = [from, to].map(|knot| [0, 1, 2].map(|i| knot.place.base[i]));
            return middles.iter().fold(self, |held, middle| held.with(middle, middle));
        }
        // A point of a path is at most half of the path's length away from one of the ends. It deviates from the straight line by at
        // most an eighth of the bend.
        let sways = solid.sways(&from.place, &to.place);
        let aside = sways.iter().map(|sway| (sway.length / 2.0).min(sway.bend / 8.0)).fold(0.0, f64::max);
        let parts = [from, to].into_iter().flat_map(|knot| solid.parts(&knot.place));
        parts.map(|part| part.hull()).fold(self, |held, [least, most]| {
            held.with(&(least - Vector::splat(aside)).to_array(), &(most + Vector::splat(aside)).to_array())
        })
    }

    /// Returns the distance between two boxes; infinite if one of them is empty.
    fn distance(&self, other: &Self) -> f64 {
        let apart = |i: usize| (self.least[i] - other.most[i]).max(other.least[i] - self.most[i]).max(0.0);
        (0..3).map(|i| apart(i).powi(2)).sum::<f64>().sqrt()
    }
}

/// Returns the depth of the trees for paths with at most this number of knots. All bodies of an act have trees of the same depth.
pub fn depth(knots: usize) -> u32 {
    (knots / LEAF).max(1).ilog2().min(DEPTH_MAX)
}

impl Mover {
    /// Creates the mover for an act that lasts `ends` seconds.
    pub fn new(path: Path, solid: Solid, ends: f64, depth: u32) -> Self {
        let leaves = 1_usize << depth;
        let mut boxes = vec![Held::NOTHING; 2 * leaves];
        for leaf in 0..leaves {
            let (from, to) = (time(leaf, leaves, ends), time(leaf + 1, leaves, ends));
            let from = from.max(path.known_from());
            if from <= to {
                let knots: Vec<Knot> = path.within(from, to).collect();
                // A single knot is treated as a movement without change.
                let ways = knots.iter().zip(knots.iter().skip(1).chain(knots.last()));
                boxes[leaves + leaf] =
                    ways.fold(Held::NOTHING, |held, (from, to)| held.passing(&solid, from, to));
            }
        }
        for node in (1..leaves).rev() {
            let (a, b) = (boxes[2 * node], boxes[2 * node + 1]);
            boxes[node] = a.with(&b.least, &b.most);
        }
        Self { path, solid, boxes, depth, ends }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn solid(&self) -> &Solid {
        &self.solid
    }
}

fn time(leaf: usize, leaves: usize, ends: f64) -> f64 {
    ends * leaf as f64 / leaves as f64
}

/// Returns the closest approach of two bodies if its distance is less than `below`. Both trees must have the same depth.
pub fn closest(a: &Mover, b: &Mover, below: f64) -> Option<Approach> {
    debug_assert_eq!((a.depth, a.ends), (b.depth, b.ends));
    let best = Best { approach: Approach { at: f64::NAN, distance: below }, found: false };
    let mut search = Search { a, b, best };
    search.node(1);
    search.best.found.then_some(search.best.approach)
}

struct Search<'a> {
    a: &'a Mover,
    b: &'a Mover,
    best: Best,
}

impl Search<'_> {
    fn least(&self, node: usize) -> f64 {
        self.a.boxes[node].distance(&self.b.boxes[node]) - self.a.solid.reach() - self.b.solid.reach()
    }

    fn node(&mut self, node: usize) {
        let leaves = self.a.boxes.len() / 2;
        let best = self.best.approach.distance;
        if best <= 0.0 || self.least(node) >= best {
            return;
        }
        if node >= leaves {
            return self.leaf(node - leaves, leaves);
        }
        // The closer half first: its result may exclude the other half.
        let mut halves = [2 * node, 2 * node + 1];
        if self.least(halves[1]) < self.least(halves[0]) {
            halves.reverse();
        }
        halves.into_iter().for_each(|half| self.node(half));
    }

    fn leaf(&mut self, leaf: usize, leaves: usize) {
        let moments = moments(self.a, self.b, leaf, leaves);
        for pair in moments.windows(2) {
            PairMovement::new([&self.a.solid, &self.b.solid], &pair[0], &pair[1]).closest(&mut self.best);
        }
    }
}

/// Returns the moments at which one of the bodies has a knot, within one leaf (the shortest interval of the tree), in order of time.
fn moments(a: &Mover, b: &Mover, leaf: usize, leaves: usize) -> Vec<path::Both> {
    let from = time(leaf, leaves, a.ends).max(a.path.known_from()).max(b.path.known_from());
    let mut moments = path::together(&a.path, &b.path, from, time(leaf + 1, leaves, a.ends));
    // A single moment, for example if nothing moves, is treated as a movement without change.
    if let [only] = moments.as_slice() {
        moments.push(only.clone());
    }
    moments
}

/// Returns the time of the first contact of two bodies, in seconds; a contact that overlaps by less than a tenth of a millimetre may be
/// missed.
pub fn first_contact(a: &Mover, b: &Mover) -> Option<f64> {
    contact_in(a, b, 1)
}

fn contact_in(a: &Mover, b: &Mover, node: usize) -> Option<f64> {
    let leaves = a.boxes.len() / 2;
    if a.boxes[node].distance(&b.boxes[node]) > a.solid.reach() + b.solid.reach() {
        return None;
    }
    if node < leaves {
        return contact_in(a, b, 2 * node).or_else(|| contact_in(a, b, 2 * node + 1));
    }
    let moments = moments(a, b, node - leaves, leaves);
    moments
        .windows(2)
        .find_map(|pair| PairMovement::new([&a.solid, &b.solid], &pair[0], &pair[1]).first_contact())
}
