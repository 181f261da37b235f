//! Reasons why a curve has no fit.

use std::fmt;

/// The reason why a curve has no fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Unfit {
    /// The curve has no samples.
    Empty,
    /// The sample with this index is invalid. It lacks a time or a value, is not later than the previous sample, or has a number that is
    /// NaN or beyond 1e100.
    Sample(usize),
    /// The slack of the samples is negative, beyond 1e100 or not a number.
    Slack(f64),
    /// No multiple of the granularity lies from `min` to `max`, or the granularity is not a number above 0.
    Grid,
    /// A prescribed value is beyond 1e100 or not a number, or a curve of a single sample has two different prescribed values.
    Ends,
    /// No number of steps meets the tolerance.
    Tolerance {
        /// The smallest tolerance that can be met.
        smallest: f64,
        /// The time in milliseconds of the sample that determines the smallest tolerance.
        at: f64,
    },
    /// The steps at the ends alone exceed the budget.
    Budget {
        /// The number of steps that the ends require.
        needed: usize,
    },
}

impl fmt::Display for Unfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => write!(f, "the curve has no samples"),
            Self::Sample(index) => {
                write!(f, "sample {index} is not a number, or is not later than the previous sample")
            }
            Self::Slack(slack) => write!(f, "invalid distance from the chord: {slack}"),
            Self::Grid => write!(f, "the range contains no multiple of the granularity"),
            Self::Ends => write!(
                f,
                "the start and end values are not numbers, or differ although the curve has only one sample"
            ),
            Self::Tolerance { smallest, at } => {
                write!(f, "steps cannot come closer to the curve than {smallest}, at {at} ms")
            }
            Self::Budget { needed } => {
                write!(f, "the start and the end of the curve alone need {needed} steps")
            }
        }
    }
}

impl std::error::Error for Unfit {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::{Ends, Grid, Samples, fewest, least_error};

    const GRID: Grid = Grid { min: -3.0, max: 3.0, granularity: 1.0 };

    #[track_caller]
    fn check_unfit(times: &[f64], values: &[f64], grid: Grid, ends: Ends, expected: Unfit) {
        let curve = Samples { times, values, slack: 0.0, gaps: &[] };
        assert_eq!(fewest(&curve, &grid, 1.0, ends), Err(expected));
        assert_eq!(least_error(&curve, &grid, 9, ends), Err(expected));
    }

    #[test]
    fn unusable_input_is_identified() {
        let free = Ends::default();
        check_unfit(&[], &[], GRID, free, Unfit::Empty);
        check_unfit(&[0.0, 1.0], &[0.0], GRID, free, Unfit::Sample(1));
        check_unfit(&[0.0, 1.0, 1.0], &[0.0; 3], GRID, free, Unfit::Sample(2));
        check_unfit(&[0.0, f64::NAN], &[0.0; 2], GRID, free, Unfit::Sample(1));
        check_unfit(&[0.0], &[f64::INFINITY], GRID, free, Unfit::Sample(0));
        for grid in
            [Grid { granularity: 0.0, ..GRID }, Grid { min: 4.0, ..GRID }, Grid { max: f64::NAN, ..GRID }]
        {
            check_unfit(&[0.0], &[0.0], grid, free, Unfit::Grid);
        }
        check_unfit(&[0.0], &[0.0], Grid { min: 1.0, max: 2.0, granularity: 10.0 }, free, Unfit::Grid);
        check_unfit(&[0.0], &[0.0], GRID, Ends { first: Some(0.0), last: Some(1.0) }, Unfit::Ends);
        check_unfit(&[0.0], &[0.0], GRID, Ends { first: Some(f64::NAN), last: None }, Unfit::Ends);
    }
}
