//! Bodies that are driven by speeds, compared with circles, straight lines and a slow integration.

use std::f64::consts::{PI, TAU};

use super::super::drive::{Driven, Pose};
use super::super::{Drive, Steering};
use super::*;

const NONE: Coordinate = Coordinate::Fixed(0.0);

fn wheels(track: f64) -> Drive {
    Drive { steering: Steering::Wheels { left: NONE, right: NONE, track }, start: [0.0; 3] }
}

fn twist() -> Drive {
    Drive { steering: Steering::Twist { speed: NONE, turn: NONE }, start: [0.0; 3] }
}

fn drive(drive: &Drive, signals: [Axis; 2], ends: f64, lever: f64) -> Driven {
    drive.path(Pose::at([0.0; 3]), &signals, ends, lever).unwrap()
}

/// Returns the pose on the polyline at a time.
fn at(driven: &Driven, time: f64) -> [f64; 3] {
    let [x, y, yaw] = driven.axes.clone();
    let base = Path::of(&[x, y, fixed(0.0), yaw], true).within(time, time).next().unwrap().place.base;
    [base[0], base[1], base[3]]
}

fn holding(steps: &[(f64, f64)]) -> Axis {
    let steps: Vec<_> = steps.iter().map(|(at, value)| (at * 1_000.0, *value)).collect();
    axis_of(&[&script(0.0, &steps)], Interpolation::Hold, Some(0.0)).unwrap()
}

#[test]
fn constant_wheel_speeds_give_a_circle() {
    let wheel = |speed: f64| holding(&[(0.0, speed), (TAU, 0.0)]);
    // 0.5 m/s forward and 1 rad/s to the left: a radius of half a metre.
    let driven = drive(&wheels(0.2), [wheel(0.4), wheel(0.6)], TAU, 0.0);
    for eighth in 0..=8 {
        let angle = TAU * f64::from(eighth) / 8.0;
        let ([x, y, yaw], expected) = (at(&driven, angle), [0.5 * angle.sin(), 0.5 - 0.5 * angle.cos()]);
        assert!((x - expected[0]).hypot(y - expected[1]) < driven.margin, "{eighth}: {x}, {y}");
        assert!((yaw - angle).abs() < 1e-9);
    }
    let end = driven.end.unwrap();
    assert!(end.x.hypot(end.y) < 1e-9 && end.drift == 0.0 && driven.margin < 1e-4, "{driven:?}");
    let [speed, acceleration] = driven.peaks.map(|peak| peak.unwrap().rate);
    assert!((speed - 0.5).abs() < 1e-12 && (acceleration - 0.5).abs() < 1e-12, "{speed}, {acceleration}");
}

#[test]
fn opposite_wheels_turn_on_the_spot_and_a_ramp_drives_straight() {
    let wheel = |speed: f64| holding(&[(0.0, speed), (2.0, 0.0)]);
    let turned = drive(&wheels(0.3), [wheel(-0.15), wheel(0.15)], 2.0, 0.4);
    let end = turned.end.unwrap();
    assert!(end.x.abs() + end.y.abs() < 1e-12 && (end.yaw - 2.0).abs() < 1e-12, "{end:?}");
    let ramp = || axis(&[(0.0, 0.0), (1.0, 0.8), (3.0, 0.0)]);
    let straight = drive(&twist(), [ramp(), fixed(0.0)], 3.0, 0.0);
    let end = straight.end.unwrap();
    assert!((end.x - 1.2).abs() < 1e-9 && end.y == 0.0, "{end:?}");
    assert!((straight.peaks[1].unwrap().rate - 0.8).abs() < 1e-9);
}

#[test]
fn body_left_in_motion_continues_and_has_no_end() {
    let driven = drive(&twist(), [holding(&[(0.0, 0.5)]), fixed(0.0)], 4.0, 0.0);
    assert_eq!(driven.end, None);
    assert!((at(&driven, 4.0)[0] - 2.0).abs() < 1e-12);
}

