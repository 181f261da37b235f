//! The combined results of all trials.

use std::collections::BTreeMap;

use downbeat_scripts::{Choreography, World};
use serde::Serialize;
use urrcp::{RobotId, Span};

use super::figures::{Quantiles, Share};
use super::trial::{Evidence, Started, Trial};
use downbeat_mission::requirements::{Figures, Judged, closest_of, judge};

/// The combined results of all trials of a choreography.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Results {
    /// The scenario's name.
    pub scenario: String,
    /// The world's name.
    pub world: String,
    /// Number of trials that were played.
    pub trials: usize,
    /// The seed from which the trials were drawn.
    pub seed: u64,
    /// Share of the missions in which the first act began on all of its robots that were not left out.
    pub starts: Share,
    /// Share of the missions that all robots finished as planned.
    pub finishes: Share,
    /// Share of the missions that did not start, failed or were stopped.
    pub aborts: Share,
    /// Share of the missions in which some robots of an act began and others did not.
    pub mixed: Share,
    /// Each outcome and its share of the missions, the most frequent first.
    pub outcomes: Vec<(String, Share)>,
    /// Quantiles over all missions in which an act began on all robots. Each value is the mission's largest spread of starts in an act,
    /// by the true clock.
    pub spread: Option<Quantiles>,
    /// The results of each act that was sent in some trial, in the order of the scenario.
    pub acts: Vec<ActResult>,
    /// The leads (times from sending an act to its start) that acts had and needed. `None` if no act was accepted by all of its robots.
    pub lead: Option<LeadResult>,
    /// The reasons why missions did not end as planned, the most frequent first.
    pub reasons: Vec<Reason>,
    /// The results of each robot, in the order of the fleet.
    pub robots: Vec<RobotResult>,
    /// The robot that was the first to fail in the most missions; `None` if no robot failed.
    pub weakest_robot: Option<RobotId>,
    /// The robot that takes longest to accept its scripts (99 % quantile); `None` if no robot accepted an act.
    pub weakest_link: Option<RobotId>,
    /// The verdicts on the scenario's requirements.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub requirements: Vec<Judged>,
    /// The result of each trial, in order.
    pub each: Vec<Trial>,
}

/// The combined results of an act over all trials.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ActResult {
    /// The name of the act.
    pub act: String,
    /// How often the act began on all its robots, as a share of the times that it was sent.
    pub starts: Share,
    /// Quantiles of the spread of starts in the act, by the true clock; `None` if the act never began on all its robots.
    pub spread: Option<Quantiles>,
    /// The scenario's `start_tolerance`.
    #[serde(rename = "tolerance_ms")]
    pub tolerance: Span,
    /// Share of the starts of the act whose spread exceeds the tolerance.
    pub beyond_tolerance: Share,
}

/// Leads (times from sending an act to its start) of all acts that their robots accepted. If a robot refuses or does not answer, no lead
/// would have sufficed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LeadResult {
    /// The actual lead: the time from the sending timestamp of an act to its start.
    pub had: Quantiles,
    /// The sufficient lead, with which the last acceptance would just have been in time: the time until that acceptance, plus lease and
    /// margin.
    pub enough: Quantiles,
    /// Number of acts that were sent, but not accepted by all of their robots.
    pub undecided: usize,
}

/// A reason why some missions did not end as planned.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reason {
    /// The robot that failed first; `None` if no robot failed.
    pub robot: Option<RobotId>,
    /// The kind of the robot's failure, or the outcome of the mission if no robot failed.
    pub kind: String,
    /// Share of the missions with this reason.
    pub share: Share,
    /// The number of the first trial with this reason.
    pub example: u32,
    /// The message for people from the trial with the number `example`.
    pub text: String,
}

