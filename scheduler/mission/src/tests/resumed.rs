//! Missions that another process resumes from the journal of the process that died.

use super::again::{chained, second};
use super::course::{broken, fates, without_those_that_fail};
use super::played::Played;
use super::*;

/// The state of a mission according to its records, and the reports of the acts that have ended.
fn kept(played: &Played) -> (Kept, Vec<ActReport>) {
    let lines: Vec<_> =
        played.recorded.iter().flat_map(|record| dated_line(at(1), record).unwrap()).collect();
    (Kept::of_bytes(&lines), ended_acts(&lines).collect())
}

/// The mission as another process resumes it, `millis` milliseconds after its process has died.
fn resumed_after(played: &Played, millis: i64) -> Played {
    let (kept, ended) = kept(played);
    played.resumed_at(played.now + ms(millis), &kept, ended)
}

#[test]
fn resumed_mission_queries_sent_scripts_and_resends_none() {
    let mut played = Played::begun(waits_in(2));
    let first_ends = played.mission.acts[0].timing().unwrap().end;
    played.run_until(first_ends + ms(10));
    assert_eq!(played.mission.acts.len(), 1, "the second act plays alone");
    let now = played.now;
    let mut resumed = resumed_after(&played, 0).mission;
    assert_eq!((resumed.phase, resumed.course.begun), (Phase::Performing, 2));
    assert_eq!((resumed.acts.len(), resumed.acts[0].number().get()), (1, 1));
    assert!(
        resumed.acts[0]
            .script(ScriptRef { act: ActNumber::new(1), member: MemberIndex::new(0), script: 0 })
            .is_out()
    );
    assert!(resumed.robots[R0].halt.touched.contains(&"a".parse::<DeviceId>().unwrap()));
    assert_eq!(resumed.timers.next_round, Some(now), "leases have been running out");
    assert_eq!(resumed.course.fates[ActIndex::new(0)].fate, ActFate::Played);
    let actions = happens(&mut resumed, now, Event::LinkUp { robot: R0 });
    assert_eq!(scripts_in(&actions), []);
    let asks = |action: &Action| matches!(action, Action::Send { message: Message::Inquiry(_), .. });
    assert!(actions.iter().any(asks));
}

#[test]
fn left_out_robot_stays_out_after_resumption_and_is_stopped() {
    let mut played = Played::begun(without_those_that_fail());
    played.run_to_the_start();
    played.mission.fail(played.now, R1, broken());
    // The process dies before it sends the stop.
    let recorded = played.mission.advance(played.now).into_iter().filter_map(|action| match action {
        Action::Record(record) => Some(record),
        _ => None,
    });
    played.recorded.extend(recorded);
    let mut resumed = resumed_after(&played, 200);
    assert_eq!(resumed.mission.robots[R1].standing, Standing::Out);
    assert_eq!(resumed.run_to_the_end(), Outcome::DoneWithout);
    assert!(matches!(resumed.mission.robots[R1].halt.stop, Stop::Confirmed(_)));
}

/// A mission some time after it left out its second robot, which had played one step.
fn left_out_after(later: Span) -> Played {
    let mut played = Played::begun(without_those_that_fail());
    played.run_to_the_start();
    played.mission.fail(played.now, R1, broken());
    let actions = played.mission.advance(played.now);
    played.carry_out(actions);
    played.run_until(played.now + later);
    played
}

#[test]
fn robot_left_out_before_the_crash_is_reported_with_failure_and_steps() {
    // The process died before or after the robot had confirmed its stop.
    for confirmed in [false, true] {
        let played = left_out_after(if confirmed { ms(100) } else { Span::ZERO });
        let mut resumed = resumed_after(&played, 200);
        resumed.run_until(resumed.now + ms(10));
        let script = &resumed.mission.acts[0].member(R1).unwrap().scripts()[0];
        assert_eq!(script.steps_done(), 1, "{confirmed}");
        assert_eq!(resumed.run_to_the_end(), Outcome::DoneWithout);
        let robot = &resumed.mission.robots[R1];
        assert_eq!(robot.failures.iter().map(|failure| &failure.kind).collect::<Vec<_>>(), [&broken()]);
        assert_eq!((robot.totals.scripts, robot.totals.started, robot.totals.steps_done), (1, 1, 1));
        assert_eq!(robot.totals.unaccounted, 0);
        let left_out = resumed.mission.course.reports[0].robots.iter().map(|robot| robot.left_out);
        assert_eq!(left_out.collect::<Vec<_>>(), [false, true]);
    }
}

