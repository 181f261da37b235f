//! Plays a plan against each fault, and holds what was promised against what the robots really set.

use std::collections::BTreeSet;

use downbeat_robot::simulated::{Fault, SimulatedRobot};
use downbeat_scripts::{Choreography, Fleet, OnFailure};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use urrcp::{RobotId, Span};

use super::value_of;
use crate::dry_run::{Rehearsal, Watched};
use crate::fleet;
use crate::mission::{MissionOptions, Outcome};
use crate::report::{Report, StopState};

/// A fault that is injected.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "fault")]
#[non_exhaustive]
pub enum Injected {
    /// Nothing goes wrong.
    None,
    /// A robot refuses every script.
    Refuses {
        /// Which one.
        robot: RobotId,
    },
    /// A robot never answers a control request, and does not execute it.
    Silent {
        /// Which one.
        robot: RobotId,
    },
    /// A robot closes its link right after it has accepted a script, and is never reached again.
    Disconnects {
        /// Which one.
        robot: RobotId,
    },
}

impl Injected {
    fn robot(&self) -> Option<(&RobotId, Fault)> {
        match self {
            Self::None => None,
            Self::Refuses { robot } => Some((robot, Fault::Refuse)),
            Self::Silent { robot } => Some((robot, Fault::Silent)),
            Self::Disconnects { robot } => Some((robot, Fault::Disconnect)),
        }
    }

    /// For people.
    #[must_use]
    pub fn text(&self) -> String {
        match self {
            Self::None => "no fault".to_owned(),
            Self::Refuses { robot } => format!("`{robot}` refuses"),
            Self::Silent { robot } => format!("`{robot}` is silent"),
            Self::Disconnects { robot } => format!("`{robot}` disconnects after it has accepted"),
        }
    }
}

/// A fault, and what the mission made of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Trial {
    /// What went wrong.
    pub injected: Injected,
    /// As in a report.
    pub outcome: Value,
    /// True spread of starts, the largest of all acts.
    pub true_spread_ms: Option<Span>,
    /// The robots that set anything, in the order of the fleet.
    pub moved: Vec<RobotId>,
    /// What was promised and did not hold; empty in every certificate.
    pub broken: Vec<String>,
}

/// Every fault that is played: none, and for each robot that moves that it refuses, is silent, and disconnects.
#[must_use]
pub fn faults(choreography: &Choreography) -> Vec<Injected> {
    let moves: BTreeSet<&RobotId> =
        choreography.acts.iter().flat_map(|act| &act.plan.robots).map(|robot| &robot.robot).collect();
    let of_robot = |robot: &RobotId| {
        let robot = robot.clone();
        [
            Injected::Refuses { robot: robot.clone() },
            Injected::Silent { robot: robot.clone() },
            Injected::Disconnects { robot },
        ]
    };
    std::iter::once(Injected::None).chain(moves.into_iter().flat_map(of_robot)).collect()
}

/// Plays one of them to its end.
///
/// # Errors
/// A robot that cannot be simulated, for people.
pub fn play(
    choreography: &Choreography,
    fleet: &Fleet,
    (first_act, seed): (usize, u64),
    injected: &Injected,
) -> Result<Trial, String> {
    let robots = fleet::robots_in(fleet, choreography);
    let faulty = injected.robot();
    let machine = |(index, robot): (usize, &&downbeat_scripts::FleetRobot)| {
        let seed = seed.wrapping_add(index as u64);
        let fault = faulty.filter(|(of, _)| **of == robot.id).map(|(_, fault)| fault);
        match fault {
            Some(fault) => fleet::rehearsed_with(robot, seed, fault),
            None => fleet::rehearsed(robot, seed),
        }
    };
    let machines: Result<Vec<SimulatedRobot>, _> = robots.iter().enumerate().map(machine).collect();
    let machines = machines.map_err(|error| error.to_string())?;
    let options = MissionOptions { greeting: fleet::greeting(fleet), first_act, ..MissionOptions::default() };
    let rehearsal = Rehearsal::new(choreography.clone(), fleet::participants(&robots), options, machines)
        .map_err(|error| error.to_string())?;
    let (report, watched) = rehearsal.play_watched();
    let broken = broken(choreography, injected, &report, &watched);
    let ids = report.robots.iter().map(|row| row.robot.clone());
    let moved = ids.zip(&watched).filter(|(_, watched)| watched.moved()).map(|(id, _)| id).collect();
    Ok(Trial {
        injected: injected.clone(),
        outcome: value_of(&report.outcome),
        true_spread_ms: report.true_spread,
        moved,
        broken,
    })
}

/// What was promised and did not hold, for people.
fn broken(
    choreography: &Choreography,
    injected: &Injected,
    report: &Report,
    watched: &[Watched],
) -> Vec<String> {
    let mut broken = Vec::new();
    ended(choreography, injected, report, &mut broken);
    all_or_none(choreography, injected, report, watched, &mut broken);
    at_rest(report, watched, &mut broken);
    told(report, watched, &mut broken);
    broken
}

