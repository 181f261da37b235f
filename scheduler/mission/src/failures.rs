//! The failures of a robot, in bounded memory: a robot that fails repeatedly does not fill the report.

use std::mem::discriminant;
use std::ops::Deref;

use super::failure_kind::Failure;

/// The maximum number of failures that are kept per robot. Of further failures, only the first one of each kind is kept, and the others
/// are counted.
pub(super) const KEPT_MAX: usize = 64;

/// The failures of one robot, in order.
#[derive(Debug, Default)]
pub(crate) struct Failures {
    kept: Vec<Failure>,
    omitted: u64,
}

/// Result of noting a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Noted {
    Kept,
    /// The failure was only counted, not kept.
    Omitted,
}

impl Failures {
    pub(crate) fn note(&mut self, failure: Failure) -> Noted {
        // Decisions that depend on a kind of failure must not depend on the number of other failures.
        let known = |kept: &Failure| discriminant(&kept.kind) == discriminant(&failure.kind);
        if self.kept.len() >= KEPT_MAX && self.kept.iter().any(known) {
            self.omitted += 1;
            return Noted::Omitted;
        }
        self.kept.push(failure);
        Noted::Kept
    }

    /// Returns the number of failures that were counted but not kept.
    pub(crate) const fn omitted(&self) -> u64 {
        self.omitted
    }
}

impl Deref for Failures {
    type Target = [Failure];

    fn deref(&self) -> &[Failure] {
        &self.kept
    }
}

#[cfg(test)]
mod tests {
    use urrcp::RobotId;

    use super::*;
    use crate::FailureKind;

    #[test]
    fn repeated_failures_of_a_robot_are_counted_and_only_a_few_listed() {
        let mut failures = Failures::default();
        let robot = RobotId::new("r").unwrap();
        let of = |kind| Failure { robot: robot.clone(), kind };
        for _ in 0..1_000_000 {
            failures.note(of(FailureKind::Garbled { reason: "x".to_owned() }));
        }
        assert_eq!((failures.len(), failures.omitted()), (KEPT_MAX, 1_000_000 - KEPT_MAX as u64));
        let other = of(FailureKind::LinkDown { reason: "cut".to_owned() });
        assert_eq!(failures.note(other.clone()), Noted::Kept, "the first of its kind");
        assert_eq!(failures.last(), Some(&other));
        assert_eq!(failures.note(other), Noted::Omitted);
    }
}
