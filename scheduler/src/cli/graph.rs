//! `downbeat graph`: acts, cues and relations for the tools that draw graphs.

use clap::ValueEnum;

use super::{Exit, Format, ScenarioArgs, choice, console, load};
use crate::show::graph::Graph;

/// Write acts, cues and their relations as a graph, for Graphviz or Mermaid.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Acts are boxes, with the course from act to act between them. Each cue shows its start, its duration and its \
slack; the critical path is bold and red. With --format json, nodes and edges are printed.

Examples:
  downbeat graph show.yaml | dot -Tsvg -o show.svg
  downbeat graph show.yaml --act finale | dot -Tpng -o finale.png
  downbeat graph show.yaml --as mermaid
  downbeat graph show.yaml --format json"
)]
pub(super) struct GraphArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Only this act.
    #[arg(long, value_name = "NAME")]
    act: Option<String>,
    /// The language of the graph. By default dot.
    #[arg(long = "as", value_enum, value_name = "LANGUAGE")]
    language: Option<Language>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Language {
    /// Graphviz.
    Dot,
    /// A flowchart, as many sites for code and notes draw it.
    Mermaid,
}

pub(super) fn graph(args: &GraphArgs, format: Format) -> Exit {
    if args.language.is_some() && format == Format::Json {
        console::error(
            "--as is for tools that draw; leave it out, because --format json has nodes and edges",
        );
        return Exit::Usage;
    }
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
        Format::Text => console::print(&match args.language.unwrap_or(Language::Dot) {
            Language::Dot => graph.dot(),
            Language::Mermaid => graph.mermaid(),
        }),
    }
    Exit::Done
}
