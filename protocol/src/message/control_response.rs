//! Step 6 of the protocol: the robot's response to a control request.

use std::fmt;

use serde::de::{self, Visitor};
use serde::ser::SerializeStruct;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::{ControlRequest, OnLine, Script};
use crate::content_hash::ContentHash;
use crate::error::ControlError;
use crate::number::{self, Number};
use crate::object;
use crate::text::{DeviceId, Label, RequestId};
use crate::time::{Millis, Robot, Timestamp};

/// The robot's response to a control request. It confirms acceptance, reports progress or failure, or provides a sensor reading.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct ControlResponse {
    /// When the robot sent this response. The server does not use it for synchronization.
    pub timestamp: Timestamp<Robot>,
    /// The id of the device that the response is about.
    pub device_id: DeviceId,
    /// The result of the request.
    pub status: Status,
    /// The value or script accepted for execution, or the sensor reading; null on failure.
    #[serde(default)]
    pub status_value: StatusValue,
    /// The id of the request that this response belongs to (our extension).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub request_id: Option<RequestId>,
    /// The hash that the robot computed over the accepted value (our extension).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub content_hash: Option<ContentHash>,
    /// When the reported start or end actually happened (our extension).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub event_timestamp: Option<Timestamp<Robot>>,
    /// Number of script steps executed so far (our extension).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps_done: Option<u32>,
    /// Number of executed script steps that were late by more than a millisecond (our extension).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub late_steps: Option<u32>,
    /// Largest delay of an executed script step, in milliseconds; `None` if no step was late (our extension).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub late_ms_max: Option<Millis>,
    /// The reason why the request failed (our extension); `None` if the status is not `Failed`.
    #[serde(default, deserialize_with = "object::optional", skip_serializing_if = "Option::is_none")]
    pub error: Option<ControlError>,
}

impl ControlResponse {
    /// Creates a response with only the mandatory fields. Set other fields afterwards or with `..ControlResponse::new(...)`.
    ///
    /// ```
    /// use urrcp::{ControlResponse, DeviceId, Status, StatusValue, Timestamp};
    ///
    /// let (now, sensor) = (Timestamp::from_nanos(1_700_000_000_000_000_000), DeviceId::new("range")?);
    /// let status_value = StatusValue::Number(0.4);
    /// let reading = ControlResponse { status_value, ..ControlResponse::new(now, sensor, Status::Provide) };
    /// assert!(reading.error.is_none());
    /// # Ok::<(), urrcp::LimitError>(())
    /// ```
    #[must_use]
    pub const fn new(timestamp: Timestamp<Robot>, device_id: DeviceId, status: Status) -> Self {
        Self {
            timestamp,
            device_id,
            status,
            status_value: StatusValue::Null,
            request_id: None,
            content_hash: None,
            event_timestamp: None,
            steps_done: None,
            late_steps: None,
            late_ms_max: None,
            error: None,
        }
    }

    /// Creates the response `Failed` to `request`. It contains the reason and, if the request has an id, this id.
    #[must_use]
    pub fn refusal(timestamp: Timestamp<Robot>, request: &ControlRequest, error: ControlError) -> Self {
        Self {
            request_id: request.request_id.clone(),
            error: Some(error),
            ..Self::new(timestamp, request.device_id.clone(), Status::Failed)
        }
    }
}

impl Serialize for ControlResponse {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.write(serializer, &self.status_value)
    }
}

impl Serialize for OnLine<'_, ControlResponse> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.write(serializer, &OnLine(&self.0.status_value))
    }
}

