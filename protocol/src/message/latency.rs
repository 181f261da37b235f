//! The actuation latency of a device: the time from a command to visible motion.

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::limits::{LATENCY_MS_MAX, LimitError};
use crate::number;
use crate::time::Span;

/// The actuation latency of a device: the time from passing a value to the device until the first visible motion (our extension).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Latency {
    /// The median latency of all trials.
    #[serde(rename = "median_ms")]
    pub median: Span,
    /// The spread: 95 % of all trials are within `median` ± `spread`.
    #[serde(rename = "spread_ms")]
    pub spread: Span,
}

impl Latency {
    /// Creates a latency from a median and a spread, each from 0 to [`LATENCY_MS_MAX`] milliseconds.
    ///
    /// # Errors
    /// [`LimitError::Latency`] if a value is outside that range.
    pub fn new(median: Span, spread: Span) -> Result<Self, LimitError> {
        [median, spread].into_iter().try_for_each(check)?;
        Ok(Self { median, spread })
    }
}

fn check(span: Span) -> Result<(), LimitError> {
    let millis = span.as_millis_f64();
    if (0.0..=LATENCY_MS_MAX).contains(&millis) { Ok(()) } else { Err(LimitError::Latency { millis }) }
}

/// Serialization of a latency or its spread as milliseconds that may be omitted or null.
pub(super) mod wire {
    use super::{Deserialize, Deserializer, LimitError, Serialize, Serializer, Span, check, de, number};

    pub(crate) fn serialize<S: Serializer>(latency: &Option<Span>, s: S) -> Result<S::Ok, S::Error> {
        latency.serialize(s)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<Option<Span>, D::Error> {
        let Some(number::Number(millis)) = Option::<number::Number>::deserialize(d)? else { return Ok(None) };
        let span = Span::from_millis_f64(millis);
        // `span` is rounded to nanoseconds, which would hide a slightly negative number.
        if millis < 0.0 { Err(LimitError::Latency { millis }) } else { check(span).map(|()| Some(span)) }
            .map_err(de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::InitializationBlock;

    fn block(keys: &str) -> Result<InitializationBlock, serde_json::Error> {
        serde_json::from_str(&format!(
            r#"{{"id": "r", "api_version": "1", "devices": [{{"id": "d", {keys}
               "available_control_types": {{"position": {{"min_value": 0, "max_value": 1, "granularity": 1}}}}}}]}}"#
        ))
    }

    #[track_caller]
    fn check_refused(keys: &str, because: &str) {
        let error = block(keys).unwrap_err().to_string();
        assert!(error.contains(because), "{error}");
    }

    #[test]
    fn latency_is_in_milliseconds_and_its_spread_requires_it() {
        let latency = |keys| block(keys).unwrap().devices[0].actuation_latency();
        assert_eq!(latency(""), None);
        assert_eq!(latency(r#""latency": null,"#), None);
        let (median, spread) = (Span::from_micros(41_200), Span::from_millis(3));
        assert_eq!(latency(r#""latency": 41.2,"#), Some(Latency { median, spread: Span::ZERO }));
        assert_eq!(latency(r#""latency": 41.2, "latency_spread": 3,"#), Some(Latency { median, spread }));
        check_refused(r#""latency": -0.0000001,"#, "expected 0 to 10000 ms");
        check_refused(r#""latency": 10000.1,"#, "expected 0 to 10000 ms");
        check_refused(r#""latency": 1, "latency_spread": -1,"#, "expected 0 to 10000 ms");
        check_refused(r#""latency": "1","#, "a number");
        check_refused(r#""latency_spread": 1,"#, "`latency_spread` of device `d` requires a `latency`");
    }

    #[test]
    fn latency_is_written_as_it_was_read_and_omitted_if_absent() {
        for (keys, written) in [("", false), (r#""latency": 41.2, "latency_spread": 3.1,"#, true)] {
            let text = serde_json::to_string(&block(keys).unwrap()).unwrap();
            assert_eq!(text.contains(r#""latency":41.2,"latency_spread":3.1"#), written, "{text}");
            assert_eq!(text.contains("latency"), written, "{text}");
        }
    }
}
