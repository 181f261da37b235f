//! A choreography as it is rehearsed: slower, with a part of the fleet, or a single act.

use urrcp::{ControlType, Device, Interpolation, Millis, RobotId, Script, Span, Step};

use crate::compile::compensate;
use crate::fleet::{Fleet, FleetRobot};
use crate::plan::{Act, Choreography, DeviceScript, Wait, Way};
use crate::space::DUST;

/// Faults that are listed of a choreography at another speed.
const SHOWN: usize = 20;

impl Choreography {
    /// With these robots alone. Acts keep their times, also those in which none of them plays.
    ///
    /// # Errors
    /// Names that no act moves.
    pub fn only(mut self, robots: &[RobotId]) -> Result<Self, Vec<RobotId>> {
        let moved = |id: &&RobotId| {
            !self.acts.iter().flat_map(|act| &act.plan.robots).any(|robot| robot.robot == **id)
        };
        let unknown: Vec<_> = robots.iter().filter(moved).cloned().collect();
        if !unknown.is_empty() {
            return Err(unknown);
        }
        for act in &mut self.acts {
            act.plan.robots.retain(|robot| robots.contains(&robot.robot));
            act.readings.retain(|reading| robots.contains(&reading.robot));
            // Where the others stand is not known.
            act.in_space.closest = None;
            act.in_space.bodies.retain(|body| robots.contains(&body.robot));
            act.in_space.driven.retain(|path| robots.contains(&path.robot));
            act.in_space.unknown.retain(|robot| robots.contains(robot));
        }
        Ok(self)
    }

    /// This act alone, at once.
    #[must_use]
    pub fn act_alone(mut self, act: usize) -> Self {
        let mut act = self.acts.swap_remove(act);
        act.wait = Wait::Done;
        act.timeout = None;
        act.next = Way::End;
        act.on_failure.then = None;
        self.acts = vec![act];
        self
    }

    /// Played at `speed` times the speed as written: all times divided by it; speeds times it, accelerations times
    /// its square, on the device's grid. Checked again against what each device declares.
    ///
    /// # Errors
    /// What a device cannot do at that speed, each with its robot, device and step.
    pub fn at_speed(mut self, speed: f64, fleet: &Fleet) -> Result<Self, Vec<String>> {
        let mut faults = Vec::new();
        for act in &mut self.acts {
            // A device takes as long to move at any speed of the show.
            compensate::undo(act);
            stretch_act(act, speed, fleet, &mut faults);
        }
        compensate::apply(&mut self.acts);
        faults.truncate(SHOWN);
        if faults.is_empty() { Ok(self) } else { Err(faults) }
    }
}

fn stretch_act(act: &mut Act, speed: f64, fleet: &Fleet, faults: &mut Vec<String>) {
    let at = |span: Span| Span::from_millis_f64(span.as_millis_f64() / speed);
    for cue in &mut act.cues {
        (cue.start, cue.end, cue.slack) = (at(cue.start), at(cue.end), at(cue.slack));
    }
    for reading in &mut act.readings {
        reading.at = at(reading.at);
    }
    if let Some(closest) = &mut act.in_space.closest {
        closest.at = at(closest.at);
    }
    for point in act.in_space.driven.iter_mut().flat_map(|path| &mut path.points) {
        point.at = at(point.at);
    }
    for used in &mut act.in_space.bodies {
        (used.speed, used.acceleration) = (used.speed * speed, used.acceleration * speed * speed);
        let body = fleet.robots.iter().find(|listed| listed.id == used.robot).and_then(|r| r.body.as_ref());
        let limits = body.map(|body| (body.speed, body.acceleration)).unwrap_or_default();
        for (found, limit, unit) in [(used.speed, limits.0, "m/s"), (used.acceleration, limits.1, "m/s²")] {
            let Some(limit) = limit.filter(|limit| found > limit * DUST) else { continue };
            faults.push(format!(
                "robot `{}`: its body would reach {found:.3} {unit}, at most {limit} is allowed (act `{}`)",
                used.robot, act.name
            ));
        }
    }
    for robot in &mut act.plan.robots {
        let listed = fleet.robots.iter().find(|listed| listed.id == robot.robot);
        for script in &mut robot.scripts {
            let found = stretch(script, speed, listed);
            faults.extend(found.into_iter().map(|fault| {
                format!("robot `{}` device `{}` {fault} (act `{}`)", robot.robot, script.device, act.name)
            }));
        }
    }
}

fn stretch(script: &mut DeviceScript, speed: f64, listed: Option<&FleetRobot>) -> Vec<String> {
    let millis = |at: Millis| Millis::new(at.get() / speed);
    let block = listed.and_then(|listed| listed.init.as_ref());
    let device = block.and_then(|block| block.device(script.device.as_str()));
    let mut faults = Vec::new();
    let mut steps = Vec::with_capacity(script.script.steps().len());
    for step in script.script.steps() {
        let Ok(offset) = millis(step.offset) else {
            return vec!["would last longer than a script can".to_owned()];
        };
        let mut setpoint = step.setpoint.clone();
        let factor = match setpoint.control_type {
            ControlType::Speed => speed,
            ControlType::Acceleration => speed * speed,
            _ => 1.0,
        };
        if factor != 1.0 {
            setpoint.value = on_grid(setpoint.value * factor, setpoint.control_type, device);
        }
        steps.push(Step { offset, setpoint, stop_condition: step.stop_condition });
    }
    if let Some(device) = device {
        let check = |(index, step): (usize, &Step)| {
            let error = device.check_in_script(&step.setpoint).err()?;
            Some(format!("step {}: {}", index + 1, error.message))
        };
        faults.extend(steps.iter().enumerate().filter_map(check).take(3));
        let limits = listed.and_then(|listed| listed.limits.get(script.device.as_str())).copied();
        faults.extend(too_fast(&steps, device, limits.unwrap_or_default()));
    }
    script.rest = Span::from_millis_f64(script.rest.as_millis_f64() / speed);
    match (Script::new(steps), millis(script.start)) {
        (Ok(stretched), Ok(start)) => (script.script, script.start) = (stretched, start),
        _ => faults.push("would last longer than a script can".to_owned()),
    }
    faults
}

fn on_grid(value: f64, control_type: ControlType, device: Option<&Device>) -> f64 {
    let limits = device.and_then(|device| device.available_control_types.limits(control_type));
    match limits.map(|limits| limits.granularity).filter(|granularity| *granularity > 0.0) {
        Some(granularity) => (value / granularity).round() * granularity,
        None => value,
    }
}

/// The first linear way between two positions that is faster than the device may move.
fn too_fast(steps: &[Step], device: &Device, limits: crate::fleet::RateLimits) -> Option<String> {
    let limit = limits.or_declared(device, ControlType::Position).speed?;
    if device.interpolation != Interpolation::Linear {
        return None;
    }
    steps.windows(2).enumerate().find_map(|(index, pair)| {
        let positions = pair.iter().all(|step| step.setpoint.control_type == ControlType::Position);
        let seconds = (pair[1].offset.get() - pair[0].offset.get()) / 1_000.0;
        let way = (pair[1].setpoint.value - pair[0].setpoint.value).abs();
        let message =
            || format!("step {}: {:.3} a second to it, at most {limit} is allowed", index + 2, way / seconds);
        // A hair's breadth for rounding.
        (positions && way > limit * seconds * (1.0 + 1e-9)).then(message)
    })
}
