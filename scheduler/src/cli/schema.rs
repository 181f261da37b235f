//! `downbeat schema`: JSON Schemas for editors.

use clap::ValueEnum;

use super::{Exit, console};

/// Print the JSON Schema of a scenario or a fleet file, for editors.
#[derive(Debug, clap::Args)]
#[command(after_help = "How to set up an editor: docs/editors.md.

Examples:
  downbeat schema scenario > scenario.schema.json
  downbeat schema fleet > fleet.schema.json")]
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
}

pub(super) fn schema(args: &SchemaArgs) -> Exit {
    let of = match args.of {
        Of::Scenario => downbeat_scripts::Schema::Scenario,
        Of::Fleet => downbeat_scripts::Schema::Fleet,
    };
    console::print(downbeat_scripts::schema(of));
    Exit::Done
}
