//! Step 5 of the protocol: the control request, with all data for driving one device.

use std::fmt;

use serde::de::{self, IgnoredAny, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::script::{FurtherValues, Key, Keys, serialize_values, set_once};
use super::{OnLine, Script, Setpoint, StopCondition};
use crate::content_hash::ContentHash;
use crate::control_type::ControlType;
use crate::number;
use crate::text::{DeviceId, Label, RequestId, SessionId};
use crate::time::{Millis, Robot, Server, Timestamp};

/// Step 5 of the protocol: drives, reads or stops one device.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlRequest {
    /// When the server sent the request. All requests of one act (a part of a show whose robots start together) have the same timestamp.
    pub timestamp: Option<Timestamp<Server>>,
    /// Milliseconds from `timestamp` to the start. If it is omitted, the command starts on receipt.
    pub time_offset_to_start: Option<Millis>,
    /// The id of the device that the request addresses.
    pub device_id: DeviceId,
    /// The lease of the command: how long the server may be silent before the device stops. `None`: unlimited.
    pub stop_condition: Option<StopCondition>,
    /// The instant by the robot's clock at which the robot drops the command if it has not started (our extension). An inquiry that names
    /// the request may replace the instant.
    pub pending_until: Option<Timestamp<Robot>>,
    /// The id that every response to this request repeats (our extension).
    pub request_id: Option<RequestId>,
    /// The hash of `control_value`, which the robot checks and repeats in its response (our extension).
    pub content_hash: Option<ContentHash>,
    /// The session of the sender (our extension). A robot accepts commands of only one session at a time.
    pub session: Option<SessionId>,
    /// With an empty script: whether the device goes to its default state instead of coming to rest where it is (our extension).
    pub home: bool,
    /// The control type with its values.
    pub command: Command,
}

/// The command in a control request: the control type with its values.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// Sets values of the control type `position`, `speed`, `acceleration` or `custom_N`.
    Set(Setpoint),
    /// Plays a script. A script without steps cancels commands.
    Script(Script),
    /// Requests a reading of the sensor.
    ReadSensor,
    /// A command of a control type that this version does not know and that no device has. Contains the name of the type; the values are
    /// ignored.
    Unknown(Label),
}

impl Command {
    /// Returns the control type of the command; `None` if this version does not know it.
    #[must_use]
    pub const fn control_type(&self) -> Option<ControlType> {
        match self {
            Self::Set(setpoint) => Some(setpoint.control_type),
            Self::Script(_) => Some(ControlType::Script),
            Self::ReadSensor => Some(ControlType::Sensor),
            Self::Unknown(_) => None,
        }
    }

    /// Returns the SHA-256 hash of the canonical JSON of the command's values or steps.
    #[must_use]
    pub fn content_hash(&self) -> ContentHash {
        let json = match self {
            Self::Set(setpoint) => {
                let all: Vec<_> = setpoint.values().map(number::Number).collect();
                match all.as_slice() {
                    [one] => serde_json::to_vec(one),
                    many => serde_json::to_vec(many),
                }
            }
            Self::Script(script) => return script.content_hash(),
            Self::ReadSensor | Self::Unknown(_) => Ok(b"null".to_vec()),
        };
        ContentHash::of(&json.unwrap_or_default())
    }
}

impl ControlRequest {
    /// Creates a request that takes effect on receipt and has no lease, so that the server may be silent for any time.
    #[must_use]
    pub const fn immediate(device_id: DeviceId, command: Command) -> Self {
        Self {
            timestamp: None,
            time_offset_to_start: None,
            device_id,
            stop_condition: None,
            pending_until: None,
            request_id: None,
            content_hash: None,
            session: None,
            home: false,
            command,
        }
    }

    /// Whether the request is a stop: an empty script that takes effect on receipt. A stop ends the current command of the device,
    /// regardless of the session. An empty script with `home` is not a stop, because it moves the device.
    #[must_use]
    pub fn is_stop(&self) -> bool {
        let empty = matches!(&self.command, Command::Script(script) if script.is_empty());
        empty && self.starts_at().is_none() && !self.home
    }

    /// Creates a request without a lease that starts `time_offset_to_start` after `timestamp`. All requests that are to start together
    /// should have the same `timestamp`.
    #[must_use]
    pub fn deferred(
        timestamp: Timestamp<Server>,
        time_offset_to_start: Millis,
        device_id: DeviceId,
        command: Command,
    ) -> Self {
        Self {
            timestamp: Some(timestamp),
            time_offset_to_start: Some(time_offset_to_start),
            ..Self::immediate(device_id, command)
        }
    }

    /// Returns this request with an id, which every response to it repeats.
    #[must_use]
    pub fn with_request_id(mut self, request_id: RequestId) -> Self {
        self.request_id = Some(request_id);
        self
    }

    /// Returns this request with a lease: a limit on the silence of the server.
    #[must_use]
    pub const fn with_stop_condition(mut self, stop_condition: StopCondition) -> Self {
        self.stop_condition = Some(stop_condition);
        self
    }

