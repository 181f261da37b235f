//! Tests of an act from its start to its last step.

use downbeat_plan::PlannedReading;

use super::*;
use crate::script::Ending;

const COMPLETED: ScriptState = ScriptState::Ended(Ending::Completed);

fn chain(tells: Tells, queue: usize) -> Bench {
    let scripts: [&[Planned]; 1] = [&[("a", 0, 200), ("a", 200, 200), ("a", 400, 200), ("a", 600, 200)]];
    Bench::of(&[tells], queue, bench::played(&scripts))
}

/// Returns the time at which each script was sent, relative to the start.
fn sent_at(bench: &Bench) -> Vec<Span> {
    bench.sent_to(R0).iter().map(|(at, _)| *at - bench.start()).collect()
}

#[test]
fn act_is_over_when_every_script_has_completed() {
    let mut bench = Bench::pair();
    bench.play(Leases::Shortened);
    bench.run_until(bench.timing().end - ms(1));
    assert!(bench.act.is_playing());
    bench.run_until(bench.timing().end + ms(1));
    assert!(bench.act.is_over());
    assert_eq!((bench.state(R0, 0), bench.state(R1, 0)), (&COMPLETED, &COMPLETED));
}

#[test]
fn act_that_holds_its_last_value_is_over_when_its_movement_ends() {
    for tells in [Tells::Everything, Tells::Answers, Tells::Nothing] {
        let mut choreography = bench::choreography(&[&[("a", 0, 400)], &[("a", 0, 500)]]);
        choreography.acts[0].plan.robots[0].scripts[0].rest = ms(2_000);
        let mut bench = Bench::of(&[tells; 2], 2, Arc::new(choreography));
        bench.play(Leases::Shortened);
        let end = bench.start() + ms(2_400);
        assert_eq!(bench.timing().end, end);
        bench.run_until(end - ms(1));
        assert!(bench.act.is_playing(), "{tells:?}");
        bench.run_until(end);
        assert!(bench.act.is_over(), "{tells:?}");
    }
}

#[test]
fn movement_of_a_left_out_robot_does_not_delay_end_of_act() {
    let mut choreography = bench::choreography(&[&[("a", 0, 400)], &[("a", 0, 500)]]);
    choreography.acts[0].plan.robots[0].scripts[0].rest = ms(2_000);
    let bench = Bench::of(&[Tells::Everything; 2], 2, Arc::new(choreography));
    let mut bench = Bench { policy: Policy::Without, ..bench };
    bench.play(Leases::Shortened);
    bench.act.drop_robot(R0);
    bench.run_until(bench.start() + ms(505));
    assert!(bench.act.is_over());
}

#[test]
fn script_that_fails_after_start_without_step_count_may_have_begun() {
    for (steps_done, state) in [(None, ScriptState::Unknown), (Some(0), failed())] {
        let mut bench = Bench { mum: vec![R1], ..Bench::pair() };
        bench.play(Leases::Shortened);
        bench.run_until(bench.start() + ms(100));
        let script = bench.scripts_of(R1)[0];
        let error = crate::bench::refusal(ErrorCode::Cancelled);
        let response = ControlResponse { error, steps_done, ..bench.response(script, Status::Failed) };
        bench.take_response(script, &response);
        assert_eq!((bench.state(R1, 0), bench.failed.len()), (&state, 1));
    }
}

fn failed() -> ScriptState {
    ScriptState::Ended(Ending::Failed(crate::bench::refusal(ErrorCode::Cancelled).unwrap()))
}

#[test]
fn ended_script_makes_room_for_the_next_one() {
    let mut bench = chain(Tells::Everything, 2);
    bench.play(Leases::Shortened);
    bench.run_to_the_end();
    let sent = sent_at(&bench);
    assert_eq!(sent.len(), 4);
    assert!(sent[2] >= ms(200) && sent[2] < ms(205) && sent[3] >= ms(400) && sent[3] < ms(405), "{sent:?}");
    assert!(bench.act.is_over());
}

