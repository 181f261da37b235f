//! A solved network that recomputes only the affected events when a constraint changes.

use petgraph::graph::NodeIndex;
use petgraph::visit::EdgeRef;
use urrcp::Span;

use super::conflict::Conflict;
use super::network::{Bounds, ConstraintId, Network, Schedule};

/// Weight of a missing bound.
const ABSENT: i64 = i64::MIN;
/// Value of `Node::parent` for events without a parent: the origin determines their time, or nothing does.
const NO_PARENT: u32 = u32::MAX;

/// A network with its earliest schedule.
#[derive(Clone, Debug)]
pub struct Solved {
    network: Network,
    /// Nodes in the order of their first computed times, so that neighbours in time are neighbours in memory. The origin is first.
    nodes: Vec<Node>,
    /// Index of each event in `nodes`.
    place_of: Vec<u32>,
    out: Grouped,
    into: Grouped,
    /// Value of `Node::mark` for the nodes of the set that is currently being built.
    round: u32,
    /// Index and previous value of each node that the current change has modified.
    undo: Vec<(u32, Node)>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    time: i64,
    /// The node whose bound determines this node's time. Parents form a tree with the origin as its root.
    parent: u32,
    mark: u32,
}

/// One arc of a constraint, to >= from + weight, stored at one of its ends; `other` is the other end.
#[derive(Clone, Copy, Debug)]
struct Arc {
    other: u32,
    weight: i64,
}

/// Arcs grouped by one of their ends. Each constraint has two arcs: one for its lower and one for its upper bound.
#[derive(Clone, Debug)]
struct Grouped {
    first: Vec<u32>,
    arcs: Vec<Arc>,
    /// For each arc in the order of creation, its index in `arcs`.
    places: Vec<u32>,
}

impl Grouped {
    /// Groups arcs, given as (this end, other end, weight), by this end.
    fn new(nodes: usize, all: &[(u32, u32, i64)]) -> Self {
        let mut first = vec![0u32; nodes + 1];
        for (node, ..) in all {
            first[*node as usize + 1] += 1;
        }
        for node in 0..nodes {
            first[node + 1] += first[node];
        }
        let mut next = first.clone();
        let mut arcs = vec![Arc { other: 0, weight: ABSENT }; all.len()];
        let mut places = Vec::with_capacity(all.len());
        for (node, other, weight) in all {
            let place = &mut next[*node as usize];
            arcs[*place as usize] = Arc { other: *other, weight: *weight };
            places.push(*place);
            *place += 1;
        }
        Self { first, arcs, places }
    }

    fn range(&self, node: u32) -> std::ops::Range<usize> {
        self.first[node as usize] as usize..self.first[node as usize + 1] as usize
    }

    fn of(&self, node: u32) -> &[Arc] {
        &self.arcs[self.range(node)]
    }

    fn set(&mut self, arc: usize, weight: i64) {
        self.arcs[self.places[arc] as usize].weight = weight;
    }
}

impl Solved {
    /// Solves a network.
    ///
    /// # Errors
    /// Returns the smallest contradiction if the network has no schedule.
    pub fn new(network: Network) -> Result<Self, Conflict> {
        let Schedule(times) = network.solve()?;
        let mut order: Vec<usize> = (0..times.len()).collect();
        order.sort_by_key(|event| (times[*event], *event));
        let mut place_of = vec![0u32; times.len()];
        for (place, event) in (0u32..).zip(&order) {
            place_of[*event] = place;
        }
        let place = |node: NodeIndex| place_of[node.index()];
        let arcs: Vec<(u32, u32, i64)> = network
            .graph
            .edge_references()
            .flat_map(|edge| pair(place(edge.source()), place(edge.target()), *edge.weight()))
            .collect();
        let out = Grouped::new(times.len(), &arcs);
        let reversed: Vec<_> = arcs.iter().map(|(from, to, weight)| (*to, *from, *weight)).collect();
        let into = Grouped::new(times.len(), &reversed);
        let node = |event: &usize| Node { time: times[*event], parent: NO_PARENT, mark: 0 };
        let nodes = order.iter().map(node).collect();
        let mut solved = Self { network, nodes, place_of, out, into, round: 0, undo: Vec::new() };
        solved.grow_tree();
        Ok(solved)
    }

