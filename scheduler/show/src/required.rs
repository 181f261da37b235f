//! Formats the requirements of a scenario and their results as a table.

use super::table::{Rows, wrapped};
use downbeat_mission::requirements::{Judged, Judgement};

/// Returns a table with a row for each requirement, followed by notes on the limits of the results. Returns an empty text if nothing is
/// required.
#[must_use]
pub fn requirements_table(judged: &[Judged], columns: usize) -> String {
    if judged.is_empty() {
        return String::new();
    }
    let mut rows = Rows::new(&["requirement", "", "required", "found"], 2);
    for one in judged {
        let found = one.found.map_or_else(|| "-".to_owned(), |found| figure(found, one.unit));
        let required = format!("{} {}", one.bound, figure(one.value, one.unit));
        rows.add([one.requirement.to_owned(), one.result.text().to_owned(), required, found]);
    }
    let mut text = format!("\n{}", rows.text(columns));
    let mut notes: Vec<(&str, Vec<&str>)> = Vec::new();
    for (one, note) in judged.iter().filter_map(|one| Some((one, one.note.as_deref()?))) {
        match notes.iter_mut().find(|(known, _)| *known == note) {
            Some((_, names)) => names.push(one.requirement),
            None => notes.push((note, vec![one.requirement])),
        }
    }
    for (note, names) in notes {
        text.push_str(&wrapped(&format!("  {}: {note}", names.join(", ")), columns));
    }
    let of = |verdict| judged.iter().filter(|judged| judged.result == verdict).count();
    let sentence = match (of(Judgement::NotMet), of(Judgement::NotKnown)) {
        (0, 0) => "all requirements are met".to_owned(),
        (0, unknown) => format!("no requirement is known to be unmet; the result is unknown for {unknown}"),
        (unmet, 0) => format!("{unmet} of {} requirements NOT met", judged.len()),
        (unmet, unknown) => format!("{unmet} of {} requirements NOT met, {unknown} unknown", judged.len()),
    };
    text.push_str(&wrapped(&sentence, columns));
    text
}

/// Formats a value with its unit and at most three decimal places, or six if its magnitude is below one.
fn figure(value: f64, unit: &str) -> String {
    let shown = if value.abs() < 1.0 { format!("{value:.6}") } else { format!("{value:.3}") };
    let shown = if shown.contains('.') { shown.trim_end_matches('0').trim_end_matches('.') } else { &shown };
    if unit == "%" { format!("{shown}%") } else { format!("{shown} {unit}") }
}
