//! Distances, compared with closed forms and with a slow computation of the same movements that samples many moments.

use proptest::prelude::*;
use urrcp::{Interpolation, Millis, Script, Setpoint, Step};

use super::closest::{Approach, Mover, closest, depth, first_contact};
use super::path::{Axis, Path, Played, peaks};
use super::place::Place;
use super::solid::Solid;
use super::volume::furthest_out;
use super::{Body, Coordinate, Shape, Volume};

mod arms;
mod drives;

const POINT: Shape = Shape::Ball { radius: 0.0 };

fn script(start_ms: f64, steps: &[(f64, f64)]) -> (Millis, Script) {
    let millis = |ms| Millis::new(ms).unwrap();
    let step =
        |&(ms, value): &(f64, f64)| Step::new(millis(ms), Setpoint::new(urrcp::ControlType::Position, value));
    (millis(start_ms), Script::new(steps.iter().map(step).collect()).unwrap())
}

fn axis_of(scripts: &[&(Millis, Script)], interpolation: Interpolation, begin: Option<f64>) -> Option<Axis> {
    let scripts: Vec<_> = scripts.iter().map(|(start, script)| (*start, script)).collect();
    let coordinate = Coordinate::Device { device: "d".parse().unwrap(), scale: 1.0, offset: 0.0 };
    Axis::of(&coordinate, &Played { scripts: &scripts, interpolation, begin, ..Played::default() })
}

/// Creates an axis that is linear between values; times are in seconds.
fn axis(points: &[(f64, f64)]) -> Axis {
    let steps: Vec<_> = points.iter().map(|(at, value)| (at * 1_000.0, *value)).collect();
    axis_of(&[&script(0.0, &steps)], Interpolation::Linear, None).unwrap()
}

fn fixed(value: f64) -> Axis {
    Axis::of(&Coordinate::Fixed(value), &Played::default()).unwrap()
}

fn solid(shape: &Shape) -> Solid {
    Solid::of(&Body { shape: *shape, ..Body::default() }, 0.0)
}

/// Returns the least distance between any part of `a` and any part of `b`.
fn distance((a, at_a): (&Solid, &Place), (b, at_b): (&Solid, &Place)) -> f64 {
    let parts = b.parts(at_b);
    let gaps = a.parts(at_a).into_iter().flat_map(|a| parts.iter().map(move |b| a.gap(b).distance));
    gaps.fold(f64::INFINITY, f64::min)
}

fn mover(axes: [Axis; 4], shape: &Shape, ends: f64) -> Mover {
    let path = Path::of(&axes, true);
    Mover::new(path, solid(shape), ends, 3)
}

fn between(a: &Mover, b: &Mover) -> Approach {
    closest(a, b, f64::INFINITY).unwrap()
}

#[test]
fn two_passing_points_are_closest_between_their_steps() {
    let a = mover([axis(&[(0.0, 0.0), (10.0, 10.0)]), fixed(0.0), fixed(1.0), fixed(0.0)], &POINT, 10.0);
    let b = mover([axis(&[(0.0, 10.0), (10.0, 0.0)]), fixed(0.3), fixed(1.4), fixed(0.0)], &POINT, 10.0);
    let approach = between(&a, &b);
    assert!((approach.distance - 0.5).abs() < 1e-9 && (approach.at - 5.0).abs() < 1e-9, "{approach:?}");
    assert_eq!(closest(&a, &b, 0.499), None);
}

#[test]
fn device_that_jumps_passes_all_places_in_between() {
    let jumps =
        axis_of(&[&script(0.0, &[(0.0, 0.0), (1_000.0, 4.0), (2_000.0, 4.0)])], Interpolation::Hold, None);
    let a = mover([jumps.unwrap(), fixed(0.0), fixed(0.0), fixed(0.0)], &POINT, 2.0);
    let b = mover([fixed(2.0), fixed(0.0), fixed(0.0), fixed(0.0)], &POINT, 2.0);
    assert_eq!(between(&a, &b), Approach { at: 1.0, distance: 0.0 });
}

#[test]
fn device_rests_between_scripts_and_starts_from_its_current_position() {
    let (first, second) = (script(0.0, &[(1_000.0, 2.0)]), script(3_000.0, &[(1_000.0, 4.0)]));
    let moves = axis_of(&[&first, &second], Interpolation::Linear, Some(0.0)).unwrap();
    let path = Path::of(&[moves, fixed(0.0), fixed(0.0), fixed(0.0)], true);
    let at: Vec<f64> = [0.5, 1.0, 2.0, 3.5, 4.0]
        .iter()
        .map(|at| path.within(*at, *at).next().unwrap().place.base[0])
        .collect();
    assert_eq!(at, [1.0, 2.0, 2.0, 3.0, 4.0]);
    let unknown = axis_of(&[&first], Interpolation::Linear, None).unwrap();
    assert_eq!(Path::of(&[unknown, fixed(0.0), fixed(0.0), fixed(0.0)], true).known_from(), 1.0);
    assert_eq!(axis_of(&[], Interpolation::Linear, None), None);
}

