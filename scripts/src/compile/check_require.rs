//! What a scenario requires and the compiled plan alone can say: the closest approach.

use super::conflict::told;
use crate::fields::Reader;
use crate::finding::Code;
use crate::plan::Choreography;
use crate::scenario::Scenario;

/// A distance that is not kept. It stays a warning: what is required is judged by `check` and `dry-run`, and limits of the fleet
/// (`space`) are what forbids a mission.
pub(super) fn check(findings: &mut Reader, scenario: &Scenario, choreography: &Choreography) {
    let (Some(floor), Some(place)) = (scenario.requirements.closest, &scenario.closest_place) else { return };
    let Some((act, closest)) = choreography.closest().filter(|(_, closest)| !floor.holds(closest.distance))
    else {
        return;
    };
    let [a, b] = &closest.robots;
    let of_act = if act.name.is_empty() { String::new() } else { format!(" of `{}`", act.name) };
    let message = format!(
        "`{a}` and `{b}` come within {:.3} m of each other at {}{of_act}",
        closest.distance,
        told(closest.at)
    );
    let hint = Some("let one of them move later or elsewhere, or require less".to_owned());
    findings.add(Code::Unmet, place.clone(), message, format!("{} {} m", floor.word(), floor.bound()), hint);
}
