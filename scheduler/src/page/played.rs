//! What happened: acts, what the operator was told, and what robots set.

use std::collections::BTreeMap;

use downbeat_scripts::Choreography;
use urrcp::{DeviceId, Server, Timestamp};

use super::columns::{Columns, Points};
use super::document::{Clock, DeviceSeries, Played, PlayedRobot};
use super::planned::Places;
use crate::dry_run::{self, act_of};
use crate::mission::Progress;
use crate::report::{ActReport, Report};

/// What the operator was told, and when.
pub type Told = (Timestamp<Server>, Progress);

/// The instant at which the page counts from zero.
#[derive(Clone, Copy, Debug)]
pub(super) struct Epoch(pub(super) Timestamp<Server>);

impl Epoch {
    /// Milliseconds from there.
    pub(super) fn millis(self, at: Timestamp<Server>) -> f64 {
        (at - self.0).as_millis_f64()
    }
}

pub(super) fn acts(
    report: &Report,
    told: &[Told],
    choreography: &Choreography,
    places: &Places,
    epoch: Epoch,
) -> Vec<Played> {
    let mut acts: Vec<Played> = Vec::with_capacity(report.acts.len());
    for act in &report.acts {
        let plan = choreography.acts.iter().position(|planned| planned.is_named(&act.act));
        let duration = plan.map_or(0.0, |plan| choreography.acts[plan].plan.duration().as_millis_f64());
        let mut played = Played {
            name: act.act.clone(),
            number: act.number,
            plan,
            start: epoch.millis(act.start),
            end: epoch.millis(act.start) + duration,
            sent: Some(epoch.millis(act.timestamp)),
            decided: None,
            committed: None,
            no_return: None,
            lease: Some(epoch.millis(act.start - act.lead.margin)),
            robots: robots(act, places, epoch),
        };
        phases(&mut played, act, told, (places, epoch));
        acts.push(played);
    }
    acts
}

/// When an act was decided and committed, and when its robots had ended all their scripts.
fn phases(played: &mut Played, act: &ActReport, told: &[Told], (places, epoch): (&Places, Epoch)) {
    let first = told.partition_point(|(at, _)| *at < act.timestamp);
    for (at, progress) in &told[first..] {
        match progress {
            Progress::Decided { act: name, start, no_return, .. }
                if *name == act.act && *start == act.start =>
            {
                played.decided = Some(epoch.millis(*at));
                played.no_return = Some(epoch.millis(*no_return));
            }
            Progress::Committed { act: name, .. } if *name == act.act && played.committed.is_none() => {
                played.committed = Some(epoch.millis(*at));
            }
            Progress::Finished { robot } if *at >= act.start => {
                let place = places.robot(robot);
                let of_act =
                    played.robots.iter_mut().find(|row| Some(row.robot) == place && row.ended.is_none());
                if let Some(row) = of_act {
                    row.ended = Some(epoch.millis(*at));
                }
            }
            Progress::ActEnded { act: name } | Progress::ActSkipped { act: name, .. } if *name == act.act => {
                return;
            }
            _ => {}
        }
    }
}

fn robots(act: &ActReport, places: &Places, epoch: Epoch) -> Vec<PlayedRobot> {
    let robot = |of_act: &crate::report::ActRobot| {
        let starts =
            of_act.devices.iter().filter_map(|script| Some(script.planned_start? + script.start_error?));
        Some(PlayedRobot {
            robot: places.robot(&of_act.robot)?,
            left_out: of_act.left_out,
            started: starts.min().map(|at| epoch.millis(at)),
            ended: None,
        })
    };
    act.robots.iter().filter_map(robot).collect()
}

/// What robots set, each device of each act by itself, in true time.
pub(super) fn set(
    played: &dry_run::Played,
    places: &Places,
    epoch: Epoch,
    columns: &mut Columns,
) -> Vec<DeviceSeries> {
    let mut all = Vec::new();
    for (row, log) in played.report.robots.iter().zip(&played.logs) {
        let Some(robot) = places.robot(&row.robot) else { continue };
        let mut of_device: BTreeMap<(Option<u32>, &DeviceId), Points> = BTreeMap::new();
        for entry in log.iter().filter(|entry| entry.motion == "set") {
            let act = entry.request_id.as_deref().and_then(act_of);
            let at = epoch.millis(Timestamp::from_nanos(entry.true_ns));
            of_device.entry((act, &entry.device)).or_default().push(at, entry.value);
        }
        for ((act, device), points) in of_device {
            let Some(device) = places.device(robot, device) else { continue };
            all.push(DeviceSeries { robot, device, act, series: columns.series(&points) });
        }
    }
    all
}

/// Readings that the scenario asked for, by the time at which they were asked for.
pub(super) fn read(
    report: &Report,
    places: &Places,
    epoch: Epoch,
    columns: &mut Columns,
) -> Vec<DeviceSeries> {
    let mut of_sensor: BTreeMap<(usize, usize, u32), Points> = BTreeMap::new();
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

/// What is known of clocks at the end, which holds for the whole mission.
pub(super) fn clocks(
    report: &Report,
    places: &Places,
    (from, to): (f64, f64),
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
