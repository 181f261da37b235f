//! A script step: an object with named keys in JSON, or a short list in a binary encoding.

use std::fmt;

use serde::de::{self, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde::ser::{SerializeMap, SerializeSeq};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::script::{FurtherValues, Key, Keys, serialize_values, set_once};
use super::{Setpoint, StopCondition};
use crate::control_type::{ControlType, Short};
use crate::limits::CONTROL_VALUES_MAX;
use crate::number::Number;
use crate::time::Millis;

/// A step of a script: the values that a device sets at a certain time.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Milliseconds from the start of the script.
    pub offset: Millis,
    /// The values that the device sets.
    pub setpoint: Setpoint,
    /// The lease (how long the server may be silent) while this step is the current one. `None`: the lease of the script applies.
    pub stop_condition: Option<StopCondition>,
}

impl Step {
    /// Creates a step without its own lease; the lease of its script applies.
    #[must_use]
    pub const fn new(offset: Millis, setpoint: Setpoint) -> Self {
        Self { offset, setpoint, stop_condition: None }
    }
}

impl Serialize for Step {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if !serializer.is_human_readable() && self.stop_condition.is_none() {
            return self.serialize_short(serializer);
        }
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("time_offset_to_start", &self.offset)?;
        map.serialize_entry("control_type", &self.setpoint.control_type)?;
        serialize_values(&self.setpoint, &mut map)?;
        if let Some(stop_condition) = &self.stop_condition {
            map.serialize_entry("stop_condition", stop_condition)?;
        }
        map.end()
    }
}

impl Step {
    /// Serializes the step in the short form, a list: `[time_offset_to_start, control_type, control_value, ...]`.
    fn serialize_short<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut list = serializer.serialize_seq(Some(SHORT_MIN + self.setpoint.more.len()))?;
        list.serialize_element(&self.offset)?;
        list.serialize_element(&Short(self.setpoint.control_type))?;
        self.setpoint.values().try_for_each(|value| list.serialize_element(&Number(value)))?;
        list.end()
    }

    fn checked<E: de::Error>(self) -> Result<Self, E> {
        match self.setpoint.control_type {
            control_type @ (ControlType::Script | ControlType::Sensor) => Err(E::custom(format!(
                "control type `{control_type}` is not supported in a script step, expected position, speed, acceleration or custom_N"
            ))),
            _ => Ok(self),
        }
    }
}

/// Number of list entries in the short form of a step with one value.
const SHORT_MIN: usize = 3;

impl<'de> Deserialize<'de> for Step {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            deserializer.deserialize_map(StepVisitor)
        } else {
            deserializer.deserialize_any(ShortStepVisitor)
        }
    }
}

/// A visitor that deserializes a step from an object with named keys or from the short form, a list.
struct ShortStepVisitor;

impl<'de> Visitor<'de> for ShortStepVisitor {
    type Value = Step;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a script step, or [time_offset_to_start, control_type, control_value, ...]")
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Step, A::Error> {
        StepVisitor.visit_map(map)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Step, A::Error> {
        let short = |length| de::Error::invalid_length(length, &self);
        let offset = list.next_element()?.ok_or_else(|| short(0))?;
        let Short(control_type) = list.next_element()?.ok_or_else(|| short(1))?;
        let Number(value) = list.next_element()?.ok_or_else(|| short(2))?;
        let mut more = Vec::new();
        while let Some(Number(further)) = list.next_element()? {
            if more.len() + 1 == CONTROL_VALUES_MAX {
                return Err(de::Error::custom(format!(
                    "too many values, expected at most {CONTROL_VALUES_MAX}: control_value to control_value_{CONTROL_VALUES_MAX}"
                )));
            }
            more.push(further);
        }
        let setpoint = Setpoint { control_type, value, more: more.into() };
        Step { offset, setpoint, stop_condition: None }.checked()
    }
}

enum StepKey {
    Offset,
    ControlType,
    Value,
    /// The key `control_value_N`, where N is at least 2.
    Further(usize),
    StopCondition,
    Unknown,
}

impl Keys for StepKey {
    fn named<E: de::Error>(key: &str) -> Result<Self, E> {
        Ok(match key {
            "time_offset_to_start" => Self::Offset,
            "control_type" => Self::ControlType,
            "control_value" => Self::Value,
            "stop_condition" => Self::StopCondition,
            other => FurtherValues::index(other)?.map_or(Self::Unknown, Self::Further),
        })
    }
}

struct StepVisitor;

impl<'de> Visitor<'de> for StepVisitor {
    type Value = Step;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a script step")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Step, A::Error> {
        let (mut offset, mut control_type, mut value, mut stop_condition) = (None, None, None, None);
        let mut more = FurtherValues::default();
        while let Some(key) = map.next_key::<Key<StepKey>>()? {
            match key.0 {
                StepKey::Offset => set_once(&mut offset, "time_offset_to_start", map.next_value()?)?,
                StepKey::ControlType => set_once(&mut control_type, "control_type", map.next_value()?)?,
                StepKey::Value => {
                    let Number(number) = map.next_value()?;
                    set_once(&mut value, "control_value", number)?;
                }
                StepKey::StopCondition => {
                    set_once(&mut stop_condition, "stop_condition", map.next_value()?)?;
                }
                StepKey::Further(index) => more.put(index, map.next_value()?)?,
                StepKey::Unknown => drop(map.next_value::<IgnoredAny>()?),
            }
        }
        let control_type = control_type.ok_or_else(|| de::Error::missing_field("control_type"))?;
        let setpoint = Setpoint {
            control_type,
            value: value.ok_or_else(|| de::Error::missing_field("control_value"))?,
            more: more.finish()?,
        };
        let offset = offset.ok_or_else(|| de::Error::missing_field("time_offset_to_start"))?;
        Step { offset, setpoint, stop_condition: stop_condition.flatten() }.checked()
    }
}
