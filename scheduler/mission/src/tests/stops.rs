//! Stops: how they are sent and repeated, and their ids.

use urrcp::ControlRequest;

use super::played::Played;
use super::*;
use crate::bench::ms;

fn stops_in(actions: &[Action]) -> Vec<ControlRequest> {
    let stop = |action: &Action| match action {
        Action::Send { message: Message::ControlRequest(request), .. } => Some(request.clone()),
        _ => None,
    };
    actions.iter().filter_map(stop).collect()
}

fn asked_to_stop(mission: &mut Mission, now: i64, rest: Rest) -> Vec<ControlRequest> {
    stops_in(&mission.handle(at(now), Event::StopRequested { rest, by: None }))
}

fn sent() -> Mission {
    let mut mission = begins_at_once(Everything);
    let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    mission
}

#[test]
fn robot_stops_in_place_or_goes_home_as_the_operator_requests() {
    for (rest, holds) in [(Rest::Home, true), (Rest::InPlace, false)] {
        let stops = asked_to_stop(&mut sent(), 1, rest);
        assert_eq!(stops.iter().map(|stop| stop.home).collect::<Vec<_>>(), [holds], "{rest:?}");
    }
}

#[test]
fn latest_operator_command_applies_and_a_repeated_one_sends_nothing() {
    let mut mission = sent();
    assert_eq!(asked_to_stop(&mut mission, 1, Rest::InPlace).len(), 1);
    assert_eq!(asked_to_stop(&mut mission, 2, Rest::InPlace).len(), 0);
    let stops = asked_to_stop(&mut mission, 3, Rest::Home);
    assert_eq!(stops.iter().map(|stop| stop.home).collect::<Vec<_>>(), [true]);
}

#[test]
fn unconfirmed_stop_is_resent_and_given_up_when_patience_ends() {
    let mut mission = sent();
    let first = asked_to_stop(&mut mission, 1, Rest::InPlace);
    let (again, ends) = (at(201), at(1) + mission.options.patience);
    assert_eq!(mission.next_wakeup(), Some(again));
    assert_eq!(mission.advance(again - Span::from_nanos(1)).len(), 0);
    assert_eq!(stops_in(&mission.advance(again)), first, "the same request");
    assert_eq!(mission.robots[R0].totals.retries, 1);
    assert_eq!(mission.next_wakeup(), Some(at(401)));
    let _ended = mission.advance(ends);
    assert!(mission.outcome().is_some());
}

/// A mission with one act of two robots, `before_brink` ahead of the brink (the last instant at which the start can be cancelled). The
/// second robot is silent during the last rounds.
fn awaits_word(before_brink: Span) -> Played {
    let scripts: [&[Planned]; 2] = [&[("a", 0, 400)]; 2];
    let participant = |id: &str| Participant::new(RobotId::new(id).unwrap(), robot(id, Everything, 2).block);
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let participants = ["r0", "r1"].map(participant).to_vec();
    let mission = Mission::new(Arc::new(choreography(&scripts)), participants, options, at(0)).unwrap();
    let mut played = Played::begun(mission);
    let timing = played.mission.acts[0].timing().unwrap().clone();
    played.run_until(timing.critical() - ms(30));
    played.mutes(R1);
    played.run_until(timing.brink() - before_brink);
    assert!(!played.mission.acts[0].is_committed() && played.now >= timing.critical());
    played
}

#[test]
fn stop_is_sent_at_once_while_other_messages_await_the_commitment() {
    for by_operator in [true, false] {
        let mut played = awaits_word(ms(14));
        let (now, mission) = (played.now, &mut played.mission);
        mission.read(
            now,
            R0,
            "b".parse().unwrap(),
            super::super::robot_state::Reading::Wait(ActNumber::new(0)),
        );
        assert!(
            mission.outbox.actions.is_empty() && mission.outbox.deferred.len() == 1,
            "it waits for the commitment"
        );
        let actions = if by_operator {
            mission.handle(now, Event::StopRequested { rest: Rest::InPlace, by: None })
        } else {
            mission.fail(now, R0, super::course::broken());
            std::mem::take(&mut mission.outbox.actions)
        };
        let urgent = |action: &Action| match action {
            Action::Send { robot, urgent: true, .. } => Some(*robot),
            _ => None,
        };
        assert_eq!(actions.iter().filter_map(urgent).collect::<Vec<_>>(), [R0, R1], "{by_operator}");
        assert_eq!(stops_in(&actions).len(), 2, "{by_operator}: the reading is not sent");
    }
}

