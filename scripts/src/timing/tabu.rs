//! The search for an order: heads and tails of tasks, dispatching, tabu search, and a bound to judge the result by.

use std::collections::{BinaryHeap, HashMap, VecDeque};

use urrcp::Span;

use super::network::{Network, Schedule};
use super::order::{Effort, Found, Ordering, Task};
use super::paths::{Arcs, UNREACHED, longest};

/// How long a swap may not be undone, in moves.
const TENURE: usize = 8;
/// After so many moves without progress the search goes back to the best order and shakes it.
const PATIENCE: usize = 1_500;

type Sequences = Vec<Vec<usize>>;

pub(super) fn search(network: &Network, tasks: &[Task], effort: Effort) -> Ordering {
    let mut shop = match Shop::new(network, tasks) {
        Ok(shop) => shop,
        Err(zone) => return Ordering::Infeasible(zone),
    };
    if let Some(zone) = shop.hopeless() {
        return Ordering::Infeasible(Some(zone));
    }
    let at_least = shop.at_least();
    let mut best: Option<(Cost, Sequences)> = None;
    for rule in Rule::ALL {
        let start = shop.dispatch(rule);
        shop.improve(start, effort, at_least, &mut best);
        if best.as_ref().is_some_and(|(cost, _)| cost.late == 0 && cost.makespan <= at_least) {
            break;
        }
    }
    let found = best.filter(|(cost, _)| cost.late == 0).and_then(|(cost, sequences)| {
        let schedule = shop.exact(network, &sequences)?;
        Some(Found {
            sequences,
            makespan: Span::from_nanos(cost.makespan),
            at_least: Span::from_nanos(at_least),
            schedule,
        })
    });
    found.map_or(Ordering::NotFound, Ordering::Found)
}

/// How an order is judged: first by how much it breaks upper bounds, then by its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Cost {
    late: i64,
    makespan: i64,
}

#[derive(Clone, Copy)]
enum Rule {
    /// Earliest possible start, then longest remaining way.
    Head,
    /// Longest remaining way first.
    Tail,
    /// Least time to spare.
    Slack,
}

impl Rule {
    const ALL: [Self; 3] = [Self::Slack, Self::Head, Self::Tail];
}

/// The network as the search sees it: lower bounds as a graph of events, upper bounds apart.
struct Shop<'a> {
    tasks: &'a [Task],
    zones: usize,
    nodes: usize,
    /// Lower bounds.
    forward: Vec<Vec<(usize, i64)>>,
    backward: Vec<Vec<(usize, i64)>>,
    /// to <= from + weight
    upper: Vec<(usize, usize, i64)>,
    /// Without any order.
    heads: Vec<i64>,
    tails: Vec<i64>,
    work: usize,
    random: u64,
}

/// Times of all events under an order.
struct Timed {
    heads: Vec<i64>,
    order: Vec<usize>,
    cost: Cost,
    /// The arc that decides each event: the event before.
    decided: Vec<usize>,
    last: usize,
}

const NONE: usize = usize::MAX;

