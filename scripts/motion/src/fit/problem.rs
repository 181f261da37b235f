//! A validated curve with a grid and ends, and the distance of steps from the curve.

use super::lattice::{Candidates, Lattice};
use super::layers::Layers;
use super::tube::Tubes;
use super::{Ends, Fit, Grid, Samples, Unfit, linear, search};

/// Largest absolute value of times and values, so that slopes and their products remain finite.
pub(super) const EXTREME: f64 = 1e100;
/// Bound of the error of a few roundings, relative to the largest value.
pub(super) const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// Steps, each as the index of its sample and its value.
pub(super) type Path = Vec<(usize, f64)>;

/// A validated curve, the grid of the device, and the prescribed ends.
pub(super) struct Problem<'a> {
    pub(super) curve: Samples<'a>,
    pub(super) lattice: Lattice,
    pub(super) ends: Ends,
    /// A small addition to the room (the largest allowed distance from the curve), so that rounding does not exclude a curve that just
    /// meets its tolerance.
    pub(super) dust: f64,
    pub(super) tubes: Tubes<'a>,
    /// The solution with steps at the ends only; no solution has fewer steps.
    shortest: Found,
    /// The layers of the last search, reused by searches with less room.
    layers: Option<Layers>,
}

/// Steps, and their largest distance from the samples.
#[derive(Clone, Debug, Default)]
pub(super) struct Found {
    pub(super) path: Path,
    pub(super) at_least: usize,
    /// Largest distance of the steps from a sample.
    pub(super) off: f64,
    /// The index of the sample with the largest distance.
    pub(super) off_at: usize,
}

impl<'a> Problem<'a> {
    pub(super) fn new(curve: &Samples<'a>, grid: &Grid, ends: Ends) -> Result<Self, Unfit> {
        check(curve)?;
        let usable = [ends.first, ends.last].into_iter().flatten().all(|value| value.abs() <= EXTREME);
        let differ = ends.first.zip(ends.last).is_some_and(|(first, last)| first != last);
        if !usable || (differ && curve.times.len() == 1) {
            return Err(Unfit::Ends);
        }
        let (dust, tubes, shortest) = (dust(curve, ends), Tubes::of(curve), Found::default());
        let (curve, lattice) = (*curve, Lattice::new(grid)?);
        let mut problem = Self { curve, lattice, ends, dust, tubes, shortest, layers: None };
        problem.shortest = problem.at_ends();
        Ok(problem)
    }

    pub(super) fn fewest(mut self, tolerance: f64) -> Result<Fit, Unfit> {
        let room = tolerance - self.curve.slack;
        let Some(found) = self.within(room, usize::MAX) else {
            let start = self.closest_start();
            let closest = search::least(&mut self, start, usize::MAX, search::Precision::Fine);
            let smallest = closest.off + self.curve.slack;
            return Err(Unfit::Tolerance { smallest, at: self.curve.times[closest.off_at] });
        };
        let (steps, at_least) = (found.path.len(), found.at_least);
        let found = search::least(&mut self, found, steps, search::Precision::Within(room / 100.0));
        Ok(self.fit(&Found { at_least, ..found }))
    }

    pub(super) fn least_error(mut self, budget: usize) -> Result<Fit, Unfit> {
        let needed = self.shortest.path.len();
        if needed > budget {
            return Err(Unfit::Budget { needed });
        }
        let is_ample = budget >= self.curve.times.len();
        let start = if is_ample { self.closest_start() } else { self.shortest.clone() };
        let found = search::least(&mut self, start, budget, search::Precision::Fine);
        Ok(self.fit(&found))
    }

    /// The fewest steps whose distance from the curve is at most `room`. `None` if there are none, or more than `most` are needed.
    pub(super) fn within(&mut self, room: f64, most: usize) -> Option<Found> {
        let possible = room >= 0.0 && self.shortest.path.len() <= most;
        let room = possible.then_some(room + self.dust)?;
        if self.shortest.off <= room {
            return Some(self.shortest.clone());
        }
        if self.curve.times.len() == 1 {
            return None;
        }
        let mut layers = self.layers.take();
        let found = linear::steps(self, room, most, &mut layers);
        self.layers = layers;
        let (path, at_least) = found?;
        Some(self.measured(path, at_least))
    }

