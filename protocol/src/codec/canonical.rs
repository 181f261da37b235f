//! Parses scripts in the canonical JSON that [`encode`](crate::encode) writes. The hash of a script is computed over exactly this text. A
//! reader that has the text can therefore compare hashes without serializing the script again.

use crate::control_type::ControlType;
use crate::limits::{CONTROL_VALUES_MAX, SCRIPT_STEPS_MAX};
use crate::message::{Script, Setpoint, Step};
use crate::time::Millis;

/// Maximum number of digits for which two different decimals are always two different doubles (`DBL_DIG` in C).
const DIGITS_MAX: usize = 15;
/// Maximum number of zeros directly after the decimal point of a number below 1. The general parser reads smaller numbers, because the
/// canonical form of very small numbers has an exponent.
const LEADING_ZEROS_MAX: usize = 3;

/// Parses the script in canonical JSON at the start of `text`. Returns the script, its JSON and the rest of `text`. Returns `None` for
/// anything else, and also for valid scripts with long numbers or with a stop condition in a step.
pub(super) fn read(text: &str) -> Option<(Script, &str, &str)> {
    let mut rest = text.strip_prefix('[')?;
    let mut steps = Vec::with_capacity(steps_at_most(rest));
    loop {
        let step;
        (step, rest) = read_step(rest)?;
        steps.push(step);
        match rest.strip_prefix(',') {
            Some(_) if steps.len() == SCRIPT_STEPS_MAX => return None,
            Some(next) => rest = next,
            None => break,
        }
    }
    let rest = rest.strip_prefix(']')?;
    let own = text.strip_suffix(rest)?;
    Some((Script::new(steps).ok()?, own, rest))
}

/// Returns an upper bound on the number of steps in `text`.
fn steps_at_most(text: &str) -> usize {
    const SHORTEST: &str = r#"{"time_offset_to_start":0,"control_type":"speed","control_value":0}"#;
    memchr::memchr_iter(b'{', text.as_bytes()).count().min(text.len() / SHORTEST.len())
}

