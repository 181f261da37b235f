//! Two bodies between two moments, while the coordinates of both change linearly.
//!
//! Two methods bound the distance of each pair of parts from below between two moments. First, the distance changes by at most the
//! movements of the parts' points (Lipschitz). Second, in any fixed direction, two convex parts are at least as far apart as their
//! points. Between two moments, this distance is at least as large as at both of them, except for an eighth of the second derivative of
//! the points' movements times the time squared (the error of linear interpolation). With the second bound, few moments suffice for
//! bodies that move alike.

use super::chain::Sway;
use super::closest::Approach;
use super::part::{BodyPart, Gap};
use super::path::Both;
use super::solid::Solid;

/// Accuracy of distances, in metres. `SHARE` is the accuracy as a share of the movement between two steps. The larger one applies, which
/// bounds the work for bodies that move by hundreds of kilometres at once.
pub(super) const EXACT: f64 = 1e-4;
const SHARE: f64 = 1e-5;

pub(super) struct PairMovement<'a> {
    solids: [&'a Solid; 2],
    from: &'a Both,
    to: &'a Both,
    /// Largest movement of one base relative to the other base, without rotations, in metres.
    shift: f64,
    sways: [Vec<Sway>; 2],
}

/// All parts of two bodies when the share `s` of the movement has passed.
struct Look {
    s: f64,
    parts: [Vec<BodyPart>; 2],
}

/// One part of each body, with the distances between them at both ends of an interval.
struct Pair {
    parts: [usize; 2],
    gaps: [Gap; 2],
}

/// The closest approach found so far; until one is found, an upper limit.
pub(super) struct Best {
    pub(super) approach: Approach,
    pub(super) found: bool,
}

impl Best {
    fn note(&mut self, at: f64, distance: f64) {
        if distance < self.approach.distance {
            *self = Self { approach: Approach { at, distance }, found: true };
        }
    }
}

