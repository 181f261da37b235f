//! What goes into a mission and what comes out of it.

use std::sync::Arc;

use downbeat_plan::Choreography;
use serde::{Deserialize, Serialize};
use urrcp::{DeviceId, Message, RobotId, Server, Span, Timestamp};

use super::failure_kind::Failure;
use super::fates::ActFate;
use super::robot_state::Rest;
use super::{LeadTime, Preflight, Record, SkewBudget};
use crate::clock::NtpState;

/// What happened outside.
#[derive(Clone, Debug)]
pub enum Event {
    /// A link stands.
    LinkUp {
        /// Index of the robot.
        robot: usize,
    },
    /// A robot has proven who it is, on the link that stands next.
    Proven {
        /// Index of the robot.
        robot: usize,
        /// Until when its certificate counts, if it has shown one.
        until: Option<Timestamp<Server>>,
    },
    /// A link broke or could not be made.
    LinkDown {
        /// Index of the robot.
        robot: usize,
        /// What is certain about it.
        loss: Loss,
        /// Why, for people.
        reason: String,
    },
    /// A message arrived.
    Received {
        /// From whom.
        robot: usize,
        /// The message.
        message: Message,
    },
    /// Bytes arrived that are no message.
    Garbled {
        /// From whom.
        robot: usize,
        /// What is wrong with them.
        reason: String,
    },
    /// The operator wants everything to stop.
    StopRequested {
        /// How the robots come to rest.
        rest: Rest,
        /// Who says so, for people, where that is another than who began the mission.
        by: Option<String>,
    },
    /// The operator lets the act begin that waits for it. Answered by [`Action::Answer`].
    Go {
        /// Which act is meant; `None`: whichever waits.
        act: Option<String>,
        /// Who says so, for people, where that is another than who began the mission.
        by: Option<String>,
    },
    /// What NTP says of this machine's clock by now.
    ServerTime(NtpState),
    /// So many durable records of this mission are on the disk, the first ones, counted from 1. A driver without a journal
    /// says so at once.
    Recorded {
        /// How many.
        count: u64,
    },
    /// The journal was removed or replaced, and all of it has been written again.
    JournalWrittenAgain,
    /// The journal takes no more records.
    JournalLost {
        /// Why, for people.
        reason: String,
    },
}

/// What the end of a link says about the robot behind it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loss {
    /// An established link was closed or reset.
    Closed,
    /// Connecting was refused: no process listens there.
    Refused,
    /// One side does not prove who it is, or is not let in: another attempt changes nothing.
    Denied,
    /// No route, no answer in time, or anything else that leaves open whether the robot lives.
    Unreachable,
    /// The robot sends far more than it was asked for. It is connected to again only to be stopped.
    Flooding {
        /// Messages that have come on the link.
        messages: u64,
        /// Bytes that have come on it.
        bytes: u64,
    },
}

/// What the driver has to do.
#[derive(Clone, Debug)]
pub enum Action {
    /// Send a message on the robot's link.
    Send {
        /// To whom.
        robot: usize,
        /// The message.
        message: Message,
        /// Ahead of everything that waits to be sent.
        urgent: bool,
    },
    /// Connect to the robot again.
    Reconnect {
        /// Index of the robot.
        robot: usize,
        /// The pause before that.
        after: Span,
    },
    /// Write this down. A durable record is answered by [`Event::Recorded`] once it is on the disk; what follows is done
    /// without waiting for that.
    Record(Record),
    /// Tell the operator.
    Tell(Progress),
    /// Answer the operator's go: which act it lets begin, or why it counts for none.
    Answer(Result<String, String>),
}

