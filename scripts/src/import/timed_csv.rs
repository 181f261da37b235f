//! Any CSV with a column of times: which column moves what is said by the user.

use crate::finding::{Code, did_you_mean, names};
use crate::node::shortened;
use crate::source::Source;

use super::input::Input;
use super::sink::Sink;
use super::table::{Row, rows, separator_of};
use super::units::{self, name_and_unit};
use super::{DeviceMotion, ImportOptions, Keyframe, Motion, RobotMotion, keyframes};

/// A column that moves a device.
struct Mapped {
    robot: String,
    motion: DeviceMotion,
    index: usize,
    empty: usize,
}

/// Where the times stand, and what turns them into seconds.
struct TimeColumn {
    index: usize,
    factor: f64,
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
    let Some((time, mut mapped)) = header.columns(options, source, sink) else { return Vec::new() };
    let found = sink.findings.len();
    let mut before = None;
    for mut row in rows {
        row.drop_trailing(header.width);
        read_row(&row, header.width, &time, &mut before, &mut mapped, source, sink);
        if sink.is_full(source) {
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

struct Header<'a> {
    row: Row<'a>,
    /// Whether it names the columns; otherwise it is a line of values already.
    named: bool,
    width: usize,
}

impl<'a> Header<'a> {
    fn new(mut row: Row<'a>) -> Self {
        let named = row.cells.iter().any(|cell| cell.text.parse::<f64>().is_err() && !cell.text.is_empty());
        row.drop_trailing(row.cells.len().saturating_sub(1));
        let width = row.cells.len();
        Self { row, named, width }
    }

    fn columns(
        &self,
        options: &ImportOptions,
        source: &Source,
        sink: &mut Sink,
    ) -> Option<(TimeColumn, Vec<Mapped>)> {
        let time = options.time_column.as_deref().unwrap_or("t");
        let time = self.index(time, source, sink).map(|index| {
            let factor = units::factor(self.unit(index), "s").unwrap_or(1.0);
            TimeColumn { index, factor }
        });
        let mut mapped = Vec::new();
        for (to, column) in &options.columns {
            let index = self.index(column, source, sink);
            let (robot, device) = to.split_once('/').unwrap_or(("robot", to));
            mapped.extend(index.map(|index| {
                let unit = self.unit(index).to_owned();
                let motion = DeviceMotion { device: device.to_owned(), unit, keyframes: Vec::new() };
                Mapped { robot: robot.to_owned(), motion, index, empty: 0 }
            }));
        }
        let complete = mapped.len() == options.columns.len();
        time.filter(|_| complete && !mapped.is_empty()).map(|time| (time, mapped))
    }

    fn unit(&self, index: usize) -> &str {
        if self.named { name_and_unit(&self.row.cells[index].text).1 } else { "" }
    }

    /// A column by its name, with or without its unit, or by its number from 1.
    fn index(&self, column: &str, source: &Source, sink: &mut Sink) -> Option<usize> {
        let texts = || self.row.cells.iter().map(|cell| cell.text.as_ref());
        let by_name = |text: &str| text == column || name_and_unit(text).0 == column;
        let mut found = texts().enumerate().filter(|(_, text)| self.named && by_name(text));
        let number = column.parse::<usize>().ok().filter(|number| (1..=self.width).contains(number));
        match (found.next(), found.next()) {
            (Some((index, _)), None) => Some(index),
            (None, _) if number.is_some() => number.map(|number| number - 1),
            (Some(_), Some((second, _))) => {
                let message = format!("two columns are named `{}`", shortened(column));
                let hint = Some("say the number of the column, from 1");
                let expected = "each name once";
                sink.found(source, self.row.spot(second), Code::ImportTable, message, expected, hint);
                None
            }
            (None, _) => {
                let message = format!("no column `{}`", shortened(column));
                let expected = match self.named {
                    true => format!("one of {}, or a number from 1 to {}", names(texts()), self.width),
                    false => format!("a number from 1 to {}: the file has no header", self.width),
                };
                let hint = did_you_mean(column, texts());
                sink.found(source, self.row.spot(0), Code::ImportTable, message, expected, hint.as_deref());
                None
            }
        }
    }
}

fn read_row(
    row: &Row<'_>,
    width: usize,
    time: &TimeColumn,
    before: &mut Option<f64>,
    mapped: &mut [Mapped],
    source: &Source,
    sink: &mut Sink,
) {
    if !row.has(width, source, sink) {
        return;
    }
    let at_s = row.number(time.index, "the time", source, sink).map(|at| at * time.factor);
    let at_ms = at_s.and_then(|at_s| checked_time(row, time.index, at_s, before, source, sink));
    for column in mapped {
        if row.cells[column.index].text.is_empty() {
            column.empty += 1;
            continue;
        }
        let what = format!("`{}` of `{}`", column.motion.device, column.robot);
        let value = row.number(column.index, &what, source, sink);
        if let (Some(at_ms), Some(value)) = (at_ms, value) {
            column.motion.keyframes.push(Keyframe { at_ms, value: value + 0.0 });
        }
    }
}

fn checked_time(
    row: &Row<'_>,
    index: usize,
    at_s: f64,
    before: &mut Option<f64>,
    source: &Source,
    sink: &mut Sink,
) -> Option<u64> {
    let Some(at_ms) = keyframes::millis(at_s) else {
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
    if let Some((code, message, hint)) = before.and_then(|before| keyframes::check_later(before, at_s)) {
        let expected = format!("a time after {} s", before.unwrap_or(0.0));
        sink.found(source, row.spot(index), code, message, expected, Some(hint));
        return None;
    }
    *before = Some(at_s);
    Some(at_ms)
}

fn motions(input: &Input, mapped: Vec<Mapped>, source: &Source, sink: &mut Sink) -> Vec<Motion> {
    let mut motions: Vec<Motion> = Vec::new();
    for column in mapped {
        let Mapped { robot, motion, empty, .. } = column;
        if motion.keyframes.is_empty() && sink.findings.is_empty() {
            let message = format!("the column of `{}` of `{robot}` is empty", motion.device);
            sink.about(&source.name, Code::NothingToDo, message, "at least one value", None);
        } else if empty > 0 {
            let device = &motion.device;
            let cells = crate::counted(empty, "empty cell");
            sink.note(format!("{}: `{device}` of `{robot}` moves straight through {cells}", source.name));
        }
        match motions.iter_mut().find(|known| known.robot.robot == robot) {
            Some(known) => known.robot.devices.push(motion),
            None => {
                let robot = RobotMotion { robot, devices: vec![motion] };
                motions.push(Motion { scene: input.scene.clone(), robot });
            }
        }
    }
    motions
}
