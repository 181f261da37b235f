//! Missions under faults, in virtual time, with the same mission machine and the same robot machines as a real show. The network
//! loses, duplicates, delays and reorders messages, and breaks into partitions. Processes die or stall, clocks are off, drift and
//! are set, and robots lie. Everything follows from a seed, so each violation can be reproduced and read as a trace.

pub mod baseline;
pub mod braking;
mod check;
mod draw;
mod shrink;
mod stage;
mod trace;
pub mod trajectory;
mod world;

use downbeat_robot::set_log::LogEntry;
use urrcp::{Message, Server, Span, Timestamp};

use braking::Braking;

pub use check::{ActStarts, Cause, Excuse, Situation, Starts, Verdict, Violation};
use downbeat_mission::report::Report;
use downbeat_mission::{Progress, Record};
pub use downbeat_rehearsal::world::Direction;
pub use draw::{
    Connections, Drawn, DrawnDisk, DrawnRobot, Fault, FaultKind, Hands, Lie, Names, Network, draw,
};
pub use shrink::{Shrunk, shrunk};
pub use stage::{Stage, faults_met};
pub use trace::trace;

/// What happened to a seed.
#[derive(Debug)]
pub struct Ran {
    /// What the seed stood for.
    pub drawn: Drawn,
    /// The report of the process that ended the mission, if one did.
    pub report: Option<Report>,
    /// What was written down, and when.
    pub records: Vec<(Timestamp<Server>, Record)>,
    /// What each robot really set.
    pub logs: Vec<Vec<LogEntry>>,
    /// How its devices came to rest, as far as that takes time.
    pub brakings: Vec<Vec<Braking>>,
    /// What other robots did that answered at the addresses of these.
    pub logs_of_strangers: Vec<Vec<LogEntry>>,
    /// For each robot the scripts that it began although its hardware had been dead for so long that it had to know.
    pub starts_of_dead: Vec<Vec<String>>,
    /// The clock of the last process minus the true time: times in the report are by that clock, all others are true.
    pub server_ahead: Span,
    /// Everything that happened, for the trace and for the checks.
    pub history: Vec<(Timestamp<Server>, Happened)>,
    /// Until when the robots were watched.
    pub watched_until: Timestamp<Server>,
    /// The mission never came to an end.
    pub hung: bool,
    /// The statement about the mission that did not hold, if any.
    pub broken: Option<String>,
}

/// A line of a trace.
#[derive(Clone, Debug)]
pub enum Happened {
    /// A message was sent to a robot.
    ToRobot(usize, Message),
    /// A message from the scheduler arrived at a robot.
    AtRobot(usize, Message),
    /// The scheduler took a message from a robot, which is kept only for a trace.
    FromRobot(usize, Option<Message>),
    /// A message was lost on the way to or from a robot.
    Lost(usize),
    /// A message to or from a robot travelled for this long.
    Slow(usize, Span),
    /// A message to or from a robot waited for this long behind others, on a link as it usually is.
    Queued(usize, Span),
    /// A stop waits for this long behind what was sent to a robot before it, on a link as it usually is.
    StopQueued(usize, Span),
    /// Something went wrong.
    Fault(Fault),
    /// A robot is back.
    Back(usize),
    /// A robot belongs to an operator who has seized it.
    Seized(usize),
    /// A link stands.
    LinkUp(usize),
    /// A link is down, as the scheduler sees it.
    LinkDown(usize),
    /// The mission was resumed by its journal.
    TakenUp(&'static str),
    /// So many bytes of records were on the disk and are not read again.
    Forgotten(usize),
    /// The operator was told.
    Told(Box<Progress>),
    /// The mission will never end, and this is what it waits for.
    Stuck(String),
}

/// Plays a seed to its end and watches what the robots still do.
#[must_use]
pub fn run(seed: u64) -> Ran {
    world::play(draw(seed), false)
}

/// Plays what was drawn.
#[must_use]
pub fn play(drawn: Drawn) -> Ran {
    world::play(drawn, false)
}

/// The same, keeping every message.
#[must_use]
pub fn play_verbosely(drawn: Drawn) -> Ran {
    world::play(drawn, true)
}

/// Everything that is held against a mission, the comparison with the same mission without its faults included, which is played
/// as well, as far as that could find anything.
#[must_use]
pub fn judge(ran: &Ran) -> Verdict {
    let mut verdict = ran.verdict();
    let sent = ran.records.iter().any(|(_, record)| matches!(record, Record::Prepared(_)));
    if sent
        && ran.broken.is_none()
        && !ran.drawn.faults.is_empty()
        && !ran.hung
        && let Some(last) = ran.last_to_compare()
    {
        let undisturbed = world::play_up_to(ran.drawn.clone().without_faults(), last);
        verdict.violations.extend(ran.compared_with(&undisturbed).violations);
    }
    verdict
}

/// The same as [`run`], keeping every message.
#[must_use]
pub fn run_verbosely(seed: u64) -> Ran {
    world::play(draw(seed), true)
}

#[cfg(test)]
mod tests;
