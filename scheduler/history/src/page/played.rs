//! Converts the course of a mission for the page: acts, messages to the operator, and values that robots set.

use std::collections::BTreeMap;

use downbeat_robot::set_log::LogEntry;
use downbeat_scripts::Choreography;
use urrcp::{DeviceId, RobotId, Server, Timestamp};

use super::columns::{Columns, Points};
use super::document::{Clock, DeviceSeries, Played, PlayedRobot};
use super::planned::Places;
use crate::history::{Fate, Happened, over};
use downbeat_mission::report::{ActReport, ActRobot, Report};
use downbeat_mission::{ActNumber, Progress};
use downbeat_rehearsal::dry_run::{self, act_of};

/// A message to the operator with its time.
pub type TimedProgress = (Timestamp<Server>, Progress);

/// The instant that corresponds to 0 ms on the page.
#[derive(Clone, Copy, Debug)]
pub(super) struct Epoch(pub(super) Timestamp<Server>);

impl Epoch {
    /// Converts an instant to milliseconds since the epoch.
    pub(super) fn millis(self, at: Timestamp<Server>) -> f64 {
        (at - self.0).as_millis_f64()
    }
}

pub(super) fn acts(
    played: &dry_run::Played,
    told: &[TimedProgress],
    choreography: &Choreography,
    places: &Places,
    epoch: Epoch,
) -> Vec<Played> {
    let mut acts: Vec<Played> = Vec::with_capacity(played.report.acts.len());
    for act in &played.report.acts {
        let plan = choreography.acts.iter().position(|planned| planned.is_named(&act.act));
        let duration = plan.map_or(0.0, |plan| choreography.acts[plan].duration().as_millis_f64());
        let told = &told[told.partition_point(|(at, _)| *at < act.timestamp)..];
        let happened = told.iter().map(|(at, told)| (*at, Happened::Told(told)));
        let over = over(happened, &act.act, act.number, act.timestamp);
        let phases = Phases::of(told, &act.act, act.start);
        acts.push(Played {
            name: act.act.clone(),
            number: act.number,
            plan,
            start: epoch.millis(act.start),
            end: epoch.millis(act.start) + duration,
            sent: Some(epoch.millis(act.timestamp)),
            decided: phases.decided.map(|at| epoch.millis(at)),
            committed: phases.committed.map(|at| epoch.millis(at)),
            no_return: phases.no_return.map(|at| epoch.millis(at)),
            lease: phases.leases_end.map(|at| epoch.millis(at)),
            fate: Fate::of(Some(act)),
            over: over.map(|at| epoch.millis(at)),
            robots: robots(act, played, told, places, epoch),
        });
    }
    acts
}

/// When an act was decided (all robots had accepted it) and committed, its point of no return, and the end of its leases.
#[derive(Debug, Default)]
pub(super) struct Phases {
    pub(super) decided: Option<Timestamp<Server>>,
    pub(super) committed: Option<Timestamp<Server>>,
    pub(super) no_return: Option<Timestamp<Server>>,
    pub(super) leases_end: Option<Timestamp<Server>>,
}

impl Phases {
    /// Collects these instants from the messages to the operator about an act.
    pub(super) fn of(told: &[TimedProgress], name: &str, planned: Timestamp<Server>) -> Self {
        let decided = told.iter().find_map(|(at, told)| match told {
            Progress::Decided { act, start, no_return, leases_end, .. }
                if act == name && *start == planned =>
            {
                Some((*at, *no_return, *leases_end))
            }
            _ => None,
        });
        let Some((decided, no_return, leases_end)) = decided else { return Self::default() };
        let committed = |(at, told): &&TimedProgress| {
            *at >= decided && matches!(told, Progress::Committed { act, .. } if act == name)
        };
        Self {
            decided: Some(decided),
            committed: told.iter().find(committed).map(|(at, _)| *at),
            no_return: Some(no_return),
            leases_end: Some(leases_end),
        }
    }
}

fn robots(
    act: &ActReport,
    played: &dry_run::Played,
    told: &[TimedProgress],
    places: &Places,
    epoch: Epoch,
) -> Vec<PlayedRobot> {
    let robot = |of_act: &ActRobot| {
        Some(PlayedRobot {
            robot: places.robot(&of_act.robot)?,
            left_out: of_act.left_out,
            started: started(act.number, played.log_of(&of_act.robot)?).map(|at| epoch.millis(at)),
            ended: finished(told, &of_act.robot, act.number).map(|at| epoch.millis(at)),
        })
    };
    act.robots.iter().filter_map(robot).collect()
}

