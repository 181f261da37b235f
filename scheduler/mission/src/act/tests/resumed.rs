//! Tests of an act that another process has promised and this one takes over.

use super::super::Reached;
use super::*;
use crate::record::Promise;
use crate::{ActReport, ClockMode, DeviceState};

fn promised(scripts: &[&[Planned]]) -> (Bench, Promise) {
    let tells = vec![Tells::Everything; scripts.len()];
    let mut bench = Bench::new(&tells, scripts);
    bench.promise(Leases::Shortened);
    let Some((_, Record::Prepared(promise))) = bench.recorded.first().cloned() else { panic!("no promise") };
    (bench, promise)
}

/// Returns an act whose process has died, and that this process takes over `before_start` before its start. The robots still hold their
/// scripts.
pub(super) fn taken_up(reached: Reached, before_start: Span) -> Bench {
    let scripts: [&[Planned]; 2] = [&[("a", 0, 400)]; 2];
    let (other, promise) = promised(&scripts);
    let robots = robots(&[Tells::Everything; 2], 2);
    let now = promise.start - before_start;
    let choreography = Arc::clone(&other.act.choreography);
    let act = Act::take_up(choreography, &promise, reached, &robots, now).unwrap();
    let mut bench = Bench { now, ..Bench::around(act, robots) };
    for robot in 0..2 {
        let script = bench.scripts_of(RobotIndex::new(robot))[0];
        bench.act.sent(at(2), script);
        bench.sent.push((at(2), script));
    }
    bench
}

#[test]
fn act_with_a_different_promised_script_is_not_taken_over() {
    let scripts: [&[Planned]; 2] = [&[("a", 0, 400)]; 2];
    let (other, mut promise) = promised(&scripts);
    promise.scripts[1].content_hash = urrcp::Command::ReadSensor.content_hash();
    let (choreography, robots) = (Arc::clone(&other.act.choreography), robots(&[Tells::Everything; 2], 2));
    let changed = Act::take_up(choreography, &promise, Reached::Decision, &robots, promise.start).err();
    let changed = changed.unwrap().to_string();
    assert!(changed.contains("device `a` of `r1` was sent a different script"), "{changed}");
}

#[test]
fn decided_act_is_committed_if_time_remains_and_otherwise_withdrawn() {
    for (before_start, commits) in [(ms(330), true), (ms(200), false), (ms(20), false), (ms(-500), false)] {
        let mut bench = taken_up(Reached::Decision, before_start);
        bench.run_until(bench.start().max(bench.now));
        assert_eq!(
            bench.act.progress() == Progressed::Committed,
            commits,
            "{before_start}: {:?}",
            bench.failed
        );
        let critical = bench.timing().critical();
        let asked_late = bench.asked.iter().any(|question| question.at >= critical);
        assert_eq!(asked_late, commits, "{before_start}");
        assert_eq!(bench.commitments().is_empty(), !commits, "{before_start}");
        assert_ne!(bench.failed.is_empty() && bench.withdrawn.is_none(), !commits, "{before_start}");
    }
}

#[test]
fn act_with_commitment_recorded_early_is_still_committed_all_or_none() {
    let mut bench = taken_up(Reached::Commitment, ms(400));
    assert_eq!(bench.act.progress(), Progressed::Approaching);
    bench.run_until(bench.start());
    assert_eq!(bench.act.progress(), Progressed::Committed);
    assert!(bench.commitments().is_empty(), "it is on the disk already");
    let critical = bench.timing().critical();
    assert!(bench.asked.iter().any(|question| question.at >= critical));
}

#[test]
fn no_robot_fails_because_a_process_took_over_too_late_to_ask_it() {
    for before_start in [200, 69, 20, -500] {
        let mut bench = taken_up(Reached::Decision, ms(before_start));
        bench.run_until(bench.start().max(bench.now));
        assert!(bench.failed.is_empty(), "{before_start}: {:?}", bench.failed);
        let withdrawn = bench.withdrawn.as_ref().map(|(_, outcome)| outcome);
        assert!(matches!(withdrawn, Some(Outcome::CommitmentLate { .. })), "{before_start}: {withdrawn:?}");
    }
}

#[test]
fn decided_act_is_resent_if_never_received_and_not_committed_if_lost() {
    let mut bench = taken_up(Reached::Decision, ms(330));
    bench.sent.clear();
    bench.run_until(bench.start());
    assert_eq!((bench.sent_to(R0).len(), bench.sent_to(R1).len()), (1, 1));
    assert_eq!(bench.act.progress(), Progressed::Committed);

    let mut bench = Bench {
        mum: vec![R1],
        says_always: Some(RequestState::Unknown),
        ..taken_up(Reached::Decision, ms(330))
    };
    bench.run_until(bench.start());
    assert_eq!(bench.act.progress(), Progressed::Approaching);
    assert!(matches!(bench.failed.as_slice(), [(_, R1, _)]) && bench.commitments().is_empty());
}

