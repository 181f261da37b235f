//! The differences between two missions that were played.

use std::collections::BTreeMap;

use downbeat_mission::report::{ActReport, ActRobot, DeviceReport, DeviceState, Outcome};
use downbeat_mission::{Failure, Record};
use serde::Serialize;
use urrcp::{RobotId, Span};

use super::played::{PlayedAct, SentScript, acts, movement};
use super::steps::{StepDifferences, compare};
use super::{Change, Presence, matched};
use crate::history::History;

/// The differences between two missions that were played.
#[derive(Clone, Debug, Serialize)]
pub struct RunDifferences {
    /// Whether the missions are equal.
    pub same: bool,
    pub(crate) scenario: Option<Change<Option<String>>>,
    /// The outcomes of both missions, if they differ. An unknown outcome is `null` in JSON.
    pub(crate) outcome: Option<Change<Option<Outcome>>>,
    /// The acts that differ, in the order of the first mission, followed by the acts that only the second mission has.
    pub(crate) acts: Vec<RunAct>,
    /// Robots that only the second mission left out.
    pub(crate) dropped_added: Vec<String>,
    pub(crate) dropped_removed: Vec<String>,
    /// The robot failures that only one of the missions has.
    pub(crate) failures: FailureDifferences,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct FailureDifferences {
    pub(crate) added: Vec<RobotFailure>,
    pub(crate) removed: Vec<RobotFailure>,
}

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub(crate) struct RobotFailure {
    pub(crate) robot: String,
    pub(crate) text: String,
}

/// An act that differs between two missions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct RunAct {
    pub(crate) act: String,
    /// Number of this repetition of the act in its mission, from 1.
    pub(crate) time: usize,
    pub(crate) presence: Presence,
    pub(crate) fate: Option<Change<String>>,
    pub(crate) spread_ms: Option<Figure>,
    pub(crate) robots: Vec<RunRobot>,
    /// The devices that received different scripts in the two missions.
    pub(crate) scripts: Vec<ScriptDifferences>,
}

/// The same measurement in two missions, in milliseconds. The closer a value is to 0, the better.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Figure {
    pub(crate) a: Option<f64>,
    pub(crate) b: Option<f64>,
    /// Whether the value of the second mission is better. `None` if a value is unknown, if both are equally far from 0, or if their
    /// difference is smaller than the uncertainty of the clocks.
    pub(crate) better: Option<bool>,
}

