//! Missions without links, observed through their actions.

mod again;
mod clocks;
mod course;
mod greeting;
mod hostile;
mod lost;
mod played;
mod readings;
mod resumed;
mod stops;
mod table;
mod transfer;

use std::sync::Arc;

use downbeat_fleet::sensor_range::SensorRange;
use downbeat_plan::{Wait, Way};
use urrcp::{DeviceId, ErrorCode, Message, RequestId, Span, Status};

use super::act::ActAction;
use super::bench::Tells::Everything;
use super::bench::{
    Planned, R0, R1, R2, TOLERANCE, Tells, at, by_robot, choreography, device_script, ms, robot,
};
use super::preflight::{Check, Verdict};
use super::robot_state::{Standing, Stop};
use super::script::ScriptRef;
use super::*;
use crate::clock::ClockSample;
use crate::session::Session;

/// A mission with two acts, `one` and `two`, that one robot plays. The act with the index `waiting` waits for the operator.
fn waits_in(waiting: usize) -> Mission {
    let mut choreography = choreography(&[&[("a", 0, 400)]]);
    let two = choreography.acts[0].clone();
    choreography.acts.push(two);
    for (index, name) in ["one", "two"].into_iter().enumerate() {
        choreography.acts[index].name = name.to_owned();
        choreography.acts[index].next = if index == 0 { Way::Act(1) } else { Way::End };
        choreography.acts[index].wait = if index == waiting { Wait::Operator } else { Wait::Done };
    }
    let block = robot("r0", Everything, 2).block;
    let participants = vec![Participant::new(RobotId::new("r0").unwrap(), block)];
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    Mission::new(Arc::new(choreography), participants, options, at(0)).unwrap()
}

#[track_caller]
fn answers(mission: &mut Mission, act: Option<&str>, expected: Result<&str, &str>) {
    let actions = mission.handle(at(1), Event::Go { act: act.map(str::to_owned), by: None });
    let answer = actions.into_iter().find_map(|action| match action {
        Action::Answer(answer) => Some(answer),
        _ => None,
    });
    assert_eq!(answer, Some(expected.map(str::to_owned).map_err(str::to_owned)));
}

#[test]
fn go_applies_to_the_waiting_act_and_is_otherwise_refused_with_a_reason() {
    let mut mission = waits_in(0);
    answers(&mut mission, None, Err("the fleet is still being checked"));
    let _sent = mission.handle(at(0), Event::LinkUp { robot: R0 });
    answers(&mut mission, Some("three"), Err("unknown act `three`"));
    answers(&mut mission, Some("two"), Err("`two` is not waiting; `one` waits for the operator's go"));
    answers(&mut mission, Some("one"), Ok("one"));
    answers(&mut mission, Some("one"), Err("`one` is not waiting for the operator"));
    answers(&mut mission, None, Err("no act is waiting for the operator"));
    // Nothing was sent, so no stop is needed.
    let _ended = mission.handle(at(2), Event::StopRequested { rest: Rest::InPlace, by: None });
    answers(&mut mission, None, Err("the mission is over"));
}

/// A mission with one act that begins at once. `tells` are the abilities of its robot.
fn begins_at_once(tells: Tells) -> Mission {
    one_act(tells, 400)
}

/// Like `begins_at_once`, but the act takes `takes` milliseconds.
fn one_act(tells: Tells, takes: i64) -> Mission {
    begins_with(tells, &[("a", 0, takes)])
}

fn begins_with(tells: Tells, scripts: &[Planned]) -> Mission {
    let block = robot("r0", tells, 2).block;
    let participants = vec![Participant::new(RobotId::new("r0").unwrap(), block)];
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    Mission::new(Arc::new(choreography(&[scripts])), participants, options, at(0)).unwrap()
}

fn scripts_in(actions: &[Action]) -> Vec<RequestId> {
    let script = |action: &Action| match action {
        Action::Send { message: Message::ControlRequest(request), .. } => request.request_id.clone(),
        _ => None,
    };
    actions.iter().filter_map(script).collect()
}

/// Handles an event, with a disk that stores records immediately.
fn happens(mission: &mut Mission, now: Timestamp<Server>, event: Event) -> Vec<Action> {
    let mut actions = mission.handle(now, event);
    actions.extend(mission.advance(now));
    for count in 1..=3 {
        actions.extend(mission.handle(now, Event::Recorded { count }));
        actions.extend(mission.advance(now));
    }
    actions
}

