//! Tests of robots that send too many messages, and of robots for which the others would have to wait without bound.

use downbeat_plan::OnFailure;

use super::*;
use crate::bench::{ms, robot};
use crate::lead::{LEASE_MAX, ROUND_TRIP_LONGEST};

/// A mission with one act of two robots. If one robot fails, the other continues.
pub(super) fn of_two(tolerance: Span) -> Mission {
    let mut choreography = choreography(&[&[("a", 0, 400)], &[("a", 0, 400)]]);
    choreography.acts[0].on_failure.default = OnFailure::Without;
    choreography.acts[0].plan.start_tolerance = tolerance;
    let participant = |id: &str| Participant::new(RobotId::new(id).unwrap(), robot(id, Everything, 2).block);
    let participants = vec![participant("r0"), participant("r1")];
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    Mission::new(Arc::new(choreography), participants, options, at(0)).unwrap()
}

fn reconnects(actions: &[Action]) -> bool {
    actions.iter().any(|action| matches!(action, Action::Reconnect { .. }))
}

fn flooding() -> Event {
    let loss = Loss::Flooding { messages: 2_000, bytes: 3_000 };
    Event::LinkDown { robot: R1, loss, reason: "it floods".to_owned() }
}

#[test]
fn flooding_robot_has_failed_and_is_reconnected_only_to_be_stopped() {
    let mut mission = of_two(TOLERANCE);
    let _up = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    let sent = happens(&mut mission, at(0), Event::LinkUp { robot: R1 });
    assert_eq!(scripts_in(&sent).len(), 2);
    let actions = happens(&mut mission, at(2), flooding());
    assert!(reconnects(&actions), "it was sent a script, and is stopped: {actions:?}");
    let kinds: Vec<_> = mission.robots[R1].failures.iter().map(|failure| failure.kind.clone()).collect();
    assert_eq!(kinds, [FailureKind::Flooding { messages: 2_000, bytes: 3_000 }]);
    assert_eq!(mission.robots[R1].standing, Standing::Out, "the policy of its act");
    assert_eq!(mission.robots[R0].standing, Standing::In);
    let stops = scripts_in(&happens(&mut mission, at(4), Event::LinkUp { robot: R1 }));
    assert_eq!(stops.len(), 1);
    let confirmed = crate::bench::response(&"a".parse().unwrap(), Some(&stops[0]), Status::Ok, at(5));
    let message = Message::ControlResponse(confirmed);
    let mut actions = happens(&mut mission, at(6), Event::Received { robot: R1, message });
    actions.extend(happens(&mut mission, at(7), flooding()));
    actions.extend(happens(&mut mission, at(8), Event::StopRequested { rest: Rest::InPlace, by: None }));
    while let Some(now) = mission.next_wakeup() {
        actions.extend(mission.advance(now));
    }
    assert!(!reconnects(&actions), "{actions:?}");
    assert_eq!(mission.robots[R1].failures.len(), 1);
}

#[test]
fn robot_that_floods_during_a_stop_is_named_once_and_still_stopped() {
    let mut mission = of_two(TOLERANCE);
    let _up = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R1 });
    let _stops = happens(&mut mission, at(2), Event::StopRequested { rest: Rest::InPlace, by: None });
    for again in 0..3 {
        let actions = happens(&mut mission, at(3 + again), flooding());
        assert!(reconnects(&actions), "{actions:?}");
        let _up = happens(&mut mission, at(3 + again), Event::LinkUp { robot: R1 });
    }
    assert!(matches!(mission.robots[R1].failures[..], [Failure { kind: FailureKind::Flooding { .. }, .. }]));
}

#[test]
fn robot_that_floods_during_greeting_is_refused() {
    let mut mission = of_two(TOLERANCE);
    mission.options.greeting = Greeting::Full;
    let actions = happens(&mut mission, at(2), flooding());
    assert!(mission.robots[R1].has_failed() && !reconnects(&actions), "{actions:?}");
}

/// A mission after three exchanges of timestamps. The second robot's link has the given round trip, and its clock is ahead by `ahead`.
fn after_exchanges_of(round_trip: Span, ahead: Span, tolerance: Span) -> Mission {
    let mut mission = of_two(tolerance);
    for (robot, round_trip, ahead) in [(0, ms(1), Span::ZERO), (1, round_trip, ahead)] {
        for sent in [0, 60, 120].map(|seconds| at(0) + ms(1_000) * seconds) {
            let there = by_robot(sent + round_trip / 2 + ahead);
            let sample = ClockSample::from_exchange(sent, there, there, sent + round_trip);
            mission.robots[RobotIndex::new(robot)].clock.add(sample);
        }
    }
    mission
}

#[test]
fn robot_with_round_trips_longer_than_any_lease_is_refused() {
    for (round_trip, refused) in [(ROUND_TRIP_LONGEST, false), (ROUND_TRIP_LONGEST + ms(1), true)] {
        let mut mission = after_exchanges_of(round_trip, Span::ZERO, ms(60_000));
        mission.check_links();
        assert!(!mission.robots[R0].has_failed());
        let texts: Vec<_> =
            mission.robots[R1].failures.iter().map(|failure| failure.kind.to_string()).collect();
        assert_eq!(texts.len(), usize::from(refused), "{texts:?}");
        let says = "the link to the robot is too slow: a round trip takes 3.001 s, expected at most 3 s";
        assert!(texts.iter().all(|text| text.starts_with(says)), "{texts:?}");
    }
}

#[test]
fn no_robot_makes_the_others_wait_for_an_unbounded_lease() {
    for (ahead, refused) in [(ms(100), false), (ms(-5_000), false), (ms(5_000), false), (ms(20_000), true)] {
        let mut mission = after_exchanges_of(ms(100), ahead, ms(300_000));
        let now = at(150_000);
        let _up = mission.handle(now, Event::LinkUp { robot: R0 });
        let actions = happens(&mut mission, now, Event::LinkUp { robot: R1 });
        let lease = actions.iter().find_map(|action| match action {
            Action::Tell(Progress::Preparing { lead, .. }) => Some(lead.lease),
            _ => None,
        });
        assert!(lease.is_some_and(|lease| lease <= LEASE_MAX), "{ahead}: {lease:?} {actions:?}");
        let slow = |kind: &FailureKind| matches!(kind, FailureKind::TooSlow { slow: Slow::Lease { .. } });
        assert_eq!(mission.robots[R1].failures.iter().any(|failure| slow(&failure.kind)), refused, "{ahead}");
        assert!(!mission.robots[R0].has_failed(), "{ahead}");
    }
}

#[test]
fn flooding_robot_is_left_out_if_absent_but_not_if_being_stopped() {
    let mut mission = of_two(TOLERANCE);
    mission.phase = Phase::Performing;
    mission.robots[R1].standing = Standing::Absent;
    let _told = mission.handle(at(2), flooding());
    assert!(mission.robots[R1].has_failed());
    assert_eq!(mission.robots[R1].standing, Standing::Out);

    let mut mission = of_two(TOLERANCE);
    let _up = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: R1 });
    let _stops = happens(&mut mission, at(2), Event::StopRequested { rest: Rest::InPlace, by: None });
    let _told = mission.handle(at(3), flooding());
    assert!(mission.robots[R1].has_failed());
    assert_eq!(mission.robots[R1].standing, Standing::In);
}
