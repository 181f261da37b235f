//! Tests of the identity of robots, repeated questions, and robots of other sessions.

use downbeat_plan::AllOrNone;
use urrcp::{AvailabilityResponse, ControlError};

use super::played::Played;
use super::*;
use crate::bench::Tells::Reports;
use crate::bench::ms;
use crate::poses::Expected;
use crate::seize::Ownership;

fn asks(actions: &[Action]) -> usize {
    let asks = |action: &&Action| {
        matches!(action, Action::Send { message: Message::AvailabilityRequest(_) | Message::Inquiry(_), .. })
    };
    actions.iter().filter(asks).count()
}

#[test]
fn without_greeting_any_message_is_attributed_to_the_expected_robot() {
    let response = AvailabilityResponse {
        originate_timestamp: None,
        receive_timestamp: by_robot(at(1)),
        timestamp: by_robot(at(1)),
        status: Status::Ok,
        error: None,
        revocation_list: None,
    };
    let message = Message::AvailabilityResponse(response);
    for (greeting, up, counts) in
        [(Greeting::Skip, false, true), (Greeting::Full, false, false), (Greeting::Full, true, true)]
    {
        let mut mission = begins_at_once(Everything);
        mission.options.greeting = greeting;
        mission.robots[R0].connected(at(0));
        if up {
            mission.robots[R0].named();
        }
        assert_eq!(mission.is_expected_robot(at(1), R0, &message), counts, "{greeting:?}, named: {up}");
    }
}

#[test]
fn strict_scenario_refuses_a_robot_that_could_start_undecided_scripts() {
    let strict = Some(AllOrNone::Strict);
    for (tells, all_or_none, refused) in
        [(Everything, strict, false), (Reports, strict, true), (Reports, None, false)]
    {
        let mut mission = begins_at_once(tells);
        Arc::make_mut(&mut mission.choreography).requirements.all_or_none = all_or_none;
        mission.options.greeting = Greeting::Full;
        let block = robot("r0", tells, 2).block.unwrap();
        mission.introduced(at(0), R0, block);
        assert_eq!(mission.robots[R0].has_failed(), refused, "{tells:?} {all_or_none:?}");
        let checks = &preflight::table(&mission, at(0)).rows[0].checks;
        let warned = checks
            .iter()
            .any(|(_, verdict)| matches!(verdict, Verdict::Warning(why) if why.contains("pending_until")));
        assert_eq!(warned, tells == Reports && !refused, "{tells:?} {all_or_none:?}");
    }
}

#[test]
fn robot_that_sends_an_error_instead_of_its_name_is_not_awaited() {
    let mut mission = begins_at_once(Everything);
    mission.options.greeting = Greeting::Full;
    mission.robots[R0].connected(at(0));
    let error = ControlError::new(ErrorCode::Internal, "battery is empty");
    let response = AvailabilityResponse {
        originate_timestamp: None,
        receive_timestamp: by_robot(at(1)),
        timestamp: by_robot(at(1)),
        status: Status::Failed,
        error: Some(error.clone()),
        revocation_list: None,
    };
    mission.receive(at(1), R0, Message::AvailabilityResponse(response));
    let kinds: Vec<_> = mission.robots[R0].failures.iter().map(|failure| failure.kind.clone()).collect();
    assert_eq!(kinds, [FailureKind::NotAvailable { error }]);
}

#[test]
fn pending_request_is_repeated_after_three_round_trips_and_a_margin() {
    let mut mission = greets_a_clock(0, 40);
    mission.robots[R0].connected(at(0));
    mission.robots[R0].named();
    mission.robots[R0].contact.questions.asked(at(100));
    let again = at(100) + ms(3 * 40 + 20);
    mission.ask_further(again - Span::from_nanos(1), R0);
    assert_eq!(asks(&std::mem::take(&mut mission.outbox.actions)), 0);
    mission.ask_further(again, R0);
    assert_eq!(asks(&std::mem::take(&mut mission.outbox.actions)), 1);
}

/// A mission whose robot has proven its identity, and may be taken over from another session.
fn may_seize() -> Mission {
    let mut mission = begins_at_once(Everything);
    mission.options.greeting = Greeting::Full;
    mission.options.seize = true;
    mission.robots[R0].identity.proven = true;
    mission.robots[R0].connected(at(0));
    mission.robots[R0].named();
    mission
}

fn busy() -> ControlError {
    ControlError::new(ErrorCode::Busy, "it belongs to `other`")
}

#[test]
fn only_proven_robots_never_ours_are_seized_from_another_session() {
    type Change = fn(&mut Mission);
    let changes: [(&str, Change); 5] = [
        ("the operator does not want it", |mission| mission.options.seize = false),
        ("it has not proven who it is", |mission| mission.robots[R0].identity.proven = false),
        ("it was ours", |mission| mission.robots[R0].identity.ownership = Ownership::Seized),
        ("it has answered", |mission| {
            let there = by_robot(at(1));
            mission.robots[R0].clock.add(ClockSample::from_exchange(at(0), there, there, at(2)));
        }),
        ("the mission has begun", |mission| mission.phase = Phase::Performing),
    ];
    for (why, change) in changes {
        let mut mission = may_seize();
        change(&mut mission);
        assert!(!mission.is_to_be_seized(R0, &busy()) && !mission.robots[R0].is_of_another(), "{why}");
    }
    let internal = ControlError::new(ErrorCode::Internal, "its hardware is away");
    assert!(!may_seize().is_to_be_seized(R0, &internal));
    let mut mission = may_seize();
    assert!(mission.is_to_be_seized(R0, &busy()) && mission.robots[R0].is_of_another());
}

