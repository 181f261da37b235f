//! Draws unusual missions. Acts are repeated, scripts start before their first steps, a robot never joins, or movements last for minutes
//! while clocks drift. One seed in fifty is such a mission.

use std::collections::HashMap;

use downbeat_plan::{Choreography, DeviceScript, Way};
use fastrand::Rng;
use urrcp::{Millis, Script, Span, Step};

use super::{Drawn, faults, one_in};
use downbeat_mission::{ClockMode, Join};

/// Start time of the process of a robot that is to be absent for the whole mission, relative to the start of the mission.
const NEVER: Span = Span::from_millis(3_600_000);
/// The maximum total duration of all acts, in milliseconds.
const LAST_MAX: f64 = 120_000.0;

/// Makes a mission unusual in one of several ways, and draws its faults again.
pub(super) fn reshape(rng: &mut Rng, mut drawn: Drawn) -> Drawn {
    match rng.u8(0..4) {
        0 => repeat_acts(rng, &mut drawn),
        1 => begin_later(rng, &mut drawn.choreography),
        2 => leave_one_out(rng, &mut drawn),
        _ => last_long(rng, &mut drawn),
    }
    let faults = faults::draw_faults(rng, &drawn);
    Drawn { faults, ..drawn }
}

/// Makes the last act lead back to an earlier act or to itself. No further act begins after two to six acts have begun.
fn repeat_acts(rng: &mut Rng, drawn: &mut Drawn) {
    let acts = &mut drawn.choreography.acts;
    let back = rng.usize(0..acts.len());
    if let Some(last) = acts.last_mut() {
        last.next = Way::Act(back);
    }
    drawn.acts_max = Some(rng.u32(2..=6));
}

/// Delays the first steps of some scripts, and everything after them on the same device.
fn begin_later(rng: &mut Rng, choreography: &mut Choreography) {
    for robot in choreography.acts.iter_mut().flat_map(|act| &mut act.plan.robots) {
        let mut shifts = HashMap::new();
        for script in &mut robot.scripts {
            let shift = shifts.entry(script.device.clone()).or_insert(0.0);
            let later = if one_in(rng, 2) { f64::from(rng.u32(20..300)) } else { 0.0 };
            move_script(script, |start| start + *shift, |offset| offset + later);
            *shift += later;
        }
    }
}

/// Makes one robot absent for the whole mission.
fn leave_one_out(rng: &mut Rng, drawn: &mut Drawn) {
    let robot = rng.usize(0..drawn.robots.len());
    drawn.robots[robot].there_from = NEVER;
    drawn.join = if one_in(rng, 3) { Join::Refuse } else { Join::NextAct };
}

/// Makes all movements longer, by a factor of up to fifty that is evenly distributed on a logarithmic scale. Also adds drift to the
/// clocks that do not follow NTP.
fn last_long(rng: &mut Rng, drawn: &mut Drawn) {
    let lasts = drawn.choreography.acts.iter().map(|act| act.plan.duration().as_millis_f64()).sum::<f64>();
    let longest = (LAST_MAX / lasts.max(1.0)).clamp(1.0, 50.0);
    let longer = longest.powf(rng.f64());
    let scripts = drawn.choreography.acts.iter_mut().flat_map(|act| &mut act.plan.robots);
    for script in scripts.flat_map(|robot| &mut robot.scripts) {
        move_script(script, |start| start * longer, |offset| offset * longer);
    }
    for robot in drawn.robots.iter_mut().filter(|robot| robot.clock == ClockMode::Measured) {
        robot.settings.drift_ppm = (rng.f64() - 0.5) * 160.0;
    }
}

/// Changes the start of a script and the times of its steps. Rounds all times to whole milliseconds.
pub(super) fn move_script(
    script: &mut DeviceScript,
    start: impl Fn(f64) -> f64,
    offset: impl Fn(f64) -> f64,
) {
    let steps = script.script.steps().iter().map(|step| {
        let offset = Millis::new(offset(step.offset.get()).round()).ok()?;
        Some(Step { offset, ..step.clone() })
    });
    let steps: Option<Vec<Step>> = steps.collect();
    let moved = steps.and_then(|steps| Script::new(steps).ok());
    if let Some((moved, start)) = moved.zip(Millis::new(start(script.start.get()).round()).ok()) {
        (script.script, script.start) = (moved, start);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::{FAMILIES, UNUSUAL};
    use crate::{judge, run};
    use downbeat_mission::ActFate;

    #[test]
    fn acts_are_repeated_begin_late_lack_a_robot_or_last_for_minutes() {
        let (mut repeated, mut later, mut without, mut long) = (0, 0, 0, 0);
        for seed in (UNUSUAL..10_000).step_by(FAMILIES as usize) {
            let ran = run(seed);
            assert_eq!(judge(&ran).violations, [], "seed {seed}");
            let Some(report) = &ran.report else { continue };
            let played = report.course.iter().filter(|act| act.fate == ActFate::Played);
            repeated += usize::from(played.clone().any(|act| act.played > 1));
            let acts = &ran.drawn.choreography.acts;
            let scripts = || acts.iter().flat_map(|act| &act.plan.robots).flat_map(|robot| &robot.scripts);
            let has_played = played.count() > 0;
            let first = |script: &DeviceScript| script.script.steps().first().map(|step| step.offset.get());
            later += usize::from(has_played && scripts().any(|script| first(script) > Some(0.0)));
            without +=
                usize::from(has_played && ran.drawn.robots.iter().any(|robot| robot.there_from == NEVER));
            long += usize::from(
                has_played && acts.iter().any(|act| act.plan.duration() > Span::from_millis(5_000)),
            );
        }
        assert!(
            repeated > 5 && later > 10 && without > 5 && long > 2,
            "{:?}",
            (repeated, later, without, long)
        );
    }
}
