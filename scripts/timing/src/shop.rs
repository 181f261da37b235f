//! A job shop in a temporal network, as the search for an order uses it: heads and tails of tasks, the times of an order, and bounds that
//! rate it.

use std::collections::{BinaryHeap, HashMap, VecDeque};

use urrcp::Span;

use super::network::{Network, Schedule};
use super::order::Task;
use super::paths::{Arcs, IMPLICIT, UNREACHED, longest};

/// For each zone, the indices of its tasks in their order.
pub(super) type Sequences = Vec<Vec<usize>>;

/// Cost of an order: first the amount by which it violates upper bounds, then its makespan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Cost {
    pub(super) late: i64,
    pub(super) makespan: i64,
}

/// The network in the form that the search uses: lower bounds as a graph of events, upper bounds in a separate list.
pub(super) struct Shop<'a> {
    pub(super) tasks: &'a [Task],
    pub(super) zones: usize,
    pub(super) nodes: usize,
    /// Lower bounds by their start node: (end node, weight).
    pub(super) forward: Vec<Vec<(usize, i64)>>,
    pub(super) backward: Vec<Vec<(usize, i64)>>,
    /// Upper bounds (from, to, weight): to <= from + weight
    pub(super) upper: Vec<(usize, usize, i64)>,
    /// Earliest time of each event as long as the tasks are not ordered.
    pub(super) heads: Vec<i64>,
    pub(super) tails: Vec<i64>,
    pub(super) work: usize,
    pub(super) random: u64,
}

/// Times of all events in one order of the tasks.
pub(super) struct Timed {
    pub(super) heads: Vec<i64>,
    pub(super) order: Vec<usize>,
    pub(super) cost: Cost,
    /// For each event, the preceding event whose arc determines its time.
    pub(super) decided: Vec<usize>,
    pub(super) last: usize,
}

pub(super) const NONE: usize = usize::MAX;
/// Maximum number of passes that postpone events to meet upper bounds. After that, the order is considered to violate these bounds.
const ROUNDS_MAX: usize = 64;

impl<'a> Shop<'a> {
    pub(super) fn new(network: &Network, tasks: &'a [Task]) -> Result<Self, Option<usize>> {
        let arcs: Arcs = network.arcs(None);
        let Ok(times) = longest(&arcs, vec![0; arcs.nodes()]) else { return Err(None) };
        let nodes = arcs.nodes();
        let (mut forward, mut backward, mut upper) =
            (vec![Vec::new(); nodes], vec![Vec::new(); nodes], Vec::new());
        for arc in arcs.all() {
            let (from, to) = (arc.from as usize, arc.to as usize);
            // An arc that points back in time is an upper bound. So is an arc into the origin, and one that keeps two events at the same
            // time.
            let together = arc.weight == 0 && arc.label != IMPLICIT && arc.label % 2 == 1;
            if arc.weight < 0 || to == 0 || together {
                upper.push((to, from, -arc.weight));
            } else {
                forward[from].push((to, arc.weight));
                backward[to].push((from, arc.weight));
            }
        }
        let zones = tasks.iter().map(|task| task.zone + 1).max().unwrap_or(0);
        let mut shop = Self {
            tasks,
            zones,
            nodes,
            forward,
            backward,
            upper,
            heads: times,
            tails: vec![0; nodes],
            work: 0,
            random: 0x9E37_79B9_7F4A_7C15,
        };
        shop.tails = shop.longest_tails();
        Ok(shop)
    }

    pub(super) fn start(&self, task: usize) -> usize {
        self.tasks[task].start.0.index()
    }

    pub(super) fn end(&self, task: usize) -> usize {
        self.tasks[task].end.0.index()
    }

    pub(super) fn length(&self, task: usize) -> i64 {
        let (start, end) = (self.start(task), self.end(task));
        self.forward[start].iter().filter(|(to, _)| *to == end).map(|(_, weight)| *weight).max().unwrap_or(0)
    }

    pub(super) fn longest_tails(&self) -> Vec<i64> {
        let arcs = self.backward_arcs();
        longest(&arcs, vec![0; self.nodes]).unwrap_or_else(|_| vec![0; self.nodes])
    }

