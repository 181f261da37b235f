//! Plays a plan with each fault, and compares the actual behaviour of the robots with what Downbeat promises.

use std::collections::BTreeSet;

use downbeat_robot::set_log::MotionKind;
use downbeat_robot::simulated::{Fault, SimulatedRobot};
use downbeat_scripts::{Act, Between, Choreography, Fleet, Incident, OnFailure, RobotPlan, Trouble, World};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use urrcp::{RobotId, Span};

use super::value_of;
use crate::dry_run::{Circumstances, Rehearsal, Watched};
use downbeat_mission::report::{Report, StopState};
use downbeat_mission::{ActNumber, MissionOptions, Outcome};
use downbeat_runtime::fleet;

/// A fault to inject into a trial, or none.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "fault")]
#[non_exhaustive]
pub enum Injected {
    /// No fault is injected.
    None,
    /// A robot refuses every script.
    Refuses {
        /// The id of the faulty robot.
        robot: RobotId,
    },
    /// A robot never answers a control request, and does not execute it.
    Silent {
        /// The id of the faulty robot.
        robot: RobotId,
    },
    /// A robot closes its link right after it has accepted a script, and stays unreachable.
    Disconnects {
        /// The id of the faulty robot.
        robot: RobotId,
    },
    /// A robot's process ends in the middle of an act and does not restart.
    Dies {
        /// The id of the faulty robot.
        robot: RobotId,
        /// The name of the act in which the fault occurs.
        act: String,
    },
    /// A robot's link is interrupted for 5 s in the middle of an act, which is longer than the usual lease.
    LinkDown {
        /// The id of the faulty robot.
        robot: RobotId,
        /// The name of the act in which the fault occurs.
        act: String,
    },
    /// A robot stalls for 0.4 s in the middle of an act, as a process under load does.
    Stalls {
        /// The id of the faulty robot.
        robot: RobotId,
        /// The name of the act in which the fault occurs.
        act: String,
    },
}

/// Duration of an interrupted link. It exceeds the usual lease, so a robot without messages for this time comes to rest.
const INTERRUPTED: Span = Span::from_millis(5_000);
/// Duration of a stall: a typical delay of a process under load.
const STALLED: Span = Span::from_millis(400);

impl Injected {
    /// Returns the id of the faulty robot; `None` without a fault.
    fn whose(&self) -> Option<&RobotId> {
        match self {
            Self::None => None,
            Self::Refuses { robot }
            | Self::Silent { robot }
            | Self::Disconnects { robot }
            | Self::Dies { robot, .. }
            | Self::LinkDown { robot, .. }
            | Self::Stalls { robot, .. } => Some(robot),
        }
    }

    /// Returns the robot, the act and the fault; `None` if the fault does not occur during an act.
    fn incident(&self) -> Option<(&RobotId, &str, Trouble)> {
        match self {
            Self::None | Self::Refuses { .. } | Self::Silent { .. } | Self::Disconnects { .. } => None,
            Self::Dies { robot, act } => Some((robot, act, Trouble::Dies { back_after: None })),
            Self::LinkDown { robot, act } => {
                Some((robot, act, Trouble::LinkDown { lasts: always(INTERRUPTED) }))
            }
            Self::Stalls { robot, act } => Some((robot, act, Trouble::Stalls { lasts: always(STALLED) })),
        }
    }

    /// Returns the robot and the fault; `None` if the fault is not permanent.
    fn lasting(&self) -> Option<(&RobotId, Fault)> {
        match self {
            Self::Refuses { robot } => Some((robot, Fault::Refuse)),
            Self::Silent { robot } => Some((robot, Fault::Silent)),
            Self::Disconnects { robot } => Some((robot, Fault::Disconnect)),
            Self::None | Self::Dies { .. } | Self::LinkDown { .. } | Self::Stalls { .. } => None,
        }
    }

    /// Describes the fault for people.
    #[must_use]
    pub fn text(&self) -> String {
        match self {
            Self::None => "no fault".to_owned(),
            Self::Refuses { robot } => format!("`{robot}` refuses"),
            Self::Silent { robot } => format!("`{robot}` is silent"),
            Self::Disconnects { robot } => format!("`{robot}` disconnects after accepting its scripts"),
            Self::Dies { robot, act } => format!("`{robot}` dies in the middle of `{act}`"),
            Self::LinkDown { robot, act } => {
                format!("the link to `{robot}` goes down for {INTERRUPTED} in the middle of `{act}`")
            }
            Self::Stalls { robot, act } => {
                format!("`{robot}` stalls for {STALLED} in the middle of `{act}`")
            }
        }
    }
}

