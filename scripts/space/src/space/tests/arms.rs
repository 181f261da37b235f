//! Arms, compared with closed forms and with a slow computation: matrices for the joints, a search along the links for distances.

use std::f64::consts::{FRAC_PI_2, PI};

use parry3d_f64::math::{Pose, Rotation, Vector};
use parry3d_f64::shape::{Cuboid, Segment};

use super::super::part::{BodyPart, Core};
use super::super::{Joint, JointKind};
use super::*;

const RADIUS: f64 = 0.05;

fn joint(xyz: [f64; 3]) -> Joint {
    Joint {
        name: "j".into(),
        kind: JointKind::Revolute,
        xyz,
        rpy: [0.0; 3],
        axis: [0.0, 0.0, 1.0],
        value: Coordinate::Fixed(0.0),
        radius: RADIUS,
    }
}

/// Returns an arm with two links of 1 m in a plane.
fn planar() -> Body {
    let joints = vec![joint([0.0; 3]), joint([1.0, 0.0, 0.0])];
    Body { joints, tip: [1.0, 0.0, 0.0], ..Body::default() }
}

fn arm(body: &Body, base: [f64; 4], joints: Vec<Axis>, ends: f64) -> Mover {
    let axes: Vec<Axis> = base.map(fixed).into_iter().chain(joints).collect();
    Mover::new(Path::of(&axes, true), Solid::of(body, 0.0), ends, 3)
}

/// Returns an arm whose tip is at `2 cos(angle)` in front of the base, because the elbow turns back by twice the angle of the shoulder.
fn reaching(base: [f64; 4], angles: [f64; 2]) -> Mover {
    let shoulder = axis(&[(0.0, angles[0]), (2.0, angles[1])]);
    let elbow = axis(&[(0.0, -2.0 * angles[0]), (2.0, -2.0 * angles[1])]);
    arm(&planar(), base, vec![shoulder, elbow], 2.0)
}

fn ball(x: f64, y: f64, radius: f64) -> Mover {
    mover([fixed(x), fixed(y), fixed(0.0), fixed(0.0)], &Shape::Ball { radius }, 2.0)
}

#[test]
fn two_planar_arms_are_closest_at_their_tips() {
    let opposite = [4.5, 0.0, 0.0, PI];
    let through = between(&reaching([0.0; 4], [1.2, -0.8]), &reaching(opposite, [1.2, -0.8]));
    assert!((through.distance - (0.5 - 2.0 * RADIUS)).abs() < 1e-4, "{through:?}");
    assert!((through.at - 1.2).abs() < 0.02, "{through:?}");
    let towards = between(&reaching([0.0; 4], [1.2, 0.2]), &reaching(opposite, [1.2, 0.2]));
    let expected = 4.5 - 4.0 * 0.2_f64.cos() - 2.0 * RADIUS;
    assert!((towards.distance - expected).abs() < 1e-9 && towards.at == 2.0, "{towards:?}, not {expected}");
}

#[test]
fn arm_touches_a_ball_when_its_tip_arrives() {
    let arm = || reaching([0.0; 4], [1.2, 0.0]);
    let first = first_contact(&arm(), &ball(2.0, 0.0, 0.15)).unwrap();
    // 2 cos(angle) = 2 - 0.05 - 0.15
    let expected = 2.0 * (1.2 - 0.9_f64.acos()) / 1.2;
    assert!((first - expected).abs() < 1e-3, "{first}, not {expected}");
    assert_eq!(first_contact(&arm(), &ball(2.21, 0.0, 0.15)), None);
}

#[test]
fn arm_leaves_its_volume_between_its_steps() {
    let hall = Volume { most: [1.9, f64::INFINITY, f64::INFINITY], ..Volume::default() };
    let out = furthest_out(&reaching([0.0; 4], [1.0, -1.0]), &hall).unwrap();
    assert!((out.distance - (2.0 + RADIUS - 1.9)).abs() < 1e-4 && (out.at - 1.0).abs() < 0.02, "{out:?}");
    assert_eq!(furthest_out(&reaching([0.0; 4], [1.0, 0.5]), &hall), None);
}

#[test]
fn arm_touches_an_infinite_floor() {
    let mut joints = vec![joint([0.0; 3])];
    joints[0].axis = [0.0, 1.0, 0.0];
    let body = Body { joints, tip: [1.0, 0.0, 0.0], ..Body::default() };
    let falls = axis(&[(0.0, 0.0), (2.0, FRAC_PI_2)]);
    let arm = arm(&body, [0.3, -0.2, 0.5 + RADIUS, 0.0], vec![falls], 2.0);
    let (solid, place) = Solid::of_volume(&Volume {
        least: [f64::NEG_INFINITY, f64::NEG_INFINITY, -1.0],
        most: [f64::INFINITY, f64::INFINITY, 0.0],
    });
    let floor = Mover::new(Path::resting(place, 2.0), solid, 2.0, 3);
    // After 30 degrees, the tip is half a metre lower.
    let first = first_contact(&arm, &floor).unwrap();
    assert!((first - 2.0 / 3.0).abs() < 1e-3, "{first}");
}

