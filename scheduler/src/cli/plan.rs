//! `downbeat plan`: shows the control requests of a compiled scenario.

use std::collections::BTreeMap;

use downbeat_scripts::{
    Act, BodyUse, Choreography, Closest, DeviceLatency, DeviceScript, DeviceUse, OnDoubt, OnFailure, Plan,
    PlannedCue, PlannedReading, RobotPlan, Wait, Way,
};
use serde::{Serialize, Serializer};
use urrcp::{Command, ControlRequest, DeviceId, Message, Millis, RobotId, Server, Span, Timestamp};

use super::load;
use super::{Exit, Format, ScenarioArgs, console};
use crate::fleet;
use crate::requirements::{Judged, any_unmet};
use crate::show::gantt::gantt;
use crate::show::{plan_table, requirements_table};

/// Show when each cue takes place and which requests each robot receives.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "With --format json, each act has its times, its devices, and the control requests of each robot. \
Offsets are given for a lead of 0.

Examples:
  downbeat plan show.yaml
  downbeat plan show.yaml --gantt
  downbeat plan show.yaml --format json"
)]
pub(super) struct PlanArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
    /// Draw the cues of each act as bars over time, and when each robot moves.
    #[arg(long)]
    gantt: bool,
}

pub(super) fn plan(args: &PlanArgs, format: Format) -> Exit {
    if args.gantt && format == Format::Json {
        console::error(
            "--gantt is not supported with --format json; leave it out: the JSON contains the times of all cues",
        );
        return Exit::Usage;
    }
    let (choreography, fleet) = match load::load_choreography(&args.scenario, format) {
        Ok((choreography, fleet, _)) => (choreography, fleet),
        Err(exit) => return exit,
    };
    let requirements = super::check::of_the_plan(&choreography);
    let exit = if any_unmet(&requirements) { Exit::Failed } else { Exit::Done };
    match format {
        Format::Text => {
            for act in &choreography.acts {
                let columns = console::columns();
                console::print(&if args.gantt {
                    gantt(act, &fleet::robots_of(&fleet, &act.plan), columns)
                } else {
                    plan_table(act, columns)
                });
            }
            console::print(&requirements_table(&requirements, console::columns()));
        }
        Format::Json => console::print_json(&Planned {
            scenario: &choreography.scenario,
            duration_ms: crate::show::main_duration(&choreography),
            start_tolerance_ms: choreography.acts.first().map(|act| act.plan.start_tolerance),
            acts: choreography.acts.iter().map(|act| planned_act(act, &choreography)).collect(),
            requirements,
        }),
    }
    exit
}

#[derive(Serialize)]
struct Planned<'a> {
    scenario: &'a str,
    duration_ms: Span,
    start_tolerance_ms: Option<Span>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    requirements: Vec<Judged>,
    acts: Vec<PlannedAct<'a>>,
}

#[derive(Serialize)]
struct PlannedAct<'a> {
    #[serde(flatten)]
    figures: ActFigures<'a>,
    wait: &'a Wait,
    timeout_ms: Option<Span>,
    on_timeout: Option<String>,
    next: Option<String>,
    on_failure: OnFailure,
    on_doubt: OnDoubt,
    readings: &'a [PlannedReading],
    robots: Requests<'a>,
}

/// Times, latencies, and use of devices and bodies in an act, for the JSON output.
#[derive(Serialize)]
pub(super) struct ActFigures<'a> {
    act: &'a str,
    duration_ms: Span,
    /// Delay of the act's motions compared with the scenario, to compensate latencies. `None` if no device has a latency.
    #[serde(skip_serializing_if = "Option::is_none")]
    lead_in_ms: Option<Span>,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    latencies: &'a BTreeMap<RobotId, BTreeMap<DeviceId, DeviceLatency>>,
    cues: &'a [PlannedCue],
    devices: &'a [DeviceUse],
    /// The closest approach of two bodies. `None` if the fleet file describes no bodies.
    #[serde(skip_serializing_if = "Option::is_none")]
    closest: Option<&'a Closest>,
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    bodies: &'a [BodyUse],
}

pub(super) fn figures(choreography: &Choreography) -> Vec<ActFigures<'_>> {
    choreography.acts.iter().map(act_figures).collect()
}

fn act_figures(act: &Act) -> ActFigures<'_> {
    ActFigures {
        act: &act.name,
        duration_ms: act.duration(),
        lead_in_ms: (!act.latencies.is_empty() || act.lead_in > Span::ZERO).then_some(act.lead_in),
        latencies: &act.latencies,
        cues: &act.cues,
        devices: &act.devices,
        closest: act.in_space.closest.as_ref(),
        bodies: &act.in_space.bodies,
    }
}

fn planned_act<'a>(act: &'a Act, choreography: &'a Choreography) -> PlannedAct<'a> {
    let way = |way: Way| match way {
        Way::Act(index) => choreography.acts.get(index).map(|act| act.name.clone()),
        Way::End => Some("end".to_owned()),
        Way::Fail => None,
    };
    PlannedAct {
        figures: act_figures(act),
        wait: &act.wait,
        timeout_ms: act.timeout,
        on_timeout: way(act.on_timeout),
        next: way(act.next),
        on_failure: act.on_failure.default,
        on_doubt: act.on_doubt,
        readings: &act.readings,
        robots: Requests(&act.plan),
    }
}

/// Serializes the requests of each robot. They are created robot by robot during the output, because a plan may have millions of steps.
struct Requests<'a>(&'a Plan);

impl Serialize for Requests<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut robots: Vec<&RobotPlan> = self.0.robots.iter().collect();
        robots.sort_by_key(|robot| robot.robot.as_str());
        let of_robot = |robot: &RobotPlan| requests(self.0, robot);
        serializer.collect_map(robots.into_iter().map(|robot| (robot.robot.as_str(), of_robot(robot))))
    }
}

fn requests(plan: &Plan, robot: &RobotPlan) -> Vec<Message> {
    let unsent = Timestamp::<Server>::from_nanos(0);
    let request = |script: &DeviceScript| {
        let mut stop_condition = script.stop_condition;
        stop_condition.pending = stop_condition.pending.or(plan.stop_condition.pending);
        Message::ControlRequest(ControlRequest {
            timestamp: Some(unsent),
            time_offset_to_start: Some(Millis::from_span(Span::ZERO + script.start.span())),
            stop_condition: Some(stop_condition),
            ..ControlRequest::immediate(script.device.clone(), Command::Script(script.script.clone()))
        })
    };
    robot.scripts.iter().map(request).collect()
}
