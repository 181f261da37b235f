//! Draws the choreography: acts with chains of scripts, what they wait for, and the consequences of failures.

use downbeat_fleet::sensor_range::SensorRange;
use downbeat_plan::{
    Act, Choreography, DeviceScript, FailurePolicy, OnDoubt, OnFailure, Plan, PlannedReading, Requirements,
    RobotPlan, Wait, Way,
};
use fastrand::Rng;
use urrcp::{ControlType, Device, Interpolation, Millis, Script, Setpoint, Span, Step, StopCondition};

use super::fleet::{DrawnRobot, Show};
use super::{millis, one_in};
use downbeat_rehearsal::dry_run::BEGIN;

/// The sensor reading above which an act that waits for the sensor starts.
pub(crate) const BRIGHT: f64 = 50.0;

pub(super) fn draw_choreography(rng: &mut Rng, robots: &[DrawnRobot], show: Show) -> Choreography {
    let count = match rng.u8(0..20) {
        _ if show == Show::Large => 1,
        0..=8 => 1,
        9..=14 => 2,
        15..=18 => 3,
        _ => 4,
    };
    let running = match rng.u8(0..8) {
        0 => None,
        _ => Millis::new(f64::from(rng.u32(300..2_500))).ok(),
    };
    let pending = one_in(rng, 12).then(|| f64::from(rng.u32(300..1_500)));
    let stop_condition = StopCondition { pending: pending.and_then(|ms| Millis::new(ms).ok()), running };
    let tolerance = match rng.u8(0..4) {
        0 => millis(rng, 15, 60),
        _ => Span::from_millis(60),
    };
    let lead = one_in(rng, 12).then(|| millis(rng, 600, 3_000));
    // Either all devices with chains play them in every act, or none does.
    let longest = if rng.bool() { 1 } else { rng.usize(2..=6) };
    let acts = (0..count).map(|index| {
        let robots: Vec<RobotPlan> = robots
            .iter()
            .filter_map(|robot| {
                let absent = index > 0 && one_in(rng, 5);
                (!absent).then(|| draw_robot_plan(rng, robot, longest, show, stop_condition))
            })
            .collect();
        Plan { scenario: "soak".to_owned(), start_tolerance: tolerance, lead, stop_condition, robots }
    });
    let plans: Vec<Plan> = acts.collect();
    let acts = plans.into_iter().enumerate().map(|(index, plan)| draw_act(rng, robots, plan, index, count));
    Choreography { scenario: "soak".to_owned(), acts: acts.collect(), requirements: Requirements::default() }
}

/// Changes the first script of each linearly moving device so that it starts at the initial position of simulated robots.
pub(super) fn begin_where_devices_are(choreography: &mut Choreography, robots: &[DrawnRobot]) {
    for first in choreography.first_uses(0) {
        let planned = &mut choreography.acts[first.act].plan.robots[first.robot];
        let Some(robot) = robots.iter().find(|robot| robot.block.id == planned.robot) else { continue };
        let script = &mut planned.scripts[first.script];
        let device = robot.block.device(script.device.as_str());
        if device.is_none_or(|device| device.interpolation != Interpolation::Linear) {
            continue;
        }
        let mut steps = script.script.steps().to_vec();
        if let Some(first) = steps.first_mut() {
            first.setpoint.value = BEGINS_AT;
        }
        if let Ok(begins_there) = Script::new(steps) {
            script.script = begins_there;
        }
    }
}

/// The initial position of the devices of simulated robots.
pub(crate) const BEGINS_AT: f64 = 0.0;

fn draw_act(rng: &mut Rng, robots: &[DrawnRobot], plan: Plan, index: usize, count: usize) -> Act {
    let duration = plan.duration();
    let mut act = Choreography::of_plan(plan).acts.swap_remove(0);
    act.name = format!("act {index}");
    act.next = if index + 1 < count { Way::Act(index + 1) } else { Way::End };
    act.on_failure = draw_policy(rng, robots, index, count);
    act.on_doubt = if one_in(rng, 6) { OnDoubt::Withdraw } else { OnDoubt::Start };
    draw_wait(rng, robots, &mut act, index, count);
    if one_in(rng, 5) {
        let robot = &robots[rng.usize(0..robots.len())];
        let at = Span::from_nanos(rng.i64(0..=duration.as_nanos()));
        act.readings = robot
            .block
            .devices
            .last()
            .map(|sensor| PlannedReading { robot: robot.block.id.clone(), sensor: sensor.id.clone(), at })
            .into_iter()
            .collect();
    }
    act
}

