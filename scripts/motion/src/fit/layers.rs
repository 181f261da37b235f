//! All paths with the fewest pieces (straight lines from step to step), as layers of steps: the steps of the nth layer are n pieces from
//! the first sample. The room is the largest allowed distance from the curve.
//!
//! With less room, the paths to a step and from that step to the end can only need more pieces. If the number of pieces stays the same,
//! each step therefore stays in its layer or drops out. A search with less room only examines the remaining steps.

use std::ops::Range;
use std::rc::Rc;

use super::cones::{Cones, Sight as _};
use super::lattice::Candidates;
use super::problem::{Path, Problem};

/// Candidate values of one sample, as a bit set of their indices.
#[derive(Clone, Copy)]
pub(super) struct Node {
    pub(super) sample: usize,
    pub(super) candidates: u64,
    /// The last sample that a line from these candidates may reach; `usize::MAX` if that sample is not known.
    pub(super) until: usize,
}

impl Node {
    pub(super) const fn new(sample: usize, candidates: u64) -> Self {
        Self { sample, candidates, until: usize::MAX }
    }
}

/// Consecutive layers; the nodes of each layer are in order of their samples.
#[derive(Default)]
pub(super) struct Stack {
    nodes: Vec<Node>,
    /// The index of the first node of each layer.
    begins: Vec<usize>,
}

impl Stack {
    /// Starts a layer. Nodes that are pushed later belong to it.
    pub(super) fn begin(&mut self) {
        self.begins.push(self.nodes.len());
    }

    pub(super) fn push(&mut self, node: Node) {
        self.nodes.push(node);
    }

    pub(super) fn layers(&self) -> usize {
        self.begins.len()
    }

    /// The index range of a layer's nodes.
    pub(super) fn of(&self, layer: usize) -> Range<usize> {
        self.begins[layer]..self.begins.get(layer + 1).copied().unwrap_or(self.nodes.len())
    }

    pub(super) fn node(&mut self, index: usize) -> &mut Node {
        &mut self.nodes[index]
    }
}

pub(super) struct Layers {
    room: f64,
    candidates: Rc<[Candidates]>,
    /// The layers, from the last sample back to the first. A straight piece leads from each step to a step of the layer before it in this
    /// list.
    backwards: Stack,
}

impl Layers {
    /// Keeps the steps of `forwards` that lie on a complete path from the first to the last sample. `None` if there is no such path.
    pub(super) fn new(
        problem: &Problem,
        room: f64,
        candidates: &[Candidates],
        forwards: &Stack,
    ) -> Option<Self> {
        let last = forwards.layers() - 1;
        let layer = |number: usize| &forwards.nodes[forwards.of(last - number)];
        Self::leading(problem, room, candidates.into(), (0..=last).map(layer), |node| Some(*node))
    }

    /// Returns the layers that remain if the largest allowed distance from the curve falls to `room`; `None` if no path remains.
    pub(super) fn within(&self, problem: &Problem, room: f64) -> Option<Self> {
        let near = |node: &Node| {
            let near = problem.candidates(node.sample, room);
            let candidates = node.candidates & self.candidates[node.sample].common(&near);
            (candidates != 0).then_some(Node { candidates, ..*node })
        };
        let layer = |number: usize| &self.backwards.nodes[self.backwards.of(number)];
        let last = self.backwards.layers() - 1;
        Self::leading(problem, room, self.candidates.clone(), (0..=last).map(layer), near)
    }

