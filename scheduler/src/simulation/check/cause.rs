//! What went wrong, when, for how long, and to whom: a robot's own link, process or clock, the scheduler, or nobody's fault but
//! the operator's stop. An excuse has to be one of these, of the robot that is excused.

use std::fmt;

use urrcp::{Server, Span, Timestamp};

use crate::simulation::{Fault, Happened, Ran};

/// Why something was excused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Cause {
    /// The robot's own process ended.
    RobotCrash,
    /// The robot's own process stood still.
    RobotPause,
    /// The robot's own clock was set.
    ClockSet,
    /// Nothing passed on the robot's own link.
    Partition,
    /// The robot's own link was down, or being made again.
    LinkDown,
    /// A message on the robot's own link took longer than any should.
    Slow,
    /// A message on the robot's own link was lost.
    Lost,
    /// The scheduler's process ended between the commitment and the last start.
    SchedulerCrash,
    /// The scheduler's process stood still between the commitment and the last start.
    SchedulerPause,
    /// A stop was sent after the point of no return.
    LateStop,
}

impl Cause {
    /// All of them, in the order in which one is chosen where several apply.
    pub const ALL: [Self; 10] = [
        Self::RobotCrash,
        Self::RobotPause,
        Self::ClockSet,
        Self::Partition,
        Self::LinkDown,
        Self::Slow,
        Self::Lost,
        Self::SchedulerCrash,
        Self::SchedulerPause,
        Self::LateStop,
    ];

    /// Of the robot's link.
    pub(super) const fn is_of_link(self) -> bool {
        matches!(self, Self::Partition | Self::LinkDown | Self::Slow | Self::Lost)
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::RobotCrash => "its process ended",
            Self::RobotPause => "its process stood still",
            Self::ClockSet => "its clock was set",
            Self::Partition => "its link carried nothing",
            Self::LinkDown => "its link was down",
            Self::Slow => "its link was slow",
            Self::Lost => "its link lost a message",
            Self::SchedulerCrash => "the scheduler ended",
            Self::SchedulerPause => "the scheduler stood still",
            Self::LateStop => "stop after the point of no return",
        })
    }
}

/// Something that went wrong.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    pub(super) cause: Cause,
    /// To which robot; `None`: to the scheduler.
    pub(super) robot: Option<usize>,
    pub(super) from: Timestamp<Server>,
    /// Until when it lasted.
    pub(super) until: Timestamp<Server>,
}

impl Hit {
    pub(super) fn is_of(&self, robot: usize) -> bool {
        self.robot == Some(robot)
    }

    /// It lasts into the time between two instants, both included.
    pub(super) fn overlaps(&self, from: Timestamp<Server>, until: Timestamp<Server>) -> bool {
        self.from <= until && self.until >= from
    }
}

/// Everything that went wrong in a run.
pub(super) fn hits_of(ran: &Ran) -> Vec<Hit> {
    let mut hits: Vec<Hit> = Vec::new();
    // Where the link of a robot that is down stands in `hits`.
    let mut down: Vec<Option<usize>> = vec![None; ran.drawn.robots.len()];
    for (at, happened) in &ran.history {
        let hit = |cause, robot, lasts| Hit { cause, robot, from: *at, until: *at + lasts };
        match happened {
            Happened::Lost(robot) => hits.push(hit(Cause::Lost, Some(*robot), Span::ZERO)),
            Happened::Slow(robot, lasts) => hits.push(hit(Cause::Slow, Some(*robot), *lasts)),
            Happened::Fault(fault) => {
                hits.extend(of_fault(fault).map(|(cause, robot, lasts)| hit(cause, robot, lasts)));
            }
            Happened::LinkDown(robot) => {
                let index = *down[*robot].get_or_insert(hits.len());
                if index == hits.len() {
                    hits.push(Hit {
                        cause: Cause::LinkDown,
                        robot: Some(*robot),
                        from: *at,
                        until: Timestamp::from_nanos(i64::MAX),
                    });
                }
            }
            // It stands again once something is heard on it.
            Happened::FromRobot(robot, _) => {
                if let Some(index) = down[*robot].take() {
                    hits[index].until = *at;
                }
            }
            _ => {}
        }
    }
    hits
}

/// What a fault does to whom, and for how long; `None` where it is nobody's fault.
const fn of_fault(fault: &Fault) -> Option<(Cause, Option<usize>, Span)> {
    Some(match *fault {
        Fault::RobotCrash { robot, .. } => (Cause::RobotCrash, Some(robot), Span::ZERO),
        Fault::RobotPause { robot, lasts } => (Cause::RobotPause, Some(robot), lasts),
        Fault::Partition { robot, lasts, .. } => (Cause::Partition, Some(robot), lasts),
        Fault::ClockStep { robot, .. } => (Cause::ClockSet, Some(robot), Span::ZERO),
        Fault::SchedulerCrash { .. } => (Cause::SchedulerCrash, None, Span::ZERO),
        Fault::SchedulerPause { lasts } => (Cause::SchedulerPause, None, lasts),
        Fault::Stop => return None,
    })
}
