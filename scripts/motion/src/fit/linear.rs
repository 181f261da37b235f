//! Steps of a device that moves linearly: breadth-first search over samples and their candidate values.
//!
//! From a step, the slopes that stay within the room of all samples passed are an interval that narrows sample by sample,
//! as in Chan and Chin (International Journal of Computational Geometry and Applications 6, 1996); a candidate value
//! whose slope lies within is one step away. The graph is that of Imai and Iri 1986 with several values a sample, so the
//! first layer that reaches the last sample has the fewest steps.
//!
//! Exact and yet fast: `tube` tells for each sample how many pieces any way to the end still needs. A node that would
//! exceed the number of pieces aimed at is left out. The remaining layers (`layers`) answer for all smaller rooms.

use std::ops::Range;

use super::Samples;
use super::cones::{Cones, Sight};
use super::lattice::Candidates;
use super::layers::{Layers, Node, Stack};
use super::problem::{Path, Problem};
use super::tube::View;

/// Curves of no more samples may have a step at each.
const SAMPLES_MAX: usize = 4096;
/// Samples of one straight piece of longer curves where a step may lie; of longer pieces every second, third and so on.
const PIECE_SAMPLES_MAX: usize = 256;
/// Candidates of a sample that are many.
const FINE: u32 = 6;

/// The fewest steps within the room, and how many any others need at least; `None` if there are none or more than `most`.
///
/// `known` are the layers of a larger room, or none. They are replaced by those of this one.
pub(super) fn steps(
    problem: &Problem,
    room: f64,
    most: usize,
    known: &mut Option<Layers>,
) -> Option<(Path, usize)> {
    if let Some(layers) = known.as_ref().filter(|layers| layers.answer(room, most)) {
        let within = layers.within(problem, room)?;
        let path = within.path(problem);
        let steps = path.len();
        *known = Some(within);
        return Some((path, steps));
    }
    let samples = problem.curve.times.len();
    let left = problem.tubes.pieces_left(room + problem.dust);
    let pieces_min = *left.first()?;
    let pieces_max = u32::try_from(most.min(samples) - 1).unwrap_or(u32::MAX);
    let mut search = Search::new(problem, room, left);
    let sparse = samples > SAMPLES_MAX && search.make_sparse();
    let layers = match search.fewest(pieces_min, pieces_max) {
        // Whether there are any steps at all must not depend on where they may lie.
        None if sparse && most >= samples => {
            Search::new(problem, room, search.left).fewest(pieces_min, pieces_max)
        }
        layers => layers,
    }?;
    let path = layers.path(problem);
    let thinned = sparse || layers.are_thinned();
    let at_least = if thinned { pieces_min as usize + 1 } else { path.len() };
    // What is thinned for this room may have other values for a smaller one.
    *known = Some(layers).filter(|_| !thinned);
    Some((path, at_least))
}

struct Search<'a> {
    problem: &'a Problem<'a>,
    room: f64,
    /// Pieces that the way from each sample to the end has at least.
    left: Vec<u32>,
    candidates: Vec<Candidates>,
    gates: Vec<(f64, f64)>,
    /// Candidates not reached yet.
    open: Vec<u64>,
    /// Candidates of the next layer.
    next: Vec<u64>,
}

impl<'a> Search<'a> {
    fn new(problem: &'a Problem<'a>, room: f64, left: Vec<u32>) -> Self {
        let samples = problem.curve.times.len();
        let candidates = (0..samples).map(|sample| problem.candidates(sample, room)).collect();
        let gates = (0..samples).map(|sample| problem.curve.gate(sample, room)).collect();
        let (open, next) = (Vec::new(), vec![0; samples]);
        Self { problem, room, left, candidates, gates, open, next }
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

    /// All ways with the fewest pieces. The first search is for the number that any way needs at least.
    fn fewest(&mut self, pieces_min: u32, pieces_max: u32) -> Option<Layers> {
        if pieces_min > pieces_max {
            return None;
        }
        let is_fine = self.candidates.iter().any(|candidates| candidates.all().count_ones() > FINE);
        // Of many values, the lowest and the highest tell nearly as much as all, and soon.
        let viewed = is_fine.then(|| self.aimed(pieces_min, pieces_max, View::new(self.problem.dust)));
        if let Some(viewed) = viewed {
            let layers = viewed?;
            let exact = Layers::new(self.problem, self.room, &self.candidates, &layers);
            if exact.is_some() {
                return exact;
            }
        }
        let layers = self.aimed(pieces_min, pieces_max, Cones::default())?;
        Layers::new(self.problem, self.room, &self.candidates, &layers)
    }

    fn aimed(&mut self, pieces_min: u32, pieces_max: u32, mut sight: impl Sight) -> Option<Stack> {
        match self.run(pieces_min, &mut sight) {
            None if pieces_min < pieces_max => self.run(pieces_max, &mut sight),
            layers => layers,
        }
    }

    /// The layers until the last sample is reached, if that takes at most this many pieces.
    fn run(&mut self, pieces: u32, sight: &mut impl Sight) -> Option<Stack> {
        self.open.clear();
        self.open.extend(self.candidates.iter().map(Candidates::all));
        self.next.fill(0);
        let last = self.open.len() - 1;
        let first = std::mem::take(&mut self.open[0]);
        if first == 0 {
            return None;
        }
        let mut layers = Stack::default();
        layers.begin();
        layers.push(Node::new(0, first));
        for pieces_left in (0..pieces).rev() {
            let (mut first, mut until) = (usize::MAX, 0);
            for index in layers.of(layers.layers() - 1) {
                let reached = self.spread(layers.node(index), pieces_left, sight);
                (first, until) = (first.min(reached.start), until.max(reached.end));
                if self.next[last] != 0 {
                    layers.begin();
                    layers.push(Node::new(last, self.candidates[last].all()));
                    return Some(layers);
                }
            }
            layers.begin();
            for sample in first..until {
                match std::mem::take(&mut self.next[sample]) {
                    0 => {}
                    candidates => layers.push(Node::new(sample, candidates)),
                }
            }
            if first >= until {
                return None;
            }
        }
        None
    }

    /// Reaches everything that is one piece away and has at most this many pieces left to go. Returns where that is.
    fn spread(&mut self, node: &mut Node, pieces_left: u32, sight: &mut impl Sight) -> Range<usize> {
        let Samples { times, .. } = self.problem.curve;
        let (mut first, mut until) = (usize::MAX, 0);
        sight.begin(&self.candidates[node.sample], node.candidates);
        for next in node.sample + 1..times.len() {
            let duration = times[next] - times[node.sample];
            node.until = next;
            if self.open[next] != 0 && self.left[next] <= pieces_left {
                let fresh = sight.reached(&self.candidates[next], self.open[next], duration);
                if fresh != 0 {
                    self.open[next] &= !fresh;
                    self.next[next] |= fresh;
                    (first, until) = (first.min(next), next + 1);
                }
            }
            if !sight.narrow(duration, self.gates[next]) {
                break;
            }
        }
        first..until
    }
}
