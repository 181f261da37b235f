//! Tests that each invariant can fail: the tests falsify the histories and reports of valid missions.

use downbeat_robot::set_log::MotionKind;
use urrcp::{ControlType, Message, Span};

use super::*;
use crate::braking::Braking;
use crate::draw::{FAMILIES, Hands, RATES, TIMES};
use crate::{Drawn, Fault, Happened, Lie, Names, Network, draw, run};
use downbeat_mission::report::StopState;
use downbeat_mission::{Outcome, Progress, Record, Standing};
use downbeat_rehearsal::dry_run::BEGIN;

/// Finds the first seed whose drawn mission satisfies `like` and whose run satisfies `sound`.
#[track_caller]
fn first(like: impl Fn(&Drawn) -> bool, sound: impl Fn(&Ran) -> bool) -> Ran {
    let found = (0..3_000).filter(|seed| like(&draw(*seed))).map(run).find(|ran| sound(ran));
    let ran = found.expect("there are such missions");
    assert_eq!(ran.verdict().violations, []);
    ran
}

/// Whether a drawn mission has no faults and a single act, which two or more honest robots play.
fn calm(drawn: &Drawn) -> bool {
    let sound = |robot: &crate::DrawnRobot| {
        robot.lie.is_none() && robot.names == Names::Echoed && robot.block.reports && robot.block.inquiry
    };
    drawn.network == Network::Stream
        && drawn.tail == 0.0
        && drawn.faults.is_empty()
        && drawn.disk.capacity.is_none()
        && drawn.choreography.acts.len() == 1
        && drawn.choreography.acts[0].plan.robots.len() > 1
        && drawn.robots.iter().all(sound)
        && drawn.choreography.acts[0].plan.robots.iter().all(|robot| robot.scripts[0].start.get() == 0.0)
}

fn done(ran: &Ran) -> bool {
    ran.report.as_ref().is_some_and(|report| report.outcome == Outcome::Done)
}

fn played() -> Ran {
    first(calm, done)
}

/// Returns the letters of the violated invariants.
fn violated(ran: &Ran) -> String {
    let mut all: Vec<char> = ran.verdict().violations.iter().map(|violation| violation.invariant).collect();
    all.dedup();
    all.into_iter().collect()
}

#[track_caller]
fn finds(invariant: char, wrong: impl Fn(&mut Ran)) {
    let mut ran = played();
    wrong(&mut ran);
    assert!(violated(&ran).contains(invariant), "{:?}", ran.verdict().violations);
}

fn promised(ran: &Ran) -> downbeat_mission::Promise {
    let promise = |(_, record): &(_, Record)| match record {
        Record::Prepared(promise) => Some(promise.clone()),
        _ => None,
    };
    ran.records.iter().find_map(promise).unwrap()
}

/// The index of a robot of the act.
fn member(ran: &Ran) -> usize {
    let robot = &promised(ran).scripts[0].robot;
    ran.drawn.robots.iter().position(|drawn| drawn.block.id == *robot).unwrap()
}

/// Returns the report's entry for the first script of the first robot.
fn said(ran: &mut Ran) -> &mut downbeat_mission::DeviceReport {
    &mut ran.report.as_mut().unwrap().acts[0].robots[0].devices[0]
}

/// Inserts a fault into the history, at `before_start` before the start of the act.
fn hit(ran: &mut Ran, before_start: Span, fault: Fault) {
    let at = promised(ran).start - before_start;
    let place = ran.history.partition_point(|(when, _)| *when <= at);
    ran.history.insert(place, (at, Happened::Fault(fault)));
}

fn crash(robot: usize) -> Fault {
    Fault::RobotCrash { robot, back_after: None, told: true }
}

/// Falsifies a run as if a robot of the act had set no values. Returns the index of the robot.
fn one_misses(ran: &mut Ran) -> usize {
    let robot = member(ran);
    ran.logs[robot].clear();
    robot
}

#[test]
fn partial_start_is_detected_unless_missing_robot_had_a_fault() {
    let with = |before: i64, fault: fn(usize, usize) -> Fault| {
        let mut ran = played();
        let missing = one_misses(&mut ran);
        let other = (0..ran.drawn.robots.len()).find(|robot| *robot != missing).unwrap();
        hit(&mut ran, Span::from_millis(before), fault(missing, other));
        let verdict = ran.verdict();
        let found = verdict.violations.iter().any(|violation| violation.invariant == 'a');
        (found, verdict.excuses.iter().map(|excuse| excuse.cause).collect::<Vec<_>>())
    };
    assert_eq!(with(1, |missing, _| crash(missing)), (false, vec![Cause::RobotCrash]), "its own");
    assert_eq!(with(1, |_, other| crash(other)), (true, vec![]), "that of another robot");
    assert_eq!(with(3_000, |missing, _| crash(missing)), (true, vec![]), "long before the window");
    assert_eq!(with(-3_000, |missing, _| crash(missing)), (true, vec![]), "after its start");
    assert_eq!(with(1, |_, _| Fault::Stop), (true, vec![]), "the word alone stops nobody");
    let pause = |_, _| Fault::SchedulerPause { lasts: Span::from_millis(5) };
    assert_eq!(with(1, pause), (true, vec![]), "after all had answered the commitment");
    assert_eq!(with(3_000, pause), (true, vec![]), "before the commitment");
}

