//! Converts a movement to steps of a device. Courses that the device itself interpolates are kept as written; the others are fitted with
//! the fewest steps within the tolerance.

mod hold;

use std::borrow::Cow;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

use urrcp::{ControlType, Device, Interpolation, Limits, Span};

use super::{Between, Curve, Easing, Function, Knot, Shape};
use crate::fit::{self, Ends, Fit, Grid, Samples};

/// Maximum number of samples that are fitted together: longer curves are cut at a knot, and the parts are fitted separately.
const RUN_SAMPLES_MAX: f64 = 16_384.0;
/// Maximum number of samples between two knots.
const SAMPLES_MAX: f64 = 65_536.0;
/// Minimum number of samples between two knots.
const SAMPLES_MIN: f64 = 16.0;

/// The properties of a device that matter for motion.
#[derive(Clone, Copy)]
pub struct Actuator<'a> {
    /// The device's interpolation between two steps.
    pub interpolation: Interpolation,
    /// The quantity that the device's steps set.
    pub control_type: ControlType,
    /// The limits of the device; `None` if it has none.
    pub limits: Option<&'a Limits>,
    /// Maximum number of steps; the conversion stops when a movement needs more.
    pub room: usize,
}

/// A value that a step sets, and its time relative to the start of the cue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Value {
    /// The time of the step.
    pub at: Span,
    /// The value that the device is set to.
    pub to: f64,
}

/// The steps of one movement on one device.
#[derive(Clone, Debug, Default)]
pub struct Fitted {
    pub steps: Vec<Value>,
    interpolation: Interpolation,
    /// The error of the last step. It is kept separately because the step may be removed again.
    last_off: f64,
    /// The largest difference from the movement as written; `worst_at` is its time.
    pub worst: f64,
    pub worst_at: Span,
    /// Lower bound of the number of steps, wherever they are placed.
    pub at_least: usize,
    /// The smallest tolerance that can be met, if the requested one cannot; otherwise `None`.
    pub needed: Option<f64>,
}

/// A cache of fits, so that repeated movements are fitted once.
#[derive(Default)]
pub struct Fits(HashMap<Vec<u64>, Arc<Result<Fit, f64>>>);

impl Fits {
    /// Adds fits from another cache.
    pub fn extend(&mut self, other: Self) {
        self.0.extend(other.0);
    }
}

/// How the course between two knots is converted to steps.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Means {
    /// A single step at the knot; the device's own interpolation does the rest.
    Own,
    /// The device holds the old value, then takes the new one.
    Jump,
    /// The device takes the new value, then holds it.
    Early,
    /// The course is fitted separately, with exact values at both ends.
    Alone,
    /// The course is fitted together with adjacent `Joined` courses.
    Joined,
    /// For a device that holds its value: the course is fitted together with adjacent courses, both constant ones and curves.
    Held,
    /// The value does not change during the course.
    Still,
}

/// A movement, with the values that the device is set to at its knots.
pub struct Played<'a> {
    /// The movement as written.
    pub curve: &'a Curve,
    /// The value that the device is set to at each knot; empty if the written values are used.
    set: Vec<f64>,
}

impl<'a> Played<'a> {
    /// Creates a movement; `set` is empty if the written values are used.
    pub fn new(curve: &'a Curve, set: Vec<f64>) -> Self {
        Self { curve, set }
    }

    fn set(&self, index: usize) -> f64 {
        self.set.get(index).copied().unwrap_or(self.curve.knots[index].to)
    }

    /// The movement, with the values that the device is set to in place of the written ones.
    pub fn as_set(&self) -> Cow<'a, Curve> {
        if self.set.is_empty() {
            return Cow::Borrowed(self.curve);
        }
        let mut curve = self.curve.clone();
        curve.knots.iter_mut().zip(&self.set).for_each(|(knot, set)| knot.to = *set);
        Cow::Owned(curve)
    }
}

/// A movement with the requirements for its steps.
struct Tracked<'a> {
    played: &'a Played<'a>,
    tolerance: f64,
    thinned: bool,
}

impl<'a> Actuator<'a> {
    /// Creates an actuator for a device. `limits` describe the values that scripts can set; `room` is the maximum number of steps.
    pub fn new(device: &Device, control_type: ControlType, limits: Option<&'a Limits>, room: usize) -> Self {
        Self { interpolation: device.interpolation, control_type, limits, room }
    }

    fn moves(&self) -> bool {
        self.interpolation == Interpolation::Linear
    }

