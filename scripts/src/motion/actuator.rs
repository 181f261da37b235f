//! From a movement to the steps of a device: what the device moves by itself as it is written, the rest with the fewest
//! steps within the tolerance.

use std::collections::HashMap;
use std::sync::Arc;

use urrcp::{ControlType, Device, Interpolation, Limits, Span};

use super::{Curve, Easing, Function, Shape};
use crate::fit::{self, Ends, Fit, Grid, Samples};

/// Most samples that are fitted together: longer curves are cut at a knot, and each part is fitted by itself.
const RUN_SAMPLES_MAX: f64 = 16_384.0;
/// Most samples of one way between two knots.
const SAMPLES_MAX: f64 = 65_536.0;
/// Fewest samples of one way between two knots.
const SAMPLES_MIN: f64 = 16.0;

/// The device as far as motion is concerned.
#[derive(Clone, Copy)]
pub(crate) struct Actuator<'a> {
    pub(crate) interpolation: Interpolation,
    pub(crate) control_type: ControlType,
    pub(crate) limits: Option<&'a Limits>,
    /// With more steps than this a movement is given up.
    pub(crate) room: usize,
}

/// A value that a step sets, counted from the cue's start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Value {
    pub(crate) at: Span,
    pub(crate) to: f64,
}

/// The steps of one movement on one device.
#[derive(Clone, Debug, Default)]
pub(crate) struct Fitted {
    pub(crate) steps: Vec<Value>,
    /// The largest difference from the movement as it is written, and when.
    pub(crate) worst: f64,
    pub(crate) worst_at: Span,
    /// No way of placing steps needs fewer.
    pub(crate) at_least: usize,
    /// Where no steps keep to the tolerance, the least that could be kept to.
    pub(crate) needed: Option<f64>,
}

/// What has been fitted before: repeated movements are fitted once.
#[derive(Default)]
pub(crate) struct Fits(HashMap<Vec<u64>, Arc<Result<Fit, f64>>>);

/// How a way between two knots becomes steps.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Means {
    /// The device does it by itself: a step at the knot.
    Own,
    /// The device stays, then takes the new value.
    Jump,
    /// The device takes the new value, then stays.
    Early,
    /// Fitted by itself: its ends are kept exactly.
    Alone,
    /// Fitted together with its neighbours of the same kind.
    Joined,
}

impl<'a> Actuator<'a> {
    pub(crate) fn new(device: &'a Device, control_type: ControlType, room: usize) -> Self {
        let limits = device.available_control_types.limits(control_type);
        Self { interpolation: device.interpolation, control_type, limits, room }
    }

    fn moves(&self) -> bool {
        self.interpolation == Interpolation::Linear
    }

    /// Whether the first knot is reached by moving from wherever the device is.
    pub(crate) fn moves_from_anywhere(&self, curve: &Curve) -> bool {
        let first = curve.knots.first();
        first.is_some_and(|first| {
            first.at > Span::ZERO
                && self.moves()
                && matches!(first.shape, Shape::Own | Shape::OwnReversed | Shape::Eased(Easing::Linear))
        })
    }

    /// Whether the first knot needs a value to begin from, and has none.
    pub(crate) fn lacks_beginning(&self, curve: &Curve) -> bool {
        let Some(first) = curve.knots.first() else { return false };
        let waits = match first.shape {
            Shape::Eased(Easing::Step) => true,
            Shape::Eased(_) => false,
            _ => true,
        };
        first.at > Span::ZERO && !waits && !self.moves_from_anywhere(curve)
    }

    /// The error that is allowed where nothing else is said: max_error, or one granularity if that is more.
    pub(crate) fn tolerance(&self) -> f64 {
        self.limits.map_or(0.0, |limits| limits.max_error.unwrap_or(0.0).max(limits.granularity))
    }

    /// The fewest steps within the tolerance. Keyframes that the device can play as they are stay as they are, unless
    /// `thinned` allows to leave some out.
    pub(crate) fn steps(&self, curve: &Curve, tolerance: f64, thinned: bool, fits: &mut Fits) -> Fitted {
        let knots = &curve.knots;
        let steps = Vec::with_capacity(knots.len().min(self.room));
        let mut fitted = Fitted { steps, ..Fitted::default() };
        if let Some(first) = knots.first() {
            let to = if first.shape == Shape::Sampled { self.on_grid(first.to) } else { first.to };
            fitted.steps.push(Value { at: first.at, to });
            fitted.at_least = 1;
        }
        let mut index = 1;
        let mut cut = false;
        while index < knots.len() && fitted.steps.len() <= self.room {
            let (before, knot) = (&knots[index - 1], &knots[index]);
            let means = if knot.at == before.at { Means::Own } else { self.means(knot.shape, thinned) };
            let mut end = index + 1;
            match means {
                Means::Own => fitted.direct(&[Value { at: knot.at, to: knot.to }]),
                Means::Jump if self.moves() && knot.to != before.to => {
                    fitted
                        .direct(&[Value { at: knot.at, to: before.to }, Value { at: knot.at, to: knot.to }]);
                }
                Means::Jump => fitted.direct(&[Value { at: knot.at, to: knot.to }]),
                Means::Early => {
                    fitted.direct(&[Value { at: before.at, to: knot.to }]);
                    if self.moves() {
                        fitted.direct(&[Value { at: knot.at, to: knot.to }]);
                    }
                }
                Means::Alone => self.fit(curve, index..end, tolerance, &mut fitted, fits),
                Means::Joined => {
                    end = self.run_end(curve, index, tolerance, thinned);
                    self.fit(curve, index..end, tolerance, &mut fitted, fits);
                    // A straight piece may reach across a cut.
                    fitted.at_least -= usize::from(cut);
                }
            }
            cut = means == Means::Joined && end < knots.len() && self.joins(curve, end, thinned);
            index = end;
        }
        fitted
    }

