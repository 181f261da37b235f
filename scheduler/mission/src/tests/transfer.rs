//! Acts that are planned after a stop: the move to the default positions, and the approach to the act after a failure.

use std::sync::Mutex;

use downbeat_plan::{FailurePolicy, OnFailure, Positions};

use super::course::{broken, fates};
use super::played::Played;
use super::*;
use crate::bench::ms;
use crate::transfer::{Destination, PlanTransfer, TransferReport};

/// Plans an act of 400 ms for the robots that take part, and keeps the positions from which it starts.
#[derive(Debug)]
struct Planner {
    answer: Result<bool, &'static str>,
    /// The id of a robot that the planner leaves out because it has nothing to move; `None` if all robots move.
    skips: Mutex<Option<&'static str>>,
    from: Mutex<Vec<Positions>>,
}

impl PlanTransfer for Planner {
    fn plan(
        &self,
        _: &Choreography,
        _: Destination,
        _: ActIndex,
        from: &Positions,
    ) -> Result<Option<downbeat_plan::Act>, String> {
        self.from.lock().unwrap().push(from.clone());
        let mut act = choreography(&[&[("a", 0, 400)], &[("a", 0, 400)]]).acts.remove(0);
        act.name = "home".to_owned();
        let skips = *self.skips.lock().unwrap();
        let skips = |robot: &RobotId| skips.is_some_and(|skipped| skipped == robot.as_str());
        act.plan.robots.retain(|planned| from.contains_key(&planned.robot) && !skips(&planned.robot));
        self.answer.map(|moves| moves.then_some(act)).map_err(str::to_owned)
    }
}

/// A mission in which two robots play an act of 10 s and can move home.
fn plays(answer: Result<bool, &'static str>, on_failure: OnFailure) -> (Played, Arc<Planner>) {
    let planner = Arc::new(Planner { answer, skips: Mutex::default(), from: Mutex::default() });
    let mut choreography = choreography(&[&[("a", 0, 10_000)], &[("a", 0, 10_000)]]);
    choreography.acts[0].on_failure = FailurePolicy { default: on_failure, ..FailurePolicy::default() };
    let participant = |id: &str| Participant::new(RobotId::new(id).unwrap(), robot(id, Everything, 2).block);
    let participants = ["r0", "r1"].map(participant).to_vec();
    let transfer: Option<Arc<dyn PlanTransfer>> = Some(planner.clone());
    let options = MissionOptions { greeting: Greeting::Skip, transfer, ..MissionOptions::default() };
    let mission = Mission::new(Arc::new(choreography), participants, options, at(0)).unwrap();
    let mut played = Played::begun(mission);
    played.positions = [("a".parse().unwrap(), 45.0)].into();
    played.run_to_the_start();
    (played, planner)
}

fn says(played: &mut Played, rest: Rest) {
    played.happens(Event::StopRequested { rest, by: None });
}

fn homes_sent(played: &Played) -> usize {
    let home = |message: &Message| matches!(message, Message::ControlRequest(request) if request.home);
    played.sent.iter().filter(|(.., message)| home(message)).count()
}

/// The kind of rest that each robot has confirmed.
fn rests(played: &Played) -> Vec<Option<Rest>> {
    let rest = |robot: &RobotState| match robot.halt.stop {
        Stop::Confirmed(rest) => Some(rest),
        Stop::None | Stop::Sent(_) => None,
    };
    played.mission.robots().iter().map(rest).collect()
}

#[test]
fn robots_rest_and_then_play_a_way_home_planned_from_their_positions() {
    let (mut played, planner) = plays(Ok(true), OnFailure::Stop);
    says(&mut played, Rest::Home);
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    assert_eq!(homes_sent(&played), 0, "no robot goes home on its own");
    assert_eq!(fates(&played), [ActFate::Stopped, ActFate::Played]);
    let planned = TransferReport::Planned { act: "home".to_owned(), without: Vec::new() };
    assert_eq!(played.mission.home(), Some(&planned));
    assert_eq!(rests(&played), [Some(Rest::Home), Some(Rest::Home)]);
    let from = planner.from.lock().unwrap();
    let stated: Vec<_> = from.iter().flatten().flat_map(|(_, devices)| devices.values()).collect();
    assert_eq!(stated, [&45.0, &45.0]);
}

