//! Offsets between clocks, from exchanges of four timestamps as in NTP (RFC 5905, section 8). This module reads no clock. The method and
//! its sources are in `docs/clocks.md`.

mod round_trips;

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use urrcp::{Robot, Server, Span, Timestamp};

use round_trips::RoundTrips;

/// The maximum assumed drift between two clocks, as a fraction, until the drift has been measured. IEEE 802.3 allows this much for the
/// oscillator of a network port, and thus of a free-running computer.
pub const DRIFT_BOUND: f64 = 100e-6;

/// The maximum change of a measured drift while it is tracked, as a fraction: PHI, the frequency tolerance of RFC 5905, section 7.2.
pub const DRIFT_WANDER: f64 = 15e-6;

/// The uncertainty above which a measured drift is neither reported nor tracked. A worse estimate is hardly better than [`DRIFT_BOUND`].
const DRIFT_KNOWN: f64 = DRIFT_BOUND / 2.0;

/// The number of time bins in which exchanges are collected to measure the drift. The bins widen until together they span the window.
const BINS: usize = 64;
const WINDOW: Span = Span::from_millis(3_600_000);
/// The width of the bins is doubled at most this often: from 220 ms to 56 s.
const DOUBLINGS_MAX: u32 = 8;
const FIRST_BIN_NANOS: i64 = (WINDOW.as_nanos() / 64) >> DOUBLINGS_MAX;

/// One exchange of timestamps with a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockSample {
    /// The robot's clock minus the server's, assuming that both directions took the same time.
    pub offset: Span,
    /// Round trip without the robot's processing time.
    pub delay: Span,
    /// The lower bound of the offset at `at`. It is reached if the answer took no time to travel.
    pub lower: Span,
    /// The upper bound of the offset at `sent`. It is reached if the question took no time to travel.
    pub upper: Span,
    /// The time at which the server sent the question.
    pub sent: Timestamp<Server>,
    /// The time at which the server received the answer.
    pub at: Timestamp<Server>,
}

impl ClockSample {
    /// Computes a sample from the four timestamps of an exchange. Offset ((T2-T1)+(T3-T4))/2 and delay (T4-T1)-(T3-T2), RFC 5905 section
    /// 8; bounds T3-T4 and T2-T1, widened by the resolution of the robot's timestamps.
    #[must_use]
    pub fn from_exchange(
        sent: Timestamp<Server>,
        robot_received: Timestamp<Robot>,
        robot_sent: Timestamp<Robot>,
        received: Timestamp<Server>,
    ) -> Self {
        let there = robot_received - sent.assume_clock();
        let back = robot_sent - received.assume_clock();
        let delay = (received - sent) - (robot_sent - robot_received);
        let resolution = resolution(robot_received, robot_sent);
        Self {
            offset: back + (there - back) / 2,
            delay: delay.max(Span::ZERO),
            lower: back - resolution,
            upper: there + resolution,
            sent,
            at: received,
        }
    }
}

/// Returns the resolution of two timestamps of a robot: 1 ms, 1 µs or 1 ns. Many robots write milliseconds or microseconds. On a fast
/// link, this resolution is longer than the travel time.
#[must_use]
pub fn resolution(one: Timestamp<Robot>, other: Timestamp<Robot>) -> Span {
    let counts_in = |step: &i64| one.as_nanos() % step == 0 && other.as_nanos() % step == 0;
    Span::from_nanos([1_000_000, 1_000].into_iter().find(counts_in).unwrap_or(1))
}

/// A lower or upper bound of a clock's offset at an instant.
#[derive(Clone, Copy, Debug)]
struct Bound {
    at: Timestamp<Server>,
    value: Span,
}

impl Bound {
    fn drifted(self, now: Timestamp<Server>, rate: f64) -> Span {
        self.value + Span::from_millis_f64((now - self.at).as_millis_f64() * rate)
    }

    /// Returns the value of this lower bound at `now`, if the offset drifts at a rate within `rates`.
    fn least(self, now: Timestamp<Server>, rates: Rates) -> Span {
        self.drifted(now, rates.least).min(self.drifted(now, rates.most))
    }

    /// Returns the value of this upper bound at `now`, if the offset drifts at a rate within `rates`.
    fn most(self, now: Timestamp<Server>, rates: Rates) -> Span {
        self.drifted(now, rates.least).max(self.drifted(now, rates.most))
    }

    /// Returns the mean drift rate since `earlier`, if both bounds equalled the offset itself. `None` if no time has passed.
    fn rate_since(self, earlier: Self) -> Option<f64> {
        let time = (self.at - earlier.at).as_millis_f64();
        (time > 0.0).then(|| (self.value - earlier.value).as_millis_f64() / time)
    }
}

/// The range in which the drift rate of the offset lies.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Rates {
    least: f64,
    most: f64,
}

