//! Tests of robots whose link breaks, or that do not answer, while they play.

use urrcp::{ControlType, Millis, Script, Setpoint, Step};

use super::played::Played;
use super::*;
use crate::bench::{RUNNING, ms};
use crate::failure_kind::FailureKind;
use crate::report::{Report, StopState};

fn breaks() -> Event {
    Event::LinkDown { robot: R0, loss: Loss::Closed, reason: "it broke".to_owned() }
}

/// A mission whose only robot plays and has lost its link.
fn broken() -> Played {
    let mut played = Played::begun(one_act(Everything, 10_000));
    played.run_to_the_start();
    played.mutes(R0);
    played.happens(breaks());
    played
}

#[test]
fn robot_is_given_up_only_when_its_lost_link_times_out() {
    let Played { mut mission, now, .. } = broken();
    let until = mission.timers.give_up.unwrap();
    assert!(until >= now + RUNNING);
    mission.give_up_lost(until - Span::from_nanos(1));
    assert!(!mission.robots[R0].has_failed(), "it may still come back");
    mission.give_up_lost(until);
    let kinds: Vec<_> = mission.robots[R0].failures.iter().map(|failure| failure.kind.clone()).collect();
    assert_eq!(kinds, [FailureKind::LinkDown { reason: "it broke".to_owned() }]);
    assert_eq!(mission.timers.give_up, None, "the mission waits for no other robot");
}

#[test]
fn lost_link_and_its_deadline_are_reported_to_the_operator_once() {
    let mut played = broken();
    played.run_until(played.now + ms(1));
    played.happens(breaks());
    let lost = |progress: &Progress| match progress {
        Progress::LinkLost { reason, until, .. } => Some((reason.clone(), *until)),
        _ => None,
    };
    let told: Vec<_> = played.told.iter().filter_map(lost).collect();
    assert_eq!(told, [("it broke".to_owned(), played.mission.timers.give_up)]);
}

#[test]
fn reattached_robot_is_no_longer_awaited() {
    let mut played = broken();
    let until = played.mission.timers.give_up.unwrap();
    played.mute.clear();
    played.happens(Event::LinkUp { robot: R0 });
    assert_eq!(played.mission.timers.give_up, Some(until), "it has not answered");
    played.run_until(played.now + ms(1));
    assert!(played.told.iter().any(|told| matches!(told, Progress::Reattached { .. })));
    assert_eq!(played.mission.timers.give_up, None);
    assert_eq!(played.run_to_the_end(), Outcome::Done);
    assert_eq!(played.mission.robots[R0].totals.reconnects, 1);
}

/// A mission that stops because another process answers at the address of its robot, while that robot is still playing.
fn replaced(patience: Span) -> Played {
    let mut played = broken();
    played.mission.options.patience = patience;
    let script = played.mission.robots[R0].requests.scripts().next().map(|(id, _)| id.clone()).unwrap();
    played.loses(&script);
    played.mute.clear();
    played.happens(Event::LinkUp { robot: R0 });
    played.run_until(played.now + ms(20));
    let robot = &played.mission.robots[R0];
    assert!(matches!(robot.halt.stop, Stop::Confirmed(_)) && !robot.is_settled());
    played
}

fn is_confirmed(played: &Played) -> bool {
    confirmations(played) > 0
}

#[test]
fn stop_confirmed_by_another_process_counts_after_the_first_lease_ended() {
    let mut played = replaced(RUNNING * 3);
    played.run_until(played.now + RUNNING - ms(40));
    assert!(played.mission.outcome().is_none() && !is_confirmed(&played));
    played.run_until(played.now + ms(60));
    assert_eq!(played.mission.outcome(), Some(&Outcome::Failed));
    assert!(is_confirmed(&played));
}

fn confirmations(played: &Played) -> usize {
    played.recorded.iter().filter(|record| matches!(record, Record::StopConfirmed { .. })).count()
}

#[test]
fn stop_confirmed_by_a_process_not_yet_known_to_be_new_takes_effect_late() {
    let mut played = broken();
    played.mission.options.patience = RUNNING * 3;
    let script = played.mission.robots[R0].requests.scripts().next().map(|(id, _)| id.clone()).unwrap();
    played.loses(&script);
    played.happens(Event::StopRequested { rest: Rest::InPlace, by: None });
    played.mute.clear();
    played.happens(Event::LinkUp { robot: R0 });
    played.run_until(played.now + RUNNING - ms(40));
    assert!(matches!(played.mission.robots[R0].halt.stop, Stop::Confirmed(_)));
    assert_eq!((played.mission.outcome(), confirmations(&played)), (None, 0));
    played.run_until(played.now + ms(60));
    assert_eq!((played.mission.outcome(), confirmations(&played)), (Some(&Outcome::Stopped), 1));
}