/// A fault, and the result of the mission into which it was injected.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Trial {
    /// The injected fault.
    pub injected: Injected,
    /// The outcome of the mission, as in a report.
    pub outcome: Value,
    /// The largest spread of starts in an act, measured by the true clock; `None` if it is unknown.
    pub true_spread_ms: Option<Span>,
    /// The ids of the robots that set any value, in the order of the fleet.
    pub moved: Vec<RobotId>,
    /// The promises that were broken, in sentences; empty in every certificate.
    pub broken: Vec<String>,
}

/// Lists all faults to play. The first entry is the trial without a fault. Each moving robot once refuses, once is silent, and once
/// disconnects. In each act in which a robot moves, it once dies, once loses its link, and once stalls.
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
    let in_acts = |robot: &RobotId| {
        let acts = choreography.acts.iter();
        let acts = acts.filter(|act| act.plan.robots.iter().any(|planned| planned.robot == *robot));
        let of_act = |act: &Act| {
            let (robot, act) = (robot.clone(), told_as(act));
            [
                Injected::Dies { robot: robot.clone(), act: act.clone() },
                Injected::LinkDown { robot: robot.clone(), act: act.clone() },
                Injected::Stalls { robot, act },
            ]
        };
        acts.flat_map(of_act).collect::<Vec<_>>()
    };
    let of_robots = moves.into_iter().flat_map(|robot| of_robot(robot).into_iter().chain(in_acts(robot)));
    std::iter::once(Injected::None).chain(of_robots).collect()
}

/// The name of an act in messages.
fn told_as(act: &Act) -> String {
    if act.name.is_empty() { act.plan.scenario.clone() } else { act.name.clone() }
}

const fn always(span: Span) -> Between<Span> {
    Between { least: span, largest: span }
}

/// Creates a world in which only the given fault occurs, in the middle of its act. Returns `None` if the fault does not occur during an
/// act.
fn world_with(choreography: &Choreography, fleet: &Fleet, injected: &Injected) -> Option<World> {
    let (robot, act, trouble) = injected.incident()?;
    let place = fleet.robots.iter().position(|listed| listed.id == *robot)?;
    let at = always(middle(choreography.acts.iter().find(|planned| planned.is_named(act))?));
    let incident = Incident { robots: vec![place], trouble, act: Some(act.to_owned()), at, probability: 1.0 };
    Some(World {
        name: String::new(),
        links: Vec::new(),
        clocks: Vec::new(),
        sensors: Vec::new(),
        operator: None,
        incidents: vec![incident],
    })
}

