//! Draws missions such that a fault of each kind occurs at each stage of a mission. With random times, more than half of the faults would
//! occur before anything is sent or after the end. Hardly any would occur in the short stages.
//!
//! The seed determines the kind and the stage. The time comes from a run of the same mission without the fault. If only another fault
//! leads to the stage (a stop, or the end of the scheduler), that run includes it. One seed in fifty is such a mission.

use downbeat_plan::Wait;
use fastrand::Rng;
use urrcp::{Server, Span, Timestamp};

use super::{BEGINS_AT, Drawn, Fault, FaultKind, Hands, Names, draw_mission, millis, one_in, twins};
use crate::stage::{faults_met, intervals};
use crate::{Ran, Stage, play};
use downbeat_rehearsal::dry_run::BEGIN;

/// Maximum number of missions that are drawn for a seed, until the fault occurs at its stage in one of them.
pub(super) const ATTEMPTS: usize = 16;

/// The kinds of faults with the stages at which they can occur.
fn cells() -> Vec<(FaultKind, Stage)> {
    let cells = Stage::ALL.into_iter().flat_map(|stage| kinds().map(move |kind| (kind, stage)));
    cells.filter(|(kind, stage)| stage.meets(*kind)).collect()
}

/// Returns the kinds of faults to draw: all except twins, which have their own family of missions.
fn kinds() -> impl Iterator<Item = FaultKind> {
    FaultKind::ALL.into_iter().filter(|kind| *kind != FaultKind::Twin)
}

/// Replaces the faults of a mission by a fault whose kind and stage the seed determines. In half of the missions, adds another fault at
/// any stage. `index` is the number of this mission within its family.
pub(super) fn stage_faults(rng: &mut Rng, mut drawn: Drawn, index: u64) -> Drawn {
    let cells = cells();
    let (kind, stage) = cells[usize::try_from(index).unwrap_or(0) % cells.len()];
    for _ in 0..ATTEMPTS {
        if let Some(met) = with_fault(rng, drawn.clone(), kind, stage) {
            return met;
        }
        drawn = draw_mission(rng, drawn.seed);
    }
    drawn
}

/// Changes a mission so that a fault of the given kind occurs at the given stage. `None` if the mission does not reach that stage.
pub(super) fn with_fault(rng: &mut Rng, mut drawn: Drawn, kind: FaultKind, stage: Stage) -> Option<Drawn> {
    let robot = rng.usize(0..drawn.robots.len());
    if kind == FaultKind::HardwareDies {
        drawn.robots[robot].hands = Hands::Hardware;
    }
    if kind == FaultKind::Twin {
        twins::tell_what_they_know(&mut drawn.robots[robot]);
    }
    drawn.faults.clear();
    let mut drawn = bring_about(rng, drawn, stage)?;
    let at = instant(rng, &play(drawn.clone()), stage)?;
    let fault = match kind.draw(rng, robot) {
        // The number of actions is small, because the stage may end soon.
        Fault::SchedulerCrashAmid { resumed_after, .. } => {
            Fault::SchedulerCrashAmid { actions: rng.u32(0..3), resumed_after }
        }
        Fault::SchedulerPauseAmid { lasts, .. } => {
            Fault::SchedulerPauseAmid { actions: rng.u32(0..3), lasts }
        }
        other => other,
    };
    insert(&mut drawn, at, fault);
    let ran = play(drawn.clone());
    if !faults_met(&ran).contains(&(kind, stage)) {
        return None;
    }
    if one_in(rng, 2) {
        let other = rng.choice(kinds().collect::<Vec<_>>())?;
        let stage = rng.choice(Stage::ALL)?;
        let at = instant(rng, &ran, stage).unwrap_or(at);
        let robot = rng.usize(0..drawn.robots.len());
        let mut both = drawn.clone();
        insert(&mut both, at, other.draw(rng, robot));
        // The other fault may end the mission before the stage.
        if faults_met(&play(both.clone())).contains(&(kind, stage)) {
            return Some(both);
        }
    }
    Some(drawn)
}

