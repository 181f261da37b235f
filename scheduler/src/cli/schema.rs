//! `downbeat schema`: JSON Schemas for editors.

use clap::ValueEnum;

use super::{Exit, console};

/// Print the JSON Schema of a scenario, a fleet file, a world file, a report or the protocol's messages.
#[derive(Debug, clap::Args)]
#[command(after_help = "docs/editors.md says how to set up an editor.

Examples:
  downbeat schema scenario > scenario.schema.json
  downbeat schema fleet > fleet.schema.json
  downbeat schema world > world.schema.json
  downbeat schema report > report.schema.json
  downbeat schema protocol > urrcp.schema.json")]
pub(super) struct SchemaArgs {
    /// What the schema describes.
    #[arg(value_enum)]
    of: Of,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Of {
    /// A choreography.
    Scenario,
    /// The robots.
    Fleet,
    /// What a dry run meets.
    World,
    /// What `run`, `dry-run` and `preflight` print with `--format json`.
    Report,
    /// What goes to a robot and comes from it, a message a line.
    Protocol,
}

pub(super) fn schema(args: &SchemaArgs) -> Exit {
    match args.of {
        Of::Scenario => console::print(downbeat_scripts::schema(downbeat_scripts::Schema::Scenario)),
        Of::Fleet => console::print(downbeat_scripts::schema(downbeat_scripts::Schema::Fleet)),
        Of::World => console::print(downbeat_scripts::schema(downbeat_scripts::Schema::World)),
        Of::Report => console::print(crate::report::SCHEMA),
        Of::Protocol => console::print_json(&urrcp::message_schema()),
    }
    Exit::Done
}
