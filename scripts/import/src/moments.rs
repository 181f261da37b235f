//! Times in tables: numbers in some unit, frame numbers, timecodes, clock times such as `hh:mm:ss`, and dates.

use std::str::FromStr;

use num_rational::Ratio;
use num_traits::{CheckedDiv, CheckedMul};
use urrcp::Span;

use downbeat_motion::exact::{Exact, Fraction, decimal, fraction, near_fraction, to_f64};

/// The unit or notation of the values in a column of times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TimeUnit {
    /// Numbers in a unit that lasts this many nanoseconds.
    Nanos(u64),
    /// Frame numbers, with this number of frames per second.
    Frames(f64),
    /// `hh:mm:ss` and `hh:mm:ss.fff`.
    HoursMinutesSeconds,
    /// `mm:ss` and `mm:ss.fff`.
    MinutesSeconds,
    /// `mm:ss:ms`, where the last number is milliseconds.
    MinutesSecondsMillis,
    /// `hh:mm:ss:ff`, where the last number is a frame; the value is the number of frames per second. `hh:mm:ss;ff` skips frame numbers
    /// (drop-frame).
    Timecode(f64),
    /// `2026-11-23T19:30:00.5+01:00`; without a time zone, in UTC.
    Date,
}

/// The units and notations that a user may specify, for error messages.
pub(super) const UNITS: &str = "h, min, s, ms, us, ns, 25fps, hh:mm:ss, mm:ss or mm:ss:ms";

const CLOCKS: [(&str, TimeUnit); 3] = [
    ("hh:mm:ss", TimeUnit::HoursMinutesSeconds),
    ("mm:ss", TimeUnit::MinutesSeconds),
    ("mm:ss:ms", TimeUnit::MinutesSecondsMillis),
];

/// Units of Unix times: the name of each, and its duration in nanoseconds.
const UNIX: [(&str, u64); 4] = [("s", 1_000_000_000), ("ms", 1_000_000), ("us", 1_000), ("ns", 1)];
/// The times that count as Unix times, in seconds since 1970: from the year 2000 to the year 2100. In a column of Unix times, the first
/// and the last one differ by at most `UNIX_LENGTH_S`.
const YEARS_S: std::ops::Range<i64> = 946_684_800..4_102_444_800;
const UNIX_LENGTH_S: i64 = 10_000_000;
/// Limits of numbers: the largest absolute exponent; the largest number, which exceeds all Unix times in nanoseconds; and the maximum
/// number of digits of a whole number between colons. Fractions of such numbers fit in 128 bits.
const EXPONENT_MAX: u32 = 18;
const NUMBER_MAX: f64 = 1e19;
const DIGITS_MAX: usize = 9;
/// Maximum number of digits after the decimal point that are read.
const PART_MAX: usize = 18;

impl FromStr for TimeUnit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let frames = text.strip_suffix("fps").and_then(|number| number.trim().parse::<f64>().ok());
        let frames = frames.filter(|rate| (0.001..=1_000_000.0).contains(rate)).map(Self::Frames);
        let clock = CLOCKS.iter().find(|(word, _)| *word == text).map(|(_, unit)| *unit);
        let unit = frames.or(clock).or_else(|| spelled(text));
        unit.ok_or_else(|| format!("one of {UNITS}"))
    }
}

impl TimeUnit {
    /// Parses a text in this unit or notation, to the nearest nanosecond.
    pub(super) fn time(self, text: &str) -> Option<Span> {
        let text = text.trim();
        let parts: Vec<&str> = text.split(':').collect();
        let seconds = match (self, parts.as_slice()) {
            (Self::Nanos(nanos), [one]) => {
                let size = Exact::of_nanos(Ratio::from_integer(i128::from(nanos)));
                return Some(size.times(number(one)?).rounded());
            }
            (Self::Frames(rate), [one]) => divided(number(one)?, frame_rate(rate)),
            (Self::HoursMinutesSeconds, [h, m, s]) => {
                whole(h)? * 3_600 + sixtieth(whole(m)?)? * 60 + sixtieth(second(s)?)?
            }
            (Self::MinutesSeconds, [m, s]) => whole(m)? * 60 + sixtieth(second(s)?)?,
            (Self::MinutesSecondsMillis, [m, s, ms]) => {
                let ms = whole(ms).filter(|ms| *ms < Ratio::from_integer(1_000))?;
                whole(m)? * 60 + sixtieth(whole(s)?)? + ms / 1_000
            }
            (Self::Timecode(rate), _) => timecode(text, rate)?,
            (Self::Date, _) => date(text)?,
            _ => return None,
        };
        Some(Exact::from(Span::from_millis(1_000)).times(seconds).rounded())
    }
}