#[test]
fn robot_without_inquiries_is_resent_waiting_scripts_on_reconnection() {
    for (tells, again) in [(Tells::Reports, true), (Everything, false)] {
        let mut mission = begins_at_once(tells);
        let first = scripts_in(&happens(&mut mission, at(0), Event::LinkUp { robot: R0 }));
        assert_eq!(first.len(), 1);
        let down = Event::LinkDown { robot: R0, loss: Loss::Closed, reason: "it broke".to_owned() };
        let _reconnects = happens(&mut mission, at(2), down);
        let actions = happens(&mut mission, at(4), Event::LinkUp { robot: R0 });
        let expected = if again { first } else { Vec::new() };
        assert_eq!(scripts_in(&actions), expected, "{tells:?}");
        let totals = mission.robots[R0].totals;
        assert_eq!((totals.reconnects, totals.retries), (1, u32::from(again)), "{tells:?}");
    }
}

#[test]
fn stops_are_sent_only_on_an_identified_link_of_the_intended_robot() {
    let mut mission = begins_at_once(Everything);
    assert!(!mission.takes_stops(at(0), R0), "there is no link");
    let _sent = mission.handle(at(0), Event::LinkUp { robot: R0 });
    assert!(mission.takes_stops(at(0), R0), "the link of the robot itself");
}

/// A mission, the act that it has sent (already removed from it), and the act's report.
fn sent_act() -> (Mission, Act, ActReport) {
    let mut mission = begins_at_once(Everything);
    let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    let act = mission.acts.remove(0);
    let report = ActReport::new(&act, &mission.robots).unwrap();
    (mission, act, report)
}

fn with_rows(mut report: ActReport, rows: usize) -> ActReport {
    report.robots = vec![report.robots[0].clone(); rows];
    report
}

#[test]
fn report_of_the_last_act_is_kept_whatever_its_size() {
    let (mut mission, act, report) = sent_act();
    mission.keep_report(&act, with_rows(report.clone(), 20_001));
    assert_eq!((mission.course.reports.len(), mission.course.reports_omitted), (1, 0));
    mission.keep_report(&act, report);
    assert_eq!(
        (mission.course.reports.len(), mission.course.reports_omitted),
        (1, 1),
        "the oldest is left out"
    );
}

#[test]
fn reports_are_kept_up_to_twenty_thousand_rows() {
    let (mut mission, act, report) = sent_act();
    mission.keep_report(&act, with_rows(report.clone(), 19_999));
    mission.keep_report(&act, report.clone());
    assert_eq!((mission.course.reports.len(), mission.course.reports_omitted), (2, 0));
    mission.keep_report(&act, report);
    assert_eq!((mission.course.reports.len(), mission.course.reports_omitted), (2, 1));
}

#[test]
fn stopped_robot_with_waiting_script_rests_when_its_pending_lease_ends() {
    let (mut mission, act, _) = sent_act();
    mission.robots[R0].set_stop(Stop::Confirmed(Rest::InPlace));
    let member = &act.members()[MemberIndex::new(0)];
    let lease = act.timing().unwrap().lead.lease;
    let left = act.left_behind(member, 0, &mission.robots[R0], at(1));
    assert_eq!(left, Some(Some(mission.robots[R0].contact.last_sent.unwrap() + lease)));
}

#[test]
fn act_is_sent_later_than_the_preceding_stop() {
    for (stopped, sent) in [(None, at(0)), (Some(at(0)), at(0) + Span::from_nanos(1))] {
        let mut mission = begins_at_once(Everything);
        mission.timers.stopped_at = stopped;
        let actions = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
        let script = |action: &Action| match action {
            Action::Send { message: Message::ControlRequest(request), .. } => request.timestamp,
            _ => None,
        };
        assert_eq!(actions.iter().find_map(script), Some(sent));
    }
}

#[test]
fn required_sensor_passes_once_read_and_only_if_robots_are_greeted() {
    let read = Some(51.0);
    for (greeting, readings, passes) in [
        (Greeting::Full, vec![read], true),
        (Greeting::Full, vec![None], false),
        (Greeting::Skip, vec![read], false),
    ] {
        let mut mission = begins_at_once(Everything);
        let range = SensorRange::Above(50.0);
        mission.robots[R0].settings.require = vec![Requirement { sensor: "eye".parse().unwrap(), range }];
        mission.robots[R0].greeted.readings = readings;
        mission.options.greeting = greeting;
        let table = preflight::table(&mission, at(0));
        let verdict = table.rows[0].checks.iter().find(|(check, _)| *check == Check::Sensors).unwrap();
        let expected = if passes { Verdict::Pass("eye 51".to_owned()) } else { Verdict::NotChecked };
        assert_eq!(verdict.1, expected, "{greeting:?}");
    }
}

