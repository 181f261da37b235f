//! The network between the scheduler and a robot: determines when messages arrive and which are lost.

use std::collections::VecDeque;

use downbeat_scripts::{Between, Delay, LinkWorld, QUANTILES};
use fastrand::Rng;
use urrcp::{Command, Message, Server, Span, StatusValue, Timestamp};

/// Number of retransmissions after which Linux closes a connection (`net.ipv4.tcp_retries2`).
const RESENT_MAX: u32 = 15;
/// Longest retransmission timeout of Linux (`TCP_RTO_MAX`).
const RESENT_AFTER_MAX: Span = Span::from_millis(120_000);
/// First retransmission timeout of a new connection (RFC 6298, section 2.1). The timeout doubles after each further loss.
const FIRST_RESENT_AFTER: Span = Span::from_millis(1_000);
/// Maximum additional delay of a message in the long tail, as a multiple of the largest delay.
const TAIL_MAX: i64 = 20;

/// Approximate size in bytes of a message, without the steps of its script and the requests that it names.
const MESSAGE_BYTES: usize = 220;
/// Approximate size in bytes of a script step in a message.
const STEP_BYTES: usize = 60;
/// Approximate size in bytes of a request that a message names.
const NAME_BYTES: usize = 70;

/// The direction of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From the scheduler to the robot.
    ToRobot,
    /// From the robot to the scheduler.
    FromRobot,
}

/// Properties of a network path, which are equal in both directions.
#[derive(Clone, Debug)]
pub struct Conditions {
    /// Delays, interruptions, and parameters of TCP.
    pub link: LinkWorld,
    /// What happens to messages that the network drops or blocks.
    pub transport: Transport,
    /// Probability that a message is additionally delayed by 1 to 20 times the largest delay. `None`: never, and no random number is
    /// drawn.
    pub tail: Option<f64>,
    /// Bandwidth in bytes per second; `None`: unlimited.
    pub bandwidth: Option<u32>,
}

/// What happens to messages that the network drops or blocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Transport {
    /// Like TCP: lost messages are retransmitted after a timeout that doubles after each further loss. Messages keep their order.
    Tcp,
    /// No messages are lost. Messages sent during an interruption wait until its end. Messages keep their order.
    Held,
    /// Messages may be lost, and may overtake each other.
    Datagram {
        /// Probability that a message is lost.
        loss: f64,
        /// Probability that a message arrives twice.
        double: f64,
    },
}

impl From<LinkWorld> for Conditions {
    fn from(link: LinkWorld) -> Self {
        Self { link, transport: Transport::Tcp, tail: None, bandwidth: None }
    }
}

/// When a message arrives, and how much of its travel time is normal queuing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Travel {
    /// When the message arrives.
    pub arrives: Timestamp<Server>,
    /// The part of the travel time that a path in its usual state needs to transmit this message and the messages before it.
    pub queued: Span,
}

/// The network path to one robot and back.
#[derive(Clone, Debug)]
pub struct Path {
    conditions: Conditions,
    /// When the next interruption of each configured kind begins.
    next: Vec<Timestamp<Server>>,
    /// Start and end of each interruption whose times have already been drawn at random.
    interrupted: VecDeque<(Timestamp<Server>, Timestamp<Server>)>,
    /// For each direction: the time until which injected faults block the path.
    pub blocked_until: [Timestamp<Server>; 2],
    /// A temporary bandwidth in bytes per second, and when it ends.
    pub slow: Option<(u32, Timestamp<Server>)>,
    /// A temporary additional delay per message, and when it ends.
    pub lag: Option<(Span, Timestamp<Server>)>,
    /// For each direction: the time until which earlier messages are being transmitted.
    busy: [Timestamp<Server>; 2],
    /// For each direction: the latest arrival so far on the current connection. Unless messages are datagrams, none arrives before an
    /// earlier one.
    last: [Timestamp<Server>; 2],
}

