//! Rulers of charts and pictures: ticks at round times, such as every 0.5 s, and their labels.

use downbeat_scripts::Act;

const SECOND: f64 = 1_000.0;
const MINUTE: f64 = 60.0 * SECOND;
const HOUR: f64 = 60.0 * MINUTE;

/// Permitted intervals between two ticks, in milliseconds.
const ROUND: [f64; 26] = [
    0.1,
    0.2,
    0.5,
    1.0,
    2.0,
    5.0,
    10.0,
    20.0,
    50.0,
    100.0,
    200.0,
    500.0,
    SECOND,
    2.0 * SECOND,
    5.0 * SECOND,
    10.0 * SECOND,
    15.0 * SECOND,
    30.0 * SECOND,
    MINUTE,
    2.0 * MINUTE,
    5.0 * MINUTE,
    10.0 * MINUTE,
    15.0 * MINUTE,
    30.0 * MINUTE,
    HOUR,
    2.0 * HOUR,
];

/// A tick at a round time on a ruler.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tick {
    /// Milliseconds since the act's start.
    pub(super) millis: f64,
    /// The tick's label: `0.5 s`, or `1:30` if the act lasts a minute or longer.
    pub(super) label: String,
}

/// Returns the length of an act's ruler in milliseconds, at least 1. The ruler ends at the act's last step or at the end of its last cue,
/// whichever is later.
pub(super) fn length(act: &Act) -> f64 {
    let ends = act.cues.iter().map(|cue| cue.end).max().unwrap_or_default();
    act.duration().max(ends).as_millis_f64().max(1.0)
}

/// Returns the ticks for an act that lasts `total` milliseconds: one tick at zero, and at most `most` more.
pub(super) fn ticks(total: f64, most: usize) -> Vec<Tick> {
    let every = every(total, most.max(1) as f64);
    let count = (total / every * (1.0 + 1e-9)).floor() as u32;
    let tick = |index: u32| {
        let millis = f64::from(index) * every;
        Tick { millis, label: label(millis, total, every) }
    };
    (0..=count).map(tick).collect()
}

fn every(total: f64, most: f64) -> f64 {
    let round = ROUND.into_iter().find(|every| total / every <= most);
    round.unwrap_or_else(|| HOUR * (total / HOUR / most).ceil())
}

fn label(millis: f64, total: f64, every: f64) -> String {
    if total < SECOND {
        return format!("{} ms", rounded(millis));
    }
    if total < MINUTE {
        return format!("{} s", rounded(millis / SECOND));
    }
    let (hours, minutes) = ((millis / HOUR).floor(), (millis % HOUR / MINUTE).floor());
    let seconds = rounded(millis % MINUTE / SECOND);
    let seconds = if every < SECOND { format!("{seconds:04.1}") } else { format!("{seconds:02}") };
    if hours > 0.0 { format!("{hours}:{minutes:02}:{seconds}") } else { format!("{minutes}:{seconds}") }
}

/// Removes floating-point errors from the time of a tick, given in milliseconds or seconds. The time is a multiple of a tenth of a
/// millisecond, so four decimal places are enough.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(total: f64, most: usize, expected: &[&str]) {
        let labels: Vec<_> = ticks(total, most).into_iter().map(|tick| tick.label).collect();
        assert_eq!(labels, expected, "{total} ms");
    }

    #[test]
    fn ticks_are_round_and_labelled_in_familiar_units() {
        check(0.9, 3, &["0 ms", "0.5 ms"]);
        check(300.0, 3, &["0 ms", "100 ms", "200 ms", "300 ms"]);
        check(4_250.0, 10, &["0 s", "0.5 s", "1 s", "1.5 s", "2 s", "2.5 s", "3 s", "3.5 s", "4 s"]);
        check(90_000.0, 3, &["0:00", "0:30", "1:00", "1:30"]);
        check(2.0 * HOUR, 2, &["0:00", "1:00:00", "2:00:00"]);
        check(100.0 * HOUR, 2, &["0:00", "50:00:00", "100:00:00"]);
    }

    #[test]
    fn number_of_ticks_is_limited_by_available_space() {
        for total in (0..160).map(|exponent| 1.2_f64.powi(exponent)) {
            for most in [0, 1, 3, 10, 60] {
                let ticks = ticks(total, most);
                assert!(ticks.len() <= most.max(1) + 1, "{total} ms, {most}: {ticks:?}");
                assert!(ticks.iter().all(|tick| tick.millis <= total * 1.001), "{total} ms, {most}");
            }
        }
    }
}
