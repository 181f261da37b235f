//! Hover: documentation of keys, descriptions of items, and the solved times and the steps of cues.

use std::path::Path;
use std::rc::Rc;

use downbeat_reader::keys::{Item, Naming};
use downbeat_scripts::{Act, Choreography, DeviceUse, Fleet, PlannedCue, WrittenCue};
use urrcp::{RobotId, Span};

use crate::about;
use crate::check::Placed;
use crate::file::File;
use crate::names::definitions;
use crate::workspace::Workspace;

/// Maximum number of devices whose movements are shown for a cue.
const DEVICES_MAX: usize = 8;
/// Number of characters of a curve.
const WIDTH: usize = 24;
/// Characters for the values of a curve, from the least to the largest.
const LEVELS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// A compiled scenario with the places of its cues.
#[derive(Clone, Debug)]
pub(crate) struct Compiled {
    pub(crate) choreography: Rc<Choreography>,
    pub(crate) placed: Rc<Placed>,
}

/// A cue of a compiled scenario.
#[derive(Clone, Copy)]
pub(crate) struct Solved<'c> {
    pub(crate) act: &'c Act,
    pub(crate) cue: &'c PlannedCue,
    pub(crate) written: &'c WrittenCue,
}

impl Compiled {
    /// Returns the cues that are written in a file, in the order of the scenario. A cue of a sequence occurs once for each playing.
    pub(crate) fn cues_in<'c>(&'c self, path: &'c Path) -> impl Iterator<Item = Solved<'c>> {
        let outline = &self.placed.outline;
        let is_here = move |written: &WrittenCue| {
            let source = outline.sources.get(written.source);
            source.is_some_and(|source| same_file(Path::new(&source.name), path))
        };
        let acts = self.choreography.acts.iter().zip(&outline.acts);
        let cues = acts.flat_map(|(act, written)| {
            act.cues.iter().zip(&written.cues).map(move |(cue, written)| Solved { act, cue, written })
        });
        cues.filter(move |solved| is_here(solved.written))
    }
}

fn same_file(one: &Path, other: &Path) -> bool {
    one == other || one.file_name() == other.file_name() && one.canonicalize().is_ok_and(|one| one == other)
}

/// Returns the text about the byte of a file, in Markdown.
pub(crate) fn hover(
    workspace: &Workspace,
    compiled: Option<&Compiled>,
    fleet: Option<&Fleet>,
    file: &Rc<File>,
    byte: usize,
) -> Option<String> {
    if let Some(mention) = file.mention_at(byte) {
        if mention.naming == Naming::Defines(Item::Cue)
            && let Some(text) = compiled.and_then(|compiled| of_cue(compiled, file, byte))
        {
            return Some(text);
        }
        let sites = definitions(workspace, file, mention);
        if mention.naming == Naming::Uses(Item::Cue)
            && let (Some(site), Some(compiled)) = (sites.first(), compiled)
            && let Some(text) = of_cue(compiled, &site.file, site.span().start)
        {
            return Some(text);
        }
        let about = sites.iter().find_map(|site| about::summary(site, fleet));
        let kind = format!("{:?}", mention.naming.item()).to_lowercase();
        return about.map(|about| format!("{kind} `{}`: {about}", mention.name));
    }
    of_key(file, byte)
}

fn of_key(file: &File, byte: usize) -> Option<String> {
    let node = file.node_at(byte)?;
    let map = file.tree.nodes[node].parent?;
    let key = file
        .tree
        .entries(map)
        .iter()
        .find(|entry| entry.key == node)
        .and_then(|entry| file.tree.scalar(entry.key))?;
    let declared = match map {
        0 => file.content.keys(),
        _ => file.typed.kinds.get(map)?.iter().find_map(|typing| {
            typing.declared().filter(|map| map.keys.iter().any(|known| known.name == key))
        }),
    };
    let known = declared?.keys.iter().find(|known| known.name == key)?;
    Some(format!("`{key}`: {}", about::key(known)))
}