#[test]
fn robot_without_reports_is_asked_when_a_script_should_have_ended() {
    let mut bench = chain(Tells::Answers, 2);
    bench.play(Leases::Shortened);
    bench.run_to_the_end();
    let sent = sent_at(&bench);
    assert!(sent[2] > ms(200) && sent[2] < ms(300) && sent[3] > ms(400) && sent[3] < ms(500), "{sent:?}");
    assert!(bench.act.is_over());
    assert_eq!(bench.state(R0, 3), &COMPLETED);
}

#[test]
fn robot_without_reports_is_asked_at_script_end_whenever_act_began() {
    let scripts: [&[Planned]; 2] = [&[("a", 0, 30), ("a", 200, 10), ("a", 300, 10)], &[("a", 0, 2_000)]];
    // The last robot may start while the first one, which is on time, still owes the report that its first script has ended.
    for late in (30_000..70_000).step_by(100).map(Span::from_micros) {
        let bench = Bench::of(&[Tells::Answers, Tells::Everything], 1, bench::played(&scripts));
        let mut bench = Bench { late, ..bench };
        bench.commit(Leases::Fixed);
        bench.run_to_the_end();
        let sent = sent_at(&bench);
        assert!(sent.len() == 3 && sent[1] < ms(100) && sent[2] < ms(290), "{late}: {sent:?}");
    }
}

#[test]
fn scripts_of_a_robot_that_reports_nothing_expire_as_unknown() {
    let mut bench = chain(Tells::Nothing, 2);
    bench.play(Leases::Fixed);
    bench.run_to_the_end();
    let sent = sent_at(&bench);
    assert!(sent[2] > ms(200) && sent[2] < ms(300) && sent[3] > ms(400) && sent[3] < ms(500), "{sent:?}");
    assert!(bench.act.is_over());
    assert!((0..4).all(|script| bench.state(R0, script) == &ScriptState::Unknown), "never completed");
    assert!(bench.failed.is_empty());
}

#[test]
fn later_script_on_another_device_does_not_delay_refills_and_readings() {
    let scripts: [&[Planned]; 2] = [&[("a", 0, 40), ("a", 40, 40), ("a", 80, 80)], &[("a", 200, 100)]];
    let mut choreography = bench::choreography(&scripts);
    let reading = PlannedReading { robot: "r1".parse().unwrap(), sensor: "b".parse().unwrap(), at: ms(50) };
    choreography.acts[0].readings = vec![reading];
    let mut bench = Bench::of(&[Tells::Nothing, Tells::Everything], 2, choreography.into());
    bench.commit(Leases::Fixed);
    bench.run_to_the_end();
    let sent = sent_at(&bench);
    assert!(sent[2] < ms(80), "it begins 80 ms after the start: {sent:?}");
    assert_eq!(bench.reads.first().map(|(at, ..)| *at), Some(bench.start() + ms(50)));
}

/// Returns an act of two robots. The second one may start 100 ms late. By then, the first one, which is on time, has played most of its
/// scripts.
fn beside_a_late_one(tells: Tells) -> Bench {
    let scripts: [&[Planned]; 2] =
        [&[("a", 0, 30), ("a", 30, 30), ("a", 60, 30), ("a", 90, 30)], &[("a", 0, 400)]];
    let bench = Bench::of(&[tells, Tells::Everything], 2, bench::played(&scripts));
    let mut bench = Bench { late: ms(100), ..bench };
    bench.commit(Leases::Fixed);
    bench
}

#[test]
fn script_played_by_its_robots_clock_makes_room_before_last_robot_starts() {
    for tells in [Tells::Nothing, Tells::Answers] {
        let mut bench = beside_a_late_one(tells);
        bench.run_until(bench.start() + ms(95));
        assert_eq!(bench.act.progress(), Progressed::Committed);
        let sent = sent_at(&bench);
        assert!(sent[2] > ms(30) && sent[2] < ms(60) && sent[3] > ms(60) && sent[3] < ms(90), "{sent:?}");
        bench.run_to_the_end();
        assert!(bench.act.is_over() && bench.failed.is_empty());
    }
}