    /// Returns this request with the hash of its values. The robot compares the hash with the values that it receives.
    #[must_use]
    pub fn with_content_hash(mut self) -> Self {
        self.content_hash = Some(self.command.content_hash());
        self
    }

    /// Returns the instant at which the command starts; `None` if it starts on receipt.
    #[must_use]
    pub fn starts_at(&self) -> Option<Timestamp<Server>> {
        Some(self.timestamp? + self.time_offset_to_start?.span())
    }
}

impl Serialize for ControlRequest {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.write(serializer, |script| script)
    }
}

impl Serialize for OnLine<'_, ControlRequest> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.write(serializer, OnLine)
    }
}

impl ControlRequest {
    /// Serializes the request. `form` wraps the script in a type that determines how it is serialized.
    fn write<'a, S: Serializer, T: Serialize>(
        &'a self,
        serializer: S,
        form: impl FnOnce(&'a Script) -> T,
    ) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        if let Some(timestamp) = &self.timestamp {
            map.serialize_entry("timestamp", timestamp)?;
        }
        if let Some(offset) = &self.time_offset_to_start {
            map.serialize_entry("time_offset_to_start", offset)?;
        }
        map.serialize_entry("device_id", &self.device_id)?;
        if let Some(stop_condition) = &self.stop_condition {
            map.serialize_entry("stop_condition", stop_condition)?;
        }
        if let Some(pending_until) = &self.pending_until {
            map.serialize_entry("pending_until", pending_until)?;
        }
        if let Some(request_id) = &self.request_id {
            map.serialize_entry("request_id", request_id)?;
        }
        if let Some(content_hash) = &self.content_hash {
            map.serialize_entry("content_hash", content_hash)?;
        }
        if let Some(session) = &self.session {
            map.serialize_entry("session", session)?;
        }
        if self.home {
            map.serialize_entry("home", &true)?;
        }
        match &self.command {
            Command::Unknown(name) => map.serialize_entry("control_type", name)?,
            command => map.serialize_entry("control_type", &command.control_type())?,
        }
        match &self.command {
            Command::Set(setpoint) => serialize_values(setpoint, &mut map)?,
            Command::Script(script) => map.serialize_entry("control_value", &form(script))?,
            Command::ReadSensor | Command::Unknown(_) => {}
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for ControlRequest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(RequestVisitor { values: Values::Read })
    }
}

/// A `control_value` that was parsed before its control type was known.
enum RawValue {
    Null,
    Number(f64),
    Script(Script),
}

/// A control request whose control type this version does not know. Its values are ignored, so a list or a text among them does not make
/// the request invalid. The request sends the device to its default state (paper, step 6).
pub(crate) struct OfUnknownType(pub(crate) ControlRequest);

impl<'de> Deserialize<'de> for OfUnknownType {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(RequestVisitor { values: Values::Ignored }).map(Self)
    }
}

/// Whether the parser reads or ignores the values of a request.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Values {
    Read,
    Ignored,
}

impl<'de> Deserialize<'de> for RawValue {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(RawValueVisitor)
    }
}

struct RawValueVisitor;

impl<'de> Visitor<'de> for RawValueVisitor {
    type Value = RawValue;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, or the list of steps of a script")
    }

    fn visit_unit<E: de::Error>(self) -> Result<RawValue, E> {
        Ok(RawValue::Null)
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<RawValue, E> {
        number::finite(value).map(RawValue::Number)
    }

    #[expect(clippy::cast_precision_loss, reason = "the protocol's numbers are doubles")]
    fn visit_u64<E: de::Error>(self, value: u64) -> Result<RawValue, E> {
        Ok(RawValue::Number(value as f64))
    }

    #[expect(clippy::cast_precision_loss, reason = "the protocol's numbers are doubles")]
    fn visit_i64<E: de::Error>(self, value: i64) -> Result<RawValue, E> {
        Ok(RawValue::Number(value as f64))
    }

    fn visit_seq<A: de::SeqAccess<'de>>(self, seq: A) -> Result<RawValue, A::Error> {
        Script::deserialize(de::value::SeqAccessDeserializer::new(seq)).map(RawValue::Script)
    }
}

struct RequestVisitor {
    values: Values,
}

#[derive(Default)]
struct Fields {
    timestamp: Option<Option<Timestamp<Server>>>,
    time_offset_to_start: Option<Option<Millis>>,
    device_id: Option<DeviceId>,
    stop_condition: Option<Option<StopCondition>>,
    pending_until: Option<Option<Timestamp<Robot>>>,
    request_id: Option<Option<RequestId>>,
    content_hash: Option<Option<ContentHash>>,
    session: Option<Option<SessionId>>,
    home: Option<Option<bool>>,
    control_type: Option<Named>,
    control_value: Option<RawValue>,
    more: FurtherValues,
}

impl<'de> Visitor<'de> for RequestVisitor {
    type Value = ControlRequest;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a control request")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<ControlRequest, A::Error> {
        let mut fields = Fields::default();
        while let Some(key) = map.next_key::<Key<RequestKey>>()? {
            let ignored =
                self.values == Values::Ignored || matches!(fields.control_type, Some(Named::Unknown(_)));
            match key.0 {
                RequestKey::Value | RequestKey::Further(_) if ignored => {
                    map.next_value::<IgnoredAny>()?;
                }
                key => read_field(&mut fields, key, &mut map)?,
            }
        }
        match (self.values, &fields.control_type) {
            (Values::Ignored, Some(Named::Known(known))) => {
                Err(de::Error::custom(format!("`{known}` is a known control type")))
            }
            _ => finish(fields),
        }
    }
}

