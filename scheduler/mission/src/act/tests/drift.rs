//! Tests of clocks at the end of an act, compared with the offsets with which its scripts were sent.

use super::*;
use crate::ClockMode;
use crate::clock::ClockEstimate;

/// Returns a sample of a clock that is ahead by `ahead` milliseconds.
fn shows(now: Timestamp<Server>, ahead: i64) -> ClockSample {
    let there = by_robot(now) + ms(ahead);
    ClockSample::from_exchange(now, there, there, now)
}

/// Returns an estimate of a clock that is now ahead by `ahead` milliseconds.
fn drifted(now: Timestamp<Server>, ahead: i64) -> ClockEstimate {
    let mut clock = ClockEstimate::default();
    clock.add(shows(now, ahead));
    clock
}

/// Lets the two robots of `bench`, whose clocks are measured, play their act.
fn both_have_played(mut bench: Bench) -> Bench {
    bench.robots.iter_mut().for_each(|robot| robot.settings.clock = ClockMode::Measured);
    (0..2).for_each(|robot| bench.ask(RobotIndex::new(robot)));
    bench.run_until(bench.now + ms(2_000));
    assert!(bench.act.members().iter().all(|member| member.is_done()), "{:?}", bench.failed);
    bench
}

fn played() -> Bench {
    let mut bench = Bench::pair();
    bench.play(Leases::Shortened);
    both_have_played(bench)
}

/// Like [`played`], but another process began the act, and this one has taken it over.
fn resumed() -> Bench {
    both_have_played(super::resumed::taken_up(super::super::Reached::Commitment, ms(-100)))
}

/// Returns the time in milliseconds by which the robots were certainly apart or off their plan.
fn apart(bench: &Bench) -> f64 {
    bench.act.drifted_apart(&bench.robots).unwrap().as_millis_f64().round()
}

#[test]
fn robot_whose_clock_was_set_during_the_act_is_not_checked_for_drift() {
    let mut bench = played();
    let now = bench.now;
    bench.robots[R0].clock = drifted(now, 0);
    bench.robots[R1].clock = drifted(now, 30);
    assert_eq!(apart(&bench), 30.0);
    let mut set = drifted(now - ms(1_000), 0);
    set.add(shows(now, 30));
    assert_eq!(set.steps(), 1);
    bench.robots[R1].clock = set;
    assert_eq!(apart(&bench), 0.0);
}

#[test]
fn robots_of_a_resumed_act_are_compared_only_with_each_other() {
    for (mut bench, ahead, expected) in
        [(played(), [30, 30], 30.0), (resumed(), [30, 30], 0.0), (resumed(), [0, 30], 30.0)]
    {
        let now = bench.now;
        for (robot, ahead) in bench.robots.iter_mut().zip(ahead) {
            robot.clock = drifted(now, ahead);
        }
        assert_eq!(apart(&bench), expected, "{ahead:?}");
    }
}
