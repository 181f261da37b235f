//! The link of a robot in a world: a TCP connection over a network that delays, loses and is interrupted.

use std::collections::VecDeque;

use downbeat_scripts::{Between, Delay, LinkWorld, QUANTILES};
use fastrand::Rng;
use urrcp::{Server, Span, Timestamp};

/// Linux gives a connection up after this many retransmissions (`net.ipv4.tcp_retries2`).
const RESENT_MAX: u32 = 15;
/// The longest time after which Linux sends again (`TCP_RTO_MAX`).
const RESENT_AFTER_MAX: Span = Span::from_millis(120_000);
/// After this time the first packet of a connection is sent again (RFC 6298, section 2.1), twice as long after each further loss.
const FIRST_RESENT_AFTER: Span = Span::from_millis(1_000);

/// Which way something travels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    ToRobot,
    FromRobot,
}

/// A link as it is drawn for one trial.
#[derive(Clone, Debug)]
pub(crate) struct Link {
    says: LinkWorld,
    rng: Rng,
    /// For each kind of interruption when the next one begins.
    next: Vec<Timestamp<Server>>,
    /// When nothing passes, from and until, as far as that is drawn.
    interrupted: VecDeque<(Timestamp<Server>, Timestamp<Server>)>,
    /// The last arrivals each way on the connection that stands: it keeps the order.
    last: [Timestamp<Server>; 2],
}

impl Link {
    pub(crate) fn new(says: LinkWorld, mut rng: Rng, begin: Timestamp<Server>) -> Self {
        let next = says.interruptions.iter().map(|kind| begin + exponential(&mut rng, kind.every)).collect();
        Self { says, rng, next, interrupted: VecDeque::new(), last: [begin; 2] }
    }

    /// Nothing passes from now on for a while.
    pub(super) fn interrupt(&mut self, now: Timestamp<Server>, lasts: Span) {
        self.interrupted.push_back((now, now + lasts));
    }

    /// When something arrives that is sent now; `None` where the connection is given up before.
    pub(super) fn arrival(&mut self, now: Timestamp<Server>, way: Way) -> Option<Timestamp<Server>> {
        let arrives = self.passes(now, now, self.says.resent_after)? + self.delay();
        let last = &mut self.last[way as usize];
        *last = arrives.max(*last);
        Some(*last)
    }

    /// When a connection stands that is begun now, as the scheduler sees it; `None`: not within that time.
    pub(super) fn connects(&mut self, now: Timestamp<Server>, within: Span) -> Option<Timestamp<Server>> {
        let there = self.passes(now, now, FIRST_RESENT_AFTER)? + self.delay();
        let back = self.passes(now, there, FIRST_RESENT_AFTER)? + self.delay();
        self.last = [back; 2];
        (back <= now + within).then_some(back)
    }

    /// When something sent at `at` is on its way and will not be lost.
    fn passes(
        &mut self,
        now: Timestamp<Server>,
        mut at: Timestamp<Server>,
        mut wait: Span,
    ) -> Option<Timestamp<Server>> {
        for _ in 0..=RESENT_MAX {
            let is_lost = self.says.loss > 0.0 && self.rng.f64() < self.says.loss;
            if !is_lost && !self.is_interrupted(now, at) {
                return Some(at);
            }
            at = at + wait;
            wait = (wait * 2).min(RESENT_AFTER_MAX);
        }
        None
    }

    fn is_interrupted(&mut self, now: Timestamp<Server>, at: Timestamp<Server>) -> bool {
        for (kind, next) in self.says.interruptions.iter().zip(&mut self.next) {
            while *next <= at {
                let until = *next + between(&mut self.rng, kind.lasts);
                self.interrupted.push_back((*next, until));
                *next = until.max(*next + exponential(&mut self.rng, kind.every));
            }
        }
        while self.interrupted.front().is_some_and(|(_, until)| *until < now) {
            self.interrupted.pop_front();
        }
        self.interrupted.iter().any(|(from, until)| (*from..*until).contains(&at))
    }

    fn delay(&mut self) -> Span {
        let delay = match &self.says.delay {
            Delay::Between(bounds) => between(&mut self.rng, *bounds),
            Delay::Quantiles(quantiles) => by_quantiles(quantiles, self.rng.f64()),
        };
        match self.says.jitter {
            Span::ZERO => delay,
            mean => delay + exponential(&mut self.rng, mean),
        }
    }
}

/// Drawn uniformly.
pub(crate) fn between(rng: &mut Rng, bounds: Between<Span>) -> Span {
    Span::from_nanos(
        rng.i64(bounds.least.as_nanos()..=bounds.largest.as_nanos().max(bounds.least.as_nanos())),
    )
}

/// Drawn from the exponential distribution with this mean, by inversion.
fn exponential(rng: &mut Rng, mean: Span) -> Span {
    Span::from_millis_f64(-(1.0 - rng.f64()).ln() * mean.as_millis_f64())
}