#[test]
fn robot_of_another_session_is_seized_unless_a_robot_has_failed() {
    for fails in [false, true] {
        let mut mission = may_seize();
        assert!(!mission.seize_others(at(1)), "it belongs to nobody");
        assert!(mission.is_to_be_seized(R0, &busy()));
        mission.robots[R0].pose.read = vec![("a".parse().unwrap(), 1.0)];
        if fails {
            mission.note_failure(R0, FailureKind::Garbled { reason: "x".into() });
        }
        assert_eq!(mission.seize_others(at(1)), !fails);
        if fails {
            assert_eq!(mission.robots[R0].identity.ownership, Ownership::Asked);
            let busy = FailureKind::NotAvailable { error: busy() };
            assert_eq!(mission.robots[R0].failures.last().map(|failure| &failure.kind), Some(&busy));
            continue;
        }
        assert_eq!(mission.robots[R0].identity.ownership, Ownership::Seizing);
        assert_eq!(mission.robots[R0].pose.read, [], "where it stood while it was another's");
        let seizes = |action: &Action| matches!(action, Action::Send { message: Message::AvailabilityRequest(asked), .. } if asked.seize);
        assert!(mission.outbox.actions.iter().any(seizes));
        mission.is_ours(at(2), R0);
        assert_eq!(mission.robots[R0].identity.ownership, Ownership::Seized);
    }
}

#[test]
fn robot_that_became_free_meanwhile_is_asked_and_not_seized() {
    let mut mission = may_seize();
    assert!(mission.is_to_be_seized(R0, &busy()));
    mission.is_ours(at(1), R0);
    assert_eq!(mission.robots[R0].identity.ownership, Ownership::Asked);
}

/// A mission with a robot whose device `a` declares that it can report its position. The first keyframe of `a` is at 45.
fn tells_where_it_stands() -> Mission {
    let mut mission = may_seize();
    let text = serde_json::to_string(mission.robots[R0].block.as_ref().unwrap()).unwrap().replacen(
        "\"available_control_types\":{",
        "\"available_control_types\":{\"sensor\":{\"min_value\":0,\"max_value\":90},",
        1,
    );
    let mut block: urrcp::InitializationBlock = serde_json::from_str(&text).unwrap();
    block.devices[0].interpolation = urrcp::Interpolation::Linear;
    mission.robots[R0].block = Some(block);
    mission
}

#[test]
fn only_a_seized_robot_out_of_place_is_read_again_one_reading_at_a_time() {
    for (ownership, stands, reads) in
        [(Ownership::Seized, 10.0, 1), (Ownership::Seized, 45.0, 0), (Ownership::Asked, 10.0, 0)]
    {
        let mut mission = tells_where_it_stands();
        mission.robots[R0].identity.ownership = ownership.clone();
        mission.robots[R0].pose.read = vec![("a".parse().unwrap(), stands)];
        mission.follow_on_its_way(at(1), R0);
        assert_eq!(
            mission.robots[R0].requests.awaited_readings().count(),
            reads,
            "{ownership:?} at {stands}"
        );
        assert_eq!(mission.robots[R0].pose.read.len(), 1 - reads);
        mission.robots[R0].pose.read = vec![("a".parse().unwrap(), stands)];
        mission.follow_on_its_way(at(2), R0);
        assert_eq!(mission.robots[R0].requests.awaited_readings().count(), reads, "its answer is awaited");
    }
}

#[test]
fn seized_robot_that_still_moves_is_read_again_for_at_most_four_seconds() {
    for (arrives, outcome) in [(None, Outcome::NotStarted), (Some(at(3_900)), Outcome::Done)] {
        let mut mission = may_seize();
        mission.robots[R0].block.as_mut().unwrap().devices[0].interpolation = urrcp::Interpolation::Linear;
        mission.robots[R0].identity.ownership = Ownership::Seizing;
        let mut played = Played::linked(mission, &[R0]);
        played.positions = [("a".parse().unwrap(), 10.0)].into();
        if let Some(arrives) = arrives {
            played.run_until(arrives);
            played.positions = [("a".parse().unwrap(), 45.0)].into();
        }
        assert_eq!(played.run_to_the_end(), outcome);
        let reads =
            |message: &Message| matches!(message, Message::Inquiry(asked) if !asked.devices.is_empty());
        let read = played.sent.iter().filter(|(.., message)| reads(message)).map(|(at, ..)| *at);
        let (first, last) = (read.clone().min().unwrap(), read.max().unwrap());
        let still_moves = played.mission.robots[R0].failures.iter().any(
            |failure| matches!(&failure.kind, FailureKind::Position { reading, .. } if *reading == 10.0),
        );
        assert_eq!(still_moves, arrives.is_none());
        assert!(last - first > ms(3_850) && last - first <= ms(4_000), "{first} to {last}");
    }
}

fn asked() -> Mission {
    let mut mission = begins_at_once(Everything);
    mission.options.greeting = Greeting::Full;
    mission
}

/// Adds `count` exchanges of timestamps with the robot.
fn answers_times(mission: &mut Mission, count: i64) {
    for exchange in 0..count {
        let there = by_robot(at(exchange * 10 + 1));
        let sample = ClockSample::from_exchange(at(exchange * 10), there, there, at(exchange * 10 + 2));
        mission.robots[R0].clock.add(sample);
    }
}

#[test]
fn robots_are_asked_for_name_and_eight_clock_samples_before_any_script() {
    let mut played = Played::begun(asked());
    assert_eq!(played.run_to_the_end(), Outcome::Done);
    let first = played.sent.iter().position(|(.., message)| matches!(message, Message::ControlRequest(_)));
    let before = &played.sent[..first.unwrap()];
    let asks = |message: &Message| matches!(message, Message::AvailabilityRequest(_) | Message::Inquiry(_));
    // One of these messages asks for positions.
    assert_eq!(before.iter().filter(|(.., message)| asks(message)).count(), 9);
    let positions =
        |message: &Message| matches!(message, Message::Inquiry(inquiry) if !inquiry.devices.is_empty());
    assert!(before.iter().any(|(.., message)| positions(message)));
    assert!(matches!(before[0].2, Message::InitializationRequest(_)));
    let greeted = played.told.iter().find_map(|told| match told {
        Progress::Greeted { clock_offset_max, preflight } => Some((*clock_offset_max, preflight.clone())),
        _ => None,
    });
    let (offset, preflight) = greeted.unwrap();
    assert!(offset.unwrap() < Span::from_micros(1), "{offset:?}");
    let failed =
        |(_, verdict): &(Check, Verdict)| matches!(verdict, Verdict::Failure(_) | Verdict::Warning(_));
    assert!(!preflight.rows[0].checks.iter().any(failed), "{preflight:?}");
    assert!(played.recorded.iter().any(|record| matches!(record, Record::Checked)));
}

