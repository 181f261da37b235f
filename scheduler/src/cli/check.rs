//! `downbeat check`: all findings at once.

use serde::Serialize;

use super::load::{self, Loaded};
use super::{Exit, Format, ScenarioArgs, console};

/// Find everything in a scenario that will not work, without moving anything.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  downbeat check scripts/examples/dance.yaml
  downbeat check show.yaml --fleet stage.yaml --format json")]
pub(super) struct CheckArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
}

#[derive(Serialize)]
struct Checked<'a> {
    scenario: String,
    ok: bool,
    findings: &'a [downbeat_scripts::Finding],
}

pub(super) fn check(args: &CheckArgs, format: Format) -> Exit {
    let Loaded { plan, findings, scenario, unreadable, .. } = load::load(&args.scenario);
    match format {
        Format::Json => console::print_json(&Checked { scenario, ok: plan.is_some(), findings: &findings }),
        Format::Text => {
            load::show_findings(&findings);
            if let Some(plan) = &plan {
                console::print(&format!("{scenario}: no errors, {}\n", crate::report::plan_figures(plan)));
            }
        }
    }
    match plan {
        Some(_) => Exit::Done,
        None if unreadable => Exit::Usage,
        None => Exit::Failed,
    }
}
