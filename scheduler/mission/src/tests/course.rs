//! The order of acts, their fates, and the resulting end of the mission.

use downbeat_plan::{Choreography, OnFailure};

use super::played::Played;
use super::*;
use crate::FixedStart;
use crate::bench::ms;

pub(super) fn broken() -> FailureKind {
    FailureKind::Garbled { reason: "x".to_owned() }
}

pub(super) fn fates(played: &Played) -> Vec<ActFate> {
    played.mission.course.fates.iter().map(|course| course.fate.clone()).collect()
}

fn stop(played: &mut Played) -> Outcome {
    played.happens(Event::StopRequested { rest: Rest::InPlace, by: None });
    played.run_to_the_end()
}

#[test]
fn act_is_withdrawn_before_start_stopped_after_it_and_played_once_over() {
    let mut played = Played::begun(begins_at_once(Everything));
    assert_eq!(stop(&mut played), Outcome::Stopped);
    assert_eq!(fates(&played), [ActFate::Withdrawn]);

    let mut played = Played::begun(one_act(Everything, 10_000));
    played.run_to_the_start();
    assert_eq!(stop(&mut played), Outcome::Stopped);
    assert_eq!(fates(&played), [ActFate::Stopped]);

    let mut played = Played::begun(waits_in(1));
    played.run_until(played.now + ms(3_000));
    assert_eq!(stop(&mut played), Outcome::Stopped);
    assert_eq!(fates(&played), [ActFate::Played, ActFate::StillWaiting]);

    let mut played = Played::begun(begins_at_once(Tells::Nothing));
    assert_eq!(played.run_to_the_end(), Outcome::Unknown);
    assert_eq!(fates(&played), [ActFate::Unknown]);
}

#[test]
fn failed_mission_counts_as_not_started_if_nothing_has_moved() {
    let fail = |played: &mut Played| {
        let now = played.now;
        played.mission.fail(now, R0, broken());
        played.run_to_the_end()
    };
    let mut played = Played::begun(begins_at_once(Everything));
    assert_eq!(fail(&mut played), Outcome::NotStarted);
    let mut played = Played::begun(one_act(Everything, 10_000));
    played.run_to_the_start();
    assert_eq!(fail(&mut played), Outcome::Failed, "it plays");
    let mut played = Played::begun(waits_in(1));
    played.run_until(played.now + ms(3_000));
    assert_eq!(played.mission.course.reports.len(), 1);
    assert_eq!(fail(&mut played), Outcome::Failed, "an act was played");
}

#[test]
fn mission_has_started_if_an_act_was_played_even_if_the_next_cannot_start() {
    let late = Outcome::DecisionLate { by: ms(3) };
    let short = Outcome::LeaseTooShort { lease: ms(1), needed: ms(2) };
    for denial in [late, short] {
        let mut played = Played::begun(waits_in(1));
        played.run_until(played.now + ms(3_000));
        let now = played.now;
        played.mission.abort(now, denial.clone(), Rest::InPlace, None);
        assert_eq!(played.run_to_the_end(), Outcome::Failed, "{denial}");
        assert!(played.mission.because().is_some(), "{denial}");
    }
}

#[test]
fn acts_follow_each_other_up_to_the_requested_number() {
    for (acts_max, begun, bound) in [(None, 2, None), (Some(2), 2, None), (Some(1), 1, Some(1))] {
        let mut mission = waits_in(2);
        mission.options.acts_max = acts_max;
        let mut played = Played::begun(mission);
        assert_eq!(played.run_to_the_end(), Outcome::Done, "{acts_max:?}");
        assert_eq!(played.mission.course.begun, begun, "{acts_max:?}");
        assert_eq!(played.mission.bound_reached(), bound, "{acts_max:?}");
        let totals = played.mission.robots[R0].totals;
        let begun = begun as usize;
        assert_eq!(
            (totals.scripts, totals.sent, totals.accepted, totals.started),
            (begun, begun, begun, begun)
        );
        assert_eq!((totals.failed, totals.unaccounted, totals.retries), (0, 0, 0));
        assert_eq!((totals.steps_done, totals.steps_planned), (2 * begun as u64, 2 * begun as u64));
    }
}

