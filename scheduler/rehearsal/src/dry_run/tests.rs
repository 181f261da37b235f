//! Whole missions in virtual time: invariants that hold regardless of a robot's behaviour.

mod approach;
mod motions;

use downbeat_robot::set_log::LogEntry;
use downbeat_robot::simulated::{Fault, Settings, SimulatedRobot};
use downbeat_scripts::{
    Act, Choreography, DeviceScript, Plan, Requirements, RobotPlan, SensorRange, Wait, Way,
};
use urrcp::{
    ControlType, DeviceId, InitializationBlock, Millis, RobotId, Script, Server, Setpoint, Span, Step,
    StopCondition, Timestamp,
};

use super::{Audience, BEGIN, Cut, Played, Rehearsal, play};
use downbeat_mission::report::Outcome;
use downbeat_mission::{Greeting, Mission, MissionOptions, Participant, Progress, Standing};

const ARM: &str = r#"{"id": "arm", "api_version": "1", "reports": true, "devices": [
  {"id": "shoulder", "name": "shoulder", "default_value": 0, "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 1},
     "script": {"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 8}}}]}"#;

fn block(id: usize) -> InitializationBlock {
    let mut block: InitializationBlock = serde_json::from_str(ARM).unwrap();
    block.id = RobotId::new(format!("arm-{id}")).unwrap();
    block
}

fn plan(robots: usize) -> Plan {
    let step = |millis, value| Step {
        offset: Millis::new(millis).unwrap(),
        setpoint: Setpoint::new(ControlType::Position, value),
        stop_condition: None,
    };
    let running = Millis::new(2_000.0).ok();
    let stop_condition = StopCondition { pending: None, running };
    let script = DeviceScript {
        device: DeviceId::new("shoulder").unwrap(),
        start: Millis::ZERO,
        stop_condition,
        script: Script::new(vec![step(0.0, 45.0), step(1_000.0, 0.0), step(2_000.0, 45.0)]).unwrap(),
        rest: Span::ZERO,
    };
    let robots = (0..robots).map(|id| RobotPlan { robot: block(id).id, scripts: vec![script.clone()] });
    Plan {
        scenario: "wave".into(),
        start_tolerance: Span::from_millis(10),
        lead: None,
        stop_condition,
        robots: robots.collect(),
    }
}

fn play_with(settings: Vec<Settings>, options: MissionOptions) -> Played {
    let robots = settings.len();
    let machines: Vec<_> =
        settings.into_iter().enumerate().map(|(id, s)| SimulatedRobot::new(block(id), s)).collect();
    let participants: Vec<_> =
        (0..robots).map(|id| Participant::new(block(id).id, Some(block(id)))).collect();
    play(Mission::of_plan(plan(robots), participants, options, BEGIN).unwrap(), machines)
}

fn six(change: impl Fn(usize, &mut Settings)) -> Vec<Settings> {
    let one = |id| {
        let mut settings = Settings {
            seed: id as u64,
            clock_offset: Span::from_millis(100 * id as i64),
            ntp_error: Some(Span::from_micros(40)),
            delay: Some((Span::ZERO, Span::from_millis(80))),
            ..Settings::default()
        };
        change(id, &mut settings);
        settings
    };
    (0..6).map(one).collect()
}

fn moved(logs: &[Vec<LogEntry>]) -> usize {
    logs.iter().filter(|log| log.iter().any(|entry| entry.is_set())).count()
}

#[test]
fn six_robots_on_slow_links_start_within_their_clock_error() {
    let played = play_with(six(|_, _| {}), MissionOptions::default());
    assert_eq!(played.report.outcome, Outcome::Done);
    let starts: Vec<i64> = played.logs.iter().map(|log| log[0].true_ns).collect();
    let spread = starts.iter().max().unwrap() - starts.iter().min().unwrap();
    assert!(spread > 0 && spread <= 80_000, "spread {spread} ns");
    assert_eq!(played.report.true_spread, Some(Span::from_nanos(spread)));
    assert!(played.report.robots.iter().all(|robot| robot.steps_done == 3));
    let values: Vec<f64> = played.logs[0].iter().map(|entry| entry.value).collect();
    assert_eq!(values, [45.0, 0.0, 45.0]);
    assert_eq!(played.logs[0][2].due - played.logs[0][0].due, Span::from_millis(2_000));
}

#[track_caller]
fn check_none_starts(fault: Fault, says: &str) {
    let settings = six(|id, settings| settings.fault = (id == 3).then_some(fault));
    let played = play_with(settings, MissionOptions::default());
    assert_eq!(played.report.outcome, Outcome::NotStarted);
    assert_eq!(moved(&played.logs), 0, "{:?}", played.logs);
    let failure = &played.report.failures[0];
    assert_eq!(failure.robot.as_str(), "arm-3");
    assert!(failure.kind.to_string().contains(says), "{}", failure.kind);
}

#[test]
fn no_robot_starts_if_one_refuses() {
    check_none_starts(Fault::Refuse, "busy");
}

#[test]
fn no_robot_starts_if_one_is_silent() {
    check_none_starts(Fault::Silent, "silent: no acceptance by `shoulder`");
}

#[test]
fn no_robot_starts_if_one_disconnects_after_acceptance() {
    check_none_starts(Fault::Disconnect, "link down");
}

#[test]
fn certainly_wrong_clock_keeps_the_fleet_from_starting() {
    let settings = six(|id, settings| {
        settings.delay = None;
        settings.ntp_error = (id != 2).then_some(Span::ZERO);
    });
    let played = play_with(settings, MissionOptions::default());
    assert_eq!(played.report.outcome, Outcome::NotStarted);
    assert!(played.report.failures[0].kind.to_string().contains("clock off by 200 ms"));
    assert_eq!(moved(&played.logs), 0);
}

#[test]
fn each_robot_that_prevents_a_start_is_named_once_with_its_own_reason() {
    let settings = six(|id, settings| {
        settings.delay = (id == 4).then_some((Span::from_millis(60_000), Span::from_millis(60_000)));
        settings.ntp_error = (id != 2).then_some(Span::ZERO);
    });
    let played = play_with(settings, MissionOptions::default());
    let mut said: Vec<String> =
        played.report.failures.iter().map(|f| format!("{}: {}", f.robot, f.kind)).collect();
    said.sort();
    assert_eq!(played.report.outcome, Outcome::NotStarted);
    let [clock, silent] = said.as_slice() else { panic!("{said:?}") };
    assert!(clock.starts_with("arm-2") && clock.contains("clock off"), "{clock}");
    assert!(silent.starts_with("arm-4") && silent.contains("silent"), "{silent}");
}

#[test]
fn short_lead_is_refused_with_the_required_lead() {
    let options = MissionOptions { lead: Some(Span::from_millis(100)), ..MissionOptions::default() };
    let played = play_with(six(|_, _| {}), options);
    let Outcome::LeadTooShort { needed, .. } = played.report.outcome else {
        panic!("{:?}", played.report.outcome)
    };
    assert!(needed.total() > Span::from_millis(100));
    assert_eq!(moved(&played.logs), 0);
    let enough = MissionOptions { lead: Some(needed.total()), ..MissionOptions::default() };
    assert_eq!(play_with(six(|_, _| {}), enough).report.outcome, Outcome::Done);
}

#[test]
fn static_fleet_starts_without_protocol_steps_one_to_four() {
    let settings = six(|_, settings| settings.delay = None);
    let options = MissionOptions { greeting: Greeting::Skip, ..MissionOptions::default() };
    let played = play_with(settings, options);
    assert_eq!(played.report.outcome, Outcome::Done);
    assert_eq!(moved(&played.logs), 6);
}

#[test]
fn same_seed_gives_the_same_mission() {
    let json = |played: Played| serde_json::to_string(&played.report).unwrap();
    let once = json(play_with(six(|_, _| {}), MissionOptions::default()));
    assert_eq!(once, json(play_with(six(|_, _| {}), MissionOptions::default())));
}

fn with_policy(policy: downbeat_scripts::OnFailure, settings: Vec<Settings>) -> Played {
    let robots = settings.len();
    let machines: Vec<_> =
        settings.into_iter().enumerate().map(|(id, s)| SimulatedRobot::new(block(id), s)).collect();
    let participants: Vec<_> =
        (0..robots).map(|id| Participant::new(block(id).id, Some(block(id)))).collect();
    let mut choreography = downbeat_scripts::Choreography::of_plan(plan(robots));
    choreography.acts[0].on_failure.default = policy;
    let mission = Mission::new(choreography, participants, MissionOptions::default(), BEGIN).unwrap();
    play(mission, machines)
}

#[test]
fn others_continue_without_a_robot_that_refuses() {
    let settings = six(|id, settings| {
        settings.delay = None;
        settings.fault = (id == 3).then_some(Fault::Refuse);
    });
    let played = with_policy(downbeat_scripts::OnFailure::Without, settings);
    assert_eq!(played.report.outcome, Outcome::DoneWithout);
    assert_eq!(moved(&played.logs), 5);
    let standings: Vec<_> = played.report.robots.iter().map(|robot| robot.standing).collect();
    let taking_part = Standing::In;
    assert_eq!(standings, [taking_part, taking_part, taking_part, Standing::Out, taking_part, taking_part]);
}

#[test]
fn robot_without_ntp_starts_with_the_others_if_its_clock_is_measured() {
    let machines: Vec<_> = (0..2)
        .map(|id| {
            let ntp_error = (id == 0).then_some(Span::ZERO);
            let clock_offset = Span::from_millis(2_345);
            let delay = Some((Span::from_millis(1), Span::from_millis(3)));
            let settings =
                Settings { clock_offset, drift_ppm: 30.0, ntp_error, delay, ..Settings::default() };
            SimulatedRobot::new(block(id), settings)
        })
        .collect();
    let participant = |id| {
        let clock =
            if id == 1 { downbeat_mission::ClockMode::Measured } else { downbeat_mission::ClockMode::Ntp };
        let mut participant = Participant::new(block(id).id, Some(block(id)));
        participant.settings.clock = clock;
        participant
    };
    let participants = (0..2).map(participant).collect();
    let mission = Mission::of_plan(plan(2), participants, MissionOptions::default(), BEGIN).unwrap();
    let played = play(mission, machines);
    assert_eq!(played.report.outcome, Outcome::Done, "{:?}", played.report.failures);
    let skew = played.report.acts[0].skew.clone().unwrap();
    assert!(played.report.true_spread.unwrap() <= skew.predicted, "{:?} {skew:?}", played.report.true_spread);
    assert!(played.report.robots[1].clock.unwrap().offset > Span::from_millis(2_300));
}

/// Creates a rehearsal of consecutive acts, in each of which two arms move. `change` may change the acts.
fn acts(change: impl Fn(&mut Vec<Act>)) -> Rehearsal {
    acts_with(MissionOptions::default(), change)
}

fn acts_with(options: MissionOptions, change: impl Fn(&mut Vec<Act>)) -> Rehearsal {
    acts_on(block, options, change)
}

fn acts_on(
    block: impl Fn(usize) -> InitializationBlock,
    options: MissionOptions,
    change: impl Fn(&mut Vec<Act>),
) -> Rehearsal {
    let mut acts: Vec<Act> = (0..3)
        .map(|number| {
            let mut act = Choreography::of_plan(plan(2)).acts.remove(0);
            act.name = format!("act-{number}");
            act.next = if number == 2 { Way::End } else { Way::Act(number + 1) };
            act
        })
        .collect();
    change(&mut acts);
    let machines = (0..2).map(|id| SimulatedRobot::new(block(id), Settings::default())).collect();
    let participants = (0..2).map(|id| Participant::new(block(id).id, Some(block(id)))).collect();
    let choreography = Choreography { scenario: "acts".into(), acts, requirements: Requirements::default() };
    Rehearsal::new(choreography, participants, options, machines).unwrap()
}

/// An audience that panics if the mission does not end.
struct Patience {
    seconds: u32,
    acts: u32,
}

impl Audience for Patience {
    fn told(&mut self, _: Timestamp<Server>, progress: &Progress) {
        self.acts += u32::from(matches!(progress, Progress::ActEnded { .. }));
    }

    fn second(&mut self, _: Timestamp<Server>) {
        self.seconds += 1;
        assert!(self.seconds < 2_000, "virtual time does not end");
    }
}

fn played_through(rehearsal: Rehearsal) -> (Played, u32) {
    let mut patience = Patience { seconds: 0, acts: 0 };
    let played = rehearsal.play_before(&mut patience);
    (played, patience.acts)
}

#[test]
fn operator_go_applies_to_whichever_act_waits_for_it() {
    for waiting in [&[0][..], &[1], &[2], &[1, 2], &[0, 1, 2]] {
        let rehearsal = acts(|acts| waiting.iter().for_each(|act| acts[*act].wait = Wait::Operator));
        let (played, ended) = played_through(rehearsal);
        assert_eq!((played.report.outcome, ended), (Outcome::Done, 3), "{waiting:?} waits");
        assert_eq!(played.cut, None);
    }
}

fn bounded(acts_max: u32) -> MissionOptions {
    MissionOptions { acts_max: Some(acts_max), ..MissionOptions::default() }
}

#[test]
fn loop_of_acts_is_played_three_times_or_as_often_as_requested() {
    let looped = |options| acts_with(options, |acts| acts[2].next = Way::Act(1));
    for (options, bound) in [(MissionOptions::default(), 9), (bounded(4), 4), (bounded(1), 1)] {
        let (played, ended) = played_through(looped(options));
        assert_eq!((played.report.acts.len(), ended), (bound as usize, bound));
        assert_eq!(played.report.outcome, Outcome::Done, "{:?}", played.report.failures);
        assert!(played.report.robots.iter().all(|robot| robot.steps_done == robot.steps_planned));
        assert_eq!((played.report.acts_max_reached, played.cut), (Some(bound), None));
    }
}

#[test]
fn mission_that_ends_at_its_act_limit_reports_it() {
    let (played, _) = played_through(acts_with(bounded(2), |_| {}));
    assert_eq!(serde_json::to_value(&played.report).unwrap()["acts_max_reached"], 2);
    let (played, ended) = played_through(acts_with(bounded(3), |_| {}));
    assert_eq!((played.report.acts_max_reached, ended), (None, 3), "there was no other");
}

#[test]
fn act_after_a_failure_counts_against_the_act_limit() {
    for (acts_max, reached) in [(1, Some(1)), (2, None)] {
        let mut rehearsal = acts_with(bounded(acts_max), |acts| acts[0].on_failure.then = Some(2));
        let refuses = Settings { fault: Some(Fault::Refuse), ..Settings::default() };
        rehearsal.robots[1] = SimulatedRobot::new(block(1), refuses);
        let (played, _) = played_through(rehearsal);
        assert_eq!(played.report.acts_max_reached, reached, "{:?}", played.report.failures);
        assert_ne!(played.report.outcome, Outcome::Done);
    }
}

#[test]
fn act_waiting_for_a_missing_reading_does_not_wait_forever() {
    let range = SensorRange::Above(1e9);
    let waits = Wait::Sensor { robot: block(0).id.to_string(), sensor: "none".into(), range };
    let (played, ended) = played_through(acts(|acts| acts[1].wait = waits.clone()));
    assert_eq!(ended, 1);
    assert!(matches!(&played.cut, Some(Cut { act, .. }) if act == "act-1"), "{:?}", played.cut);
    let given_up = acts(|acts| {
        acts[1].wait = waits.clone();
        acts[1].timeout = Some(Span::from_millis(300_000));
        acts[1].on_timeout = Way::Act(2);
    });
    let (played, ended) = played_through(given_up);
    let skipping = Outcome::DoneSkipping { acts: vec!["act-1".to_owned()] };
    assert_eq!((played.report.outcome, ended, played.cut), (skipping, 2, None));
}

#[test]
fn act_that_waits_for_a_time_waits_for_as_long_as_that_takes() {
    let later = Wait::TimeOfDay(Span::from_millis(72_000_000));
    let (played, ended) = played_through(acts(|acts| acts[1].wait = later.clone()));
    assert_eq!((played.report.outcome, ended, played.cut), (Outcome::Done, 3, None));
}

#[test]
fn acts_that_only_wait_for_each_other_do_not_repeat_forever() {
    let waits = Wait::Sensor {
        robot: block(0).id.to_string(),
        sensor: "none".into(),
        range: SensorRange::Above(1e9),
    };
    let (played, _) = played_through(acts(|acts| {
        acts[1].wait = waits.clone();
        acts[1].timeout = Some(Span::from_millis(1_000));
        acts[1].on_timeout = Way::Act(1);
    }));
    assert_eq!((played.report.acts_max_reached, played.report.acts.len()), (Some(9), 1));
}

/// An audience that keeps the reasons for stopping all robots, as reported to the operator.
#[derive(Default)]
struct Reasons(Vec<String>);

impl Audience for Reasons {
    fn told(&mut self, _: Timestamp<Server>, progress: &Progress) {
        if let Progress::Stopping { reason, .. } = progress {
            self.0.push(reason.clone());
        }
    }

    fn second(&mut self, _: Timestamp<Server>) {}
}

#[test]
fn stop_reason_names_the_failed_robot_or_counts_missing_acceptances() {
    let again = "2 of 2 robots did not accept their scripts in time; `act-0` is prepared again";
    for (refuse, begins) in [(&[1][..], "arm-1: "), (&[0, 1], again)] {
        let mut rehearsal = acts(|_| {});
        for robot in refuse {
            let refuses = Settings { fault: Some(Fault::Silent), ..Settings::default() };
            rehearsal.robots[*robot] = SimulatedRobot::new(block(*robot), refuses);
        }
        let mut reasons = Reasons::default();
        let played = rehearsal.play_before(&mut reasons);
        assert_eq!(played.report.outcome, Outcome::NotStarted);
        let [reason] = reasons.0.as_slice() else { panic!("{:?}", reasons.0) };
        assert!(reason.starts_with(begins), "{reason}");
        let failed: Vec<_> = played.report.failures.iter().map(|failure| failure.robot.to_string()).collect();
        assert_eq!(failed, refuse.iter().map(|robot| format!("arm-{robot}")).collect::<Vec<_>>());
    }
}

#[test]
fn acts_without_waits_follow_each_other_without_a_gap() {
    // A device that holds only one script accepts the next one only after the first has ended.
    for (queue, gap) in [(1, Span::from_millis(371)), (2, Span::ZERO)] {
        let block = |id| {
            let mut block = block(id);
            block.devices[0].script_queue = queue;
            block
        };
        let (played, _) = played_through(acts_on(block, MissionOptions::default(), |_| {}));
        let gaps: Vec<_> = played.report.acts.iter().map(|act| act.gap).collect();
        assert_eq!(gaps, [None, Some(gap), Some(gap)]);
        for (before, act) in played.report.acts.iter().zip(&played.report.acts[1..]) {
            assert_eq!(act.start, before.start + Span::from_millis(2_000) + gap);
        }
    }
}

/// An arm whose shoulder moves linearly and reports its position, and which has a separate sensor.
const WITH_SENSORS: &str = r#"{"id": "arm-0", "api_version": "1", "reports": true, "devices": [
  {"id": "shoulder", "name": "shoulder", "default_value": 0, "interpolation": "linear", "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 1},
     "sensor": {"min_value": 0, "max_value": 90},
     "script": {"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 8}}},
  {"id": "eye", "name": "eye", "unit": "m", "available_control_types": {"sensor": {"min_value": 0, "max_value": 4}}}]}"#;

/// An audience that keeps the reports of the preflight (the checks before the start).
#[derive(Default)]
struct Shown(Vec<downbeat_mission::Preflight>);

impl Audience for Shown {
    fn told(&mut self, _: Timestamp<Server>, progress: &Progress) {
        if let Progress::Greeted { preflight, .. } = progress {
            self.0.push(preflight.clone());
        }
    }

    fn second(&mut self, _: Timestamp<Server>) {}
}

/// Returns the outcome and the preflight report (of checks before the start) for an arm with sensors, whose shoulder sensor reads
/// `shoulder`.
fn preflight_at(shoulder: f64) -> (Outcome, downbeat_mission::Preflight) {
    let block: InitializationBlock = serde_json::from_str(WITH_SENSORS).unwrap();
    let machines = vec![SimulatedRobot::new(block.clone(), Settings::default())];
    let participants = vec![Participant::new(block.id.clone(), Some(block.clone()))];
    let options = MissionOptions { preflight_only: true, ..MissionOptions::default() };
    let mut rehearsal =
        Rehearsal::new(Choreography::of_plan(plan(1)), participants, options, machines).unwrap();
    for (sensor, reading) in [("shoulder", shoulder), ("eye", 0.5)] {
        assert!(rehearsal.set_reading(&block.id, &DeviceId::new(sensor).unwrap(), reading));
    }
    let mut shown = Shown::default();
    let played = rehearsal.play_before(&mut shown);
    let [preflight] = shown.0.try_into().unwrap();
    (played.report.outcome, preflight)
}

#[test]
fn device_may_be_two_grid_steps_from_the_first_keyframe() {
    for (stands, outcome) in [
        (45.0, Outcome::Ready),
        (47.0, Outcome::Ready),
        (43.0, Outcome::Ready),
        (47.5, Outcome::NotReady),
        (42.5, Outcome::NotReady),
    ] {
        assert_eq!(preflight_at(stands).0, outcome, "at {stands}");
    }
}

#[test]
fn preflight_shows_every_sensor_reading() {
    let (_, preflight) = preflight_at(45.0);
    let readings: Vec<_> = preflight.rows[0]
        .readings
        .iter()
        .map(|read| (read.device.as_str(), read.reading, read.unit.as_deref(), read.expected.as_deref()))
        .collect();
    assert_eq!(
        readings,
        [("shoulder", Some(45.0), None, Some("45 ±2")), ("eye", Some(0.5), Some("m"), None)]
    );
}