    /// Whether the movement begins with a move to its first knot that may start from any position.
    pub fn moves_from_anywhere(&self, curve: &Curve) -> bool {
        let first = curve.knots.first();
        first.is_some_and(|first| {
            first.at > Span::ZERO
                && self.moves()
                && matches!(first.shape, Shape::Own | Shape::OwnReversed | Shape::Eased(Easing::Linear))
        })
    }

    /// Whether the course to the first knot needs an initial value, but the movement has none.
    pub fn lacks_beginning(&self, curve: &Curve) -> bool {
        let Some(first) = curve.knots.first() else { return false };
        let waits = match first.shape {
            Shape::Eased(Easing::Step) => true,
            Shape::Eased(_) => false,
            _ => true,
        };
        first.at > Span::ZERO && !waits && !self.moves_from_anywhere(curve)
    }

    /// Returns the default tolerance: the device's limit `max_error`, or one granularity if that is larger.
    pub fn tolerance(&self) -> f64 {
        self.limits.map_or(0.0, |limits| limits.max_error.unwrap_or(0.0).max(limits.granularity))
    }

    /// Converts a movement to the fewest steps within the tolerance. Keyframes that the device can play unchanged are kept, unless
    /// `thinned` permits omitting some.
    pub fn steps(&self, played: &Played<'_>, tolerance: f64, thinned: bool, fits: &mut Fits) -> Fitted {
        let knots = &played.curve.knots;
        let track = Tracked { played, tolerance, thinned };
        let mut fitted = Fitted::new(self.interpolation, knots.len().min(self.room));
        if !knots.is_empty() {
            fitted.put(knots[0].at, self.settled(played, 0), knots[0].to);
        }
        let mut index = 1;
        let (mut cut, mut was_still) = (false, false);
        while index < knots.len() && fitted.steps.len() <= self.room {
            let (before, knot) = (&knots[index - 1], &knots[index]);
            let (set_before, set) = (self.settled(played, index - 1), self.settled(played, index));
            let means = self.way(&track, index);
            let mut end = index + 1;
            // A constant section ends with a step here, unless the next course implies it.
            if was_still && !matches!(means, Means::Still | Means::Jump) {
                fitted.put(before.at, set_before, before.to);
            }
            was_still = means == Means::Still;
            match means {
                Means::Own => fitted.put(knot.at, set, knot.to),
                Means::Jump => {
                    if self.moves() && set != set_before {
                        fitted.put(knot.at, set_before, before.to);
                    }
                    fitted.put(knot.at, set, knot.to);
                }
                Means::Early => {
                    if self.moves() && set != set_before {
                        fitted.put(before.at, set_before, before.to);
                    }
                    fitted.put(before.at, set, knot.to);
                    if self.moves() {
                        fitted.put(knot.at, set, knot.to);
                    }
                }
                Means::Still => {}
                Means::Alone if self.moves() => self.fit(&track, index..end, &mut fitted, fits),
                Means::Alone => self.hold(&track, index..end, &mut fitted, fits),
                Means::Joined => {
                    end = self.run_end(&track, index);
                    self.fit(&track, index..end, &mut fitted, fits);
                    // A straight piece may extend across a cut.
                    fitted.at_least -= usize::from(cut);
                }
                Means::Held => {
                    end = (index + 1..knots.len())
                        .find(|next| self.way(&track, *next) != Means::Held)
                        .unwrap_or(knots.len());
                    self.hold(&track, index..end, &mut fitted, fits);
                }
            }
            cut = means == Means::Joined && end < knots.len() && self.way(&track, end) == Means::Joined;
            index = end;
        }
        fitted.settle();
        if !self.moves() && self.control_type == ControlType::Position {
            fitted.drop_idle();
        }
        fitted
    }

    /// Returns how the course to a knot is converted to steps. A course that takes no time does not interrupt the fit if its change of
    /// the value is within the tolerance.
    fn way(&self, track: &Tracked<'_>, index: usize) -> Means {
        let knots = &track.played.curve.knots;
        let means = |index: usize| self.means(knots, index, track.thinned);
        if knots[index].at > knots[index - 1].at {
            return means(index);
        }
        let lasts = |index: &usize| knots[*index].at > knots[*index - 1].at;
        let (before, after) = ((1..index).rev().find(lasts), (index..knots.len()).find(lasts));
        let gap = (knots[index].to - knots[index - 1].to).abs();
        let granularity = self.limits.map_or(0.0, |limits| limits.granularity);
        // The samples between must leave room for a value on the grid.
        let closes = gap <= track.tolerance && 1.9 * track.tolerance - gap >= granularity;
        match (before.map(means), after.map(means)) {
            (Some(Means::Joined), Some(Means::Joined)) if closes => Means::Joined,
            (Some(Means::Held), Some(Means::Held) | None) => Means::Held,
            _ => Means::Own,
        }
    }

