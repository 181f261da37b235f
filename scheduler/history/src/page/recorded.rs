//! Converts a mission that was played for the page, from its journal or its recording.

use std::collections::BTreeMap;

use downbeat_mission::report::ActReport;
use downbeat_mission::{ActNumber, Progress, Promise, Record};
use urrcp::{DeviceId, RobotId, Server, Span, Timestamp};

use super::columns::Columns;
use super::document::{
    Clock, Device, DeviceSeries, DocumentKind, Lane, Late, Mission, Plan, Played, PlayedRobot, Robot, Script,
    VERSION,
};
use super::events;
use super::planned::{self, Places};
use super::played::{Epoch, Phases, TimedProgress, finished};
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
        let sent: Vec<Sent> = self.promises().map(|(_, promise)| Sent::of(promise)).collect();
        let acts: Vec<Played> =
            sent.iter().enumerate().map(|(plan, act)| self.played(act, plan, &places, epoch)).collect();
        let events = events::of_happened(self.happened(), &places, epoch);
        let times =
            events.iter().map(|event| event.at).chain(acts.iter().flat_map(|act| [act.start, act.end]));
        let times: Vec<f64> = times.chain(acts.iter().filter_map(|act| act.sent)).collect();
        Mission {
            version: VERSION,
            program: super::PROGRAM,
            kind: match self.source {
                HistorySource::Journal => DocumentKind::Journal,
                HistorySource::Recording => DocumentKind::Recording,
            },
            cut_off: self.cut_off.clone(),
            scenario: self.scenario.clone().unwrap_or_default(),
            epoch: epoch.0.to_string(),
            from: times.iter().copied().fold(0.0, f64::min),
            to: times.iter().copied().fold(0.0, f64::max),
            known_until: self.known_until().map_or(0.0, |at| epoch.millis(at)),
            report: self.whole_report(),
            sources: written.map(|written| planned::sources(written.outline)).unwrap_or_default(),
            groups: written.map(|written| planned::groups(written.fleet, &places)).unwrap_or_default(),
            space: written.map(|written| planned::space(written.fleet)).unwrap_or_default(),
            plans: self.plans(written, &sent, &acts, &places, columns),
            acts,
            events,
            findings: written
                .map(|written| planned::findings(written.findings, written.outline))
                .unwrap_or_default(),
            set: Vec::new(),
            read: self.reported(&places, epoch, columns),
            clocks: self.clocks(&places, epoch, columns),
            late: self.late(&places, epoch),
            compared: None,
            robots,
        }
    }

    /// The indices of robots and devices, according to the robots' descriptions.
    pub(super) fn places(&self) -> Places {
        self.described().0
    }

    /// Returns the scripts that were sent in each act. Uses the robot and device indices of another mission.
    pub(super) fn plans_among(&self, places: &Places, columns: &mut Columns) -> Vec<Plan> {
        let epoch = self.epoch();
        let sent: Vec<Sent> = self.promises().map(|(_, promise)| Sent::of(promise)).collect();
        let acts: Vec<Played> =
            sent.iter().enumerate().map(|(plan, act)| self.played(act, plan, places, epoch)).collect();
        self.plans(None, &sent, &acts, places, columns)
    }

    /// Returns the robots and devices according to the robots' descriptions, and their indices.
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
        sent: &[Sent<'_>],
        acts: &[Played],
        places: &Places,
        columns: &mut Columns,
    ) -> Vec<Plan> {
        let mut plans = Vec::with_capacity(sent.len());
        for (act, played) in sent.iter().zip(acts) {
            let plan = written.and_then(|written| written.plan(act.promise, places, columns));
            plans.push(plan.unwrap_or_else(|| self.plan(act, played, places, columns)));
        }
        plans
    }

    /// Returns the planned start of the first act or, if there is no act, the earliest known instant.
    fn epoch(&self) -> Epoch {
        let start = self.promises().next().map(|(_, promise)| promise.start);
        let records = self.records.iter().map(|(at, _)| *at);
        let first = records.chain(self.told.iter().map(|(at, _)| *at)).next();
        Epoch(start.or(first).unwrap_or(Timestamp::from_nanos(0)))
    }

    fn played(&self, act: &Sent<'_>, plan: usize, places: &Places, epoch: Epoch) -> Played {
        let Promise { number, timestamp, start, .. } = *act.promise;
        let decided =
            |record: &Record| matches!(record, Record::Decided { number: act, .. } if *act == number);
        let committed =
            |record: &Record| matches!(record, Record::Committed { number: act } if *act == number);
        let report = self.report_of(number);
        let name = self.name_of(act.promise);
        let phases = Phases::of(&self.told, &name, start);
        // The commitment is recorded before it is made, so the actual time takes precedence if it is known.
        let committed = if self.told.is_empty() { self.recorded(committed) } else { phases.committed };
        let over = over(self.happened(), &name, number, timestamp);
        let robots = robots(act, report, &self.told, places, epoch);
        let at = |instant: Option<Timestamp<Server>>| instant.map(|instant| epoch.millis(instant));
        Played {
            name,
            number,
            plan: Some(plan),
            start: epoch.millis(start),
            end: epoch.millis(start + act.duration),
            sent: at(Some(timestamp)),
            decided: at(phases.decided.or_else(|| self.recorded(decided))),
            committed: at(committed),
            no_return: at(phases.no_return),
            lease: at(phases.leases_end),
            fate: Fate::of(report),
            over: at(over),
            robots,
        }
    }

    /// Returns when the first record that satisfies `is` was written; `None` if there is no such record.
    fn recorded(&self, is: impl Fn(&Record) -> bool) -> Option<Timestamp<Server>> {
        self.records.iter().find(|(_, record)| is(record)).map(|(at, _)| *at)
    }

    /// The report of the act with the given number; `None` if the act has not ended.
    fn report_of(&self, number: ActNumber) -> Option<&ActReport> {
        self.ended_acts().map(|act| act.report).rfind(|report| report.number == number)
    }

    /// The name of an act: from its report or, without a report, from the messages to the operator.
    pub(super) fn name_of(&self, promise: &Promise) -> String {
        let name = self.report_of(promise.number).map(|report| report.act.as_str());
        let name = name.or_else(|| self.told_name(promise.timestamp));
        name.map_or_else(|| format!("act {}", promise.number.get() + 1), str::to_owned)
    }

    /// The name of the act with the sending timestamp `sent`, from the messages to the operator.
    pub(crate) fn told_name(&self, sent: Timestamp<Server>) -> Option<&str> {
        self.told.iter().find_map(|(_, told)| match told {
            Progress::Preparing { act, timestamp, .. } if *timestamp == sent => Some(act.as_str()),
            _ => None,
        })
    }

    fn plan(&self, act: &Sent<'_>, played: &Played, places: &Places, columns: &mut Columns) -> Plan {
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
            bodies: Vec::new(),
            budgets: Vec::new(),
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

    /// The late steps that robots reported while they played. A step is not due before its script, and not after the report.
    fn late(&self, places: &Places, epoch: Epoch) -> Vec<Late> {
        let mut all = Vec::new();
        for (_, promise) in self.promises() {
            for script in &promise.scripts {
                let robot = self.robots.iter().find(|known| known.id == script.robot);
                let late = robot.and_then(|known| known.late.get(script.request_id.as_str()));
                let place = places.robot(&script.robot);
                let device = place.and_then(|place| places.device(place, &script.device));
                let (Some(late), Some((robot, device))) = (late, place.zip(device)) else { continue };
                let begins = promise.start + script.start.span();
                all.extend(late.grew.iter().map(|grew| Late {
                    robot,
                    device,
                    act: promise.number,
                    from: epoch.millis(grew.from.map_or(begins, |from| from.max(begins))),
                    to: epoch.millis(grew.to),
                    steps: grew.steps,
                    most: grew.most.map(Span::as_millis_f64),
                }));
            }
        }
        all
    }

    /// The measured clock offsets. The uncertainty of a measurement is half of its round trip.
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

/// An act of a past mission that was sent to robots.
struct Sent<'a> {
    promise: &'a Promise,
    duration: Span,
    robots: Vec<RobotId>,
    /// The time that was added to each robot's timestamps to convert them to its clock.
    shifts: BTreeMap<RobotId, Span>,
}