/// Makes three exchanges with round trips of four seconds each, before anything is played.
fn was_slow(mission: &mut Mission) {
    for sent in [-15_000, -10_000, -5_000].map(at) {
        let there = by_robot(sent + ms(2_000));
        mission.robots[R0].clock.add(ClockSample::from_exchange(sent, there, there, sent + ms(4_000)));
    }
}

#[test]
fn robot_that_was_slow_while_others_connected_is_measured_further() {
    let mut mission = asked();
    was_slow(&mut mission);
    let mut played = Played::begun(mission);
    assert_eq!(played.run_to_the_end(), Outcome::Done);
}

#[test]
fn slow_robot_is_measured_for_four_more_seconds_and_then_refused() {
    let mut mission = asked();
    was_slow(&mut mission);
    for (now, goes_on) in [(0, true), (3_960, true), (3_980, false)] {
        // While it samples, the mission asks again every 20 ms.
        if let Some((_, next)) = &mut mission.greeting.sampling {
            *next = at(now) + ms(20);
        }
        assert_eq!(mission.still_sampling(at(now)), goes_on, "{now}");
    }
    mission.check_links();
    let slow = |failure: &Failure| matches!(failure.kind, FailureKind::TooSlow { .. });
    assert!(mission.robots[R0].failures.iter().any(slow));
}

#[test]
fn preflight_ends_once_the_fleet_is_checked() {
    for (fails, outcome) in [(false, Outcome::Ready), (true, Outcome::NotReady)] {
        let mut mission = asked();
        mission.options.preflight_only = true;
        let mut played = Played::of(mission, if fails { vec![R0] } else { Vec::new() });
        assert_eq!(played.run_to_the_end(), outcome);
        let moved = |(.., message): &(Timestamp<Server>, RobotIndex, Message)| {
            matches!(message, Message::ControlRequest(_))
        };
        assert!(!played.sent.iter().any(moved));
    }
}

#[test]
fn robot_failure_during_greeting_keeps_the_mission_from_starting() {
    let mut mission = asked();
    let _asks = mission.handle(at(0), Event::LinkUp { robot: R0 });
    mission.fail(at(1), R0, FailureKind::Garbled { reason: "x".into() });
    assert_eq!(mission.outcome(), Some(&Outcome::NotStarted));
}

#[test]
fn greeting_timeout_names_the_missing_step() {
    type Reached = fn(&mut Mission);
    let reached: [(Reached, Option<&str>); 6] = [
        (|_| {}, Some("connection")),
        (|mission| mission.robots[R0].connected(at(0)), Some("initialization block")),
        (|mission| _ = mission.robots[R0].named(), Some("availability response")),
        (|mission| answers_times(mission, 7), Some("further availability responses")),
        (
            |mission| {
                answers_times(mission, 1);
                mission.read(
                    at(100),
                    R0,
                    "a".parse().unwrap(),
                    super::super::robot_state::Reading::Wait(ActNumber::new(0)),
                );
            },
            Some("readings of its sensors"),
        ),
        (|mission| mission.robots[R0].requests.clear_readings(), None),
    ];
    for count in 1..=reached.len() {
        let mut mission = asked();
        reached[..count].iter().for_each(|(reach, _)| reach(&mut mission));
        mission.greeting_overdue(at(5_000));
        let kinds =
            mission.robots[R0].failures.iter().map(|failure| failure.kind.clone()).collect::<Vec<_>>();
        let within = mission.options.patience;
        let expected =
            reached[count - 1].1.map(|awaited| FailureKind::Silent { awaited: awaited.to_owned(), within });
        assert_eq!(kinds, expected.into_iter().collect::<Vec<_>>());
    }
}

#[test]
fn ignored_responses_are_reported_for_a_robot_that_seems_silent() {
    let mut mission = asked();
    mission.robots[R0].connected(at(0));
    mission.robots[R0].named();
    mission.robots[R0].contact.exchanges.ignore();
    mission.greeting_overdue(at(5_000));
    let text = mission.robots[R0].failures[0].kind.to_string();
    assert!(text.contains("availability response (answers ignored because they match no request or have impossible times: 1)"), "{text}");
}

/// A mission of two robots whose act repeats forever, played by the robots that are available. The second robot is missing at first.
fn waits_for_nobody(greeting: Greeting) -> Played {
    let mut choreography = choreography(&[&[("a", 0, 400)], &[("a", 0, 400)]]);
    choreography.acts[0].next = Way::Act(0);
    choreography.acts[0].wait = Wait::Done;
    begun_without_the_second(choreography, greeting)
}

/// A mission of two robots. The second one is missing at first.
fn begun_without_the_second(choreography: Choreography, greeting: Greeting) -> Played {
    let participant = |id: &str| Participant::new(RobotId::new(id).unwrap(), robot(id, Everything, 2).block);
    let participants = vec![participant("r0"), participant("r1")];
    let options = MissionOptions { greeting, join: Join::NextAct, ..MissionOptions::default() };
    let mission = Mission::new(Arc::new(choreography), participants, options, at(0)).unwrap();
    let mut played = Played::linked(mission, &[R0]);
    played.happens(Event::LinkDown { robot: R1, loss: Loss::Unreachable, reason: "off".to_owned() });
    played.run_until(at(1_000));
    played
}

