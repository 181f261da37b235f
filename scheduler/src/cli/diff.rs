//! `downbeat diff`: compares two compiled scenarios, or two missions that were played.

use std::path::{Path, PathBuf};

use downbeat_scripts::{Attempt, Refusal, parse_duration};
use serde::Serialize;
use urrcp::Span;

use super::{Exit, Format, ProjectArgs, ScenarioArgs, console, dry_run, load};
use crate::compare::{self, text};
use crate::history::{History, NoHistory};
use crate::page::{self, OtherPlan, OtherRun, Rehearsed};

/// Show the differences between two compiled scenarios, or between two missions that were played.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Scenarios are compared in compiled form, so equivalent text counts as equal. Recordings, journals and \
folders of missions are compared by the scripts that were sent and their results. Tables have at most 20 rows; --format json contains all rows.

Exit codes:
  0  no difference
  1  they differ
  2  one of them cannot be read or does not compile, or they are of different kinds

Examples:
  downbeat diff show.yaml changed.yaml
  downbeat diff show.yaml show.yaml --fleet stage.yaml --fleet-b tour.yaml
  downbeat diff monday.mcap tuesday.mcap --within 1ms
  downbeat diff show.yaml changed.yaml --html changes.html
  downbeat diff monday.mcap tuesday.mcap --html week.html
  downbeat diff show.yaml changed.yaml --format json"
)]
pub(super) struct DiffArgs {
    /// A scenario; or a recording, a journal, or the folder of a mission.
    a: PathBuf,
    /// A second one of the same kind.
    b: PathBuf,
    /// The fleet file of both scenarios. By default, the one that each names, or else ./fleet.yaml.
    #[arg(long, value_name = "FILE")]
    fleet: Option<PathBuf>,
    /// The fleet file of the second scenario, if it differs.
    #[arg(long, value_name = "FILE")]
    fleet_b: Option<PathBuf>,
    #[command(flatten)]
    project: ProjectArgs,
    /// Treat start errors and spreads of missions as equal if they differ by at most this.
    #[arg(long, value_name = "DURATION", value_parser = within)]
    within: Option<Span>,
    /// Write a page for a browser: the second scenario or mission, with the first one behind it, and the differences. It needs no
    /// network.
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Compare the parts before the damage of a recording or a journal that is not whole.
    #[arg(long)]
    partial: bool,
}

fn within(text: &str) -> Result<Span, String> {
    parse_duration(text).ok_or_else(|| "expected a duration such as 500us or 1ms".to_owned())
}

pub(super) fn diff(args: &DiffArgs, format: Format) -> Exit {
    match differs(args, format) {
        Ok(false) => Exit::Done,
        Ok(true) => Exit::Failed,
        Err(exit) => exit,
    }
}

fn differs(args: &DiffArgs, format: Format) -> Result<bool, Exit> {
    match (is_run(&args.a)?, is_run(&args.b)?) {
        (false, false) => plans(args, format),
        (true, true) => runs(args, format),
        (a_is_run, _) => {
            let (run, plan) = if a_is_run { (&args.a, &args.b) } else { (&args.b, &args.a) };
            Err(refused(&format!(
                "`{}` is a recorded mission, but `{}` is not; expected two scenarios, or two recordings, journals or folders of missions",
                run.display(),
                plan.display()
            )))
        }
    }
}

fn is_run(path: &Path) -> Result<bool, Exit> {
    History::is_at(path).map_err(|error| {
        let refusal = Refusal::of(Attempt::Read(path), &error);
        refused(&format!("cannot read `{}`: {refusal}", path.display()))
    })
}

fn refused(error: &str) -> Exit {
    console::error(error);
    Exit::Usage
}