/// Draws what an act waits for. If that may never occur, the act has a timeout.
fn draw_wait(rng: &mut Rng, robots: &[DrawnRobot], act: &mut Act, index: usize, count: usize) {
    let kind = rng.u8(0..if index == 0 { 40 } else { 10 });
    act.wait = match kind {
        0 => Wait::Operator,
        1 => {
            let robot = robots[rng.usize(0..robots.len())].block.id.to_string();
            Wait::Sensor { robot, sensor: "eye".to_owned(), range: SensorRange::Above(BRIGHT) }
        }
        2 => Wait::Instant(BEGIN + millis(rng, 200, 8_000)),
        _ => Wait::Done,
    };
    act.timeout = (kind < 2).then(|| millis(rng, 300, 2_500));
    // An act leads only to later acts, so that every mission ends.
    act.on_timeout = match rng.u8(0..4) {
        0 => Way::Fail,
        1 if index + 1 < count => Way::Act(index + 1),
        _ => Way::End,
    };
}

fn draw_robot_plan(
    rng: &mut Rng,
    robot: &DrawnRobot,
    longest: usize,
    show: Show,
    stop_condition: StopCondition,
) -> RobotPlan {
    let moves = |device: &&Device| device.available_control_types.limits(ControlType::Position).is_some();
    let devices: Vec<&Device> = robot.block.devices.iter().filter(moves).collect();
    let scripts = devices.into_iter().flat_map(|device| {
        let count = if one_in(rng, 3) { 1 } else { rng.usize(1..=longest) };
        draw_scripts(rng, device, count, show, stop_condition)
    });
    RobotPlan { robot: robot.block.id.clone(), scripts: scripts.collect() }
}

/// Draws a chain of scripts for a device. If the device holds only one script at a time, there are longer pauses between the scripts.
fn draw_scripts(
    rng: &mut Rng,
    device: &Device,
    count: usize,
    show: Show,
    stop_condition: StopCondition,
) -> Vec<DeviceScript> {
    let mut scripts = Vec::new();
    let mut start = if one_in(rng, 4) { f64::from(rng.u32(0..600)) } else { 0.0 };
    // The scripts of long chains are short, so that the chains do not last too long.
    let longest = if count > 2 { 160 } else { 400 };
    for _ in 0..count {
        let mut offset = 0.0;
        let (steps, each) = match show {
            Show::Large => (rng.usize(200..=380), 4..=8),
            Show::Small => (rng.usize(1..=4), 60..=longest),
        };
        let steps = (0..steps).map(|_| {
            let at = offset;
            offset += f64::from(rng.u32(each.clone()));
            Some(Step {
                offset: Millis::new(at).ok()?,
                setpoint: Setpoint::new(ControlType::Position, f64::from(rng.u32(0..=90))),
                stop_condition: None,
            })
        });
        let steps: Vec<Step> = steps.collect::<Vec<_>>().into_iter().flatten().collect();
        let last = steps.last().map_or(0.0, |step| step.offset.get());
        if let (Ok(script), Ok(at)) = (Script::new(steps), Millis::new(start)) {
            scripts.push(DeviceScript {
                device: device.id.clone(),
                start: at,
                stop_condition,
                script,
                rest: Span::ZERO,
            });
        }
        let pause = if device.script_queue == 1 { 150..450 } else { 1..200 };
        start += last + f64::from(rng.u32(pause));
    }
    if let Some(last) = scripts.last_mut() {
        last.rest = draw_rest(&last.script);
    }
    scripts
}

/// Returns how long the movement of a script continues after its last step. It depends on the value of that step, and is often zero.
fn draw_rest(script: &Script) -> Span {
    let last = script.steps().last().map_or(0.0, |step| step.setpoint.value);
    if last % 5.0 == 0.0 { Span::from_millis_f64(last * 6.0) } else { Span::ZERO }
}

fn draw_policy(rng: &mut Rng, robots: &[DrawnRobot], act: usize, acts: usize) -> FailurePolicy {
    let mut policy = || match rng.u8(0..10) {
        0..=5 => OnFailure::Stop,
        6..=8 => OnFailure::Without,
        _ => OnFailure::Home,
    };
    let default = policy();
    let own = vec![(robots[0].block.id.clone(), policy())];
    // An act leads only to later acts, so that every mission ends.
    let then = (act + 1 < acts && one_in(rng, 6)).then_some(acts - 1);
    FailurePolicy { default, robots: if one_in(rng, 5) { own } else { Vec::new() }, then }
}