#[test]
fn act_that_ended_without_a_process_waits_briefly_for_a_left_out_robot() {
    for answers in [true, false] {
        let played = left_out_after(ms(100));
        let mut resumed = resumed_after(&played, 20_000);
        // The link of this robot is established last.
        resumed.delay_link(R1, if answers { ms(300) } else { ms(60_000) });
        assert_eq!(resumed.run_to_the_end(), Outcome::DoneWithout);
        let totals = resumed.mission.robots[R1].totals;
        assert_eq!((totals.steps_done, totals.unaccounted), if answers { (1, 0) } else { (0, 1) });
    }
}

#[test]
fn lapsing_act_is_prepared_again_by_the_resuming_process() {
    for committed in [false, true] {
        let mut played = chained(true);
        if committed {
            // The commitment was recorded ahead of time.
            played.recorded.push(Record::Committed { number: ActNumber::new(1) });
        }
        played.is_withdrawn();
        played.drops(&second(&played));
        let mut resumed = resumed_after(&played, 10);
        assert_eq!(resumed.run_to_the_end(), Outcome::Done, "{committed}");
        assert!(!resumed.mission.robots[R0].has_failed());
        assert!(resumed.mission.course.fates.iter().all(|act| act.played == 1));
    }
}

#[test]
fn act_resumed_too_late_to_query_its_robots_lapses_at_once() {
    let played = chained(true);
    let mut resumed = resumed_after(&played, 200);
    resumed.run_until(resumed.now + ms(5));
    // While the act approached its start, its robots would receive nothing, and the leases of the first act would end.
    assert!(resumed.mission.acts[1].is_lapsing());
    let asks = |message: &Message| matches!(message, Message::Inquiry(_));
    assert!(resumed.sent.iter().any(|(.., message)| asks(message)));
}

#[test]
fn act_prepared_again_is_reported_as_such_after_resumption() {
    let mut played = Played::begun(begins_at_once(Everything));
    let number = played.mission.acts[0].number();
    played.mission.withdraw_act(played.now, number, Outcome::DecisionLate { by: ms(30) });
    let actions = played.mission.advance(played.now);
    played.carry_out(actions);
    played.run_until(played.now + ms(20));
    played.run_to_the_start();
    let mut resumed = resumed_after(&played, 10);
    assert_eq!(resumed.run_to_the_end(), Outcome::Done);
    assert_eq!(resumed.mission.course.reports[0].prepared_again, 1);
}

#[test]
fn report_of_a_resumed_mission_contains_acts_ended_before_the_crash() {
    let mut played = Played::begun(waits_in(2));
    played.run_until(played.mission.acts[0].timing().unwrap().end + ms(10));
    let before = played.mission.course.reports[0].clone();
    let mut resumed = resumed_after(&played, 0);
    assert_eq!(resumed.run_to_the_end(), Outcome::Done);
    let undisturbed = played.run_to_the_end();
    let (mut totals, expected) = (resumed.mission.robots[R0].totals, played.mission.robots[R0].totals);
    assert_eq!((undisturbed, std::mem::take(&mut totals.reconnects)), (Outcome::Done, 1));
    assert_eq!(format!("{totals:?}"), format!("{expected:?}"));
    assert_eq!((totals.scripts, totals.steps_done), (2, 4));
    let reports = &resumed.mission.course.reports;
    assert_eq!(reports.iter().map(|act| act.number.get()).collect::<Vec<_>>(), [0, 1]);
    let [listed, before] = [&reports[0], &before].map(|act| serde_json::to_value(act).unwrap());
    assert_eq!((listed, resumed.mission.course.reports_omitted), (before, 0));
}

#[test]
fn acts_with_unreadable_reports_are_counted() {
    let mut played = Played::begun(waits_in(2));
    played.run_until(played.mission.acts[0].timing().unwrap().end + ms(10));
    let (kept, _) = kept(&played);
    let resumed = played.resumed_at(played.now, &kept, Vec::new());
    assert_eq!(resumed.mission.course.reports_omitted, 1);
}