#[test]
fn shortened_lease_of_a_device_that_begins_later_must_be_renewed() {
    let scripts: [&[Planned]; 2] = [&[("a", 0, 400)], &[("a", 150, 400)]];
    let mut bench = Bench::new(&[Tells::Everything; 2], &scripts);
    bench.play(Leases::Shortened);
    let shortened = bench.timing().final_lease() + ms(150);
    assert!(
        bench.act.shortest_lease().is_some_and(|lease| lease <= shortened),
        "{:?}",
        bench.act.shortest_lease()
    );
}

#[test]
fn overdue_report_is_requested_before_its_robot_fails() {
    let mut bench = Bench { mum: vec![R1], ..Bench::pair() };
    bench.play(Leases::Shortened);
    bench.says_always = Some(RequestState::Held);
    let grace = bench.act.report_grace(&bench.robots);
    bench.run_to_the_end();
    let due = bench.start() + grace;
    assert!(bench.asked_of(R1).any(|question| question.at >= due && question.at < due + ms(2)));
    // The end is later by the possible lateness of the robot's clock.
    assert!(
        matches!(bench.failed.as_slice(), [(when, R1, FailureKind::Silent { .. })]
            if *when >= due + grace && *when < due + grace + ms(1)),
        "{:?}",
        bench.failed
    );
}

/// Returns many robots that begin one after another.
fn one_after_another(robots: usize) -> Bench {
    let scripts: Vec<Vec<Planned>> =
        (0..robots).map(|robot| vec![("a", i64::try_from(robot).unwrap(), 400)]).collect();
    let scripts: Vec<&[Planned]> = scripts.iter().map(Vec::as_slice).collect();
    let bench = Bench::new(&vec![Tells::Everything; robots], &scripts);
    Bench { mum: (0..robots).map(RobotIndex::new).collect(), ..bench }
}

#[test]
fn robots_with_delayed_reports_and_answers_are_not_asked_repeatedly() {
    let mut bench = one_after_another(100);
    bench.play(Leases::Shortened);
    bench.silent = bench.mum.clone();
    let grace = bench.act.report_grace(&bench.robots);
    bench.run_until(bench.start() + grace * 2 - ms(1));
    for robot in 0..100 {
        let playing = |question: &&Question| question.stage == Progressed::Playing;
        let asked = bench.asked_of(RobotIndex::new(robot)).filter(playing).count();
        assert_eq!(asked, 1, "robot {robot}");
    }
    assert!(bench.failed.is_empty());
}

#[test]
fn lost_request_for_an_overdue_report_is_repeated() {
    let mut bench = one_after_another(2);
    bench.play(Leases::Shortened);
    let grace = bench.act.report_grace(&bench.robots);
    bench.silent = vec![R0];
    bench.run_until(bench.start() + grace + ms(100));
    bench.silent.clear();
    bench.run_to_the_end();
    assert!(bench.failed.is_empty(), "{:?}", bench.failed);
    assert_eq!((bench.state(R0, 0), bench.state(R1, 0)), (&COMPLETED, &COMPLETED));
}

#[test]
fn answer_replaces_a_lost_report() {
    let mut bench = Bench { mum: vec![R1], ..Bench::pair() };
    bench.play(Leases::Shortened);
    bench.run_to_the_end();
    assert!(bench.failed.is_empty());
    assert_eq!(bench.state(R1, 0), &COMPLETED);
}

#[test]
fn robot_without_reports_fails_if_its_script_never_ends() {
    let mut bench = Bench { mum: vec![R0], ..Bench::new(&[Tells::Answers], &[&[("a", 0, 400)]]) };
    bench.play(Leases::Shortened);
    bench.says_always = Some(RequestState::Running);
    bench.run_to_the_end();
    assert!(matches!(bench.failed.as_slice(), [(_, R0, FailureKind::Silent { .. })]));
}