    /// Returns the index after the last of the knots whose courses are fitted together with the course to the knot `index`.
    fn run_end(&self, track: &Tracked<'_>, index: usize) -> usize {
        let knots = &track.played.curve.knots;
        let mut samples = 0.0;
        let mut end = index;
        while end < knots.len() && self.way(track, end) == Means::Joined {
            if knots[end].at > knots[end - 1].at {
                samples += self.parts(track.played.curve, end, track.tolerance);
                if samples > RUN_SAMPLES_MAX && end > index {
                    break;
                }
            }
            end += 1;
        }
        end
    }

    /// The value that the device is set to at a knot: the written value if there is one, otherwise the nearest grid value.
    fn settled(&self, played: &Played<'_>, index: usize) -> f64 {
        if played.curve.knots[index].shape.is_written() {
            played.set(index)
        } else {
            self.on_grid(played.set(index))
        }
    }

    /// Finds by bisection the smallest tolerance that at most `most` steps can meet, but not less than `tolerance` or half of the
    /// granularity, whichever is smaller. Returns that tolerance and the steps. If `most` steps meet no tolerance, returns the fewest
    /// possible steps.
    pub fn least_error(
        &self,
        played: &Played<'_>,
        tolerance: f64,
        most: usize,
        fits: &mut Fits,
    ) -> (f64, Fitted) {
        let curve = played.curve;
        let fit = |tolerance: f64, fits: &mut Fits| self.steps(played, tolerance, true, fits);
        let enough = |fitted: &Fitted| fitted.steps.len() <= most.min(self.room) && fitted.needed.is_none();
        let finest = self.limits.map_or(0.0, |limits| limits.granularity / 2.0).min(tolerance);
        let values = curve.knots.iter().map(|knot| knot.to);
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let swing = |knot: &super::Knot| match knot.shape {
            Shape::Function { gain, .. } => gain.abs(),
            _ => 0.0,
        };
        let swings = curve.knots.iter().map(swing).fold(0.0, f64::max);
        let mut wide = (high - low + swings).max(tolerance).max(finest) * 2.0;
        let mut best = fit(wide, fits);
        let mut narrow = finest;
        for _ in 0..32 {
            let middle = f64::midpoint(narrow, wide);
            if wide - narrow <= 1e-4 * wide || !enough(&best) {
                break;
            }
            let fitted = fit(middle, fits);
            if enough(&fitted) { (wide, best) = (middle, fitted) } else { narrow = middle }
        }
        (wide, best)
    }

    fn on_grid(&self, value: f64) -> f64 {
        self.limits.map_or(value, |limits| limits.nearest_settable(value))
    }

    /// How a course of nonzero duration is converted to steps.
    fn means(&self, knots: &[Knot], index: usize, thinned: bool) -> Means {
        use Between::{Linear, OwnReversed, Step};
        let knot = &knots[index];
        // Of several equal values in sequence, only the last is needed.
        let still = || knot.to == knots[index - 1].to && index + 1 < knots.len();
        match (knot.shape, self.interpolation) {
            (Shape::Meets, _) => Means::Own,
            (_, Interpolation::Hold) if thinned => Means::Held,
            (Shape::Function { .. } | Shape::Sampled(_), Interpolation::Hold) => Means::Held,
            (Shape::Own | Shape::OwnReversed | Shape::Eased(Easing::Linear), Interpolation::Linear) => {
                if thinned {
                    Means::Joined
                } else {
                    Means::Own
                }
            }
            (Shape::Function { .. } | Shape::Sampled(Linear), _) => Means::Joined,
            (Shape::Sampled(Between::Own | OwnReversed), Interpolation::Linear) => Means::Joined,
            (Shape::Sampled(_), Interpolation::Linear) if still() => Means::Still,
            (Shape::Eased(Easing::Step), Interpolation::Linear) if thinned && still() => Means::Still,
            (Shape::Own | Shape::Eased(Easing::Step) | Shape::Sampled(Step), _) => Means::Jump,
            (Shape::Eased(_), _) => {
                if thinned {
                    Means::Joined
                } else {
                    Means::Alone
                }
            }
            (Shape::OwnReversed | Shape::Early | Shape::Sampled(_), _) => Means::Early,
        }
    }

