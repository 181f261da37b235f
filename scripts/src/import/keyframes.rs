//! Times in whole milliseconds, in order; values with as many digits as they are worth.

use crate::finding::Code;

/// Longest time that is read, in seconds: 100 days and more, within what the protocol carries.
pub(super) const SECONDS_MAX: f64 = 1e7;

/// Seconds to whole milliseconds; `None` where they are negative or beyond all measure.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the range is checked before")]
pub(super) fn millis(seconds: f64) -> Option<u64> {
    (0.0..=SECONDS_MAX).contains(&seconds).then(|| (seconds * 1_000.0).round() as u64)
}

/// All multiples of the sampling period up to a duration, and the duration itself, in milliseconds.
pub(super) fn sampled_times(duration_s: f64, rate_hz: f64) -> Vec<u64> {
    let Some(end) = millis(duration_s) else { return Vec::new() };
    let mut times: Vec<u64> = (0_u32..)
        .map_while(|index| millis(f64::from(index) / rate_hz).filter(|at_ms| *at_ms < end))
        .collect();
    times.push(end);
    // Above 1000 Hz two samples would share a millisecond.
    times.dedup();
    times
}

/// A value rounded to so many digits after the point, without a negative zero.
pub(super) fn rounded(value: f64, digits: i32) -> f64 {
    let scale = 10_f64.powi(digits);
    let scaled = (value * scale).round();
    // Values beyond the precision of doubles have no such digits to lose.
    if scaled.abs() < 9e15 { scaled / scale + 0.0 } else { value }
}

/// What is wrong with a time after another one of the same device, in seconds: the code, a sentence and a hint.
pub(super) fn check_later(before_s: f64, at_s: f64) -> Option<(Code, String, &'static str)> {
    if at_s < before_s {
        let message = format!("the time {at_s} s comes after {before_s} s");
        return Some((Code::ImportTime, message, "times go forward: sort the lines, or correct the time"));
    }
    if at_s == before_s {
        let message = format!("the time {at_s} s stands twice");
        return Some((Code::TimesCollide, message, "two values at one time: keep one of them"));
    }
    let at_ms = millis(at_s).filter(|at_ms| millis(before_s) == Some(*at_ms))?;
    let message = format!("the times {before_s} s and {at_s} s both are {at_ms} ms");
    Some((Code::TimesCollide, message, "times are kept in milliseconds: keep one of the two"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_gives_its_multiples_and_the_end() {
        assert_eq!(sampled_times(4.25, 50.0).len(), 214);
        assert_eq!(sampled_times(198.0, 10.0).len(), 1_981);
        assert_eq!(sampled_times(0.05, 30.0), [0, 33, 50]);
    }

    #[test]
    fn times_are_rounded_and_bounded() {
        assert_eq!(millis(0.372734245), Some(373));
        assert_eq!([millis(-0.1), millis(f64::NAN), millis(1e9)], [None; 3]);
    }
}
