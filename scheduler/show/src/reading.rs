//! Formats sensor readings for people.

/// Formats a reading with at most six decimal places. A value that would be rounded to zero is shown with two significant digits and a
/// power of ten.
pub(super) fn reading_text(value: f64) -> String {
    let rounded = (value * 1e6).round() / 1e6;
    if value != 0.0 && rounded == 0.0 { format!("{value:.1e}") } else { rounded.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(value: f64, expected: &str) {
        assert_eq!(reading_text(value), expected);
    }

    #[test]
    fn readings_are_shown_in_short_form() {
        check(-10.4213, "-10.4213");
        check(89.999_999_712, "90");
        check(-1.767_249_105_254_329_3e-19, "-1.8e-19");
        check(0.0, "0");
        check(f64::NAN, "NaN");
    }
}