/// The combined results of a robot over all trials.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RobotResult {
    /// The id of the robot.
    pub robot: RobotId,
    /// Share of the missions in which the robot was the first to fail.
    pub fails_first: Share,
    /// Quantiles of the time from sending an act until the robot had accepted all its scripts; `None` if it never did.
    pub accepts_within: Option<Quantiles>,
    /// Share of the acts accepted by all their robots in which this robot was the last to accept.
    pub accepts_last: Share,
    /// Share of the missions in which the robot's link had to be re-established.
    pub reconnects: Share,
}

/// Outcomes of missions that began and reached their planned end, even if robots were left out or late.
const CAME_TO_AN_END: [&str; 6] =
    ["done", "done_without", "done_skipping", "out_of_tolerance", "steps_late", "unknown"];

impl Results {
    pub(super) fn of(
        choreography: &Choreography,
        world: &World,
        ids: Vec<RobotId>,
        seed: u64,
        trials: Vec<(Trial, Evidence)>,
    ) -> Self {
        let (each, evidence): (Vec<Trial>, Vec<Evidence>) = trials.into_iter().unzip();
        let all = each.len();
        let count =
            |is: &dyn Fn(&Trial) -> bool| Share::of(each.iter().filter(|trial| is(trial)).count(), all);
        let first_began = |evidence: &&Evidence| {
            evidence.acts.first().is_some_and(|act| act.begun == act.planned && act.planned > 0)
        };
        let robots = robots(ids, &each, &evidence);
        let weakest_robot = robots.iter().max_by_key(|robot| robot.fails_first.count);
        let weakest_robot = weakest_robot.filter(|robot| robot.fails_first.count > 0);
        let slowest = robots.iter().filter_map(|robot| Some((robot.accepts_within?.p99, robot)));
        let weakest_link = slowest.reduce(|slowest, next| if next.0 > slowest.0 { next } else { slowest });
        let (starts, finishes) = (
            Share::of(evidence.iter().filter(first_began).count(), all),
            count(&|trial| trial.outcome == "done"),
        );
        let spread = Quantiles::of(each.iter().filter_map(|trial| trial.spread));
        let figures = Figures {
            trials: Some(starts.of),
            spread_p50: spread.map(|spread| spread.p50),
            spread_p99: spread.map(|spread| spread.p99),
            spread_max: spread.map(|spread| spread.max),
            starts: Some(starts.count),
            finishes: Some(finishes.count),
            closest: closest_of(choreography),
        };
        Self {
            scenario: choreography.scenario.clone(),
            world: world.name.clone(),
            trials: all,
            seed,
            starts,
            finishes,
            aborts: count(&|trial| !CAME_TO_AN_END.contains(&trial.outcome.as_str())),
            mixed: count(&|trial| trial.started == Started::Some),
            outcomes: outcomes(&each),
            spread,
            acts: acts(choreography, &evidence),
            lead: lead(&evidence),
            reasons: reasons(&each),
            weakest_robot: weakest_robot.map(|robot| robot.robot.clone()),
            weakest_link: weakest_link.map(|(_, robot)| robot.robot.clone()),
            robots,
            requirements: judge(&choreography.requirements, &figures),
            each,
        }
    }
}

fn outcomes(each: &[Trial]) -> Vec<(String, Share)> {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    each.iter().for_each(|trial| *counts.entry(&trial.outcome).or_default() += 1);
    let mut counts: Vec<_> = counts.into_iter().collect();
    counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    counts.into_iter().map(|(name, count)| (name.to_owned(), Share::of(count, each.len()))).collect()
}

fn acts(choreography: &Choreography, evidence: &[Evidence]) -> Vec<ActResult> {
    let result = |act: &downbeat_scripts::Act| {
        let starts =
            evidence.iter().flat_map(|evidence| &evidence.acts).filter(|seen| act.is_named(&seen.act));
        let (mut sent, mut began, mut spreads) = (0, 0, Vec::new());
        for seen in starts {
            sent += 1;
            began += usize::from(seen.begun == seen.planned && seen.planned > 0);
            spreads.extend(seen.spread);
        }
        let tolerance = act.plan.start_tolerance;
        let beyond = spreads.iter().filter(|spread| **spread > tolerance).count();
        (sent > 0).then(|| ActResult {
            act: act.called().to_owned(),
            starts: Share::of(began, sent),
            beyond_tolerance: Share::of(beyond, spreads.len()),
            spread: Quantiles::of(spreads),
            tolerance,
        })
    };
    choreography.acts.iter().filter_map(result).collect()
}