#[test]
fn scheduler_stall_is_an_excuse_only_until_all_robots_answer_commitment() {
    let with = |after: &dyn Fn(&Ran) -> Option<Timestamp<Server>>| {
        let mut ran = played();
        let _missing = one_misses(&mut ran);
        let before_start = promised(&ran).start - after(&ran).unwrap() - Span::from_millis(1);
        hit(&mut ran, before_start, Fault::SchedulerPause { lasts: Span::from_millis(5) });
        violated(&ran).contains('a')
    };
    let written = |(at, record): &(_, Record)| matches!(record, Record::Committed { .. }).then_some(*at);
    assert!(!with(&|ran| ran.records.iter().find_map(written)));
    let answered = |(at, happened): &(_, Happened)| match happened {
        Happened::Told(told) => matches!(**told, Progress::Committed { window: Some(_), .. }).then_some(*at),
        _ => None,
    };
    assert!(with(&|ran| ran.history.iter().find_map(answered)));
}

#[test]
fn process_end_known_before_point_of_no_return_is_no_excuse() {
    let no_return = |ran: &Ran| {
        ran.history.iter().find_map(|(_, happened)| match happened {
            Happened::Told(told) => match **told {
                Progress::Decided { no_return, doubt, .. } => Some((no_return, doubt)),
                _ => None,
            },
            _ => None,
        })
    };
    // The start of the act minus the latest instant at which the end of a process becomes known in time.
    let known = |ran: &Ran| {
        let slow = ran.drawn.robots[member(ran)].slow;
        let (no_return, doubt) = no_return(ran)?;
        let known = promised(ran).start - no_return + (ran.drawn.delay.1 * 2 + slow) * 3;
        (known + Span::from_millis(1) < doubt).then_some(known)
    };
    for (earlier, is_told, found) in [(1, true, true), (-1, true, false), (1, false, false)] {
        let mut ran = first(calm, |ran| done(ran) && known(ran).is_some());
        let before_start = known(&ran).unwrap() + Span::from_millis(earlier);
        let robot = one_misses(&mut ran);
        hit(&mut ran, before_start, Fault::RobotCrash { robot, back_after: None, told: is_told });
        assert_eq!(violated(&ran).contains('a'), found, "{earlier}, {is_told}");
    }
}

/// Whether a robot that accepts no inquiries is excused for starting an act alone. The last message to it was sent `sent_late`
/// milliseconds after the instant one lease before the start. It arrived 120 ms later. The delay is attributed to the link of the robot
/// that `slow` selects.
fn is_carried_over(sent_late: i64, slow: impl Fn(usize, usize) -> usize, stands_still: bool) -> bool {
    let as_with_inquiries = |drawn: &Drawn| {
        let mut drawn = drawn.clone();
        drawn.robots.iter_mut().for_each(|robot| robot.block.inquiry = true);
        calm(&drawn)
    };
    let takes_none = |ran: &Ran| done(ran) && !ran.drawn.robots[member(ran)].block.inquiry;
    let mut ran = first(as_with_inquiries, takes_none);
    let (promise, robot) = (promised(&ran), member(&ran));
    let other = (0..ran.drawn.robots.len()).find(|other| *other != robot).unwrap();
    ran.logs.iter_mut().enumerate().filter(|(of, _)| *of != robot).for_each(|(_, log)| log.clear());
    ran.records.retain(|(_, record)| !matches!(record, Record::Committed { .. }));
    let sent = promise.start - promise.lease + Span::from_millis(sent_late);
    let alone = promise.start - promise.lease - Span::from_millis(150);
    let told = |(at, happened): &(_, Happened)| {
        matches!(happened, Happened::AtRobot(..)) && *at >= alone && *at <= promise.start
    };
    ran.history.retain(|happened| !told(happened));
    let mut add = |at, happened| {
        let place = ran.history.partition_point(|(when, _)| *when <= at);
        ran.history.insert(place, (at, happened));
    };
    let question = urrcp::AvailabilityRequest {
        timestamp: Some(sent),
        session: None,
        seize: false,
        revocation_list: None,
    };
    let takes = Span::from_millis(120);
    add(sent, Happened::Slow(slow(robot, other), takes));
    add(sent + takes, Happened::AtRobot(robot, Message::AvailabilityRequest(question)));
    if stands_still {
        let lasts = promise.lease + Span::from_millis(200);
        add(alone, Happened::Fault(Fault::SchedulerPause { lasts }));
    }
    let verdict = ran.verdict();
    let found = verdict.violations.iter().any(|violation| violation.invariant == 'a');
    let causes: Vec<_> =
        verdict.excuses.iter().filter(|excuse| excuse.invariant == 'a').map(|excuse| excuse.cause).collect();
    assert_eq!(causes, if found { vec![] } else { vec![Cause::Slow] }, "{:?}", verdict.violations);
    !found
}

