//! Splits tables in text files into rows of cells with their positions. Blank lines and lines that begin with `#` are ignored.

use std::borrow::Cow;

use downbeat_yaml::finding::Code;
use downbeat_yaml::render::counted;
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;

use super::dialect::{self, Decimal, Dialect};
use super::sink::{Sink, Spot};

/// Maximum number of cells per line.
const CELLS_MAX: usize = 50_000;

/// One line of a table, split into cells.
#[derive(Clone, Debug)]
pub struct Row<'a> {
    /// The number of the line in the file, counted from 1.
    pub line: usize,
    pub(super) text: &'a str,
    /// The cells of the line.
    pub cells: Vec<Cell<'a>>,
    decimal: Option<Decimal>,
}

/// The text between two separators, without quotes and surrounding spaces.
#[derive(Clone, Debug)]
pub struct Cell<'a> {
    /// The content of the cell, without quotes.
    pub text: Cow<'a, str>,
    start: usize,
    width: usize,
}

/// Returns the rows of a table. A header that is written as a comment is the first one.
pub fn rows(source: &Source, dialect: Dialect) -> impl Iterator<Item = Row<'_>> {
    let lines = source.text.lines().enumerate().skip(dialect.skipped).filter(|(_, line)| is_row(line));
    let rows = lines.map(move |(index, text)| Row::of(index, text, dialect.separator));
    let with_decimal = move |row| Row { decimal: dialect.decimal, ..row };
    commented_header(source, dialect).into_iter().chain(rows).map(with_decimal)
}

/// All lines of a table, including those that begin with `#`.
pub(super) fn every_row(source: &Source, separator: char) -> impl Iterator<Item = Row<'_>> {
    source.text.lines().enumerate().map(move |(index, text)| Row::of(index, text, separator))
}

/// Finds a header that is written as a comment, such as `# duration,x^0`. It is the last comment before the first line of numbers with as
/// many columns as that line.
fn commented_header(source: &Source, dialect: Dialect) -> Option<Row<'_>> {
    let Dialect { separator, skipped, .. } = dialect;
    let lines = || source.text.lines().enumerate().skip(skipped);
    let (line, first) = lines().find(|(_, line)| is_row(line))?;
    let mut first = cells(first, 0, separator);
    let number = |cell: &Cell<'_>| cell.text.replace(',', ".").parse::<f64>().is_ok();
    if first.last().is_some_and(|cell| cell.text.is_empty()) {
        first.pop();
    }
    if first.len() < 2 || !first.iter().all(number) {
        return None;
    }
    let names = |(index, text): (usize, &'_ str)| {
        let behind = text.find('#').filter(|at| text[..*at].trim().is_empty())? + 1;
        let count = cells(text, behind, separator).len();
        let named = count == first.len() && !cells(text, behind, separator).iter().any(number);
        named.then_some((index, behind))
    };
    let (index, behind) = lines().take_while(|(index, _)| *index < line).filter_map(names).last()?;
    let text = source.text.lines().nth(index)?;
    Some(Row { cells: cells(text, behind, separator), ..Row::of(index, text, separator) })
}

pub(super) fn is_row(line: &str) -> bool {
    let trimmed = line.trim();
    !trimmed.is_empty() && !trimmed.starts_with('#')
}

/// Splits a line, from the byte offset `from` on, into cells.
fn cells(line: &str, mut from: usize, separator: char) -> Vec<Cell<'_>> {
    if separator == ' ' {
        return cells_between_blanks(line, from);
    }
    let mut cells = Vec::new();
    loop {
        let end = cell_end(&line[from..], separator).map_or(line.len(), |end| from + end);
        cells.push(cell(line, from, end));
        if end == line.len() || cells.len() == CELLS_MAX {
            return cells;
        }
        from = end + separator.len_utf8();
    }
}

/// Like [`cells`], but for cells that are separated by whitespace. A unit in brackets belongs to the cell before it.
fn cells_between_blanks(line: &str, mut from: usize) -> Vec<Cell<'_>> {
    let mut cells: Vec<Cell<'_>> = Vec::new();
    while cells.len() < CELLS_MAX {
        let rest = line[from..].trim_start();
        if rest.is_empty() {
            break;
        }
        let start = line.len() - rest.len();
        let length = match rest.strip_prefix('"').and_then(|inner| inner.find('"')) {
            Some(inner) => inner + 2,
            None => rest.find(char::is_whitespace).unwrap_or(rest.len()),
        };
        from = start + length;
        match cells.last().map(|before| before.start).filter(|_| rest.starts_with(['[', '('])) {
            Some(before) => {
                cells.pop();
                cells.push(cell(line, before, from));
            }
            None => cells.push(cell(line, start, from)),
        }
    }
    cells
}

/// Returns the byte offset of the separator that ends the first cell; `None` if there is only one cell. Separators in quotes are ignored.
fn cell_end(rest: &str, separator: char) -> Option<usize> {
    let mut quoted = false;
    let opens = rest.trim_start_matches(' ').starts_with('"');
    rest.char_indices().find_map(|(at, c)| {
        quoted ^= opens && c == '"';
        (c == separator && !quoted).then_some(at)
    })
}

fn cell(line: &str, from: usize, end: usize) -> Cell<'_> {
    let raw = &line[from..end];
    let trimmed = raw.trim();
    let start = from + (raw.len() - raw.trim_start().len());
    let text = match trimmed.strip_prefix('"').and_then(|rest| rest.strip_suffix('"')) {
        Some(inner) => Cow::Owned(inner.replace("\"\"", "\"")),
        None => Cow::Borrowed(trimmed),
    };
    Cell { text, start, width: trimmed.len() }
}