/// A mission in the phase `Performing` whose link broke and was re-established. On each new link, the mission asks which robot answers.
fn reconnected() -> Mission {
    let mut mission = begins_at_once(Everything);
    let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    mission.options.greeting = Greeting::Full;
    let down = Event::LinkDown { robot: R0, loss: Loss::Closed, reason: "it broke".to_owned() };
    let _reconnects = happens(&mut mission, at(2), down);
    let _asks = mission.handle(at(4), Event::LinkUp { robot: R0 });
    mission
}

#[test]
fn unidentified_robot_is_asked_again_before_its_link_is_dropped() {
    let mut mission = reconnected();
    mission.ask_names_again(at(300));
    assert!(mission.robots[R0].unnamed_since().is_some(), "it may still answer");
    assert!(
        mission
            .outbox
            .actions
            .iter()
            .any(|action| matches!(action, Action::Send { message: Message::InitializationRequest(_), .. }))
    );
    mission.ask_names_again(at(4_000));
    assert!(mission.robots[R0].unnamed_since().is_none(), "equivalent to unreached");
}

#[test]
fn another_robot_at_the_address_of_a_playing_one_stops_the_mission() {
    let mut mission = reconnected();
    let block = robot("another", Everything, 2).block.unwrap();
    let _actions =
        mission.handle(at(5), Event::Received { robot: R0, message: Message::InitializationBlock(block) });
    assert!(
        mission.robots[R0]
            .failures
            .iter()
            .any(|failure| matches!(failure.kind, FailureKind::AnotherRobot { .. }))
    );
    assert!(matches!(mission.phase, Phase::Stopping { .. } | Phase::Ended), "{:?}", mission.phase);
}

#[test]
fn robot_with_unanswered_measured_clock_fails_when_patience_ends() {
    let mut mission = begins_at_once(Everything);
    mission.robots[R0].settings.clock = ClockMode::Measured;
    let _asks = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    let ends = mission.acts[0].since() + mission.options.patience;
    let _waits = mission.advance(ends - Span::from_nanos(1));
    assert!(!mission.robots[R0].has_failed());
    let _fails = mission.advance(ends);
    assert!(mission.robots[R0].has_failed());
}

#[test]
fn robot_that_was_sent_nothing_gets_no_stop_and_others_get_only_one() {
    let mut mission = begins_at_once(Everything);
    mission.stop_robot(at(0), R0, Rest::InPlace);
    assert!(!mission.robots[R0].stop_was_sent() && mission.timers.stopped_at.is_none());
    let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    mission.stop_robot(at(1), R0, Rest::InPlace);
    mission.stop_robot(at(2), R0, Rest::Home);
    assert!(
        matches!(&mission.robots[R0].halt.stop, Stop::Sent(sent) if sent.at == at(1) && sent.rest == Rest::InPlace)
    );
    assert_eq!(mission.timers.stopped_at, Some(at(1)));
}

#[test]
fn robot_owes_the_fate_of_its_sent_scripts_if_it_can_report_it() {
    for (tells, owes) in [(Everything, true), (Tells::Reports, true), (Tells::Nothing, false)] {
        let mut mission = begins_at_once(tells);
        assert!(!mission.owes_a_fate(R0), "{tells:?}: nothing was sent");
        let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
        assert_eq!(mission.owes_a_fate(R0), owes, "{tells:?}");
    }
}

#[test]
fn act_reports_how_far_apart_its_starts_may_be() {
    let mut mission = greets_a_clock(0, 2);
    mission.options.greeting = Greeting::Skip;
    let actions = happens(&mut mission, at(3), Event::LinkUp { robot: R0 });
    let skew = actions.iter().find_map(|action| match action {
        Action::Tell(Progress::Preparing { skew, .. }) => skew.as_ref(),
        _ => None,
    });
    assert!(skew.is_some());
    let act = mission.acts.remove(0);
    assert!(mission.skew_of(&act, at(4)).is_some(), "its lead follows from it");
}

