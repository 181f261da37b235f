//! What goes wrong, and when: a part of it anywhere, a part around the starts, where it matters most.

use fastrand::Rng;
use urrcp::Span;

use super::kind::FaultKind;
use super::{Drawn, millis, one_in};
use downbeat_rehearsal::world::Direction;

/// Something that goes wrong at an instant, counted from the beginning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// A robot's process ends, and starts again after a while or never. Its system may close its connections.
    RobotCrash {
        /// Index of the robot in the fleet.
        robot: usize,
        /// After how long it is back.
        back_after: Option<Span>,
        /// Its connections are closed by its system.
        told: bool,
    },
    /// A robot's process stands still for a while.
    RobotPause {
        /// Index of the robot in the fleet.
        robot: usize,
        /// For how long.
        lasts: Span,
    },
    /// Another robot answers at a robot's address for a while.
    AnotherRobot {
        /// Index of the robot whose address it takes over.
        robot: usize,
        /// For how long.
        lasts: Span,
    },
    /// Another process that uses the id of a robot answers at its address for a while. The robot continues, out of reach.
    Twin {
        /// Index of the robot whose address it takes over.
        robot: usize,
        /// For how long.
        lasts: Span,
    },
    /// The hardware behind an edge dies.
    HardwareDies {
        /// Index of the robot in the fleet.
        robot: usize,
        /// After how long it is back.
        back_after: Option<Span>,
        /// Whether its connection ends at once; otherwise it only stops to answer.
        told: bool,
    },
    /// Another session claims a robot and sends it its own script.
    ForeignSession {
        /// Index of the robot in the fleet.
        robot: usize,
        /// Until its connection ends.
        lasts: Span,
    },
    /// An operator with the role takes a robot from the session to which it belongs, and sends it a script.
    Seize {
        /// Index of the robot in the fleet.
        robot: usize,
        /// Until the connection of that operator ends.
        lasts: Span,
    },
    /// Nothing passes between the scheduler and a robot for a while.
    Partition {
        /// Index of the robot in the fleet.
        robot: usize,
        /// For how long.
        lasts: Span,
        /// The connection is found broken at its end.
        breaks: bool,
    },
    /// Nothing passes one way for a while.
    OneWay {
        /// Which robot's link.
        robot: usize,
        /// Which way.
        way: Direction,
        /// For how long.
        lasts: Span,
    },
    /// Connections stand and can be made, and carry nothing any more; those that are made after a while do again.
    DeadLink {
        /// Index of the robot in the fleet.
        robot: usize,
        /// For how long.
        lasts: Span,
    },
    /// Each message takes this much longer, either way, for a while.
    Lag {
        /// Index of the robot in the fleet.
        robot: usize,
        /// The additional delay of each message.
        by: Span,
        /// For how long.
        lasts: Span,
    },
    /// The robot's side of the connection is gone, and the scheduler's side does not know.
    HalfOpen {
        /// Index of the robot in the fleet.
        robot: usize,
    },
    /// A link carries little for a while.
    SlowLink {
        /// Index of the robot in the fleet.
        robot: usize,
        /// Bytes a second, each way.
        bandwidth: u32,
        /// For how long.
        lasts: Span,
    },
    /// A robot's clock is set.
    ClockStep {
        /// Index of the robot in the fleet.
        robot: usize,
        /// By how much.
        by: Span,
    },
    /// The clock of the scheduler's machine is set. A process keeps its own clock; the next one begins with this one.
    ServerClockStep {
        /// By how much.
        by: Span,
    },
    /// The scheduler's process ends, and is resumed by its journal after a while or never.
    SchedulerCrash {
        /// After how long the operator says `resume`.
        resumed_after: Option<Span>,
    },
    /// The scheduler's process ends while it acts: after this many more actions.
    SchedulerCrashAmid {
        /// The number of actions: messages, connections, records.
        actions: u32,
        /// After how long the operator says `resume`.
        resumed_after: Option<Span>,
    },
    /// The scheduler's process stands still for a while.
    SchedulerPause {
        /// For how long.
        lasts: Span,
    },
    /// The scheduler's process stalls after this many more actions. It performs the remaining actions of that instant
    /// when it continues.
    SchedulerPauseAmid {
        /// The number of actions: messages, connections, records.
        actions: u32,
        /// For how long.
        lasts: Span,
    },
    /// The disk does nothing for a while.
    DiskStalls {
        /// For how long.
        lasts: Span,
    },
    /// The operator says stop.
    Stop,
    /// The operator says that all robots go to their default state.
    Home,
    /// `downbeat stop` is called in another terminal: a mission that is cut off is withdrawn by its journal.
    StopByJournal,
}

/// Earliest and latest distance from a start at which faults around it happen.
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

/// About when each act starts if nothing goes wrong.
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

/// The kinds of ordinary missions, each in proportion to its expected frequency.
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
        // As by a supervisor: in time for the start.
        1 => Some(millis(rng, 1, 60)),
        _ => Some(millis(rng, 50, 2_000)),
    }
}

/// What often comes with a fault.
fn draw_consequence(rng: &mut Rng, at: Span, fault: Fault) -> Vec<(Span, Fault)> {
    match fault {
        // It comes back with another clock.
        Fault::RobotCrash { robot, back_after: Some(after), .. } if one_in(rng, 5) => {
            vec![(at + after / 2, Fault::ClockStep { robot, by: millis(rng, -500, 500) })]
        }
        Fault::SchedulerCrash { resumed_after: Some(after) }
        | Fault::SchedulerCrashAmid { resumed_after: Some(after), .. } => match rng.u8(0..10) {
            // One operator says stop at about the same time as another says resume.
            0..=1 => {
                let around = (at + after + millis(rng, -30, 60)).max(Span::ZERO);
                vec![(around, Fault::StopByJournal)]
            }
            // The process that takes it up dies as well.
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