impl ControlResponse {
    /// Serializes the response with the given `status_value` instead of its own.
    fn write<S: Serializer>(&self, serializer: S, status_value: &impl Serialize) -> Result<S::Ok, S::Error> {
        let optional = [
            self.request_id.is_some(),
            self.content_hash.is_some(),
            self.event_timestamp.is_some(),
            self.steps_done.is_some(),
            self.late_steps.is_some(),
            self.late_ms_max.is_some(),
            self.error.is_some(),
        ];
        let fields = 4 + optional.into_iter().filter(|given| *given).count();
        let mut fields = serializer.serialize_struct("ControlResponse", fields)?;
        fields.serialize_field("timestamp", &self.timestamp)?;
        fields.serialize_field("device_id", &self.device_id)?;
        fields.serialize_field("status", &self.status)?;
        fields.serialize_field("status_value", status_value)?;
        if let Some(request_id) = &self.request_id {
            fields.serialize_field("request_id", request_id)?;
        }
        if let Some(content_hash) = &self.content_hash {
            fields.serialize_field("content_hash", content_hash)?;
        }
        if let Some(event_timestamp) = &self.event_timestamp {
            fields.serialize_field("event_timestamp", event_timestamp)?;
        }
        if let Some(steps_done) = &self.steps_done {
            fields.serialize_field("steps_done", steps_done)?;
        }
        if let Some(late_steps) = &self.late_steps {
            fields.serialize_field("late_steps", late_steps)?;
        }
        if let Some(late_ms_max) = &self.late_ms_max {
            fields.serialize_field("late_ms_max", late_ms_max)?;
        }
        if let Some(error) = &self.error {
            fields.serialize_field("error", error)?;
        }
        fields.end()
    }
}

/// The result of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Status {
    /// The robot has completed the request.
    Ok,
    /// The robot has accepted the request for execution.
    Accepted,
    /// The command has started: the device has set the first value or has begun to move to it linearly (our extension).
    Started,
    /// The response provides a sensor reading.
    Provide,
    /// The robot has refused the request or ended it early.
    Failed,
    /// A status that this version does not know.
    Other(Label),
}

impl Status {
    /// The word that represents the status on the wire.
    #[must_use]
    pub fn as_str(&self) -> &str {
        match self {
            Self::Ok => "OK",
            Self::Accepted => "Accepted",
            Self::Started => "Started",
            Self::Provide => "Provide",
            Self::Failed => "Failed",
            Self::Other(label) => label.as_str(),
        }
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl Serialize for Status {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

impl<'de> Deserialize<'de> for Status {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let label = Label::deserialize(deserializer)?;
        Ok(match label.as_str() {
            "OK" => Self::Ok,
            "Accepted" => Self::Accepted,
            "Started" => Self::Started,
            "Provide" => Self::Provide,
            "Failed" => Self::Failed,
            _ => Self::Other(label),
        })
    }
}

/// The value in a robot's response to a control request.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum StatusValue {
    /// The response has no value, for example on failure.
    #[default]
    Null,
    /// The accepted value of a setpoint, or a sensor reading.
    Number(f64),
    /// The script accepted for execution.
    Script(Script),
}

impl Serialize for StatusValue {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Null => serializer.serialize_none(),
            Self::Number(value) => Number(*value).serialize(serializer),
            Self::Script(script) => script.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for StatusValue {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(StatusValueVisitor)
    }
}

struct StatusValueVisitor;

impl<'de> Visitor<'de> for StatusValueVisitor {
    type Value = StatusValue;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("null, a number, or the list of steps of a script")
    }

    fn visit_unit<E: de::Error>(self) -> Result<StatusValue, E> {
        Ok(StatusValue::Null)
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<StatusValue, E> {
        number::finite(value).map(StatusValue::Number)
    }

    #[expect(clippy::cast_precision_loss, reason = "the protocol's numbers are doubles")]
    fn visit_u64<E: de::Error>(self, value: u64) -> Result<StatusValue, E> {
        Ok(StatusValue::Number(value as f64))
    }

    #[expect(clippy::cast_precision_loss, reason = "the protocol's numbers are doubles")]
    fn visit_i64<E: de::Error>(self, value: i64) -> Result<StatusValue, E> {
        Ok(StatusValue::Number(value as f64))
    }

    fn visit_seq<A: de::SeqAccess<'de>>(self, seq: A) -> Result<StatusValue, A::Error> {
        Script::deserialize(de::value::SeqAccessDeserializer::new(seq)).map(StatusValue::Script)
    }
}
