//! Cuts a device's movement into scripts, and computes when these start.

use urrcp::{ControlType, Device, DeviceId, Millis, Script, Setpoint, Span, Step, StopCondition};

use crate::plan::DeviceScript;

/// What determines how the movement of one device is cut into scripts.
pub(super) struct Cutting {
    pub(super) device: DeviceId,
    /// Whether the device moves linearly.
    pub(super) moves: bool,
    pub(super) stop_condition: StopCondition,
    /// Whether the mission corrects the starts of later scripts for the drift of the robot's clock.
    pub(super) corrected: bool,
    /// End of the device's movement, since the act's start.
    pub(super) end: Span,
}

impl Cutting {
    /// Cuts steps into scripts. `cuts` contains, for each script, the index of the first step after it.
    pub(super) fn split(&self, steps: &[Step], cuts: &[usize], start: Span) -> Option<Vec<DeviceScript>> {
        let mut scripts = Vec::with_capacity(cuts.len());
        let mut from = 0;
        for &to in cuts {
            let (planned, pause) = match from {
                0 => (start, Span::ZERO),
                from => self.begin_after(&steps[from - 1], &steps[from..to]),
            };
            let begin = planned + pause;
            let relative = |step: &Step| {
                let offset = match step.offset.span() - planned {
                    offset if pause == Span::ZERO => offset,
                    offset => Span::from_millis_f64(offset.as_millis_f64() * (1.0 - CATCH_UP)),
                };
                Step { offset: Millis::from_span(offset), ..step.clone() }
            };
            // Steps whose times are out of order have already been reported; then there is no plan.
            let script = Script::new(steps[from..to].iter().map(relative).collect()).ok()?;
            scripts.push(DeviceScript {
                device: self.device.clone(),
                start: Millis::from_span(begin),
                stop_condition: self.stop_condition,
                script,
                rest: Span::ZERO,
            });
            from = to;
        }
        if let Some(last) = scripts.last_mut() {
            last.rest = (self.end - last.start.span() - last.script.duration()).max(Span::ZERO);
        }
        Some(scripts)
    }

    /// Returns the start of the script that plays `steps` after the earlier step `last`, and the pause before the first of `steps`.
    ///
    /// If the value does not change until the first step, the script begins with that step. The idle time before it leaves room to
    /// correct the start after a drift of the robot's clock. Otherwise, the script begins at the end of the previous script. If its start
    /// is to be corrected, the pause leaves the room, and the script makes up for the pause until its end.
    fn begin_after(&self, last: &Step, steps: &[Step]) -> (Span, Span) {
        let (end, first) = (last.offset.span(), &steps[0]);
        // Two scripts of a device never begin at the same instant.
        let is_alone = self.moves && steps.len() == 1;
        if rests(last, first, self.moves) && !is_alone {
            return (first.offset.span(), Span::ZERO);
        }
        let length = steps.last().map_or(Span::ZERO, |step| step.offset.span() - end);
        let pause = if self.corrected { length.as_millis_f64() * CATCH_UP } else { 0.0 };
        (end, Span::from_millis_f64(pause))
    }
}

/// Minimum playing time of the scripts that a device holds while the next script is sent.
pub(super) const REFILL: Span = Span::from_millis(1_000);

/// Whether every script that the device cannot hold from the start can be sent in time. The device has room for another script once an
/// earlier script has ended. The scripts that it then still holds must play for at least [`REFILL`].
pub(super) fn can_be_refilled(scripts: &[DeviceScript], queue: usize) -> bool {
    let end = |script: &DeviceScript| script.start.span() + script.script.duration();
    scripts.len() <= queue
        || scripts.windows(queue + 1).all(|held| held[queue].start.span() - end(&held[0]) >= REFILL)
}

/// Whether a device keeps its value from one step to the next one.
fn rests(last: &Step, next: &Step, moves: bool) -> bool {
    let is_position = |step: &Step| step.setpoint.control_type == ControlType::Position;
    is_position(last) && is_position(next) && (!moves || last.setpoint == next.setpoint)
}

/// Pause before a script that continues a movement without a rest, as a share of the script's length. Clocks drift apart more slowly than
/// this share. The mission can therefore start the script earlier if the robot's clock is slow.
const CATCH_UP: f64 = 100e-6;

/// Maximum length of scripts for robots with measured clocks. A small tolerance reduces this maximum, but not below
/// `CORRECTED_EVERY_LEAST`.
pub(super) const CORRECTED_EVERY: Span = Span::from_millis(30_000);
const CORRECTED_EVERY_LEAST: Span = Span::from_millis(1_000);

