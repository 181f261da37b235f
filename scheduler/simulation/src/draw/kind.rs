//! The kinds of faults. Draws a fault of a given kind.

use std::fmt;

use fastrand::Rng;

use super::faults::draw_resumption;
use super::{Fault, millis, one_in};
use downbeat_rehearsal::world::Direction;

/// A kind of fault, without details such as the affected robot and the duration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[expect(missing_docs, reason = "each is the fault of the same name")]
pub enum FaultKind {
    RobotCrash,
    RobotPause,
    AnotherRobot,
    Twin,
    HardwareDies,
    ForeignSession,
    Seize,
    Partition,
    OneWay,
    DeadLink,
    HalfOpen,
    SlowLink,
    Lag,
    ClockStep,
    ServerClockStep,
    SchedulerCrash,
    SchedulerCrashAmid,
    SchedulerPause,
    SchedulerPauseAmid,
    DiskStalls,
    Stop,
    Home,
    StopByJournal,
}

impl FaultKind {
    /// All kinds of faults.
    pub const ALL: [Self; 23] = [
        Self::RobotCrash,
        Self::RobotPause,
        Self::AnotherRobot,
        Self::Twin,
        Self::HardwareDies,
        Self::ForeignSession,
        Self::Seize,
        Self::Partition,
        Self::OneWay,
        Self::DeadLink,
        Self::HalfOpen,
        Self::SlowLink,
        Self::Lag,
        Self::ClockStep,
        Self::ServerClockStep,
        Self::SchedulerCrash,
        Self::SchedulerCrashAmid,
        Self::SchedulerPause,
        Self::SchedulerPauseAmid,
        Self::DiskStalls,
        Self::Stop,
        Self::Home,
        Self::StopByJournal,
    ];

    /// Draws a fault of this kind. `robot` is the affected robot, if the kind affects one.
    pub(super) fn draw(self, rng: &mut Rng, robot: usize) -> Fault {
        match self {
            Self::RobotCrash => {
                let back_after = (!one_in(rng, 3)).then(|| millis(rng, 20, 1_500));
                Fault::RobotCrash { robot, back_after, told: !one_in(rng, 3) }
            }
            Self::RobotPause => {
                // Some pauses are short enough to delay a start without preventing it.
                let longest = if rng.bool() { 70 } else { 1_500 };
                Fault::RobotPause { robot, lasts: millis(rng, 1, longest) }
            }
            Self::AnotherRobot => Fault::AnotherRobot { robot, lasts: millis(rng, 100, 2_000) },
            Self::Twin => Fault::Twin { robot, lasts: millis(rng, 100, 3_000) },
            Self::HardwareDies => {
                let back_after = rng.bool().then(|| millis(rng, 20, 1_500));
                Fault::HardwareDies { robot, back_after, told: rng.bool() }
            }
            Self::ForeignSession => Fault::ForeignSession { robot, lasts: millis(rng, 50, 3_000) },
            Self::Seize => Fault::Seize { robot, lasts: millis(rng, 50, 3_000) },
            Self::Partition | Self::OneWay | Self::DeadLink | Self::HalfOpen | Self::SlowLink | Self::Lag => {
                self.draw_of_link(rng, robot)
            }
            Self::ClockStep => {
                let by = if rng.bool() { millis(rng, -3_000, 3_000) } else { millis(rng, -40, 40) };
                Fault::ClockStep { robot, by }
            }
            Self::ServerClockStep => {
                let by = if rng.bool() { millis(rng, -3_000, 3_000) } else { millis(rng, -20, 20) };
                Fault::ServerClockStep { by }
            }
            Self::SchedulerCrash => Fault::SchedulerCrash { resumed_after: draw_resumption(rng) },
            Self::SchedulerCrashAmid => {
                let most = if rng.bool() { 16 } else { 200 };
                let actions = rng.u32(0..most);
                Fault::SchedulerCrashAmid { actions, resumed_after: draw_resumption(rng) }
            }
            Self::SchedulerPause => Fault::SchedulerPause { lasts: millis(rng, 1, 1_500) },
            Self::SchedulerPauseAmid => {
                Fault::SchedulerPauseAmid { actions: rng.u32(0..16), lasts: millis(rng, 1, 500) }
            }
            Self::DiskStalls => Fault::DiskStalls { lasts: millis(rng, 20, 3_000) },
            Self::Stop => Fault::Stop,
            Self::Home => Fault::Home,
            Self::StopByJournal => Fault::StopByJournal,
        }
    }

