//! `downbeat report`: a mission that was played, from its journal or its recording.

use std::path::{Path, PathBuf};

use downbeat_scripts::shown::shown;
use downbeat_scripts::{Attempt, Refusal};
use serde_json::Value;

use super::{Exit, Format, ProjectArgs, ScenarioArgs, console, load};
use crate::history::{self, History, NoHistory};
use crate::page::{self, Written};

/// Show a mission that was played, from its journal or its recording.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "A recording (`downbeat run --record`) knows requests, values and clocks, a journal the decisions alone. A file \
that is not whole, as after a power failure, is refused: --partial shows what comes before the damage.

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
    /// The fleet file of that scenario. By default the one that the scenario names, or else ./fleet.yaml.
    #[arg(long, value_name = "FILE", requires = "scenario")]
    fleet: Option<PathBuf>,
    #[command(flatten)]
    project: ProjectArgs,
    /// Show what comes before the damage of a file that is not whole.
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

/// What a file has kept of a mission. A file that is not whole is refused unless a part will do, of which the command `does` this.
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
            "`{name}` is not whole: {cut_off}; --partial {does} what comes before that"
        )));
    }
    if history.is_empty() {
        return Err(refused(&format!(
            "`{name}` is not whole: {cut_off}, so nothing can be read of it; give the mission's journal, if it is still there"
        )));
    }
    console::note(&format!("`{name}` is not whole: {cut_off}"));
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

fn text(report: &Value) -> String {
    let name = report["scenario"].as_str().unwrap_or("a mission");
    let outcome = match &report["outcome"] {
        Value::Null => "its end is not known".to_owned(),
        Value::String(outcome) => outcome.clone(),
        other => other["outcome"].as_str().map_or_else(|| other.to_string(), str::to_owned),
    };
    let mut text = format!("{}: {outcome}\n", shown(name));
    for act in report["acts"].as_array().into_iter().flatten() {
        let (name, start) =
            (act["act"].as_str().unwrap_or_default(), act["start"].as_str().unwrap_or_default());
        let robots = downbeat_scripts::counted(act["robots"].as_array().map_or(0, Vec::len), "robot");
        let spread = act["spread_ms"].as_f64();
        let spread =
            spread.map_or_else(|| "no starts known".to_owned(), |spread| format!("spread {spread} ms"));
        let fate = history::fate_text(act);
        text += &format!("  {}: {fate}, planned start {start}, {robots}, {spread}\n", shown(name));
    }
    for failure in report["failures"].as_array().into_iter().flatten() {
        let (robot, why) =
            (failure["robot"].as_str().unwrap_or_default(), failure["text"].as_str().unwrap_or_default());
        text += &format!("  {}: {}\n", shown(robot), shown(why));
    }
    text
}
