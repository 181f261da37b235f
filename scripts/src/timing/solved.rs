//! A solved network of which one constraint changes: only what depends on it is looked at.

use std::collections::{BinaryHeap, HashMap};

use petgraph::Direction;
use petgraph::graph::NodeIndex;
use petgraph::visit::EdgeRef;
use urrcp::Span;

use super::conflict::Conflict;
use super::network::{Bounds, ConstraintId, Network, Schedule};

/// A network with its earliest schedule.
#[derive(Clone, Debug)]
pub struct Solved {
    network: Network,
    times: Vec<i64>,
}

/// to >= from + weight
#[derive(Clone, Copy)]
struct Arc {
    from: usize,
    to: usize,
    weight: i64,
}

impl Solved {
    /// Solves a network.
    ///
    /// # Errors
    /// The smallest contradiction.
    pub fn new(network: Network) -> Result<Self, Conflict> {
        let Schedule(times) = network.solve()?;
        Ok(Self { network, times })
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
    /// Both directions are shortest paths over non-negative slacks from the change on (the idea of Ramalingam, Song,
    /// Joskowicz and Miller, Algorithmica 23, 1999): what rises, by the largest rise first; what falls, by the least fall.
    ///
    /// # Errors
    /// The smallest contradiction.
    pub fn change(&mut self, id: ConstraintId, min: Option<Span>, max: Option<Span>) -> Result<(), Conflict> {
        let Some((from, to)) = self.network.graph.edge_endpoints(id.0) else { return Ok(()) };
        let old = self.network.graph[id.0];
        let before: Vec<Arc> = arcs(from.index(), to.index(), old).collect();
        self.network.graph[id.0] = Bounds { min, max };
        let after: Vec<Arc> = arcs(from.index(), to.index(), Bounds { min, max }).collect();
        for arc in after {
            if let Err(risen) = self.raise(arc) {
                for (node, time) in risen {
                    self.times[node] = time;
                }
                let Err(conflict) = self.network.solve() else { continue };
                self.network.graph[id.0] = old;
                return Err(conflict);
            }
        }
        for arc in before {
            // A bound that decided may do so no longer.
            if self.times[arc.to] <= self.times[arc.from].saturating_add(arc.weight) {
                self.lower(arc.to);
            }
        }
        Ok(())
    }

    fn out(&self, node: usize) -> impl Iterator<Item = Arc> + '_ {
        let graph = &self.network.graph;
        let index = NodeIndex::new(node);
        let later = graph.edges_directed(index, Direction::Outgoing).filter_map(move |edge| {
            let weight = edge.weight().min?.as_nanos();
            Some(Arc { from: node, to: edge.target().index(), weight })
        });
        let earlier = graph.edges_directed(index, Direction::Incoming).filter_map(move |edge| {
            let weight = -edge.weight().max?.as_nanos();
            Some(Arc { from: node, to: edge.source().index(), weight })
        });
        later.chain(earlier)
    }

    fn ending_at(&self, node: usize) -> impl Iterator<Item = Arc> + '_ {
        let graph = &self.network.graph;
        let index = NodeIndex::new(node);
        let later = graph.edges_directed(index, Direction::Incoming).filter_map(move |edge| {
            let weight = edge.weight().min?.as_nanos();
            Some(Arc { from: edge.source().index(), to: node, weight })
        });
        let earlier = graph.edges_directed(index, Direction::Outgoing).filter_map(move |edge| {
            let weight = -edge.weight().max?.as_nanos();
            Some(Arc { from: edge.target().index(), to: node, weight })
        });
        later.chain(earlier)
    }

    /// Raises what an arc raises. It raises its own beginning exactly if it closes a positive cycle; then what was raised
    /// is returned with the old times. So it is if the origin rises.
    fn raise(&mut self, arc: Arc) -> Result<(), Vec<(usize, i64)>> {
        let rise = self.times[arc.from].saturating_add(arc.weight) - self.times[arc.to];
        let mut old: Vec<(usize, i64)> = Vec::new();
        let mut heap = BinaryHeap::new();
        if rise > 0 {
            heap.push((rise, arc.to));
        }
        let mut settled: HashMap<usize, ()> = HashMap::new();
        while let Some((rise, node)) = heap.pop() {
            if settled.insert(node, ()).is_some() {
                continue;
            }
            if node == arc.from || node == 0 {
                return Err(old);
            }
            old.push((node, self.times[node]));
            let risen = self.times[node].saturating_add(rise);
            for next in self.out(node) {
                let rise = risen.saturating_add(next.weight) - self.times[next.to];
                if rise > 0 && !settled.contains_key(&next.to) {
                    heap.push((rise, next.to));
                }
            }
            self.times[node] = risen;
        }
        Ok(())
    }

    /// Lowers what has lost the bound that decided it.
    fn lower(&mut self, root: usize) {
        let affected = self.decided_by(root);
        // The fall that the node's other bounds leave, or none above `cap`.
        let own = |times: &[i64], node: usize| {
            let least = self.ending_at(node).filter(|arc| !affected.contains_key(&arc.from));
            let least = least.map(|arc| times[arc.from].saturating_add(arc.weight)).fold(0, i64::max);
            times[node] - least
        };
        let mut falls: HashMap<usize, i64> = HashMap::with_capacity(affected.len());
        let mut heap = BinaryHeap::new();
        let cap = own(&self.times, root);
        for &node in affected.keys() {
            let fall = if node == 0 { 0 } else { own(&self.times, node) };
            // Everything affected is tied to the root, and falls no further.
            if node == root || fall < cap {
                heap.push(std::cmp::Reverse((fall, node)));
            }
        }
        while let Some(std::cmp::Reverse((fall, node))) = heap.pop() {
            if falls.contains_key(&node) {
                continue;
            }
            falls.insert(node, fall);
            for next in self.out(node) {
                if affected.contains_key(&next.to) && !falls.contains_key(&next.to) {
                    let slack = self.times[next.to] - self.times[node].saturating_add(next.weight);
                    heap.push(std::cmp::Reverse((fall.saturating_add(slack), next.to)));
                }
            }
        }
        for (node, fall) in falls {
            self.times[node] -= fall;
        }
    }

    /// Everything that a chain of decisive bounds ties to a node.
    fn decided_by(&self, root: usize) -> HashMap<usize, ()> {
        let mut affected = HashMap::from([(root, ())]);
        let mut stack = vec![root];
        while let Some(node) = stack.pop() {
            for arc in self.out(node) {
                let decides = self.times[arc.to] == self.times[node].saturating_add(arc.weight);
                if decides && affected.insert(arc.to, ()).is_none() {
                    stack.push(arc.to);
                }
            }
        }
        affected
    }
}

fn arcs(from: usize, to: usize, bounds: Bounds) -> impl Iterator<Item = Arc> {
    let min = bounds.min.map(|min| Arc { from, to, weight: min.as_nanos() });
    let max = bounds.max.map(|max| Arc { from: to, to: from, weight: -max.as_nanos() });
    min.into_iter().chain(max)
}
