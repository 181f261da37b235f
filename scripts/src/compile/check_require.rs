//! Checks the one requirement that depends on the compiled plan: the closest approach of two bodies.

use super::conflict::told;
use crate::fields::Reader;
use crate::finding::Code;
use crate::plan::Choreography;
use crate::scenario::Scenario;

/// Warns if the closest approach is smaller than required. This is only a warning, because `check` and `dry-run` check requirements. Only
/// limits in the fleet file (`space`) prevent a mission.
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
    let hint = Some("move one of them later or elsewhere, or require a smaller distance".to_owned());
    findings.add(Code::Unmet, place.clone(), message, format!("{} {} m", floor.word(), floor.bound()), hint);
}
