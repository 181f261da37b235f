//! The comparison on a page with another plan or mission. The page shows the other side in the background, and lists the differences in
//! words. Of a plan, it shows curves and cues; of a mission that was played, the values that were sent to robots.

use downbeat_scripts::{Act, Choreography};
use urrcp::Span;

use super::Rehearsed;
use super::columns::Columns;
use super::document::{Compared, Difference, Ghost, GhostCue, Lane, Mission};
use super::planned::{self, Places};
use crate::compare::listed::{Listed, listed};
use crate::compare::text::{Entry, entries};
use crate::compare::{PlanDifferences, RunDifferences};
use crate::history::History;

/// The plan that a page of a dry run is compared with.
#[derive(Debug)]
pub struct OtherPlan<'a> {
    /// The name of the file that contains the other plan or mission.
    pub name: String,
    /// The compiled plan.
    pub choreography: &'a Choreography,
    /// The differences, with this plan as the first and the plan of the page as the second.
    pub found: &'a PlanDifferences,
}

pub(super) fn compared(rehearsed: &Rehearsed<'_>, other: &OtherPlan<'_>, columns: &mut Columns) -> Compared {
    let own = rehearsed.choreography;
    let places = planned::places(&downbeat_runtime::fleet::robots_in(rehearsed.fleet, own));
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
        Some(ghost(plan, act, before, &places, columns))
    });
    Compared {
        with: other.name.clone(),
        ghosts: ghosts.collect(),
        differences: entries(other.found).into_iter().map(difference).collect(),
    }
}

fn ghost(plan: usize, act: &Act, before: &Act, places: &Places, columns: &mut Columns) -> Ghost {
    let cues = act.cues.iter().enumerate().filter_map(|(cue, own)| {
        let before = before.cues.iter().find(|before| before.name == own.name)?;
        let elsewhere = (before.start, before.end) != (own.start, own.end);
        elsewhere.then(|| GhostCue {
            cue,
            start: before.start.as_millis_f64(),
            end: before.end.as_millis_f64(),
        })
    });
    let own = planned::lanes(act, places, columns);
    let lanes = others(&own, planned::lanes(before, places, columns));
    Ghost { plan, cues: cues.collect(), lanes }
}

/// Returns those of the other side's lanes (the curves of device values) that differ from the page's own lanes. Equal lanes would be
/// hidden behind the page's own.
fn others(own: &[Lane], mut lanes: Vec<Lane>) -> Vec<Lane> {
    let key = |lane: &Lane| (lane.robot, lane.device, lane.value);
    lanes.retain(|lane| {
        let same = own.iter().find(|own| key(own) == key(lane));
        same.is_none_or(|own| {
            let mut scripts = own.scripts.iter().zip(&lane.scripts);
            own.scripts.len() != lane.scripts.len()
                || !scripts.all(|(a, b)| a.start.to_bits() == b.start.to_bits() && a.steps == b.steps)
        })
    });
    lanes
}

/// The mission that a page of another mission is compared with.
#[derive(Debug)]
pub struct OtherRun<'a> {
    /// The name of the file that contains the other plan or mission.
    pub name: String,
    /// The data of the mission.
    pub history: &'a History,
    /// The differences, with this mission as the first and the mission of the page as the second.
    pub found: &'a RunDifferences,
}

pub(super) fn compared_runs(
    own: (&History, &Mission),
    other: &OtherRun<'_>,
    columns: &mut Columns,
) -> Compared {
    let (history, mission) = own;
    let places = history.places();
    // Finds the repetition number `time` of the act `name`.
    let playing = |name: &str, time: usize| {
        let mut plans = mission.plans.iter().enumerate().filter(|(_, plan)| plan.name == name);
        plans.nth(time.saturating_sub(1)).map(|(index, _)| index)
    };
    let difference = |(time, entry): Listed| {
        let robot = entry.device.as_ref().and_then(|(robot, _)| places.robot(robot));
        let device = entry.device.as_ref().and_then(|(_, device)| places.device(robot?, device));
        Difference {
            plan: entry.act.as_ref().and_then(|act| playing(act, time)),
            at: entry.at.map(Span::as_millis_f64),
            robot,
            device,
            subject: entry.subject,
            text: entry.text,
        }
    };
    let mut times = std::collections::HashMap::new();
    let mut ghosts = Vec::new();
    for before in other.history.plans_among(&places, columns) {
        let time = times.entry(before.name.clone()).or_insert(0);
        *time += 1;
        let Some(plan) = playing(&before.name, *time) else { continue };
        let lanes = others(&mission.plans[plan].lanes, before.lanes);
        ghosts.push(Ghost { plan, cues: Vec::new(), lanes });
    }
    Compared {
        with: other.name.clone(),
        ghosts,
        differences: listed(other.found).into_iter().map(difference).collect(),
    }
}
