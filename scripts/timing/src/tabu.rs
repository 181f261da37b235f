//! The search for an order: starts from dispatching rules and improves by tabu search.

use std::collections::HashMap;

use urrcp::Span;

use super::network::Network;
use super::order::{Effort, Found, Ordering, Task};
use super::shop::{Cost, NONE, Sequences, Shop, Timed};

/// Minimum number of moves during which a swap may not be undone; a random number below this one is added.
const TENURE: usize = 8;
/// Number of moves without progress after which the search returns to the best order and changes it at random.
const PATIENCE: usize = 1_500;

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
    match (found, shop.few_orders()) {
        (Some(found), _) if found.makespan == found.at_least => Ordering::Found(found),
        (Some(found), None) => Ordering::Found(found),
        (None, None) => Ordering::NotFound,
        (_, Some(orders)) => shop.best_of(network, orders, at_least),
    }
}

/// Maximum number of orders that are tried exhaustively.
const ORDERS_MAX: usize = 720;
/// Largest number of events for an exhaustive search.
const EVENTS_MAX: usize = 2_000;

#[derive(Clone, Copy)]
enum Rule {
    /// Earliest possible start first, then longest remaining path.
    Head,
    /// Longest remaining path first.
    Tail,
    /// Least slack first.
    Slack,
}

impl Rule {
    const ALL: [Self; 3] = [Self::Slack, Self::Head, Self::Tail];
}

impl Shop<'_> {
    /// Returns all orders if there are at most [`ORDERS_MAX`].
    fn few_orders(&self) -> Option<Vec<Sequences>> {
        let mut all: Vec<Sequences> = vec![Vec::new()];
        for zone in 0..self.zones {
            let tasks = self.zone_tasks(zone);
            let count = (1..=tasks.len()).try_fold(all.len(), |orders, next| orders.checked_mul(next))?;
            if count > ORDERS_MAX || self.nodes > EVENTS_MAX {
                return None;
            }
            let own = permutations(&tasks);
            let with = |known: &Sequences| {
                own.iter().map(|order| [known.clone(), vec![order.clone()]].concat()).collect::<Vec<_>>()
            };
            all = all.iter().flat_map(with).collect();
        }
        Some(all)
    }

    /// Returns the order with the smallest makespan, or `Infeasible` if none of them keeps all bounds.
    fn best_of(&self, network: &Network, orders: Vec<Sequences>, at_least: i64) -> Ordering {
        let timed = |sequences| Some((self.exact(network, &sequences)?, sequences));
        let best = orders.into_iter().filter_map(timed).min_by_key(|(schedule, _)| schedule.makespan());
        best.map_or(Ordering::Infeasible(None), |(schedule, sequences)| {
            let at_least = Span::from_nanos(at_least);
            Ordering::Found(Found { sequences, makespan: schedule.makespan(), at_least, schedule })
        })
    }

    fn next_random(&mut self, below: usize) -> usize {
        // Marsaglia's xorshift with a fixed seed, so that results are reproducible.
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        usize::try_from(self.random >> 33).unwrap_or(0) % below.max(1)
    }

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
                // Tasks that wait for each other: the network has a cycle of length zero. Any order is acceptable.
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

    fn critical(&self, timed: &Timed) -> Vec<usize> {
        let broken =
            self.upper.iter().max_by_key(|(from, to, bound)| timed.heads[*to] - timed.heads[*from] - bound);
        let mut node = match broken.filter(|_| timed.cost.late > 0) {
            Some(&(_, to, _)) => to,
            None => timed.last,
        };
        let mut path = vec![node];
        // Events that determine each other would form a cycle.
        while timed.decided[node] != NONE && path.len() <= self.nodes {
            node = timed.decided[node];
            path.push(node);
        }
        path.reverse();
        path
    }

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
                // Undo the swap: `place` still holds the places of the two tasks before it.
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
}

fn permutations(tasks: &[usize]) -> Vec<Vec<usize>> {
    let [first, rest @ ..] = tasks else { return vec![Vec::new()] };
    let mut all = Vec::new();
    for order in permutations(rest) {
        for place in 0..=order.len() {
            let mut with = order.clone();
            with.insert(place, *first);
            all.push(with);
        }
    }
    all
}

/// Returns the zone of each task and its index in the zone's sequence.
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
