//! Steps 3 and 4 of the protocol: the request for the robot's description, and the description.

use std::collections::HashSet;
use std::fmt;
use std::marker::PhantomData;

use serde::de::{self, IgnoredAny, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::growth::Word;
use super::{Device, Devices, parameters};
use crate::encoding::Encoding;
use crate::limits::{DEVICES_MAX, ENCODINGS_MAX, LimitError, ROBOT_PARAMETERS_MAX};
use crate::object::Object;
use crate::text::{Label, RobotId};
use crate::time::{Server, Timestamp};

/// The version of the protocol that [`InitializationBlock::new`] declares.
pub const API_VERSION: &str = "1";

/// Step 3 of the protocol: asks the robot for its description.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct InitializationRequest {
    /// When the server sent the request (our extension).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub timestamp: Option<Timestamp<Server>>,
}

/// Step 4 of the protocol: the robot's description of itself (paper, figure 2).
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(!try_from))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Object<RawBlock>")]
pub struct InitializationBlock {
    /// The unique id of the robot.
    pub id: RobotId,
    /// The name of the robot for people, unique within one system.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<Label>,
    /// The intended use of the robot.
    #[serde(rename = "type", skip_serializing_if = "Option::is_none")]
    pub robot_type: Option<RobotType>,
    /// The manufacturer of the robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub manufacture: Option<Label>,
    /// The version of the robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub version: Option<Label>,
    /// The version of URRCP that the robot implements.
    pub api_version: Label,
    /// Whether the robot sends `Started`, `OK` and `Failed` after `Accepted` (our extension).
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    #[cfg_attr(feature = "schema", schemars(default))]
    pub reports: bool,
    /// The encodings that the robot supports in addition to JSON, such as `msgpack` (our extension).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(default))]
    pub encodings: Vec<Label>,
    /// Whether the robot answers inquiries (our extension).
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    #[cfg_attr(feature = "schema", schemars(default))]
    pub inquiry: bool,
    /// Whether the robot acts on `pending_until`, in control requests and in inquiries (our extension).
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    #[cfg_attr(feature = "schema", schemars(default))]
    pub pending_until: bool,
    /// The robot's devices: 1 to 32,000, with unique ids.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<Device>", length(min = 1, max = DEVICES_MAX)))]
    pub devices: Devices,
}

#[derive(Deserialize)]
struct RawBlock {
    id: RobotId,
    #[serde(default)]
    name: Option<Label>,
    #[serde(default, rename = "type", deserialize_with = "robot_type")]
    robot_type: Option<RobotType>,
    #[serde(default)]
    manufacture: Option<Label>,
    #[serde(default)]
    version: Option<Label>,
    api_version: Label,
    #[serde(default)]
    reports: bool,
    #[serde(default, deserialize_with = "encodings")]
    encodings: Vec<Label>,
    #[serde(default)]
    inquiry: bool,
    #[serde(default)]
    pending_until: bool,
    #[serde(deserialize_with = "devices")]
    devices: Vec<Object<Device>>,
}

/// Deserializes a type of robots. A message may contain one of a later version, which is [`RobotType::Other`] in this one.
fn robot_type<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<RobotType>, D::Error> {
    Ok(Option::<Word<RobotType>>::deserialize(deserializer)?.map(|word| match word {
        Word::Known(known) => known,
        Word::Later => RobotType::Other,
    }))
}

/// Deserializes a list of at most [`ENCODINGS_MAX`] encodings.
fn encodings<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Label>, D::Error> {
    match deserializer.deserialize_seq(Bounded { most: ENCODINGS_MAX, of: PhantomData })? {
        (encodings, count) if count <= ENCODINGS_MAX => Ok(encodings),
        _ => Err(de::Error::custom(LimitError::EncodingCount)),
    }
}

/// Deserializes a list of at most [`DEVICES_MAX`] devices. A common limit applies to the parameters of all their custom control types.
fn devices<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Object<Device>>, D::Error> {
    let list = Bounded { most: DEVICES_MAX, of: PhantomData };
    match parameters::together(ROBOT_PARAMETERS_MAX, || deserializer.deserialize_seq(list))? {
        (devices, count) if count <= DEVICES_MAX => Ok(devices),
        (_, count) => Err(de::Error::custom(LimitError::DeviceCount { count })),
    }
}