/// What this share of all values does not exceed, linear between the quantiles.
fn by_quantiles(quantiles: &[Span; 5], share: f64) -> Span {
    let above = QUANTILES.iter().position(|known| *known > share).unwrap_or(QUANTILES.len() - 1);
    let below = above.saturating_sub(1);
    let part = (share - QUANTILES[below]) / (QUANTILES[above] - QUANTILES[below]);
    let width = (quantiles[above] - quantiles[below]).as_millis_f64();
    quantiles[below] + Span::from_millis_f64(width * part.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use downbeat_scripts::{Between, Delay, Interruptions, LinkWorld};
    use fastrand::Rng;
    use urrcp::{Server, Span, Timestamp};

    use super::{Link, Way};

    const BEGIN: Timestamp<Server> = super::super::BEGIN;

    fn says() -> LinkWorld {
        LinkWorld::with_delay(Delay::Between(Between::fixed(Span::from_millis(2))))
    }

    /// How long each of many messages travels, sent at a distance at which none waits for another.
    fn travels(says: LinkWorld) -> Vec<f64> {
        let mut link = Link::new(says, Rng::with_seed(7), BEGIN);
        let sent = (0..20_000).map(|index| BEGIN + Span::from_millis(10_000) * index);
        let mut travels: Vec<f64> =
            sent.map(|at| (link.arrival(at, Way::ToRobot).unwrap() - at).as_millis_f64()).collect();
        travels.sort_by(f64::total_cmp);
        travels
    }

    #[test]
    fn jitter_has_the_mean_that_it_was_given() {
        let travels = travels(LinkWorld { jitter: Span::from_millis(5), ..says() });
        let mean = travels.iter().sum::<f64>() / travels.len() as f64;
        // Five standard errors of the mean of 20,000.
        assert!((mean - 7.0).abs() < 5.0 * 5.0 / 20_000_f64.sqrt(), "{mean}");
        assert!(travels[0] >= 2.0);
    }

    #[test]
    fn a_delay_drawn_by_quantiles_has_them() {
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
    fn what_is_lost_is_sent_again_after_the_timeout_and_twice_as_long_after_the_next_loss() {
        let travels = travels(LinkWorld { loss: 0.2, ..says() });
        let share =
            |millis: f64| travels.iter().filter(|t| (**t - millis).abs() < 0.001).count() as f64 / 20_000.0;
        assert!((share(2.0) - 0.8).abs() < 0.02, "{}", share(2.0));
        assert!((share(202.0) - 0.16).abs() < 0.02, "{}", share(202.0));
        assert!((share(602.0) - 0.032).abs() < 0.01, "{}", share(602.0));
    }

    #[test]
    fn messages_keep_their_order_behind_one_that_was_lost() {
        let mut link = Link::new(LinkWorld { loss: 0.3, ..says() }, Rng::with_seed(1), BEGIN);
        let sent = (0..200).map(|index| BEGIN + Span::from_millis(index));
        let arrivals: Vec<_> = sent.map(|at| link.arrival(at, Way::FromRobot).unwrap()).collect();
        assert!(arrivals.is_sorted() && arrivals[199] > BEGIN + Span::from_millis(400));
    }

    #[test]
    fn nothing_passes_while_the_link_is_interrupted() {
        let mut link = Link::new(says(), Rng::with_seed(1), BEGIN);
        link.interrupt(BEGIN, Span::from_millis(500));
        // Sent again after 200, 600 ms.
        assert_eq!(link.arrival(BEGIN, Way::ToRobot), Some(BEGIN + Span::from_millis(602)));
        assert_eq!(link.connects(BEGIN, Span::from_millis(3_000)), Some(BEGIN + Span::from_millis(1_004)));
        link.interrupt(BEGIN, Span::from_millis(60_000));
        assert_eq!(link.connects(BEGIN, Span::from_millis(3_000)), None);
    }

    #[test]
    fn a_second_attempt_to_connect_does_not_pass_an_interruption_that_the_first_met() {
        let within = Span::from_millis(3_000);
        let mut link = Link::new(says(), Rng::with_seed(1), BEGIN);
        link.interrupt(BEGIN, Span::from_millis(60_000));
        assert_eq!(link.connects(BEGIN, within), None);
        assert_eq!(link.connects(BEGIN + within, within), None);
    }

    #[test]
    fn interruptions_come_as_often_and_last_as_long_as_they_should() {
        let lasts = Between { least: Span::from_millis(1_000), largest: Span::from_millis(3_000) };
        let kind = Interruptions { every: Span::from_millis(20_000), lasts };
        let mut link = Link::new(LinkWorld { interruptions: vec![kind], ..says() }, Rng::with_seed(3), BEGIN);
        let at = |index| BEGIN + Span::from_millis(100) * index;
        let down = (0..1_000_000).filter(|index| link.is_interrupted(at(*index), at(*index))).count();
        // 2 s of 20 s; 5,000 interruptions, so the share is known to about 1.5 percent of itself.
        assert!((down as f64 / 1e6 - 0.1).abs() < 0.008, "{down}");
    }
}