/// When the first script of a robot in an act really started, by the true clock.
fn started(number: ActNumber, log: &[LogEntry]) -> Option<Timestamp<Server>> {
    let of_act = |entry: &&LogEntry| entry.request_id.as_deref().and_then(act_of) == Some(number);
    Some(Timestamp::from_nanos(log.iter().find(of_act)?.true_ns))
}

/// When the operator was informed that a robot had ended all its scripts in an act; `None` if that did not happen.
pub(super) fn finished(
    told: &[TimedProgress],
    robot: &RobotId,
    number: ActNumber,
) -> Option<Timestamp<Server>> {
    let of_robot = |told: &Progress| matches!(told, Progress::Finished { robot: of, number: act } if of == robot && *act == number);
    told.iter().find(|(_, told)| of_robot(told)).map(|(at, _)| *at)
}

/// The values that robots set, per device and act, at the true times at which they become visible.
pub(super) fn set(
    played: &dry_run::Played,
    choreography: &Choreography,
    places: &Places,
    epoch: Epoch,
    columns: &mut Columns,
) -> Vec<DeviceSeries> {
    let mut all = Vec::new();
    let planned_as = |number: Option<ActNumber>| {
        let act = played.report.acts.iter().find(|act| Some(act.number) == number)?;
        choreography.acts.iter().find(|planned| planned.is_named(&act.act))
    };
    for (row, log) in played.report.robots.iter().zip(&played.logs) {
        let Some(robot) = places.robot(&row.robot) else { continue };
        let mut of_device: BTreeMap<(Option<ActNumber>, &DeviceId), Points> = BTreeMap::new();
        for entry in log.iter().filter(|entry| entry.is_set()) {
            let act = entry.request_id.as_deref().and_then(act_of);
            let at = epoch.millis(Timestamp::from_nanos(entry.true_ns));
            of_device.entry((act, &entry.device)).or_default().push(at, entry.value);
        }
        for ((act, device), mut points) in of_device {
            if let Some(planned) = planned_as(act).filter(|planned| !planned.latencies.is_empty()) {
                points.shift(planned.latency_of(&row.robot, device).as_millis_f64());
            }
            let Some(device) = places.device(robot, device) else { continue };
            all.push(DeviceSeries { robot, device, act, series: columns.series(&points) });
        }
    }
    all
}

/// The sensor readings that the scenario requested, at the times of the requests.
pub(super) fn read(
    report: &Report,
    places: &Places,
    epoch: Epoch,
    columns: &mut Columns,
) -> Vec<DeviceSeries> {
    let mut of_sensor: BTreeMap<(usize, usize, ActNumber), Points> = BTreeMap::new();
    for act in &report.acts {
        for reading in &act.readings {
            let Some(robot) = places.robot(&reading.robot) else { continue };
            let Some((device, value)) = places.device(robot, &reading.sensor).zip(reading.value) else {
                continue;
            };
            let at = epoch.millis(act.start + reading.at);
            of_sensor.entry((robot, device, act.number)).or_default().push(at, value);
        }
    }
    let series = of_sensor.into_iter().map(|((robot, device, act), points)| DeviceSeries {
        robot,
        device,
        act: Some(act),
        series: columns.series(&points),
    });
    series.collect()
}

/// The clock measurements at the end of the mission, which the page shows for the whole mission.
pub(super) fn clocks(
    report: &Report,
    places: &Places,
    from: f64,
    to: f64,
    columns: &mut Columns,
) -> Vec<Clock> {
    let always = |value: f64| [(from, value), (to, value)].into_iter().collect::<Points>();
    let mut all = Vec::new();
    for robot in &report.robots {
        let Some((place, reading)) = places.robot(&robot.robot).zip(robot.clock.as_ref()) else { continue };
        let (offset, uncertainty) = (reading.offset.as_millis_f64(), reading.uncertainty.as_millis_f64());
        all.push(Clock {
            robot: place,
            offset: columns.series(&always(offset)),
            uncertainty: columns.series(&always(uncertainty)),
        });
    }
    all
}
