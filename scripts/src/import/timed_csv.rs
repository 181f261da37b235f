//! Any CSV with a column of times: which column moves what is said by the user.

use std::collections::HashSet;

use urrcp::Span;

use crate::finding::Code;
use crate::node::shortened;
use crate::source::Source;

use super::columns::Header;
use super::input::Input;
use super::moments::{self, Said, TimeUnit, UNITS};
use super::sink::Sink;
use super::table::{Row, rows, separator_of};
use super::{Course, DeviceMotion, ImportOptions, Keyframe, Motion, by_robot, keyframes};

/// Columns that move a device.
struct Mapped {
    robot: String,
    motion: DeviceMotion,
    indices: Vec<usize>,
    empty: usize,
    /// Lines that repeat what is held anyway.
    same: usize,
}

/// Where the times stand, and what they mean.
struct TimeColumn {
    index: usize,
    unit: TimeUnit,
}

/// Reads one file: all mapped robots in one scene.
pub(super) fn read(input: &Input, source: &Source, options: &ImportOptions, sink: &mut Sink) -> Vec<Motion> {
    let mut rows = rows(source, separator_of(source)).peekable();
    let Some(first) = rows.peek().cloned() else {
        let expected = "a header and a line a time";
        sink.about(&source.name, Code::ImportTable, "the file is empty".into(), expected, None);
        return Vec::new();
    };
    let header = Header::new(first);
    if header.named {
        rows.next();
    }
    let Some((time, mut mapped)) = columns(&header, input, options, source, sink) else { return Vec::new() };
    let found = sink.findings.len();
    let mut before = None;
    for mut row in rows {
        row.drop_trailing(header.width);
        read_row(&row, header.width, &time, &mut before, &mut mapped, source, sink);
        let keyframes =
            mapped.iter().map(|mapped| mapped.motion.keyframes.len() * mapped.indices.len()).sum::<usize>();
        if sink.is_full(source) || !sink.has_room_for(keyframes as f64) {
            break;
        }
    }
    if before.is_none() && sink.findings.len() == found {
        sink.about(
            &source.name,
            Code::NothingToDo,
            "the file has no lines of values".into(),
            "a line a time",
            None,
        );
    }
    motions(input, mapped, source, sink)
}

fn columns(
    header: &Header<'_>,
    input: &Input,
    options: &ImportOptions,
    source: &Source,
    sink: &mut Sink,
) -> Option<(TimeColumn, Vec<Mapped>)> {
    let index = header.index(options.time_column.as_deref().unwrap_or("t"), source, sink);
    let unit = index.and_then(|index| time_unit(header, index, options, source, sink));
    let mut mapped: Vec<Mapped> = Vec::new();
    let mut complete = true;
    let mut used: HashSet<usize> = index.into_iter().collect();
    let time = used.clone();
    // What stands for every column is left those that others name.
    let (every, others): (Vec<_>, Vec<_>) = options.columns.iter().partition(|(_, columns)| columns == "*");
    for (to, columns) in others.into_iter().chain(every) {
        let taken = if columns == "*" { &used } else { &time };
        let chosen = header.choose(to, columns, taken, source, sink);
        complete &= chosen.is_some();
        for chosen in chosen.into_iter().flatten() {
            used.extend(&chosen.indices);
            let (robot, device) = chosen.target.split_once('/').unwrap_or((&input.robot, &chosen.target));
            let held = |name: &String| *name == device || *name == format!("{robot}/{device}");
            let course = match chosen.indices.len() {
                1 if options.holds.iter().any(held) => Course::Held,
                1 => Course::Straight,
                _ => Course::Several(Vec::new()),
            };
            let unit = header.unit(chosen.indices[0]).to_owned();
            let motion = DeviceMotion { device: device.to_owned(), unit, course, keyframes: Vec::new() };
            mapped.push(Mapped {
                robot: robot.to_owned(),
                motion,
                indices: chosen.indices,
                empty: 0,
                same: 0,
            });
        }
    }
    let (index, unit) = (index?, unit?);
    if !complete || mapped.is_empty() {
        return None;
    }
    header.note_unused(&used, source, sink);
    Some((TimeColumn { index, unit }, mapped))
}

/// What the times mean: as the user says, else as the header says, else as the times show by themselves. Never a guess.
fn time_unit(
    header: &Header<'_>,
    index: usize,
    options: &ImportOptions,
    source: &Source,
    sink: &mut Sink,
) -> Option<TimeUnit> {
    let said = moments::said_by(header.text(index));
    if let Some(unit) = options.time_unit {
        if matches!(said, Said::Unit(other) if other != unit) {
            let column = shortened(header.text(index));
            sink.note(format!(
                "{}: --time-unit is taken, though the column is named `{column}`",
                source.name
            ));
        }
        return Some(unit);
    }
    let skipped = usize::from(header.named);
    let time = |row: Row<'_>| row.cells.get(index).map(|cell| cell.text.clone().into_owned());
    let times =
        || rows(source, separator_of(source)).skip(skipped).filter_map(time).filter(|text| !text.is_empty());
    let clock = times().next().is_some_and(|text| text.contains(':'));
    if clock {
        let texts: Vec<String> = times().collect();
        let fitting = moments::clocks(texts.iter().map(String::as_str));
        return match fitting.as_slice() {
            [(_, one)] => Some(*one),
            // Which line is wrong is found when it is read.
            [] => moments::clocks(texts.first().map(String::as_str).into_iter())
                .first()
                .map(|(_, unit)| *unit)
                .or_else(|| {
                    unclear(header, index, "the times can be read in no way", source, sink);
                    None
                }),
            several => {
                let words: Vec<_> = several.iter().map(|(word, _)| *word).collect();
                let message = format!("the times may be {}", words.join(" or "));
                unclear(header, index, &message, source, sink);
                None
            }
        };
    }
    match said {
        Said::Unit(unit) => return Some(unit),
        Said::Unclear => unclear(header, index, "the unit of the times is not known", source, sink),
        Said::Nothing => unclear(header, index, "nothing says in which unit the times are", source, sink),
    }
    None
}

