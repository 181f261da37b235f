//! Amounts that are fixed or random.

use urrcp::Span;

use crate::kinds;
use downbeat_reader::fields::{At, Reader};
use downbeat_reader::keys::Kind;
use downbeat_reader::{keys, named, schema};
use downbeat_yaml::finding::Code;
use downbeat_yaml::node::Node;
use downbeat_yaml::shown::shortened;

keys! {
    /// A random value with uniform distribution.
    pub(crate) struct BetweenKeys {
        /// The least.
        #[required]
        from: kinds::PLAIN_NUMBER,
        /// The largest.
        #[required]
        to: kinds::PLAIN_NUMBER,
    }
}

named! {
    /// Fixed, or random with uniform distribution.
    pub(super) static TIMES = Kind::AnyOf(&[&kinds::TIME, &Kind::KeysOf(BetweenKeys::declaration, &kinds::TIME)]);

    /// Fixed, or random with uniform distribution.
    pub(super) static SIGNED_TIMES =
        Kind::AnyOf(&[&kinds::SIGNED_TIME, &Kind::KeysOf(BetweenKeys::declaration, &kinds::SIGNED_TIME)]);

    /// Fixed, or random with uniform distribution.
    pub(super) static DRIFTS = Kind::AnyOf(&[&DRIFT, &Kind::KeysOf(BetweenKeys::declaration, &DRIFT)]);

    /// Fixed, or random with uniform distribution.
    pub(super) static NUMBERS = Kind::AnyOf(&[&kinds::PLAIN_NUMBER, &BetweenKeys::KIND]);

    /// In parts per million: `5ppm`.
    pub(super) static DRIFT = schema!({"type": "string", "pattern": "ppm$"});

    /// From `0%` to `100%`, or from 0 to 1.
    pub(super) static PROBABILITY = Kind::AnyOf(&[
        &schema!({"type": "number", "minimum": 0, "maximum": 1}),
        &schema!({"type": "string", "pattern": "^\\s*\\d+(\\.\\d+)?\\s*%$"}),
    ]);
}

/// A random value with uniform distribution, or a fixed value if both bounds are equal. The value is drawn once per trial (one simulation
/// of the mission), or once per message if it is a property of messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Between<T> {
    /// The lower bound.
    pub least: T,
    /// The upper bound.
    pub largest: T,
}

impl<T: Copy> Between<T> {
    /// Creates an amount that is not random.
    #[must_use]
    pub const fn fixed(value: T) -> Self {
        Self { least: value, largest: value }
    }
}

/// Reads an amount: a value, or `{from: VALUE, to: VALUE}`.
pub(super) fn between<T: Copy + PartialOrd>(
    findings: &mut Reader,
    at: &At<'_>,
    read: impl Fn(&mut Reader, &At<'_>) -> Option<T>,
) -> Option<Between<T>> {
    if !matches!(at.node, Node::Map(_)) {
        return read(findings, at).map(Between::fixed);
    }
    let BetweenKeys { from, to } = findings.keys(at, "a random amount")?;
    let (from, to) = (from?, to?);
    let (least, largest) = (read(findings, &from), read(findings, &to));
    let (least, largest) = (least?, largest?);
    if largest < least {
        let expected = "a `from` that does not exceed `to`";
        findings.add(Code::TimeOrder, to.place(), "`to` is less than `from`", expected, None);
        return None;
    }
    Some(Between { least, largest })
}

pub(super) fn duration(findings: &mut Reader, at: &At<'_>) -> Option<Span> {
    findings.duration(at)
}

pub(super) fn signed_duration(findings: &mut Reader, at: &At<'_>) -> Option<Span> {
    findings.signed_duration(at)
}

/// Reads a duration above zero.
pub(super) fn positive_duration(findings: &mut Reader, at: &At<'_>) -> Option<Span> {
    let span = findings.duration(at)?;
    if span > Span::ZERO {
        return Some(span);
    }
    findings.add(Code::BadDuration, at.place(), "found a time of 0", "a time above 0", None);
    None
}

/// Reads a probability: `5%`, or a number from 0 to 1.
pub(super) fn probability(findings: &mut Reader, at: &At<'_>) -> Option<f64> {
    let expected = "a probability from 0% to 100%, or from 0 to 1";
    let (found, value) = match at.node {
        Node::Text(text) => {
            let percent = text.strip_suffix('%').and_then(|number| number.trim().parse::<f64>().ok());
            (format!("`{}`", shortened(text)), percent.map(|percent| percent / 100.0))
        }
        _ => {
            let number = findings.number(at, expected)?;
            (format!("the number {number}"), Some(number))
        }
    };
    let value = value.filter(|value| (0.0..=1.0).contains(value));
    if value.is_none() {
        findings.add(Code::WrongType, at.place(), format!("found {found}"), expected, None);
    }
    value
}
