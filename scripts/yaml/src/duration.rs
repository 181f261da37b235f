//! Parses and writes durations as people write them: `2s`, `250ms`, `1m30s`, `1.5s`, `00:01:30`.

use urrcp::Span;

use crate::budget::longest;

/// The expected form of a duration, for messages.
pub const EXPECTED: &str = "a time with its unit, such as 250ms, 2s or 1m30s";

/// Maximum number of digits before the decimal point. As many are read after it; further ones are ignored.
const DIGITS_MAX: usize = 15;
/// Number of parts into which a nanosecond is divided while a time is computed, before it is rounded.
const PARTS: i128 = 1_000_000_000;

/// Parses a time, and rounds it to the nearest nanosecond. A time is a sum of numbers with h, m, s, ms or us, or has the form
/// `00:01:30.5` (hours, minutes, seconds). `None` if the text is anything else, or the time is longer than 1e11 ms.
#[must_use]
pub fn parse_duration(text: &str) -> Option<Span> {
    let mut rest = text.trim();
    let mut parts: i128 = 0;
    if rest.is_empty() {
        return None;
    }
    if rest.contains(':') {
        return of_clock(rest);
    }
    while !rest.is_empty() {
        let digits = rest.find(|c: char| !c.is_ascii_digit() && c != '.')?;
        let number = &rest[..digits];
        rest = &rest[digits..];
        let letters = rest.find(|c: char| !c.is_ascii_alphabetic()).unwrap_or(rest.len());
        parts = parts.checked_add(parts_of(number, unit_nanos(&rest[..letters])?)?)?;
        rest = &rest[letters..];
    }
    let span = Span::from_nanos(i64::try_from((parts + PARTS / 2) / PARTS).ok()?);
    (span.as_millis_f64() <= urrcp::OFFSET_MS_MAX).then_some(span)
}

/// Returns the product of a number and its unit, in parts of a nanosecond ([`PARTS`]). `None` if the number is invalid or too long.
fn parts_of(number: &str, unit_nanos: i128) -> Option<i128> {
    let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
    let plain = |digits: &str| digits.bytes().all(|byte| byte.is_ascii_digit());
    if whole.len() + fraction.len() == 0 || whole.len() > DIGITS_MAX || !plain(fraction) {
        return None;
    }
    let value = |digits: &str| if digits.is_empty() { Some(0) } else { digits.parse::<i128>().ok() };
    let fraction = &fraction[..fraction.len().min(DIGITS_MAX)];
    let scale = 10i128.pow(u32::try_from(fraction.len()).ok()?);
    Some(value(whole)? * unit_nanos * PARTS + value(fraction)? * unit_nanos * PARTS / scale)
}

/// Recognizes an instant that a user wrote where a duration belongs: a date such as `2026-12-01`, or a time of day such as `8pm`. Returns
/// its kind; `None` for any other text.
pub fn instant(text: &str) -> Option<&'static str> {
    let is_number = |part: &str, most: usize| {
        (1..=most).contains(&part.len()) && part.bytes().all(|byte| byte.is_ascii_digit())
    };
    let date = text.split(['T', 't', ' ']).next().unwrap_or(text);
    let parts: Vec<&str> = date.split(['-', '/', '.']).collect();
    if let [a, b, c] = parts.as_slice()
        && is_number(b, 2)
        && ((a.len() == 4 && is_number(a, 4) && is_number(c, 2))
            || (c.len() == 4 && is_number(c, 4) && is_number(a, 2)))
    {
        return Some("date");
    }
    let small = text.to_ascii_lowercase();
    let hours = small.strip_suffix("am").or_else(|| small.strip_suffix("pm"))?.trim();
    hours.split(':').all(|part| is_number(part, 2)).then_some("time of day")
}

/// Returns a hint for a range that lacks the unit at one end or at both: `1..3`, `1..3s`, `bar 4..8`.
pub fn bare_range(text: &str) -> Option<String> {
    let (from, to) = text.split_once("..")?;
    let (from, to) = (from.trim(), to.trim());
    let is_number = |text: &str| text.parse::<f64>().is_ok_and(|value| value >= 0.0);
    if !is_number(to) {
        let unit = to.trim_start_matches(|c: char| c.is_ascii_digit() || c == '.');
        return (is_number(from) && parse_duration(to).is_some())
            .then(|| format!("write `{from}{unit}..{to}`"));
    }
    if is_number(from) {
        return Some(format!("add the unit: `{from}s..{to}s`"));
    }
    let unit = from.trim_start_matches(|c: char| c.is_ascii_digit() || c == '.');
    match from.strip_prefix("bar ") {
        Some(bar) if is_number(bar) => Some(format!("write `{from}..bar {to}`")),
        _ => parse_duration(from).map(|_| format!("write `{from}..{to}{unit}`")),
    }
}