#[test]
fn late_request_excuses_robot_only_with_slow_link_and_stalled_scheduler() {
    assert!(is_carried_over(-100, |robot, _| robot, true));
    assert!(!is_carried_over(-100, |_, other| other, true), "the link of another robot");
    assert!(!is_carried_over(-100, |robot, _| robot, false), "the scheduler could take it back");
    assert!(!is_carried_over(1, |robot, _| robot, true), "it was sent too late");
}

/// Whether a robot that accepts no inquiries is excused for beginning a script without the preceding one. The script arrived after a
/// silence that `questions` messages interrupted. The delay is attributed to the link of the robot that `slow` selects.
fn outlives_the_first(questions: i64, slow: impl Fn(usize, usize) -> usize, stands_still: bool) -> bool {
    let undisturbed = |drawn: &Drawn| {
        let sound = |robot: &crate::DrawnRobot| robot.lie.is_none() && robot.names == Names::Echoed;
        drawn.network == Network::Stream
            && drawn.tail == 0.0
            && drawn.faults.is_empty()
            && drawn.choreography.acts.len() == 1
            && drawn.choreography.acts[0].plan.robots.len() > 1
            && drawn.robots.iter().all(sound)
    };
    let follower = |ran: &Ran| {
        let scripts = promised(ran).scripts;
        let robot = |id: &urrcp::RobotId| ran.drawn.robots.iter().position(|drawn| drawn.block.id == *id);
        let pair = |two: &[downbeat_mission::PromisedScript]| {
            let robot = robot(&two[0].robot).filter(|robot| !ran.drawn.robots[*robot].block.inquiry)?;
            let follows = (&two[0].robot, &two[0].device) == (&two[1].robot, &two[1].device);
            follows.then(|| (robot, two[0].request_id.clone(), two[1].request_id.clone()))
        };
        scripts.windows(2).find_map(pair)
    };
    let mut ran = first(undisturbed, |ran| done(ran) && follower(ran).is_some());
    let (promise, (robot, before, follows)) = (promised(&ran), follower(&ran).unwrap());
    let other = (0..ran.drawn.robots.len()).find(|other| *other != robot).unwrap();
    ran.logs.iter_mut().enumerate().filter(|(of, _)| *of != robot).for_each(|(_, log)| log.clear());
    ran.logs[robot].retain(|entry| entry.request_id.as_deref() == Some(follows.as_str()));
    ran.records.retain(|(_, record)| !matches!(record, Record::Committed { .. }));
    let is_script = |happened: &Happened, of: &urrcp::RequestId| match happened {
        Happened::AtRobot(r, Message::ControlRequest(request)) => {
            *r == robot && request.request_id.as_ref() == Some(of)
        }
        _ => false,
    };
    let script = ran.history.iter().find(|(_, happened)| is_script(happened, &follows)).unwrap().1.clone();
    let sent = ran.history.iter().find(|(_, happened)| is_script(happened, &before)).unwrap().0;
    ran.history.retain(|(_, happened)| {
        !matches!(happened, Happened::AtRobot(r, _) if *r == robot) || is_script(happened, &before)
    });
    let takes = promise.lease + Span::from_millis(20);
    let mut add = |at, happened| {
        let place = ran.history.partition_point(|(when, _)| *when <= at);
        ran.history.insert(place, (at, happened));
    };
    let question =
        urrcp::AvailabilityRequest { timestamp: None, session: None, seize: false, revocation_list: None };
    for number in 1..=questions {
        let question = Message::AvailabilityRequest(question.clone());
        add(sent + takes / (questions + 1) * number, Happened::AtRobot(robot, question));
    }
    add(sent, Happened::Slow(slow(robot, other), takes));
    add(sent + takes, script);
    if stands_still {
        add(sent, Happened::Fault(Fault::SchedulerPause { lasts: Span::from_millis(5_000) }));
    }
    let verdict = ran.verdict();
    let found = verdict.violations.iter().any(|violation| violation.invariant == 'a');
    let causes: Vec<_> =
        verdict.excuses.iter().filter(|excuse| excuse.invariant == 'a').map(|excuse| excuse.cause).collect();
    assert_eq!(causes, if found { vec![] } else { vec![Cause::Slow] }, "{:?}", verdict.violations);
    !found
}

#[test]
fn late_script_excuses_start_without_predecessor_only_if_that_was_dropped() {
    assert!(outlives_the_first(0, |robot, _| robot, true));
    assert!(!outlives_the_first(0, |_, other| other, true), "the link of another robot");
    assert!(!outlives_the_first(0, |robot, _| robot, false), "the scheduler could take it back");
    assert!(!outlives_the_first(2, |robot, _| robot, true), "the lease of the other one had not ended");
}

#[test]
fn commitment_recorded_after_the_start_is_detected() {
    finds('a', |ran| {
        let after = promised(ran).start + Span::from_nanos(1);
        let commitment = |record: &Record| matches!(record, Record::Committed { .. });
        ran.records.iter_mut().filter(|(_, record)| commitment(record)).for_each(|(at, _)| *at = after);
    });
}

