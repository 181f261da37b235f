//! What went wrong, when, for how long, and what it concerns: a robot's own link, process or clock, the scheduler, or only the
//! operator's stop. An excuse has to be one of these, of the robot that is excused.

use std::fmt;

use urrcp::{Server, Span, Timestamp};

use crate::{Fault, Happened, Ran};

/// Why something was excused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Cause {
    /// The robot's own process ended.
    RobotCrash,
    /// The robot's own process stood still.
    RobotPause,
    /// The robot's own clock was set.
    ClockSet,
    /// Another robot answered at the robot's own address, or another session asked for it.
    Stranger,
    /// The robot's own hardware died.
    Hardware,
    /// Nothing passed on the robot's own link, at least one way, or next to nothing.
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
    /// The scheduler's disk stood still between the commitment and the last start.
    Disk,
    /// A stop was sent after the point of no return.
    LateStop,
}

impl Cause {
    /// All of them, in the order in which one is chosen where several apply.
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

    /// The largest share of acts in which this cause may excuse a violation of an invariant: about a quarter more than in a million
    /// seeds. A larger share means that an excuse has become wider, or that missions react to this fault in another way.
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
            Self::Stranger => "another robot at its address, or session",
            Self::Hardware => "its hardware died",
            Self::Partition => "its link carried nothing, or one way",
            Self::LinkDown => "its link was down",
            Self::Slow => "its link was slow",
            Self::Lost => "its link lost a message",
            Self::SchedulerCrash => "the scheduler ended",
            Self::SchedulerPause => "the scheduler stood still",
            Self::Disk => "the scheduler's disk stood still",
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
    /// By how much a clock was set.
    pub(super) by: Span,
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
    let mut hits = Hits { all: Vec::new(), open: Vec::new() };
    for (at, happened) in &ran.history {
        let hit = |cause, robot, lasts| Hit { cause, robot, from: *at, until: *at + lasts, by: Span::ZERO };
        match happened {
            Happened::Lost(robot) => hits.all.push(hit(Cause::Lost, Some(*robot), Span::ZERO)),
            Happened::Slow(robot, lasts) => hits.all.push(hit(Cause::Slow, Some(*robot), *lasts)),
            Happened::Fault(Fault::ClockStep { robot, by }) => {
                hits.all.push(Hit { by: *by, ..hit(Cause::ClockSet, Some(*robot), Span::ZERO) });
            }
            // It is not known what is left of the connections of a machine that is gone.
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

/// What went wrong so far, and what of it continues.
struct Hits {
    all: Vec<Hit>,
    /// What ends what continues, and where it stands.
    open: Vec<(End, usize)>,
}

/// What ends something that continues.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    /// Something is heard of the robot again.
    Heard,
    /// A connection with it stands that was made from then on.
    Linked(Timestamp<Server>),
    /// It is back.
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

/// What a fault affects, and for how long; `None` if it is the fault of no party.
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
        // Each message that it delays is counted.
        Fault::Lag { .. } => return None,
        // The next process alone has that clock, and its promises are counted by it.
        Fault::ServerClockStep { .. } | Fault::Stop | Fault::Home | Fault::StopByJournal => return None,
        // Taken above, with what else there is to them.
        Fault::ClockStep { .. } | Fault::DeadLink { .. } | Fault::HalfOpen { .. } => return None,
    })
}
