//! Finds the line and column of each place that findings refer to by its path in the tree. The text is parsed a second time for this,
//! only if there is something to report. Content of an alias gets the position at which the alias is used.

mod defined;
mod repeated;
mod spelled;
mod uses;

use std::borrow::Borrow;
use std::collections::HashMap;

use saphyr_parser::Event;

use crate::composed::composed;
use crate::events::{Events, Extent};
use crate::finding::{Finding, PathStep, Pending, Place, Related, Within};
use crate::render::line_starts;
use crate::source::Source;

use spelled::offsets;

/// Maximum length, in bytes, of a source line that is copied into every finding in full.
const LINE_BYTES_MAX: usize = 500;
/// Maximum total number of bytes of source lines in the findings of one file. Beyond it, lines above [`LINE_BYTES_MAX`] are cut.
const LINES_BYTES_MAX: usize = 16 * 1024 * 1024;

/// Adds the line and column to every finding. Sorts the findings by file, and within a file by place.
pub fn locate<S: Borrow<Source>>(sources: &[S], mut pending: Vec<Pending>) -> Vec<Finding> {
    defined::relate(sources, &mut pending);
    let mut by_file: Vec<Vec<(Pending, String)>> = sources.iter().map(|_| Vec::new()).collect();
    let uses = uses::told(sources, &pending);
    for (finding, use_) in pending.into_iter().zip(uses) {
        if let Some(file) = by_file.get_mut(usize::from(finding.place.file)) {
            file.push((finding, use_));
        }
    }
    sources.iter().zip(by_file).flat_map(|(source, pending)| locate_in(source.borrow(), pending)).collect()
}

/// Returns the first and the last line of the node at each place, in the order of `places`.
pub fn lines_of<S: Borrow<Source>>(sources: &[S], places: &[&Place]) -> Vec<(usize, usize)> {
    let mut lines = vec![(1, 1); places.len()];
    for (file, source) in sources.iter().enumerate() {
        let of_file = || places.iter().enumerate().filter(|(_, place)| usize::from(place.file) == file);
        let mut wanted = Wanted::default();
        let nodes: Vec<usize> = of_file().map(|(_, place)| wanted.add(place)).collect();
        wanted.find(&source.borrow().text);
        for ((index, place), node) in of_file().zip(nodes) {
            let first = wanted.spot(node, place.key).line;
            lines[index] = (first, wanted.last_lines[node].max(first));
        }
    }
    lines
}

/// Adds the line and column to the findings of one file. Each finding is paired with a text about the uses through which its place was
/// read, which is appended to its message.
fn locate_in(source: &Source, pending: Vec<(Pending, String)>) -> Vec<Finding> {
    if pending.is_empty() {
        return Vec::new();
    }
    let mut wanted = Wanted::default();
    let (mut pending, uses): (Vec<Pending>, Vec<String>) = pending.into_iter().unzip();
    for finding in &mut pending {
        finding.related.retain(|(place, _)| place.file == finding.place.file);
    }
    let nodes: Vec<usize> = pending.iter().map(|p| wanted.add(&p.place)).collect();
    let related: Vec<Vec<usize>> =
        pending.iter().map(|p| p.related.iter().map(|(place, _)| wanted.add(place)).collect()).collect();
    wanted.find(&source.text);
    let lines = LineStarts::of(&source.text);
    let mut room = LINES_BYTES_MAX;
    let findings = pending.into_iter().zip(nodes).zip(related).map(|((pending, node), related)| {
        let place = lines.within(wanted.spot(node, pending.place.key));
        let place = match &pending.place.within {
            Some(within) => lines.part(&source.text, place, within),
            None => place,
        };
        let others = related.iter().zip(&pending.related).map(|(node, (place, message))| {
            related_place(source, &lines, lines.within(wanted.spot(*node, place.key)), message, &mut room)
        });
        let others = others.collect();
        finding(source, &lines, pending, place, others, &mut room)
    });
    let mut findings: Vec<_> = findings.zip(uses).collect();
    findings.sort_by_key(|(finding, _)| (finding.line, finding.column, finding.code));
    // A move that several cues use is read once per use, so its faults are found repeatedly. Only the first use is reported.
    findings.dedup_by(|(finding, _), (before, _)| finding == before);
    repeated::join(findings)
}