#[test]
fn stopping_mission_sends_no_pending_scripts() {
    let mut mission = begins_at_once(Everything);
    let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    let _stops = mission.handle(at(1), Event::StopRequested { rest: Rest::InPlace, by: None });
    assert!(matches!(mission.phase, Phase::Stopping { .. }), "{:?}", mission.phase);
    let script = ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script: 0 };
    mission.carry_out(at(2), ActNumber::new(0), vec![ActAction::Send(script)]);
    assert_eq!(scripts_in(&mission.outbox.actions), []);
}

#[test]
fn robot_with_unconfirmed_stop_is_sent_no_script_of_the_next_act() {
    for (is_stopped, sends) in [(true, 0), (false, 1)] {
        let mut mission = begins_at_once(Everything);
        let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
        if is_stopped {
            mission.stop_robot(at(1), R0, Rest::InPlace);
        }
        mission.outbox.actions.clear();
        let script = ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script: 0 };
        mission.carry_out(at(2), ActNumber::new(0), vec![ActAction::Send(script)]);
        assert_eq!(scripts_in(&mission.outbox.actions).len(), sends, "stopped: {is_stopped}");
    }
}

#[test]
fn deferred_script_is_not_sent_after_the_stop_of_its_robot() {
    for (is_stopped, sends) in [(true, 0), (false, 1)] {
        let mut mission = begins_at_once(Everything);
        let sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
        let script = sent.into_iter().find_map(|action| match action {
            Action::Send { message: message @ Message::ControlRequest(_), .. } => Some(message),
            _ => None,
        });
        if is_stopped {
            mission.stop_robot(at(1), R0, Rest::InPlace);
        }
        mission.outbox.actions.clear();
        mission.outbox.deferred = vec![(R0, script.unwrap())];
        mission.send_deferred(at(2));
        assert_eq!(scripts_in(&mission.outbox.actions).len(), sends, "stopped: {is_stopped}");
    }
}

/// A mission with two acts: `r0` alone plays the first one, and `r1` alone plays the second one.
fn one_after_the_other() -> Mission {
    let mut choreography = choreography(&[&[("a", 0, 400)], &[("a", 0, 400)]]);
    let two = choreography.acts[0].clone();
    choreography.acts.push(two);
    choreography.acts[0].plan.robots.truncate(1);
    choreography.acts[1].plan.robots.remove(0);
    choreography.acts[0].next = Way::Act(1);
    let robots =
        ["r0", "r1"].map(|id| Participant::new(RobotId::new(id).unwrap(), robot(id, Everything, 2).block));
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    Mission::new(Arc::new(choreography), robots.to_vec(), options, at(0)).unwrap()
}

#[test]
fn act_with_no_robots_left_is_skipped() {
    let mut mission = one_after_the_other();
    mission.robots[R0].standing = Standing::Out;
    mission.options.check_invariants = false;
    let actions = happens(&mut mission, at(0), Event::LinkUp { robot: R1 });
    assert_eq!(scripts_in(&actions).len(), 1, "`r1` has its script of the second act");
    assert_eq!(mission.course.fates[ActIndex::new(0)].fate, ActFate::NobodyLeft);
}

#[test]
fn starts_off_by_exactly_the_tolerance_are_in_tolerance() {
    for (error, flawed) in [(TOLERANCE, false), (TOLERANCE + Span::from_nanos(1), true)] {
        let (mut mission, act, mut report) = sent_act();
        report.robots[0].devices[0].start_error = Some(error);
        mission.keep_report(&act, report);
        assert_eq!(mission.conclusion.flaw_of_times.is_some(), flawed, "{error}");
    }
}

#[test]
fn steps_late_by_the_tolerance_are_accepted_and_left_out_robots_ignored() {
    let beyond = TOLERANCE + Span::from_nanos(1);
    for (late, left_out, flawed) in [(TOLERANCE, false, false), (beyond, false, true), (beyond, true, false)]
    {
        let (mut mission, act, mut report) = sent_act();
        report.robots[0].left_out = left_out;
        report.robots[0].devices[0].late_max = Some(late);
        mission.keep_report(&act, report);
        let expected = flawed.then_some(Outcome::StepsLate { late, tolerance: TOLERANCE });
        assert_eq!(mission.conclusion.flaw_of_times, expected, "{late}, left out: {left_out}");
    }
}