fn lead(evidence: &[Evidence]) -> Option<LeadResult> {
    let leads = || evidence.iter().flat_map(|evidence| &evidence.leads);
    Some(LeadResult {
        had: Quantiles::of(leads().map(|(had, _)| *had))?,
        enough: Quantiles::of(leads().map(|(_, enough)| *enough))?,
        undecided: evidence.iter().map(|evidence| evidence.undecided).sum(),
    })
}

fn reasons(each: &[Trial]) -> Vec<Reason> {
    let mut by_reason: BTreeMap<(Option<&str>, String), Vec<&Trial>> = BTreeMap::new();
    for trial in each {
        let Some(why) = &trial.why else { continue };
        let key = (why.robot.as_ref().map(RobotId::as_str), alike(&why.text));
        by_reason.entry(key).or_default().push(trial);
    }
    let reason = |trials: Vec<&Trial>| {
        let first = trials.first()?;
        let why = first.why.as_ref()?;
        Some(Reason {
            robot: why.robot.clone(),
            kind: why.kind.clone(),
            share: Share::of(trials.len(), each.len()),
            example: first.trial,
            text: why.text.clone(),
        })
    };
    let mut reasons: Vec<_> = by_reason.into_values().filter_map(reason).collect();
    reasons.sort_by_key(|reason| std::cmp::Reverse(reason.share.count));
    reasons
}

/// Removes numbers and quoted names from `text`, so that failures that differ only in these count as one reason.
fn alike(text: &str) -> String {
    let unquoted = text.split('`').step_by(2).map(|part| part.trim_matches([',', ' ']));
    let words: Vec<&str> = unquoted.filter(|part| !part.is_empty()).collect();
    words.join(" ").chars().filter(|c| !c.is_ascii_digit() && !matches!(c, '.' | '-' | '+')).collect()
}

fn robots(ids: Vec<RobotId>, each: &[Trial], evidence: &[Evidence]) -> Vec<RobotResult> {
    let decided: usize = evidence.iter().map(|evidence| evidence.last.len()).sum();
    let result = |(index, robot): (usize, RobotId)| {
        let failed_first =
            |trial: &&Trial| trial.why.as_ref().is_some_and(|why| why.robot.as_ref() == Some(&robot));
        let last = evidence.iter().flat_map(|evidence| &evidence.last).filter(|last| **last == index);
        let again = |evidence: &&Evidence| evidence.reconnects.get(index).is_some_and(|count| *count > 0);
        let accepted = evidence.iter().filter_map(|evidence| evidence.accepted.get(index)).flatten().copied();
        RobotResult {
            fails_first: Share::of(each.iter().filter(failed_first).count(), each.len()),
            accepts_within: Quantiles::of(accepted),
            accepts_last: Share::of(last.count(), decided),
            reconnects: Share::of(evidence.iter().filter(again).count(), each.len()),
            robot,
        }
    };
    ids.into_iter().enumerate().map(result).collect()
}

#[cfg(test)]
mod tests {
    use super::alike;

    #[test]
    fn reasons_differing_only_in_numbers_or_names_are_alike() {
        let silent = alike("silent: no acceptance by `z`, `yaw` within 101.101 ms");
        assert_eq!(silent, alike("silent: no acceptance by `x` within 98 ms"));
        assert_ne!(silent, alike("silent: no word shortly before the start within 98 ms"));
        assert_ne!(alike("device `x`: busy: simulated refusal"), alike("device `x`: link_lost: silent"));
    }
}
