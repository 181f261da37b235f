//! Clocks, sensors and the operator of a world.

use urrcp::{DeviceId, RobotId, Span};

use super::amount::{self, Between, between};
use super::is_null;
use crate::kinds;
use downbeat_reader::fields::{At, Reader};
use downbeat_reader::keys::Kind;
use downbeat_reader::{keys, named};
use downbeat_yaml::finding::Code;
use downbeat_yaml::node::Node;

keys! {
    /// The clock of a robot.
    pub(crate) struct ClockKeys as "clock" {
        /// The raw clock minus the true time.
        offset: amount::SIGNED_TIMES,
        /// How much faster the raw clock runs.
        drift: amount::DRIFTS,
        /// Largest error of the clock under NTP, in either direction.
        error: kinds::TIME,
    }
}

keys! {
    /// How the operator behaves.
    pub(crate) struct OperatorKeys as "operator" {
        /// The time for which an act waits until the operator says go. By default 1s.
        go_after: amount::TIMES,
        /// For each act that waits, the probability that the operator never says go.
        never: amount::PROBABILITY,
    }
}

named! {
    /// Fixed, or drawn once per trial, or a list of times, each with the reading after it.
    pub(super) static READING = Kind::AnyOf(&[
        &amount::NUMBERS,
        &Kind::List(&Kind::Tuple(&[&amount::TIMES, &amount::NUMBERS]), 0..=usize::MAX),
    ]);
}

/// The clock of a robot. For values that are `None`, the settings of the fleet file apply.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ClockWorld {
    /// The raw clock minus the true time.
    pub offset: Option<Between<Span>>,
    /// How much faster the raw clock runs than true time, in parts per million.
    pub drift_ppm: Option<Between<f64>>,
    /// Largest error of the clock, in either direction, if it follows NTP.
    pub error: Option<Span>,
}

/// The readings of a sensor in a world.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorWorld {
    /// The robot that has the sensor.
    pub robot: RobotId,
    /// The id of the sensor.
    pub sensor: DeviceId,
    /// The readings that the sensor shows.
    pub reading: Reading,
}

/// The readings of a sensor, in its unit.
#[derive(Clone, Debug, PartialEq)]
pub enum Reading {
    /// A constant reading, which is drawn once per trial (one simulation of the mission).
    Drawn(Between<f64>),
    /// Times from the beginning of the mission, each with the reading from that time on. Times and readings are drawn once per trial (one
    /// simulation of the mission). Before the first time, the reading is 0.
    OverTime(Vec<(Between<Span>, Between<f64>)>),
}

/// The behaviour of the operator in a world.
#[derive(Clone, Debug, PartialEq)]
pub struct OperatorWorld {
    /// For each act that waits for the operator, the time that the operator takes to give the go (the signal to start).
    pub go_after: Between<Span>,
    /// For each act that waits for the operator, the probability that the operator never gives the go (the signal to start).
    pub never: f64,
}

pub(super) fn read_clock(findings: &mut Reader, at: &At<'_>, name: &str) -> Option<ClockWorld> {
    let what = format!("the clock of `{name}`");
    let ClockKeys { offset, drift, error } = findings.keys(at, &what)?;
    Some(ClockWorld {
        offset: offset.and_then(|at| between(findings, &at, amount::signed_duration)),
        drift_ppm: drift.and_then(|at| between(findings, &at, crate::fleet::drift_ppm)),
        error: error.and_then(|at| findings.duration(&at)),
    })
}

pub(super) fn read_operator(findings: &mut Reader, at: &At<'_>) -> Option<OperatorWorld> {
    if is_null(at) {
        return None;
    }
    let OperatorKeys { go_after, never } = findings.keys(at, "`operator`")?;
    let go_after = go_after.map(|at| between(findings, &at, amount::duration));
    let never = never.map(|at| amount::probability(findings, &at));
    Some(OperatorWorld {
        go_after: go_after.unwrap_or(Some(Between::fixed(Span::from_millis(1_000))))?,
        never: never.unwrap_or(Some(0.0))?,
    })
}

/// Reads the readings of a sensor: a number, `{from: NUMBER, to: NUMBER}`, or `[[TIME, NUMBER], ...]`. In the list, times and numbers may
/// be random, too.
pub(super) fn read_reading(findings: &mut Reader, at: &At<'_>) -> Option<Reading> {
    let number = |findings: &mut Reader, at: &At<'_>| findings.number(at, "a number in the sensor's unit");
    if !matches!(at.node, Node::List(_)) {
        return between(findings, at, number).map(Reading::Drawn);
    }
    let mut points: Vec<(Between<Span>, Between<f64>)> = Vec::new();
    for item in findings.list(at, "a list of times and readings") {
        let expected = "a time and a reading, such as [5s, 0.4]";
        let pair = findings.list(&item, expected);
        let [time, value] = pair.as_slice() else {
            if matches!(item.node, Node::List(_)) {
                let message = format!("found {} entries", pair.len());
                findings.add(Code::WrongType, item.place(), message, expected, None);
            }
            continue;
        };
        let (at, value) = (between(findings, time, amount::duration), between(findings, value, number));
        let (Some(at), Some(value)) = (at, value) else { continue };
        if points.last().is_some_and(|(before, _)| before.largest >= at.least) {
            let expected = "ascending times";
            findings.add(
                Code::TimeOrder,
                time.place(),
                "the time is not later than the previous one",
                expected,
                None,
            );
        }
        points.push((at, value));
    }
    Some(Reading::OverTime(points))
}