/// A mission that still greets its robot, after one exchange of timestamps. `offset` is the offset of the robot's clock, and `delay` the
/// round trip, in milliseconds.
fn greets_a_clock(offset: i64, delay: i64) -> Mission {
    let mut mission = begins_at_once(Everything);
    mission.options.greeting = Greeting::Full;
    let (sent, received) = (at(0), at(delay));
    let by_robot = by_robot(at(delay / 2 + offset));
    mission.robots[R0].clock.add(ClockSample::from_exchange(sent, by_robot, by_robot, received));
    mission
}

#[test]
fn clock_is_refused_only_if_certainly_off() {
    for (offset, delay, refused) in [(8, 10, false), (12, 10, false), (18, 10, true)] {
        let mut mission = greets_a_clock(offset, delay);
        mission.check_clocks(at(delay));
        assert_eq!(mission.robots[R0].has_failed(), refused, "{offset} ms, known to {} ms", delay / 2);
    }
}

#[test]
fn absent_robot_may_join_after_patience_ends_but_a_silent_one_fails() {
    for (connected, standing, failed) in [(false, Standing::Absent, false), (true, Standing::In, true)] {
        let mut mission = begins_at_once(Everything);
        mission.options.greeting = Greeting::Full;
        mission.options.join = Join::NextAct;
        if connected {
            let _asks = mission.handle(at(0), Event::LinkUp { robot: R0 });
            mission.robots[R0].named();
        }
        mission.greeting_overdue(at(0) + mission.options.patience);
        let robot = &mission.robots[R0];
        assert!(
            robot.has_failed() == failed && (failed || robot.standing == standing),
            "connected: {connected}"
        );
    }
}

#[test]
fn robot_is_ours_once_asked_on_its_link_for_a_session() {
    for (greeting, session, up) in [
        (Greeting::Full, true, true),
        (Greeting::Skip, true, true),
        (Greeting::Full, false, true),
        (Greeting::Full, true, false),
    ] {
        let mut mission = begins_at_once(Everything);
        mission.options.greeting = greeting;
        mission.options.session = session.then(|| Session::named("s".parse().unwrap()));
        if up {
            mission.robots[R0].connected(at(0));
            mission.robots[R0].named();
        }
        let table = preflight::table(&mission, at(0));
        let verdict = table.rows[0].checks.iter().find(|(check, _)| *check == Check::Free).unwrap();
        let ours = greeting == Greeting::Full && session && up;
        assert_eq!(verdict.1 == Verdict::Pass("ours".to_owned()), ours, "{greeting:?} {session} {up}");
    }
}

#[test]
fn script_must_fit_the_limits_its_robot_declares() {
    let block = |steps: u32| {
        let mut block = robot("r0", Everything, 2).block.unwrap();
        let text = serde_json::to_string(&block)
            .unwrap()
            .replace("\"max_number_of_steps\":8", &format!("\"max_number_of_steps\":{steps}"));
        block = serde_json::from_str(&text).unwrap();
        block
    };
    let script = device_script(("a", 0, 400));
    assert_eq!(greet::unfit(&script, &block(2)), Vec::<String>::new());
    assert_eq!(
        greet::unfit(&script, &block(1)),
        ["device `a` supports at most 1 step per script, but the plan has 2"]
    );
}

#[test]
fn resent_script_is_counted() {
    let mut mission = begins_at_once(Everything);
    let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    mission.count_retry(ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script: 0 });
    assert_eq!(mission.robots[R0].totals.retries, 1);
}

#[test]
fn start_without_id_belongs_to_a_held_script() {
    let mut mission = begins_at_once(Tells::Nothing);
    let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    let device = "a".parse().unwrap();
    let accepted = Message::ControlResponse(super::bench::response(&device, None, Status::Accepted, at(1)));
    let _noted = happens(&mut mission, at(1), Event::Received { robot: R0, message: accepted });
    let started = super::bench::response(&device, None, Status::Started, at(2));
    let found = requests::open_without_name(&mission.acts, R0, requests::Says::Answers, &device, &started);
    assert_eq!(found, Some(ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script: 0 }));
}

