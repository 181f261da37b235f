//! Tests of clocks that stray and leases that end. The known clocks and the start of each script decide whether a robot has failed.

use super::*;

/// Returns an act with a robot that does not report by itself. It begins a script late in the act, and plays it under a lease of
/// [`bench::RUNNING`].
fn plays_from(begins: i64, lasts: i64) -> Bench {
    let mut bench =
        Bench::new(&[Tells::Everything, Tells::Nothing], &[&[("a", 0, 400)], &[("a", begins, lasts)]]);
    bench.play(Leases::Fixed);
    bench
}

/// Whether the script is broken off if the lease of the robot in [`plays_from`] would have ended at `ends` after the start of the act.
fn broke_off(bench: &Bench, ends: Span) -> bool {
    let over = by_robot(bench.start() + ends);
    let lost = bench.act.broke_off(R1, over - bench::RUNNING, over + ms(6));
    if let Some(kind) = &lost {
        assert!(
            matches!(kind, FailureKind::Script { error, .. } if error.code == ErrorCode::LinkLost),
            "{kind:?}"
        );
    }
    lost.is_some()
}

#[test]
fn script_is_interrupted_by_a_lease_that_ends_while_it_plays() {
    let bench = plays_from(300, 4_000);
    let nanosecond = Span::from_nanos(1);
    for (ends, broken) in [
        (ms(300) - nanosecond, false),
        (ms(300), true),
        (ms(2_000), true),
        (ms(4_300) - nanosecond, true),
        (ms(4_300), false),
    ] {
        assert_eq!(broke_off(&bench, ends), broken, "a lease that ends {ends} after the start of the act");
    }
}

#[test]
fn script_interruption_is_judged_by_a_robot_clock_that_is_ahead() {
    let mut bench =
        Bench::new(&[Tells::Everything, Tells::Nothing], &[&[("a", 0, 400)], &[("a", 300, 4_000)]]);
    bench.pump();
    let timing = timing(&bench.act, bench.now, Leases::Fixed, bench.late);
    let (_, actions) = bench
        .act
        .promise(timing, &bench.robots, None, |robot| if robot.id.as_str() == "r1" { ms(50) } else { ms(0) });
    bench.carry_out(actions);
    bench.run_until(bench.start() + ms(5));
    assert_eq!(bench.act.progress(), Progressed::Playing);
    assert!(!broke_off(&bench, ms(349)), "by its clock it has not begun");
    assert!(broke_off(&bench, ms(350)));
}

#[test]
fn silence_within_the_resolution_of_a_coarse_clock_interrupts_nothing() {
    let bench = plays_from(300, 4_000);
    let before = by_robot(bench.start() + ms(100));
    let broke_off = |after: Span| bench.act.broke_off(R1, before, before + bench::RUNNING + after).is_some();
    assert!(!broke_off(ms(5)));
    assert!(broke_off(ms(5) + Span::from_nanos(1)));
}

#[test]
fn known_clock_is_used_even_if_another_clock_is_unknown() {
    for leases in [Leases::Shortened, Leases::Fixed] {
        let mut bench = Bench::of_three(Policy::Abort);
        bench.decide(leases);
        // The robot's state is as in a process that took over and has not received anything from the robot yet.
        bench.robots[R2] = bench::robot("r2", Tells::Everything, 2);
        let (now, there) = (bench.now, by_robot(bench.now) + ms(6));
        bench.robots[R1].clock.add(ClockSample::from_exchange(now - ROUND_TRIP, there, there, now));
        let brink = bench.timing().brink();
        let told = bench.act.allow_for(now, &bench.robots);
        assert!(
            matches!(told.as_slice(), [ActAction::Tell(Progress::Decided { .. })]),
            "{leases:?}: {told:?}"
        );
        assert!(bench.timing().brink() <= brink - ms(4), "{leases:?}");
    }
}

#[test]
fn nothing_is_reported_if_clocks_are_unchanged() {
    let mut bench = Bench::of_three(Policy::Abort);
    bench.decide(Leases::Shortened);
    assert!(bench.act.allow_for(bench.now, &bench.robots).is_empty());
}
