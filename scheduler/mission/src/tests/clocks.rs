//! Tests of clocks that turn out to differ from the clocks by which an act was sent.

use super::played::Played;
use super::*;
use crate::bench::ms;

/// A mission with one act of three robots that was sent. The clocks of the second and the third robot have since been set, in opposite
/// directions, and only the third robot has not answered yet.
fn two_have_strayed() -> Mission {
    let scripts: [&[Planned]; 3] = [&[("a", 0, 400)]; 3];
    let participant = |id: &str| Participant::new(RobotId::new(id).unwrap(), robot(id, Everything, 2).block);
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let participants = ["r0", "r1", "r2"].map(participant).to_vec();
    let mut mission = Mission::new(Arc::new(choreography(&scripts)), participants, options, at(0)).unwrap();
    for robot in 0..3 {
        let _sent = happens(&mut mission, at(0), Event::LinkUp { robot: robot.into() });
    }
    mission.robots[R0].clock.add(shows(0));
    mission.robots[R1].clock.add(shows(50));
    mission
}

/// An exchange with a clock that is ahead by `ahead` milliseconds.
fn shows(ahead: i64) -> ClockSample {
    let there = by_robot(at(1)) + ms(ahead);
    ClockSample::from_exchange(at(1), there, there, at(2))
}

fn blamed(mission: &Mission) -> Vec<(RobotIndex, FailureKind)> {
    let failures = |(index, robot): (RobotIndex, &RobotState)| {
        robot.failures.iter().map(move |failure| (index, failure.kind.clone())).collect::<Vec<_>>()
    };
    mission.robots.enumerated().flat_map(failures).collect()
}

#[test]
fn all_robots_with_drifted_clocks_fail_as_soon_as_drift_is_detected() {
    let mut mission = two_have_strayed();
    assert_eq!(blamed(&mission), []);
    mission.take_times(at(2), R2, shows(-50));
    let blamed = blamed(&mission);
    assert!(
        matches!(blamed.as_slice(), [(R1, FailureKind::Clock { .. }), (R2, FailureKind::Clock { .. })]),
        "{blamed:?}"
    );
}

#[test]
fn robot_whose_clock_drifted_across_two_acts_is_blamed_once() {
    let mut mission = two_have_strayed();
    let other = mission.acts[0].clone();
    mission.acts.push(other);
    mission.take_times(at(2), R2, shows(-50));
    let blamed = blamed(&mission);
    assert_eq!(blamed.len(), 2, "{blamed:?}");
}

/// Plays two acts of a robot whose clock is 400 ms ahead. `running` is the running lease of its scripts in milliseconds. Returns the time
/// at which the second act is sent, and the time at which the robot ends the first one.
fn second_is_sent(running: i64) -> (Timestamp<Server>, Timestamp<Server>) {
    let mut mission = waits_in(2);
    mission.options.greeting = Greeting::Full;
    for act in &mut Arc::make_mut(&mut mission.choreography).acts {
        act.plan.start_tolerance = ms(1_000);
        let running = Some(urrcp::Millis::from_span(ms(running)));
        let scripts = act.plan.robots.iter_mut().flat_map(|robot| &mut robot.scripts);
        scripts.for_each(|script| script.stop_condition.running = running);
    }
    let ahead = ms(400);
    let mut played = Played::linked(mission, &[R0]);
    played.ahead = [(R0, ahead)].into();
    played.run_until(at(50));
    let end = played.mission.acts[0].timing().unwrap().end - ahead;
    assert_eq!(played.run_to_the_end(), Outcome::Done, "{:?}", played.mission.robots[R0].failures);
    let script = |message: &Message| matches!(message, Message::ControlRequest(request) if request.time_offset_to_start.is_some());
    let sent = played.sent.iter().filter(|(.., message)| script(message)).nth(1).unwrap();
    (sent.0, end)
}

#[test]
fn act_needing_silence_longer_than_leases_of_another_is_sent_after_it() {
    let (sent, end) = second_is_sent(2_000);
    assert!(sent < end, "the lease is longer than the silence: {sent}, {end}");
    let (sent, end) = second_is_sent(300);
    assert!(sent >= end, "{sent}, {end}");
}

/// A mission whose only robot cannot be asked about its scripts. It plays two of four consecutive scripts; its queue holds two.
fn plays_a_chain(tells: Tells, clock: ClockMode, ahead: Span) -> Played {
    let mut mission =
        begins_with(tells, &[("a", 0, 300), ("a", 400, 300), ("a", 800, 300), ("a", 1_200, 300)]);
    mission.robots[R0].settings.clock = clock;
    let mut played = Played::linked(mission, &[R0]);
    played.ahead = [(R0, ahead)].into();
    // The robot's clock is known before the act is sent, as after a greeting.
    let there = by_robot(at(0)) + ahead;
    played.mission.robots[R0].clock.add(ClockSample::from_exchange(at(0), there, there, at(0)));
    played.run_until(at(10));
    played.run_to_the_start();
    played
}