fn related_place(
    source: &Source,
    lines: &LineStarts,
    spot: Spot,
    message: &str,
    room: &mut usize,
) -> Related {
    Related {
        line: spot.line,
        column: spot.column,
        width: spot.width.max(1),
        message: message.to_owned(),
        source_line: carried(lines.line(&source.text, spot.line), room),
        is_repeat: false,
    }
}

/// Returns a source line for a finding. `room` is the number of bytes that remain for the lines of all findings; when it is exhausted,
/// long lines are cut.
fn carried(line: &str, room: &mut usize) -> String {
    if line.len() <= LINE_BYTES_MAX || line.len() <= *room {
        *room = room.saturating_sub(line.len());
        return line.to_owned();
    }
    let end = (0..=LINE_BYTES_MAX).rev().find(|end| line.is_char_boundary(*end)).unwrap_or(0);
    line[..end].to_owned()
}

fn finding(
    source: &Source,
    lines: &LineStarts,
    pending: Pending,
    spot: Spot,
    related: Vec<Related>,
    room: &mut usize,
) -> Finding {
    let line = lines.line(&source.text, spot.line);
    let is_block = !line.chars().nth(spot.column.saturating_sub(1)).is_some_and(|c| matches!(c, '[' | '{'));
    Finding {
        code: pending.code,
        severity: pending.code.severity(),
        file: source.name.clone(),
        line: spot.line,
        column: spot.column,
        width: spot.width.max(1),
        message: pending.message,
        expected: pending.expected,
        hint: pending.hint_in_block.filter(|_| is_block).or(pending.hint),
        source_line: carried(line, room),
        related,
    }
}

/// The byte offsets at which the lines of a text begin.
struct LineStarts(Vec<usize>);

impl LineStarts {
    fn of(text: &str) -> Self {
        Self(line_starts(text).collect())
    }

    /// Moves a position beyond the last line to the last line. The parser reports such positions for nodes at the end of the text, such
    /// as the value after a final `---`.
    fn within(&self, spot: Spot) -> Spot {
        if spot.line > self.0.len() { Spot { line: self.0.len(), column: 1, width: 1 } } else { spot }
    }

    /// Returns the position of `within`, a part of a YAML text that starts at `spot`. If something else is written there, such as an
    /// alias, returns `spot`.
    fn part(&self, text: &str, spot: Spot, within: &Within) -> Spot {
        let Some(&start) = spot.line.checked_sub(1).and_then(|index| self.0.get(index)) else { return spot };
        let ahead = self.line(text, spot.line).chars().take(spot.column.saturating_sub(1));
        let begin = start + ahead.map(char::len_utf8).sum::<usize>();
        let end = within.from + within.width;
        let Some((from, to)) = offsets(&text[begin..], &within.text, within.from, end) else { return spot };
        let (from, to) = (begin + from, begin + to);
        let line = self.0.partition_point(|start| *start <= from);
        let own = self.0.get(line.saturating_sub(1)).copied().unwrap_or(start);
        let end = to.min(own + self.line(text, line).len()).max(from);
        let count = |from: usize, to: usize| text.get(from..to).map_or(1, |part| part.chars().count());
        Spot { line, column: count(own, from) + 1, width: count(from, end).max(1) }
    }

    fn line<'a>(&self, text: &'a str, number: usize) -> &'a str {
        let Some(&start) = number.checked_sub(1).and_then(|index| self.0.get(index)) else { return "" };
        let end = self.0.get(number).copied().unwrap_or(text.len());
        text[start..end].trim_end_matches(['\r', '\n'])
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Spot {
    line: usize,
    column: usize,
    width: usize,
}

impl Spot {
    fn of(extent: Extent) -> Self {
        let Extent { start, end } = extent;
        let width = if start.0 == end.0 { end.1.saturating_sub(start.1) } else { 1 };
        Self { line: start.0, column: start.1 + 1, width }
    }
}

/// The paths whose positions are searched, as a tree. Node 0 is the root of the document.
struct Wanted {
    children: Vec<HashMap<PathStep, usize>>,
    parents: Vec<usize>,
    values: Vec<Option<Spot>>,
    keys: Vec<Option<Spot>>,
    /// For each node that is a list or map, its last line.
    last_lines: Vec<usize>,
}

