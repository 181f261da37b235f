//! The fewest script steps that follow a curve within a tolerance, and the least error for a number of steps.
//!
//! Pure mathematics on numbers; this module does not depend on the origin of a curve. Values of steps lie on the device's grid. For
//! devices that hold their value, `hold` is optimal over all times. For devices that move linearly, steps are at the times of samples:
//! `linear` is optimal over the candidates of `lattice`, and `tube` proves a bound for any other solution. The fewest steps and the least
//! error are the min-# and min-epsilon problems of Imai and Iri (Computer Vision, Graphics, and Image Processing 36, 1986). Errors are
//! measured along the value, as in Hakimi and Schmeichel (CVGIP: Graphical Models and Image Processing 53, 1991).

mod cones;
mod hold;
mod lattice;
mod layers;
mod linear;
mod problem;
mod search;
mod tube;
mod unfit;

use urrcp::Limits;

pub use hold::{Movement, Rates};
use problem::Problem;
use tube::Tubes;
pub use unfit::Unfit;

/// A curve, given by samples.
#[derive(Clone, Copy, Debug)]
pub struct Samples<'a> {
    /// Times of the samples in milliseconds, strictly increasing.
    pub times: &'a [f64],
    /// Values of the samples, one per time.
    pub values: &'a [f64],
    /// Upper bound of the distance between the curve and the straight line that joins two adjacent samples.
    pub slack: f64,
    /// Half of the curve's jump at each sample; the sample's value is the middle of the jump. Empty if the curve is continuous.
    pub gaps: &'a [f64],
}

impl Samples<'_> {
    /// The allowed distance from a sample's value: `room`, minus half of the jump at the sample.
    fn room_at(&self, sample: usize, room: f64) -> f64 {
        room - self.gap(sample)
    }

    fn gap(&self, sample: usize) -> f64 {
        self.gaps.get(sample).copied().unwrap_or(0.0)
    }

    /// Returns the least and the largest allowed value at a sample, where steps may be at most `room` away from the curve.
    fn gate(&self, sample: usize, room: f64) -> (f64, f64) {
        let (value, room) = (self.values[sample], self.room_at(sample, room));
        (value - room, value + room)
    }
}

/// The values that a device can take: the multiples of the granularity from `min` to `max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Smallest value that the device can take.
    pub min: f64,
    /// Largest value that the device can take.
    pub max: f64,
    /// Distance between adjacent values, above 0.
    pub granularity: f64,
}

impl Grid {
    /// The grid of a device with the given limits.
    pub fn of(limits: &Limits) -> Self {
        Self { min: limits.min_value, max: limits.max_value, granularity: limits.granularity }
    }
}

/// Prescribed values at the ends of a curve, used exactly, even if they are off the grid. `None` if any value is allowed.
///
/// A device that moves linearly always has a step at both ends. A device that holds has a step at the last sample only if it does not
/// already hold the prescribed value.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ends {
    /// The value at the first sample.
    pub first: Option<f64>,
    /// The value at the last sample.
    pub last: Option<f64>,
}

/// Steps that follow a curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// The time in milliseconds and the value of each step, in order of time.
    pub steps: Vec<(f64, f64)>,
    /// Largest distance of the steps from the curve, including the curve's slack, up to rounding.
    pub worst: f64,
    /// The time of the largest distance, in milliseconds. For a held value, the distance may occur just before that time.
    pub worst_at: f64,
    /// Lower bound of the number of steps within the tolerance; for [`least_error`], the tolerance is `worst`. For a device that moves
    /// linearly, the bound applies to steps at the samples' times.
    ///
    /// The bound equals the number of steps, unless the grid or the sampling is so fine that it had to be thinned.
    pub at_least: usize,
}

/// Finds the fewest steps within the tolerance, for a device that moves linearly. Among the solutions with that number of steps, it finds
/// one whose error is minimal to within 1 % of the tolerance.
///
/// At most 35 values per sample are candidates, including the value nearest to the curve. For curves of more than 4096 samples, at most
/// 256 samples per straight piece are candidates. If there are more values or samples, they are thinned evenly; no fit has fewer steps
/// than [`Fit::at_least`] even then.
///
/// ```
/// use downbeat_motion::fit::{Ends, Grid, Samples, fewest};
///
/// let curve = Samples { times: &[0.0, 10.0, 20.0, 30.0], values: &[0.0, 5.2, 9.8, 0.0], slack: 0.0, gaps: &[] };
/// let grid = Grid { min: 0.0, max: 10.0, granularity: 1.0 };
/// let fit = fewest(&curve, &grid, 0.5, Ends::default())?;
/// assert_eq!(fit.steps, [(0.0, 0.0), (20.0, 10.0), (30.0, 0.0)]);
/// # Ok::<(), downbeat_motion::fit::Unfit>(())
/// ```
///
/// # Errors
/// Returns the unusable part of the input, or the smallest tolerance that can be met with any number of steps.
pub fn fewest(curve: &Samples, grid: &Grid, tolerance: f64, ends: Ends) -> Result<Fit, Unfit> {
    Problem::new(curve, grid, ends)?.fewest(tolerance)
}

/// Finds the least error with at most `budget` steps, for a device that moves linearly. The relative precision is 1e-6, or the absolute
/// precision is a millionth of the granularity.
///
/// The function bisects the tolerance and calls [`fewest`] for each. [`fewest`] thins the values if there are more than 17 multiples of
/// the granularity on either side. The error without slack is then at most 17/16 times the sum of the optimum and one granularity: every
/// value has a candidate within a seventeenth of the room, rounded up to the grid. If [`fewest`] thins the samples, the result is the
/// least error found.
///
/// # Errors
/// Returns the unusable part of the input, or the number of steps that the ends alone require.
pub fn least_error(curve: &Samples, grid: &Grid, budget: usize, ends: Ends) -> Result<Fit, Unfit> {
    Problem::new(curve, grid, ends)?.least_error(budget)
}

/// Lower bound of the number of steps at samples that a device that moves linearly needs, on any grid. It proves that a result of
/// [`fewest`] is optimal.
///
/// The bound is one more than the fewest straight pieces that stay within the tolerance. Each piece leads from a sample to a sample; the
/// pieces need not be connected (O'Rourke, Communications of the ACM 24, 1981). `None` if no number of steps suffices, because the slack
/// alone exceeds the tolerance or the samples are unusable.
#[must_use]
pub fn lower_bound(curve: &Samples, tolerance: f64) -> Option<usize> {
    problem::check(curve).ok()?;
    let room = (tolerance - curve.slack).min(4.0 * problem::EXTREME);
    (room >= 0.0).then(|| Tubes::of(curve).steps_at_least(room + problem::dust(curve, Ends::default())))
}

/// Lower bound of the number of steps, at any times and with any values, that a device that moves linearly needs. Unlike [`lower_bound`],
/// it is not limited to steps at samples.
///
/// The bound is one more than the fewest groups of consecutive samples such that a single straight line passes all samples of a group
/// within the tolerance. `None` if no number of steps suffices, as for [`lower_bound`].
#[must_use]
pub fn steps_at_least(curve: &Samples, tolerance: f64) -> Option<usize> {
    problem::check(curve).ok()?;
    let room = tolerance.min(4.0 * problem::EXTREME) + problem::dust(curve, Ends::default());
    (room >= 0.0).then(|| if curve.times.len() == 1 { 1 } else { Tubes::of(curve).groups(room) + 1 })
}

#[cfg(test)]
mod tests;
