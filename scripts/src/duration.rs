//! Durations as people write them: `2s`, `250ms`, `1m30s`, `1.5s`.

use urrcp::Span;

/// What a duration looks like, for messages.
pub(crate) const EXPECTED: &str = "a time with its unit, such as 250ms, 2s or 1m30s";

/// Reads a time: numbers with h, m, s, ms or us, added up. `None` if it is anything else or longer than 1e11 ms.
#[must_use]
pub fn parse_duration(text: &str) -> Option<Span> {
    let mut rest = text.trim();
    let mut millis = 0.0;
    if rest.is_empty() {
        return None;
    }
    while !rest.is_empty() {
        let digits = rest.find(|c: char| !c.is_ascii_digit() && c != '.')?;
        let number: f64 = rest[..digits].parse().ok()?;
        rest = &rest[digits..];
        let letters = rest.find(|c: char| !c.is_ascii_alphabetic()).unwrap_or(rest.len());
        millis += number * unit_millis(&rest[..letters])?;
        rest = &rest[letters..];
    }
    (millis <= urrcp::OFFSET_MS_MAX).then(|| Span::from_millis_f64(millis))
}

/// The same with an optional sign ahead.
pub(crate) fn parse_signed(text: &str) -> Option<Span> {
    match text.trim().strip_prefix('-') {
        Some(rest) => parse_duration(rest).map(|span| -span),
        None => parse_duration(text.trim().trim_start_matches('+')),
    }
}

fn unit_millis(unit: &str) -> Option<f64> {
    match unit {
        "h" => Some(3_600_000.0),
        "m" | "min" => Some(60_000.0),
        "s" => Some(1_000.0),
        "ms" => Some(1.0),
        "us" => Some(0.001),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_as_people_write_them() {
        let millis = |text| parse_duration(text).map(Span::as_millis_f64);
        assert_eq!(millis("2s"), Some(2_000.0));
        assert_eq!(millis("250ms"), Some(250.0));
        assert_eq!(millis("1m30s"), Some(90_000.0));
        assert_eq!(millis("1.5s"), Some(1_500.0));
        assert_eq!(millis("200us"), Some(0.2));
        for wrong in ["", "2", "s", "2 parsecs", "-1s", "1..5s", "1e9s", "9999999999999s"] {
            assert_eq!(millis(wrong), None, "{wrong}");
        }
        assert_eq!(parse_signed("-120ms"), Some(Span::from_millis(-120)));
    }
}