#[test]
fn act_that_follows_at_once_starts_when_the_previous_one_ends() {
    let mut played = Played::begun(waits_in(2));
    let _done = played.run_to_the_end();
    let [one, two] = [0, 1].map(|act| &played.mission.course.reports[act]);
    assert_eq!(two.start, one.start + ms(400));
    assert_eq!((one.gap, two.gap), (None, Some(Span::ZERO)));
}

#[test]
fn act_report_states_its_times() {
    let mut played = Played::begun(begins_at_once(Everything));
    let timing = played.mission.acts[0].timing().unwrap().clone();
    let _done = played.run_to_the_end();
    let report = &played.mission.course.reports[0];
    assert_eq!((report.timestamp, report.start), (timing.timestamp, timing.start));
    assert_eq!(report.start, report.timestamp + report.lead.total());
    assert_eq!(report.spread, Some(Span::ZERO));
    // The request was answered after the disk and one round trip.
    let accepted = report.margin_left.map(|left| timing.decision - left);
    assert!(
        accepted.is_some_and(|at| at > timing.timestamp && at < timing.timestamp + ms(10)),
        "{accepted:?}"
    );
    let window = report.window.unwrap();
    assert!(window > Span::ZERO && window < ms(5), "{window}");
    let device = &report.robots[0].devices[0];
    assert_eq!(device.planned_start, Some(timing.start));
    assert_eq!(device.start_error, Some(Span::ZERO));
    assert_eq!((device.steps_done, device.steps_planned, device.late_steps), (2, 2, 0));
}

/// A mission with one act of two robots. If one robot fails, the other continues.
pub(super) fn without_those_that_fail() -> Mission {
    let mut choreography = choreography(&[&[("a", 0, 10_000)], &[("a", 0, 10_000)]]);
    choreography.acts[0].on_failure.default = OnFailure::Without;
    let participant = |id: &str| Participant::new(RobotId::new(id).unwrap(), robot(id, Everything, 2).block);
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let participants = vec![participant("r0"), participant("r1")];
    Mission::new(Arc::new(choreography), participants, options, at(0)).unwrap()
}

#[test]
fn others_continue_without_a_failed_robot_and_the_outcome_reports_it() {
    let mut played = Played::begun(without_those_that_fail());
    played.run_to_the_start();
    let now = played.now;
    played.mission.fail(now, R1, broken());
    assert_eq!(played.mission.robots[R1].standing, Standing::Out);
    assert_eq!(played.run_to_the_end(), Outcome::DoneWithout);
    let report = &played.mission.course.reports[0];
    assert_eq!(report.robots.iter().map(|robot| robot.left_out).collect::<Vec<_>>(), [false, true]);
    let stopped = |robot: RobotIndex| matches!(played.mission.robots[robot].halt.stop, Stop::Confirmed(_));
    assert_eq!((stopped(R0), stopped(R1)), (false, true));
}

#[test]
fn mission_with_no_robots_left_has_failed() {
    let mut played = Played::begun(without_those_that_fail());
    played.run_to_the_start();
    let now = played.now;
    played.mission.fail_all(now, vec![(R0, broken()), (R1, broken())]);
    assert_eq!(played.run_to_the_end(), Outcome::Failed);
    let reason = played.told.iter().find_map(|told| match told {
        Progress::Stopping { reason, .. } => Some(reason.clone()),
        _ => None,
    });
    let reason = reason.unwrap();
    assert!(reason.starts_with("r0: ") && reason.ends_with("; 1 robot more failed"), "{reason}");
}

