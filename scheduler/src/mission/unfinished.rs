//! What a process that died has left of its mission.

use std::collections::{BTreeMap, BTreeSet};

use urrcp::{DeviceId, Millis, RobotId, Server, Span, Timestamp};

use super::Failure;
use super::record::{ActFlaws, ActOver, Promise};

/// A mission whose process died, as another process continues it.
#[derive(Clone, Debug)]
pub struct Unfinished<'a> {
    /// Acts that were promised and have not ended, in order, each with its progress.
    pub promises: &'a [(Promise, Progressed)],
    /// Number of acts that have ended, without attempts that were repeated.
    pub ended_acts: u32,
    /// The fates of the acts that are over, in order.
    pub course: &'a [ActOver],
    /// The flaws of the acts that ended, which rule out the outcome `done`.
    pub flaws: &'a [ActFlaws],
    /// The failures of robots, in order.
    pub failures: &'a [Failure],
    /// Robots that were left out.
    pub dropped: &'a [RobotId],
    /// Robots that have confirmed their stop.
    pub stopped: &'a [RobotId],
    /// What is left on robots.
    pub left: Left,
}

/// What a mission left on its robots, which another process withdraws.
#[derive(Clone, Debug, Default)]
pub struct Left {
    /// The robots that were sent anything.
    pub robots: BTreeMap<RobotId, LeftOn>,
    /// The ids by which robots call themselves, if these differ from their ids in the fleet file.
    pub own_ids: BTreeMap<RobotId, RobotId>,
    /// No lease was renewed after this instant; `None` if leases may have been renewed until now.
    pub renewed_until: Option<Timestamp<Server>>,
    /// Whether robots may have moved.
    pub moved: bool,
    /// The failures of robots.
    pub failures: Vec<Failure>,
}

/// What a mission left on a robot.
#[derive(Clone, Debug, Default)]
pub struct LeftOn {
    /// The devices that were sent anything.
    pub devices: BTreeSet<DeviceId>,
    /// The offset that was added to timestamps for its clock.
    pub shift: Span,
    /// The running leases of scripts whose acts have not ended; `None` for one that continues without a link.
    pub leases: Vec<Option<Millis>>,
}

/// The progress of an act that was promised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progressed {
    /// Its requests were sent, or were about to be.
    Prepared,
    /// All robots had accepted.
    Decided,
    /// Leases were carried over its start, or were about to be.
    Committed,
}