    pub(super) fn backward_arcs(&self) -> Arcs {
        let reversed = (0..self.nodes)
            .flat_map(|to| self.backward[to].iter().map(move |(from, weight)| (to, *from, *weight, 0)));
        Arcs::new(self.nodes, reversed)
    }

    pub(super) fn zone_tasks(&self, zone: usize) -> Vec<usize> {
        (0..self.tasks.len()).filter(|task| self.tasks[*task].zone == zone).collect()
    }

    pub(super) fn hopeless(&self) -> Option<usize> {
        let deadline: HashMap<usize, i64> =
            self.upper.iter().filter(|(from, ..)| *from == 0).map(|(_, to, bound)| (*to, *bound)).collect();
        let latest = self.latest(&deadline);
        (0..self.zones).find(|zone| {
            let jobs: Vec<_> = self
                .zone_tasks(*zone)
                .iter()
                .map(|&task| {
                    (
                        self.heads[self.start(task)],
                        self.length(task),
                        -latest[self.end(task)].min(i64::MAX / 4),
                    )
                })
                .collect();
            preemptive(&jobs) > 0
        })
    }

    pub(super) fn latest(&self, deadline: &HashMap<usize, i64>) -> Vec<i64> {
        let mut negated = vec![UNREACHED; self.nodes];
        for (&event, &bound) in deadline {
            negated[event] = -bound;
        }
        let negated = longest(&self.backward_arcs(), negated).unwrap_or_default();
        let latest = |time: &i64| if *time == UNREACHED { i64::MAX / 4 } else { -time };
        negated.iter().map(latest).collect()
    }

    pub(super) fn at_least(&self) -> i64 {
        let chain = (0..self.nodes).map(|node| self.heads[node] + self.tails[node]).max().unwrap_or(0);
        let zone = |zone| {
            let tasks = self.zone_tasks(zone);
            let job =
                |&task: &usize| (self.heads[self.start(task)], self.length(task), self.tails[self.end(task)]);
            preemptive(&tasks.iter().map(job).collect::<Vec<_>>())
        };
        (0..self.zones).map(zone).max().unwrap_or(0).max(chain)
    }

    pub(super) fn tasks_ahead(&self) -> Vec<Vec<usize>> {
        let task_at_end: HashMap<usize, usize> =
            (0..self.tasks.len()).map(|task| (self.end(task), task)).collect();
        (0..self.tasks.len())
            .map(|task| {
                let mut ahead = Vec::new();
                let mut seen = vec![self.start(task)];
                let mut stack = vec![self.start(task)];
                while let Some(node) = stack.pop() {
                    for &(from, _) in &self.backward[node] {
                        if from == 0 || seen.contains(&from) {
                            continue;
                        }
                        seen.push(from);
                        match task_at_end.get(&from) {
                            Some(&before) if before != task => ahead.push(before),
                            _ => stack.push(from),
                        }
                    }
                }
                ahead
            })
            .collect()
    }

    pub(super) fn push_on(&self, heads: &mut [i64], node: usize, time: i64) {
        let mut queue = VecDeque::from([(node, time)]);
        while let Some((node, time)) = queue.pop_front() {
            if time > heads[node] || (queue.is_empty() && time == heads[node]) {
                heads[node] = heads[node].max(time);
                for &(to, weight) in &self.forward[node] {
                    if time + weight > heads[to] {
                        queue.push_back((to, time + weight));
                    }
                }
            }
        }
    }

