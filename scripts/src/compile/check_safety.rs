//! Checks for leases that have no effect.

use urrcp::{Millis, Span};

use crate::fields::Reader;
use crate::finding::{Code, Place};
use crate::plan::Act;
use crate::scenario::{self, Scenario};

/// Warns about an explicit lease that is longer than the scripts it protects: after a broken link, the script ends first.
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
    let message =
        format!("the lease of {lease} for {whose} is longer than its scripts, which last {length} in total");
    let hint = Some(
        "shorten the lease: otherwise a robot that loses the link plays its script to the end".to_owned(),
    );
    findings.add(Code::LeaseTooLong, place.clone(), message, format!("less than {length}"), hint);
}
