//! Lists the moves and sequences that a scenario offers, with their parameters, for authors of cues.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use crate::fields::Reader;
use crate::files::Files;
use crate::finding::{Finding, Place};
use crate::fleet::Fleet;
use crate::locate::lines_of;
use crate::node::Node;
use crate::scenario::{self, Shared};
use crate::source::Source;

/// A move or a sequence that cues can use.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Offer {
    /// Kind of the entry: `move` or `sequence`.
    pub kind: &'static str,
    /// Name by which the scenario uses the entry.
    pub name: String,
    /// Description of the entry: the text of its key `doc`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub doc: Option<String>,
    /// Parameters in the order of the file.
    pub parameters: Vec<Parameter>,
    /// Devices that a move uses, in the order of the file. Devices whose names are parameters of a played move are not included.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub devices: Vec<String>,
    /// Names of the moves and sequences that the entry uses, in the order of the file.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub uses: Vec<String>,
    /// Name of the file that contains the entry.
    pub file: String,
    /// Line of the entry in that file, from 1.
    pub line: usize,
}

/// A parameter of a move or a sequence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Parameter {
    /// Name of the parameter.
    pub name: String,
    /// Default value as written; `None` if the parameter has no default.
    pub default: Option<String>,
}

/// Returns the moves and sequences of a scenario and of all files that it includes, sorted by kind and name.
///
/// # Errors
/// Returns the findings if one of the files cannot be read or is not YAML. Errors within the entries are left to [`crate::compile`].
pub fn inventory(source: &Source, files: &dyn Files) -> Result<Vec<Offer>, Vec<Finding>> {
    let documents = scenario::documents(source, files)?;
    let fleet = Fleet::default();
    let library = scenario::library_of(&mut Reader::default(), &documents, files, &fleet);
    let Some(library) = library else { return Ok(Vec::new()) };
    let mut all: Vec<(&'static str, String, Shared<'_>)> = library.offered().collect();
    all.sort_by(|one, other| (one.0, &one.1).cmp(&(other.0, &other.1)));
    let place = |(kind, _, part): &(&'static str, String, Shared<'_>)| {
        let list = Place { file: part.file, ..Place::default() }.of_key(if *kind == "move" {
            "moves"
        } else {
            "sequences"
        });
        Place { key: true, ..list.of_key(part.name) }
    };
    let places: Vec<Place> = all.iter().map(place).collect();
    let lines = lines_of(&documents.sources, &places.iter().collect::<Vec<_>>());
    let offers = all.into_iter().zip(lines).map(|((kind, name, part), (line, _))| Offer {
        kind,
        name,
        doc: text(part.node, "doc"),
        parameters: parameters(part.node),
        devices: devices(part.node),
        uses: uses(part.node),
        file: documents.sources[usize::from(part.file)].name.clone(),
        line,
    });
    let mut offers: Vec<Offer> = offers.collect();
    add_played_devices(&mut offers);
    Ok(offers)
}

fn entry<'n>(node: &'n Node, key: &str) -> Option<&'n Node> {
    match node {
        Node::Map(entries) => entries.iter().find(|(known, _)| known == key).map(|(_, node)| node),
        _ => None,
    }
}

fn text(node: &Node, key: &str) -> Option<String> {
    match entry(node, key)? {
        Node::Text(text) => Some(text.trim().to_owned()),
        _ => None,
    }
}

/// Returns the devices of a move's own tracks, without duplicates.
fn devices(node: &Node) -> Vec<String> {
    let mut devices: Vec<String> = Vec::new();
    let tracks =
        std::iter::once(node).chain(entries_of(node)).filter_map(|node| match entry(node, "tracks")? {
            Node::Map(entries) => Some(entries),
            _ => None,
        });
    for (device, _) in tracks.flatten() {
        if !devices.contains(device) {
            devices.push(device.clone());
        }
    }
    devices
}