fn unclear(header: &Header<'_>, index: usize, message: &str, source: &Source, sink: &mut Sink) {
    let hint = Some("say it with --time-unit, such as --time-unit s");
    let expected = format!("{UNITS}, in the name of the column or by --time-unit");
    sink.found(source, header.row.spot(index), Code::ImportTime, message, expected, hint);
}

fn read_row(
    row: &Row<'_>,
    width: usize,
    time: &TimeColumn,
    before: &mut Option<Span>,
    mapped: &mut [Mapped],
    source: &Source,
    sink: &mut Sink,
) {
    if !row.has(width, source, sink) {
        return;
    }
    let at = seconds(row, time, source, sink)
        .and_then(|at_s| checked_time(row, time.index, at_s, before, source, sink));
    for column in mapped {
        if column.indices.iter().all(|index| row.cells[*index].text.is_empty()) {
            column.empty += 1;
            continue;
        }
        let what = format!("`{}` of `{}`", column.motion.device, column.robot);
        let values: Vec<_> =
            column.indices.iter().map(|index| row.number(*index, &what, source, sink)).collect();
        let values: Option<Vec<f64>> = values.into_iter().map(|value| Some(value? + 0.0)).collect();
        if let (Some(at), Some(values)) = (at, values) {
            column.add(at, values);
        }
    }
}

impl Mapped {
    fn add(&mut self, at: Span, values: Vec<f64>) {
        self.motion.keyframes.push(Keyframe { at, value: values[0] });
        if let Course::Several(all) = &mut self.motion.course {
            all.push(values);
        }
    }
}

fn seconds(row: &Row<'_>, time: &TimeColumn, source: &Source, sink: &mut Sink) -> Option<f64> {
    let text = row.cells[time.index].text.as_ref();
    if let TimeUnit::Seconds(size) = time.unit {
        return row.number(time.index, "the time", source, sink).map(|at| at * size);
    }
    let seconds = time.unit.seconds(text);
    if seconds.is_none() {
        let message = format!("the time is `{}`", shortened(text));
        let expected = "a time like those before";
        sink.found(source, row.spot(time.index), Code::ImportNumber, message, expected, None);
    }
    seconds
}

fn checked_time(
    row: &Row<'_>,
    index: usize,
    at_s: f64,
    before: &mut Option<Span>,
    source: &Source,
    sink: &mut Sink,
) -> Option<Span> {
    let Some(at) = keyframes::span(at_s) else {
        let expected = format!("a time from 0 to {} s", keyframes::SECONDS_MAX);
        sink.found(
            source,
            row.spot(index),
            Code::ImportTime,
            format!("the time is {at_s} s"),
            expected,
            None,
        );
        return None;
    };
    if let Some((code, message, hint)) = before.and_then(|before| keyframes::check_later(before, at)) {
        let expected = format!("a time after {} s", before.map_or(0.0, keyframes::seconds));
        sink.found(source, row.spot(index), code, message, expected, Some(hint));
        return None;
    }
    *before = Some(at);
    Some(at)
}

fn motions(input: &Input, mut mapped: Vec<Mapped>, source: &Source, sink: &mut Sink) -> Vec<Motion> {
    for column in &mut mapped {
        column.same = column.motion.thin();
        column.note(source, sink);
    }
    by_robot(&input.scene, mapped.into_iter().map(|mapped| (mapped.robot, mapped.motion)))
}

impl Mapped {
    /// Says what of it is not as it is in the file.
    fn note(&self, source: &Source, sink: &mut Sink) {
        let Self { robot, motion, empty, same, .. } = self;
        let device = &motion.device;
        if motion.keyframes.is_empty() && sink.findings.is_empty() {
            let message = format!("the column of `{device}` of `{robot}` is empty");
            sink.about(&source.name, Code::NothingToDo, message, "at least one value", None);
        } else if *empty > 0 {
            let cells = crate::counted(*empty, "empty cell");
            let how = if motion.course == Course::Straight { "moves straight" } else { "stays as it is" };
            sink.note(format!("{}: `{device}` of `{robot}` {how} through {cells}", source.name));
        }
        if *same > 0 {
            let lines = crate::counted(*same, "line");
            sink.note(format!(
                "{}: `{device}` of `{robot}` does not change in {lines}: left out",
                source.name
            ));
        }
    }
}
