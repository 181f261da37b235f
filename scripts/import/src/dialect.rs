//! The notation of a table: the separator of its cells, its decimal mark, and the lines before it.

use std::borrow::Cow;
use std::str::FromStr;

use downbeat_yaml::source::Source;

use super::table::{Row, is_row, rows};

/// Number of lines that are searched for a table after a title, and number of consecutive rows with equally many cells that count as a
/// table.
const TITLE_LINES_MAX: usize = 20;
const ROWS_AGREEING: usize = 3;

/// The decimal mark of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decimal {
    /// `1234.5` or `1,234.5`.
    Point,
    /// `1234,5` or `1.234,5`.
    Comma,
}

impl FromStr for Decimal {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "point" => Ok(Self::Point),
            "comma" => Ok(Self::Comma),
            _ => Err("point or comma".to_owned()),
        }
    }
}

/// The notation of a table in a text file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dialect {
    /// The separator of cells. A space stands for any sequence of blanks.
    pub(super) separator: char,
    /// Number of lines before the table.
    pub(super) skipped: usize,
    /// The decimal mark of numbers. `None` if numbers with commas are invalid.
    pub(super) decimal: Option<Decimal>,
}

impl Dialect {
    /// Detects the dialect of a table that follows `skipped` lines. If the user specifies `decimal`, it takes precedence over the
    /// detected decimal mark.
    pub fn of(source: &Source, skipped: usize, decimal: Option<Decimal>) -> Self {
        let (separator, skipped) = stated_separator(source, skipped)
            .unwrap_or_else(|| (separator_of(source.text.lines().skip(skipped)), skipped));
        let plain = Self { separator, skipped, decimal: None };
        Self { decimal: decimal.or_else(|| decimal_of(source, plain)), ..plain }
    }
}

/// Parses a first line such as `sep=;`, which specifies the separator for Excel. Returns the separator and the number of lines before the
/// table.
fn stated_separator(source: &Source, skipped: usize) -> Option<(char, usize)> {
    let first = source.text.lines().nth(skipped)?.trim_matches(|c| c == '"' || c == '\r');
    let (key, separator) = first.split_at_checked("sep=".len())?;
    let mut characters = separator.chars();
    let (separator, rest) = (characters.next()?, characters.next());
    (key.eq_ignore_ascii_case("sep=") && rest.is_none()).then_some((separator, skipped + 1))
}

/// Returns the most frequent of comma, semicolon and tab in the first line. If the line contains none of them but contains blanks,
/// returns a space.
fn separator_of<'a>(mut lines: impl Iterator<Item = &'a str>) -> char {
    let first = lines.find(|line| is_row(line)).unwrap_or("");
    let count = |separator: char| first.chars().filter(|c| *c == separator).count();
    let most = [';', '\t']
        .into_iter()
        .fold(',', |best, other| if count(other) > count(best) { other } else { best });
    let is_blank = count(most) == 0 && first.trim().contains(char::is_whitespace);
    if is_blank { ' ' } else { most }
}

/// Returns the decimal mark of all unambiguous numbers in a table. `None` if their marks differ, or if no number is unambiguous.
fn decimal_of(source: &Source, dialect: Dialect) -> Option<Decimal> {
    // If commas separate cells, only quoted cells can contain any.
    let may_differ =
        if dialect.separator == ',' { source.text.contains('"') } else { source.text.contains(',') };
    if !may_differ {
        return None;
    }
    let mut shown = None;
    for row in rows(source, dialect) {
        for mark in row.cells.iter().filter_map(|cell| mark_of(&cell.text)) {
            match shown {
                Some(other) if other != mark => return None,
                _ => shown = Some(mark),
            }
        }
    }
    shown
}

/// Returns the decimal mark of a number. `None` if the number has no mark, or if the mark is ambiguous, as in `1,500`.
fn mark_of(text: &str) -> Option<Decimal> {
    if !text.contains([',', '.']) {
        return None;
    }
    let reads = |decimal| plain(text, Some(decimal)).is_some_and(|plain| plain.parse::<f64>().is_ok());
    match (reads(Decimal::Point), reads(Decimal::Comma)) {
        (true, false) => Some(Decimal::Point),
        (false, true) => Some(Decimal::Comma),
        _ => None,
    }
}

/// Rewrites a number with a decimal point and without thousands separators. `None` if its commas or points do not fit the decimal mark
/// `decimal`.
pub(super) fn plain(text: &str, decimal: Option<Decimal>) -> Option<Cow<'_, str>> {
    let (mark, group) = match decimal {
        None => return (!text.contains(',')).then_some(Cow::Borrowed(text)),
        Some(Decimal::Point) => ('.', ','),
        Some(Decimal::Comma) => (',', '.'),
    };
    let (whole, fraction) = text.split_once(mark).unwrap_or((text, ""));
    let mut groups = whole.trim_start_matches(['+', '-']).split(group);
    let first = groups.next().unwrap_or("");
    let is_grouped = whole.contains(group);
    let sound = !is_grouped || ((1..=3).contains(&first.len()) && first != "0");
    if fraction.contains([mark, group]) || !sound || !groups.all(|digits| digits.len() == 3) {
        return None;
    }
    if mark == '.' && !is_grouped {
        return Some(Cow::Borrowed(text));
    }
    let point = if text.contains(mark) { "." } else { "" };
    Some(Cow::Owned(format!("{}{point}{fraction}", whole.replace(group, ""))))
}

