//! Several values at once: what a device is set to by each keyframe, or by as few of them as its track allows.

use urrcp::{ControlType, Device, Interpolation, Setpoint, Span};

use super::perform::OnDevice;
use crate::motion::{Stretch, runs};
use crate::scenario::Vector;

/// Halvings of the tolerance on the way to the least error.
const ROUNDS: u32 = 48;

/// Setpoints at times, and how far they are from what is written.
pub(super) struct Thinned {
    pub(super) steps: Vec<(Span, Setpoint)>,
    pub(super) worst: f64,
    pub(super) worst_at: Span,
}

/// The setpoints of a track: all keyframes; or, for a device that holds its values, those that its tolerance or its number of
/// steps leaves.
pub(super) fn thinned(
    on: &OnDevice<'_>,
    control_type: ControlType,
    vectors: &[Vector],
    stretch: Stretch,
) -> Thinned {
    let wanted = on.track.tolerance.is_some() || on.track.steps_max.is_some();
    let all = || Kept {
        items: vectors.iter().map(|vector| (vector.at, vector.values.clone())).collect(),
        worst: (0.0, Span::ZERO),
    };
    let kept = match wanted && on.device.interpolation == Interpolation::Hold {
        false => all(),
        true => match on.track.steps_max {
            None => kept(on.device, vectors, tolerance(on)),
            Some(most) => closest(on.device, vectors, most as usize),
        },
    };
    let setpoint = |(at, values): (Span, Vec<f64>)| {
        let mut setpoint = Setpoint::new(control_type, values.first().copied().unwrap_or_default());
        setpoint.more = values.get(1..).unwrap_or_default().into();
        (stretch.of(at), setpoint)
    };
    let (worst, worst_at) = kept.worst;
    Thinned { steps: kept.items.into_iter().map(setpoint).collect(), worst, worst_at: stretch.of(worst_at) }
}

/// The error that a track allows: its own tolerance, or what the script's limits name.
pub(super) fn tolerance(on: &OnDevice<'_>) -> f64 {
    let script = on.device.available_control_types.script().map(|script| &script.limits);
    let own = || script.map_or(0.0, |limits| limits.max_error.unwrap_or(0.0).max(limits.granularity));
    on.track.tolerance.unwrap_or_else(own)
}

struct Kept {
    items: Vec<(Span, Vec<f64>)>,
    worst: (f64, Span),
}

/// As few as the tolerance allows. The last keyframe is where the movement ends.
fn kept(device: &Device, vectors: &[Vector], tolerance: f64) -> Kept {
    let mut kept = Kept { items: Vec::new(), worst: (0.0, Span::ZERO) };
    let Some((last, levels)) = vectors.split_last() else { return kept };
    let limits = device.available_control_types.script().map(|script| &script.limits);
    let grid = |value: f64| limits.map_or(value, |limits| limits.nearest(value));
    for run in runs(levels.iter().map(|vector| vector.values.as_slice()), grid, tolerance) {
        let at = levels[run.first].at;
        if run.worst > kept.worst.0 {
            kept.worst = (run.worst, at);
        }
        kept.items.push((at, run.values));
    }
    kept.items.push((last.at, last.values.clone()));
    kept
}

/// The least error with so many of them, or as few as there can be.
fn closest(device: &Device, vectors: &[Vector], most: usize) -> Kept {
    let values = || vectors.iter().flat_map(|vector| &vector.values);
    let (mut narrow, mut wide) = (0.0, 2.0 * values().fold(0.0, |most: f64, value| most.max(value.abs())));
    let mut best = kept(device, vectors, narrow);
    if best.items.len() <= most {
        return best;
    }
    best = kept(device, vectors, wide);
    for _ in 0..ROUNDS {
        let middle = f64::midpoint(narrow, wide);
        let found = kept(device, vectors, middle);
        match found.items.len() <= most {
            true => (wide, best) = (middle, found),
            false => narrow = middle,
        }
    }
    best
}
