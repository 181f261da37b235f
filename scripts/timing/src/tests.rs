//! Laws that hold in every network, compared with brute force on small ones.

use proptest::prelude::*;

use super::*;
use urrcp::Span;

fn span(nanos: i64) -> Span {
    Span::from_nanos(nanos)
}

#[derive(Clone, Debug)]
struct Small {
    events: usize,
    constraints: Vec<(usize, usize, Option<i64>, Option<i64>)>,
}

impl Small {
    fn network(&self) -> (Network, Vec<ConstraintId>) {
        let mut network = Network::new();
        let mut events = vec![network.origin()];
        events.extend((0..self.events).map(|_| network.event()));
        let constrain = |(from, to, min, max): &(usize, usize, Option<i64>, Option<i64>)| {
            network.constrain(events[*from], events[*to], min.map(span), max.map(span))
        };
        let ids = self.constraints.iter().map(constrain).collect();
        (network, ids)
    }

    /// Longest paths between all events (Floyd and Warshall); `None` if there is a positive cycle.
    fn ways(&self) -> Option<Vec<Vec<Option<i64>>>> {
        let n = self.events + 1;
        let mut ways = vec![vec![None; n]; n];
        let raise =
            |way: &mut Option<i64>, value: i64| *way = Some(way.map_or(value, |known: i64| known.max(value)));
        for (node, row) in ways.iter_mut().enumerate() {
            raise(&mut row[node], 0);
        }
        for way in &mut ways[0] {
            raise(way, 0);
        }
        for (from, to, min, max) in &self.constraints {
            if let Some(min) = min {
                raise(&mut ways[*from][*to], *min);
            }
            if let Some(max) = max {
                raise(&mut ways[*to][*from], -max);
            }
        }
        for k in 0..n {
            for i in 0..n {
                for j in 0..n {
                    if let (Some(a), Some(b)) = (ways[i][k], ways[k][j]) {
                        raise(&mut ways[i][j], a + b);
                    }
                }
            }
        }
        (0..n).all(|node| ways[node][node] == Some(0)).then_some(ways)
    }
}

fn small() -> impl Strategy<Value = Small> {
    (2usize..7).prop_flat_map(|events| {
        let bound = prop::option::of(-6i64..12);
        let constraint = (0..=events, 0..=events, bound.clone(), bound).prop_map(|(from, to, min, max)| {
            let max = max.map(|max| max.max(min.unwrap_or(max)));
            (from, to, min, max)
        });
        prop::collection::vec(constraint, 1..10).prop_map(move |constraints| Small { events, constraints })
    })
}

/// The number of arcs in the shortest positive cycle, by trying all lengths from all events.
fn fewest(small: &Small) -> usize {
    let n = small.events + 1;
    let mut arcs: Vec<(usize, usize, i64)> = (1..n).map(|node| (0, node, 0)).collect();
    for (from, to, min, max) in &small.constraints {
        arcs.extend(min.map(|min| (*from, *to, min)));
        arcs.extend(max.map(|max| (*to, *from, -max)));
    }
    for length in 1..=n {
        for start in 0..n {
            let mut best = vec![None; n];
            best[start] = Some(0i64);
            for _ in 0..length {
                let mut next: Vec<Option<i64>> = vec![None; n];
                for (from, to, weight) in &arcs {
                    if let Some(value) = best[*from] {
                        next[*to] =
                            Some(next[*to].map_or(value + weight, |known: i64| known.max(value + weight)));
                    }
                }
                best = next;
            }
            if best[start].is_some_and(|value| value > 0) {
                return length;
            }
        }
    }
    usize::MAX
}