/// What an operator wants to know while the mission goes on.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "progress", rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Progress {
    /// All links stand.
    Connected {
        /// How many robots.
        robots: usize,
    },
    /// All robots are greeted and checked.
    Greeted {
        /// Largest measured offset of a clock that follows NTP; `None` where robots have failed.
        #[serde(rename = "clock_offset_max_ms")]
        clock_offset_max: Option<Span>,
        /// What was checked, a row a robot.
        preflight: Preflight,
    },
    /// An act waits for its condition.
    Waiting {
        /// Which act.
        act: String,
        /// For what, for people.
        awaits: String,
        /// The instant at which it is meant to start, if it waits for a time.
        #[serde(skip_serializing_if = "Option::is_none")]
        at: Option<Timestamp<Server>>,
    },
    /// All requests of an act are on their way.
    Preparing {
        /// Which act.
        act: String,
        /// The sending timestamp that all share.
        timestamp: Timestamp<Server>,
        /// When the first cue starts.
        start: Timestamp<Server>,
        /// Why the start is that far ahead.
        lead: LeadTime,
        /// How far apart the robots may start.
        skew: Option<SkewBudget>,
        /// The robot whose link determines the lead.
        #[serde(skip_serializing_if = "Option::is_none")]
        slowest: Option<RobotId>,
    },
    /// A robot has accepted all its scripts.
    Accepted {
        /// Which robot.
        robot: RobotId,
    },
    /// All have accepted: the act starts, unless a lease cannot be carried over the start.
    Decided {
        /// Which act.
        act: String,
        /// When the first cue starts.
        start: Timestamp<Server>,
        /// How long it plays.
        #[serde(rename = "duration_ms")]
        duration: Span,
        /// All leases end here unless the act is committed.
        leases_end: Timestamp<Server>,
        /// A failure that is known by then is withdrawn before anything has moved; after it only stopping is possible.
        no_return: Timestamp<Server>,
        /// A robot that goes silent without a word later than so long before the start may be noticed too late.
        #[serde(rename = "doubt_ms")]
        doubt: Span,
    },
    /// All robots have confirmed the renewal that carries them over the start.
    Committed {
        /// Which act.
        act: String,
        /// Between the first renewal sent and the last confirmed: had this machine died in it, some would have started.
        #[serde(rename = "window_ms")]
        window: Option<Span>,
    },
    /// A device's script has started.
    Started {
        /// On which robot.
        robot: RobotId,
        /// Actual minus planned start.
        #[serde(rename = "error_ms")]
        error: Option<Span>,
    },
    /// What a robot says of itself while it plays, at most once a second.
    Heard {
        /// Which robot.
        robot: RobotId,
        /// Steps of the act under way that it has executed.
        steps_done: u64,
        /// Its clock's offset, robot minus server.
        #[serde(rename = "clock_offset_ms")]
        clock_offset: Option<Span>,
    },
    /// The sensor that an act waits for reads another value than before.
    Reading {
        /// Which act.
        act: String,
        /// What it reads.
        value: Option<f64>,
    },
    /// A robot has confirmed its stop on every device.
    AtRest {
        /// Which robot.
        robot: RobotId,
    },
    /// A robot has ended all its scripts of an act.
    Finished {
        /// Which robot.
        robot: RobotId,
        /// Which of the mission's acts, counted from zero.
        number: u32,
    },
    /// An act is not played, and the mission goes on.
    ActSkipped {
        /// Which act.
        act: String,
        /// Why it is not played.
        #[serde(flatten)]
        fate: ActFate,
    },
    /// An act has ended.
    ActEnded {
        /// Which act.
        act: String,
    },
    /// Something failed.
    Failed(Failure),
    /// The link to a robot broke in mid-mission; it goes on by its script.
    LinkLost {
        /// Which robot.
        robot: RobotId,
        /// Why the link broke, for people.
        reason: String,
        /// When it is given up; `None` where it holds nothing that could still move it.
        until: Option<Timestamp<Server>>,
    },
    /// A robot is back.
    Reattached {
        /// Which robot.
        robot: RobotId,
    },
    /// All robots rest, and this act moves their devices to their default positions.
    GoingHome {
        /// The name of the act.
        act: String,
        /// The choreography with this act. Recordings leave it out.
        #[serde(skip)]
        choreography: Arc<Choreography>,
    },
    /// All robots rest, and no device has to move to its default position.
    AtHome,
    /// All robots rest, and this act moves devices to the first positions of the act that follows the failure.
    Approaching {
        /// The name of the act.
        act: String,
        /// The name of the act that follows.
        to: String,
        /// The choreography with this act. Recordings leave it out.
        #[serde(skip)]
        choreography: Arc<Choreography>,
    },
    /// The act after the failure is not played, because no act that moves devices to its first positions can be planned.
    NotApproached {
        /// The name of the act.
        act: String,
        /// The reason, for people.
        reason: String,
    },
    /// The devices stay where they came to rest, instead of moving to their default positions.
    NotHome {
        /// The reason, for people.
        reason: String,
    },
    /// A robot is left out from here on.
    Dropped {
        /// Which robot.
        robot: RobotId,
    },
    /// The NTP server answers no more: this machine's clock goes on by itself.
    NtpLost {
        /// Since when.
        since: Timestamp<Server>,
    },
    /// The NTP server answers again.
    NtpBack {
        /// What has come between NTP time and this machine's clock since the mission began.
        #[serde(rename = "offset_change_ms")]
        offset_change: Span,
    },
    /// The journal was removed or replaced while the mission ran, and all of it has been written again.
    JournalWrittenAgain,
    /// The journal cannot be written: everything is stopped.
    JournalLost {
        /// Why it cannot be written, for people.
        reason: String,
    },
    /// An act was withdrawn before anything moved, and is prepared again.
    ActWithdrawn {
        /// The name of the act.
        act: String,
    },
    /// Stop requests are on their way.
    Stopping {
        /// Why all are stopped, for people.
        reason: String,
        /// How they come to rest.
        rest: Rest,
    },
}

/// A reading that the scenario asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TakenReading {
    /// The sensor's robot.
    pub robot: RobotId,
    /// Which sensor.
    pub sensor: DeviceId,
    /// When it was asked for, from the act's start.
    #[serde(rename = "at_ms")]
    pub at: Span,
    /// What it read.
    pub value: Option<f64>,
}
