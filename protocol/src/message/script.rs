//! Setpoints, and the script: many of them in one command.

use std::fmt;
use std::sync::Arc;

use serde::de::{self, IgnoredAny, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::StopCondition;
use crate::control_type::ControlType;
use crate::limits::{CONTROL_VALUES_MAX, LimitError};
use crate::number;
use crate::time::{Millis, Span};

/// One control type with its values, in the device's unit.
#[derive(Clone, Debug, PartialEq)]
pub struct Setpoint {
    /// position, speed, acceleration or custom_N.
    pub control_type: ControlType,
    /// `control_value`.
    pub value: f64,
    /// `control_value_2` ... `control_value_N`.
    pub more: Box<[f64]>,
}

impl Setpoint {
    /// A setpoint of one value.
    #[must_use]
    pub fn new(control_type: ControlType, value: f64) -> Self {
        Self { control_type, value, more: Box::default() }
    }

    /// All values, the first included.
    pub fn values(&self) -> impl Iterator<Item = f64> + '_ {
        std::iter::once(self.value).chain(self.more.iter().copied())
    }
}

/// One step of a script.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// When, from the script's own start.
    pub offset: Millis,
    /// What to set.
    pub setpoint: Setpoint,
    /// Overrides the script's lease while this step is the current one.
    pub stop_condition: Option<StopCondition>,
}

/// Steps in order of time. Without steps it cancels. Clones share their steps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script(Arc<[Step]>);

impl Script {
    /// Takes steps whose offsets do not decrease.
    ///
    /// # Errors
    /// [`LimitError::StepsOutOfOrder`] names the first step that is earlier than the one ahead of it.
    pub fn new(steps: Vec<Step>) -> Result<Self, LimitError> {
        let fall = steps.windows(2).position(|pair| pair[1].offset < pair[0].offset);
        match fall {
            None => Ok(Self(steps.into())),
            Some(i) => Err(LimitError::StepsOutOfOrder {
                step: i + 1,
                millis: steps[i + 1].offset.get(),
                previous: steps[i].offset.get(),
            }),
        }
    }

    /// The empty script, which cancels what is scheduled to start at its own start or later.
    #[must_use]
    pub fn cancel() -> Self {
        Self::default()
    }

    /// The steps in order.
    #[must_use]
    pub fn steps(&self) -> &[Step] {
        &self.0
    }

    /// Whether it cancels instead of moving.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// From its start to its last step.
    #[must_use]
    pub fn duration(&self) -> Span {
        self.0.last().map_or(Span::ZERO, |step| step.offset.span())
    }
}

impl Serialize for Script {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter())
    }
}

impl<'de> Deserialize<'de> for Script {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::new(Vec::deserialize(deserializer)?).map_err(de::Error::custom)
    }
}

/// Writes a number in its one canonical text.
pub(super) struct Number(pub(super) f64);

impl Serialize for Number {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        number::serialize(&self.0, serializer)
    }
}

/// Writes `control_value` and the further values of a setpoint.
pub(super) fn serialize_values<M: SerializeMap>(setpoint: &Setpoint, map: &mut M) -> Result<(), M::Error> {
    map.serialize_entry("control_value", &Number(setpoint.value))?;
    for (i, value) in setpoint.more.iter().enumerate() {
        map.serialize_entry(&format!("control_value_{}", i + 2), &Number(*value))?;
    }
    Ok(())
}

/// Collects `control_value_2` ... in any order.
#[derive(Default)]
pub(super) struct FurtherValues(Vec<Option<f64>>);

impl FurtherValues {
    /// The N of the key `control_value_N`, counted from 2, if it is one.
    pub(super) fn index<E: de::Error>(key: &str) -> Result<Option<usize>, E> {
        let Some(digits) = key.strip_prefix("control_value_") else { return Ok(None) };
        match digits.parse::<usize>() {
            Ok(n) if (2..=CONTROL_VALUES_MAX).contains(&n) && !digits.starts_with('0') => Ok(Some(n - 2)),
            _ => Err(E::custom(format!(
                "key `{key}`, expected control_value_2 to control_value_{CONTROL_VALUES_MAX}"
            ))),
        }
    }

    pub(super) fn put<E: de::Error>(&mut self, index: usize, value: f64) -> Result<(), E> {
        if self.0.len() <= index {
            self.0.resize(index + 1, None);
        }
        match self.0[index].replace(number::finite(value)?) {
            None => Ok(()),
            Some(_) => Err(E::custom(format!("duplicate field `control_value_{}`", index + 2))),
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(super) fn finish<E: de::Error>(self) -> Result<Box<[f64]>, E> {
        let missing = self.0.iter().position(Option::is_none);
        match missing {
            None => Ok(self.0.into_iter().flatten().collect()),
            Some(i) => Err(E::custom(format!("missing field `control_value_{}`", i + 2))),
        }
    }
}

/// Sets a field once.
pub(super) fn set_once<T, E: de::Error>(slot: &mut Option<T>, key: &'static str, value: T) -> Result<(), E> {
    match slot.replace(value) {
        None => Ok(()),
        Some(_) => Err(E::duplicate_field(key)),
    }
}

impl Serialize for Step {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
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

impl<'de> Deserialize<'de> for Step {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(StepVisitor)
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
        while let Some(key) = map.next_key::<std::borrow::Cow<'_, str>>()? {
            match key.as_ref() {
                "time_offset_to_start" => {
                    set_once(&mut offset, "time_offset_to_start", map.next_value()?)?;
                }
                "control_type" => set_once(&mut control_type, "control_type", map.next_value()?)?,
                "control_value" => {
                    let number = number::finite(map.next_value::<f64>()?)?;
                    set_once(&mut value, "control_value", number)?;
                }
                "stop_condition" => {
                    set_once(&mut stop_condition, "stop_condition", map.next_value()?)?;
                }
                other => match FurtherValues::index(other)? {
                    Some(index) => more.put(index, map.next_value()?)?,
                    None => drop(map.next_value::<IgnoredAny>()?),
                },
            }
        }
        let control_type = control_type.ok_or_else(|| de::Error::missing_field("control_type"))?;
        if matches!(control_type, ControlType::Script | ControlType::Sensor) {
            return Err(de::Error::custom(format!(
                "control type `{control_type}` in a script step, expected position, speed, acceleration or custom_N"
            )));
        }
        let setpoint = Setpoint {
            control_type,
            value: value.ok_or_else(|| de::Error::missing_field("control_value"))?,
            more: more.finish()?,
        };
        let offset = offset.ok_or_else(|| de::Error::missing_field("time_offset_to_start"))?;
        Ok(Step { offset, setpoint, stop_condition: stop_condition.flatten() })
    }
}