    fn draw_of_link(self, rng: &mut Rng, robot: usize) -> Fault {
        match self {
            Self::OneWay => {
                let way = if rng.bool() { Direction::ToRobot } else { Direction::FromRobot };
                Fault::OneWay { robot, way, lasts: millis(rng, 1, 3_000) }
            }
            Self::DeadLink => Fault::DeadLink { robot, lasts: millis(rng, 100, 3_000) },
            Self::HalfOpen => Fault::HalfOpen { robot },
            Self::SlowLink => {
                let bandwidth = rng.u32(2_000..=60_000);
                Fault::SlowLink { robot, bandwidth, lasts: millis(rng, 50, 1_500) }
            }
            Self::Lag => Fault::Lag { robot, by: millis(rng, 20, 450), lasts: millis(rng, 50, 3_000) },
            _ => Fault::Partition { robot, lasts: millis(rng, 1, 3_000), breaks: rng.bool() },
        }
    }
}

impl From<&Fault> for FaultKind {
    fn from(fault: &Fault) -> Self {
        match fault {
            Fault::RobotCrash { .. } => Self::RobotCrash,
            Fault::RobotPause { .. } => Self::RobotPause,
            Fault::AnotherRobot { .. } => Self::AnotherRobot,
            Fault::Twin { .. } => Self::Twin,
            Fault::HardwareDies { .. } => Self::HardwareDies,
            Fault::ForeignSession { .. } => Self::ForeignSession,
            Fault::Seize { .. } => Self::Seize,
            Fault::Partition { .. } => Self::Partition,
            Fault::OneWay { .. } => Self::OneWay,
            Fault::DeadLink { .. } => Self::DeadLink,
            Fault::HalfOpen { .. } => Self::HalfOpen,
            Fault::SlowLink { .. } => Self::SlowLink,
            Fault::Lag { .. } => Self::Lag,
            Fault::ClockStep { .. } => Self::ClockStep,
            Fault::ServerClockStep { .. } => Self::ServerClockStep,
            Fault::SchedulerCrash { .. } => Self::SchedulerCrash,
            Fault::SchedulerCrashAmid { .. } => Self::SchedulerCrashAmid,
            Fault::SchedulerPause { .. } => Self::SchedulerPause,
            Fault::SchedulerPauseAmid { .. } => Self::SchedulerPauseAmid,
            Fault::DiskStalls { .. } => Self::DiskStalls,
            Fault::Stop => Self::Stop,
            Fault::Home => Self::Home,
            Fault::StopByJournal => Self::StopByJournal,
        }
    }
}

impl fmt::Display for FaultKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::RobotCrash => "robot's process ends",
            Self::RobotPause => "robot's process stalls",
            Self::AnotherRobot => "another robot answers",
            Self::Twin => "a twin answers",
            Self::HardwareDies => "hardware dies",
            Self::ForeignSession => "another session",
            Self::Seize => "a robot is seized",
            Self::Partition => "partition",
            Self::OneWay => "one-way partition",
            Self::DeadLink => "dead connection",
            Self::HalfOpen => "half-open connection",
            Self::SlowLink => "little bandwidth",
            Self::Lag => "long delays",
            Self::ClockStep => "robot's clock is set",
            Self::ServerClockStep => "host's clock is set",
            Self::SchedulerCrash => "scheduler ends",
            Self::SchedulerCrashAmid => "scheduler ends mid-act",
            Self::SchedulerPause => "scheduler stalls",
            Self::SchedulerPauseAmid => "scheduler stalls mid-act",
            Self::DiskStalls => "disk stalls",
            Self::Stop => "stop",
            Self::Home => "stop with home",
            Self::StopByJournal => "stop via journal",
        })
    }
}