/// Parses a number with an optional sign and exponent. The result is exact unless the number has too many digits or too large an
/// exponent.
fn number(text: &str) -> Option<Fraction> {
    let text = text.trim();
    let value = text.parse::<f64>().ok().filter(|value| value.abs() <= NUMBER_MAX)?;
    let (mantissa, exponent) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let exact = || {
        let size = long_decimal(mantissa.trim_start_matches(['+', '-']))?;
        let exponent: i32 = exponent.parse().ok()?;
        let power = 10_i128.pow(Some(exponent.unsigned_abs()).filter(|size| *size <= EXPONENT_MAX)?);
        let size = match exponent {
            0.. => size.checked_mul(&Ratio::from_integer(power))?,
            _ => size.checked_mul(&Ratio::new(1, power))?,
        };
        Some(if text.starts_with('-') { -size } else { size })
    };
    Some(exact().unwrap_or_else(|| near_fraction(value)))
}

/// Parses a decimal number like [`decimal`], but supports enough digits for Unix times in nanoseconds.
fn long_decimal(text: &str) -> Option<Fraction> {
    let (whole, part) = text.split_once('.').unwrap_or((text, ""));
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if !digits(whole) || !digits(part) {
        return None;
    }
    let part = &part[..part.len().min(PART_MAX)];
    let numerator: i128 = format!("{whole}{part}").parse().ok()?;
    Some(Ratio::new(numerator, 10_i128.pow(u32::try_from(part.len()).ok()?)))
}

fn whole(text: &str) -> Option<Fraction> {
    decimal(text).filter(|_| !text.contains('.') && text.len() <= DIGITS_MAX)
}

/// Parses the seconds of a clock time, with or without decimals. More than two digits before the decimal point, as in `033`, are invalid.
fn second(text: &str) -> Option<Fraction> {
    let text = text.replace(',', ".");
    if text.split('.').next().is_some_and(|whole| whole.len() > 2) {
        return None;
    }
    decimal(&text)
}

fn sixtieth(value: Fraction) -> Option<Fraction> {
    (value < Ratio::from_integer(60)).then_some(value)
}

/// Returns a number of frames divided by the frame rate. The result is rounded if the exact fraction does not fit its type.
fn divided(frames: Fraction, rate: Fraction) -> Fraction {
    frames.checked_div(&rate).unwrap_or_else(|| near_fraction(to_f64(frames) / to_f64(rate)))
}

/// Returns the exact frame rate in frames per second. For example, 23.976, 29.97 and 59.94 mean 24, 30 and 60 times 1000/1001.
fn frame_rate(rate: f64) -> Fraction {
    let video = [24, 30, 48, 60, 120].into_iter().map(|whole| Ratio::new(whole * 1_000, 1_001));
    let near = |exact: &Fraction| (to_f64(*exact) - rate).abs() < 0.005;
    video.into_iter().find(near).unwrap_or_else(|| fraction(rate))
}

/// Converts a timecode `hh:mm:ss:ff` to seconds. Frames are numbered without gaps. With `;`, frame numbers are skipped so that the
/// timecode follows 29.97 or 59.94 frames per second (SMPTE 12M). Two of every 30 numbers are skipped at the start of each minute, except
/// for every tenth minute.
fn timecode(text: &str, rate: f64) -> Option<Fraction> {
    let parts: Vec<&str> = text.split([':', ';']).collect();
    let [h, m, s, f] = parts.as_slice() else { return None };
    let (rate, per_second) = (frame_rate(rate), frame_rate(rate).ceil());
    let (minutes, frames) =
        (whole(h)? * 60 + sixtieth(whole(m)?)?, whole(f).filter(|frames| *frames < per_second)?);
    let mut number = (minutes * 60 + sixtieth(whole(s)?)?) * per_second + frames;
    if text.contains(';') {
        let is_video = rate != per_second && (per_second % 30).numer() == &0;
        let dropped = (minutes - (minutes / 10).floor()) * (per_second / 30) * 2;
        number = is_video.then(|| number - dropped)?;
    }
    Some(divided(number, rate))
}

