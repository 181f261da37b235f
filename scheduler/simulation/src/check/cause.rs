//! Collects the faults of a run. Each has an interval, and affects a robot's own link, process or clock, or the scheduler. Every excuse
//! must be such a fault or an operator's stop. A robot is excused only by its own faults or by those of the scheduler.

use std::fmt;

use urrcp::{Server, Span, Timestamp};

use crate::{Fault, Happened, Ran};

/// The cause that excuses a violation of an invariant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Cause {
    /// The robot's own process ended.
    RobotCrash,
    /// The robot's own process stalled.
    RobotPause,
    /// The robot's own clock was set.
    ClockSet,
    /// Another robot answered at the robot's own address, or another session took over the robot.
    Stranger,
    /// The robot's own hardware died.
    Hardware,
    /// The robot's own link carried no messages, or hardly any, in at least one direction.
    Partition,
    /// The robot's own link was down, or being re-established.
    LinkDown,
    /// A message on the robot's own link took longer than the maximum.
    Slow,
    /// A message on the robot's own link was lost.
    Lost,
    /// The scheduler's process ended between the commitment and the last start.
    SchedulerCrash,
    /// The scheduler's process stalled between the commitment and the last start.
    SchedulerPause,
    /// The scheduler's disk stalled between the commitment and the last start.
    Disk,
    /// A stop was sent after the point of no return.
    LateStop,
}

impl Cause {
    /// All causes, in order of precedence. If several apply, the first one is reported.
    pub const ALL: [Self; 13] = [
        Self::RobotCrash,
        Self::RobotPause,
        Self::ClockSet,
        Self::Stranger,
        Self::Hardware,
        Self::Partition,
        Self::LinkDown,
        Self::Slow,
        Self::Lost,
        Self::SchedulerCrash,
        Self::SchedulerPause,
        Self::Disk,
        Self::LateStop,
    ];

    /// Returns the largest permitted share of acts in which this cause excuses a violation of an invariant. It is about a quarter more
    /// than observed in a million seeds. A larger share means that the excuse has become broader, or that missions react differently to
    /// the fault.
    #[must_use]
    pub const fn largest_share(self, invariant: char) -> f64 {
        let of_100_000 = match (invariant, self) {
            ('a', Self::RobotCrash) => 560.0,
            ('a', Self::RobotPause) => 160.0,
            ('a', Self::ClockSet) => 50.0,
            ('a', Self::Stranger) => 40.0,
            ('a', Self::Hardware) => 20.0,
            ('a', Self::Partition) => 540.0,
            ('a', Self::LinkDown) => 3.0,
            ('a', Self::Slow) => 90.0,
            ('a', Self::Lost) => 20.0,
            ('a', Self::SchedulerCrash) => 230.0,
            ('a', Self::SchedulerPause) => 90.0,
            ('a', Self::Disk) => 1.0,
            ('a', Self::LateStop) => 80.0,
            ('f', Self::ClockSet) => 1_500.0,
            ('f', Self::RobotPause) => 60.0,
            _ => 0.0,
        };
        of_100_000 / 100_000.0
    }

    /// Whether the cause concerns the robot's link.
    pub(super) const fn is_of_link(self) -> bool {
        matches!(self, Self::Partition | Self::LinkDown | Self::Slow | Self::Lost)
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::RobotCrash => "its process ended",
            Self::RobotPause => "its process stalled",
            Self::ClockSet => "its clock was set",
            Self::Stranger => "another robot at its address, or another session",
            Self::Hardware => "its hardware failed",
            Self::Partition => "its link was partitioned, fully or in one direction",
            Self::LinkDown => "its link was down",
            Self::Slow => "its link was slow",
            Self::Lost => "its link lost a message",
            Self::SchedulerCrash => "the scheduler ended",
            Self::SchedulerPause => "the scheduler stalled",
            Self::Disk => "the scheduler's disk stalled",
            Self::LateStop => "stop after the point of no return",
        })
    }
}

/// A fault with the interval in which it has effect.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    pub(super) cause: Cause,
    /// The index of the affected robot. `None`: the fault affects the scheduler.
    pub(super) robot: Option<usize>,
    pub(super) from: Timestamp<Server>,
    /// End of the fault.
    pub(super) until: Timestamp<Server>,
    /// The amount by which the fault set a clock.
    pub(super) by: Span,
}

impl Hit {
    pub(super) fn is_of(&self, robot: usize) -> bool {
        self.robot == Some(robot)
    }

    /// Whether the fault overlaps the interval between two instants, both included.
    pub(super) fn overlaps(&self, from: Timestamp<Server>, until: Timestamp<Server>) -> bool {
        self.from <= until && self.until >= from
    }
}

