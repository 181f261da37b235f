//! Tables as text: lines of cells that know where they stand. Blank lines and lines that begin with `#` are passed over.

use std::borrow::Cow;

use crate::finding::Code;
use crate::node::shortened;
use crate::source::Source;

use super::sink::{Sink, Spot};

/// Most cells of a line that are told apart.
const CELLS_MAX: usize = 50_000;

/// One line.
#[derive(Clone, Debug)]
pub(super) struct Row<'a> {
    /// From 1.
    pub(super) line: usize,
    pub(super) text: &'a str,
    pub(super) cells: Vec<Cell<'a>>,
}

/// What stands between two separators, without quotes and space around it.
#[derive(Clone, Debug)]
pub(super) struct Cell<'a> {
    pub(super) text: Cow<'a, str>,
    start: usize,
    width: usize,
}

/// The lines of a table.
pub(super) fn rows(source: &Source, separator: char) -> impl Iterator<Item = Row<'_>> {
    let text = source.text.strip_prefix('\u{feff}').unwrap_or(&source.text);
    let header = commented_header(text, separator);
    let lines = text.lines().enumerate().filter(|(_, line)| is_row(line));
    let rows =
        lines.map(move |(index, text)| Row { line: index + 1, text, cells: cells(text, 0, separator) });
    header.into_iter().chain(rows)
}

/// All lines of a table, also those that begin with `#`.
pub(super) fn every_row(source: &Source, separator: char) -> impl Iterator<Item = Row<'_>> {
    let lines = source.text.lines().enumerate();
    lines.map(move |(index, text)| Row { line: index + 1, text, cells: cells(text, 0, separator) })
}

/// A header that is written as a comment, `# duration,x^0`: the last one ahead of numbers, of as many columns.
fn commented_header(text: &str, separator: char) -> Option<Row<'_>> {
    let (line, first) = text.lines().enumerate().find(|(_, line)| is_row(line))?;
    let mut first = cells(first, 0, separator);
    let number = |cell: &Cell<'_>| cell.text.parse::<f64>().is_ok();
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
    let (index, behind) = text.lines().enumerate().take(line).filter_map(names).last()?;
    let text = text.lines().nth(index)?;
    let cells = cells(text, behind, separator);
    Some(Row { line: index + 1, text, cells })
}

/// The separator that the first line uses most: comma, semicolon or tab.
pub(super) fn separator_of(source: &Source) -> char {
    let first = source.text.lines().find(|line| is_row(line)).unwrap_or("");
    let count = |separator: char| first.chars().filter(|c| *c == separator).count();
    [';', '\t'].into_iter().fold(',', |best, other| if count(other) > count(best) { other } else { best })
}

fn is_row(line: &str) -> bool {
    let trimmed = line.trim();
    !trimmed.is_empty() && !trimmed.starts_with('#')
}

/// The cells of a line from a byte on.
fn cells(line: &str, mut from: usize, separator: char) -> Vec<Cell<'_>> {
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

/// Where the separator stands that ends the cell; those within quotes do not.
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

impl Row<'_> {
    /// The place of a cell, of the line's end where there is none.
    pub(super) fn spot(&self, index: usize) -> Spot<'_> {
        let (start, width) =
            self.cells.get(index).map_or((self.text.len(), 0), |cell| (cell.start, cell.width));
        Spot { line: self.line, text: self.text, start, width }
    }

    /// Drops one empty cell at the end, where a separator ends the line.
    pub(super) fn drop_trailing(&mut self, columns: usize) {
        if self.cells.len() == columns + 1 && self.cells.last().is_some_and(|cell| cell.text.is_empty()) {
            self.cells.pop();
        }
    }

    /// Whether it has as many cells as the header; a finding otherwise.
    pub(super) fn has(&self, columns: usize, source: &Source, sink: &mut Sink) -> bool {
        let found = self.cells.len();
        if found == columns {
            return true;
        }
        let message = format!("line {} has {found} columns, not {columns}", self.line);
        let hint = (found < columns).then_some("is the file complete?");
        let expected = format!("{columns} columns, as the header has");
        sink.found(source, self.spot(found.min(columns)), Code::ImportTable, message, expected, hint);
        false
    }

    /// A cell as a finite number; a finding otherwise.
    pub(super) fn number(&self, index: usize, what: &str, source: &Source, sink: &mut Sink) -> Option<f64> {
        let text = self.cells.get(index).map_or("", |cell| &cell.text);
        let parsed = text.parse::<f64>();
        if let Ok(value) = parsed
            && value.is_finite()
        {
            return Some(value);
        }
        let message = match parsed {
            Ok(value) => format!("{what} is {value}"),
            Err(_) if text.is_empty() => format!("{what} is missing"),
            Err(_) => format!("{what} is the text `{}`", shortened(text)),
        };
        let comma = text.contains(',') || text.contains(';');
        let hint = comma.then_some("write decimal points, and one separator between columns");
        sink.found(source, self.spot(index), Code::ImportNumber, message, "a finite number", hint);
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_behind_a_hash_keeps_its_places() {
        let text = "# made by hand\n# duration, x\n1,2\n# t,u\n3,4\n";
        let source = Source { name: "t.csv".into(), text: text.into() };
        let rows: Vec<_> = rows(&source, ',').collect();
        let texts: Vec<_> = rows[0].cells.iter().map(|cell| cell.text.as_ref()).collect();
        assert_eq!((texts, rows[0].line, rows.len()), (vec!["duration", "x"], 2, 3));
        assert_eq!((rows[0].spot(0).start, rows[0].spot(1).start), (2, 12));
    }

    #[test]
    fn cells_keep_their_places_and_lose_their_quotes() {
        let source = Source { name: "t.csv".into(), text: "\u{feff}a,b\n\n# c\n \"1,5\" , 2,\n".into() };
        let mut rows: Vec<_> = rows(&source, ',').collect();
        assert_eq!(rows.len(), 2);
        rows[1].drop_trailing(2);
        let texts: Vec<_> = rows[1].cells.iter().map(|cell| cell.text.as_ref()).collect();
        assert_eq!((texts, rows[1].line), (vec!["1,5", "2"], 4));
        assert_eq!(rows[1].spot(1).start, 9);
    }

    #[test]
    fn the_separator_is_the_one_that_the_header_uses() {
        for (text, separator) in [("a,b", ','), ("a;b;c", ';'), ("a\tb", '\t'), ("", ',')] {
            assert_eq!(separator_of(&Source { name: String::new(), text: text.into() }), separator, "{text}");
        }
    }
}