    pub(super) fn time(&mut self, sequences: &Sequences) -> Option<Timed> {
        let mut after = vec![NONE; self.nodes];
        let mut before = vec![NONE; self.nodes];
        for sequence in sequences {
            for pair in sequence.windows(2) {
                after[self.end(pair[0])] = self.start(pair[1]);
                before[self.start(pair[1])] = self.end(pair[0]);
            }
        }
        let mut open: Vec<usize> = (0..self.nodes)
            .map(|node| self.backward[node].len() + usize::from(before[node] != NONE))
            .collect();
        let mut order: Vec<usize> = (0..self.nodes).filter(|node| open[*node] == 0).collect();
        let mut heads = vec![0i64; self.nodes];
        let mut decided = vec![NONE; self.nodes];
        let mut next = 0;
        while let Some(&node) = order.get(next) {
            next += 1;
            let extra = (after[node] != NONE).then_some((after[node], 0));
            for (to, weight) in self.forward[node].iter().copied().chain(extra) {
                self.work += 1;
                if heads[node] + weight > heads[to]
                    || (decided[to] == NONE && heads[node] + weight == heads[to])
                {
                    heads[to] = heads[node] + weight;
                    decided[to] = node;
                }
                open[to] -= 1;
                if open[to] == 0 {
                    order.push(to);
                }
            }
        }
        if order.len() < self.nodes {
            return None;
        }
        self.settle(&order, &after, &mut heads, &mut decided);
        let late = self.upper.iter().map(|(from, to, bound)| beyond(&heads, *from, *to, *bound)).sum();
        let last = (0..self.nodes).max_by_key(|node| (heads[*node], *node)).unwrap_or(0);
        let cost = Cost { late, makespan: heads[last] };
        Some(Timed { heads, order, cost, decided, last })
    }

    /// Postpones events that are too far ahead of others for an upper bound. The origin cannot be postponed: an event that is later than
    /// the origin allows stays late. If events postpone each other forever, all times stay unchanged.
    fn settle(&mut self, order: &[usize], after: &[usize], heads: &mut Vec<i64>, decided: &mut Vec<usize>) {
        let before = (heads.clone(), decided.clone());
        for _ in 0..ROUNDS_MAX {
            let mut kept = true;
            for &(from, to, bound) in self.upper.iter().filter(|(from, ..)| *from != 0) {
                let beyond = beyond(heads, from, to, bound);
                if beyond > 0 {
                    (heads[from], decided[from], kept) = (heads[from] + beyond, to, false);
                }
            }
            self.work += self.upper.len();
            if kept {
                return;
            }
            for &node in order {
                let extra = (after[node] != NONE).then_some((after[node], 0));
                for (to, weight) in self.forward[node].iter().copied().chain(extra) {
                    if heads[node] + weight > heads[to] {
                        (heads[to], decided[to]) = (heads[node] + weight, node);
                    }
                }
            }
            self.work += self.nodes;
        }
        (*heads, *decided) = before;
    }

    pub(super) fn exact(&self, network: &Network, sequences: &Sequences) -> Option<Schedule> {
        let mut network = network.clone();
        for sequence in sequences {
            for pair in sequence.windows(2) {
                network.constrain(self.tasks[pair[0]].end, self.tasks[pair[1]].start, Some(Span::ZERO), None);
            }
        }
        network.solve().ok()
    }
}

/// Amount by which the times in `heads` violate an upper bound; 0 if they meet it.
fn beyond(heads: &[i64], from: usize, to: usize, bound: i64) -> i64 {
    (heads[to] - heads[from] - bound).max(0)
}

/// Returns the cost of Jackson's preemptive schedule for jobs (head, length, tail) on one machine: the maximum of completion time plus
/// tail.
fn preemptive(jobs: &[(i64, i64, i64)]) -> i64 {
    let mut by_head: Vec<_> = jobs.to_vec();
    by_head.sort_unstable();
    let mut next = by_head.iter().peekable();
    let mut ready: BinaryHeap<(i64, i64)> = BinaryHeap::new();
    let (mut time, mut end) = (i64::MIN / 2, UNREACHED);
    loop {
        if ready.is_empty() {
            match next.peek() {
                Some((head, ..)) => time = time.max(*head),
                None => return end,
            }
        }
        while let Some((head, length, tail)) = next.peek().filter(|(head, ..)| *head <= time) {
            let _ = head;
            ready.push((*tail, *length));
            next.next();
        }
        let Some((tail, length)) = ready.pop() else { continue };
        let until = next.peek().map_or(i64::MAX, |(head, ..)| *head);
        let done = length.min(until - time);
        time += done;
        if done < length {
            ready.push((tail, length - done))
        } else {
            end = end.max(time.saturating_add(tail))
        }
    }
}