/// Returns a hint for two numbers such as `4-8`, which may mean a range, or a bar and a beat.
pub fn of_two_numbers(text: &str) -> Option<String> {
    let (from, to) = text.split_once('-')?;
    let [from, to] = [from.trim().parse::<u32>().ok()?, to.trim().parse::<u32>().ok()?];
    Some(format!("write a range as `{from}s..{to}s`, or a position in the music as `bar {from} beat {to}`"))
}

/// Returns a hint for a position in the music that is written in an invalid form: `bar 4.2`, `bars 4-8`, `4 beat 2`.
pub fn position(text: &str) -> Option<String> {
    let mut words = text.split(|c: char| !c.is_ascii_alphabetic()).filter(|word| !word.is_empty());
    if !words.all(|word| matches!(word, "bar" | "bars" | "beat" | "beats")) || !text.contains('b') {
        return None;
    }
    let numbers: Vec<&str> =
        text.split(|c: char| !c.is_ascii_digit()).filter(|number| !number.is_empty()).collect();
    let is_range = text.contains('-') || text.contains("..");
    match (numbers.as_slice(), is_range && !text.contains("beat")) {
        ([from, to], true) => Some(format!("write a range as `bar {from}..bar {to}`")),
        ([bar, beat], false) if !is_range => Some(format!(
            "write a position as `bar {bar} beat {beat}`, or a length as `{bar} bars {beat} beats`"
        )),
        _ => Some("write a position as `bar 3 beat 2`, or a length as `3 bars 2 beats`".to_owned()),
    }
}

/// Returns a hint for a time in a form that only people understand: `1:30`, `1 second`, `0,3s`.
pub fn hint(text: &str) -> Option<String> {
    let text = text.trim();
    if let Some(rest) = text.strip_prefix('-').filter(|rest| parse_duration(rest).is_some()) {
        return Some(format!(
            "a time cannot be negative: write `{rest}`, or start the other movements later"
        ));
    }
    if ["now", "start", "begin", "immediately"].contains(&text) {
        return Some("write `0s` for the beginning".to_owned());
    }
    if ["auto", "automatic", "default"].contains(&text) {
        return Some("leave the key out to use the default".to_owned());
    }
    if let Some(rest) = text.strip_prefix('+').filter(|rest| parse_duration(rest).is_some()) {
        return Some(format!("write `{rest}`"));
    }
    let joined: String = text.split_whitespace().collect();
    if joined != text && parse_duration(&joined).is_some() {
        return Some(format!("write `{joined}`"));
    }
    if let Some(range) = range(text) {
        return Some(format!("write a range as `{range}`"));
    }
    if let Some(hint) = of_frames(text).or_else(|| of_fraction(text)).or_else(|| relation(text)) {
        return Some(hint);
    }
    let with_point = text.replace(',', ".");
    if with_point != text && parse_duration(&with_point).is_some() {
        return Some(format!("write a decimal point: `{with_point}`"));
    }
    if text.contains(':') {
        return almost_of_clock(text);
    }
    if text
        .split_once("..")
        .is_some_and(|(from, to)| [from, to].iter().all(|end| parse_duration(end).is_some()))
    {
        return Some("a range is not supported here: write one time".to_owned());
    }
    if is_too_long(text) {
        return Some(format!("use a time of at most {}", written(longest())));
    }
    if let Some(beat) = text.strip_prefix("beat ").filter(|beat| beat.parse::<f64>().is_ok()) {
        return Some(format!(
            "write a position with its bar, as in `bar 1 beat {beat}`, or a length as `{beat} beats`"
        ));
    }
    if let Some(length) = musical(text) {
        return Some(format!("write `{length}`"));
    }
    if let Some(position) = position(text) {
        return Some(position);
    }
    let span = in_words(&with_point)?;
    Some(format!("write `{}`", written(span)))
}

