//! `downbeat schema`: prints JSON Schemas for editors.

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
    /// The subject of the schema.
    #[arg(value_enum)]
    of: Of,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Of {
    /// A choreography.
    Scenario,
    /// The robots.
    Fleet,
    /// The conditions of a dry run.
    World,
    /// The output of `run`, `dry-run` and `preflight` with `--format json`.
    Report,
    /// The messages to and from a robot, one message per line.
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
