//! Tables of places: x, y and z in the first three columns, or in those that the header names.

use super::{Format, ITEMS_MAX};
use crate::formation::{Point, Unfit};

pub(super) fn read(bytes: &[u8]) -> Result<Vec<Point>, Unfit> {
    let text = std::str::from_utf8(bytes)
        .map_err(|_| Format::Csv.unfit("this is not a text file in UTF-8".to_owned()))?;
    let text = text.trim_start_matches('\u{feff}');
    let rows = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
    let rows = rows.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    let mut columns: Option<[usize; 3]> = None;
    let mut points = Vec::new();
    for (line, row) in rows {
        let cells: Vec<&str> =
            row.split([',', ';', '\t']).map(|cell| cell.trim().trim_matches('"')).collect();
        let columns = match columns {
            Some(columns) => columns,
            None => {
                let (found, headed) = header(&cells);
                columns = Some(found);
                if headed {
                    continue;
                }
                found
            }
        };
        let number = |column: usize| cells.get(column).and_then(|cell| cell.parse::<f64>().ok());
        let [Some(x), Some(y), Some(z)] = columns.map(number) else {
            return Err(Format::Csv.unfit(format!("line {line} has no three numbers")));
        };
        points.push([x, y, z]);
        if points.len() > ITEMS_MAX {
            return Err(Format::Csv.unfit(format!("the table has more than {ITEMS_MAX} rows")));
        }
    }
    match points.is_empty() {
        true => Err(Format::Csv.unfit("the table has no rows of numbers".to_owned())),
        false => Ok(points),
    }
}

/// The columns of x, y and z, and whether the line is a header: a first line without any number is one.
fn header(cells: &[&str]) -> ([usize; 3], bool) {
    let named = |name: &str| {
        cells.iter().position(|cell| {
            let word = cell.split(['[', '(', ' ', '_']).next().unwrap_or("");
            word.eq_ignore_ascii_case(name)
        })
    };
    match [named("x"), named("y"), named("z")] {
        [Some(x), Some(y), Some(z)] => ([x, y, z], true),
        _ => ([0, 1, 2], cells.iter().all(|cell| cell.parse::<f64>().is_err())),
    }
}
