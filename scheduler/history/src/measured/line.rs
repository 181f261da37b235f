//! Models the offset of a robot's clock from the server's as a line over time, which lies between bounds from all exchanges.
//! `docs/measured.md` describes the method and its sources.

use std::ops::Neg;

use urrcp::{Server, Span, Timestamp};

use crate::history::Exchange;
use downbeat_mission::clock::resolution;

/// Fastest drift that the search covers, as a fraction. It exceeds the drift of any real clock, and is the maximum for a simulated clock.
const RATE_MAX: f64 = 0.1;
/// Minimum number of exchanges, and minimum time that they cover, to measure a drift. With less data, a drift cannot be distinguished
/// from varying delays and is assumed to be zero.
const EXCHANGES_FOR_DRIFT: usize = 20;
const TIME_FOR_DRIFT: Span = Span::from_millis(1_000);
/// Number of steps of the search for a rate. The range of rates that remains afterwards corresponds to less than a nanosecond per hour.
const CUTS: usize = 100;

/// The offset of a robot's clock from the server's, as a line over time.
#[derive(Clone, Copy, Debug)]
pub(super) struct ClockLine {
    origin: Timestamp<Server>,
    /// Offset of the clock at `origin`, in nanoseconds.
    offset: f64,
    /// Drift of the clock as a fraction.
    pub(super) rate: f64,
    /// The range of rates for which a line fits between the bounds. `None` if no rate was searched for.
    pub(super) rates: Option<(f64, f64)>,
    /// Distance between the upper and the lower bounds along the line, in nanoseconds: the sum of the minimum delays in both directions.
    gap: f64,
}

/// Bounds on the clock offset. Each bound is a pair of instant and offset, in nanoseconds. Messages to the robot give upper bounds, and
/// messages from the robot give lower bounds.
struct Bounds {
    upper: Vec<(f64, f64)>,
    lower: Vec<(f64, f64)>,
}

impl ClockLine {
    /// Fits the line with the largest distance from the upper and the lower bounds. This assumes equal minimum delays in both directions.
    /// `None` if no line fits between the bounds, because the clock was set or runs unevenly.
    pub(super) fn fit(exchanges: &[Exchange]) -> Option<Self> {
        let first = exchanges.first()?;
        let origin = first.sent;
        let zero = nanos(first.robot_received.assume_clock() - first.sent);
        let bounds = Bounds::of(exchanges, origin, zero);
        let last = exchanges.last().map_or(origin, |exchange| exchange.received);
        let step = -nanos(counts_in(exchanges));
        let drift_shows = exchanges.len() >= EXCHANGES_FOR_DRIFT && last - origin >= TIME_FOR_DRIFT;
        let (rate, rates) = if !drift_shows && bounds.gap(0.0) >= step {
            (0.0, None)
        } else {
            let rate = bounds.widest();
            (rate, bounds.possible(rate))
        };
        let gap = bounds.gap(rate);
        let offset = zero + f64::midpoint(bounds.least_upper(rate), bounds.greatest_lower(rate));
        (gap >= step).then_some(Self { origin, offset, rate, rates, gap: gap.max(0.0) })
    }

    /// The robot's clock minus the server's clock at an instant, in nanoseconds.
    fn at(&self, at: Timestamp<Server>) -> f64 {
        self.offset + self.rate * nanos(at - self.origin)
    }

    /// The robot's clock minus the server's clock at an instant.
    pub(super) fn offset_at(&self, at: Timestamp<Server>) -> Span {
        span(self.at(at))
    }

    /// The one-way travel times of a question and of its answer.
    pub(super) fn ways(&self, exchange: &Exchange) -> [Span; 2] {
        let there = nanos(exchange.robot_received.assume_clock() - exchange.sent) - self.at(exchange.sent);
        let back = nanos(exchange.received - exchange.robot_sent.assume_clock()) + self.at(exchange.received);
        [there, back].map(|way| span(way.max(0.0)))
    }

    /// Uncertainty of the offset: the error if one direction has no delay, so that the other has the whole minimum delay of a round trip.
    pub(super) fn uncertainty(&self) -> Span {
        span(self.gap / 2.0)
    }
}

impl Bounds {
    fn of(exchanges: &[Exchange], origin: Timestamp<Server>, zero: f64) -> Self {
        let upper = |exchange: &Exchange| {
            let bound = nanos(exchange.robot_received.assume_clock() - exchange.sent);
            (nanos(exchange.sent - origin), bound - zero)
        };
        let lower = |exchange: &Exchange| {
            let bound = nanos(exchange.robot_sent.assume_clock() - exchange.received);
            (nanos(exchange.received - origin), bound - zero)
        };
        Self { upper: exchanges.iter().map(upper).collect(), lower: exchanges.iter().map(lower).collect() }
    }

    fn least_upper(&self, rate: f64) -> f64 {
        self.upper.iter().map(|(at, bound)| bound - rate * at).fold(f64::INFINITY, f64::min)
    }

    fn greatest_lower(&self, rate: f64) -> f64 {
        self.lower.iter().map(|(at, bound)| bound - rate * at).fold(f64::INFINITY.neg(), f64::max)
    }

    /// Returns the distance between the upper and the lower bounds along a line with the given rate. It is a concave function of the
    /// rate, because it is a minimum of linear functions minus a maximum of linear functions.
    fn gap(&self, rate: f64) -> f64 {
        self.least_upper(rate) - self.greatest_lower(rate)
    }

    /// Returns the rate of the line along which the bounds are furthest apart.
    fn widest(&self) -> f64 {
        let (mut least, mut most) = (-RATE_MAX, RATE_MAX);
        for _ in 0..CUTS {
            let third = (most - least) / 3.0;
            let (low, high) = (least + third, most - third);
            if self.gap(low) < self.gap(high) { least = low } else { most = high }
        }
        f64::midpoint(least, most)
    }

    /// Returns the range of rates for which a line fits between the bounds; `None` if there is no such rate.
    fn possible(&self, widest: f64) -> Option<(f64, f64)> {
        let end = |far: f64| {
            let (mut inside, mut outside) = (widest, far);
            for _ in 0..CUTS {
                let middle = f64::midpoint(inside, outside);
                if self.gap(middle) >= 0.0 { inside = middle } else { outside = middle }
            }
            inside
        };
        (self.gap(widest) >= 0.0).then(|| (end(-RATE_MAX), end(RATE_MAX)))
    }
}

/// Estimates the resolution of a robot's timestamps.
pub(super) fn counts_in(exchanges: &[Exchange]) -> Span {
    let steps = exchanges.iter().map(|exchange| resolution(exchange.robot_received, exchange.robot_sent));
    steps.min().unwrap_or_default()
}

#[expect(clippy::cast_precision_loss, reason = "exact up to 104 days, else rounded")]
const fn nanos(span: Span) -> f64 {
    span.as_nanos() as f64
}

fn span(nanos: f64) -> Span {
    Span::from_millis_f64(nanos / 1e6)
}