/// Returns a run in which a robot of the act misses its start shortly after a brief interruption of its link.
fn missing_behind_a_link() -> (Ran, usize) {
    let mut ran = played();
    let missing = one_misses(&mut ran);
    let fault = Fault::Partition { robot: missing, lasts: Span::from_millis(5), breaks: false };
    hit(&mut ran, Span::from_millis(1), fault);
    (ran, missing)
}

#[test]
fn link_fault_does_not_excuse_robot_that_received_commitment_in_time() {
    let (mut ran, missing) = missing_behind_a_link();
    assert!(violated(&ran).contains('a'));
    // Removes the commitment, as if it had not arrived.
    ran.history.retain(|(_, happened)| match happened {
        Happened::AtRobot(robot, Message::Inquiry(inquiry)) => {
            *robot != missing || inquiry.pending_lease.is_some()
        }
        _ => true,
    });
    assert!(!violated(&ran).contains('a'), "{:?}", ran.verdict().violations);
}

#[test]
fn link_fault_excuses_robot_if_a_lease_expired_before_commitment_arrived() {
    let (mut ran, missing) = missing_behind_a_link();
    let shortened = |(at, happened): &(_, Happened)| match happened {
        Happened::AtRobot(robot, Message::Inquiry(inquiry))
            if *robot == missing && inquiry.pending_lease.is_some() =>
        {
            inquiry.pending_until.map(|until| (*at, until, inquiry.clone()))
        }
        _ => None,
    };
    let (at, until, inquiry) = ran.history.iter().find_map(shortened).unwrap();
    // Another device of the robot begins at another instant.
    let requests = urrcp::RequestId::new("another".to_owned()).into_iter().collect();
    let pending_until = Some(until - promised(&ran).lease);
    let message = Message::Inquiry(urrcp::Inquiry { requests, pending_until, ..inquiry });
    let place = ran.history.partition_point(|(when, _)| *when <= at);
    ran.history.insert(place, (at, Happened::AtRobot(missing, message)));
    assert!(!violated(&ran).contains('a'), "{:?}", ran.verdict().violations);
}

#[test]
fn robot_dropped_after_its_start_is_reported_as_having_missed_it() {
    for (after_start, found) in [(10, true), (-10, false)] {
        let mut ran = played();
        let missing = one_misses(&mut ran);
        let at = promised(&ran).start + Span::from_millis(after_start);
        let robot = ran.drawn.robots[missing].block.id.clone();
        ran.records.push((at, Record::Dropped { robot }));
        assert_eq!(violated(&ran).contains('a'), found, "{after_start}");
    }
}

#[test]
fn repeated_step_and_late_start_are_detected() {
    finds('b', |ran| {
        let robot = member(ran);
        let again = ran.logs[robot].iter().find(|entry| entry.is_set()).unwrap().clone();
        ran.logs[robot].push(again);
    });
    finds('b', |ran| {
        let robot = member(ran);
        let entry = ran.logs[robot].iter_mut().find(|entry| entry.step == Some(0)).unwrap();
        entry.set_at = entry.due + Span::from_millis(60);
    });
}

#[test]
fn movement_without_a_reason_is_detected() {
    let stop_moves = |motion: MotionKind| {
        move |ran: &mut Ran| {
            let robot = member(ran);
            let mut stopped = ran.logs[robot].iter().rfind(|entry| entry.is_set()).unwrap().clone();
            (stopped.motion, stopped.step, stopped.request_id) = (motion, None, None);
            stopped.value += 1.0;
            stopped.due = stopped.due + Span::from_millis(1);
            ran.logs[robot].push(stopped);
        }
    };
    for motion in [MotionKind::Default, MotionKind::Rest, MotionKind::Slow] {
        finds('m', stop_moves(motion));
    }
    finds('m', |ran| {
        let robot = member(ran);
        ran.logs[robot].iter_mut().find(|entry| entry.is_set()).unwrap().value += 1.0;
    });
    finds('m', |ran| {
        let robot = member(ran);
        ran.logs[robot].iter_mut().find(|entry| entry.is_set()).unwrap().request_id = None;
    });
}

/// Returns a run in which a robot refuses a request once, so that it executes the script under another request id. `tells` states whether
/// the robot reports outcomes.
fn moves_under_another_name(tells: bool) -> (Ran, usize) {
    let mut ran = played();
    let robot = member(&ran);
    let block = &mut ran.drawn.robots[robot].block;
    (block.reports, block.inquiry) = (tells, false);
    let promise = promised(&ran);
    let name = promise.scripts[0].request_id.as_str();
    let entries = ran.logs[robot].iter_mut().filter(|entry| entry.request_id.as_deref() == Some(name));
    entries.for_each(|entry| entry.request_id = Some(format!("{name}+1")));
    (ran, robot)
}

#[test]
fn only_a_robot_without_reports_may_move_under_another_request_id() {
    assert!(violated(&moves_under_another_name(true).0).contains('m'));
    let (mut ran, robot) = moves_under_another_name(false);
    let found = violated(&ran);
    assert!(!found.contains('m') && !found.contains('b'), "{found}");
    let mut again = ran.logs[robot].iter().find(|entry| entry.is_set()).unwrap().clone();
    again.request_id = again.request_id.map(|name| downbeat_mission::promised_name(&name).to_owned());
    ran.logs[robot].push(again);
    assert!(violated(&ran).contains('b'), "one script under two names");
}

