//! Observes a mission to its end and beyond, because lost robots continue until their leases have ended. Counts the values that robots
//! set, without keeping them.

use std::collections::BTreeMap;

use downbeat_robot::set_log::{LogEntry, MotionKind};
use urrcp::{DeviceId, Server, Span, Timestamp};

use super::operator::VirtualOperator;
use super::world::VirtualWorld;
use super::{Audience, Logs, Rehearsal, act_of};
use downbeat_mission::drive::{at_once, drive};
use downbeat_mission::report::Report;
use downbeat_mission::{ActNumber, Progress, RobotIndex};

/// The actual behaviour of one robot in a mission.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Watched {
    /// Number of scripts that the robot began, by act number.
    pub begun: BTreeMap<ActNumber, usize>,
    /// The kind of the last motion of each device.
    pub last: BTreeMap<DeviceId, MotionKind>,
    /// Whether the robot was still active when the longest lease and the longest act had passed after the mission.
    pub still_moves: bool,
}

impl Watched {
    /// Whether the robot set any value of a script.
    #[must_use]
    pub fn moved(&self) -> bool {
        !self.begun.is_empty()
    }
}

/// Additional time, besides the longest act and the longest lease, for late messages and for devices to slow down.
const AFTERWARDS: Span = Span::from_millis(60_000);

struct Watcher(Vec<Watched>);

impl Audience for Watcher {
    fn told(&mut self, _: Timestamp<Server>, _: &Progress) {}

    fn second(&mut self, _: Timestamp<Server>) {}

    fn set(&mut self, robot: RobotIndex, entry: &LogEntry) {
        let watched = &mut self.0[robot.get()];
        watched.last.insert(entry.device.clone(), entry.motion);
        let act = entry.request_id.as_deref().and_then(act_of);
        if let (Some(act), Some(0), MotionKind::Set) = (act, entry.step, entry.motion) {
            *watched.begun.entry(act).or_default() += 1;
        }
    }
}

impl Rehearsal {
    /// Plays the mission to its end, and continues until every robot has come to rest or its leases have ended. Returns the report and
    /// the actual behaviour of the robots, in the order of the report's robots.
    #[must_use]
    pub fn play_watched(self) -> (Report, Vec<Watched>) {
        let Self { mut mission, robots, begin, circumstances, .. } = self;
        let choreography = mission.choreography();
        let operator = VirtualOperator::new(choreography);
        let scripts =
            choreography.acts.iter().flat_map(|act| &act.plan.robots).flat_map(|robot| &robot.scripts);
        let leases = scripts.filter_map(|script| Some(script.stop_condition.running?.span()));
        let lease = leases.max().unwrap_or_default();
        let acts = choreography.acts.iter().map(|act| act.plan.duration()).max().unwrap_or_default();
        let ids: Vec<_> = mission.robot_ids().cloned().collect();
        let mut watcher = Watcher(vec![Watched::default(); ids.len()]);
        let mut world =
            VirtualWorld::new(robots, ids, begin, operator, circumstances, Logs::Watched, &mut watcher);
        let report = at_once(drive(&mut mission, &mut world));
        let mut report = report.unwrap_or_else(|| Report::as_left(&mut mission, begin));
        report.true_spread = world.true_spread();
        report.true_end_spread = world.true_end_spread();
        let busy = world.settle(lease + acts + AFTERWARDS);
        for (watched, busy) in watcher.0.iter_mut().zip(busy) {
            watched.still_moves = busy && watched.moved();
        }
        (report, watcher.0)
    }
}
