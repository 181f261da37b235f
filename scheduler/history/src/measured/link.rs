//! Measures the delays and losses of a robot's link from its exchanges.

use serde::Serialize;
use urrcp::{Server, Span, Timestamp};

use super::line::{ClockLine, counts_in};
use crate::history::Exchange;

/// Delay beyond the minimum from which a message counts as lost and retransmitted. The minimum retransmission timeout of Linux is 200 ms
/// plus the round trip. A twentieth of it is subtracted for coarse timers.
const RESENT_AFTER: Span = Span::from_millis(190);
/// Alternative to `RESENT_AFTER`, as a multiple of the median deviation of the delays. The larger of the two limits applies. On a link
/// with widely varying delays, the retransmission timeout is also longer (RFC 6298, section 2).
const DEVIATIONS: i64 = 4;
/// Additional delay from which the link counts as interrupted. A message that is lost three times in a row has this delay (200 + 400 +
/// 800 ms).
const INTERRUPTED: Span = Span::from_millis(1_400);

/// The measured properties of a robot's link.
#[derive(Clone, Debug, Serialize)]
pub struct LinkMeasured {
    /// How the two directions of an exchange were separated.
    pub method: Method,
    /// Number of questions that the robot answered.
    pub exchanges: usize,
    /// Number of one-way delays that the quantiles are based on. Messages that were lost or queued behind a lost one are excluded.
    pub samples: usize,
    /// Quantiles of the one-way delay.
    #[serde(rename = "delay_ms")]
    pub delay: Quantiles,
    /// The packet loss of the link.
    pub loss: Loss,
    /// Periods in which no message passed although the connection persisted.
    pub interruptions: Vec<Interruption>,
    /// Mean time between interruptions: the time from the first question to the last answer, divided by the number of interruptions.
    #[serde(rename = "interruption_every_ms")]
    pub interruption_every: Option<Span>,
}

/// How the two directions of an exchange were separated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Each direction was measured separately. This assumes that the clock offset is a line over time, and that both directions have
    /// equal minimum delays.
    EachWay,
    /// Each delay is half of a round trip, because the robot's clock was set or its timestamps are too coarse.
    HalfRoundTrip,
}

/// Quantiles of a delay, in milliseconds in JSON.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Quantiles {
    /// The smallest delay.
    pub least: Span,
    /// The median delay.
    pub p50: Span,
    /// The 90th percentile of the delay.
    pub p90: Span,
    /// The 99th percentile of the delay.
    pub p99: Span,
    /// The largest delay.
    pub largest: Span,
}

/// The packet loss of a link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Loss {
    /// Number of lost packets, recognized by the delay of their retransmission. Packets queued behind a lost one are not counted
    /// separately.
    pub lost: usize,
    /// Number of packets that were evaluated.
    pub packets: usize,
    /// `lost` divided by `packets`, from 0 to 1.
    pub share: f64,
    /// Upper bound on the loss with 95 % confidence, by the statistical rule of three. `None` if a packet was lost.
    pub below: Option<f64>,
    /// Median additional delay of the packets that were lost and resent; `None` if no packet was lost.
    #[serde(rename = "resent_after_ms")]
    pub resent_after: Option<Span>,
}

/// A period in which no message passed a link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Interruption {
    /// Departure of the first message that was delayed.
    pub from: Timestamp<Server>,
    /// The duration of the interruption.
    #[serde(rename = "lasted_ms")]
    pub lasted: Span,
}

impl Interruption {
    fn end(&self) -> Timestamp<Server> {
        self.from + self.lasted
    }
}

/// A message with its departure and travel time, or a question and its answer with departure and round trip.
#[derive(Clone, Copy)]
struct Trip {
    sent: Timestamp<Server>,
    took: Span,
}

/// The travel times of messages, classified as usual, lost or interrupted.
#[derive(Default)]
struct Sorted {
    usual: Vec<Span>,
    lost: Vec<Span>,
    held: Vec<Interruption>,
}