    /// Fits the courses to the knots of `run`, and adds all steps but the first, which already exists.
    fn fit(&self, track: &Tracked<'_>, run: Range<usize>, fitted: &mut Fitted, fits: &mut Fits) {
        let (played, tolerance) = (track.played, track.tolerance);
        let knots = &played.curve.knots;
        let (begin, last) = (knots[run.start - 1].at, run.end - 1);
        let Some(limits) = self.limits else {
            return run.for_each(|index| fitted.put(knots[index].at, played.set(index), knots[index].to));
        };
        let ends = Ends {
            first: Some(self.on_grid(played.set(run.start - 1))),
            last: Some(self.on_grid(played.set(last))),
        };
        let key = self.key(played.curve, run.clone(), tolerance, ends);
        let fit = fits.0.entry(key).or_insert_with(|| {
            let sampled = self.sample(played.curve, run.clone(), tolerance);
            let Sampled { times, values, gaps, slack } = &sampled;
            let samples = Samples { times, values, slack: *slack, gaps };
            let fit = fit::fewest(&samples, &Grid::of(limits), tolerance, ends);
            let at_least = fit::steps_at_least(&samples, tolerance).unwrap_or(0).max(2);
            Arc::new(fit.map(|fit| Fit { at_least: at_least.min(fit.steps.len()), ..fit }).map_err(|unfit| {
                match unfit {
                    fit::Unfit::Tolerance { smallest, .. } => smallest,
                    _ => f64::INFINITY,
                }
            }))
        });
        match fit.as_ref() {
            Ok(fit) => fitted.add(begin, fit, limits.granularity),
            Err(needed) => {
                fitted.needs(*needed);
                fitted.put(knots[last].at, self.settled(played, last), knots[last].to);
            }
        }
    }

    fn sample(&self, curve: &Curve, run: Range<usize>, tolerance: f64) -> Sampled {
        let begin = curve.knots[run.start - 1].at;
        let first = curve.value(run.start, 0.0);
        let mut sampled = Sampled { times: vec![0.0], values: vec![first], gaps: Vec::new(), slack: 0.0 };
        for index in run {
            let (from, to) = (curve.knots[index - 1].at, curve.knots[index].at);
            if from == to {
                sampled.meets(curve.knots[index - 1].to, curve.knots[index].to);
                continue;
            }
            let parts = self.parts(curve, index, tolerance);
            let (_, curvature) = curve.rates(index);
            let seconds = (to - from).as_millis_f64() / 1_000.0;
            sampled.slack = sampled.slack.max(curvature * (seconds / parts).powi(2) / 8.0);
            let mut part = 1.0;
            while part <= parts {
                // Rounded to whole nanoseconds, like steps.
                let at = Span::from_millis_f64((to - from).as_millis_f64() * part / parts);
                let s = if part < parts { at.as_millis_f64() / (to - from).as_millis_f64() } else { 1.0 };
                let time = (from + at - begin).as_millis_f64();
                if sampled.times.last().is_some_and(|last| time > *last) {
                    sampled.times.push(time);
                    sampled.values.push(curve.value(index, s));
                }
                part += 1.0;
            }
        }
        sampled
    }

    /// Returns the number of equal parts into which a course is sampled. Linear interpolation then has an error of at most 1/32 of the
    /// tolerance. This error is the curvature times the part's length squared over 8 (de Boor, A Practical Guide to Splines, chapter
    /// III).
    fn parts(&self, curve: &Curve, index: usize, tolerance: f64) -> f64 {
        let seconds = (curve.knots[index].at - curve.knots[index - 1].at).as_millis_f64() / 1_000.0;
        let (_, curvature) = curve.rates(index);
        if curvature == 0.0 {
            return 1.0;
        }
        let parts = seconds * (4.0 * curvature / tolerance).sqrt();
        // Parts of 1 µs are fine enough for any device.
        parts.ceil().min(seconds * 1e6).clamp(SAMPLES_MIN, SAMPLES_MAX)
    }

