//! The input and the output of a mission.

use std::sync::Arc;

use downbeat_plan::Choreography;
use serde::{Deserialize, Serialize};
use urrcp::{DeviceId, Message, RobotId, Server, Span, Timestamp};

use super::failure_kind::Failure;
use super::fates::ActFate;
use super::robot_state::Rest;
use super::{ActNumber, LeadTime, Preflight, Record, RobotIndex, SkewBudget};
use crate::clock::NtpState;

/// An event outside the mission, which the driver passes to it.
#[derive(Clone, Debug)]
pub enum Event {
    /// A link to a robot was made.
    LinkUp {
        /// Index of the robot.
        robot: RobotIndex,
    },
    /// A robot has proven its identity. [`Event::LinkUp`] follows for the link on which it did so.
    Proven {
        /// Index of the robot.
        robot: RobotIndex,
        /// The expiry of the robot's certificate, if the robot has presented one.
        until: Option<Timestamp<Server>>,
        /// Whether another authority replaces the one that issued the robot's certificate.
        is_of_replaced_authority: bool,
    },
    /// A link to a robot broke or could not be made.
    LinkDown {
        /// Index of the robot.
        robot: RobotIndex,
        /// What the loss shows about the robot.
        loss: Loss,
        /// The reason for the loss, as text for users.
        reason: String,
    },
    /// A message from a robot arrived.
    Received {
        /// Index of the robot.
        robot: RobotIndex,
        /// The message.
        message: Message,
    },
    /// Bytes from a robot arrived that are not a message.
    Garbled {
        /// Index of the robot.
        robot: RobotIndex,
        /// The fault in the bytes.
        reason: String,
    },
    /// The operator requests a stop of everything.
    StopRequested {
        /// How the robots come to rest.
        rest: Rest,
        /// The operator who requests the stop, for users, if another operator started the mission.
        by: Option<String>,
    },
    /// The operator permits the waiting act to begin. The mission answers with [`Action::Answer`].
    Go {
        /// The name of the act; `None` for any act that waits.
        act: Option<String>,
        /// The operator who sent the go, for users, if another operator started the mission.
        by: Option<String>,
    },
    /// The current state of this machine's clock relative to NTP time.
    ServerTime(NtpState),
    /// The first `count` durable records of this mission are on disk. A driver without a journal sends this event at once.
    Recorded {
        /// The number of durable records that are on disk.
        count: u64,
    },
    /// The journal was removed or replaced, and all of it has been written again.
    JournalWrittenAgain,
    /// The journal no longer accepts records.
    JournalLost {
        /// The reason why the journal was lost, as text for users.
        reason: String,
    },
}

/// What the loss of a link shows about the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loss {
    /// An established link was closed or reset.
    Closed,
    /// The connection was refused: no process listens at the address.
    Refused,
    /// One side has not proven its identity, or is not admitted. Another attempt would not help.
    Denied,
    /// No route, no answer in time, or any other loss that does not show whether the robot is alive.
    Unreachable,
    /// The robot sends far more messages than requested. The mission reconnects to it only to stop it.
    Flooding {
        /// Number of messages received on the link.
        messages: u64,
        /// Number of bytes received on the link.
        bytes: u64,
    },
}

/// An action that the driver must perform.
#[derive(Clone, Debug)]
pub enum Action {
    /// Send a message on the robot's link.
    Send {
        /// Index of the robot.
        robot: RobotIndex,
        /// The message.
        message: Message,
        /// Whether the message goes ahead of all messages that wait to be sent.
        urgent: bool,
    },
    /// Connect to the robot again.
    Reconnect {
        /// Index of the robot.
        robot: RobotIndex,
        /// The pause before the attempt.
        after: Span,
    },
    /// Write this record. [`Event::Recorded`] confirms a durable record once it is on disk. The following actions are performed without
    /// waiting for that confirmation.
    Record(Record),
    /// Report this to the operator.
    Tell(Progress),
    /// Answer the operator's go: with the act that the go permits to begin, or with the reason why the go is ignored.
    Answer(Result<String, String>),
}

