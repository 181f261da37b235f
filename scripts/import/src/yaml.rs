//! Writes imported motion as a scenario that people can read, with one keyframe per line.

use std::borrow::Cow;
use std::fmt::Write;

use urrcp::{InitializationBlock, Span};

use downbeat_yaml::duration;

use super::fleet_part::asked;
use super::grid::on_grid;
use super::{Course, DeviceMotion, Imported, Keyframe, Scene};

/// How the imported scenes are combined into one scenario.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scenes {
    /// Each scene becomes an act, a part of the scenario that is started separately.
    Acts,
    /// All scenes become one list of cues, one scene after another.
    Joined,
}

/// Largest difference between two values that count as equal. It allows for rounding in the files.
const SAME: f64 = 1e-5;

/// Returns the text of a scenario file with the imported motion. `fleet` is the fleet file that the scenario refers to, if any.
#[must_use]
pub fn scenario_text(
    imported: &Imported,
    scenes: Scenes,
    init: Option<&InitializationBlock>,
    fleet: Option<&str>,
) -> String {
    let mut text = format!("# Imported from {}.\n", one_line(&imported.origin));
    line(&mut text, format_args!("scenario: {}", scalar(&imported.name)));
    if let Some(fleet) = fleet {
        line(&mut text, format_args!("fleet: {}", scalar(fleet)));
    }
    if !all_on_grid(imported, init) {
        text.push_str(
            "off_grid: snap # some values of the files are not multiples of the robots' granularity\n",
        );
    }
    match (imported.scenes.as_slice(), scenes) {
        ([one], _) => {
            text.push_str("cues:\n");
            Cues { text: &mut text, indent: 2 }.scene(one, "", Span::ZERO, &mut Joints::default());
        }
        (all, Scenes::Joined) => {
            text.push_str("cues:\n");
            let mut cues = Cues { text: &mut text, indent: 2 };
            let mut joints = Joints::default();
            let mut start = Span::ZERO;
            for scene in all {
                cues.scene(scene, &format!("{}: ", scene.name), start, &mut joints);
                start += scene.duration();
            }
        }
        (all, Scenes::Acts) => {
            text.push_str("acts:\n");
            for scene in all {
                line(&mut text, format_args!("  - act: {}\n    cues:", scalar(&scene.name)));
                Cues { text: &mut text, indent: 6 }.scene(scene, "", Span::ZERO, &mut Joints::default());
            }
        }
    }
    text
}

/// Returns the number of keyframes and polynomial pieces that are written to the scenario. In joined scenes, a keyframe that repeats the
/// end of the previous scene is left out.
#[must_use]
pub fn steps_written(imported: &Imported, scenes: Scenes) -> usize {
    if scenes == Scenes::Acts {
        return imported.devices().map(|(_, device)| device.written()).sum();
    }
    let mut joints = Joints::default();
    let mut start = Span::ZERO;
    let mut steps = 0;
    for scene in &imported.scenes {
        for robot in &scene.robots {
            let written = |device: &DeviceMotion| match device.course {
                Course::Pieces(_) => device.written(),
                _ => joints.rest(&robot.robot, device, start).len(),
            };
            steps += robot.devices.iter().map(written).sum::<usize>();
        }
        start += scene.duration();
    }
    steps
}

/// The last time and value of each device in the scenes written so far, by robot and device.
#[derive(Default)]
struct Joints(std::collections::HashMap<(String, String), (Span, f64)>);

impl Joints {
    /// Returns the keyframes of a device. The first one is left out if it only repeats the end of the previous scene.
    fn rest<'a>(&mut self, robot: &str, device: &'a DeviceMotion, start: Span) -> &'a [Keyframe] {
        let all = device.keyframes.as_slice();
        if let Course::Pieces(_) | Course::Several(_) = device.course {
            return all;
        }
        let (Some(first), Some(last)) = (all.first(), all.last()) else { return all };
        let key = (robot.to_owned(), device.device.clone());
        let before = self.0.insert(key, (start + last.at, last.value));
        let repeats =
            before.is_some_and(|(at, value)| at == start + first.at && (value - first.value).abs() <= SAME);
        if repeats && all.len() > 1 { &all[1..] } else { all }
    }
}

fn all_on_grid(imported: &Imported, init: Option<&InitializationBlock>) -> bool {
    match init {
        None => asked(imported).iter().all(|asked| asked.grid.complete),
        Some(init) => imported.devices().all(|(_, device)| {
            let limits = init
                .device(&device.device)
                .and_then(|block| block.available_control_types.limits(urrcp::ControlType::Position));
            let fitted = matches!(device.course, Course::Pieces(_));
            let values = || device.values();
            limits.is_none_or(|limits| {
                fitted || values().iter().all(|value| on_grid(*value, limits.granularity))
            })
        }),
    }
}

