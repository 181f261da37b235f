//! Steps of a device that moves linearly: breadth-first search over samples and their candidate values.
//!
//! From a step, the slopes that stay within the room of all samples passed are an interval that narrows sample by sample,
//! as in Chan and Chin (International Journal of Computational Geometry and Applications 6, 1996); a candidate value
//! whose slope lies within is one step away. The graph is that of Imai and Iri 1986 with several values a sample, so the
//! first layer that reaches the last sample has the fewest steps.
//!
//! Exact and yet fast: `tube` tells for each sample how many pieces any way to the end still needs. A node that would
//! exceed the number of pieces aimed at is left out; if the aim is missed it is raised.

use super::lattice::Candidates;
use super::problem::{Path, Problem};
use super::tube::pieces_left;

/// Curves of no more samples may have a step at each.
const SAMPLES_MAX: usize = 4096;
/// Samples of one straight piece of longer curves where a step may lie; of longer pieces every second, third and so on.
const PIECE_SAMPLES_MAX: usize = 256;

/// The fewest steps within the room, and how many any others need at least; `None` if there are none or more than `most`.
pub(super) fn steps(problem: &Problem, room: f64, most: usize) -> Option<(Path, usize)> {
    let samples = problem.curve.times.len();
    let left = pieces_left(&problem.curve, room + problem.dust);
    let pieces_min = *left.first()?;
    let pieces_max = u32::try_from(most.min(samples) - 1).unwrap_or(u32::MAX);
    let mut search = Search::new(problem, room, left);
    let sparse = samples > SAMPLES_MAX && search.make_sparse();
    let path = match search.fewest(pieces_min, pieces_max) {
        // Whether there are any steps at all must not depend on where they may lie.
        None if sparse && most >= samples => {
            Search::new(problem, room, search.left).fewest(pieces_min, pieces_max)
        }
        path => path,
    }?;
    let thinned = sparse || search.candidates.iter().any(|candidates| candidates.thinned);
    let at_least = if thinned { pieces_min as usize + 1 } else { path.len() };
    Some((path, at_least))
}

/// A step that the first ones reach.
struct Node {
    sample: usize,
    candidate: u8,
    /// Index of the step before.
    from: usize,
}

struct Search<'a> {
    problem: &'a Problem<'a>,
    room: f64,
    /// Pieces that the way from each sample to the end has at least.
    left: Vec<u32>,
    candidates: Vec<Candidates>,
    /// Candidates not reached yet.
    open: Vec<u64>,
    /// In the order in which they are reached, layer by layer.
    nodes: Vec<Node>,
    /// Whether a node was left out that more pieces would allow.
    cut: bool,
}

impl<'a> Search<'a> {
    fn new(problem: &'a Problem<'a>, room: f64, left: Vec<u32>) -> Self {
        let values = problem.curve.values;
        let near = |(k, value): (usize, &f64)| problem.lattice.near(*value, problem.curve.room_at(k, room));
        let mut candidates: Vec<_> = values.iter().enumerate().map(near).collect();
        let last = values.len() - 1;
        for (end, sample) in [(problem.ends.first, 0), (problem.ends.last, last)] {
            if let Some(value) = end {
                let close = (value - values[sample]).abs() <= problem.curve.room_at(sample, room);
                candidates[sample] = if close { Candidates::only(value) } else { Candidates::NONE };
            }
        }
        Self { problem, room, left, candidates, open: Vec::new(), nodes: Vec::new(), cut: false }
    }

    /// Leaves out samples of long pieces as places of steps; whether it did.
    fn make_sparse(&mut self) -> bool {
        let mut sparse = false;
        let mut rest = &mut self.candidates[..];
        for piece in self.left.chunk_by(|a, b| a == b) {
            let (of_piece, after) = rest.split_at_mut(piece.len());
            let stride = piece.len().div_ceil(PIECE_SAMPLES_MAX);
            let dropped = of_piece.iter_mut().enumerate().filter(|(i, _)| i % stride != 0);
            dropped.for_each(|(_, candidates)| *candidates = Candidates::NONE);
            sparse |= stride > 1;
            rest = after;
        }
        sparse
    }

    /// The fewest steps, by aiming at ever more pieces.
    fn fewest(&mut self, pieces_min: u32, pieces_max: u32) -> Option<Path> {
        let mut beyond = 0;
        loop {
            let pieces = pieces_min.saturating_add(beyond).min(pieces_max);
            let path = self.run(pieces);
            if path.is_some() || pieces == pieces_max || !self.cut {
                return path;
            }
            beyond = beyond * 2 + 1;
        }
    }

    /// The fewest steps, if they have at most this many pieces.
    fn run(&mut self, pieces: u32) -> Option<Path> {
        self.open.clear();
        self.open.extend(self.candidates.iter().map(Candidates::all));
        self.nodes.clear();
        self.cut = self.left[0] > pieces;
        if !self.cut {
            self.reach(0, self.open[0], 0);
        }
        let mut layer = 0..self.nodes.len();
        for pieces_left in (0..pieces).rev() {
            for index in layer.clone() {
                self.spread(index, pieces_left);
                if self.nodes.last().is_some_and(|node| self.left[node.sample] == 0) {
                    return Some(self.path());
                }
            }
            layer = layer.end..self.nodes.len();
        }
        None
    }

    /// Reaches everything that is one piece away and has at most this many pieces left to go.
    fn spread(&mut self, index: usize, pieces_left: u32) {
        let Node { sample, candidate, .. } = self.nodes[index];
        let (times, values) = (self.problem.curve.times, self.problem.curve.values);
        let value = self.candidates[sample].value(candidate);
        let (mut flattest, mut steepest) = (f64::NEG_INFINITY, f64::INFINITY);
        for next in sample + 1..times.len() {
            let duration = times[next] - times[sample];
            let (low, high) = (value + flattest * duration, value + steepest * duration);
            let close = self.left[next] <= pieces_left;
            // It is enough to know one of those that are too far from the end.
            if self.open[next] != 0 && (close || !self.cut) {
                let fresh = self.candidates[next].between(low, high) & self.open[next];
                match close {
                    true => self.reach(next, fresh, index),
                    false => self.cut |= fresh != 0,
                }
            }
            let room = self.problem.curve.room_at(next, self.room);
            // Dividing takes longer than comparing, and most samples narrow one side at most.
            let (bottom, top) = (values[next] - room, values[next] + room);
            if bottom > low {
                flattest = (bottom - value) / duration;
            }
            if top < high {
                steepest = (top - value) / duration;
            }
            if flattest > steepest {
                break;
            }
        }
    }

    fn reach(&mut self, sample: usize, mut fresh: u64, from: usize) {
        self.open[sample] &= !fresh;
        while fresh != 0 {
            #[expect(clippy::cast_possible_truncation, reason = "below 64")]
            let candidate = fresh.trailing_zeros() as u8;
            self.nodes.push(Node { sample, candidate, from });
            fresh &= fresh - 1;
        }
    }

    /// The way to the node reached last.
    fn path(&self) -> Path {
        let mut path = Path::new();
        let mut index = self.nodes.len() - 1;
        loop {
            let node = &self.nodes[index];
            path.push((node.sample, self.candidates[node.sample].value(node.candidate)));
            if node.sample == 0 {
                break;
            }
            index = node.from;
        }
        path.reverse();
        path
    }
}
