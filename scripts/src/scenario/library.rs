//! What cues share: included files, variables, moves, roles, the tempo.

use std::borrow::Cow;
use std::cell::{OnceCell, RefCell};
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use super::Name;
use super::across::is_spread;
use super::each::Roster;
use crate::exact::{Fraction, fraction};
use crate::fields::{At, Reader};
use crate::files::Files;
use crate::finding::{Code, Finding, Place, one_of};
use crate::fleet::Fleet;
use crate::locate::locate;
use crate::music::{Section, Tempo, position};
use crate::node::{self, Node, shortened};
use crate::source::Source;
use crate::tags::foreign_tags;

/// Most files that a scenario may include, directly or through others.
const INCLUDES_MAX: usize = 256;

pub(crate) const SCENARIO_KEYS: [&str; 19] = [
    "scenario",
    "fleet",
    "include",
    "variables",
    "moves",
    "roles",
    "tempo",
    "signature",
    "zones",
    "order",
    "off_grid",
    "start_tolerance",
    "lead",
    "stop_condition",
    "on_failure",
    "on_doubt",
    "require",
    "cues",
    "acts",
];
const INCLUDE_KEYS: [&str; 4] = ["include", "variables", "moves", "roles"];

/// The scenario and its includes, as trees.
#[derive(Debug, Default)]
pub(crate) struct Documents<'a> {
    pub(crate) sources: Vec<Cow<'a, Source>>,
    pub(crate) nodes: Vec<Node>,
}

/// Reads a scenario's file and everything that it includes, each file once.
pub(super) fn documents<'a>(source: &'a Source, files: &dyn Files) -> Result<Documents<'a>, Vec<Finding>> {
    let root = node::parse(source).map_err(|finding| vec![finding])?;
    let mut documents = Documents { sources: vec![Cow::Borrowed(source)], nodes: vec![root] };
    let mut known = vec![String::new()];
    let mut findings = foreign_tags(source);
    let mut next = 0;
    while next < documents.nodes.len() {
        for (name, place) in includes(&documents.nodes[next], next) {
            if known.contains(&name) || known.len() > INCLUDES_MAX {
                continue;
            }
            match files.read(&name).and_then(|source| node::parse(&source).map(|node| (source, node))) {
                Ok((source, node)) => {
                    findings.extend(foreign_tags(&source));
                    known.push(name);
                    documents.sources.push(Cow::Owned(source));
                    documents.nodes.push(node);
                }
                Err(finding) if finding.code == Code::OutsideProject => {
                    let mut reader = Reader::default();
                    reader.add_named(place, finding);
                    findings.extend(locate(&documents.sources, reader.found));
                }
                Err(finding) if finding.code == Code::Unreadable => {
                    let mut reader = Reader::default();
                    let message = format!("cannot read `{}`: {}", shortened(&name), finding.message);
                    let hint = Some("the path counts from the folder of the scenario".to_owned());
                    reader.add(Code::Include, place, message, "a readable file", hint);
                    findings.extend(locate(&documents.sources, reader.found));
                }
                Err(finding) => findings.push(finding),
            }
        }
        next += 1;
    }
    if findings.is_empty() { Ok(documents) } else { Err(findings) }
}

/// The names under `include`; wrong kinds are found when the file is read.
fn includes(root: &Node, file: usize) -> Vec<(String, Place)> {
    let at = At::document(root, u16::try_from(file).unwrap_or(u16::MAX));
    let Node::Map(entries) = root else { return Vec::new() };
    let Some((_, node)) = entries.iter().find(|(key, _)| key == "include") else { return Vec::new() };
    let list = at.entry("include", 0, node);
    match node {
        Node::Text(name) => vec![(name.clone(), list.place())],
        Node::List(items) => {
            let named = items.iter().enumerate().filter_map(|(index, item)| match item {
                Node::Text(name) => Some((name.clone(), list.item(index, item).place())),
                _ => None,
            });
            named.collect()
        }
        _ => Vec::new(),
    }
}

/// Moves and roles by name, and where data files come from.
pub(crate) struct Library<'a> {
    pub(super) moves: HashMap<String, (u16, &'a Node)>,
    pub(super) roles: HashMap<String, Vec<Name>>,
    pub(super) files: &'a dyn Files,
    roster: Roster<'a>,
    used: RefCell<HashSet<String>>,
    /// Names of all moves, in order; made for the first finding that lists them.
    names: OnceCell<Vec<String>>,
}