impl Path {
    /// Creates a path whose time starts at `begin`.
    pub fn new(conditions: Conditions, rng: &mut Rng, begin: Timestamp<Server>) -> Self {
        let kinds = conditions.link.interruptions.iter();
        let next = kinds.map(|kind| begin + exponential(rng, kind.every)).collect();
        let (interrupted, begin) = (VecDeque::new(), [begin; 2]);
        Self {
            conditions,
            next,
            interrupted,
            blocked_until: begin,
            slow: None,
            lag: None,
            busy: begin,
            last: begin,
        }
    }

    /// Blocks a direction until the time `until`. Returns the end of the blockage, which is later if an earlier fault lasts longer.
    pub fn block(&mut self, way: Direction, until: Timestamp<Server>) -> Timestamp<Server> {
        let blocked = &mut self.blocked_until[way as usize];
        *blocked = until.max(*blocked);
        *blocked
    }

    /// Starts a new connection at `at`, without messages in transit.
    pub const fn begin(&mut self, at: Timestamp<Server>) {
        (self.last, self.busy) = ([at; 2], [at; 2]);
    }

    /// Sends a message, or the end of a connection if `message` is `None`. Returns `None` if a datagram is lost or TCP closes the
    /// connection.
    pub fn travel(
        &mut self,
        rng: &mut Rng,
        now: Timestamp<Server>,
        way: Direction,
        message: Option<&Message>,
    ) -> Option<Travel> {
        let at = way as usize;
        let (usual, takes) = message.map(|message| self.transmission(now, message)).unwrap_or_default();
        let sent = now.max(self.busy[at]) + takes;
        let arrives = if let Transport::Datagram { loss, .. } = self.conditions.transport {
            let delay = self.delay(rng, now);
            if self.closed_until(rng, now, now, way).is_some() || rng.f64() < loss {
                return None;
            }
            sent + delay
        } else {
            let passes = self.passes(rng, now, sent, way, self.conditions.link.resent_after)?;
            self.last[at] = self.last[at].max(passes + self.delay(rng, now));
            self.last[at]
        };
        self.busy[at] = sent;
        // The wait for earlier messages on a path in its usual state is not a fault.
        let queued = if takes == usual && self.slow.is_none() { sent - now } else { usual };
        Some(Travel { arrives, queued })
    }

    /// Draws whether a message that is sent now arrives twice.
    pub fn doubles(&self, rng: &mut Rng) -> bool {
        matches!(self.conditions.transport, Transport::Datagram { double, .. } if rng.f64() < double)
    }

    /// Returns when a connection that the scheduler starts now is established on the scheduler's side; `None` if this is not possible by
    /// `by`.
    pub fn connects(
        &mut self,
        rng: &mut Rng,
        now: Timestamp<Server>,
        by: Timestamp<Server>,
    ) -> Option<Timestamp<Server>> {
        let there =
            self.passes(rng, now, now, Direction::ToRobot, FIRST_RESENT_AFTER)? + self.delay(rng, now);
        let back =
            self.passes(rng, now, there, Direction::FromRobot, FIRST_RESENT_AFTER)? + self.delay(rng, now);
        self.last = [back; 2];
        (back <= by).then_some(back)
    }

    /// Returns when the end of a connection, which the robot's operating system closes at `at`, departs: after all earlier messages.
    #[must_use]
    pub fn end_passes(&self, at: Timestamp<Server>) -> Timestamp<Server> {
        at.max(self.blocked_until[Direction::FromRobot as usize])
            .max(self.last[Direction::FromRobot as usize])
    }

    /// Returns the transmission times of a message at the usual bandwidth and at the current bandwidth, in this order.
    fn transmission(&self, now: Timestamp<Server>, message: &Message) -> (Span, Span) {
        let usual = self.conditions.bandwidth;
        let slow = self.slow.filter(|(_, until)| now < *until).map(|(slow, _)| slow);
        if usual.is_none() && slow.is_none() {
            return (Span::ZERO, Span::ZERO);
        }
        let bytes = i64::try_from(bytes_of(message)).unwrap_or(i64::MAX);
        let takes = |bandwidth: u32| Span::from_nanos(bytes * 1_000_000_000 / i64::from(bandwidth.max(1)));
        let usual = usual.map(takes).unwrap_or_default();
        (usual, slow.map_or(usual, takes))
    }