#[test]
fn failure_may_lead_to_another_act_once_all_are_at_rest() {
    let mut choreography = choreography(&[&[("a", 0, 10_000)]]);
    let bow = choreography.acts[0].clone();
    choreography.acts.push(bow);
    choreography.acts[0].on_failure.then = Some(1);
    choreography.acts[0].next = Way::End;
    choreography.acts[1].next = Way::End;
    choreography.acts[1].wait = Wait::Done;
    let participant = Participant::new(RobotId::new("r0").unwrap(), robot("r0", Everything, 2).block);
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let mission = Mission::new(Arc::new(choreography), vec![participant], options, at(0)).unwrap();
    let mut played = Played::begun(mission);
    played.run_to_the_start();
    let now = played.now;
    played.mission.abort(now, Outcome::Failed, Rest::InPlace, Some(ActIndex::new(1)));
    assert_eq!(played.run_to_the_end(), Outcome::Failed);
    assert_eq!(fates(&played), [ActFate::Stopped, ActFate::Played]);
}

#[test]
fn playing_robots_are_asked_three_times_per_lease() {
    let mut played = Played::begun(one_act(Everything, 10_000));
    played.run_to_the_start();
    let from = played.now;
    played.run_until(from + ms(5_000));
    let asked =
        played.sent.iter().filter(|(at, _, message)| *at > from && matches!(message, Message::Inquiry(_)));
    let asked: Vec<_> = asked.map(|(at, ..)| *at).collect();
    assert!(asked.len() >= 7, "{asked:?}");
    // The running lease is two seconds.
    for pair in asked.windows(2) {
        assert_eq!(pair[1] - pair[0], Span::from_nanos(2_000_000_000 / 3));
    }
}

#[test]
fn messages_are_resent_to_a_robot_that_does_not_respond_before_decision() {
    let mut played = Played::of(begins_at_once(Everything), vec![R0]);
    let timing = played.mission.acts[0].timing().unwrap().clone();
    played.run_until(timing.ask_again() - Span::from_nanos(1));
    let requests = |played: &Played| {
        let request = |(.., message): &&(Timestamp<Server>, RobotIndex, Message)| {
            matches!(message, Message::ControlRequest(_))
        };
        played.sent.iter().filter(request).count()
    };
    assert_eq!(requests(&played), 1);
    played.run_until(timing.ask_again());
    assert_eq!((requests(&played), played.mission.robots[R0].totals.retries), (2, 1));
    played.run_until(timing.decision);
    let kinds: Vec<_> =
        played.mission.robots[R0].failures.iter().map(|failure| failure.kind.to_string()).collect();
    assert!(kinds[0].contains("acceptance by `a`"), "{kinds:?}");
}

#[test]
fn refused_go_names_the_act_that_plays_before_the_waiting_one() {
    let mut played = Played::begun(waits_in(1));
    played.run_to_the_start();
    let mission = &mut played.mission;
    answers(mission, None, Err("`two` waits until `one` has ended"));
    answers(mission, Some("two"), Err("`two` waits until `one` has ended"));
    answers(mission, Some("one"), Err("`one` is not waiting for the operator"));
    played.run_until(played.now + ms(3_000));
    answers(&mut played.mission, Some("two"), Ok("two"));
}

#[test]
fn mission_left_by_the_operator_reports_its_current_acts() {
    let mut played = Played::begun(begins_at_once(Everything));
    let now = played.now;
    played.mission.leave(now);
    assert_eq!((played.mission.acts.len(), played.mission.course.reports.len()), (0, 1));
}

#[test]
fn every_request_states_the_session() {
    let mut mission = begins_at_once(Everything);
    let session = Session::named("show".parse().unwrap());
    let told = Some(session.on_the_wire().clone());
    mission.options.session = Some(session);
    let mut played = Played::begun(mission);
    played.run_to_the_start();
    for (.., message) in &played.sent {
        let of = match message {
            Message::ControlRequest(request) => &request.session,
            Message::Inquiry(inquiry) => &inquiry.session,
            other => panic!("{other:?}"),
        };
        assert_eq!(*of, told);
    }
    assert!(played.sent.len() > 3);
}

#[test]
fn journal_start_must_be_stored_within_the_operators_patience() {
    let mut mission = begins_at_once(Everything);
    let _begun = mission.handle(at(0), Event::LinkUp { robot: R0 });
    let _waits = mission.advance(at(0));
    let ends = mission.acts[0].since() + mission.options.patience;
    assert!(mission.next_wakeup() <= Some(ends));
    let _waits = mission.advance(ends - Span::from_nanos(1));
    assert_eq!(mission.conclusion.outcome, None);
    let _ends = mission.advance(ends);
    assert!(
        matches!(mission.outcome(), Some(Outcome::JournalLost { .. })),
        "{:?}",
        mission.conclusion.outcome
    );
}

