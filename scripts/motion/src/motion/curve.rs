//! A movement as knots, and operations on whole movements. A knot is a value at a time, with the shape of the course that leads to it.

use std::sync::Arc;

use urrcp::Span;

use super::{Easing, Function};
use crate::exact::{Exact, Laps};

/// A change of a movement's length that scales all its times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stretch {
    /// The length before the change.
    pub from: Span,
    /// The length after the change.
    pub to: Span,
}

impl Stretch {
    /// Scales a time and rounds it to the nearest nanosecond. `from` becomes exactly `to`.
    pub fn of(self, at: Span) -> Span {
        let (from, to) = (i128::from(self.from.as_nanos()), i128::from(self.to.as_nanos()));
        if from == to || from <= 0 {
            return at;
        }
        let doubled = 2 * i128::from(at.as_nanos()) * to + from;
        Span::from_nanos(i64::try_from(doubled.div_euclid(2 * from)).unwrap_or(i64::MAX))
    }
}

/// A movement over time. Times are relative to the start of its cue.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curve {
    /// Knots in order of time. Two knots at the same time are a jump.
    pub knots: Vec<Knot>,
    /// The functions that [`Shape::Function`] refers to.
    pub functions: Arc<[Function]>,
}

/// A value at a time, and the course to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knot {
    /// The time of the knot, from the start of the cue.
    pub at: Span,
    /// The value that the movement has at the knot.
    pub to: f64,
    /// The shape of the course to the knot.
    pub shape: Shape,
    /// The index of the list item in the file that the knot comes from.
    pub item: u32,
}

/// The course to a knot from the previous one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// The device's own interpolation: linear, or constant until the knot's time.
    Own,
    /// The device's own interpolation in reverse: a device that holds takes the knot's value at once.
    OwnReversed,
    /// The course of an easing.
    Eased(Easing),
    /// The knot's value, already from the time of the previous knot on.
    Early,
    /// Part of a sampled curve, from the previous sample to this one. The fit may omit samples.
    Sampled(Between),
    /// A change that takes no time: two pieces meet, or a repeated movement restarts. The values may differ slightly.
    Meets,
    /// offset + gain * function(s), where s runs from 0 to 1 or, if reversed, from 1 to 0.
    Function {
        /// The index of the function in [`Curve::functions`].
        index: u32,
        /// The factor that the function is multiplied by.
        gain: f64,
        /// The value that is added to the product.
        offset: f64,
        /// Whether s runs from 1 to 0.
        reversed: bool,
    },
}

/// The course between two samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Between {
    /// The device's own interpolation.
    Own,
    /// The device's own interpolation, reversed in time: a device that would keep the previous value until the next keyframe takes the next
    /// value at once instead.
    OwnReversed,
    /// A straight line.
    Linear,
    /// The previous sample's value, until the time of the next sample.
    Step,
    /// The next sample's value, from the time of the previous sample on.
    Early,
}

impl Between {
    fn reversed(self) -> Self {
        match self {
            Self::Own => Self::OwnReversed,
            Self::OwnReversed => Self::Own,
            Self::Linear => Self::Linear,
            Self::Step => Self::Early,
            Self::Early => Self::Step,
        }
    }
}

impl Shape {
    /// Whether the value at the end of the course is written in the file, or results from such a value by scaling or mirroring.
    pub fn is_written(self) -> bool {
        matches!(self, Self::Own | Self::OwnReversed | Self::Eased(_) | Self::Early)
    }

    /// Whether a course of this shape has to be fitted with steps, at least for some devices.
    pub fn is_fitted(self) -> bool {
        match self {
            Self::Function { .. } | Self::Sampled(_) => true,
            Self::Eased(easing) => !matches!(easing, Easing::Linear | Easing::Step),
            Self::Own | Self::OwnReversed | Self::Early | Self::Meets => false,
        }
    }

    fn reversed(self) -> Self {
        match self {
            Self::Sampled(between) => Self::Sampled(between.reversed()),
            Self::Own => Self::OwnReversed,
            Self::OwnReversed => Self::Own,
            Self::Eased(Easing::Step) => Self::Early,
            Self::Early => Self::Eased(Easing::Step),
            Self::Function { index, gain, offset, reversed } => {
                Self::Function { index, gain, offset, reversed: !reversed }
            }
            // All other shapes are symmetric about their middle.
            other => other,
        }
    }