#[test]
fn way_home_is_planned_only_for_devices_the_mission_has_moved() {
    for states_all in [false, true] {
        let (mut played, planner) = plays(Ok(true), OnFailure::Stop);
        played.positions = ["a", "b", "c"].map(|device| (device.parse().unwrap(), 45.0)).into();
        played.states_all = states_all;
        says(&mut played, Rest::Home);
        assert_eq!(played.run_to_the_end(), Outcome::Stopped);
        let from = planner.from.lock().unwrap();
        let devices: Vec<_> = from.iter().flatten().flat_map(|(_, devices)| devices.keys()).collect();
        assert_eq!(devices, [&"a".parse::<DeviceId>().unwrap(); 2], "it states all devices: {states_all}");
    }
}

#[test]
fn robot_with_nothing_to_move_has_confirmed_its_stop() {
    let (mut played, planner) = plays(Ok(true), OnFailure::Stop);
    *planner.skips.lock().unwrap() = Some("r1");
    says(&mut played, Rest::Home);
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    let planned = TransferReport::Planned { act: "home".to_owned(), without: Vec::new() };
    assert_eq!(played.mission.home(), Some(&planned));
    assert_eq!(rests(&played), [Some(Rest::Home), Some(Rest::InPlace)]);
}

#[test]
fn slowing_device_is_read_until_it_is_at_rest() {
    let (mut played, planner) = plays(Ok(true), OnFailure::Stop);
    says(&mut played, Rest::Home);
    for position in [46.0, 47.0, 48.0] {
        played.positions = [("a".parse().unwrap(), position)].into();
        played.run_until(played.now + ms(150));
        assert!(planner.from.lock().unwrap().is_empty(), "planned from {position}");
    }
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    let from = planner.from.lock().unwrap();
    let stated: Vec<_> = from.iter().flatten().flat_map(|(_, devices)| devices.values()).collect();
    assert_eq!(stated, [&48.0, &48.0]);
}

#[test]
fn robots_stay_in_place_without_a_plan_and_the_reason_is_reported() {
    let (mut played, _) = plays(Err("a and b collide"), OnFailure::Stop);
    says(&mut played, Rest::Home);
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    let reason = "a and b collide".to_owned();
    assert_eq!(played.mission.home(), Some(&TransferReport::NotPlanned { reason: reason.clone() }));
    assert!(
        played.told.iter().any(|told| matches!(told, Progress::NotHome { reason: told } if *told == reason))
    );
    assert_eq!(rests(&played), [Some(Rest::InPlace), Some(Rest::InPlace)]);
}

#[test]
fn devices_at_their_default_positions_are_home() {
    let (mut played, _) = plays(Ok(false), OnFailure::Stop);
    says(&mut played, Rest::Home);
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    assert_eq!(played.mission.home(), Some(&TransferReport::NothingToMove));
    assert_eq!(played.told.iter().filter(|told| matches!(told, Progress::AtHome)).count(), 1);
    assert_eq!(rests(&played), [Some(Rest::Home), Some(Rest::Home)]);
}

#[test]
fn no_robot_goes_home_if_none_can_take_part() {
    let (mut played, planner) = plays(Ok(true), OnFailure::Home);
    let actions = {
        let failing = vec![(R0, broken()), (R1, broken())];
        played.mission.fail_all(played.now, failing);
        std::mem::take(&mut played.mission.outbox.actions)
    };
    played.carry_out(actions);
    assert_eq!(played.run_to_the_end(), Outcome::Failed);
    assert!(planner.from.lock().unwrap().is_empty());
    let reason = "`r0` has failed or does not report its positions".to_owned();
    assert_eq!(played.mission.home(), Some(&TransferReport::NotPlanned { reason }));
}

/// The event that the second robot's process has ended.
fn gone() -> Event {
    Event::LinkDown { robot: R1, loss: Loss::Refused, reason: "refused".to_owned() }
}

