//! The fewest script steps that follow a curve within a tolerance, and the least error for a number of steps.
//!
//! Pure mathematics on numbers; what a curve is and where it comes from is not known here. Values of steps lie on the device's
//! grid. For devices that hold their value, `hold` is optimal among all times. For devices that move linearly, steps lie at the
//! times of samples: `linear` is optimal over the candidates of `lattice`, and `tube` proves how far any other could get.
//! The two questions are the min-# and min-epsilon problems of Imai and Iri (Computer Vision, Graphics, and Image
//! Processing 36, 1986), for errors measured along the value as in Hakimi and Schmeichel (CVGIP: Graphical Models and
//! Image Processing 53, 1991).

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

/// A curve by its samples.
#[derive(Clone, Copy, Debug)]
pub struct Samples<'a> {
    /// Milliseconds, strictly increasing.
    pub times: &'a [f64],
    /// One for each time.
    pub values: &'a [f64],
    /// Between two samples the curve lies off their chord by at most this.
    pub slack: f64,
    /// Half of what the curve jumps by at each sample, whose value is the middle of the jump. Empty: it jumps nowhere.
    pub gaps: &'a [f64],
}

impl Samples<'_> {
    /// What is left of the room at a sample.
    fn room_at(&self, sample: usize, room: f64) -> f64 {
        room - self.gap(sample)
    }

    fn gap(&self, sample: usize) -> f64 {
        self.gaps.get(sample).copied().unwrap_or(0.0)
    }

    /// The least and the largest value within the room of a sample.
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
    /// Distance of two neighbouring values, above 0.
    pub granularity: f64,
}

impl Grid {
    /// The grid of a device with these limits.
    pub fn of(limits: &Limits) -> Self {
        Self { min: limits.min_value, max: limits.max_value, granularity: limits.granularity }
    }
}

/// Values prescribed at the ends, taken as they are, also off the grid; `None` leaves the end free.
///
/// A device that moves linearly has a step at both ends in any case. One that holds has a step at the last sample only
/// if it does not hold the prescribed value before.
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
    /// Time in milliseconds and value of each, in the order of time.
    pub steps: Vec<(f64, f64)>,
    /// Largest distance from the curve, its slack included, up to rounding.
    pub worst: f64,
    /// The time in milliseconds where it is that far; of a held value also just ahead of it.
    pub worst_at: f64,
    /// No steps are fewer than this within the tolerance, which is `worst` for [`least_error`]; of a device that moves
    /// linearly, no steps at the samples' times.
    ///
    /// The number of steps itself, unless the grid or the sampling is so fine that it had to be thinned.
    pub at_least: usize,
}

/// The fewest steps within the tolerance, and among these the least error, to within one percent of the tolerance.
///
/// For a device that moves linearly. At most 35 values a sample are tried, the one nearest to the curve included, and of
/// curves of more than 4,096 samples at most 256 places a straight piece. What is finer is thinned evenly, and then
/// [`Fit::at_least`] tells how many steps fewer another fit could have.
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
/// What of the input cannot be used, or the smallest tolerance that can be met with any number of steps.
pub fn fewest(curve: &Samples, grid: &Grid, tolerance: f64, ends: Ends) -> Result<Fit, Unfit> {
    Problem::new(curve, grid, ends)?.fewest(tolerance)
}

/// The least error with at most `budget` steps, to a relative 1e-6 or a millionth of the granularity.
///
/// The tolerance is bisected over [`fewest`]. Where that thins the values (for more than 17 multiples of the granularity
/// on either side), the error without slack is at most the least there is and one granularity, times 17/16: every value
/// has a candidate within a seventeenth of the room, rounded up to the grid. Where it thins places, it is the least found.
///
/// # Errors
/// What of the input cannot be used, or the number of steps that the ends alone take.
pub fn least_error(curve: &Samples, grid: &Grid, budget: usize, ends: Ends) -> Result<Fit, Unfit> {
    Problem::new(curve, grid, ends)?.least_error(budget)
}

/// Steps that a device which moves linearly needs at least, whatever its grid: a proof for those that [`fewest`] finds.
///
/// One more than the fewest straight pieces, each from a sample to a sample, that stay within the tolerance; pieces need
/// not meet in value (O'Rourke, Communications of the ACM 24, 1981). `None` if no steps suffice, because the slack alone
/// exceeds the tolerance or the samples cannot be used.
#[must_use]
pub fn lower_bound(curve: &Samples, tolerance: f64) -> Option<usize> {
    problem::check(curve).ok()?;
    let room = (tolerance - curve.slack).min(4.0 * problem::EXTREME);
    (room >= 0.0).then(|| Tubes::of(curve).steps_at_least(room + problem::dust(curve, Ends::default())))
}

/// Steps that a device which moves linearly needs at least, wherever in time and at whichever values they lie: a proof that
/// holds for every way of following the curve, not only for steps at samples.
///
/// One more than the fewest groups of samples that one straight line can serve. `None` as for [`lower_bound`].
#[must_use]
pub fn steps_at_least(curve: &Samples, tolerance: f64) -> Option<usize> {
    problem::check(curve).ok()?;
    let room = tolerance.min(4.0 * problem::EXTREME) + problem::dust(curve, Ends::default());
    (room >= 0.0).then(|| if curve.times.len() == 1 { 1 } else { Tubes::of(curve).groups(room) + 1 })
}

#[cfg(test)]
mod tests;
