//! Draws the faults and their times: some at any time, others shortly before or after the starts of acts, where they matter most.

use fastrand::Rng;
use urrcp::Span;

use super::kind::FaultKind;
use super::{Drawn, millis, one_in};
use downbeat_rehearsal::world::Direction;

/// A fault of a robot, its link, the scheduler or the disk, or a command of an operator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// A robot's process ends, and restarts after a while or never. The operating system may close its connections.
    RobotCrash {
        /// Index of the robot in the fleet.
        robot: usize,
        /// Time until the process restarts; `None`: never.
        back_after: Option<Span>,
        /// Whether the operating system informs the scheduler by closing the connections of the process.
        told: bool,
    },
    /// A robot's process stalls for a while.
    RobotPause {
        /// Index of the robot in the fleet.
        robot: usize,
        /// Duration of the fault.
        lasts: Span,
    },
    /// Another robot answers at a robot's address for a while.
    AnotherRobot {
        /// Index of the robot whose address the other robot or process takes over.
        robot: usize,
        /// Duration of the fault.
        lasts: Span,
    },
    /// Another process that uses the id of a robot answers at its address for a while. The robot continues, but is unreachable.
    Twin {
        /// Index of the robot whose address the other robot or process takes over.
        robot: usize,
        /// Duration of the fault.
        lasts: Span,
    },
    /// The hardware behind an edge (a robot that only controls separate hardware) dies.
    HardwareDies {
        /// Index of the robot in the fleet.
        robot: usize,
        /// Time until the hardware returns; `None`: never.
        back_after: Option<Span>,
        /// Whether the edge is informed because the connection to the hardware ends. Otherwise, the hardware only stops answering.
        told: bool,
    },
    /// Another session claims a robot and sends it its own script.
    ForeignSession {
        /// Index of the robot in the fleet.
        robot: usize,
        /// Time until the connection of the other session ends.
        lasts: Span,
    },
    /// An operator with the role `seize` seizes a robot from its session, and sends it a script.
    Seize {
        /// Index of the robot in the fleet.
        robot: usize,
        /// Time until the connection of that operator ends.
        lasts: Span,
    },
    /// No message passes between the scheduler and a robot for a while.
    Partition {
        /// Index of the robot in the fleet.
        robot: usize,
        /// Duration of the fault.
        lasts: Span,
        /// Whether the connection breaks at the end of the partition.
        breaks: bool,
    },
    /// No message passes between the scheduler and a robot in one direction for a while.
    OneWay {
        /// Index of the robot in the fleet.
        robot: usize,
        /// The direction in which no messages pass.
        way: Direction,
        /// Duration of the fault.
        lasts: Span,
    },
    /// Connections to a robot exist and can be established, but carry no messages. Connections that are established after `lasts` work
    /// again.
    DeadLink {
        /// Index of the robot in the fleet.
        robot: usize,
        /// Duration of the fault.
        lasts: Span,
    },
    /// For a while, each message to and from a robot takes longer by `by`.
    Lag {
        /// Index of the robot in the fleet.
        robot: usize,
        /// The additional delay of each message.
        by: Span,
        /// Duration of the fault.
        lasts: Span,
    },
    /// The robot's side of the connection is gone, but the scheduler's side remains open.
    HalfOpen {
        /// Index of the robot in the fleet.
        robot: usize,
    },
    /// The bandwidth of a link is reduced for a while.
    SlowLink {
        /// Index of the robot in the fleet.
        robot: usize,
        /// The reduced bandwidth in each direction, in bytes per second.
        bandwidth: u32,
        /// Duration of the fault.
        lasts: Span,
    },
    /// A robot's clock is set.
    ClockStep {
        /// Index of the robot in the fleet.
        robot: usize,
        /// The time that is added to the clock; negative if the clock is set back.
        by: Span,
    },
    /// The clock of the scheduler's machine is set. A running process keeps its own clock; the next process starts with the machine's new
    /// clock.
    ServerClockStep {
        /// The time that is added to the clock; negative if the clock is set back.
        by: Span,
    },
    /// The scheduler's process ends, and the mission is resumed from its journal after a while or never.
    SchedulerCrash {
        /// Time until the operator runs `resume`; `None`: never.
        resumed_after: Option<Span>,
    },
    /// The scheduler's process ends after `actions` further actions, possibly between two actions of one instant.
    SchedulerCrashAmid {
        /// The number of actions (messages, connections or records) that the process still performs.
        actions: u32,
        /// Time until the operator runs `resume`; `None`: never.
        resumed_after: Option<Span>,
    },
    /// The scheduler's process stalls for a while.
    SchedulerPause {
        /// Duration of the fault.
        lasts: Span,
    },
    /// The scheduler's process stalls after `actions` further actions. It performs the remaining actions of that instant when the stall
    /// ends.
    SchedulerPauseAmid {
        /// The number of actions (messages, connections or records) that the process still performs.
        actions: u32,
        /// Duration of the fault.
        lasts: Span,
    },
    /// The disk stalls for a while.
    DiskStalls {
        /// Duration of the fault.
        lasts: Span,
    },
    /// The operator requests a stop.
    Stop,
    /// The operator sends all robots to their default state.
    Home,
    /// An operator runs `downbeat stop` in another terminal. If the mission's process has ended, the command withdraws the mission by its
    /// journal.
    StopByJournal,
}

