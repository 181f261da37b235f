//! Tables as text: lines of cells that know where they stand. Blank lines and lines that begin with `#` are passed over.

use std::borrow::Cow;

use crate::finding::Code;
use crate::node::shortened;
use crate::source::Source;

use super::sink::{Sink, Spot};

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
    let lines = text.lines().enumerate().filter(|(_, line)| is_row(line));
    lines.map(move |(index, text)| Row { line: index + 1, text, cells: cells(text, separator) })
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

fn cells(line: &str, separator: char) -> Vec<Cell<'_>> {
    let mut cells = Vec::new();
    let mut from = 0;
    loop {
        let end = cell_end(&line[from..], separator).map_or(line.len(), |end| from + end);
        cells.push(cell(line, from, end));
        if end == line.len() {
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
