//! Clocks that turn out to be others than an act was sent by.

use super::played::Played;
use super::*;
use crate::bench::ms;

/// One act of three robots that was sent. The clocks of the second and the third have been set since, in opposite directions,
/// and only the latter has not answered yet.
fn two_have_strayed() -> Mission {
    let scripts: [&[Planned]; 3] = [&[("a", 0, 400)]; 3];
    let participant = |id: &str| Participant::new(RobotId::new(id).unwrap(), robot(id, Everything, 2).block);
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let participants = ["r0", "r1", "r2"].map(participant).to_vec();
    let mut mission = Mission::new(Arc::new(choreography(&scripts)), participants, options, at(0)).unwrap();
    for robot in 0..3 {
        let _sent = happens(&mut mission, at(0), Event::LinkUp { robot });
    }
    mission.robots[0].clock.add(shows(0));
    mission.robots[1].clock.add(shows(50));
    mission
}

/// An exchange with a clock that is ahead by so many milliseconds.
fn shows(ahead: i64) -> ClockSample {
    let there = by_robot(at(1)) + ms(ahead);
    ClockSample::from_exchange(at(1), there, there, at(2))
}

fn blamed(mission: &Mission) -> Vec<(usize, FailureKind)> {
    let failures = |(index, robot): (usize, &RobotState)| {
        robot.failures.iter().map(move |failure| (index, failure.kind.clone())).collect::<Vec<_>>()
    };
    mission.robots.iter().enumerate().flat_map(failures).collect()
}

#[test]
fn all_robots_whose_clocks_have_strayed_fail_as_soon_as_it_shows() {
    let mut mission = two_have_strayed();
    assert_eq!(blamed(&mission), []);
    mission.take_times(at(2), 2, shows(-50));
    let blamed = blamed(&mission);
    assert!(
        matches!(blamed.as_slice(), [(1, FailureKind::Clock { .. }), (2, FailureKind::Clock { .. })]),
        "{blamed:?}"
    );
}

#[test]
fn a_robot_whose_clock_has_strayed_from_what_two_acts_were_sent_by_is_blamed_once() {
    let mut mission = two_have_strayed();
    let other = mission.acts[0].clone();
    mission.acts.push(other);
    mission.take_times(at(2), 2, shows(-50));
    let blamed = blamed(&mission);
    assert_eq!(blamed.len(), 2, "{blamed:?}");
}

/// Two acts of a robot whose clock is 400 ms ahead, and whose scripts have this running lease. Returns when the second act is sent and
/// when the robot ends the first one.
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
    let mut played = Played::linked(mission, &[0]);
    played.ahead = [(0, ahead)].into();
    played.run_until(at(50));
    let end = played.mission.acts[0].timing().unwrap().end - ahead;
    assert_eq!(played.run_to_the_end(), Outcome::Done, "{:?}", played.mission.robots[0].failures);
    let script = |message: &Message| matches!(message, Message::ControlRequest(request) if request.time_offset_to_start.is_some());
    let sent = played.sent.iter().filter(|(.., message)| script(message)).nth(1).unwrap();
    (sent.0, end)
}

#[test]
fn an_act_that_needs_a_longer_silence_than_the_leases_of_another_is_sent_after_its_end() {
    let (sent, end) = second_is_sent(2_000);
    assert!(sent < end, "the lease is longer than the silence: {sent}, {end}");
    let (sent, end) = second_is_sent(300);
    assert!(sent >= end, "{sent}, {end}");
}