impl Rates {
    const ANY: Self = Self { least: -DRIFT_BOUND, most: DRIFT_BOUND };
    const UNKNOWN: Self = Self { least: f64::NEG_INFINITY, most: f64::INFINITY };

    const fn exactly(rate: f64) -> Self {
        Self { least: rate, most: rate }
    }

    fn and(self, other: Self) -> Self {
        Self { least: self.least.max(other.least), most: self.most.min(other.most) }
    }
}

/// The tightest lower bound and the tightest upper bound from several exchanges. The two bounds may come from different exchanges.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    lower: Bound,
    upper: Bound,
}

impl Bounds {
    fn of(sample: &ClockSample) -> Self {
        // A robot that claims a longer processing time than the whole exchange is wrong. No value inside those bounds is better.
        let (lower, upper) = (sample.lower.min(sample.upper), sample.lower.max(sample.upper));
        Self { lower: Bound { at: sample.at, value: lower }, upper: Bound { at: sample.sent, value: upper } }
    }

    /// Replaces each bound by that of `other` if the latter is tighter at `now`.
    fn tighten(&mut self, other: Self, now: Timestamp<Server>, rates: Rates) {
        if other.lower.least(now, rates) >= self.lower.least(now, rates) {
            self.lower = other.lower;
        }
        if other.upper.most(now, rates) <= self.upper.most(now, rates) {
            self.upper = other.upper;
        }
    }

    fn interval(self, now: Timestamp<Server>, rates: Rates) -> Interval {
        Interval { lower: self.lower.least(now, rates), upper: self.upper.most(now, rates) }
    }
}

#[derive(Clone, Copy, Debug)]
struct Interval {
    lower: Span,
    upper: Span,
}

impl Interval {
    fn and(self, other: Self) -> Self {
        Self { lower: self.lower.max(other.lower), upper: self.upper.min(other.upper) }
    }

    fn is_empty(self) -> bool {
        self.lower > self.upper
    }
}

/// The estimate of a robot's clock and link from the exchanges so far. The clock's offset lies within the intersection of all their
/// bounds.
#[derive(Clone, Debug, Default)]
pub struct ClockEstimate {
    /// The tightest bounds of all exchanges since the clock was last set. Drift within [`DRIFT_BOUND`] never changes which of two bounds
    /// is tighter, so one lower and one upper bound are enough.
    bounds: Option<Bounds>,
    history: History,
    latest: Option<Timestamp<Server>>,
    delay_min: Span,
    delay_max: Span,
    round_trips: RoundTrips,
    samples: u32,
    steps: u32,
}

/// The estimate of a robot's clock, as reported.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClockReading {
    /// The robot's clock minus the server's, in milliseconds.
    #[serde(rename = "offset_ms")]
    pub offset: Span,
    /// The true offset differs from `offset` by at most this, whatever the asymmetry of the path.
    #[serde(rename = "uncertainty_ms")]
    pub uncertainty: Span,
    /// The shortest of all round trips.
    #[serde(rename = "delay_min_ms")]
    pub delay_min: Span,
    /// The longest of all round trips.
    #[serde(rename = "delay_max_ms")]
    pub delay_max: Span,
    /// The round trip on which the mission bases its waiting times. It leaves out isolated outliers and, unlike `delay_max`, forgets old
    /// round trips.
    #[serde(rename = "delay_high_ms")]
    pub delay_high: Span,
    /// The number of exchanges so far.
    pub samples: u32,
    /// The number of exchanges that contradicted earlier ones: a clock was set, or is wrong.
    pub steps: u32,
    /// How fast the robot's clock gains on the server's; `None` until the exchanges span enough time.
    #[serde(flatten)]
    pub drift: Option<Drift>,
}

/// The reason why, according to a clock reading, a robot may start at the wrong time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockDoubt {
    /// The clock is certainly off, whatever the path. Check its synchronization.
    Clock,
    /// The clock may be right, but the round trips are too long or too uneven to be sure. Check the link.
    Path,
}

impl ClockDoubt {
    /// Returns the reason to doubt an offset with this uncertainty. It is the clock, which is certainly off, if the uncertainty interval
    /// excludes zero; otherwise, it is the path.
    #[must_use]
    pub fn of(offset: Span, uncertainty: Span) -> Self {
        if offset.abs() > uncertainty { Self::Clock } else { Self::Path }
    }
}

impl ClockReading {
    /// Returns the main reason why a reading is too bad for a start: the clock's offset, or the uncertainty of the path.
    #[must_use]
    pub fn doubt(&self) -> ClockDoubt {
        ClockDoubt::of(self.offset, self.uncertainty)
    }
}

