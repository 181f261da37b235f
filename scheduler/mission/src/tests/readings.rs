//! Readings of sensors: what becomes of questions on a link that breaks.

use super::played::Played;
use super::*;

/// Two acts with the device `a`, which has a sensor and moves linearly. The second act waits for the operator.
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
    let mut played = Played::linked(mission, &[0]);
    played.positions = [("a".parse().unwrap(), 45.0)].into();
    played
}

#[test]
fn readings_that_a_broken_link_lost_in_the_greeting_are_asked_for_again() {
    let mut played = has_a_sensor(Tells::Reports);
    let range = SensorRange::Above(10.0);
    played.mission.robots[0].settings.require = vec![Requirement { sensor: "a".parse().unwrap(), range }];
    played.mission.robots[0].readings = vec![None];
    // Its block has arrived, and the readings are on their way.
    played.run_until(at(0) + Span::from_micros(500));
    assert!(played.mission.robots[0].introduced && !played.mission.robots[0].has_shown_its_pose());
    played.mutes(0);
    played.mute.clear();
    let reason = "closed".to_owned();
    played.happens(Event::LinkDown { robot: 0, loss: Loss::Closed, reason });
    played.happens(Event::LinkUp { robot: 0 });
    played.run_until(at(8_000));
    assert!(!played.mission.robots[0].has_failed(), "{:?}", played.mission.robots[0].failures);
}
