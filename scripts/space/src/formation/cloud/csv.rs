//! Reads tables of places. x, y and z are in the first three columns, or in the columns that the header names. If columns are separated
//! by semicolons or tabs, a comma is a decimal separator, as in spreadsheets of many countries.

use super::{Format, ITEMS_MAX};
use crate::formation::{Point, Unfit};

pub(super) fn read(bytes: &[u8]) -> Result<Vec<Point>, Unfit> {
    let text = std::str::from_utf8(bytes)
        .map_err(|_| Format::Csv.unfit("this is not a text file in UTF-8".to_owned()))?;
    let text = text.trim_start_matches('\u{feff}');
    let rows = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
    let rows = rows.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    let mut columns: Option<[usize; 3]> = None;
    let separator = ['\t', ';'].into_iter().find(|separator| text.contains(*separator)).unwrap_or(',');
    let mut points = Vec::new();
    for (line, row) in rows {
        let cells: Vec<&str> = row.split(separator).map(|cell| cell.trim().trim_matches('"')).collect();
        let columns = match columns {
            Some(columns) => columns,
            None => {
                if let Some(name) = named_twice(&cells) {
                    return Err(Format::Csv.unfit(format!("duplicate column `{name}` in line {line}")));
                }
                let (found, headed) = header(&cells);
                columns = Some(found);
                if headed {
                    continue;
                }
                found
            }
        };
        let number = |column: usize| cells.get(column).and_then(|cell| number(cell));
        let [Some(x), Some(y), Some(z)] = columns.map(number) else {
            return Err(Format::Csv.unfit(format!("line {line} does not have three numbers")));
        };
        points.push([x, y, z]);
        if points.len() > ITEMS_MAX {
            return Err(Format::Csv.unfit(format!("the table has more than {ITEMS_MAX} rows")));
        }
    }
    if points.is_empty() {
        Err(Format::Csv.unfit("the table has no rows of numbers".to_owned()))
    } else {
        Ok(points)
    }
}

fn number(cell: &str) -> Option<f64> {
    cell.replace(',', ".").parse().ok()
}

/// Returns the first of the coordinates x, y and z that is the name of several columns; `None` if each name is unique.
fn named_twice(cells: &[&str]) -> Option<&'static str> {
    let of_name = |name: &str| cells.iter().filter(|cell| cell.eq_ignore_ascii_case(name)).count();
    ["x", "y", "z"].into_iter().find(|name| of_name(name) > 1)
}

/// Returns the columns of x, y and z, and whether the line is a header. A line is a header if it names all three, or contains no number.
fn header(cells: &[&str]) -> ([usize; 3], bool) {
    let named = |name: &str| {
        cells.iter().position(|cell| {
            let word = cell.split(['[', '(', ' ', '_']).next().unwrap_or("");
            word.eq_ignore_ascii_case(name)
        })
    };
    match [named("x"), named("y"), named("z")] {
        [Some(x), Some(y), Some(z)] => ([x, y, z], true),
        _ => ([0, 1, 2], cells.iter().all(|cell| number(cell).is_none())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(text: &str, expected: &[Point]) {
        assert_eq!(read(text.as_bytes()).ok().as_deref(), Some(expected), "{text}");
    }

    #[test]
    fn duplicate_coordinate_column_is_reported() {
        let told = read(b"x,x,y,z\n1,2,3,4\n").err().map(|unfit| unfit.message);
        assert_eq!(told.as_deref(), Some("duplicate column `x` in line 1"));
        check("x,x_speed,y,z\n1,2,3,4\n", &[[1.0, 3.0, 4.0]]);
    }

    #[test]
    fn separator_is_the_first_present_of_tab_semicolon_and_comma() {
        check("x,y,z\n1.5,2.5,3\n", &[[1.5, 2.5, 3.0]]);
        check("1,2,3\n", &[[1.0, 2.0, 3.0]]);
        check("name;x;y;z\np1;1,5;2,5;3,5\n", &[[1.5, 2.5, 3.5]]);
        check("1,5\t2,5\t-3\n", &[[1.5, 2.5, -3.0]]);
    }

    #[test]
    fn row_without_three_numbers_is_refused() {
        assert!(read(b"1;2\n").is_err() && read(b"x,y,z\n1,2,high\n").is_err());
    }
}
