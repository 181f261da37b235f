//! Sampled movements: one column of a CSV file.

use urrcp::Span;

use super::kinds;
use crate::fields::{At, Reader};
use crate::files::Files;
use crate::finding::{Code, one_of};
use crate::import::dialect::Dialect;
use crate::import::table::{self, Row};
use crate::motion::{Between, Curve, Knot, Shape};
use crate::node::Node;
use crate::shown::shortened;
use crate::source::{BYTE_ORDER_MARK, Source};
use downbeat_reader::{keys, words};

/// Time units with their length in milliseconds.
const UNITS: [(&str, f64); 3] = [("s", 1_000.0), ("ms", 1.0), ("us", 0.001)];
const EASES: [(&str, Between); 2] = [("linear", Between::Linear), ("step", Between::Step)];

keys! {
    /// One column of a CSV file.
    pub(super) struct SamplesKeys {
        /// Path from the scenario's folder.
        #[required]
        file: kinds::TEXT,
        /// The column with times: its name, or its number from 1.
        #[required]
        time: kinds::NAME,
        /// The column with values: its name, or its number from 1.
        #[required]
        value: kinds::NAME,
        /// Default: s.
        time_unit: words!(UNITS),
        /// Factor on the values.
        scale: kinds::NUMBER,
        /// Movement from one row to the next. Default: as the device moves.
        ease: words!(EASES),
    }
}

/// Maximum number of faults listed per file; the last entry contains the number of further ones.
const FAULTS_MAX: usize = 20;

/// Reads a movement from a column of a CSV file: `{file: arm.csv, time: t, value: elbow, time_unit: s, scale: 1, ease: step}`.
pub(super) fn samples(reader: &mut Reader, files: &dyn Files, at: &At<'_>) -> Option<Curve> {
    let SamplesKeys { file, time, value, time_unit: unit, scale, ease } = reader.keys(at, "`samples`")?;
    let name =
        file.and_then(|at| reader.text(&at, "the path of a CSV file").map(std::borrow::Cow::into_owned));
    let millis = unit.map_or(Some(1_000.0), |at| reader.word(&at, &UNITS))?;
    let scale = scale.map_or(Some(1.0), |at| reader.number(&at, "a factor"))?;
    let between = ease.map_or(Some(Between::Own), |at| reader.word(&at, &EASES))?;
    let (file, name) = (file?, name?);
    let source = match files.read(&name) {
        Ok(source) => source,
        Err(finding) if finding.code == Code::OutsideProject => {
            reader.add_named(file.place(), finding);
            return None;
        }
        Err(finding) => {
            let message = format!("cannot read `{}`: {}", shortened(&name), finding.message);
            let hint = Some("the path is relative to the folder of the scenario".to_owned());
            reader.add(Code::Unreadable, file.place(), message, "a readable CSV file", hint);
            return None;
        }
    };
    let text = source.text.trim_start_matches(BYTE_ORDER_MARK).to_owned();
    let source = Source { text, ..source };
    let rows: Vec<Row<'_>> = table::rows(&source, Dialect::of(&source, 0, None)).collect();
    let mut table = Table { reader, file, name: &name, faults: 0 };
    let (time, value) = (time?, value?);
    let header: Vec<&str> =
        rows.first().map_or_else(Vec::new, |row| row.cells.iter().map(|cell| cell.text.as_ref()).collect());
    let columns = (table.column(&time, &header), table.column(&value, &header));
    let (Some((time, named)), Some((value, also_named))) = columns else { return None };
    let body = &rows[usize::from(named || also_named).min(rows.len())..];
    table.curve(body, [time, value], [millis, scale], Shape::Sampled(between))
}

struct Table<'r, 'a> {
    reader: &'r mut Reader,
    file: At<'a>,
    name: &'r str,
    faults: usize,
}

impl Table<'_, '_> {
    /// Returns the index of a column, given by its name in the header or by its number from 1, and whether there is a header.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small whole number")]
    fn column(&mut self, at: &At<'_>, header: &[&str]) -> Option<(usize, bool)> {
        if let Node::Number(number) = at.node {
            let index = *number as usize;
            if number.fract() == 0.0 && index >= 1 && index <= header.len() {
                let headed = header.iter().all(|cell| cell.parse::<f64>().is_err());
                return Some((index - 1, headed));
            }
        }
        let expected = "the name of a column, or its number, counted from 1";
        let name = self.reader.name(at, expected)?;
        let found = header.iter().position(|cell| *cell == name);
        if found.is_none() {
            let message = format!("`{}` has no column `{}`", shortened(self.name), shortened(&name));
            let hint = self.reader.did_you_mean(&name, header.iter().copied());
            let expected = one_of(header.iter().copied());
            self.reader.add(Code::BadData, at.place(), message, expected, hint);
        }
        found.map(|index| (index, true))
    }

    fn fault(&mut self, line: usize, message: &str, expected: &str) {
        self.faults += 1;
        if self.faults <= FAULTS_MAX {
            let message = format!("`{}` line {line}: {message}", shortened(self.name));
            self.reader.add(Code::BadData, self.file.place(), message, expected, None);
        }
    }

    fn curve(
        &mut self,
        rows: &[Row<'_>],
        [time, value]: [usize; 2],
        [millis, scale]: [f64; 2],
        shape: Shape,
    ) -> Option<Curve> {
        let mut knots: Vec<Knot> = Vec::with_capacity(rows.len());
        for (index, row) in rows.iter().enumerate() {
            let line = &row.line;
            let number =
                |column: usize| row.plain(column).parse::<f64>().ok().filter(|value| value.is_finite());
            let (Some(at), Some(to)) = (number(time), number(value)) else {
                self.fault(*line, "no finite number in one of the two columns", "a number in both columns");
                continue;
            };
            let at = Span::from_millis_f64(at * millis);
            if at < Span::ZERO || at.as_millis_f64() > urrcp::OFFSET_MS_MAX {
                self.fault(*line, &format!("the time {at}"), "a time of at least 0");
                continue;
            }
            if let Some(last) = knots.last().filter(|last| at <= last.at) {
                let message = format!("{at} is not later than {}", last.at);
                self.fault(*line, &message, "times that increase");
                continue;
            }
            let item = u32::try_from(index).unwrap_or(u32::MAX);
            knots.push(Knot { at, to: to * scale, shape, item });
        }
        if self.faults > FAULTS_MAX {
            let message = format!("`{}`: {} more faults", shortened(self.name), self.faults - FAULTS_MAX);
            self.reader.add(Code::BadData, self.file.place(), message, "a table of numbers", None);
        }
        if knots.is_empty() && self.faults == 0 {
            let message = format!("`{}` has no rows", shortened(self.name));
            self.reader.add(Code::BadData, self.file.place(), message, "at least one row of numbers", None);
        }
        (self.faults == 0 && !knots.is_empty()).then(|| Curve::new(knots, Vec::new()))
    }
}