    /// Returns the departure time of the first transmission that gets through, for a packet first sent at `at`. `None` if TCP gives up.
    fn passes(
        &mut self,
        rng: &mut Rng,
        now: Timestamp<Server>,
        mut at: Timestamp<Server>,
        way: Direction,
        mut wait: Span,
    ) -> Option<Timestamp<Server>> {
        if self.conditions.transport != Transport::Tcp {
            return Some(self.closed_until(rng, now, at, way).unwrap_or(at));
        }
        let loss = self.conditions.link.loss;
        for _ in 0..=RESENT_MAX {
            let is_lost = loss > 0.0 && rng.f64() < loss;
            if !is_lost && self.closed_until(rng, now, at, way).is_none() {
                return Some(at);
            }
            at = at + wait;
            wait = (wait * 2).min(RESENT_AFTER_MAX);
        }
        None
    }

    /// Returns the end of the blockage for a packet that departs at `at`, which must not be before `now`. `None`: the path is open, and
    /// the packet passes.
    fn closed_until(
        &mut self,
        rng: &mut Rng,
        now: Timestamp<Server>,
        at: Timestamp<Server>,
        way: Direction,
    ) -> Option<Timestamp<Server>> {
        for (kind, next) in self.conditions.link.interruptions.iter().zip(&mut self.next) {
            while *next <= at {
                let until = *next + between(rng, kind.lasts);
                self.interrupted.push_back((*next, until));
                *next = until.max(*next + exponential(rng, kind.every));
            }
        }
        while self.interrupted.front().is_some_and(|(_, until)| *until < now) {
            self.interrupted.pop_front();
        }
        let drawn = self.interrupted.iter().filter(|(from, until)| (*from..*until).contains(&at));
        let blocked = Some(self.blocked_until[way as usize]).filter(|until| at < *until);
        drawn.map(|(_, until)| *until).chain(blocked).max()
    }

    fn delay(&self, rng: &mut Rng, now: Timestamp<Server>) -> Span {
        let Conditions { link, tail, .. } = &self.conditions;
        let (mut delay, largest) = match &link.delay {
            Delay::Between(bounds) => (between(rng, *bounds), bounds.largest),
            Delay::Quantiles(quantiles) => (by_quantiles(quantiles, rng.f64()), quantiles[4]),
        };
        if link.jitter > Span::ZERO {
            delay += exponential(rng, link.jitter);
        }
        if tail.is_some_and(|probability| rng.f64() < probability) {
            delay += largest * rng.i64(1..=TAIL_MAX);
        }
        let lag = self.lag.filter(|(_, until)| now < *until);
        delay + lag.map_or(Span::ZERO, |(by, _)| by)
    }
}

/// Draws a duration from the uniform distribution between two bounds.
pub(crate) fn between(rng: &mut Rng, bounds: Between<Span>) -> Span {
    Span::from_nanos(
        rng.i64(bounds.least.as_nanos()..=bounds.largest.as_nanos().max(bounds.least.as_nanos())),
    )
}

/// Draws a duration from the exponential distribution with mean `mean`, by inversion.
fn exponential(rng: &mut Rng, mean: Span) -> Span {
    Span::from_millis_f64(-(1.0 - rng.f64()).ln() * mean.as_millis_f64())
}

/// Returns the quantile for `share` (0 to 1), interpolated linearly between the five given quantiles.
fn by_quantiles(quantiles: &[Span; 5], share: f64) -> Span {
    let above = QUANTILES.iter().position(|known| *known > share).unwrap_or(QUANTILES.len() - 1);
    let below = above.saturating_sub(1);
    let part = (share - QUANTILES[below]) / (QUANTILES[above] - QUANTILES[below]);
    let width = (quantiles[above] - quantiles[below]).as_millis_f64();
    quantiles[below] + Span::from_millis_f64(width * part.clamp(0.0, 1.0))
}

