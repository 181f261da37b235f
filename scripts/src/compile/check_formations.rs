//! Checks that no two places of a formation are too close to each other.

use crate::fields::Reader;
use crate::finding::{Code, Place};
use crate::fleet::Fleet;
use crate::formation::{Point, ROUNDING, SAME, nearest_pair};
use crate::scenario::Scenario;
use crate::shown::shortened;

/// Checks formations that list their places in the file. The places of all other formations depend on the number of robots.
pub(super) fn check(findings: &mut Reader, scenario: &Scenario, fleet: &Fleet) {
    let mut written: Vec<_> = scenario.formations.iter().collect();
    written.sort_unstable_by_key(|(name, _)| name.as_str());
    for (name, written) in written {
        let Some(formation) = &written.formation else { continue };
        // An error about a cue with this formation already reports it.
        if findings.has(Code::NoWayPast, &crowded(name)) {
            continue;
        }
        let places = formation.own_count().and_then(|count| formation.places(count).ok());
        if let Some(places) = places {
            near(findings, &written.place, name, &places, fleet);
        }
    }
}

/// Returns the text that identifies the cause of findings about a formation with places that are too close to each other.
pub(super) fn crowded(name: &str) -> String {
    format!("places of {name}")
}

/// Describes the distance between two places, as the end of a sentence.
pub(super) fn apart(metres: f64, required: f64) -> String {
    if metres < SAME {
        "are at the same point".to_owned()
    } else {
        format!("are {} m apart", differing(metres, required)[0])
    }
}

/// Formats two distances in metres with enough decimals to show which one is larger, at least three.
pub(super) fn differing(a: f64, b: f64) -> [String; 2] {
    let shown = |decimals: usize| [a, b].map(|metres| format!("{metres:.decimals$}"));
    (3..9).map(shown).find(|[a, b]| a != b).unwrap_or_else(|| shown(9))
}

/// Describes the required distance between two bodies.
pub(super) fn between(found: f64, required: f64) -> String {
    let [_, required] = differing(found, required);
    format!(
        "at least {required} m between centres: the `distance` in the fleet's `space` plus the radii of both bodies"
    )
}

/// Warns about the two nearest places of a formation if no two bodies of the fleet may be that close.
pub(super) fn near(findings: &mut Reader, place: &Place, name: &str, places: &[Point], fleet: &Fleet) {
    let Some(pair) = nearest_pair(places) else { return };
    let bodies = || fleet.robots.iter().filter_map(|robot| robot.body.as_ref());
    // Without a required distance, touching bodies are not reported.
    let least = fleet.space.distance.map(|_| fleet.space.between_middles(bodies()));
    if pair.distance >= least.unwrap_or(0.0).max(SAME) - ROUNDING {
        return;
    }
    let [a, b] = pair.places;
    let [x, y, z] = places[a];
    let apart = apart(pair.distance, least.unwrap_or(0.0));
    let message = format!(
        "places {} and {} of `{}` {apart}, near [{x:.2}, {y:.2}, {z:.2}]",
        a + 1,
        b + 1,
        shortened(name)
    );
    let expected = least.map_or_else(|| "distinct places".to_owned(), |least| between(pair.distance, least));
    let hint = Some("make the formation larger, or use fewer robots".to_owned());
    findings.add(Code::NearPlaces, place.clone(), message, expected, hint);
}