/// Detects a table that begins after a title. Returns the number of lines before the table, and the table's number of cells per row. The
/// table begins at a row with more cells than the first line, followed by rows of values with as many cells.
pub(super) fn table_behind_title(source: &Source, dialect: Dialect) -> Option<(usize, usize)> {
    let lines = source.text.lines().enumerate().skip(dialect.skipped).filter(|(_, line)| is_row(line));
    let lines: Vec<(usize, &str)> = lines.take(TITLE_LINES_MAX).collect();
    let rows = |separator| {
        let mut rows: Vec<Row<'_>> =
            lines.iter().map(|(index, line)| Row::of(*index, line, separator)).collect();
        rows.iter_mut().for_each(|row| row.drop_trailing(row.cells.len().saturating_sub(1)));
        rows
    };
    let own: Vec<usize> = rows(dialect.separator).iter().map(|row| row.cells.len()).collect();
    if own.first().is_some_and(|first| *first > 1 && own.get(1).is_none_or(|second| second == first)) {
        return None;
    }
    [',', ';', '\t', ' '].into_iter().find_map(|separator| {
        let rows = rows(separator);
        let first = rows.first()?.cells.len();
        let is_value = |row: &Row<'_>| row.cells[0].text.starts_with(|c: char| c.is_ascii_digit());
        let begin = rows.windows(ROWS_AGREEING).find(|rows| {
            let count = rows[0].cells.len();
            let agree = rows[1..].iter().all(|row| row.cells.len() == count && is_value(row));
            count > first && count > 1 && agree
        })?;
        Some((begin[0].line - 1, begin[0].cells.len()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dialect(text: &str) -> Dialect {
        Dialect::of(&Source { name: String::new(), text: text.into() }, 0, None)
    }

    #[test]
    fn separator_is_the_one_used_or_stated_in_the_first_line() {
        for (text, separator, skipped) in [
            ("a,b", ',', 0),
            ("a;b;c", ';', 0),
            ("a\tb", '\t', 0),
            ("  a   b", ' ', 0),
            ("a", ',', 0),
            ("", ',', 0),
            ("sep=;\na,b;c", ';', 1),
            ("\"SEP=\t\"\na,b", '\t', 1),
            ("sep=\na", ',', 0),
        ] {
            let found = dialect(text);
            assert_eq!((found.separator, found.skipped), (separator, skipped), "{text}");
        }
    }

    #[test]
    fn decimal_comma_is_detected_if_no_number_is_ambiguous() {
        for (text, decimal) in [
            ("a;b\n0,5;1", Some(Decimal::Comma)),
            ("a;b\n1.000,5;1", Some(Decimal::Comma)),
            ("a;b\n0,125;1.250", Some(Decimal::Comma)),
            ("a;b\n1,250;2,500", None),
            ("a;b\n1,250;2.5", Some(Decimal::Point)),
            ("a;b\n0,5;2.5", None),
            ("a,b\n\"0,5\",1", Some(Decimal::Comma)),
            ("a,b\n0.5,1", None),
            ("a,b\n0,5\n1,5", None),
        ] {
            assert_eq!(dialect(text).decimal, decimal, "{text}");
        }
    }

    #[test]
    fn thousands_separators_are_removed_and_values_kept() {
        let comma = |text| plain(text, Some(Decimal::Comma)).map(Cow::into_owned);
        for (text, expected) in [
            ("1.000,5", "1000.5"),
            ("-3,125", "-3.125"),
            ("1.234.567", "1234567"),
            ("12", "12"),
            ("1,5e-3", "1.5e-3"),
            (",5", ".5"),
        ] {
            assert_eq!(comma(text).as_deref(), Some(expected), "{text}");
        }
        for wrong in ["12.5", "1.0000", "0.125", "1,2,3", "1,000.5", "1..000"] {
            assert_eq!(comma(wrong), None, "{wrong}");
        }
        let point = |text| plain(text, Some(Decimal::Point)).map(Cow::into_owned);
        assert_eq!(point("1,000.5").as_deref(), Some("1000.5"));
        assert_eq!((point("0.125").as_deref(), point("1,5")), (Some("0.125"), None));
        assert_eq!((plain("1,5", None), plain("0.5", None)), (None, Some(Cow::Borrowed("0.5"))));
    }

    #[test]
    fn table_begins_where_rows_agree_on_more_cells() {
        let behind = |text: &str| {
            let source = Source { name: String::new(), text: text.into() };
            table_behind_title(&source, dialect(text))
        };
        assert_eq!(behind("My show\nmade by hand\n\nt,a,b\n0,1,2\n1,2,3\n"), Some((3, 3)));
        assert_eq!(behind("Trial 1\nt x y\n0 1 2\n1 2 3\n"), Some((1, 3)));
        assert_eq!(behind("scenario: show\ncues:\n  - {cue: a, at: 0s}\n  - {cue: b, at: 1s}\n"), None);
        assert_eq!(behind("t,a,b\n0,1,2\n1,2,3\n"), None);
        assert_eq!(behind("t,a\n0,1,\n1,2,\n2,3,\n"), None);
        assert_eq!(behind("t,a\n0,1,2\n1,2\n2,3\n"), None);
    }
}