    /// Returns the values that a step at this sample may take, at most `room` away from the curve, for a device that moves linearly.
    pub(super) fn candidates(&self, sample: usize, room: f64) -> Candidates {
        let (value, room) = (self.curve.values[sample], self.curve.room_at(sample, room));
        let is_last = sample + 1 == self.curve.values.len();
        match if is_last { self.ends.last } else { self.ends.first.filter(|_| sample == 0) } {
            None => self.lattice.near(value, room),
            Some(end) if (end - value).abs() <= room => Candidates::only(end),
            Some(_) => Candidates::NONE,
        }
    }

    fn at_ends(&self) -> Found {
        let last = self.curve.times.len() - 1;
        let path = match last {
            0 => vec![(0, self.end(self.ends.first.or(self.ends.last), 0))],
            _ => vec![(0, self.end(self.ends.first, 0)), (last, self.end(self.ends.last, last))],
        };
        let steps = path.len();
        self.measured(path, steps)
    }

    /// Returns a solution with one step at each sample. The search for the closest steps starts there.
    fn closest_start(&self) -> Found {
        let last = self.curve.times.len() - 1;
        if last == 0 {
            return self.shortest.clone();
        }
        let mut path: Path =
            self.curve.values.iter().map(|value| self.lattice.nearest(*value)).enumerate().collect();
        for end in &self.shortest.path {
            path[end.0] = *end;
        }
        let at_least = 2;
        self.measured(path, at_least)
    }

    fn end(&self, prescribed: Option<f64>, sample: usize) -> f64 {
        prescribed.unwrap_or_else(|| self.lattice.nearest(self.curve.values[sample]))
    }

    /// Lower bound of the distance of any steps from the curve: the distance at the ends.
    pub(super) fn off_min(&self) -> f64 {
        let last = self.curve.times.len() - 1;
        let off = |end: Option<f64>, sample: usize| {
            (self.end(end, sample) - self.curve.values[sample]).abs() + self.curve.gap(sample)
        };
        if last == 0 { self.shortest.off } else { off(self.ends.first, 0).max(off(self.ends.last, last)) }
    }

    fn measured(&self, path: Path, at_least: usize) -> Found {
        let mut worst = (0.0, path.first().map_or(0, |step| step.0));
        let last = self.curve.times.len() - 1;
        for (i, &from) in path.iter().enumerate() {
            let to = path.get(i + 1).copied().unwrap_or((last, from.1));
            for k in from.0..=to.0 {
                let off = (self.follows(from, to, k) - self.curve.values[k]).abs() + self.curve.gap(k);
                if off > worst.0 {
                    worst = (off, k);
                }
            }
        }
        Found { path, at_least, off: worst.0, off_at: worst.1 }
    }

    /// Returns the device's value at `sample`, on the line between two steps.
    fn follows(&self, from: (usize, f64), to: (usize, f64), sample: usize) -> f64 {
        if sample == from.0 {
            return from.1;
        }
        let times = self.curve.times;
        let part = (times[sample] - times[from.0]) / (times[to.0] - times[from.0]);
        from.1 + (to.1 - from.1) * part
    }

    fn fit(&self, found: &Found) -> Fit {
        Fit {
            steps: found.path.iter().map(|(sample, value)| (self.curve.times[*sample], *value)).collect(),
            worst: found.off + self.curve.slack,
            worst_at: self.curve.times[found.off_at],
            at_least: found.at_least,
        }
    }
}

/// Checks that the samples are finite numbers in order of time.
pub(super) fn check(curve: &Samples) -> Result<(), Unfit> {
    let Samples { times, values, slack, gaps } = *curve;
    if times.is_empty() && values.is_empty() {
        return Err(Unfit::Empty);
    }
    let number = |of: &[f64], i: usize| of.get(i).is_some_and(|number| number.abs() <= EXTREME);
    let later = |i: usize| i == 0 || times[i] - times[i - 1] >= 1.0 / EXTREME;
    let usable = |i: &usize| number(times, *i) && number(values, *i) && later(*i);
    if let Some(broken) = (0..times.len().max(values.len())).find(|i| !usable(i)) {
        return Err(Unfit::Sample(broken));
    }
    if let Some(broken) = gaps.iter().position(|gap| !(0.0..=EXTREME).contains(gap)) {
        return Err(Unfit::Sample(broken));
    }
    if (0.0..=EXTREME).contains(&slack) { Ok(()) } else { Err(Unfit::Slack(slack)) }
}

/// Upper bound of the rounding error of this curve's values.
pub(super) fn dust(curve: &Samples, ends: Ends) -> f64 {
    let values = curve.values.iter().chain(&ends.first).chain(&ends.last);
    ROUNDING * values.fold(0.0, |largest: f64, value| largest.max(value.abs()))
}