#[test]
fn late_robot_joins_the_acts_not_yet_sent() {
    for greeting in [Greeting::Full, Greeting::Skip] {
        let mut played = waits_for_nobody(greeting);
        assert_eq!(played.mission.robots[R1].standing, Standing::Absent);
        assert_eq!(played.mission.phase, Phase::Performing, "{greeting:?}");
        played.happens(Event::LinkUp { robot: R1 });
        played.run_until(at(5_000));
        assert_eq!(played.mission.robots[R1].standing, Standing::In, "{greeting:?}");
        assert!(played.mission.robots[R1].totals.started > 0, "{greeting:?}");
        let told = played.told.iter().filter(|told| matches!(told, Progress::Reattached { .. }));
        assert_eq!(told.count(), 1, "{greeting:?}");
        if greeting == Greeting::Full {
            assert_eq!(played.mission.robots[R1].totals.reconnects, 0, "its first link");
        }
    }
}

#[test]
fn joining_robot_that_would_jump_is_left_out_and_the_others_play() {
    for (stands_at, left_out) in [(Some(0.0), true), (Some(45.0), false), (None, false)] {
        let mut played = waits_for_nobody(Greeting::Full);
        let block = played.mission.robots[R1].block.as_mut().unwrap();
        block.devices[0].interpolation = urrcp::Interpolation::Linear;
        played.positions = stands_at.map(|at| ("a".parse().unwrap(), at)).into_iter().collect();
        played.happens(Event::LinkUp { robot: R1 });
        played.run_until(at(5_000));
        let robot = &played.mission.robots[R1];
        let misplaced = |failure: &Failure| matches!(failure.kind, FailureKind::Position { .. });
        assert_eq!(robot.failures.iter().any(misplaced), left_out, "at {stands_at:?}");
        assert_eq!(robot.totals.started > 0, !left_out, "at {stands_at:?}");
        assert!(robot.halt.touched.is_empty() == left_out, "at {stands_at:?}");
        assert!(played.mission.outcome().is_none(), "the other robot still plays");
    }
}

#[test]
fn act_ends_immediately_if_its_only_robot_joins_late_and_would_jump() {
    let mut choreography = choreography(&[&[("a", 0, 3_000)], &[("a", 0, 3_000)]]);
    let mut alone = choreography.acts[0].clone();
    alone.plan.robots.remove(0);
    (choreography.acts[0].next, alone.wait) = (Way::Act(1), Wait::Done);
    choreography.acts.push(alone);
    let mut played = begun_without_the_second(choreography, Greeting::Full);
    let block = played.mission.robots[R1].block.as_mut().unwrap();
    block.devices[0].interpolation = urrcp::Interpolation::Linear;
    played.positions = [("a".parse().unwrap(), 0.0)].into();
    played.happens(Event::LinkUp { robot: R1 });
    played.run_until(at(6_000));
    assert_eq!(played.mission.outcome(), Some(&Outcome::DoneWithout));
    assert!(played.mission.robots[R1].halt.touched.is_empty());
}

#[test]
fn robot_that_moved_while_disconnected_before_its_first_act_fails() {
    for (stands_at, fails) in [(0.0, true), (45.0, false)] {
        let mut choreography = choreography(&[&[("a", 0, 400)], &[("a", 0, 400)]]);
        choreography.acts[0].wait = Wait::Operator;
        let participant =
            |id: &str| Participant::new(RobotId::new(id).unwrap(), robot(id, Everything, 2).block);
        let participants = vec![participant("r0"), participant("r1")];
        let mission = Mission::new(Arc::new(choreography), participants, MissionOptions::default(), at(0));
        let mut played = Played::linked(mission.unwrap(), &[R0, R1]);
        let block = played.mission.robots[R1].block.as_mut().unwrap();
        block.devices[0].interpolation = urrcp::Interpolation::Linear;
        played.positions = [("a".parse().unwrap(), 45.0)].into();
        played.run_until(at(1_000));
        assert_eq!(played.mission.phase, Phase::Performing, "at {stands_at}");
        let reason = "closed".to_owned();
        played.happens(Event::LinkDown { robot: R1, loss: Loss::Closed, reason });
        played.positions = [("a".parse().unwrap(), stands_at)].into();
        played.happens(Event::LinkUp { robot: R1 });
        played.run_until(at(2_000));
        played.happens(Event::Go { act: None, by: None });
        let outcome = played.run_to_the_end();
        assert_eq!(outcome == Outcome::NotStarted, fails, "at {stands_at}: {outcome:?}");
        assert_eq!(played.mission.robots[R1].halt.touched.is_empty(), fails, "at {stands_at}");
        let mut failures = played.mission.robots[R1].failures.iter();
        assert!(failures.all(|failure| failure.kind.to_string().contains("`run --approach 5s`")));
    }
}

#[test]
fn robot_that_never_joins_or_joins_after_its_last_act_began_is_left_out() {
    for comes in [false, true] {
        let long = choreography(&[&[("a", 0, 10_000)], &[("a", 0, 10_000)]]);
        let mut played = begun_without_the_second(long, Greeting::Full);
        if comes {
            played.happens(Event::LinkUp { robot: R1 });
        }
        assert_eq!(played.run_to_the_end(), Outcome::DoneWithout, "comes: {comes}");
        let [failure] = &*played.mission.robots[R1].failures else { panic!("comes: {comes}") };
        assert!(matches!(failure.kind, FailureKind::NeverJoined { .. }), "{failure:?}");
        assert_eq!(played.mission.robots[R1].standing == Standing::In, comes);
    }
}