#[test]
fn stop_on_a_slow_link_has_three_round_trips_to_be_confirmed() {
    let mut mission = sent();
    let there = by_robot(at(100));
    mission.robots[R0].clock.add(ClockSample::from_exchange(at(0), there, there, at(200)));
    let _stops = asked_to_stop(&mut mission, 300, Rest::InPlace);
    assert_eq!(mission.next_wakeup(), Some(at(900)));
}

#[test]
fn stop_ids_begin_with_the_session() {
    for (session, begin) in [(None, "stop/"), (Some("show"), "show/stop/")] {
        let mut mission = begins_at_once(Everything);
        mission.options.session = session.map(|name| Session::named(name.parse().unwrap()));
        let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
        let stops = asked_to_stop(&mut mission, 1, Rest::InPlace);
        let name = stops[0].request_id.as_ref().unwrap().as_str();
        assert!(name.starts_with(begin), "{name}");
        assert_eq!(stops[0].timestamp, Some(at(1)), "earlier requests are withdrawn");
    }
}

#[test]
fn robot_is_stopped_again_only_if_the_kind_of_stop_differs() {
    let mut mission = sent();
    let otherwise =
        |mission: &Mission| [Rest::InPlace, Rest::Home].map(|rest| mission.robots[R0].stops_otherwise(rest));
    assert_eq!(otherwise(&mission), [false, true], "a robot that came to rest earlier still goes home");
    mission.stop_robot(at(1), R0, Rest::Home);
    assert_eq!(otherwise(&mission), [true, false]);
    mission.robots[R0].set_stop(Stop::Confirmed(Rest::InPlace));
    assert_eq!(otherwise(&mission), [false, true]);
}

#[test]
fn stop_after_a_failure_lasts_until_the_operator_overrides_it() {
    let mut mission = sent();
    mission.abort(at(1), Outcome::Failed, Rest::InPlace, Some(ActIndex::new(0)));
    assert_eq!(stops_in(&std::mem::take(&mut mission.outbox.actions)).len(), 1);
    assert_eq!(mission.course.then, Some(ActIndex::new(0)));
    assert_eq!(asked_to_stop(&mut mission, 2, Rest::InPlace).len(), 0);
    assert_eq!(
        (mission.course.then, mission.conclusion.outcome.clone()),
        (None, Some(Outcome::Stopped)),
        "nothing follows"
    );
    let _ends = mission.advance(at(1) + mission.options.patience + ms(1));
    assert_eq!(mission.outcome(), Some(&Outcome::Stopped));

    let mut mission = sent();
    mission.abort(at(1), Outcome::Failed, Rest::Home, None);
    mission.outbox.actions.clear();
    let stops = asked_to_stop(&mut mission, 2, Rest::InPlace);
    assert_eq!(
        stops.iter().map(|stop| stop.home).collect::<Vec<_>>(),
        [false],
        "on the move to the default positions"
    );
}

#[test]
fn lost_journal_stops_the_mission_and_no_act_follows_a_stop() {
    let lost = || Event::JournalLost { reason: "full".to_owned() };
    let mut mission = begins_at_once(Everything);
    let _refused = mission.handle(at(0), lost());
    assert!(matches!(mission.outcome(), Some(Outcome::JournalLost { .. })), "{:?}", mission.outcome());

    let mut mission = sent();
    assert_eq!(stops_in(&mission.handle(at(1), lost())).len(), 1);
    assert!(matches!(mission.conclusion.outcome, Some(Outcome::JournalLost { .. })));

    let mut mission = sent();
    mission.abort(at(1), Outcome::Failed, Rest::Home, Some(ActIndex::new(0)));
    let _told = mission.handle(at(2), lost());
    assert_eq!(mission.course.then, None);
}

#[test]
fn robot_with_confirmed_stop_is_at_rest_and_this_is_recorded() {
    let mut played = Played::begun(one_act(Everything, 10_000));
    played.run_to_the_start();
    let by = Some("anna".to_owned());
    played.happens(Event::StopRequested { rest: Rest::InPlace, by });
    assert_eq!(played.mission.because(), Some("stopped by anna"));
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    assert!(
        played.told.iter().any(|told| matches!(told, Progress::AtRest { robot } if robot.as_str() == "r0"))
    );
    let confirmed = |record: &Record| matches!(record, Record::StopConfirmed { .. });
    assert_eq!(played.recorded.iter().filter(|record| confirmed(record)).count(), 1);
}