#[test]
fn flaw_of_an_act_that_ended_before_the_crash_is_in_the_outcome() {
    let tolerance = ms(10);
    let outcome = |flaws: ActFlaws| {
        let mut played = Played::begun(waits_in(2));
        played.run_until(played.mission.acts[0].timing().unwrap().end + ms(10));
        let (mut kept, ended) = kept(&played);
        kept.flaws.push(flaws);
        played.resumed_at(played.now, &kept, ended).run_to_the_end()
    };
    assert_eq!(outcome(ActFlaws::default()), Outcome::Done);
    let unaccounted = vec![RobotId::new("r0").unwrap()];
    assert_eq!(outcome(ActFlaws { unaccounted, ..ActFlaws::default() }), Outcome::Unknown);
    let apart = OutOfTolerance { spread: ms(20), tolerance };
    let flaws = ActFlaws { out_of_tolerance: Some(apart), ..ActFlaws::default() };
    assert_eq!(outcome(flaws), Outcome::OutOfTolerance { spread: ms(20), tolerance });
    let late = StepsLate { late: ms(30), tolerance };
    let flaws = ActFlaws { steps_late: Some(late), ..ActFlaws::default() };
    assert_eq!(outcome(flaws), Outcome::StepsLate { late: ms(30), tolerance });
}

#[test]
fn start_without_id_may_belong_to_a_script_only_the_dead_process_sent() {
    let scripts = [("a", 0, 100), ("a", 200, 100), ("a", 400, 100)];
    let mut played = Played::begun(begins_with(Tells::Reports, &scripts));
    let start = played.mission.acts[0].timing().unwrap().start;
    played.run_until(start + ms(350));
    // The robot holds two scripts at a time. The first two are considered sent, and leave no room for the third one.
    let resumed = resumed_after(&played, 0).mission;
    let script = |script| ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script };
    assert!(resumed.acts[0].script(script(2)).is_planned());
    let device = "a".parse().unwrap();
    for (begins, expected) in [(200, script(1)), (400, script(2))] {
        let started = super::super::bench::response(&device, None, Status::Started, start + ms(begins));
        let says = requests::Says::ByItself;
        assert_eq!(requests::open_without_name(&resumed.acts, R0, says, &device, &started), Some(expected));
    }
}

#[test]
fn answer_without_id_belongs_to_a_script_that_this_process_sent() {
    let scripts = [("a", 0, 100), ("a", 200, 100), ("a", 400, 100)];
    let mut played = Played::begun(begins_with(Tells::Reports, &scripts));
    let start = played.mission.acts[0].timing().unwrap().start;
    played.run_until(start + ms(350));
    // The first two scripts are considered sent. Their acceptance, if any, went to the dead process.
    let mut resumed = resumed_after(&played, 0).mission;
    let script = |script| ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script };
    resumed.send_script(played.now, script(2));
    let device = "a".parse().unwrap();
    let says = requests::Says::ByItself;
    let at = start + ms(351);
    let accepted = super::super::bench::response(&device, None, Status::Accepted, at);
    assert_eq!(requests::open_without_name(&resumed.acts, R0, says, &device, &accepted), Some(script(2)));
    let mut late = super::super::bench::response(&device, None, Status::Failed, at);
    late.error = Some(ControlError::new(ErrorCode::Late, "the start passed 1 ms ago"));
    assert_eq!(requests::open_without_name(&resumed.acts, R0, says, &device, &late), Some(script(2)));
}

/// A mission with one act of two robots that takes one second.
fn of_two_robots() -> Played {
    let scripts: [&[Planned]; 2] = [&[("a", 0, 1_000)]; 2];
    let participant = |id: &str| Participant::new(RobotId::new(id).unwrap(), robot(id, Everything, 2).block);
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let participants = vec![participant("r0"), participant("r1")];
    let mission = Mission::new(Arc::new(choreography(&scripts)), participants, options, at(0)).unwrap();
    let mut played = Played::begun(mission);
    played.run_to_the_start();
    played
}

#[test]
fn act_that_ended_without_a_driving_process_was_not_stopped() {
    let fate = |robots_lost: &[RobotIndex], stopped_after: i64| {
        let played = of_two_robots();
        let mut resumed = resumed_after(&played, stopped_after);
        robots_lost.iter().for_each(|robot| resumed.mutes(*robot));
        resumed.run_until(resumed.now + ms(5));
        resumed.happens(Event::StopRequested { rest: Rest::InPlace, by: None });
        assert_eq!(resumed.run_to_the_end(), Outcome::Stopped);
        fates(&resumed)
    };
    assert_eq!(fate(&[R0], 3_000), [ActFate::Played], "one robot has completed it");
    assert_eq!(fate(&[R0, R1], 3_000), [ActFate::Unknown]);
    assert_eq!(fate(&[R0], 200), [ActFate::Stopped]);
    assert_eq!(fate(&[R0, R1], 200), [ActFate::Stopped]);
}