/// The rate at which one clock gains on another, in parts per million.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Drift {
    /// The rate, in parts per million.
    #[serde(rename = "drift_ppm")]
    pub ppm: f64,
    /// The true rate differs from `ppm` by at most this.
    #[serde(rename = "drift_uncertainty_ppm")]
    pub uncertainty_ppm: f64,
}

impl ClockEstimate {
    /// Adds an exchange. If it contradicts the earlier ones, those are discarded: only the new one certainly reflects the current clock.
    pub fn add(&mut self, sample: ClockSample) {
        self.delay_min = if self.samples == 0 { sample.delay } else { self.delay_min.min(sample.delay) };
        self.delay_max = self.delay_max.max(sample.delay);
        self.round_trips.add(sample.at, sample.delay);
        self.samples = self.samples.saturating_add(1);
        self.latest = self.latest.max(Some(sample.at));
        let (new, now) = (Bounds::of(&sample), sample.at);
        let told = new.interval(now, Rates::ANY);
        let all = self.bounds.map(|bounds| bounds.interval(now, Rates::ANY));
        match (&mut self.bounds, all) {
            (Some(bounds), Some(all)) if !all.and(told).is_empty() => {
                bounds.tighten(new, now, Rates::ANY);
                if self.history.narrow(all, now).and(told).is_empty() {
                    // The clock drifted within the bound, but not at the measured rate: NTP may have begun to correct it.
                    self.history = History::default();
                }
            }
            (bounds, _) => {
                self.steps += u32::from(bounds.is_some());
                *bounds = Some(new);
                self.history = History::default();
            }
        }
        self.history.add(new, now);
    }

    /// Returns the number of exchanges so far.
    #[must_use]
    pub const fn samples(&self) -> u32 {
        self.samples
    }

    /// Returns the number of exchanges that contradicted earlier ones.
    #[must_use]
    pub const fn steps(&self) -> u32 {
        self.steps
    }

    /// Returns the estimate as of the latest exchange, or `None` before the first.
    #[must_use]
    pub fn reading(&self) -> Option<ClockReading> {
        self.latest.and_then(|at| self.reading_at(at))
    }

    /// Returns the round trip time that is rarely exceeded; zero before the first exchange.
    pub(crate) const fn delay_high(&self) -> Span {
        self.round_trips.high()
    }

    /// Whether there were enough exchanges to distinguish an isolated long round trip from the usual ones.
    pub(crate) fn tells_outliers(&self) -> bool {
        self.round_trips.tell_outliers()
    }

    /// Returns the estimate extrapolated to `now` by the drift, if known, with correspondingly larger uncertainty. `None` before the
    /// first exchange.
    #[must_use]
    pub fn reading_at(&self, now: Timestamp<Server>) -> Option<ClockReading> {
        let all = self.bounds?.interval(now, Rates::ANY);
        let narrow = self.history.narrow(all, now);
        let interval = if narrow.is_empty() { all } else { narrow };
        let half = (interval.upper - interval.lower) / 2;
        Some(ClockReading {
            offset: interval.lower + half,
            uncertainty: half + Span::from_nanos(1),
            delay_min: self.delay_min,
            delay_max: self.delay_max,
            delay_high: self.round_trips.high(),
            samples: self.samples,
            steps: self.steps,
            drift: self.history.drift(),
        })
    }
}

/// The bounds from the exchanges of the last hour, from which the drift is computed. They are collected in at most [`BINS`] bins, however
/// many exchanges there are.
#[derive(Clone, Debug)]
struct History {
    bins: VecDeque<Bin>,
    doublings: u32,
    /// The range in which the mean drift rate from any bin to any later one lies.
    means: Rates,
    narrowest: Option<Narrowest>,
}

/// The tightest bounds among all bins at the current drift rates. As long as the rates stay the same, these bounds remain the tightest at
/// any later instant.
#[derive(Clone, Copy, Debug)]
struct Narrowest {
    rates: Rates,
    bounds: Bounds,
    since: Timestamp<Server>,
}

/// The tightest bounds of the exchanges in one time bin; `index` is the number of the bin.
#[derive(Clone, Copy, Debug)]
struct Bin {
    index: i64,
    bounds: Bounds,
}

impl Default for History {
    fn default() -> Self {
        Self { bins: VecDeque::new(), doublings: 0, means: Rates::UNKNOWN, narrowest: None }
    }
}

impl History {
    fn add(&mut self, new: Bounds, now: Timestamp<Server>) {
        let index = now.as_nanos().div_euclid(FIRST_BIN_NANOS << self.doublings);
        // The tightest bound of a bin depends on the common drift rate.
        let together =
            Rates::exactly(self.rates().map_or(0.0, |rates| f64::midpoint(rates.least, rates.most)));
        match self.bins.back_mut() {
            Some(bin) if index <= bin.index => bin.bounds.tighten(new, now, together),
            _ => {
                // Closes the current bin and updates the estimate from it.
                let ended = self.bins.len().saturating_sub(1);
                self.means = (0..ended).fold(self.means, |means, bin| means.and(self.mean(bin, ended)));
                self.bins.push_back(Bin { index, bounds: new });
                self.make_room(now, together);
            }
        }
        self.narrowest = self.rates().map(|rates| self.narrowest_with(new, now, rates));
    }

