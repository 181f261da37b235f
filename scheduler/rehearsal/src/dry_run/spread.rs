//! Measures how far apart the scripts of an act started. It uses the true clock, which only a dry run knows.

use downbeat_mission::{ActNumber, RobotIndex};
use std::collections::HashMap;

use downbeat_robot::set_log::LogEntry;
use urrcp::{DeviceId, Robot, RobotId, Span, Timestamp};

use super::act_of;
use downbeat_mission::report::ActReport;

/// Collects the true start times of scripts, for the acts that have not ended.
#[derive(Debug)]
pub(super) struct TrueSpread {
    index_of: HashMap<RobotId, usize>,
    /// For each robot: the scripts that have begun, by act number and device.
    firsts: Vec<HashMap<(ActNumber, DeviceId), Starts>>,
    largest: Option<Span>,
    largest_of_ends: Option<Span>,
    starts: Vec<ActStarts>,
}

/// The scripts of a device in one act that have begun, in order.
#[derive(Clone, Debug, Default)]
struct Starts {
    scripts: Vec<Seen>,
    /// The request id of the latest script.
    latest: Option<String>,
}

/// A script that has begun: the device set its first value or began to move linearly to it.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// When the script began, in nanoseconds by the true clock.
    began: i64,
    /// When the script was due, by the robot's clock.
    due: Timestamp<Robot>,
    /// Time from the start of the script to its latest step by the true clock, minus the planned time.
    gained: Span,
}

/// The timing errors of the scripts of an act.
#[derive(Clone, Debug, Default)]
struct Errors {
    starts: Vec<Span>,
    ends: Vec<Span>,
}

/// The scripts of an act that really started, as the first movements of devices show.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ActStarts {
    /// Name of the act.
    pub act: String,
    /// Number of planned scripts, without those of robots that were left out.
    pub planned: usize,
    /// Number of the planned scripts that began.
    pub begun: usize,
    /// Largest minus smallest start error of the scripts, by the true clock; `None` if not all of them began.
    pub spread: Option<Span>,
}

impl TrueSpread {
    pub(super) fn new(ids: Vec<RobotId>) -> Self {
        let firsts = vec![HashMap::new(); ids.len()];
        let index_of = ids.into_iter().enumerate().map(|(index, id)| (id, index)).collect();
        Self { index_of, firsts, largest: None, largest_of_ends: None, starts: Vec::new() }
    }

    pub(super) const fn largest(&self) -> Option<Span> {
        self.largest
    }

    /// Returns the largest spread of an act's last script steps; `None` if no act was evaluated.
    pub(super) const fn largest_of_ends(&self) -> Option<Span> {
        self.largest_of_ends
    }

    pub(super) fn take_starts(&mut self) -> Vec<ActStarts> {
        std::mem::take(&mut self.starts)
    }

    pub(super) fn see(&mut self, robot: RobotIndex, entry: &LogEntry) {
        if entry.step.is_none() {
            return;
        }
        if let Some(act) = entry.request_id.as_deref().and_then(act_of) {
            let starts = self.firsts[robot.get()].entry((act, entry.device.clone())).or_default();
            if starts.latest == entry.request_id {
                if let Some(script) = starts.scripts.last_mut() {
                    script.gained = Span::from_nanos(entry.true_ns - script.began) - (entry.due - script.due);
                }
            } else if entry.step == Some(0) {
                starts.scripts.push(Seen { began: entry.true_ns, due: entry.due, gained: Span::ZERO });
                starts.latest.clone_from(&entry.request_id);
            }
        }
    }

    /// Evaluates an act that has ended: computes the largest minus the smallest start error of its scripts.
    pub(super) fn act_ended(&mut self, act: &ActReport) {
        let errors = self.errors(act);
        let spread = errors.as_ref().and_then(|errors| width(&errors.starts));
        self.largest = self.largest.max(spread);
        self.largest_of_ends = self.largest_of_ends.max(errors.and_then(|errors| width(&errors.ends)));
        self.starts.push(self.starts_of(act, spread));
        self.firsts.iter_mut().for_each(|firsts| firsts.retain(|(number, _), _| *number > act.number));
    }

    fn starts_of(&self, act: &ActReport, spread: Option<Span>) -> ActStarts {
        let (mut planned, mut begun) = (0, 0);
        for robot in act.robots.iter().filter(|robot| !robot.left_out) {
            let firsts = self.index_of.get(&robot.robot).map(|index| &self.firsts[*index]);
            planned += robot.devices.len();
            let of_act = firsts.into_iter().flatten().filter(|((number, _), _)| *number == act.number);
            begun += of_act.map(|(_, starts)| starts.scripts.len()).sum::<usize>().min(robot.devices.len());
        }
        ActStarts { act: act.act.clone(), planned, begun, spread }
    }

    /// Returns the errors of all scripts of an act; `None` if any robot, except those left out, did not start one of its scripts.
    fn errors(&self, act: &ActReport) -> Option<Errors> {
        let mut errors = Errors::default();
        for robot in act.robots.iter().filter(|robot| !robot.left_out) {
            let firsts = &self.firsts[*self.index_of.get(&robot.robot)?];
            // A device's scripts begin in the order of the plan.
            let mut begun: HashMap<&DeviceId, usize> = HashMap::new();
            for device in &robot.devices {
                let nth = begun.entry(&device.device).or_default();
                let script = firsts.get(&(act.number, device.device.clone()))?.scripts.get(*nth)?;
                let start = Span::from_nanos(script.began - device.planned_start?.as_nanos());
                errors.starts.push(start);
                errors.ends.push(start + script.gained);
                *nth += 1;
            }
        }
        Some(errors)
    }
}

fn width(errors: &[Span]) -> Option<Span> {
    Some(*errors.iter().max()? - *errors.iter().min()?)
}
