//! Finds the least error for a number of steps. It bisects the room, which is the largest allowed distance from the curve, and counts the
//! fewest steps for each room.

use super::problem::{Found, Problem};

/// Maximum number of bisections of the room (the largest allowed distance from the curve). After these, the resolution of a double is
/// exhausted.
const ROUNDS_MAX: u32 = 200;

/// The required precision of the least error.
#[derive(Clone, Copy)]
pub(super) enum Precision {
    /// A millionth of the error, or a millionth of the granularity if that is larger.
    Fine,
    /// An absolute distance, in units of the value.
    Within(f64),
}

/// Returns at most `budget` steps that are as close to the curve as possible, and at least as close as `start`.
pub(super) fn least(problem: &mut Problem, start: Found, budget: usize, precision: Precision) -> Found {
    let mut too_little = problem.off_min().max(bound(problem, start.off, budget, precision));
    if let Some(found) = problem.within(too_little, budget) {
        return if found.off < start.off { found } else { start };
    }
    let (mut enough, mut best) = (start.off, start);
    // The least error is rarely far above its bound, and a search with little room is much faster.
    let mut stride = match precision {
        Precision::Fine => problem.lattice.granularity / 4.0,
        Precision::Within(distance) => distance / 2.0,
    };
    for _ in 0..ROUNDS_MAX {
        let close = match precision {
            Precision::Fine => (enough * 1e-6).max(problem.lattice.granularity * 1e-6),
            Precision::Within(distance) => distance,
        };
        if enough - too_little <= close {
            break;
        }
        let room = too_little + stride.min((enough - too_little) / 2.0);
        stride *= 2.0;
        match problem.within(room, budget) {
            None => too_little = room,
            Some(found) => {
                stride = f64::INFINITY;
                // Only rounding can cause a distance that exceeds the room.
                enough = room.min(found.off);
                best = found;
            }
        }
    }
    best
}

/// Returns a room (a largest allowed distance from the curve) that is insufficient, or just sufficient, for `budget` steps on any grid.
fn bound(problem: &Problem, enough: f64, budget: usize, precision: Precision) -> f64 {
    let close = match precision {
        Precision::Fine => problem.lattice.granularity * 1e-7,
        Precision::Within(distance) => distance / 4.0,
    };
    let (mut too_little, mut enough) = (0.0, enough);
    for _ in 0..ROUNDS_MAX {
        let room = too_little + (enough - too_little) / 2.0;
        if enough - too_little <= close.max(enough * 1e-7) {
            break;
        }
        if problem.tubes.is_enough(room + 2.0 * problem.dust, budget) {
            enough = room
        } else {
            too_little = room
        }
    }
    too_little
}
