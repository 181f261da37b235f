//! Steps 3 and 4: what the robot is, and how each of its devices can be driven.

use std::collections::{BTreeMap, HashSet};
use std::fmt;

use serde::de::{self, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};

use super::Setpoint;
use super::parameters::Parameters;
use crate::codec::Encoding;
use crate::control_type::ControlType;
use crate::error::{ControlError, ErrorCode};
use crate::limits::{DEVICES_MAX, LimitError};
use crate::number;
use crate::object::Object;
use crate::text::{DeviceId, Label, RobotId};
use crate::time::{Server, Timestamp};

/// Step 3: describe yourself.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct InitializationRequest {
    /// When the server sent it (our extension).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub timestamp: Option<Timestamp<Server>>,
}

/// Step 4: the robot's own description (paper, figure 2).
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(!try_from))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Object<RawBlock>")]
pub struct InitializationBlock {
    /// Identifies the robot uniquely.
    pub id: RobotId,
    /// For people; unique in one system.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<Label>,
    /// What it is built for.
    #[serde(rename = "type", skip_serializing_if = "Option::is_none")]
    pub robot_type: Option<RobotType>,
    /// Who made it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub manufacture: Option<Label>,
    /// The robot's version.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub version: Option<Label>,
    /// The URRCP version.
    pub api_version: Label,
    /// Whether it sends `Started`, `OK` and `Failed` after `Accepted` (our extension).
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    #[cfg_attr(feature = "schema", schemars(default))]
    pub reports: bool,
    /// What it understands beside JSON, as `msgpack` (our extension).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schemars(default))]
    pub encodings: Vec<Label>,
    /// 1 to 32,000 devices, ids unique.
    #[cfg_attr(feature = "schema", schemars(length(min = 1, max = DEVICES_MAX)))]
    pub devices: Vec<Device>,
}

#[derive(Deserialize)]
struct RawBlock {
    id: RobotId,
    #[serde(default)]
    name: Option<Label>,
    #[serde(default, rename = "type")]
    robot_type: Option<RobotType>,
    #[serde(default)]
    manufacture: Option<Label>,
    #[serde(default)]
    version: Option<Label>,
    api_version: Label,
    #[serde(default)]
    reports: bool,
    #[serde(default)]
    encodings: Vec<Label>,
    devices: Vec<Object<Device>>,
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
        Ok(Self {
            id: raw.id,
            name: raw.name,
            robot_type: raw.robot_type,
            manufacture: raw.manufacture,
            version: raw.version,
            api_version: raw.api_version,
            reports: raw.reports,
            encodings: raw.encodings,
            devices: raw.devices.into_iter().map(|Object(device)| device).collect(),
        })
    }
}

impl InitializationBlock {
    /// The device of that id.
    #[must_use]
    pub fn device(&self, id: &str) -> Option<&Device> {
        self.devices.iter().find(|device| device.id.as_str() == id)
    }

    /// The same robot, which says that it understands this encoding too.
    #[must_use]
    pub fn and_understands(mut self, encoding: Encoding) -> Self {
        if !self.understands(encoding) {
            self.encodings.extend(Label::new(encoding.as_str()));
        }
        self
    }

    /// Whether the robot says that it understands this encoding. JSON it always does.
    #[must_use]
    pub fn understands(&self, encoding: Encoding) -> bool {
        encoding == Encoding::Json || self.encodings.iter().any(|listed| listed.as_str() == encoding.as_str())
    }
}

/// What a robot is built for (paper, table 1; the list is fixed per protocol version).
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RobotType {
    /// For production, as a rule a manipulator.
    Industrial,
    /// For moving goods.
    Transport,
    /// General purpose, like a human.
    Anthropomorphic,
    /// For the military.
    Military,
    /// None of the above.
    Other,
}

/// How a device gets from one script step's value to the next (our extension).
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Interpolation {
    /// The value is set at the step's time and held.
    #[default]
    Hold,
    /// The value moves linearly and arrives at the step's time.
    Linear,
}