    /// Determines the parent of each node. The origin determines events at time zero; bounds without slack lead from them to every other
    /// event.
    fn grow_tree(&mut self) {
        self.clear_marks();
        let mut queue: Vec<u32> =
            (0u32..).zip(&self.nodes).filter(|(_, n)| n.time == 0).map(|(i, _)| i).collect();
        for &node in &queue {
            self.nodes[node as usize].mark = self.round;
        }
        let mut next = 0;
        while let Some(&node) = queue.get(next) {
            next += 1;
            for place in self.out.range(node) {
                let arc = self.out.arcs[place];
                let time = self.nodes[node as usize].time;
                let to = &mut self.nodes[arc.other as usize];
                if arc.weight != ABSENT && to.mark != self.round && to.time == time.saturating_add(arc.weight)
                {
                    (to.mark, to.parent) = (self.round, node);
                    queue.push(arc.other);
                }
            }
        }
    }

    fn clear_marks(&mut self) {
        self.round += 1;
        if self.round == u32::MAX {
            self.round = 1;
            self.nodes.iter_mut().for_each(|node| node.mark = 0);
        }
    }

    /// The network's earliest schedule.
    #[must_use]
    pub fn schedule(&self) -> Schedule {
        Schedule(self.place_of.iter().map(|place| self.nodes[*place as usize].time).collect())
    }

    /// The time of `event` in the earliest schedule.
    #[must_use]
    pub fn time(&self, event: super::Event) -> Span {
        Span::from_nanos(self.nodes[self.place_of[event.0.index()] as usize].time)
    }

    /// Changes the bounds of a constraint. If the new bounds contradict the rest of the network, nothing changes.
    ///
    /// First loosens each bound that becomes looser, then tightens the others one by one. Visits only events that the change affects
    /// (the idea of Ramalingam, Song, Joskowicz and Miller, Algorithmica 23, 1999).
    ///
    /// # Errors
    /// Returns the smallest contradiction if the new bounds cannot be met.
    pub fn change(&mut self, id: ConstraintId, min: Option<Span>, max: Option<Span>) -> Result<(), Conflict> {
        let Some((from, to)) = self.network.graph.edge_endpoints(id.0) else { return Ok(()) };
        let bounds = std::mem::replace(&mut self.network.graph[id.0], Bounds { min, max });
        let place = 2 * id.0.index();
        let (from, to) = (self.place_of[from.index()], self.place_of[to.index()]);
        let old = pair(from, to, bounds);
        let new = pair(from, to, Bounds { min, max });
        self.undo.clear();
        for (which, ((from, to, weight), (.., looser))) in old.into_iter().zip(new).enumerate() {
            if looser < weight {
                self.set_weight(place + which, looser);
                let child = &self.nodes[to as usize];
                let decided = child.parent == from
                    && child.time == self.nodes[from as usize].time.saturating_add(weight);
                if decided {
                    self.lower(to);
                }
            }
        }
        for (which, (begin, end, weight)) in new.into_iter().enumerate() {
            self.set_weight(place + which, weight);
            if !self.raise(begin, end, weight) {
                for (which, arc) in old.iter().enumerate() {
                    self.set_weight(place + which, arc.2);
                }
                while let Some((node, before)) = self.undo.pop() {
                    let mark = self.nodes[node as usize].mark;
                    self.nodes[node as usize] = Node { mark, ..before };
                }
                let conflict = self.network.solve().err();
                self.network.graph[id.0] = bounds;
                return conflict.map_or(Ok(()), Err);
            }
        }
        Ok(())
    }

    fn set_weight(&mut self, arc: usize, weight: i64) {
        self.out.set(arc, weight);
        self.into.set(arc, weight);
    }

    fn set(&mut self, node: u32, time: i64, parent: u32) {
        let known = &mut self.nodes[node as usize];
        self.undo.push((node, *known));
        (known.time, known.parent) = (time, parent);
    }

