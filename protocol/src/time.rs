//! Instants, spans (signed durations) and offsets. The type of an instant names its clock, so that instants of different clocks cannot be
//! mixed.
//!
//! ```compile_fail
//! use urrcp::{Robot, Server, Span, Timestamp};
//! fn lateness(planned: Timestamp<Server>, started: Timestamp<Robot>) -> Span {
//!     started - planned // two clocks: one must be translated first
//! }
//! ```

use std::cmp::Ordering;
use std::fmt;
use std::hash::{Hash, Hasher};
use std::marker::PhantomData;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};
use std::time::Duration;

use chrono::{DateTime, SecondsFormat, Utc};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::limits::{LimitError, OFFSET_MS_MAX};
use crate::number;

/// The control server's clock, disciplined by NTP.
#[derive(Clone, Copy, Debug)]
pub enum Server {}

/// A robot's own clock: disciplined by NTP if the robot uses NTP.
#[derive(Clone, Copy, Debug)]
pub enum Robot {}

/// A signed duration in nanoseconds, up to 292 years in either direction. Arithmetic saturates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Span(i64);

impl Span {
    /// Zero duration.
    pub const ZERO: Self = Self(0);
    /// The longest span.
    pub const MAX: Self = Self(i64::MAX);

    /// Creates a span from nanoseconds.
    #[must_use]
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// Creates a span from microseconds, saturating.
    #[must_use]
    pub const fn from_micros(micros: i64) -> Self {
        Self(micros.saturating_mul(1_000))
    }

    /// Creates a span from milliseconds, saturating.
    #[must_use]
    pub const fn from_millis(millis: i64) -> Self {
        Self(millis.saturating_mul(1_000_000))
    }

    /// Creates a span from fractional milliseconds, rounded to the nearest nanosecond. Saturates if it is out of range; NaN gives zero.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "`as` saturates and maps NaN to 0")]
    #[expect(clippy::cast_precision_loss, reason = "what was a whole f64 is one again")]
    pub fn from_millis_f64(millis: f64) -> Self {
        let nanos = millis * 1e6;
        // Like `f64::round`, which calls the mathematics library if the processor may lack a rounding instruction.
        let whole = nanos as i64;
        let rest = nanos - whole as f64;
        Self(whole.saturating_add(i64::from(rest >= 0.5) - i64::from(rest <= -0.5)))
    }

    /// Returns the nanoseconds.
    #[must_use]
    pub const fn as_nanos(self) -> i64 {
        self.0
    }

    /// Returns the milliseconds.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "exact up to 104 days, else rounded")]
    pub fn as_millis_f64(self) -> f64 {
        self.0 as f64 / 1e6
    }

    /// Returns the absolute value of the span.
    #[must_use]
    pub const fn abs(self) -> Self {
        Self(self.0.saturating_abs())
    }

    /// Converts to an unsigned duration; zero if negative.
    #[must_use]
    pub fn to_duration(self) -> Duration {
        Duration::from_nanos(u64::try_from(self.0).unwrap_or(0))
    }
}

impl From<Duration> for Span {
    fn from(duration: Duration) -> Self {
        Self(i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX))
    }
}

impl Add for Span {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

impl AddAssign for Span {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Span {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }
}

impl Neg for Span {
    type Output = Self;
    fn neg(self) -> Self {
        Self(self.0.saturating_neg())
    }
}

impl Mul<i64> for Span {
    type Output = Self;
    fn mul(self, factor: i64) -> Self {
        Self(self.0.saturating_mul(factor))
    }
}

impl Div<i64> for Span {
    type Output = Self;
    fn div(self, divisor: i64) -> Self {
        Self(self.0.checked_div(divisor).unwrap_or(i64::MAX))
    }
}

impl fmt::Display for Span {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let millis = self.as_millis_f64();
        let text = match millis.abs() {
            m if m >= 1_000.0 => format!("{} s", rounded(millis / 1_000.0)),
            m if m >= 1.0 || m == 0.0 => format!("{} ms", rounded(millis)),
            _ => format!("{} us", rounded(millis * 1_000.0)),
        };
        f.pad(&text)
    }
}

