//! The links of a world: the delays of messages, losses, and interruptions.

use urrcp::Span;

use super::amount::{self, Between, between};
use crate::kinds;
use downbeat_reader::fields::{At, Reader};
use downbeat_reader::keys;
use downbeat_reader::keys::{Keys, Kind};
use downbeat_yaml::finding::Code;
use downbeat_yaml::node::Node;

keys! {
    /// The link of a robot.
    pub(crate) struct LinkKeys as "link" {
        /// The delay of a message, one way.
        delay: Kind::AnyOf(&[&amount::TIMES, &QuantileKeys::KIND]),
        /// Mean of the exponentially distributed time that is added to the delay.
        jitter: kinds::TIME,
        /// Probability that a packet is lost and sent again.
        loss: amount::PROBABILITY,
        /// The time until a lost packet is sent again; it doubles after each further loss. By default 200ms.
        resent_after: kinds::TIME,
        /// Times at which no messages pass.
        interruptions: Kind::List(&InterruptionKeys::KIND, 0..=usize::MAX),
    }
}

keys! {
    /// Times at which no messages pass.
    pub(crate) struct InterruptionKeys {
        /// Mean time from the start of one to the start of the next.
        #[required]
        every: kinds::TIME,
        /// How long each lasts.
        #[required]
        lasts: amount::TIMES,
    }
}

keys! {
    /// A random value, given by quantiles with linear interpolation between them.
    pub(crate) struct QuantileKeys {
        #[required]
        least: kinds::TIME,
        #[required]
        p50: kinds::TIME,
        #[required]
        p90: kinds::TIME,
        #[required]
        p99: kinds::TIME,
        #[required]
        largest: kinds::TIME,
    }
}

/// For each value of [`Delay::Quantiles`], the fraction of messages whose delay is at most that value.
pub const QUANTILES: [f64; 5] = [0.0, 0.5, 0.9, 0.99, 1.0];
/// Default time until a lost message is sent again: the minimum retransmission timeout of Linux (`TCP_RTO_MIN`, 200 ms); RFC 6298
/// specifies 1 s.
const RESENT_AFTER: Span = Span::from_millis(200);

/// The link of a robot, with equal properties in both directions. The link is a TCP connection: messages keep their order, and no message
/// is lost permanently.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkWorld {
    /// The delay of a message, one way.
    pub delay: Delay,
    /// Mean of the exponentially distributed time that is added to the delay.
    pub jitter: Span,
    /// Probability that a message is lost and sent again.
    pub loss: f64,
    /// The time until a lost message is sent again; it doubles after each further loss.
    pub resent_after: Span,
    /// Times at which no messages pass.
    pub interruptions: Vec<Interruptions>,
}

impl LinkWorld {
    /// Creates a link that only delays messages, without jitter, losses or interruptions.
    #[must_use]
    pub const fn with_delay(delay: Delay) -> Self {
        Self { delay, jitter: Span::ZERO, loss: 0.0, resent_after: RESENT_AFTER, interruptions: Vec::new() }
    }
}

/// The delay of a message, one way.
#[derive(Clone, Debug, PartialEq)]
pub enum Delay {
    /// A delay that is random for each message, with uniform distribution.
    Between(Between<Span>),
    /// The delays at the quantiles [`QUANTILES`], with linear interpolation between them.
    Quantiles([Span; 5]),
}

/// Random interruptions of a link, during which no messages pass. The time from the start of one interruption to the start of the next is
/// exponentially distributed.
#[derive(Clone, Debug, PartialEq)]
pub struct Interruptions {
    /// Mean time from the start of one interruption to the start of the next.
    pub every: Span,
    /// The duration of each interruption.
    pub lasts: Between<Span>,
}

pub(super) fn read(findings: &mut Reader, at: &At<'_>, name: &str) -> Option<LinkWorld> {
    let what = format!("the link of `{name}`");
    let LinkKeys { delay, jitter, loss, resent_after, interruptions } = findings.keys(at, &what)?;
    let read_delay = delay.map(|at| read_delay(findings, &at));
    let jitter = jitter.map(|at| (at, findings.duration(&at)));
    if let (Some(Some(Delay::Quantiles(_))), Some((at, _))) = (&read_delay, &jitter) {
        let expected = "either quantiles, or a delay with jitter";
        let message = "the quantiles of the delay already include the jitter";
        findings.add(Code::WrongType, at.key_place(), message, expected, Some("remove `jitter`".into()));
    }
    let loss = loss.map(|at| (at, amount::probability(findings, &at)));
    if let Some((at, Some(loss))) = &loss
        && *loss >= 1.0
    {
        let hint = Some("to interrupt a link, add a `link_down` incident".to_owned());
        findings.add(
            Code::WrongType,
            at.place(),
            "with a loss of 100%, no message ever arrives",
            "less than 100%",
            hint,
        );
    }
    let resent_after = resent_after.map(|at| amount::positive_duration(findings, &at));
    let interruptions = interruptions.map(|at| read_interruptions(findings, &at)).unwrap_or_default();
    Some(LinkWorld {
        delay: read_delay.unwrap_or(Some(Delay::Between(Between::fixed(Span::ZERO))))?,
        jitter: jitter.map_or(Some(Span::ZERO), |(_, jitter)| jitter)?,
        loss: loss.map_or(Some(0.0), |(_, loss)| loss)?,
        resent_after: resent_after.unwrap_or(Some(RESENT_AFTER))?,
        interruptions,
    })
}

fn read_delay(findings: &mut Reader, at: &At<'_>) -> Option<Delay> {
    let is_quantiles = |(key, _): &(String, Node)| QuantileKeys::NAMES.contains(&key.as_str());
    match at.node {
        Node::Map(entries) if entries.iter().any(is_quantiles) => quantiles(findings, at),
        _ => between(findings, at, amount::duration).map(Delay::Between),
    }
}

fn quantiles(findings: &mut Reader, at: &At<'_>) -> Option<Delay> {
    let QuantileKeys { least, p50, p90, p99, largest } = findings.keys(at, "the quantiles of a delay")?;
    let spans =
        [least, p50, p90, p99, largest].map(|at| at.and_then(|at| Some((at, findings.duration(&at)?))));
    for (pair, names) in spans.windows(2).zip(QuantileKeys::NAMES.windows(2)) {
        let ([Some((_, before)), Some((at, after))], [smaller, larger]) = (pair, names) else { continue };
        if after < before {
            let message = format!("`{larger}` lies below `{smaller}`");
            findings.add(Code::TimeOrder, at.place(), message, "quantiles in ascending order", None);
            return None;
        }
    }
    let [least, p50, p90, p99, largest] = spans.map(|span| span.map(|(_, span)| span));
    Some(Delay::Quantiles([least?, p50?, p90?, p99?, largest?]))
}

fn read_interruptions(findings: &mut Reader, at: &At<'_>) -> Vec<Interruptions> {
    let items = findings.list(at, "a list of interruptions, such as `[{every: 2min, lasts: 300ms}]`");
    let mut read = |at: &At<'_>| {
        let InterruptionKeys { every, lasts } = findings.keys(at, "an interruption")?;
        let every = every.and_then(|at| amount::positive_duration(findings, &at));
        let lasts = lasts.and_then(|at| between(findings, &at, amount::duration));
        Some(Interruptions { every: every?, lasts: lasts? })
    };
    items.iter().filter_map(&mut read).collect()
}