fn bytes_of(message: &Message) -> usize {
    let steps = |command: &Command| match command {
        Command::Script(script) => script.steps().len(),
        _ => 0,
    };
    let more = match message {
        Message::ControlRequest(request) => STEP_BYTES * steps(&request.command),
        Message::ControlResponse(response) => match &response.status_value {
            StatusValue::Script(script) => STEP_BYTES * script.steps().len(),
            _ => 0,
        },
        Message::Inquiry(inquiry) => NAME_BYTES * inquiry.requests.len(),
        Message::InquiryResponse(response) => 3 * NAME_BYTES * response.requests.len(),
        _ => 0,
    };
    MESSAGE_BYTES + more
}

#[cfg(test)]
mod tests {
    use downbeat_scripts::{Between, Delay, Interruptions, LinkWorld};
    use fastrand::Rng;
    use urrcp::{Server, Span, Timestamp};

    use super::{Conditions, Direction, Path, Transport};
    use crate::dry_run::BEGIN;

    const DELAY: Span = Span::from_millis(2);

    fn says() -> LinkWorld {
        LinkWorld::with_delay(Delay::Between(Between::fixed(DELAY)))
    }

    /// A path with a random generator, for messages that differ only in their send times.
    struct Line {
        path: Path,
        rng: Rng,
    }

    impl Line {
        fn new(conditions: impl Into<Conditions>, seed: u64) -> Self {
            let mut rng = Rng::with_seed(seed);
            Self { path: Path::new(conditions.into(), &mut rng, BEGIN), rng }
        }

        fn arrival(&mut self, at: Timestamp<Server>, way: Direction) -> Option<Timestamp<Server>> {
            Some(self.path.travel(&mut self.rng, at, way, None)?.arrives)
        }

        fn block(&mut self, lasts: Span) {
            self.path.blocked_until = [BEGIN + lasts; 2];
        }

        fn is_closed(&mut self, at: Timestamp<Server>) -> bool {
            self.path.closed_until(&mut self.rng, at, at, Direction::ToRobot).is_some()
        }

        fn connects(&mut self, at: Timestamp<Server>) -> Option<Timestamp<Server>> {
            self.path.connects(&mut self.rng, at, at + Span::from_millis(3_000))
        }
    }

    /// Returns the sorted travel times in milliseconds of many messages, sent at intervals that prevent queuing.
    fn travels(says: LinkWorld) -> Vec<f64> {
        let mut line = Line::new(says, 7);
        let sent = (0..20_000).map(|index| BEGIN + Span::from_millis(10_000) * index);
        let mut travels: Vec<f64> =
            sent.map(|at| (line.arrival(at, Direction::ToRobot).unwrap() - at).as_millis_f64()).collect();
        travels.sort_by(f64::total_cmp);
        travels
    }

    #[test]
    fn jitter_has_the_configured_mean() {
        let travels = travels(LinkWorld { jitter: Span::from_millis(5), ..says() });
        let mean = travels.iter().sum::<f64>() / travels.len() as f64;
        // The tolerance is five standard errors of the mean of 20,000 values.
        assert!((mean - 7.0).abs() < 5.0 * 5.0 / 20_000_f64.sqrt(), "{mean}");
        assert!(travels[0] >= 2.0);
    }

    #[test]
    fn delays_drawn_from_quantiles_match_them() {
        let quantiles = [1, 2, 4, 20, 100].map(Span::from_millis);
        let travels = travels(LinkWorld { delay: Delay::Quantiles(quantiles), ..says() });
        let at = |share: f64| travels[(share * (travels.len() - 1) as f64) as usize];
        for (share, expected, within) in
            [(0.0, 1.0, 0.01), (0.5, 2.0, 0.06), (0.9, 4.0, 0.4), (0.99, 20.0, 6.0)]
        {
            assert!((at(share) - expected).abs() < within, "{share}: {}", at(share));
        }
        assert!(at(1.0) <= 100.0);
    }

    #[test]
    fn lost_message_is_resent_after_a_timeout_that_doubles_with_each_loss() {
        let travels = travels(LinkWorld { loss: 0.2, ..says() });
        let share =
            |millis: f64| travels.iter().filter(|t| (**t - millis).abs() < 0.001).count() as f64 / 20_000.0;
        assert!((share(2.0) - 0.8).abs() < 0.02, "{}", share(2.0));
        assert!((share(202.0) - 0.16).abs() < 0.02, "{}", share(202.0));
        assert!((share(602.0) - 0.032).abs() < 0.01, "{}", share(602.0));
    }

