//! Descriptions of keys, of devices and of other items, for completion and hover.

use downbeat_reader::keys::{Item, Key, Kind};
use downbeat_scripts::Fleet;
use urrcp::{ControlType, Device};

use crate::file::File;
use crate::names::Site;

/// Maximum number of characters of a summary.
const SUMMARY_MAX: usize = 80;

/// A device with a description of its values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct DeviceAbout {
    pub(crate) id: String,
    /// Its range and its unit.
    pub(crate) summary: String,
}

/// Returns the documentation of a key in Markdown.
pub(crate) fn key(key: &Key) -> String {
    let mut text = paragraphs(key.doc);
    if text.is_empty() {
        text = of_kind(key.kind);
    }
    let words = words(key.kind);
    if !words.is_empty() && !words.iter().all(|word| text.contains(&format!("`{word}`"))) {
        let listed: Vec<String> = words.iter().map(|word| format!("`{word}`")).collect();
        text.push_str(&format!(" Words: {}.", listed.join(", ")));
    }
    if let Some(default) = key.default() {
        text.push_str(&format!("\n\nDefault: {default}."));
    }
    if key.required {
        text.push_str("\n\nRequired.");
    }
    text
}

/// Joins the lines of a doc comment to paragraphs. Links lead to the documentation, so only their texts remain.
fn paragraphs(doc: &[&str]) -> String {
    let mut text = String::new();
    for line in doc {
        let line = line.trim();
        if line.is_empty() {
            text.push_str("\n\n");
        } else {
            text.push_str(line);
            text.push(' ');
        }
    }
    without_links(text.trim())
}

fn without_links(text: &str) -> String {
    let mut plain = String::new();
    let mut rest = text;
    while let Some(at) = rest.find("](#") {
        let label = rest[..at].rfind('[').unwrap_or(at);
        plain.push_str(&rest[..label]);
        plain.push_str(rest.get(label + 1..at).unwrap_or_default());
        rest = rest[at..].find(')').map_or("", |end| &rest[at + end + 1..]);
    }
    plain.push_str(rest);
    plain
}

fn of_kind(kind: &Kind) -> String {
    match kind {
        Kind::Named { doc, .. } => paragraphs(doc),
        Kind::Keys(of) | Kind::KeysOf(of, _) | Kind::KeysAnd(of, _) => paragraphs(of().doc),
        Kind::Name(_, kind) | Kind::NameKeys(_, kind) => of_kind(kind),
        _ => String::new(),
    }
}

