//! Rehearsals of a choreography: at another speed, with some of the robots, or with a single act.

use downbeat_fleet::fleet::{Fleet, FleetRobot};
use downbeat_space::space::DUST;
use urrcp::{ControlType, Device, Millis, RobotId, Script, Span, Step};

use crate::choreography::{Act, Choreography, DeviceScript, Wait, Way};
use crate::compensate;

/// Maximum number of faults reported for a choreography at another speed.
const SHOWN: usize = 20;

impl Choreography {
    /// Removes all other robots from the choreography. Acts keep their times, even if none of the given robots plays in them.
    ///
    /// # Errors
    /// Returns the names of given robots that no act moves.
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
            act.devices.retain(|used| robots.contains(&used.robot));
            act.readings.retain(|reading| robots.contains(&reading.robot));
            // The positions of the other robots are unknown.
            act.in_space.closest = None;
            act.in_space.bodies.retain(|body| robots.contains(&body.robot));
            act.in_space.driven.retain(|path| robots.contains(&path.robot));
            act.in_space.unknown.retain(|robot| robots.contains(robot));
        }
        Ok(self)
    }

    /// Reduces the choreography to act number `act`, from 0, which then begins immediately.
    #[must_use]
    pub fn act_alone(mut self, act: usize) -> Self {
        let mut act = self.acts.swap_remove(act);
        act.wait = Wait::Done;
        act.timeout = None;
        act.next = Way::End;
        act.on_failure.then = None;
        act.devices.iter_mut().for_each(|used| used.entry_factor_max = f64::INFINITY);
        self.acts = vec![act];
        self
    }

    /// Plays the choreography at `speed` times the written speed: divides times by `speed`, multiplies speeds by it and accelerations by
    /// its square. Rounds values to the device's grid and checks them again against the limits that each device declares.
    ///
    /// # Errors
    /// Returns a message for each limit that would be exceeded at this speed.
    pub fn at_speed(mut self, speed: f64, fleet: &Fleet) -> Result<Self, Vec<String>> {
        let mut faults = Vec::new();
        for act in &mut self.acts {
            // Latency does not depend on the speed of the show.
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
                "robot `{}`: its body would reach {found:.3} {unit}, but the limit is {limit} (act `{}`)",
                used.robot, act.name
            ));
        }
    }
    for used in &mut act.devices {
        let most = used.factor_max.min(used.entry_factor_max);
        if speed > most * DUST {
            faults.push(format!(
                "robot `{}`, device `{}`: it can move at most {most:.3} times as fast as written (act `{}`)",
                used.robot, used.device, act.name
            ));
        }
        used.factor_max /= speed;
        used.entry_factor_max /= speed;
        used.worst_at = at(used.worst_at);
    }
    for robot in &mut act.plan.robots {
        let listed = fleet.robots.iter().find(|listed| listed.id == robot.robot);
        for script in &mut robot.scripts {
            let found = stretch(script, speed, listed);
            faults.extend(found.into_iter().map(|fault| {
                format!("robot `{}`, device `{}`: {fault} (act `{}`)", robot.robot, script.device, act.name)
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
            return vec!["the script would exceed its maximum length".to_owned()];
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
    }
    script.rest = Span::from_millis_f64(script.rest.as_millis_f64() / speed);
    match (Script::new(steps), millis(script.start)) {
        (Ok(stretched), Ok(start)) => (script.script, script.start) = (stretched, start),
        _ => faults.push("the script would exceed its maximum length".to_owned()),
    }
    faults
}

fn on_grid(value: f64, control_type: ControlType, device: Option<&Device>) -> f64 {
    let limits = device.and_then(|device| device.available_control_types.limits(control_type));
    limits.map_or(value, |limits| limits.nearest(value))
}