/// The outcome of a mission whose act is sent with these options, before any script plays.
fn sent_with(lease: Option<i64>, options: impl Fn(&mut MissionOptions)) -> Option<Outcome> {
    let mut mission = begins_at_once(Everything);
    let mut choreography = Choreography::clone(&mission.choreography);
    choreography.acts[0].plan.stop_condition.pending = lease.map(|lease| urrcp::Millis::from_span(ms(lease)));
    mission.choreography = Arc::new(choreography);
    options(&mut mission.options);
    Played::begun(mission).mission.outcome().cloned()
}

#[test]
fn operator_settings_are_kept_or_refused() {
    assert_eq!(sent_with(Some(240), |_| {}), None);
    let (lease, needed) = (ms(239), ms(240));
    assert_eq!(sent_with(Some(239), |_| {}), Some(Outcome::LeaseTooShort { lease, needed }));

    let Some(Outcome::LeadTooShort { lead, needed, safe_start }) =
        sent_with(None, |options| options.lead = Some(ms(1)))
    else {
        panic!()
    };
    assert_eq!(
        (lead, safe_start - needed.total()),
        (ms(1), at(2)),
        "once it is known how long the disk takes"
    );
    let lead = needed.total();
    assert_eq!(sent_with(None, |options| options.lead = Some(lead)), None);
    let just = lead - Span::from_nanos(1);
    assert!(matches!(
        sent_with(None, |options| options.lead = Some(just)),
        Some(Outcome::LeadTooShort { .. })
    ));

    assert_eq!(
        sent_with(None, |options| options.fixed.operator =
            Some(FixedStart { act: ActIndex::new(0), at: safe_start })),
        None
    );
    let start = safe_start - Span::from_nanos(1);
    let too_soon = sent_with(None, |options| {
        options.fixed.operator = Some(FixedStart { act: ActIndex::new(0), at: start })
    });
    assert_eq!(too_soon, Some(Outcome::StartTooSoon { start, safe_start }));
}

#[test]
fn requested_start_is_kept_and_the_spare_time_extends_the_leases() {
    let mut mission = begins_at_once(Everything);
    mission.options.fixed.operator = Some(FixedStart { act: ActIndex::new(0), at: at(1_500) });
    let played = Played::begun(mission);
    let timing = played.mission.acts[0].timing().unwrap();
    assert_eq!((timing.start, timing.gap), (at(1_500), Some(Span::ZERO)));
    assert!(timing.lead.lease > ms(500), "{:?}", timing.lead);
}

#[test]
fn act_that_waits_too_long_fails_ends_or_is_skipped_per_scenario() {
    let two = || Outcome::DoneSkipping { acts: vec!["one".to_owned()] };
    for (way, outcome, second) in [
        (Way::Fail, Outcome::Failed, ActFate::NotReached),
        (Way::End, two(), ActFate::NotReached),
        (Way::Act(1), two(), ActFate::Played),
    ] {
        let mut mission = waits_in(0);
        let mut choreography = Choreography::clone(&mission.choreography);
        choreography.acts[0].timeout = Some(ms(1_000));
        choreography.acts[0].on_timeout = way;
        mission.choreography = Arc::new(choreography);
        let mut played = Played::begun(mission);
        played.run_until(at(1_000) - Span::from_nanos(1));
        assert_eq!(played.mission.acts[0].index(), ActIndex::new(0), "{way:?}");
        let ended = played.run_to_the_end();
        assert!(ended == outcome || way == Way::Fail && ended == Outcome::NotStarted, "{way:?}: {ended}");
        assert_eq!(fates(&played)[1], second, "{way:?}");
        assert!(matches!(fates(&played)[0], ActFate::TimedOut { .. }), "{way:?}: {:?}", fates(&played));
    }
}

