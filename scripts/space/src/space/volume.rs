//! The largest distance by which a body leaves a volume in which it must stay.

use super::Volume;
use super::closest::{Approach, Mover};
use super::path::Knot;
use super::place::Place;
use super::solid::Solid;
use super::way::EXACT;

/// Maximum number of checks between two knots.
const LOOKS_MAX: f64 = 1e4;
/// Largest distance in metres by which a body may leave a volume because of rounding.
const ROUNDING: f64 = 5e-7;

/// Returns the largest distance by which a body is outside a volume, and its time. `None` if the body never leaves the volume.
///
/// Between two checks, a turning body may be further outside than at both of them, by at most `EXACT`: an eighth of the second derivative
/// of the movement of its points times the time squared.
pub fn furthest_out(mover: &Mover, volume: &Volume) -> Option<Approach> {
    let mut worst = Approach { at: 0.0, distance: 0.0 };
    let mut note = |at: f64, place: &Place| {
        let distance = out(mover.solid(), place, volume);
        if distance > worst.distance + ROUNDING {
            worst = Approach { at, distance };
        }
    };
    for pair in mover.path().knots().windows(2) {
        let [from, to]: [&Knot; 2] = [&pair[0], &pair[1]];
        let looks = looks(mover.solid(), from, to);
        for look in 0..looks {
            let s = f64::from(look) / f64::from(looks);
            note(from.at + s * (to.at - from.at), &from.place.towards(&to.place, s));
        }
    }
    if let Some(last) = mover.path().knots().last() {
        note(last.at, &last.place);
    }
    (worst.distance > 0.0).then_some(worst)
}

/// Returns the number of checks between two knots, so that the movement bends by at most [`EXACT`] between two checks.
fn looks(solid: &Solid, from: &Knot, to: &Knot) -> u32 {
    let bend = solid.sways(&from.place, &to.place).iter().map(|sway| sway.bend).fold(0.0, f64::max);
    (bend / (8.0 * EXACT)).sqrt().ceil().clamp(1.0, LOOKS_MAX) as u32
}

fn out(solid: &Solid, place: &Place, volume: &Volume) -> f64 {
    let parts = solid.parts(place);
    let sides = parts.iter().flat_map(|part| {
        let ([least, most], radius) = (part.hull().map(|corner| corner.to_array()), part.radius);
        (0..3).map(move |i| (volume.least[i] - least[i]).max(most[i] - volume.most[i]) + radius)
    });
    sides.fold(f64::NEG_INFINITY, f64::max)
}