#[test]
fn movement_after_a_stop_or_beyond_the_shorter_lease_is_detected() {
    finds('c', |ran| {
        let robot = ran.drawn.robots[member(ran)].block.id.clone();
        let at = promised(ran).start;
        ran.records.push((at, Record::StopConfirmed { robot }));
    });
    let leased = |drawn: &Drawn| {
        calm(drawn)
            && drawn.choreography.acts[0]
                .plan
                .stop_condition
                .running
                .is_some_and(|lease| lease.get() > 1_000.0)
    };
    let mut ran = first(leased, done);
    let robot = member(&ran);
    let promise = promised(&ran);
    // Nothing arrives for longer than the pending lease, but not for as long as the running lease.
    let silent_from = promise.start - promise.lease - Span::from_millis(20);
    ran.history.retain(
        |(at, happened)| !matches!(happened, Happened::AtRobot(r, _) if *r == robot && *at >= silent_from),
    );
    assert!(violated(&ran).contains('c'), "{:?}", ran.verdict().violations);
}

#[test]
fn value_outside_the_limits_is_detected() {
    for value in [91.0, -0.5, f64::NAN] {
        finds('d', |ran| {
            let robot = member(ran);
            ran.logs[robot].iter_mut().find(|entry| entry.control_type == "position").unwrap().value = value;
        });
    }
}

#[test]
fn mission_that_hangs_or_has_no_report_is_detected() {
    finds('e', |ran| ran.report = None);
    finds('h', |ran| ran.hung = true);
}

#[test]
fn start_two_ms_over_budget_is_excused_only_by_the_robots_own_clock() {
    let late = |fault: Option<fn(usize, usize) -> Fault>| {
        let mut ran = played();
        let robot = member(&ran);
        let other = (0..ran.drawn.robots.len()).find(|other| *other != robot).unwrap();
        let skew = ran.report.as_ref().unwrap().acts[0].skew.clone().unwrap();
        let name = ran.drawn.robots[robot].block.id.clone();
        let told = skew.robots.iter().find(|told| told.robot == name).unwrap();
        let latest = told.uncertainty + told.wake_up - told.offset;
        let at = promised(&ran).start + latest + Span::from_millis(2);
        for entry in ran.logs[robot].iter_mut().filter(|entry| entry.step == Some(0) && entry.is_set()) {
            entry.true_ns = at.as_nanos();
        }
        fault.into_iter().for_each(|fault| hit(&mut ran, Span::from_millis(5), fault(robot, other)));
        violated(&ran).contains('f')
    };
    assert!(late(None));
    assert!(!late(Some(|robot, _| Fault::ClockStep { robot, by: Span::from_millis(-2) })));
    assert!(late(Some(|_, other| Fault::ClockStep { robot: other, by: Span::from_millis(-2) })));
    assert!(late(Some(|robot, _| crash(robot))), "a process that ended starts nothing late");
}

#[test]
fn report_with_one_step_too_many_or_too_few_is_detected() {
    finds('g', |ran| said(ran).steps_done += 1);
    finds('g', |ran| said(ran).steps_done -= 1);
    finds('g', |ran| ran.report.as_mut().unwrap().robots[0].steps_done += 1);
    finds('g', |ran| ran.report.as_mut().unwrap().robots[0].scripts += 1);
    finds('g', |ran| ran.report.as_mut().unwrap().robots[0].started += 1);
    finds('g', |ran| said(ran).steps_planned += 1);
    finds('g', |ran| said(ran).late_steps += 1);
    finds('g', |ran| said(ran).state = downbeat_mission::DeviceState::Planned);
    finds('g', |ran| {
        let robot = member(ran);
        ran.logs[robot].pop();
    });
}

#[test]
fn report_with_wrong_start_window_lead_or_doubt_is_detected() {
    let grain = Span::from_micros(2);
    finds('g', |ran| {
        let said = said(ran);
        said.started_at = said.started_at.map(|at| at + Span::from_micros(2));
    });
    finds('g', |ran| {
        let said = said(ran);
        said.start_error = said.start_error.map(|error| error + Span::from_micros(2));
    });
    finds('g', |ran| ran.report.as_mut().unwrap().acts[0].lead.margin += grain);
    finds('g', |ran| ran.report.as_mut().unwrap().acts[0].doubt += grain);
    finds('g', |ran| ran.report.as_mut().unwrap().acts[0].start = promised(ran).start + grain);
    finds('g', |ran| ran.report.as_mut().unwrap().acts[0].spread = Some(Span::from_millis(99)));
    finds('g', |ran| {
        let act = &mut ran.report.as_mut().unwrap().acts[0];
        act.window = act.window.map(|window| window + Span::from_micros(2));
    });
    finds('g', |ran| ran.report.as_mut().unwrap().acts[0].skew = None);
}