#[test]
fn stop_request_after_the_end_changes_nothing() {
    let mut played = Played::begun(begins_at_once(Everything));
    assert_eq!(played.run_to_the_end(), Outcome::Done);
    let by = Some("anna".to_owned());
    played.happens(Event::StopRequested { rest: Rest::InPlace, by });
    assert_eq!((played.mission.because(), played.mission.outcome()), (None, Some(&Outcome::Done)));
}

#[test]
fn robot_not_reached_by_its_stop_is_reported_once_with_the_reason() {
    let mut played = Played::begun(one_act(Everything, 10_000));
    played.run_to_the_start();
    played.mutes(R0);
    played.happens(Event::StopRequested { rest: Rest::InPlace, by: None });
    let down = || Event::LinkDown { robot: R0, loss: Loss::Unreachable, reason: "no route".to_owned() };
    played.happens(down());
    assert!(!played.mission.robots[R0].has_failed(), "it may still be reached");
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    let kinds: Vec<_> =
        played.mission.robots[R0].failures.iter().map(|failure| failure.kind.clone()).collect();
    assert_eq!(kinds, [FailureKind::LinkDown { reason: "no route".to_owned() }]);
}

#[test]
fn robot_that_does_not_confirm_its_stop_on_a_working_link_has_not_failed() {
    let mut played = Played::begun(one_act(Everything, 10_000));
    played.run_to_the_start();
    played.mutes(R0);
    played.happens(Event::StopRequested { rest: Rest::InPlace, by: None });
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    assert!(!played.mission.robots[R0].has_failed() && played.mission.robots[R0].awaits_stop());
}

#[test]
fn reattached_robot_is_not_reported_while_the_mission_stops() {
    let mut played = Played::begun(one_act(Everything, 10_000));
    played.run_to_the_start();
    played.mutes(R0);
    played.happens(Event::StopRequested { rest: Rest::InPlace, by: None });
    played.happens(Event::LinkDown { robot: R0, loss: Loss::Closed, reason: "it broke".to_owned() });
    played.mute.clear();
    played.happens(Event::LinkUp { robot: R0 });
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    assert!(!played.told.iter().any(|told| matches!(told, Progress::Reattached { .. })));
    assert!(played.mission.robots[R0].is_settled(), "its stop came with the new link");
}

#[test]
fn scripts_left_by_another_process_are_withdrawn_once_links_are_up() {
    let left = crate::LeftOn {
        devices: ["a", "b"].map(|device| device.parse().unwrap()).into(),
        shift: ms(7),
        leases: vec![Some(urrcp::Millis::from_span(ms(2_000))), None],
    };
    for (until, renewed) in [(Some(at(-500)), at(-500)), (None, at(0)), (Some(at(500)), at(0))] {
        for (leases, expected) in
            [(left.leases.clone(), vec![Some(renewed + ms(2_000)), None]), (Vec::new(), vec![Some(renewed)])]
        {
            let left = crate::Left {
                robots: [("r0".parse().unwrap(), crate::LeftOn { leases, ..left.clone() })].into(),
                own_ids: [("r0".parse().unwrap(), "UR5-1".parse().unwrap())].into(),
                renewed_until: until,
                ..Default::default()
            };
            let participants =
                vec![Participant::new(RobotId::new("r0").unwrap(), robot("r0", Everything, 2).block)];
            let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
            let cause = Cause { outcome: Outcome::Stopped, reason: "why".to_owned() };
            let mut mission =
                Mission::withdraw("s".to_owned(), participants, options, &left, cause, Rest::Home, at(0));
            assert_eq!(mission.robots[R0].identity.own_id.as_str(), "UR5-1");
            assert_eq!(mission.robots[R0].halt.left, expected);
            let stops = stops_in(&mission.handle(at(1), Event::LinkUp { robot: R0 }));
            let devices: Vec<_> = stops.iter().map(|stop| stop.device_id.as_str()).collect();
            assert_eq!(devices, ["a", "b"]);
            assert!(stops.iter().all(|stop| stop.home && stop.timestamp == Some(at(0) + ms(7))));
        }
    }
}

