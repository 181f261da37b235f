//! Leases that protect nothing.

use urrcp::{Millis, Span};

use crate::fields::Reader;
use crate::finding::{Code, Place};
use crate::plan::Act;
use crate::scenario::{self, Scenario};

/// A lease that the scenario states and that is longer than what it guards: when the link breaks, the script ends first.
pub(super) fn check(findings: &mut Reader, scenario: &Scenario, acts: &[Option<Act>]) {
    let longest = acts.iter().flatten().map(|act| act.plan.duration()).max();
    if let (Some(place), Some(longest)) = (&scenario.lease_place, longest) {
        compare(findings, "the scenario", place, scenario.stop_condition.running, longest);
    }
    for (written, act) in scenario.acts.iter().zip(acts).filter_map(|(w, act)| Some((w, act.as_ref()?))) {
        for (cue, planned) in written.cues.iter().zip(&act.cues) {
            if let Some(lease) = cue.stop_condition {
                let whose = format!("the cue `{}`", cue.name);
                compare(findings, &whose, &lease_place(cue), lease.running, planned.end - planned.start);
            }
        }
    }
}

fn lease_place(cue: &scenario::Cue) -> Place {
    cue.place.of_key("stop_condition")
}

fn compare(findings: &mut Reader, whose: &str, place: &Place, lease: Option<Millis>, length: Span) {
    let Some(lease) = lease.map(Millis::span).filter(|lease| *lease > length && length > Span::ZERO) else {
        return;
    };
    let message = format!("a lease of {lease} for {whose}, whose scripts last {length} in all");
    let hint =
        Some("a robot that loses the link plays such a script to its end: shorten the lease".to_owned());
    findings.add(Code::LeaseTooLong, place.clone(), message, format!("less than {length}"), hint);
}
