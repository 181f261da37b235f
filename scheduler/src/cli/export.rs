//! `downbeat export`: converts a compiled scenario into files of other tools.

use std::path::PathBuf;

use clap::builder::PossibleValue;
use downbeat_export::{ExportFormat, Exported};
use serde::Serialize;

use super::import::{rate, write_all};
use super::load;
use super::{Exit, Format, ScenarioArgs, console};

/// Convert a scenario into files of other tools.
#[derive(Debug, clap::Args)]
#[command(after_help = "Formats:
  drone-csv         one CSV per drone, as Skybrush Studio reads it
  joint-trajectory  one YAML file per robot, as ROS JointTrajectory

Examples:
  downbeat export drone-csv show.yaml --rate 25 --output csv
  downbeat export joint-trajectory show.yaml --output trajectories")]
pub(super) struct ExportArgs {
    /// The format of the files to write.
    #[arg(value_name = "FORMAT")]
    to: To,
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// The folder for the files.
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
    /// Replace files that exist.
    #[arg(long)]
    force: bool,
    /// Lines per second of a drone-csv. By default, 10.
    #[arg(long, value_name = "HZ", value_parser = rate)]
    rate: Option<f64>,
}

/// A format, as given on the command line.
#[derive(Clone, Copy, Debug)]
struct To(ExportFormat);

impl clap::ValueEnum for To {
    fn value_variants<'a>() -> &'a [Self] {
        &[To(ExportFormat::WORDS[0].1), To(ExportFormat::WORDS[1].1)]
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let word = ExportFormat::WORDS.iter().find(|(_, format)| *format == self.0).map(|(word, _)| *word);
        word.map(PossibleValue::new)
    }
}

#[derive(Serialize)]
struct Done<'a> {
    notes: &'a [String],
    files: &'a [String],
}

pub(super) fn export(args: &ExportArgs, format: Format) -> Exit {
    let (choreography, fleet) = match load::load_choreography(&args.scenario, format) {
        Ok((choreography, fleet, _)) => (choreography, fleet),
        Err(exit) => return exit,
    };
    let Exported { files, notes, problem } =
        downbeat_export::export(args.to.0, &choreography, &fleet, args.rate);
    if let Some(problem) = problem {
        console::error(&problem);
        return Exit::Failed;
    }
    let written = match write_all(&args.output, &files, args.force) {
        Ok(written) => written,
        Err(findings) => {
            load::show_findings(&findings);
            return Exit::Usage;
        }
    };
    match format {
        Format::Json => console::print_json(&Done { notes: &notes, files: &written }),
        Format::Text => {
            notes.iter().for_each(|note| console::note(&format!("note: {note}")));
            written.iter().for_each(|file| console::note(&format!("wrote {file}")));
        }
    }
    Exit::Done
}