/// Progress that is reported to the operator while the mission runs.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "progress", rename_all = "snake_case")]
#[cfg_attr(test, derive(strum::VariantNames), strum(serialize_all = "snake_case"))]
pub enum Progress {
    /// The links to all robots have been established.
    Connected {
        /// Number of robots.
        robots: usize,
    },
    /// All robots are greeted and checked.
    Greeted {
        /// The largest measured offset of a clock that follows NTP; `None` if robots have failed.
        #[serde(rename = "clock_offset_max_ms")]
        clock_offset_max: Option<Span>,
        /// The results of the checks, one row per robot.
        preflight: Preflight,
    },
    /// An act waits for its condition.
    Waiting {
        /// Name of the act.
        act: String,
        /// The condition that the act waits for, as text for users.
        awaits: String,
        /// The intended start, if the act waits for a time.
        #[serde(skip_serializing_if = "Option::is_none")]
        at: Option<Timestamp<Server>>,
    },
    /// All requests of an act are being sent.
    Preparing {
        /// Name of the act.
        act: String,
        /// The sending timestamp that all requests share.
        timestamp: Timestamp<Server>,
        /// The planned start of the act, at its first cue.
        start: Timestamp<Server>,
        /// The components of the lead time, from sending the requests to the start.
        lead: LeadTime,
        /// How far apart the robots may start because of their clocks.
        skew: Option<SkewBudget>,
        /// The robot whose slow link determines the lead time.
        #[serde(skip_serializing_if = "Option::is_none")]
        slowest: Option<RobotId>,
    },
    /// A robot has accepted all its scripts.
    Accepted {
        /// Id of the robot.
        robot: RobotId,
    },
    /// All robots of an act have accepted. The act starts, unless a lease cannot be extended beyond the start.
    Decided {
        /// Name of the act.
        act: String,
        /// The planned start of the act, at its first cue.
        start: Timestamp<Server>,
        /// The playing time of the act.
        #[serde(rename = "duration_ms")]
        duration: Span,
        /// The time at which all leases end, unless the act is committed.
        leases_end: Timestamp<Server>,
        /// The latest time at which the act can be withdrawn after a failure before anything has moved. Later, robots can only be
        /// stopped.
        no_return: Timestamp<Server>,
        /// The length of the interval before the start in which a robot's sudden silence may be noticed too late to prevent the start.
        #[serde(rename = "doubt_ms")]
        doubt: Span,
    },
    /// All robots have confirmed the message that extends their leases beyond the start.
    Committed {
        /// Name of the act.
        act: String,
        /// Time from sending the first message that extends a lease beyond the start to the last confirmation. If this machine had died
        /// during this time, only some robots would have started.
        #[serde(rename = "window_ms")]
        window: Option<Span>,
    },
    /// A script of a device has started.
    Started {
        /// Id of the robot.
        robot: RobotId,
        /// The script's actual minus its planned start.
        #[serde(rename = "error_ms")]
        error: Option<Span>,
    },
    /// A robot's own status while it plays, at most once per second.
    Heard {
        /// Id of the robot.
        robot: RobotId,
        /// Number of executed steps of the act under way.
        steps_done: u64,
        /// The offset of the robot's clock, robot minus server.
        #[serde(rename = "clock_offset_ms")]
        clock_offset: Option<Span>,
    },
    /// The sensor that an act waits for has a new value.
    Reading {
        /// Name of the act.
        act: String,
        /// The value; `None` without a reading.
        value: Option<f64>,
    },
    /// A robot has confirmed its stop on every device.
    AtRest {
        /// Id of the robot.
        robot: RobotId,
    },
    /// A robot has ended all its scripts of an act.
    Finished {
        /// Id of the robot.
        robot: RobotId,
        /// The number of the act in the mission, starting at 0.
        number: ActNumber,
    },
    /// An act is not played, and the mission continues.
    ActSkipped {
        /// Name of the act.
        act: String,
        /// The reason why the act is not played.
        #[serde(flatten)]
        fate: ActFate,
    },
    /// An act has ended.
    ActEnded {
        /// Name of the act.
        act: String,
    },
    /// A robot failed.
    Failed(Failure),
    /// The link to a robot broke in mid-mission. The robot continues with its script.
    LinkLost {
        /// Id of the robot.
        robot: RobotId,
        /// The reason why the link broke, as text for users.
        reason: String,
        /// The time at which the mission gives up on the robot; `None` if the robot holds nothing that could still move it.
        until: Option<Timestamp<Server>>,
    },
    /// A robot has reconnected.
    Reattached {
        /// Id of the robot.
        robot: RobotId,
    },
    /// All robots rest, and this act moves their devices to their default positions.
    GoingHome {
        /// The name of the act.
        act: String,
        /// The choreography that contains this act. Recordings omit it.
        #[serde(skip)]
        choreography: Arc<Choreography>,
    },
    /// All robots rest, and no device has to move to its default position.
    AtHome,
    /// All robots rest, and this act moves devices to the first positions of the act that follows the failure.
    Approaching {
        /// The name of the act.
        act: String,
        /// The name of the act that follows the failure.
        to: String,
        /// The choreography that contains this act. Recordings omit it.
        #[serde(skip)]
        choreography: Arc<Choreography>,
    },
    /// The act after the failure is not played, because no act that moves devices to its first positions can be planned.
    NotApproached {
        /// The name of the act.
        act: String,
        /// The reason why no approach can be planned, as text for users.
        reason: String,
    },
    /// The devices stay where they came to rest, instead of moving to their default positions.
    NotHome {
        /// The reason why the devices stay, as text for users.
        reason: String,
    },
    /// A robot is left out from now on.
    Dropped {
        /// Id of the robot.
        robot: RobotId,
    },
    /// The NTP server no longer answers. This machine's clock runs without correction.
    NtpLost {
        /// The time since which the NTP server has not answered.
        since: Timestamp<Server>,
    },
    /// The NTP server answers again.
    NtpBack {
        /// How much the difference between NTP time and this machine's clock has changed since the mission began.
        #[serde(rename = "offset_change_ms")]
        offset_change: Span,
    },
    /// The journal was removed or replaced during the mission, and all of it has been written again.
    JournalWrittenAgain,
    /// The journal cannot be written, and all robots are stopped.
    JournalLost {
        /// The reason why the journal was lost, as text for users.
        reason: String,
    },
    /// An act was withdrawn before anything moved, and is prepared again.
    ActWithdrawn {
        /// The name of the act.
        act: String,
    },
    /// Stop requests are being sent.
    Stopping {
        /// The reason for the stop, as text for users.
        reason: String,
        /// How the robots come to rest.
        rest: Rest,
    },
}

/// A reading that the scenario requested.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TakenReading {
    /// The sensor's robot.
    pub robot: RobotId,
    /// Id of the sensor.
    pub sensor: DeviceId,
    /// The planned time of the request for the reading, counted from the act's start.
    #[serde(rename = "at_ms")]
    pub at: Span,
    /// The value; `None` without a reading.
    pub value: Option<f64>,
}