    fn narrowest_with(&self, new: Bounds, now: Timestamp<Server>, rates: Rates) -> Narrowest {
        let known = self.narrowest.filter(|known| known.rates == rates && known.since <= now);
        let (mut bounds, bins) = match known {
            Some(known) => (known.bounds, 0),
            None => (new, self.bins.len()),
        };
        bounds.tighten(new, now, rates);
        self.bins.iter().take(bins).for_each(|bin| bounds.tighten(bin.bounds, now, rates));
        Narrowest { rates, bounds, since: now }
    }

    fn make_room(&mut self, now: Timestamp<Server>, together: Rates) {
        while self.bins.len() > BINS && self.doublings < DOUBLINGS_MAX {
            self.doublings += 1;
            let mut wider: VecDeque<Bin> = VecDeque::with_capacity(BINS + 1);
            for bin in self.bins.drain(..) {
                let index = bin.index.div_euclid(2);
                match wider.back_mut() {
                    Some(last) if last.index == index => last.bounds.tighten(bin.bounds, now, together),
                    _ => wider.push_back(Bin { index, ..bin }),
                }
            }
            self.bins = wider;
        }
        let before = self.bins.len();
        let is_old = |bin: &Bin| now - bin.bounds.lower.at > WINDOW;
        while self.bins.len() > BINS || self.bins.front().is_some_and(is_old) {
            self.bins.pop_front();
        }
        if self.bins.len() < before {
            self.narrowest = None;
            // Knowledge from the discarded bins is discarded as well, so that the drift may change over the hours.
            let ended = self.bins.len().saturating_sub(1);
            let pairs = (0..ended).flat_map(|later| (0..later).map(move |earlier| (earlier, later)));
            self.means = pairs.fold(Rates::UNKNOWN, |means, (a, b)| means.and(self.mean(a, b)));
        }
    }

    /// Returns the range of the mean drift rate from one bin to a later one.
    fn mean(&self, earlier: usize, later: usize) -> Rates {
        let (earlier, later) = (self.bins[earlier].bounds, self.bins[later].bounds);
        Rates {
            least: later.lower.rate_since(earlier.upper).unwrap_or(f64::NEG_INFINITY),
            most: later.upper.rate_since(earlier.lower).unwrap_or(f64::INFINITY),
        }
    }

    /// Returns the range of the current drift rate; `None` until it is known well. No rate in the window differs by more than
    /// [`DRIFT_WANDER`] from a mean rate measured anywhere in the window.
    fn rates(&self) -> Option<Rates> {
        let Rates { least, most } = self.means;
        let rates = Rates { least: least - DRIFT_WANDER, most: most + DRIFT_WANDER }.and(Rates::ANY);
        let half = (rates.most - rates.least) / 2.0;
        (0.0..DRIFT_KNOWN).contains(&half).then_some(rates)
    }

    fn drift(&self) -> Option<Drift> {
        self.rates().map(|rates| Drift {
            ppm: f64::midpoint(rates.least, rates.most) * 1e6,
            uncertainty_ppm: (rates.most - rates.least) / 2.0 * 1e6,
        })
    }

    /// Returns the part of an interval that lies within the bounds of the window. These bounds are extrapolated to `now` by the drift.
    fn narrow(&self, interval: Interval, now: Timestamp<Server>) -> Interval {
        let Some(rates) = self.rates() else { return interval };
        if let Some(narrowest) = self.narrowest.filter(|narrowest| narrowest.since <= now) {
            return interval.and(narrowest.bounds.interval(now, rates));
        }
        self.bins.iter().fold(interval, |interval, bin| interval.and(bin.bounds.interval(now, rates)))
    }
}

/// The server's clock relative to NTP during a mission.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct NtpState {
    /// NTP time minus the server's clock. The server's clock was set to NTP time at first, so this is the change since then.
    #[serde(rename = "offset_change_ms")]
    pub offset_change: Span,
    /// The true change differs from `offset_change` by at most this, if the NTP server is right; `None` before the first answer.
    #[serde(rename = "uncertainty_ms", skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<Span>,
    /// The rate at which NTP time gains on the server's clock, once known.
    #[serde(flatten)]
    pub drift: Option<Drift>,
    /// The number of times that NTP time contradicted itself: the NTP server was set, or is wrong.
    pub steps: u32,
    /// The time since which the NTP server has not answered; `None` unless it has left several questions unanswered.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lost_since: Option<Timestamp<Server>>,
}

#[cfg(test)]
mod tests;