    fn affine(self, factor: f64, shift: f64) -> Self {
        match self {
            Self::Function { index, gain, offset, reversed } => {
                Self::Function { index, gain: factor * gain, offset: factor * offset + shift, reversed }
            }
            other => other,
        }
    }
}

impl Knot {
    /// Returns a copy of the knot that is later by `by`. Adds `item` to the index of its list item, and `function` to the index of its
    /// function.
    fn moved(&self, by: Span, item: u32, function: u32) -> Self {
        let shape = match self.shape {
            Shape::Function { index, gain, offset, reversed } => {
                Shape::Function { index: index.saturating_add(function), gain, offset, reversed }
            }
            shape => shape,
        };
        let item = if self.item == u32::MAX { item } else { item.saturating_add(self.item) };
        Self { at: by + self.at, to: self.to, shape, item }
    }
}

impl Curve {
    /// Creates a curve from knots and the functions that they refer to.
    pub fn new(knots: Vec<Knot>, functions: Vec<Function>) -> Self {
        Self { knots, functions: functions.into() }
    }

    /// Returns the memory consumption of the curve, as an equivalent number of knots.
    pub fn size(&self) -> usize {
        let coefficients = |function: &Function| match function {
            Function::Polynomial(coefficients) => coefficients.len(),
            Function::Sine { .. } | Function::Swept(_) => 0,
            Function::Formula(part) => part.formula.steps(),
        };
        self.knots.len() + self.functions.iter().map(|function| 1 + coefficients(function) / 6).sum::<usize>()
    }

    /// The time of the last knot.
    pub fn length(&self) -> Span {
        self.knots.last().map_or(Span::ZERO, |knot| knot.at)
    }

    /// Scales all values relative to `about`: value = about + factor * (value - about).
    pub fn scale(&mut self, about: f64, factor: f64) {
        let shift = about - factor * about;
        for knot in &mut self.knots {
            knot.to = factor * knot.to + shift;
            knot.shape = knot.shape.affine(factor, shift);
        }
    }

    /// Stretches all times of the curve. `starts` is the curve's start within the length that `stretch` scales.
    pub fn stretch(&mut self, stretch: Stretch, starts: Span) {
        let begin = stretch.of(starts);
        for knot in &mut self.knots {
            knot.at = stretch.of(starts + knot.at) - begin;
        }
    }

