//! `downbeat report`: shows a mission that was played, from its journal or its recording.

use std::path::{Path, PathBuf};

use downbeat_scripts::shown::shown;
use downbeat_scripts::{Attempt, Refusal};

use super::{Exit, Format, ProjectArgs, ScenarioArgs, console, load};
use crate::history::{self, History, HistoryReport, NoHistory};
use crate::page::{self, Written};

/// Show a mission that was played, from its journal or its recording.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "A recording (`downbeat run --record`) contains requests, values and clocks; a journal contains only the decisions. An incomplete \
file, for example after a power failure, is refused; --partial shows the part before the damage.

Examples:
  downbeat report show.mcap --html show.html
  downbeat report show.mcap --html show.html --scenario show.yaml
  downbeat report ~/.local/state/downbeat/swap@stage-4711-20261123T193000000
  downbeat report show.mcap --partial --format json"
)]
pub(super) struct ReportArgs {
    /// A recording, a journal, or the folder of a mission.
    file: PathBuf,
    /// Write a page for a browser. It needs no network.
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// The scenario that was played: the page then has its cues, its lines and its bodies.
    #[arg(long, value_name = "FILE", requires = "html")]
    scenario: Option<PathBuf>,
    /// The fleet file of that scenario. By default, the one that the scenario names, or else ./fleet.yaml.
    #[arg(long, value_name = "FILE", requires = "scenario")]
    fleet: Option<PathBuf>,
    #[command(flatten)]
    project: ProjectArgs,
    /// Show the part before the damage of a file that is not whole.
    #[arg(long)]
    partial: bool,
}

pub(super) fn report(args: &ReportArgs, format: Format) -> Exit {
    let history = match read(&args.file, args.partial, "shows") {
        Ok(history) => history,
        Err(exit) => return exit,
    };
    if let Some(error) = args.html.as_ref().and_then(|path| load::replaces(path, &[&args.file])) {
        return refused(&error);
    }
    if let Some(path) = &args.html
        && let Err(exit) = write(args, &history, path, format)
    {
        return exit;
    }
    let report = history.report();
    match format {
        Format::Text => console::print(&text(&report)),
        Format::Json => console::print_json(&report),
    }
    Exit::Done
}

/// Reads the history of a mission. Refuses an incomplete file unless `partial` is true. `does` is the command's verb, for the hint.
pub(super) fn read(file: &Path, partial: bool, does: &str) -> Result<History, Exit> {
    let history = match History::read(file) {
        Ok(history) => history,
        Err(NoHistory::Io { path, error }) => {
            let refusal = Refusal::of(Attempt::Read(&path), &error);
            return Err(refused(&format!("cannot read `{}`: {refusal}", path.display())));
        }
        Err(error) => return Err(refused(&error.to_string())),
    };
    let Some(cut_off) = &history.cut_off else { return Ok(history) };
    let name = file.display();
    if !partial {
        return Err(refused(&format!(
            "`{name}` is incomplete: {cut_off}; --partial {does} the part before that"
        )));
    }
    if history.is_empty() {
        return Err(refused(&format!(
            "`{name}` is incomplete: {cut_off}, so none of it can be read; use the mission's journal if it still exists"
        )));
    }
    console::note(&format!("`{name}` is incomplete: {cut_off}"));
    Ok(history)
}

fn write(args: &ReportArgs, history: &History, path: &Path, format: Format) -> Result<(), Exit> {
    let page = match &args.scenario {
        None => page::of_history(history, None),
        Some(scenario) => {
            let scenario = ScenarioArgs {
                scenario: scenario.clone(),
                fleet: args.fleet.clone(),
                project: args.project.clone(),
            };
            let (choreography, fleet, _, findings) = load::load_whole(&scenario, format)?;
            let outline = load::outline(&scenario, &fleet);
            let written = Written {
                choreography: &choreography,
                outline: &outline,
                fleet: &fleet,
                findings: &findings,
            };
            written.check(history).map_err(|error| refused(&error.to_string()))?;
            page::of_history(history, Some(&written))
        }
    };
    page.and_then(|text| page::save(path, &text)).map_err(|error| {
        let refusal = Refusal::of(Attempt::Write(path), &error);
        refused(&format!("cannot write `{}`: {refusal}", path.display()))
    })
}

fn refused(error: &str) -> Exit {
    console::error(error);
    Exit::Usage
}

fn text(report: &HistoryReport<'_>) -> String {
    let name = report.scenario.unwrap_or("a mission");
    let outcome = report.outcome.map_or_else(|| "outcome unknown".to_owned(), ToString::to_string);
    let mut text = format!("{}: {outcome}\n", shown(name));
    for act in &report.acts {
        let robots = downbeat_scripts::counted(act.robots.len(), "robot");
        let spread = act.spread.map_or_else(
            || "spread unknown".to_owned(),
            |spread| format!("spread {} ms", spread.as_millis_f64()),
        );
        let fate = history::fate_text(act);
        let (name, start) = (shown(&act.act), act.start);
        text += &format!("  {name}: {fate}, planned start {start}, {robots}, {spread}\n");
    }
    for failure in &report.failures {
        text += &format!("  {}: {}\n", shown(failure.robot.as_str()), shown(&failure.kind.to_string()));
    }
    text
}
