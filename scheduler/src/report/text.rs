//! The report and the plan as tables for people.

use std::fmt::Write;

use comfy_table::{CellAlignment, Table, presets};
use downbeat_scripts::{Act, Choreography, Plan, RobotPlan, counted};
use urrcp::Span;

use super::{ActReport, Outcome, Report, RobotReport, StopState};
use crate::mission::{Check, Preflight, Verdict};

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

/// An act: its cues with their times, and a row a device.
#[must_use]
pub fn plan_table(act: &Act) -> String {
    let mut cues = table(&["cue", "start", "end", "slack"], 1);
    for cue in &act.cues {
        let times = [cue.start, cue.end, cue.slack].map(|time| time.to_string());
        cues.add_row([vec![cue.name.clone()], times.to_vec()].concat());
    }
    let header = ["robot", "device", "scripts", "steps", "at least", "budget", "worst error", "at"];
    let mut rows = table(&header, 2);
    for device in &act.devices {
        rows.add_row(vec![
            device.robot.to_string(),
            device.device.to_string(),
            device.scripts.to_string(),
            device.steps.to_string(),
            device.at_least.to_string(),
            device.budget.to_string(),
            format!("{:.4}", device.worst_error),
            device.worst_at.to_string(),
        ]);
    }
    format!("{}: {}\n{cues}\n{rows}\n", act.plan.scenario, plan_figures(&act.plan))
}

/// How long the acts last one after another.
#[must_use]
pub fn main_duration(choreography: &Choreography) -> Span {
    let acts = choreography.main_line().into_iter().map(|act| choreography.acts[act].plan.duration());
    acts.fold(Span::ZERO, |sum, duration| sum + duration)
}

/// How large a choreography is, in one line.
#[must_use]
pub fn choreography_figures(choreography: &Choreography) -> String {
    if let [act] = choreography.acts.as_slice() {
        return plan_figures(&act.plan);
    }
    let plans = || choreography.acts.iter().map(|act| &act.plan);
    let robots: std::collections::BTreeSet<_> =
        plans().flat_map(|plan| &plan.robots).map(|robot| robot.robot.as_str()).collect();
    let steps: usize = plans().map(steps_of).sum();
    format!(
        "{}, {}, {}, {} on the main line",
        counted(choreography.acts.len(), "act"),
        counted(robots.len(), "robot"),
        counted(steps, "step"),
        main_duration(choreography)
    )
}

fn steps_of(plan: &Plan) -> usize {
    let scripts = plan.robots.iter().flat_map(|robot| &robot.scripts);
    scripts.map(|script| script.script.steps().len()).sum()
}

/// How large a plan is, in one line.
#[must_use]
pub fn plan_figures(plan: &Plan) -> String {
    let devices = |robot: &RobotPlan| {
        let mut devices: Vec<_> = robot.scripts.iter().map(|script| &script.device).collect();
        devices.dedup();
        devices.len()
    };
    format!(
        "{}, {}, {}, {}",
        counted(plan.robots.len(), "robot"),
        counted(plan.robots.iter().map(devices).sum(), "device"),
        counted(steps_of(plan), "step"),
        plan.duration()
    )
}

/// What was checked before a mission: a row a robot, a column a check; below it, if wanted, what is wrong.
#[must_use]
pub fn preflight_table(preflight: &Preflight, told: bool) -> String {
    let titles = Check::ALL.map(Check::title);
    let mut rows = table(&[&["robot"], titles.as_slice()].concat(), 1);
    let mut wrong = String::new();
    for row in &preflight.rows {
        let mut cells = vec![row.robot.to_string()];
        for (check, verdict) in &row.checks {
            let (cell, why) = match verdict {
                Verdict::Pass(seen) => (seen.clone(), None),
                Verdict::Warning(why) => ("warning".to_owned(), Some(why)),
                Verdict::Failure(why) => ("FAILURE".to_owned(), Some(why)),
                Verdict::NotChecked => ("not checked".to_owned(), None),
            };
            if let Some(why) = why.filter(|_| told) {
                let _infallible = writeln!(wrong, "{} {}: {why}", row.robot, check.title());
            }
            cells.push(cell);
        }
        rows.add_row(cells);
    }
    format!("{rows}\n{wrong}")
}

