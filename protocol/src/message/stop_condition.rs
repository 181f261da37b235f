//! The lease: how long the server may be silent before a device stops on its own.

use std::fmt;

use serde::de::{self, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::number;
use crate::time::Millis;

/// The lease of a command: how long the server may be silent, in milliseconds, before the device drops its pending commands, ends the
/// running one and comes to rest. A limit of `None` means that the silence is unlimited.
///
/// On the wire, a lease is one number that applies before and after the start, or `{"pending": ms, "running": ms or null}`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StopCondition {
    /// Maximum silence in milliseconds while the command waits for its start.
    pub pending: Option<Millis>,
    /// Maximum silence in milliseconds once the command has started.
    pub running: Option<Millis>,
}

impl StopCondition {
    /// Creates a lease with the same limit before and after the start of the command.
    #[must_use]
    pub const fn both(silence: Millis) -> Self {
        Self { pending: Some(silence), running: Some(silence) }
    }
}

impl Serialize for StopCondition {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match (self.pending, self.running) {
            (Some(pending), Some(running)) if pending == running => pending.serialize(serializer),
            (pending, running) => {
                let mut map = serializer.serialize_map(Some(2))?;
                map.serialize_entry("pending", &pending)?;
                map.serialize_entry("running", &running)?;
                map.end()
            }
        }
    }
}

impl<'de> Deserialize<'de> for StopCondition {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(NumberOrPair)
    }
}

struct NumberOrPair;

fn both<E: de::Error>(millis: f64) -> Result<StopCondition, E> {
    Millis::new(number::finite(millis)?).map(StopCondition::both).map_err(E::custom)
}

impl<'de> Visitor<'de> for NumberOrPair {
    type Value = StopCondition;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("milliseconds, or {\"pending\": milliseconds, \"running\": milliseconds or null}")
    }

    fn visit_f64<E: de::Error>(self, millis: f64) -> Result<StopCondition, E> {
        both(millis)
    }

    #[expect(clippy::cast_precision_loss, reason = "beyond 2^53 it is out of range anyway")]
    fn visit_u64<E: de::Error>(self, millis: u64) -> Result<StopCondition, E> {
        both(millis as f64)
    }

    #[expect(clippy::cast_precision_loss, reason = "beyond 2^53 it is out of range anyway")]
    fn visit_i64<E: de::Error>(self, millis: i64) -> Result<StopCondition, E> {
        both(millis as f64)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<StopCondition, A::Error> {
        #[derive(Deserialize)]
        struct Pair {
            #[serde(default)]
            pending: Option<Millis>,
            #[serde(default)]
            running: Option<Millis>,
        }
        let pair = Pair::deserialize(de::value::MapAccessDeserializer::new(map))?;
        Ok(StopCondition { pending: pair.pending, running: pair.running })
    }
}
