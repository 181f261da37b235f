//! A solved network of which one constraint changes: only what depends on it is looked at.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use petgraph::visit::EdgeRef;
use urrcp::Span;

use super::conflict::Conflict;
use super::network::{Bounds, ConstraintId, Network, Schedule};

/// The weight of a bound that is not there.
const ABSENT: i64 = i64::MIN;

/// A network with its earliest schedule.
#[derive(Clone, Debug)]
pub struct Solved {
    network: Network,
    times: Vec<i64>,
    /// Two a constraint: its lower and its upper bound.
    arcs: Vec<Arc>,
    out: Grouped,
    into: Grouped,
    marks: Marks,
    /// Nodes with the times that they had before the change under way.
    undo: Vec<(u32, i64)>,
}

/// to >= from + weight
#[derive(Clone, Copy, Debug)]
struct Arc {
    from: u32,
    to: u32,
    weight: i64,
}

/// Indices of arcs by one of their ends.
#[derive(Clone, Debug)]
struct Grouped {
    first: Vec<u32>,
    arcs: Vec<u32>,
}

impl Grouped {
    fn new(nodes: usize, arcs: &[Arc], end: impl Fn(&Arc) -> u32) -> Self {
        let mut first = vec![0u32; nodes + 1];
        for arc in arcs {
            first[end(arc) as usize + 1] += 1;
        }
        for node in 0..nodes {
            first[node + 1] += first[node];
        }
        let mut next = first.clone();
        let mut sorted = vec![0u32; arcs.len()];
        for (index, arc) in (0u32..).zip(arcs) {
            let place = &mut next[end(arc) as usize];
            sorted[*place as usize] = index;
            *place += 1;
        }
        Self { first, arcs: sorted }
    }

    fn of(&self, node: u32) -> &[u32] {
        &self.arcs[self.first[node as usize] as usize..self.first[node as usize + 1] as usize]
    }
}

/// Sets of nodes that are emptied at once.
#[derive(Clone, Debug)]
struct Marks {
    round: u32,
    marked: Vec<u32>,
}

impl Marks {
    fn clear(&mut self) {
        self.round += 1;
        if self.round == u32::MAX {
            self.round = 1;
            self.marked.fill(0);
        }
    }

    /// Whether the node was not in the set before.
    fn insert(&mut self, node: u32) -> bool {
        std::mem::replace(&mut self.marked[node as usize], self.round) != self.round
    }

    fn contains(&self, node: u32) -> bool {
        self.marked[node as usize] == self.round
    }
}

impl Solved {
    /// Solves a network.
    ///
    /// # Errors
    /// The smallest contradiction.
    pub fn new(network: Network) -> Result<Self, Conflict> {
        let Schedule(times) = network.solve()?;
        let index = |node: petgraph::graph::NodeIndex| u32::try_from(node.index()).unwrap_or(u32::MAX);
        let arcs: Vec<Arc> = network
            .graph
            .edge_references()
            .flat_map(|edge| pair(index(edge.source()), index(edge.target()), *edge.weight()))
            .collect();
        let out = Grouped::new(times.len(), &arcs, |arc| arc.from);
        let into = Grouped::new(times.len(), &arcs, |arc| arc.to);
        let marks = Marks { round: 0, marked: vec![0; times.len()] };
        Ok(Self { network, times, arcs, out, into, marks, undo: Vec::new() })
    }

    /// The earliest schedule.
    #[must_use]
    pub fn schedule(&self) -> Schedule {
        Schedule(self.times.clone())
    }

    /// The time of one event.
    #[must_use]
    pub fn time(&self, event: super::Event) -> Span {
        Span::from_nanos(self.times[event.0.index()])
    }

    /// Changes the bounds of a constraint. Where they contradict the others nothing changes.
    ///
    /// First the bounds are loosened as far as old and new ones allow, then tightened one by one. Both are shortest paths
    /// over slacks, which are not negative, from the change on (the idea of Ramalingam, Song, Joskowicz and Miller,
    /// Algorithmica 23, 1999): what rises, by the largest rise first; what falls, by the least fall.
    ///
    /// # Errors
    /// The smallest contradiction.
    pub fn change(&mut self, id: ConstraintId, min: Option<Span>, max: Option<Span>) -> Result<(), Conflict> {
        let Some((from, to)) = self.network.graph.edge_endpoints(id.0) else { return Ok(()) };
        let index = |node: petgraph::graph::NodeIndex| u32::try_from(node.index()).unwrap_or(u32::MAX);
        let bounds = std::mem::replace(&mut self.network.graph[id.0], Bounds { min, max });
        let place = 2 * id.0.index();
        let old = [self.arcs[place], self.arcs[place + 1]];
        let new = pair(index(from), index(to), Bounds { min, max });
        self.undo.clear();
        for which in 0..2 {
            let arc = old[which];
            let decided = arc.weight != ABSENT && self.times[arc.to as usize] == self.time_from(arc);
            if new[which].weight < arc.weight {
                self.arcs[place + which].weight = new[which].weight;
                if decided {
                    self.lower(arc.to);
                }
            }
        }
        for which in 0..2 {
            self.arcs[place + which].weight = new[which].weight;
            if !self.raise(new[which]) {
                self.arcs[place..place + 2].copy_from_slice(&old);
                for (node, time) in self.undo.drain(..).rev() {
                    self.times[node as usize] = time;
                }
                let conflict = self.network.solve().err();
                self.network.graph[id.0] = bounds;
                return conflict.map_or(Ok(()), Err);
            }
        }
        Ok(())
    }

