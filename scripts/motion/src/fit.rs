//! The fewest script steps that follow a curve within a tolerance, and the least error for a number of steps.
//!
//! Pure mathematics on numbers; this module does not depend on the origin of a curve. Values of steps lie on the device's grid. For
//! devices that hold their value, `hold` is optimal over all times. For devices that move linearly, steps are at the times of samples:
//! `linear` is optimal over the candidates of `lattice`, and `tube` proves a bound for any other solution. The two questions are the
//! min-# and min-epsilon problems of Imai and Iri (Computer Vision, Graphics, and Image Processing 36, 1986), for errors measured along
//! the value as in Hakimi and Schmeichel (CVGIP: Graphical Models and Image Processing 53, 1991).

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
    /// In milliseconds, strictly increasing.
    pub times: &'a [f64],
    /// One value per time.
    pub values: &'a [f64],
    /// Bound of the distance between the curve and its chord between two samples.
    pub slack: f64,
    /// Half of the curve's jump at each sample; the sample's value is the middle of the jump. Empty if the curve is continuous.
    pub gaps: &'a [f64],
}

impl Samples<'_> {
    /// The remaining room at a sample.
    fn room_at(&self, sample: usize, room: f64) -> f64 {
        room - self.gap(sample)
    }

    fn gap(&self, sample: usize) -> f64 {
        self.gaps.get(sample).copied().unwrap_or(0.0)
    }

    /// The least and the largest value within the room at a sample.
    fn gate(&self, sample: usize, room: f64) -> (f64, f64) {
        let (value, room) = (self.values[sample], self.room_at(sample, room));
        (value - room, value + room)
    }
}

/// The values that a device can take: the multiples of the granularity from `min` to `max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// Distance between adjacent values, above 0.
    pub granularity: f64,
}

impl Grid {
    /// The grid of a device with these limits.
    pub fn of(limits: &Limits) -> Self {
        Self { min: limits.min_value, max: limits.max_value, granularity: limits.granularity }
    }
}

/// Prescribed values at the ends, used exactly, even if they are off the grid. `None` if the end is free.
///
/// A device that moves linearly always has a step at both ends. A device that holds has a step at the last sample only if it does not
/// already hold the prescribed value.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ends {
    /// At the first sample.
    pub first: Option<f64>,
    /// At the last sample.
    pub last: Option<f64>,
}

/// Steps that follow a curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// The time in milliseconds and the value of each step, in order of time.
    pub steps: Vec<(f64, f64)>,
    /// Largest distance from the curve, including the curve's slack, up to rounding.
    pub worst: f64,
    /// The time of this distance, in milliseconds; for a held value possibly the time just before.
    pub worst_at: f64,
    /// Lower bound of the number of steps within the tolerance, which is `worst` for [`least_error`]. For a device that moves linearly,
    /// the bound applies to steps at the samples' times.
    ///
    /// It equals the number of steps, unless the grid or the sampling is so fine that it had to be thinned.
    pub at_least: usize,
}

/// Finds the fewest steps within the tolerance, and among these the least error, to within 1 % of the tolerance.
///
/// For a device that moves linearly. At most 35 values per sample are candidates, including the one nearest to the curve. For curves of
/// more than 4096 samples, at most 256 samples per straight piece are candidates. Finer values and samples are thinned evenly.
/// [`Fit::at_least`] then shows how many steps fewer another fit could have.
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

/// Finds the least error with at most `budget` steps, to a relative precision of 1e-6 or a millionth of the granularity.
///
/// The tolerance is bisected over [`fewest`]. If that thins the values (for more than 17 multiples of the granularity on either side),
/// the error without slack is at most 17/16 times the sum of the optimum and one granularity: every value has a candidate within a
/// seventeenth of the room, rounded up to the grid. If it thins the samples, the result is the least error found.
///
/// # Errors
/// Returns the unusable part of the input, or the number of steps that the ends alone require.
pub fn least_error(curve: &Samples, grid: &Grid, budget: usize, ends: Ends) -> Result<Fit, Unfit> {
    Problem::new(curve, grid, ends)?.least_error(budget)
}

/// Lower bound of the number of steps that a device that moves linearly needs on any grid: a proof for the result of [`fewest`].
///
/// One more than the fewest straight pieces, each from sample to sample, that stay within the tolerance; the pieces need not be connected
/// (O'Rourke, Communications of the ACM 24, 1981). `None` if no number of steps suffices, because the slack alone exceeds the tolerance
/// or the samples are unusable.
#[must_use]
pub fn lower_bound(curve: &Samples, tolerance: f64) -> Option<usize> {
    problem::check(curve).ok()?;
    let room = (tolerance - curve.slack).min(4.0 * problem::EXTREME);
    (room >= 0.0).then(|| Tubes::of(curve).steps_at_least(room + problem::dust(curve, Ends::default())))
}

/// Lower bound of the number of steps that a device that moves linearly needs at any times and values: a proof for every way of following
/// the curve, not only for steps at samples.
///
/// One more than the fewest groups of samples such that one straight line fits each group. `None` as for [`lower_bound`].
#[must_use]
pub fn steps_at_least(curve: &Samples, tolerance: f64) -> Option<usize> {
    problem::check(curve).ok()?;
    let room = tolerance.min(4.0 * problem::EXTREME) + problem::dust(curve, Ends::default());
    (room >= 0.0).then(|| if curve.times.len() == 1 { 1 } else { Tubes::of(curve).groups(room) + 1 })
}

#[cfg(test)]
mod tests;
