//! Checks invariants (c) and (g) for robots that another operator seized. (c) A seized robot performs no further action of its previous
//! mission. (g) The report names the operator that seized the robot.

use downbeat_robot::set_log::MotionKind;
use urrcp::{Server, Span, Timestamp};

use super::Verdict;
use super::cause::{Cause, Hit};
use super::facts::{Facts, SentScript};
use crate::world::SEIZED_BY;
use crate::{Happened, Names};
use downbeat_mission::Record;

/// Time within which the mission learns that it has lost a robot, unless another fault prevents that.
const KNOWN_WITHIN: Span = Span::from_millis(1_000);

pub(super) fn check(facts: &Facts<'_>, verdict: &mut Verdict) {
    let seized = facts.ran.history.iter().filter_map(|(at, happened)| match happened {
        Happened::Seized(robot) => Some((*at, *robot)),
        _ => None,
    });
    for (at, robot) in seized.filter(|(_, robot)| facts.honest(*robot)) {
        plays_on(facts, at, robot, verdict);
        if was_cut_short(facts, at, robot) && has_to_be_known(facts, at, robot) && !is_known(facts, robot) {
            let what =
                format!("r{robot} was taken over by {SEIZED_BY} at {at}, but the report does not say so");
            verdict.violated('g', what);
        }
    }
}

fn plays_on(facts: &Facts<'_>, at: Timestamp<Server>, robot: usize, verdict: &mut Verdict) {
    let promised = |id: &str| {
        let before = facts.acts.iter().filter(|act| act.at < at);
        before.flat_map(|act| act.of(robot)).any(|script| script.promised.request_id.as_str() == id)
    };
    let moves = facts.ran.logs[robot].iter().find(|entry| {
        let after =
            entry.true_ns > at.as_nanos() && matches!(entry.motion, MotionKind::Set | MotionKind::Ramp);
        after && entry.request_id.as_deref().is_some_and(|id| promised(facts.promised_name(robot, id)))
    });
    if let Some(entry) = moves {
        verdict.violated('c', format!("r{robot} was seized at {at}, but continued to play: {entry:?}"));
    }
}

/// Whether a script of the robot had begun by the time `at` and was never completed.
fn was_cut_short(facts: &Facts<'_>, at: Timestamp<Server>, robot: usize) -> bool {
    let scripts = facts.acts.iter().flat_map(|act| act.of(robot));
    let began =
        |script: &SentScript<'_>| script.log.first().is_some_and(|first| first.true_ns < at.as_nanos());
    scripts.into_iter().any(|script| began(script) && script.steps_set() < script.steps_written())
}

/// Whether the mission has to learn that a playing robot was seized. This requires that the robot can report the seizure, and that no
/// other fault prevents the mission from receiving the report.
fn has_to_be_known(facts: &Facts<'_>, at: Timestamp<Server>, robot: usize) -> bool {
    let drawn = &facts.drawn().robots[robot];
    let tells = drawn.names == Names::Echoed && drawn.block.reports;
    let until = at + KNOWN_WITHIN;
    let other =
        |hit: &Hit| (hit.is_of(robot) || hit.robot.is_none()) && hit.overlaps(at - KNOWN_WITHIN, until);
    let itself = |hit: &Hit| hit.cause == Cause::Stranger && hit.from == at;
    let disturbed = facts.hits.iter().any(|hit| other(hit) && !itself(hit));
    let ends = |record: &Record| matches!(record, Record::Stopping { .. } | Record::Ended { .. });
    let ended = facts.ran.records.iter().any(|(when, record)| *when <= at && ends(record));
    let out = facts.dropped[robot].is_some_and(|out| out <= at);
    tells && !disturbed && !ended && !out && !facts.was_taken_up()
}

fn is_known(facts: &Facts<'_>, robot: usize) -> bool {
    let says = |report: &downbeat_mission::report::Report| {
        let of_robot = report.failures.iter().filter(|failure| failure.robot == *facts.name(robot));
        of_robot.into_iter().any(|failure| failure.kind.to_string().contains(SEIZED_BY))
    };
    facts.ran.report.as_ref().is_none_or(says)
}