#[test]
fn expired_lease_without_id_is_assigned_to_the_shortest_open_lease() {
    let sent = |scripts: &[Planned]| {
        let participant = Participant::new(RobotId::new("r0").unwrap(), robot("r0", Tells::Reports, 4).block);
        let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
        let choreography = Arc::new(choreography(&[scripts]));
        let mut mission = Mission::new(choreography, vec![participant], options, at(0)).unwrap();
        let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
        mission
    };
    let device = "a".parse().unwrap();
    let failed = |code| urrcp::ControlResponse {
        error: super::bench::refusal(code),
        ..super::bench::response(&device, None, Status::Failed, at(2))
    };
    let script = |script| ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script };
    // A script that waits behind another script of its act has the lease of that running script. Another act waits under a shorter one.
    let (mut before, mut behind) = (sent(&[("a", 0, 400), ("a", 500, 400)]), sent(&[("a", 0, 400)]));
    let mut acts = vec![before.acts.remove(0), behind.acts.remove(0)];
    let _over = acts[0].answered(script(0), &failed(ErrorCode::Cancelled), at(2), &before.robots);
    acts[0].sent(at(2), script(1));
    for (code, expected) in [(ErrorCode::Cancelled, 1), (ErrorCode::LinkLost, 0)] {
        let says = requests::Says::ByItself;
        let found = requests::open_without_name(&acts, R0, says, &device, &failed(code.clone()));
        assert_eq!(found, Some(script(expected)), "{code}");
    }
}

#[test]
fn act_names_the_robot_that_requires_early_sending() {
    let mut played = played::Played::begun(one_act(Everything, 400));
    played.run_to_the_start();
    let slowest = played.mission.acts[0].timing().unwrap().slowest.as_ref();
    assert_eq!(slowest.map(|(robot, _)| robot.as_str()), Some("r0"));
}

#[test]
fn end_without_id_belongs_to_latest_begun_script_if_two_would_end_then() {
    let mut mission = begins_with(Tells::Reports, &[("a", 0, 400), ("a", 400, 0)]);
    let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    mission.acts[0].sent(at(1), ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script: 1 });
    let start = mission.acts[0].timing().unwrap().start;
    let device = "a".parse().unwrap();
    let says = |status, when: Timestamp<Server>| {
        let said = super::bench::response(&device, None, status, at(1));
        urrcp::ControlResponse { timestamp: when.assume_clock(), ..said }
    };
    for (script, begins) in [(0, start), (1, start + ms(400))] {
        let script = ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script };
        for (status, when) in [(Status::Accepted, at(2)), (Status::Started, begins)] {
            let _noted = mission.acts[0].answered(script, &says(status, when), when, &mission.robots);
        }
    }
    let ended = says(Status::Ok, start + ms(400));
    let found = requests::open_without_name(&mission.acts, R0, requests::Says::ByItself, &device, &ended);
    let last = ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script: 1 };
    assert_eq!(found, Some(last), "the end of what began before it was not heard");
    let again = says(Status::Started, start + ms(400));
    let found = requests::open_without_name(&mission.acts, R0, requests::Says::ByItself, &device, &again);
    assert_eq!(found, None, "neither came again");
}

#[test]
fn next_round_is_later_than_the_one_just_done() {
    let mut mission = begins_at_once(Everything);
    let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    mission.timers.next_round = Some(at(5));
    mission.renew_if_due(at(5));
    assert!(mission.timers.next_round > Some(at(5)), "{:?}", mission.timers.next_round);
}

#[test]
fn robot_without_inquiries_owes_nothing_once_it_responds_after_its_stop() {
    for (answered, owes) in [(0, true), (1, true), (2, false)] {
        let mut mission = begins_at_once(Tells::Reports);
        let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
        mission.timers.stopped_at = Some(at(1));
        mission.robots[R0].contact.questions.asked(at(answered));
        mission.robots[R0].contact.questions.answer(at(answered));
        assert_eq!(mission.owes_a_fate(R0), owes, "answered {answered} ms after the beginning");
    }
}

#[test]
fn stops_of_two_devices_follow_an_inquiry_that_ends_both_leases() {
    let block = robot("r0", Everything, 2).block;
    let participants = vec![Participant::new(RobotId::new("r0").unwrap(), block)];
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let scripts: &[&[super::bench::Planned]] = &[&[("a", 0, 400), ("b", 0, 400)]];
    let mut mission = Mission::new(Arc::new(choreography(scripts)), participants, options, at(0)).unwrap();
    let sent = scripts_in(&happens(&mut mission, at(0), Event::LinkUp { robot: R0 }));
    assert_eq!(sent.len(), 2);
    let actions = mission.handle(at(1), Event::StopRequested { rest: Rest::InPlace, by: None });
    let kinds: Vec<&str> = actions
        .iter()
        .filter_map(|action| match action {
            Action::Send { message: Message::Inquiry(_), .. } => Some("question"),
            Action::Send { message: Message::ControlRequest(_), .. } => Some("stop"),
            _ => None,
        })
        .collect();
    assert_eq!(kinds, ["question", "stop", "stop"]);
}