/// Maximum length of consecutive scripts whose starts are corrected for the drift of clocks. During one script, two clocks drift apart
/// by at most a third of the tolerance.
pub(super) fn longest_corrected(tolerance: Span) -> Span {
    let longest = Span::from_millis_f64(tolerance.as_millis_f64() / 3.0 / CATCH_UP);
    longest.clamp(CORRECTED_EVERY_LEAST, CORRECTED_EVERY)
}

/// Adds steps where a position changes linearly, so that the steps there are at most `longest` apart. Each added step has a value that
/// the device can take, at the instant at which the movement passes this value.
pub(super) fn divided(steps: Vec<Step>, device: &Device, longest: Span) -> Vec<Step> {
    let mut all: Vec<Step> = Vec::with_capacity(steps.len());
    for step in steps {
        if let Some(last) = all.last().filter(|last| !rests(last, &step, true)) {
            let between = between(last, &step, device, longest);
            all.extend(between);
        }
        all.push(step);
    }
    all
}

#[expect(clippy::cast_precision_loss, reason = "a number of scripts")]
fn between(last: &Step, step: &Step, device: &Device, longest: Span) -> Vec<Step> {
    let time = step.offset.span() - last.offset.span();
    let (from, to) = (&last.setpoint, &step.setpoint);
    let is_position = |at: &Setpoint| at.control_type == ControlType::Position;
    let limits = device.available_control_types.limits(ControlType::Position);
    let (Some(limits), true) = (limits, time > longest && is_position(from) && is_position(to)) else {
        return Vec::new();
    };
    let way = to.value - from.value;
    let parts = (time + longest - Span::from_nanos(1)).as_nanos() / longest.as_nanos();
    let mut further: Vec<Step> = Vec::new();
    for part in 1..parts {
        let value = limits.nearest_settable(from.value + way * part as f64 / parts as f64);
        let offset =
            last.offset.span() + Span::from_millis_f64(time.as_millis_f64() * (value - from.value) / way);
        let is_ahead = offset > further.last().unwrap_or(last).offset.span() && offset < step.offset.span();
        let setpoint = Setpoint::new(ControlType::Position, value);
        if is_ahead && device.check_in_script(&setpoint).is_ok() {
            further.push(Step {
                offset: Millis::from_span(offset),
                setpoint,
                stop_condition: step.stop_condition,
            });
        }
    }
    further
}

/// Returns where to cut steps into scripts of at most `most` steps and about the length `longest`. If the device rests in the second
/// half of a script, the cut is at the last such rest.
pub(super) fn cuts(steps: &[Step], most: usize, moves: bool, longest: Span) -> Vec<usize> {
    let mut cuts = Vec::with_capacity(steps.len().div_ceil(most));
    let mut from: usize = 0;
    loop {
        // A script begins where the previous one ends.
        let begin = steps.get(from.saturating_sub(1)).map_or(Span::ZERO, |step| step.offset.span());
        // All remaining scripts have about the same length, so that the last one is not short.
        let left = steps.last().map_or(Span::ZERO, |last| last.offset.span() - begin);
        let length =
            left / (left + longest - Span::from_nanos(1)).as_nanos().div_euclid(longest.as_nanos()).max(1);
        let end = (from + most).min(steps.len());
        let in_time = steps[from..end].partition_point(|step| step.offset.span() - begin <= length);
        let last = from + in_time.max(1);
        if last >= steps.len() {
            cuts.push(steps.len());
            return cuts;
        }
        let is_rest = |cut: &usize| rests(&steps[cut - 1], &steps[*cut], moves);
        from = (from + (last - from).div_ceil(2)..=last).rev().find(is_rest).unwrap_or(last);
        cuts.push(from);
    }
}

/// Returns cuts after every `most` steps.
pub(super) fn every(most: usize, steps: usize) -> Vec<usize> {
    (1..=steps.div_ceil(most).max(1)).map(|count| (count * most).min(steps)).collect()
}

#[cfg(test)]
mod tests {
    use urrcp::Setpoint;

    use super::*;

    fn steps(of: &[(i64, f64)]) -> Vec<Step> {
        let step = |&(seconds, value): &(i64, f64)| Step {
            offset: Millis::from_span(Span::from_millis(seconds * 1_000)),
            setpoint: Setpoint::new(ControlType::Position, value),
            stop_condition: None,
        };
        of.iter().map(step).collect()
    }

    /// Creates a device that moves linearly from 0 to 600 with this granularity.
    fn rail(granularity: f64) -> Device {
        let limits = urrcp::Limits::new(0.0, 600.0, granularity).unwrap();
        let mut rail = Device::new("rail".parse().unwrap()).with_position(limits.clone());
        rail = rail.with_scripts(urrcp::ScriptParameters::new(limits, 100));
        rail.interpolation = urrcp::Interpolation::Linear;
        rail
    }

