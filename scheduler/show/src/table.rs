//! Formats tables that fit the terminal. If the columns are too wide for it, each row is printed on several lines instead. Line breaks
//! never split a cell.

use comfy_table::{CellAlignment, Table, presets};
use downbeat_scripts::shown::{shown, within};
use unicode_width::UnicodeWidthStr;

use super::UNBOUNDED;

/// Maximum width of a cell, in columns of the terminal, if the width of the table is limited.
const CELL_MAX: usize = 60;

/// A table: a header and rows.
#[derive(Clone, Debug)]
pub struct Rows {
    header: Vec<&'static str>,
    /// Index of the first right-aligned column. All later columns are right-aligned, too.
    numbers_from: usize,
    rows: Vec<Vec<String>>,
}

impl Rows {
    /// Creates a table without rows. Columns from the index `numbers_from` contain numbers, so they are right-aligned.
    #[must_use]
    pub fn new(header: &[&'static str], numbers_from: usize) -> Self {
        Self { header: header.to_vec(), numbers_from, rows: Vec::new() }
    }

    /// Adds a row. Escapes its cells, because their text may come from outside, for example from a robot.
    pub fn add(&mut self, cells: impl IntoIterator<Item = impl AsRef<str>>) {
        self.rows.push(cells.into_iter().map(|cell| shown(cell.as_ref()).into_owned()).collect());
    }

    /// Formats the table in lines of at most `columns` columns, unless a single cell is wider.
    #[must_use]
    pub fn text(&self, columns: usize) -> String {
        self.painted(columns, |_, line| line)
    }

    /// Like [`Rows::text`], but applies `paint` to each line of a row. `paint` receives the row's index, from 0, and the line.
    #[must_use]
    pub fn painted(&self, columns: usize, paint: impl Fn(usize, String) -> String) -> String {
        let rows: Vec<_> = self.rows.iter().map(|row| cut(row, columns)).collect();
        let table = self.table(&rows);
        let mut lines = table.lines().map(|line| line.trim_end().to_owned());
        if !table.lines().all(|line| line.trim_end().width() <= columns) {
            let rows = rows.iter().enumerate();
            let lines = rows.flat_map(|(row, cells)| {
                let stacked = self.stacked(cells, columns);
                stacked.lines().map(|line| paint(row, line.to_owned()) + "\n").collect::<Vec<_>>()
            });
            return lines.collect();
        }
        let header = lines.next().unwrap_or_default() + "\n";
        lines.enumerate().fold(header, |text, (row, line)| text + &paint(row, line) + "\n")
    }

    /// Whether there are no rows.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    fn table(&self, rows: &[Vec<String>]) -> Table {
        let mut table = Table::new();
        table.load_style(presets::NOTHING);
        table.set_header(self.header.clone());
        for column in table.column_iter_mut().skip(self.numbers_from) {
            column.set_cell_alignment(CellAlignment::Right);
        }
        for row in rows {
            table.add_row(row.clone());
        }
        table
    }

    /// Formats a row on several lines: the first cell on its own line, then the other cells with their titles, several per line if there
    /// is room.
    fn stacked(&self, row: &[String], columns: usize) -> String {
        let mut cells = row.iter();
        let mut text = wrapped(cells.next().map_or("", String::as_str), columns);
        let pieces = self.header.iter().skip(1).zip(cells).filter(|(_, cell)| *cell != "-");
        let mut pieces: Vec<_> = pieces.map(|(title, cell)| format!("{title} {cell},")).collect();
        if let Some(last) = pieces.last_mut() {
            last.pop();
        }
        let mut line = String::new();
        for piece in pieces {
            if !line.is_empty() && line.width() + 1 + piece.width() > columns {
                text.push_str(&wrapped(&line, columns));
                line.clear();
            }
            line = if line.is_empty() { format!("  {piece}") } else { format!("{line} {piece}") };
        }
        if line.is_empty() { text } else { text + &wrapped(&line, columns) }
    }
}