#[test]
fn first_round_is_not_due_immediately() {
    let mut mission = waits_in(0);
    let _waits = mission.handle(at(0), Event::LinkUp { robot: R0 });
    mission.timers.next_round = None;
    let before = mission.outbox.actions.len();
    mission.renew_if_due(at(1));
    assert_eq!((mission.outbox.actions.len(), mission.timers.next_round), (before, Some(at(1_001))));
    mission.renew_if_due(at(1_001));
    assert!(mission.outbox.actions.len() > before, "the robot is asked");
}

#[test]
fn queued_act_is_replaced_by_the_act_a_failure_leads_to() {
    let mut mission = waits_in(1);
    let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    mission.lead_elsewhere(ActIndex::new(0));
    assert_eq!((mission.acts.len(), mission.course.begun), (1, 1), "the current act continues");
    mission.line_up_act(at(1), ActIndex::new(1));
    assert_eq!((mission.acts.len(), mission.course.begun), (2, 2));
    mission.lead_elsewhere(ActIndex::new(0));
    assert_eq!(
        (mission.acts.len(), mission.course.begun, mission.course.detour),
        (1, 1, Some(ActIndex::new(0)))
    );
}

/// The time at which the script of [`sent_act`] that its robot still has is ended by a lease.
fn left_at(mission: &Mission, act: &Act, now: Timestamp<Server>) -> Option<Option<Timestamp<Server>>> {
    act.left_behind(&act.members()[MemberIndex::new(0)], 0, &mission.robots[R0], now)
}

#[test]
fn script_whose_pending_lease_reaches_its_start_uses_its_running_lease() {
    let (mut mission, act, _) = sent_act();
    mission.robots[R0].set_stop(Stop::Confirmed(Rest::InPlace));
    let timing = act.timing().unwrap();
    for (before, ends_by) in [(ms(1), timing.lead.lease), (ms(0), super::bench::RUNNING)] {
        let last_sent = timing.start - timing.lead.lease - before;
        mission.robots[R0].contact.last_sent = Some(last_sent);
        assert_eq!(left_at(&mission, &act, at(1)), Some(Some(last_sent + ends_by)), "{before} before it");
    }
}

#[test]
fn running_script_ends_by_its_running_lease_from_the_last_message() {
    let (mut mission, mut act, _) = sent_act();
    let script = ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script: 0 };
    let started = act.timing().unwrap().start;
    let says = super::bench::response(&"a".parse().unwrap(), None, Status::Started, started);
    let _noted = act.answered(script, &says, started, &mission.robots);
    mission.robots[R0].contact.last_sent = Some(at(10));
    let ends = at(10) + super::bench::RUNNING;
    assert_eq!(left_at(&mission, &act, at(100)), Some(Some(ends)));
    let there = by_robot(at(3));
    mission.robots[R0].clock.add(ClockSample::from_exchange(at(0), there, there, at(7)));
    assert_eq!(left_at(&mission, &act, at(100)), Some(Some(ends + ms(7))), "it may have been under way");
    mission.robots[R0].set_stop(Stop::Confirmed(Rest::InPlace));
    assert_eq!(left_at(&mission, &act, ends + ms(500)), Some(Some(ends + ms(500))), "it has ended");
}

#[test]
fn robot_has_nothing_left_of_ended_or_unsent_scripts() {
    let (mut mission, mut act, _) = sent_act();
    let end = act.timing().unwrap().end;
    assert!(left_at(&mission, &act, end - Span::from_nanos(1)).is_some());
    assert_eq!(left_at(&mission, &act, end), None, "its time is over");
    mission.robots[R0].set_stop(Stop::Confirmed(Rest::InPlace));
    assert!(left_at(&mission, &act, end).is_some(), "nobody knows when it began");
    let failed = urrcp::ControlResponse {
        error: super::bench::refusal(ErrorCode::Cancelled),
        ..super::bench::response(&"a".parse().unwrap(), None, Status::Failed, at(1))
    };
    let _noted = act.answered(
        ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script: 0 },
        &failed,
        at(1),
        &mission.robots,
    );
    assert_eq!(left_at(&mission, &act, at(1)), None);

    let mut mission = begins_with(Everything, &[("a", 0, 400), ("a", 400, 400)]);
    let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    mission.robots[R0].set_stop(Stop::Confirmed(Rest::InPlace));
    let act = &mission.acts[0];
    assert_eq!(
        act.left_behind(&act.members()[MemberIndex::new(0)], 1, &mission.robots[R0], at(1)),
        None,
        "it waits to be sent"
    );
}

