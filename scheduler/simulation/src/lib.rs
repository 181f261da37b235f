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

/// The result of running a seed.
#[derive(Debug)]
pub struct Ran {
    /// The mission drawn from the seed.
    pub drawn: Drawn,
    /// The report of the process that ended the mission, if one did.
    pub report: Option<Report>,
    /// The records in the journal, with their times.
    pub records: Vec<(Timestamp<Server>, Record)>,
    /// The values that each robot really set.
    pub logs: Vec<Vec<LogEntry>>,
    /// How its devices came to rest, if that took time.
    pub brakings: Vec<Vec<Braking>>,
    /// The actions of other robots that answered at the addresses of these.
    pub logs_of_strangers: Vec<Vec<LogEntry>>,
    /// For each robot, the scripts that it began although its hardware had been dead long enough for it to notice.
    pub starts_of_dead: Vec<Vec<String>>,
    /// The clock of the last process minus the true time: times in the report are by that clock, all others are true.
    pub server_ahead: Span,
    /// All events, for the trace and for the checks.
    pub history: Vec<(Timestamp<Server>, Happened)>,
    /// The end of the observation of the robots.
    pub watched_until: Timestamp<Server>,
    /// Whether the mission never ended.
    pub hung: bool,
    /// The assertion that failed during the mission, if any.
    pub broken: Option<String>,
}

/// An event of a run.
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
    /// A message to or from a robot was in transit for this long.
    Slow(usize, Span),
    /// A message to or from a robot was queued behind others for this long, on a link in its usual state.
    Queued(usize, Span),
    /// A stop was queued for this long behind earlier messages to a robot, on a link in its usual state.
    StopQueued(usize, Span),
    /// A fault occurred.
    Fault(Fault),
    /// A robot is back.
    Back(usize),
    /// A robot belongs to an operator who has seized it.
    Seized(usize),
    /// A link was established.
    LinkUp(usize),
    /// A link broke, as the scheduler sees it.
    LinkDown(usize),
    /// The mission was resumed from its journal.
    TakenUp(&'static str),
    /// This many bytes of records were on the disk and are not read again.
    Forgotten(usize),
    /// The operator received a message.
    Told(Box<Progress>),
    /// The mission will never end; the text states what it waits for.
    Stuck(String),
}

/// Plays a seed to its end and observes the robots afterwards.
#[must_use]
pub fn run(seed: u64) -> Ran {
    world::play(draw(seed), false)
}

/// Plays a drawn mission.
#[must_use]
pub fn play(drawn: Drawn) -> Ran {
    world::play(drawn, false)
}

/// Like [`play`], but keeps every message.
#[must_use]
pub fn play_verbosely(drawn: Drawn) -> Ran {
    world::play(drawn, true)
}

/// Returns all violations of a mission. If it could find any, also plays the same mission without its faults and compares both.
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

/// Like [`run`], but keeps every message.
#[must_use]
pub fn run_verbosely(seed: u64) -> Ran {
    world::play(draw(seed), true)
}

#[cfg(test)]
mod tests;
