//! Delays of the robots of a cue: by the robots' order, by their places, at random, or by their `at`.

use super::kinds;
use crate::exact::{Beginning, Exact, Fraction, Laps, fraction};
use crate::fields::{Across, At, By, Reader, Robot, parts};
use crate::finding::{Code, Place};
use crate::node::Node;
use downbeat_reader::keys;

keys! {
    /// The order of the robots, and their delays.
    pub(super) struct CanonKeys {
        /// Delay from each place of the order to the next.
        step: kinds::TIME,
        /// Speed at which the start passes over the places of the robots, in metres per second.
        speed: kinds::NUMBER,
        /// Delay from the first start to the last.
        over: kinds::TIME,
        by: kinds::BY,
        /// For `by: random`: each number gives another order.
        seed: kinds::NUMBER,
        direction: kinds::DIRECTION,
    }
}

/// Limits of the speed of a wave over the robots, in metres per second.
const SPEED_MIN: f64 = 1e-3;
const SPEED_MAX: f64 = 1e6;

/// Delay of each robot's start after the start of the cue.
#[derive(Clone, Debug)]
pub(crate) enum Canon {
    /// The same delay from each robot to the next.
    Even(Laps),
    /// One delay per robot, in the order of the robots.
    Each { delays: Vec<Exact>, from: Beginning, place: Place },
}

impl Default for Canon {
    fn default() -> Self {
        Self::Even(Laps::default())
    }
}

impl Canon {
    /// Returns the delay of the robot at `index`.
    pub(crate) fn delay(&self, index: usize) -> urrcp::Span {
        match self {
            Self::Even(laps) => laps.begin(u32::try_from(index).unwrap_or(u32::MAX)),
            Self::Each { delays, from, .. } => {
                delays.get(index).map_or(urrcp::Span::ZERO, |delay| from.lay(*delay))
            }
        }
    }

    /// Adds, for each robot, the delay that results from the cue's key `at`.
    pub(super) fn delayed(self, late: Option<Late>) -> Self {
        let Some(Late { by, from, place }) = late else { return self };
        let delays = by.iter().enumerate().map(|(index, late)| match &self {
            Self::Even(laps) => late.plus(laps.length.times(Fraction::from_integer(index as i128))),
            Self::Each { delays, .. } => late.plus(delays.get(index).copied().unwrap_or_default()),
        });
        Self::Each { delays: delays.collect(), from, place }
    }
}

/// Delays of the robots of a cue whose key `at` has a different value for each robot.
pub(super) struct Late {
    pub(super) by: Vec<Exact>,
    pub(super) from: Beginning,
    pub(super) place: Place,
}

/// Reads a canon (delays from robot to robot), such as `400ms` or `{step: 400ms, by: x, direction: outward}`.
pub(super) fn read(reader: &mut Reader, at: Option<&At<'_>>) -> Canon {
    let Some(at) = at else { return Canon::default() };
    let found = match at.node {
        Node::Map(_) => in_order(reader, at),
        _ => steps(reader, at).map(|steps| match steps {
            Steps::Even(step) => Canon::Even(reader.laps(step)),
            Steps::Each(begins) => each(reader, at, begins),
        }),
    };
    found.unwrap_or_default()
}

fn each(reader: &Reader, at: &At<'_>, delays: Vec<Exact>) -> Canon {
    Canon::Each { delays, from: reader.music.start, place: at.place() }
}

/// Delays of the places in the order of robots; robots at the same place begin together.
enum Steps {
    /// The same delay from each place to the next.
    Even(Exact),
    /// One delay for each place, since the start of the cue.
    Each(Vec<Exact>),
}

impl Steps {
    fn of(&self, rank: usize) -> Exact {
        match self {
            Self::Even(step) => step.times(Fraction::from_integer(rank as i128)),
            Self::Each(begins) => begins.get(rank).or(begins.last()).copied().unwrap_or_default(),
        }
    }
}

/// Reads the delays between consecutive places in the order of robots. In an expression, `$index` is the number of the place.
fn steps(reader: &mut Reader, at: &At<'_>) -> Option<Steps> {
    let count = reader.group.count();
    let mut begins = vec![Exact::ZERO];
    // The step of a group with a single robot is also read, because it may contain errors.
    for index in 1..count.max(2) {
        let robot = Robot { index, count: count.max(2) };
        let (step, differs) = reader.as_robot(robot, |reader| reader.exact(at));
        let step = step?;
        if !differs {
            return Some(Steps::Even(step));
        }
        begins.push(begins[index - 1].plus(step));
    }
    Some(Steps::Each(begins))
}

fn in_order(reader: &mut Reader, at: &At<'_>) -> Option<Canon> {
    let CanonKeys { step, speed, over, by, seed, direction } = reader.keys(at, "`canon`")?;
    let across = Across::read(reader, by, seed, direction);
    let delays = match (step, speed, over) {
        (Some(step), None, None) => {
            let steps = steps(reader, &step);
            let ranks = across?.ranks(reader, at)?;
            let steps = steps?;
            ranks.into_iter().map(|rank| steps.of(rank)).collect()
        }
        (None, Some(speed), None) => {
            let second = travelled(reader, &speed);
            let across = across?;
            if !matches!(across.by, By::Axis(_) | By::Point(_)) {
                let message = "a canon with `speed` requires robots that are ordered by position";
                let hint = Some("add `by: x`, or use a `step`".to_owned());
                let expected = "x, y, z or a point under `by`";
                reader.add(Code::MissingKey, speed.key_place(), message, expected, hint);
                return None;
            }
            scaled(second?, &across.along(reader, at)?)
        }
        (None, None, Some(over)) => {
            let over = reader.exact(&over);
            let along = across?.along(reader, at)?;
            scaled(over?, &parts(&along))
        }
        _ => {
            let message = "found none or several of `step`, `speed` and `over`";
            reader.add(
                Code::MissingKey,
                at.place(),
                message,
                "exactly one of `step`, `speed` and `over`",
                None,
            );
            return None;
        }
    };
    Some(each(reader, at, delays))
}

fn scaled(unit: Exact, by: &[Fraction]) -> Vec<Exact> {
    by.iter().map(|share| unit.times(*share)).collect()
}

/// Reads the speed at which a wave passes over the robots, and returns the time that the wave takes per metre.
fn travelled(reader: &mut Reader, at: &At<'_>) -> Option<Exact> {
    let expected = "a speed from 0.001 to 1000000 metres per second";
    let speed = reader.positive(at, expected)?;
    if (SPEED_MIN..=SPEED_MAX).contains(&speed) {
        return Some(Exact::of_nanos(Fraction::from_integer(1_000_000_000) / fraction(speed)));
    }
    reader.add(Code::WrongType, at.place(), format!("found the number {speed}"), expected, None);
    None
}
