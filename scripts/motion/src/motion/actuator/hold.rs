//! Steps of a device that holds its values: constant sections and curves are fitted together.

use std::ops::Range;
use std::sync::Arc;

use urrcp::Span;

use super::Means;
use super::{Actuator, Fits, Fitted, Tracked, Value, tidy, tidy_scale};
use crate::fit::{Ends, Fit, Grid, Movement, Rates};
use crate::motion::{Between, Easing, Knot, Shape};

impl Actuator<'_> {
    /// Adds the fewest steps for the courses to the knots of `run`, on a device that holds its value. A curve starts with its exact
    /// value; the first level of a movement that consists of steps may be adjusted. At the end, the device has the written value.
    pub(super) fn hold(&self, track: &Tracked<'_>, run: Range<usize>, fitted: &mut Fitted, fits: &mut Fits) {
        let (played, tolerance) = (track.played, track.tolerance);
        let knots = &played.curve.knots;
        let (begin, last) = (knots[run.start - 1].at, run.end - 1);
        let is_curve = |index: usize| level(knots, index).is_none();
        let has_curves = run.clone().any(is_curve);
        if self.limits.is_none() && has_curves {
            return run.for_each(|index| fitted.put(knots[index].at, played.set(index), knots[index].to));
        }
        let first = Some(self.on_grid(played.set(run.start - 1))).filter(|_| is_curve(run.start));
        // Another value may be set at the instant of the end.
        let is_left = knots
            .get(run.end)
            .is_some_and(|next| next.at == knots[last].at || self.way(track, run.end) == Means::Early);
        let ends = Ends { first, last: Some(self.on_grid(played.set(last))).filter(|_| !is_left) };
        let key = has_curves.then(|| self.key(played.curve, run.clone(), tolerance, ends));
        let most = (self.room + 1).saturating_sub(fitted.steps.len());
        let fit = key.as_ref().and_then(|key| fits.0.get(key).cloned());
        let fit = fit.unwrap_or_else(|| Arc::new(self.held(track, run, ends, most)));
        let is_whole = fit.as_ref().as_ref().map_or(true, |fit| fit.steps.len() <= most);
        fits.0.extend(key.filter(|_| is_whole).map(|key| (key, fit.clone())));
        match fit.as_ref() {
            Ok(fit) => fitted.hold(begin, fit, self.limits.map(|limits| tidy_scale(limits.granularity))),
            Err(needed) => {
                fitted.needs(*needed);
                fitted.put(knots[last].at, self.settled(played, last), knots[last].to);
            }
        }
    }

    /// Fits the courses to the knots of `run`. Times are relative to the start of the run.
    fn held(&self, track: &Tracked<'_>, run: Range<usize>, ends: Ends, most: usize) -> Result<Fit, f64> {
        let curve = track.played.curve;
        let knots = &curve.knots;
        let begin = knots[run.start - 1].at;
        let value = |index: usize, at: i64| {
            let (from, to) = (knots[index - 1].at - begin, knots[index].at - begin);
            let part = (Span::from_nanos(at) - from).as_millis_f64() / (to - from).as_millis_f64();
            curve.value(index, part)
        };
        let mut movement = Movement::new(&value, track.tolerance);
        for index in run.clone().filter(|index| knots[*index].at > knots[*index - 1].at) {
            let until = (knots[index].at - begin).as_nanos();
            match level(knots, index) {
                Some(level) => movement.stay(level, until),
                None => {
                    let (slope, curvature) = curve.rates(index);
                    movement.follow(index, until, Rates { slope, curvature });
                }
            }
        }
        let grid = self.limits.map(Grid::of);
        movement.fewest(grid.as_ref(), ends, knots[run.end - 1].to, most)
    }
}

impl Fitted {
    /// Adds the steps of a fit that starts at `begin`. A first step that repeats the current value is omitted. If the existing last step
    /// is at `begin` and has another value, it is removed.
    fn hold(&mut self, begin: Span, fit: &Fit, scale: Option<f64>) {
        let tidied = |value: f64| scale.map_or(value, |scale| tidy(value, scale));
        let first = fit.steps.first().map(|first| tidied(first.1));
        if self.steps.last().is_some_and(|last| last.at == begin && Some(last.to) != first) {
            self.take_back(begin);
        }
        self.settle();
        let holds = self.steps.last().map(|last| last.to);
        let known = usize::from(holds.is_some() && holds == first);
        let at = |millis: f64| begin + Span::from_millis_f64(millis);
        let value = |&(time, to): &(f64, f64)| Value { at: at(time), to: tidied(to) };
        self.steps.extend(fit.steps.iter().skip(known).map(value));
        self.at_least += fit.at_least - known;
        self.off_by(fit.worst, at(fit.worst_at));
    }

    /// Removes steps at the end that repeat the value before them.
    pub(super) fn drop_idle(&mut self) {
        while let [.., before, last] = self.steps[..]
            && before.to == last.to
        {
            self.steps.pop();
            self.at_least = self.at_least.saturating_sub(1);
        }
    }
}

/// The constant value of the course to a knot, for a device that holds its value; `None` if the course is a curve.
pub(super) fn level(knots: &[Knot], index: usize) -> Option<f64> {
    match knots[index].shape {
        Shape::Own | Shape::Eased(Easing::Step) | Shape::Sampled(Between::Own | Between::Step) => {
            Some(knots[index - 1].to)
        }
        Shape::OwnReversed | Shape::Early | Shape::Sampled(Between::OwnReversed | Between::Early) => {
            Some(knots[index].to)
        }
        Shape::Eased(_) | Shape::Sampled(Between::Linear) | Shape::Meets | Shape::Function { .. } => None,
    }
}
