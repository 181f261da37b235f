//! The mission prepares acts again if this machine was too slow to start them.

use super::played::Played;
use super::*;
use crate::mission::bench::{ms, response};

const LATE: Outcome = Outcome::DecisionLate { by: Span::from_millis(30) };

impl Played {
    /// Withdraws the act under way.
    fn is_withdrawn(&mut self) {
        let (now, number) = (self.now, self.mission.acts[0].number());
        self.mission.withdraw_act(now, number, LATE);
        let actions = self.mission.advance(now);
        self.carry_out(actions);
    }

    fn lead(&self) -> Span {
        self.mission.acts[0].timing().unwrap().lead.total()
    }

    fn starts(&self) -> usize {
        let scripts = self.sent.iter().filter(|(.., message)| {
            matches!(message, Message::ControlRequest(request) if request.time_offset_to_start.is_some())
        });
        scripts.count()
    }
}

#[test]
fn an_act_that_was_withdrawn_before_anything_moved_is_prepared_again_with_a_longer_lead() {
    for tells in [Everything, Tells::Reports, Tells::Answers] {
        let mut played = Played::begun(begins_at_once(tells));
        let before = played.lead();
        played.is_withdrawn();
        played.run_until(played.now + ms(20));
        assert!(played.lead() > before + ms(60), "{tells:?}");
        assert_eq!(played.run_to_the_end(), Outcome::Done, "{tells:?}");
        assert_eq!(played.starts(), 2, "{tells:?}");
        let [report] = &*played.mission.reports.make_contiguous() else { panic!("one act was played") };
        assert_eq!((report.number, report.prepared_again), (1, 1), "{tells:?}");
        let totals = &played.mission.robots[0].totals;
        assert_eq!((totals.scripts, totals.steps_planned), (1, totals.steps_done), "{tells:?}");
        assert_eq!(played.mission.fates[0].played, 1);
    }
}

#[test]
fn an_act_is_prepared_again_twice_at_most() {
    let mut played = Played::begun(begins_at_once(Everything));
    for attempts in 0..3 {
        assert_eq!(played.mission.acts[0].attempts(), attempts);
        played.is_withdrawn();
        played.run_until(played.now + ms(20));
    }
    assert_eq!(played.mission.outcome(), Some(&LATE));
    assert_eq!(played.starts(), 3);
}

#[test]
fn what_an_act_waited_for_is_not_waited_for_again() {
    let mut played = Played::begun(waits_in(0));
    played.happens(Event::Go { act: None, by: None });
    played.run_until(played.now + ms(20));
    played.is_withdrawn();
    played.run_until(played.now + ms(20));
    assert!(played.mission.acts[0].was_sent());
    assert_eq!(played.run_to_the_end(), Outcome::Done);
}

#[test]
fn an_act_with_an_instant_of_its_own_or_behind_another_one_is_not_prepared_again() {
    let mut mission = begins_at_once(Everything);
    mission.options.start_at = Some(at(1_000));
    let mut played = Played::begun(mission);
    played.is_withdrawn();
    assert_eq!(played.run_to_the_end(), LATE);

    let mut played = Played::begun(waits_in(1));
    played.run_to_the_start();
    assert_eq!(played.mission.acts.len(), 2);
    assert!(!played.mission.may_be_prepared_again(1));
}

#[test]
fn a_mission_that_ends_before_the_next_attempt_has_withdrawn_its_act() {
    let mut played = Played::begun(waits_in(0));
    played.mission.acts[0].is_attempted_again(1);
    played.happens(Event::StopRequested { rest: Rest::InPlace, by: None });
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    assert_eq!(played.starts(), 0);
    assert_eq!(played.mission.fates[0].fate, ActFate::Withdrawn);
}

#[test]
fn a_stop_of_the_operator_ends_the_preparation_for_good() {
    let mut played = Played::begun(begins_at_once(Everything));
    played.is_withdrawn();
    played.happens(Event::StopRequested { rest: Rest::InPlace, by: None });
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    assert_eq!(played.starts(), 1);
}

#[test]
fn an_act_is_not_prepared_again_if_a_robot_does_not_confirm_its_stop() {
    let mut played = Played::begun(begins_at_once(Everything));
    played.mutes(0);
    played.is_withdrawn();
    assert_eq!(played.run_to_the_end(), LATE);
    assert_eq!(played.starts(), 1);
}

#[test]
fn an_act_that_a_robot_has_begun_is_not_prepared_again() {
    let mut played = Played::begun(one_act(Everything, 10_000));
    played.run_to_the_start();
    played.is_withdrawn();
    assert_eq!(played.run_to_the_end(), Outcome::Failed);
    assert_eq!(played.starts(), 1);
}