/// Returns the valid form `2s..4s` of a range that is written as `2s to 4s` or `2s - 4s`.
fn range(text: &str) -> Option<String> {
    let (from, to) = [" to ", "-", "\u{2013}"].iter().find_map(|mark| text.split_once(mark))?;
    let [from, to] = [from.trim(), to.trim()];
    let [least, largest] = [parse_duration(from)?, parse_duration(to)?];
    (least < largest).then(|| format!("{from}..{to}"))
}

/// Returns a hint for a time in frames (`48 frames`, `00:00:02:12`). The frame rate is not known, so the hint assumes 25 frames per
/// second.
fn of_frames(text: &str) -> Option<String> {
    let is_number = |part: &&str| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit());
    if let [hours, minutes, seconds, frames] = text.split([':', ';']).collect::<Vec<_>>().as_slice()
        && [hours, minutes, seconds, frames].into_iter().all(is_number)
    {
        let whole = parse_duration(&format!("{hours}h{minutes}m{seconds}s"))?;
        let frames = frames.parse::<i64>().ok().filter(|frames| *frames < 1_000)?;
        return Some(at_25_frames(&format!("{text} is"), whole + Span::from_millis(frames * 40)));
    }
    let digits = text.find(|c: char| !c.is_ascii_digit())?;
    let count: i64 = text[..digits].parse().ok()?;
    let word = text[digits..].trim();
    let millis = count.checked_mul(40).filter(|_| matches!(word, "f" | "fr" | "frame" | "frames"))?;
    Some(at_25_frames(&format!("{text} are"), Span::from_millis(millis)))
}

fn at_25_frames(text: &str, span: Span) -> String {
    format!("write a time: at 25 frames per second, {text} `{}`", written(span))
}

/// Returns a hint for a fraction of a unit, such as `1/2 beat`.
fn of_fraction(text: &str) -> Option<String> {
    let (whole, rest) = text.split_once('/')?;
    let digits = rest.find(|c: char| !c.is_ascii_digit())?;
    let unit = rest[digits..].trim();
    let sound = [whole, &rest[..digits]].iter().all(|part| part.parse::<u32>().is_ok_and(|part| part > 0));
    let musical = matches!(unit, "beat" | "beats" | "bar" | "bars");
    let time = if musical { format!("{whole} {unit}") } else { format!("{whole}{unit}") };
    (sound && (musical || unit_nanos(unit).is_some()))
        .then(|| format!("write `{time} / {}`", &rest[..digits]))
}

/// Returns a hint for a key that is written in the value, such as `at: after rise` instead of `after: rise`.
fn relation(text: &str) -> Option<String> {
    let (key, name) = text.split_once(' ')?;
    matches!(key, "after" | "with" | "before")
        .then(|| format!("write `{key}: {}` instead of `at`", name.trim()))
}

/// Whether a text is not a valid time only because its numbers are too large.
fn is_too_long(text: &str) -> bool {
    let mut short = String::new();
    for c in text.chars() {
        match c.is_ascii_digit() {
            true if short.ends_with('1') => {}
            true => short.push('1'),
            false => short.push(c),
        }
    }
    parse_duration(text).is_none() && parse_duration(&short).is_some()
}

/// Returns the valid form of a musical length that lacks the space or uses another word: `2beats`, `4 quarters`.
fn musical(text: &str) -> Option<String> {
    let (number, word) = text.split_at(text.find(|c: char| !c.is_ascii_digit() && c != '.')?);
    number.parse::<f64>().ok()?;
    let meant = match word.trim() {
        joined @ ("beat" | "beats" | "bar" | "bars") => joined,
        "measure" => "bar",
        "measures" => "bars",
        "quarter" | "quarter note" => "beat",
        "quarters" | "quarter notes" => "beats",
        _ => return None,
    };
    Some(format!("{number} {meant}"))
}

/// Parses a time such as `00:01:30` or `00:01:30.5`. Hours, minutes and seconds are all required, because two numbers would be ambiguous.
fn of_clock(text: &str) -> Option<Span> {
    let parts: Vec<&str> = text.split(':').collect();
    let [hours, minutes, seconds] = parts.as_slice() else { return None };
    let (whole, _) = seconds.split_once('.').unwrap_or((seconds, ""));
    let below_60 = |digits: &str| digits.len() == 2 && digits < "60";
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let sound = [*hours, *minutes, whole].iter().all(|part| digits(part));
    if !sound || !below_60(minutes) || !below_60(whole) {
        return None;
    }
    parse_duration(&format!("{hours}h{minutes}m{seconds}s"))
}