/// Earliest and latest time of a fault near the start of an act, in milliseconds relative to that start.
const AROUND: (i64, i64) = (-450, 200);

pub(super) fn draw_faults(rng: &mut Rng, drawn: &Drawn) -> Vec<(Span, Fault)> {
    let count = match rng.u8(0..20) {
        0..=6 => 0,
        7..=12 => 1,
        13..=16 => 2,
        _ => 3,
    };
    let starts = expected_starts(drawn);
    let mut faults = Vec::new();
    for _ in 0..count {
        let at = draw_instant(rng, drawn, &starts);
        let fault = draw_fault(rng, drawn.robots.len());
        faults.push((at, fault));
        faults.extend(draw_consequence(rng, at, fault));
    }
    faults.sort_by_key(|(at, _)| *at);
    faults
}

/// Returns the approximate start of each act, as in a mission without faults.
fn expected_starts(drawn: &Drawn) -> Vec<Span> {
    let slow = drawn.robots.iter().map(|robot| robot.slow).max().unwrap_or_default();
    let round_trip = drawn.delay.1 * 2 + slow;
    let prepares = round_trip * 10 + drawn.disk.sync * 3 + Span::from_millis(450);
    let mut starts = Vec::new();
    let mut at = prepares;
    for act in &drawn.choreography.acts {
        starts.push(at);
        at += act.plan.duration();
    }
    starts
}

fn draw_instant(rng: &mut Rng, drawn: &Drawn, starts: &[Span]) -> Span {
    if rng.bool() && !starts.is_empty() {
        let around = starts[rng.usize(0..starts.len())] + millis(rng, AROUND.0, AROUND.1);
        return around.max(Span::ZERO);
    }
    let duration: Span =
        drawn.choreography.acts.iter().fold(Span::ZERO, |sum, act| sum + act.plan.duration());
    let acts = i64::try_from(drawn.choreography.acts.len()).unwrap_or(1);
    let within = duration + Span::from_millis(800) + Span::from_millis(200) * acts;
    Span::from_nanos(rng.i64(0..=within.as_nanos()))
}

fn draw_fault(rng: &mut Rng, robots: usize) -> Fault {
    let robot = rng.usize(0..robots);
    draw_kind(rng).draw(rng, robot)
}

/// Draws a kind of fault for an ordinary mission, in proportion to its expected frequency.
fn draw_kind(rng: &mut Rng) -> FaultKind {
    match rng.u8(0..40) {
        0..=6 => FaultKind::RobotCrash,
        7..=8 => FaultKind::RobotPause,
        9 => FaultKind::AnotherRobot,
        10..=11 => FaultKind::HardwareDies,
        12 => FaultKind::ForeignSession,
        13..=17 => FaultKind::Partition,
        18..=20 => FaultKind::OneWay,
        21..=22 => FaultKind::DeadLink,
        23..=24 => FaultKind::HalfOpen,
        25 => FaultKind::SlowLink,
        26..=27 => FaultKind::ClockStep,
        28 => FaultKind::ServerClockStep,
        29..=30 => FaultKind::SchedulerCrash,
        31..=34 => FaultKind::SchedulerCrashAmid,
        35..=36 => FaultKind::SchedulerPause,
        37 => FaultKind::DiskStalls,
        38 if one_in(rng, 4) => FaultKind::Home,
        38 => FaultKind::Stop,
        _ => FaultKind::StopByJournal,
    }
}

pub(super) fn draw_resumption(rng: &mut Rng) -> Option<Span> {
    match rng.u8(0..4) {
        0 => None,
        // The process returns in time for the start, as with a supervisor.
        1 => Some(millis(rng, 1, 60)),
        _ => Some(millis(rng, 50, 2_000)),
    }
}

/// Draws the further faults, if any, that often follow the fault `fault`.
fn draw_consequence(rng: &mut Rng, at: Span, fault: Fault) -> Vec<(Span, Fault)> {
    match fault {
        // The robot restarts with a different clock.
        Fault::RobotCrash { robot, back_after: Some(after), .. } if one_in(rng, 5) => {
            vec![(at + after / 2, Fault::ClockStep { robot, by: millis(rng, -500, 500) })]
        }
        Fault::SchedulerCrash { resumed_after: Some(after) }
        | Fault::SchedulerCrashAmid { resumed_after: Some(after), .. } => match rng.u8(0..10) {
            // One operator runs `stop` at about the same time as another runs `resume`.
            0..=1 => {
                let around = (at + after + millis(rng, -30, 60)).max(Span::ZERO);
                vec![(around, Fault::StopByJournal)]
            }
            // The process that resumes the mission dies as well.
            2..=4 => {
                let later = at + after + millis(rng, 0, 600);
                let actions = rng.u32(0..40);
                vec![(later, Fault::SchedulerCrashAmid { actions, resumed_after: draw_resumption(rng) })]
            }
            5 => vec![(at + after / 2, Fault::ServerClockStep { by: millis(rng, -60, 60) })],
            _ => Vec::new(),
        },
        _ => Vec::new(),
    }
}