fn rounded(value: f64) -> f64 {
    (value * 1_000.0).round() / 1_000.0
}

impl Serialize for Span {
    /// Serializes the span as a number of milliseconds.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        number::serialize(&self.as_millis_f64(), serializer)
    }
}

impl<'de> Deserialize<'de> for Span {
    /// Deserializes a span from a number of milliseconds.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        number::deserialize(deserializer).map(Self::from_millis_f64)
    }
}

/// An instant by the clock `C`: nanoseconds since 1970-01-01T00:00:00Z without leap seconds.
pub struct Timestamp<C> {
    nanos: i64,
    clock: PhantomData<fn() -> C>,
}

impl<C> Timestamp<C> {
    /// Creates a timestamp from nanoseconds since the Unix epoch.
    #[must_use]
    pub const fn from_nanos(nanos: i64) -> Self {
        Self { nanos, clock: PhantomData }
    }

    /// Returns the nanoseconds since the Unix epoch.
    #[must_use]
    pub const fn as_nanos(self) -> i64 {
        self.nanos
    }

    /// Reinterprets the timestamp as a reading of the clock `D`. This is valid only if NTP disciplines both clocks, or if the offset
    /// between them has already been added.
    #[must_use]
    pub const fn assume_clock<D>(self) -> Timestamp<D> {
        Timestamp::from_nanos(self.nanos)
    }
}

impl<C> Clone for Timestamp<C> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<C> Copy for Timestamp<C> {}

impl<C> PartialEq for Timestamp<C> {
    fn eq(&self, other: &Self) -> bool {
        self.nanos == other.nanos
    }
}

impl<C> Eq for Timestamp<C> {}

impl<C> PartialOrd for Timestamp<C> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<C> Ord for Timestamp<C> {
    fn cmp(&self, other: &Self) -> Ordering {
        self.nanos.cmp(&other.nanos)
    }
}

impl<C> Hash for Timestamp<C> {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.nanos.hash(state);
    }
}

impl<C> fmt::Debug for Timestamp<C> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl<C> fmt::Display for Timestamp<C> {
    /// Formats the instant as RFC 3339 in UTC with nine fractional digits.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let utc: DateTime<Utc> = DateTime::from_timestamp_nanos(self.nanos);
        f.pad(&utc.to_rfc3339_opts(SecondsFormat::Nanos, true))
    }
}

impl<C> Add<Span> for Timestamp<C> {
    type Output = Self;
    fn add(self, span: Span) -> Self {
        Self::from_nanos(self.nanos.saturating_add(span.0))
    }
}

impl<C> Sub<Span> for Timestamp<C> {
    type Output = Self;
    fn sub(self, span: Span) -> Self {
        Self::from_nanos(self.nanos.saturating_sub(span.0))
    }
}

impl<C> Sub for Timestamp<C> {
    type Output = Span;
    fn sub(self, other: Self) -> Span {
        Span(self.nanos.saturating_sub(other.nanos))
    }
}

impl<C> Serialize for Timestamp<C> {
    /// Serializes the instant: as RFC 3339 or, in a binary encoding, as nanoseconds since the Unix epoch.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            serializer.collect_str(self)
        } else {
            serializer.serialize_i64(self.nanos)
        }
    }
}

impl<'de, C> Deserialize<'de> for Timestamp<C> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Instant;
        impl de::Visitor<'_> for Instant {
            type Value = i64;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an RFC 3339 timestamp")
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<i64, E> {
                let parsed = DateTime::parse_from_rfc3339(text)
                    .map_err(|e| E::custom(format!("invalid timestamp, expected RFC 3339: {e}")))?;
                parsed
                    .timestamp_nanos_opt()
                    .ok_or_else(|| E::custom("timestamp out of range, expected a year from 1678 to 2262"))
            }

            fn visit_i64<E: de::Error>(self, nanos: i64) -> Result<i64, E> {
                Ok(nanos)
            }

            fn visit_u64<E: de::Error>(self, nanos: u64) -> Result<i64, E> {
                i64::try_from(nanos)
                    .map_err(|_| E::custom("timestamp out of range, expected a year from 1678 to 2262"))
            }
        }
        let nanos = if deserializer.is_human_readable() {
            deserializer.deserialize_str(Instant)
        } else {
            deserializer.deserialize_any(Instant)
        };
        nanos.map(Self::from_nanos)
    }
}

