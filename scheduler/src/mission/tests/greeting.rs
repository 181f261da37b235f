//! Who counts as the robot that is meant, when robots are asked again, and robots of other sessions.

use urrcp::{AvailabilityResponse, ControlError};

use super::*;
use crate::mission::bench::ms;
use crate::mission::seize::Ownership;

fn asks(actions: &[Action]) -> usize {
    let asks = |action: &&Action| {
        matches!(action, Action::Send { message: Message::AvailabilityRequest(_) | Message::Inquiry(_), .. })
    };
    actions.iter().filter(asks).count()
}

#[test]
fn where_robots_are_not_asked_for_their_names_whatever_comes_is_from_the_one_that_is_meant() {
    let response = AvailabilityResponse {
        originate_timestamp: None,
        receive_timestamp: by_robot(at(1)),
        timestamp: by_robot(at(1)),
        status: Status::Ok,
        error: None,
    };
    let message = Message::AvailabilityResponse(response);
    for (greeting, up, counts) in
        [(Greeting::Skip, false, true), (Greeting::Full, false, false), (Greeting::Full, true, true)]
    {
        let mut mission = begins_at_once(Everything);
        mission.options.greeting = greeting;
        mission.robots[0].connected(at(0));
        if up {
            mission.robots[0].named();
        }
        assert_eq!(mission.is_the_one(at(1), 0, &message), counts, "{greeting:?}, named: {up}");
    }
}

#[test]
fn a_robot_whose_answer_is_under_way_is_asked_again_after_three_round_trips_and_a_little() {
    let mut mission = greets_a_clock(0, 40);
    mission.robots[0].connected(at(0));
    mission.robots[0].named();
    mission.robots[0].questions.asked(at(100));
    let again = at(100) + ms(3 * 40 + 20);
    mission.ask_further(again - Span::from_nanos(1), 0);
    assert_eq!(asks(&std::mem::take(&mut mission.actions)), 0);
    mission.ask_further(again, 0);
    assert_eq!(asks(&std::mem::take(&mut mission.actions)), 1);
}

/// A mission that may take a robot of another session, which has proven who it is.
fn may_seize() -> Mission {
    let mut mission = begins_at_once(Everything);
    mission.options.greeting = Greeting::Full;
    mission.options.seize = true;
    mission.robots[0].proven = true;
    mission.robots[0].connected(at(0));
    mission.robots[0].named();
    mission
}

fn busy() -> ControlError {
    ControlError::new(ErrorCode::Busy, "it belongs to `other`")
}

#[test]
fn only_a_proven_robot_of_another_session_is_taken_and_only_before_it_was_ours() {
    type Change = fn(&mut Mission);
    let changes: [(&str, Change); 5] = [
        ("the operator does not want it", |mission| mission.options.seize = false),
        ("it has not proven who it is", |mission| mission.robots[0].proven = false),
        ("it was ours", |mission| mission.robots[0].ownership = Ownership::Seized),
        ("it has answered", |mission| {
            let there = by_robot(at(1));
            mission.robots[0].clock.add(ClockSample::from_exchange(at(0), there, there, at(2)));
        }),
        ("the mission has begun", |mission| mission.phase = Phase::Performing),
    ];
    for (why, change) in changes {
        let mut mission = may_seize();
        change(&mut mission);
        assert!(!mission.is_to_be_seized(0, &busy()) && !mission.robots[0].is_of_another(), "{why}");
    }
    let internal = ControlError::new(ErrorCode::Internal, "its hardware is away");
    assert!(!may_seize().is_to_be_seized(0, &internal));
    let mut mission = may_seize();
    assert!(mission.is_to_be_seized(0, &busy()) && mission.robots[0].is_of_another());
}

#[test]
fn a_robot_of_another_session_is_taken_unless_another_robot_has_failed() {
    for fails in [false, true] {
        let mut mission = may_seize();
        assert!(!mission.seize_others(at(1)), "it belongs to nobody");
        assert!(mission.is_to_be_seized(0, &busy()));
        mission.robots[0].positions = vec![("a".parse().unwrap(), 1.0)];
        if fails {
            mission.note_failure(0, FailureKind::Garbled { reason: "x".into() });
        }
        assert_eq!(mission.seize_others(at(1)), !fails);
        if fails {
            assert_eq!(mission.robots[0].ownership, Ownership::Asked);
            let busy = FailureKind::NotAvailable { error: busy() };
            assert_eq!(mission.robots[0].failures.last().map(|failure| &failure.kind), Some(&busy));
            continue;
        }
        assert_eq!(mission.robots[0].ownership, Ownership::Seizing);
        assert_eq!(mission.robots[0].positions, [], "where it stood while it was another's");
        let seizes = |action: &Action| matches!(action, Action::Send { message: Message::AvailabilityRequest(asked), .. } if asked.seize);
        assert!(mission.actions.iter().any(seizes));
        mission.is_ours(at(2), 0);
        assert_eq!(mission.robots[0].ownership, Ownership::Seized);
    }
}

#[test]
fn a_robot_that_has_become_free_meanwhile_is_asked_as_any_other() {
    let mut mission = may_seize();
    assert!(mission.is_to_be_seized(0, &busy()));
    mission.is_ours(at(1), 0);
    assert_eq!(mission.robots[0].ownership, Ownership::Asked);
}

/// A mission whose robot says that its device `a`, which begins at 45, can tell where it stands.
fn tells_where_it_stands() -> Mission {
    let mut mission = may_seize();
    let text = serde_json::to_string(mission.robots[0].block.as_ref().unwrap()).unwrap().replacen(
        "\"available_control_types\":{",
        "\"available_control_types\":{\"sensor\":{\"min_value\":0,\"max_value\":90},",
        1,
    );
    let mut block: urrcp::InitializationBlock = serde_json::from_str(&text).unwrap();
    block.devices[0].interpolation = urrcp::Interpolation::Linear;
    mission.robots[0].block = Some(block);
    mission
}

#[test]
fn only_a_robot_that_was_taken_and_stands_elsewhere_is_read_again_one_reading_at_a_time() {
    for (ownership, stands, reads) in
        [(Ownership::Seized, 10.0, 1), (Ownership::Seized, 45.0, 0), (Ownership::Asked, 10.0, 0)]
    {
        let mut mission = tells_where_it_stands();
        mission.robots[0].ownership = ownership.clone();
        mission.robots[0].positions = vec![("a".parse().unwrap(), stands)];
        mission.follow_on_its_way(at(1), 0);
        assert_eq!(mission.robots[0].reads.len(), reads, "{ownership:?} at {stands}");
        assert_eq!(mission.robots[0].positions.len(), 1 - reads);
        mission.robots[0].positions = vec![("a".parse().unwrap(), stands)];
        mission.follow_on_its_way(at(2), 0);
        assert_eq!(mission.robots[0].reads.len(), reads, "its answer is awaited");
    }
}
