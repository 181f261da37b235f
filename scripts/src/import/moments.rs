//! Times as tables write them: numbers in some unit, frames, or hours, minutes and seconds with colons between.

use std::str::FromStr;

/// What the numbers of a column of times mean.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TimeUnit {
    /// So many seconds each.
    Seconds(f64),
    /// Frames, this many a second.
    Frames(f64),
    /// `hh:mm:ss` and `hh:mm:ss.fff`.
    HoursMinutesSeconds,
    /// `mm:ss` and `mm:ss.fff`.
    MinutesSeconds,
    /// `mm:ss:ms`, where the last number counts milliseconds.
    MinutesSecondsMillis,
}

/// What can be told where a unit is asked for.
pub(super) const UNITS: &str = "h, min, s, ms, us, ns, 25fps, hh:mm:ss, mm:ss or mm:ss:ms";

const CLOCKS: [(&str, TimeUnit); 3] = [
    ("hh:mm:ss", TimeUnit::HoursMinutesSeconds),
    ("mm:ss", TimeUnit::MinutesSeconds),
    ("mm:ss:ms", TimeUnit::MinutesSecondsMillis),
];

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
    /// The seconds that a text says, if it is a time of this kind.
    pub(super) fn seconds(self, text: &str) -> Option<f64> {
        let number = |text: &str| text.trim().parse::<f64>().ok().filter(|number| number.is_finite());
        let parts: Vec<&str> = text.trim().split(':').collect();
        match (self, parts.as_slice()) {
            (Self::Seconds(size), [one]) => Some(number(one)? * size),
            (Self::Frames(rate), [one]) => Some(number(one)? / rate),
            (Self::HoursMinutesSeconds, [h, m, s]) => {
                Some(whole(h)? * 3_600.0 + sixtieth(whole(m)?)? * 60.0 + sixtieth(decimal(s)?)?)
            }
            (Self::MinutesSeconds, [m, s]) => Some(whole(m)? * 60.0 + sixtieth(decimal(s)?)?),
            (Self::MinutesSecondsMillis, [m, s, ms]) => {
                let ms = whole(ms).filter(|ms| *ms < 1_000.0)?;
                Some(whole(m)? * 60.0 + sixtieth(whole(s)?)? + ms / 1_000.0)
            }
            _ => None,
        }
    }
}

fn whole(text: &str) -> Option<f64> {
    (!text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())).then(|| text.parse().ok())?
}

/// Seconds with or without decimals, of two digits at most: `033` is no number of seconds.
fn decimal(text: &str) -> Option<f64> {
    if text.split('.').next().is_some_and(|whole| whole.len() > 2) {
        return None;
    }
    let plain = text.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.');
    plain.then(|| text.parse().ok())?
}

fn sixtieth(value: f64) -> Option<f64> {
    (value < 60.0).then_some(value)
}

/// What the name of a column of times says about its unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Said {
    Unit(TimeUnit),
    /// It says something, but not which unit.
    Unclear,
    Nothing,
}

/// `Time [msec]`, `t (ms)`, `time_ms`, `t/ms`, `timeMs`, `ms since start`, `seconds`.
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
        // A single letter in front is a name, as in `s1 time`.
        (index == last || word.chars().count() > 1).then(|| spelled(word)).flatten()
    });
    match (units.next(), units.next()) {
        (Some(unit), None) => Said::Unit(unit),
        (Some(unit), Some(other)) if unit == other => Said::Unit(unit),
        (Some(_), Some(_)) => Said::Unclear,
        (None, _) => Said::Nothing,
    }
}

/// Its words, apart also where a capital follows a small letter.
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

/// A unit as people spell it.
fn spelled(word: &str) -> Option<TimeUnit> {
    Some(TimeUnit::Seconds(match word.to_lowercase().trim_end_matches('.') {
        "h" | "hr" | "hrs" | "hour" | "hours" => 3_600.0,
        "min" | "mins" | "minute" | "minutes" => 60.0,
        "s" | "sec" | "secs" | "second" | "seconds" => 1.0,
        "ms" | "msec" | "msecs" | "milli" | "millis" | "millisec" | "millisecs" | "millisecond"
        | "milliseconds" => 1e-3,
        "us" | "\u{b5}s" | "\u{3bc}s" | "usec" | "usecs" | "\u{b5}sec" | "\u{3bc}sec" | "micros"
        | "microsec" | "microsecs" | "microsecond" | "microseconds" => 1e-6,
        "ns" | "nsec" | "nsecs" | "nanos" | "nanosec" | "nanosecs" | "nanosecond" | "nanoseconds" => 1e-9,
        _ => return None,
    }))
}

/// The ways of writing clock times that fit all of these texts, with their words.
pub(super) fn clocks<'a>(texts: impl Iterator<Item = &'a str>) -> Vec<(&'static str, TimeUnit)> {
    let mut fitting = CLOCKS.to_vec();
    for text in texts {
        fitting.retain(|(_, clock)| clock.seconds(text).is_some());
    }
    fitting
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_read_in_their_usual_spellings() {
        let millis = Said::Unit(TimeUnit::Seconds(1e-3));
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
            assert_eq!(said_by(header), Said::Unit(TimeUnit::Seconds(1.0)), "{header}");
        }
        assert_eq!(said_by("t [\u{3bc}s]"), Said::Unit(TimeUnit::Seconds(1e-6)));
        for header in ["t", "time", "Timestamp", "frame", "s1 time", "%time", ""] {
            assert_eq!(said_by(header), Said::Nothing, "{header}");
        }
        for header in ["t [m]", "time (local)", "secs.nsecs"] {
            assert_eq!(said_by(header), Said::Unclear, "{header}");
        }
    }

    #[test]
    fn clock_times_are_read_where_only_one_reading_fits() {
        let seconds = |unit: &str, text| unit.parse::<TimeUnit>().ok().and_then(|unit| unit.seconds(text));
        assert_eq!(seconds("mm:ss:ms", "01:02:345"), Some(62.345));
        assert_eq!(seconds("mm:ss:ms", "1:2:5"), Some(62.005));
        assert_eq!(seconds("hh:mm:ss", "01:02:03.25"), Some(3_723.25));
        assert_eq!(seconds("mm:ss", "2:03.5"), Some(123.5));
        assert_eq!(seconds("25fps", "50"), Some(2.0));
        for wrong in ["", "1", "1:2", "1:60:0", "1:2:1000", "-1:2:3", "1:2:3:4", "a:b:c"] {
            assert_eq!(seconds("mm:ss:ms", wrong), None, "{wrong}");
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
}
