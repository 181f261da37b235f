//! Draws missions that last for minutes, hours or days, while clocks drift. The durations are evenly distributed on a logarithmic scale. Some
//! acts wait for a long time, others play for a long time. The leases are long, so that the scheduler queries each robot only once per
//! second.

use downbeat_plan::Wait;
use downbeat_rehearsal::dry_run::BEGIN;
use fastrand::Rng;
use urrcp::{Millis, Span, StopCondition};

use super::unusual::move_script;
use super::{Drawn, faults, millis, one_in};
use downbeat_mission::ClockMode;

/// The duration of the shortest mission of this kind in milliseconds.
const SHORTEST: f64 = 60_000.0;

/// The longest missions that are drawn.
#[derive(Clone, Copy, Debug)]
pub(super) enum Longest {
    FourHours,
    TwoDays,
}

impl Longest {
    const fn millis(self) -> f64 {
        match self {
            Self::FourHours => 4.0 * 3_600_000.0,
            Self::TwoDays => 48.0 * 3_600_000.0,
        }
    }
}

/// Maximum total drift of a robot that follows NTP, in milliseconds, and its maximum rate in parts per million.
const NTP_MAX_MS: f64 = 10.0;
const NTP_MAX_PPM: f64 = 10.0;

/// The maximum start tolerance of long acts. Clocks drift beyond it within minutes.
const TOLERANCE: Span = Span::from_millis(20);

/// Makes a mission last for at least a minute.
pub(super) fn last_longer(rng: &mut Rng, mut drawn: Drawn, longest: Longest) -> Drawn {
    let lasts = SHORTEST * (longest.millis() / SHORTEST).powf(rng.f64());
    let silence = f64::from(rng.u32(6_000..30_000));
    let running = Millis::new(silence).ok().filter(|_| !one_in(rng, 4));
    for act in &mut drawn.choreography.acts {
        let plan = &mut act.plan;
        plan.stop_condition = StopCondition { running, ..plan.stop_condition };
        for script in plan.robots.iter_mut().flat_map(|robot| &mut robot.scripts) {
            script.stop_condition = StopCondition { running, ..script.stop_condition };
        }
    }
    if rng.bool() {
        wait_long(rng, &mut drawn, lasts)
    } else {
        let drifts = rng.usize(0..drawn.robots.len());
        drawn.robots[drifts].clock = ClockMode::Measured;
        play_long(&mut drawn, lasts);
        let plans = drawn.choreography.acts.iter_mut().map(|act| &mut act.plan);
        plans.for_each(|plan| plan.start_tolerance = plan.start_tolerance.min(TOLERANCE));
    }
    for robot in &mut drawn.robots {
        robot.settings.drift_ppm = match robot.clock {
            ClockMode::Measured => (if rng.bool() { 1.0 } else { -1.0 }) * (20.0 + 60.0 * rng.f64()),
            _ => (rng.f64() - 0.5) * 2.0 * (NTP_MAX_MS / lasts * 1e6).min(NTP_MAX_PPM),
        };
    }
    let faults = faults::draw_faults(rng, &drawn);
    Drawn { faults, ..drawn }
}

/// Makes acts wait for a long time, for the operator or for an instant.
fn wait_long(rng: &mut Rng, drawn: &mut Drawn, lasts: f64) {
    let acts = drawn.choreography.acts.len();
    let each = lasts / acts as f64;
    for index in 0..acts {
        let act = &mut drawn.choreography.acts[index];
        if rng.bool() {
            let at = Span::from_millis_f64(each * (index as f64 + rng.f64())) + millis(rng, 500, 1_500);
            (act.wait, act.timeout, drawn.comes_after[index]) = (Wait::Instant(BEGIN + at), None, None);
        } else {
            let comes = Span::from_millis_f64(each * rng.f64());
            (act.wait, act.timeout) =
                (Wait::Operator, Some(comes + millis(rng, -200, 4_000).max(Span::ZERO)));
            drawn.comes_after[index] = Some(comes);
        }
    }
}

/// Slows down all movements, so that the acts last for `lasts` milliseconds in total.
fn play_long(drawn: &mut Drawn, lasts: f64) {
    let plays = drawn.choreography.acts.iter().map(|act| act.plan.duration().as_millis_f64()).sum::<f64>();
    let longer = (lasts / plays.max(1.0)).max(1.0);
    let robots = drawn.choreography.acts.iter_mut().flat_map(|act| &mut act.plan.robots);
    for script in robots.flat_map(|robot| &mut robot.scripts) {
        move_script(script, |start| start * longer, |offset| offset * longer);
    }
}

#[cfg(test)]
mod tests {
    use super::super::{FAMILIES, HOURS, HOURS_ONE_IN, reached};
    use super::*;
    use crate::{Situation, draw};

    #[test]
    fn missions_last_for_hours_while_clocks_drift() {
        let (below, every) = (10_000, FAMILIES * HOURS_ONE_IN);
        let longest = (HOURS..below).step_by(every as usize).map(|seed| draw(seed).lasts()).max();
        assert!(longest > Some(Span::from_millis(3_600_000)), "{longest:?}");
        let reached = reached((HOURS, below), every);
        assert!(reached.contains_key(&Situation::DriftsApart), "{reached:?}");
    }
}