#[test]
fn script_end_without_id_does_not_confirm_stop_of_a_withdrawn_mission() {
    let on = crate::LeftOn { devices: ["a".parse().unwrap()].into(), ..Default::default() };
    let left = crate::Left { robots: [("r0".parse().unwrap(), on)].into(), ..Default::default() };
    let participants = vec![Participant::new("r0".parse().unwrap(), robot("r0", Tells::Reports, 2).block)];
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let cause = Cause { outcome: Outcome::Stopped, reason: "why".to_owned() };
    let mut mission =
        Mission::withdraw("s".to_owned(), participants, options, &left, cause, Rest::InPlace, at(0));
    assert_eq!(stops_in(&mission.handle(at(1), Event::LinkUp { robot: R0 })).len(), 1);
    let ok = super::super::bench::response(&"a".parse().unwrap(), None, Status::Ok, at(3));
    let ended = urrcp::ControlResponse { status_value: urrcp::StatusValue::Number(45.0), ..ok.clone() };
    for (answer, awaits) in [(ended, true), (ok, false)] {
        let message = Message::ControlResponse(answer);
        let _noted = mission.handle(at(4), Event::Received { robot: R0, message });
        assert_eq!(mission.robots[R0].awaits_stop(), awaits);
    }
}

#[test]
fn end_without_id_after_a_stop_may_belong_to_the_script_or_the_stop() {
    let last_value = urrcp::StatusValue::Number(45.0);
    for (status_value, steps_done, completed) in [
        (urrcp::StatusValue::Null, None, false),
        (urrcp::StatusValue::Null, Some(2), true),
        (last_value, None, true),
    ] {
        let mut played = Played::begun(begins_at_once(Tells::Reports));
        played.run_to_the_start();
        played.mutes(R0);
        let end = played.mission.acts[0].timing().unwrap().end;
        played.run_until(end + ms(5));
        played.happens(Event::StopRequested { rest: Rest::InPlace, by: None });
        let ended = super::super::bench::response(&"a".parse().unwrap(), None, Status::Ok, played.now);
        let ended = urrcp::ControlResponse { status_value, steps_done, ..ended };
        played.now = played.now + ms(1);
        played.happens(Event::Received { robot: R0, message: Message::ControlResponse(ended) });
        let act = &played.mission.acts[0];
        let script = act.script(ScriptRef { act: ActNumber::new(0), member: MemberIndex::new(0), script: 0 });
        assert_eq!((script.has_completed(), script.is_out()), (completed, false), "{steps_done:?}");
        assert!(played.mission.robots[R0].awaits_stop(), "it confirms no stop");
    }
}

#[test]
fn robot_taken_over_by_another_session_is_stopped_only_by_the_operator() {
    for by_operator in [true, false] {
        let mut mission = sent();
        let stops = if by_operator {
            asked_to_stop(&mut mission, 1, Rest::InPlace)
        } else {
            mission.abort(at(1), Outcome::Failed, Rest::InPlace, None);
            stops_in(&std::mem::take(&mut mission.outbox.actions))
        };
        for _ in 0..2 {
            let refused = urrcp::ControlResponse {
                error: super::super::bench::refusal(ErrorCode::Busy),
                ..super::super::bench::response(
                    &stops[0].device_id,
                    stops[0].request_id.as_ref(),
                    Status::Failed,
                    at(2),
                )
            };
            let message = Message::ControlResponse(refused);
            let _noted = mission.handle(at(2), Event::Received { robot: R0, message });
        }
        let kinds: Vec<_> = mission.robots[R0].failures.iter().map(|failure| failure.kind.clone()).collect();
        assert!(matches!(kinds.as_slice(), [FailureKind::NotAvailable { .. }]), "{kinds:?}");
        assert_eq!(mission.robots[R0].is_left_to_others(), !by_operator);
        assert_eq!(mission.outcome().is_some(), !by_operator, "it is not waited for");
    }
}

#[test]
fn failure_without_id_after_a_stop_belongs_to_the_script_it_ended() {
    let mut played = Played::begun(begins_at_once(Tells::Reports));
    played.run_to_the_start();
    played.mutes(R0);
    played.happens(Event::StopRequested { rest: Rest::InPlace, by: None });
    let failed = urrcp::ControlResponse {
        error: super::super::bench::refusal(ErrorCode::Cancelled),
        steps_done: Some(1),
        ..super::super::bench::response(&"a".parse().unwrap(), None, Status::Failed, played.now)
    };
    played.happens(Event::Received { robot: R0, message: Message::ControlResponse(failed) });
    let script = played.mission.acts[0].script(ScriptRef {
        act: ActNumber::new(0),
        member: MemberIndex::new(0),
        script: 0,
    });
    assert!(script.is_final() && script.steps_done() == 1, "{:?}", script.state());
    assert!(played.mission.robots[R0].awaits_stop(), "it confirms no stop");
}