fn read_step(text: &str) -> Option<(Step, &str)> {
    let (offset, rest) = read_number(text.strip_prefix(r#"{"time_offset_to_start":"#)?)?;
    let (control_type, rest) = rest.strip_prefix(r#","control_type":""#)?.split_once('"')?;
    let control_type = match control_type.parse().ok()? {
        ControlType::Script | ControlType::Sensor => return None,
        control_type => control_type,
    };
    let (value, mut rest) = read_number(rest.strip_prefix(r#","control_value":"#)?)?;
    let mut more = Vec::new();
    while let Some(next) = rest.strip_prefix(r#","control_value_"#) {
        let (index, next) = next.split_once(r#"":"#)?;
        if index.parse() != Ok(more.len() + 2)
            || more.len() + 2 > CONTROL_VALUES_MAX
            || index.starts_with(['0', '+'])
        {
            return None;
        }
        let further;
        (further, rest) = read_number(next)?;
        more.push(further);
    }
    let setpoint = Setpoint { control_type, value, more: more.into() };
    Some((Step::new(Millis::new(offset).ok()?, setpoint), rest.strip_prefix('}')?))
}

/// Parses the number at the start of `text`. Returns the number and the rest of `text`; `None` if the number is not in canonical form.
///
/// A decimal with at most [`DIGITS_MAX`] digits is the shortest text of its nearest double, because no other decimal of that length has
/// the same double. The digits and the power of ten are exact doubles, so their quotient is the nearest double (W. D. Clinger, "How to
/// Read Floating Point Numbers Accurately", 1990).
fn read_number(text: &str) -> Option<(f64, &str)> {
    const TENS: [f64; DIGITS_MAX + 1] =
        [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15];
    let magnitude = text.strip_prefix('-').unwrap_or(text);
    let (whole, mut rest) = split_digits(magnitude);
    let mut fraction = "";
    if let Some(after_point) = rest.strip_prefix('.') {
        (fraction, rest) = split_digits(after_point);
        if fraction.is_empty() || fraction.ends_with('0') {
            return None;
        }
    }
    let is_zero = whole == "0";
    let unusual = whole.is_empty()
        || whole.starts_with('0') && !is_zero
        || is_zero && fraction.bytes().take_while(|digit| *digit == b'0').count() > LEADING_ZEROS_MAX
        || is_zero && fraction.is_empty() && magnitude.len() < text.len()
        || whole.len() + fraction.len() > DIGITS_MAX;
    if unusual {
        return None;
    }
    let digits =
        whole.bytes().chain(fraction.bytes()).fold(0_u64, |sum, digit| sum * 10 + u64::from(digit - b'0'));
    #[expect(clippy::cast_precision_loss, reason = "15 digits are a whole number below 2^53")]
    let value = digits as f64 / TENS.get(fraction.len())?;
    Some((if magnitude.len() < text.len() { -value } else { value }, rest))
}

fn split_digits(text: &str) -> (&str, &str) {
    let digits = text.bytes().take_while(u8::is_ascii_digit).count();
    text.split_at_checked(digits).unwrap_or((text, ""))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[track_caller]
    fn check_number(text: &str, expected: Option<f64>) {
        let followed = format!("{text},");
        let read = read_number(&followed).filter(|(_, rest)| *rest == ",").map(|(value, _)| value);
        assert_eq!(read.map(f64::to_bits), expected.map(f64::to_bits), "{text}");
    }

    #[test]
    fn only_canonical_numbers_are_accepted() {
        for (text, value) in [
            ("0", 0.0),
            ("7", 7.0),
            ("-45", -45.0),
            ("0.1", 0.1),
            ("-0.0001", -0.0001),
            ("12.345", 12.345),
            ("0.30000000000001", 0.300_000_000_000_01),
            ("999999999999999", 999_999_999_999_999.0),
            ("9.99999999999999", 9.999_999_999_999_99),
        ] {
            check_number(text, Some(value));
        }
        for other in [
            "",
            "-",
            "-0",
            "00",
            "01",
            "-01",
            "+1",
            "1.",
            ".5",
            "1.0",
            "1.50",
            "0.00001",
            "1e2",
            "1E2",
            "1.5e1",
            "0x1",
            "1000000000000000",
            "0.123456789012345",
            "1.000000000000001",
            " 1",
            "1 ",
            "--1",
            "٣",
        ] {
            check_number(other, None);
        }
    }

    #[test]
    fn non_canonical_script_is_left_to_the_general_parser() {
        let canonical = r#"[{"time_offset_to_start":0,"control_type":"custom_3","control_value":1,"control_value_2":2.5,"control_value_3":-3},{"time_offset_to_start":0.5,"control_type":"speed","control_value":0}]"#;
        let read =
            |text: &str| super::read(text).map(|(script, own, rest)| (script, own.len(), rest.to_owned()));
        let followed = format!("{canonical},\"x\":[]}}}}");
        let script = serde_json::from_str(canonical).unwrap();
        assert_eq!(read(&followed), Some((script, canonical.len(), ",\"x\":[]}}".to_owned())));
        for (part, other) in [
            ("[{", "[ {"),
            ("[{", "{"),
            ("},{", "}, {"),
            ("},{", "}{"),
            ("},{", "},"),
            ("}]", "},]"),
            ("}]", "}"),
            ("custom_3", "custom_03"),
            ("custom_3", "script"),
            ("speed", "sensor"),
            ("speed", "spe\\u0065d"),
            ("speed", "spin"),
            ("control_value_2", "control_value_3"),
            ("control_value_3", "control_value_2"),
            ("control_value_3", "control_value_03"),
            ("control_value_3", "control_value_+3"),
            ("control_value_3", "control_value_4"),
            ("\"control_value\":1", "\"control_value\":1.0"),
            ("\"control_value\":1", "\"control_value\":null"),
            ("\"control_value\":0}", "\"control_value\":0,\"stop_condition\":{\"pending\":5}}"),
            ("\"control_value\":0}", "\"control_value\":0,\"control_value\":0}"),
            ("start\":0,", "start\":-1,"),
            ("start\":0,", "start\":1,"),
            ("start\":0,", "start\":99999999999999,"),
            ("time_offset_to_start\":0.5,\"control_type", "control_type\":0.5,\"control_type"),
        ] {
            let changed = canonical.replace(part, other);
            assert_ne!(changed, canonical, "{part}");
            assert_eq!(read(&changed), None, "{changed}");
        }
        for length in 0..canonical.len() {
            assert_eq!(read(&canonical[..length]), None);
        }
    }

    #[test]
    fn counts_of_steps_and_values_are_limited() {
        let step = r#"{"time_offset_to_start":0,"control_type":"speed","control_value":0}"#;
        let steps = |count: usize| format!("[{}]", vec![step; count].join(","));
        assert_eq!(read(&steps(SCRIPT_STEPS_MAX)).unwrap().0.steps().len(), SCRIPT_STEPS_MAX);
        assert_eq!(read(&steps(SCRIPT_STEPS_MAX + 1)), None);
        let values = |last: usize| {
            let more = (2..=last).map(|n| format!(r#","control_value_{n}":{n}"#)).collect::<String>();
            format!("[{}{more}}}]", step.trim_end_matches('}'))
        };
        assert_eq!(
            read(&values(CONTROL_VALUES_MAX)).unwrap().0.steps()[0].setpoint.more.len(),
            CONTROL_VALUES_MAX - 1
        );
        assert_eq!(read(&values(CONTROL_VALUES_MAX + 1)), None);
        assert!(steps_at_most(&"{".repeat(10_000)) < 10_000 / 60);
    }

    proptest! {
        /// Every accepted number is in canonical form, and serde_json parses it to the same value.
        #[test]
        fn accepted_number_is_canonical(text in "-?[0-9]{0,3}[0-9]{0,14}(\\.[0-9]{0,14}[0-9]{0,3})?(e-?[0-9])?") {
            if let Some((value, "")) = read_number(&text) {
                prop_assert_eq!(serde_json::from_str::<f64>(&text).unwrap().to_bits(), value.to_bits());
                prop_assert_eq!(serde_json::to_string(&crate::number::Number(value)).unwrap(), text);
            }
        }

        /// Every number with few digits is accepted.
        #[test]
        fn number_with_few_digits_is_accepted(digits in -999_999_999_999_999_i64..1_000_000_000_000_000, places in 0..15_i32) {
            let value = digits as f64 / 10_f64.powi(places);
            let text = serde_json::to_string(&crate::number::Number(value)).unwrap();
            let short = text.bytes().filter(u8::is_ascii_digit).count() <= DIGITS_MAX;
            if short && !text.contains('e') && value.abs() >= 1e-4 {
                prop_assert_eq!(read_number(&text), Some((value, "")));
            }
        }
    }
}