fn check_conflict(small: &Small, conflict: &Conflict, ids: &[ConstraintId]) {
    assert_eq!(conflict.chain.len(), fewest(small), "{small:?} {conflict:?}");
    assert!(conflict.excess > Span::ZERO);
    let begin = |link: &Link| if link.bound == Bound::Min { link.from } else { link.to };
    let end = |link: &Link| if link.bound == Bound::Min { link.to } else { link.from };
    for (index, link) in conflict.chain.iter().enumerate() {
        let next = &conflict.chain[(index + 1) % conflict.chain.len()];
        assert_eq!(end(link), begin(next), "a chain");
    }
    for correction in &conflict.corrections {
        let link = conflict.chain[correction.link];
        let index = ids.iter().position(|id| Some(*id) == link.constraint).unwrap();
        for (by, consistent) in [(correction.by, true), (correction.by - span(1), false)] {
            let mut loosened = small.clone();
            let (_, _, min, max) = &mut loosened.constraints[index];
            match link.bound {
                Bound::Min => *min = min.map(|min| min - by.as_nanos()),
                Bound::Max => *max = max.map(|max| max + by.as_nanos()),
            }
            assert_eq!(loosened.ways().is_some(), consistent, "{small:?} {correction:?}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn schedule_is_earliest_and_conflict_is_smallest(small in small()) {
        let (network, ids) = small.network();
        match (small.ways(), network.solve()) {
            (Some(ways), Ok(schedule)) => {
                let expected: Vec<_> = ways[0].iter().map(|way| way.unwrap()).collect();
                prop_assert_eq!(schedule.0, expected);
            }
            (None, Err(conflict)) => check_conflict(&small, &conflict, &ids),
            (ways, solved) => prop_assert!(false, "{:?} {:?} {:?}", small, ways, solved),
        }
    }

    #[test]
    fn critical_events_lie_on_longest_paths_to_end(small in small()) {
        let (network, _) = small.network();
        let Ok(schedule) = network.solve() else { return Ok(()) };
        let mut forth = small.clone();
        for (from, to, min, max) in &mut forth.constraints {
            *min = min.filter(|_| *to > 0);
            *max = max.filter(|_| *from > 0);
        }
        let ways = forth.ways().unwrap();
        let last = schedule.makespan().as_nanos();
        let leads = |event: usize| ways[event].iter().flatten().any(|way| schedule.0[event] + way == last);
        let expected: Vec<_> = (0..=small.events).filter(|event| leads(*event)).collect();
        let mut found: Vec<_> = network.critical(&schedule).iter().map(|event| event.0.index()).collect();
        found.sort_unstable();
        prop_assert_eq!(found, expected);
    }

    #[test]
    fn no_event_can_be_later_than_its_latest_time(small in small(), room in 0i64..6) {
        let (network, _) = small.network();
        let Ok(earliest) = network.solve() else { return Ok(()) };
        let horizon = earliest.makespan() + span(room);
        let latest = network.latest(horizon).unwrap();
        for event in 1..=small.events {
            for (later, possible) in [(0, true), (1, false)] {
                let mut pushed = small.clone();
                pushed.constraints.push((0, event, Some(latest.0[event] + later), None));
                pushed.constraints.extend((1..=small.events).map(|other| (0, other, None, Some(horizon.as_nanos()))));
                prop_assert_eq!(pushed.ways().is_some(), possible, "{:?} {}", small, event);
            }
        }
    }

    #[test]
    fn incremental_change_matches_solving_again(
        small in small(),
        changes in prop::collection::vec((0usize..9, prop::option::of(-6i64..12), prop::option::of(-6i64..12)), 1..6),
    ) {
        let (network, ids) = small.network();
        let Ok(mut solved) = Solved::new(network) else { return Ok(()) };
        let mut changed = small.clone();
        for (index, min, max) in changes {
            let index = index % ids.len();
            let max = max.map(|max| max.max(min.unwrap_or(max)));
            let old = changed.constraints[index];
            (changed.constraints[index].2, changed.constraints[index].3) = (min, max);
            let solved_again = changed.network().0.solve();
            match (solved.change(ids[index], min.map(span), max.map(span)), solved_again) {
                (Ok(()), Ok(schedule)) => prop_assert_eq!(solved.schedule(), schedule),
                (Err(_), Err(_)) => changed.constraints[index] = old,
                (change, again) => prop_assert!(false, "{:?} {:?}", change, again),
            }
        }
    }

    #[test]
    fn order_of_few_tasks_is_optimal(lengths in prop::collection::vec((1i64..9, 0usize..2), 2..6), jobs in 1usize..4) {
        let mut network = Network::new();
        let mut tasks: Vec<Task> = Vec::new();
        let mut last = vec![network.origin(); jobs];
        for (index, (length, zone)) in lengths.iter().enumerate() {
            let (start, end) = (network.event(), network.event());
            network.constrain(start, end, Some(span(*length)), Some(span(*length)));
            network.constrain(last[index % jobs], start, Some(Span::ZERO), None);
            last[index % jobs] = end;
            tasks.push(Task { start, end, zone: *zone });
        }
        let Ordering::Found(found) = order(&network, &tasks, Effort { moves: 400, ..Effort::default() }) else { panic!("always possible") };
        let best = best_of_all(&network, &tasks, &mut Vec::new(), &mut (0..tasks.len()).collect());
        prop_assert_eq!(found.makespan.as_nanos(), best);
        prop_assert_eq!(found.schedule.makespan().as_nanos(), best);
        prop_assert!(found.at_least <= found.makespan);
    }
}

/// Orders two tasks of one zone, whose events have the given bounds. Returns the makespan; `None` if no order is found.
fn found_near(bounds: &[(usize, usize, Option<i64>, Option<i64>)]) -> Option<i64> {
    let mut network = Network::new();
    let mut events = vec![network.origin()];
    events.extend((0..6).map(|_| network.event()));
    for cue in 0..3 {
        network.constrain(events[1 + 2 * cue], events[2 + 2 * cue], Some(span(10)), Some(span(10)));
    }
    for (from, to, min, max) in bounds {
        network.constrain(events[*from], events[*to], min.map(span), max.map(span));
    }
    let task = |cue: usize| Task { start: events[1 + 2 * cue], end: events[2 + 2 * cue], zone: 0 };
    match order(&network, &[task(1), task(2)], Effort { moves: 100, ..Effort::default() }) {
        Ordering::Found(found) => Some(found.schedule.makespan().as_nanos()),
        _ => None,
    }
}

#[test]
fn order_is_found_for_tasks_tied_to_other_events() {
    // The third cue begins shortly before the first one ends.
    assert_eq!(found_near(&[(2, 5, Some(-1), None)]), Some(20));
    // The third cue begins with the first one or exactly 3 after it, and the second cue must be first.
    assert_eq!(found_near(&[(1, 5, Some(0), Some(0)), (4, 5, Some(0), None)]), Some(20));
    assert_eq!(found_near(&[(1, 5, Some(3), Some(3)), (4, 5, Some(4), None)]), Some(24));
    // The second cue is at a time before which the third one has not ended, and the first one ends with the third.
    assert_eq!(found_near(&[(0, 3, Some(9), Some(9)), (6, 2, Some(-1), Some(-1))]), Some(29));
    // Impossible with a deadline for the first cue.
    assert_eq!(found_near(&[(1, 5, Some(3), Some(3)), (4, 5, Some(4), None), (0, 2, None, Some(20))]), None);
}

/// The shortest makespan over all orders of all tasks.
fn best_of_all(network: &Network, tasks: &[Task], order: &mut Vec<usize>, rest: &mut Vec<usize>) -> i64 {
    if rest.is_empty() {
        let mut network = network.clone();
        for zone in 0..2 {
            let sequence: Vec<_> = order.iter().filter(|task| tasks[**task].zone == zone).collect();
            for pair in sequence.windows(2) {
                network.constrain(tasks[*pair[0]].end, tasks[*pair[1]].start, Some(Span::ZERO), None);
            }
        }
        return network.solve().map_or(i64::MAX, |schedule| schedule.makespan().as_nanos());
    }
    let mut best = i64::MAX;
    for index in 0..rest.len() {
        let task = rest.remove(index);
        order.push(task);
        best = best.min(best_of_all(network, tasks, order, rest));
        order.pop();
        rest.insert(index, task);
    }
    best
}
