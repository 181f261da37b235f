//! A mission that was played, from its journal or its recording.

use std::collections::BTreeMap;

use serde_json::Value;
use urrcp::{DeviceId, RobotId, Server, Span, Timestamp};

use super::columns::Columns;
use super::document::{
    Clock, Device, DeviceSeries, Kind, Lane, Mission, Plan, Played, PlayedRobot, Robot, Script, VERSION,
};
use super::events;
use super::planned::{self, Places};
use super::played::{Epoch, Phases, finished, instant};
use super::written::Written;
use crate::history::{Fate, History, HistorySource, KnownRobot, PlannedStep, over};
use downbeat_rehearsal::dry_run::act_of;

impl History {
    pub(super) fn mission(&self, written: Option<&Written<'_>>, columns: &mut Columns) -> Mission {
        let (places, robots) = match written {
            Some(written) => {
                let robots = downbeat_runtime::fleet::robots_in(written.fleet, written.choreography);
                let places = planned::places(&robots);
                let robots = planned::robots(&robots, &places);
                (places, robots)
            }
            None => self.described(),
        };
        let epoch = self.epoch();
        let sent: Vec<Sent> = self.of_kind("prepared").filter_map(|(_, record)| Sent::of(record)).collect();
        let acts: Vec<Played> =
            sent.iter().enumerate().map(|(plan, act)| self.played(act, plan, &places, epoch)).collect();
        let told = if self.told.is_empty() { &self.records } else { &self.told };
        let events = events::of_values(told, &places, epoch);
        let times =
            events.iter().map(|event| event.at).chain(acts.iter().flat_map(|act| [act.start, act.end]));
        let times: Vec<f64> = times.chain(acts.iter().filter_map(|act| act.sent)).collect();
        Mission {
            version: VERSION,
            program: super::PROGRAM,
            kind: match self.source {
                HistorySource::Journal => Kind::Journal,
                HistorySource::Recording => Kind::Recording,
            },
            cut_off: self.cut_off.clone(),
            scenario: self.scenario.clone().unwrap_or_default(),
            epoch: epoch.0.to_string(),
            from: times.iter().copied().fold(0.0, f64::min),
            to: times.iter().copied().fold(0.0, f64::max),
            report: Some(self.report()),
            sources: written.map(|written| planned::sources(written.outline)).unwrap_or_default(),
            groups: written.map(|written| planned::groups(written.fleet, &places)).unwrap_or_default(),
            plans: self.plans(written, &sent, &acts, (&places, columns)),
            acts,
            events,
            findings: written
                .map(|written| planned::findings(written.findings, written.outline))
                .unwrap_or_default(),
            set: Vec::new(),
            read: self.reported(&places, epoch, columns),
            clocks: self.clocks(&places, epoch, columns),
            compared: None,
            robots,
        }
    }

    /// The robots as they described themselves, and their devices.
    pub(super) fn places(&self) -> Places {
        self.described().0
    }

    /// What was sent in each act, for the robots and devices of another mission.
    pub(super) fn plans_among(&self, places: &Places, columns: &mut Columns) -> Vec<Plan> {
        let epoch = self.epoch();
        let sent: Vec<Sent> = self.of_kind("prepared").filter_map(|(_, record)| Sent::of(record)).collect();
        let acts: Vec<Played> =
            sent.iter().enumerate().map(|(plan, act)| self.played(act, plan, places, epoch)).collect();
        self.plans(None, &sent, &acts, (places, columns))
    }

    /// The robots as they described themselves.
    fn described(&self) -> (Places, Vec<Robot>) {
        let described: Vec<Described> = self.robots.iter().map(Described::of).collect();
        let mut places = Places::default();
        for robot in &described {
            places.add(&robot.id, robot.devices.iter().map(|(id, _)| id.to_string()));
        }
        (places, described.into_iter().map(Described::robot).collect())
    }

    fn plans(
        &self,
        written: Option<&Written<'_>>,
        sent: &[Sent],
        acts: &[Played],
        (places, columns): (&Places, &mut Columns),
    ) -> Vec<Plan> {
        let records = self.of_kind("prepared").map(|(_, record)| record);
        let mut plans = Vec::with_capacity(sent.len());
        for ((act, played), record) in sent.iter().zip(acts).zip(records) {
            let plan = written.and_then(|written| written.plan(record, places, columns));
            plans.push(plan.unwrap_or_else(|| self.plan(act, played, places, columns)));
        }
        plans
    }

    /// The planned start of the first act; before anything was sent, the first thing that is known.
    fn epoch(&self) -> Epoch {
        let start = self.of_kind("prepared").find_map(|(_, record)| instant(&record["start"]));
        let first = self.records.first().or_else(|| self.told.first()).map(|(at, _)| *at);
        Epoch(start.or(first).unwrap_or(Timestamp::from_nanos(0)))
    }

