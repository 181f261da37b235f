//! Robots whose link breaks, or that say nothing, while they play.

use super::played::Played;
use super::*;
use crate::mission::bench::{RUNNING, ms};
use crate::mission::failure_kind::FailureKind;

fn breaks() -> Event {
    Event::LinkDown { robot: 0, loss: Loss::Closed, reason: "it broke".to_owned() }
}

/// A mission whose only robot plays and has lost its link.
fn broken() -> Played {
    let mut played = Played::begun(one_act(Everything, 10_000));
    played.run_to_the_start();
    played.mutes(0);
    played.happens(breaks());
    played
}

#[test]
fn a_robot_whose_link_stays_away_is_given_up_and_not_before() {
    let Played { mut mission, now, .. } = broken();
    let until = mission.give_up.unwrap();
    assert!(until >= now + RUNNING);
    mission.give_up_lost(until - Span::from_nanos(1));
    assert!(!mission.robots[0].has_failed(), "it may still come back");
    mission.give_up_lost(until);
    let kinds: Vec<_> = mission.robots[0].failures.iter().map(|failure| failure.kind.clone()).collect();
    assert_eq!(kinds, [FailureKind::LinkDown { reason: "it broke".to_owned() }]);
    assert_eq!(mission.give_up, None, "nobody else is waited for");
}

#[test]
fn the_operator_is_told_once_that_a_link_is_lost_and_until_when_it_may_come_back() {
    let mut played = broken();
    played.run_until(played.now + ms(1));
    played.happens(breaks());
    let lost = |progress: &Progress| match progress {
        Progress::LinkLost { reason, until, .. } => Some((reason.clone(), *until)),
        _ => None,
    };
    let told: Vec<_> = played.told.iter().filter_map(lost).collect();
    assert_eq!(told, [("it broke".to_owned(), played.mission.give_up)]);
}

#[test]
fn a_robot_that_is_heard_again_is_waited_for_no_more() {
    let mut played = broken();
    let until = played.mission.give_up.unwrap();
    played.mute.clear();
    played.happens(Event::LinkUp { robot: 0 });
    assert_eq!(played.mission.give_up, Some(until), "it has said nothing");
    played.run_until(played.now + ms(1));
    assert!(played.told.iter().any(|told| matches!(told, Progress::Reattached { .. })));
    assert_eq!(played.mission.give_up, None);
    assert_eq!(played.run_to_the_end(), Outcome::Done);
    assert_eq!(played.mission.robots[0].totals.reconnects, 1);
}

#[test]
fn a_robot_whose_process_is_gone_has_lost_what_it_had() {
    for (loss, fails) in [(Loss::Refused, true), (Loss::Closed, false), (Loss::Unreachable, false)] {
        let mut mission = begins_at_once(Everything);
        let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: 0 });
        let _down = mission.handle(at(2), Event::LinkDown { robot: 0, loss, reason: "why".to_owned() });
        assert_eq!(mission.robots[0].has_failed(), fails, "{loss:?}");
    }
}

#[test]
fn a_robot_that_plays_may_be_silent_for_its_lease_and_a_round_trip() {
    let mut played = Played::begun(begins_at_once(Everything));
    assert_eq!(played.mission.silence_bound(played.now, 0), None, "its act is not committed");
    played.run_to_the_start();
    let bound = |played: &mut Played, round_trip: i64| {
        let there = by_robot(at(0));
        let mut clock = crate::clock::ClockEstimate::default();
        clock.add(ClockSample::from_exchange(at(0), there, there, at(round_trip)));
        played.mission.robots[0].clock = clock;
        played.mission.silence_bound(played.now, 0)
    };
    assert_eq!(bound(&mut played, 0), Some(RUNNING));
    assert_eq!(bound(&mut played, 200), Some(RUNNING + ms(200)));
    played.mission.robots[0].stop = Stop::Confirmed(Rest::InPlace);
    assert_eq!(played.mission.silence_bound(played.now, 0), None, "it was stopped");
}

#[test]
fn a_robot_that_falls_silent_while_it_plays_fails() {
    let mut played = Played::begun(one_act(Everything, 10_000));
    played.run_to_the_start();
    played.mutes(0);
    let since = played.now;
    played.run_until(since + ms(1_900));
    assert!(!played.mission.robots[0].has_failed());
    played.run_until(since + ms(4_000));
    let kinds: Vec<_> =
        played.mission.robots[0].failures.iter().map(|failure| failure.kind.clone()).collect();
    assert!(matches!(kinds.as_slice(), [FailureKind::Silent { .. }]), "{kinds:?}");
}

