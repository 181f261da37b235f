//! Plans acts after a stop in a simulated mission. Each device moves linearly to its destination.

use std::collections::HashMap;

use downbeat_plan::{Act, Choreography, DeviceScript, Plan, Positions, RobotPlan};
use urrcp::{
    ControlType, DeviceId, InitializationBlock, Interpolation, Millis, RobotId, Script, Setpoint, Span, Step,
    StopCondition,
};

use crate::Drawn;
use downbeat_mission::{ActIndex, Destination, PlanTransfer};

/// The first positions of devices in an act, by robot and device.
type Firsts<'a> = HashMap<(&'a RobotId, &'a DeviceId), f64>;

const TAKES: Span = Span::from_millis(400);

#[derive(Debug)]
pub(super) struct Planner(Vec<InitializationBlock>);

impl Planner {
    pub(super) fn of(drawn: &Drawn) -> Self {
        Self(drawn.robots.iter().map(|robot| robot.block.clone()).collect())
    }

    fn script(
        &self,
        robot: &RobotId,
        device: &DeviceId,
        from: f64,
        firsts: Option<&Firsts<'_>>,
        stop_condition: StopCondition,
    ) -> Option<DeviceScript> {
        let device = self.0.iter().find(|block| block.id == *robot)?.device(device.as_str())?;
        let to = match firsts {
            None => device.default_value?,
            Some(firsts) => {
                let first = firsts.get(&(robot, &device.id)).copied();
                first.filter(|_| device.interpolation == Interpolation::Linear)?
            }
        };
        let from = device.available_control_types.limits(ControlType::Position)?.nearest_settable(from);
        let step = |offset, value| Step {
            offset: Millis::from_span(offset),
            setpoint: Setpoint::new(ControlType::Position, value),
            stop_condition: None,
        };
        let script = Script::new(vec![step(Span::ZERO, from), step(TAKES, to)]).ok()?;
        let start = Millis::from_span(Span::ZERO);
        let moves = (from - to).abs() > 0.0;
        let device = device.id.clone();
        moves.then_some(DeviceScript { device, start, stop_condition, script, rest: Span::ZERO })
    }
}

impl PlanTransfer for Planner {
    fn plan(
        &self,
        choreography: &Choreography,
        to: Destination,
        like: ActIndex,
        from: &Positions,
    ) -> Result<Option<Act>, String> {
        let like = &choreography.acts[like.get()];
        let (name, firsts) = match to {
            Destination::Home => ("home", None),
            Destination::Act(act) => {
                let uses = choreography.first_uses(act.get()).into_iter();
                let firsts = uses.filter_map(|first| choreography.first_position(first));
                let firsts: Firsts<'_> =
                    firsts.map(|(robot, device, position)| ((robot, device), position)).collect();
                ("approach", Some(firsts))
            }
        };
        let stop_condition = like.plan.stop_condition;
        let robots = from.iter().map(|(robot, devices)| {
            let script = |(device, from): (&DeviceId, &f64)| {
                self.script(robot, device, *from, firsts.as_ref(), stop_condition)
            };
            RobotPlan { robot: robot.clone(), scripts: devices.iter().filter_map(script).collect() }
        });
        let robots: Vec<_> = robots.filter(|robot| !robot.scripts.is_empty()).collect();
        if robots.is_empty() {
            return Ok(None);
        }
        let plan = Plan { lead: None, robots, ..like.plan.clone() };
        let mut act = Choreography::of_plan(plan).acts.remove(0);
        act.name = name.to_owned();
        Ok(Some(act))
    }
}
