//! The result of one trial.

use downbeat_scripts::FleetRobot;
use serde::Serialize;
use urrcp::{RobotId, Server, Span, Timestamp};

use crate::dry_run::{ActStarts, Audience, Played};
use downbeat_mission::report::Outcome;
use downbeat_mission::{Failure, Progress};

/// The result of one trial.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Trial {
    /// The number of the trial, from 0.
    pub trial: u32,
    /// How the mission ended, as in a report.
    pub outcome: String,
    /// Whether all, some or none of the robots really began the acts.
    pub started: Started,
    /// Largest spread of starts in an act, by the true clock; `None` if no act began on all robots.
    #[serde(rename = "spread_ms")]
    pub spread: Option<Span>,
    /// Why the mission did not end as planned; `None` if it did.
    pub why: Option<Why>,
}

/// Whether all, some or none of the robots really began the acts that were sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Started {
    /// In every act, all robots began.
    All,
    /// In no act did any robot begin.
    None,
    /// In each act, either all robots began or none.
    AllOrNone,
    /// In at least one act, some robots began and others did not.
    Some,
}

/// Why a mission did not end as planned: the first failure of a robot or, if no robot failed, the outcome.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Why {
    /// The robot that failed first; `None` if no robot failed.
    pub robot: Option<RobotId>,
    /// The kind of the robot's failure, as in a report, or the outcome of the mission if no robot failed.
    pub kind: String,
    /// The reason, for people.
    pub text: String,
}

/// Data of a trial that its report does not contain.
#[derive(Clone, Debug, Default)]
pub(super) struct Evidence {
    /// The scripts that really began in each act, in the order of the acts.
    pub(super) acts: Vec<ActStarts>,
    /// For each robot: the times from sending an act until the robot has accepted all its scripts, one per act.
    pub(super) accepted: Vec<Vec<Span>>,
    /// For each act that all its robots accepted: the index of the robot that accepted last.
    pub(super) last: Vec<usize>,
    /// For each act that all its robots accepted: its actual lead (time from sending the act to its start), and the smallest sufficient
    /// lead.
    pub(super) leads: Vec<(Span, Span)>,
    /// Number of acts that were sent, but not accepted by all of their robots.
    pub(super) undecided: usize,
    /// Number of times that each robot's link was re-established.
    pub(super) reconnects: Vec<u32>,
}

/// Observes a trial and collects the data that the report does not contain.
pub(super) struct Witness<'a> {
    robots: &'a [&'a FleetRobot],
    /// The act in preparation: when it was sent, its lead (time until its start), and the lease and margin within that lead.
    sent: Option<(Timestamp<Server>, Span, Span)>,
    latest: Option<(usize, Span)>,
    failure: Option<Failure>,
    evidence: Evidence,
}

impl<'a> Witness<'a> {
    pub(super) fn new(robots: &'a [&'a FleetRobot]) -> Self {
        let evidence = Evidence { accepted: vec![Vec::new(); robots.len()], ..Evidence::default() };
        Self { robots, sent: None, latest: None, failure: None, evidence }
    }

    fn index(&self, id: &RobotId) -> Option<usize> {
        self.robots.iter().position(|robot| robot.id == *id)
    }

    pub(super) fn says(mut self, trial: u32, played: &Played) -> (Trial, Evidence) {
        let report = &played.report;
        self.evidence.undecided += usize::from(self.sent.is_some());
        self.evidence.acts.clone_from(&played.starts);
        self.evidence.reconnects = report.robots.iter().map(|robot| robot.reconnects).collect();
        let outcome = kind_of(&report.outcome);
        let why = (report.outcome != Outcome::Done).then(|| match (&self.failure, &played.cut) {
            (Some(failure), _) => Why {
                robot: Some(failure.robot.clone()),
                kind: tag_of(failure, "failure").unwrap_or_default(),
                text: failure.kind.to_string(),
            },
            (None, Some(cut)) => Why {
                robot: None,
                kind: "waited".to_owned(),
                text: format!("`{}` waits for {}, which never happens", cut.act, cut.awaits),
            },
            (None, None) => Why { robot: None, kind: outcome.clone(), text: report.outcome.to_string() },
        });
        let (started, spread) = (started(&played.starts), report.largest_true_spread());
        let trial = Trial { trial, outcome, started, spread, why };
        (trial, self.evidence)
    }
}

impl Audience for Witness<'_> {
    fn told(&mut self, at: Timestamp<Server>, progress: &Progress) {
        match progress {
            Progress::Preparing { timestamp, lead, .. } => {
                self.evidence.undecided += usize::from(self.sent.is_some());
                self.sent = Some((*timestamp, lead.total(), lead.lease + lead.margin));
                self.latest = None;
            }
            Progress::Accepted { robot } => {
                let (Some(index), Some((sent, ..))) = (self.index(robot), self.sent) else { return };
                self.evidence.accepted[index].push(at - sent);
                self.latest = Some((index, at - sent));
            }
            Progress::Decided { .. } => {
                let (Some((_, had, beyond)), Some((robot, took))) = (self.sent.take(), self.latest) else {
                    return;
                };
                self.evidence.last.push(robot);
                self.evidence.leads.push((had, took + beyond));
            }
            Progress::Failed(failure) => {
                self.failure.get_or_insert_with(|| failure.clone());
            }
            _ => {}
        }
    }

    fn second(&mut self, _: Timestamp<Server>) {}
}

fn started(acts: &[ActStarts]) -> Started {
    let all = |act: &ActStarts| act.begun == act.planned && act.planned > 0;
    let none = |act: &ActStarts| act.begun == 0;
    match acts {
        [] => Started::None,
        acts if acts.iter().all(all) => Started::All,
        acts if acts.iter().all(none) => Started::None,
        acts if acts.iter().all(|act| all(act) || none(act)) => Started::AllOrNone,
        _ => Started::Some,
    }
}

/// Returns the name of an outcome, as written in JSON.
fn kind_of(outcome: &Outcome) -> String {
    match serde_json::to_value(outcome) {
        Ok(serde_json::Value::String(name)) => name,
        Ok(serde_json::Value::Object(map)) => map.keys().next().cloned().unwrap_or_default(),
        _ => String::new(),
    }
}

fn tag_of(value: &impl Serialize, tag: &str) -> Option<String> {
    Some(serde_json::to_value(value).ok()?.get(tag)?.as_str()?.to_owned())
}
