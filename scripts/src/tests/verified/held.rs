//! Finds the fewest values with which a device that holds its values can follow a movement, by trying all values in many short intervals.

use proptest::prelude::*;

use super::{Change, Ease, Form, Movement, final_value};
use crate::DeviceUse;

/// Number of intervals of a section; `PLACES` is the number of samples in each interval.
const CUTS: usize = 48;
const PLACES: usize = 4;

/// The possible values of a device that holds its values: from the first number to the second one, in multiples of the third one.
#[derive(Clone, Copy, Debug)]
pub(in crate::tests) struct Values(
    pub(in crate::tests) f64,
    pub(in crate::tests) f64,
    pub(in crate::tests) f64,
);

impl Values {
    pub(in crate::tests) fn nearest(self, value: f64) -> f64 {
        let Self(min, max, granularity) = self;
        let (low, high) = ((min / granularity - 1e-9).ceil(), (max / granularity + 1e-9).floor());
        (value / granularity).round().clamp(low, high) * granularity
    }

    /// Whether a value is exactly in the middle between two grid values.
    fn is_between(self, value: f64) -> bool {
        ((value / self.2).rem_euclid(1.0) - 0.5).abs() < 1e-6
    }

    /// Returns all possible values of the device from `low` to `high`.
    fn all(self, low: f64, high: f64) -> Vec<f64> {
        let (low, high) = (self.nearest(low), self.nearest(high));
        let count = ((high - low) / self.2).round() as usize;
        (0..=count).map(|k| low + k as f64 * self.2).collect()
    }
}

/// A movement, divided into short intervals, each with its smallest and its largest value.
pub(in crate::tests) struct Held {
    times: Vec<(f64, f64)>,
    /// Amount by which the movement may exceed the sampled smallest and largest values.
    missed: f64,
    /// The value of the first step; `None` if the movement begins with a constant value, so that this value is not fixed.
    first: Option<f64>,
    last: f64,
    /// Deviation of the device's last value from the written last value.
    off_at_end: f64,
    /// Whether the first or last value is in the middle between two grid values, so that rounding decides which one the device takes.
    is_unclear: bool,
    values: Values,
}

impl Held {
    pub(in crate::tests) fn of(movement: &Movement, change: &Change, values: Values) -> Self {
        let last = final_value(movement, change);
        let is_unclear = values.is_between(last);
        let mut held =
            Self { times: Vec::new(), missed: 0.0, first: None, last, off_at_end: 0.0, is_unclear, values };
        let mut ways: Vec<_> = movement.ways.iter().collect();
        if change.backwards {
            ways.reverse();
        }
        let is_level = |form: &Form| matches!(form, Form::Eased(Ease::Step, ..));
        for turn in 0..change.turns {
            for way in &ways {
                let seconds = (way.end - way.begin) / 1_000.0;
                let at = |k: usize| {
                    let s = k as f64 / (CUTS * PLACES) as f64;
                    change.of(way.form.at(if change.backwards { 1.0 - s } else { s }, seconds))
                };
                let all: Vec<f64> = (0..=CUTS * PLACES).map(at).collect();
                if held.times.is_empty() && !is_level(&way.form) {
                    held.first = Some(values.nearest(all[0]));
                    held.is_unclear |= values.is_between(all[0]);
                }
                // Between two samples, a curve exceeds both by about an eighth of its bend there.
                let bends = all.windows(3).map(|three| (three[0] - 2.0 * three[1] + three[2]).abs());
                held.missed = bends.fold(held.missed, |most, bend| most.max(bend / 5.0));
                for places in all.windows(PLACES + 1).step_by(PLACES) {
                    held.stays(places);
                }
            }
            if turn + 1 < change.turns && change.pause.is_some_and(|pause| pause > 0.0) {
                held.stays(&[held.last]);
            }
        }
        held.last = values.nearest(last);
        held.off_at_end = (held.last - last).abs();
        held
    }

    fn stays(&mut self, places: &[f64]) {
        let low = places.iter().copied().fold(f64::INFINITY, f64::min);
        let high = places.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        self.times.push((low, high));
    }

    /// Returns the smallest number of steps that stay within a tolerance, if values change only between two intervals. `None` if no such
    /// number is known.
    pub(in crate::tests) fn suffice(&self, tolerance: f64) -> Option<usize> {
        if self.is_unclear || self.off_at_end > tolerance {
            return None;
        }
        let room = tolerance - self.missed;
        let low = self.times.iter().map(|time| time.0).fold(self.last, f64::min);
        let high = self.times.iter().map(|time| time.1).fold(self.last, f64::max);
        let all = self.values.all(low - tolerance, high + tolerance);
        let mut steps: Vec<Option<usize>> = Vec::new();
        for (low, high) in &self.times {
            let begins =
                |value: f64| self.first.is_none_or(|first| (first - value).abs() < 1e-9).then_some(1);
            let least = steps.iter().flatten().min().copied();
            let with = |(k, value): (usize, &f64)| {
                let serves = value - low <= room && high - value <= room;
                let anew = if steps.is_empty() { begins(*value) } else { least.map(|least| least + 1) };
                let stays = steps.get(k).copied().flatten();
                stays.into_iter().chain(anew).min().filter(|_| serves)
            };
            steps = all.iter().enumerate().map(with).collect();
        }
        let ends = |(steps, value): (&Option<usize>, &f64)| {
            steps.map(|steps| steps + usize::from((value - self.last).abs() > 1e-9))
        };
        steps.iter().zip(&all).filter_map(ends).min()
    }
}

/// Checks the steps of a movement on a device that holds its values, if the movement is fitted. The number of steps and its reported
/// bound may not exceed the sufficient number. No other `most` steps may have an error that is more than three percent smaller.
pub(in crate::tests) fn as_few_as_can_be(
    used: &DeviceUse,
    held: &Held,
    tolerance: f64,
    most: Option<usize>,
) -> Result<(), TestCaseError> {
    let within = if most.is_some() { used.worst_error * (1.0 + 1e-6) + 1e-9 } else { tolerance };
    let suffice = held.suffice(within);
    prop_assert!(suffice.is_none_or(|suffice| used.at_least <= suffice), "{used:?}, but {suffice:?} suffice");
    let Some(most) = most else {
        prop_assert!(
            suffice.is_none_or(|suffice| used.steps <= suffice),
            "{used:?}, but {suffice:?} suffice"
        );
        return Ok(());
    };
    let closer = held.suffice(used.worst_error * 0.97 - 1e-9);
    prop_assert!(closer.is_none_or(|closer| closer > most), "{used:?}, but {closer:?} are closer");
    Ok(())
}