#[test]
fn act_whose_scripts_expired_waiting_for_a_dead_process_was_withdrawn() {
    let mut played = of_two_robots();
    // The leases of its scripts ended before their start.
    played.ends_early(0);
    let mut resumed = resumed_after(&played, 3_000);
    assert_eq!(resumed.run_to_the_end(), Outcome::NotStarted);
    assert_eq!(fates(&resumed), [ActFate::Withdrawn]);
}

#[test]
fn ended_scripts_of_a_long_movement_are_queried_at_once() {
    let scripts: Vec<_> = (0..8).map(|index| ("a", 2_000 * index, 2_000)).collect();
    let block = robot("r0", Everything, 2).block;
    let participants = vec![Participant::new(RobotId::new("r0").unwrap(), block)];
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let mission = Mission::new(Arc::new(choreography(&[&scripts])), participants, options, at(0)).unwrap();
    let mut played = Played::begun(mission);
    played.run_to_the_start();
    // Six scripts have begun, and the robot holds two at a time.
    played.run_until(played.now + ms(11_000));
    let mut resumed = resumed_after(&played, 50);
    assert_eq!(resumed.run_to_the_end(), Outcome::Done, "{:?}", resumed.told);
    assert_eq!(resumed.mission.robots[R0].totals.steps_done, 16);
    let first = resumed.sent.iter().find_map(|(_, _, message)| match message {
        Message::Inquiry(inquiry) => Some(inquiry.requests.len()),
        _ => None,
    });
    assert!(first >= Some(6), "{first:?}");
}

/// The outcome and the reason of a mission that is withdrawn with this outcome. Its robot confirms the stop.
fn withdrawn(moved: bool, outcome: Outcome) -> (Outcome, Option<String>) {
    let participants = vec![Participant::new(RobotId::new("r0").unwrap(), robot("r0", Everything, 2).block)];
    let on = crate::LeftOn { devices: ["a".parse().unwrap()].into(), ..Default::default() };
    let robots = [(RobotId::new("r0").unwrap(), on)].into();
    let failures = vec![Failure { robot: RobotId::new("r0").unwrap(), kind: broken() }];
    let left = crate::Left { robots, moved, failures, ..Default::default() };
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let cause = Cause { outcome, reason: "why".to_owned() };
    let mission =
        Mission::withdraw("s".to_owned(), participants, options, &left, cause, Rest::InPlace, at(0));
    let mut played = Played::linked(mission, &[R0]);
    let outcome = played.run_to_the_end();
    assert!(matches!(played.mission.robots[R0].halt.stop, Stop::Confirmed(_)));
    assert_eq!(played.mission.robots[R0].failures.len(), 1, "the failure from the journal");
    (outcome, played.mission.because().map(str::to_owned))
}

#[test]
fn withdrawn_mission_failed_if_anything_may_have_moved_else_not_started() {
    let why = || Some("why".to_owned());
    assert_eq!(withdrawn(true, Outcome::Failed), (Outcome::Failed, why()));
    assert_eq!(withdrawn(false, Outcome::Failed), (Outcome::NotStarted, why()));
    assert_eq!(withdrawn(true, Outcome::NotStarted), (Outcome::Failed, why()));
    assert_eq!(withdrawn(true, Outcome::Stopped), (Outcome::Stopped, None));
    let late = Outcome::DecisionLate { by: ms(3) };
    assert_eq!(withdrawn(false, late.clone()), (late.clone(), why()));
    assert_eq!(withdrawn(true, late.clone()), (Outcome::Failed, late.hold_up()));
}

#[test]
fn device_moved_before_resumption_continues_as_the_scenario_specifies() {
    let mut show = choreography(&[&[("a", 0, 400)]]);
    for (device, length, next) in [("b", 9_000, Way::Act(2)), ("a", 400, Way::End)] {
        let mut act = choreography(&[&[(device, 0, length)]]).acts.remove(0);
        (act.next, act.name) = (next, format!("moves {device}"));
        show.acts.push(act);
    }
    show.acts[0].next = Way::Act(1);
    let mut block = robot("r0", Everything, 2).block.unwrap();
    block.devices.iter_mut().for_each(|device| device.interpolation = urrcp::Interpolation::Linear);
    let participants = vec![Participant::new(RobotId::new("r0").unwrap(), Some(block))];
    let mission = Mission::new(Arc::new(show), participants, MissionOptions::default(), at(0)).unwrap();
    let mut played = Played::linked(mission, &[R0]);
    played.positions = ["a", "b"].map(|device| (device.parse().unwrap(), 45.0)).into();
    played.run_until(at(3_000));
    assert_eq!(played.mission.acts[0].index(), ActIndex::new(1));
    let mut resumed = resumed_after(&played, 100);
    resumed.mission.options.greeting = Greeting::Full;
    resumed.positions.insert("a".parse().unwrap(), 0.0);
    assert_eq!(resumed.run_to_the_end(), Outcome::Done, "{:?}", resumed.mission.robots[R0].failures);
}

