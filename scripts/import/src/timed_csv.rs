//! Reads any CSV with a column of times. The user assigns columns to devices.

use std::collections::HashSet;

use urrcp::Span;

use downbeat_yaml::finding::Code;
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;

use super::columns::Header;
use super::dialect::{self, Decimal, Dialect};
use super::input::Input;
use super::moments::{self, Said, TimeUnit, UNITS};
use super::sink::Sink;
use super::table::{Row, rows};
use super::{Course, DeviceMotion, ImportOptions, Keyframe, Motion, by_robot, keyframes};

/// A device of a robot, and the columns that move it.
struct Mapped {
    robot: String,
    motion: DeviceMotion,
    indices: Vec<usize>,
    empty: usize,
    /// Number of lines that are left out because the value of the device does not change.
    same: usize,
}

/// The column of times, and the unit of its values.
struct TimeColumn {
    index: usize,
    unit: TimeUnit,
}

/// A table with its header and the options of the user.
#[derive(Clone, Copy)]
struct Table<'a> {
    source: &'a Source,
    dialect: Dialect,
    header: &'a Header<'a>,
    options: &'a ImportOptions,
}

/// Reads one file. Returns the motions of all robots to whose devices columns are assigned, as one scene.
pub(super) fn read(input: &Input, source: &Source, options: &ImportOptions, sink: &mut Sink) -> Vec<Motion> {
    let dialect = Dialect::of(source, options.skip, options.decimal);
    let mut rows = rows(source, dialect).peekable();
    let Some(first) = rows.peek().cloned() else {
        let expected = "a header line, and one line for each time";
        sink.about(&source.name, Code::ImportTable, "the file is empty".into(), expected, None);
        return Vec::new();
    };
    let header = Header::new(first);
    if header.named {
        rows.next();
    }
    let table = Table { source, dialect, header: &header, options };
    if begins_with_title(&table, sink) {
        return Vec::new();
    }
    let Some((time, mut mapped)) = columns(&table, input, sink) else { return Vec::new() };
    if dialect.decimal == Some(Decimal::Comma) && options.decimal.is_none() {
        sink.note(format!("{}: commas in numbers are read as decimal commas", source.name));
    }
    let found = sink.findings.len();
    let mut clock = Clock { time, first: None, last: None };
    for mut row in rows {
        row.drop_trailing(header.width);
        if row.has(header.width, source, sink) {
            let at = clock.read(&row, source, sink);
            read_row(&row, at, &mut mapped, source, sink);
        }
        let keyframes =
            mapped.iter().map(|mapped| mapped.motion.keyframes.len() * mapped.indices.len()).sum::<usize>();
        if sink.is_full(source) || !sink.has_room_for(keyframes as f64) {
            break;
        }
    }
    if clock.last.is_none() && sink.findings.len() == found {
        sink.about(
            &source.name,
            Code::NothingToDo,
            "the file has no lines with values".into(),
            "one line per time",
            None,
        );
    }
    clock.note(options, source, sink);
    motions(input, mapped, source, sink)
}

/// Whether a title precedes the table, that is, lines with fewer cells. Adds a finding if there is one.
fn begins_with_title(table: &Table<'_>, sink: &mut Sink) -> bool {
    let Some((before, cells)) = dialect::table_behind_title(table.source, table.dialect) else {
        return false;
    };
    let own = downbeat_yaml::render::counted(table.header.width, "column");
    let message = format!("the first line has {own}, but the lines from line {} on have {cells}", before + 1);
    let hint = format!("if the lines above are a title, skip them with --skip {before}");
    let expected = "a header with the names of all columns";
    sink.found(table.source, table.header.row.spot(0), Code::ImportTable, message, expected, Some(&hint));
    true
}

