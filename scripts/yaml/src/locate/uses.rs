//! Lists the uses through which the place of a finding was read, for the end of its message: ` (in the move `wave`, used by the move
//! `greet` in line 12)`.

use std::borrow::Borrow;

use super::lines_of;
use crate::finding::{Pending, Place};
use crate::source::Source;

/// Maximum number of nested uses that a message lists, beginning with the innermost.
const USES_MAX: usize = 8;

/// Returns, for each finding, the text that lists the uses and the related places in other files; empty for most findings.
pub(super) fn told<S: Borrow<Source>>(sources: &[S], pending: &[Pending]) -> Vec<String> {
    let places: Vec<&Place> = pending.iter().flat_map(mentioned).collect();
    if places.is_empty() {
        return vec![String::new(); pending.len()];
    }
    let mut lines = lines_of(sources, &places).into_iter().map(|(first, _)| first);
    let told = |finding: &Pending| {
        let mut line = |place: &Place| {
            let number = lines.next().unwrap_or(1);
            match sources.get(usize::from(place.file)) {
                Some(other) if place.file != finding.place.file => {
                    format!("line {number} of {}", other.borrow().name)
                }
                _ => format!("line {number}"),
            }
        };
        let mut parts: Vec<String> = Vec::new();
        for (index, used) in uses(&finding.place).enumerate() {
            let head = if index == 0 { format!("in {}", used.what) } else { String::new() };
            let by = used.by.as_ref().map(|by| format!(" by {by}")).unwrap_or_default();
            let use_ = format!("used{by} in {}", line(&used.place));
            parts.extend((index == 0).then_some(head));
            parts.push(use_);
        }
        for (place, message) in elsewhere(finding) {
            parts.push(format!("{message} in {}", line(place)));
        }
        if parts.is_empty() { String::new() } else { format!(" ({})", parts.join(", ")) }
    };
    pending.iter().map(told).collect()
}

fn uses(place: &Place) -> impl Iterator<Item = &crate::finding::Use> {
    std::iter::successors(place.used.as_deref(), |used| used.place.used.as_deref()).take(USES_MAX)
}

/// Returns the related places that are in other files than the finding, and therefore cannot be shown next to it.
fn elsewhere(finding: &Pending) -> impl Iterator<Item = &(Place, String)> {
    finding.related.iter().filter(|(place, _)| place.file != finding.place.file)
}

/// Returns the places that the text for a finding mentions, in order: those of its uses, then those in other files.
fn mentioned(finding: &Pending) -> impl Iterator<Item = &Place> {
    uses(&finding.place).map(|used| &used.place).chain(elsewhere(finding).map(|(place, _)| place))
}
