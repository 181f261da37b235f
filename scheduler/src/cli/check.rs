//! `downbeat check`: prints all findings about a scenario and its fleet.

use std::path::PathBuf;

use clap::ValueEnum;
use downbeat_scripts::shown::shown;
use downbeat_scripts::{Attempt, Choreography, Refusal, Requirements};
use serde::Serialize;

use super::load::{self, Loaded};
use super::watch::Stamp;
use super::{Exit, Format, ScenarioArgs, console};
use crate::requirements::{Figures, Judged, any_unmet, closest_of, judge};
use crate::show::requirements_table;

/// Find the mistakes in a scenario and its fleet, without moving anything.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  downbeat check show.yaml
  downbeat check show.yaml --fleet stage.yaml --format json
  downbeat check show.yaml --deny warnings --sarif findings.sarif
  downbeat check show.yaml --watch    again after each change
  downbeat explain DB0012    explain a code in detail")]
pub(super) struct CheckArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Also treat these as errors.
    #[arg(long, value_enum, value_name = "WHAT")]
    deny: Option<Deny>,
    /// Also write the findings as SARIF 2.1.0, which code hosts show next to the lines.
    #[arg(long, value_name = "FILE")]
    sarif: Option<PathBuf>,
    /// Check again after each change of a file in the project, until Ctrl-C.
    #[arg(long)]
    watch: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Deny {
    /// Warnings end with exit code 1.
    Warnings,
}

#[derive(Serialize)]
struct Checked<'a> {
    scenario: String,
    ok: bool,
    findings: &'a [downbeat_scripts::Finding],
    #[serde(skip_serializing_if = "Vec::is_empty")]
    requirements: Vec<Judged>,
    #[serde(skip_serializing_if = "Option::is_none")]
    acts: Option<Vec<super::plan::ActFigures<'a>>>,
}

pub(super) fn check(args: &CheckArgs, format: Format) -> Exit {
    if !args.watch {
        return check_once(args, format);
    }
    let project = args.scenario.project.of(&args.scenario.scenario);
    let mut files = Stamp::of(project.root());
    loop {
        check_once(args, format);
        console::note(&format!("waiting for a change of a file in `{}`", project.root().display()));
        files = files.wait_for_change(project.root());
    }
}

fn check_once(args: &CheckArgs, format: Format) -> Exit {
    let Loaded { choreography, findings, scenario, unreadable, .. } = load::load(&args.scenario);
    if let Some(path) = &args.sarif {
        let sarif = downbeat_scripts::sarif(&findings);
        if let Err(error) = std::fs::write(path, format!("{sarif:#}\n")) {
            let refusal = Refusal::of(Attempt::Write(path), &error);
            console::error(&format!("cannot write `{}`: {refusal}", path.display()));
            return Exit::Usage;
        }
    }
    let denied = args.deny == Some(Deny::Warnings) && !findings.is_empty();
    let requirements = choreography.as_ref().map(of_the_plan).unwrap_or_default();
    let unmet = any_unmet(&requirements);
    let ok = choreography.is_some() && !denied && !unmet;
    match format {
        Format::Json => {
            let acts = choreography.as_ref().map(super::plan::figures);
            console::print_json(&Checked { scenario, ok, findings: &findings, requirements, acts });
        }
        Format::Text => {
            load::show_findings(&findings);
            if let Some(choreography) = &choreography {
                let errors = if denied { "warnings denied" } else { "no errors" };
                let figures = crate::show::choreography_figures(choreography);
                console::print(&format!("{}: {errors}, {figures}\n", shown(&scenario)));
                if let Some(latencies) = crate::show::latencies_text(choreography) {
                    console::print(&format!("{latencies}\n"));
                }
                console::print(&requirements_table(&requirements, console::columns()));
            }
        }
    }
    match ok {
        true => Exit::Done,
        false if unreadable => Exit::Usage,
        false => Exit::Failed,
    }
}

/// Evaluates those requirements of a scenario that need only the plan, without playing it.
pub(super) fn of_the_plan(choreography: &Choreography) -> Vec<Judged> {
    let asked = Requirements { closest: choreography.requirements.closest, ..Requirements::default() };
    judge(&asked, &Figures { closest: closest_of(choreography), ..Figures::default() })
}