#[test]
fn incorrect_outcome_or_fate_in_report_is_detected() {
    finds('g', |ran| ran.report.as_mut().unwrap().outcome = Outcome::NotStarted);
    finds('g', |ran| ran.report.as_mut().unwrap().outcome = Outcome::DoneWithout);
    finds('g', |ran| ran.report.as_mut().unwrap().course[0].fate = downbeat_mission::ActFate::Withdrawn);
    finds('g', |ran| ran.report.as_mut().unwrap().course[0].fate = downbeat_mission::ActFate::NotReached);
    finds('g', |ran| ran.report.as_mut().unwrap().robots[0].stop = StopState::Confirmed);
    finds('g', |ran| ran.report.as_mut().unwrap().robots[0].standing = Standing::Out);
    finds('g', |ran| ran.report.as_mut().unwrap().acts[0].robots[0].left_out = true);
}

#[test]
fn robot_blamed_or_left_out_without_a_reason_is_detected() {
    let blame = |ran: &mut Ran| {
        let robot = ran.drawn.robots[member(ran)].block.id.clone();
        let kind = downbeat_mission::FailureKind::LinkDown { reason: "connection reset".to_owned() };
        ran.report.as_mut().unwrap().failures.push(downbeat_mission::Failure { robot, kind });
    };
    finds('g', blame);
    finds('g', |ran| {
        let robot = ran.drawn.robots[member(ran)].block.id.clone();
        ran.records.push((promised(ran).start, Record::Dropped { robot }));
    });
}

/// Returns a run in which the scheduler receives no message from any playing robot for longer than the lease, and the operator is not
/// informed.
fn silent() -> Ran {
    let long = |drawn: &Drawn| {
        let plan = &drawn.choreography.acts[0].plan;
        let lease = plan.stop_condition.running.map(urrcp::Millis::span);
        calm(drawn) && lease.is_some_and(|lease| plan.duration() > lease + Span::from_millis(300))
    };
    let mut ran = first(long, done);
    let start = promised(&ran).start;
    ran.history.retain(|(at, happened)| !matches!(happened, Happened::FromRobot(..) if *at >= start));
    ran
}

#[test]
fn unreported_silence_is_detected() {
    let ran = silent();
    assert!(violated(&ran).contains('h'), "{:?}", ran.verdict().violations);
}

#[test]
fn message_delayed_as_long_as_the_silence_does_not_excuse_it() {
    let mut ran = silent();
    let (start, robot) = (promised(&ran).start, member(&ran));
    let lasts = ran.drawn.choreography.acts[0].plan.duration();
    let before = |hit: Span| start - hit - Span::from_millis(1);
    let place = ran.history.partition_point(|(at, _)| *at <= start);
    ran.history.insert(place, (start, Happened::Slow(robot, lasts)));
    assert!(violated(&ran).contains('h'), "a partition: {:?}", ran.verdict().violations);
    ran.history.remove(place);
    let place = ran.history.partition_point(|(at, _)| *at <= before(lasts));
    for robot in 0..ran.drawn.robots.len() {
        ran.history.insert(place, (before(lasts), Happened::Slow(robot, lasts)));
    }
    assert!(!violated(&ran).contains('h'), "what its link is like: {:?}", ran.verdict().violations);
}

#[test]
fn ignored_or_undelivered_stop_is_detected() {
    let stopped = |drawn: &Drawn| {
        let by_the_operator = matches!(drawn.faults.as_slice(), [(_, Fault::Stop)]);
        by_the_operator && calm(&Drawn { faults: Vec::new(), ..drawn.clone() })
    };
    let confirmed =
        |ran: &Ran| ran.report.as_ref().is_some_and(|report| report.robots[0].stop == StopState::Confirmed);
    let ran = || first(stopped, confirmed);
    let mut deaf = ran();
    deaf.records.retain(|(_, record)| !matches!(record, Record::Stopping { .. } | Record::Ended { .. }));
    assert!(violated(&deaf).contains('h'), "{:?}", deaf.verdict().violations);
    let mut lost = ran();
    let stopping = lost.records.iter().find_map(|(at, record)| match record {
        Record::Stopping { .. } => Some(*at),
        _ => None,
    });
    let stopping = stopping.unwrap();
    lost.history.retain(|(at, happened)| !matches!(happened, Happened::AtRobot(..) if *at >= stopping));
    assert!(violated(&lost).contains('h'), "{:?}", lost.verdict().violations);
    let mut endless = ran();
    endless.records.retain(|(_, record)| matches!(record, Record::Prepared(_) | Record::Stopping { .. }));
    assert!(violated(&endless).contains('h'), "{:?}", endless.verdict().violations);
}

#[test]
fn lead_or_gap_far_beyond_same_mission_without_faults_is_detected() {
    let ran = played();
    let mut slow = played();
    assert_eq!(slow.compared_with(&ran).violations, []);
    for (_, record) in &mut slow.records {
        if let Record::Prepared(promise) = record {
            promise.start = promise.start + Span::from_millis(10_000);
        }
    }
    let found = slow.compared_with(&ran).violations;
    assert!(found.iter().all(|violation| violation.invariant == 'h') && found.len() == 1, "{found:?}");
}

