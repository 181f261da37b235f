//! Delays and losses of one robot's link, from its exchanges.

use serde::Serialize;
use urrcp::{Server, Span, Timestamp};

use super::line::{ClockLine, counts_in};
use crate::history::Exchange;

/// A message that takes longer than the minimum by this was lost and retransmitted. The minimum retransmission timeout of Linux is 200
/// ms, in addition to the round trip; a twentieth is subtracted for coarse timers.
const RESENT_AFTER: Span = Span::from_millis(190);
/// Alternative threshold as a multiple of the median deviation, if that is longer: on a link with widely varying delays, the timeout is
/// also longer (RFC 6298, section 2).
const DEVIATIONS: i64 = 4;
/// The delay of a message that is lost three times in a row (200 + 400 + 800 ms): from this delay, the link was interrupted.
const INTERRUPTED: Span = Span::from_millis(1_400);

/// The measured properties of a robot's link.
#[derive(Clone, Debug, Serialize)]
pub struct LinkMeasured {
    /// How the two directions of an exchange were separated.
    pub method: Method,
    /// Number of answered questions.
    pub exchanges: usize,
    /// Number of one-way delays behind the quantiles, without messages that were lost or queued behind a lost one.
    pub samples: usize,
    /// Quantiles of the one-way delay.
    #[serde(rename = "delay_ms")]
    pub delay: Quantiles,
    /// The packet loss.
    pub loss: Loss,
    /// Periods in which nothing passed while the connection persisted.
    pub interruptions: Vec<Interruption>,
    /// Mean time between two interruptions: from the first question to the last answer, divided by their number.
    #[serde(rename = "interruption_every_ms")]
    pub interruption_every: Option<Span>,
}

/// How the two directions of an exchange were separated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Each direction separately: the clocks differ by a line, and the minimum delays of both directions are assumed to be equal.
    EachWay,
    /// Half of each round trip: the robot's clock was set, or its timestamps are too coarse.
    HalfRoundTrip,
}

/// Quantiles of a delay, in milliseconds in JSON.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Quantiles {
    /// The smallest delay.
    pub least: Span,
    /// Median.
    pub p50: Span,
    /// 90th percentile.
    pub p90: Span,
    /// 99th percentile.
    pub p99: Span,
    /// The largest delay.
    pub largest: Span,
}

/// The packet loss of a link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Loss {
    /// Packets that were delayed by a retransmission. Packets queued behind one are counted with it.
    pub lost: usize,
    /// Packets that were evaluated.
    pub packets: usize,
    /// Their ratio, from 0 to 1.
    pub share: f64,
    /// If no packet was lost: the upper bound of the loss with 95 % confidence, by the rule of three.
    pub below: Option<f64>,
    /// Median of the additional delay of the lost packets.
    #[serde(rename = "resent_after_ms")]
    pub resent_after: Option<Span>,
}

/// A period in which nothing passed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Interruption {
    /// When the first message was delayed.
    pub from: Timestamp<Server>,
    /// Its duration.
    #[serde(rename = "lasted_ms")]
    pub lasted: Span,
}

impl Interruption {
    fn end(&self) -> Timestamp<Server> {
        self.from + self.lasted
    }
}

/// Departure and travel time of a message, or of a question with its answer.
#[derive(Clone, Copy)]
struct Trip {
    sent: Timestamp<Server>,
    took: Span,
}

/// The trips in one direction, classified.
#[derive(Default)]
struct Sorted {
    usual: Vec<Span>,
    lost: Vec<Span>,
    held: Vec<Interruption>,
}

impl LinkMeasured {
    /// `None` if no question was answered.
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
    /// Links keep the order: a message that departs while another one is delayed waits behind it and gives no information.
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

/// Merges interruptions that both directions of a link show.
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
    /// Interpolates linearly between order statistics; `None` without values.
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