/// Without a fault the mission is done and starts are close together; with one it says so.
fn ended(choreography: &Choreography, injected: &Injected, report: &Report, broken: &mut Vec<String>) {
    let outcome = &report.outcome;
    let tolerance = choreography.acts.iter().map(|act| act.plan.start_tolerance).max().unwrap_or_default();
    match injected {
        Injected::None if *outcome != Outcome::Done => {
            broken.push(format!("without a fault the mission ends as: {outcome}"));
        }
        Injected::None => {}
        _ if *outcome == Outcome::Done => {
            broken.push("the mission says that it is done, as if nothing had gone wrong".to_owned());
        }
        _ if report.failures.is_empty() => broken.push("no failure is reported".to_owned()),
        _ => {}
    }
    if let Some(spread) = report.true_spread.filter(|spread| *spread > tolerance) {
        broken.push(format!("robots start {spread} apart, {tolerance} is allowed"));
    }
}

/// Each act starts on all robots that have a part in it, or on none; only the faulty one is left out, and only if the policy of the
/// act says so.
fn all_or_none(
    choreography: &Choreography,
    injected: &Injected,
    report: &Report,
    watched: &[Watched],
    broken: &mut Vec<String>,
) {
    let index_of = |robot: &RobotId| report.robots.iter().position(|row| row.robot == *robot);
    let begun: BTreeSet<u32> = watched.iter().flat_map(|watched| watched.begun.keys().copied()).collect();
    for number in &begun {
        if !report.acts.iter().any(|act| act.number == *number) && report.acts_omitted == 0 {
            broken.push(format!("act number {number} began, and the report does not know it"));
        }
    }
    for act in &report.acts {
        let Some(planned) = choreography.acts.iter().find(|planned| planned.is_named(&act.act)) else {
            continue;
        };
        let name =
            if planned.name.is_empty() { "the scenario".to_owned() } else { format!("act `{}`", act.act) };
        let (mut started, mut waited) = (Vec::new(), Vec::new());
        for robot in &act.robots {
            let began = index_of(&robot.robot)
                .and_then(|index| watched.get(index)?.begun.get(&act.number).copied())
                .unwrap_or_default();
            match (robot.left_out, began > 0) {
                (false, true) => started.push(robot.robot.to_string()),
                (false, false) => waited.push(robot.robot.to_string()),
                (true, true) => broken.push(format!("{name}: `{}` was left out and moved", robot.robot)),
                (true, false) => {
                    let rules = &planned.on_failure;
                    let rule = rules.robots.iter().find(|(of, _)| *of == robot.robot);
                    let rule = rule.map_or(rules.default, |(_, rule)| *rule);
                    let is_faulty = injected.robot().is_some_and(|(of, _)| *of == robot.robot);
                    // An act before may have left it out for the rest of the mission, as its own policy says.
                    let may = choreography.acts.iter().any(|act| {
                        let of = act.on_failure.robots.iter().find(|(of, _)| *of == robot.robot);
                        of.map_or(act.on_failure.default, |(_, rule)| *rule) == OnFailure::Without
                            || act.on_failure.then.is_some()
                    });
                    if !is_faulty || !(rule == OnFailure::Without || may) {
                        broken.push(format!("{name}: `{}` was left out against its policy", robot.robot));
                    }
                }
            }
        }
        if !started.is_empty() && !waited.is_empty() {
            broken.push(format!("{name}: {} started, and {} did not", started.join(", "), waited.join(", ")));
        }
    }
}

/// Nothing moves in the end, and what is said to be stopped went to its default state or holds.
fn at_rest(report: &Report, watched: &[Watched], broken: &mut Vec<String>) {
    for (row, watched) in report.robots.iter().zip(watched) {
        if watched.still_moves {
            broken.push(format!("`{}` still moves after the mission and all leases have ended", row.robot));
        }
        if row.stop == StopState::Confirmed {
            let moving = watched.last.iter().find(|(_, motion)| matches!(**motion, "set" | "ramp"));
            if let Some((device, _)) = moving {
                broken.push(format!(
                    "`{}` confirmed its stop, and `{device}` is not in its default state",
                    row.robot
                ));
            }
        }
        let stops = matches!(report.outcome, Outcome::Failed | Outcome::NotStarted);
        let runs_on = matches!(row.stop, StopState::Unconfirmed { lease_ends: None } | StopState::TakenOver);
        if stops && watched.moved() && runs_on {
            broken.push(format!("`{}` moved, and nothing stops it", row.robot));
        }
    }
}

/// What the report says of starts is what the robots did; of one that went away it may know less.
fn told(report: &Report, watched: &[Watched], broken: &mut Vec<String>) {
    for (row, watched) in report.robots.iter().zip(watched) {
        let began: usize = watched.begun.values().sum();
        let agrees = match row.unaccounted {
            0 => row.started == began,
            _ => row.started <= began,
        };
        if !agrees && report.acts_omitted == 0 {
            broken.push(format!(
                "`{}`: the report says {} scripts started, and {began} did",
                row.robot, row.started
            ));
        }
    }
}
