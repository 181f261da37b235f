//! Shapes that have places for any number of bodies: flat ones lie on the floor, with their middle at 0.

use std::f64::consts::{PI, TAU};

use super::Point;

/// Along the x axis, from left to right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Line {
    /// Metres between neighbours.
    Spacing(f64),
    /// Metres from the first to the last.
    Length(f64),
}

/// Around the middle, from the x axis on and counterclockwise as seen from above.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Ring {
    /// Metres from the middle.
    Radius(f64),
    /// Metres between neighbours, in a straight line.
    Spacing(f64),
}

/// Row by row along the x axis, the rows along the y axis, layers of full rows along the z axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Grid {
    /// Metres between columns, rows and layers.
    pub(crate) spacing: Point,
    /// By default as many as make the grid a square.
    pub(crate) columns: Option<u32>,
    /// By default all that are needed, in one layer.
    pub(crate) rows: Option<u32>,
}

/// Steps of the numbers from 0 that lie around 0: -1, 0, 1 of three, -0.5, 0.5 of two.
#[expect(clippy::cast_precision_loss, reason = "there are few places")]
fn around(index: usize, count: usize) -> f64 {
    index as f64 - (count.saturating_sub(1)) as f64 / 2.0
}

#[expect(clippy::cast_precision_loss, reason = "there are few places")]
const fn real(count: usize) -> f64 {
    count as f64
}

impl Line {
    pub(super) fn places(self, count: usize) -> Vec<Point> {
        let spacing = match self {
            Self::Spacing(spacing) => spacing,
            Self::Length(length) => length / real(count.saturating_sub(1).max(1)),
        };
        (0..count).map(|index| [spacing * around(index, count), 0.0, 0.0]).collect()
    }
}

impl Ring {
    pub(super) fn places(self, count: usize) -> Vec<Point> {
        let radius = match self {
            Self::Radius(radius) => radius,
            // The chord of a part of the circle: 2 r sin(pi / n).
            Self::Spacing(_) if count < 2 => 0.0,
            Self::Spacing(spacing) => spacing / (2.0 * (PI / real(count)).sin()),
        };
        let place = |index: usize| {
            let angle = TAU * real(index) / real(count);
            [radius * angle.cos(), radius * angle.sin(), 0.0]
        };
        (0..count).map(place).collect()
    }
}

impl Grid {
    pub(super) fn places(self, count: usize) -> Vec<Point> {
        let most = count.max(1);
        let given = |number: u32| usize::try_from(number).unwrap_or(usize::MAX).clamp(1, most);
        let square = || (1..=most).find(|side| side * side >= count).unwrap_or(most);
        let columns = match (self.columns, self.rows) {
            (Some(columns), _) => given(columns),
            (None, Some(rows)) => count.div_ceil(given(rows)).max(1),
            (None, None) => square(),
        };
        let rows = self.rows.map_or_else(|| count.div_ceil(columns), given).max(1);
        let layers = count.div_ceil(columns * rows);
        let place = |index: usize| {
            let (row, column) = (index / columns, index % columns);
            let steps = [around(column, columns), around(row % rows, rows), around(row / rows, layers)];
            std::array::from_fn(|axis| steps[axis] * self.spacing[axis])
        };
        (0..count).map(place).collect()
    }
}