#[test]
fn robot_with_its_own_policy_is_left_out_where_another_ends_the_mission() {
    for (robot, outcome) in [(1, Outcome::DoneWithout), (0, Outcome::Failed)] {
        let mut mission = without_those_that_fail();
        let mut choreography = Choreography::clone(&mission.choreography);
        choreography.acts[0].on_failure.default = OnFailure::Stop;
        choreography.acts[0].on_failure.robots = vec![("r1".parse().unwrap(), OnFailure::Without)];
        mission.choreography = Arc::new(choreography);
        let mut played = Played::begun(mission);
        played.run_to_the_start();
        let now = played.now;
        played.mission.fail(now, RobotIndex::new(robot), broken());
        assert_eq!(played.run_to_the_end(), outcome, "r{robot}");
    }
}

#[test]
fn twice_the_disk_delay_is_allowed_and_slowly_forgotten() {
    let mut mission = begins_at_once(Everything);
    assert_eq!(mission.recording_time(), ms(30));
    for (took, allowed) in [(100, 200), (0, 150), (0, 112), (5_000, 2_000)] {
        mission.recording.count += 1;
        let count = mission.recording.count;
        mission.recording.awaited.push_back((count, None, at(0)));
        mission.outbox.arrived = at(took);
        mission.recorded(at(took), count);
        assert_eq!(mission.recording_time().as_nanos() / 1_000_000, allowed, "{took}");
    }
}

#[test]
fn strictest_policy_applies_when_robots_fail_together() {
    use downbeat_plan::OnFailure as Policy;
    for (of_first, of_second, rest) in [
        (Policy::Without, Policy::Home, Some(Rest::Home)),
        (Policy::Home, Policy::Without, Some(Rest::Home)),
        (Policy::Home, Policy::Stop, Some(Rest::InPlace)),
        (Policy::Stop, Policy::Without, Some(Rest::InPlace)),
        (Policy::Without, Policy::Without, None),
    ] {
        let mut choreography = choreography(&[&[("a", 0, 400)], &[("a", 0, 400)], &[("a", 0, 400)]]);
        let policy = &mut choreography.acts[0].on_failure;
        policy.robots = vec![("r0".parse().unwrap(), of_first), ("r1".parse().unwrap(), of_second)];
        let robots = ["r0", "r1", "r2"];
        let participants =
            robots.map(|id| Participant::new(RobotId::new(id).unwrap(), robot(id, Everything, 2).block));
        let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
        let mission = Mission::new(Arc::new(choreography), participants.to_vec(), options, at(0)).unwrap();
        let mut played = Played::begun(mission);
        played.run_to_the_start();
        let now = played.now;
        played.mission.fail_all(now, vec![(R0, broken()), (R1, broken())]);
        let rest_of_third = match &played.mission.robots[R2].halt.stop {
            Stop::Sent(sent) => Some(sent.rest),
            _ => None,
        };
        assert_eq!(rest_of_third, rest, "{of_first:?} and {of_second:?}");
    }
}

#[test]
fn act_sent_during_another_keeps_silence_for_at_most_the_running_lease() {
    let mut mission = waits_in(2);
    mission.acts.clear();
    let mut played = Played::begun(mission);
    played.run_to_the_start();
    let end = played.mission.acts[0].timing().unwrap().end;
    played.run_until(end - ms(1));
    let leases = played.mission.acts.iter().map(|act| act.timing().and_then(|timing| timing.played));
    assert_eq!(leases.collect::<Vec<_>>(), [None, Some(super::super::bench::RUNNING)]);
}

#[test]
fn loop_of_acts_with_no_robots_left_ends_the_mission() {
    let mut mission = one_after_the_other();
    let choreography = Arc::get_mut(&mut mission.choreography).unwrap();
    choreography.acts[1].plan = choreography.acts[0].plan.clone();
    choreography.acts[1].next = Way::Act(0);
    mission.robots[R0].standing = Standing::Out;
    mission.options.check_invariants = false;
    let _ended = happens(&mut mission, at(0), Event::LinkUp { robot: R1 });
    assert_eq!(mission.outcome(), Some(&Outcome::DoneWithout));
    assert!((2..=3).contains(&mission.course.begun), "{} acts", mission.course.begun);
}