/// A number of milliseconds on the wire: finite, from 0 to [`OFFSET_MS_MAX`], fractions allowed.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
pub struct Millis(f64);

impl Millis {
    /// Zero duration.
    pub const ZERO: Self = Self(0.0);

    /// Creates a number of milliseconds.
    ///
    /// # Errors
    /// [`LimitError::OffsetOutOfRange`] if it is negative, not finite or exceeds [`OFFSET_MS_MAX`].
    pub fn new(millis: f64) -> Result<Self, LimitError> {
        if (0.0..=OFFSET_MS_MAX).contains(&millis) {
            Ok(Self(millis))
        } else {
            Err(LimitError::OffsetOutOfRange { millis })
        }
    }

    /// Converts a span to milliseconds, clamped to the range that the protocol permits.
    #[must_use]
    pub fn from_span(span: Span) -> Self {
        Self(span.as_millis_f64().clamp(0.0, OFFSET_MS_MAX))
    }

    /// Returns the milliseconds.
    #[must_use]
    pub const fn get(self) -> f64 {
        self.0
    }

    /// Converts the milliseconds to a span, rounded to the nearest nanosecond.
    #[must_use]
    pub fn span(self) -> Span {
        Span::from_millis_f64(self.0)
    }
}

impl fmt::Display for Millis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.span().fmt(f)
    }
}

impl Serialize for Millis {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        number::serialize(&self.0, serializer)
    }
}

impl<'de> Deserialize<'de> for Millis {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::new(number::deserialize(deserializer)?).map_err(de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn timestamp_is_written_with_nine_decimals_and_parsed_back() {
        let instant = Timestamp::<Server>::from_nanos(1_795_028_400_000_000_001);
        let text = serde_json::to_string(&instant).unwrap();
        assert_eq!(text, "\"2026-11-18T19:00:00.000000001Z\"");
        assert_eq!(serde_json::from_str::<Timestamp<Server>>(&text).unwrap(), instant);
    }

    #[test]
    fn milliseconds_are_rounded_like_f64() {
        let special = [0.0, -0.0, 0.499_999_999_999_999_94, 0.5, 1.5, 2.5, 4_503_599_627_370_497.5, 9.3e18];
        let special = special.into_iter().chain([f64::INFINITY, f64::NAN, f64::MAX, f64::MIN_POSITIVE]);
        let many = (0..100_000).map(|n| f64::from(n) * 7_919.25 + f64::from(n) * 1e-3);
        for nanos in special.chain(many).flat_map(|nanos| [nanos, -nanos]) {
            let millis = nanos / 1e6;
            assert_eq!(Span::from_millis_f64(millis).as_nanos(), (millis * 1e6).round() as i64, "{millis}");
        }
    }

    #[test]
    fn arithmetic_saturates_instead_of_overflowing() {
        let late = Timestamp::<Server>::from_nanos(i64::MAX);
        assert_eq!(late + Span::from_millis(1), late);
        assert_eq!(Span::from_millis(i64::MAX), Span::MAX);
        assert_eq!(-Span::from_nanos(i64::MIN), Span::MAX);
    }

    #[test]
    fn offset_is_finite_and_not_negative() {
        assert!(Millis::new(-0.001).is_err());
        assert!(Millis::new(f64::NAN).is_err());
        assert!(Millis::new(f64::INFINITY).is_err());
        assert!(Millis::new(0.25).is_ok());
    }

    #[test]
    fn spans_are_displayed_in_readable_units() {
        assert_eq!(Span::from_nanos(1_500_000).to_string(), "1.5 ms");
        assert_eq!(Span::from_nanos(82_000).to_string(), "82 us");
        assert_eq!(Span::from_millis(4_250).to_string(), "4.25 s");
    }
}
