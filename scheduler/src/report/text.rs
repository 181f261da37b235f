//! The report and the plan as tables for people.

use std::fmt::Write;

use comfy_table::{CellAlignment, Table, presets};
use downbeat_scripts::{Plan, counted};
use urrcp::Span;

use super::{Report, RobotReport, StopState};

fn table(header: &[&str], numbers_from: usize) -> Table {
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    table.set_header(header.to_vec());
    for column in table.column_iter_mut().skip(numbers_from) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

fn or_dash<T: ToString>(value: Option<T>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| value.to_string())
}

fn signed(span: Span) -> String {
    match span >= Span::ZERO {
        true => format!("+{span}"),
        false => span.to_string(),
    }
}

/// The compiled scripts, a row a device.
#[must_use]
pub fn plan_table(plan: &Plan) -> String {
    let mut rows = table(&["robot", "device", "start", "end", "steps", "lowest", "highest", "control"], 2);
    for robot in &plan.robots {
        for script in &robot.scripts {
            let steps = script.script.steps();
            let values = || steps.iter().map(|step| step.setpoint.value);
            let mut types: Vec<_> = steps.iter().map(|step| step.setpoint.control_type).collect();
            types.sort_unstable();
            types.dedup();
            let types: Vec<_> = types.iter().map(ToString::to_string).collect();
            rows.add_row(vec![
                robot.robot.to_string(),
                script.device.to_string(),
                script.start.to_string(),
                (script.start.span() + script.script.duration()).to_string(),
                steps.len().to_string(),
                values().fold(f64::INFINITY, f64::min).to_string(),
                values().fold(f64::NEG_INFINITY, f64::max).to_string(),
                types.join(", "),
            ]);
        }
    }
    format!("{}: {}\n{rows}\n", plan.scenario, plan_figures(plan))
}

/// How large a plan is, in one line.
#[must_use]
pub fn plan_figures(plan: &Plan) -> String {
    let scripts = || plan.robots.iter().flat_map(|robot| &robot.scripts);
    let steps: usize = scripts().map(|script| script.script.steps().len()).sum();
    format!(
        "{}, {}, {}, {}",
        counted(plan.robots.len(), "robot"),
        counted(scripts().count(), "device"),
        counted(steps, "step"),
        plan.duration()
    )
}

/// The report: a row a robot, failures with their reasons, and the figures that matter.
#[must_use]
pub fn report_text(report: &Report) -> String {
    let mut text = format!("{}: {}\n", report.scenario, report.outcome);
    for failure in &report.failures {
        let _infallible = writeln!(text, "  {}: {}", failure.robot, failure.kind);
    }
    if report.lead.is_some() {
        text.push_str(&robots_table(report));
        text.push_str(&closing_lines(report));
    }
    text
}

fn robots_table(report: &Report) -> String {
    let header = ["robot", "accepted", "started", "start error", "steps", "clock offset", "uncertainty"];
    let mut rows = table(&header, 1);
    for robot in &report.robots {
        rows.add_row(vec![
            robot.robot.to_string(),
            if robot.accepted { "yes" } else { "no" }.to_owned(),
            format!("{}/{}", robot.started, robot.devices.len()),
            or_dash(robot.start_error.map(signed)),
            format!("{}/{}", robot.steps_done, robot.steps_planned),
            or_dash(robot.clock.map(|clock| signed(clock.offset))),
            or_dash(robot.clock.map(|clock| clock.uncertainty)),
        ]);
    }
    format!("{rows}\n")
}

fn closing_lines(report: &Report) -> String {
    let mut text = String::new();
    if let (Some(start), Some(lead)) = (report.start, report.lead) {
        let _infallible = writeln!(
            text,
            "planned start {start}, {} after sending ({} to prepare, {} of lease, {} of margin)",
            lead.total(),
            lead.prepare,
            lead.lease,
            lead.margin
        );
    }
    let started = report.robots.iter().filter(|robot| robot.started > 0).count();
    match report.spread {
        Some(spread) => {
            let _infallible = writeln!(
                text,
                "start spread {spread} over {}, by their own clocks, each known to the uncertainty above",
                counted(started, "robot")
            );
        }
        None => text.push_str("no robot reported a start\n"),
    }
    if let Some(spread) = report.true_spread {
        let _infallible = writeln!(text, "true start spread {spread}, by the one clock of the virtual world");
    }
    text.extend(report.robots.iter().filter_map(stop_line));
    text
}

fn stop_line(robot: &RobotReport) -> Option<String> {
    match robot.stop {
        StopState::NotSent => None,
        StopState::Confirmed => Some(format!("{}: default state confirmed\n", robot.robot)),
        StopState::Unconfirmed { lease_ends: Some(at) } => {
            Some(format!("{}: stop NOT confirmed; its lease ends at {at}\n", robot.robot))
        }
        StopState::Unconfirmed { lease_ends: None } => {
            Some(format!("{}: stop NOT confirmed, and it runs without a lease\n", robot.robot))
        }
    }
}