#[test]
fn a_round_that_comes_late_says_that_this_machine_was_held_up_and_nothing_of_the_robots() {
    for (late, held_up) in [(100, 0), (101, 1)] {
        let mut played = Played::begun(begins_at_once(Everything));
        let due = played.now;
        played.mission.next_round = Some(due);
        played.mission.robots[0].questions.asked(due);
        played.mission.notice_hold_up(due + ms(late));
        assert_eq!(played.mission.rounds_held_up, held_up);
        assert_eq!(played.mission.robots[0].questions.unanswered().is_none(), held_up > 0);
    }
}

#[test]
fn a_round_that_falls_into_the_quiet_around_a_start_comes_a_moment_later() {
    let mut played = Played::begun(begins_at_once(Everything));
    let start = played.mission.acts[0].timing().unwrap().start;
    let now = start - Span::from_micros(100);
    played.run_until(now);
    let before = played.sent.len();
    played.mission.next_round = Some(now);
    played.mission.renew_if_due(now);
    assert_eq!((played.mission.actions.len(), played.sent.len()), (0, before));
    assert_eq!(played.mission.next_round, Some(start + ms(1)));
}

#[test]
fn the_operator_is_told_what_a_robot_says_of_itself_now_and_then() {
    let mut played = Played::begun(one_act(Everything, 10_000));
    played.run_to_the_start();
    let heard =
        |played: &Played| played.told.iter().filter(|told| matches!(told, Progress::Heard { .. })).count();
    let before = heard(&played);
    played.run_until(played.now + ms(6_000));
    // Nine rounds, of which every second one is later than 900 ms after the one that was told of.
    assert!((4..=5).contains(&(heard(&played) - before)), "{before}, {}", heard(&played));
}

#[test]
fn lost_robots_are_given_up_each_at_its_own_time() {
    let mut mission = super::hostile::of_two(TOLERANCE);
    mission.phase = Phase::Performing;
    for (robot, give_up) in [(0, at(20)), (1, at(10))] {
        let reason = format!("the link of {robot}");
        let lost = crate::mission::robot_state::Lost {
            reason,
            loss: Loss::Closed,
            since: at(0),
            connecting: true,
            give_up: Some(give_up),
        };
        mission.robots[robot].link = crate::mission::robot_state::Link::Lost(lost);
    }
    mission.give_up = Some(at(10));
    mission.give_up_lost(at(10) - Span::from_nanos(1));
    assert!(!mission.robots[1].has_failed());
    mission.give_up_lost(at(10));
    let failed = [0, 1].map(|robot| mission.robots[robot].has_failed());
    assert_eq!((failed, mission.give_up), ([false, true], Some(at(20))));
}

#[test]
fn a_round_that_a_short_lease_needs_is_not_put_off_by_the_quiet_around_a_start() {
    for (lease, waits) in [(20, true), (10, false)] {
        let mut mission = begins_at_once(Everything);
        let choreography = Arc::get_mut(&mut mission.choreography).unwrap();
        let running = Some(urrcp::Millis::from_span(ms(lease)));
        choreography.acts[0].plan.robots[0].scripts[0].stop_condition.running = running;
        let mut played = Played::begun(mission);
        let now = played.mission.acts[0].timing().unwrap().start - Span::from_micros(100);
        played.run_until(now);
        played.mission.next_round = Some(now);
        played.mission.renew_if_due(now);
        assert_eq!(played.mission.actions.is_empty(), waits, "a lease of {lease} ms");
    }
}

#[test]
fn silence_is_noticed_by_a_machine_that_looks_for_it_a_little_late() {
    for (looks, noticed) in [(-1, false), (0, true), (1, true)] {
        let mut played = Played::begun(one_act(Everything, 10_000));
        played.run_to_the_start();
        let now = played.now;
        played.mission.robots[0].heard(now - ms(60_000));
        played.mission.robots[0].questions.asked(now - ms(60_000));
        played.mission.next_silence = Some(now - ms(looks));
        played.mission.notice_silence(now);
        assert_eq!(played.mission.robots[0].has_failed(), noticed, "{looks} ms after it was due");
    }
}

#[test]
fn a_robot_that_an_act_asks_on_the_way_to_its_start_is_not_asked_once_more_by_a_round() {
    for (asked, more) in [(1, 0), (10_000, 1)] {
        let mut played = Played::begun(begins_at_once(Everything));
        let now = played.now;
        assert!(played.mission.acts[0].approaches(0) && !played.mission.acts[0].hushes(0, now));
        played.mission.robots[0].questions.forgive();
        let mut questions = crate::mission::robot_state::Questions::default();
        questions.asked(now - ms(asked));
        played.mission.robots[0].questions = questions;
        played.mission.next_round = Some(now);
        played.mission.renew_if_due(now);
        assert_eq!(played.mission.actions.len(), more, "asked {asked} ms ago");
    }
}
