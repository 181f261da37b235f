//! The inquiry: a query for the states of requests, and for the free queue space and the commanded positions of devices.

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

/// Queries a robot about its requests and devices (our extension). An inquiry starts, stops and moves nothing, and does not claim the
/// robot. Like any message, it renews the leases (limits on the server's silence) of its sender.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Inquiry {
    /// When the server sent the inquiry, T1 of RFC 5905. The response to an inquiry with a timestamp is also a sample of the robot's
    /// clock.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub timestamp: Option<Timestamp<Server>>,
    /// The session of the sender. Only the session that owns the robot receives information about requests.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<SessionId>,
    /// The ids of the requests to query; at most 32,000.
    #[serde(default, deserialize_with = "names", skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<Vec<RequestId>>", length(max = INQUIRY_NAMES_MAX)))]
    pub requests: Vec<RequestId>,
    /// The ids of the devices to query; at most 32,000.
    #[serde(default, deserialize_with = "names", skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<Vec<DeviceId>>", length(max = INQUIRY_NAMES_MAX)))]
    pub devices: Vec<DeviceId>,
    /// Maximum silence of the server, in milliseconds, after which the robot drops those of `requests` that have not started. It applies
    /// from receipt of the inquiry, unless a request already has a shorter limit. `None`: the limits stay unchanged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pending_lease: Option<Millis>,
    /// The instant by the robot's clock at which the robot drops those of `requests` that have not started, regardless of later messages.
    /// It replaces the instant set by the request itself or by an earlier inquiry of the same sender. `None`: the instant stays
    /// unchanged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pending_until: Option<Timestamp<Robot>>,
}

/// The robot's response to an inquiry: the states of requests and devices at one instant.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InquiryResponse {
    /// The timestamp of the inquiry, T1. `None` if the inquiry had none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub originate_timestamp: Option<Timestamp<Server>>,
    /// When the robot received the inquiry: T2.
    pub receive_timestamp: Timestamp<Robot>,
    /// When the robot sent this response: T3.
    pub timestamp: Timestamp<Robot>,
    /// `OK`, or `Failed` with an error.
    pub status: Status,
    /// The reason why the status is `Failed`. `busy`: the robot belongs to another session. `internal`: the robot's hardware is absent.
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
    /// The state of the request.
    pub state: RequestState,
    /// The hash that the robot computed over the accepted value of the request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub content_hash: Option<ContentHash>,
    /// The planned start of the request; `None` unless the request is held or running.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_timestamp: Option<Timestamp<Robot>>,
    /// The actual start of the request; `None` if it has not started.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub event_timestamp: Option<Timestamp<Robot>>,
    /// Number of script steps executed so far.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps_done: Option<u32>,
    /// Number of executed script steps that were late by more than a millisecond.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub late_steps: Option<u32>,
    /// Largest delay of an executed script step, in milliseconds; `None` if no step was late.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub late_ms_max: Option<Millis>,
    /// The reason why the robot refused the request or ended it early. `None` if the request was completed or has not ended.
    #[serde(default, deserialize_with = "object::optional", skip_serializing_if = "Option::is_none")]
    pub error: Option<ControlError>,
}

/// The state of a request.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RequestState {
    /// The robot never received the request, has forgotten it or has restarted since.
    Unknown,
    /// The robot has accepted the request, but its start time has not been reached.
    Held,
    /// The request has started and has not ended.
    Running,
    /// The request was completed, refused or ended early.
    Ended,
}

/// The free queue space and the commanded position of a device.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeviceReport {
    /// The id of the device.
    pub device_id: DeviceId,
    /// Number of further scripts that the device's script queue can hold.
    pub room: u32,
    /// The commanded position at the time of the response, in the device's unit. `None` if the device has no position or the robot does
    /// not know it.
    #[serde(default, with = "number::optional", skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub position: Option<f64>,
}

impl InquiryResponse {
    /// Creates the response to `inquiry` without entries, from the robot's clock readings at receipt and at sending.
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
    /// Creates a report that contains only the id and the state of a request.
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

/// Deserializes a list of at most [`INQUIRY_NAMES_MAX`] entries; null counts as an empty list.
fn names<'de, D: Deserializer<'de>, T: Deserialize<'de>>(deserializer: D) -> Result<Vec<T>, D::Error> {
    Ok(Option::<List<T>>::deserialize(deserializer)?.map(|List(names)| names).unwrap_or_default())
}

/// Deserializes a list of at most [`INQUIRY_NAMES_MAX`] objects; null counts as an empty list.
fn objects<'de, D: Deserializer<'de>, T: Deserialize<'de>>(deserializer: D) -> Result<Vec<T>, D::Error> {
    let list: Vec<Object<T>> = names(deserializer)?;
    Ok(list.into_iter().map(|Object(entry)| entry).collect())
}

/// A list of at most [`INQUIRY_NAMES_MAX`] entries.
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