#[test]
fn lost_robot_does_not_keep_the_others_from_going_home() {
    let (mut played, _) = plays(Ok(true), OnFailure::Stop);
    played.mute = vec![R1];
    says(&mut played, Rest::Home);
    played.happens(gone());
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    let without = vec![RobotId::new("r1").unwrap()];
    assert_eq!(played.mission.home(), Some(&TransferReport::Planned { act: "home".to_owned(), without }));
    assert_eq!(rests(&played), [Some(Rest::Home), None]);
}

#[test]
fn robots_stay_in_place_without_a_journal() {
    let (mut played, planner) = plays(Ok(true), OnFailure::Stop);
    says(&mut played, Rest::Home);
    played.happens(Event::JournalLost { reason: "full".to_owned() });
    played.run_to_the_end();
    assert!(planner.from.lock().unwrap().is_empty());
    assert!(matches!(played.mission.home(), Some(TransferReport::NotPlanned { .. })));
    assert_eq!(rests(&played), [Some(Rest::InPlace), Some(Rest::InPlace)]);
}

/// Runs until the move to the default positions has started.
fn runs_home(played: &mut Played) {
    while !played.mission.is_on_its_way_home() {
        played.run_until(played.now + ms(10));
    }
    played.run_to_the_start();
}

#[test]
fn stop_on_the_way_home_leaves_robots_in_place_and_home_again_is_ignored() {
    let (mut played, _) = plays(Ok(true), OnFailure::Stop);
    says(&mut played, Rest::Home);
    runs_home(&mut played);
    let sent = played.sent.len();
    says(&mut played, Rest::Home);
    assert_eq!(played.sent.len(), sent, "it is on its way");
    says(&mut played, Rest::InPlace);
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    assert_eq!(fates(&played), [ActFate::Stopped, ActFate::Stopped]);
    assert_eq!(rests(&played), [Some(Rest::InPlace), Some(Rest::InPlace)]);
}

#[test]
fn stop_immediately_after_home_leaves_robots_in_place() {
    let (mut played, planner) = plays(Ok(true), OnFailure::Stop);
    says(&mut played, Rest::Home);
    says(&mut played, Rest::InPlace);
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    assert!(planner.from.lock().unwrap().is_empty());
    let (mut played, _) = plays(Ok(true), OnFailure::Stop);
    says(&mut played, Rest::InPlace);
    says(&mut played, Rest::Home);
    assert_eq!(played.run_to_the_end(), Outcome::Stopped);
    assert_eq!(fates(&played), [ActFate::Stopped, ActFate::Played]);
}

#[test]
fn other_robots_go_home_after_a_failure_and_the_failed_one_stays() {
    let (mut played, _) = plays(Ok(true), OnFailure::Home);
    let actions = {
        played.mission.fail(played.now, R1, broken());
        std::mem::take(&mut played.mission.outbox.actions)
    };
    played.carry_out(actions);
    assert_eq!(played.run_to_the_end(), Outcome::Failed);
    let without = vec![RobotId::new("r1").unwrap()];
    assert_eq!(played.mission.home(), Some(&TransferReport::Planned { act: "home".to_owned(), without }));
    assert_eq!(rests(&played), [Some(Rest::Home), Some(Rest::InPlace)]);
}

#[test]
fn no_robot_goes_home_while_one_may_still_move() {
    let (mut played, planner) = plays(Ok(true), OnFailure::Stop);
    played.mute = vec![R1];
    played.mission.robots[R1].settings.clock = ClockMode::Ntp;
    let still: Vec<_> = vec![None];
    says(&mut played, Rest::Home);
    played.mission.robots[R1].halt.left = still;
    played.run_until(played.now + ms(60_000));
    assert!(planner.from.lock().unwrap().is_empty());
    assert!(
        matches!(played.mission.home(), Some(TransferReport::NotPlanned { .. })),
        "{:?}",
        played.mission.home()
    );
}