/// Returns a hint for a time that resembles `00:01:30`. It has a decimal comma, or only two numbers (`1:30`), or three numbers of which
/// some do not have two digits.
fn almost_of_clock(text: &str) -> Option<String> {
    let with_point = text.replace(',', ".");
    if of_clock(&with_point).is_some() {
        return Some(format!("write a decimal point: `{with_point}`"));
    }
    let numbers: Vec<u32> = text.split(':').map(|part| part.parse().ok()).collect::<Option<_>>()?;
    match numbers.as_slice() {
        [a, b] if *b < 60 => {
            let (hours, minutes) = (a / 60, a % 60);
            let as_minutes = format!("{hours:02}:{minutes:02}:{b:02}");
            Some(format!("write hours, minutes and seconds, as in `{as_minutes}` or `{a:02}:{b:02}:00`"))
        }
        [h, m, s] => parse_duration(&format!("{h}h{m}m{s}s"))
            .map(|_| format!("write two digits for minutes and seconds, each below 60, or `{h}h{m}m{s}s`")),
        _ => None,
    }
}

/// Parses a time in a form that is invalid but clear: `1 second`, `250 milliseconds`, `2 S`, `1e3ms`.
fn in_words(text: &str) -> Option<Span> {
    if let Some((number, unit)) =
        text.char_indices().rev().find(|(_, c)| c.is_ascii_digit()).map(|(at, _)| text.split_at(at + 1))
        && let (Ok(value), Some(nanos)) = (number.parse::<f64>(), unit_nanos(unit))
        && number.contains(['e', 'E'])
        && value >= 0.0
    {
        let millis = value * Span::from_nanos(i64::try_from(nanos).ok()?).as_millis_f64();
        return (millis <= urrcp::OFFSET_MS_MAX).then(|| Span::from_millis_f64(millis));
    }
    let number = text.find(|c: char| !c.is_ascii_digit() && c != '.')?;
    let (number, word) = text.split_at(number);
    let unit = match word.trim().to_ascii_lowercase().as_str() {
        "s" | "sec" | "secs" | "second" | "seconds" => "s",
        "ms" | "msec" | "millis" | "millisecond" | "milliseconds" => "ms",
        "m" | "min" | "mins" | "minute" | "minutes" => "m",
        "h" | "hour" | "hours" => "h",
        _ => return None,
    };
    parse_duration(&format!("{number}{unit}"))
}

/// Like [`parse_duration`], but with an optional leading minus sign.
pub fn parse_signed(text: &str) -> Option<Span> {
    match text.trim().strip_prefix('-') {
        Some(rest) => parse_duration(rest).map(|span| -span),
        None => parse_duration(text.trim().trim_start_matches('+')),
    }
}

/// Writes a time exactly, in the notation of scenarios: `1.5s`, `250ms`, `-2us`.
#[must_use]
pub fn written(span: Span) -> String {
    let (sign, nanos) = (if span < Span::ZERO { "-" } else { "" }, span.as_nanos().unsigned_abs());
    let (per_unit, digits, unit) = match nanos {
        1_000_000_000.. | 0 => (1_000_000_000, 9, "s"),
        1_000_000.. => (1_000_000, 6, "ms"),
        _ => (1_000, 3, "us"),
    };
    let text = format!("{}.{:0digits$}", nanos / per_unit, nanos % per_unit);
    format!("{sign}{}{unit}", text.trim_end_matches('0').trim_end_matches('.'))
}

/// Writes a number of seconds in the notation of scenarios, rounded up to whole milliseconds.
pub fn seconds(seconds: f64) -> String {
    written(Span::from_millis_f64((seconds * 1_000.0 - 1e-9).ceil()))
}

