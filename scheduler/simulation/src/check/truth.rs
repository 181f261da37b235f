//! (e) Every mission ends in a report. (g) What it says is true.
//!
//! Each number of the report is compared with what the robots logged themselves, robot by robot and script by script; sums with
//! what they sum up; what was said before with what is said at the end. Times are equal within [`GRAIN`], counts exactly. What
//! could not be known has to be called unknown.

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

/// How exactly times have to agree.
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

/// What a report says, and what happened.
struct Said<'a> {
    facts: &'a Facts<'a>,
    report: &'a Report,
    /// When the process that reports took the mission up, if another one had begun it.
    resumed_at: Option<Timestamp<Server>>,
    /// Whether that process has only withdrawn the mission: it knows nothing of the earlier part.
    is_withdrawn: bool,
}

impl Said<'_> {
    /// The robot failed by a claim that cannot be true, as one does whose clock is set: nothing more of it was believed.
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
