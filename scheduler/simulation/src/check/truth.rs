//! Checks invariants (e) and (g). (e) Every mission ends with a report. (g) The report is true.
//!
//! Compares each number of the report with the robots' own logs, per robot and script. Compares sums with their terms, and earlier
//! messages with the report. Times are equal within [`GRAIN`], counts exactly. What cannot be known must be reported as unknown.

mod acts;
mod blame;
mod outcome;
mod rows;

use urrcp::{Server, Span, Timestamp};

use super::Verdict;
use super::cause::Cause;
use super::facts::Facts;
use crate::Happened;
use downbeat_mission::report::Report;
use downbeat_mission::{Progress, Record};

/// Maximum difference between two times that count as equal.
const GRAIN: Span = Span::from_micros(1);

pub(super) fn check(facts: &Facts<'_>, verdict: &mut Verdict) {
    let Some(report) = &facts.ran.report else {
        let killed = facts.hits.iter().any(|hit| hit.cause == Cause::SchedulerCrash);
        if !facts.ran.hung && !killed {
            verdict.violated('e', "the mission ended without a report".to_owned());
        }
        return;
    };
    let taken_up = facts.taken_up().next_back();
    let said = Said {
        facts,
        report,
        resumed_at: taken_up.map(|(at, _)| at),
        is_withdrawn: taken_up.is_some_and(|(_, how)| how == "withdrawn"),
    };
    let mut wrong = Vec::new();
    said.acts(&mut wrong);
    said.rows(&mut wrong);
    said.blame(&mut wrong);
    said.outcome(&mut wrong);
    wrong.into_iter().for_each(|what| verdict.violated('g', what));
}

/// A report, and the facts with which it is compared.
struct Said<'a> {
    facts: &'a Facts<'a>,
    report: &'a Report,
    /// When the process that wrote the report resumed the mission; `None` if the same process had begun it.
    resumed_at: Option<Timestamp<Server>>,
    /// Whether the process that wrote the report has only withdrawn the mission. It then knows nothing about the earlier part.
    is_withdrawn: bool,
}

impl Said<'_> {
    /// Whether the robot's reports are ignored. This happens after a robot has made an impossible claim, for example because its clock
    /// was set.
    fn is_discredited(&self, robot: usize) -> bool {
        let name = self.facts.name(robot);
        let claim = |happened: &Happened| match happened {
            Happened::Told(progress) => matches!(&**progress, Progress::Failed(failure)
                if failure.robot == *name && matches!(failure.kind, downbeat_mission::FailureKind::Claim { .. })),
            _ => false,
        };
        self.facts.clock_was_set(robot) || self.facts.ran.history.iter().any(|(_, happened)| claim(happened))
    }

    /// When the mission ended.
    fn ended(&self) -> Option<Timestamp<Server>> {
        let ended = |(at, record): &(Timestamp<Server>, Record)| {
            matches!(record, Record::Ended { .. }).then_some(*at)
        };
        self.facts.ran.records.iter().rev().find_map(ended)
    }
}
