//! The values of a grid near a sample, as few as a search can bear.

use super::problem::EXTREME;
use super::{Grid, Unfit};

/// Most candidates of a sample on either side of the nearest; both sides and the nearest fit the 64 bits of a set.
const SIDE_MAX: f64 = 17.0;
/// Multiples up to here are told apart by a double.
const INDEX_MAX: f64 = 9_007_199_254_740_992.0;

/// The multiples of the granularity within the range, known not to be empty.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice {
    low: f64,
    high: f64,
    pub(super) granularity: f64,
}

impl Lattice {
    pub(super) fn new(grid: &Grid) -> Result<Self, Unfit> {
        let granularity = grid.granularity;
        let low = (grid.min / granularity - DECIMAL_DUST).ceil().max(-INDEX_MAX);
        let high = (grid.max / granularity + DECIMAL_DUST).floor().min(INDEX_MAX);
        let usable = (1.0 / EXTREME..=EXTREME).contains(&granularity);
        let ordered = grid.min <= grid.max && low <= high;
        if usable && ordered { Ok(Self { low, high, granularity }) } else { Err(Unfit::Grid) }
    }

    pub(super) fn nearest(&self, value: f64) -> f64 {
        self.nearest_index(value) * self.granularity
    }

    /// The largest value up to this one, or the smallest of all if no value is as small.
    pub(super) fn below(&self, value: f64) -> f64 {
        (value / self.granularity).floor().clamp(self.low, self.high) * self.granularity
    }

    /// The smallest value from this one on, or the largest of all if no value is as large.
    pub(super) fn above(&self, value: f64) -> f64 {
        (value / self.granularity).ceil().clamp(self.low, self.high) * self.granularity
    }

    fn nearest_index(&self, value: f64) -> f64 {
        (value / self.granularity).round().clamp(self.low, self.high)
    }

    /// The values within the room around a sample: all, or the nearest and every so many-th on both sides of it.
    pub(super) fn near(&self, value: f64, room: f64) -> Candidates {
        let low = ((value - room) / self.granularity).ceil().max(self.low);
        let high = ((value + room) / self.granularity).floor().min(self.high);
        if low > high {
            return Candidates::NONE;
        }
        let nearest = self.nearest_index(value).clamp(low, high);
        let stride = ((nearest - low).max(high - nearest) / SIDE_MAX).ceil().max(1.0);
        let below = ((nearest - low) / stride).floor();
        let above = ((high - nearest) / stride).floor();
        let (base, scale) = (nearest - below * stride, self.granularity);
        Candidates { base, scale, stride, last: below + above, thinned: stride > 1.0 }
    }
}

/// A bound such as 0.3 is meant to be a multiple of 0.1.
const DECIMAL_DUST: f64 = 1e-9;

/// The candidate values of one sample, evenly spaced.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidates {
    base: f64,
    scale: f64,
    stride: f64,
    /// Index of the last, -1 if there are none.
    last: f64,
    pub(super) thinned: bool,
}

impl Candidates {
    pub(super) const NONE: Self = Self { base: 0.0, scale: 1.0, stride: 1.0, last: -1.0, thinned: false };

    pub(super) fn only(value: f64) -> Self {
        Self { base: value, last: 0.0, ..Self::NONE }
    }

    pub(super) fn value(&self, index: u8) -> f64 {
        (self.base + f64::from(index) * self.stride) * self.scale
    }

    /// The set of the indices of all values from `low` to `high`, bit by bit.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "indices below 64")]
    pub(super) fn between(&self, low: f64, high: f64) -> u64 {
        let (origin, pitch) = (self.base * self.scale, self.stride * self.scale);
        let (first, last) = (((low - origin) / pitch).max(0.0), ((high - origin) / pitch).min(self.last));
        if first > last {
            return 0;
        }
        // Rounded up and down; on ordinary processors a call for each would take longer than all the rest.
        let (down, last) = (first as u32, last as u32);
        let first = down + u32::from(f64::from(down) < first);
        if first <= last { (u64::MAX >> (63 - (last - first))) << first } else { 0 }
    }

    pub(super) fn all(&self) -> u64 {
        self.between(f64::NEG_INFINITY, f64::INFINITY)
    }
}
