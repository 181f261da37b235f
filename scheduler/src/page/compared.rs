//! Another plan behind the page of a plan: its curves and cues as ghosts, and what differs in words.

use downbeat_scripts::{Act, Choreography};
use urrcp::Span;

use super::Rehearsed;
use super::columns::Columns;
use super::document::{Compared, Difference, Ghost, GhostCue};
use super::planned::{self, Places};
use crate::compare::PlanDifferences;
use crate::compare::text::{Entry, entries};

/// The plan that a page is compared with.
#[derive(Debug)]
pub(crate) struct OtherPlan<'a> {
    /// Its file.
    pub(crate) name: String,
    /// What it compiles to.
    pub(crate) choreography: &'a Choreography,
    /// From it to the plan of the page.
    pub(crate) found: &'a PlanDifferences,
}

pub(super) fn compared(rehearsed: &Rehearsed<'_>, other: &OtherPlan<'_>, columns: &mut Columns) -> Compared {
    let own = rehearsed.choreography;
    let places = planned::places(&crate::fleet::robots_in(rehearsed.fleet, own));
    let difference = |entry: Entry| {
        let plan = own.acts.iter().position(|act| Some(&act.name) == entry.act.as_ref());
        let robot = entry.device.as_ref().and_then(|(robot, _)| places.robot(robot));
        let device = entry.device.as_ref().and_then(|(_, device)| places.device(robot?, device));
        let at = entry.at.map(Span::as_millis_f64);
        Difference { plan, at, robot, device, subject: entry.subject, text: entry.text }
    };
    let acts = own.acts.iter().enumerate();
    let ghosts = acts.filter_map(|(plan, act)| {
        let before = other.choreography.acts.iter().find(|before| before.name == act.name)?;
        Some(ghost((plan, act), before, &places, columns))
    });
    Compared {
        with: other.name.clone(),
        ghosts: ghosts.collect(),
        differences: entries(other.found).into_iter().map(difference).collect(),
    }
}

fn ghost((plan, act): (usize, &Act), before: &Act, places: &Places, columns: &mut Columns) -> Ghost {
    let cues = act.cues.iter().enumerate().filter_map(|(cue, own)| {
        let before = before.cues.iter().find(|before| before.name == own.name)?;
        let elsewhere = (before.start, before.end) != (own.start, own.end);
        elsewhere.then(|| GhostCue {
            cue,
            start: before.start.as_millis_f64(),
            end: before.end.as_millis_f64(),
        })
    });
    // Where both have the same steps, nothing of the ghost could be seen.
    let own = planned::lanes(act, places, columns);
    let mut lanes = planned::lanes(before, places, columns);
    lanes.retain(|lane| {
        let key = |lane: &super::document::Lane| (lane.robot, lane.device, lane.value);
        let same = own.iter().find(|own| key(own) == key(lane));
        same.is_none_or(|own| {
            let scripts = own.scripts.iter().zip(&lane.scripts);
            own.scripts.len() != lane.scripts.len()
                || !scripts.clone().all(|(a, b)| a.start.to_bits() == b.start.to_bits() && a.steps == b.steps)
        })
    });
    Ghost { plan, cues: cues.collect(), lanes }
}