#[test]
fn roll_pitch_and_yaw_use_fixed_axes_and_joints_may_slide() {
    let mut turned = joint([0.0, 0.0, 1.0]);
    // x points up after the pitch, then to the left of its initial direction after the yaw.
    turned.rpy = [0.3, -FRAC_PI_2, FRAC_PI_2];
    let mut slides = joint([0.5, 0.0, 0.0]);
    (slides.kind, slides.axis) = (JointKind::Prismatic, [1.0, 0.0, 0.0]);
    let body = Body { joints: vec![turned, slides], tip: [0.1, 0.0, 0.0], ..Body::default() };
    let place = Place { base: [0.0; 4], joints: [0.0, 0.4].into() };
    let Core::Segment(last) = Solid::of(&body, 0.0).parts(&place)[1].core else { panic!("no link") };
    assert!((last.a - Vector::new(0.0, 0.0, 1.5)).length() < 1e-12, "{last:?}");
    assert!((last.b - Vector::new(0.0, 0.0, 2.0)).length() < 1e-12, "{last:?}");
}

#[test]
fn arms_with_equal_motion_keep_their_distance() {
    let swing = || (0..200).map(|n| (f64::from(n) / 10.0, f64::from(n % 2) * 3.0)).collect::<Vec<_>>();
    let of = |x| arm(&planar(), [x, 0.0, 0.0, 0.0], vec![axis(&swing()), axis(&swing())], 19.9);
    let found = between(&of(0.0), &of(5.0));
    assert!(found.distance > 1.0, "{found:?}");
}

#[test]
fn arms_turning_absurdly_far_are_checked_quickly() {
    for far in [1e6, 1e150, 1e308] {
        let way = || axis(&[(0.0, -far), (1.0, far), (2.0, -far)]);
        let of = |x| arm(&planar(), [x, 0.0, 0.0, 0.0], vec![way(), way()], 2.0);
        let _some = closest(&of(0.0), &of(3.0), f64::INFINITY);
        let _none = first_contact(&of(0.0), &of(9.0));
        let _out = furthest_out(&of(0.0), &Volume { least: [-1.0; 3], most: [1.0; 3] });
    }
}

/// The rows of a rotation matrix, each followed by a component of the translation.
type Matrix = [[f64; 4]; 3];

fn times(a: &Matrix, b: &Matrix) -> Matrix {
    let entry = |i: usize, j: usize| {
        (0..3).map(|k| a[i][k] * b[k][j]).sum::<f64>() + if j == 3 { a[i][3] } else { 0.0 }
    };
    std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)))
}

fn moved([x, y, z]: [f64; 3]) -> Matrix {
    [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z]]
}

/// Returns a rotation by Rodrigues' formula.
fn turned([x, y, z]: [f64; 3], angle: f64) -> Matrix {
    let (s, c) = angle.sin_cos();
    let d = 1.0 - c;
    [
        [c + x * x * d, x * y * d - z * s, x * z * d + y * s, 0.0],
        [y * x * d + z * s, c + y * y * d, y * z * d - x * s, 0.0],
        [z * x * d - y * s, z * y * d + x * s, c + z * z * d, 0.0],
    ]
}

/// Returns the places of the joints and the tip, by matrices.
fn joints_by_matrices(body: &Body, place: &Place) -> Vec<[f64; 3]> {
    let [x, y, z, yaw] = place.base;
    let mut matrix = times(&moved([x, y, z]), &turned([0.0, 0.0, 1.0], yaw));
    let mut points = Vec::new();
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for (joint, value) in body.joints.iter().zip(&place.joints) {
        matrix = times(&matrix, &moved(joint.xyz));
        for i in [2, 1, 0] {
            matrix = times(&matrix, &turned(axes[i], joint.rpy[i]));
        }
        points.push(matrix.map(|row| row[3]));
        matrix = match joint.kind {
            JointKind::Revolute => times(&matrix, &turned(joint.axis, *value)),
            JointKind::Prismatic => times(&matrix, &moved(joint.axis.map(|part| part * value))),
        };
    }
    points.push(times(&matrix, &moved(body.tip)).map(|row| row[3]));
    points
}

/// Returns the minimum of a convex function over the arguments from 0 to 1, by ternary search.
fn least(of: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let third = (high - low) / 3.0;
        if of(low + third) < of(high - third) { high -= third } else { low += third }
    }
    of(f64::midpoint(low, high))
}

fn along([a, b]: [[f64; 3]; 2], s: f64) -> [f64; 3] {
    std::array::from_fn(|i| a[i] + s * (b[i] - a[i]))
}

