//! The invariants, checked against the values that the robots really set. One file each; `docs/simulation.md` describes them.

mod all_or_none;
mod cause;
mod facts;
mod limits;
mod liveness;
mod movements;
mod once;
mod promises;
mod rest;
mod seized;
mod situation;
mod synchrony;
#[cfg(test)]
mod tests;
mod times;
mod truth;

use std::fmt;

use urrcp::{Server, Span, Timestamp};

pub use self::cause::Cause;
use self::facts::Facts;
#[cfg(test)]
pub(super) use self::liveness::LEAD_LEAST;
pub use self::situation::Situation;
use super::Ran;

/// Maximum contribution of a drifting clock to a lease or a start within a mission.
const DRIFT: Span = Span::from_millis(1);

/// A violation of an invariant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// The letter of the invariant: one of [`Verdict::INVARIANTS`].
    pub invariant: char,
    /// Description of the violation.
    pub what: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({}) {}", self.invariant, self.what)
    }
}

/// The result of an act's starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Starts {
    /// Every robot started.
    All,
    /// No robot started.
    None,
    /// Some robots started, and others did not.
    Mixed,
}

/// An act that was sent, or the first one of a mission that sent none, and the result of its starts.
#[derive(Clone, Debug)]
pub struct ActStarts {
    /// Its number in the mission.
    pub number: u32,
    /// The planned start of its first cue.
    pub start: Timestamp<Server>,
    /// The honest robots that had a part in it at its start.
    pub robots: Vec<usize>,
    /// The result of its starts.
    pub starts: Starts,
}

/// A violation that a fault excuses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Excuse {
    /// Letter of the invariant.
    pub invariant: char,
    /// The fault.
    pub cause: Cause,
}

/// The findings of a run.
#[derive(Clone, Debug, Default)]
pub struct Verdict {
    /// The violations.
    pub violations: Vec<Violation>,
    /// The excused violations: one for each act with mixed starts, and one for each robot that is excused of another invariant.
    pub excuses: Vec<Excuse>,
    /// Each act that was sent, or the first one if none was sent.
    pub acts: Vec<ActStarts>,
    /// The situations that the mission reached, repeated as often as they occurred.
    pub situations: Vec<Situation>,
}

impl Verdict {
    /// The letters of the invariants, with short descriptions.
    pub const INVARIANTS: [(char, &str); 10] = [
        ('a', "all or none"),
        ('b', "nothing late, nothing twice"),
        ('c', "rest after a stop and beyond a lease"),
        ('d', "no value outside limits"),
        ('e', "every mission ends in a report"),
        ('f', "starts within the skew budget"),
        ('g', "reports that are true"),
        ('h', "silence, gaps and stops in time"),
        ('i', "statements that hold inside the mission"),
        ('m', "no movement without a reason"),
    ];

    fn violated(&mut self, invariant: char, what: String) {
        self.violations.push(Violation { invariant, what });
    }

    fn excused(&mut self, invariant: char, cause: Cause) {
        self.excuses.push(Excuse { invariant, cause });
    }
}

impl Ran {
    /// Checks all invariants.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        if let Some(broken) = &self.broken {
            let violation = Violation { invariant: 'i', what: broken.clone() };
            return Verdict { violations: vec![violation], ..Verdict::default() };
        }
        let facts = Facts::of(self);
        let mut verdict = Verdict::default();
        all_or_none::check(&facts, &mut verdict);
        once::check(&facts, &mut verdict);
        rest::check(&facts, &mut verdict);
        movements::check(&facts, &mut verdict);
        seized::check(&facts, &mut verdict);
        limits::check(&facts, &mut verdict);
        synchrony::check(&facts, &mut verdict);
        times::check(&facts, &mut verdict);
        truth::check(&facts, &mut verdict);
        liveness::check(&facts, &mut verdict);
        promises::check(&facts, &mut verdict);
        verdict.situations = situation::reached(&facts);
        verdict
    }

    /// The number of the last act for which a comparison with the same mission without its faults could find anything.
    #[must_use]
    pub fn last_to_compare(&self) -> Option<u32> {
        liveness::last_to_compare(&Facts::of(self))
    }

    /// Compares a mission under faults with the same one without them.
    #[must_use]
    pub fn compared_with(&self, undisturbed: &Self) -> Verdict {
        let mut verdict = Verdict::default();
        liveness::compare(&Facts::of(self), &Facts::of(undisturbed), &mut verdict);
        verdict
    }
}