fn words(kind: &'static Kind) -> Vec<&'static str> {
    let all = crate::typed::alternatives(kind);
    let words = all.iter().filter_map(|typing| match typing.kind {
        Kind::Words(words) => Some(*words),
        _ => None,
    });
    words.flatten().copied().collect()
}

/// Describes an item in a few words, from its definition.
pub(crate) fn summary(site: &Site, fleet: Option<&Fleet>) -> Option<String> {
    let mention = site.mention();
    let file = &site.file;
    match mention.naming.item() {
        Item::Robot => robot(&mention.name, fleet).or_else(|| listed(file, mention.node)),
        Item::Device => fleet.and_then(|fleet| {
            let all = devices(fleet, &[]);
            all.into_iter().find(|device| device.id == mention.name).map(|device| device.summary)
        }),
        Item::Move | Item::Sequence => {
            let node = value_of(file, mention.node)?;
            let doc = file.tree.value(node, "doc").and_then(|doc| file.tree.scalar(doc));
            doc.map(|doc| doc.split_whitespace().collect::<Vec<_>>().join(" "))
        }
        Item::Variable | Item::Parameter | Item::Formation | Item::Path => listed(file, mention.node),
        _ => None,
    }
}

/// Returns the node of the value whose key is a node.
pub(crate) fn value_of(file: &File, key: usize) -> Option<usize> {
    let map = file.tree.nodes.get(key)?.parent?;
    file.tree.entries(map).iter().find(|entry| entry.key == key).map(|entry| entry.value)
}

/// Returns the value of a key as written, on one line.
fn listed(file: &File, key: usize) -> Option<String> {
    let value = value_of(file, key)?;
    let text = &file.text.as_str()[file.tree.nodes[value].span.clone()];
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let mut short: String = text.chars().take(SUMMARY_MAX).collect();
    if short.len() < text.len() {
        short.push_str(" ...");
    }
    Some(short)
}

fn robot(name: &str, fleet: Option<&Fleet>) -> Option<String> {
    let fleet = fleet?;
    if let Some(robot) = fleet.robots.iter().find(|robot| robot.id.as_str() == name) {
        let devices = robot.init.iter().flat_map(|init| &init.devices).map(|device| device.id.as_str());
        return Some(format!("robot with {}", devices.collect::<Vec<_>>().join(", ")));
    }
    let group = fleet.groups.get(name)?;
    let ids: Vec<&str> = group.iter().map(|id| id.as_str()).collect();
    Some(format!("group of {}", ids.join(", ")))
}

/// Returns the ids of the robots of the cue around a node. Empty if there is no cue, or if it does not say.
pub(crate) fn robots_at(file: &File, node: usize, fleet: &Fleet) -> Vec<String> {
    let robots = file.ancestors(node).find_map(|map| file.tree.value(map, "robots"));
    let Some(robots) = robots else { return Vec::new() };
    let names = file.tree.items(robots).iter().chain(std::iter::once(&robots));
    let mut ids = Vec::new();
    for name in names.filter_map(|node| file.tree.scalar(*node)) {
        match fleet.groups.get(name) {
            Some(group) => ids.extend(group.iter().map(|id| id.as_str().to_owned())),
            None => ids.push(name.to_owned()),
        }
    }
    ids
}

/// Returns the devices of robots, each id once; the devices of all robots if none of the ids is known.
pub(crate) fn devices(fleet: &Fleet, robots: &[String]) -> Vec<DeviceAbout> {
    let is_meant = |id: &str| robots.iter().any(|robot| robot == id);
    let any = fleet.robots.iter().any(|robot| is_meant(robot.id.as_str()));
    let meant = fleet.robots.iter().filter(|robot| !any || is_meant(robot.id.as_str()));
    let mut all: Vec<DeviceAbout> = Vec::new();
    for device in meant.flat_map(|robot| &robot.init).flat_map(|init| &init.devices) {
        if !all.iter().any(|known| known.id == device.id.as_str()) {
            all.push(DeviceAbout { id: device.id.as_str().to_owned(), summary: of_device(device) });
        }
    }
    all
}

/// Describes the values of a device: ranges and unit.
pub(crate) fn of_device(device: &Device) -> String {
    let unit = device.unit.as_ref().map(|unit| format!(" {}", unit.as_str())).unwrap_or_default();
    let per_second = |control| match control {
        ControlType::Speed => "/s",
        ControlType::Acceleration => "/s²",
        _ => "",
    };
    let types = [ControlType::Position, ControlType::Speed, ControlType::Acceleration];
    let ranges = types.into_iter().filter_map(|control| {
        let limits = device.available_control_types.limits(control)?;
        let (least, most) = (limits.min_value, limits.max_value);
        Some(format!("{control} {least} to {most}{unit}{}", per_second(control)))
    });
    let ranges: Vec<String> = ranges.collect();
    if !ranges.is_empty() {
        ranges.join(", ")
    } else if device.available_control_types.sensor().is_some() {
        format!("sensor{unit}")
    } else {
        "no range".to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_described_without_links() {
        let scenario = downbeat_scripts::scenario_keys();
        let order = scenario.keys.iter().find(|key| key.name == "order").unwrap();
        assert!(super::key(order).contains("Words: `given`, `auto`."), "{}", super::key(order));
        assert!(super::key(order).ends_with("Default: `given`."));
        assert_eq!(
            without_links("See [patterns over a group](#patterns-over-a-group)."),
            "See patterns over a group."
        );
    }
}