/// Fails the mission while it plays. The robots come to rest as `rest` specifies, and another act follows.
fn fails_towards_another_act(played: &mut Played, rest: Rest) {
    stops_before_another_act(played, rest);
    assert_eq!(played.run_to_the_end(), Outcome::Failed);
}

/// Like `fails_towards_another_act`, but runs only until the stop.
fn stops_before_another_act(played: &mut Played, rest: Rest) {
    let then = Arc::make_mut(&mut played.mission.choreography);
    let mut after = choreography(&[&[("a", 0, 400)], &[("a", 0, 400)]]).acts.remove(0);
    after.name = "after".to_owned();
    then.acts.push(after);
    played.mission.course.fates.push(ActCourse { act: "after".to_owned(), ..ActCourse::default() });
    let (failed, reason) = (Outcome::Failed, "broken".to_owned());
    played.mission.abort_because(played.now, failed, reason, rest, Some(ActIndex::new(1)));
    let actions = std::mem::take(&mut played.mission.outbox.actions);
    played.carry_out(actions);
}

#[test]
fn act_after_a_failure_begins_once_robots_are_at_their_first_positions() {
    for rest in [Rest::Home, Rest::InPlace] {
        for (answer, fate) in [(Ok(true), ActFate::Played), (Err("a and b collide"), ActFate::NotReached)] {
            let (mut played, planner) = plays(answer, OnFailure::Stop);
            fails_towards_another_act(&mut played, rest);
            assert_eq!(fates(&played)[1], fate);
            let from = planner.from.lock().unwrap();
            let stated: Vec<_> = from.iter().flatten().flat_map(|(_, devices)| devices.values()).collect();
            assert_eq!(stated, [&45.0, &45.0]);
            let mission = &played.mission;
            let report = if rest == Rest::Home { mission.home() } else { mission.approach() };
            assert_eq!(matches!(report, Some(TransferReport::Planned { .. })), answer.is_ok(), "{report:?}");
            let refused =
                |told: &&Progress| matches!(told, Progress::NotApproached { act, .. } if act == "after");
            let refused = played.told.iter().filter(refused).count();
            assert_eq!(refused, usize::from(rest == Rest::InPlace && answer.is_err()));
        }
    }
}

/// A mission that plans no approach after a failure. Its devices move linearly, and a stop leaves them at the position `rests_at`.
fn stays_at(rests_at: f64) -> Played {
    let (mut played, _) = plays(Ok(true), OnFailure::Stop);
    played.mission.options.transfer = None;
    for robot in &mut played.mission.robots {
        let devices = robot.block.iter_mut().flat_map(|block| block.devices.iter_mut());
        devices.for_each(|device| device.interpolation = urrcp::Interpolation::Linear);
    }
    played.positions = [("a".parse().unwrap(), rests_at)].into();
    played
}

#[test]
fn robots_do_not_jump_to_first_positions_of_the_act_after_a_failure() {
    for (rests_at, plays_it) in [(0.0, false), (45.0, true)] {
        let mut played = stays_at(rests_at);
        fails_towards_another_act(&mut played, Rest::InPlace);
        assert_eq!(fates(&played)[1] == ActFate::Played, plays_it, "from {rests_at}");
        let jumps = |told: &Progress| matches!(told, Progress::Failed(failure) if matches!(failure.kind, FailureKind::Position { .. }));
        let jumped = played.told.iter().any(jumps);
        assert_eq!(jumped, !plays_it, "from {rests_at}");
    }
}

/// Changes the robots so that they take no inquiries and their devices have sensors.
fn states_positions_by_sensors(played: &mut Played) {
    for block in played.mission.robots.iter_mut().flat_map(|robot| &mut robot.block) {
        block.inquiry = false;
        for device in block.devices.iter_mut() {
            *device = device.clone().with_sensor(urrcp::SensorParameters::new(0.0, 90.0).unwrap());
        }
    }
}

