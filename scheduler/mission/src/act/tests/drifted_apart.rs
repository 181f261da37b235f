//! Tests whether robots whose clocks drift while an act plays were certainly apart at its end.

use super::*;
use crate::ClockMode;
use crate::clock::ClockEstimate;

/// Returns two robots that have played. Each tuple contains the time in milliseconds from the start to the robot's end, and two values of
/// its clock: the offset at the start in milliseconds, and the drift relative to this machine's clock in ppm.
fn played(clock: ClockMode, robots: [(i64, i64, f64); 2]) -> Bench {
    let scripts = robots.map(|(lasts, ..)| [("a", 0, lasts)]);
    let scripts: Vec<&[Planned]> = scripts.iter().map(<[Planned; 1]>::as_slice).collect();
    let mut bench = Bench::new(&[Tells::Everything; 2], &scripts);
    bench.play(Leases::Shortened);
    let start = bench.start();
    bench.run_until(start + ms(1_000 + robots.map(|(lasts, ..)| lasts).into_iter().max().unwrap()));
    for (robot, (_, ahead, ppm)) in robots.into_iter().enumerate() {
        let mut estimate = ClockEstimate::default();
        for at in (0..=600_000).step_by(5_000).map(ms) {
            let gained = Span::from_millis_f64(at.as_millis_f64() * ppm / 1e6);
            let (now, there) = (start + at, by_robot(start + at) + ms(ahead) + gained);
            estimate.add(ClockSample::from_exchange(now, there, there, now));
        }
        bench.robots[RobotIndex::new(robot)].settings.clock = clock;
        bench.robots[RobotIndex::new(robot)].clock = estimate;
    }
    bench
}

#[track_caller]
fn check(clock: ClockMode, robots: [(i64, i64, f64); 2], apart: i64) {
    let bench = played(clock, robots);
    assert!(bench.act.members().iter().all(|member| member.is_done()), "both have ended");
    let found = bench.act.drifted_apart(&bench.robots).unwrap();
    assert!((found - ms(apart)).abs() < ms(1), "{clock:?} {robots:?}: {found}, expected {apart} ms");
}

#[test]
fn drift_of_this_machine_is_not_attributed_to_ntp_robots() {
    check(ClockMode::Ntp, [(400, 0, 50.0), (600_000, 0, 50.0)], 0);
    check(ClockMode::Ntp, [(600_000, 0, -50.0), (400, 0, -50.0)], 0);
}

#[test]
fn robots_that_were_apart_at_any_drift_of_this_machine_are_detected() {
    check(ClockMode::Ntp, [(600_000, 0, 0.0), (600_000, 30, 0.0)], 30);
    check(ClockMode::Ntp, [(600_000, 0, 0.0), (400_000, 50, 0.0)], 30);
    check(ClockMode::Ntp, [(400_000, 50, 0.0), (600_000, 0, 0.0)], 30);
}

#[test]
fn robots_planned_by_the_clock_of_this_machine_are_judged_by_it() {
    check(ClockMode::Measured, [(400, 0, 50.0), (600_000, 0, 50.0)], 30);
    check(ClockMode::Measured, [(400_000, 15, 0.0), (600_000, 0, -25.0)], 30);
}
