//! Writes measurements as a world file, with comments on how they were measured. The same recording always gives the same bytes.

use downbeat_import::scalar;
use downbeat_scripts::{counted, written};
use urrcp::{RobotId, Span};

use super::clock::{ClockMeasured, Follows};
use super::link::{Interruption, LinkMeasured, Loss, Method};
use super::told::{Break, OperatorMeasured, SensorMeasured};
use super::{Measured, RobotMeasured};
use crate::history::HistorySource;

/// Minimum number of samples to state the 99th percentile. With fewer samples, it hardly differs from the largest value.
const SAMPLES_FOR_P99: usize = 100;
/// Number of sensor readings per line of the file.
const READINGS_ON_A_LINE: usize = 4;

/// Creates the text of a world file from measurements. `file` is the name of the measured file.
#[must_use]
pub fn world_text(measured: &Measured, file: &str) -> String {
    let mut text = head(measured, file);
    let robots = &measured.robots;
    let links = robots.iter().filter_map(|robot| Some(link(&robot.robot, robot.link.as_ref()?)));
    section(&mut text, "links", links);
    let clocks = robots.iter().filter_map(|robot| Some(clock(&robot.robot, robot.clock.as_ref()?)));
    section(&mut text, "clocks", clocks);
    section(&mut text, "sensors", measured.sensors.iter().map(sensor));
    text += &operator(&measured.operator);
    section(&mut text, "incidents", robots.iter().flat_map(incidents));
    text
}

/// Appends `entries` under `key`, if any entry contains more than comments.
fn section(text: &mut String, key: &str, entries: impl Iterator<Item = String>) {
    let entries: String = entries.collect();
    let says_something = entries.lines().any(|line| !line.trim_start().starts_with('#'));
    *text += &if says_something { format!("{key}:\n{entries}") } else { entries };
}

fn head(measured: &Measured, file: &str) -> String {
    let began = measured.began.to_string();
    let (date, second) = (began.get(..10).unwrap_or_default(), began.get(..19).unwrap_or_default());
    let scenario = measured.scenario.as_deref().unwrap_or("mission");
    let mut text = format!(
        "# Measured in {} by downbeat {}.\n# Mission {}, {second}Z, {}.\n",
        scalar(file),
        env!("CARGO_PKG_VERSION"),
        scalar(scenario),
        micros(measured.duration),
    );
    if let Some(cut_off) = &measured.cut_off {
        text += &format!(
            "# The file is incomplete: {}. Only the part before that was measured.\n",
            scalar(cut_off)
        );
    }
    text += match measured.source {
        HistorySource::Recording => {
            "#
# Delays are one-way and come from the timestamps in the answers of the robots. The least delay is assumed to be the same in both directions:
# exchanges of timestamps cannot tell an asymmetric path from an offset of the clock (RFC 5905, section 8).
# Packets that arrived 200 ms or more after the fastest one count as lost and sent again by TCP; a pause of the robot, of the radio or of this
# machine looks the same. Not measured: errors of robots, and delays while no request was sent.
"
        }
        HistorySource::Journal => {
            "#
# A journal contains no messages: delays, losses, sensors and drifts were not measured.
"
        }
    };
    for robot in measured.robots.iter().filter(|robot| !robot.says_something()) {
        text += &format!("# {}: nothing was measured.\n", scalar(robot.robot.as_str()));
    }
    text + &format!("world: {}\n", scalar(&format!("{scenario}-{date}")))
}

fn link(robot: &RobotId, link: &LinkMeasured) -> String {
    let delay = &link.delay;
    let way = match link.method {
        Method::EachWay => "each direction separately",
        Method::HalfRoundTrip => {
            "half of each round trip, because the robot's clock was set or has a coarse resolution"
        }
    };
    let samples =
        format!("{} of {}, {way}", counted(link.samples, "delay"), counted(link.exchanges, "exchange"));
    let few = if link.samples < SAMPLES_FOR_P99 { "; p99 is based on few samples" } else { "" };
    let mut text = format!(
        "  # {samples}{few}\n  {}:\n    delay: {{least: {}, p50: {}, p90: {}, p99: {}, largest: {}}}\n",
        scalar(robot.as_str()),
        micros(delay.least),
        micros(delay.p50),
        micros(delay.p90),
        micros(delay.p99),
        micros(delay.largest),
    );
    text += &loss(&link.loss);
    text + &interruptions(link)
}

fn loss(loss: &Loss) -> String {
    let Loss { lost, packets, share, below, resent_after } = loss;
    let of = counted(*packets, "packet");
    match (below, resent_after) {
        (Some(below), _) => {
            format!("    # lost: none of {of}, so below {} with 95 % confidence\n", percent(*below))
        }
        (None, Some(resent)) => format!(
            "    # lost: {lost} of {of}\n    loss: {}\n    resent_after: {}\n",
            percent(*share),
            written(Span::from_millis(resent.as_nanos() / 1_000_000))
        ),
        (None, None) => String::new(),
    }
}