    #[test]
    fn messages_behind_a_lost_one_keep_their_order() {
        let mut line = Line::new(LinkWorld { loss: 0.3, ..says() }, 1);
        let sent = (0..200).map(|index| BEGIN + Span::from_millis(index));
        let arrivals: Vec<_> = sent.map(|at| line.arrival(at, Direction::FromRobot).unwrap()).collect();
        assert!(arrivals.is_sorted() && arrivals[199] > BEGIN + Span::from_millis(400));
    }

    #[test]
    fn nothing_passes_while_the_path_is_blocked() {
        let mut line = Line::new(says(), 1);
        line.block(Span::from_millis(500));
        // The message is retransmitted after 200 and 600 ms.
        let arrives = Some(BEGIN + Span::from_millis(602));
        assert_eq!(line.arrival(BEGIN, Direction::ToRobot), arrives);
        assert_eq!(line.connects(BEGIN), Some(BEGIN + Span::from_millis(1_004)));
    }

    #[test]
    fn second_connection_attempt_does_not_pass_the_interruption_of_the_first() {
        let mut line = Line::new(says(), 1);
        line.block(Span::from_millis(60_000));
        assert_eq!(line.connects(BEGIN), None);
        assert_eq!(line.connects(BEGIN + Span::from_millis(3_000)), None);
        let lasts = Between::fixed(Span::from_millis(60_000));
        let kind = Interruptions { every: Span::from_millis(1), lasts };
        let mut line = Line::new(LinkWorld { interruptions: vec![kind], ..says() }, 1);
        let begun = BEGIN + Span::from_millis(100);
        assert_eq!(line.connects(begun), None);
        assert_eq!(line.connects(begun + Span::from_millis(3_000)), None);
    }

    #[test]
    fn messages_on_a_held_stream_arrive_at_the_end_of_the_interruption() {
        let conditions = Conditions { transport: Transport::Held, ..says().into() };
        let mut line = Line::new(conditions, 1);
        line.path.block(Direction::ToRobot, BEGIN + Span::from_millis(500));
        let at = |millis| Some(BEGIN + Span::from_millis(millis));
        assert_eq!(line.arrival(BEGIN, Direction::ToRobot), at(502));
        assert_eq!(line.arrival(BEGIN + Span::from_millis(100), Direction::ToRobot), at(502));
        assert_eq!(line.arrival(BEGIN, Direction::FromRobot), at(2));
    }

    #[test]
    fn datagram_is_lost_in_an_interruption_and_overtakes_a_lagging_one() {
        let transport = Transport::Datagram { loss: 0.0, double: 0.0 };
        let mut line = Line::new(Conditions { transport, ..says().into() }, 1);
        line.path.block(Direction::ToRobot, BEGIN + Span::from_millis(500));
        assert_eq!(line.arrival(BEGIN, Direction::ToRobot), None);
        let at = |millis| BEGIN + Span::from_millis(millis);
        line.path.lag = Some((Span::from_millis(50), at(601)));
        assert_eq!(line.arrival(at(600), Direction::ToRobot), Some(at(652)));
        assert_eq!(line.arrival(at(601), Direction::ToRobot), Some(at(603)));
    }

    #[test]
    fn interruptions_have_the_configured_frequency_and_duration() {
        let lasts = Between { least: Span::from_millis(1_000), largest: Span::from_millis(3_000) };
        let kind = Interruptions { every: Span::from_millis(20_000), lasts };
        let mut line = Line::new(LinkWorld { interruptions: vec![kind], ..says() }, 3);
        let at = |index| BEGIN + Span::from_millis(100) * index;
        let down = (0..1_000_000).filter(|index| line.is_closed(at(*index))).count();
        // The path is down for 2 s of every 20 s. With 5,000 interruptions, the relative error of the share is about 1.5 percent.
        assert!((down as f64 / 1e6 - 0.1).abs() < 0.008, "{down}");
    }
}
