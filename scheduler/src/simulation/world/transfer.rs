//! Plans acts after the stops of a simulated mission: each device moves linearly to its destination.

use downbeat_scripts::{Act, Choreography, DeviceScript, Plan, Positions, RobotPlan};
use urrcp::{
    ControlType, DeviceId, InitializationBlock, Interpolation, Millis, RobotId, Script, Setpoint, Span, Step,
    StopCondition,
};

use crate::mission::{Destination, PlanTransfer};
use crate::simulation::Drawn;

const TAKES: Span = Span::from_millis(400);

#[derive(Debug)]
pub(super) struct Planner(Vec<InitializationBlock>);

impl Planner {
    pub(super) fn of(drawn: &Drawn) -> Self {
        Self(drawn.robots.iter().map(|robot| robot.block.clone()).collect())
    }

    fn script(
        &self,
        (robot, device, from): (&RobotId, &DeviceId, f64),
        next: Option<&Act>,
        stop_condition: StopCondition,
    ) -> Option<DeviceScript> {
        let device = self.0.iter().find(|block| block.id == *robot)?.device(device.as_str())?;
        let to = match next {
            None => device.default_value?,
            Some(act) => {
                let planned = act.plan.robots.iter().find(|planned| planned.robot == *robot)?;
                let (_, first) = planned.first_positions().find(|(id, _)| **id == device.id)?;
                Some(first).filter(|_| device.interpolation == Interpolation::Linear)?
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
        like: usize,
        from: &Positions,
    ) -> Result<Option<Act>, String> {
        let like = &choreography.acts[like];
        let (name, next) = match to {
            Destination::Home => ("home", None),
            Destination::Act(act) => ("approach", choreography.acts.get(act)),
        };
        let stop_condition = like.plan.stop_condition;
        let robots = from.iter().map(|(robot, devices)| {
            let script =
                |(device, from): (&DeviceId, &f64)| self.script((robot, device, *from), next, stop_condition);
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
