//! Steps of a device that holds its value: the longest runs, one after the other.
//!
//! A value held from one step until the next meets the chords between all samples from the first step's to the second's,
//! both included: just ahead of the second step the curve has almost its value there. What serves a run serves each part
//! of it, so runs that are as long as possible are as few as possible.

use super::Samples;
use super::problem::{Path, Problem};

/// The fewest steps within the room, and that no fewer do; `None` if there are none or more than `most`.
pub(super) fn steps(problem: &Problem, room: f64, most: usize) -> Option<(Path, usize)> {
    let last = problem.curve.times.len() - 1;
    let mut path = Path::new();
    let mut start = 0;
    while start < last {
        let (end, value) = longest_run(problem, start, room)?;
        path.push((start, value));
        start = end;
        if path.len() > most {
            return None;
        }
    }
    if let Some(value) = problem.ends.last {
        let off = (value - problem.curve.values[last]).abs() + problem.curve.gap(last);
        path.push((off <= room).then_some((last, value))?);
    }
    let steps = path.len();
    (steps <= most).then_some((path, steps))
}

/// The fewest groups of samples that follow each other and each of which one value can serve.
pub(super) fn groups(curve: &Samples, room: f64) -> usize {
    let (mut groups, mut range): (usize, Option<(f64, f64)>) = (0, None);
    // A step right at a jump needs to be close to one side of it only.
    for (_, &value) in curve.values.iter().enumerate().filter(|(k, _)| curve.gap(*k) == 0.0) {
        let (low, high) = range.map_or((value, value), |(low, high)| (value.min(low), value.max(high)));
        range = match range.is_some() && high - low <= 2.0 * room {
            true => Some((low, high)),
            false => {
                groups += 1;
                Some((value, value))
            }
        };
    }
    groups
}

/// One value for the whole curve, and the step at its end if one is prescribed.
pub(super) fn single(problem: &Problem) -> Path {
    let last = problem.curve.times.len() - 1;
    let run = longest_run(problem, 0, f64::INFINITY);
    run.map(|(_, value)| (0, value)).into_iter().chain(problem.ends.last.map(|value| (last, value))).collect()
}

/// The last sample that a value set at `start` can be held to, with the value that is closest until there.
fn longest_run(problem: &Problem, start: usize, room: f64) -> Option<(usize, f64)> {
    let values = problem.curve.values;
    let prescribed = problem.ends.first.filter(|_| start == 0);
    let (mut low, mut high) =
        (values[start] - problem.curve.gap(start), values[start] + problem.curve.gap(start));
    let mut run = None;
    for (end, &value) in values.iter().enumerate().skip(start + 1) {
        let gap = problem.curve.gap(end);
        (low, high) = (low.min(value - gap), high.max(value + gap));
        let held = prescribed.unwrap_or_else(|| problem.lattice.nearest(low + (high - low) / 2.0));
        if !(held - low <= room && high - held <= room) {
            break;
        }
        run = Some((end, held));
    }
    run
}