impl<'a> Sent<'a> {
    fn of(promise: &'a Promise) -> Self {
        let ends = promise.scripts.iter().map(|script| script.start.span() + script.duration);
        let mut robots: Vec<RobotId> = Vec::new();
        let mut shifts = BTreeMap::new();
        for script in &promise.scripts {
            shifts.insert(script.robot.clone(), script.shift);
            if !robots.contains(&script.robot) {
                robots.push(script.robot.clone());
            }
        }
        Self { promise, duration: ends.max().unwrap_or_default(), robots, shifts }
    }
}

/// A robot with the devices of its description, and with further devices that received scripts or reported values.
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

fn lanes_of(robot: &KnownRobot, act: &Sent<'_>, places: &Places, columns: &mut Columns) -> Vec<Lane> {
    let mut lanes: Vec<Lane> = Vec::new();
    let Some(place) = places.robot(&robot.id) else { return lanes };
    let shift = act.shifts.get(&robot.id).copied().unwrap_or_default();
    for ((device, request), steps) in &robot.planned {
        if act_of(request) != Some(act.promise.number) {
            continue;
        }
        let Some(device) = device.parse().ok().and_then(|id| places.device(place, &id)) else { continue };
        // Repeated messages are recorded repeatedly.
        let mut steps: Vec<&PlannedStep> = steps.iter().collect();
        steps.sort_by_key(|step| step.due);
        steps.dedup_by_key(|step| step.due);
        let Some(first) = steps.first() else { continue };
        let points = steps.iter().map(|step| ((step.due - first.due).as_millis_f64(), step.value));
        let script = Script {
            start: (first.due - shift - act.promise.start).as_millis_f64(),
            steps: columns.series(&points.collect()),
        };
        let control = first.control_type.to_string();
        match lanes.iter_mut().find(|lane| lane.device == device && lane.control == control) {
            Some(lane) => lane.scripts.push(script),
            None => lanes.push(Lane {
                robot: place,
                device,
                control,
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
    act: &Sent<'_>,
    report: Option<&ActReport>,
    told: &[TimedProgress],
    places: &Places,
    epoch: Epoch,
) -> Vec<PlayedRobot> {
    let robot = |id: &RobotId| {
        let row = report.and_then(|report| report.robots.iter().find(|row| row.robot == *id));
        let scripts = row.into_iter().flat_map(|row| &row.devices);
        let starts = scripts.filter_map(|script| Some(script.planned_start? + script.start_error?));
        Some(PlayedRobot {
            robot: places.robot(id)?,
            left_out: row.is_some_and(|row| row.left_out),
            started: starts.min().map(|at| epoch.millis(at)),
            ended: finished(told, id, act.promise.number).map(|at| epoch.millis(at)),
        })
    };
    act.robots.iter().filter_map(robot).collect()
}