#[test]
fn initial_jump_is_a_movement_only_if_previous_place_is_certain() {
    let jumps = axis_of(&[&script(0.0, &[(0.0, 4.0), (1_000.0, 4.0)])], Interpolation::Linear, Some(0.0));
    let axes = [jumps.unwrap(), fixed(0.0), fixed(0.0), fixed(0.0)];
    let b = mover([fixed(1.0), fixed(0.0), fixed(0.0), fixed(0.0)], &POINT, 1.0);
    for (sure, distance) in [(true, 0.0), (false, 3.0)] {
        let a = Mover::new(Path::of(&axes, sure), solid(&POINT), 1.0, 3);
        assert_eq!(between(&a, &b).distance, distance);
    }
}

#[test]
fn overlapping_scripts_never_make_time_go_backwards() {
    let (first, second) =
        (script(0.0, &[(0.0, 0.0), (3_000.0, 3.0)]), script(1_000.0, &[(0.0, 1.0), (1_000.0, 5.0)]));
    let axes = [
        axis_of(&[&first, &second], Interpolation::Linear, None).unwrap(),
        fixed(0.0),
        fixed(0.0),
        fixed(0.0),
    ];
    let path = Path::of(&axes, true);
    assert!(path.knots().is_sorted_by_key(|knot| knot.at), "{path:?}");
    assert!(peaks(&axes).iter().flatten().all(|peak| peak.rate.is_finite()));
}

#[test]
fn rotating_box_is_closest_with_its_corner() {
    let turn = axis(&[(0.0, 0.0), (2.0, std::f64::consts::PI)]);
    let long = Shape::Box { size: [2.0, 0.2, 0.2] };
    let turning = mover([fixed(0.0), fixed(0.0), fixed(0.0), turn], &long, 2.0);
    let ball = mover([fixed(0.0), fixed(1.5), fixed(0.0), fixed(0.0)], &Shape::Ball { radius: 0.1 }, 2.0);
    let approach = between(&turning, &ball);
    // The box's corners move on a circle; the end between them comes closer to the ball: half a length.
    let corner = 1.0_f64.hypot(0.1);
    assert!((approach.distance - (1.4 - corner)).abs() < 2e-3, "{approach:?}");
    let touching =
        mover([fixed(0.0), fixed(1.05), fixed(0.0), fixed(0.0)], &Shape::Ball { radius: 0.1 }, 2.0);
    assert_eq!(between(&turning, &touching).distance, 0.0);
}

#[test]
fn bodies_moving_absurdly_far_are_checked_quickly() {
    let shape = Shape::Box { size: [0.4, 0.3, 0.2] };
    for far in [1e6, 1e150, 1e308] {
        let way = || axis(&[(0.0, -far), (1.0, far), (2.0, -far)]);
        let a = mover([way(), fixed(0.0), fixed(0.0), way()], &shape, 2.0);
        let b = mover([fixed(0.0), fixed(1.0), fixed(0.0), way()], &shape, 2.0);
        let _some = closest(&a, &b, f64::INFINITY);
        let _none = first_contact(&a, &b);
        assert!(furthest_out(&a, &Volume { least: [-1.0; 3], most: [1.0; 3] }).is_some());
    }
}

#[test]
fn first_contact_is_the_moment_of_entry() {
    let way = axis(&[(0.0, -2.0), (4.0, 2.0), (8.0, -2.0)]);
    let ball = mover([way, fixed(0.0), fixed(0.0), fixed(0.0)], &Shape::Ball { radius: 0.1 }, 8.0);
    let pillar = mover([fixed(0.5), fixed(0.0), fixed(0.0), fixed(0.0)], &Shape::Box { size: [0.4; 3] }, 8.0);
    // The first contact is at x = 0.2, on the ball's way there.
    let first = first_contact(&ball, &pillar).unwrap();
    assert!((first - 2.2).abs() < 1e-3, "{first}");
    let aside = mover([fixed(0.5), fixed(0.31), fixed(0.0), fixed(0.0)], &Shape::Box { size: [0.4; 3] }, 8.0);
    assert_eq!(first_contact(&ball, &aside), None);
}