impl<'a> PairMovement<'a> {
    pub(super) fn new(solids: [&'a Solid; 2], from: &'a Both, to: &'a Both) -> Self {
        let mut way = Self { solids, from, to, shift: 0.0, sways: [Vec::new(), Vec::new()] };
        let (begin, end) = (way.relative(from), way.relative(to));
        way.shift = begin.iter().zip(&end).map(|(begin, end)| (end - begin).powi(2)).sum::<f64>().sqrt();
        way
    }

    /// Searches for an approach that is closer than `best`.
    pub(super) fn closest(mut self, best: &mut Best) {
        let nearest = self.middles_are_nearest();
        if let [Some(a), Some(b)] = self.solids.map(Solid::ball) {
            return best.note(self.time(nearest), self.gap_of_balls(nearest, a + b));
        }
        self.measure();
        let looks = [0.0, nearest, 1.0].map(|s| self.look(s));
        for look in looks.windows(2) {
            let pairs = self.pairs([&look[0], &look[1]], best.approach.distance);
            for (end, look) in look.iter().enumerate() {
                pairs.iter().for_each(|pair| best.note(self.time(look.s), pair.gaps[end].distance));
            }
            self.narrow([&look[0], &look[1]], pairs, best);
        }
    }

    /// Returns the time of the first contact, in seconds; a contact that overlaps by less than [`EXACT`] may be missed.
    pub(super) fn first_contact(mut self) -> Option<f64> {
        self.measure();
        let (from, to) = (self.look(0.0), self.look(1.0));
        let pairs = self.pairs([&from, &to], f64::MIN_POSITIVE);
        self.contact([&from, &to], pairs).map(|s| self.time(s))
    }

    fn measure(&mut self) {
        self.sways = std::array::from_fn(|body| {
            self.solids[body].sways(&self.from.places[body], &self.to.places[body])
        });
    }

    fn relative(&self, both: &Both) -> [f64; 3] {
        std::array::from_fn(|i| both.places[1].base[i] - both.places[0].base[i])
    }

    fn gap_of_balls(&self, s: f64, radii: f64) -> f64 {
        let (begin, end) = (self.relative(self.from), self.relative(self.to));
        let way = (0..3).map(|i| begin[i] + s * (end[i] - begin[i]));
        (way.map(|way| way * way).sum::<f64>().sqrt() - radii).max(0.0)
    }

    fn time(&self, s: f64) -> f64 {
        self.from.at + s * (self.to.at - self.from.at)
    }

    fn middles_are_nearest(&self) -> f64 {
        let (begin, end) = (self.relative(self.from), self.relative(self.to));
        let way: [f64; 3] = std::array::from_fn(|i| end[i] - begin[i]);
        let squared = way.iter().map(|way| way * way).sum::<f64>();
        let towards = begin.iter().zip(&way).map(|(begin, way)| -begin * way).sum::<f64>();
        if squared > 0.0 { (towards / squared).clamp(0.0, 1.0) } else { 0.0 }
    }

    fn look(&self, s: f64) -> Look {
        let parts =
            |body: usize| self.solids[body].parts(&self.from.places[body].towards(&self.to.places[body], s));
        Look { s, parts: [parts(0), parts(1)] }
    }

    /// Returns all pairs of parts that may come closer to each other than `below`, in metres.
    fn pairs(&self, ends: [&Look; 2], below: f64) -> Vec<Pair> {
        let [a, b] = self.sways.each_ref().map(Vec::len);
        let all = (0..a).flat_map(|i| (0..b).map(move |j| [i, j]));
        let near = all.filter(|parts| {
            let [from, to] = ends.map(|look| look.at_least(*parts));
            let least = f64::midpoint(from, to) - self.steepest(*parts) * (ends[1].s - ends[0].s) / 2.0;
            // Pairs whose bound is not a number are kept, too.
            least < below || least.is_nan()
        });
        near.map(|parts| Pair { parts, gaps: ends.map(|look| look.gap(parts)) }).collect()
    }

    /// Returns the largest possible change of the distance between two parts over the whole movement, in metres.
    fn steepest(&self, [i, j]: [usize; 2]) -> f64 {
        self.shift + self.sways[0][i].length + self.sways[1][j].length
    }

    /// Returns a lower bound on the distance between two parts between two moments.
    fn least(&self, pair: &Pair, [from, to]: [&Look; 2]) -> f64 {
        let (took, [i, j]) = (to.s - from.s, pair.parts);
        let [at_from, at_to] = pair.gaps.map(|gap| gap.distance);
        let sloped = f64::midpoint(at_from, at_to) - self.steepest(pair.parts) * took / 2.0;
        let sag = (self.sways[0][i].bend + self.sways[1][j].bend) * took * took / 8.0;
        let apart = |look: &Look, normal| look.parts[0][i].apart(&look.parts[1][j], normal);
        let normals = pair.gaps.iter().filter_map(|gap| gap.normal);
        let level = normals.map(|normal| apart(from, normal).min(apart(to, normal)) - sag);
        level.fold(sloped.max(0.0), f64::max)
    }

    /// Returns the required accuracy for these pairs, and whether their distances may change by more than this accuracy between two
    /// moments.
    fn exact(&self, pairs: &[Pair], [from, to]: [&Look; 2]) -> (f64, bool) {
        let steepest = pairs.iter().map(|pair| self.steepest(pair.parts)).fold(0.0, f64::max);
        let exact = EXACT.max(steepest * SHARE);
        (exact, steepest.is_finite() && steepest * (to.s - from.s) >= exact)
    }

    /// Searches for an approach between two moments that is closer than `best`. Ignores an approach that is closer by at most the
    /// accuracy ([`EXACT`]).
    fn narrow(&self, ends: [&Look; 2], mut pairs: Vec<Pair>, best: &mut Best) {
        let (exact, divided) = self.exact(&pairs, ends);
        pairs.retain(|pair| self.least(pair, ends) < best.approach.distance - exact);
        if pairs.is_empty() || !divided {
            return;
        }
        let (middle, halves) = self.halves(ends, pairs);
        halves[0].iter().for_each(|pair| best.note(self.time(middle.s), pair.gaps[1].distance));
        let [before, after] = halves;
        self.narrow([ends[0], &middle], before, best);
        self.narrow([&middle, ends[1]], after, best);
    }

    fn contact(&self, ends: [&Look; 2], mut pairs: Vec<Pair>) -> Option<f64> {
        let touch = |pairs: &[Pair], end: usize| pairs.iter().any(|pair| pair.gaps[end].distance <= 0.0);
        if touch(&pairs, 0) {
            return Some(ends[0].s);
        }
        pairs.retain(|pair| self.least(pair, ends) <= 0.0);
        let (_, divided) = self.exact(&pairs, ends);
        if pairs.is_empty() || !divided {
            return touch(&pairs, 1).then_some(ends[1].s);
        }
        let (middle, [before, after]) = self.halves(ends, pairs);
        self.contact([ends[0], &middle], before).or_else(|| self.contact([&middle, ends[1]], after))
    }

    fn halves(&self, ends: [&Look; 2], pairs: Vec<Pair>) -> (Look, [Vec<Pair>; 2]) {
        let middle = self.look(f64::midpoint(ends[0].s, ends[1].s));
        let halved = pairs.into_iter().map(|Pair { parts, gaps: [from, to] }| {
            let gap = middle.gap(parts);
            (Pair { parts, gaps: [from, gap] }, Pair { parts, gaps: [gap, to] })
        });
        let (before, after) = halved.unzip();
        (middle, [before, after])
    }
}

impl Look {
    fn at_least(&self, [i, j]: [usize; 2]) -> f64 {
        self.parts[0][i].at_least(&self.parts[1][j])
    }

    fn gap(&self, [i, j]: [usize; 2]) -> Gap {
        self.parts[0][i].gap(&self.parts[1][j])
    }
}