/// Replaces the process of the robot by one whose clock is ahead by `ahead`.
fn is_replaced(played: &mut Played, ahead: Span) {
    let scripts: Vec<_> = played.mission.robots[R0].requests.scripts().map(|(id, _)| id.clone()).collect();
    scripts.iter().for_each(|script| played.loses(script));
    let reason = "it broke".to_owned();
    played.happens(Event::LinkDown { robot: R0, loss: Loss::Closed, reason });
    played.ahead = [(R0, ahead)].into();
    played.sent.clear();
    played.happens(Event::LinkUp { robot: R0 });
}

fn scripts_sent(played: &Played) -> usize {
    let script = |message: &Message| matches!(message, Message::ControlRequest(request) if request.time_offset_to_start.is_some());
    played.sent.iter().filter(|(.., message)| script(message)).count()
}

#[test]
fn robot_back_with_another_clock_mid_act_fails_and_gets_no_script() {
    for tells in [Tells::Nothing, Tells::Reports] {
        for clock in [ClockMode::Measured, ClockMode::Ntp] {
            for by in [-2_000, 2_000] {
                let mut played = plays_a_chain(tells, clock, ms(3));
                is_replaced(&mut played, ms(3 + by));
                played.run_until(played.now + ms(20));
                let case = format!("{tells:?}, {clock:?}, {by} ms");
                let blamed = blamed(&played.mission);
                assert!(matches!(blamed.as_slice(), [(R0, FailureKind::Clock { .. })]), "{case}: {blamed:?}");
                assert_eq!(scripts_sent(&played), 0, "{case}");
                assert_eq!(played.run_to_the_end(), Outcome::Failed, "{case}");
                assert_eq!(scripts_sent(&played), 0, "{case}");
            }
        }
    }
}

#[test]
fn robot_back_with_the_same_clock_gets_waiting_script_once_it_responds() {
    for clock in [ClockMode::Measured, ClockMode::Ntp] {
        let mut played = plays_a_chain(Tells::Nothing, clock, ms(3));
        is_replaced(&mut played, ms(3));
        assert_eq!(scripts_sent(&played), 0, "{clock:?}: its clock is unknown yet");
        played.run_until(played.now + ms(20));
        assert_eq!(blamed(&played.mission), [], "{clock:?}");
        assert_eq!(scripts_sent(&played), 1, "{clock:?}: one waits, and its device has no room for more");
        assert_eq!(played.run_to_the_end(), Outcome::Unknown, "{clock:?}");
        assert_eq!(scripts_sent(&played), 3, "{clock:?}");
    }
}

#[test]
fn robot_whose_clock_is_set_mid_act_fails_if_more_scripts_are_to_begin() {
    for tells in [Everything, Tells::Answers, Tells::Reports, Tells::Nothing] {
        for (until, fails) in [(50, true), (1_250, false)] {
            let mut played = plays_a_chain(tells, ClockMode::Ntp, ms(3));
            let start = played.mission.acts[0].timing().unwrap().start;
            played.run_until(start + ms(until));
            // Further than the robot's answers can contradict its reports.
            played.ahead = [(R0, ms(-100))].into();
            played.run_until(start + ms(until + 1_100));
            let clock = |(_, kind): &(RobotIndex, FailureKind)| matches!(kind, FailureKind::Clock { .. });
            assert_eq!(blamed(&played.mission).iter().any(clock), fails, "{tells:?}, {until} ms");
        }
    }
}

#[test]
fn script_deferred_for_silence_is_not_sent_before_response_on_new_link() {
    let mut mission = begins_at_once(Tells::Nothing);
    let sent = happens(&mut mission, at(0), Event::LinkUp { robot: R0 });
    let script = sent.into_iter().find_map(|action| match action {
        Action::Send { message: message @ Message::ControlRequest(_), .. } => Some(message),
        _ => None,
    });
    mission.take_times(at(2), R0, shows(0));
    let down = Event::LinkDown { robot: R0, loss: Loss::Closed, reason: "it broke".to_owned() };
    let _reconnects = happens(&mut mission, at(3), down);
    let _asks = happens(&mut mission, at(4), Event::LinkUp { robot: R0 });
    for sends in [0, 1] {
        mission.outbox.deferred = vec![(R0, script.clone().unwrap())];
        mission.outbox.actions.clear();
        mission.send_deferred(at(6));
        assert_eq!(scripts_in(&mission.outbox.actions).len(), sends);
        let there = by_robot(at(5));
        mission.take_times(at(6), R0, ClockSample::from_exchange(at(5), there, there, at(6)));
    }
}