/// Whether the check reports a jump of a device that a stop had left at `position`. Between the stop and the jump, the mission sends the
/// robots home if `home`, and plans an approach if `approaches`.
fn jumps_after_a_stop_at(position: f64, home: bool, approaches: bool) -> bool {
    let states = |drawn: &Drawn| {
        let at_home = |device: &urrcp::Device| device.default_value.is_some();
        let own = |robot: &crate::DrawnRobot| {
            matches!(robot.hands, Hands::Own) && robot.block.devices.iter().take(1).all(at_home)
        };
        calm(drawn) && drawn.robots.iter().all(own)
    };
    let mut ran = first(states, done);
    let (promise, robot) = (promised(&ran), member(&ran));
    let at = promise.timestamp - Span::from_millis(1);
    let log = &mut ran.logs[robot];
    let mut stop = log[0].clone();
    (stop.motion, stop.value, stop.true_ns) = (MotionKind::Rest, position, at.as_nanos());
    (stop.step, stop.request_id) = (None, None);
    log[0].value = 60.0;
    log.insert(0, stop);
    let place = ran.history.partition_point(|(when, _)| *when <= at);
    let choreography = std::sync::Arc::new(ran.drawn.choreography.clone());
    let approaching = Progress::Approaching { act: String::new(), to: String::new(), choreography };
    let told = home.then_some(Progress::AtHome).into_iter().chain(approaches.then_some(approaching));
    ran.history.splice(place..place, told.map(|told| (at, Happened::Told(Box::new(told)))));
    ran.verdict().violations.iter().any(|violation| violation.what.contains("where a stop had left it"))
}

#[test]
fn jump_after_a_stop_is_detected_unless_it_begins_at_home() {
    assert!(jumps_after_a_stop_at(0.0, false, false));
    assert!(!jumps_after_a_stop_at(0.0, true, false));
    assert!(!jumps_after_a_stop_at(0.4, true, false), "the nearest position");
    assert!(jumps_after_a_stop_at(0.6, true, false));
    assert!(jumps_after_a_stop_at(0.0, true, true), "it stayed on the approach");
}

/// Returns the number of violations in a mission whose lead exceeds the permitted lead by `by` milliseconds.
fn with_a_lead_beyond(by: i64, wrong: impl Fn(&mut Ran, &downbeat_mission::Promise)) -> usize {
    let ran = played();
    let mut slow = played();
    for (_, record) in &mut slow.records {
        if let Record::Prepared(promise) = record {
            let allowed = (promise.start - promise.timestamp) * 3 + Span::from_millis(500);
            promise.start = promise.timestamp + allowed + Span::from_millis(by);
        }
    }
    let promise = promised(&slow);
    wrong(&mut slow, &promise);
    slow.compared_with(&ran).violations.len()
}

#[test]
fn long_lead_of_timed_act_is_accepted_if_sent_only_slightly_ahead() {
    let at_its_time = |by, late| {
        with_a_lead_beyond(by, |ran, promise| {
            let at = promise.start - Span::from_nanos(late);
            ran.drawn.choreography.acts[0].wait = downbeat_plan::Wait::Instant(at);
        })
    };
    assert_eq!(with_a_lead_beyond(1_000, |_, _| {}), 1);
    assert_eq!(at_its_time(1_000, 0), 0);
    assert_eq!(at_its_time(1_000, 1), 1, "it is late");
    assert_eq!(at_its_time(5_000, 0), 1, "it is sent far too early");
}

#[test]
fn queued_messages_are_several_delays_if_two_of_them_do_not_overlap() {
    let queues_for = |lasts: i64| {
        with_a_lead_beyond(1_000, |ran, promise| {
            let robot = member(ran);
            let begins = promise.timestamp - Span::from_millis(1_000);
            let slow =
                |k| (begins + Span::from_millis(10) * k, Happened::Slow(robot, Span::from_millis(200)));
            ran.history.splice(0..0, (0..lasts / 10).map(slow));
        })
    };
    assert_eq!(queues_for(190), 1, "all of them are one moment");
    assert_eq!(queues_for(220), 0);
}

#[test]
fn lying_robot_is_checked_only_against_its_limits() {
    let mut ran = played();
    let robot = member(&ran);
    ran.drawn.robots[robot].lie = Some(Lie::NeverMoves);
    ran.logs[robot].clear();
    assert!(!violated(&ran).contains('a'), "{:?}", ran.verdict().violations);
}

/// Finds the first run with speed-driven devices or limited accelerations for which `occurs` returns true.
#[track_caller]
fn with_rates(occurs: impl Fn(&Ran, &Verdict) -> bool) -> Ran {
    let such = (RATES..20_000).step_by(FAMILIES as usize).map(run).find(|ran| {
        let verdict = ran.verdict();
        verdict.violations.is_empty() && occurs(ran, &verdict)
    });
    such.expect("there are such missions")
}