#[test]
fn act_left_by_the_operator_before_its_start_is_withdrawn_though_sent() {
    let mut mission = begins_at_once(Everything);
    let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    assert!(mission.acts[0].is_unaccounted());
    mission.leave(at(1));
    assert_eq!(mission.course.fates[ActIndex::new(0)].fate, ActFate::Withdrawn);
}

/// A mission with one act. Its first robot has played its whole script, and the other robots continue to play.
fn the_first_is_done(tells: &[Tells]) -> Played {
    let scripts: Vec<Planned> =
        (0..tells.len()).map(|robot| ("a", 0, if robot == 0 { 100 } else { 10_000 })).collect();
    let scripts: Vec<&[Planned]> = scripts.iter().map(std::slice::from_ref).collect();
    let participant = |(robot, tells): (usize, &Tells)| {
        let id = format!("r{robot}");
        Participant::new(RobotId::new(&id).unwrap(), super::robot(&id, *tells, 2).block)
    };
    let participants = tells.iter().enumerate().map(participant).collect();
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let mission = Mission::new(Arc::new(choreography(&scripts)), participants, options, at(0)).unwrap();
    let mut played = Played::begun(mission);
    played.run_to_the_start();
    played.run_until(played.now + ms(1_000));
    assert_eq!(played.mission.acts[0].is_done_by_one(), tells[0] != Tells::Nothing);
    assert!(!played.mission.acts[0].is_over());
    played
}

#[test]
fn interrupted_act_was_stopped_even_if_a_robot_has_finished_its_part() {
    for tells in [[Everything; 2], [Tells::Nothing; 2]] {
        let mut played = the_first_is_done(&tells);
        let now = played.now;
        played.mission.leave(now);
        assert_eq!(fates(&played), [ActFate::Stopped], "{tells:?}");
        let mut played = the_first_is_done(&tells);
        assert_eq!(stop(&mut played), Outcome::Stopped);
        assert_eq!(fates(&played), [ActFate::Stopped], "{tells:?}");
    }
}

#[test]
fn act_whose_last_robot_was_left_out_may_have_begun_and_next_is_played() {
    // A robot that drops undecided scripts cannot begin the act before its commitment.
    for (starts, drops, first) in [
        (true, true, ActFate::Stopped),
        (true, false, ActFate::Stopped),
        (false, true, ActFate::Withdrawn),
        (false, false, ActFate::Stopped),
    ] {
        let mut mission = one_after_the_other();
        let choreography = Arc::get_mut(&mut mission.choreography).unwrap();
        choreography.acts[0].on_failure.default = OnFailure::Without;
        mission.robots[R0].block.as_mut().unwrap().pending_until = drops;
        let mut played = Played::begun(mission);
        if starts {
            played.run_to_the_start();
        }
        let now = played.now;
        played.mission.fail(now, R0, broken());
        assert_eq!(played.run_to_the_end(), Outcome::DoneWithout, "it had started: {starts}");
        assert_eq!(fates(&played), [first, ActFate::Played], "it had started: {starts}, drops: {drops}");
    }
}

#[test]
fn silent_robot_may_have_moved_at_the_earliest_start_its_clock_allows() {
    let (mut mission, act, _) = sent_act();
    let timing = act.timing().unwrap();
    let earliest = timing.earliest_start();
    assert!(earliest < timing.start && !act.is_committed());
    for drops in [false, true] {
        mission.robots[R0].block.as_mut().unwrap().pending_until = drops;
        let moved = [earliest - Span::from_nanos(1), earliest].map(|now| mission.may_have_begun(now, &act));
        assert_eq!(moved, [false, !drops]);
    }

    let mut played = Played::begun(begins_at_once(Tells::Nothing));
    played.run_to_the_start();
    let act = &played.mission.acts[0];
    let start = act.timing().unwrap().start;
    assert!(act.is_committed() && !act.has_begun());
    assert_eq!([at(0), start].map(|now| played.mission.may_have_begun(now, act)), [false, true]);
}
