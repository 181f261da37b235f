//! The grid values near a sample, thinned to a number that the search can handle.

use super::problem::EXTREME;
use super::{Grid, Unfit};

/// Maximum number of candidates of a sample on either side of the nearest one. Both sides and the nearest one fit in a bit set of 64
/// bits.
const SIDE_MAX: f64 = 17.0;
/// Maximum number of candidates of a sample.
pub(super) const VALUES_MAX: usize = 35;
/// Largest index of a grid value, which is the index times the granularity: a double represents whole numbers exactly up to 2^53.
const INDEX_MAX: f64 = 9_007_199_254_740_992.0;

/// The grid values of a device: the granularity times each whole number from `low` to `high`; at least one exists.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice {
    low: f64,
    high: f64,
    pub(super) granularity: f64,
    /// Number of grid values per unit: the inverse of the granularity.
    density: f64,
}

impl Lattice {
    pub(super) fn new(grid: &Grid) -> Result<Self, Unfit> {
        let granularity = grid.granularity;
        let low = (grid.min / granularity - DECIMAL_DUST).ceil().max(-INDEX_MAX);
        let high = (grid.max / granularity + DECIMAL_DUST).floor().min(INDEX_MAX);
        let usable = (1.0 / EXTREME..=EXTREME).contains(&granularity);
        let ordered = grid.min <= grid.max && low <= high;
        if usable && ordered {
            Ok(Self { low, high, granularity, density: 1.0 / granularity })
        } else {
            Err(Unfit::Grid)
        }
    }

    pub(super) fn nearest(&self, value: f64) -> f64 {
        self.nearest_index(value) * self.granularity
    }

    /// The largest grid value that is at most `value`. If all grid values are larger, the smallest one.
    pub(super) fn below(&self, value: f64) -> f64 {
        (value / self.granularity).floor().clamp(self.low, self.high) * self.granularity
    }

    /// The smallest grid value that is at least `value`. If all grid values are smaller, the largest one.
    pub(super) fn above(&self, value: f64) -> f64 {
        (value / self.granularity).ceil().clamp(self.low, self.high) * self.granularity
    }

    fn nearest_index(&self, value: f64) -> f64 {
        round(value / self.granularity).clamp(self.low, self.high)
    }

    /// The grid values that differ from `value` by at most `room`. If there are too many, returns the nearest one, and every nth one on
    /// both sides of it.
    pub(super) fn near(&self, value: f64, room: f64) -> Candidates {
        let low = ceil((value - room) / self.granularity).max(self.low);
        let high = floor((value + room) / self.granularity).min(self.high);
        if low > high {
            return Candidates::NONE;
        }
        let nearest = self.nearest_index(value).clamp(low, high);
        let (scale, farthest) = (self.granularity, (nearest - low).max(high - nearest));
        if farthest <= SIDE_MAX {
            return Candidates::new([low, 1.0, scale], high - low, self.density);
        }
        let stride = ceil(farthest / SIDE_MAX);
        let below = floor((nearest - low) / stride);
        let above = floor((high - nearest) / stride);
        let base = nearest - below * stride;
        Candidates::new([base, stride, scale], below + above, self.density / stride)
    }
}

/// Whole numbers below this bound fit in an `i64`.
const WHOLE_MAX: f64 = 9e15;

/// The value without its fraction digits; `None` from [`WHOLE_MAX`] on. The rounding functions of the standard library are too slow here:
/// on common processors, they are function calls.
#[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "below WHOLE_MAX")]
fn truncated(value: f64) -> Option<f64> {
    (value.abs() < WHOLE_MAX).then_some(value as i64 as f64)
}

fn floor(value: f64) -> f64 {
    truncated(value).map_or_else(|| value.floor(), |whole| if whole > value { whole - 1.0 } else { whole })
}

fn ceil(value: f64) -> f64 {
    truncated(value).map_or_else(|| value.ceil(), |whole| if whole < value { whole + 1.0 } else { whole })
}

fn round(value: f64) -> f64 {
    let away = |whole: f64| if (value - whole).abs() >= 0.5 { whole + value.signum() } else { whole };
    truncated(value).map_or_else(|| value.round(), |whole| away(whole).copysign(value))
}

/// Tolerance for rounding in decimal bounds, so that 0.3 counts as a multiple of 0.1.
const DECIMAL_DUST: f64 = 1e-9;

/// The candidate values of one sample, evenly spaced.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidates {
    base: f64,
    scale: f64,
    stride: f64,
    /// The value of the first candidate.
    origin: f64,
    /// Number of candidates per unit.
    density: f64,
    /// The index of the last candidate, counted from 0; -1 if there are no candidates.
    last: f64,
}

impl Candidates {
    pub(super) const NONE: Self =
        Self { base: 0.0, scale: 1.0, stride: 1.0, origin: 0.0, density: 1.0, last: -1.0 };

    fn new([base, stride, scale]: [f64; 3], last: f64, density: f64) -> Self {
        Self { base, scale, stride, origin: base * scale, density, last }
    }

    pub(super) fn only(value: f64) -> Self {
        Self { base: value, origin: value, last: 0.0, ..Self::NONE }
    }

    pub(super) fn are_thinned(&self) -> bool {
        self.stride > 1.0
    }

    pub(super) fn value(&self, index: u8) -> f64 {
        (self.base + f64::from(index) * self.stride) * self.scale
    }

    /// The indices of all values from `low` to `high`, as a bit set.
    pub(super) fn between(&self, low: f64, high: f64) -> u64 {
        self.indices((low - self.origin) * self.density, (high - self.origin) * self.density)
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "indices below 64")]
    fn indices(&self, first: f64, last: f64) -> u64 {
        let (first, last) = (first.max(0.0), last.min(self.last));
        if first > last {
            return 0;
        }
        // `first` is rounded up, `last` down.
        let (down, last) = (first as u32, last as u32);
        let first = down + u32::from(f64::from(down) < first);
        if first <= last { (u64::MAX >> (63 - (last - first))) << first } else { 0 }
    }

    /// Returns the indices of all values that are also in `nearer`, the candidates of the same sample within a smaller distance from the
    /// curve. Neither set may be thinned.
    pub(super) fn common(&self, nearer: &Self) -> u64 {
        let first = nearer.base - self.base;
        self.indices(first, first + nearer.last)
    }

    pub(super) fn all(&self) -> u64 {
        self.indices(0.0, self.last)
    }
}