impl<'a> Library<'a> {
    /// With the moves of all files; what is wrong with them is found by [`Self::include`] and [`Self::add`].
    pub(super) fn new(nodes: &'a [Node], files: &'a dyn Files, fleet: &'a Fleet) -> Self {
        let mut moves = HashMap::new();
        for (file, node) in (0u16..).zip(nodes) {
            let Node::Map(entries) = node else { continue };
            let named = entries.iter().filter(|(key, _)| key == "moves").filter_map(|(_, node)| match node {
                Node::Map(moves) => Some(moves),
                _ => None,
            });
            for (name, node) in named.flatten() {
                moves.entry(name.clone()).or_insert((file, node));
            }
        }
        let (roster, roles) = (Roster::new(fleet), HashMap::new());
        Self { moves, roles, files, roster, used: RefCell::default(), names: OnceCell::new() }
    }

    /// The robots that names stand for, as far as they are known.
    pub(super) fn robots(&self, names: &[Name]) -> Vec<usize> {
        self.roster.robots(&self.roles, names)
    }

    /// Takes an included file.
    pub(super) fn include(&mut self, reader: &mut Reader, node: &Node, file: u16) {
        let at = At::document(node, file);
        let Some([include, variables, moves, roles]) = reader.map(&at, "an included file", INCLUDE_KEYS, &[])
        else {
            return;
        };
        if let Some(at) = include {
            include_kind(reader, &at);
        }
        self.add_from(reader, [variables, moves, roles], file);
    }

