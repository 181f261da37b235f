//! Checks the invariants against the values that the robots really set on their devices. Each invariant has its own file;
//! `docs/simulation.md` describes them.

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

use downbeat_mission::ActNumber;
use std::fmt;

use urrcp::{Server, Span, Timestamp};

pub use self::cause::Cause;
use self::facts::Facts;
#[cfg(test)]
pub(super) use self::liveness::LEAD_LEAST;
pub use self::situation::Situation;
use super::Ran;

/// Maximum error, due to the drift of a clock, of the end of a lease or of a start within a mission.
const DRIFT: Span = Span::from_millis(1);

/// A violation of an invariant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// The letter of the violated invariant, one of [`Verdict::INVARIANTS`].
    pub invariant: char,
    /// A description of the violation for people.
    pub what: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({}) {}", self.invariant, self.what)
    }
}

/// Whether all, no or some robots started an act.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Starts {
    /// Every robot started.
    All,
    /// No robot started.
    None,
    /// Some robots started, and others did not.
    Mixed,
}

/// The starts of an act that was sent. If a mission sent no act, those of its first act.
#[derive(Clone, Debug)]
pub struct ActStarts {
    /// The number of the act in the mission.
    pub number: ActNumber,
    /// The planned start of the act.
    pub start: Timestamp<Server>,
    /// The indices of the robots that took part in the act at its start and do not lie.
    pub robots: Vec<usize>,
    /// Whether all, none or some of these robots started.
    pub starts: Starts,
}

/// A violation of an invariant that a fault excuses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Excuse {
    /// The letter of the invariant.
    pub invariant: char,
    /// The fault that excuses the violation.
    pub cause: Cause,
}

/// The findings of the checks of a run.
#[derive(Clone, Debug, Default)]
pub struct Verdict {
    /// The violations without an excuse.
    pub violations: Vec<Violation>,
    /// The excused violations: one for each act that only some robots started, and one for each robot that has an excuse for violating
    /// another invariant.
    pub excuses: Vec<Excuse>,
    /// The starts of each act that was sent. If no act was sent, those of the first act.
    pub acts: Vec<ActStarts>,
    /// The situations that the mission reached, each listed as often as it occurred.
    pub situations: Vec<Situation>,
}

impl Verdict {
    /// The letters of the invariants, with short descriptions.
    pub const INVARIANTS: [(char, &str); 10] = [
        ('a', "all or none"),
        ('b', "nothing late, nothing twice"),
        ('c', "at rest after a stop or expired lease"),
        ('d', "no value outside limits"),
        ('e', "every mission ends in a report"),
        ('f', "starts within the skew budget"),
        ('g', "truthful reports"),
        ('h', "stops, gaps and silence stay bounded"),
        ('i', "internal assertions hold"),
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
    /// Checks all invariants whose violation can be found in a single run, without a comparison.
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

    /// Returns the number of the last act for which a comparison with the same mission without faults could find a violation. `None` if
    /// there is no such act.
    #[must_use]
    pub fn last_to_compare(&self) -> Option<ActNumber> {
        liveness::last_to_compare(&Facts::of(self))
    }

    /// Compares this mission, which has faults, with `undisturbed`, the same mission without faults.
    #[must_use]
    pub fn compared_with(&self, undisturbed: &Self) -> Verdict {
        let mut verdict = Verdict::default();
        liveness::compare(&Facts::of(self), &Facts::of(undisturbed), &mut verdict);
        verdict
    }
}