#[test]
fn late_robot_that_cannot_join_yet_or_ever_does_not_stop_the_others() {
    let mut played = waits_for_nobody(Greeting::Full);
    played.mutes(R1);
    played.happens(Event::LinkUp { robot: R1 });
    let block = robot("r1", Everything, 2).block.unwrap();
    played.happens(Event::Received { robot: R1, message: Message::InitializationBlock(block) });
    let away = AvailabilityResponse {
        originate_timestamp: None,
        receive_timestamp: by_robot(at(1_000)),
        timestamp: by_robot(at(1_000)),
        status: Status::Failed,
        error: Some(ControlError::new(ErrorCode::Internal, "its hardware is away")),
        revocation_list: None,
    };
    let asked = asks_of(&played, R1);
    played.happens(Event::Received { robot: R1, message: Message::AvailabilityResponse(away) });
    played.run_until(at(4_000));
    assert_eq!(
        (&played.mission.phase, played.mission.robots[R1].standing),
        (&Phase::Performing, Standing::Absent)
    );
    assert!(asks_of(&played, R1) > asked, "the mission asks again");

    let mut unfit = waits_for_nobody(Greeting::Full);
    Arc::make_mut(&mut unfit.mission.choreography).requirements.all_or_none = Some(AllOrNone::Strict);
    unfit.mutes(R1);
    unfit.happens(Event::LinkUp { robot: R1 });
    let block = robot("r1", Reports, 2).block.unwrap();
    unfit.happens(Event::Received { robot: R1, message: Message::InitializationBlock(block) });
    unfit.run_until(at(4_000));
    assert_eq!(
        (&unfit.mission.phase, unfit.mission.robots[R1].standing),
        (&Phase::Performing, Standing::Out)
    );
    assert_eq!(unfit.mission.robots[R1].failures.len(), 1);
}

/// The number of availability requests that were sent to a robot.
fn asks_of(played: &Played, robot: RobotIndex) -> usize {
    let asks = |message: &Message| matches!(message, Message::AvailabilityRequest(_));
    played.sent.iter().filter(|(_, to, message)| *to == robot && asks(message)).count()
}

#[test]
fn absent_robot_that_turns_out_to_be_another_is_left_out() {
    let mut played = waits_for_nobody(Greeting::Full);
    let block = robot("another", Everything, 2).block.unwrap();
    let told = || Event::Received { robot: R1, message: Message::InitializationBlock(block.clone()) };
    played.mutes(R1);
    for _ in 0..2 {
        played.happens(Event::LinkUp { robot: R1 });
        played.happens(told());
        assert_eq!(played.mission.robots[R1].standing, Standing::Out);
        assert_eq!(played.mission.robots[R1].failures.len(), 1, "reported once");
        assert!(played.mission.robots[R1].lost().is_some_and(|lost| lost.connecting));
    }
    assert_eq!(played.mission.phase, Phase::Performing, "the others go on");
}

#[test]
fn wrong_robot_is_reported_once_during_greeting_and_its_link_is_kept() {
    let mut mission = asked();
    mission
        .robots
        .push(super::super::robot_state::RobotState::new(Participant::new("r1".parse().unwrap(), None)));
    let _asks = mission.handle(at(0), Event::LinkUp { robot: R0 });
    let block = robot("another", Everything, 2).block.unwrap();
    for _ in 0..2 {
        let message = Message::InitializationBlock(block.clone());
        let _told = mission.handle(at(1), Event::Received { robot: R0, message });
    }
    assert_eq!(mission.robots[R0].failures.len(), 1);
    assert!(mission.robots[R0].lost().is_none());
}

#[test]
fn ntp_loss_and_return_are_reported_once_each() {
    let mut mission = begins_at_once(Everything);
    let state =
        |lost: Option<i64>| Event::ServerTime(NtpState { lost_since: lost.map(at), ..NtpState::default() });
    let mut told = |lost| {
        let actions = mission.handle(at(0), state(lost));
        let what = |action: &Action| match action {
            Action::Tell(Progress::NtpLost { since }) => Some(Some(*since)),
            Action::Tell(Progress::NtpBack { .. }) => Some(None),
            _ => None,
        };
        actions.iter().filter_map(what).collect::<Vec<_>>()
    };
    assert_eq!(told(None), []);
    assert_eq!(told(Some(5)), [Some(at(5))]);
    assert_eq!(told(Some(5)), []);
    assert_eq!(told(None), [None]);
    assert_eq!(told(None), []);
    assert_eq!(told(Some(9)), [Some(at(9))]);
    assert_eq!(mission.ntp().and_then(|state| state.lost_since), Some(at(9)));
}

#[test]
fn silent_robot_is_sent_its_stop_after_a_moment_and_a_wrong_one_is_not() {
    let mut mission = asked();
    mission.robots[R0].connected(at(0));
    assert!(!mission.takes_stops(at(250) - Span::from_nanos(1), R0));
    assert!(mission.takes_stops(at(250), R0));
    let (expected, told) = ("r0".parse().unwrap(), "another".parse().unwrap());
    mission.note_failure(R0, FailureKind::AnotherRobot { expected, told });
    assert!(!mission.takes_stops(at(250), R0));
}

#[test]
fn unreachable_robot_is_retried_unless_retrying_is_useless() {
    for (loss, before, now, fails) in [
        (Loss::Refused, None, 0, false),
        (Loss::Refused, Some(0), 499, false),
        (Loss::Refused, Some(0), 500, true),
        (Loss::Unreachable, Some(0), 500, false),
        (Loss::Unreachable, Some(0), 4_999, false),
        (Loss::Unreachable, Some(0), 5_000, true),
        (Loss::Denied, None, 0, true),
    ] {
        let mut mission = asked();
        mission
            .robots
            .push(super::super::robot_state::RobotState::new(Participant::new("r1".parse().unwrap(), None)));
        let down = |loss| Event::LinkDown { robot: R0, loss, reason: "why".to_owned() };
        if let Some(before) = before {
            let _reconnects = mission.handle(at(before), down(Loss::Unreachable));
        }
        let actions = mission.handle(at(now), down(loss));
        assert_eq!(mission.robots[R0].has_failed(), fails, "{loss:?} at {now}");
        let again = actions.iter().any(|action| matches!(action, Action::Reconnect { .. }));
        assert_eq!(again, !fails, "{loss:?} at {now}");
    }
}