    /// Takes what the scenario's own file holds.
    pub(super) fn add(&mut self, reader: &mut Reader, parts: [Option<At<'_>>; 3]) {
        self.add_from(reader, parts, 0);
    }

    fn add_from(&mut self, reader: &mut Reader, [variables, moves, roles]: [Option<At<'_>>; 3], file: u16) {
        if let Some(at) = variables {
            for (name, at) in reader.entries(&at, "variable to its value") {
                if let Some(value) = scalar(reader, &at) {
                    reader.scope.set(name, value);
                }
            }
        }
        if let Some(at) = moves {
            for (name, at) in reader.entries(&at, "move to its parameters and tracks") {
                if self.moves.get(name).is_some_and(|(known, _)| *known != file) {
                    twice(reader, &at, "move", name);
                }
            }
        }
        if let Some(at) = roles {
            for (name, at) in reader.entries(&at, "role to its robots") {
                let robots = super::cue::robot_names(reader, &at);
                if self.roles.insert(name.to_owned(), robots).is_some() {
                    twice(reader, &at, "role", name);
                }
            }
        }
    }

    /// The move of that name, with the file in which it stands.
    pub(super) fn get(&self, reader: &mut Reader, at: &At<'_>, name: &str) -> Option<(u16, &'a Node)> {
        let found = self.moves.get(name).copied();
        self.used.borrow_mut().insert(name.to_owned());
        if found.is_none() {
            let sorted = || {
                let mut names: Vec<_> = self.moves.keys().cloned().collect();
                names.sort_unstable();
                names
            };
            let known = || self.names.get_or_init(sorted).iter().map(String::as_str);
            let hint = reader.did_you_mean(name, known());
            let message = format!("no move `{}`", shortened(name));
            reader.add(Code::UnknownMove, at.place(), message, one_of(known()), hint);
        }
        found
    }
}

impl Library<'_> {
    /// Moves that no cue uses: their faults are found as well.
    pub(super) fn unused(&self) -> Vec<String> {
        let used = self.used.borrow();
        let mut unused: Vec<_> = self.moves.keys().filter(|name| !used.contains(*name)).cloned().collect();
        unused.sort_unstable();
        unused
    }
}

fn twice(reader: &mut Reader, at: &At<'_>, what: &str, name: &str) {
    let message = format!("the {what} `{}` is in two files", shortened(name));
    let hint = Some("rename one of them".to_owned());
    reader.add(Code::NameTwice, at.key_place(), message, format!("each {what} once"), hint);
}

fn include_kind(reader: &mut Reader, at: &At<'_>) {
    let expected = "the path of a file, or a list of them";
    match at.node {
        Node::List(_) => {
            for item in reader.list(at, expected) {
                reader.text(&item, expected);
            }
        }
        _ => drop(reader.text(at, expected)),
    }
}

/// A number, a text or a truth value.
pub(super) fn scalar(reader: &mut Reader, at: &At<'_>) -> Option<Node> {
    if is_spread(at.node) {
        return reader.spread(at).map(Node::Text);
    }
    match reader.defined(at)? {
        node @ (Node::Number(_) | Node::Text(_) | Node::Bool(_)) => Some(node),
        _ => {
            reader.wrong_type(at, "a number, a time or a word");
            None
        }
    }
}

/// Sets the tempo for what is read from now on.
pub(super) fn music(reader: &mut Reader, tempo: Option<At<'_>>, signature: Option<At<'_>>) {
    let beats_a_bar = signature.and_then(|at| read_signature(reader, &at)).unwrap_or(4);
    let Some(at) = tempo else { return };
    let sections = match at.node {
        Node::List(_) => tempo_list(reader, &at, beats_a_bar),
        _ => bpm(reader, &at)
            .map(|beats_a_minute| vec![Section { bar: 0, beats_a_minute, beats_a_bar }])
            .unwrap_or_default(),
    };
    if !sections.is_empty() {
        reader.music.tempo = Some(Arc::new(Tempo::new(&sections)));
    }
}

fn tempo_list(reader: &mut Reader, at: &At<'_>, mut beats_a_bar: u8) -> Vec<Section> {
    let mut sections: Vec<Section> = Vec::new();
    for item in reader.list(at, "a list of tempos such as {at: bar 1, bpm: 120}") {
        let known = ["at", "bpm", "signature"];
        let Some([place, tempo, signature]) = reader.map(&item, "a tempo", known, &["at", "bpm"]) else {
            continue;
        };
        beats_a_bar = signature.and_then(|at| read_signature(reader, &at)).unwrap_or(beats_a_bar);
        let bar = place.and_then(|at| whole_bar(reader, &at));
        let beats_a_minute = tempo.and_then(|at| bpm(reader, &at));
        let (Some(bar), Some(beats_a_minute)) = (bar, beats_a_minute) else { continue };
        let least = sections.last().map_or(0, |last| last.bar + 1);
        if bar < least || (sections.is_empty() && bar > 0) {
            let message = format!("a tempo at bar {}", bar + 1);
            let expected = match sections.is_empty() {
                true => "the first tempo at bar 1".to_owned(),
                false => format!("bar {} or later", least + 1),
            };
            let place = place.map_or_else(|| item.place(), |at| at.place());
            reader.add(Code::TimeOrder, place, message, expected, None);
            continue;
        }
        sections.push(Section { bar, beats_a_minute, beats_a_bar });
    }
    sections
}

fn whole_bar(reader: &mut Reader, at: &At<'_>) -> Option<u32> {
    let expected = "the beginning of a bar, such as `bar 9`";
    let text = reader.text(at, expected)?;
    let found = position(&text).filter(|(_, beat)| *beat == Fraction::ZERO).map(|(bar, _)| bar);
    if found.is_none() {
        let message = format!("`{}` is not the beginning of a bar", shortened(&text));
        reader.add(Code::BadDuration, at.place(), message, expected, None);
    }
    found
}

fn bpm(reader: &mut Reader, at: &At<'_>) -> Option<Fraction> {
    let expected = "beats a minute, from 1 to 10000";
    let value = reader.positive(at, expected)?;
    if (1.0..=10_000.0).contains(&value) {
        return Some(fraction(value));
    }
    reader.add(Code::WrongType, at.place(), format!("a tempo of {value}"), expected, None);
    None
}

/// `3/4`: the beats of a bar.
fn read_signature(reader: &mut Reader, at: &At<'_>) -> Option<u8> {
    let expected = "a time signature such as 3/4";
    let text = reader.text(at, expected)?;
    let parsed = text.split_once('/').and_then(|(beats, unit)| {
        let beats = beats.trim().parse::<u8>().ok().filter(|beats| *beats > 0)?;
        unit.trim().parse::<u8>().ok().filter(|unit| unit.is_power_of_two())?;
        Some(beats)
    });
    if parsed.is_none() {
        let message = format!("`{}` is not a time signature", shortened(&text));
        reader.add(Code::UnknownWord, at.place(), message, expected, None);
    }
    parsed
}