#[test]
fn robot_back_after_a_long_break_is_asked_before_it_fails() {
    let mut bench = Bench { policy: Policy::Without, ..Bench::pair() };
    bench.play(Leases::Shortened);
    bench.break_link(R1);
    bench.silent = vec![R1];
    bench.run_until(bench.timing().end + ms(3_000));
    assert!(bench.failed.is_empty(), "without a link nothing is awaited");
    bench.robots[R1].connected(at(0));
    assert!(bench.robots[R1].named());
    bench.silent.clear();
    bench.act.drop_robot(R0);
    bench.pump();
    assert!(bench.failed.is_empty(), "{:?}", bench.failed);
    bench.ask(R1);
    bench.run_to_the_end();
    bench.run_until(bench.now + ms(2_000));
    assert_eq!((bench.failed.len(), bench.state(R1, 0)), (0, &COMPLETED));
}

#[test]
fn act_is_due_at_once_when_the_awaited_robot_is_left_out() {
    let mut bench = Bench { mum: vec![R1], ..Bench::pair() };
    bench.play(Leases::Shortened);
    bench.run_until(bench.timing().end + ms(10));
    assert_eq!(bench.state(R0, 0), &COMPLETED);
    bench.act.drop_robot(R1);
    assert!(bench.wakeup().is_some_and(|at| at <= bench.now));
    bench.run_until(bench.now);
    assert!(bench.act.is_over());
}

#[test]
fn start_error_is_actual_minus_planned_by_the_robots_own_clock() {
    let mut bench = Bench { mum: vec![R0, R1], ..Bench::pair() };
    bench.play(Leases::Shortened);
    let script = bench.scripts_of(R1)[0];
    let event_timestamp = Some(by_robot(bench.start()) + Span::from_micros(70));
    let response = ControlResponse { event_timestamp, ..bench.response(script, Status::Started) };
    bench.take_response(script, &response);
    let member = bench.act.member(R1).unwrap();
    assert_eq!(bench.act.start_error(member, bench.act.script(script)), Some(Span::from_micros(70)));
}

#[test]
fn scenario_readings_are_taken_at_their_times() {
    let mut choreography = bench::choreography(&[&[("a", 0, 400)]]);
    let reading = |at| PlannedReading { robot: "r0".parse().unwrap(), sensor: "b".parse().unwrap(), at };
    choreography.acts[0].readings = vec![reading(ms(100)), reading(ms(250))];
    let mut bench = Bench::of(&[Tells::Everything], 2, choreography.into());
    bench.play(Leases::Shortened);
    bench.run_to_the_end();
    let times: Vec<_> = bench.reads.iter().map(|(at, ..)| *at - bench.start()).collect();
    assert_eq!(times, [ms(100), ms(250)]);
}

#[test]
fn next_script_begins_later_than_now() {
    let mut bench = chain(Tells::Everything, 2);
    bench.play(Leases::Shortened);
    let start = bench.start();
    assert_eq!(bench.act.next_begin(R0, start + ms(199)), Some(start + ms(200)));
    assert_eq!(bench.act.next_begin(R0, start + ms(200)), None, "no other is out");
}

#[test]
fn unreported_script_expires_at_its_end_by_a_clock_that_is_behind() {
    let mut bench = Bench::new(&[Tells::Nothing], &[&[("a", 0, 400)]]);
    bench.play(Leases::Fixed);
    bench.robots[R0].shift = ms(40);
    let lapses = bench.timing().end + ms(40) + super::super::LAPSE;
    bench.run_until(lapses - ms(1));
    assert!(bench.act.script(bench.scripts_of(R0)[0]).is_out(), "{:?}", bench.state(R0, 0));
    bench.run_until(lapses + ms(2));
    assert_eq!(bench.state(R0, 0), &ScriptState::Unknown);
}

