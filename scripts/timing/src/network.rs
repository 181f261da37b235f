//! A network of events, and bounds on the times between them.

use std::collections::HashSet;

use petgraph::graph::{DiGraph, EdgeIndex, NodeIndex};
use petgraph::visit::EdgeRef;
use urrcp::Span;

use super::conflict::{Conflict, explain};
use super::paths::{Arcs, longest};

/// An event of a network: a point in time. The origin is the event at time zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Event(pub(super) NodeIndex);

/// Id of a constraint of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ConstraintId(pub(super) EdgeIndex);

/// Lower and upper bound on to - from; `None` for no bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Bounds {
    pub(super) min: Option<Span>,
    pub(super) max: Option<Span>,
}

/// Events and bounds on the time between them. No event is earlier than the origin.
#[derive(Clone, Debug)]
pub struct Network {
    pub(super) graph: DiGraph<(), Bounds>,
}

/// A time for every event.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schedule(pub(super) Vec<i64>);

impl Schedule {
    /// Time of `event` since the origin; zero for an event of another network.
    #[must_use]
    pub fn time(&self, event: Event) -> Span {
        Span::from_nanos(self.0.get(event.0.index()).copied().unwrap_or(0))
    }

    /// Time of the latest event.
    #[must_use]
    pub fn makespan(&self) -> Span {
        Span::from_nanos(self.0.iter().copied().max().unwrap_or(0))
    }
}

impl Default for Network {
    fn default() -> Self {
        Self::new()
    }
}

impl Network {
    /// Creates a network that contains only the origin.
    #[must_use]
    pub fn new() -> Self {
        let mut graph = DiGraph::new();
        graph.add_node(());
        Self { graph }
    }

    /// The origin: the event at time zero.
    #[must_use]
    pub fn origin(&self) -> Event {
        Event(NodeIndex::new(0))
    }

    /// Adds an event. It cannot be earlier than the origin.
    pub fn event(&mut self) -> Event {
        Event(self.graph.add_node(()))
    }

    /// Adds the constraint min <= to - from <= max. Both bounds may be negative; a missing bound has no effect.
    ///
    /// # Panics
    /// If `from` or `to` belongs to a larger network.
    pub fn constrain(
        &mut self,
        from: Event,
        to: Event,
        min: Option<Span>,
        max: Option<Span>,
    ) -> ConstraintId {
        ConstraintId(self.graph.add_edge(from.0, to.0, Bounds { min, max }))
    }

    /// Number of events, including the origin.
    #[must_use]
    pub fn events(&self) -> usize {
        self.graph.node_count()
    }

    /// Returns an upper bound on the length of every schedule without unnecessary waiting: the sum of the absolute values of all lower
    /// bounds.
    #[must_use]
    pub fn total(&self) -> Span {
        let mins = self.graph.edge_weights().filter_map(|bounds| bounds.min);
        mins.fold(Span::ZERO, |sum, min| sum + min.abs())
    }

    /// Computes the earliest schedule by the method of Goldberg and Radzik (Applied Mathematics Letters 6, 1993): repeated passes over
    /// the violated bounds in topological order. Takes linear time in acyclic networks, regardless of the order of their events.
    ///
    /// # Errors
    /// Returns the smallest contradiction if no schedule exists.
    pub fn solve(&self) -> Result<Schedule, Conflict> {
        let arcs = self.arcs(None);
        match longest(&arcs, vec![0; self.events()]) {
            Ok(times) => Ok(Schedule(times)),
            Err(cycle) => Err(explain(self, &arcs, &cycle)),
        }
    }

    /// Returns the latest time of each event at which all bounds can still be met and no event is after `horizon`. `None` if that is
    /// impossible. Follows longest paths backwards.
    #[must_use]
    pub fn latest(&self, horizon: Span) -> Option<Schedule> {
        let arcs = self.arcs(None);
        let backwards =
            arcs.all().iter().map(|arc| (arc.to as usize, arc.from as usize, arc.weight, arc.label));
        let mut negated = vec![-horizon.as_nanos(); self.events()];
        negated[0] = 0;
        let negated = longest(&Arcs::new(self.events(), backwards), negated).ok()?;
        (negated[0] == 0).then(|| Schedule(negated.iter().map(|time| -time).collect()))
    }

    /// Returns the events that determine the time of the last event in `earliest`. From each of them, a chain of bounds without slack
    /// leads to the last event. A chain begins at the origin: being fixed to an instant alone does not make an event critical.
    #[must_use]
    pub fn critical(&self, earliest: &Schedule) -> HashSet<Event> {
        let arcs = self.arcs(None);
        let backwards =
            arcs.all().iter().map(|arc| (arc.to as usize, arc.from as usize, arc.weight, arc.label));
        let backwards = Arcs::new(self.events(), backwards);
        let times = &earliest.0;
        let last = earliest.makespan().as_nanos();
        let mut open: Vec<usize> = (0..times.len()).filter(|event| times[*event] == last).collect();
        let mut found: HashSet<Event> = open.iter().map(|event| Event(NodeIndex::new(*event))).collect();
        while let Some(later) = open.pop() {
            // No chain leads to the origin, although events that are fixed to the origin cannot be later.
            for arc in backwards.of(later).iter().filter(|_| later > 0) {
                let earlier = arc.to as usize;
                let no_room = times[earlier].saturating_add(arc.weight) == times[later];
                if no_room && found.insert(Event(NodeIndex::new(earlier))) {
                    open.push(earlier);
                }
            }
        }
        found
    }

    /// Returns every bound as an arc: to >= from + weight. Omits the arc with the label `without`.
    pub(super) fn arcs(&self, without: Option<usize>) -> Arcs {
        let bounds = self.graph.edge_references().flat_map(|edge| {
            let (from, to, index) = (edge.source().index(), edge.target().index(), edge.id().index());
            let min = edge.weight().min.map(|min| (from, to, min.as_nanos(), 2 * index));
            let max = edge.weight().max.map(|max| (to, from, -max.as_nanos(), 2 * index + 1));
            min.into_iter().chain(max)
        });
        let origin = (1..self.events()).map(|event| (0, event, 0, super::paths::IMPLICIT));
        Arcs::new(self.events(), bounds.chain(origin).filter(|arc| Some(arc.3) != without))
    }
}