/// The differences in a robot's behaviour in an act.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct RunRobot {
    pub(crate) robot: String,
    pub(crate) presence: Presence,
    pub(crate) left_out: Option<Change<bool>>,
    /// The start error of the robot's script that deviates most from its planned start.
    pub(crate) start_error_ms: Option<Figure>,
    pub(crate) steps_done: Option<Change<u64>>,
    pub(crate) late_steps: Option<Change<u64>>,
    pub(crate) states: Vec<StateChange>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct StateChange {
    pub(crate) device: String,
    /// The states of the device's scripts in each mission, one state per script.
    #[serde(flatten)]
    pub(crate) states: Change<Vec<DeviceState>>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct ScriptDifferences {
    pub(crate) robot: String,
    pub(crate) device: String,
    pub(crate) presence: Presence,
    /// The start of the device's first script in each mission, in milliseconds from the act's start, if they differ.
    pub(crate) start_ms: Option<Change<f64>>,
    /// The differences in the steps; `None` if a file does not contain the steps.
    pub(crate) steps: Option<StepDifferences>,
}

/// Compares two missions. Start errors and spreads that differ by at most `within` are considered equal.
pub fn runs(a: &History, b: &History, within: Span) -> RunDifferences {
    let outcome = |history: &History| history.outcome().cloned();
    let (acts_a, acts_b) = (acts(a), acts(b));
    let pairs = matched(&acts_a, &acts_b, |act| (act.name.as_str(), act.before));
    let acts = pairs
        .into_iter()
        .map(|(in_a, in_b)| act(&Side { history: a, act: in_a }, &Side { history: b, act: in_b }, within));
    let (dropped_a, dropped_b) = (dropped(a), dropped(b));
    let (failures_a, failures_b) = (failures(a), failures(b));
    let mut found = RunDifferences {
        same: false,
        scenario: Change::of(a.scenario.clone(), b.scenario.clone()),
        outcome: Change::of(outcome(a), outcome(b)),
        acts: acts.filter(|act| !act.is_empty()).collect(),
        dropped_added: beyond(&dropped_b, &dropped_a),
        dropped_removed: beyond(&dropped_a, &dropped_b),
        failures: FailureDifferences {
            added: beyond(&failures_b, &failures_a),
            removed: beyond(&failures_a, &failures_b),
        },
    };
    found.same = found.scenario.is_none()
        && (found.outcome.is_none() && found.acts.is_empty())
        && (found.dropped_added.is_empty() && found.dropped_removed.is_empty())
        && found.failures == FailureDifferences::default();
    found
}

/// Returns the items in `all` that have no counterpart in `others`.
fn beyond<T: Clone + Ord>(all: &[T], others: &[T]) -> Vec<T> {
    let pairs = matched(all, others, |one| one);
    pairs.into_iter().filter_map(|(one, other)| one.filter(|_| other.is_none()).cloned()).collect()
}

fn dropped(history: &History) -> Vec<String> {
    let robot = |(_, record): &(_, Record)| match record {
        Record::Dropped { robot } => Some(robot.to_string()),
        _ => None,
    };
    history.records.iter().filter_map(robot).collect()
}

fn failures(history: &History) -> Vec<RobotFailure> {
    let failure =
        |failure: &Failure| RobotFailure { robot: failure.robot.to_string(), text: failure.kind.to_string() };
    history.failures().into_iter().map(failure).collect()
}

impl Figure {
    /// `uncertainty`: the error bound of the difference, in milliseconds.
    fn of(a: Option<f64>, b: Option<f64>, within: Span, uncertainty: f64) -> Option<Self> {
        let differs = match (a, b) {
            (Some(a), Some(b)) => Span::from_millis_f64(a - b).abs() > within,
            (None, None) => false,
            _ => true,
        };
        let known = |a: f64, b: f64| (a.abs() - b.abs()).abs() > uncertainty;
        let better = a.zip(b).filter(|(a, b)| known(*a, *b)).map(|(a, b)| b.abs() < a.abs());
        differs.then_some(Self { a, b, better })
    }
}

/// An act of one of the two missions; `None` if the mission did not play it.
struct Side<'a> {
    history: &'a History,
    act: Option<&'a PlayedAct<'a>>,
}

fn act<'a>(side_a: &Side<'a>, side_b: &Side<'a>, within: Span) -> RunAct {
    let (a, b) = (side_a.act, side_b.act);
    let report = |act: Option<&PlayedAct<'a>>| act.and_then(|act| act.report);
    let (report_a, report_b) = (report(a), report(b));
    let spread = |report: Option<&ActReport>| Some(report?.spread?.as_millis_f64());
    let both = a.zip(b);
    let rows = |report: Option<&'a ActReport>| report.map_or(&[][..], |report| &report.robots);
    let rows = matched(rows(report_a), rows(report_b), |row| &row.robot);
    let uncertainty = |robot: &RobotId| {
        let robot = robot.as_str();
        side_a.history.clock_uncertainty(robot) + side_b.history.clock_uncertainty(robot)
    };
    let of_spread = rows.iter().filter_map(|(a, b)| b.or(*a)).map(|row| uncertainty(&row.robot));
    let of_spread = of_spread.fold(0.0, f64::max);
    let robots = rows.into_iter().map(|(a, b)| {
        let uncertainty = b.or(a).map_or(0.0, |row| uncertainty(&row.robot));
        robot(a, b, within, uncertainty)
    });
    RunAct {
        act: b.or(a).map(|act| act.name.clone()).unwrap_or_default(),
        time: b.or(a).map_or(1, |act| act.before + 1),
        presence: Presence::of(a, b),
        fate: both.and_then(|(a, b)| Change::of(a.fate.clone(), b.fate.clone())),
        spread_ms: both.and_then(|_| Figure::of(spread(report_a), spread(report_b), within, of_spread)),
        robots: robots.filter(|robot| both.is_some() && !robot.is_empty()).collect(),
        scripts: both.map_or_else(Vec::new, |(a, b)| scripts([side_a.history, side_b.history], a, b)),
    }
}