fn columns(table: &Table<'_>, input: &Input, sink: &mut Sink) -> Option<(TimeColumn, Vec<Mapped>)> {
    let Table { header, options, source, .. } = *table;
    let found = sink.findings.len();
    let index = header.index(options.time_column.as_deref().unwrap_or("t"), source, sink);
    if options.time_column.is_none()
        && header.named
        && header.text(0) == "time"
        && let Some(finding) = sink.findings.get_mut(found)
    {
        finding.hint = Some("add `--time time`".to_owned());
    }
    let unit = index.and_then(|index| time_unit(table, index, sink));
    let mut mapped: Vec<Mapped> = Vec::new();
    let mut complete = true;
    let mut used: HashSet<usize> = index.into_iter().collect();
    let time = used.clone();
    // The pattern `*` only matches columns that no other option names.
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

/// Returns the unit of the times: the one that the user states, or else the header states, or else the times themselves show
/// unambiguously. The unit is never guessed: if it is unclear, adds a finding and returns `None`.
fn time_unit(table: &Table<'_>, index: usize, sink: &mut Sink) -> Option<TimeUnit> {
    let Table { header, options, source, .. } = *table;
    let said = moments::said_by(header.text(index));
    if let Some(unit) = options.time_unit {
        if matches!(said, Said::Unit(other) if other != unit) {
            let column = shortened(header.text(index));
            sink.note(format!(
                "{}: --time-unit overrides the unit in the column name `{column}`",
                source.name
            ));
        }
        return Some(unit);
    }
    let times = || {
        let rows = rows(source, table.dialect).skip(usize::from(header.named));
        rows.map(move |row| row.plain(index).into_owned()).filter(|text| !text.is_empty())
    };
    let first = times().next().unwrap_or_default();
    if TimeUnit::Date.time(&first).is_some() {
        return Some(TimeUnit::Date);
    }
    match (first.matches([':', ';']).count(), said, options.rate_hz) {
        (3, _, Some(rate)) => Some(TimeUnit::Timecode(rate)),
        (3, _, None) => table.unclear(index, "the frame rate of the timecodes is unknown", FRAMES, sink),
        (1.., ..) => clock(table, index, &first, &times().collect::<Vec<_>>(), sink),
        (0, Said::Unit(unit), _) => Some(unit),
        (0, Said::Nothing | Said::Frames, Some(rate)) => Some(TimeUnit::Frames(rate)),
        (0, Said::Frames, None) => table.unclear(index, "the frame rate is unknown", FRAMES, sink),
        (0, Said::Unclear, _) => table.unclear(index, "the unit of the times is unknown", UNIT, sink),
        (0, Said::Nothing, None) => match moments::unix(&first, &times().last().unwrap_or_default()) {
            Some((word, unit)) => {
                sink.note(format!("{}: the times are Unix times in {word}", source.name));
                Some(unit)
            }
            None => table.unclear(index, "the unit of the times is unknown", UNIT, sink),
        },
    }
}

/// Returns the notation of the clock times in the column. Adds a finding if several notations match all of them, or if no notation
/// matches the first one.
fn clock(
    table: &Table<'_>,
    index: usize,
    first: &str,
    texts: &[String],
    sink: &mut Sink,
) -> Option<TimeUnit> {
    match moments::clocks(texts.iter().map(String::as_str)).as_slice() {
        [(_, one)] => Some(*one),
        // A time that does not match is reported when its line is read.
        [] => match moments::clocks(std::iter::once(first)).first() {
            Some((_, unit)) => Some(*unit),
            None => table.unclear(index, "unknown format of the times", UNIT, sink),
        },
        several => {
            let words: Vec<_> = several.iter().map(|(word, _)| *word).collect();
            table.unclear(
                index,
                &format!("the format of the times is ambiguous: {}", words.join(" or ")),
                UNIT,
                sink,
            )
        }
    }
}

/// The hint for times whose unit is not known.
const UNIT: &str = "set it with --time-unit, such as --time-unit s";
const FRAMES: &str = "set it with --rate, such as --rate 25";

impl Table<'_> {
    fn unclear(&self, index: usize, message: &str, hint: &str, sink: &mut Sink) -> Option<TimeUnit> {
        let expected = match hint {
            FRAMES => "frames per second, set with --rate".to_owned(),
            _ => format!("{UNITS}, in the column name or set with --time-unit"),
        };
        let spot = self.header.row.spot(index);
        sink.found(self.source, spot, Code::ImportTime, message, expected, Some(hint));
        None
    }
}

