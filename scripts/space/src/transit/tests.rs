//! Laws of groups in transit: assignments are permutations of least cost, and no two bodies come closer than reported.

use pathfinding::kuhn_munkres::kuhn_munkres_min;
use pathfinding::matrix::Matrix;
use proptest::prelude::*;

use super::approach::{SLACK, closest};
use super::assignment::{Assignment, Cheapest, Price, Ways};
use super::crossing::Crossed;
use super::{Body, Crossing, Goals, Least, Limits, Refused, Route, cross};
use crate::formation::{Point, metres_between, nearest_pair};

const FREE: Limits = Limits { axes: [[f64::INFINITY; 2]; 3], body: [f64::INFINITY; 2] };
const WAYS: Price = Price { sixteenths: 0, longest: f64::INFINITY };

/// Returns the assignment with the least sum of distances; surplus bodies do not move.
fn cheapest(starts: &[Point], places: &[Point]) -> Assignment {
    Ways::between(starts, places, starts).cheapest(WAYS).assignment
}

fn body(from: Point, keep: f64) -> Body {
    Body { from, keep, error: 0.0, rounding: 0.0, begin: 0.0, limits: FREE, heights: Some([0.0, 100.0]) }
}

fn points(count: impl Into<prop::collection::SizeRange>) -> impl Strategy<Value = Vec<Point>> {
    prop::collection::vec(prop::array::uniform3(-10.0..10.0f64), count)
}

/// Returns all permutations of the numbers below `count`, by exchanging the last number with each.
fn orders(count: usize) -> Vec<Vec<usize>> {
    match count {
        0 => vec![Vec::new()],
        _ => {
            let put = |order: Vec<usize>| {
                (0..count).map(move |at| {
                    let mut order = order.clone();
                    order.insert(at, count - 1);
                    order
                })
            };
            orders(count - 1).into_iter().flat_map(put).collect()
        }
    }
}

fn ways(starts: &[Point], places: &[Point], order: &[usize]) -> Vec<f64> {
    starts.iter().zip(order).map(|(start, place)| metres_between(*start, places[*place])).collect()
}

/// Returns the places in the order of the starts, for an assignment that has a place for every start.
fn order_of(assignment: &[Option<usize>]) -> Vec<usize> {
    let order: Vec<usize> = assignment.iter().map(|place| place.expect("a place for every start")).collect();
    let mut sorted = order.clone();
    sorted.sort_unstable();
    sorted.dedup();
    assert_eq!(sorted.len(), order.len(), "each place once");
    order
}

/// Whether no exchange of places in any ring of bodies decreases the sum of distances, which proves that the sum is the least one. The
/// Bellman-Ford algorithm finds the shortest exchanges.
fn is_least(starts: &[Point], places: &[Point], order: &[usize]) -> bool {
    let count = starts.len();
    let gain = |a: usize, b: usize| {
        metres_between(starts[a], places[order[b]]) - metres_between(starts[a], places[order[a]])
    };
    let mut reached = vec![0.0; count];
    for _ in 0..=count {
        let mut shorter = false;
        for a in 0..count {
            for b in 0..count {
                let through = reached[a] + gain(a, b);
                if through < reached[b] - 1e-7 {
                    (reached[b], shorter) = (through, true);
                }
            }
        }
        if !shorter {
            return true;
        }
    }
    false
}

/// Returns the least of many sampled distances between two routes.
fn sampled(a: &Route, b: &Route) -> f64 {
    let (from, to) = (a.begin.min(b.begin), a.end().max(b.end()));
    let at = |i: u32| from + (to - from) * f64::from(i) / 4_000.0;
    (0..=4_000).map(|i| metres_between(a.at(at(i)), b.at(at(i)))).fold(f64::INFINITY, f64::min)
}

