//! `downbeat graph`: writes acts, cues and relations for Graphviz.

use super::{Exit, Format, ScenarioArgs, choice, console, load};
use crate::show::graph::Graph;

/// Write acts, cues and their relations as a graph, for Graphviz.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Acts are boxes; the edges between them show which act follows. Each cue shows its start, its duration and its \
slack; the critical path is bold and red. With --format json, nodes and edges are printed.

Examples:
  downbeat graph show.yaml | dot -Tsvg -o show.svg
  downbeat graph show.yaml --act finale | dot -Tpng -o finale.png
  downbeat graph show.yaml --format json"
)]
pub(super) struct GraphArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Only this act.
    #[arg(long, value_name = "NAME")]
    act: Option<String>,
}

pub(super) fn graph(args: &GraphArgs, format: Format) -> Exit {
    let (choreography, fleet) = match load::load_choreography(&args.scenario, format) {
        Ok((choreography, fleet, _)) => (choreography, fleet),
        Err(exit) => return exit,
    };
    let only = match &args.act {
        None => None,
        Some(name) => match choreography.acts.iter().position(|act| act.is_named(name)) {
            Some(index) => Some(index),
            None => {
                console::error(&choice::no_such_act("--act", name, &choreography));
                return Exit::Usage;
            }
        },
    };
    let graph = Graph::of(&choreography, &load::outline(&args.scenario, &fleet), only);
    match format {
        Format::Json => console::print_json(&graph),
        Format::Text => console::print(&graph.dot()),
    }
    Exit::Done
}
