//! Tests of acts that are prepared again because this machine was too slow to start them.

use downbeat_plan::OnFailure;

use super::played::Played;
use super::*;
use crate::bench::{ms, response};
use crate::{FixedStart, FixedStarts};

const LATE: Outcome = Outcome::DecisionLate { by: Span::from_millis(30) };

impl Played {
    /// Withdraws the last act under way.
    pub(super) fn is_withdrawn(&mut self) {
        let (now, number) = (self.now, self.mission.acts.last().unwrap().number());
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
fn act_withdrawn_before_any_motion_is_prepared_again_with_a_longer_lead() {
    for tells in [Everything, Tells::Reports, Tells::Answers] {
        let mut played = Played::begun(begins_at_once(tells));
        // Only the first attempt has additional time, because no round trip is known.
        let before = played.lead() - ms(500);
        played.is_withdrawn();
        played.run_until(played.now + ms(20));
        assert!(played.lead() > before + ms(60), "{tells:?}");
        assert_eq!(played.run_to_the_end(), Outcome::Done, "{tells:?}");
        assert_eq!(played.starts(), 2, "{tells:?}");
        let [report] = &*played.mission.course.reports.make_contiguous() else {
            panic!("one act was played")
        };
        assert_eq!((report.number.get(), report.prepared_again), (1, 1), "{tells:?}");
        let totals = &played.mission.robots[R0].totals;
        assert_eq!((totals.scripts, totals.steps_planned), (1, totals.steps_done), "{tells:?}");
        assert_eq!(played.mission.course.fates[ActIndex::new(0)].played, 1);
    }
}

#[test]
fn lead_grows_for_a_slower_machine_as_far_as_a_prescribed_lease_allows() {
    // The lead consists of three round trips, each longer by all or half of twice the delay of 30 ms, and of margins.
    for (pending, longer) in [(3_000, 180..260), (240, 90..130)] {
        let mut mission = begins_at_once(Everything);
        let act = &mut Arc::make_mut(&mut mission.choreography).acts[0];
        act.plan.stop_condition.pending = Some(urrcp::Millis::from_span(ms(pending)));
        let mut played = Played::begun(mission);
        let before = played.lead() - ms(500);
        played.is_withdrawn();
        played.run_until(played.now + ms(20));
        let by = (played.lead() - before).as_nanos() / 1_000_000;
        assert!(longer.contains(&by), "{by} ms longer, a pending lease of {pending} ms");
        assert_eq!(played.run_to_the_end(), Outcome::Done, "a pending lease of {pending} ms");
    }
}

#[test]
fn act_is_prepared_again_at_most_twice() {
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
fn act_prepared_again_does_not_repeat_its_wait() {
    let mut played = Played::begun(waits_in(0));
    played.happens(Event::Go { act: None, by: None });
    played.run_until(played.now + ms(20));
    played.is_withdrawn();
    played.run_until(played.now + ms(20));
    assert!(played.mission.acts[0].was_sent());
    assert_eq!(played.run_to_the_end(), Outcome::Done);
}

#[test]
fn act_with_an_exact_start_time_is_not_prepared_again() {
    let mut mission = begins_at_once(Everything);
    mission.options.fixed.operator = Some(FixedStart { act: ActIndex::new(0), at: at(1_000) });
    let mut played = Played::begun(mission);
    played.is_withdrawn();
    assert_eq!(played.run_to_the_end(), LATE);
}

/// A mission whose act has a fixed start at 2 s and is withdrawn shortly before. `within` is the permitted delay of the start in
/// milliseconds.
fn is_late_for_its_start(within: i64) -> Played {
    let mut mission = begins_at_once(Everything);
    let start = FixedStart { act: ActIndex::new(0), at: at(2_000) };
    mission.options.fixed = FixedStarts { operator: Some(start), within: ms(within) };
    let mut played = Played::begun(mission);
    played.run_until(at(1_995));
    played.is_withdrawn();
    played
}

#[test]
fn act_with_a_fixed_start_is_prepared_again_within_the_permitted_time() {
    let mut played = is_late_for_its_start(10_000);
    assert_eq!(played.run_to_the_end(), Outcome::Done);
    let mut played = is_late_for_its_start(1);
    let ended = played.run_to_the_end();
    assert!(matches!(ended, Outcome::StartTooSoon { start, .. } if start == at(2_000)), "{ended:?}");
}

#[test]
fn next_attempt_does_not_start_before_the_fixed_time() {
    let mut mission = begins_at_once(Everything);
    let start = FixedStart { act: ActIndex::new(0), at: at(5_000) };
    mission.options.fixed = FixedStarts { operator: Some(start), within: ms(1_000) };
    let mut played = Played::begun(mission);
    played.run_until(at(2_000));
    played.is_withdrawn();
    played.run_until(at(5_005));
    assert_eq!(played.mission.acts[0].attempts(), 1);
    assert_eq!(played.mission.acts[0].timing().map(|timing| timing.start), Some(at(5_000)));
    assert_eq!(played.run_to_the_end(), Outcome::Done);
}

#[test]
fn start_that_is_too_soon_is_moved_later_within_the_permitted_time() {
    let mut mission = begins_at_once(Everything);
    let start = FixedStart { act: ActIndex::new(0), at: at(1) };
    mission.options.fixed = FixedStarts { operator: Some(start), within: ms(5_000) };
    assert_eq!(Played::begun(mission).run_to_the_end(), Outcome::Done);
}

/// A mission with two acts. The first one plays, and the second one, which follows immediately, has been sent.
pub(super) fn chained(drops_undecided: bool) -> Played {
    let mut mission = waits_in(2);
    mission.robots[R0].block.as_mut().unwrap().pending_until = drops_undecided;
    let mut played = Played::begun(mission);
    played.run_to_the_start();
    assert!(played.mission.acts[1].was_sent() && !played.mission.acts[1].is_committed());
    played
}

/// A mission with two acts. The second act was withdrawn, and its robot has dropped it.
fn lapses() -> Played {
    let mut played = chained(true);
    played.is_withdrawn();
    assert!(played.mission.acts[1].is_lapsing());
    played.drops(&second(&played));
    played
}

/// The request id of the second act's script.
pub(super) fn second(played: &Played) -> RequestId {
    played.mission.acts[1].members()[MemberIndex::new(0)].scripts()[0].request_id().cloned().unwrap()
}

#[test]
fn queued_act_lapses_and_is_prepared_again_after_the_current_one_ends() {
    let mut played = lapses();
    let end = played.mission.acts[0].timing().unwrap().end;
    played.run_until(end);
    assert_eq!((played.stops(), played.starts()), (0, 2), "a stop would end the first act, too");
    assert_eq!(played.run_to_the_end(), Outcome::Done);
    assert_eq!((played.stops(), played.starts()), (1, 3));
    let again: Vec<_> = played.mission.course.reports.iter().map(|act| act.prepared_again).collect();
    assert_eq!(again, [0, 1]);
    let totals = &played.mission.robots[R0].totals;
    assert_eq!((totals.scripts, totals.steps_planned), (2, totals.steps_done));
    assert!(played.mission.course.fates.iter().all(|act| act.played == 1));
}

#[test]
fn robots_that_drop_a_lapsing_act_have_not_failed() {
    let mut played = lapses();
    let (device, id) = (DeviceId::new("a").unwrap(), second(&played));
    let mut dropped = response(&device, Some(&id), Status::Failed, played.now);
    dropped.error = Some(ran_out());
    played.happens(Event::Received { robot: R0, message: Message::ControlResponse(dropped) });
    assert!(!played.mission.robots[R0].has_failed());
    assert_eq!(played.run_to_the_end(), Outcome::Done);
}

#[test]
fn act_that_cannot_have_begun_is_withdrawn_even_if_a_robot_is_lost() {
    for (drops_undecided, second) in [(true, ActFate::Withdrawn), (false, ActFate::Stopped)] {
        let mut played = chained(drops_undecided);
        played.mutes(R0);
        let reason = "closed".to_owned();
        played.happens(Event::LinkDown { robot: R0, loss: Loss::Closed, reason });
        assert_eq!(played.run_to_the_end(), Outcome::Failed);
        let fates: Vec<_> = played.mission.course.fates.iter().map(|act| act.fate.clone()).collect();
        assert_eq!(fates, [ActFate::Stopped, second]);
    }
}

#[test]
fn stop_withdraws_a_lapsing_act() {
    let mut played = lapses();
    played.happens(Event::StopRequested { rest: Rest::InPlace, by: None });
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    assert_eq!(played.starts(), 2);
    let fates: Vec<_> = played.mission.course.fates.iter().map(|act| act.fate.clone()).collect();
    assert_eq!(fates, [ActFate::Stopped, ActFate::Withdrawn]);
}

#[test]
fn withdrawn_queued_act_stops_both_acts_if_a_robot_may_keep_it_longer() {
    let mut played = chained(false);
    played.is_withdrawn();
    assert_eq!(played.run_to_the_end(), Outcome::Failed);
    assert_eq!(played.starts(), 2);
}

#[test]
fn act_is_withdrawn_if_the_mission_ends_before_the_next_attempt() {
    let mut played = Played::begun(waits_in(0));
    played.mission.acts[0].is_attempted_again(1);
    played.happens(Event::StopRequested { rest: Rest::InPlace, by: None });
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    assert_eq!(played.starts(), 0);
    assert_eq!(played.mission.course.fates[ActIndex::new(0)].fate, ActFate::Withdrawn);
}

#[test]
fn operator_stop_prevents_further_preparation_attempts() {
    let mut played = Played::begun(begins_at_once(Everything));
    played.is_withdrawn();
    played.happens(Event::StopRequested { rest: Rest::InPlace, by: None });
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    assert_eq!(played.starts(), 1);
}

#[test]
fn stop_before_the_next_attempt_is_sent_only_if_robots_are_to_go_home() {
    for (rest, sent) in [(Rest::Home, 1), (Rest::InPlace, 0)] {
        let mut played = Played::begun(begins_at_once(Everything));
        played.is_withdrawn();
        // The stop is confirmed, and the next attempt is being written to disk.
        played.run_until(played.now + ms(1));
        assert!(!played.mission.acts[0].is_open() && played.mission.acts[0].attempts() == 1);
        let before = played.stops();
        played.happens(Event::StopRequested { rest, by: None });
        assert_eq!(played.run_to_the_end(), Outcome::Stopped);
        assert_eq!(played.stops() - before, sent, "{rest:?}");
        let confirmed = matches!(played.mission.robots[R0].halt.stop, Stop::Confirmed(Rest::Home));
        assert_eq!(confirmed, rest == Rest::Home);
    }
}

#[test]
fn act_is_not_prepared_again_if_a_robot_does_not_confirm_its_stop() {
    let mut played = Played::begun(begins_at_once(Everything));
    played.mutes(R0);
    played.is_withdrawn();
    assert_eq!(played.run_to_the_end(), LATE);
    assert_eq!(played.starts(), 1);
}

#[test]
fn act_begun_by_a_robot_is_not_prepared_again() {
    let mut played = Played::begun(one_act(Everything, 10_000));
    played.run_to_the_start();
    played.is_withdrawn();
    assert_eq!(played.run_to_the_end(), Outcome::Failed);
    assert_eq!(played.starts(), 1);
}

/// A mission with three robots. The first `silent` robots do not accept their scripts in time.
fn accepts_late(silent: usize, on_failure: OnFailure) -> Played {
    let scripts: [&[Planned]; 3] = [&[("a", 0, 400)]; 3];
    let mut choreography = choreography(&scripts);
    choreography.acts[0].on_failure.default = on_failure;
    let ids = ["r0", "r1", "r2"];
    let participant = |id: &str| Participant::new(RobotId::new(id).unwrap(), robot(id, Everything, 2).block);
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let mission = Mission::new(Arc::new(choreography), ids.map(participant).into(), options, at(0)).unwrap();
    Played::of(mission, (0..silent).map(RobotIndex::new).collect())
}

#[test]
fn machine_is_suspected_once_if_most_robots_do_not_accept_in_time() {
    let mut played = accepts_late(2, OnFailure::Without);
    while played.mission.acts[0].attempts() == 0 && played.mission.again.is_none() {
        played.run_until(played.now + ms(1));
    }
    played.mute.clear();
    assert_eq!(played.run_to_the_end(), Outcome::Done);
    assert!(played.mission.robots.iter().all(|robot| !robot.has_failed()));
}

#[test]
fn silent_robots_fail_even_if_they_are_the_majority() {
    let mut played = accepts_late(2, OnFailure::Without);
    assert_eq!(played.run_to_the_end(), Outcome::NotStarted);
    let failed: Vec<bool> = played.mission.robots.iter().map(RobotState::has_failed).collect();
    assert_eq!(failed, [true, true, false]);
}

#[test]
fn silent_robots_fail_at_second_attempt_or_at_third_if_all_are_silent() {
    for (silent, attempts) in [(3, 3), (2, 2)] {
        let mut played = accepts_late(silent, OnFailure::Without);
        let failed =
            |played: &Played| played.mission.robots.iter().filter(|robot| robot.has_failed()).count();
        while failed(&played) == 0 {
            // The silent robots answer only the stop of an attempt.
            let withdrawn = played.mission.again.is_some();
            played.mute = (0..silent).map(RobotIndex::new).filter(|_| !withdrawn).collect();
            played.run_until(played.now + ms(1));
        }
        let attempt = played.mission.acts[0].attempts() + 1;
        assert_eq!((failed(&played), attempt), (silent, attempts), "{silent} of 3 robots are silent");
    }
}

#[test]
fn single_robot_that_does_not_accept_in_time_is_left_out_at_once() {
    let mut played = accepts_late(1, OnFailure::Without);
    assert_eq!(played.run_to_the_end(), Outcome::DoneWithout);
    assert!(played.mission.course.reports.iter().all(|act| act.prepared_again == 0));
}

#[test]
fn leases_expired_during_a_machine_stall_are_no_robot_failures() {
    for (late, again) in [(ms(50), true), (Span::ZERO, false)] {
        let mut played = Played::begun(begins_at_once(Everything));
        played.run_until(played.mission.acts[0].timing().unwrap().critical() - ms(40));
        let due = played.mission.acts[0].wakeup().unwrap();
        played.now = due + late;
        let named = played.mission.robots[R0].requests.scripts().next().map(|(id, _)| id.clone());
        let mut ended = response(&DeviceId::new("a").unwrap(), named.as_ref(), Status::Failed, played.now);
        ended.error = Some(ran_out());
        played.happens(Event::Received { robot: R0, message: Message::ControlResponse(ended) });
        let outcome = played.run_to_the_end();
        assert_eq!(outcome == Outcome::Done, again, "{late}: {outcome:?}");
        assert_eq!(played.mission.robots[R0].has_failed(), !again, "{late}");
    }
}

#[test]
fn link_lost_while_an_act_is_withdrawn_is_reconnected() {
    let mut played = accepts_late(0, OnFailure::Without);
    played.mutes(R2);
    played.is_withdrawn();
    played.run_until(played.now + ms(20));
    assert!(played.mission.robots[R0].is_settled() && !played.mission.robots[R2].is_settled());
    let reason = "closed".to_owned();
    played.happens(Event::LinkDown { robot: R0, loss: Loss::Closed, reason });
    assert!(!played.mission.robots[R0].lost().unwrap().connecting, "it has confirmed its stop");
    played.mute.clear();
    // The mission waits for its patience to learn the fate of this robot's script.
    for _ in 0..8_000 {
        if played.mission.acts.first().is_some_and(|act| act.attempts() == 1) {
            break;
        }
        played.run_until(played.now + ms(1));
    }
    assert!(played.mission.robots[R0].lost().unwrap().connecting);
}

#[test]
fn repeated_attempt_does_not_count_as_another_act() {
    let mut mission = begins_at_once(Everything);
    mission.options.acts_max = Some(1);
    let mut played = Played::begun(mission);
    played.is_withdrawn();
    assert_eq!(played.run_to_the_end(), Outcome::Done);
    assert_eq!(played.mission.options.acts_max, Some(1));
}

#[test]
fn lease_that_ends_during_a_machine_stall_stops_no_other_act() {
    let mut played = chained(true);
    played.drops(&second(&played));
    let failing = vec![(R0, FailureKind::Script { device: DeviceId::new("a").unwrap(), error: ran_out() })];
    let now = played.mission.acts[1].wakeup().unwrap() + ms(50);
    played.mission.fail_of_act(now, ActNumber::new(1), failing);
    assert!(played.mission.acts[1].is_lapsing() && !played.mission.robots[R0].has_failed());
    assert_eq!(played.run_to_the_end(), Outcome::Done);
}

#[test]
fn expired_leases_and_silence_after_a_late_wake_up_are_excused() {
    let lease = || FailureKind::Script { device: DeviceId::new("a").unwrap(), error: ran_out() };
    let silence =
        || FailureKind::Silent { awaited: "word shortly before the start".to_owned(), within: ms(30) };
    for (late, policy, kind, repeated) in [
        (0, OnFailure::Stop, lease(), false),
        (30, OnFailure::Stop, lease(), true),
        (30, OnFailure::Without, lease(), true),
        (0, OnFailure::Stop, silence(), false),
        (30, OnFailure::Stop, silence(), true),
        (30, OnFailure::Without, silence(), false),
    ] {
        let mut mission = begins_at_once(Everything);
        Arc::make_mut(&mut mission.choreography).acts[0].on_failure.default = policy;
        let mut played = Played::begun(mission);
        played.now = played.mission.next_wakeup().unwrap() + ms(late);
        let actions = played.mission.advance(played.now);
        played.carry_out(actions);
        played.run_until(played.now + ms(2));
        let case = format!("{late} ms late, {policy:?}, {kind}");
        let number = played.mission.acts[0].number();
        played.mission.fail_of_act(played.now, number, vec![(R0, kind)]);
        let actions = played.mission.advance(played.now);
        played.carry_out(actions);
        let outcome = played.run_to_the_end();
        assert_eq!(
            (outcome == Outcome::Done, played.mission.course.repeated > 0),
            (repeated, repeated),
            "{case}"
        );
    }
}

fn ran_out() -> urrcp::ControlError {
    urrcp::ControlError::new(urrcp::ErrorCode::LinkLost, "the pending lease ended")
}

#[test]
fn leases_grow_with_the_lateness_of_the_machine() {
    let leases = |late: i64, prescribed: Option<Span>| {
        let mut choreography = choreography(&[&[("a", 0, 400)]]);
        choreography.acts[0].plan.stop_condition.pending = prescribed.map(urrcp::Millis::from_span);
        let participants =
            vec![Participant::new(RobotId::new("r0").unwrap(), robot("r0", Everything, 2).block)];
        let mut mission =
            Mission::new(Arc::new(choreography), participants, MissionOptions::default(), at(0)).unwrap();
        let _asks = mission.advance(at(0));
        let due = mission.next_wakeup().unwrap();
        let _late = mission.advance(due + ms(late));
        let mut played = Played::linked(mission, &[R0]);
        played.now = due + ms(late);
        played.run_until(played.now + ms(100));
        let timing = played.mission.acts[0].timing().expect("it is sent");
        (timing.lead.lease, timing.final_lease())
    };
    let (usual, least) = leases(0, None);
    let (longer, last) = leases(50, None);
    assert_eq!((longer - usual, last - least), (ms(100), ms(120)), "{usual}, {least}");
    let prescribed = Some(ms(300));
    assert_eq!(leases(50, prescribed), leases(0, prescribed), "the scenario decides");
}