    /// Raises the end node of an arc to the time that the arc requires, and everything that depends on it. Returns `false` if that would
    /// raise the arc's start or the origin, because the arc then closes a positive cycle.
    fn raise(&mut self, begin: u32, to: u32, weight: i64) -> bool {
        let asked = self.nodes[begin as usize].time.saturating_add(weight);
        if weight == ABSENT || asked <= self.nodes[to as usize].time {
            return true;
        }
        if to == begin || to == 0 {
            return false;
        }
        self.clear_marks();
        self.set(to, asked, begin);
        self.nodes[to as usize].mark = self.round;
        self.sweep(to, to, Some(begin))
    }

    /// Raises all nodes that depend on the marked nodes from `first` to `last`. Nodes are sorted by their first times, so most dependents
    /// of a node come after it. One pass in that order suffices for these; another pass handles nodes before the current one that were
    /// raised meanwhile.
    fn sweep(&mut self, first: u32, last: u32, begin: Option<u32>) -> bool {
        let (mut from, mut last) = (Some(first), last);
        while let Some(mut node) = from.take() {
            while node <= last {
                let known = &mut self.nodes[node as usize];
                if known.mark != self.round {
                    node += 1;
                    continue;
                }
                known.mark = 0;
                let time = known.time;
                for place in self.out.range(node) {
                    let arc = self.out.arcs[place];
                    let asked = time.saturating_add(arc.weight);
                    if arc.weight == ABSENT || asked <= self.nodes[arc.other as usize].time {
                        continue;
                    }
                    if Some(arc.other) == begin || arc.other == 0 {
                        return false;
                    }
                    self.set(arc.other, asked, node);
                    self.nodes[arc.other as usize].mark = self.round;
                    last = last.max(arc.other);
                    if arc.other <= node {
                        from = Some(from.map_or(arc.other, |known: u32| known.min(arc.other)));
                    }
                }
                node += 1;
            }
        }
        true
    }

    /// Lowers all nodes whose time depended on a bound that was loosened. The tree below `root` first falls to the times that bounds
    /// from outside the tree require. It then rises to the times that bounds within the tree require.
    fn lower(&mut self, root: u32) {
        let affected = self.tree_below(root);
        for &node in &affected {
            let (fall, parent) = self.fall_outside(node);
            let time = self.nodes[node as usize].time;
            self.set(node, time - fall, parent);
        }
        let ends =
            affected.iter().fold((root, root), |(first, last), node| (first.min(*node), last.max(*node)));
        self.sweep(ends.0, ends.1, None);
    }

    /// Returns how far a node can fall, and the node whose bound stops it: a bound from outside the marked set, or the origin.
    fn fall_outside(&self, node: u32) -> (i64, u32) {
        let mut least = (0, NO_PARENT);
        for arc in self.into.of(node) {
            let from = &self.nodes[arc.other as usize];
            let asked = from.time.saturating_add(arc.weight);
            if arc.weight != ABSENT && from.mark != self.round && asked > least.0 {
                least = (asked, arc.other);
            }
        }
        (self.nodes[node as usize].time - least.0, least.1)
    }

    /// Returns a node and all nodes whose time it determines. Leaves them marked.
    fn tree_below(&mut self, root: u32) -> Vec<u32> {
        self.clear_marks();
        self.nodes[root as usize].mark = self.round;
        let mut below = vec![root];
        let mut next = 0;
        while let Some(&node) = below.get(next) {
            next += 1;
            for place in self.out.range(node) {
                let child = &mut self.nodes[self.out.arcs[place].other as usize];
                if child.parent == node && child.mark != self.round {
                    child.mark = self.round;
                    below.push(self.out.arcs[place].other);
                }
            }
        }
        below
    }
}

/// The two arcs of a constraint, lower bound first: (from, to, weight).
fn pair(from: u32, to: u32, bounds: Bounds) -> [(u32, u32, i64); 2] {
    let min = bounds.min.map_or(ABSENT, Span::as_nanos);
    let max = bounds.max.map_or(ABSENT, |max| -max.as_nanos());
    [(from, to, min), (to, from, max)]
}