impl RunAct {
    fn is_empty(&self) -> bool {
        let quiet = self.fate.is_none() && self.spread_ms.is_none();
        self.presence == Presence::Changed && quiet && self.robots.is_empty() && self.scripts.is_empty()
    }
}

fn robot(a: Option<&ActRobot>, b: Option<&ActRobot>, within: Span, uncertainty: f64) -> RunRobot {
    let shown = b.or(a).map_or("", |row| row.robot.as_str());
    let both = a.zip(b);
    let change = |of: fn(&DeviceReport) -> u32| both.and_then(|(a, b)| Change::of(sum(a, of), sum(b, of)));
    let states = both.map_or_else(Vec::new, |(a, b)| {
        let (a, b) = (states(a), states(b));
        let mut devices: Vec<&String> = a.keys().chain(b.keys()).collect();
        devices.sort();
        devices.dedup();
        let change = |device: &String| {
            let states = Change::of(a.get(device).cloned(), b.get(device).cloned())?;
            let states = Change { a: states.a.unwrap_or_default(), b: states.b.unwrap_or_default() };
            Some(StateChange { device: device.clone(), states })
        };
        devices.into_iter().filter_map(change).collect()
    });
    RunRobot {
        robot: shown.to_owned(),
        presence: Presence::of(a, b),
        left_out: both.and_then(|(a, b)| Change::of(a.left_out, b.left_out)),
        start_error_ms: both
            .and_then(|(a, b)| Figure::of(start_error(a), start_error(b), within, uncertainty)),
        steps_done: change(|script| script.steps_done),
        late_steps: change(|script| script.late_steps),
        states,
    }
}

impl RunRobot {
    fn is_empty(&self) -> bool {
        let Self { robot: _, presence, left_out, start_error_ms, steps_done, late_steps, states } = self;
        let quiet = left_out.is_none() && start_error_ms.is_none() && states.is_empty();
        *presence == Presence::Changed && quiet && steps_done.is_none() && late_steps.is_none()
    }
}

fn start_error(row: &ActRobot) -> Option<f64> {
    let errors = row.devices.iter().filter_map(|script| script.start_error);
    errors.max_by_key(|error| error.abs()).map(Span::as_millis_f64)
}

fn sum(row: &ActRobot, of: fn(&DeviceReport) -> u32) -> u64 {
    row.devices.iter().map(|script| u64::from(of(script))).sum()
}

fn states(row: &ActRobot) -> BTreeMap<String, Vec<DeviceState>> {
    let mut states: BTreeMap<String, Vec<DeviceState>> = BTreeMap::new();
    for script in &row.devices {
        states.entry(script.device.to_string()).or_default().push(script.state);
    }
    states
}

fn scripts(
    [history_a, history_b]: [&History; 2],
    a: &PlayedAct<'_>,
    b: &PlayedAct<'_>,
) -> Vec<ScriptDifferences> {
    let mut keys: Vec<&(String, String)> = a.scripts.keys().chain(b.scripts.keys()).collect();
    keys.sort();
    keys.dedup();
    let mut all = Vec::new();
    for key in keys {
        let (of_a, of_b) = (a.scripts.get(key), b.scripts.get(key));
        if of_a.zip(of_b).is_some_and(|(a, b)| are_same(a, b)) {
            continue;
        }
        let (robot, device) = key;
        let first = |scripts: &Vec<SentScript>| scripts.first().map(|script| script.start.get());
        let starts = of_a.and_then(first).zip(of_b.and_then(first));
        let steps = |history, scripts: Option<&Vec<SentScript>>| {
            movement(history, robot, device, scripts.map_or(&[], Vec::as_slice))
        };
        let movements = steps(history_a, of_a).zip(steps(history_b, of_b));
        all.push(ScriptDifferences {
            robot: robot.clone(),
            device: device.clone(),
            presence: Presence::of(of_a, of_b),
            start_ms: starts.and_then(|(a, b)| Change::of(a, b)),
            steps: movements.map(|(a, b)| compare(&a, &b)),
        });
    }
    all
}

