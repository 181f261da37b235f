//! Plays missions with faults in virtual time, with the same mission machine and robot machines as a real show. The network loses,
//! duplicates, delays and reorders messages, and breaks into partitions. Processes die or stall, clocks are off, drift and are set, and
//! robots lie. Everything follows from a seed, so each violation can be reproduced and read as a trace.

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

/// The result of playing the mission of a seed.
#[derive(Debug)]
pub struct Ran {
    /// The mission drawn from the seed.
    pub drawn: Drawn,
    /// The report of the process that ended the mission; `None` if no process ended it.
    pub report: Option<Report>,
    /// The records in the journal, with their times.
    pub records: Vec<(Timestamp<Server>, Record)>,
    /// For each robot: the log of the values that it really set on its devices.
    pub logs: Vec<Vec<LogEntry>>,
    /// For each robot: how its devices came to rest, if that took time.
    pub brakings: Vec<Vec<Braking>>,
    /// For each robot: the log of other robots that answered at its address.
    pub logs_of_strangers: Vec<Vec<LogEntry>>,
    /// For each robot: the scripts that it began, although its hardware had been dead for long enough to notice.
    pub starts_of_dead: Vec<Vec<String>>,
    /// By how much the clock of the last scheduler process was ahead of the true time. Times in the report are by that clock; all other
    /// times are true.
    pub server_ahead: Span,
    /// All events, for the trace and for the checks.
    pub history: Vec<(Timestamp<Server>, Happened)>,
    /// The instant at which the observation of the robots ended.
    pub watched_until: Timestamp<Server>,
    /// Whether the mission never ended.
    pub hung: bool,
    /// The message of the internal assertion that failed during the mission, if any.
    pub broken: Option<String>,
}

/// An event of a run. A `usize` is the index of a robot.
#[derive(Clone, Debug)]
pub enum Happened {
    /// A message was sent to a robot.
    ToRobot(usize, Message),
    /// A message from the scheduler arrived at a robot.
    AtRobot(usize, Message),
    /// The scheduler received a message from a robot; the message is kept only for a trace.
    FromRobot(usize, Option<Message>),
    /// A message was lost on the way to or from a robot.
    Lost(usize),
    /// A message to or from a robot was in transit for the given time.
    Slow(usize, Span),
    /// A message to or from a robot waited for the given time behind other messages, although no fault slowed the link down.
    Queued(usize, Span),
    /// A stop waited for the given time behind earlier messages to a robot, although no fault slowed the link down.
    StopQueued(usize, Span),
    /// A fault occurred.
    Fault(Fault),
    /// A robot's process has restarted.
    Back(usize),
    /// An operator has seized a robot, which now belongs to that operator.
    Seized(usize),
    /// A link was established.
    LinkUp(usize),
    /// The scheduler noticed that a link broke.
    LinkDown(usize),
    /// Another process took over the mission by its journal. The text is "resumed" or "withdrawn".
    TakenUp(&'static str),
    /// The given number of bytes of records were on the disk, but the next process could not read them.
    Forgotten(usize),
    /// The operator received a message.
    Told(Box<Progress>),
    /// The mission will never end; the text states what it waits for.
    Stuck(String),
}

/// Plays the mission of a seed to its end, and observes the robots afterwards.
#[must_use]
pub fn run(seed: u64) -> Ran {
    world::play(draw(seed), world::HistoryDetail::Checks)
}

/// Plays a drawn mission.
#[must_use]
pub fn play(drawn: Drawn) -> Ran {
    world::play(drawn, world::HistoryDetail::Checks)
}

/// Like [`play`], but keeps every message for a trace.
#[must_use]
pub fn play_verbosely(drawn: Drawn) -> Ran {
    world::play(drawn, world::HistoryDetail::Trace)
}

/// Returns all violations of a mission. If a comparison with the same mission without faults could find violations, also plays that
/// mission and compares both.
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

/// Like [`run`], but keeps every message for a trace.
#[must_use]
pub fn run_verbosely(seed: u64) -> Ran {
    world::play(draw(seed), world::HistoryDetail::Trace)
}

#[cfg(test)]
mod tests;