#[test]
fn robot_owned_by_another_session_fails_when_asked() {
    let mut mission = asked();
    mission
        .robots
        .push(super::super::robot_state::RobotState::new(Participant::new("r1".parse().unwrap(), None)));
    mission.robots[R0].connected(at(0));
    mission.robots[R0].named();
    let there = by_robot(at(1));
    let response = AvailabilityResponse {
        error: Some(busy()),
        ..AvailabilityResponse::new(&urrcp::AvailabilityRequest::default(), there, there, Status::Failed)
    };
    let message = Message::AvailabilityResponse(response);
    let _failed = mission.handle(at(2), Event::Received { robot: R0, message });
    let kinds: Vec<_> = mission.robots[R0].failures.iter().map(|failure| failure.kind.clone()).collect();
    assert_eq!(kinds, [FailureKind::NotAvailable { error: busy() }]);
}

/// A mission whose device has other limits, such as its smallest step and its largest error. `change` edits the device's description.
fn with_limits(change: impl FnOnce(&mut serde_json::Value)) -> Mission {
    let mut mission = tells_where_it_stands();
    let mut block = serde_json::to_value(mission.robots[R0].block.as_ref().unwrap()).unwrap();
    change(&mut block["devices"][0]);
    mission.robots[R0].block = Some(serde_json::from_value(block).unwrap());
    mission
}

#[test]
fn device_may_be_two_steps_or_two_errors_from_its_first_value() {
    for (granularity, max_error, within) in [(1.0, None, 2.0), (0.5, Some(3.0), 6.0), (2.0, Some(0.5), 4.0)] {
        let mut mission = with_limits(|device| {
            let limits = &mut device["available_control_types"]["position"];
            limits["granularity"] = granularity.into();
            max_error.into_iter().for_each(|error: f64| limits["max_error"] = error.into());
        });
        for (off, misplaced) in [(within, 0), (-within, 0), (within + 0.25, 1), (-within - 0.25, 1)] {
            mission.robots[R0].pose.read = vec![("a".parse().unwrap(), 45.0 + off)];
            assert_eq!(mission.misplaced(R0).len(), misplaced, "{off} of {within}");
        }
    }
}

#[test]
fn device_that_jumps_or_has_time_to_arrive_may_be_anywhere() {
    let first = |mission: &mut Mission, after: i64, control_type| {
        let choreography = Arc::get_mut(&mut mission.choreography).unwrap();
        let step = urrcp::Step {
            offset: urrcp::Millis::from_span(ms(after)),
            setpoint: urrcp::Setpoint::new(control_type, 45.0),
            stop_condition: None,
        };
        choreography.acts[0].plan.robots[0].scripts[0].script = urrcp::Script::new(vec![step]).unwrap();
    };
    let position = urrcp::ControlType::Position;
    for (linear, after, control_type, speed, expected) in [
        (true, 0, position, None, Some(2.0)),
        (false, 0, position, None, None),
        (false, 0, position, Some(10.0), Some(2.0)),
        (true, 1, position, None, None),
        (true, 1_000, position, Some(10.0), Some(12.0)),
        (true, 0, urrcp::ControlType::Speed, None, None),
    ] {
        let mut mission = tells_where_it_stands();
        if !linear {
            mission.robots[R0].block.as_mut().unwrap().devices[0].interpolation = urrcp::Interpolation::Hold;
        }
        first(&mut mission, after, control_type);
        mission.greeting.first_uses[R0].values_mut().for_each(|(_, largest)| *largest = speed);
        let told = mission.expected_position(R0, &"a".parse().unwrap());
        let expected = expected.map(|within| Expected { position: 45.0, within });
        assert_eq!(told, expected, "linear: {linear}, after {after} ms, {control_type:?}, {speed:?}");
    }
}

#[test]
fn device_first_moved_in_a_later_act_must_not_jump() {
    let mut show = choreography(&[&[("a", 0, 400)]]);
    let mut second = choreography(&[&[("a", 0, 400), ("b", 0, 400)]]).acts.remove(0);
    second.next = Way::Act(0);
    show.acts.push(second);
    for (next, misplaced) in [(Way::Act(1), 1), (Way::End, 0)] {
        show.acts[0].next = next;
        let block = robot("r0", Everything, 2).block.map(|mut block| {
            block.devices.iter_mut().for_each(|device| device.interpolation = urrcp::Interpolation::Linear);
            block
        });
        let participant = Participant::new(RobotId::new("r0").unwrap(), block);
        let show = Arc::new(show.clone());
        let mut mission = Mission::new(show, vec![participant], MissionOptions::default(), at(0)).unwrap();
        let stated = [("a", 45.0), ("b", 10.0)];
        let stated = stated.map(|(device, position)| (device.parse().unwrap(), position));
        mission.robots[R0].pose.commanded = stated.into();
        let found = mission.misplaced(R0);
        let is_b = |kind: &FailureKind| matches!(kind, FailureKind::Position { device, .. } if device.as_str() == "b");
        assert_eq!((found.len(), found.iter().all(is_b)), (misplaced, true), "{next:?}: {found:?}");
    }
}

#[test]
fn unreachable_absent_robot_is_no_lost_link_and_is_tried_again() {
    let mut played = waits_for_nobody(Greeting::Full);
    played.mission.robots[R1].link = super::super::robot_state::Link::Connecting;
    let now = played.now;
    let down = Event::LinkDown { robot: R1, loss: Loss::Unreachable, reason: "off".to_owned() };
    let actions = played.mission.handle(now, down);
    assert!(actions.iter().any(|action| matches!(action, Action::Reconnect { robot: R1, .. })));
    let told = |action: &Action| matches!(action, Action::Tell(Progress::LinkLost { .. }));
    assert!(!actions.iter().any(told), "{actions:?}");
    assert!(played.mission.robots[R1].lost().is_some_and(|lost| lost.give_up.is_none()));
}

#[test]
fn failed_robot_does_not_join_when_it_connects() {
    let mut played = waits_for_nobody(Greeting::Full);
    played.mission.note_failure(R1, FailureKind::Garbled { reason: "x".into() });
    played.happens(Event::LinkUp { robot: R1 });
    played.run_until(at(5_000));
    assert!(played.mission.robots[R1].greeted.introduced && played.mission.robots[R1].clock.samples() >= 8);
    assert_eq!(played.mission.robots[R1].standing, Standing::Absent);
}