#[test]
fn exchange_cycle_that_reduces_the_sum_is_found() {
    let starts = [[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]];
    let places = [[0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [2.0, 1.0, 0.0]];
    assert!(is_least(&starts, &places, &[0, 1, 2]));
    assert!(!is_least(&starts, &places, &[1, 2, 0]));
}

#[test]
fn paths_of_100_bodies_are_within_one_percent_of_minimum_in_20_cases() {
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let mut pairs = 0;
    while pairs < 20 {
        let tree = points(200).new_tree(&mut runner).unwrap();
        let all = proptest::strategy::ValueTree::current(&tree);
        let (starts, places) = all.split_at(100);
        if nearest_pair(places).unwrap().distance < 0.2 {
            continue;
        }
        pairs += 1;
        let order = order_of(&cheapest(starts, places));
        assert!(is_least(starts, places, &order));
        let least: f64 = ways(starts, places, &order).iter().sum();
        let bodies: Vec<Body> = starts.iter().map(|start| body(*start, 0.1)).collect();
        let goals = Goals::Any(places, starts);
        let crossing = Crossing { bodies: &bodies, goals, least: Least::Total, over: 10.0 };
        let crossed = cross(&crossing).unwrap().ways;
        let total: f64 = crossed.iter().map(|way| metres_between(way.from, way.to)).sum();
        assert!(total <= 1.01 * least, "{total} {least}");
        for (index, a) in crossed.iter().enumerate() {
            for b in &crossed[index + 1..] {
                let required = metres_between(a.from, b.from).min(0.2) - SLACK;
                assert!(closest(a, b, required - SLACK).is_none(), "{a:?} {b:?}");
            }
        }
    }
}

#[test]
fn two_bodies_swap_places_only_if_one_can_move_aside() {
    let crossing = |heights: Option<[f64; 2]>| {
        let at = |x: f64| Body { heights, ..body([x, 0.0, 1.0], 0.2) };
        let (bodies, goals) = ([at(0.0), at(3.0)], [[3.0, 0.0, 1.0], [0.0, 0.0, 1.0]]);
        cross(&Crossing { bodies: &bodies, goals: Goals::Own(&goals), least: Least::Total, over: 4.0 })
    };
    let ways = crossing(Some([1.0, 3.0])).unwrap().ways;
    assert!(sampled(&ways[0], &ways[1]) >= 0.4 - SLACK, "{ways:?}");
    let Err(Refused::Blocked(blocked)) = crossing(None) else { panic!("they cannot change their height") };
    assert_eq!((blocked.pair, blocked.pairs), ([0, 1], 1));
    assert!(blocked.distance < 1e-6 && (blocked.at - 2.0).abs() < 0.1, "{blocked:?}");
}

#[test]
fn reported_shortest_time_is_sufficient_and_less_is_not() {
    let limits = Limits { body: [1.5, 4.0], ..FREE };
    let bodies = [Body { limits, ..body([0.0; 3], 0.1) }];
    let over = |over| {
        let goals = Goals::Own(&[[4.0, 3.0, 0.0]]);
        cross(&Crossing { bodies: &bodies, goals, least: Least::Total, over })
    };
    let Err(Refused::TooShort { seconds, .. }) = over(1.0) else { panic!("5 m in 1 s") };
    // The largest speed of minimum jerk is 15/8 of the mean speed.
    assert!((seconds - 1.875 * 5.0 / 1.5).abs() < 1e-9, "{seconds}");
    assert!(over(seconds).is_ok() && over(seconds * 0.999).is_err());
}

#[test]
fn assignment_of_300_bodies_on_a_circle_has_the_least_sum() {
    let turn = |index: usize| {
        let angle = std::f64::consts::TAU * index as f64 / 300.0;
        [100.0 * angle.cos(), 100.0 * angle.sin(), 50.0]
    };
    let starts: Vec<Point> = (0..300).map(turn).collect();
    let places: Vec<Point> =
        (0..300).map(|index| [(index % 20) as f64 - 10.0, (index / 20) as f64 - 8.0, 50.0]).collect();
    assert!(is_least(&starts, &places, &order_of(&cheapest(&starts, &places))));
}

#[test]
fn bodies_on_equal_arcs_keep_a_constant_distance() {
    let way = |x: f64| Route { lift: 3.0, ..Route::straight([x, 0.0, 0.0], [x + 5.0, 2.0, 1.0], 0.0, 4.0) };
    let found = closest(&way(0.0), &way(0.5), 0.6).unwrap();
    // A search that stops at its limit returns a much lower bound.
    assert!((found.distance - 0.5).abs() <= SLACK + 1e-9, "{found:?}");
    assert!(closest(&way(0.0), &way(0.5), 0.4).is_none());
}

#[test]
fn bodies_move_from_dense_grid_to_dense_circle_with_minimal_longest_path() {
    let starts: Vec<Point> =
        (0..300).map(|index| [(index % 20) as f64 * 1.5, (index / 20) as f64 * 1.5, 0.0]).collect();
    let turn = |index: usize| {
        let angle = std::f64::consts::TAU * index as f64 / 300.0;
        [70.0 * angle.cos(), 80.0 + 70.0 * angle.sin(), 10.0]
    };
    let places: Vec<Point> = (0..300).map(turn).collect();
    let bodies: Vec<Body> = starts.iter().map(|start| body(*start, 0.6)).collect();
    let goals = Goals::Any(&places, &starts);
    let ways = cross(&Crossing { bodies: &bodies, goals, least: Least::Longest, over: 30.0 }).unwrap().ways;
    for (index, a) in ways.iter().enumerate() {
        assert!(ways[index + 1..].iter().all(|b| closest(a, b, 1.2 - SLACK).is_none()), "{index}");
    }
}

/// Returns the least sum of distances by the Hungarian algorithm, in metres. Distances are added as whole numbers of nanometres.
#[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "ways are short")]
fn hungarian(starts: &[Point], places: &[Point], spare: &[Point]) -> f64 {
    let left_over = starts.len().saturating_sub(places.len());
    let ways = Matrix::from_fn(starts.len(), places.len() + left_over, |(start, place)| {
        let goal = places.get(place).unwrap_or(&spare[start]);
        (metres_between(starts[start], *goal) * 1e9).round() as i64
    });
    let (total, _) = kuhn_munkres_min(&ways);
    total as f64 / 1e9
}

/// Checks that an assignment has the least sum of distances.
#[track_caller]
fn check_sum(starts: &[Point], places: &[Point], spare: &[Point]) {
    let assignment = Ways::between(starts, places, spare).cheapest(WAYS).assignment;
    let mut taken: Vec<usize> = assignment.iter().copied().flatten().collect();
    taken.sort_unstable();
    taken.dedup();
    assert_eq!(taken.len(), starts.len().min(places.len()), "each place once, as many as possible");
    let goal = |start: usize| assignment[start].map_or(spare[start], |place| places[place]);
    let total: f64 = (0..starts.len()).map(|start| metres_between(starts[start], goal(start))).sum();
    let least = hungarian(starts, places, spare);
    assert!((total - least).abs() <= 1e-6 * (1.0 + least), "{total} {least}");
}

fn grid(count: usize, columns: usize, at: Point) -> Vec<Point> {
    let place = |index: usize| [at[0] + (index % columns) as f64, at[1] + (index / columns) as f64, at[2]];
    (0..count).map(place).collect()
}

#[test]
fn sum_is_least_with_many_equal_paths() {
    // Two grids have few different distances. If a grid is only raised, all assignments along a line are equivalent.
    check_sum(&grid(400, 20, [0.0; 3]), &grid(400, 10, [7.0, 3.0, 5.0]), &[[0.0; 3]; 400]);
    check_sum(&grid(400, 20, [0.0; 3]), &grid(400, 20, [0.0, 0.0, 9.0]), &[[0.0; 3]; 400]);
    check_sum(&grid(300, 300, [0.0; 3]), &grid(300, 300, [120.0, 0.0, 0.0]), &[[0.0; 3]; 300]);
}

#[test]
fn sum_is_least_with_coinciding_points() {
    let same = [[3.0, 4.0, 0.0]; 200];
    check_sum(&same, &same, &same);
    check_sum(&same, &grid(200, 20, [0.0; 3]), &same);
    check_sum(&same, &[[0.0; 3]; 90], &grid(200, 20, [0.0; 3]));
    check_sum(&same[..90], &same, &same[..90]);
    let halves = [grid(100, 10, [0.0; 3]), grid(100, 10, [0.0; 3])].concat();
    check_sum(&halves, &grid(200, 20, [2.0, 1.0, 0.0]), &halves);
}

#[test]
fn sum_is_least_with_far_more_places_or_bodies_at_equal_distances() {
    let (few, many) = (grid(60, 10, [0.0, 0.0, 4.0]), grid(500, 25, [-3.0, 2.0, 0.0]));
    check_sum(&few, &many, &few);
    check_sum(&many, &few, &many);
    check_sum(&many, &few, &grid(500, 20, [1.0, 1.0, 3.0]));
}

#[test]
fn auction_stopped_early_is_proven_close_to_the_least_sum() {
    let turn = |index: usize| {
        let angle = std::f64::consts::TAU * index as f64 / 1_500.0;
        [477.0 * angle.cos(), 477.0 * angle.sin(), 60.0]
    };
    let (starts, places) = (grid(1_500, 40, [0.0; 3]), (0..1_500).map(turn).collect::<Vec<Point>>());
    let all = Ways::between(&starts, &places, &starts);
    let [whole, early] = [u64::MAX, 1_000_000].map(|compared| all.cheapest_within(WAYS, compared));
    let total =
        |found: &Cheapest| -> f64 { ways(&starts, &places, &order_of(&found.assignment)).iter().sum() };
    let (whole, early) = ((total(&whole), whole.proven), (total(&early), early.proven));
    assert!(whole.1 > 1.0 - 1e-6 && early.1 < 1.0 - 1e-6, "{whole:?} {early:?}");
    assert!(early.0 <= 1.001 * whole.0 && early.0 * early.1 <= whole.0 + 1e-6, "{whole:?} {early:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn sums_of_larger_groups_match_the_hungarian_algorithm(
        starts in points(1..300), places in points(1..300), homes in points(300), step in 0.01..4.0f64, go_home: bool,
    ) {
        // On a grid, many distances are equal, and points coincide.
        let gridded = |points: &[Point]| -> Vec<Point> {
            points.iter().map(|point| point.map(|part| (part / step).round() * step)).collect()
        };
        for (starts, places) in [(starts.clone(), places.clone()), (gridded(&starts), gridded(&places))] {
            let spare = if go_home { &homes[..starts.len()] } else { &starts[..] };
            check_sum(&starts, &places, spare);
        }
    }

    #[test]
    fn longest_path_of_larger_groups_cannot_be_shortened(
        starts in points(1..200), places in points(1..200), homes in points(200), step in 0.01..4.0f64,
    ) {
        let gridded = |points: &[Point]| -> Vec<Point> {
            points.iter().map(|point| point.map(|part| (part / step).round() * step)).collect()
        };
        for (starts, places) in [(starts.clone(), places.clone()), (gridded(&starts), gridded(&places))] {
            let spare = &homes[..starts.len()];
            let between = Ways::between(&starts, &places, spare);
            let shortest = between.shortest_longest();
            prop_assert!(fits(&starts, &places, spare, shortest));
            prop_assert!(shortest == 0.0 || !fits(&starts, &places, spare, shortest * (1.0 - 1e-9)), "{shortest}");
            let bound = Price { sixteenths: 0, longest: shortest };
            let bounded = between.cheapest(bound).assignment;
            let goal = |start: usize| bounded[start].map_or(spare[start], |place| places[place]);
            prop_assert!((0..starts.len()).all(|start| metres_between(starts[start], goal(start)) <= shortest));
        }
    }
}

/// Whether each start can have a place within `length`, or each place a start, by successive augmenting paths. If there are fewer
/// places, the other starts need their spare place within `length`.
fn fits(starts: &[Point], places: &[Point], spare: &[Point], length: f64) -> bool {
    let left_over = starts.len().saturating_sub(places.len());
    let columns = places.len() + left_over;
    let reaches = |start: usize, column: usize| {
        metres_between(starts[start], *places.get(column).unwrap_or(&spare[start])) <= length
    };
    let mut owner: Vec<Option<usize>> = vec![None; columns];
    (0..starts.len()).all(|start| {
        let mut seen = vec![false; columns];
        let mut from = vec![0; columns];
        let mut reached = vec![start];
        while let Some(row) = reached.pop() {
            for column in (0..columns).filter(|column| reaches(row, *column)) {
                if std::mem::replace(&mut seen[column], true) {
                    continue;
                }
                from[column] = row;
                let Some(next) = owner[column] else {
                    let mut free = column;
                    loop {
                        let row = from[free];
                        let before = owner.iter().position(|owner| *owner == Some(row));
                        owner[free] = Some(row);
                        match before {
                            Some(before) if before != free => free = before,
                            _ => return true,
                        }
                    }
                };
                reached.push(next);
            }
        }
        false
    })
}

proptest! {
    #[test]
    fn least_sum_and_shortest_longest_path_match_all_permutations(all in (1usize..=7).prop_flat_map(|n| points(2 * n))) {
        let (starts, places) = all.split_at(all.len() / 2);
        let every = orders(starts.len());
        let sums = every.iter().map(|order| ways(starts, places, order).iter().sum::<f64>());
        let longest = every.iter().map(|order| ways(starts, places, order).into_iter().fold(0.0, f64::max));
        let (least, shortest) = (sums.fold(f64::INFINITY, f64::min), longest.fold(f64::INFINITY, f64::min));
        let found = order_of(&cheapest(starts, places));
        prop_assert!((ways(starts, places, &found).iter().sum::<f64>() - least).abs() < 1e-6);
        let between = Ways::between(starts, places, starts);
        prop_assert!((between.shortest_longest() - shortest).abs() < 1e-9);
        let bound = Price { sixteenths: 0, longest: shortest * (1.0 + 1e-9) };
        let bounded = order_of(&between.cheapest(bound).assignment);
        prop_assert!(ways(starts, places, &bounded).into_iter().fold(0.0, f64::max) <= shortest + 1e-6);
    }

    #[test]
    fn unequal_numbers_of_places_and_bodies_give_the_least_sum(
        starts in points(0..6), places in points(0..6), more in points(0..3), many: bool, homes in points(8), go_home: bool,
    ) {
        let (starts, places) = if many { (starts, [places, more].concat()) } else { ([starts, more].concat(), places) };
        let spare = if go_home { &homes[..starts.len()] } else { &starts[..] };
        let between = Ways::between(&starts, &places, spare);
        let assignment = between.cheapest(WAYS).assignment;
        prop_assert_eq!(assignment.len(), starts.len());
        let taken: Vec<Option<usize>> = assignment.iter().copied().filter(Option::is_some).collect();
        prop_assert_eq!(order_of(&taken).len(), starts.len().min(places.len()));
        let ways = |assignment: &[Option<usize>]| -> Vec<f64> {
            let goal = |(start, place): (usize, &Option<usize>)| place.map_or(spare[start], |place| places[place]);
            let goals = assignment.iter().enumerate().map(goal);
            starts.iter().zip(goals).map(|(start, goal)| metres_between(*start, goal)).collect()
        };
        // Places that do not exist may be taken in any order: their bodies are left over.
        let all = orders(starts.len().max(places.len()));
        let all: Vec<Vec<f64>> = all.iter().map(|order| {
            ways(&order[..starts.len()].iter().map(|place| Some(*place).filter(|place| *place < places.len())).collect::<Vec<_>>())
        }).collect();
        let total = ways(&assignment).iter().sum::<f64>();
        let least = all.iter().map(|ways| ways.iter().sum::<f64>()).fold(f64::INFINITY, f64::min);
        prop_assert!(total <= least + 1e-6, "{total} {least}");
        let longest = all.iter().map(|ways| ways.iter().copied().fold(0.0, f64::max)).fold(f64::INFINITY, f64::min);
        prop_assert!((between.shortest_longest() - longest).abs() < 1e-9, "{} {longest}", between.shortest_longest());
    }

    #[test]
    fn no_sample_is_closer_than_the_reported_approach(
        ends in points(4), times in prop::array::uniform4(0.1..5.0f64), lifts in prop::array::uniform2(-2.0..2.0f64), even: bool
    ) {
        let way = |index: usize| Route {
            from: ends[index], to: ends[index + 2], begin: times[index], length: times[index + 2], lift: lifts[index],
        };
        let (a, mut b) = (way(0), way(1));
        let a = if even { Route { lift: 0.0, ..a } } else { a };
        if even {
            b = Route { begin: a.begin, length: a.length, lift: 0.0, ..b };
        }
        let found = closest(&a, &b, 1e3).unwrap();
        let sampled = sampled(&a, &b);
        prop_assert!(found.distance <= sampled + 1e-9, "{} {sampled}", found.distance);
        prop_assert!(found.distance >= sampled - 2.0 * SLACK - 0.05, "{} {sampled}", found.distance);
        prop_assert!(metres_between(a.at(found.at), b.at(found.at)) <= found.distance + SLACK + 1e-6);
        prop_assert!(closest(&a, &b, found.distance - 1e-6).is_none());
    }

    #[test]
    fn bodies_in_accepted_crossings_keep_apart(
        starts in points(2..9), shift in prop::array::uniform3(-8.0..8.0f64), keep in 0.05..1.0f64, canon in 0.0..1.0f64,
        longest: bool,
    ) {
        let goals: Vec<Point> = starts.iter().map(|[x, y, z]| [y + shift[0], -x + shift[1], z + shift[2]]).collect();
        let begins = (0..starts.len()).map(|index| canon * index as f64);
        let bodies: Vec<Body> =
            starts.iter().zip(begins).map(|(start, begin)| Body { begin, ..body(*start, keep) }).collect();
        let least = if longest { Least::Longest } else { Least::Total };
        let crossing = Crossing { bodies: &bodies, goals: Goals::Any(&goals, &starts), least, over: 5.0 };
        if let Ok(Crossed { ways, .. }) = cross(&crossing) {
            for (a, b) in ways.iter().enumerate().flat_map(|(i, a)| ways[i + 1..].iter().map(move |b| (a, b))) {
                let begin = metres_between(a.from, b.from);
                prop_assert!(sampled(a, b) >= begin.min(2.0 * keep) - SLACK - 1e-6, "{a:?} {b:?}");
            }
            for (way, body) in ways.iter().zip(&bodies) {
                prop_assert!(way.begin >= body.begin - 1e-9 && way.end() <= body.begin + 5.0 + 1e-9);
            }
        }
    }
}
