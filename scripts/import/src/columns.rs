//! Assigns columns of a table to devices: by name, by number, by pattern, or several columns to one device.

use std::collections::{HashMap, HashSet};

use downbeat_yaml::finding::{Code, did_you_mean, names};
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;

use super::sink::Sink;
use super::table::Row;
use super::units::name_and_unit;

/// Maximum number of columns that one note lists by name.
const NAMED_MAX: usize = 12;

/// The header of a table, or its first line of values if it has no header.
pub(super) struct Header<'a> {
    pub(super) row: Row<'a>,
    /// Whether the line contains the names of the columns. If not, it is already a line of values.
    pub(super) named: bool,
    pub(super) width: usize,
    /// For each column name, with and without its unit, the indices of the columns with that name.
    by_name: HashMap<String, Vec<usize>>,
}

/// A device that the user has selected as a target, and the columns that move it.
pub(super) struct Chosen {
    /// The target (`device` or `robot/device`) as written by the user. A `*` is replaced by the text that it matched.
    pub(super) target: String,
    pub(super) indices: Vec<usize>,
}

impl<'a> Header<'a> {
    /// Creates the header from the first row. A row that contains values, including times, does not name the columns.
    pub(super) fn new(mut row: Row<'a>) -> Self {
        // Values include clock times, dates and numbers with decimal commas.
        let value = |text: &str| {
            let begins =
                text.is_empty() || text.starts_with(|c: char| c.is_ascii_digit() || "+-.,".contains(c));
            let is_time = |b: u8| b.is_ascii_digit() || b":;.,+-TZeE ".contains(&b);
            text.parse::<f64>().is_ok() || begins && text.bytes().all(is_time)
        };
        let named = row.cells.iter().any(|cell| !value(&cell.text));
        row.drop_trailing(row.cells.len().saturating_sub(1));
        let width = row.cells.len();
        let mut by_name: HashMap<String, Vec<usize>> = HashMap::new();
        for (index, cell) in row.cells.iter().enumerate().filter(|_| named) {
            let (whole, name) = (cell.text.as_ref(), name_and_unit(&cell.text).0);
            by_name.entry(whole.to_owned()).or_default().push(index);
            if name != whole {
                by_name.entry(name.to_owned()).or_default().push(index);
            }
        }
        Self { row, named, width, by_name }
    }

    pub(super) fn text(&self, index: usize) -> &str {
        if self.named { &self.row.cells[index].text } else { "" }
    }

    pub(super) fn unit(&self, index: usize) -> &str {
        name_and_unit(self.text(index)).1
    }

    fn texts(&self) -> impl Iterator<Item = &str> {
        self.row.cells.iter().map(|cell| cell.text.as_ref())
    }

    /// Returns the index of a column that is given by its name, with or without its unit, or by its number, counted from 1.
    pub(super) fn index(&self, column: &str, source: &Source, sink: &mut Sink) -> Option<usize> {
        let found = self.by_name.get(column).map_or(&[][..], Vec::as_slice);
        let number = column.parse::<usize>().ok().filter(|number| (1..=self.width).contains(number));
        match found {
            [index] => Some(*index),
            [] if number.is_some() => number.map(|number| number - 1),
            [_, second, ..] => {
                let message = format!("duplicate column name `{}`", shortened(column));
                let hint = Some("refer to the column by its number, counted from 1");
                let expected = "unique names";
                sink.found(source, self.row.spot(*second), Code::ImportTable, message, expected, hint);
                None
            }
            [] => {
                self.unknown(column, source, sink);
                None
            }
        }
    }

    fn unknown(&self, column: &str, source: &Source, sink: &mut Sink) {
        let message = format!("no column `{}`", shortened(column));
        let expected = if self.named {
            format!("one of {}, or a number from 1 to {}", names(self.texts()), self.width)
        } else {
            format!("a number from 1 to {}: the file has no header", self.width)
        };
        let hint = did_you_mean(column, self.texts());
        sink.found(source, self.row.spot(0), Code::ImportTable, message, expected, hint.as_deref());
    }

    /// Returns the devices and columns of one `--map` option. A `*` yields one device for each text that it matches; it does not match
    /// columns in `taken`.
    pub(super) fn choose(
        &self,
        target: &str,
        columns: &str,
        taken: &HashSet<usize>,
        source: &Source,
        sink: &mut Sink,
    ) -> Option<Vec<Chosen>> {
        if !target.contains('*') {
            let indices = self.indices(columns, source, sink)?;
            return Some(vec![Chosen { target: target.to_owned(), indices }]);
        }
        let stars = self.stars(columns, taken);
        if stars.is_empty() {
            self.unknown(columns, source, sink);
            return None;
        }
        let chosen = stars.iter().map(|star| {
            let indices = self.indices(&columns.replace('*', star), source, sink)?;
            Some(Chosen { target: target.replace('*', star), indices })
        });
        chosen.collect()
    }

    fn indices(&self, columns: &str, source: &Source, sink: &mut Sink) -> Option<Vec<usize>> {
        // A name that contains a comma takes precedence.
        if self
            .by_name
            .get(columns)
            .is_some_and(|found| found.iter().any(|index| self.text(*index) == columns))
        {
            return Some(vec![self.index(columns, source, sink)?]);
        }
        columns.split(',').map(|column| self.index(column.trim(), source, sink)).collect()
    }

    /// Returns the texts that the `*` in a pattern matches, in the order of the columns.
    fn stars(&self, columns: &str, taken: &HashSet<usize>) -> Vec<String> {
        let pattern = columns.split(',').map(str::trim).find(|column| column.contains('*'));
        let Some((before, behind)) = pattern.and_then(|pattern| pattern.split_once('*')) else {
            return Vec::new();
        };
        let star = |text: &str| {
            let inner = text.strip_prefix(before)?.strip_suffix(behind)?;
            (!inner.is_empty()).then(|| inner.to_owned())
        };
        let others = self.texts().enumerate().filter(|(index, _)| self.named && !taken.contains(index));
        let mut stars: Vec<String> =
            others.filter_map(|(_, text)| star(name_and_unit(text).0).or_else(|| star(text))).collect();
        let mut seen = HashSet::new();
        stars.retain(|star| seen.insert(star.clone()));
        stars
    }

    /// Adds a note that lists the columns that are not mapped to a device.
    pub(super) fn note_unused(&self, used: &HashSet<usize>, source: &Source, sink: &mut Sink) {
        let unused: Vec<usize> = (0..self.width).filter(|index| !used.contains(index)).collect();
        if unused.is_empty() {
            return;
        }
        let name = |index: &usize| match self.text(*index) {
            "" => format!("column {}", index + 1),
            text => format!("`{}`", shortened(text)),
        };
        let mut named: Vec<String> = unused.iter().take(NAMED_MAX).map(name).collect();
        if unused.len() > NAMED_MAX {
            named.push(format!("and {} more", unused.len() - NAMED_MAX));
        }
        let columns = downbeat_yaml::render::counted(unused.len(), "column");
        sink.note(format!("{}: ignored {columns} without a mapping: {}", source.name, named.join(", ")));
    }
}