#[test]
fn process_that_responds_after_another_confirmed_its_stop_is_stopped() {
    let mut played = replaced(RUNNING * 3);
    assert_eq!(played.stops(), 1);
    played.happens(breaks());
    assert!(played.mission.robots[R0].lost().unwrap().connecting);
    played.happens(Event::LinkUp { robot: R0 });
    assert_eq!(played.stops(), 2);
}

/// The time from the start of a script of 10 s until a robot's process that still runs it comes to rest; `None` if it never does. `lease`
/// is the script's lease, and `last` its last setpoint.
fn rests_elsewhere(lease: Option<Span>, last: Setpoint) -> Option<Span> {
    let mut choreography = choreography(&[&[("a", 0, 10_000)]]);
    let script = &mut choreography.acts[0].plan.robots[0].scripts[0];
    script.stop_condition.running = lease.map(Millis::from_span);
    let step = |offset, setpoint| Step { offset: Millis::from_span(offset), setpoint, stop_condition: None };
    let first = Setpoint::new(last.control_type, 1.0);
    script.script = Script::new(vec![step(Span::ZERO, first), step(ms(10_000), last)]).unwrap();
    let participants = vec![Participant::new(RobotId::new("r0").unwrap(), robot("r0", Everything, 2).block)];
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let mission = Mission::new(Arc::new(choreography), participants, options, at(0)).unwrap();
    let mut played = Played::begun(mission);
    played.run_to_the_start();
    let id = played.mission.robots[R0].requests.scripts().next().map(|(id, _)| id.clone()).unwrap();
    played.loses(&id);
    let (start, now) = (played.mission.acts[0].timing().unwrap().start, played.now);
    played.mission.inquire_now(now, R0);
    let actions = played.mission.advance(now);
    played.carry_out(actions);
    played.run_until(now + ms(1));
    played.mission.robots[R0].halt.elsewhere.expect("another process may run it").map(|until| until - start)
}

#[test]
fn other_process_moves_until_lease_or_last_step_and_drives_until_lease() {
    let position = Setpoint::new(ControlType::Position, 5.0);
    let (driven, halted) = (Setpoint::new(ControlType::Speed, 5.0), Setpoint::new(ControlType::Speed, 0.0));
    let (short, long) = (Some(ms(2_000)), Some(ms(60_000)));
    for (lease, last, from, to) in [
        (short, position.clone(), 2_000, 2_100),
        (long, position.clone(), 10_000, 10_100),
        (None, position, 10_000, 10_100),
        (None, halted, 10_000, 10_100),
        (long, driven.clone(), 60_000, 60_100),
    ] {
        let rests = rests_elsewhere(lease, last.clone()).expect("it comes to rest");
        assert!(ms(from) <= rests && rests <= ms(to), "{lease:?} {last:?}: {rests}");
    }
    assert_eq!(rests_elsewhere(None, driven), None);
}

#[test]
fn longest_lease_of_the_lost_scripts_applies() {
    let elsewhere = |leases: &[Option<i64>]| {
        let mut mission = begins_at_once(Everything);
        leases.iter().for_each(|lease| mission.robots[R0].runs_elsewhere(lease.map(at)));
        mission.robots[R0].halt.elsewhere
    };
    assert_eq!(elsewhere(&[]), None);
    assert_eq!(elsewhere(&[Some(3), Some(5), Some(4)]), Some(Some(at(5))));
    assert_eq!(elsewhere(&[Some(3), None, Some(4)]), Some(None), "one runs without a lease");
}

#[test]
fn in_process_robot_is_moved_by_no_other_process() {
    let mut played = broken();
    played.mission.robots[R0].in_process = true;
    let script = played.mission.robots[R0].requests.scripts().next().map(|(id, _)| id.clone()).unwrap();
    played.loses(&script);
    played.mute.clear();
    played.happens(Event::LinkUp { robot: R0 });
    played.run_until(played.now + ms(20));
    assert_eq!(played.mission.outcome(), Some(&Outcome::Failed));
    assert!(is_confirmed(&played));
}

