//! How far apart the scripts of an act started, by the one true clock, which only a dry run has.

use std::collections::HashMap;

use downbeat_robot::set_log::LogEntry;
use urrcp::{DeviceId, RobotId, Span};

use super::act_of;
use crate::report::ActReport;

/// The starts of the scripts of acts that have not ended.
#[derive(Debug)]
pub(super) struct TrueSpread {
    index_of: HashMap<RobotId, usize>,
    /// A map for each robot, by the number of the act and the device.
    firsts: Vec<HashMap<(u32, DeviceId), Starts>>,
    largest: Option<Span>,
    starts: Vec<ActStarts>,
}

/// The starts of a device's scripts: the instants at which it set their first values or began to move linearly to them.
#[derive(Clone, Debug, Default)]
struct Starts {
    /// The true times, in order.
    times: Vec<i64>,
    /// The request of the latest script.
    latest: Option<String>,
}

/// How many scripts of an act really started, counted by the first movements of devices.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ActStarts {
    /// Name of the act.
    pub act: String,
    /// Scripts of robots that were not left out.
    pub planned: usize,
    /// Those of them that began.
    pub begun: usize,
    /// Largest minus smallest error of their starts, by the true time; `None` where not all began.
    pub spread: Option<Span>,
}

impl TrueSpread {
    pub(super) fn new(ids: Vec<RobotId>) -> Self {
        let firsts = vec![HashMap::new(); ids.len()];
        let index_of = ids.into_iter().enumerate().map(|(index, id)| (id, index)).collect();
        Self { index_of, firsts, largest: None, starts: Vec::new() }
    }

    pub(super) const fn largest(&self) -> Option<Span> {
        self.largest
    }

    pub(super) fn take_starts(&mut self) -> Vec<ActStarts> {
        std::mem::take(&mut self.starts)
    }

    pub(super) fn see(&mut self, robot: usize, entry: &LogEntry) {
        if entry.step != Some(0) {
            return;
        }
        if let Some(act) = entry.request_id.as_deref().and_then(act_of) {
            let starts = self.firsts[robot].entry((act, entry.device.clone())).or_default();
            if starts.latest != entry.request_id {
                starts.times.push(entry.true_ns);
                starts.latest.clone_from(&entry.request_id);
            }
        }
    }

    /// An act has ended: largest minus smallest error of the starts of its scripts.
    pub(super) fn act_ended(&mut self, act: &ActReport) {
        let spread = self.spread(act);
        self.largest = self.largest.max(spread);
        self.starts.push(self.starts_of(act, spread));
        self.firsts.iter_mut().for_each(|firsts| firsts.retain(|(number, _), _| *number > act.number));
    }

    fn starts_of(&self, act: &ActReport, spread: Option<Span>) -> ActStarts {
        let (mut planned, mut begun) = (0, 0);
        for robot in act.robots.iter().filter(|robot| !robot.left_out) {
            let firsts = self.index_of.get(&robot.robot).map(|index| &self.firsts[*index]);
            planned += robot.devices.len();
            let of_act = firsts.into_iter().flatten().filter(|((number, _), _)| *number == act.number);
            begun += of_act.map(|(_, starts)| starts.times.len()).sum::<usize>().min(robot.devices.len());
        }
        ActStarts { act: act.act.clone(), planned, begun, spread }
    }

    /// `None` where a robot that was not left out did not start a script.
    fn spread(&self, act: &ActReport) -> Option<Span> {
        let mut errors = Vec::new();
        for robot in act.robots.iter().filter(|robot| !robot.left_out) {
            let firsts = &self.firsts[*self.index_of.get(&robot.robot)?];
            // A device's scripts begin in the order of the plan.
            let mut begun: HashMap<&DeviceId, usize> = HashMap::new();
            for device in &robot.devices {
                let nth = begun.entry(&device.device).or_default();
                let first = firsts.get(&(act.number, device.device.clone()))?.times.get(*nth)?;
                let planned = device.planned_start?;
                errors.push(Span::from_nanos(first - planned.as_nanos()));
                *nth += 1;
            }
        }
        Some(*errors.iter().max()? - *errors.iter().min()?)
    }
}