fn parameters(node: &Node) -> Vec<Parameter> {
    let Some(Node::Map(entries)) = entry(node, "parameters") else { return Vec::new() };
    let written = |node: &Node| match node {
        Node::Text(text) => Some(text.clone()),
        Node::Number(value) => Some(value.to_string()),
        Node::Bool(value) => Some(value.to_string()),
        _ => None,
    };
    entries.iter().map(|(name, node)| Parameter { name: name.clone(), default: written(node) }).collect()
}

/// Returns the moves that a move plays, or the moves and sequences that a sequence's cues use, without duplicates.
fn uses(node: &Node) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for item in entries_of(node) {
        for name in ["move", "sequence"].into_iter().filter_map(|key| text(item, key)) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
    }
    names
}

/// Returns the entries of `play`, including those of inner lists, or the cues of a sequence.
fn entries_of<'n>(node: &'n Node) -> Vec<&'n Node> {
    let lists = [entry(node, "play"), entry(node, "cues")].into_iter().flatten();
    let inner = |item: &'n Node| if matches!(item, Node::List(_)) { items(item) } else { vec![item] };
    lists.flat_map(items).flat_map(inner).collect()
}

fn items(node: &Node) -> Vec<&Node> {
    match node {
        Node::List(items) => items.iter().collect(),
        _ => Vec::new(),
    }
}

/// Adds the devices of played moves to each move that plays them.
fn add_played_devices(offers: &mut [Offer]) {
    let index_of: BTreeMap<String, usize> = offers
        .iter()
        .enumerate()
        .filter(|(_, offer)| offer.kind == "move")
        .map(|(index, offer)| (offer.name.clone(), index))
        .collect();
    for index in index_of.values().copied() {
        let (mut seen, mut found, mut open) = (BTreeSet::from([index]), Vec::new(), vec![index]);
        while let Some(next) = open.pop() {
            let prefix = offers[next].name.rsplit_once('.').map_or("", |(prefix, _)| prefix).to_owned();
            for name in offers[next].uses.clone() {
                let known = index_of.get(&format!("{prefix}.{name}")).or_else(|| index_of.get(&name));
                if let Some(known) = known.filter(|known| seen.insert(**known)) {
                    found.push(*known);
                    open.push(*known);
                }
            }
        }
        for other in found {
            for device in offers[other].devices.clone() {
                if !offers[index].devices.contains(&device) {
                    offers[index].devices.push(device);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NoFiles;

    #[test]
    fn moves_and_sequences_are_listed_with_parameters_devices_and_uses() {
        let text = "scenario: s
moves:
  greet: {doc: Bows and waves., parameters: {depth: 30, hand: ~}, play: [{move: bow}, [{tracks: {lamp: []}}, {move: wave}]]}
  bow: {tracks: {back: []}}
  wave: {play: [{move: bow}], parameters: {time: 2 * 1s}}
sequences:
  all: {cues: [{move: bow}, {sequence: all}]}
cues: [{cue: mark}]
";
        let source = Source { name: "s.yaml".into(), text: text.to_owned() };
        let offers = inventory(&source, &NoFiles).unwrap();
        let names: Vec<_> =
            offers.iter().map(|offer| (offer.kind, offer.name.as_str(), offer.line)).collect();
        assert_eq!(
            names,
            [("move", "bow", 4), ("move", "greet", 3), ("move", "wave", 5), ("sequence", "all", 7)]
        );
        let greet = &offers[1];
        assert_eq!(greet.doc.as_deref(), Some("Bows and waves."));
        assert_eq!(greet.devices, ["lamp", "back"]);
        let parameters: Vec<_> =
            greet.parameters.iter().map(|p| (p.name.as_str(), p.default.as_deref())).collect();
        assert_eq!(parameters, [("depth", Some("30")), ("hand", None)]);
        assert_eq!(offers[3].uses, ["bow", "all"]);
    }
}