#[test]
fn stop_confirmed_by_another_process_is_unconfirmed_during_a_lease() {
    let mut played = replaced(RUNNING / 2);
    assert_eq!(played.run_to_the_end(), Outcome::Failed);
    let report = Report::of(&played.mission).unwrap();
    let stop = &report.robots[0].stop;
    let StopState::Unconfirmed { lease_ends: Some(ends) } = stop else { panic!("{stop:?}") };
    assert!(*ends > played.now - ms(60_000) && !is_confirmed(&played));
}

#[test]
fn robot_whose_process_is_gone_has_lost_its_scripts() {
    let other = [(Loss::Closed, false), (Loss::Unreachable, false), (Loss::Denied, false)];
    for (loss, fails) in [(Loss::Refused, true)].into_iter().chain(other) {
        let mut mission = begins_at_once(Everything);
        let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
        let _down = mission.handle(at(2), Event::LinkDown { robot: R0, loss, reason: "why".to_owned() });
        assert_eq!(mission.robots[R0].has_failed(), fails, "{loss:?}");
    }
}

#[test]
fn playing_robot_may_be_silent_for_its_lease_and_a_round_trip() {
    let mut played = Played::begun(begins_at_once(Everything));
    assert_eq!(played.mission.silence_bound(played.now, R0), None, "its act is not committed");
    played.run_to_the_start();
    let bound = |played: &mut Played, round_trip: i64| {
        let there = by_robot(at(0));
        let mut clock = crate::clock::ClockEstimate::default();
        clock.add(ClockSample::from_exchange(at(0), there, there, at(round_trip)));
        played.mission.robots[R0].clock = clock;
        played.mission.silence_bound(played.now, R0)
    };
    assert_eq!(bound(&mut played, 0), Some(RUNNING));
    assert_eq!(bound(&mut played, 200), Some(RUNNING + ms(200)));
    played.mission.robots[R0].set_stop(Stop::Confirmed(Rest::InPlace));
    assert_eq!(played.mission.silence_bound(played.now, R0), None, "it was stopped");
}

#[test]
fn robot_that_becomes_silent_while_playing_fails() {
    let mut played = Played::begun(one_act(Everything, 10_000));
    played.run_to_the_start();
    played.mutes(R0);
    let since = played.now;
    played.run_until(since + ms(1_900));
    assert!(!played.mission.robots[R0].has_failed());
    played.run_until(since + ms(4_000));
    let kinds: Vec<_> =
        played.mission.robots[R0].failures.iter().map(|failure| failure.kind.clone()).collect();
    assert!(matches!(kinds.as_slice(), [FailureKind::Silent { .. }]), "{kinds:?}");
}

#[test]
fn non_reporting_robot_is_asked_about_its_script_after_a_machine_stall() {
    for late in [100, 600, 1_100, 2_000] {
        let mut played = Played::begun(one_act(Tells::Answers, 400));
        let start = played.mission.acts[0].timing().unwrap().start;
        played.run_until(start - ms(10));
        // A round is due as well. Its inquiry, which contains no script, is sent and answered first.
        played.now = start + ms(400 + late);
        played.run_until(played.now);
        played.delay_reports(ms(60));
        let outcome = played.run_to_the_end();
        assert_eq!((outcome, played.mission.robots[R0].failures.len()), (Outcome::Done, 0), "{late} ms late");
    }
}

#[test]
fn reports_received_during_a_stall_are_read_before_a_robot_is_blamed() {
    for late in [600, 1_100, 2_000] {
        let mut played = Played::begun(one_act(Tells::Reports, 400));
        let start = played.mission.acts[0].timing().unwrap().start;
        played.run_until(start - ms(10));
        played.now = start + ms(400 + late);
        let actions = played.mission.advance(played.now);
        played.carry_out(actions);
        let outcome = played.run_to_the_end();
        assert_eq!((outcome, played.mission.robots[R0].failures.len()), (Outcome::Done, 0), "{late} ms late");
    }
}

#[test]
fn late_round_counts_as_a_machine_stall_and_excuses_open_requests() {
    for (late, held_up) in [(100, 0), (101, 1)] {
        let mut played = Played::begun(begins_at_once(Everything));
        let due = played.now;
        played.mission.timers.next_round = Some(due);
        played.mission.robots[R0].contact.questions.asked(due);
        played.mission.notice_hold_up(due + ms(late));
        assert_eq!(played.mission.machine.rounds_held_up, held_up);
        assert_eq!(played.mission.robots[R0].contact.questions.unanswered().is_none(), held_up > 0);
    }
}

