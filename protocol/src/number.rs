//! Numbers on the wire: finite, and written without a fraction where they have none.

use serde::{Deserialize, Deserializer, Serializer, de};

/// Largest integer that a double holds exactly, 2^53.
const EXACT_INTEGER_MAX: f64 = 9_007_199_254_740_992.0;

/// Writes `45` for 45.0 and `0` for -0.0, so that one value has one text.
pub(crate) fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    if value.fract() == 0.0 && value.abs() <= EXACT_INTEGER_MAX {
        #[expect(clippy::cast_possible_truncation, reason = "an integer within 2^53")]
        return serializer.serialize_i64(*value as i64);
    }
    serializer.serialize_f64(*value)
}

/// Reads any JSON or YAML number that a double can hold.
pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    finite(f64::deserialize(deserializer)?)
}

pub(crate) fn finite<E: de::Error>(value: f64) -> Result<f64, E> {
    match value.is_finite() {
        true => Ok(value),
        false => Err(E::custom(crate::LimitError::NotFinite)),
    }
}

/// The same for a number that may be left out or null.
pub(crate) mod optional {
    use super::{Deserialize, Deserializer, Serializer, finite};

    pub(crate) fn serialize<S: Serializer>(value: &Option<f64>, s: S) -> Result<S::Ok, S::Error> {
        match value {
            Some(value) => super::serialize(value, s),
            None => s.serialize_none(),
        }
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<Option<f64>, D::Error> {
        Option::<f64>::deserialize(d)?.map(finite).transpose()
    }
}