    /// Whether the way to a knot may be fitted together with the one before.
    fn joins(&self, curve: &Curve, index: usize, thinned: bool) -> bool {
        let (before, knot) = (&curve.knots[index - 1], &curve.knots[index]);
        knot.at > before.at && self.means(knot.shape, thinned) == Means::Joined
    }

    /// Where the ways that begin with the one to `index` are no longer fitted together.
    fn run_end(&self, curve: &Curve, index: usize, tolerance: f64, thinned: bool) -> usize {
        let mut samples = self.parts(curve, index, tolerance);
        let mut end = index + 1;
        while end < curve.knots.len() && self.joins(curve, end, thinned) {
            samples += self.parts(curve, end, tolerance);
            if samples > RUN_SAMPLES_MAX {
                break;
            }
            end += 1;
        }
        end
    }

    /// The smallest error with at most `most` steps, no smaller than the tolerance, by bisecting it; and that tolerance.
    /// With too few steps for anything, the fewest there can be.
    pub(crate) fn least_error(
        &self,
        curve: &Curve,
        tolerance: f64,
        most: usize,
        fits: &mut Fits,
    ) -> (f64, Fitted) {
        let fit = |tolerance: f64, fits: &mut Fits| self.steps(curve, tolerance, true, fits);
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
            match enough(&fitted) {
                true => (wide, best) = (middle, fitted),
                false => narrow = middle,
            }
        }
        (wide, best)
    }

    fn on_grid(&self, value: f64) -> f64 {
        self.limits.map_or(value, |limits| {
            tidy(
                limits.nearest(value).clamp(limits.min_value, limits.max_value),
                tidy_scale(limits.granularity),
            )
        })
    }

    fn means(&self, shape: Shape, thinned: bool) -> Means {
        match (shape, self.interpolation) {
            (Shape::Own | Shape::OwnReversed | Shape::Eased(Easing::Linear), Interpolation::Linear)
                if thinned =>
            {
                Means::Joined
            }
            (Shape::Own | Shape::OwnReversed | Shape::Eased(Easing::Linear), Interpolation::Linear) => {
                Means::Own
            }
            (Shape::Own | Shape::Eased(Easing::Step), _) => Means::Jump,
            (Shape::OwnReversed | Shape::Early, _) => Means::Early,
            (Shape::Eased(_), _) if thinned => Means::Joined,
            (Shape::Eased(_), _) => Means::Alone,
            (Shape::Sampled | Shape::Function { .. }, _) => Means::Joined,
        }
    }

    /// Fits the ways to the knots of `run` and adds the steps after the first, which is there already.
    fn fit(
        &self,
        curve: &Curve,
        run: std::ops::Range<usize>,
        tolerance: f64,
        fitted: &mut Fitted,
        fits: &mut Fits,
    ) {
        let (begin, last) = (curve.knots[run.start - 1].at, run.end - 1);
        let Some(limits) = self.limits else {
            let knots = curve.knots[run].iter().map(|knot| Value { at: knot.at, to: knot.to });
            return fitted.direct(&knots.collect::<Vec<_>>());
        };
        let key = self.key(curve, run.clone(), tolerance);
        let fit = fits.0.entry(key).or_insert_with(|| {
            let sampled = self.sample(curve, run.clone(), tolerance);
            let samples = Samples { times: &sampled.times, values: &sampled.values, slack: sampled.slack };
            let grid = Grid { min: limits.min_value, max: limits.max_value, granularity: limits.granularity };
            let ends = Ends {
                first: Some(self.on_grid(curve.knots[run.start - 1].to)),
                last: Some(self.on_grid(curve.knots[last].to)),
            };
            let fit = fit::fewest(&samples, self.interpolation, &grid, tolerance, ends);
            Arc::new(fit.map_err(|unfit| match unfit {
                fit::Unfit::Tolerance { smallest, .. } => smallest,
                _ => f64::INFINITY,
            }))
        });
        match fit.as_ref() {
            Ok(fit) => fitted.add(begin, fit, limits.granularity),
            Err(needed) => {
                fitted.needed = Some(fitted.needed.map_or(*needed, |known| known.max(*needed)));
                fitted.direct(&[Value { at: curve.knots[last].at, to: curve.knots[last].to }]);
            }
        }
    }

    fn sample(&self, curve: &Curve, run: std::ops::Range<usize>, tolerance: f64) -> Sampled {
        let begin = curve.knots[run.start - 1].at;
        let mut sampled = Sampled { times: vec![0.0], values: vec![curve.value(run.start, 0.0)], slack: 0.0 };
        for index in run {
            let (from, to) = (curve.knots[index - 1].at, curve.knots[index].at);
            let parts = self.parts(curve, index, tolerance);
            let (_, curvature) = curve.rates(index);
            let seconds = (to - from).as_millis_f64() / 1_000.0;
            sampled.slack = sampled.slack.max(curvature * (seconds / parts).powi(2) / 8.0);
            let mut part = 1.0;
            while part <= parts {
                // On whole nanoseconds, as steps are.
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

    /// Into how many equal parts a way is cut to be sampled: so many that a linear piece between two samples is off by
    /// a thirty-second of the tolerance (curvature times the part's length squared over 8: de Boor, A Practical Guide to
    /// Splines, chapter III), or a held value moves by a quarter of it.
    fn parts(&self, curve: &Curve, index: usize, tolerance: f64) -> f64 {
        let seconds = (curve.knots[index].at - curve.knots[index - 1].at).as_millis_f64() / 1_000.0;
        let (slope, curvature) = curve.rates(index);
        if self.moves() && curvature == 0.0 {
            return 1.0;
        }
        let parts = match self.interpolation {
            Interpolation::Linear => seconds * (4.0 * curvature / tolerance).sqrt(),
            Interpolation::Hold => 4.0 * seconds * slope / tolerance,
        };
        // Parts of a microsecond are fine enough for anything that moves.
        parts.ceil().min(seconds * 1e6).clamp(SAMPLES_MIN, SAMPLES_MAX)
    }

    /// Everything on which the fit of a run depends.
    fn key(&self, curve: &Curve, run: std::ops::Range<usize>, tolerance: f64) -> Vec<u64> {
        let limits = self.limits.map_or([0.0; 3], |l| [l.min_value, l.max_value, l.granularity]);
        let mut key =
            vec![u64::from(self.moves()), tolerance.to_bits(), curve.knots[run.start - 1].to.to_bits()];
        key.extend(limits.map(f64::to_bits));
        for index in run {
            let knot = &curve.knots[index];
            key.extend([(knot.at - curve.knots[index - 1].at).as_nanos().cast_unsigned(), knot.to.to_bits()]);
            match knot.shape {
                Shape::Own | Shape::OwnReversed | Shape::Sampled | Shape::Early => key.push(0),
                Shape::Eased(easing) => key.push(1 + easing as u64),
                Shape::Function { index, gain, offset, reversed } => {
                    key.extend([9 + u64::from(reversed), gain.to_bits(), offset.to_bits()]);
                    match curve.functions.get(index as usize) {
                        Some(Function::Polynomial(c)) => key.extend(c.iter().map(|c| c.to_bits())),
                        Some(Function::Sine { cycles, phase }) => {
                            key.extend([cycles.to_bits(), phase.to_bits()])
                        }
                        None => {}
                    }
                }
            }
        }
        key
    }
}

/// By what values on a grid are multiplied to be rounded to whole numbers: so finely that they move far less than a
/// millionth of the granularity.
fn tidy_scale(granularity: f64) -> f64 {
    10f64.powf((-granularity.log10()).ceil().max(0.0) + 7.0)
}

/// A value on a grid without the dust of its multiplication: fewer digits on the wire.
fn tidy(value: f64, scale: f64) -> f64 {
    let scaled = value * scale;
    // Beyond this doubles have no fractions left.
    if scaled.abs() < 9e15 { scaled.round() / scale } else { value }
}

struct Sampled {
    times: Vec<f64>,
    values: Vec<f64>,
    slack: f64,
}

impl Fitted {
    /// Steps as they are written. Of two at one time that set the same value, one is enough.
    fn direct(&mut self, steps: &[Value]) {
        for step in steps {
            if self.steps.last() != Some(step) {
                self.steps.push(*step);
                self.at_least += 1;
            }
        }
    }

    fn add(&mut self, begin: Span, fit: &Fit, granularity: f64) {
        let at = |millis: f64| begin + Span::from_millis_f64(millis);
        let scale = tidy_scale(granularity);
        let value = |&(time, to): &(f64, f64)| Value { at: at(time), to: tidy(to, scale) };
        self.steps.extend(fit.steps.iter().skip(1).map(value));
        self.at_least += fit.at_least.saturating_sub(1);
        if fit.worst > self.worst {
            (self.worst, self.worst_at) = (fit.worst, at(fit.worst_at));
        }
    }
}