fn are_same(a: &[SentScript], b: &[SentScript]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.is_same(b))
}

#[cfg(test)]
mod tests {
    use urrcp::{Command, ContentHash, Timestamp};

    use super::*;
    use crate::test_records::{device, ended, prepared, report, script};

    use DeviceState::{Ended, Failed};

    fn one() -> ContentHash {
        hash(Span::from_millis(1))
    }

    fn hash(of: Span) -> ContentHash {
        let setpoint = urrcp::Setpoint::new(urrcp::ControlType::Position, of.as_millis_f64());
        Command::Set(setpoint).content_hash()
    }

    fn history(error_ms: f64, state: DeviceState, hash: ContentHash) -> History {
        let error = Some(Span::from_millis_f64(error_ms));
        let devices = vec![DeviceReport { start_error: error, steps_done: 3, ..device("d", state) }];
        let robots = vec![ActRobot { robot: "r".parse().unwrap(), left_out: false, devices }];
        let records = [
            prepared(0, vec![script("x", hash)]),
            ended(ActReport { spread: error, robots, ..report("one", 0) }),
            Record::Ended { outcome: Outcome::Done },
        ];
        History::of_records(records.into_iter().map(|record| (Timestamp::from_nanos(0), record)).collect())
    }

    #[test]
    fn start_error_closer_to_zero_is_better() {
        let found = runs(&history(2.0, Ended, one()), &history(-0.5, Ended, one()), Span::ZERO);
        let robot = &found.acts[0].robots[0];
        assert_eq!(robot.start_error_ms, Some(Figure { a: Some(2.0), b: Some(-0.5), better: Some(true) }));
        assert!(!found.same && robot.states.is_empty() && found.acts[0].scripts.is_empty());
    }

    #[test]
    fn neither_value_is_better_within_the_uncertainty_of_the_clocks() {
        let better = |delay_ms: f64| {
            let [a, b] = [2.0, 0.5].map(|error_ms| {
                let mut history = history(error_ms, Ended, one());
                let mut robot = crate::history::KnownRobot::new("r".parse().unwrap(), None);
                robot.clock.push((Timestamp::from_nanos(0), 0.0, delay_ms));
                history.robots.push(robot);
                history
            });
            let found = runs(&a, &b, Span::ZERO).acts.remove(0);
            [found.spread_ms, found.robots[0].start_error_ms].map(|figure| figure.unwrap().better)
        };
        assert_eq!(better(1.4), [Some(true); 2]);
        assert_eq!(better(1.6), [None; 2]);
    }

    #[test]
    fn differences_within_the_tolerance_are_ignored() {
        let (a, b) = (history(2.0, Ended, one()), history(2.5, Ended, one()));
        assert!(runs(&a, &b, Span::from_micros(500)).same);
        assert!(!runs(&a, &b, Span::from_micros(499)).same);
        assert!(runs(&a, &a, Span::ZERO).same);
    }

    #[test]
    fn different_scripts_or_states_are_differences_at_any_tolerance() {
        let a = history(2.0, Ended, one());
        let found = runs(&a, &history(2.0, Failed, one()), Span::MAX);
        assert_eq!(found.acts[0].robots[0].states[0].states.b, [Failed]);
        let found = runs(&a, &history(2.0, Ended, hash(Span::from_millis(2))), Span::MAX);
        assert_eq!(found.acts[0].scripts[0].steps, None, "a journal has no steps");
        assert!(!found.same);
    }
}
