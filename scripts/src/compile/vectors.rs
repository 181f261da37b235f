//! Tracks whose keyframes set several values at once. Their steps are all keyframes, or as few of them as the track permits.

use std::borrow::Cow;

use urrcp::{Device, Interpolation, Span};

use super::perform::OnDevice;
use crate::motion::{Stretch, runs};
use crate::scenario::{Vector, Vectors};

/// Number of times that the tolerance is halved in the search for the least error.
const ROUNDS: u32 = 48;

/// The steps of a track, with their deviation from the written values.
pub(super) struct Thinned {
    pub(super) steps: Vectors,
    pub(super) worst: f64,
    pub(super) worst_at: Span,
}

/// Returns the steps of a track: all keyframes or, for a device that holds its values, only those that the track's tolerance or number
/// of steps requires.
pub(super) fn thinned(on: &OnDevice<'_>, vectors: &Vectors, stretch: Stretch) -> Thinned {
    let wanted = on.track.tolerance.is_some() || on.track.steps_max.is_some();
    let kept = if !(wanted && on.device.interpolation == Interpolation::Hold) {
        Kept { items: Cow::Borrowed(vectors), worst: (0.0, Span::ZERO) }
    } else {
        match on.track.steps_max {
            None => kept(on.device, vectors, tolerance(on)),
            Some(most) => closest(on.device, vectors, most as usize),
        }
    };
    let (worst, worst_at) = kept.worst;
    let starts = on.track.starts;
    let stretched = |at: Span| stretch.of(starts + at) - stretch.of(starts);
    Thinned { steps: kept.items.into_owned().moved(stretched), worst, worst_at: stretched(worst_at) }
}

/// Returns the permitted error of a track: its own tolerance or, by default, the tolerance of the script's limits.
pub(super) fn tolerance(on: &OnDevice<'_>) -> f64 {
    let script = on.device.available_control_types.script().map(|script| &script.limits);
    let own = || script.map_or(0.0, |limits| limits.max_error.unwrap_or(0.0).max(limits.granularity));
    on.track.tolerance.unwrap_or_else(own)
}

struct Kept<'a> {
    items: Cow<'a, Vectors>,
    worst: (f64, Span),
}

/// Keeps as few keyframes as the tolerance permits. Always keeps the last keyframe, because it ends the movement.
fn kept<'a>(device: &Device, vectors: &Vectors, tolerance: f64) -> Kept<'a> {
    let mut items = Vectors::default();
    let mut worst = (0.0, Span::ZERO);
    let limits = device.available_control_types.script().map(|script| &script.limits);
    let grid = |value: f64| limits.map_or(value, |limits| limits.nearest_settable(value));
    let levels = vectors.iter().take(vectors.len().saturating_sub(1)).map(|vector| vector.values);
    for run in runs(levels, grid, tolerance) {
        let Some(first) = vectors.get(run.first) else { continue };
        if run.worst > worst.0 {
            worst = (run.worst, first.at);
        }
        items.push(Vector { values: &run.values, ..first });
    }
    if let Some(last) = vectors.last() {
        items.push(last);
    }
    Kept { items: Cow::Owned(items), worst }
}

/// Keeps the keyframes that minimize the error: at most `most` keyframes or, if that is impossible, as few as possible.
fn closest<'a>(device: &Device, vectors: &Vectors, most: usize) -> Kept<'a> {
    let largest = vectors.values().iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    let (mut narrow, mut wide) = (0.0, 2.0 * largest);
    let mut best = kept(device, vectors, narrow);
    if best.items.len() <= most {
        return best;
    }
    best = kept(device, vectors, wide);
    for _ in 0..ROUNDS {
        let middle = f64::midpoint(narrow, wide);
        let found = kept(device, vectors, middle);
        if found.items.len() <= most { (wide, best) = (middle, found) } else { narrow = middle }
    }
    best
}
