//! A movement that is cut into scripts: where, and when each of them begins.

use urrcp::{ControlType, DeviceId, Millis, Script, Span, Step, StopCondition};

use crate::plan::DeviceScript;

/// The scripts of one device.
pub(super) struct Cutting {
    pub(super) device: DeviceId,
    /// It moves linearly.
    pub(super) moves: bool,
    pub(super) stop_condition: StopCondition,
    /// When its movement ends, from the act's start.
    pub(super) end: Span,
}

impl Cutting {
    /// Cuts steps into scripts. Each index in `cuts` is that of the first step after a script.
    pub(super) fn split(&self, steps: &[Step], cuts: &[usize], start: Span) -> Option<Vec<DeviceScript>> {
        let mut scripts = Vec::with_capacity(cuts.len());
        let mut from = 0;
        for &to in cuts {
            let begin = match from {
                0 => start,
                // Two scripts of a device never begin at the same instant.
                from if self.moves && to - from == 1 => steps[from - 1].offset.span(),
                from => self.begin_after(&steps[from - 1], &steps[from]),
            };
            let relative =
                |step: &Step| Step { offset: Millis::from_span(step.offset.span() - begin), ..step.clone() };
            // Times out of order have been found already; then there is no plan.
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

    /// When a script begins that continues after `last` with `next`. If the value does not change until then, it begins with
    /// that step: the pause leaves room for a start that is corrected because the robot's clock has drifted. Otherwise it begins
    /// where the script before it ends.
    fn begin_after(&self, last: &Step, next: &Step) -> Span {
        match rests(last, next, self.moves) {
            true => next.offset.span(),
            false => last.offset.span(),
        }
    }
}

/// While a script plays the one behind those that the device holds is sent; that long it may take.
pub(super) const REFILL: Span = Span::from_millis(1_000);

/// Whether every script that the device cannot hold from the start can be sent in time: when one has ended there is room,
/// and those that it still holds play long enough.
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

/// A robot's clock that is measured may drift by 50 ppm, like any quartz clock: by 1.5 ms in this time. Scripts no longer than
/// this are corrected for the drift one after the other.
pub(super) const CORRECTED_EVERY: Span = Span::from_millis(30_000);

/// Where to cut steps into scripts of at most `most` steps and about this length: at the last rest in the second half of a script,
/// if there is one.
pub(super) fn cuts(steps: &[Step], most: usize, moves: bool, longest: Span) -> Vec<usize> {
    let mut cuts = Vec::with_capacity(steps.len().div_ceil(most));
    let mut from: usize = 0;
    loop {
        // A script begins where the one before ends.
        let begin = steps.get(from.saturating_sub(1)).map_or(Span::ZERO, |step| step.offset.span());
        // All scripts that are left are of about the same length, so that the last one is not a short one.
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

/// The same after every `most` steps.
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

    fn lengths(of: &[(i64, f64)], most: usize, moves: bool) -> Vec<usize> {
        let cuts = cuts(&steps(of), most, moves, Span::from_millis(30_000));
        cuts.iter().scan(0, |before, cut| Some(cut - std::mem::replace(before, *cut))).collect()
    }

    #[test]
    fn movements_are_cut_at_rests_into_scripts_of_about_one_length() {
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
