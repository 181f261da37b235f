//! Bounds that a scenario sets for the results of its trials. The scheduler checks them.

use std::fmt;

use urrcp::Span;

/// The scenario's `require` section: bounds on the results of its trials. A bound that is `None` is not required.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Requirements {
    /// Upper bound on the median, over all trials, of the true spread of starts (the time from the first start to the last).
    pub spread_p50: Option<Ceiling>,
    /// Upper bound on the spread of starts (the time from the first start to the last) in 99 of 100 trials.
    pub spread_p99: Option<Ceiling>,
    /// Upper bound on the spread of starts (the time from the first start to the last) in all trials.
    pub spread_max: Option<Ceiling>,
    /// Lower bound on the share of trials in which the mission starts.
    pub starts: Option<Floor<Share>>,
    /// Lower bound on the share of trials in which the mission is done.
    pub finishes: Option<Floor<Share>>,
    /// Lower bound on the distance between any two bodies, from surface to surface, in metres.
    pub closest: Option<Floor<f64>>,
    /// Whether each robot itself must drop a script whose start was not decided.
    pub all_or_none: Option<AllOrNone>,
}

/// How strictly a mission prevents a robot from starting alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AllOrNone {
    /// Each robot acts on `pending_until`, the instant after which it drops a script that has not begun. No delayed message can then
    /// start a script whose start was not decided.
    Strict,
}

impl Requirements {
    /// Whether nothing is required.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// An upper bound on a measured figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ceiling {
    /// The figure must be smaller than this value.
    Below(Span),
    /// The figure must be smaller than or equal to this value.
    AtMost(Span),
}

impl Ceiling {
    /// Whether `figure` satisfies this bound.
    #[must_use]
    pub fn holds(self, figure: Span) -> bool {
        match self {
            Self::Below(bound) => figure < bound,
            Self::AtMost(bound) => figure <= bound,
        }
    }

    /// The value of the bound.
    #[must_use]
    pub const fn bound(self) -> Span {
        match self {
            Self::Below(bound) | Self::AtMost(bound) => bound,
        }
    }

    /// The word for this kind of bound in a scenario: `below` or `at most`.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Below(_) => "below",
            Self::AtMost(_) => "at most",
        }
    }
}

/// A lower bound on a measured figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Floor<T> {
    /// The figure must be larger than this value.
    Above(T),
    /// The figure must be larger than or equal to this value.
    AtLeast(T),
}

impl<T: Copy> Floor<T> {
    /// The value of the bound.
    #[must_use]
    pub const fn bound(self) -> T {
        match self {
            Self::Above(bound) | Self::AtLeast(bound) => bound,
        }
    }

    /// The word for this kind of bound in a scenario: `above` or `at least`.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Above(_) => "above",
            Self::AtLeast(_) => "at least",
        }
    }
}

impl Floor<f64> {
    /// Whether `figure` satisfies this bound. NaN never does.
    #[must_use]
    pub fn holds(self, figure: f64) -> bool {
        match self {
            Self::Above(bound) => figure > bound,
            Self::AtLeast(bound) => figure >= bound,
        }
    }
}

impl Floor<Share> {
    /// Whether `count` out of `all` satisfies this bound, compared exactly.
    #[must_use]
    pub fn holds(self, count: u64, all: u64) -> bool {
        let figure = u128::from(count) * u128::from(Share::WHOLE);
        let bound = u128::from(self.bound().billionths()) * u128::from(all);
        match self {
            Self::Above(_) => figure > bound,
            Self::AtLeast(_) => figure >= bound,
        }
    }
}

/// A share of a whole, in billionths, so that 999 of 1,000 are exactly 99.9 %.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Share(u32);

impl Share {
    const WHOLE: u32 = 1_000_000_000;

    /// Creates a share of `billionths`; more than the whole counts as the whole.
    #[must_use]
    pub fn from_billionths(billionths: u32) -> Self {
        Self(billionths.min(Self::WHOLE))
    }

    /// The share in billionths, from 0 to 1,000,000,000.
    #[must_use]
    pub const fn billionths(self) -> u32 {
        self.0
    }

    /// The share in percent, from 0 to 100.
    #[must_use]
    pub fn percent(self) -> f64 {
        f64::from(self.0) / 1e7
    }
}

impl fmt::Display for Share {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}%", self.percent())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn share_of_trials_is_compared_exactly() {
        let share = Share::from_billionths(999_000_000);
        assert!(Floor::AtLeast(share).holds(999, 1_000));
        assert!(!Floor::Above(share).holds(999, 1_000));
        assert!(Floor::Above(share).holds(1_000, 1_000));
        assert!(!Floor::AtLeast(share).holds(9_989, 10_000));
        assert_eq!(share.to_string(), "99.9%");
    }

    #[test]
    fn bounds_are_inclusive_or_exclusive_as_stated() {
        let bound = Span::from_millis(5);
        assert!(!Ceiling::Below(bound).holds(bound));
        assert!(Ceiling::AtMost(bound).holds(bound));
        assert!(!Floor::Above(0.3).holds(0.3));
        assert!(Floor::AtLeast(0.3).holds(0.3));
        assert!(!Floor::AtLeast(0.3).holds(f64::NAN));
    }
}