#[test]
fn position_that_never_rests_does_not_make_an_act_late() {
    for by_sensor in [false, true] {
        let mut played = stays_at(45.0);
        if by_sensor {
            states_positions_by_sensors(&mut played);
        }
        // The device is never at rest, and never too far from the first step of the act.
        played.jitters = 1.5;
        let start = played.now + ms(8_000);
        stops_before_another_act(&mut played, Rest::InPlace);
        Arc::make_mut(&mut played.mission.choreography).acts[1].wait = Wait::Instant(start);
        let _outcome = played.run_to_the_end();
        let starts = played.recorded.iter().filter_map(|record| match record {
            Record::Prepared(promise) if promise.act == ActIndex::new(1) => Some(promise.start - start),
            _ => None,
        });
        assert_eq!(starts.collect::<Vec<_>>(), [Span::ZERO], "by sensor: {by_sensor}");
    }
}

#[test]
fn slowing_device_is_read_until_at_rest_before_the_act_after_a_failure() {
    // The first step of the act is at 45. At first, the device is close to it.
    for (by_sensor, rests_at, plays_it) in
        [(false, 60.0, false), (false, 45.0, true), (true, 60.0, false), (true, 45.0, true)]
    {
        let mut played = stays_at(rests_at);
        if by_sensor {
            states_positions_by_sensors(&mut played);
        }
        played.slows = Some((played.now + ms(1_000), (44.9 - rests_at) / 1_000.0));
        fails_towards_another_act(&mut played, Rest::InPlace);
        assert_eq!(fates(&played)[1] == ActFate::Played, plays_it, "to {rests_at}, by sensor: {by_sensor}");
    }
}

#[test]
fn device_goes_home_from_its_rest_position_while_another_robot_is_silent() {
    let (mut played, planner) = plays(Ok(true), OnFailure::Stop);
    played.mute = vec![R1];
    played.slows = Some((played.now + ms(700), 0.01));
    says(&mut played, Rest::Home);
    played.happens(gone());
    let _outcome = played.run_to_the_end();
    let from = planner.from.lock().unwrap();
    let stated: Vec<_> = from.iter().flatten().flat_map(|(_, devices)| devices.values()).collect();
    assert_eq!(stated, [&45.0]);
}

#[test]
fn robot_that_confirms_its_stop_late_plays_the_next_act() {
    let (mut played, _) = plays(Ok(true), OnFailure::Stop);
    played.mission.options.transfer = None;
    played.mute = vec![R1];
    stops_before_another_act(&mut played, Rest::InPlace);
    played.happens(gone());
    let goes_on = played.now + played.mission.options.patience + ms(1);
    played.run_until(goes_on);
    assert!(matches!(played.mission.phase, Phase::Performing));
    played.mute.clear();
    played.happens(Event::LinkUp { robot: R1 });
    let _outcome = played.run_to_the_end();
    let script = |(at, robot, message): &(Timestamp<Server>, RobotIndex, Message)| {
        let Message::ControlRequest(request) = message else { return false };
        let moves = matches!(&request.command, urrcp::Command::Script(script) if !script.is_empty());
        *at > goes_on && *robot == R1 && moves
    };
    let sent = played.sent.iter().any(script);
    let stop = &played.mission.robots()[R1].halt.stop;
    assert!(sent && matches!(stop, Stop::None), "{sent}, {stop:?}");
    assert_eq!(fates(&played)[1], ActFate::Played);
}

#[test]
fn possible_movements_after_failures_are_announced_before_a_mission() {
    let mut show = choreography(&[&[("a", 0, 400)]]);
    for name in ["second", "third", "bow"] {
        let mut act = show.acts[0].clone();
        act.name = name.to_owned();
        show.acts.push(act);
    }
    show.acts[0].name = "first".to_owned();
    for act in 0..2 {
        show.acts[act].on_failure.then = Some(3);
    }
    show.acts[2].on_failure.robots = vec![(RobotId::new("r0").unwrap(), OnFailure::Home)];
    let announced = crate::preflight::after_failures(&show);
    let announced: Vec<_> =
        (announced.iter()).map(|after| (after.acts.join(" "), after.home, after.then.as_deref())).collect();
    let expected = [("first second".to_owned(), false, Some("bow")), ("third".to_owned(), true, None)];
    assert_eq!(announced, expected);
}