/// The report: a row a robot, failures with their reasons, and the figures that matter.
#[must_use]
pub fn report_text(report: &Report) -> String {
    let mut text = format!("{}: {}\n", report.scenario, report.outcome);
    if let Some(acts_max) = report.acts_max_reached {
        let acts = counted(acts_max as usize, "act");
        let _infallible =
            writeln!(text, "  ended because {acts} had begun, the bound; another would have followed");
    }
    let alone = matches!(report.outcome, Outcome::Ready | Outcome::NotReady);
    if let Some(preflight) = report.preflight.as_ref().filter(|_| alone) {
        return text + &preflight_table(preflight, true);
    }
    for failure in &report.failures {
        let _infallible = writeln!(text, "  {}: {}", failure.robot, failure.kind);
    }
    if report.acts.len() > 1 {
        text.push_str(&acts_table(report));
    }
    if !report.acts.is_empty() {
        text.push_str(&robots_table(report));
    }
    if let [act] = report.acts.as_slice() {
        text.push_str(&act_lines(act));
    }
    text.push_str(&closing_lines(report));
    text
}

fn acts_table(report: &Report) -> String {
    let mut rows =
        table(&["act", "start", "gap", "lead", "predicted spread", "spread", "margin left", "window"], 2);
    for act in &report.acts {
        rows.add_row(vec![
            act.act.clone(),
            act.start.to_string(),
            or_dash(act.gap),
            act.lead.total().to_string(),
            or_dash(act.skew.as_ref().map(|skew| skew.predicted)),
            or_dash(act.spread),
            or_dash(act.margin_left),
            or_dash(act.window),
        ]);
    }
    format!("{rows}\n")
}

fn act_lines(act: &ActReport) -> String {
    let lead = act.lead;
    let mut text = format!(
        "planned start {}, {} after sending ({} to prepare, {} of lease, {} of margin)\n",
        act.start,
        lead.total(),
        lead.prepare,
        lead.lease,
        lead.margin
    );
    if let Some(skew) = &act.skew {
        let _infallible =
            writeln!(text, "predicted start spread {} at most, {} allowed", skew.predicted, skew.tolerance);
    }
    if let (Some(margin), Some(window)) = (act.margin_left, act.window) {
        let _infallible = writeln!(
            text,
            "the last acceptance came {margin} before the decision; the leases were carried over the start within {window}"
        );
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
            format!("{}/{}", robot.started, robot.scripts),
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
    let started = report.robots.iter().filter(|robot| robot.started > 0).count();
    match report.spread {
        Some(spread) => {
            let _infallible = writeln!(
                text,
                "start spread {spread} over {}, by their own clocks, each known to the uncertainty above",
                counted(started, "robot")
            );
        }
        None if report.acts.is_empty() => {}
        None => text.push_str("no robot reported a start\n"),
    }
    if let Some(spread) = report.true_spread {
        let _infallible = writeln!(text, "true start spread {spread}, by the one clock of the virtual world");
    }
    text.extend(report.robots.iter().filter_map(unaccounted_line));
    text.extend(report.robots.iter().filter_map(stop_line));
    if let Some(failure) = report.recording.as_ref().and_then(|recording| recording.failure.as_ref()) {
        let _infallible = writeln!(text, "the recording is not whole: {failure}");
    }
    text
}

fn unaccounted_line(robot: &RobotReport) -> Option<String> {
    let scripts = counted(robot.unaccounted, "script");
    (robot.unaccounted > 0).then(|| format!("{}: it has not said what became of {scripts}\n", robot.robot))
}

fn stop_line(robot: &RobotReport) -> Option<String> {
    match robot.stop {
        StopState::NotSent => None,
        StopState::Confirmed => Some(format!("{}: default state confirmed\n", robot.robot)),
        StopState::Held => Some(format!("{}: held where it was, confirmed\n", robot.robot)),
        StopState::Unconfirmed { lease_ends: Some(at) } => {
            Some(format!("{}: stop NOT confirmed; its lease ends at {at}\n", robot.robot))
        }
        StopState::Unconfirmed { lease_ends: None } => {
            Some(format!("{}: stop NOT confirmed, and it runs without a lease\n", robot.robot))
        }
    }
}