/// Converts a date and time in ISO 8601 to seconds since 1970.
fn date(text: &str) -> Option<Fraction> {
    let (day, time) = text.split_once(['T', 't', ' '])?;
    let (time, zone) = match time.find(['Z', 'z', '+', '-']) {
        Some(at) => (&time[..at], zone(&time[at..])?),
        None => (time, Ratio::from_integer(0)),
    };
    let time = match time.split(':').collect::<Vec<_>>().as_slice() {
        [h, m] => hours(h)? * 3_600 + sixtieth(whole(m)?)? * 60,
        [h, m, s] => hours(h)? * 3_600 + sixtieth(whole(m)?)? * 60 + sixtieth(second(s)?)?,
        _ => return None,
    };
    Some(Ratio::from_integer(days(day)? * 86_400) + time - zone)
}

fn hours(text: &str) -> Option<Fraction> {
    whole(text).filter(|hours| *hours < Ratio::from_integer(24))
}

/// Parses a time zone, `Z`, `+01:00`, `+0100` or `+01`, as its offset in seconds.
fn zone(text: &str) -> Option<Fraction> {
    if text.eq_ignore_ascii_case("z") {
        return Some(Ratio::from_integer(0));
    }
    let (sign, rest) = text.split_at_checked(1)?;
    let (h, m) = rest.split_at_checked(2)?;
    let minutes = if m.is_empty() { "0" } else { m.trim_start_matches(':') };
    let seconds = hours(h)? * 3_600 + sixtieth(whole(minutes)?)? * 60;
    Some(if sign == "-" { -seconds } else { seconds })
}

/// Parses a date of the Gregorian calendar as the number of days since 1970-01-01.
fn days(text: &str) -> Option<i128> {
    let parts: Option<Vec<i128>> = text.split('-').map(|part| Some(whole(part)?.to_integer())).collect();
    let [year, month, day] = parts?[..] else { return None };
    let is_leap = |year: i128| year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    let february = if is_leap(year) { 29 } else { 28 };
    let lengths = [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let before = usize::try_from(month - 1).ok().filter(|before| *before < lengths.len())?;
    if !(1_600..=9_999).contains(&year) || !(1..=lengths[before]).contains(&day) {
        return None;
    }
    let leap_years = |year: i128| year / 4 - year / 100 + year / 400;
    let years = (year - 1_970) * 365 + leap_years(year - 1) - leap_years(1_969);
    Some(years + lengths[..before].iter().sum::<i128>() + day - 1)
}

/// Finds the unit in which the first and the last number of a column are Unix times. Returns the unit with its name. At most one unit
/// qualifies.
pub(super) fn unix(first: &str, last: &str) -> Option<(&'static str, TimeUnit)> {
    UNIX.into_iter().map(|(word, nanos)| (word, TimeUnit::Nanos(nanos))).find(|(_, unit)| {
        let seconds = |text| unit.time(text).map(|time| time.as_nanos() / 1_000_000_000);
        let (Some(first), Some(last)) = (seconds(first), seconds(last)) else { return false };
        [first, last].iter().all(|time| YEARS_S.contains(time)) && (last - first).abs() <= UNIX_LENGTH_S
    })
}

/// What the name of a column of times reveals about the unit of these times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Said {
    Unit(TimeUnit),
    /// The values are frame numbers.
    Frames,
    /// The name contains a unit, but it is unknown or ambiguous.
    Unclear,
    Nothing,
}

/// Finds the unit in the name of a column: `Time [msec]`, `t (ms)`, `time_ms`, `t/ms`, `timeMs`, `ms since start`, `seconds`.
pub(super) fn said_by(header: &str) -> Said {
    let header = header.trim();
    for (open, close) in [('[', ']'), ('(', ')'), ('{', '}'), ('<', '>')] {
        if let Some((_, inner)) = header.strip_suffix(close).and_then(|rest| rest.rsplit_once(open)) {
            return spelled(inner.trim()).map_or(Said::Unclear, Said::Unit);
        }
    }
    let words = words(header);
    let last = words.len().saturating_sub(1);
    let mut units = words.iter().enumerate().filter_map(|(index, word)| {
        // A single letter at the beginning is a name, as in `s1 time`.
        (index == last || word.chars().count() > 1).then(|| spelled(word)).flatten()
    });
    match (units.next(), units.next()) {
        (None, _) if words.iter().any(|word| ["frame", "frames"].contains(&word.to_lowercase().as_str())) => {
            Said::Frames
        }
        (Some(unit), None) => Said::Unit(unit),
        (Some(unit), Some(other)) if unit == other => Said::Unit(unit),
        (Some(_), Some(_)) => Said::Unclear,
        (None, _) => Said::Nothing,
    }
}