fn length(way: [f64; 3]) -> f64 {
    way.iter().map(|part| part * part).sum::<f64>().sqrt()
}

fn to_link(point: [f64; 3], link: [[f64; 3]; 2]) -> f64 {
    let way: [f64; 3] = std::array::from_fn(|i| link[1][i] - link[0][i]);
    let squared = way.iter().map(|part| part * part).sum::<f64>();
    let towards = (0..3).map(|i| (point[i] - link[0][i]) * way[i]).sum::<f64>();
    let share = if squared > 0.0 { (towards / squared).clamp(0.0, 1.0) } else { 0.0 };
    let nearest = along(link, share);
    length(std::array::from_fn(|i| point[i] - nearest[i]))
}

fn to_box(point: [f64; 3], place: &Place, size: [f64; 3]) -> f64 {
    let (sin, cos) = place.base[3].sin_cos();
    let [x, y, z]: [f64; 3] = std::array::from_fn(|i| point[i] - place.base[i]);
    let local = [cos * x + sin * y, cos * y - sin * x, z];
    length(std::array::from_fn(|i| (local[i].abs() - size[i] / 2.0).max(0.0)))
}

/// Returns the distance between an arm's links and another body, by a slow method.
fn slow_distance((body, place): (&Body, &Place), (other, at): (&Body, &Place)) -> f64 {
    let points = joints_by_matrices(body, place);
    let others = joints_by_matrices(other, at);
    let mut least_of_all = f64::INFINITY;
    for (link, joint) in points.windows(2).map(|ends| [ends[0], ends[1]]).zip(&body.joints) {
        let mut note = |distance: f64| least_of_all = least_of_all.min((distance - joint.radius).max(0.0));
        for (far, joint) in others.windows(2).map(|ends| [ends[0], ends[1]]).zip(&other.joints) {
            note(least(|s| to_link(along(link, s), far)) - joint.radius);
        }
        match other.shape {
            Shape::Box { size } => note(least(|s| to_box(along(link, s), at, size))),
            Shape::Ball { radius } if other.joints.is_empty() => {
                note(to_link([at.base[0], at.base[1], at.base[2]], link) - radius);
            }
            Shape::Ball { .. } => {}
        }
    }
    least_of_all
}

fn unit(axis: [f64; 3]) -> [f64; 3] {
    let long = length(axis);
    if long > 0.1 { axis.map(|part| part / long) } else { [1.0, 0.0, 0.0] }
}

fn vector(most: f64) -> impl Strategy<Value = [f64; 3]> {
    [-most..most, -most..most, -most..most]
}

fn any_joint() -> impl Strategy<Value = Joint> {
    (vector(0.5), vector(3.0), vector(1.0), any::<bool>(), 0.0..0.1f64).prop_map(
        |(xyz, rpy, axis, slides, radius)| {
            let kind = if slides { JointKind::Prismatic } else { JointKind::Revolute };
            Joint { kind, rpy, axis: unit(axis), radius, ..joint(xyz) }
        },
    )
}

/// Generates arms on a base that may be a box.
fn any_arm() -> impl Strategy<Value = Body> {
    let base =
        prop_oneof![Just(POINT), [0.1..0.5f64, 0.1..0.5, 0.1..0.5].prop_map(|size| Shape::Box { size })];
    (base, proptest::collection::vec(any_joint(), 1..5), vector(0.5)).prop_map(|(shape, joints, tip)| Body {
        shape,
        joints,
        tip,
        ..Body::default()
    })
}

/// Generates arms, balls and boxes.
fn any_body() -> impl Strategy<Value = Body> {
    prop_oneof![any_arm(), shape().prop_map(|shape| Body { shape, ..Body::default() })]
}

/// Generates the values of coordinates over time in seconds, for as many coordinates as any body needs.
fn ways() -> impl Strategy<Value = Vec<Vec<(f64, f64)>>> {
    let way = proptest::collection::vec((0u32..40, -15i32..15), 1..6).prop_map(|mut points| {
        points.push((0, points[0].1));
        points.sort_by_key(|point| point.0);
        points.dedup_by_key(|point| point.0);
        points.into_iter().map(|(at, value)| (f64::from(at) / 10.0, f64::from(value) / 10.0)).collect()
    });
    proptest::collection::vec(way, 8)
}