    fn played(&self, act: &Sent, plan: usize, places: &Places, epoch: Epoch) -> Played {
        let written = |kind: &'static str| {
            let of_act = self.of_kind(kind).find(|(_, record)| record["number"] == act.number);
            of_act.map(|(at, _)| *at)
        };
        let report = self.report_of(act.number);
        let name = self.name_of(act.number, act.timestamp);
        let phases = Phases::of(&self.told, &name, act.start);
        let told = if self.told.is_empty() { &self.records } else { &self.told };
        // The commitment is written down before it is made: where it is known when that was, this counts.
        let committed = if self.told.is_empty() { written("committed") } else { phases.committed };
        let over = over(told, &name, act.number, act.timestamp);
        let robots = robots(act, report, &self.told, (places, epoch));
        let at = |instant: Option<Timestamp<Server>>| instant.map(|instant| epoch.millis(instant));
        Played {
            name,
            number: act.number,
            plan: Some(plan),
            start: epoch.millis(act.start),
            end: epoch.millis(act.start + act.duration),
            sent: at(Some(act.timestamp)),
            decided: at(phases.decided.or_else(|| written("decided"))),
            committed: at(committed),
            no_return: at(phases.no_return),
            lease: at(phases.leases_end),
            fate: Fate::of(report),
            over: at(over),
            robots,
        }
    }

    /// The report of the act of this number.
    fn report_of(&self, number: u32) -> Option<&Value> {
        let reports = self.of_kind("act_ended").map(|(_, record)| &record["report"]);
        reports.filter(|report| report["number"] == number).last()
    }

    /// The name of the act with this number and sending timestamp: from its report or, without one, from the progress that was
    /// reported to the operator.
    pub(super) fn name_of(&self, number: u32, timestamp: Timestamp<Server>) -> String {
        let sent =
            |told: &Value| told["progress"] == "preparing" && instant(&told["timestamp"]) == Some(timestamp);
        let told = || self.told.iter().map(|(_, told)| told).find(|told| sent(told));
        let name = self.report_of(number).or_else(told).and_then(|named| named["act"].as_str());
        name.map_or_else(|| format!("act {}", number + 1), str::to_owned)
    }

    fn plan(&self, act: &Sent, played: &Played, places: &Places, columns: &mut Columns) -> Plan {
        let mut lanes: Vec<Lane> = Vec::new();
        for robot in &self.robots {
            let mut of_robot = lanes_of(robot, act, places, columns);
            lanes.append(&mut of_robot);
        }
        Plan {
            name: played.name.clone(),
            duration: act.duration.as_millis_f64(),
            start_tolerance: 0.0,
            cues: Vec::new(),
            lanes,
            closest: None,
            waits: String::new(),
        }
    }

    fn reported(&self, places: &Places, epoch: Epoch, columns: &mut Columns) -> Vec<DeviceSeries> {
        let mut all = Vec::new();
        for robot in &self.robots {
            let Some(place) = places.robot(&robot.id) else { continue };
            for (device, values) in &robot.reported {
                let Some(device) = device.parse().ok().and_then(|id| places.device(place, &id)) else {
                    continue;
                };
                let points = values.iter().map(|(at, value)| (epoch.millis(*at), *value));
                let series = columns.series(&points.collect());
                all.push(DeviceSeries { robot: place, device, act: None, series });
            }
        }
        all
    }

    /// An exchange leaves the offset open by half of its round trip.
    fn clocks(&self, places: &Places, epoch: Epoch, columns: &mut Columns) -> Vec<Clock> {
        let known = self.robots.iter().filter(|robot| !robot.clock.is_empty());
        let clock = |robot: &KnownRobot| {
            let offsets = robot.clock.iter().map(|(at, offset, _)| (epoch.millis(*at), *offset));
            let doubts = robot.clock.iter().map(|(at, _, delay)| (epoch.millis(*at), delay / 2.0));
            Some(Clock {
                robot: places.robot(&robot.id)?,
                offset: columns.series(&offsets.collect()),
                uncertainty: columns.series(&doubts.collect()),
            })
        };
        known.filter_map(clock).collect()
    }
}

/// An act that was sent.
struct Sent {
    number: u32,
    timestamp: Timestamp<Server>,
    start: Timestamp<Server>,
    duration: Span,
    robots: Vec<RobotId>,
    /// What was added for the clock of each robot.
    shifts: BTreeMap<String, Span>,
}

