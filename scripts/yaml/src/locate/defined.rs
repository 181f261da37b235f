//! Finds the definitions of the variables that are used at the place of a finding, because the user has to edit these definitions.

use std::borrow::Borrow;

use super::{LineStarts, Wanted};
use crate::finding::{Code, PathStep, Pending, Place};
use crate::source::Source;

/// Maximum number of definitions that one finding shows.
const SHOWN_MAX: usize = 2;

/// Adds related places to each finding about a value: the definitions of the variables in that value.
pub(super) fn relate<S: Borrow<Source>>(sources: &[S], pending: &mut [Pending]) {
    let mut named: Vec<(usize, Vec<String>)> = Vec::new();
    for (file, source) in sources.iter().enumerate() {
        let text = &source.borrow().text;
        let is_here = |found: &Pending| usize::from(found.place.file) == file && is_about_value(found);
        if text.contains('$') && pending.iter().any(is_here) {
            let here = pending.iter().enumerate().filter(|(_, found)| is_here(found));
            named.extend(variables(text, here.map(|(index, found)| (index, &found.place))));
        }
    }
    let wanted: Vec<Place> = named
        .iter()
        .flat_map(|(index, names)| candidates(&pending[*index].place, names, sources.len()))
        .collect();
    let mut is_there = existing(sources, &wanted).into_iter();
    for (index, names) in named {
        let found = &mut pending[index];
        // If an expression cannot be evaluated, the expression itself has to be edited.
        let is_alone = names.len() == 1
            && found.place.within.as_ref().is_none_or(|part| *part.text == *format!("${}", names[0]));
        let mut definitions: Vec<(Place, String)> = Vec::new();
        for name in &names {
            let places = candidates(&found.place, std::slice::from_ref(name), sources.len());
            let there: Vec<bool> = is_there.by_ref().take(places.len()).collect();
            let first = places.into_iter().zip(there).find(|(_, is_there)| *is_there);
            definitions.extend(first.map(|(place, _)| (place, format!("`{name}` is defined here"))));
        }
        if !definitions.is_empty() && (is_alone || found.code != Code::Expression) {
            found.related = vec![(found.place.clone(), format!("expected {}", found.expected))];
            found.related.extend(definitions.into_iter().take(SHOWN_MAX));
        }
    }
}

/// Whether the finding is about a value, so that a different value would resolve it.
fn is_about_value(found: &Pending) -> bool {
    let is_value = matches!(
        found.code,
        Code::WrongType
            | Code::BadDuration
            | Code::UnknownRobot
            | Code::UnknownDevice
            | Code::OutOfRange
            | Code::OffGranularity
            | Code::UnknownWord
            | Code::UnknownMove
            | Code::Snapped
            | Code::Expression
            | Code::WrongKind
    );
    is_value && found.related.is_empty() && !found.place.key
}

/// Returns, for each of the given places in one file, its index and the names of the variables that are used there. Places without
/// variables are left out.
fn variables<'p>(text: &str, places: impl Iterator<Item = (usize, &'p Place)>) -> Vec<(usize, Vec<String>)> {
    let mut wanted = Wanted::default();
    let places: Vec<(usize, usize)> = places.map(|(index, place)| (index, wanted.add(place))).collect();
    wanted.find(text);
    let lines = LineStarts::of(text);
    let names = |(index, node): (usize, usize)| {
        let spot = wanted.values[node]?;
        let written: String = lines
            .line(text, spot.line)
            .chars()
            .skip(spot.column.saturating_sub(1))
            .take(spot.width)
            .collect();
        let is_part = |c: char| c.is_alphanumeric() || c == '_';
        let mut names: Vec<String> = Vec::new();
        for rest in written.split('$').skip(1) {
            let name: String = rest.chars().take_while(|c| is_part(*c)).collect();
            if !name.is_empty() && !names.contains(&name) {
                names.push(name);
            }
        }
        (!names.is_empty()).then_some((index, names))
    };
    places.into_iter().filter_map(names).collect()
}

/// Returns the places at which each variable may be defined, in order of precedence.
fn candidates(used: &Place, names: &[String], files: usize) -> Vec<Place> {
    let own = match used.path.as_slice() {
        [PathStep::Key(kind, _), PathStep::Key(name, _), ..] if kind == "moves" || kind == "sequences" => {
            Some([kind, name])
        }
        _ => None,
    };
    let of_file = |file: u16| Place { file, ..Place::default() };
    let others = (0u16..).take(files).filter(|file| *file != used.file);
    names
        .iter()
        .flat_map(|name| {
            let root = of_file(used.file);
            let inner =
                own.map(|[kind, outer]| root.of_key(kind).of_key(outer).of_key("parameters").of_key(name));
            let in_file = ["variables", "parameters"].map(|key| root.of_key(key).of_key(name));
            let elsewhere = others.clone().map(|file| of_file(file).of_key("variables").of_key(name));
            inner.into_iter().chain(in_file).chain(elsewhere).collect::<Vec<_>>()
        })
        .collect()
}

/// Returns, for each place, whether it exists and has a value other than null.
fn existing<S: Borrow<Source>>(sources: &[S], places: &[Place]) -> Vec<bool> {
    let mut existing = vec![false; places.len()];
    for (file, source) in sources.iter().enumerate() {
        let here = || places.iter().enumerate().filter(|(_, place)| usize::from(place.file) == file);
        if here().next().is_none() {
            continue;
        }
        let mut wanted = Wanted::default();
        let nodes: Vec<usize> = here().map(|(_, place)| wanted.add(place)).collect();
        let text = &source.borrow().text;
        wanted.find(text);
        let lines = LineStarts::of(text);
        for ((index, _), node) in here().zip(nodes) {
            existing[index] = wanted.values[node].is_some_and(|spot| {
                let line = lines.line(text, spot.line).chars();
                let value: String = line.skip(spot.column.saturating_sub(1)).take(spot.width).collect();
                !matches!(value.as_str(), "" | "~" | "null")
            });
        }
    }
    existing
}