#[test]
fn committed_act_continues_to_play() {
    let mut bench = taken_up(Reached::Commitment, ms(100));
    assert!(bench.act.is_committed());
    bench.ask(R0);
    bench.ask(R1);
    bench.run_to_the_end();
    assert!(bench.act.is_over() && bench.failed.is_empty(), "{:?}", bench.failed);
}

#[test]
fn script_ended_without_a_scheduler_is_asked_about_before_robot_fails() {
    let mut bench = taken_up(Reached::Commitment, ms(-10_000));
    bench.pump();
    bench.run_until(bench.now + ms(1));
    assert!(bench.failed.is_empty(), "{:?}", bench.failed);
    bench.ask(R0);
    bench.ask(R1);
    bench.run_until(bench.now + ms(5_000));
    assert!(bench.act.is_over() && bench.failed.is_empty(), "{:?}", bench.failed);
}

#[test]
fn script_unknown_to_robot_after_its_start_is_lost_and_not_sent_late() {
    let mut bench = taken_up(Reached::Commitment, ms(-1_000));
    bench.sent.clear();
    let script = bench.scripts_of(R1)[0];
    bench.report(script, bench.now, RequestState::Unknown);
    assert_eq!(bench.state(R1, 0), &ScriptState::Unknown, "it may have played");
    assert_eq!(bench.sent, []);
    assert!(matches!(bench.failed.as_slice(), [(_, R1, FailureKind::Script { .. })]), "{:?}", bench.failed);
}

#[test]
fn script_possibly_sent_by_another_process_is_reported_as_unknown() {
    let scripts: [&[Planned]; 1] = [&[("a", 0, 400), ("a", 500, 400), ("a", 1_000, 400)]];
    let (other, promise) = promised(&scripts);
    let robots = robots(&[Tells::Everything], 2);
    let choreography = Arc::clone(&other.act.choreography);
    let take_up =
        |reached| Act::take_up(Arc::clone(&choreography), &promise, reached, &robots, promise.start).unwrap();
    for reached in [Reached::Commitment, Reached::Decision] {
        let report = ActReport::new(&take_up(reached), &robots).unwrap();
        let states: Vec<_> = report.robots[0].devices.iter().map(|script| script.state).collect();
        assert_eq!(states, [DeviceState::Unknown; 3], "{reached:?}");
    }
}

#[test]
fn promise_must_match_the_choreography() {
    let (other, promise) = promised(&[&[("a", 0, 400)]]);
    let robots = robots(&[Tells::Everything], 2);
    let take_up = |choreography, promise: &Promise| {
        Act::take_up(choreography, promise, Reached::Decision, &robots, at(5)).map(|act| act.all_names())
    };
    let same = take_up(Arc::clone(&other.act.choreography), &promise).unwrap();
    assert_eq!(same.iter().map(|(_, id, _)| id).collect::<Vec<_>>(), [&promise.scripts[0].request_id]);
    assert!(take_up(bench::played(&[&[("a", 0, 401)]]), &promise).is_err(), "another movement");
    assert!(take_up(bench::played(&[&[("b", 0, 400)]]), &promise).is_err(), "another device");
    assert!(take_up(bench::played(&[&[("a", 10, 400)]]), &promise).is_err(), "another time");
    assert!(
        take_up(Arc::clone(&other.act.choreography), &Promise { act: ActIndex::new(1), ..promise.clone() })
            .is_err()
    );
}

#[test]
fn script_reported_only_to_previous_process_ends_as_unknown_on_time() {
    let scripts: [&[Planned]; 1] = [&[("a", 0, 400)]];
    let mut other = Bench::new(&[Tells::Reports], &scripts);
    other.promise(Leases::Fixed);
    let Some((_, Record::Prepared(promise))) = other.recorded.first().cloned() else { panic!("no promise") };
    for after_start in [100, 450, 10_000] {
        let robots = robots(&[Tells::Reports], 2);
        let now = promise.start + ms(after_start);
        let choreography = Arc::clone(&other.act.choreography);
        let act = Act::take_up(choreography, &promise, Reached::Commitment, &robots, now).unwrap();
        let mut bench = Bench { now, ..Bench::around(act, robots) };
        let script = bench.scripts_of(R0)[0];
        bench.act.sent(now, script);
        bench.ask(R0);
        bench.run_until(now + ms(60_000));
        assert!(bench.failed.is_empty(), "{after_start}: {:?}", bench.failed);
        assert_eq!(bench.state(R0, 0), &ScriptState::Unknown, "{after_start}");
        assert!(bench.act.is_over(), "{after_start}");
    }
}