#[test]
fn failure_without_id_matches_accepted_script_only_if_robot_reports() {
    for (tells, says, found) in [
        (Tells::Nothing, requests::Says::Answers, [Some(0), None, Some(0), Some(0), None]),
        (Tells::Reports, requests::Says::ByItself, [Some(0), None, Some(0), Some(0), Some(0)]),
    ] {
        let sent = |accepted: bool| {
            let mut mission = begins_at_once(tells);
            let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
            let script = ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script: 0 };
            let said = super::bench::response(&"a".parse().unwrap(), None, Status::Accepted, at(1));
            if accepted {
                let _noted = mission.acts[0].answered(script, &said, at(1), &mission.robots);
            }
            mission
        };
        let asked = [
            (false, Status::Accepted),
            (true, Status::Accepted),
            (true, Status::Ok),
            (false, Status::Failed),
            (true, Status::Failed),
        ];
        for ((accepted, status), expected) in asked.into_iter().zip(found) {
            let mission = sent(accepted);
            let device = "a".parse().unwrap();
            let response = urrcp::ControlResponse {
                error: super::bench::refusal(ErrorCode::Cancelled).filter(|_| status == Status::Failed),
                ..super::bench::response(&device, None, status.clone(), at(2))
            };
            let found = requests::open_without_name(&mission.acts, R0, says, &device, &response);
            assert_eq!(found.map(|found| found.script), expected, "{tells:?}, {accepted}, {status:?}");
            let named = urrcp::ControlResponse { request_id: RequestId::new("n").ok(), ..response.clone() };
            assert_eq!(requests::open_without_name(&mission.acts, R0, says, &device, &named), None);
            let other = "b".parse().unwrap();
            assert_eq!(requests::open_without_name(&mission.acts, R0, says, &other, &response), None);
        }
    }
}

#[test]
fn mission_ends_at_the_act_limit_of_the_operator_or_the_process() {
    let mut mission = begins_at_once(Everything);
    mission.bound_acts(3);
    mission.bound_acts(5);
    assert_eq!((mission.options.acts_max, mission.bound_reached()), (Some(3), None));
    mission.course.bounded = true;
    assert_eq!(mission.bound_reached(), Some(3));
}

#[test]
fn mission_needs_a_participant_for_every_robot_of_its_acts() {
    let participants = vec![Participant::new(RobotId::new("r1").unwrap(), None)];
    let missing = |scripts: &[&[Planned]]| {
        Mission::new(Arc::new(choreography(scripts)), participants.clone(), MissionOptions::default(), at(0))
            .err()
            .map(|missing| missing.robot.to_string())
    };
    assert_eq!(missing(&[&[("a", 0, 400)], &[("a", 0, 400)]]), Some("r0".to_owned()));
    let mut second_alone = choreography(&[&[("a", 0, 400)], &[("a", 0, 400)]]);
    second_alone.acts[0].plan.robots.remove(0);
    let options = MissionOptions::default();
    assert!(Mission::new(Arc::new(second_alone), participants, options, at(0)).is_ok());
}

#[test]
fn greeting_wakes_for_its_next_sample_and_no_later_than_its_deadline() {
    let mut mission = begins_at_once(Everything);
    let deadline = at(0) + mission.options.patience;
    mission.machine.lateness = lateness::Lateness::new(at(3));
    assert_eq!(mission.next_wakeup(), Some(at(3)), "it measures how late it is called");
    mission.machine.lateness = lateness::Lateness::new(deadline + ms(1));
    assert_eq!(mission.next_wakeup(), Some(deadline));
    for (next, wakes) in [(at(20), at(20)), (deadline + ms(1), deadline)] {
        mission.greeting.sampling = Some((at(4_000), next));
        assert_eq!(mission.next_wakeup(), Some(wakes));
    }
    mission.timers.next_name = Some(at(5));
    assert_eq!(mission.next_wakeup(), Some(at(5)));
    mission.phase = Phase::Ended;
    assert_eq!(mission.next_wakeup(), None);
}