/// Three robots; the first `silent` ones do not accept in time.
fn accepts_late(silent: usize, on_failure: downbeat_scripts::OnFailure) -> Played {
    let scripts: [&[Planned]; 3] = [&[("a", 0, 400)]; 3];
    let mut choreography = choreography(&scripts);
    choreography.acts[0].on_failure.default = on_failure;
    let ids = ["r0", "r1", "r2"];
    let participant = |id: &str| Participant::new(RobotId::new(id).unwrap(), robot(id, Everything, 2).block);
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let mission = Mission::new(Arc::new(choreography), ids.map(participant).into(), options, at(0)).unwrap();
    Played::of(mission, (0..silent).collect())
}

#[test]
fn if_most_robots_do_not_accept_in_time_this_machine_is_suspected_once() {
    let mut played = accepts_late(2, downbeat_scripts::OnFailure::Without);
    while played.mission.acts[0].attempts() == 0 && played.mission.again.is_none() {
        played.run_until(played.now + ms(1));
    }
    played.mute.clear();
    assert_eq!(played.run_to_the_end(), Outcome::Done);
    assert!(played.mission.robots.iter().all(|robot| !robot.has_failed()));
}

#[test]
fn most_robots_that_stay_silent_have_failed() {
    let mut played = accepts_late(2, downbeat_scripts::OnFailure::Without);
    assert_eq!(played.run_to_the_end(), Outcome::NotStarted);
    let failed: Vec<bool> = played.mission.robots.iter().map(RobotState::has_failed).collect();
    assert_eq!(failed, [true, true, false]);
}

#[test]
fn one_robot_that_does_not_accept_in_time_is_left_out_at_once() {
    let mut played = accepts_late(1, downbeat_scripts::OnFailure::Without);
    assert_eq!(played.run_to_the_end(), Outcome::DoneWithout);
    assert!(played.mission.reports.iter().all(|act| act.prepared_again == 0));
}

#[test]
fn leases_that_end_while_this_machine_stalls_are_no_failure_of_their_robots() {
    for (late, again) in [(ms(50), true), (Span::ZERO, false)] {
        let mut played = Played::begun(begins_at_once(Everything));
        played.run_until(played.mission.acts[0].timing().unwrap().critical() - ms(40));
        let due = played.mission.acts[0].wakeup().unwrap();
        played.now = due + late;
        let named = played.mission.robots[0].requests.keys().next().cloned();
        let mut ended = response(&DeviceId::new("a").unwrap(), named.as_ref(), Status::Failed, played.now);
        ended.error = Some(ran_out());
        played.happens(Event::Received { robot: 0, message: Message::ControlResponse(ended) });
        let outcome = played.run_to_the_end();
        assert_eq!(outcome == Outcome::Done, again, "{late}: {outcome:?}");
        assert_eq!(played.mission.robots[0].has_failed(), !again, "{late}");
    }
}

#[test]
fn a_link_that_broke_while_the_act_was_withdrawn_is_made_again() {
    let mut played = accepts_late(0, downbeat_scripts::OnFailure::Without);
    played.mutes(2);
    played.is_withdrawn();
    played.run_until(played.now + ms(20));
    assert!(played.mission.robots[0].is_settled() && !played.mission.robots[2].is_settled());
    let reason = "closed".to_owned();
    played.happens(Event::LinkDown { robot: 0, loss: Loss::Closed, reason });
    assert!(!played.mission.robots[0].lost().unwrap().connecting, "it has confirmed its stop");
    played.mute.clear();
    // The mission waits for its patience to learn what became of the script of this robot.
    for _ in 0..8_000 {
        if played.mission.acts.first().is_some_and(|act| act.attempts() == 1) {
            break;
        }
        played.run_until(played.now + ms(1));
    }
    assert!(played.mission.robots[0].lost().unwrap().connecting);
}

#[test]
fn a_repetition_does_not_count_as_another_act() {
    let mut mission = begins_at_once(Everything);
    mission.options.acts_max = Some(1);
    let mut played = Played::begun(mission);
    played.is_withdrawn();
    assert_eq!(played.run_to_the_end(), Outcome::Done);
    assert_eq!(played.mission.options.acts_max, Some(1));
}

#[test]
fn a_lease_that_ends_while_this_machine_stalls_stops_no_other_act() {
    let mut played = Played::begun(waits_in(1));
    played.run_to_the_start();
    let failing = || vec![(0, FailureKind::Script { device: DeviceId::new("a").unwrap(), error: ran_out() })];
    assert!(!played.mission.may_be_prepared_again(1));
    let now = played.now + ms(100);
    played.mission.fail_of_act(now, 1, failing());
    assert!(played.mission.again.is_none() && played.mission.robots[0].has_failed());
}

fn ran_out() -> urrcp::ControlError {
    urrcp::ControlError::new(urrcp::ErrorCode::LinkLost, "the pending lease ended")
}