#[test]
fn distance_outside_volume_includes_the_size_of_the_body() {
    let hall = Volume { least: [-1.0, -1.0, 0.0], most: [1.0, 1.0, f64::INFINITY] };
    let out = |axes: [Axis; 4], shape: &Shape| furthest_out(&mover(axes, shape, 2.0), &hall);
    let way = || axis(&[(0.0, 0.0), (1.0, 0.95), (2.0, 0.0)]);
    assert_eq!(out([way(), fixed(0.0), fixed(1.0), fixed(0.0)], &POINT), None);
    let wide = out([way(), fixed(0.0), fixed(1.0), fixed(0.0)], &Shape::Ball { radius: 0.1 }).unwrap();
    assert!((wide.distance - 0.05).abs() < 1e-9 && wide.at == 1.0, "{wide:?}");
    let turned = axis(&[(0.0, 0.0), (2.0, std::f64::consts::FRAC_PI_2)]);
    let plate = Shape::Box { size: [1.8, 1.8, 0.1] };
    let corner = out([fixed(0.0), fixed(0.0), fixed(1.0), turned], &plate).unwrap();
    assert!((corner.distance - (0.9 * 2.0_f64.sqrt() - 1.0)).abs() < 1e-3 && (corner.at - 1.0).abs() < 0.03);
}

#[test]
fn speeds_combine_all_directions_and_ignore_step_errors() {
    let way = || axis(&[(0.0, 0.0), (1.0, 3.0), (2.0, 3.0)]);
    let other = axis(&[(0.0, 0.0), (0.5, 0.0), (1.5, 4.0), (2.0, 4.0)]);
    let [speed, acceleration] = peaks(&[way(), other, fixed(0.0), fixed(0.0)]).map(Option::unwrap);
    assert_eq!((speed.rate, speed.from, speed.to), (5.0, 0.5, 1.0));
    // x: 3 m/s less within a second; y: 4 m/s more within 0.75 s, then less by the same amount.
    assert!((acceleration.rate - 3.0_f64.hypot(4.0 / 0.75)).abs() < 1e-9, "{acceleration:?}");
    let coordinate = Coordinate::Device { device: "d".parse().unwrap(), scale: 0.1, offset: 7.0 };
    let (start, script) = script(0.0, &[(0.0, 0.0), (1_000.0, 30.0)]);
    let scripts = [(start, &script)];
    let doubtful =
        Played { scripts: &scripts, interpolation: Interpolation::Linear, error: 5.0, ..Played::default() };
    let axes = [Axis::of(&coordinate, &doubtful).unwrap(), fixed(0.0), fixed(0.0), fixed(0.0)];
    assert_eq!(peaks(&axes)[0].unwrap().rate, 2.0);
}

fn points() -> impl Strategy<Value = Vec<(f64, f64)>> {
    proptest::collection::vec((0u32..400, -30i32..30), 1..30).prop_map(|mut points| {
        points.push((0, points[0].1));
        points.sort_by_key(|point| point.0);
        points.dedup_by_key(|point| point.0);
        points.into_iter().map(|(at, value)| (f64::from(at) / 20.0, f64::from(value) / 10.0)).collect()
    })
}

fn shape() -> impl Strategy<Value = Shape> {
    let side = || (1u32..20).prop_map(|side| f64::from(side) / 20.0);
    prop_oneof![
        side().prop_map(|radius| Shape::Ball { radius: radius - 0.05 }),
        [side(), side(), side()].prop_map(|size| Shape::Box { size }),
    ]
}

fn body() -> impl Strategy<Value = ([Vec<(f64, f64)>; 4], Shape)> {
    ([points(), points(), points(), points()], shape())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// The search finds a distance that is at most the least of many sampled distances, and that the bodies have at the reported time.
    #[test]
    fn closest_approach_matches_a_slow_search(a in body(), b in body()) {
        let ends = 20.0;
        let movers = [&a, &b].map(|(points, shape)| {
            mover(points.each_ref().map(|points| axis(points)), shape, ends)
        });
        let found = between(&movers[0], &movers[1]);
        let paths = [&a, &b].map(|(points, _)| Path::of(&points.each_ref().map(|points| axis(points)), true));
        let solids = [solid(&a.1), solid(&b.1)];
        let gap = |at: f64| {
            let places = paths.each_ref().map(|path| path.within(at, at).next().unwrap().place);
            distance((&solids[0], &places[0]), (&solids[1], &places[1]))
        };
        let slow = (0..=40_000).map(|n| gap(f64::from(n) * ends / 40_000.0)).fold(f64::INFINITY, f64::min);
        prop_assert!(found.distance <= slow + 2e-4, "{found:?}, but {slow}");
        prop_assert!((found.distance - gap(found.at)).abs() < 1e-6, "{found:?}, but there {}", gap(found.at));
    }

    /// The closest approach does not depend on the depth of the tree.
    #[test]
    fn tree_depth_does_not_affect_the_result(a in body(), b in body(), deep in 0u32..8) {
        let found = [3, deep].map(|depth| {
            let of = |(points, shape): &([Vec<(f64, f64)>; 4], Shape)| {
                Mover::new(Path::of(&points.each_ref().map(|points| axis(points)), true), solid(shape), 20.0, depth)
            };
            closest(&of(&a), &of(&b), f64::INFINITY).unwrap().distance
        });
        prop_assert!((found[0] - found[1]).abs() <= 2e-4, "{found:?}");
    }
}