fn path((body, ways): &(Body, Vec<Vec<(f64, f64)>>)) -> Path {
    let axes: Vec<Axis> = ways[..4 + body.joints.len()].iter().map(|points| axis(points)).collect();
    Path::of(&axes, true)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    /// Sampling every millisecond finds no closer approach, regardless of the depth of the trees.
    #[test]
    fn closest_approach_of_arms_matches_a_slow_search(
        a in (any_arm(), ways()), b in (any_body(), ways()), deep in 0u32..7,
    ) {
        let ends = 4.0;
        // The base of the first arm is checked with boxes elsewhere.
        let bare = Body { shape: POINT, ..a.0.clone() };
        let movers = [(&bare, &a), (&b.0, &b)].map(|(body, of)| {
            Mover::new(path(of), Solid::of(body, 0.0), ends, deep)
        });
        let found = between(&movers[0], &movers[1]);
        let paths = [path(&a), path(&b)];
        let gap = |at: f64| {
            let [of_a, of_b] = paths.each_ref().map(|path| path.within(at, at).next().unwrap().place);
            slow_distance((&bare, &of_a), (&b.0, &of_b))
        };
        let slow = (0..=4_000).map(|n| gap(f64::from(n) / 1_000.0)).fold(f64::INFINITY, f64::min);
        prop_assert!(found.distance <= slow + 4e-4, "{found:?}, but {slow}");
        prop_assert!((found.distance - gap(found.at)).abs() < 1e-6, "{found:?}, but there {}", gap(found.at));
    }

    /// No point of a link moves further, or bends more, than its bounds permit.
    #[test]
    fn links_never_move_further_than_their_bound(of in (any_arm(), ways()), part in 0.0..1.0f64) {
        let (body, ways) = &of;
        let solid = Solid::of(&Body { shape: POINT, ..body.clone() }, 0.0);
        let values = |i: usize| -> Vec<f64> {
            ways[..4 + body.joints.len()].iter().map(|way| way[i.min(way.len() - 1)].1).collect()
        };
        let (mut from, mut to) = (Place::from_values(&values(0)), Place::from_values(&values(1)));
        // The movement of the arm's base is excluded.
        (0..3).for_each(|i| (from.base[i], to.base[i]) = (0.0, 0.0));
        let sways = solid.sways(&from, &to);
        let points = |s: f64| joints_by_matrices(body, &from.towards(&to, s));
        let h = 1e-4;
        let [before, at, after] = [part - h, part, part + h].map(points);
        for (k, sway) in sways.iter().enumerate() {
            for end in [k, k + 1] {
                let speed = length(std::array::from_fn(|i| (after[end][i] - before[end][i]) / (2.0 * h)));
                let bend = length(std::array::from_fn(|i| (after[end][i] - 2.0 * at[end][i] + before[end][i]) / (h * h)));
                prop_assert!(speed <= sway.length * (1.0 + 1e-4) + 1e-6, "{k}: {speed}, {sway:?}");
                prop_assert!(bend <= sway.bend * (1.0 + 1e-3) + 1e-4, "{k}: {bend}, {sway:?}");
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    /// The distance between a link and a box, computed by the library, is the one that a search along the link finds.
    #[test]
    fn distance_between_link_and_box_matches_a_search(
        a in vector(1.5), b in vector(1.5), size in [0.05f64..1.0, 0.05..1.0, 0.05..1.0],
        place in [-0.5f64..0.5, -0.5..0.5, -0.5..0.5, -3.0..3.0], short in prop_oneof![Just(1.0), Just(1e-3), Just(0.0)],
    ) {
        let b = along([a, b], short);
        let link = BodyPart { core: Core::Segment(Segment::new(Vector::from_array(a), Vector::from_array(b))), radius: 0.0 };
        let [x, y, z, yaw] = place;
        let pose = Pose::from_parts(Vector::new(x, y, z), Rotation::from_rotation_z(yaw));
        let block = BodyPart { core: Core::Box(pose, Cuboid::new(Vector::from_array(size) / 2.0)), radius: 0.0 };
        let place = Place::of(place);
        let expected = least(|s| to_box(along([a, b], s), &place, size));
        for (found, name) in [(link.gap(&block), "link first"), (block.gap(&link), "box first")] {
            prop_assert!((found.distance - expected).abs() < 1e-6, "{name}: {}, expected {expected}", found.distance);
        }
    }

    #[test]
    fn distance_between_links_matches_a_search(
        a in [vector(1.0), vector(1.0)], b in [vector(1.0), vector(1.0)], alike in prop_oneof![Just(0.0), Just(1e-6), Just(1.0)],
    ) {
        // The segments are often parallel, or nearly so.
        let b = [b[0], std::array::from_fn(|i| b[0][i] + alike * b[1][i] + (1.0 - alike) * (a[1][i] - a[0][i]))];
        let part = |ends: [[f64; 3]; 2]| {
            let [a, b] = ends.map(Vector::from_array);
            BodyPart { core: Core::Segment(Segment::new(a, b)), radius: 0.0 }
        };
        let (found, expected) = (part(a).gap(&part(b)).distance, least(|s| to_link(along(a, s), b)));
        prop_assert!((found - expected).abs() < 1e-6, "{found}, expected {expected}");
    }
}
