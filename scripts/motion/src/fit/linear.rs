//! Steps of a device that moves linearly: breadth-first search over samples and their candidate values.
//!
//! The room is the largest allowed distance from the curve. Consider the lines from a step that stay within the room at all passed
//! samples. Their slopes form an interval that narrows sample by sample, as in Chan and Chin (International Journal of Computational
//! Geometry and Applications 6, 1996). A candidate value whose slope is within the interval is one step away. The graph is that of Imai
//! and Iri 1986, with several values per sample. The first layer that reaches the last sample therefore has the fewest steps.
//!
//! The search is exact but fast: for each sample, `tube` provides a lower bound of the number of pieces to the end. A node that would
//! exceed the target number of pieces is skipped. The remaining layers (`layers`) answer queries for all smaller rooms.

use std::ops::Range;

use super::Samples;
use super::cones::{Cones, Sight};
use super::lattice::Candidates;
use super::layers::{Layers, Node, Stack};
use super::problem::{Path, Problem};
use super::tube::View;

/// Curves of at most this many samples may have a step at each sample.
const SAMPLES_MAX: usize = 4096;
/// Maximum number of candidate samples per straight piece of longer curves. In longer pieces, only every second, third (and so on) sample
/// is a candidate.
const PIECE_SAMPLES_MAX: usize = 256;
/// A grid is called fine if a sample has more candidates than this.
const FINE: u32 = 6;

/// Returns the fewest steps whose distance from the curve is at most `room`, and a lower bound of the number of steps. `None` if no such
/// steps exist, or more than `most` are needed.
///
/// `known` holds the layers of an earlier search with more room, if any. This search replaces them by its own layers.
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
        // The existence of a solution must not depend on the choice of samples.
        None if sparse && most >= samples => {
            Search::new(problem, room, search.left).fewest(pieces_min, pieces_max)
        }
        layers => layers,
    }?;
    let path = layers.path(problem);
    let thinned = sparse || layers.are_thinned();
    let at_least = if thinned { pieces_min as usize + 1 } else { path.len() };
    // After thinning, a smaller room may have other candidates.
    *known = Some(layers).filter(|_| !thinned);
    Some((path, at_least))
}

struct Search<'a> {
    problem: &'a Problem<'a>,
    room: f64,
    /// Lower bound of the number of pieces from each sample to the end.
    left: Vec<u32>,
    candidates: Vec<Candidates>,
    gates: Vec<(f64, f64)>,
    /// For each sample, the candidates that no piece has reached yet, as a bit set.
    open: Vec<u64>,
    /// For each sample, the candidates of the next layer, as a bit set.
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

    /// Excludes steps at some samples of long pieces. Returns whether any sample was excluded.
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

    /// Returns all paths with the fewest pieces, whose number must be from `pieces_min` to `pieces_max`. A first search only allows
    /// `pieces_min` pieces.
    fn fewest(&mut self, pieces_min: u32, pieces_max: u32) -> Option<Layers> {
        if pieces_min > pieces_max {
            return None;
        }
        let is_fine = self.candidates.iter().any(|candidates| candidates.all().count_ones() > FINE);
        // For fine grids, the lowest and the highest value provide nearly as much information as all values, and much faster.
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

    /// The layers from the first to the last sample; `None` if the last sample is more than `pieces` pieces away.
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

    /// Marks all candidates that are one piece away from `node`, at samples with at most `pieces_left` pieces to the end. Returns the
    /// range of these samples.
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
            let (low, high) = self.gates[next];
            if !sight.narrow(duration, low, high) {
                break;
            }
        }
        first..until
    }
}
