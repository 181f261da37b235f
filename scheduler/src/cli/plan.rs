//! `downbeat plan`: the control requests that a scenario compiles to.

use urrcp::{Command, ControlRequest, Message, Millis, Server, Span, Timestamp};

use super::load;
use super::{Exit, Format, ScenarioArgs, console};
use crate::report::plan_table;

/// Show the control requests that a scenario compiles to.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "With --format json: an object from robot to its requests, offsets counted with a lead of 0.

Examples:
  downbeat plan scripts/examples/tank.yaml
  downbeat plan scripts/examples/swap.yaml --format json"
)]
pub(super) struct PlanArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
}

pub(super) fn plan(args: &PlanArgs, format: Format) -> Exit {
    let plan = match load::load_plan(&args.scenario, format) {
        Ok((plan, ..)) => plan,
        Err(exit) => return exit,
    };
    match format {
        Format::Text => console::print(&plan_table(&plan)),
        Format::Json => {
            let robots: serde_json::Map<_, _> = plan
                .robots
                .iter()
                .map(|robot| (robot.robot.to_string(), serde_json::json!(requests(&plan, robot))))
                .collect();
            console::print_json(&serde_json::json!({
                "scenario": plan.scenario,
                "duration_ms": plan.duration(),
                "start_tolerance_ms": plan.start_tolerance,
                "robots": robots,
            }));
        }
    }
    Exit::Done
}

fn requests(plan: &downbeat_scripts::Plan, robot: &downbeat_scripts::RobotPlan) -> Vec<Message> {
    let unsent = Timestamp::<Server>::from_nanos(0);
    let request = |script: &downbeat_scripts::DeviceScript| {
        let mut stop_condition = script.stop_condition;
        stop_condition.pending = stop_condition.pending.or(plan.stop_condition.pending);
        Message::ControlRequest(ControlRequest {
            timestamp: Some(unsent),
            time_offset_to_start: Some(Millis::from_span(Span::ZERO + script.start.span())),
            stop_condition: Some(stop_condition),
            ..ControlRequest::immediate(script.device.clone(), Command::Script(script.script.clone()))
        })
    };
    robot.scripts.iter().map(request).collect()
}
