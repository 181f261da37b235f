//! A query without effect: the state of requests, and the room and the commanded position of devices.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{self, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::Status;
use crate::content_hash::ContentHash;
use crate::error::ControlError;
use crate::limits::{INQUIRY_NAMES_MAX, LimitError};
use crate::number;
use crate::object::{self, Object};
use crate::text::{DeviceId, RequestId, SessionId};
use crate::time::{Millis, Robot, Server, Timestamp};

/// Queries a robot about its requests and devices (our extension). Starts, stops and moves nothing, and does not claim the robot. Like
/// any message, it renews the leases of its sender.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Inquiry {
    /// When the server sent it, T1 of RFC 5905: every inquiry is also a clock sample.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub timestamp: Option<Timestamp<Server>>,
    /// The session of the sender. Only the session that owns the robot receives information about requests.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<SessionId>,
    /// The requests whose state is queried; at most 32,000.
    #[serde(default, deserialize_with = "names", skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<Vec<RequestId>>", length(max = INQUIRY_NAMES_MAX)))]
    pub requests: Vec<RequestId>,
    /// The devices whose room for further scripts is queried; at most 32,000.
    #[serde(default, deserialize_with = "names", skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<Vec<DeviceId>>", length(max = INQUIRY_NAMES_MAX)))]
    pub devices: Vec<DeviceId>,
    /// After receipt, the pending lease of each request in `requests` that is held and has not begun is the shorter of its own and this
    /// one; in milliseconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pending_lease: Option<Millis>,
    /// The pending lease of each request in `requests` that is held and has not begun ends no later than this instant of the robot's
    /// clock, regardless of later messages. Replaces the instant of the request itself or of an earlier inquiry of the same sender. An
    /// inquiry without this key leaves the instant unchanged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pending_until: Option<Timestamp<Robot>>,
}

/// The robot's knowledge at one instant.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InquiryResponse {
    /// The inquiry's own timestamp, echoed: T1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub originate_timestamp: Option<Timestamp<Server>>,
    /// When the robot received the inquiry: T2.
    pub receive_timestamp: Timestamp<Robot>,
    /// When the robot sent this: T3.
    pub timestamp: Timestamp<Robot>,
    /// `OK`, or `Failed` with an error.
    pub status: Status,
    /// `busy`: the robot belongs to another session. `internal`: its hardware is absent.
    #[serde(default, deserialize_with = "object::optional", skip_serializing_if = "Option::is_none")]
    pub error: Option<ControlError>,
    /// One entry per queried request, in the same order; empty if the robot belongs to another session.
    #[serde(default, deserialize_with = "objects", skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<Vec<RequestReport>>", length(max = INQUIRY_NAMES_MAX)))]
    pub requests: Vec<RequestReport>,
    /// One entry per queried device that the robot has, in the same order.
    #[serde(default, deserialize_with = "objects", skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<Vec<DeviceReport>>", length(max = INQUIRY_NAMES_MAX)))]
    pub devices: Vec<DeviceReport>,
}

/// The state of one request.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RequestReport {
    /// The id of the request.
    pub request_id: RequestId,
    /// Its state.
    pub state: RequestState,
    /// The hash that the robot computed over the accepted value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub content_hash: Option<ContentHash>,
    /// The planned start, while it is held or running.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_timestamp: Option<Timestamp<Robot>>,
    /// The actual start, once it has started.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub event_timestamp: Option<Timestamp<Robot>>,
    /// Number of executed steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps_done: Option<u32>,
    /// Number of executed steps that were late by more than a millisecond.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub late_steps: Option<u32>,
    /// Delay of the latest step.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub late_ms_max: Option<Millis>,
    /// Why an ended request was refused or ended early. Absent if it completed.
    #[serde(default, deserialize_with = "object::optional", skip_serializing_if = "Option::is_none")]
    pub error: Option<ControlError>,
}

/// The state of a request.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RequestState {
    /// The robot never received it, has forgotten it or has restarted since.
    Unknown,
    /// Accepted, but not yet due.
    Held,
    /// Begun and not yet ended.
    Running,
    /// Completed, refused or ended early.
    Ended,
}

/// The room and the commanded position of a device.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeviceReport {
    /// The id of the device.
    pub device_id: DeviceId,
    /// Number of free places in its script queue.
    pub room: u32,
    /// The commanded position at the instant of the answer, in the device's unit. Absent if the device has no position or the
    /// robot does not know it.
    #[serde(default, with = "number::optional", skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub position: Option<f64>,
}

impl InquiryResponse {
    /// The answer to an inquiry with the instants of its receipt and of the answer by the robot's clock, without entries.
    #[must_use]
    pub const fn new(
        inquiry: &Inquiry,
        received: Timestamp<Robot>,
        sent: Timestamp<Robot>,
        status: Status,
    ) -> Self {
        Self {
            originate_timestamp: inquiry.timestamp,
            receive_timestamp: received,
            timestamp: sent,
            status,
            error: None,
            requests: Vec::new(),
            devices: Vec::new(),
        }
    }
}

impl RequestReport {
    /// A report with only the state.
    #[must_use]
    pub const fn new(request_id: RequestId, state: RequestState) -> Self {
        Self {
            request_id,
            state,
            content_hash: None,
            start_timestamp: None,
            event_timestamp: None,
            steps_done: None,
            late_steps: None,
            late_ms_max: None,
            error: None,
        }
    }
}

/// Reads a list of at most [`INQUIRY_NAMES_MAX`] entries; null is an empty list.
fn names<'de, D: Deserializer<'de>, T: Deserialize<'de>>(deserializer: D) -> Result<Vec<T>, D::Error> {
    Ok(Option::<List<T>>::deserialize(deserializer)?.map(|List(names)| names).unwrap_or_default())
}

/// Reads a list of objects with the same limit.
fn objects<'de, D: Deserializer<'de>, T: Deserialize<'de>>(deserializer: D) -> Result<Vec<T>, D::Error> {
    let list: Vec<Object<T>> = names(deserializer)?;
    Ok(list.into_iter().map(|Object(entry)| entry).collect())
}

/// A list whose length is bounded.
struct List<T>(Vec<T>);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for List<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(Names(PhantomData)).map(Self)
    }
}

struct Names<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de>> Visitor<'de> for Names<T> {
    type Value = Vec<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Vec<T>, A::Error> {
        let mut names = Vec::new();
        while let Some(name) = list.next_element()? {
            if names.len() == INQUIRY_NAMES_MAX {
                return Err(de::Error::custom(LimitError::NameCount));
            }
            names.push(name);
        }
        Ok(names)
    }
}
