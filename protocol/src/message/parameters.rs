//! The parameters of a custom control type: any JSON within a size limit.

use std::cell::Cell;
use std::fmt;

use serde::de::{self, DeserializeSeed, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::{Map, Number, Value};

use crate::limits::{LimitError, PARAMETERS_MAX};
use crate::text::check_length;

thread_local! {
    /// Maximum total number of values in the dictionaries that this thread has yet to read.
    static ROOM: Cell<usize> = const { Cell::new(usize::MAX) };
}

/// Calls `read` and limits the values in all dictionaries that it deserializes to `values` in total. Without this limit, many
/// dictionaries could take too much memory.
pub(super) fn together<T>(values: usize, read: impl FnOnce() -> T) -> T {
    let before = ROOM.replace(values);
    let read = read();
    ROOM.set(before);
    read
}

/// A dictionary with finite numbers and at most [`PARAMETERS_MAX`] values in total.
pub(super) struct Parameters(pub(super) Map<String, Value>);

impl<'de> Deserialize<'de> for Parameters {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // The dictionary itself counts as one value.
        let (own, together) = (PARAMETERS_MAX + 1, ROOM.get());
        let mut room = own.min(together);
        let beyond =
            if together < own { LimitError::RobotParameterCount } else { LimitError::ParameterCount };
        let read = AnyValue { room: &mut room, beyond: &beyond }.deserialize(deserializer)?;
        ROOM.set(together - (own.min(together) - room));
        match read {
            Value::Object(parameters) => Ok(Self(parameters)),
            _ => Err(de::Error::custom("invalid parameters of a custom control type, expected a dictionary")),
        }
    }
}

/// A visitor that deserializes a value including its nested values, within a size limit.
struct AnyValue<'a> {
    /// Number of values that may still be read.
    room: &'a mut usize,
    /// The error to return if there are more than `room` values.
    beyond: &'a LimitError,
}

impl<'de> DeserializeSeed<'de> for AnyValue<'_> {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        *self.room = self.room.checked_sub(1).ok_or_else(|| de::Error::custom(self.beyond))?;
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for AnyValue<'_> {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("null, a boolean, a number, a string, a list or a dictionary")
    }

    fn visit_unit<E: de::Error>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E: de::Error>(self, value: bool) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_i64<E: de::Error>(self, value: i64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_u64<E: de::Error>(self, value: u64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<Value, E> {
        Number::from_f64(value).map(Value::Number).ok_or_else(|| E::custom(LimitError::NotFinite))
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<Value, E> {
        check_length(text).map_err(E::custom)?;
        Ok(text.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Value, A::Error> {
        let mut values = Vec::new();
        while let Some(value) =
            list.next_element_seed(AnyValue { room: &mut *self.room, beyond: self.beyond })?
        {
            values.push(value);
        }
        Ok(values.into())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Value, A::Error> {
        let mut values = Map::new();
        while let Some(key) = map.next_key::<String>()? {
            check_length(&key).map_err(de::Error::custom)?;
            values.insert(key, map.next_value_seed(AnyValue { room: &mut *self.room, beyond: self.beyond })?);
        }
        Ok(values.into())
    }
}