#[test]
fn absurd_speeds_are_checked_quickly() {
    for fast in [1e4, 1e12, 1e300] {
        let wheel = |speed: f64| axis(&[(0.0, -speed), (10.0, speed)]);
        let driven = wheels(0.1).path(Pose::at([0.0; 3]), &[wheel(fast), wheel(-fast)], 10.0, 1.0);
        assert!(fast < 1e6 || driven.is_none_or(|driven| driven.margin > 1e-4));
    }
}

/// Integrates the values of both signals by small steps of the midpoint rule.
fn slowly(signals: &[Axis; 2], ends: f64, looks: usize) -> Vec<[f64; 3]> {
    let values = Path::of(&[signals[0].clone(), signals[1].clone(), fixed(0.0), fixed(0.0)], true);
    let steps = 40_000;
    let h = ends / steps as f64;
    let (mut pose, mut poses) = ([0.0; 3], Vec::new());
    for step in 0..=steps {
        if step % (steps / looks) == 0 {
            poses.push(pose);
        }
        let middle = (step as f64 + 0.5) * h;
        let base = values.within(middle, middle).next().unwrap().place.base;
        let course = pose[2] + base[1] * h / 2.0;
        pose = [
            pose[0] + base[0] * h * course.cos(),
            pose[1] + base[0] * h * course.sin(),
            pose[2] + base[1] * h,
        ];
    }
    poses
}

fn signal() -> impl Strategy<Value = Axis> {
    let steps = proptest::collection::vec((1u32..10, -10i32..=10), 1..6);
    (steps, any::<bool>()).prop_map(|(mut steps, holds)| {
        steps.sort_by_key(|step| step.0);
        steps.dedup_by_key(|step| step.0);
        let steps: Vec<_> =
            steps.iter().map(|(at, value)| (f64::from(*at), f64::from(*value) / 8.0)).collect();
        if holds { holding(&steps) } else { axis(&[(0.0, 0.0)].into_iter().chain(steps).collect::<Vec<_>>()) }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// The polyline equals a slow integration up to its margin.
    #[test]
    fn driven_body_matches_a_slow_integration(speed in signal(), turn in signal(), lever in 0.0..1.0f64) {
        let (ends, looks) = (10.0, 1_000);
        let driven = drive(&twist(), [speed.clone(), turn.clone()], ends, lever);
        prop_assert!(driven.margin < 1e-4, "{}", driven.margin);
        let [x, y, yaw] = driven.axes.clone();
        let path = Path::of(&[x, y, fixed(0.0), yaw], true);
        for (look, expected) in slowly(&[speed, turn], ends, looks).into_iter().enumerate() {
            let time = ends * look as f64 / looks as f64;
            let [x, y, _, yaw] = path.within(time, time).next().unwrap().place.base;
            let off = (x - expected[0]).hypot(y - expected[1]) + lever * (yaw - expected[2]).abs();
            // The slow integration itself has an error of some micrometres.
            prop_assert!(off <= driven.margin + 5e-6, "{time}: {off}, {}", driven.margin);
        }
    }
}

#[test]
fn rover_driving_in_an_arc_is_checked_with_its_margin() {
    let wheel = |speed: f64| holding(&[(0.0, speed), (PI, 0.0)]);
    let driven = drive(&wheels(0.2), [wheel(0.4), wheel(0.6)], PI, 0.15);
    let body = Body { shape: Shape::Ball { radius: 0.1 }, ..Body::default() };
    let [x, y, yaw] = driven.axes.clone();
    let path = Path::of(&[x, y, fixed(0.0), yaw], true);
    let rover = Mover::new(path, Solid::of(&body, driven.margin), PI, 3);
    let pole = mover([fixed(0.7), fixed(0.5), fixed(0.0), fixed(0.0)], &Shape::Ball { radius: 0.05 }, PI);
    let found = between(&rover, &pole);
    assert!(found.distance <= 0.05 && found.distance > 0.05 - 2.0 * driven.margin - 1e-9, "{found:?}");
}