/// Cuts the cells of a row to the maximum width for a terminal. For a file or a pipe, nothing is cut.
fn cut(row: &[String], columns: usize) -> Vec<String> {
    let largest = if columns == UNBOUNDED { usize::MAX } else { CELL_MAX };
    row.iter().map(|cell| within(cell, largest).into_owned()).collect()
}

/// Units that stay on the same line as their number.
const UNITS: [&str; 4] = ["us", "ms", "s", "min"];

/// Wraps text to at most `columns` columns. Line breaks are between words, but never between a number and its unit. Further lines are
/// indented by two more columns than the first line.
#[must_use]
pub fn wrapped(text: &str, columns: usize) -> String {
    let inset = text.len() - text.trim_start_matches(' ').len();
    let mut lines = " ".repeat(inset);
    let mut used = inset;
    for word in words(text.trim()) {
        let width = word.width();
        if used > inset && used + 1 + width > columns {
            lines.push('\n');
            lines.push_str(&" ".repeat(inset + 2));
            used = inset + 2;
        } else if used > inset {
            lines.push(' ');
            used += 1;
        }
        lines.push_str(&word);
        used += width;
    }
    lines.push('\n');
    lines
}

/// Splits a text into words. A number and its unit count as one word.
fn words(text: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    for word in text.split(' ') {
        let is_unit = UNITS.contains(&word.trim_end_matches([',', ';', ')', '.', ':']));
        match words.last_mut().filter(|before| is_unit && before.ends_with(|c: char| c.is_ascii_digit())) {
            Some(number) => {
                number.push(' ');
                number.push_str(word);
            }
            None => words.push(word.to_owned()),
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows() -> Rows {
        let mut rows = Rows::new(&["robot", "steps", "start error", "clock offset"], 1);
        rows.add(["arm-1", "120/120", "+0.412 ms", "-150.002 ms"]);
        rows.add(["a\u{1b}[2Jb", "7/120", "-", "90 ms"]);
        rows
    }

    #[test]
    fn rows_are_shown_in_columns_if_the_width_suffices() {
        let text = rows().text(60);
        assert!(text.lines().all(|line| line.width() <= 60), "{text}");
        assert!(text.starts_with(" robot"), "{text}");
        assert!(text.contains("a\\u{1b}[2Jb"), "{text}");
    }

    #[test]
    fn rows_are_shown_as_separate_lines_if_the_width_is_too_small() {
        let expected = "arm-1
  steps 120/120,
  start error +0.412 ms,
  clock offset -150.002 ms
a\\u{1b}[2Jb
  steps 7/120,
  clock offset 90 ms
";
        assert_eq!(rows().text(30), expected);
    }

    #[test]
    fn text_fits_any_width_without_leading_commas_or_broken_numbers() {
        let cells = ["arm-1", "120/120", "+0.412 ms", "-150.002 ms"];
        for columns in 15..=120 {
            let text = rows().text(columns);
            for line in text.lines() {
                assert!(!line.trim_start().starts_with(','), "at {columns} columns:\n{text}");
                assert!(line.width() <= columns, "at {columns} columns: `{line}`");
            }
            for cell in cells {
                assert!(text.contains(cell), "`{cell}` is broken at {columns} columns:\n{text}");
            }
        }
    }

    #[test]
    fn sentences_are_wrapped_between_words() {
        assert_eq!(
            wrapped("stop NOT confirmed; its lease ends at 19:30:00.412", 30),
            "stop NOT confirmed; its lease\n  ends at 19:30:00.412\n"
        );
        assert_eq!(wrapped("short\n", 30), "short\n");
        assert_eq!(wrapped("  arm: set in", 12), "  arm: set\n    in\n");
    }

    #[test]
    fn number_and_unit_are_never_split_across_lines() {
        assert_eq!(
            wrapped("confirmed within 666.663 us (350 ms, late)", 25),
            "confirmed within\n  666.663 us (350 ms,\n  late)\n"
        );
    }
}
