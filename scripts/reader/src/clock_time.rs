//! Instants and times of day, as users write them.

use serde::Deserialize;
use serde::de::IntoDeserializer;
use serde::de::value::{Error, StrDeserializer};
use urrcp::{Server, Span, Timestamp};

/// Parses an instant in RFC 3339 format.
pub fn parse_instant(text: &str) -> Option<Timestamp<Server>> {
    let deserializer: StrDeserializer<'_, Error> = text.into_deserializer();
    Timestamp::deserialize(deserializer).ok()
}

/// Parses a time of day, `19:30` or `19:30:00.5`, as the time since midnight.
pub fn parse_time_of_day(text: &str) -> Option<Span> {
    let parts: Vec<_> = text.split(':').collect();
    let (hour, minute, second) = match parts.as_slice() {
        [hour, minute] => (*hour, *minute, "0"),
        [hour, minute, second] => (*hour, *minute, *second),
        _ => return None,
    };
    let hour = hour.parse::<u8>().ok().filter(|hour| *hour < 24)?;
    let minute = minute.parse::<u8>().ok().filter(|minute| *minute < 60)?;
    let second = second.parse::<f64>().ok().filter(|second| *second >= 0.0 && *second < 60.0)?;
    let minutes = i64::from(hour) * 60 + i64::from(minute);
    Some(Span::from_millis(minutes * 60_000) + Span::from_millis_f64(second * 1_000.0))
}