#[test]
fn robot_that_reports_fewer_steps_than_before_fails() {
    let mut bench = Bench { mum: vec![R1], ..Bench::pair() };
    bench.play(Leases::Shortened);
    let script = bench.scripts_of(R1)[0];
    let id = bench.act.script(script).request_id().cloned().unwrap();
    for (after, steps_done, failures) in [(100, Some(1), 0), (110, Some(0), 1)] {
        bench.run_until(bench.start() + ms(after));
        let report = urrcp::RequestReport { steps_done, ..bench::report(&id, RequestState::Running, None) };
        let (asked, said) = (bench.now - ROUND_TRIP, by_robot(bench.now - ROUND_TRIP / 2));
        let noted = bench.act.reported(script, &report, times(asked, said, bench.now), &bench.robots);
        bench.carry_out(noted.actions);
        assert_eq!(bench.failed.len(), failures, "{steps_done:?}");
    }
    assert!(matches!(bench.failed.as_slice(), [(_, R1, FailureKind::Claim { .. })]));
}

#[test]
fn reported_start_is_checked_against_the_time_sent_to_the_robot() {
    let mut bench = Bench { silent: vec![R0], ..Bench::new(&[Tells::Everything], &[&[("a", 0, 400)]]) };
    let there = by_robot(at(0)) + ms(500);
    bench.robots[R0].clock.add(ClockSample::from_exchange(at(0), there, there, at(0)));
    bench.pump();
    let timing = timing(&bench.act, bench.now, Leases::Shortened, ms(1));
    let (_, actions) = bench.act.promise(timing, &bench.robots, None, |_| ms(500));
    bench.carry_out(actions);
    bench.run_until(at(10));
    bench.say(bench.scripts_of(R0)[0], Status::Started);
    assert!(bench.start() > at(200));
    assert!(matches!(bench.failed.as_slice(), [(_, R0, FailureKind::Claim { .. })]), "{:?}", bench.failed);
}

#[test]
fn script_that_begins_later_cannot_have_started_with_the_act() {
    let scripts: [&[Planned]; 1] = [&[("a", 0, 400), ("b", 300, 400)]];
    let mut bench = Bench { mum: vec![R0], ..Bench::new(&[Tells::Everything], &scripts) };
    bench.play(Leases::Shortened);
    let [first, later] = bench.scripts_of(R0)[..] else { panic!("two") };
    bench.say(first, Status::Started);
    assert!(bench.failed.is_empty(), "{:?}", bench.failed);
    bench.say(later, Status::Started);
    assert!(matches!(bench.failed.as_slice(), [(_, R0, FailureKind::Claim { .. })]), "{:?}", bench.failed);
}

#[test]
fn script_can_have_ended_once_its_end_is_past_by_the_clock_of_its_robot() {
    let mut bench = Bench::new(&[Tells::Everything], &[&[("a", 0, 400)]]);
    bench.pump();
    let timing = timing(&bench.act, bench.now, Leases::Shortened, ms(1));
    let _sent = bench.act.promise(timing, &bench.robots, None, |_| ms(500));
    let script = bench.scripts_of(R0)[0];
    let end = by_robot(bench.start() + ms(400 + 500));
    let ended = [-100, 0].map(|after| bench.act.can_have_ended(script, end + ms(after)));
    assert_eq!(ended, [false, true]);
}

#[test]
fn scenario_reading_is_stored_with_its_sensor_and_its_time() {
    let mut choreography = bench::choreography(&[&[("a", 0, 400)]]);
    let reading = |at| PlannedReading { robot: "r0".parse().unwrap(), sensor: "b".parse().unwrap(), at };
    choreography.acts[0].readings = vec![reading(ms(100)), reading(ms(250))];
    let mut bench = Bench::of(&[Tells::Everything], 2, choreography.into());
    bench.act.read(1, &bench.robots[R0], Some(3.5));
    bench.act.read(2, &bench.robots[R0], Some(4.0));
    let [taken] = bench.act.readings() else { panic!("{:?}", bench.act.readings()) };
    assert_eq!((taken.sensor.as_str(), taken.at, taken.value), ("b", ms(250), Some(3.5)));
}

