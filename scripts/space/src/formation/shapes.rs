//! Shapes for any number of bodies. Flat shapes lie on the floor, with their middle at the origin.

use std::f64::consts::{PI, TAU};

use super::Point;

/// Places on a line along the x axis, from left to right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Line {
    /// Distance between neighbours, in metres.
    Spacing(f64),
    /// Distance from the first to the last place, in metres.
    Length(f64),
}

/// Places on a circle around the origin, starting at the x axis, counterclockwise as seen from above.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ring {
    /// Radius in metres.
    Radius(f64),
    /// Straight distance between neighbours, in metres.
    Spacing(f64),
}

/// Places on a grid: row by row along the x axis, the rows along the y axis, and layers of full rows along the z axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Distance between columns, rows and layers, in metres.
    pub spacing: Point,
    /// Number of columns; `None` for as many as make the grid square.
    pub columns: Option<u32>,
    /// Number of rows in a layer; `None` for as many as needed in a single layer.
    pub rows: Option<u32>,
}

/// Places on two arms of equal length that meet at a tip at the origin and open along the y axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vee {
    /// Distance between neighbours on an arm, in metres.
    pub spacing: f64,
    /// Angle between the arms, in degrees.
    pub angle: f64,
}

/// Places on a sphere around the origin, from the top to the bottom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// Radius in metres.
    pub radius: f64,
}

/// Returns number `index` of `count` numbers in steps of 1 that are centred at 0. Three numbers are -1, 0 and 1; two are -0.5 and 0.5.
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
            // The chord of one part of a circle with n equal parts: 2 r sin(pi / n).
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

impl Vee {
    /// Returns the tip, then alternately one place on the left arm and one on the right arm.
    pub(super) fn places(self, count: usize) -> Vec<Point> {
        let (across, along) = (self.angle / 2.0).to_radians().sin_cos();
        let place = |index: usize| {
            let far = self.spacing * real(index.div_ceil(2));
            let side = if index % 2 == 1 { -1.0 } else { 1.0 };
            [side * far * across, far * along, 0.0]
        };
        (0..count).map(place).collect()
    }
}

/// Fraction of a turn between successive places of a sphere: the golden ratio, so that no two places are above each other.
const GOLDEN_TURN: f64 = 0.618_033_988_749_894_8;

impl Ball {
    /// Returns the Fibonacci lattice (Swinbank and Purser, Q. J. R. Meteorol. Soc. 132, 2006; González, Math. Geosci. 42, 2010). Heights
    /// are in the middles of equal slices, which have equal areas. Each place is a golden turn further than the previous one.
    pub(super) fn places(self, count: usize) -> Vec<Point> {
        let place = |index: usize| {
            let height = 1.0 - (2.0 * real(index) + 1.0) / real(count);
            let across = (1.0 - height * height).max(0.0).sqrt();
            let angle = TAU * (real(index) * GOLDEN_TURN).fract();
            [across * angle.cos(), across * angle.sin(), height].map(|part| self.radius * part)
        };
        (0..count).map(place).collect()
    }
}