    /// Joins movements in sequence. Each is given with its start and the index of its first item. The last value of a movement is held
    /// until the next movement begins. Movements that do not meet are joined by a jump.
    pub fn joined<'a>(parts: impl Iterator<Item = (&'a Self, Span, u32)>) -> Self {
        let (mut knots, mut functions): (Vec<Knot>, Vec<Function>) = (Vec::new(), Vec::new());
        for (curve, begin, item) in parts {
            let Some(first) = curve.knots.first() else { continue };
            let offset = u32::try_from(functions.len()).unwrap_or(u32::MAX);
            functions.extend(curve.functions.iter().cloned());
            let moved = |knot: &Knot| knot.moved(begin, item, offset);
            let last = knots.last().copied();
            if let Some(last) = last.filter(|last| last.at < begin) {
                knots.push(Knot { at: begin, shape: Shape::Eased(Easing::Step), ..last });
            }
            let meets = |last: Knot| first.at == Span::ZERO && first.to == last.to;
            if !last.is_some_and(meets) {
                let shape = match first.shape {
                    shape if last.is_none() || first.at > Span::ZERO => shape,
                    Shape::Sampled(_) => Shape::Meets,
                    _ => Shape::Early,
                };
                knots.push(Knot { shape, ..moved(first) });
            }
            knots.extend(curve.knots[1..].iter().map(moved));
        }
        Self::new(knots, functions)
    }

    /// Reverses the movement within `length`, which must not be shorter than the movement.
    pub fn reverse(&mut self, length: Span) {
        let shapes: Vec<_> = self.knots.iter().map(|knot| knot.shape).collect();
        self.knots.reverse();
        for (index, knot) in self.knots.iter_mut().enumerate() {
            knot.at = length - knot.at;
            knot.shape = match index.checked_sub(1) {
                None => Shape::Own,
                Some(_) => shapes[shapes.len() - index].reversed(),
            };
        }
    }

    /// Repeats the movement until it is played `times` times in total, once per lap. `length` is its exact duration. If its last value
    /// differs from its first, the value jumps at the start of each lap.
    pub fn repeat(&mut self, times: u32, laps: &Laps, length: Exact) {
        let cycle = laps.begin(1);
        let once = self.knots.clone();
        let (Some(first), Some(last)) = (once.first().copied(), once.last().copied()) else { return };
        self.knots.reserve_exact(self.added_by_repeating(times, cycle));
        let (waits, joined) = Self::seam(&first, &last, cycle);
        for turn in 1..times {
            let begin = laps.begin(turn);
            // Laps may differ by a nanosecond.
            let end = if waits { laps.within(turn, length) } else { laps.begin(turn.saturating_add(1)) };
            let lay = |at: Span| if at == last.at { end } else { (begin + at).min(end) };
            if waits {
                self.knots.push(Knot { at: begin, shape: Shape::Eased(Easing::Step), ..last });
            }
            if !joined {
                let shape = match first.shape {
                    Shape::Sampled(_) if first.at == Span::ZERO => Shape::Meets,
                    _ if first.at == Span::ZERO => Shape::Early,
                    shape => shape,
                };
                self.knots.push(Knot { at: begin + first.at, shape, ..first });
            }
            self.knots.extend(once[1..].iter().map(|knot| Knot { at: lay(knot.at), ..*knot }));
        }
    }

    /// The number of knots that [`Self::repeat`] would add.
    pub fn added_by_repeating(&self, times: u32, cycle: Span) -> usize {
        let (Some(first), Some(last)) = (self.knots.first(), self.knots.last()) else { return 0 };
        let (waits, joined) = Self::seam(first, last, cycle);
        let turn = self.knots.len() - 1 + usize::from(waits) + usize::from(!joined);
        turn.saturating_mul(times.saturating_sub(1) as usize)
    }

    /// Returns two properties of the transition between two repetitions. The first is whether the device waits for the next repetition.
    /// The second is whether the last knot also serves as the next first knot: both have the same value, and the first knot starts
    /// without a delay.
    fn seam(first: &Knot, last: &Knot, cycle: Span) -> (bool, bool) {
        let waits = last.at < cycle || first.at > Span::ZERO;
        (waits, first.at == Span::ZERO && first.to == last.to)
    }

    /// Upper bounds of the speed and acceleration in the course to a knot, in units per second and per second squared.
    pub fn rates(&self, index: usize) -> (f64, f64) {
        let (Some(before), Some(knot)) =
            (index.checked_sub(1).and_then(|i| self.knots.get(i)), self.knots.get(index))
        else {
            return (0.0, 0.0);
        };
        let seconds = (knot.at - before.at).as_millis_f64() / 1_000.0;
        let change = (knot.to - before.to).abs();
        if seconds <= 0.0 {
            return (0.0, 0.0);
        }
        let (slope, curvature) = match knot.shape {
            Shape::Eased(easing) => (change * easing.slope_max(), change * easing.curvature_max()),
            Shape::Function { index, gain, .. } => self
                .functions
                .get(index as usize)
                .map_or((0.0, 0.0), |f| (gain.abs() * f.slope_max(), gain.abs() * f.curvature_max())),
            Shape::Sampled(Between::Step | Between::Early) | Shape::Early | Shape::Meets => (0.0, 0.0),
            Shape::Own | Shape::OwnReversed | Shape::Sampled(_) => (change, 0.0),
        };
        (slope / seconds, curvature / (seconds * seconds))
    }

    /// The largest first and second derivative of each function, in the order of `functions`. They are computed in advance because many
    /// knots may share a function.
    pub fn peaks(&self) -> Vec<(f64, f64)> {
        self.functions.iter().map(Function::peak_rates).collect()
    }

    /// The largest speed and acceleration in the course to a knot, in units per second and per second squared. They are exact for
    /// easings. For functions, they are derived from `peaks`, the result of [`Self::peaks`].
    pub fn peak_rates(&self, index: usize, peaks: &[(f64, f64)]) -> (f64, f64) {
        let Some(knot) = self.knots.get(index) else { return (0.0, 0.0) };
        let Shape::Function { index: function, gain, .. } = knot.shape else { return self.rates(index) };
        let (Some(before), Some((slope, curvature))) =
            (index.checked_sub(1).and_then(|before| self.knots.get(before)), peaks.get(function as usize))
        else {
            return (0.0, 0.0);
        };
        let seconds = (knot.at - before.at).as_millis_f64() / 1_000.0;
        (gain.abs() * slope / seconds, gain.abs() * curvature / (seconds * seconds))
    }

    /// The value in the course to a knot, at the fraction s of the course's duration.
    pub fn value(&self, index: usize, s: f64) -> f64 {
        let knot = &self.knots[index];
        let from = index.checked_sub(1).map_or(knot.to, |before| self.knots[before].to);
        let change = knot.to - from;
        match knot.shape {
            Shape::Early | Shape::Meets => knot.to,
            Shape::Own | Shape::OwnReversed | Shape::Sampled(_) => from + change * s,
            Shape::Eased(easing) => from + change * easing.at(s),
            Shape::Function { index, gain, offset, reversed } => {
                let s = if reversed { 1.0 - s } else { s };
                self.functions.get(index as usize).map_or(from, |function| offset + gain * function.at(s))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(knots: &[(i64, f64, Shape)]) -> Curve {
        let knot =
            |&(at, to, shape): &(i64, f64, Shape)| Knot { at: Span::from_millis(at), to, shape, item: 0 };
        Curve::new(knots.iter().map(knot).collect(), vec![Function::Sine { cycles: 1.0, phase: 0.0 }])
    }

    fn shown(curve: &Curve) -> Vec<(f64, f64)> {
        curve.knots.iter().map(|knot| (knot.at.as_millis_f64(), knot.to)).collect()
    }

    #[test]
    fn closed_movement_repeats_seamlessly_and_open_one_jumps() {
        let mut closed = curve(&[(0, 0.0, Shape::Own), (10, 5.0, Shape::Own), (20, 0.0, Shape::Own)]);
        closed.repeat(2, &Span::from_millis(20).into(), closed.length().into());
        assert_eq!(shown(&closed), [(0.0, 0.0), (10.0, 5.0), (20.0, 0.0), (30.0, 5.0), (40.0, 0.0)]);
        let mut open = curve(&[(0, 0.0, Shape::Own), (10, 5.0, Shape::Own)]);
        open.repeat(2, &Span::from_millis(15).into(), open.length().into());
        assert_eq!(shown(&open), [(0.0, 0.0), (10.0, 5.0), (15.0, 5.0), (15.0, 0.0), (25.0, 5.0)]);
    }

    #[test]
    fn reversing_twice_changes_nothing() {
        let wave = Shape::Function { index: 0, gain: 2.0, offset: 1.0, reversed: false };
        let once = curve(&[(0, 0.0, Shape::Own), (10, 5.0, Shape::Eased(Easing::Step)), (30, 5.0, wave)]);
        let mut twice = once.clone();
        twice.reverse(Span::from_millis(40));
        assert_eq!(shown(&twice), [(10.0, 5.0), (30.0, 5.0), (40.0, 0.0)]);
        assert_eq!(twice.knots[2].shape, Shape::Early);
        twice.reverse(Span::from_millis(40));
        assert_eq!(twice, once);
    }

    #[test]
    fn mirroring_is_scaling_by_minus_one_about_a_value() {
        let wave = Shape::Function { index: 0, gain: 2.0, offset: 10.0, reversed: false };
        let mut mirrored = curve(&[(0, 10.0, Shape::Own), (100, 10.0, wave)]);
        assert_eq!(mirrored.value(1, 0.25), 12.0);
        mirrored.scale(20.0, -1.0);
        assert_eq!(shown(&mirrored), [(0.0, 30.0), (100.0, 30.0)]);
        assert_eq!(mirrored.value(1, 0.25), 28.0);
    }
}