#[test]
fn act_is_unaccounted_while_a_robot_may_hold_unreported_scripts() {
    let mut bench = Bench::pair();
    assert!(!bench.act.is_unaccounted(), "nothing was sent");
    bench.decide(Leases::Shortened);
    assert!(bench.act.is_unaccounted());
    bench.run_to_the_end();
    assert!(!bench.act.is_unaccounted());
}

#[test]
fn robot_without_reports_is_asked_repeatedly_until_its_script_has_ended() {
    let mut bench = Bench { mum: vec![R0], ..Bench::new(&[Tells::Answers], &[&[("a", 0, 400)]]) };
    bench.play(Leases::Shortened);
    bench.says_always = Some(RequestState::Running);
    let due = bench.timing().end + super::super::LAPSE;
    bench.run_until(due + ms(320));
    let asked: Vec<_> = bench.asked_of(R0).map(|question| question.at).filter(|at| *at >= due).collect();
    assert!(asked.len() == 7 && asked[0] < due + ms(1), "{asked:?}, due at {due}");
    assert!(asked.windows(2).all(|pair| pair[1] - pair[0] == ms(50)), "{asked:?}");
}

/// Returns a robot that reports nothing, after it was sent the third script of its device. It has not answered yet.
fn sent_a_third_script() -> (Bench, ScriptRef) {
    let scripts: [&[Planned]; 1] = [&[("a", 0, 100), ("a", 100, 100), ("a", 200, 5_000)]];
    let mut bench = Bench::of(&[Tells::Nothing], 2, bench::played(&scripts));
    bench.play(Leases::Fixed);
    // In what follows, only the test itself makes the robot accept scripts.
    bench.silent = vec![R0];
    while bench.sent_to(R0).len() < 3 {
        bench.run_until(bench.now + ms(1));
    }
    let third = bench.scripts_of(R0)[2];
    (bench, third)
}

#[test]
fn duplicate_refusal_is_counted_once() {
    let (mut bench, third) = sent_a_third_script();
    let error = bench::refusal(ErrorCode::Busy);
    let refusal = ControlResponse { error, ..bench.response(third, Status::Failed) };
    bench.take_response(third, &refusal);
    bench.take_response(third, &refusal);
    assert_eq!((bench.state(R0, 2), bench.failed.len()), (&ScriptState::Planned, 0));
    bench.run_until(bench.now + ms(60));
    bench.take_response(third, &refusal);
    assert_eq!(bench.state(R0, 2), &ScriptState::Sent, "under a name that was not refused");
    bench.say(third, Status::Accepted);
    bench.take_response(third, &refusal);
    assert_eq!((bench.state(R0, 2), bench.failed.len()), (&ScriptState::Held, 0));
}

#[test]
fn script_refused_as_busy_is_soon_resent_to_robot_that_reports_nothing() {
    let (mut bench, third) = sent_a_third_script();
    bench.refuse(third, ErrorCode::Busy);
    let refused = bench.now;
    bench.run_until(refused + ms(60));
    let again: Vec<_> = bench.sent_to(R0).into_iter().skip(3).collect();
    assert!(matches!(again.as_slice(), [(at, 2)] if *at > refused), "{again:?}");
}

#[test]
fn robot_without_reports_is_asked_about_each_script_at_its_planned_end() {
    let mut bench = Bench::new(&[Tells::Answers], &[&[("a", 0, 200), ("b", 0, 230)]]);
    bench.play(Leases::Shortened);
    bench.run_to_the_end();
    let from = bench.start() + ms(100);
    let asked: Vec<_> = bench.asked_of(R0).map(|question| question.at).filter(|at| *at >= from).collect();
    let due = [200, 230].map(|end| bench.start() + ms(end) + super::super::LAPSE);
    let is_due = |(at, due): (&Timestamp<Server>, Timestamp<Server>)| *at >= due && *at < due + ms(1);
    assert!(asked.len() == 2 && asked.iter().zip(due).all(is_due), "{asked:?}, due at {due:?}");
    assert!(bench.act.is_over());
}