impl Default for Wanted {
    fn default() -> Self {
        Self {
            children: vec![HashMap::new()],
            parents: vec![0],
            values: vec![None],
            keys: vec![None],
            last_lines: vec![0],
        }
    }
}

/// A list or map that is being read.
struct Frame {
    /// The node of [`Wanted`] that represents this list or map, if any.
    wanted: Option<usize>,
    map: bool,
    index: usize,
    /// `Some` between a key and its value. It contains the node of [`Wanted`] that represents the value, if any.
    pending: Option<Option<usize>>,
    seen: HashMap<String, usize>,
}

impl Wanted {
    fn add(&mut self, place: &Place) -> usize {
        let mut node = 0;
        for part in &place.path {
            // The encoding of names may differ from that in the file.
            let part = &match part {
                PathStep::Key(key, count) => PathStep::Key(composed(key).into_owned(), *count),
                PathStep::Index(index) => PathStep::Index(*index),
            };
            node = match self.children[node].get(part) {
                Some(&child) => child,
                None => {
                    let child = self.children.len();
                    self.children[node].insert(part.clone(), child);
                    self.children.push(HashMap::new());
                    self.parents.push(node);
                    self.values.push(None);
                    self.keys.push(None);
                    self.last_lines.push(0);
                    child
                }
            };
        }
        node
    }

    /// Returns the position of a node or of its key. A node within an alias or under a missing key has none; the position of its nearest
    /// ancestor with a position is returned then.
    fn spot(&self, node: usize, key: bool) -> Spot {
        let own =
            if key { self.keys[node].or(self.values[node]) } else { self.values[node].or(self.keys[node]) };
        match own {
            Some(spot) => spot,
            None if node == 0 => Spot { line: 1, column: 1, width: 1 },
            None => self.spot(self.parents[node], false),
        }
    }

    fn find(&mut self, text: &str) {
        let mut stack: Vec<Frame> = Vec::new();
        let mut last_line = 0;
        Events::of(text).each(|event, extent| {
            // A block has no end mark: the parser reports the place of the following token.
            if extent.start != extent.end {
                last_line = extent.end.0;
            }
            match event {
                Event::MappingStart(..) | Event::SequenceStart(..) => {
                    let wanted = self.arrive(&mut stack, None, extent);
                    let map = matches!(event, Event::MappingStart(..));
                    stack.push(Frame { wanted, map, index: 0, pending: None, seen: HashMap::new() });
                }
                Event::MappingEnd | Event::SequenceEnd => {
                    if let Some(node) = stack.pop().and_then(|frame| frame.wanted) {
                        self.last_lines[node] = last_line;
                    }
                }
                Event::Scalar(text, ..) => {
                    self.arrive(&mut stack, Some(&text), extent);
                }
                Event::Alias(_) => {
                    self.arrive(&mut stack, None, extent);
                }
                Event::DocumentEnd => return false,
                _ => {}
            }
            true
        });
    }

    /// Handles the start of a key or value of the innermost map, a list item, or the document. Returns the node of [`Wanted`] that
    /// represents it, if any; `None` for a key.
    fn arrive(&mut self, stack: &mut [Frame], text: Option<&str>, extent: Extent) -> Option<usize> {
        let Some(frame) = stack.last_mut() else {
            self.values[0] = Some(Spot::of(extent));
            return Some(0);
        };
        let node = match (frame.map, frame.pending.take()) {
            (true, None) => {
                let child = frame.wanted.and_then(|parent| self.child_of_key(parent, &mut frame.seen, text?));
                if let Some(child) = child {
                    self.keys[child] = Some(Spot::of(extent));
                }
                frame.pending = Some(child);
                return None;
            }
            (true, Some(child)) => child,
            (false, _) => {
                frame.index += 1;
                let part = PathStep::Index(frame.index - 1);
                frame.wanted.and_then(|parent| self.children[parent].get(&part).copied())
            }
        };
        if let Some(node) = node {
            self.values[node] = Some(Spot::of(extent));
        }
        node
    }

    fn child_of_key(&self, parent: usize, seen: &mut HashMap<String, usize>, key: &str) -> Option<usize> {
        let key = composed(key);
        let count = seen.entry(key.to_string()).or_default();
        let part = PathStep::Key(key.into_owned(), *count);
        *count += 1;
        self.children[parent].get(&part).copied()
    }
}