    fn time_from(&self, arc: Arc) -> i64 {
        self.times[arc.from as usize].saturating_add(arc.weight)
    }

    fn set(&mut self, node: u32, time: i64) {
        self.undo.push((node, self.times[node as usize]));
        self.times[node as usize] = time;
    }

    /// Raises what an arc raises. `false` if that is its own beginning, or the origin: then it closes a positive cycle.
    fn raise(&mut self, arc: Arc) -> bool {
        if arc.weight == ABSENT {
            return true;
        }
        let mut heap = BinaryHeap::new();
        let rise = self.time_from(arc) - self.times[arc.to as usize];
        if rise > 0 {
            heap.push((rise, arc.to));
        }
        self.marks.clear();
        while let Some((rise, node)) = heap.pop() {
            if !self.marks.insert(node) {
                continue;
            }
            if node == arc.from || node == 0 {
                return false;
            }
            let risen = self.times[node as usize].saturating_add(rise);
            for &index in self.out.of(node) {
                let next = self.arcs[index as usize];
                if next.weight == ABSENT || self.marks.contains(next.to) {
                    continue;
                }
                let rise = risen.saturating_add(next.weight) - self.times[next.to as usize];
                if rise > 0 {
                    heap.push((rise, next.to));
                }
            }
            self.set(node, risen);
        }
        true
    }

    /// Lowers what has lost the bound that decided it.
    fn lower(&mut self, root: u32) {
        let affected = self.decided_by(root);
        let cap = self.fall_outside(root);
        let mut heap = BinaryHeap::new();
        for &node in &affected {
            let fall = if node == 0 { 0 } else { self.fall_outside(node) };
            // Everything affected is tied to the root, and falls no further.
            if node == root || fall < cap {
                heap.push(Reverse((fall, node)));
            }
        }
        // Leaving the set of affected nodes is settling.
        while let Some(Reverse((fall, node))) = heap.pop() {
            if !self.marks.contains(node) {
                continue;
            }
            self.marks.marked[node as usize] = 0;
            let time = self.times[node as usize];
            for &index in self.out.of(node) {
                let next = self.arcs[index as usize];
                if next.weight != ABSENT && self.marks.contains(next.to) {
                    let slack = self.times[next.to as usize] - time.saturating_add(next.weight);
                    heap.push(Reverse((fall.saturating_add(slack), next.to)));
                }
            }
            self.set(node, time - fall);
        }
    }

    /// How far the bounds from outside the marked set, and the origin, let a node fall.
    fn fall_outside(&self, node: u32) -> i64 {
        let bounds = self.into.of(node).iter().map(|index| self.arcs[*index as usize]);
        let outside = bounds.filter(|arc| arc.weight != ABSENT && !self.marks.contains(arc.from));
        let least = outside.map(|arc| self.time_from(arc)).fold(0, i64::max);
        self.times[node as usize] - least
    }

    /// Everything that a chain of decisive bounds ties to a node; it stays marked.
    fn decided_by(&mut self, root: u32) -> Vec<u32> {
        self.marks.clear();
        self.marks.insert(root);
        let mut affected = vec![root];
        let mut next = 0;
        while let Some(&node) = affected.get(next) {
            next += 1;
            for &index in self.out.of(node) {
                let arc = self.arcs[index as usize];
                let decides = arc.weight != ABSENT && self.times[arc.to as usize] == self.time_from(arc);
                if decides && self.marks.insert(arc.to) {
                    affected.push(arc.to);
                }
            }
        }
        affected
    }
}

fn pair(from: u32, to: u32, bounds: Bounds) -> [Arc; 2] {
    let min = bounds.min.map_or(ABSENT, Span::as_nanos);
    let max = bounds.max.map_or(ABSENT, |max| -max.as_nanos());
    [Arc { from, to, weight: min }, Arc { from: to, to: from, weight: max }]
}