fn plans(args: &DiffArgs, format: Format) -> Result<bool, Exit> {
    if args.within.is_some() || args.partial {
        return Err(refused(
            "--within and --partial apply only to recorded missions, but these are scenarios",
        ));
    }
    let fleet_b = args.fleet_b.as_ref().or(args.fleet.as_ref()).cloned();
    let a =
        ScenarioArgs { scenario: args.a.clone(), fleet: args.fleet.clone(), project: args.project.clone() };
    let b = ScenarioArgs { scenario: args.b.clone(), fleet: fleet_b, project: args.project.clone() };
    // Exit code 1 would mean that the scenarios differ.
    let load = |side: &ScenarioArgs| load::load_whole(side, format).map_err(|_| Exit::Usage);
    let ((plan_a, fleet_a, path_a, _), (plan_b, fleet_b, path_b, findings)) = (load(&a)?, load(&b)?);
    let found = compare::plans((&plan_a, &fleet_a), (&plan_b, &fleet_b));
    if let Some(page) = &args.html {
        let sources: [&Path; 4] = [&args.a, &args.b, &path_a, &path_b];
        if let Some(error) = load::replaces(page, &sources) {
            return Err(refused(&error));
        }
        let other = OtherPlan { name: args.a.display().to_string(), choreography: &plan_a, found: &found };
        let (played, told) = dry_run::rehearse(&plan_b, &fleet_b, format).map_err(|(_, error)| {
            refused(&format!("cannot simulate `{}` for the HTML page: {error}", args.b.display()))
        })?;
        let rehearsed = Rehearsed {
            choreography: &plan_b,
            outline: &load::outline(&b, &fleet_b),
            fleet: &fleet_b,
            findings: &findings,
            played: &played,
            told: &told,
        };
        page::of_difference(&rehearsed, &other).and_then(|text| page::save(page, &text)).map_err(
            |error| {
                let refusal = Refusal::of(Attempt::Write(page), &error);
                refused(&format!("cannot write `{}`: {refusal}", page.display()))
            },
        )?;
    }
    show(&found, format, |columns| text::plan_text(&found, columns));
    Ok(!found.same)
}

fn runs(args: &DiffArgs, format: Format) -> Result<bool, Exit> {
    if args.fleet.is_some() || args.fleet_b.is_some() {
        return Err(refused("--fleet applies only to scenarios, but these are recorded missions"));
    }
    let (a, b) = (history(&args.a, args.partial)?, history(&args.b, args.partial)?);
    let found = compare::runs(&a, &b, args.within.unwrap_or_default());
    if let Some(page) = &args.html {
        if let Some(error) = load::replaces(page, &[&args.a, &args.b]) {
            return Err(refused(&error));
        }
        let other = OtherRun { name: args.a.display().to_string(), history: &a, found: &found };
        page::of_run_difference(&b, &other).and_then(|text| page::save(page, &text)).map_err(|error| {
            let refusal = Refusal::of(Attempt::Write(page), &error);
            refused(&format!("cannot write `{}`: {refusal}", page.display()))
        })?;
    }
    show(&found, format, |columns| text::run_text(&found, columns));
    Ok(!found.same)
}

fn history(path: &Path, partial: bool) -> Result<History, Exit> {
    let history = match History::read(path) {
        Ok(history) => history,
        Err(NoHistory::Io { path, error }) => {
            let refusal = Refusal::of(Attempt::Read(&path), &error);
            return Err(refused(&format!("cannot read `{}`: {refusal}", path.display())));
        }
        Err(error) => return Err(refused(&error.to_string())),
    };
    let name = path.display();
    match &history.cut_off {
        Some(cut_off) if !partial || history.is_empty() => Err(refused(&format!(
            "`{name}` is incomplete: {cut_off}; --partial compares the part before that"
        ))),
        Some(cut_off) => {
            console::note(&format!("`{name}` is incomplete: {cut_off}"));
            Ok(history)
        }
        None => Ok(history),
    }
}

fn show(found: &impl Serialize, format: Format, text: impl FnOnce(usize) -> String) {
    match format {
        Format::Text => console::print(&text(console::columns())),
        Format::Json => console::print_json(found),
    }
}
