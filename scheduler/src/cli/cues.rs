//! `downbeat cues`: writes the cue sheet of a show.

use std::path::{Path, PathBuf};

use downbeat_scripts::{Attempt, Refusal};

use super::{Exit, Format, ScenarioArgs, console, load};
use crate::page;
use crate::show::cue_sheet::CueSheet;

/// List all cues for the people who run the show, also as CSV or as a page to print.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Each cue has its number, its time since the act's start, its robots and its note. The page fits A4 paper: print it from \
the browser, also to a PDF.

Examples:
  downbeat cues show.yaml
  downbeat cues show.yaml --html cues.html
  downbeat cues show.yaml --csv cues.csv"
)]
pub(super) struct CuesArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Write a page to print.
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Write a table for spreadsheets.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

pub(super) fn cues(args: &CuesArgs, format: Format) -> Exit {
    let outputs = [&args.html, &args.csv].into_iter().flatten();
    let mut problems = outputs.filter_map(|path| load::replaces(path, &[&args.scenario.scenario]));
    if let Some(problem) = problems.next() {
        console::error(&problem);
        return Exit::Usage;
    }
    let (choreography, fleet) = match load::load_choreography(&args.scenario, format) {
        Ok((choreography, fleet, _)) => (choreography, fleet),
        Err(exit) => return exit,
    };
    let sheet = CueSheet::of(&choreography, &load::outline(&args.scenario, &fleet));
    let files = [(&args.html, sheet.html()), (&args.csv, sheet.csv())];
    let mut written = 0;
    for (path, text) in files {
        let Some(path) = path else { continue };
        if let Err(error) = write(path, &text) {
            console::error(&error);
            return Exit::Usage;
        }
        written += 1;
    }
    match format {
        Format::Json => console::print_json(&sheet),
        Format::Text if written == 0 => console::print(&sheet.text(console::columns())),
        Format::Text => {}
    }
    Exit::Done
}

fn write(path: &Path, text: &str) -> Result<(), String> {
    page::save(path, text).map_err(|error| {
        let refusal = Refusal::of(Attempt::Write(path), &error);
        format!("cannot write `{}`: {refusal}", path.display())
    })?;
    console::note(&format!("wrote {}", path.display()));
    Ok(())
}