#[test]
fn mission_is_done_without_a_robot_that_failed_while_absent() {
    let mut choreography = choreography(&[&[("a", 0, 4_000)], &[("a", 0, 4_000)]]);
    choreography.acts[0].wait = Wait::Done;
    let mut played = begun_without_the_second(choreography, Greeting::Full);
    played.mission.note_failure(R1, FailureKind::Garbled { reason: "x".into() });
    assert_eq!(played.run_to_the_end(), Outcome::DoneWithout);
    assert_eq!(played.mission.robots[R1].standing, Standing::Absent);
}

#[test]
fn excess_readings_of_past_act_waits_are_forgotten() {
    use super::super::robot_state::Reading;
    let mut mission = may_seize();
    let sensor: DeviceId = "a".parse().unwrap();
    mission.read(at(0), R0, sensor.clone(), Reading::Requirement(0));
    for millis in 1..1_024 {
        mission.read(at(millis), R0, sensor.clone(), Reading::Wait(ActNumber::new(0)));
    }
    assert_eq!(mission.robots[R0].requests.readings_owed(), 1_024);
    mission.read(at(2_000), R0, sensor, Reading::Wait(ActNumber::new(1)));
    let left: Vec<_> = mission.robots[R0].requests.awaited_readings().collect();
    assert!(
        left.len() == 2
            && left.contains(&&Reading::Requirement(0))
            && left.contains(&&Reading::Wait(ActNumber::new(1)))
    );
}

#[test]
fn preflight_reads_positions_of_first_act_and_shows_unused_sensors() {
    use super::super::robot_state::Reading;
    for (preflight_only, shown) in [(true, vec!["b"]), (false, Vec::new())] {
        let mut mission = tells_where_it_stands();
        mission.options.preflight_only = preflight_only;
        let mut block = serde_json::to_value(mission.robots[R0].block.as_ref().unwrap()).unwrap();
        for device in [1, 2] {
            let sensor = serde_json::json!({"min_value": 0, "max_value": 90});
            block["devices"][device]["available_control_types"]["sensor"] = sensor;
        }
        mission.robots[R0].block = Some(serde_json::from_value(block).unwrap());
        let range = SensorRange::Above(50.0);
        mission.robots[R0].settings.require = vec![Requirement { sensor: "c".parse().unwrap(), range }];
        mission.read_positions(at(0), R0);
        let reads: Vec<_> = mission.robots[R0].requests.awaited_readings().cloned().collect();
        assert!(reads.contains(&Reading::Position("a".parse().unwrap())), "{reads:?}");
        let told = reads.iter().filter_map(|read| match read {
            Reading::Shown(device) => Some(device.as_str()),
            _ => None,
        });
        assert_eq!(told.collect::<Vec<_>>(), shown);
    }
}

/// A mission with three acts, in which the devices of `r0` move linearly. The first act moves `a`, and the other two move `b` as well.
/// The second act follows by `next`, and the act `on_timeout` follows if the operator sends no go in time. If the robot takes no
/// inquiries, its devices have sensors.
fn leads_to(tells: Tells, on_timeout: usize) -> Played {
    let mut show = choreography(&[&[("a", 0, 10_000)]]);
    let mut another = choreography(&[&[("a", 0, 400), ("b", 0, 400)]]).acts.remove(0);
    another.name = "another".to_owned();
    show.acts.extend([another.clone(), another]);
    (show.acts[0].next, show.acts[0].wait) = (Way::Act(1), Wait::Operator);
    (show.acts[0].timeout, show.acts[0].on_timeout) = (Some(ms(1_000)), Way::Act(on_timeout));
    let mut block = robot("r0", tells, 2).block.unwrap();
    for device in block.devices.iter_mut() {
        device.interpolation = urrcp::Interpolation::Linear;
        if !block.inquiry {
            *device = device.clone().with_sensor(urrcp::SensorParameters::new(0.0, 90.0).unwrap());
        }
    }
    let participants = vec![Participant::new(RobotId::new("r0").unwrap(), Some(block))];
    let mission = Mission::new(Arc::new(show), participants, MissionOptions::default(), at(0)).unwrap();
    let mut played = Played::linked(mission, &[R0]);
    played.positions = [("a", 45.0), ("b", 45.0)].map(|(id, at)| (id.parse().unwrap(), at)).into();
    played.run_until(at(900));
    played
}

/// Whether the mission found device `b` at an unexpected position and has not moved it. Also checks the advice in the failure, which must
/// suit an act that is not the first one.
fn refuses_b(played: &Played) -> bool {
    let robot = &played.mission.robots[R0];
    let is_b =
        |kind: &FailureKind| matches!(kind, FailureKind::Position { device, .. } if device.as_str() == "b");
    let Some(failure) = robot.failures.iter().find(|failure| is_b(&failure.kind)) else { return false };
    let told = "device `b` is at 0, but its first keyframe in the act `another` expects 45: move it there in an earlier act, or put that keyframe later";
    assert_eq!(failure.kind.to_string(), told);
    !robot.halt.touched.contains("b")
}

#[test]
fn device_first_moved_in_an_act_not_reached_by_next_must_not_jump() {
    for tells in [Everything, Tells::Reports] {
        for (stands_at, fails) in [(0.0, true), (45.0, false)] {
            let mut played = leads_to(tells, 2);
            played.positions.insert("b".parse().unwrap(), stands_at);
            let outcome = played.run_to_the_end();
            assert_eq!(refuses_b(&played), fails, "{tells:?} at {stands_at}: {outcome}");
            assert_eq!(outcome == Outcome::NotStarted, fails, "{tells:?} at {stands_at}: {outcome}");
        }
    }
}

#[test]
fn device_whose_sensor_reads_nothing_begins_the_act_from_anywhere() {
    let mut played = leads_to(Tells::Reports, 2);
    played.positions.clear();
    let outcome = played.run_to_the_end();
    let robot = &played.mission.robots[R0];
    assert!(!robot.has_failed() && robot.halt.touched.contains("b"), "{outcome}: {:?}", robot.failures);
}

