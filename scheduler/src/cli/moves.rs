//! `downbeat moves`: lists the moves and sequences that cues can use.

use std::path::PathBuf;

use downbeat_scripts::shown::shown;
use downbeat_scripts::{Finding, Folder, Offer, Parameter, Source, inventory};

use super::{Exit, Format, ProjectArgs, console, load};

/// List the moves and sequences of a scenario with their parameters, devices and documentation.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  downbeat moves show.yaml
  downbeat moves show.yaml --format json")]
pub(super) struct MovesArgs {
    /// The scenario, a YAML file.
    scenario: PathBuf,
    #[command(flatten)]
    project: ProjectArgs,
}

pub(super) fn moves(args: &MovesArgs, format: Format) -> Exit {
    let offers = Source::read(&args.scenario).map_err(|finding| vec![finding]).and_then(|source| {
        let folder = args.scenario.parent().map(PathBuf::from).unwrap_or_default();
        inventory(&source, &Folder::within(folder, args.project.of(&args.scenario)))
    });
    let offers = match offers {
        Ok(offers) => offers,
        Err(findings) => {
            let is_access = findings.iter().any(Finding::is_about_access);
            match format {
                Format::Json => console::print_json(&serde_json::json!({ "findings": findings })),
                Format::Text => load::show_findings(&findings),
            }
            return if is_access { Exit::Usage } else { Exit::Failed };
        }
    };
    match format {
        Format::Json => console::print_json(&serde_json::json!({ "offers": offers })),
        Format::Text if offers.is_empty() => console::print("no moves and no sequences\n"),
        Format::Text => console::print(&offers.iter().map(told).collect::<Vec<_>>().join("\n")),
    }
    Exit::Done
}

/// Returns a heading with the name and parameters, followed by one line for each other property.
fn told(offer: &Offer) -> String {
    let parameter = |parameter: &Parameter| match &parameter.default {
        Some(default) => format!("{}: {}", shown(&parameter.name), shown(default)),
        None => format!("{} (needed)", shown(&parameter.name)),
    };
    let parameters: Vec<_> = offer.parameters.iter().map(parameter).collect();
    let mut text = format!("{} {}", offer.kind, shown(&offer.name));
    if !parameters.is_empty() {
        text.push_str(&format!(" {{{}}}", parameters.join(", ")));
    }
    text.push('\n');
    for line in offer.doc.iter().flat_map(|doc| doc.lines()) {
        text.push_str(&format!("  {}\n", shown(line)));
    }
    for (word, names) in [("moves", &offer.devices), ("uses", &offer.uses)] {
        if !names.is_empty() {
            text.push_str(&format!("  {word} {}\n", shown(&names.join(", "))));
        }
    }
    text.push_str(&format!("  at {}:{}\n", shown(&offer.file), offer.line));
    text
}