/// One device of a robot.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Device {
    /// Unique among the robot's devices.
    pub id: DeviceId,
    /// For people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<Label>,
    /// Of all values of this device (our extension).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<Label>,
    /// The default state; without one: hold the last position, zero speed and acceleration (our extension).
    #[serde(default, with = "number::optional", skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub default_value: Option<f64>,
    /// Between script steps (our extension).
    #[serde(default)]
    pub interpolation: Interpolation,
    /// How many scripts that have not ended the device holds (our extension).
    #[serde(default = "one_script")]
    pub script_queue: u32,
    /// How it can be driven.
    pub available_control_types: ControlTypes,
}

const fn one_script() -> u32 {
    1
}

/// Control types with their parameters, each at most once.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ControlTypes(BTreeMap<ControlType, ControlParameters>);

/// The parameters of one control type.
#[derive(Clone, Debug, PartialEq)]
pub enum ControlParameters {
    /// Of position, speed and acceleration.
    Motion(Limits),
    /// Of script.
    Script(ScriptParameters),
    /// Of sensor.
    Sensor(SensorParameters),
    /// Of custom_N: its own.
    Custom(Map<String, Value>),
}

/// Bounds of a control signal, in the device's unit (paper, table 3).
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(!try_from))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Object<RawLimits>")]
pub struct Limits {
    /// Smallest value that the device can take.
    #[serde(with = "number")]
    #[cfg_attr(feature = "schema", schemars(with = "f64"))]
    pub min_value: f64,
    /// Largest value that the device can take.
    #[serde(with = "number")]
    #[cfg_attr(feature = "schema", schemars(with = "f64"))]
    pub max_value: f64,
    /// Smallest step; above 0. Values are multiples of it, counted from zero.
    #[serde(with = "number")]
    #[cfg_attr(feature = "schema", schemars(with = "f64", extend("exclusiveMinimum" = 0)))]
    pub granularity: f64,
    /// Largest error by construction or conditions of use.
    #[serde(with = "number::optional", skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>", range(min = 0)))]
    pub max_error: Option<f64>,
}

#[derive(Deserialize)]
struct RawLimits {
    #[serde(with = "number")]
    min_value: f64,
    #[serde(with = "number")]
    max_value: f64,
    #[serde(with = "number")]
    granularity: f64,
    #[serde(default, with = "number::optional")]
    max_error: Option<f64>,
}

impl TryFrom<Object<RawLimits>> for Limits {
    type Error = LimitError;

    fn try_from(Object(raw): Object<RawLimits>) -> Result<Self, LimitError> {
        check_range(raw.min_value, raw.max_value)?;
        check_not_negative("max_error", raw.max_error)?;
        // Finite already, so the comparison decides.
        if raw.granularity <= 0.0 {
            return Err(LimitError::Granularity { granularity: raw.granularity });
        }
        let RawLimits { min_value, max_value, granularity, max_error } = raw;
        Ok(Self { min_value, max_value, granularity, max_error })
    }
}

fn check_range(min: f64, max: f64) -> Result<(), LimitError> {
    match min <= max {
        true => Ok(()),
        false => Err(LimitError::EmptyRange { min, max }),
    }
}

fn check_not_negative(key: &'static str, value: Option<f64>) -> Result<(), LimitError> {
    match value {
        Some(value) if value < 0.0 => Err(LimitError::Negative { key, value }),
        _ => Ok(()),
    }
}

/// How far, in steps, a value may lie off the grid through rounding of decimal text.
const GRID_TOLERANCE: f64 = 1e-6;

impl Limits {
    /// Whether the value lies within min_value to max_value.
    #[must_use]
    pub fn contains(&self, value: f64) -> bool {
        value >= self.min_value && value <= self.max_value
    }

    /// Whether the value is a multiple of the granularity, but for the rounding of decimal text.
    #[must_use]
    pub fn on_grid(&self, value: f64) -> bool {
        let steps = value / self.granularity;
        (steps - steps.round()).abs() <= GRID_TOLERANCE
    }

    /// The multiple of the granularity nearest to the value.
    #[must_use]
    pub fn nearest(&self, value: f64) -> f64 {
        (value / self.granularity).round() * self.granularity
    }