impl<'a> Row<'a> {
    /// Splits the line with the given index, counted from 0, into cells.
    pub(super) fn of(index: usize, text: &'a str, separator: char) -> Self {
        Self { line: index + 1, text, cells: cells(text, 0, separator), decimal: None }
    }
}

impl Row<'_> {
    /// Returns the place of a cell, or the end of the line if the cell is missing.
    pub(super) fn spot(&self, index: usize) -> Spot<'_> {
        let (start, width) =
            self.cells.get(index).map_or((self.text.len(), 0), |cell| (cell.start, cell.width));
        Spot { line: self.line, text: self.text, start, width }
    }

    /// Drops the empty last cell of a line that ends with a separator and therefore has one cell more than `columns`.
    pub(super) fn drop_trailing(&mut self, columns: usize) {
        if self.cells.len() == columns + 1 && self.cells.last().is_some_and(|cell| cell.text.is_empty()) {
            self.cells.pop();
        }
    }

    /// Whether the row has `columns` cells, as many as the header. Adds a finding if it has not.
    pub(super) fn has(&self, columns: usize, source: &Source, sink: &mut Sink) -> bool {
        let found = self.cells.len();
        if found == columns {
            return true;
        }
        let message = format!("line {} has {}, not {columns}", self.line, counted(found, "column"));
        let hint = (found < columns).then_some("is the file complete?");
        let expected = format!("{columns} columns, as in the header");
        sink.found(source, self.spot(found.min(columns)), Code::ImportTable, message, expected, hint);
        false
    }

    /// Returns the text of a cell; in numbers, a decimal comma is replaced by a decimal point.
    pub fn plain(&self, index: usize) -> Cow<'_, str> {
        let text = self.cells.get(index).map_or("", |cell| &cell.text);
        dialect::plain(text, self.decimal).unwrap_or(Cow::Borrowed(text))
    }

    /// Parses a cell as a finite number. Adds a finding if it is anything else.
    pub(super) fn number(&self, index: usize, what: &str, source: &Source, sink: &mut Sink) -> Option<f64> {
        let text = self.cells.get(index).map_or("", |cell| &cell.text);
        let plain = dialect::plain(text, self.decimal);
        let parsed = plain.as_deref().and_then(|plain| plain.parse::<f64>().ok());
        if let Some(value) = parsed.filter(|value| value.is_finite()) {
            return Some(value);
        }
        let message = match parsed {
            Some(value) => format!("{what} is {value}"),
            None if text.is_empty() => format!("{what} is missing"),
            None => format!("{what} is the text `{}`", shortened(text)),
        };
        let hint = match self.decimal {
            Some(Decimal::Comma) if text.contains('.') => Some("write decimal commas throughout the file"),
            _ if text.contains(',') => {
                Some("write decimal points, or set the decimal mark with --decimal comma or --decimal point")
            }
            _ if text.contains(';') => Some("use the same separator between all columns"),
            _ => None,
        };
        sink.found(source, self.spot(index), Code::ImportNumber, message, "a finite number", hint);
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COMMAS: Dialect = Dialect { separator: ',', skipped: 0, decimal: None };

    #[test]
    fn header_after_a_hash_keeps_its_cell_positions() {
        let text = "# made by hand\n# duration, x\n1,2\n# t,u\n3,4\n";
        let source = Source { name: "t.csv".into(), text: text.into() };
        let rows: Vec<_> = rows(&source, COMMAS).collect();
        let texts: Vec<_> = rows[0].cells.iter().map(|cell| cell.text.as_ref()).collect();
        assert_eq!((texts, rows[0].line, rows.len()), (vec!["duration", "x"], 2, 3));
        assert_eq!((rows[0].spot(0).start, rows[0].spot(1).start), (2, 12));
    }

    #[test]
    fn cells_keep_their_positions_and_lose_their_quotes() {
        let source = Source { name: "t.csv".into(), text: "a,b\n\n# c\n \"1,5\" , 2,\n".into() };
        let mut rows: Vec<_> = rows(&source, COMMAS).collect();
        assert_eq!(rows.len(), 2);
        rows[1].drop_trailing(2);
        let texts: Vec<_> = rows[1].cells.iter().map(|cell| cell.text.as_ref()).collect();
        assert_eq!((texts, rows[1].line), (vec!["1,5", "2"], 4));
        assert_eq!(rows[1].spot(1).start, 9);
    }

    #[test]
    fn blanks_separate_cells_but_not_a_name_from_its_unit() {
        let text = "  # Time [s]  x [m]\n  0.5   \"a b\" \n";
        let source = Source { name: "t.txt".into(), text: text.into() };
        let dialect = Dialect { separator: ' ', ..COMMAS };
        let rows: Vec<_> = rows(&source, dialect).collect();
        let texts: Vec<_> = rows[0].cells.iter().map(|cell| cell.text.as_ref()).collect();
        assert_eq!((texts, rows[0].spot(1).start), (vec!["0.5", "a b"], 8));
        let header = cells("  # Time [s]  x [m]", 3, ' ');
        let texts: Vec<_> = header.iter().map(|cell| cell.text.as_ref()).collect();
        assert_eq!(texts, ["Time [s]", "x [m]"]);
    }
}