struct Cues<'a> {
    text: &'a mut String,
    indent: usize,
}

impl Cues<'_> {
    fn scene(&mut self, scene: &Scene, prefix: &str, start: Span, joints: &mut Joints) {
        for robot in &scene.robots {
            let name = scalar(&robot.robot);
            let cue = format!("{prefix}{}", robot.robot);
            self.line(0, format_args!("- cue: {}", scalar(&cue)));
            self.line(2, format_args!("at: {}", time(start)));
            self.line(2, format_args!("robots: {name}"));
            self.line(2, format_args!("tracks:"));
            for device in &robot.devices {
                self.line(4, format_args!("{}:", scalar(&device.device)));
                self.track(device, joints.rest(&robot.robot, device, start));
            }
        }
    }

    fn track(&mut self, device: &DeviceMotion, rest: &[Keyframe]) {
        match &device.course {
            Course::Pieces(pieces) => {
                self.line(6, format_args!("polynomial:"));
                for piece in pieces {
                    let (length, coefficients) = (duration::written(piece.length), list(&piece.coefficients));
                    self.line(8, format_args!("- {{for: {length}, coefficients: {coefficients}}}"));
                }
            }
            Course::Several(values) => {
                let skipped = values.len().saturating_sub(rest.len());
                for (keyframe, values) in rest.iter().zip(&values[skipped..]) {
                    self.line(6, format_args!("- {{at: {}, to: {}}}", time(keyframe.at), list(values)));
                }
            }
            course @ (Course::Straight | Course::Held) => {
                let ease = if *course == Course::Held { ", ease: step" } else { "" };
                for Keyframe { at, value } in rest {
                    self.line(6, format_args!("- {{at: {}, to: {}{ease}}}", time(*at), number(*value)));
                }
            }
        }
    }

    fn line(&mut self, indent: usize, content: std::fmt::Arguments<'_>) {
        let spaces = self.indent + indent;
        line(self.text, format_args!("{:spaces$}{content}", ""));
    }
}

pub(super) fn line(text: &mut String, content: std::fmt::Arguments<'_>) {
    // Writing to a `String` cannot fail.
    let _infallible = writeln!(text, "{content}");
}

/// Writes a time with its unit: in seconds if they are whole, or else in milliseconds if they are whole, or else exactly.
fn time(at: Span) -> String {
    let nanos = at.as_nanos();
    match (nanos % 1_000_000_000, nanos % 1_000_000) {
        (0, _) => format!("{}s", nanos / 1_000_000_000),
        (_, 0) => format!("{}ms", nanos / 1_000_000),
        _ => duration::written(at),
    }
}

/// Writes a number so that it is parsed as the same value. Very large and very small numbers are written with an exponent.
pub(super) fn number(value: f64) -> String {
    let size = value.abs();
    if size == 0.0 || (1e-9..1e15).contains(&size) { format!("{value}") } else { format!("{value:.17e}") }
}

fn list(values: &[f64]) -> String {
    let values: Vec<_> = values.iter().map(|value| number(*value)).collect();
    format!("[{}]", values.join(", "))
}

/// Writes a text as a YAML scalar: plain if that is unambiguous, otherwise in double quotes.
#[must_use]
pub fn scalar(text: &str) -> Cow<'_, str> {
    if is_plain(text) {
        return Cow::Borrowed(text);
    }
    let mut quoted = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => {
                quoted.push('\\');
                quoted.push(c);
            }
            ' '..='~' => quoted.push(c),
            _ if u32::from(c) <= 0xffff => quoted.push_str(&format!("\\u{:04x}", u32::from(c))),
            _ => quoted.push_str(&format!("\\U{:08x}", u32::from(c))),
        }
    }
    quoted.push('"');
    Cow::Owned(quoted)
}

fn is_plain(text: &str) -> bool {
    let inner = |c: char| c.is_ascii_alphanumeric() || "_-./ ".contains(c);
    let words = ["true", "false", "null", "yes", "no", "on", "off"];
    text.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && !text.ends_with(' ')
        && text.chars().all(inner)
        && !words.contains(&text.to_lowercase().as_str())
}

pub(super) fn one_line(text: &str) -> String {
    text.chars().map(|c| if c.is_control() || c == '\u{2028}' || c == '\u{2029}' { ' ' } else { c }).collect()
}