enum RequestKey {
    Timestamp,
    Offset,
    DeviceId,
    StopCondition,
    PendingUntil,
    RequestId,
    ContentHash,
    Session,
    Home,
    ControlType,
    Value,
    /// The key `control_value_N`, where N is at least 2.
    Further(usize),
    Unknown,
}

impl Keys for RequestKey {
    fn named<E: de::Error>(key: &str) -> Result<Self, E> {
        Ok(match key {
            "timestamp" => Self::Timestamp,
            "time_offset_to_start" => Self::Offset,
            "device_id" => Self::DeviceId,
            "stop_condition" => Self::StopCondition,
            "pending_until" => Self::PendingUntil,
            "request_id" => Self::RequestId,
            "content_hash" => Self::ContentHash,
            "session" => Self::Session,
            "home" => Self::Home,
            "control_type" => Self::ControlType,
            "control_value" => Self::Value,
            other => FurtherValues::index(other)?.map_or(Self::Unknown, Self::Further),
        })
    }
}

fn read_field<'de, A: MapAccess<'de>>(
    fields: &mut Fields,
    key: RequestKey,
    map: &mut A,
) -> Result<(), A::Error> {
    match key {
        RequestKey::Timestamp => set_once(&mut fields.timestamp, "timestamp", map.next_value()?),
        RequestKey::Offset => {
            set_once(&mut fields.time_offset_to_start, "time_offset_to_start", map.next_value()?)
        }
        RequestKey::DeviceId => set_once(&mut fields.device_id, "device_id", map.next_value()?),
        RequestKey::StopCondition => {
            set_once(&mut fields.stop_condition, "stop_condition", map.next_value()?)
        }
        RequestKey::PendingUntil => set_once(&mut fields.pending_until, "pending_until", map.next_value()?),
        RequestKey::RequestId => set_once(&mut fields.request_id, "request_id", map.next_value()?),
        RequestKey::ContentHash => set_once(&mut fields.content_hash, "content_hash", map.next_value()?),
        RequestKey::Session => set_once(&mut fields.session, "session", map.next_value()?),
        RequestKey::Home => set_once(&mut fields.home, "home", map.next_value()?),
        RequestKey::ControlType => set_once(&mut fields.control_type, "control_type", map.next_value()?),
        RequestKey::Value => set_once(&mut fields.control_value, "control_value", map.next_value()?),
        RequestKey::Further(index) => fields.more.put(index, map.next_value()?),
        RequestKey::Unknown => map.next_value::<IgnoredAny>().map(drop),
    }
}

fn finish<E: de::Error>(fields: Fields) -> Result<ControlRequest, E> {
    let control_type = fields.control_type.ok_or_else(|| E::missing_field("control_type"))?;
    Ok(ControlRequest {
        timestamp: fields.timestamp.flatten(),
        time_offset_to_start: fields.time_offset_to_start.flatten(),
        device_id: fields.device_id.ok_or_else(|| E::missing_field("device_id"))?,
        stop_condition: fields.stop_condition.flatten(),
        pending_until: fields.pending_until.flatten(),
        request_id: fields.request_id.flatten(),
        content_hash: fields.content_hash.flatten(),
        session: fields.session.flatten(),
        home: fields.home.flatten().unwrap_or(false),
        command: command(control_type, fields.control_value, fields.more)?,
    })
}

/// The name of a control type, which this version may not know.
enum Named {
    Known(ControlType),
    Unknown(Label),
}

impl<'de> Deserialize<'de> for Named {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = Label::deserialize(deserializer)?;
        Ok(name.as_str().parse().map_or(Self::Unknown(name), Self::Known))
    }
}

fn command<E: de::Error>(named: Named, value: Option<RawValue>, more: FurtherValues) -> Result<Command, E> {
    let control_type = match named {
        Named::Known(control_type) => control_type,
        Named::Unknown(name) => return Ok(Command::Unknown(name)),
    };
    match (control_type, value) {
        (ControlType::Sensor, _) => Ok(Command::ReadSensor),
        (ControlType::Script, Some(RawValue::Script(script))) if more.is_empty() => {
            Ok(Command::Script(script))
        }
        (ControlType::Script, None | Some(RawValue::Null)) => Err(E::missing_field("control_value")),
        (ControlType::Script, _) => {
            Err(E::custom("invalid control_value of a script, expected only a list of steps"))
        }
        (_, None | Some(RawValue::Null)) => Err(E::missing_field("control_value")),
        (_, Some(RawValue::Script(_))) => {
            Err(E::custom(format!("control_value of `{control_type}` is a list, expected a number")))
        }
        (_, Some(RawValue::Number(value))) => {
            Ok(Command::Set(Setpoint { control_type, value, more: more.finish()? }))
        }
    }
}