fn unit_nanos(unit: &str) -> Option<i128> {
    match unit {
        "h" => Some(3_600_000_000_000),
        "m" | "min" => Some(60_000_000_000),
        "s" => Some(1_000_000_000),
        "ms" => Some(1_000_000),
        "us" => Some(1_000),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn written_time_reads_back_unchanged() {
        let nanos = [0, 1, 999, 1_000, 420_123, 1_000_000, 999_999_999, 1_000_000_000, 216_810_420_123];
        for nanos in nanos.into_iter().chain([9_007_199_254_740_991, 99_999_999_999_999_999]) {
            let span = Span::from_nanos(nanos);
            assert_eq!(parse_signed(&written(span)), Some(span), "{}", written(span));
            assert_eq!(parse_signed(&written(-span)), Some(-span));
        }
        assert_eq!((written(Span::from_millis(1_500)), seconds(0.333_4)), ("1.5s".into(), "334ms".into()));
    }

    #[test]
    fn unsupported_time_notation_gets_hint_with_supported_form() {
        for (text, right) in [
            ("1:30", "write hours, minutes and seconds, as in `00:01:30` or `01:30:00`"),
            ("75:20", "write hours, minutes and seconds, as in `01:15:20` or `75:20:00`"),
            ("0:1:90", "write two digits for minutes and seconds, each below 60, or `0h1m90s`"),
            ("00:01:30,5", "write a decimal point: `00:01:30.5`"),
            ("1 second", "write `1s`"),
            ("2 S", "write `2s`"),
            ("0,3s", "write a decimal point: `0.3s`"),
            ("1m 30s", "write `1m30s`"),
            ("1e3ms", "write `1s`"),
            ("2s to 4s", "write a range as `2s..4s`"),
            ("2s - 4s", "write a range as `2s..4s`"),
            ("48 frames", "write a time: at 25 frames per second, 48 frames are `1.92s`"),
            ("00:00:02:12", "write a time: at 25 frames per second, 00:00:02:12 is `2.48s`"),
            ("00:01:02;12", "write a time: at 25 frames per second, 00:01:02;12 is `62.48s`"),
            ("1/2 beat", "write `1 beat / 2`"),
            ("1/3 s", "write `1s / 3`"),
            ("after rise", "write `after: rise` instead of `at`"),
        ] {
            assert_eq!(hint(text).as_deref(), Some(right));
        }
        for (text, right) in [
            ("bar 4.2", "write a position as `bar 4 beat 2`, or a length as `4 bars 2 beats`"),
            ("bars 4-8", "write a range as `bar 4..bar 8`"),
            ("beats 1-3", "write a position as `bar 3 beat 2`, or a length as `3 bars 2 beats`"),
        ] {
            assert_eq!(position(text).as_deref(), Some(right));
        }
        for (text, right) in [
            ("1..3", Some("add the unit: `1s..3s`")),
            ("1..3s", Some("write `1s..3s`")),
            ("500ms..800", Some("write `500ms..800ms`")),
            ("bar 4..8", Some("write `bar 4..bar 8`")),
            ("1s..3s", None),
            ("$a..$b", None),
            ("bar 1..bar 3", None),
        ] {
            assert_eq!(bare_range(text).as_deref(), right, "{text}");
        }
        assert!(hint("-1s").is_some());
        assert_eq!(hint("later"), None);
    }

    #[test]
    fn date_or_time_of_day_is_distinguished_from_duration_and_expression() {
        for date in ["2026-12-01", "2026-12-01T20:00:00Z", "2026-12-01 20:00", "1.12.2026", "12/01/2026"] {
            assert_eq!(instant(date), Some("date"), "{date}");
        }
        for time in ["8pm", "7:30 PM", "11am"] {
            assert_eq!(instant(time), Some("time of day"), "{time}");
        }
        for other in ["20:00", "2s-1s", "2026-12", "4-4", "1.2.3", "10 / 2 / 1", "spam", "am", "$a-$b-$c"] {
            assert_eq!(instant(other), None, "{other}");
        }
    }

    #[test]
    fn times_are_parsed_in_common_notations() {
        let millis = |text| parse_duration(text).map(Span::as_millis_f64);
        assert_eq!(millis("2s"), Some(2_000.0));
        assert_eq!(millis("250ms"), Some(250.0));
        assert_eq!(millis("1m30s"), Some(90_000.0));
        assert_eq!(millis("1.5s"), Some(1_500.0));
        assert_eq!(millis("200us"), Some(0.2));
        assert_eq!(millis("00:01:30"), Some(90_000.0));
        assert_eq!(millis("1:02:03.25"), Some(3_723_250.0));
        assert_eq!(millis("100:00:00"), Some(360_000_000.0));
        for wrong in ["01:30", "00:60:00", "00:00:60", "0:1:30", "::", "00:01:30s", "-00:00:01", "00:01:3.0"]
        {
            assert_eq!(millis(wrong), None, "{wrong}");
        }
        for wrong in ["", "2", "s", "2 parsecs", "-1s", "1..5s", "1e9s", "9999999999999s"] {
            assert_eq!(millis(wrong), None, "{wrong}");
        }
        assert_eq!(parse_signed("-120ms"), Some(Span::from_millis(-120)));
    }
}
