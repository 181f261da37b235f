//! The control types by which devices can be driven (paper, table 2).

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::limits::LimitError;

/// The kind of value with which a command drives or reads a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ControlType {
    /// The values are positions.
    Position,
    /// The values are speeds.
    Speed,
    /// The values are accelerations.
    Acceleration,
    /// The values are the steps of a script: a timed sequence of values of other control types.
    Script,
    /// The command requests a sensor reading and moves nothing.
    Sensor,
    /// The control type `custom_N`, whose meaning the robot defines. The number is N.
    Custom(u32),
}

impl fmt::Display for ControlType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Position => f.pad("position"),
            Self::Speed => f.pad("speed"),
            Self::Acceleration => f.pad("acceleration"),
            Self::Script => f.pad("script"),
            Self::Sensor => f.pad("sensor"),
            Self::Custom(n) => write!(f, "custom_{n}"),
        }
    }
}

impl FromStr for ControlType {
    type Err = LimitError;

    fn from_str(name: &str) -> Result<Self, LimitError> {
        match name {
            "position" => Ok(Self::Position),
            "speed" => Ok(Self::Speed),
            "acceleration" => Ok(Self::Acceleration),
            "script" => Ok(Self::Script),
            "sensor" => Ok(Self::Sensor),
            _ => custom_number(name)
                .map(Self::Custom)
                .ok_or_else(|| LimitError::ControlType { name: name.chars().take(64).collect() }),
        }
    }
}

/// Returns the number N of the name `custom_N`; `None` for other names and if the number is not in canonical form, for example with
/// leading zeros.
fn custom_number(name: &str) -> Option<u32> {
    let digits = name.strip_prefix("custom_")?;
    let number: u32 = digits.parse().ok()?;
    (number.to_string() == digits).then_some(number)
}

impl Serialize for ControlType {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for ControlType {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Name;
        impl de::Visitor<'_> for Name {
            type Value = ControlType;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the name of a control type")
            }

            fn visit_str<E: de::Error>(self, name: &str) -> Result<ControlType, E> {
                name.parse().map_err(E::custom)
            }
        }
        deserializer.deserialize_str(Name)
    }
}

/// A control type in the short form of a script step: the index in `NUMBERED`, or the name if it is not listed there.
pub(crate) struct Short(pub(crate) ControlType);

/// The control types that the short form of a step represents by a number: the index in this list.
const NUMBERED: [ControlType; 3] = [ControlType::Position, ControlType::Speed, ControlType::Acceleration];

impl Serialize for Short {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match NUMBERED.iter().zip(0u8..).find(|(numbered, _)| **numbered == self.0) {
            Some((_, number)) => serializer.serialize_u8(number),
            None => self.0.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Short {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NumberOrName;
        impl de::Visitor<'_> for NumberOrName {
            type Value = Short;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the name of a control type, or 0 (position), 1 (speed) or 2 (acceleration)")
            }

            fn visit_u64<E: de::Error>(self, number: u64) -> Result<Short, E> {
                let numbered = usize::try_from(number).ok().and_then(|number| NUMBERED.get(number));
                numbered
                    .map(|control_type| Short(*control_type))
                    .ok_or_else(|| E::invalid_value(de::Unexpected::Unsigned(number), &self))
            }

            fn visit_str<E: de::Error>(self, name: &str) -> Result<Short, E> {
                name.parse().map(Short).map_err(E::custom)
            }
        }
        deserializer.deserialize_any(NumberOrName)
    }
}
