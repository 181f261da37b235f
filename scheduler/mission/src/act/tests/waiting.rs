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
    let act = Act::new(
        Arc::clone(&bench.act.choreography),
        ActIndex::new(0),
        ActNumber::new(1),
        &bench.robots,
        at(0),
        Some(at(500)),
    );
    Bench::around(act, bench.robots)
}

#[test]
fn act_that_waits_for_the_operator_continues_only_after_go() {
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
fn go_is_ignored_until_the_act_that_waits_for_it_is_next() {
    let mut bench = behind_another(Wait::Operator);
    bench.pump();
    assert!(!bench.act.go());
    bench.act.comes_next(at(500));
    bench.run_until(at(600));
    assert_eq!(bench.act.progress(), Progressed::Waiting);
    assert!(bench.act.go());
}

#[test]
fn go_is_ignored_for_an_act_that_waits_for_something_else() {
    let range = SensorRange::Above(1.0);
    let wait = Wait::Sensor { robot: "r0".into(), sensor: "a".into(), range };
    assert!(!waits_for(wait).act.go());
}

#[test]
fn wait_timeout_begins_when_the_act_becomes_next() {
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
fn sensor_is_read_again_until_its_reading_is_in_range() {
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
fn act_targets_end_of_previous_act_or_its_own_time_whichever_is_later() {
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
    bench.act = Act::new(
        Arc::clone(&bench.act.choreography),
        ActIndex::new(0),
        ActNumber::new(0),
        &bench.robots,
        at(since),
        None,
    );
    bench.options.zone = CHANGES;
    let announced = bench.act.announcement(&bench.options);
    let Some(Progress::Waiting { awaits, at: fixed, .. }) = announced else { panic!("{announced:?}") };
    bench.now = at(since);
    bench.pump();
    assert_eq!(bench.act.target(), fixed);
    (awaits, fixed)
}

#[test]
fn act_waits_for_a_time_in_the_utc_offset_of_that_time() {
    assert_eq!(waits_across_a_change(-HOUR, 2 * HOUR).1, Some(at(HOUR)));
}

#[test]
fn act_with_a_skipped_local_time_starts_at_the_skip_and_reports_it() {
    let (awaits, fixed) = waits_across_a_change(-HOUR, HOUR / 2);
    assert_eq!(fixed, Some(at(0)));
    assert!(awaits.contains(", because 00:46:40 does not exist on 1 Jan 1970"), "{awaits}");
}

#[test]
fn act_with_an_ambiguous_local_time_reports_its_utc_offset() {
    let half = HOUR / 2;
    for (since, start, offset) in [(BACK - HOUR, BACK - half, "UTC+01:00"), (BACK, BACK + half, "UTC+00:00")]
    {
        let (awaits, fixed) = waits_across_a_change(since, BACK + half);
        assert_eq!(fixed, Some(at(start)));
        assert!(awaits.contains(offset), "{awaits}");
    }
}

#[test]
fn time_just_passed_when_its_act_becomes_next_refers_to_tomorrow() {
    let (awaits, fixed) = waits_across_a_change(-30 * HOUR, -30 * HOUR - 1);
    assert_eq!(fixed, Some(at(-6 * HOUR - 1)));
    assert!(awaits.contains(" on 31 Dec 1969"), "{awaits}");
}