    fn leading<'s>(
        problem: &Problem,
        room: f64,
        candidates: Rc<[Candidates]>,
        mut layers: impl Iterator<Item = &'s [Node]>,
        near: impl Fn(&Node) -> Option<Node>,
    ) -> Option<Self> {
        let mut walk = Walk::new(problem, &candidates, room);
        let mut backwards = Stack::default();
        backwards.begin();
        backwards.nodes.extend(layers.next().into_iter().flatten().filter_map(&near));
        for (number, layer) in (1..).zip(layers) {
            let mut later = backwards.of(number - 1);
            backwards.begin();
            for node in layer {
                let passed =
                    backwards.nodes[later.clone()].iter().take_while(|later| later.sample <= node.sample);
                later.start += passed.count();
                if later.is_empty() {
                    break;
                }
                if backwards.nodes[later.start].sample <= node.until {
                    let leading =
                        near(node).and_then(|node| walk.leading(node, &backwards.nodes[later.clone()]));
                    backwards.nodes.extend(leading);
                }
            }
            if backwards.of(number).is_empty() {
                return None;
            }
        }
        Some(Self { room, candidates, backwards })
    }

    pub(super) fn are_thinned(&self) -> bool {
        self.candidates.iter().any(Candidates::are_thinned)
    }

    /// Whether these layers contain all paths of `most` steps whose distance from the curve is at most `room`.
    pub(super) fn answer(&self, room: f64, most: usize) -> bool {
        room <= self.room && most == self.backwards.layers()
    }

    /// Returns the path through the earliest step of each layer. If that step has several values, the path takes the lowest.
    pub(super) fn path(&self, problem: &Problem) -> Path {
        let mut walk = Walk::new(problem, &self.candidates, self.room);
        let mut path = Path::with_capacity(self.backwards.layers());
        let mut step: Option<Node> = None;
        for number in (0..self.backwards.layers()).rev() {
            let layer = &self.backwards.nodes[self.backwards.of(number)];
            step = match step {
                None => layer.first().map(|node| Node { candidates: lowest(node.candidates), ..*node }),
                Some(from) => walk.earliest(from, layer),
            };
            let Some(Node { sample, candidates, .. }) = step else { break };
            #[expect(clippy::cast_possible_truncation, reason = "below 64")]
            let candidate = candidates.trailing_zeros() as u8;
            path.push((sample, self.candidates[sample].value(candidate)));
        }
        path
    }
}

/// A search for lines that start at one step and stay within the room (the largest allowed distance from the curve).
struct Walk<'a> {
    problem: &'a Problem<'a>,
    candidates: &'a [Candidates],
    room: f64,
    cones: Cones,
}

impl<'a> Walk<'a> {
    fn new(problem: &'a Problem<'a>, candidates: &'a [Candidates], room: f64) -> Self {
        Self { problem, candidates, room, cones: Cones::default() }
    }

    /// Keeps the candidates of `node` from which a piece leads to one of the steps in `later`. `None` if no candidate remains.
    fn leading(&mut self, node: Node, later: &[Node]) -> Option<Node> {
        self.cones.begin(&self.candidates[node.sample], node.candidates);
        let (mut leading, mut passed) = (0, node.sample);
        for next in later {
            if !self.pass(node.sample, passed + 1..next.sample) {
                break;
            }
            let duration = self.duration(node.sample, next.sample);
            leading |= self.cones.take(&self.candidates[next.sample], next.candidates, duration);
            if leading == node.candidates || !self.pass(node.sample, next.sample..next.sample + 1) {
                break;
            }
            passed = next.sample;
        }
        (leading != 0).then_some(Node { candidates: leading, ..node })
    }

    /// Returns the earliest step of `layer` that a line from `from` reaches, with the lowest candidate reached there; at the last sample,
    /// with the highest. `None` if no line reaches a step.
    fn earliest(&mut self, from: Node, layer: &[Node]) -> Option<Node> {
        self.cones.begin(&self.candidates[from.sample], from.candidates);
        let mut passed = from.sample;
        for next in &layer[layer.partition_point(|node| node.sample <= from.sample)..] {
            if !self.pass(from.sample, passed + 1..next.sample) {
                break;
            }
            let duration = self.duration(from.sample, next.sample);
            let reached = self.cones.reached(&self.candidates[next.sample], next.candidates, duration);
            if reached != 0 {
                let is_last = next.sample + 1 == self.candidates.len();
                let candidates = if is_last { 1 << (63 - reached.leading_zeros()) } else { lowest(reached) };
                return Some(Node { candidates, ..*next });
            }
            if !self.pass(from.sample, next.sample..next.sample + 1) {
                break;
            }
            passed = next.sample;
        }
        None
    }

    /// Whether any line from sample `from` passes all of `samples`, which are later.
    fn pass(&mut self, from: usize, mut samples: Range<usize>) -> bool {
        let (curve, room) = (&self.problem.curve, self.room);
        samples.all(|sample| {
            let (low, high) = curve.gate(sample, room);
            self.cones.narrow(curve.times[sample] - curve.times[from], low, high)
        })
    }

    fn duration(&self, from: usize, to: usize) -> f64 {
        self.problem.curve.times[to] - self.problem.curve.times[from]
    }
}

fn lowest(set: u64) -> u64 {
    set & set.wrapping_neg()
}