fn read_row(row: &Row<'_>, at: Option<Span>, mapped: &mut [Mapped], source: &Source, sink: &mut Sink) {
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

/// Reads the time of each line, and checks that the times increase.
struct Clock {
    time: TimeColumn,
    first: Option<Span>,
    last: Option<Span>,
}

impl Clock {
    fn read(&mut self, row: &Row<'_>, source: &Source, sink: &mut Sink) -> Option<Span> {
        let TimeColumn { index, unit } = self.time;
        if let TimeUnit::Nanos(_) | TimeUnit::Frames(_) = unit {
            row.number(index, "the time", source, sink)?;
        }
        let spot = row.spot(index);
        let Some(at) = unit.time(&row.plain(index)) else {
            let message = format!("the time is `{}`", shortened(&row.cells[index].text));
            let expected = "a time in the same format as the previous ones";
            sink.found(source, spot, Code::ImportNumber, message, expected, None);
            return None;
        };
        // Dates count from the first one.
        let origin = self.first.filter(|first| keyframes::is_date(*first)).unwrap_or_default();
        let is_within = (0.0..=keyframes::SECONDS_MAX).contains(&keyframes::seconds(at - origin));
        let is_known =
            if self.first.is_none() { keyframes::is_date(at) } else { origin > at && origin > Span::ZERO };
        if !is_within && !is_known {
            let message = format!("the time is {} s", keyframes::seconds(at));
            let [from, to] = [0.0, keyframes::SECONDS_MAX].map(|end| end + keyframes::seconds(origin));
            sink.found(
                source,
                spot,
                Code::ImportTime,
                message,
                format!("a time from {from} to {to} s"),
                None,
            );
            return None;
        }
        if let Some((code, message, hint)) = self.last.and_then(|last| keyframes::check_later(last, at)) {
            let expected = format!("a time after {} s", self.last.map_or(0.0, keyframes::seconds));
            sink.found(source, spot, code, message, expected, Some(hint));
            return None;
        }
        self.first.get_or_insert(at);
        self.last = Some(at);
        Some(at)
    }

    /// Adds notes if the frame rate has no effect, or if the first frame is not at time 0.
    fn note(&self, options: &ImportOptions, source: &Source, sink: &mut Sink) {
        let file = &source.name;
        let is_counted = matches!(self.time.unit, TimeUnit::Frames(_) | TimeUnit::Timecode(_));
        if options.rate_hz.is_some() && !is_counted {
            sink.note(format!("{file}: the times are not frame numbers, so --rate has no effect"));
        }
        let late = self.first.filter(|first| *first > Span::ZERO && options.start.is_none());
        if let (TimeUnit::Frames(_), Some(first)) = (self.time.unit, late) {
            sink.note(format!("{file}: the first frame is at {first}; use --start 0s to begin with it"));
        }
    }
}

fn motions(input: &Input, mut mapped: Vec<Mapped>, source: &Source, sink: &mut Sink) -> Vec<Motion> {
    for column in &mut mapped {
        column.same = column.motion.thin();
        column.note(source, sink);
    }
    by_robot(&input.scene, mapped.into_iter().map(|mapped| (mapped.robot, mapped.motion)))
}

impl Mapped {
    /// Adds notes about differences between the imported motion and the file: empty cells and omitted lines. An empty column is an error.
    fn note(&self, source: &Source, sink: &mut Sink) {
        let Self { robot, motion, empty, same, .. } = self;
        let device = &motion.device;
        if motion.keyframes.is_empty() && sink.findings.is_empty() {
            let message = format!("the column for `{device}` of `{robot}` is empty");
            sink.about(&source.name, Code::NothingToDo, message, "at least one value", None);
        } else if *empty > 0 {
            let cells = downbeat_yaml::render::counted(*empty, "empty cell");
            let how = if motion.course == Course::Straight { "moves straight" } else { "keeps its value" };
            sink.note(format!("{}: `{device}` of `{robot}` {how} through {cells}", source.name));
        }
        if *same > 0 {
            let lines = downbeat_yaml::render::counted(*same, "line");
            sink.note(format!(
                "{}: left out {lines} in which `{device}` of `{robot}` does not change",
                source.name
            ));
        }
    }
}