#[test]
fn mission_that_continued_after_a_stop_is_withdrawn_and_not_resumed() {
    let mut played = Played::begun(waits_in(2));
    played.run_until(played.mission.acts[0].timing().unwrap().end + ms(10));
    assert_eq!(kept(&played).0.fate(), crate::Fate::Resume);
    let promises =
        |record: &Record| matches!(record, Record::Prepared(promise) if promise.number == ActNumber::new(1));
    let second = played.recorded.iter().position(promises).unwrap();
    let stopping = Record::Stopping { outcome: Outcome::Failed, rest: Rest::InPlace, by: None };
    played.recorded.insert(second, stopping);
    assert!(matches!(kept(&played).0.fate(), crate::Fate::Withdraw(_)));
}

#[test]
fn script_not_sent_in_time_by_a_dead_process_is_not_reported_as_lost() {
    let chain = [("a", 0, 300), ("a", 400, 300), ("a", 800, 300), ("a", 1_200, 300)];
    let mut played = Played::begun(begins_with(Everything, &chain));
    played.run_to_the_start();
    let mut resumed = resumed_after(&played, 900);
    assert_eq!(resumed.run_to_the_end(), Outcome::Failed);
    let texts: Vec<_> =
        resumed.mission.robots[R0].failures.iter().map(|failure| failure.kind.to_string()).collect();
    assert!(
        matches!(texts.as_slice(), [text] if text.contains("does not have the script, and the script's start has passed")),
        "{texts:?}"
    );
}

#[test]
fn resumed_act_keeps_the_doubt_recorded_at_its_decision() {
    let mut played = Played::begun(begins_at_once(Everything));
    played.run_to_the_start();
    let stated = played.recorded.iter().find_map(|record| match record {
        Record::Decided { doubt, .. } => Some(*doubt),
        _ => None,
    });
    let mut resumed = resumed_after(&played, 50);
    assert_eq!(resumed.run_to_the_end(), Outcome::Done);
    assert_eq!(Some(resumed.mission.course.reports[0].doubt), stated);
}

/// The failures after another process has resumed an act of three robots with measured clocks. The robots' clocks are ahead of that
/// process's clock by `ahead` in milliseconds.
fn resumed_with_clocks(ahead: [i64; 3]) -> Vec<(RobotIndex, FailureKind)> {
    let chain = [("a", 0, 300), ("a", 400, 300), ("a", 800, 300), ("a", 1_200, 300)];
    let scripts: [&[Planned]; 3] = [&chain; 3];
    let participant =
        |id: &str| Participant::new(RobotId::new(id).unwrap(), robot(id, Tells::Nothing, 2).block);
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let participants = ["r0", "r1", "r2"].map(participant).to_vec();
    let mut mission = Mission::new(Arc::new(choreography(&scripts)), participants, options, at(0)).unwrap();
    mission.robots.iter_mut().for_each(|robot| robot.settings.clock = ClockMode::Measured);
    let mut played = Played::linked(mission, &[R0, R1, R2]);
    played.run_until(at(50));
    played.run_to_the_start();
    let mut resumed = resumed_after(&played, 100);
    resumed.mission.robots.iter_mut().for_each(|robot| robot.settings.clock = ClockMode::Measured);
    resumed.ahead =
        ahead.into_iter().map(ms).zip(0..).map(|(ahead, robot)| (RobotIndex::new(robot), ahead)).collect();
    resumed.run_until(resumed.now + ms(100));
    let failures = |(index, robot): (RobotIndex, &RobotState)| {
        robot.failures.iter().map(move |failure| (index, failure.kind.clone())).collect::<Vec<_>>()
    };
    resumed.mission.robots.enumerated().flat_map(failures).collect()
}

#[test]
fn clock_set_before_resumption_fails_its_robot_unless_it_was_ours() {
    assert_eq!(resumed_with_clocks([0, 0, 0]), []);
    assert_eq!(resumed_with_clocks([-2_000; 3]), [], "the clock of this machine was set");
    for ahead in [[0, 2_000, 0], [-2_000, 0, -2_000]] {
        let failures = resumed_with_clocks(ahead);
        assert!(matches!(failures.as_slice(), [(R1, FailureKind::Clock { .. })]), "{ahead:?}: {failures:?}");
    }
}
