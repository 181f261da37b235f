//! A device of a robot, and the commands that it accepts.

use serde::{Deserialize, Deserializer, Serialize};

use super::Setpoint;
use super::channels::Channels;
use super::control_types::{ControlParameters, ControlTypes, Limits, ScriptParameters, SensorParameters};
use super::growth::Word;
use super::latency::{self, Latency};
use crate::control_type::ControlType;
use crate::error::{ControlError, ErrorCode};
#[cfg(feature = "schema")]
use crate::limits::LATENCY_MS_MAX;
use crate::limits::LimitError;
use crate::number;
use crate::text::{DeviceId, Label};
use crate::time::Span;

/// How a device moves from the value of one script step to the next (our extension).
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Interpolation {
    /// The device sets the value at the step's time and holds it.
    #[default]
    Hold,
    /// The device moves linearly and reaches the value at the step's time.
    Linear,
}

/// A device of a robot, as its robot describes it.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Device {
    /// The id of the device, unique within the robot.
    pub id: DeviceId,
    /// The name of the device, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<Label>,
    /// The unit of all values of the device (our extension).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<Label>,
    /// The value of the device in its default state (our extension). `None`: the default state is the last position, which the device
    /// holds.
    #[serde(default, with = "number::optional", skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub default_value: Option<f64>,
    /// How the device moves between script steps (our extension).
    #[serde(default, deserialize_with = "interpolation")]
    pub interpolation: Interpolation,
    /// Maximum number of scripts that the device holds at a time, pending or running (our extension).
    #[serde(default = "one_script")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub script_queue: u32,
    /// Actuation latency: the median time from passing a value to the device until the first visible motion (our extension). `None`: the
    /// robot declares no latency.
    #[serde(default, with = "latency::wire", skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>", range(min = 0, max = LATENCY_MS_MAX)))]
    pub latency: Option<Span>,
    /// Spread of the latency: 95 % of all trials are within `latency` ± `latency_spread` (our extension). Requires `latency`.
    #[serde(default, with = "latency::wire", skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>", range(min = 0, max = LATENCY_MS_MAX)))]
    pub latency_spread: Option<Span>,
    /// The device's channels, for a robot that is a DMX fixture (our extension).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub channel: Option<Channels>,
    /// The control types by which the device can be driven or read.
    pub available_control_types: ControlTypes,
}

/// Deserializes an interpolation. A message may contain one of a later version, for which the default applies in this one.
fn interpolation<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Interpolation, D::Error> {
    Ok(match Word::deserialize(deserializer)? {
        Word::Known(known) => known,
        Word::Later => Interpolation::default(),
    })
}

const fn one_script() -> u32 {
    1
}

impl Device {
    /// Creates a device without control types; add them with `with_...`. By default the device holds its value between script steps, and
    /// its script queue has room for one script. Set the other fields as needed.
    ///
    /// ```
    /// use urrcp::{Device, DeviceId, Interpolation, Limits, ScriptParameters};
    ///
    /// let degrees = Limits::new(-180.0, 180.0, 0.1)?;
    /// let mut joint = Device::new(DeviceId::new("elbow")?)
    ///     .with_position(degrees.clone())
    ///     .with_scripts(ScriptParameters::new(degrees, 1_000));
    /// joint.interpolation = Interpolation::Linear;
    /// # Ok::<(), urrcp::LimitError>(())
    /// ```
    #[must_use]
    pub fn new(id: DeviceId) -> Self {
        Self {
            id,
            name: None,
            unit: None,
            default_value: None,
            interpolation: Interpolation::Hold,
            script_queue: one_script(),
            latency: None,
            latency_spread: None,
            channel: None,
            available_control_types: ControlTypes::default(),
        }
    }

    /// Returns this device with the control type `position` within `limits`.
    #[must_use]
    pub fn with_position(self, limits: Limits) -> Self {
        self.with(ControlType::Position, ControlParameters::Motion(limits))
    }

    /// Returns this device with the control type `speed` within `limits`.
    #[must_use]
    pub fn with_speed(self, limits: Limits) -> Self {
        self.with(ControlType::Speed, ControlParameters::Motion(limits))
    }

    /// Returns this device with the control type `acceleration` within `limits`. A device with linear interpolation uses the limits to
    /// slow down on a stop.
    #[must_use]
    pub fn with_acceleration(self, limits: Limits) -> Self {
        self.with(ControlType::Acceleration, ControlParameters::Motion(limits))
    }

    /// Returns this device with the control type `script`.
    #[must_use]
    pub fn with_scripts(self, parameters: ScriptParameters) -> Self {
        self.with(ControlType::Script, ControlParameters::Script(parameters))
    }

    /// Returns this device with the control type `sensor`.
    #[must_use]
    pub fn with_sensor(self, parameters: SensorParameters) -> Self {
        self.with(ControlType::Sensor, ControlParameters::Sensor(parameters))
    }

    /// Returns this device with the control type `custom_N`, where N is `number`.
    #[must_use]
    pub fn with_custom(self, number: u32, parameters: serde_json::Map<String, serde_json::Value>) -> Self {
        self.with(ControlType::Custom(number), ControlParameters::Custom(parameters))
    }

    fn with(mut self, control_type: ControlType, parameters: ControlParameters) -> Self {
        self.available_control_types.insert(control_type, parameters);
        self
    }

    /// Returns the first of `position`, `speed`, `acceleration` and `custom_N` that the device supports; `None` if it supports none of
    /// these.
    #[must_use]
    pub fn primary_control_type(&self) -> Option<ControlType> {
        let mut types = self.available_control_types.iter().map(|(control_type, _)| control_type);
        types.find(|t| !matches!(t, ControlType::Script | ControlType::Sensor))
    }

    /// Returns the actuation latency of the device, the time from a command to visible motion; `None` if the robot declares none.
    #[must_use]
    pub fn actuation_latency(&self) -> Option<Latency> {
        Some(Latency { median: self.latency?, spread: self.latency_spread.unwrap_or_default() })
    }

    /// Returns this device with a declared actuation latency, the time from a command to visible motion.
    #[must_use]
    pub const fn with_latency(mut self, latency: Latency) -> Self {
        (self.latency, self.latency_spread) = (Some(latency.median), Some(latency.spread));
        self
    }

    /// Checks that a device with a `latency_spread` also has a `latency`.
    pub(super) fn check_latency(&self) -> Result<(), LimitError> {
        match (self.latency, self.latency_spread) {
            (None, Some(_)) => Err(LimitError::SpreadAlone { id: self.id.to_string() }),
            _ => Ok(()),
        }
    }

    /// Checks that the device can hold at least one script.
    pub(super) const fn check_queue(&self) -> Result<(), LimitError> {
        match self.script_queue {
            0 => Err(LimitError::NoneAtAll { key: "script_queue" }),
            _ => Ok(()),
        }
    }

    /// Checks that the default value is within the limits. Otherwise, a stop could move the device to a position that no command may set.
    pub(super) fn check_default(&self) -> Result<(), LimitError> {
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

    /// Returns the control types that a script for this device may use; empty if the device does not accept scripts.
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

    /// Checks the setpoint of a script step against the parameters of its control type and the limits of scripts.
    ///
    /// # Errors
    /// The same errors as [`Device::check`].
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
            format!("`{}` does not support {control_type}; it supports {}", self.id, known.join(", ")),
        )
    }
}
