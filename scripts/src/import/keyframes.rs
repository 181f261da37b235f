//! Times in whole milliseconds, in order; values with as many digits as they are worth.

use crate::finding::Code;

use super::Keyframe;

/// Longest time that is read, in seconds: 100 days and more, within what the protocol carries.
pub(super) const SECONDS_MAX: f64 = 1e7;

/// Seconds to whole milliseconds; `None` where they are negative or beyond all measure.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the range is checked before")]
pub(super) fn millis(seconds: f64) -> Option<u64> {
    (0.0..=SECONDS_MAX).contains(&seconds).then(|| (seconds * 1_000.0).round() as u64)
}

/// Seconds to whole nanoseconds; `None` where they are negative or beyond all measure.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the range is checked before")]
pub(super) fn nanos(seconds: f64) -> Option<u64> {
    (0.0..=SECONDS_MAX).contains(&seconds).then(|| (seconds * 1e9).round() as u64)
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

/// A value rounded to this many digits after the point, without a negative zero.
pub(super) fn rounded(value: f64, digits: i32) -> f64 {
    let scale = 10_f64.powi(digits);
    let scaled = (value * scale).round();
    // Values beyond the precision of doubles have no such digits to lose.
    if scaled.abs() < 9e15 { scaled / scale + 0.0 } else { value }
}

/// Adds whole periods so that no value is more than half of one from the value before; says how often that was needed.
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

/// What is wrong with a time after another one of the same device, in seconds: the code, a sentence and a hint.
pub(super) fn check_later(before_s: f64, at_s: f64) -> Option<(Code, String, &'static str)> {
    if at_s < before_s {
        let message = format!("the time {at_s} s comes after {before_s} s");
        return Some((Code::ImportTime, message, "times go forward: sort the lines, or correct the time"));
    }
    if at_s == before_s {
        let message = format!("the time {at_s} s appears twice");
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
    fn headings_go_on_past_a_turn_in_either_direction() {
        let values = [350.0, 10.0, 30.0, 340.0, 0.0, 355.0];
        let mut keyframes: Vec<_> =
            (0..).zip(values).map(|(at_ms, value)| Keyframe { at_ms, value }).collect();
        assert_eq!(unwrap(&mut keyframes, 360.0), 4);
        let values: Vec<_> = keyframes.iter().map(|keyframe| keyframe.value).collect();
        assert_eq!(values, [350.0, 370.0, 390.0, 340.0, 360.0, 355.0]);
    }

    #[test]
    fn times_are_rounded_and_bounded() {
        assert_eq!(millis(0.372734245), Some(373));
        assert_eq!([millis(-0.1), millis(f64::NAN), millis(1e9)], [None; 3]);
    }
}
