//! Tests of sensor readings: the requests to which answers without ids belong, and requests on a link that breaks.

use std::collections::HashMap;

use super::played::Played;
use super::*;

/// A mission with two acts that move the device `a`, which has a sensor and moves linearly. The second act waits for the operator.
fn has_a_sensor(tells: Tells) -> Played {
    let mut show = choreography(&[&[("a", 0, 400)]]);
    let mut second = show.acts[0].clone();
    second.wait = Wait::Operator;
    show.acts[0].next = Way::Act(1);
    show.acts.push(second);
    let mut block = robot("r0", tells, 2).block.unwrap();
    for device in block.devices.iter_mut() {
        device.interpolation = urrcp::Interpolation::Linear;
        *device = device.clone().with_sensor(urrcp::SensorParameters::new(0.0, 90.0).unwrap());
    }
    let participants = vec![Participant::new(RobotId::new("r0").unwrap(), Some(block))];
    let mission = Mission::new(Arc::new(show), participants, MissionOptions::default(), at(0)).unwrap();
    let mut played = Played::linked(mission, &[R0]);
    played.positions = [("a".parse().unwrap(), 45.0)].into();
    played
}

#[test]
fn robot_that_omits_request_ids_has_its_position_read_by_sensors() {
    for tells in [Everything, Tells::Reports] {
        for (stands_at, refused) in [(45.0, false), (0.0, true)] {
            let mut played = has_a_sensor(tells);
            played.leaves_out_names = true;
            played.positions.insert("a".parse().unwrap(), stands_at);
            played.run_until(at(2_000));
            let failures: Vec<_> = played.mission.robots[R0].failures.iter().collect();
            let jumps = |failure: &&Failure| matches!(failure.kind, FailureKind::Position { .. });
            assert_eq!(
                (failures.len(), failures.iter().any(jumps)),
                (usize::from(refused), refused),
                "{failures:?}"
            );
        }
    }
}

#[test]
fn refusal_without_request_id_ends_the_wait_for_a_sensor_reading() {
    let mut played = has_a_sensor(Tells::Reports);
    (played.leaves_out_names, played.positions) = (true, HashMap::new());
    played.run_until(at(2_000));
    assert!(!played.mission.robots[R0].has_failed(), "{:?}", played.mission.robots[R0].failures);
}

#[test]
fn readings_lost_with_a_broken_link_during_greeting_are_requested_again() {
    let mut played = has_a_sensor(Tells::Reports);
    let range = SensorRange::Above(10.0);
    played.mission.robots[R0].settings.require = vec![Requirement { sensor: "a".parse().unwrap(), range }];
    played.mission.robots[R0].greeted.readings = vec![None];
    // The robot's block has arrived, and the readings are pending.
    played.run_until(at(0) + Span::from_micros(500));
    assert!(played.mission.robots[R0].greeted.introduced && !played.mission.robots[R0].has_shown_its_pose());
    played.mutes(R0);
    played.mute.clear();
    let reason = "closed".to_owned();
    played.happens(Event::LinkDown { robot: R0, loss: Loss::Closed, reason });
    played.happens(Event::LinkUp { robot: R0 });
    played.run_until(at(8_000));
    assert!(!played.mission.robots[R0].has_failed(), "{:?}", played.mission.robots[R0].failures);
}