#[test]
fn braking_that_is_too_hard_reverses_or_starts_elsewhere_is_detected() {
    let lasts = |braking: &&mut Braking| braking.lasts > Span::from_millis(20);
    for control_type in [ControlType::Position, ControlType::Speed] {
        let of_type = move |braking: &&mut Braking| braking.control_type == control_type && lasts(braking);
        let found = |wrong: &dyn Fn(&mut Braking)| {
            let such = |ran: &Ran| {
                let brakes =
                    |brakings: &Vec<Braking>| brakings.clone().iter_mut().any(|braking| of_type(&braking));
                (0..ran.brakings.len()).find(|robot| {
                    let drawn = &ran.drawn.robots[*robot];
                    drawn.lie.is_none() && drawn.hands == Hands::Own && brakes(&ran.brakings[*robot])
                })
            };
            let mut ran = with_rates(|ran, _| such(ran).is_some());
            let robot = such(&ran).unwrap();
            wrong(ran.brakings[robot].iter_mut().find(of_type).unwrap());
            violated(&ran)
        };
        assert!(
            found(&|braking| braking.lasts = braking.lasts / 3).contains('m'),
            "{control_type}: too hard"
        );
        assert!(found(&|braking| braking.values.reverse()).contains('m'), "{control_type}: turns back");
        let elsewhere = |braking: &mut Braking| braking.values.iter_mut().for_each(|value| *value += 1.0);
        assert!(found(&elsewhere).contains('m'), "{control_type}: begins elsewhere");
    }
}

#[test]
fn instant_stop_of_device_with_declared_acceleration_is_detected() {
    let slows = |ran: &Ran| {
        let of_speed = |braking: &&Braking| braking.control_type == ControlType::Speed;
        let first = |brakings: &Vec<Braking>| brakings.iter().position(|braking| of_speed(&braking));
        let honest = |robot: usize| ran.drawn.robots[robot].lie.is_none();
        let brakings = ran.brakings.iter().enumerate().filter(|(robot, _)| honest(*robot));
        brakings.into_iter().find_map(|(robot, brakings)| Some((robot, first(brakings)?)))
    };
    let mut ran = with_rates(|ran, _| slows(ran).is_some());
    let (robot, index) = slows(&ran).unwrap();
    let braking = ran.brakings[robot].remove(index);
    ran.logs[robot].iter_mut().find(|entry| braking.is_of(entry)).unwrap().motion = MotionKind::Rest;
    assert!(violated(&ran).contains('m'));
}

#[test]
fn device_turning_beyond_its_lease_is_detected() {
    let mut ran = with_rates(|_, verdict| verdict.situations.contains(&Situation::LeaseEndsTurning));
    let rests = |entry: &downbeat_robot::set_log::LogEntry| {
        entry.control_type == "speed" && entry.request_id.is_none()
    };
    ran.logs.iter_mut().for_each(|log| log.retain(|entry| !rests(entry)));
    assert!(violated(&ran).contains('c'));
}

#[test]
fn seized_robot_that_keeps_playing_is_detected() {
    finds('c', |ran| {
        let robot = member(ran);
        let first = ran.logs[robot].iter().find(|entry| entry.is_set()).unwrap().true_ns;
        let at = Timestamp::from_nanos(first - 1);
        let place = ran.history.partition_point(|(when, _)| *when <= at);
        ran.history.insert(place, (at, Happened::Seized(robot)));
    });
}

#[test]
fn report_that_omits_the_takeover_of_a_robot_is_detected() {
    let long = |drawn: &Drawn| {
        let plan = &drawn.choreography.acts[0].plan;
        calm(drawn) && plan.robots.iter().all(|robot| robot.scripts[0].script.steps().len() > 1)
    };
    let ran = first(long, done);
    let robot = member(&ran);
    let begins = ran.logs[robot].iter().find(|entry| entry.is_set()).unwrap().true_ns;
    let at = Timestamp::from_nanos(begins) - BEGIN + Span::from_millis(1);
    let fault = Fault::Seize { robot, lasts: Span::from_millis(2_000) };
    let mut ran = crate::play(Drawn { faults: vec![(at, fault)], ..ran.drawn });
    assert_eq!(ran.verdict().violations, []);
    ran.report.as_mut().unwrap().failures.clear();
    let found = |violation: &Violation| violation.what.contains("was taken over by");
    assert!(ran.verdict().violations.iter().any(found));
}

#[test]
fn act_waiting_for_wrong_time_of_day_is_detected() {
    let moved = |seed, by: i64| {
        let mut ran = run(seed);
        let mut waits = false;
        for (_, happened) in &mut ran.history {
            if let Happened::Told(told) = happened
                && let Progress::Waiting { at: Some(at), .. } = &mut **told
            {
                (*at, waits) = (*at + Span::from_millis(by), true);
            }
        }
        let found = |violation: &Violation| violation.what.contains("the clocks first show");
        waits.then(|| ran.verdict().violations.iter().any(found))
    };
    let mut seeds = (TIMES..5_000).step_by(FAMILIES as usize);
    let seed = seeds.find(|seed| moved(*seed, 0).is_some()).unwrap();
    assert_eq!([0, 1, 3_600_000].map(|by| moved(seed, by)), [Some(false), Some(true), Some(true)]);
}