/// Splits a text into words of letters and digits. An upper-case letter after a lower-case one starts a new word.
fn words(text: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut before = ' ';
    for c in text.chars() {
        let apart = !c.is_alphanumeric() || (c.is_uppercase() && before.is_lowercase());
        if apart && words.last().is_some_and(|word| !word.is_empty()) {
            words.push(String::new());
        }
        if let Some(word) = words.last_mut().filter(|_| c.is_alphanumeric()) {
            word.push(c);
        }
        before = c;
    }
    words.retain(|word| !word.is_empty());
    words
}

/// Returns the unit of time with this spelling, such as `s`, `secs` or `seconds`.
fn spelled(word: &str) -> Option<TimeUnit> {
    Some(TimeUnit::Nanos(match word.to_lowercase().trim_end_matches('.') {
        "h" | "hr" | "hrs" | "hour" | "hours" => 3_600_000_000_000,
        "min" | "mins" | "minute" | "minutes" => 60_000_000_000,
        "s" | "sec" | "secs" | "second" | "seconds" => 1_000_000_000,
        "ms" | "msec" | "msecs" | "milli" | "millis" | "millisec" | "millisecs" | "millisecond"
        | "milliseconds" => 1_000_000,
        "us" | "\u{b5}s" | "\u{3bc}s" | "usec" | "usecs" | "\u{b5}sec" | "\u{3bc}sec" | "micros"
        | "microsec" | "microsecs" | "microsecond" | "microseconds" => 1_000,
        "ns" | "nsec" | "nsecs" | "nanos" | "nanosec" | "nanosecs" | "nanosecond" | "nanoseconds" => 1,
        _ => return None,
    }))
}

