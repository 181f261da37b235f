//! The closest approach of two bodies over an act, also between their steps.
//!
//! A tree of boxes over time holds each body: the root over the whole act, two halves below it, and so on. A pair is followed
//! only into times in which their boxes come closer than the best that is known (branch and bound). Within a leaf both bodies
//! move linearly from knot to knot; there the distance changes by no more than the ways of their points, which bounds it from
//! below between any two moments (Lipschitz), until it is known to a tenth of a millimetre. Two balls have a closed form.

use super::path::{Knot, Path};
use super::solid::{Solid, distance};
use super::{Volume, path};

/// Distances are known to this, in metres, or to this share of the way between two steps if that is more: nobody waits for bodies
/// that move by hundreds of kilometres at once.
const EXACT: f64 = 1e-4;
const SHARE: f64 = 1e-5;
/// A box that turns is looked at so often between two knots, in radians and at most.
const TURN: f64 = 0.02;
const LOOKS_MAX: f64 = 1e4;
/// Knots in a leaf of the tree, about.
const LEAF: usize = 8;
const DEPTH_MAX: u32 = 12;

/// The closest of something.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Approach {
    /// In seconds from the act's start.
    pub(crate) at: f64,
    /// In metres.
    pub(crate) distance: f64,
}

/// A body that moves, with the boxes that hold its middle.
#[derive(Clone, Debug)]
pub(crate) struct Mover {
    path: Path,
    solid: Solid,
    /// In the order of a heap: 1 is the root, 2n and 2n + 1 are the halves of n. Empty where nothing is known.
    boxes: Vec<Held>,
    depth: u32,
    ends: f64,
}

/// A box that holds the middle of a body over some time.
#[derive(Clone, Copy, Debug)]
struct Held {
    least: [f64; 3],
    most: [f64; 3],
}

impl Held {
    const NOTHING: Self = Self { least: [f64::INFINITY; 3], most: [f64::NEG_INFINITY; 3] };

    fn with(mut self, least: &[f64], most: &[f64]) -> Self {
        for i in 0..3 {
            self.least[i] = self.least[i].min(least[i]);
            self.most[i] = self.most[i].max(most[i]);
        }
        self
    }

    /// Infinite if one of them holds nothing.
    fn distance(&self, other: &Self) -> f64 {
        let apart = |i: usize| (self.least[i] - other.most[i]).max(other.least[i] - self.most[i]).max(0.0);
        (0..3).map(|i| apart(i).powi(2)).sum::<f64>().sqrt()
    }
}

/// How deep trees are for paths of so many knots. All bodies of an act have trees of one depth.
pub(crate) fn depth(knots: usize) -> u32 {
    (knots / LEAF).max(1).ilog2().min(DEPTH_MAX)
}

impl Mover {
    /// Over an act that lasts until `ends`, in seconds.
    pub(crate) fn new(path: Path, solid: Solid, ends: f64, depth: u32) -> Self {
        let leaves = 1_usize << depth;
        let mut boxes = vec![Held::NOTHING; 2 * leaves];
        for leaf in 0..leaves {
            let (from, to) = (time(leaf, leaves, ends), time(leaf + 1, leaves, ends));
            let from = from.max(path.known_from());
            if from <= to {
                boxes[leaves + leaf] = path
                    .within(from, to)
                    .fold(Held::NOTHING, |held, knot| held.with(&knot.place[..3], &knot.place[..3]));
            }
        }
        for node in (1..leaves).rev() {
            let (a, b) = (boxes[2 * node], boxes[2 * node + 1]);
            boxes[node] = a.with(&b.least, &b.most);
        }
        Self { path, solid, boxes, depth, ends }
    }
}

fn time(leaf: usize, leaves: usize, ends: f64) -> f64 {
    ends * leaf as f64 / leaves as f64
}

/// The closest that two bodies come, if that is less than `below`. Both have trees of one depth.
pub(crate) fn closest(a: &Mover, b: &Mover, below: f64) -> Option<Approach> {
    debug_assert_eq!((a.depth, a.ends), (b.depth, b.ends));
    let mut search = Search { a, b, best: Approach { at: f64::NAN, distance: below }, found: false };
    search.node(1);
    search.found.then_some(search.best)
}