/// Collects all faults of a run.
pub(super) fn hits_of(ran: &Ran) -> Vec<Hit> {
    let mut hits = Hits { all: Vec::new(), open: Vec::new() };
    for (at, happened) in &ran.history {
        let hit = |cause, robot, lasts| Hit { cause, robot, from: *at, until: *at + lasts, by: Span::ZERO };
        match happened {
            Happened::Lost(robot) => hits.all.push(hit(Cause::Lost, Some(*robot), Span::ZERO)),
            Happened::Slow(robot, lasts) => hits.all.push(hit(Cause::Slow, Some(*robot), *lasts)),
            Happened::Fault(Fault::ClockStep { robot, by }) => {
                hits.all.push(Hit { by: *by, ..hit(Cause::ClockSet, Some(*robot), Span::ZERO) });
            }
            // If a machine is gone, the state of its connections is unknown.
            Happened::Fault(Fault::RobotCrash { robot, told: false, .. }) => {
                hits.begin(hit(Cause::RobotCrash, Some(*robot), Span::ZERO), End::Back);
                hits.begin(hit(Cause::Partition, Some(*robot), Span::ZERO), End::Linked(*at));
            }
            Happened::Fault(Fault::DeadLink { robot, lasts }) => {
                hits.begin(hit(Cause::Partition, Some(*robot), Span::ZERO), End::Linked(*at + *lasts));
            }
            Happened::Fault(Fault::HalfOpen { robot }) => {
                hits.begin(hit(Cause::Partition, Some(*robot), Span::ZERO), End::Linked(*at));
            }
            Happened::Fault(fault) => match of_fault(fault) {
                Some((cause, robot, Lasts::For(lasts))) => hits.all.push(hit(cause, robot, lasts)),
                Some((cause, robot, Lasts::Until(end))) => hits.begin(hit(cause, robot, Span::ZERO), end),
                None => {}
            },
            Happened::LinkDown(robot) => {
                hits.begin(hit(Cause::LinkDown, Some(*robot), Span::ZERO), End::Heard)
            }
            Happened::FromRobot(robot, _) => hits.end(*at, Some(*robot), End::Heard),
            Happened::Back(robot) => hits.end(*at, Some(*robot), End::Back),
            Happened::LinkUp(robot) => hits.end(*at, Some(*robot), End::Linked(*at)),
            Happened::TakenUp(_) => hits.end(*at, None, End::Back),
            _ => {}
        }
    }
    hits.all
}

/// The faults collected so far, and those among them that have not ended.
struct Hits {
    all: Vec<Hit>,
    /// The end condition of each fault that has not ended, with the index of the fault in `all`.
    open: Vec<(End, usize)>,
}

/// The condition under which a fault ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    /// The fault ends with the next message from the robot.
    Heard,
    /// The fault ends when a connection is established, if the attempt began at or after this instant.
    Linked(Timestamp<Server>),
    /// The fault ends when the robot returns.
    Back,
}

enum Lasts {
    For(Span),
    Until(End),
}

impl Hits {
    fn begin(&mut self, hit: Hit, end: End) {
        let goes_on = |(open, index): &(End, usize)| {
            *open == end && self.all[*index].robot == hit.robot && self.all[*index].cause == hit.cause
        };
        if !self.open.iter().any(goes_on) {
            self.open.push((end, self.all.len()));
            self.all.push(Hit { until: Timestamp::from_nanos(i64::MAX), ..hit });
        }
    }

    fn end(&mut self, at: Timestamp<Server>, robot: Option<usize>, end: End) {
        let all = &mut self.all;
        self.open.retain(|(open, index)| {
            let same = match (*open, end) {
                (End::Linked(from), End::Linked(at)) => at > from,
                (open, end) => open == end,
            };
            let ends = same && all[*index].robot == robot;
            if ends {
                all[*index].until = at;
            }
            !ends
        });
    }
}

/// The cause, the affected robot and the duration of a fault; `None` if the fault excuses nothing.
const fn of_fault(fault: &Fault) -> Option<(Cause, Option<usize>, Lasts)> {
    Some(match *fault {
        Fault::RobotCrash { robot, .. } => (Cause::RobotCrash, Some(robot), Lasts::Until(End::Back)),
        Fault::AnotherRobot { robot, .. } | Fault::Twin { robot, .. } => {
            (Cause::Stranger, Some(robot), Lasts::Until(End::Back))
        }
        Fault::RobotPause { robot, lasts } => (Cause::RobotPause, Some(robot), Lasts::For(lasts)),
        Fault::ForeignSession { robot, lasts } | Fault::Seize { robot, lasts } => {
            (Cause::Stranger, Some(robot), Lasts::For(lasts))
        }
        Fault::HardwareDies { robot, .. } => (Cause::Hardware, Some(robot), Lasts::Until(End::Back)),
        Fault::Partition { robot, lasts, .. }
        | Fault::OneWay { robot, lasts, .. }
        | Fault::SlowLink { robot, lasts, .. } => (Cause::Partition, Some(robot), Lasts::For(lasts)),
        Fault::SchedulerCrash { .. } | Fault::SchedulerCrashAmid { .. } => {
            (Cause::SchedulerCrash, None, Lasts::Until(End::Back))
        }
        Fault::SchedulerPause { lasts } | Fault::SchedulerPauseAmid { lasts, .. } => {
            (Cause::SchedulerPause, None, Lasts::For(lasts))
        }
        Fault::DiskStalls { lasts } => (Cause::Disk, None, Lasts::For(lasts)),
        // Each delayed message is counted instead.
        Fault::Lag { .. } => return None,
        // Only the next process uses the clock after the change, and its promises are measured by that clock.
        Fault::ServerClockStep { .. } | Fault::Stop | Fault::Home | Fault::StopByJournal => return None,
        // Handled above, with their additional effects.
        Fault::ClockStep { .. } | Fault::DeadLink { .. } | Fault::HalfOpen { .. } => return None,
    })
}