    fn check(&self, control_type: ControlType, value: f64) -> Result<(), ControlError> {
        if !self.contains(value) {
            let message =
                format!("{control_type} {value}, expected {} to {}", self.min_value, self.max_value);
            return Err(ControlError::new(ErrorCode::OutOfRange, message));
        }
        if !self.on_grid(value) {
            let message = format!("{control_type} {value}, expected a multiple of {}", self.granularity);
            return Err(ControlError::new(ErrorCode::OffGranularity, message));
        }
        Ok(())
    }
}

/// What a script adds to the parameters that it inherits.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScriptParameters {
    /// Inherited from the control type that the script supports.
    #[serde(flatten)]
    pub limits: Limits,
    /// Largest number of steps in one script.
    pub max_number_of_steps: u32,
    /// Control types that steps may use; without it all of the device but script and sensor (our extension).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub control_types: Option<Vec<ControlType>>,
}

/// Properties of a sensor (paper, table 4).
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(!try_from))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Object<RawSensor>")]
pub struct SensorParameters {
    /// Smallest reading.
    #[serde(with = "number")]
    #[cfg_attr(feature = "schema", schemars(with = "f64"))]
    pub min_value: f64,
    /// Largest reading.
    #[serde(with = "number")]
    #[cfg_attr(feature = "schema", schemars(with = "f64"))]
    pub max_value: f64,
    /// Largest error of a reading.
    #[serde(with = "number::optional", skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>", range(min = 0)))]
    pub max_error: Option<f64>,
    /// Largest latency in milliseconds.
    #[serde(with = "number::optional", skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>", range(min = 0)))]
    pub max_delay: Option<f64>,
}

#[derive(Deserialize)]
struct RawSensor {
    #[serde(with = "number")]
    min_value: f64,
    #[serde(with = "number")]
    max_value: f64,
    #[serde(default, with = "number::optional")]
    max_error: Option<f64>,
    #[serde(default, with = "number::optional")]
    max_delay: Option<f64>,
}

impl TryFrom<Object<RawSensor>> for SensorParameters {
    type Error = LimitError;

    fn try_from(Object(raw): Object<RawSensor>) -> Result<Self, LimitError> {
        check_range(raw.min_value, raw.max_value)?;
        check_not_negative("max_error", raw.max_error)?;
        check_not_negative("max_delay", raw.max_delay)?;
        let RawSensor { min_value, max_value, max_error, max_delay } = raw;
        Ok(Self { min_value, max_value, max_error, max_delay })
    }
}

impl ControlTypes {
    /// The parameters of a control type, if the device has it.
    #[must_use]
    pub fn get(&self, control_type: ControlType) -> Option<&ControlParameters> {
        self.0.get(&control_type)
    }

    /// The bounds of position, speed or acceleration.
    #[must_use]
    pub fn limits(&self, control_type: ControlType) -> Option<&Limits> {
        match self.get(control_type)? {
            ControlParameters::Motion(limits) => Some(limits),
            _ => None,
        }
    }

    /// The parameters of script, if the device takes scripts.
    #[must_use]
    pub fn script(&self) -> Option<&ScriptParameters> {
        match self.get(ControlType::Script)? {
            ControlParameters::Script(script) => Some(script),
            _ => None,
        }
    }

    /// The parameters of sensor, if the device is one.
    #[must_use]
    pub fn sensor(&self) -> Option<&SensorParameters> {
        match self.get(ControlType::Sensor)? {
            ControlParameters::Sensor(sensor) => Some(sensor),
            _ => None,
        }
    }

    /// All of them, in the order of [`ControlType`].
    pub fn iter(&self) -> impl Iterator<Item = (ControlType, &ControlParameters)> {
        self.0.iter().map(|(control_type, parameters)| (*control_type, parameters))
    }
}

impl Device {
    /// The control type that plain values mean: the first of position, speed, acceleration, custom_N.
    #[must_use]
    pub fn primary_control_type(&self) -> Option<ControlType> {
        let mut types = self.available_control_types.iter().map(|(control_type, _)| control_type);
        types.find(|t| !matches!(t, ControlType::Script | ControlType::Sensor))
    }