#[test]
fn round_due_in_the_quiet_around_a_start_comes_shortly_after_it() {
    let mut played = Played::begun(begins_at_once(Everything));
    let start = played.mission.acts[0].timing().unwrap().start;
    let now = start - Span::from_micros(100);
    played.run_until(now);
    let before = played.sent.len();
    played.mission.timers.next_round = Some(now);
    played.mission.renew_if_due(now);
    assert_eq!((played.mission.outbox.actions.len(), played.sent.len()), (0, before));
    assert_eq!(played.mission.timers.next_round, Some(start + ms(1)));
}

#[test]
fn robot_status_is_reported_to_the_operator_at_intervals() {
    let mut played = Played::begun(one_act(Everything, 10_000));
    played.run_to_the_start();
    let heard =
        |played: &Played| played.told.iter().filter(|told| matches!(told, Progress::Heard { .. })).count();
    let before = heard(&played);
    played.run_until(played.now + ms(6_000));
    // There are nine rounds. Every second one is later than 900 ms after the last reported one.
    assert!((4..=5).contains(&(heard(&played) - before)), "{before}, {}", heard(&played));
}

#[test]
fn each_lost_robot_is_given_up_at_its_own_time() {
    let mut mission = super::hostile::of_two(TOLERANCE);
    mission.phase = Phase::Performing;
    for (robot, give_up) in [(0, at(20)), (1, at(10))] {
        let reason = format!("the link of {robot}");
        let lost = crate::robot_state::Lost {
            reason,
            loss: Loss::Closed,
            since: at(0),
            failed: at(0),
            connecting: true,
            give_up: Some(give_up),
        };
        mission.robots[RobotIndex::new(robot)].link = crate::robot_state::Link::Lost(lost);
    }
    mission.timers.give_up = Some(at(10));
    mission.give_up_lost(at(10) - Span::from_nanos(1));
    assert!(!mission.robots[R1].has_failed());
    mission.give_up_lost(at(10));
    let failed = [0, 1].map(|robot| mission.robots[RobotIndex::new(robot)].has_failed());
    assert_eq!((failed, mission.timers.give_up), ([false, true], Some(at(20))));
}

#[test]
fn round_needed_by_a_short_lease_is_not_delayed_by_quiet_around_a_start() {
    for (lease, waits) in [(20, true), (10, false)] {
        let mut mission = begins_at_once(Everything);
        let choreography = Arc::get_mut(&mut mission.choreography).unwrap();
        let running = Some(urrcp::Millis::from_span(ms(lease)));
        choreography.acts[0].plan.robots[0].scripts[0].stop_condition.running = running;
        let mut played = Played::begun(mission);
        let now = played.mission.acts[0].timing().unwrap().start - Span::from_micros(100);
        played.run_until(now);
        played.mission.timers.next_round = Some(now);
        played.mission.renew_if_due(now);
        assert_eq!(played.mission.outbox.actions.is_empty(), waits, "a lease of {lease} ms");
    }
}

#[test]
fn silence_is_detected_by_a_check_that_runs_slightly_late() {
    for (looks, noticed) in [(-1, false), (0, true), (1, true)] {
        let mut played = Played::begun(one_act(Everything, 10_000));
        played.run_to_the_start();
        let now = played.now;
        played.mission.robots[R0].heard(now - ms(60_000));
        played.mission.robots[R0].contact.questions.asked(now - ms(60_000));
        played.mission.timers.next_silence = Some(now - ms(looks));
        played.mission.notice_silence(now);
        assert_eq!(played.mission.robots[R0].has_failed(), noticed, "{looks} ms after it was due");
    }
}

#[test]
fn robot_just_asked_by_an_approaching_act_is_not_asked_again_by_a_round() {
    for (asked, more) in [(1, 0), (10_000, 1)] {
        let mut played = Played::begun(begins_at_once(Everything));
        let now = played.now;
        assert!(played.mission.acts[0].approaches(R0) && !played.mission.acts[0].holds_messages_to(R0, now));
        played.mission.robots[R0].contact.questions.forgive();
        let mut questions = crate::robot_state::Questions::default();
        questions.asked(now - ms(asked));
        played.mission.robots[R0].contact.questions = questions;
        played.mission.timers.next_round = Some(now);
        played.mission.renew_if_due(now);
        assert_eq!(played.mission.outbox.actions.len(), more, "asked {asked} ms ago");
    }
}