/// A visitor that deserializes a list and counts its entries. It keeps the first `most` entries and discards the others.
struct Bounded<T> {
    most: usize,
    of: PhantomData<T>,
}

impl<'de, T: Deserialize<'de>> Visitor<'de> for Bounded<T> {
    type Value = (Vec<T>, usize);

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
        let mut kept = Vec::new();
        while kept.len() < self.most {
            match list.next_element()? {
                Some(entry) => kept.push(entry),
                None => {
                    let count = kept.len();
                    return Ok((kept, count));
                }
            }
        }
        let mut count = kept.len();
        while list.next_element::<IgnoredAny>()?.is_some() {
            count += 1;
        }
        Ok((kept, count))
    }
}

impl TryFrom<Object<RawBlock>> for InitializationBlock {
    type Error = LimitError;

    fn try_from(Object(raw): Object<RawBlock>) -> Result<Self, LimitError> {
        if raw.devices.is_empty() || raw.devices.len() > DEVICES_MAX {
            return Err(LimitError::DeviceCount { count: raw.devices.len() });
        }
        let mut seen = HashSet::with_capacity(raw.devices.len());
        if let Some(twice) = raw.devices.iter().find(|Object(device)| !seen.insert(&device.id)) {
            return Err(LimitError::DuplicateDevice { id: twice.0.id.to_string() });
        }
        raw.devices.iter().try_for_each(|Object(device)| device.check_default())?;
        raw.devices.iter().try_for_each(|Object(device)| device.check_latency())?;
        raw.devices.iter().try_for_each(|Object(device)| device.check_queue())?;
        Ok(Self {
            id: raw.id,
            name: raw.name,
            robot_type: raw.robot_type,
            manufacture: raw.manufacture,
            version: raw.version,
            api_version: raw.api_version,
            reports: raw.reports,
            encodings: raw.encodings,
            inquiry: raw.inquiry,
            pending_until: raw.pending_until,
            devices: raw.devices.into_iter().map(|Object(device)| device).collect(),
        })
    }
}

impl InitializationBlock {
    /// Creates a description that declares no extension of the protocol. Set the other fields as needed. Robots of the crate
    /// `downbeat-robot` add the extensions that they implement by themselves.
    ///
    /// # Errors
    /// [`LimitError`] if there is no device or more than [`DEVICES_MAX`], two have the same id, a default value is outside its device's
    /// range, or a device has a latency spread without a latency.
    pub fn new(id: RobotId, devices: Vec<Device>) -> Result<Self, LimitError> {
        let devices = devices.into_iter().map(Object).collect();
        Self::try_from(Object(RawBlock {
            id,
            name: None,
            robot_type: None,
            manufacture: None,
            version: None,
            api_version: Label::new(API_VERSION)?,
            reports: false,
            encodings: Vec::new(),
            inquiry: false,
            pending_until: false,
            devices,
        }))
    }

    /// Returns the device with the given id; `None` if the robot has no such device.
    #[must_use]
    pub fn device(&self, id: &str) -> Option<&Device> {
        self.devices.iter().find(|device| device.id.as_str() == id)
    }

    /// Returns this description with the declaration that the robot supports `encoding`.
    #[must_use]
    pub fn and_understands(mut self, encoding: Encoding) -> Self {
        if !self.understands(encoding) {
            self.encodings.extend(Label::new(encoding.as_str()));
        }
        self
    }

    /// Returns this description with the declaration that the robot answers inquiries and acts on `pending_until`.
    #[must_use]
    pub const fn and_answers_inquiries(mut self) -> Self {
        self.inquiry = true;
        self.pending_until = true;
        self
    }

    /// Whether the robot supports `encoding`. Every robot supports JSON.
    #[must_use]
    pub fn understands(&self, encoding: Encoding) -> bool {
        encoding == Encoding::Json || self.encodings.iter().any(|listed| listed.as_str() == encoding.as_str())
    }
}

/// The intended use of a robot (paper, table 1; the list is fixed per protocol version).
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum RobotType {
    /// A robot for production, usually a manipulator.
    Industrial,
    /// A robot that moves goods.
    Transport,
    /// A general-purpose robot that resembles a human.
    Anthropomorphic,
    /// A military robot.
    Military,
    /// A robot for any other use.
    Other,
}