    fn split(of: &[(i64, f64)], cuts: &[usize], corrected: bool) -> Vec<DeviceScript> {
        let steps = steps(of);
        let end = steps.last().unwrap().offset.span();
        let stop_condition = StopCondition { pending: None, running: None };
        let cutting = Cutting { device: rail(1.0).id, moves: true, stop_condition, corrected, end };
        cutting.split(&steps, cuts, Span::ZERO).unwrap()
    }

    #[test]
    fn corrected_script_without_preceding_rest_starts_later_but_ends_on_time() {
        let ramp = [(0, 0.0), (30, 30.0), (40, 40.0), (60, 60.0)];
        for (corrected, pause) in [(true, 3.0), (false, 0.0)] {
            let scripts = split(&ramp, &[2, 4], corrected);
            assert_eq!(
                (scripts[0].start.get(), scripts[0].script.duration()),
                (0.0, Span::from_millis(30_000))
            );
            assert_eq!(scripts[1].start.get(), 30_000.0 + pause);
            let offsets: Vec<_> = scripts[1].script.steps().iter().map(|step| step.offset.get()).collect();
            let slower = 1.0 - pause / 30_000.0;
            assert_eq!(offsets, [10_000.0 * slower, 30_000.0 * slower]);
        }
        // The device rests at 30 for ten seconds, which leaves enough room.
        let rests = [(0, 0.0), (30, 30.0), (40, 30.0), (60, 60.0)];
        assert_eq!(split(&rests, &[2, 4], true)[1].start.get(), 40_000.0);
        let alone = split(&[(0, 0.0), (30, 30.0), (40, 30.0)], &[2, 3], true);
        assert_eq!((alone[1].start.get(), alone[1].script.duration()), (30_001.0, Span::from_millis(9_999)));
    }

    #[test]
    fn long_linear_movement_is_divided_at_valid_device_values() {
        let divided = |of: &[(i64, f64)], granularity: f64| {
            let all = divided(steps(of), &rail(granularity), CORRECTED_EVERY);
            all.iter().map(|step| (step.offset.get() / 1_000.0, step.setpoint.value)).collect::<Vec<_>>()
        };
        let slide = [(0, 0.0), (100, 10.0)];
        assert_eq!(divided(&slide, 1.0), [(0.0, 0.0), (30.0, 3.0), (50.0, 5.0), (80.0, 8.0), (100.0, 10.0)]);
        assert_eq!(divided(&slide, 10.0), [(0.0, 0.0), (100.0, 10.0)], "no value lies between");
        let still = [(0, 10.0), (100, 10.0), (130, 0.0)];
        assert_eq!(divided(&still, 1.0), still.map(|(at, value)| (at as f64, value)));
    }

    #[test]
    fn clocks_drift_by_at_most_third_of_tolerance_within_script() {
        for (tolerance, longest) in
            [(60_000, 30_000), (9_000, 30_000), (3_000, 10_000), (300, 1_000), (100, 1_000)]
        {
            assert_eq!(longest_corrected(Span::from_micros(tolerance)), Span::from_millis(longest));
        }
    }

    fn lengths(of: &[(i64, f64)], most: usize, moves: bool) -> Vec<usize> {
        let cuts = cuts(&steps(of), most, moves, Span::from_millis(30_000));
        cuts.iter().scan(0, |before, cut| Some(cut - std::mem::replace(before, *cut))).collect()
    }

    #[test]
    fn movements_are_cut_at_rests_into_scripts_of_similar_length() {
        let ramp: Vec<_> = (0..=60).map(|at| (at, at as f64)).collect();
        assert_eq!(lengths(&ramp, 100, true), [31, 30], "without a rest");
        assert_eq!(lengths(&ramp[..32], 100, true), [16, 16], "the last script is not a short one");
        assert_eq!(lengths(&ramp, 20, true), [20, 20, 20, 1], "as many steps as a script takes");
        let mut rests = ramp.clone();
        rests[20].1 = rests[19].1;
        assert_eq!(lengths(&rests, 100, true), [20, 20, 21], "at a rest");
        assert_eq!(lengths(&ramp, 100, false), [31, 30], "a device that holds rests everywhere");
        assert_eq!(lengths(&ramp[..1], 100, true), [1]);
        assert_eq!(lengths(&[], 100, true), [0]);
        assert_eq!(lengths(&[(0, 0.0), (100, 1.0), (200, 0.0)], 100, true), [1, 1, 1], "long steps");
    }
}