/// Plays one trial to its end.
///
/// # Errors
/// A message for people if a robot cannot be simulated.
pub fn play(
    choreography: &Choreography,
    fleet: &Fleet,
    first_act: usize,
    seed: u64,
    injected: &Injected,
) -> Result<Trial, String> {
    let (report, watched) = rehearse(choreography, fleet, first_act, seed, injected)?;
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

/// Plays a mission with a fault. Returns the report and the actual behaviour of the robots.
fn rehearse(
    choreography: &Choreography,
    fleet: &Fleet,
    first_act: usize,
    seed: u64,
    injected: &Injected,
) -> Result<(Report, Vec<Watched>), String> {
    let robots = fleet::robots_in(fleet, choreography);
    let faulty = injected.lasting();
    let world = world_with(choreography, fleet, injected);
    let machine = |(index, robot): (usize, &&downbeat_scripts::FleetRobot)| {
        let seed = seed.wrapping_add(index as u64);
        let fault = faulty.filter(|(of, _)| **of == robot.id).map(|(_, fault)| fault);
        match fault {
            Some(fault) => fleet::rehearsed_with(robot, |settings| {
                (settings.seed, settings.fault) = (seed, Some(fault));
            }),
            // The links of the world delay messages, so the robot itself must not delay them.
            None if world.is_some() => fleet::rehearsed_with(robot, |settings| {
                (settings.seed, settings.delay) = (seed, Some((Span::ZERO, Span::ZERO)));
            }),
            None => fleet::rehearsed(robot, seed),
        }
    };
    let machines: Result<Vec<SimulatedRobot>, _> = robots.iter().enumerate().map(machine).collect();
    let machines = machines.map_err(|error| error.to_string())?;
    let options = MissionOptions {
        greeting: fleet::greeting(fleet),
        first_act: first_act.into(),
        transfer: Some(fleet::transfer(fleet)),
        ..MissionOptions::default()
    };
    let rehearsal = Rehearsal::new(choreography.clone(), fleet::participants(&robots), options, machines)
        .map_err(|error| error.to_string())?;
    let rehearsal = match &world {
        Some(world) => {
            rehearsal.meets(|begin| Circumstances::draw(world, &fleet.robots, &robots, seed, begin))
        }
        None => rehearsal,
    };
    Ok(rehearsal.play_watched())
}

/// Lists the promises that were broken in a mission, in sentences for people.
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

/// Checks the outcome. Without a fault, the mission succeeds and its starts are close together. With a fault, the mission reports a
/// failure.
fn ended(choreography: &Choreography, injected: &Injected, report: &Report, broken: &mut Vec<String>) {
    let outcome = &report.outcome;
    let tolerance = choreography.acts.iter().map(|act| act.plan.start_tolerance).max().unwrap_or_default();
    match injected {
        Injected::None if *outcome != Outcome::Done => {
            broken.push(format!("the mission did not succeed although no fault was injected: {outcome}"));
        }
        Injected::None => {}
        // A link that recovers and a short stall may have no consequences.
        Injected::LinkDown { .. } | Injected::Stalls { .. } => {}
        _ if *outcome == Outcome::Done => {
            broken.push("the mission reports success despite the fault".to_owned());
        }
        _ if report.failures.is_empty() => broken.push("the report lists no failure".to_owned()),
        _ => {}
    }
    // A robot that stalls or is gone in one act may be late for the next one.
    let apart = report.true_spread.filter(|spread| *spread > tolerance && injected.incident().is_none());
    if let Some(spread) = apart {
        broken.push(format!("robots start {spread} apart, but only {tolerance} is allowed"));
    }
}

/// Checks that each act starts on all of its robots or on none. A robot whose fault occurs during an act may miss the next one. Only the
/// faulty robot may be left out, and only if the act's failure policy permits it.
fn all_or_none(
    choreography: &Choreography,
    injected: &Injected,
    report: &Report,
    watched: &[Watched],
    broken: &mut Vec<String>,
) {
    let is_faulty = |robot: &RobotId| injected.whose() == Some(robot);
    // If its fault occurs during an act, the next act may lack it; the others have to agree.
    let may_miss = |robot: &RobotId| is_faulty(robot) && injected.incident().is_some();
    let index_of = |robot: &RobotId| report.robots.iter().position(|row| row.robot == *robot);
    let begun: BTreeSet<ActNumber> =
        watched.iter().flat_map(|watched| watched.begun.keys().copied()).collect();
    for number in &begun {
        if !report.acts.iter().any(|act| act.number == *number) && report.acts_omitted == 0 {
            broken.push(format!("act {number} started but is missing from the report"));
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
                (false, false) if may_miss(&robot.robot) || begins_after(injected, planned, &robot.robot) => {
                }
                (false, false) => waited.push(robot.robot.to_string()),
                // The robot moved before its fault occurred and was then left out.
                (true, true) if may_miss(&robot.robot) && may_be_left_out(choreography, &robot.robot) => {}
                (true, true) => broken.push(format!("{name}: `{}` was left out but moved", robot.robot)),
                (true, false) if is_faulty(&robot.robot) && may_be_left_out(choreography, &robot.robot) => {}
                (true, false) => {
                    broken.push(format!(
                        "{name}: `{}` was left out although its failure policy does not allow it",
                        robot.robot
                    ));
                }
            }
        }
        if !started.is_empty() && !waited.is_empty() {
            broken.push(format!("{name}: {} started, but {} did not", started.join(", "), waited.join(", ")));
        }
    }
}

/// Whether `robot` starts its first script in `act` so late that the fault may have stopped the act before. In the act with the fault,
/// "late" means at or after the fault. In other acts, it means after the first script of any robot.
fn begins_after(injected: &Injected, act: &Act, robot: &RobotId) -> bool {
    let Some((_, faulty_act, _)) = injected.incident() else { return false };
    let first = |planned: &RobotPlan| planned.scripts.iter().map(|script| script.start.span()).min();
    let of_robot = act.plan.robots.iter().find(|planned| planned.robot == *robot).and_then(first);
    let bound = if act.is_named(faulty_act) {
        Some(middle(act))
    } else {
        act.plan.robots.iter().filter_map(first).min().map(|earliest| earliest + NEXT)
    };
    of_robot.zip(bound).is_some_and(|(start, bound)| start >= bound)
}

/// The shortest time between two different instants.
const NEXT: Span = Span::from_nanos(1);

/// Returns the time from the start of `act` to its middle, where the fault occurs.
fn middle(act: &Act) -> Span {
    Span::from_nanos(act.plan.duration().as_nanos() / 2)
}