struct Search<'a> {
    a: &'a Mover,
    b: &'a Mover,
    best: Approach,
    found: bool,
}

impl Search<'_> {
    fn least(&self, node: usize) -> f64 {
        self.a.boxes[node].distance(&self.b.boxes[node]) - self.a.solid.reach() - self.b.solid.reach()
    }

    fn node(&mut self, node: usize) {
        let leaves = self.a.boxes.len() / 2;
        if self.best.distance <= 0.0 || self.least(node) >= self.best.distance {
            return;
        }
        if node >= leaves {
            return self.leaf(node - leaves, leaves);
        }
        // The better half first: it may rule the other one out.
        let mut halves = [2 * node, 2 * node + 1];
        if self.least(halves[1]) < self.least(halves[0]) {
            halves.reverse();
        }
        halves.into_iter().for_each(|half| self.node(half));
    }

    fn leaf(&mut self, leaf: usize, leaves: usize) {
        for way in ways(self.a, self.b, leaf, leaves) {
            self.way(&way);
        }
    }

    fn way(&mut self, way: &Way<'_>) {
        let mut note = |s: f64, distance: f64| {
            if distance < self.best.distance {
                self.best = Approach { at: way.time(s), distance };
                self.found = true;
            }
            self.best.distance
        };
        let nearest = way.middles_are_nearest();
        if way.is_of_balls() {
            note(nearest, way.gap(nearest));
            return;
        }
        let parts = [0.0, nearest, 1.0].map(|s| (s, way.gap(s)));
        for (s, gap) in parts {
            note(s, gap);
        }
        for pair in parts.windows(2) {
            narrow((pair[0], pair[1]), way, &mut note);
        }
    }
}

/// Two bodies from one moment to the next, between which both move linearly.
struct Way<'a> {
    solids: [&'a Solid; 2],
    from: path::Both,
    to: path::Both,
    /// How much the distance changes at most, over the whole way.
    steepest: f64,
}

/// Within a leaf, in order of time.
fn ways<'a>(a: &'a Mover, b: &'a Mover, leaf: usize, leaves: usize) -> Vec<Way<'a>> {
    let from = time(leaf, leaves, a.ends).max(a.path.known_from()).max(b.path.known_from());
    let to = time(leaf + 1, leaves, a.ends);
    let moments = path::together(&a.path, &b.path, from, to);
    moments.windows(2).map(|pair| Way::new([&a.solid, &b.solid], pair[0], pair[1])).collect()
}