fn interruptions(link: &LinkMeasured) -> String {
    let lasted = link.interruptions.iter().map(|one: &Interruption| one.lasted);
    let Some((least, most)) = lasted.clone().min().zip(lasted.max()) else { return String::new() };
    let every = micros(link.interruption_every.unwrap_or_default());
    format!(
        "    # {} of at least this length, during which the connection stayed up\n    interruptions: [{{every: {every}, lasts: {}}}]\n",
        counted(link.interruptions.len(), "pause"),
        from_to(least, most),
    )
}

fn clock(robot: &RobotId, clock: &ClockMeasured) -> String {
    let mut comment = match clock.uncertainty {
        Some(uncertainty) => format!(
            "offset {} ±{}, {}",
            micros(clock.offset),
            micros(uncertainty),
            counted(clock.exchanges, "exchange")
        ),
        None => "the clock offset that was added to the timestamps of the robot".to_owned(),
    };
    if clock.steps > 0 {
        comment += &format!(", set {} during the mission", times(clock.steps));
    }
    if let Some(error) = clock.start_error {
        comment += &format!(", starts up to {} off by its own clock", micros(error));
    }
    let keys = match clock.follows {
        Some(Follows::Measured) => {
            match clock.drift {
                Some(drift) => {
                    comment += &format!(", drift {:.1} to {:.1} ppm", drift.least, drift.most);
                }
                None => comment += ", drift not measured",
            }
            let drift = clock.drift.map_or_else(String::new, |drift| format!(", drift: {:.1}ppm", drift.ppm));
            format!("offset: {}{drift}", micros(clock.offset))
        }
        Some(Follows::Ntp) | None => match clock.surely_off {
            Some(off) => {
                comment += ": the clock was certainly off, by about this much";
                format!("error: {}", micros(off))
            }
            None => {
                comment += ": no error was detected, but an error of this size cannot be ruled out";
                format!("error: {}", micros(clock.uncertainty.unwrap_or_default()))
            }
        },
    };
    if clock.offset.as_millis_f64().abs() > urrcp::OFFSET_MS_MAX {
        return format!("  # {}: {comment}: out of range for a world file\n", scalar(robot.as_str()));
    }
    if clock.follows.is_none() {
        comment += "; no script was sent to the robot, so its clock is assumed to follow NTP";
    }
    format!("  # {comment}\n  {}: {{{keys}}}\n", scalar(robot.as_str()))
}

fn sensor(sensor: &SensorMeasured) -> String {
    let key = format!("{}/{}", sensor.robot, sensor.sensor);
    let mut text = format!(
        "  # {}; the first one applies from the beginning\n  {}:",
        counted(sensor.readings, "reading"),
        scalar(&key)
    );
    let at = |index: usize, at: Span| if index == 0 { "0s".to_owned() } else { micros(at) };
    let values = sensor.values.iter().enumerate();
    let values: Vec<String> =
        values.map(|(index, (time, value))| format!("[{}, {value}]", at(index, *time))).collect();
    if values.len() > READINGS_ON_A_LINE {
        values.iter().for_each(|value| text += &format!("\n    - {value}"))
    } else {
        text += &format!(" [{}]", values.join(", "))
    }
    text + "\n"
}

fn operator(operator: &OperatorMeasured) -> String {
    let (waits, unanswered) = (&operator.waits, operator.unanswered);
    let Some((least, most)) = waits.iter().min().zip(waits.iter().max()) else { return String::new() };
    let mut text = format!("# {} for the operator's go", counted(waits.len(), "wait"));
    if unanswered > 0 {
        text += &format!(", and {unanswered} that received none");
    }
    text + &format!("\noperator: {{go_after: {}}}\n", from_to(*least, *most))
}

fn incidents(robot: &RobotMeasured) -> Vec<String> {
    let incident = |one: &Break| {
        let note = if one.back {
            ""
        } else {
            "  # The connection was not restored by the end of the file: the robot may have failed.\n"
        };
        format!(
            "{note}  - {{robot: {}, what: link_down, at: {}, lasts: {}}}\n",
            scalar(robot.robot.as_str()),
            micros(one.at),
            micros(one.lasted)
        )
    };
    robot.breaks.iter().map(incident).collect()
}

/// Formats a range of times, or a single time if both ends are equal.
fn from_to(least: Span, most: Span) -> String {
    if micros(least) == micros(most) {
        micros(least)
    } else {
        format!("{{from: {}, to: {}}}", micros(least), micros(most))
    }
}

/// Formats a time, rounded to microseconds, the resolution of robots' timestamps.
fn micros(span: Span) -> String {
    let half = if span < Span::ZERO { -500 } else { 500 };
    written(Span::from_micros((span.as_nanos() + half) / 1_000))
}

/// Formats a share as a percentage with three significant digits.
fn percent(share: f64) -> String {
    let percent = share * 100.0;
    let digits = (0..6).find(|digits| percent * 10f64.powi(*digits) >= 100.0).unwrap_or(6);
    let digits = usize::try_from(digits).unwrap_or(0);
    let text = format!("{percent:.digits$}");
    if text.contains('.') {
        format!("{}%", text.trim_end_matches('0').trim_end_matches('.'))
    } else {
        format!("{text}%")
    }
}

fn times(count: u32) -> String {
    match count {
        1 => "once".to_owned(),
        count => format!("{count} times"),
    }
}