fn insert(drawn: &mut Drawn, at: Span, fault: Fault) {
    drawn.faults.push((at, fault));
    drawn.faults.sort_by_key(|(at, _)| *at);
}

/// Adds what a mission needs to reach a stage: an act that waits, or an earlier fault while an act is under way.
fn bring_about(rng: &mut Rng, mut drawn: Drawn, stage: Stage) -> Option<Drawn> {
    let fault = match stage {
        Stage::Waits => {
            let act = rng.usize(0..drawn.choreography.acts.len());
            let comes = millis(rng, 300, 1_500);
            let waits = &mut drawn.choreography.acts[act];
            (waits.wait, waits.timeout) = (Wait::Operator, Some(comes * 2));
            drawn.comes_after[act] = Some(comes);
            return Some(drawn);
        }
        Stage::Stops => Fault::Stop,
        Stage::Transfers => {
            state_positions(&mut drawn);
            Fault::Home
        }
        Stage::Abandoned | Stage::Resumed => {
            Fault::SchedulerCrash { resumed_after: Some(millis(rng, 1, 1_500)) }
        }
        _ => return Some(drawn),
    };
    let under_way = match stage {
        // Devices that have not moved need not be moved home.
        Stage::Transfers => Stage::Plays,
        _ => rng.choice([Stage::Decided, Stage::Committed, Stage::Plays, Stage::PlaysNext])?,
    };
    let at = instant(rng, &play(drawn.clone()), under_way)?;
    insert(&mut drawn, at, fault);
    Some(drawn)
}

/// Makes all robots state their positions and have default positions, so that the mission plans acts after a stop.
fn state_positions(drawn: &mut Drawn) {
    drawn.plans_transfers = true;
    for robot in &mut drawn.robots {
        (robot.hands, robot.names, robot.lie) = (Hands::Own, Names::Echoed, None);
        (robot.block.inquiry, robot.block.pending_until, robot.block.reports) = (true, true, true);
        for device in robot.block.devices.iter_mut() {
            device.default_value.get_or_insert(BEGINS_AT);
        }
    }
}

/// Draws an instant within a stage, relative to the start of the mission. `None` if the mission did not reach the stage.
pub(super) fn instant(rng: &mut Rng, ran: &Ran, stage: Stage) -> Option<Span> {
    let intervals: Vec<(Timestamp<Server>, Timestamp<Server>)> = intervals(ran, stage);
    let (from, until) = rng.choice(intervals)?;
    let within = (until - from).as_nanos();
    (within > 1).then(|| from - BEGIN + Span::from_nanos(rng.i64(1..within)))
}

#[cfg(test)]
mod tests {
    use super::super::{FAMILIES, STAGED};
    use super::*;
    use crate::{draw, judge};

    #[test]
    fn faults_occur_at_the_stages_assigned_to_their_seeds() {
        let mut met = 0;
        for seed in (STAGED..).step_by(FAMILIES as usize).take(cells().len()) {
            let ran = play(draw(seed));
            assert_eq!(judge(&ran).violations, [], "seed {}", ran.drawn.seed);
            let cell = cells()[(seed / FAMILIES) as usize % cells().len()];
            met += usize::from(faults_met(&ran).contains(&cell));
        }
        // `soak` checks that each fault occurs at each stage.
        let of = cells().len();
        assert!(met * 10 > of * 9, "{met} of {of}");
    }

    #[test]
    fn playing_mission_passes_through_its_stages_in_order() {
        let stages = |seed| {
            let stages = crate::stage::stages(&play(draw(seed).without_faults()));
            stages.into_iter().map(|(_, stage)| stage).collect::<Vec<_>>()
        };
        let stages = (0..).map(stages).find(|stages| stages.contains(&Stage::Plays)).unwrap();
        let at = |stage| stages.iter().position(|of| *of == stage);
        let order = [Stage::Greeting, Stage::Prepared, Stage::Decided, Stage::Committed, Stage::Plays];
        let order = order.map(at);
        assert!(order.is_sorted() && order[0].is_some(), "{stages:?}");
        assert_eq!(stages.last(), Some(&Stage::Ended));
    }
}
