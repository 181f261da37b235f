//! Tests of the conditions that an act waits for, and of the cases in which the operator's go is accepted.

use chrono::{FixedOffset, Offset, Utc};
use downbeat_fleet::sensor_range::SensorRange;
use downbeat_plan::{Wait, Way};

use super::*;
use crate::zone::Zone;

fn waits_for(wait: Wait) -> Bench {
    let mut choreography = bench::choreography(&[&[("a", 0, 400)]]);
    choreography.acts[0].wait = wait;
    choreography.acts[0].timeout = Some(ms(1_000));
    choreography.acts[0].on_timeout = Way::End;
    Bench::of(&[Tells::Everything], 2, choreography.into())
}

/// Returns an act with this condition, while an earlier act still plays.
fn behind_another(wait: Wait) -> Bench {
    let bench = waits_for(wait);
    let act = Act::new(Arc::clone(&bench.act.choreography), 0, 1, &bench.robots, at(0), Some(at(500)));
    Bench::around(act, bench.robots)
}

#[test]
fn an_act_that_waits_for_the_operator_goes_on_when_told_and_not_before() {
    let mut bench = waits_for(Wait::Operator);
    bench.pump();
    bench.run_until(at(900));
    assert_eq!(bench.act.progress(), Progressed::Waiting);
    assert!(bench.act.go());
    bench.pump();
    assert_eq!(bench.act.progress(), Progressed::Ready);
    assert!(!bench.act.go(), "go counts once");
}

#[test]
fn go_does_not_count_ahead_of_the_act_that_waits_for_it() {
    let mut bench = behind_another(Wait::Operator);
    bench.pump();
    assert!(!bench.act.go());
    bench.act.comes_next(at(500));
    bench.run_until(at(600));
    assert_eq!(bench.act.progress(), Progressed::Waiting);
    assert!(bench.act.go());
}

#[test]
fn go_does_not_count_for_an_act_that_waits_for_something_else() {
    let range = SensorRange::Above(1.0);
    let wait = Wait::Sensor { robot: "r0".into(), sensor: "a".into(), range };
    assert!(!waits_for(wait).act.go());
}

#[test]
fn waiting_ends_with_the_timeout_counted_from_when_it_is_alone() {
    let mut bench = behind_another(Wait::Operator);
    bench.run_until(at(5_000));
    assert_eq!(bench.went, None);
    bench.act.comes_next(at(5_000));
    assert_eq!(bench.act.wakeup(), Some(at(6_000)));
    bench.pump();
    assert_eq!(bench.went, None);
    bench.now = at(6_000);
    let actions = bench.act.advance(bench.now, &bench.robots, &bench.options);
    bench.carry_out(actions);
    assert_eq!(bench.went, Some(Way::End));
}

#[test]
fn a_sensor_is_read_again_until_its_reading_will_do() {
    let range = SensorRange::Above(1.0);
    let mut bench = waits_for(Wait::Sensor { robot: "r0".into(), sensor: "a".into(), range });
    bench.pump();
    bench.run_until(at(450));
    assert_eq!(bench.reads.len(), 5, "one every 100 ms: {:?}", bench.reads);
    bench.act.sensor_read(None);
    bench.act.sensor_read(Some(0.5));
    assert_eq!(bench.act.progress(), Progressed::Waiting);
    bench.act.sensor_read(Some(1.5));
    assert_eq!(bench.act.progress(), Progressed::Ready);
}

#[test]
fn an_act_that_follows_another_aims_at_its_end_and_one_with_a_time_at_the_later_of_both() {
    let mut follows = behind_another(Wait::Done);
    follows.pump();
    assert_eq!(follows.act.target(), Some(at(500)));
    let mut early = behind_another(Wait::Instant(at(300)));
    early.pump();
    assert_eq!(early.act.target(), Some(at(500)));
    let mut late = behind_another(Wait::Instant(at(800)));
    late.pump();
    assert_eq!(late.act.target(), Some(at(800)));
}

const HOUR: i64 = 3_600_000;
/// From `at(0)` until `at(BACK)`, the clocks are one hour ahead of UTC.
const BACK: i64 = 240 * HOUR;
const CHANGES: Zone = Zone::new(|instant| {
    if instant >= at(0) && instant < at(BACK) { FixedOffset::east_opt(3_600).unwrap() } else { Utc.fix() }
});

/// Returns the announcement and the target of an act that becomes the next one at `at(since)`. The act waits until the clocks show the
/// time of day of `at(shown)` in UTC.
fn waits_across_a_change(since: i64, shown: i64) -> (String, Option<Timestamp<Server>>) {
    let time = Span::from_nanos(at(shown).as_nanos().rem_euclid(ms(24 * HOUR).as_nanos()));
    let mut bench = waits_for(Wait::TimeOfDay(time));
    bench.act = Act::new(Arc::clone(&bench.act.choreography), 0, 0, &bench.robots, at(since), None);
    bench.options.zone = CHANGES;
    let announced = bench.act.announcement(&bench.options);
    let Some(Progress::Waiting { awaits, at: fixed, .. }) = announced else { panic!("{announced:?}") };
    bench.now = at(since);
    bench.pump();
    assert_eq!(bench.act.target(), fixed);
    (awaits, fixed)
}

#[test]
fn an_act_waits_for_a_time_by_the_clocks_of_that_time() {
    assert_eq!(waits_across_a_change(-HOUR, 2 * HOUR).1, Some(at(HOUR)));
}

#[test]
fn an_act_whose_time_clocks_skip_starts_as_they_skip_it_and_says_so() {
    let (awaits, fixed) = waits_across_a_change(-HOUR, HOUR / 2);
    assert_eq!(fixed, Some(at(0)));
    assert!(awaits.contains(", because 00:46:40 does not exist on 1 Jan 1970"), "{awaits}");
}

#[test]
fn an_act_whose_time_clocks_show_twice_says_which_it_means() {
    let half = HOUR / 2;
    for (since, start, offset) in [(BACK - HOUR, BACK - half, "UTC+01:00"), (BACK, BACK + half, "UTC+00:00")]
    {
        let (awaits, fixed) = waits_across_a_change(since, BACK + half);
        assert_eq!(fixed, Some(at(start)));
        assert!(awaits.contains(offset), "{awaits}");
    }
}

#[test]
fn a_time_that_has_just_passed_when_an_act_becomes_the_next_one_is_tomorrow() {
    let (awaits, fixed) = waits_across_a_change(-30 * HOUR, -30 * HOUR - 1);
    assert_eq!(fixed, Some(at(-6 * HOUR - 1)));
    assert!(awaits.contains(" on 31 Dec 1969"), "{awaits}");
}