/// Describes the cue at a byte: its times, and the movements of its devices.
fn of_cue(compiled: &Compiled, file: &File, byte: usize) -> Option<String> {
    let line = file.text.line_of(byte) + 1;
    let here = compiled
        .cues_in(&file.path)
        .filter(|solved| (solved.written.first_line..=solved.written.last_line).contains(&line));
    let all: Vec<Solved<'_>> = here.collect();
    let first = all.iter().min_by_key(|solved| solved.written.last_line - solved.written.first_line)?;
    let mut text = times(first.cue);
    let again = all.iter().filter(|solved| solved.written.first_line == first.written.first_line).count() - 1;
    if again > 0 {
        text.push_str(&format!("\n\nIt is played {} times; these are the values of the first.", again + 1));
    }
    let rows: Vec<String> = first.written.robots.iter().flat_map(|robot| rows(first, robot)).collect();
    if !rows.is_empty() {
        text.push_str("\n\n| device | movement | steps in the act | largest error |\n|---|---|---|---|\n");
        rows.iter().take(DEVICES_MAX).for_each(|row| text.push_str(row));
    }
    if rows.len() > DEVICES_MAX {
        text.push_str(&format!("\n{} more devices", rows.len() - DEVICES_MAX));
    }
    Some(text)
}

fn times(cue: &PlannedCue) -> String {
    let PlannedCue { name, start, end, slack, critical, .. } = cue;
    let room = match (*slack, critical) {
        (Span::ZERO, true) => ", on the critical path".to_owned(),
        (Span::ZERO, false) => String::new(),
        (slack, _) => format!(", may start {slack} later"),
    };
    format!("cue `{name}`: from {start} to {end} ({}){room}", *end - *start)
}

/// Returns the rows of a table for the devices that a robot moves during a cue.
fn rows(solved: &Solved<'_>, robot: &RobotId) -> Vec<String> {
    let devices = solved.act.devices.iter().filter(|used| used.robot == *robot);
    let row = |used: &DeviceUse| {
        let curve = curve(solved, used)?;
        let DeviceUse { robot, device, steps, budget, worst_error, .. } = used;
        let error = (worst_error * 1e6).round() / 1e6;
        Some(format!("| {robot}/{device} | {curve} | {steps} of {budget} | {error} |\n"))
    };
    devices.filter_map(row).collect()
}

/// Draws the values of a device during a cue. `None` if it does not move then.
fn curve(solved: &Solved<'_>, used: &DeviceUse) -> Option<String> {
    let plan = solved.act.plan.robots.iter().find(|plan| plan.robot == used.robot)?;
    let mut points: Vec<Point> = Vec::new();
    for script in plan.scripts.iter().filter(|script| script.device == used.device) {
        let begin = solved.act.moves_at(&used.robot, script).as_millis_f64();
        points.extend(script.script.steps().iter().map(|step| Point {
            at: begin + step.offset.span().as_millis_f64(),
            value: step.setpoint.value,
        }));
    }
    let (start, end) = (solved.cue.start.as_millis_f64(), solved.cue.end.as_millis_f64());
    if !points.iter().any(|point| point.at >= start && point.at <= end) || end <= start {
        return None;
    }
    let at = |index: usize| start + (end - start) * fraction(index, WIDTH - 1);
    let values: Vec<f64> = (0..WIDTH).filter_map(|index| value_at(&points, at(index))).collect();
    Some(drawn(&values))
}

/// A value at an instant in milliseconds.
#[derive(Clone, Copy, Debug)]
struct Point {
    at: f64,
    value: f64,
}

#[expect(clippy::cast_precision_loss, reason = "small numbers")]
fn fraction(part: usize, whole: usize) -> f64 {
    part as f64 / whole as f64
}

/// Returns the value between the points around an instant.
fn value_at(points: &[Point], at: f64) -> Option<f64> {
    let next = points.partition_point(|point| point.at <= at);
    let before = next.checked_sub(1).and_then(|index| points.get(index));
    match (before, points.get(next)) {
        (Some(one), Some(other)) if other.at > one.at => {
            Some(one.value + (other.value - one.value) * (at - one.at) / (other.at - one.at))
        }
        (one, other) => one.or(other).map(|point| point.value),
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a level from 0 to 7")]
fn drawn(values: &[f64]) -> String {
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let level =
        |value: f64| if most > least { ((value - least) / (most - least) * 7.0).round() as usize } else { 0 };
    let curve: String = values.iter().map(|value| LEVELS[level(*value).min(7)]).collect();
    let short = |value: f64| (value * 100.0).round() / 100.0;
    format!("{curve} {} to {}", short(least), short(most))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_show_the_least_and_the_largest_value() {
        assert_eq!(drawn(&[0.0, 3.5, 7.0]), "▁▅█ 0 to 7");
        assert_eq!(drawn(&[2.0, 2.0]), "▁▁ 2 to 2");
        let points = [Point { at: 0.0, value: 1.0 }, Point { at: 10.0, value: 3.0 }];
        assert_eq!(value_at(&points, 5.0), Some(2.0));
        assert_eq!(value_at(&points, 20.0), Some(3.0));
    }
}