#[test]
fn tree_depth_grows_with_path_length() {
    assert_eq!([0, 8, 16, 8_000, 100_000_000].map(depth), [0, 0, 1, 9, 12]);
}

/// Returns the corners of a box as seen from above, in order.
fn corners(size: [f64; 3], place: [f64; 4]) -> [[f64; 2]; 4] {
    let (sin, cos) = place[3].sin_cos();
    [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]].map(|[right, front]| {
        let (x, y) = (right * size[0] / 2.0, front * size[1] / 2.0);
        [place[0] + cos * x - sin * y, place[1] + sin * x + cos * y]
    })
}

/// Returns twice the area of a triangle, positive if its corners are counterclockwise.
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn to_side(point: [f64; 2], [a, b]: [[f64; 2]; 2]) -> f64 {
    let way = [b[0] - a[0], b[1] - a[1]];
    let along = (point[0] - a[0]) * way[0] + (point[1] - a[1]) * way[1];
    let share = (along / (way[0] * way[0] + way[1] * way[1])).clamp(0.0, 1.0);
    (point[0] - a[0] - share * way[0]).hypot(point[1] - a[1] - share * way[1])
}

/// Returns the distance between two upright boxes, from their horizontal and their vertical distance.
fn distance_of_boxes(a: ([f64; 3], [f64; 4]), b: ([f64; 3], [f64; 4])) -> f64 {
    let above = ((a.1[2] - b.1[2]).abs() - (a.0[2] + b.0[2]) / 2.0).max(0.0);
    let both = [corners(a.0, a.1), corners(b.0, b.1)];
    let sides = |box_: &[[f64; 2]; 4]| std::array::from_fn::<_, 4, _>(|i| [box_[i], box_[(i + 1) % 4]]);
    let [of_a, of_b] = both.each_ref().map(sides);
    let holds =
        |sides: &[[[f64; 2]; 2]; 4], point| sides.iter().all(|[from, to]| turn(*from, *to, point) >= 0.0);
    let cross = |[a, b]: [[f64; 2]; 2], [c, d]: [[f64; 2]; 2]| {
        turn(a, b, c) * turn(a, b, d) < 0.0 && turn(c, d, a) * turn(c, d, b) < 0.0
    };
    let overlap = both[0].iter().any(|point| holds(&of_b, *point))
        || both[1].iter().any(|point| holds(&of_a, *point))
        || of_a.iter().any(|side| of_b.iter().any(|other| cross(*side, *other)));
    let from_corners = |points: &[[f64; 2]; 4], sides: &[[[f64; 2]; 2]; 4]| {
        let all = points.iter().flat_map(|point| sides.iter().map(|side| to_side(*point, *side)));
        all.fold(f64::INFINITY, f64::min)
    };
    let beside = if overlap { 0.0 } else { from_corners(&both[0], &of_b).min(from_corners(&both[1], &of_a)) };
    beside.hypot(above)
}

proptest! {
    /// The distance between boxes is the one that geometry gives. It is computed by a library, one of whose methods is wrong in one of
    /// sixteen cases.
    #[test]
    fn distance_between_boxes_matches_geometry(
        size in [[0.05f64..1.0, 0.05..1.0, 0.05..1.0], [0.05f64..1.0, 0.05..1.0, 0.05..1.0]],
        place in [[-1.0f64..1.0, -1.0..1.0, -1.0..1.0, -3.0..3.0], [-1.0f64..1.0, -1.0..1.0, -1.0..1.0, -3.0..3.0]],
    ) {
        let solids = size.map(|size| solid(&Shape::Box { size }));
        let found = distance((&solids[0], &Place::of(place[0])), (&solids[1], &Place::of(place[1])));
        let expected = distance_of_boxes((size[0], place[0]), (size[1], place[1]));
        prop_assert!((found - expected).abs() < 1e-6, "{found}, expected {expected}");
    }
}