    /// A stop must not lead where no command may.
    fn check_default(&self) -> Result<(), LimitError> {
        let limits =
            self.primary_control_type().and_then(|primary| self.available_control_types.limits(primary));
        match (self.default_value, limits) {
            (Some(value), Some(limits)) if !limits.contains(value) => Err(LimitError::DefaultValue {
                id: self.id.to_string(),
                value,
                min: limits.min_value,
                max: limits.max_value,
            }),
            _ => Ok(()),
        }
    }

    /// The control types that a script of this device may use; empty without scripts.
    #[must_use]
    pub fn script_control_types(&self) -> Vec<ControlType> {
        let Some(script) = self.available_control_types.script() else { return Vec::new() };
        let all = self.available_control_types.iter().map(|(control_type, _)| control_type);
        all.filter(|t| !matches!(t, ControlType::Script | ControlType::Sensor))
            .filter(|t| script.control_types.as_ref().is_none_or(|listed| listed.contains(t)))
            .collect()
    }

    /// Checks a setpoint against the parameters of its control type.
    ///
    /// # Errors
    /// `unsupported_control_type`, `out_of_range` or `off_granularity`.
    pub fn check(&self, setpoint: &Setpoint) -> Result<(), ControlError> {
        match self.available_control_types.get(setpoint.control_type) {
            Some(ControlParameters::Motion(limits)) if setpoint.more.is_empty() => {
                limits.check(setpoint.control_type, setpoint.value)
            }
            Some(ControlParameters::Motion(_)) => Err(ControlError::new(
                ErrorCode::Malformed,
                format!("{} takes one value, found {}", setpoint.control_type, setpoint.more.len() + 1),
            )),
            Some(ControlParameters::Custom(_)) => Ok(()),
            _ => Err(self.unsupported(setpoint.control_type)),
        }
    }

    /// Checks a setpoint as a script step: against its control type and what the script inherits.
    ///
    /// # Errors
    /// As [`Device::check`].
    pub fn check_in_script(&self, setpoint: &Setpoint) -> Result<(), ControlError> {
        let Some(script) = self.available_control_types.script() else {
            return Err(self.unsupported(ControlType::Script));
        };
        let listed = script.control_types.as_ref();
        if listed.is_some_and(|types| !types.contains(&setpoint.control_type)) {
            return Err(self.unsupported(setpoint.control_type));
        }
        self.check(setpoint)?;
        match setpoint.control_type {
            ControlType::Custom(_) => Ok(()),
            control_type => script.limits.check(control_type, setpoint.value),
        }
    }

    fn unsupported(&self, control_type: ControlType) -> ControlError {
        let known: Vec<_> = self.available_control_types.iter().map(|(t, _)| t.to_string()).collect();
        ControlError::new(
            ErrorCode::UnsupportedControlType,
            format!("`{}` does not support {control_type}, it has {}", self.id, known.join(", ")),
        )
    }
}

impl Serialize for ControlTypes {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(&self.0)
    }
}

impl Serialize for ControlParameters {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Motion(limits) => limits.serialize(serializer),
            Self::Script(script) => script.serialize(serializer),
            Self::Sensor(sensor) => sensor.serialize(serializer),
            Self::Custom(parameters) => parameters.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for ControlTypes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(ControlTypesVisitor)
    }
}

struct ControlTypesVisitor;

impl<'de> Visitor<'de> for ControlTypesVisitor {
    type Value = ControlTypes;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a dictionary from control type to its parameters")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<ControlTypes, A::Error> {
        let mut types = BTreeMap::new();
        while let Some(control_type) = map.next_key::<ControlType>()? {
            let parameters = match control_type {
                ControlType::Script => ControlParameters::Script(map.next_value()?),
                ControlType::Sensor => ControlParameters::Sensor(map.next_value()?),
                ControlType::Custom(_) => ControlParameters::Custom(map.next_value::<Parameters>()?.0),
                _ => ControlParameters::Motion(map.next_value()?),
            };
            if types.insert(control_type, parameters).is_some() {
                return Err(de::Error::custom(format!("duplicate control type `{control_type}`")));
            }
        }
        Ok(ControlTypes(types))
    }
}