impl LinkMeasured {
    /// Measures a link; `None` if no question was answered.
    pub(super) fn of(exchanges: &[Exchange], line: Option<&ClockLine>) -> Option<Self> {
        let trips: Vec<Span> = exchanges.iter().map(round_trip).collect();
        let coarse = counts_in(exchanges) * 4 > Quantiles::of(trips)?.p50;
        let (method, lanes, packets_a_trip) = match line.filter(|_| !coarse) {
            Some(line) => (Method::EachWay, each_way(exchanges, line), 1),
            None => (Method::HalfRoundTrip, vec![round_trips(exchanges)], 2),
        };
        let all = lanes.iter().flatten().map(|trip| trip.took).collect();
        let usual = Quantiles::of(all)?;
        let deviation = median(lanes.iter().flatten().map(|trip| (trip.took - usual.p50).abs()).collect());
        let limit = usual.least + RESENT_AFTER.max(deviation * DEVIATIONS);
        let mut sorted = Sorted::default();
        lanes.into_iter().for_each(|lane| sorted.take(lane, limit, usual.p50));
        let ways = i64::try_from(packets_a_trip).unwrap_or(1);
        let delays: Vec<Span> = sorted.usual.iter().map(|took| *took / ways).collect();
        let trips = sorted.usual.len() + sorted.lost.len();
        let interruptions = merged(sorted.held);
        let count = i64::try_from(interruptions.len()).unwrap_or(i64::MAX);
        let (first, last) = exchanges.first().zip(exchanges.last())?;
        Some(Self {
            method,
            exchanges: exchanges.len(),
            samples: delays.len(),
            delay: Quantiles::of(delays)?,
            loss: Loss::of(&sorted.lost, trips * packets_a_trip),
            interruption_every: (count > 0).then(|| (last.received - first.sent) / count),
            interruptions,
        })
    }
}

fn round_trip(exchange: &Exchange) -> Span {
    let took = (exchange.received - exchange.sent) - (exchange.robot_sent - exchange.robot_received);
    took.max(Span::ZERO)
}

fn round_trips(exchanges: &[Exchange]) -> Vec<Trip> {
    exchanges.iter().map(|exchange| Trip { sent: exchange.sent, took: round_trip(exchange) }).collect()
}

fn each_way(exchanges: &[Exchange], line: &ClockLine) -> Vec<Vec<Trip>> {
    let there = |exchange: &Exchange| Trip { sent: exchange.sent, took: line.ways(exchange)[0] };
    let back = |exchange: &Exchange| {
        let took = line.ways(exchange)[1];
        Trip { sent: exchange.received + -took, took }
    };
    vec![exchanges.iter().map(there).collect(), exchanges.iter().map(back).collect()]
}

impl Sorted {
    /// Classifies the travel times in one direction. Links keep the order of messages. A message that departs while an earlier one is
    /// delayed waits behind that one, so it is ignored.
    fn take(&mut self, mut lane: Vec<Trip>, limit: Span, usual: Span) {
        lane.sort_by_key(|trip| trip.sent);
        let mut held_until = None;
        for Trip { sent, took } in lane {
            if held_until.is_some_and(|until| sent < until) {
                continue;
            }
            if took < limit {
                self.usual.push(took);
                continue;
            }
            held_until = Some(sent + took);
            match took - usual {
                late if late < INTERRUPTED => self.lost.push(late),
                late => self.held.push(Interruption { from: sent, lasted: late }),
            }
        }
    }
}

/// Merges overlapping interruptions, because an interruption of a link delays messages in both directions.
fn merged(mut held: Vec<Interruption>) -> Vec<Interruption> {
    held.sort_by_key(|one| one.from);
    let mut merged: Vec<Interruption> = Vec::new();
    for one in held {
        match merged.last_mut().filter(|last| one.from < last.end()) {
            Some(last) => last.lasted = last.end().max(one.end()) - last.from,
            None => merged.push(one),
        }
    }
    merged
}

impl Quantiles {
    /// Computes quantiles, interpolated linearly between order statistics; `None` without values.
    fn of(mut sample: Vec<Span>) -> Option<Self> {
        sample.sort_unstable();
        let (least, largest) = (*sample.first()?, *sample.last()?);
        let [p50, p90, p99] = [50, 90, 99].map(|percent| quantile(&sample, percent));
        Some(Self { least, p50, p90, p99, largest })
    }
}

/// The quantile of a sorted sample at `percent`, interpolated linearly; zero if the sample is empty.
fn quantile(sorted: &[Span], percent: usize) -> Span {
    let place = sorted.len().saturating_sub(1) * percent;
    let at = |index: usize| sorted.get(index).or(sorted.last()).copied().unwrap_or_default();
    let (low, high) = (at(place / 100), at(place / 100 + 1));
    low + (high - low) * i64::try_from(place % 100).unwrap_or(0) / 100
}

fn median(mut sample: Vec<Span>) -> Span {
    sample.sort_unstable();
    quantile(&sample, 50)
}

impl Loss {
    #[expect(clippy::cast_precision_loss, reason = "no recording has 2^53 packets")]
    fn of(late: &[Span], packets: usize) -> Self {
        let lost = late.len();
        Self {
            lost,
            packets,
            share: lost as f64 / packets.max(1) as f64,
            below: (lost == 0 && packets > 0).then(|| (3.0 / packets as f64).min(1.0)),
            resent_after: (lost > 0).then(|| median(late.to_vec())),
        }
    }
}