impl<'a> Shop<'a> {
    fn new(network: &Network, tasks: &'a [Task]) -> Result<Self, Option<usize>> {
        let arcs: Arcs = network.arcs(None);
        let Ok(times) = longest(&arcs, vec![0; arcs.nodes()]) else { return Err(None) };
        let nodes = arcs.nodes();
        let (mut forward, mut backward, mut upper) =
            (vec![Vec::new(); nodes], vec![Vec::new(); nodes], Vec::new());
        for arc in arcs.all() {
            let (from, to) = (arc.from as usize, arc.to as usize);
            // An arc that points back in time bounds from above; so does one into the origin.
            if arc.weight < 0 || to == 0 {
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

    fn next_random(&mut self, below: usize) -> usize {
        // Marsaglia's xorshift: the same every time.
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        usize::try_from(self.random >> 33).unwrap_or(0) % below.max(1)
    }

    fn start(&self, task: usize) -> usize {
        self.tasks[task].start.0.index()
    }

    fn end(&self, task: usize) -> usize {
        self.tasks[task].end.0.index()
    }

    fn length(&self, task: usize) -> i64 {
        let (start, end) = (self.start(task), self.end(task));
        self.forward[start].iter().filter(|(to, _)| *to == end).map(|(_, weight)| *weight).max().unwrap_or(0)
    }

    /// The longest way from each event to any other, by lower bounds alone.
    fn longest_tails(&self) -> Vec<i64> {
        let arcs = self.backward_arcs();
        longest(&arcs, vec![0; self.nodes]).unwrap_or_else(|_| vec![0; self.nodes])
    }

    /// Lower bounds from their ends to their beginnings.
    fn backward_arcs(&self) -> Arcs {
        let reversed = (0..self.nodes)
            .flat_map(|to| self.backward[to].iter().map(move |(from, weight)| (to, *from, *weight, 0)));
        Arcs::new(self.nodes, reversed)
    }

    fn zone_tasks(&self, zone: usize) -> Vec<usize> {
        (0..self.tasks.len()).filter(|task| self.tasks[*task].zone == zone).collect()
    }

    /// A zone that cannot be done within the deadlines of its own tasks, even if tasks could be interrupted.
    fn hopeless(&self) -> Option<usize> {
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

    /// The latest time of each event that its deadlines and those of what follows allow.
    fn latest(&self, deadline: &HashMap<usize, i64>) -> Vec<i64> {
        let mut negated = vec![UNREACHED; self.nodes];
        for (&event, &bound) in deadline {
            negated[event] = -bound;
        }
        let negated = longest(&self.backward_arcs(), negated).unwrap_or_default();
        let latest = |time: &i64| if *time == UNREACHED { i64::MAX / 4 } else { -time };
        negated.iter().map(latest).collect()
    }

    /// No order ends earlier.
    fn at_least(&self) -> i64 {
        let chain = (0..self.nodes).map(|node| self.heads[node] + self.tails[node]).max().unwrap_or(0);
        let zone = |zone| {
            let tasks = self.zone_tasks(zone);
            let job =
                |&task: &usize| (self.heads[self.start(task)], self.length(task), self.tails[self.end(task)]);
            preemptive(&tasks.iter().map(job).collect::<Vec<_>>())
        };
        (0..self.zones).map(zone).max().unwrap_or(0).max(chain)
    }

    /// Gives each zone the task that is free first and, among those that could begin before that one ends, the most urgent
    /// one (Giffler and Thompson, Operations Research 8, 1960).
    fn dispatch(&mut self, rule: Rule) -> Sequences {
        let mut sequences: Sequences = vec![Vec::new(); self.zones];
        let mut free: Vec<i64> = vec![0; self.zones];
        let mut heads = self.heads.clone();
        let mut waiting: Vec<usize> = (0..self.tasks.len()).collect();
        let ahead = self.tasks_ahead();
        let mut done = vec![false; self.tasks.len()];
        while !waiting.is_empty() {
            let begins = |task: usize, heads: &[i64], free: &[i64]| {
                heads[self.start(task)].max(free[self.tasks[task].zone])
            };
            let ready: Vec<usize> = waiting
                .iter()
                .copied()
                .filter(|task| ahead[*task].iter().all(|before| done[*before]))
                .collect();
            let Some(&first) =
                ready.iter().min_by_key(|task| (begins(**task, &heads, &free) + self.length(**task), **task))
            else {
                // Tasks that wait for each other: the network has a cycle of zero length. Any order will do.
                sequences[self.tasks[waiting[0]].zone].push(waiting[0]);
                done[waiting[0]] = true;
                waiting.remove(0);
                continue;
            };
            let zone = self.tasks[first].zone;
            let until = begins(first, &heads, &free) + self.length(first);
            let candidates = ready.iter().copied().filter(|task| {
                self.tasks[*task].zone == zone
                    && begins(*task, &heads, &free) < until.max(begins(first, &heads, &free) + 1)
            });
            let chosen = candidates.min_by_key(|&task| {
                let (head, tail) = (begins(task, &heads, &free), self.tails[self.start(task)]);
                match rule {
                    Rule::Head => (head, -tail, task),
                    Rule::Tail => (-tail, head, task),
                    Rule::Slack => (head - tail, -tail, task),
                }
            });
            let chosen = chosen.unwrap_or(first);
            let begin = begins(chosen, &heads, &free);
            sequences[zone].push(chosen);
            done[chosen] = true;
            waiting.retain(|task| *task != chosen);
            free[zone] = begin + self.length(chosen);
            self.push_on(&mut heads, self.start(chosen), begin);
        }
        self.work += self.tasks.len() * 10;
        sequences
    }

    /// Raises an event and everything that lower bounds tie to it.
    fn push_on(&self, heads: &mut [i64], node: usize, time: i64) {
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

    /// For each task the tasks that must have ended before.
    fn tasks_ahead(&self) -> Vec<Vec<usize>> {
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

    /// The times under an order; none if it runs in a circle.
    fn time(&mut self, sequences: &Sequences) -> Option<Timed> {
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
        let late = self.upper.iter().map(|&(from, to, bound)| (heads[to] - heads[from] - bound).max(0)).sum();
        let last = (0..self.nodes).max_by_key(|node| (heads[*node], *node)).unwrap_or(0);
        let cost = Cost { late, makespan: heads[last] };
        Some(Timed { heads, order, cost, decided, last })
    }

    /// The events that decide the end, or the bound that is broken most, from the beginning on.
    fn critical(&self, timed: &Timed) -> Vec<usize> {
        let broken =
            self.upper.iter().max_by_key(|(from, to, bound)| timed.heads[*to] - timed.heads[*from] - bound);
        let mut node = match broken.filter(|_| timed.cost.late > 0) {
            Some(&(_, to, _)) => to,
            None => timed.last,
        };
        let mut path = vec![node];
        while timed.decided[node] != NONE {
            node = timed.decided[node];
            path.push(node);
        }
        path.reverse();
        path
    }

    /// The neighbours of an order: swaps of the first two and the last two tasks of each block on the critical path.
    fn swaps(&self, timed: &Timed, place: &[(usize, usize)]) -> Vec<(usize, usize)> {
        let path = self.critical(timed);
        let task_of: HashMap<usize, usize> =
            (0..self.tasks.len()).map(|task| (self.start(task), task)).collect();
        let tasks: Vec<usize> = path.iter().filter_map(|node| task_of.get(node).copied()).collect();
        let mut swaps = Vec::new();
        let mut begin = 0;
        while begin < tasks.len() {
            let mut end = begin + 1;
            let follows = |a: usize, b: usize| {
                place[tasks[a]].0 == place[tasks[b]].0 && place[tasks[a]].1 + 1 == place[tasks[b]].1
            };
            while end < tasks.len() && follows(end - 1, end) {
                end += 1;
            }
            if end - begin >= 2 {
                swaps.push((tasks[begin], tasks[begin + 1]));
                if end - begin > 2 {
                    swaps.push((tasks[end - 2], tasks[end - 1]));
                }
            }
            begin = end;
        }
        swaps
    }

    fn improve(
        &mut self,
        start: Sequences,
        effort: Effort,
        at_least: i64,
        best: &mut Option<(Cost, Sequences)>,
    ) {
        let mut current = start;
        let Some(mut timed) = self.time(&current) else { return };
        let better = |cost: Cost, best: &Option<(Cost, Sequences)>| {
            best.as_ref().is_none_or(|(known, _)| cost < *known)
        };
        if better(timed.cost, best) {
            *best = Some((timed.cost, current.clone()));
        }
        let mut local = (timed.cost, current.clone());
        let mut forbidden: HashMap<(usize, usize), usize> = HashMap::new();
        let mut stale = 0;
        for step in 0..effort.moves {
            let target = best.as_ref().map_or(i64::MAX, |(cost, _)| cost.late.max(cost.makespan - at_least));
            if target <= 0 || self.work > effort.work {
                return;
            }
            let place = places(&current, self.tasks.len());
            let mut choice: Option<(Cost, (usize, usize), Timed)> = None;
            for (a, b) in self.swaps(&timed, &place) {
                swap(&mut current, &place, a, b);
                if let Some(tried) = self.time(&current) {
                    let tabu = forbidden.get(&(a, b)).is_some_and(|until| step < *until);
                    let allowed = !tabu || tried.cost < local.0;
                    if allowed && choice.as_ref().is_none_or(|(cost, ..)| tried.cost < *cost) {
                        choice = Some((tried.cost, (a, b), tried));
                    }
                }
                // Back again: the places of the two are exchanged now.
                swap(&mut current, &place, a, b);
            }
            stale += 1;
            match choice {
                Some((cost, (a, b), tried)) => {
                    swap(&mut current, &place, a, b);
                    forbidden.insert((b, a), step + TENURE + self.next_random(TENURE));
                    timed = tried;
                    if cost < local.0 {
                        local = (cost, current.clone());
                        stale = 0;
                    }
                }
                None => stale = PATIENCE,
            }
            if better(local.0, best) {
                *best = Some(local.clone());
            }
            if stale >= PATIENCE {
                stale = 0;
                forbidden.clear();
                current = best.as_ref().map_or_else(|| current.clone(), |(_, sequences)| sequences.clone());
                timed = match self.shake(&mut current) {
                    Some(timed) => timed,
                    None => return,
                };
                local = (timed.cost, current.clone());
            }
        }
    }

    /// Some random swaps of neighbours on the critical path.
    fn shake(&mut self, sequences: &mut Sequences) -> Option<Timed> {
        let mut timed = self.time(sequences)?;
        for _ in 0..12 {
            let place = places(sequences, self.tasks.len());
            let swaps = self.swaps(&timed, &place);
            if swaps.is_empty() {
                return Some(timed);
            }
            let (a, b) = swaps[self.next_random(swaps.len())];
            swap(sequences, &place, a, b);
            match self.time(sequences) {
                Some(tried) => timed = tried,
                None => swap(sequences, &place, a, b),
            }
        }
        let _ = &timed.order;
        Some(timed)
    }

    /// The order in the network itself, with every bound.
    fn exact(&self, network: &Network, sequences: &Sequences) -> Option<Schedule> {
        let mut network = network.clone();
        for sequence in sequences {
            for pair in sequence.windows(2) {
                network.constrain(self.tasks[pair[0]].end, self.tasks[pair[1]].start, Some(Span::ZERO), None);
            }
        }
        network.solve().ok()
    }
}

/// Zone and place of each task.
fn places(sequences: &Sequences, tasks: usize) -> Vec<(usize, usize)> {
    let mut places = vec![(NONE, NONE); tasks];
    for (zone, sequence) in sequences.iter().enumerate() {
        for (index, &task) in sequence.iter().enumerate() {
            places[task] = (zone, index);
        }
    }
    places
}

fn swap(sequences: &mut Sequences, places: &[(usize, usize)], a: usize, b: usize) {
    let (zone, index) = places[a];
    sequences[zone].swap(index, places[b].1);
}

/// The end of Jackson's preemptive schedule: the longest of time and tail over jobs (head, length, tail) on one machine.
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
        match done < length {
            true => ready.push((tail, length - done)),
            false => end = end.max(time.saturating_add(tail)),
        }
    }
}