/// Whether the failure policy of any act permits leaving out `robot`, or moves on to another act after a failure. A robot that was left
/// out of one act is also left out of later ones.
fn may_be_left_out(choreography: &Choreography, robot: &RobotId) -> bool {
    choreography.acts.iter().map(|act| &act.on_failure).any(|rules| {
        let rule = rules.robots.iter().find(|(of, _)| of == robot);
        rule.map_or(rules.default, |(_, rule)| *rule) == OnFailure::Without || rules.then.is_some()
    })
}

/// Checks that no robot moves at the end, and that each robot that confirmed its default state has gone to that state.
fn at_rest(report: &Report, watched: &[Watched], broken: &mut Vec<String>) {
    for (row, watched) in report.robots.iter().zip(watched) {
        if watched.still_moves {
            broken
                .push(format!("`{}` is still moving after the mission and all leases have ended", row.robot));
        }
        if row.stop == StopState::Home {
            let moving =
                watched.last.iter().find(|(_, motion)| matches!(motion, MotionKind::Set | MotionKind::Ramp));
            if let Some((device, _)) = moving {
                broken.push(format!(
                    "`{}` confirmed its default state, but `{device}` is not in that state",
                    row.robot
                ));
            }
        }
        let stops = matches!(report.outcome, Outcome::Failed | Outcome::NotStarted);
        let runs_on = matches!(row.stop, StopState::Unconfirmed { lease_ends: None } | StopState::TakenOver);
        if stops && watched.moved() && runs_on {
            broken.push(format!("`{}` was moving when the mission failed, and nothing stops it", row.robot));
        }
    }
}

