//! Helpers for keyframes: times with nanosecond precision in ascending order, and values rounded to a given number of digits.

use std::cmp::Ordering;

use urrcp::Span;

use downbeat_motion::exact::{Exact, Fraction, fraction};
use downbeat_yaml::finding::Code;

use super::Keyframe;

/// Maximum time that an import accepts, in seconds: more than 100 days, within the limits of the protocol.
pub(super) const SECONDS_MAX: f64 = 1e7;

/// Converts seconds to the nearest nanosecond. `None` if the number of seconds is negative or above [`SECONDS_MAX`].
#[expect(clippy::cast_possible_truncation, reason = "the range is checked before")]
pub(super) fn span(seconds: f64) -> Option<Span> {
    (0.0..=SECONDS_MAX).contains(&seconds).then(|| Span::from_nanos((seconds * 1e9).round() as i64))
}

/// The times that count as calendar dates: from 1990 to 2200, in seconds since 1970.
const DATES_S: std::ops::Range<f64> = 631_152_000.0..7_258_118_400.0;

/// Whether a time is a calendar date, which cannot be relative to the start of a scene.
pub(super) fn is_date(at: Span) -> bool {
    DATES_S.contains(&seconds(at))
}

/// Converts a time to seconds, for use in notes and curves.
pub(super) fn seconds(span: Span) -> f64 {
    span.as_nanos() as f64 / 1e9
}

/// Returns all multiples of the sampling period before the end of a duration, and that end itself.
pub(super) fn sampled_times(duration_s: f64, rate_hz: f64) -> Vec<Span> {
    let Some(end) = span(duration_s) else { return Vec::new() };
    let second = Exact::from(Span::from_millis(1_000));
    let at = |index: i128| second.times(Fraction::from_integer(index) / fraction(rate_hz)).rounded();
    let mut times: Vec<Span> = (0..).map(at).take_while(|at| *at < end).collect();
    times.push(end);
    times
}

/// Rounds a value to a number of decimal digits, without a negative zero.
pub(super) fn rounded(value: f64, digits: i32) -> f64 {
    let scale = 10_f64.powi(digits);
    let scaled = (value * scale).round();
    // Larger doubles have no such digits.
    if scaled.abs() < 9e15 { scaled / scale + 0.0 } else { value }
}

/// Adds whole periods to values, so that no value differs from the previous one by more than half a period. Returns the number of such
/// corrections.
pub(super) fn unwrap(keyframes: &mut [Keyframe], period: f64) -> usize {
    let (mut turns, mut jumps) = (0.0, 0);
    let mut before = None;
    for keyframe in keyframes {
        let written = keyframe.value;
        let jump = before.map_or(0.0, |before: f64| ((written - before) / period).round());
        turns -= jump;
        jumps += usize::from(jump != 0.0);
        before = Some(written);
        keyframe.value = written + turns * period;
    }
    jumps
}

/// Describes the fault of a time that is not later than `before`, the previous time of the device. Returns a code, a sentence and a hint;
/// `None` if the time is later.
pub(super) fn check_later(before: Span, at: Span) -> Option<(Code, String, &'static str)> {
    let [before_s, at_s] = [before, at].map(seconds);
    match at.cmp(&before) {
        Ordering::Greater => None,
        Ordering::Less => {
            let message = format!("the time {at_s} s is earlier than the previous time, {before_s} s");
            Some((Code::ImportTime, message, "times must increase: sort the lines, or correct the time"))
        }
        Ordering::Equal => {
            let message = format!("duplicate time {at_s} s");
            Some((Code::TimesCollide, message, "keep only one value per time"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sampled_times_are_multiples_of_the_period_and_the_end() {
        assert_eq!(sampled_times(4.25, 50.0).len(), 214);
        assert_eq!(sampled_times(198.0, 10.0).len(), 1_981);
        let times: Vec<i64> = sampled_times(0.1, 30.0).into_iter().map(Span::as_nanos).collect();
        assert_eq!(times, [0, 33_333_333, 66_666_667, 100_000_000]);
    }

    #[test]
    fn headings_are_unwrapped_in_both_directions() {
        let values = [350.0, 10.0, 30.0, 340.0, 0.0, 355.0];
        let mut keyframes: Vec<_> =
            (0..).zip(values).map(|(ms, value)| Keyframe { at: Span::from_millis(ms), value }).collect();
        assert_eq!(unwrap(&mut keyframes, 360.0), 4);
        let values: Vec<_> = keyframes.iter().map(|keyframe| keyframe.value).collect();
        assert_eq!(values, [350.0, 370.0, 390.0, 340.0, 360.0, 355.0]);
    }

    #[test]
    fn times_are_rounded_and_bounded() {
        assert_eq!(span(0.372_734_245), Some(Span::from_nanos(372_734_245)));
        assert_eq!([span(-0.1), span(f64::NAN), span(1e9)], [None; 3]);
    }
}