    /// All data that the fit of a run depends on, as a key for the cache.
    fn key(&self, curve: &Curve, run: Range<usize>, tolerance: f64, ends: Ends) -> Vec<u64> {
        let limits = self.limits.map_or([0.0; 3], |l| [l.min_value, l.max_value, l.granularity]);
        let mut key =
            vec![u64::from(self.moves()), tolerance.to_bits(), curve.knots[run.start - 1].to.to_bits()];
        key.extend(limits.map(f64::to_bits));
        key.extend([ends.first, ends.last].map(|end| end.unwrap_or(f64::NAN).to_bits()));
        for index in run {
            let knot = &curve.knots[index];
            key.extend([(knot.at - curve.knots[index - 1].at).as_nanos().cast_unsigned(), knot.to.to_bits()]);
            match knot.shape {
                Shape::Own | Shape::OwnReversed | Shape::Sampled(_) | Shape::Early | Shape::Meets => {
                    let level = hold::level(&curve.knots, index).filter(|_| !self.moves());
                    key.extend([0, level.unwrap_or(f64::NAN).to_bits()])
                }
                Shape::Eased(easing) => key.push(1 + easing as u64),
                Shape::Function { index, gain, offset, reversed } => {
                    key.extend([9 + u64::from(reversed), gain.to_bits(), offset.to_bits()]);
                    match curve.functions.get(index as usize) {
                        Some(Function::Polynomial(c)) => key.extend(c.iter().map(|c| c.to_bits())),
                        Some(Function::Sine { cycles, phase }) => {
                            key.extend([cycles.to_bits(), phase.to_bits()])
                        }
                        Some(Function::Formula(part)) => {
                            key.extend([part.from.to_bits(), part.to.to_bits()]);
                            key.extend(part.formula.key());
                        }
                        Some(Function::Swept(swept)) => key.extend(swept.key()),
                        None => {}
                    }
                }
            }
        }
        key
    }
}

/// The factor by which grid values are scaled before rounding to whole numbers. It is so large that values change by far less than a
/// millionth of the granularity.
fn tidy_scale(granularity: f64) -> f64 {
    10f64.powf((-granularity.log10()).ceil().max(0.0) + 7.0)
}

/// The nearest value that a device can be set to; for a value beyond the limits, the nearest multiple of the granularity.
pub fn nearest_on_grid(limits: &Limits, value: f64) -> f64 {
    if limits.contains(value) { limits.nearest_settable(value) } else { limits.nearest(value) }
}

/// Removes the rounding error of a value on a grid, so that it has fewer digits in messages.
fn tidy(value: f64, scale: f64) -> f64 {
    let scaled = value * scale;
    // Larger doubles have no fraction digits.
    if scaled.abs() < 9e15 { scaled.round() / scale } else { value }
}

struct Sampled {
    times: Vec<f64>,
    values: Vec<f64>,
    gaps: Vec<f64>,
    slack: f64,
}

impl Sampled {
    /// If two pieces meet at the last sample with different values, moves the sample to the middle of this gap and records the gap.
    fn meets(&mut self, before: f64, after: f64) {
        let Some(last) = self.values.last_mut().filter(|_| before != after) else { return };
        *last = f64::midpoint(before, after);
        self.gaps.resize(self.values.len(), 0.0);
        if let Some(gap) = self.gaps.last_mut() {
            *gap = gap.max((after - before).abs() / 2.0);
        }
    }
}

impl Fitted {
    fn new(interpolation: Interpolation, room: usize) -> Self {
        Self { steps: Vec::with_capacity(room), interpolation, ..Self::default() }
    }

    /// Adds a step with the value `to`; `written` is the value in the movement. Two steps at the same time with the same value are
    /// merged. For a device that holds its values, the later step replaces the earlier one.
    fn put(&mut self, at: Span, to: f64, written: f64) {
        if self.interpolation == Interpolation::Hold {
            self.take_back(at);
        }
        self.settle();
        self.last_off = (to - written).abs();
        if self.steps.last() != Some(&Value { at, to }) {
            self.steps.push(Value { at, to });
            self.at_least += 1;
        }
    }

    /// Drops the last step if its time is `at`.
    fn take_back(&mut self, at: Span) {
        if self.steps.last().is_some_and(|last| last.at == at) {
            self.steps.pop();
            self.last_off = 0.0;
            self.at_least = self.at_least.saturating_sub(1);
        }
    }

    /// Makes the last step final, and includes its error in `worst`.
    fn settle(&mut self) {
        if let Some(at) = self.steps.last().map(|last| last.at) {
            let off = std::mem::take(&mut self.last_off);
            self.off_by(off, at);
        }
    }

    fn off_by(&mut self, error: f64, at: Span) {
        if error > self.worst {
            (self.worst, self.worst_at) = (error, at);
        }
    }

    fn needs(&mut self, tolerance: f64) {
        self.needed = Some(self.needed.map_or(tolerance, |known| known.max(tolerance)));
    }

    fn add(&mut self, begin: Span, fit: &Fit, granularity: f64) {
        self.settle();
        let at = |millis: f64| begin + Span::from_millis_f64(millis);
        let scale = tidy_scale(granularity);
        let value = |&(time, to): &(f64, f64)| Value { at: at(time), to: tidy(to, scale) };
        self.steps.extend(fit.steps.iter().skip(1).map(value));
        self.at_least += fit.at_least.saturating_sub(1);
        self.off_by(fit.worst, at(fit.worst_at));
    }
}