#[test]
fn script_of_another_process_refused_as_late_may_have_been_played() {
    let mut bench = taken_up(Reached::Commitment, ms(-1_000));
    let script = bench.scripts_of(R0)[0];
    bench.refuse(script, ErrorCode::Late);
    assert_eq!((bench.state(R0, 0), bench.failed.len()), (&ScriptState::Unknown, 0));
}

#[test]
fn script_of_another_process_that_fails_after_start_may_have_begun() {
    for (before_start, begun) in [(ms(-500), true), (ms(500), false)] {
        let mut bench = taken_up(Reached::Commitment, before_start);
        let script = bench.scripts_of(R0)[0];
        bench.refuse(script, ErrorCode::Cancelled);
        assert_eq!(bench.state(R0, 0) == &ScriptState::Unknown, begun, "{before_start}");
        assert_eq!(bench.failed.len(), 1, "{before_start}");
    }
}

#[test]
fn script_reported_with_its_hash_was_accepted_and_may_have_begun() {
    for accepted in [true, false] {
        let mut bench = taken_up(Reached::Commitment, ms(-500));
        let (script, now) = (bench.scripts_of(R0)[0], bench.now);
        let known = bench.act.script(script);
        let (id, hash) = (known.request_id().cloned().unwrap(), known.content_hash());
        let report = bench::report(&id, RequestState::Ended, accepted.then_some(hash));
        let report = urrcp::RequestReport { error: bench::refusal(ErrorCode::Internal), ..report };
        let _noted = bench.act.reported(script, &report, times(now, by_robot(now), now), &bench.robots);
        assert_eq!(bench.state(R0, 0) == &ScriptState::Unknown, accepted);
    }
}

#[test]
fn offsets_change_from_journal_values_no_faster_than_clocks_drift() {
    let (other, mut promise) = promised(&[&[("a", 0, 400), ("a", 10_000, 400), ("a", 30_000, 400)]]);
    promise.scripts.iter_mut().for_each(|script| script.shift = ms(7));
    let mut robots = robots(&[Tells::Everything], 2);
    robots[R0].settings.clock = ClockMode::Measured;
    let take_up = || {
        let choreography = Arc::clone(&other.act.choreography);
        Act::take_up(choreography, &promise, Reached::Commitment, &robots, promise.start).unwrap()
    };
    // 100 ppm of the 10 s and the 20 s between the starts.
    for (shows, expected) in [(500, [8, 10]), (-500, [6, 4]), (7, [7, 7])] {
        let mut act = take_up();
        let mut shift = |script: usize| {
            let script = ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script };
            let _changed = act.translate(script, 0, |_| Some(ms(shows)));
            act.members()[MemberIndex::new(0)].shift_of(act.script(script))
        };
        assert_eq!([shift(1), shift(2)], expected.map(ms), "a clock that is {shows} ms ahead");
    }
}

/// Takes over an act of three robots after its start. Each robot has a second script that begins `later` milliseconds after the start.
/// Returns the failure that the clock of the first robot shows, if any.
fn clocks_after_take_up(later: i64, clocks: [ClockSample; 3]) -> Option<FailureKind> {
    let chain = [("a", 0, 400), ("a", later, 400)];
    let scripts: [&[Planned]; 3] = [&chain; 3];
    let (other, promise) = promised(&scripts);
    let mut robots = robots(&[Tells::Nothing; 3], 2);
    let now = promise.start + ms(100);
    let choreography = Arc::clone(&other.act.choreography);
    let mut act = Act::take_up(choreography, &promise, Reached::Commitment, &robots, now).unwrap();
    act.note_as_sent_until(now);
    for (robot, sample) in robots.iter_mut().zip(clocks) {
        robot.settings.clock = ClockMode::Measured;
        robot.clock.add(sample);
    }
    act.clock_was_set(now, R0, &robots)
}

/// Returns a sample of a clock that is ahead by `ahead` milliseconds. The answer with it took `back` milliseconds.
fn exchange(ahead: i64, back: i64) -> ClockSample {
    let there = by_robot(at(500)) + ms(ahead);
    ClockSample::from_exchange(at(500), there, there, at(500 + back))
}

#[test]
fn clock_is_considered_set_only_beyond_uncertainty_and_possible_drift() {
    let sure = exchange(0, 0);
    assert!(clocks_after_take_up(2_000, [exchange(60, 0), sure, sure]).is_some());
    assert!(clocks_after_take_up(2_000, [sure, exchange(60, 0), exchange(60, 0)]).is_some());
    let delayed = [sure, exchange(0, 160), exchange(0, 120)];
    assert_eq!(clocks_after_take_up(2_000, delayed), None, "the other two may be right");
    assert!(clocks_after_take_up(2_000, [exchange(30, 0), sure, sure]).is_some());
    assert_eq!(clocks_after_take_up(400_000, [exchange(30, 0), sure, sure]), None, "100 ppm are 40 ms");
}