impl<'a> Way<'a> {
    fn new(solids: [&'a Solid; 2], from: path::Both, to: path::Both) -> Self {
        let mut way = Self { solids, from, to, steepest: 0.0 };
        let (begin, end) = (way.relative(&from), way.relative(&to));
        let moved: f64 = begin.iter().zip(&end).map(|(begin, end)| (end - begin).powi(2)).sum();
        let turned = |body: usize| (to.places[body][3] - from.places[body][3]).abs();
        way.steepest = moved.sqrt() + solids[0].lever() * turned(0) + solids[1].lever() * turned(1);
        way
    }

    fn is_of_balls(&self) -> bool {
        matches!(self.solids, [Solid::Ball(_), Solid::Ball(_)])
    }

    fn relative(&self, both: &path::Both) -> [f64; 3] {
        std::array::from_fn(|i| both.places[1][i] - both.places[0][i])
    }

    /// At a share of the way.
    fn gap(&self, s: f64) -> f64 {
        let [at_a, at_b] =
            std::array::from_fn(|body| mixed(&self.from.places[body], &self.to.places[body], s));
        distance((self.solids[0], &at_a), (self.solids[1], &at_b))
    }

    fn time(&self, s: f64) -> f64 {
        self.from.at + s * (self.to.at - self.from.at)
    }

    fn middles_are_nearest(&self) -> f64 {
        let (begin, end) = (self.relative(&self.from), self.relative(&self.to));
        let way: [f64; 3] = std::array::from_fn(|i| end[i] - begin[i]);
        let squared = way.iter().map(|way| way * way).sum::<f64>();
        let towards = begin.iter().zip(&way).map(|(begin, way)| -begin * way).sum::<f64>();
        if squared > 0.0 { (towards / squared).clamp(0.0, 1.0) } else { 0.0 }
    }

    fn exact(&self) -> f64 {
        EXACT.max(self.steepest * SHARE)
    }

    /// Whether the distance may change by more than is wanted to be known.
    fn is_divided_between(&self, from: f64, to: f64) -> bool {
        self.steepest.is_finite() && self.steepest * (to - from) >= self.exact()
    }

    /// The least distance that is possible between two shares of the way at which it is known.
    fn least_between(&self, from: (f64, f64), to: (f64, f64)) -> f64 {
        f64::midpoint(from.1, to.1) - self.steepest * (to.0 - from.0) / 2.0
    }
}

/// Looks for less between two moments, unless it cannot be less than the best by more than [`EXACT`].
fn narrow((from, to): ((f64, f64), (f64, f64)), way: &Way<'_>, note: &mut impl FnMut(f64, f64) -> f64) {
    let s = f64::midpoint(from.0, to.0);
    let least = way.least_between(from, to).max(0.0);
    if least >= note(from.0, from.1) - way.exact() || !way.is_divided_between(from.0, to.0) {
        return;
    }
    let middle = (s, way.gap(s));
    note(middle.0, middle.1);
    narrow((from, middle), way, note);
    narrow((middle, to), way, note);
}

/// When two bodies first touch, in seconds; a graze by less than [`EXACT`] may be missed.
pub(crate) fn first_contact(a: &Mover, b: &Mover) -> Option<f64> {
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
    ways(a, b, node - leaves, leaves).iter().find_map(|way| {
        let [from, to] = [0.0, 1.0].map(|s| (s, way.gap(s)));
        contact_between((from, to), way).map(|s| way.time(s))
    })
}

fn contact_between((from, to): ((f64, f64), (f64, f64)), way: &Way<'_>) -> Option<f64> {
    if from.1 <= 0.0 {
        return Some(from.0);
    }
    if way.least_between(from, to) > 0.0 {
        return None;
    }
    if !way.is_divided_between(from.0, to.0) {
        return (to.1 <= 0.0).then_some(to.0);
    }
    let s = f64::midpoint(from.0, to.0);
    let middle = (s, way.gap(s));
    contact_between((from, middle), way).or_else(|| contact_between((middle, to), way))
}

fn mixed(from: &[f64; 4], to: &[f64; 4], share: f64) -> [f64; 4] {
    std::array::from_fn(|i| from[i] + share * (to[i] - from[i]))
}

/// How far a body is outside a volume at most, and when; `None`: it never leaves it.
///
/// Between two knots a box that turns may stand out further than at both; by no more than its corners move.
pub(crate) fn furthest_out(mover: &Mover, volume: &Volume) -> Option<Approach> {
    let out = |place: &[f64; 4]| {
        let extent = mover.solid.extent(place[3]);
        let sides = (0..3).map(|i| {
            let (low, high) = (place[i] - extent[i], place[i] + extent[i]);
            (volume.least[i] - low).max(high - volume.most[i])
        });
        sides.fold(f64::NEG_INFINITY, f64::max)
    };
    let mut worst = Approach { at: 0.0, distance: 0.0 };
    let mut note = |at: f64, out: f64| {
        // Half a micrometre is rounding.
        if out > worst.distance + 5e-7 {
            worst = Approach { at, distance: out };
        }
    };
    for pair in mover.path.knots().windows(2) {
        let [from, to]: [&Knot; 2] = [&pair[0], &pair[1]];
        let turned = (to.place[3] - from.place[3]).abs();
        let parts =
            if mover.solid.lever() > 0.0 { (turned / TURN).ceil().clamp(1.0, LOOKS_MAX) } else { 1.0 };
        for part in 0..parts as u32 {
            let s = f64::from(part) / parts;
            note(from.at + s * (to.at - from.at), out(&mixed(&from.place, &to.place, s)));
        }
    }
    if let Some(last) = mover.path.knots().last() {
        note(last.at, out(&last.place));
    }
    (worst.distance > 0.0).then_some(worst)
}