#[test]
fn untouched_device_without_a_reported_position_is_not_moved() {
    for tells in [Everything, Tells::Reports] {
        let mut played = leads_to(tells, 2);
        played.mute = vec![R0];
        assert_eq!(played.run_to_the_end(), Outcome::NotStarted, "{tells:?}");
        let robot = &played.mission.robots[R0];
        let awaited = "positions of its devices";
        let silent = |failure: &Failure| matches!(&failure.kind, FailureKind::Silent { awaited: of, .. } if of == awaited);
        assert!(robot.failures.iter().any(silent), "{tells:?}: {:?}", robot.failures);
        assert!(robot.halt.touched.is_empty());
    }
}

#[test]
fn later_moving_device_of_a_robot_is_read_again_on_a_new_link() {
    let all =
        [Everything, Tells::Reports].into_iter().flat_map(|tells| [(tells, 0.0, true), (tells, 45.0, false)]);
    for (tells, stands_at, fails) in all {
        let mut played = leads_to(tells, 2);
        played.happens(Event::Go { act: None, by: None });
        played.run_to_the_start();
        let reason = "closed".to_owned();
        played.happens(Event::LinkDown { robot: R0, loss: Loss::Closed, reason });
        played.positions.insert("b".parse().unwrap(), stands_at);
        played.happens(Event::LinkUp { robot: R0 });
        let outcome = played.run_to_the_end();
        assert_eq!(refuses_b(&played), fails, "at {stands_at}: {outcome}");
    }
}

#[test]
fn act_is_promised_only_after_a_robot_responds_on_its_new_link() {
    for (answers, says_its_name) in [(true, true), (false, true), (false, false)] {
        let mut choreography = choreography(&[&[("a", 0, 400)], &[("a", 0, 400)]]);
        choreography.acts[0].wait = Wait::Operator;
        let participant =
            |id: &str| Participant::new(RobotId::new(id).unwrap(), robot(id, Tells::Reports, 2).block);
        let participants = ["r0", "r1"].map(participant).to_vec();
        let mission = Mission::new(Arc::new(choreography), participants, MissionOptions::default(), at(0));
        let mut played = Played::linked(mission.unwrap(), &[R0, R1]);
        played.run_until(at(1_000));
        let reason = "closed".to_owned();
        played.happens(Event::LinkDown { robot: R1, loss: Loss::Closed, reason });
        let back = played.now;
        played.happens(Event::LinkUp { robot: R1 });
        if !says_its_name {
            played.mutes(R1);
        }
        played.run_until(back + Span::from_micros(200));
        if !answers {
            played.mute = vec![R1];
        }
        played.happens(Event::Go { act: None, by: None });
        let is_promised =
            |played: &Played| played.recorded.iter().any(|record| matches!(record, Record::Prepared(_)));
        assert!(!is_promised(&played), "{answers} {says_its_name}");
        played.run_until(back + ms(50));
        assert_eq!(is_promised(&played), answers, "{answers} {says_its_name}");
        let outcome = played.run_to_the_end();
        assert_eq!(outcome == Outcome::Done, answers, "{answers} {says_its_name}: {outcome}");
    }
}

#[test]
fn waiting_mission_ends_when_a_robot_no_longer_admits_the_operator() {
    for (loss, ends) in [(Loss::Denied, true), (Loss::Closed, false), (Loss::Refused, false)] {
        let mut choreography = choreography(&[&[("a", 0, 400)]]);
        choreography.acts[0].wait = Wait::Operator;
        let participant =
            Participant::new(RobotId::new("r0").unwrap(), robot("r0", Tells::Everything, 1).block);
        let mission =
            Mission::new(Arc::new(choreography), vec![participant], MissionOptions::default(), at(0));
        let mut played = Played::linked(mission.unwrap(), &[R0]);
        played.run_until(at(1_000));
        played.happens(Event::LinkDown { robot: R0, loss, reason: "your certificate is revoked".to_owned() });
        assert_eq!(played.mission.robots[R0].has_failed(), ends, "{loss:?}");
    }
}

#[test]
fn act_is_promised_to_an_unlinked_robot_only_after_a_connection_attempt() {
    let mut choreography = choreography(&[&[("a", 0, 400)], &[("a", 0, 400)]]);
    choreography.acts[0].wait = Wait::Operator;
    let choreography = Arc::new(choreography);
    let participant =
        |id: &str| Participant::new(RobotId::new(id).unwrap(), robot(id, Tells::Everything, 2).block);
    let down = |played: &mut Played| {
        let reason = "refused".to_owned();
        played.happens(Event::LinkDown { robot: R1, loss: Loss::Refused, reason });
    };
    let is_promised =
        |played: &Played| played.recorded.iter().any(|record| matches!(record, Record::Prepared(_)));
    for (is_back, answers_at_all) in [(true, true), (false, true), (false, false)] {
        let participants = ["r0", "r1"].map(participant).to_vec();
        let mission = Mission::new(Arc::clone(&choreography), participants, MissionOptions::default(), at(0));
        let mut played = Played::linked(mission.unwrap(), &[R0, R1]);
        played.run_until(at(1_000));
        // The robot has been missing for a while, so the mission waits for a second before its next attempt.
        for _ in 0..10 {
            down(&mut played);
        }
        let tried = played.reconnects.len();
        played.happens(Event::Go { act: None, by: None });
        assert_eq!(played.reconnects[tried..], [(R1, Span::ZERO)], "it tries at once");
        assert!(!is_promised(&played));
        played.run_until(played.now + ms(20));
        assert!(!is_promised(&played), "the attempt has not ended");
        match (is_back, answers_at_all) {
            (true, _) => played.happens(Event::LinkUp { robot: R1 }),
            (false, true) => down(&mut played),
            (false, false) => played.run_until(played.now + ms(250)),
        }
        assert_eq!(is_promised(&played), !is_back);
        let outcome = played.run_to_the_end();
        assert_eq!(outcome == Outcome::Done, is_back, "{outcome}");
    }
}