/// Returns the notations of clock times that all given texts match, each with its name.
pub(super) fn clocks<'a>(texts: impl Iterator<Item = &'a str>) -> Vec<(&'static str, TimeUnit)> {
    let mut fitting = CLOCKS.to_vec();
    for text in texts {
        fitting.retain(|(_, clock)| clock.time(text).is_some());
    }
    fitting
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_read_in_common_spellings() {
        let millis = Said::Unit(TimeUnit::Nanos(1_000_000));
        for header in [
            "Time [msec]",
            "time (ms)",
            "t_ms",
            "t/ms",
            "Time ms",
            "timeMs",
            "timeMS",
            "ms since start",
            "milliseconds",
            "MS",
            "time.millis",
        ] {
            assert_eq!(said_by(header), millis, "{header}");
        }
        for header in ["t[s]", "time_s", "Seconds", "sec", "time (sec.)", "t / s", "elapsed seconds"] {
            assert_eq!(said_by(header), Said::Unit(TimeUnit::Nanos(1_000_000_000)), "{header}");
        }
        assert_eq!(said_by("t [\u{3bc}s]"), Said::Unit(TimeUnit::Nanos(1_000)));
        for header in ["t", "time", "Timestamp", "s1 time", "%time", ""] {
            assert_eq!(said_by(header), Said::Nothing, "{header}");
        }
        for header in ["frame", "Frame #", "frame_id", "FrameNumber"] {
            assert_eq!(said_by(header), Said::Frames, "{header}");
        }
        for header in ["t [m]", "time (local)", "secs.nsecs"] {
            assert_eq!(said_by(header), Said::Unclear, "{header}");
        }
    }

    #[test]
    fn clock_times_are_read_only_if_unambiguous() {
        let nanos = |unit: &str, text| {
            unit.parse::<TimeUnit>().ok().and_then(|unit| unit.time(text)).map(Span::as_nanos)
        };
        assert_eq!(nanos("mm:ss:ms", "01:02:345"), Some(62_345_000_000));
        assert_eq!(nanos("mm:ss:ms", "1:2:5"), Some(62_005_000_000));
        assert_eq!(nanos("hh:mm:ss", "01:02:03,25"), Some(3_723_250_000_000));
        assert_eq!(nanos("mm:ss", "2:03.5"), Some(123_500_000_000));
        assert_eq!(nanos("25fps", "50"), Some(2_000_000_000));
        for wrong in ["", "1", "1:2", "1:60:0", "1:2:1000", "-1:2:3", "1:2:3:4", "a:b:c"] {
            assert_eq!(nanos("mm:ss:ms", wrong), None, "{wrong}");
        }
        let words = |texts: &[&str]| -> Vec<_> {
            clocks(texts.iter().copied()).into_iter().map(|(word, _)| word).collect()
        };
        assert_eq!(words(&["00:00:00", "00:00:33"]), ["hh:mm:ss", "mm:ss:ms"]);
        assert_eq!(words(&["00:00:00", "00:00:033"]), ["mm:ss:ms"]);
        assert_eq!(words(&["00:00:00", "00:00:960"]), ["mm:ss:ms"]);
        assert_eq!(words(&["00:00:00.5"]), ["hh:mm:ss"]);
        assert_eq!(words(&["00:00:00:12"]), [""; 0]);
    }

    #[test]
    fn numeric_times_are_read_to_the_nanosecond() {
        let nanos = |size, text| TimeUnit::Nanos(size).time(text).map(Span::as_nanos);
        let second = 1_000_000_000;
        assert_eq!(nanos(second, "1795462200.123456789"), Some(1_795_462_200_123_456_789));
        assert_eq!(nanos(second, "1.795462200123456717e+09"), Some(1_795_462_200_123_456_717));
        assert_eq!(nanos(second, "-0.0000000015"), Some(-1));
        assert_eq!(nanos(1, "1795462200123456789"), Some(1_795_462_200_123_456_789));
        assert_eq!(nanos(second, "1e-30"), Some(0));
        for wrong in ["", "nan", "inf", "1e999", "1:2", "0x1"] {
            assert_eq!(nanos(second, wrong), None, "{wrong}");
        }
    }

    #[test]
    fn frames_and_timecodes_follow_video_frame_rates() {
        let nanos = |unit: TimeUnit, text| unit.time(text).map(Span::as_nanos);
        assert_eq!(nanos(TimeUnit::Frames(29.97), "30000"), Some(1_001_000_000_000));
        assert_eq!(nanos(TimeUnit::Frames(23.976), "24"), Some(1_001_000_000));
        assert_eq!(nanos(TimeUnit::Frames(120.0), "1"), Some(8_333_333));
        assert_eq!(nanos(TimeUnit::Timecode(25.0), "01:00:00:24"), Some(3_600_960_000_000));
        // Without drop-frame, an hour of timecode lasts 3.6 s longer than an hour; with it, 3.6 ms less.
        assert_eq!(nanos(TimeUnit::Timecode(29.97), "01:00:00:00"), Some(3_603_600_000_000));
        assert_eq!(nanos(TimeUnit::Timecode(29.97), "01:00:00;00"), Some(3_599_996_400_000));
        assert_eq!(nanos(TimeUnit::Timecode(59.94), "00:01:00;04"), Some(60_060_000_000));
        for wrong in ["00:00:00:25", "00:00:60:00", "00:00:00;00", "00:00:00", "0:0:0:0:0", "00:00:0.5:00"] {
            assert_eq!(nanos(TimeUnit::Timecode(25.0), wrong), None, "{wrong}");
        }
    }

    #[test]
    fn dates_are_converted_to_unix_time() {
        let nanos = |text| TimeUnit::Date.time(text).map(Span::as_nanos);
        assert_eq!(nanos("1970-01-01T00:00:00Z"), Some(0));
        // The reference is `date --date ... +%s`.
        for text in ["2026-11-23T20:30:00.25+01:00", "2026-11-23 19:30:00,25", "2026-11-23T14:30:00.25-0500"]
        {
            assert_eq!(nanos(text), Some(1_795_462_200_250_000_000), "{text}");
        }
        assert_eq!(nanos("2028-02-29T00:00Z"), Some(1_835_395_200_000_000_000));
        assert_eq!(nanos("2100-03-01T00:00Z"), Some(4_107_542_400_000_000_000));
        for wrong in
            ["2026-11-23", "2026-02-29T00:00", "2026-13-01T00:00", "2026-11-23T24:00", "26-11-23T00:00", "x"]
        {
            assert_eq!(nanos(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn unit_of_unix_times_is_inferred_from_their_size() {
        let unit = |first, last| unix(first, last).map(|(word, _)| word);
        assert_eq!(unit("1795462200.25", "1795462300"), Some("s"));
        assert_eq!(unit("1795462200250", "1795462300000"), Some("ms"));
        assert_eq!(unit("1795462200250000000", "1795462200260000000"), Some("ns"));
        // One or two seconds in nanoseconds, with some other origin.
        assert_eq!(unit("1000000000", "2000000000"), None);
        assert_eq!(unit("0", "1795462300"), None);
    }
}
