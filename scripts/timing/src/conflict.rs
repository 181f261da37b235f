//! Explains why a network has no schedule: finds the smallest contradiction and corrections that resolve it.

use urrcp::Span;

use super::network::{ConstraintId, Event, Network};
use super::paths::{Arc, Arcs, IMPLICIT, UNREACHED, longest};
use petgraph::graph::{EdgeIndex, NodeIndex};

/// Maximum number of arc inspections in the search for the smallest contradiction.
const WORK_MAX: usize = 200_000_000;
/// Maximum number of arc inspections in the search for corrections.
const CORRECTION_WORK_MAX: usize = 50_000_000;

/// One of the two bounds of a constraint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Bound {
    /// The lower bound: to - from >= span
    Min,
    /// The upper bound: to - from <= span
    Max,
}

/// A minimal set of bounds that cannot all hold: if any one of them is removed, the others can.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Conflict {
    /// The bounds as a cycle of events: each link begins where the previous one ends.
    pub chain: Vec<Link>,
    /// Amount by which all bounds of the chain together are too tight.
    pub excess: Span,
    /// Changes of single bounds that each make the whole network consistent.
    pub corrections: Vec<Correction>,
}

/// One bound of a contradiction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Link {
    /// The constraint that has the bound; `None` for the implicit bound "not before the origin".
    pub constraint: Option<ConstraintId>,
    /// The kind of the bound: lower or upper.
    pub bound: Bound,
    /// The constraint's `from`, regardless of the kind of the bound.
    pub from: Event,
    /// The constraint's `to`, regardless of the kind of the bound.
    pub to: Event,
    /// Value of the bound.
    pub span: Span,
}

/// A change of one bound that resolves a contradiction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Correction {
    /// Index of the bound in [`Conflict::chain`].
    pub link: usize,
    /// Smallest sufficient loosening of the bound.
    pub by: Span,
}

/// Returns the contradiction with the fewest bounds. `found` is any positive cycle.
///
/// A contradiction is a positive cycle of arcs. Without one of its bounds, a simple cycle is no cycle, so the cycle with the fewest arcs
/// is the smallest contradiction. The search follows longest walks of 1, 2, 3 ... arcs from a node back to itself. It starts from every
/// node if that takes at most [`WORK_MAX`] arc inspections; in larger networks, only from the nodes of `found`.
pub(super) fn explain(network: &Network, arcs: &Arcs, found: &[Arc]) -> Conflict {
    let cycle = smallest(arcs, found);
    let excess = cycle.iter().map(|arc| arc.weight).fold(0, i64::saturating_add);
    let chain = cycle.iter().map(link).collect();
    let corrections = corrections(network, arcs, &cycle);
    Conflict { chain, excess: Span::from_nanos(excess), corrections }
}

fn link(arc: &Arc) -> Link {
    let event = |node: u32| Event(NodeIndex::new(node as usize));
    if arc.label == IMPLICIT {
        let (from, to) = (event(arc.from), event(arc.to));
        return Link { constraint: None, bound: Bound::Min, from, to, span: Span::ZERO };
    }
    let constraint = Some(ConstraintId(EdgeIndex::new(arc.label / 2)));
    match arc.label % 2 {
        0 => {
            let span = Span::from_nanos(arc.weight);
            Link { constraint, bound: Bound::Min, from: event(arc.from), to: event(arc.to), span }
        }
        _ => {
            let span = Span::from_nanos(-arc.weight);
            Link { constraint, bound: Bound::Max, from: event(arc.to), to: event(arc.from), span }
        }
    }
}

fn smallest(arcs: &Arcs, found: &[Arc]) -> Vec<Arc> {
    let mut best = found.to_vec();
    let everywhere = arcs.nodes().saturating_mul(arcs.all().len()).saturating_mul(best.len()) <= WORK_MAX;
    let starts: Vec<usize> = if everywhere {
        (0..arcs.nodes()).collect()
    } else {
        found.iter().map(|arc| arc.from as usize).collect()
    };
    let mut work = 0usize;
    for start in starts {
        work = work.saturating_add(arcs.all().len().saturating_mul(best.len()));
        if work > WORK_MAX || best.len() <= 1 {
            break;
        }
        if let Some(shorter) = walk(arcs, start, best.len() - 1) {
            best = shorter;
        }
    }
    best
}

/// Returns the positive cycle through `start` with the fewest arcs, if it has at most `most` arcs.
fn walk(arcs: &Arcs, start: usize, most: usize) -> Option<Vec<Arc>> {
    let mut layers: Vec<Vec<(i64, Option<Arc>)>> = vec![vec![(UNREACHED, None); arcs.nodes()]];
    layers[0][start].0 = 0;
    for hops in 0..most {
        let mut next = vec![(UNREACHED, None); arcs.nodes()];
        for arc in arcs.all() {
            let before = layers[hops][arc.from as usize].0;
            let value = before.saturating_add(arc.weight);
            if before != UNREACHED && value > next[arc.to as usize].0 {
                next[arc.to as usize] = (value, Some(*arc));
            }
        }
        let closed = next[start].0 > 0;
        layers.push(next);
        if closed {
            return Some(back(&layers, start));
        }
    }
    None
}

fn back(layers: &[Vec<(i64, Option<Arc>)>], start: usize) -> Vec<Arc> {
    let mut node = start;
    let mut cycle = Vec::with_capacity(layers.len() - 1);
    for layer in layers[1..].iter().rev() {
        let Some(arc) = layer[node].1 else { break };
        cycle.push(arc);
        node = arc.from as usize;
    }
    cycle.reverse();
    simple(cycle)
}

/// Reduces a positive closed walk to a positive simple cycle. A walk that visits a node twice consists of two shorter cycles, at least
/// one of which is positive.
fn simple(cycle: Vec<Arc>) -> Vec<Arc> {
    for (i, arc) in cycle.iter().enumerate() {
        for (j, other) in cycle.iter().enumerate().skip(i + 1) {
            if arc.from == other.from {
                let inner = cycle[i..j].to_vec();
                let outer: Vec<Arc> = cycle[..i].iter().chain(&cycle[j..]).copied().collect();
                let positive = inner.iter().map(|arc| arc.weight).fold(0, i64::saturating_add) > 0;
                return simple(if positive { inner } else { outer });
            }
        }
    }
    cycle
}

/// Returns the smallest sufficient loosening of each bound of the cycle whose loosening alone makes the network consistent. The network
/// must then also be consistent without the bound. The longest path from the bound's end back to its start limits the bound's value.
fn corrections(network: &Network, arcs: &Arcs, cycle: &[Arc]) -> Vec<Correction> {
    let mut corrections = Vec::new();
    let mut work = 0usize;
    for (index, arc) in cycle.iter().enumerate() {
        work = work.saturating_add(arcs.all().len().saturating_mul(8));
        if arc.label == IMPLICIT || work > CORRECTION_WORK_MAX {
            continue;
        }
        let without = network.arcs(Some(arc.label));
        if longest(&without, vec![0; without.nodes()]).is_err() {
            continue;
        }
        let mut times = vec![UNREACHED; without.nodes()];
        times[arc.to as usize] = 0;
        let Ok(times) = longest(&without, times) else { continue };
        let back = times[arc.from as usize];
        if back != UNREACHED {
            corrections
                .push(Correction { link: index, by: Span::from_nanos(arc.weight.saturating_add(back)) });
        }
    }
    corrections
}