/// Checks the reported starts against the actual starts. For a lost robot, the report may be incomplete.
fn told(report: &Report, watched: &[Watched], broken: &mut Vec<String>) {
    for (row, watched) in report.robots.iter().zip(watched) {
        let began: usize = watched.begun.values().sum();
        let agrees = match row.unaccounted {
            0 => row.started == began,
            _ => row.started <= began,
        };
        if !agrees && report.acts_omitted == 0 {
            broken.push(format!(
                "`{}`: the report lists {} started scripts, but {began} actually started",
                row.robot, row.started
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use downbeat_scripts::{Address, DeviceScript, FleetRobot, Plan};
    use urrcp::{ControlType, InitializationBlock, Millis, Script, Setpoint, Step, StopCondition};

    use super::*;

    const ARM: &str = r#"{"id": "NAME", "api_version": "1", "reports": true, "devices": [
      {"id": "shoulder", "name": "shoulder", "default_value": 0, "interpolation": "linear", "available_control_types": {
         "position": {"min_value": 0, "max_value": 90, "granularity": 1},
         "script": {"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 8}}}]}"#;

    /// Creates a script that moves a device for `length` milliseconds.
    fn script(length: i64) -> DeviceScript {
        let millis = |millis: i64| Millis::from_span(Span::from_millis(millis));
        let step = |at, value| Step {
            offset: millis(at),
            setpoint: Setpoint::new(ControlType::Position, value),
            stop_condition: None,
        };
        let lease = Some(millis(2_000));
        DeviceScript {
            device: "shoulder".parse().unwrap(),
            start: millis(0),
            stop_condition: StopCondition { pending: None, running: lease },
            script: Script::new(vec![step(0, 0.0), step(length, 45.0)]).unwrap(),
            rest: Span::ZERO,
        }
    }

    /// A choreography for three arms that move simultaneously.
    fn three() -> (Choreography, Fleet) {
        let names = ["a", "b", "c"];
        let robots =
            names.map(|name| RobotPlan { robot: name.parse().unwrap(), scripts: vec![script(3_000)] });
        let plan = Plan {
            scenario: "three".to_owned(),
            start_tolerance: Span::from_millis(10),
            lead: None,
            stop_condition: StopCondition::default(),
            robots: robots.to_vec(),
        };
        let robots = names.map(|name| {
            let block: InitializationBlock = serde_json::from_str(&ARM.replace("NAME", name)).unwrap();
            FleetRobot::new(block.id.clone(), Address::Simulated, Some(block))
        });
        (Choreography::of_plan(plan), Fleet { robots: robots.to_vec(), ..Fleet::default() })
    }

    fn id(name: &str) -> RobotId {
        name.parse().unwrap()
    }

    #[test]
    fn all_promises_hold_with_three_kinds_of_faults_on_every_robot() {
        let (choreography, fleet) = three();
        let all = faults(&choreography);
        assert_eq!(all.len(), 19);
        for fault in &all {
            let trial = play(&choreography, &fleet, 0, 0, fault).unwrap();
            assert_eq!(trial.broken, Vec::<String>::new(), "{fault:?}");
            let moves = *fault == Injected::None || fault.incident().is_some();
            assert_eq!(trial.moved.len(), if moves { 3 } else { 0 }, "{fault:?}");
            if let Injected::Dies { .. } = fault {
                assert_eq!(trial.outcome, "failed", "{fault:?}");
            }
        }
    }

    /// Plays a fault, falsifies the result with `doctor`, and checks that the trial then reports the broken promise `says`.
    #[track_caller]
    fn check(injected: &Injected, doctor: fn(&mut Report, &mut Vec<Watched>), says: &str) {
        let (choreography, fleet) = three();
        let (mut report, mut watched) = rehearse(&choreography, &fleet, 0, 0, injected).unwrap();
        assert_eq!(broken(&choreography, injected, &report, &watched), Vec::<String>::new());
        doctor(&mut report, &mut watched);
        let found = broken(&choreography, injected, &report, &watched);
        assert!(found.iter().any(|sentence| sentence.contains(says)), "`{says}` is not in {found:?}");
    }

    #[test]
    fn each_broken_promise_is_found() {
        let refuses = Injected::Refuses { robot: id("b") };
        check(
            &Injected::None,
            |_, watched| watched[1].begun.clear(),
            "the scenario: a, c started, but b did not",
        );
        check(
            &refuses,
            |_, watched| watched[0].begun = [(ActNumber::new(0), 1)].into(),
            "a started, but b, c did not",
        );
        check(
            &Injected::None,
            |_, watched| watched[2].still_moves = true,
            "`c` is still moving after the mission",
        );
        check(
            &Injected::None,
            |report, _| report.robots[0].started = 2,
            "the report lists 2 started scripts, but 1 actually started",
        );
        check(
            &Injected::None,
            |report, _| report.outcome = Outcome::Failed,
            "the mission did not succeed although no fault was injected",
        );
        check(&refuses, |report, _| report.outcome = Outcome::Done, "reports success despite the fault");
        check(&refuses, |report, _| report.failures.clear(), "the report lists no failure");
        check(
            &Injected::None,
            |report, _| report.true_spread = Some(Span::from_millis(11)),
            "robots start 11 ms apart, but only 10 ms is allowed",
        );
        check(
            &Injected::None,
            |report, watched| {
                report.robots[0].stop = StopState::Home;
                watched[0].last.insert("shoulder".parse().unwrap(), MotionKind::Set);
            },
            "`a` confirmed its default state, but `shoulder` is not in that state",
        );
        check(
            &Injected::None,
            |report, _| {
                report.outcome = Outcome::Failed;
                report.robots[1].stop = StopState::Unconfirmed { lease_ends: None };
            },
            "`b` was moving when the mission failed, and nothing stops it",
        );
        check(
            &Injected::None,
            |report, watched| {
                report.acts[0].robots[1].left_out = true;
                watched[1].begun.clear();
                report.robots[1].started = 0;
            },
            "`b` was left out although its failure policy does not allow it",
        );
    }

    #[test]
    fn robot_with_a_later_part_need_not_begin_after_another_has_failed() {
        let (mut choreography, fleet) = three();
        // The start is after the middle of the act, where faults occur.
        let start = Millis::from_span(Span::from_millis(2_000));
        choreography.acts[0].plan.robots[2].scripts = vec![DeviceScript { start, ..script(500) }];
        for injected in faults(&choreography) {
            let trial = play(&choreography, &fleet, 0, 0, &injected).unwrap();
            assert_eq!(trial.broken, Vec::<String>::new(), "{injected:?}");
            if let Injected::Dies { robot, .. } = &injected
                && *robot == id("a")
            {
                assert!(!trial.moved.contains(&id("c")), "{trial:?}");
            }
        }
        // A robot whose script starts before the fault must have begun.
        let dies = Injected::Dies { robot: id("a"), act: "three".to_owned() };
        let (report, mut watched) = rehearse(&choreography, &fleet, 0, 0, &dies).unwrap();
        watched[1].begun.clear();
        let found = broken(&choreography, &dies, &report, &watched);
        assert!(found.iter().any(|sentence| sentence.contains("a started, but b did not")), "{found:?}");
    }

    #[test]
    fn robot_that_dies_is_left_out_where_permitted_and_the_others_continue() {
        let (mut choreography, fleet) = three();
        choreography.acts[0].on_failure.default = OnFailure::Without;
        for injected in faults(&choreography) {
            let trial = play(&choreography, &fleet, 0, 0, &injected).unwrap();
            assert_eq!(trial.broken, Vec::<String>::new(), "{injected:?}");
        }
    }
}
