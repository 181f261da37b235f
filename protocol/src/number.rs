//! Serializes and deserializes numbers. They are finite, and integers are written without a fraction.

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// Largest integer that a double holds exactly, 2^53.
const EXACT_INTEGER_MAX: f64 = 9_007_199_254_740_992.0;

/// Writes `45` for 45.0 and `0` for -0.0, so that each value has exactly one text. A binary encoding uses a four-byte float if it
/// represents the value exactly.
pub(crate) fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    if value.fract() == 0.0 && value.abs() <= EXACT_INTEGER_MAX {
        #[expect(clippy::cast_possible_truncation, reason = "an integer within 2^53")]
        return serializer.serialize_i64(*value as i64);
    }
    #[expect(clippy::cast_possible_truncation, reason = "compared with what was meant")]
    let short = *value as f32;
    if !serializer.is_human_readable() && f64::from(short) == *value {
        return serializer.serialize_f32(short);
    }
    serializer.serialize_f64(*value)
}

/// Deserializes a number; an error if it is not finite as a double.
pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Number::deserialize(deserializer).map(|number| number.0)
}

/// A finite number, which is serialized in its canonical form.
#[derive(Clone, Copy)]
pub(crate) struct Number(pub(crate) f64);

impl Serialize for Number {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serialize(&self.0, serializer)
    }
}

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            deserializer.deserialize_f64(AnyNumber)
        } else {
            // A binary encoding has several kinds of numbers; all are accepted.
            deserializer.deserialize_any(AnyNumber)
        }
    }
}

struct AnyNumber;

impl de::Visitor<'_> for AnyNumber {
    type Value = Number;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number")
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<Number, E> {
        finite(value).map(Number)
    }

    #[expect(clippy::cast_precision_loss, reason = "the protocol's numbers are doubles")]
    fn visit_u64<E: de::Error>(self, value: u64) -> Result<Number, E> {
        Ok(Number(value as f64))
    }

    #[expect(clippy::cast_precision_loss, reason = "the protocol's numbers are doubles")]
    fn visit_i64<E: de::Error>(self, value: i64) -> Result<Number, E> {
        Ok(Number(value as f64))
    }
}

pub(crate) fn finite<E: de::Error>(value: f64) -> Result<f64, E> {
    if value.is_finite() { Ok(value) } else { Err(E::custom(crate::LimitError::NotFinite)) }
}

/// Serialization of a number that may be omitted or null.
pub(crate) mod optional {
    use super::{Deserialize, Deserializer, Number, Serializer};

    pub(crate) fn serialize<S: Serializer>(value: &Option<f64>, s: S) -> Result<S::Ok, S::Error> {
        match value {
            Some(value) => super::serialize(value, s),
            None => s.serialize_none(),
        }
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<Option<f64>, D::Error> {
        Ok(Option::<Number>::deserialize(d)?.map(|number| number.0))
    }
}
