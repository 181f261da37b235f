//! `downbeat schema`: JSON Schemas for editors.

use clap::ValueEnum;

use super::{Exit, console};

/// Print the JSON Schema of a scenario, a fleet file or a report.
#[derive(Debug, clap::Args)]
#[command(after_help = "How to set up an editor: docs/editors.md.

Examples:
  downbeat schema scenario > scenario.schema.json
  downbeat schema fleet > fleet.schema.json
  downbeat schema report > report.schema.json")]
pub(super) struct SchemaArgs {
    /// Of which file.
    #[arg(value_enum)]
    of: Of,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Of {
    /// A choreography.
    Scenario,
    /// The robots.
    Fleet,
    /// What `run`, `dry-run` and `preflight` print with `--format json`.
    Report,
}

pub(super) fn schema(args: &SchemaArgs) -> Exit {
    console::print(match args.of {
        Of::Scenario => downbeat_scripts::schema(downbeat_scripts::Schema::Scenario),
        Of::Fleet => downbeat_scripts::schema(downbeat_scripts::Schema::Fleet),
        Of::Report => crate::report::SCHEMA,
    });
    Exit::Done
}