impl Sent {
    fn of(record: &Value) -> Option<Self> {
        let scripts = record["scripts"].as_array()?;
        let ends = scripts
            .iter()
            .filter_map(|script| Some(millis(&script["start"])? + millis(&script["duration_ms"])?));
        let mut robots: Vec<RobotId> = Vec::new();
        let mut shifts = BTreeMap::new();
        for script in scripts {
            let Some(robot) = script["robot"].as_str() else { continue };
            shifts.insert(robot.to_owned(), millis(&script["shift_ms"]).unwrap_or_default());
            robots.extend(robot.parse().ok().filter(|robot| !robots.contains(robot)));
        }
        Some(Self {
            number: u32::try_from(record["number"].as_u64()?).ok()?,
            timestamp: instant(&record["timestamp"])?,
            start: instant(&record["start"])?,
            duration: ends.max().unwrap_or_default(),
            robots,
            shifts,
        })
    }
}

fn millis(value: &Value) -> Option<Span> {
    value.as_f64().map(Span::from_millis_f64)
}

/// A robot with the devices that it described, and further ones that were driven.
struct Described {
    id: RobotId,
    devices: Vec<(DeviceId, Device)>,
}

impl Described {
    fn of(robot: &KnownRobot) -> Self {
        let described = robot.init.iter().flat_map(|init| &init.devices);
        let mut devices: Vec<(DeviceId, Device)> =
            described.map(|device| (device.id.clone(), planned::device(device))).collect();
        let driven = robot.planned.keys().map(|(device, _)| device).chain(robot.reported.keys());
        for id in driven.filter_map(|id| id.parse::<DeviceId>().ok()) {
            if !devices.iter().any(|(known, _)| *known == id) {
                let device = planned::device(&urrcp::Device::new(id.clone()));
                devices.push((id, device));
            }
        }
        Self { id: robot.id.clone(), devices }
    }

    fn robot(self) -> Robot {
        let devices = self.devices.into_iter().map(|(_, device)| device).collect();
        Robot { id: self.id.to_string(), devices, body: None }
    }
}

fn lanes_of(robot: &KnownRobot, act: &Sent, places: &Places, columns: &mut Columns) -> Vec<Lane> {
    let mut lanes: Vec<Lane> = Vec::new();
    let Some(place) = places.robot(&robot.id) else { return lanes };
    let shift = act.shifts.get(robot.id.as_str()).copied().unwrap_or_default();
    for ((device, request), steps) in &robot.planned {
        if act_of(request) != Some(act.number) {
            continue;
        }
        let Some(device) = device.parse().ok().and_then(|id| places.device(place, &id)) else { continue };
        // What is sent again is written down again.
        let mut steps: Vec<&PlannedStep> = steps.iter().collect();
        steps.sort_by_key(|step| step.due);
        steps.dedup_by_key(|step| step.due);
        let Some(first) = steps.first() else { continue };
        let points = steps.iter().map(|step| ((step.due - first.due).as_millis_f64(), step.value));
        let script = Script {
            start: (first.due - shift - act.start).as_millis_f64(),
            steps: columns.series(&points.collect()),
        };
        let control = &first.control;
        match lanes.iter_mut().find(|lane| lane.device == device && lane.control == *control) {
            Some(lane) => lane.scripts.push(script),
            None => lanes.push(Lane {
                robot: place,
                device,
                control: control.clone(),
                value: 0,
                worst_error: 0.0,
                worst_at: 0.0,
                scripts: vec![script],
            }),
        }
    }
    for lane in &mut lanes {
        lane.scripts.sort_by(|a, b| a.start.total_cmp(&b.start));
    }
    lanes.sort_by_key(|lane| lane.device);
    lanes
}

fn robots(
    act: &Sent,
    report: Option<&Value>,
    told: &[(Timestamp<Server>, Value)],
    (places, epoch): (&Places, Epoch),
) -> Vec<PlayedRobot> {
    let rows = report.and_then(|report| report["robots"].as_array());
    let robot = |id: &RobotId| {
        let row = rows.and_then(|rows| rows.iter().find(|row| row["robot"] == id.as_str()));
        let scripts = row.and_then(|row| row["devices"].as_array()).into_iter().flatten();
        let starts = scripts.filter_map(|script| {
            Some(instant(&script["planned_start"])? + millis(&script["start_error_ms"])?)
        });
        Some(PlayedRobot {
            robot: places.robot(id)?,
            left_out: row.is_some_and(|row| row["left_out"] == true),
            started: starts.min().map(|at| epoch.millis(at)),
            ended: finished(told, id, act.number).map(|at| epoch.millis(at)),
        })
    };
    act.robots.iter().filter_map(robot).collect()
}
