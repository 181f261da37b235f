//! Measures the time and peak memory of parsing and compiling large shows, each in a separate process. The baseline is the YAML library
//! alone, which parses the same bytes into its generic values.
//!
//! `cargo bench -p downbeat-scripts --bench large_shows`
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark at a terminal")]
#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
#![expect(clippy::cast_precision_loss, reason = "figures for people")]

mod compiling;

use std::fmt::Write;
use std::hint::black_box;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use compiling::{peak_memory, simulated, steps};
use downbeat_scripts::{Fleet, NoFiles, Source, compile};
use serde_yaml::Value;

/// Number of runs of each case. The shortest time and the largest memory are used.
const RUNS: usize = 3;

/// A generated scenario that is compiled.
struct Case {
    name: &'static str,
    /// Generates the text of the scenario.
    text: fn() -> String,
    /// Whether the project promises bounds for this case: 1 s for a million steps and 300 bytes a step.
    bounded: bool,
}

const CASES: [Case; 7] = [
    Case { name: "light show, 370,000 steps", text: || light_show(370_000), bounded: true },
    Case { name: "light show, 1,010,000 steps", text: || light_show(1_010_000), bounded: true },
    Case { name: "colours, 1,000,000 steps", text: || colours(1_000_000), bounded: true },
    Case { name: "640,000 imported keyframes with fades", text: || faded(640_000), bounded: true },
    Case { name: "1,000,000 keyframes in JSON's style", text: || json(1_000_000), bounded: true },
    Case { name: "81 short motions as acts", text: || acts(81), bounded: false },
    Case { name: "9 MB of aliases", text: || aliases(9_000_000), bounded: false },
];

fn device(name: &str, interpolation: &str) -> String {
    let limits = r#""min_value": -1000, "max_value": 1000, "granularity": 0.001, "max_error": 0.01"#;
    format!(
        r#"{{"id": "{name}", "name": "{name}", "interpolation": "{interpolation}", "script_queue": 4,
        "available_control_types": {{"position": {{{limits}}},
        "custom_1": {{}}, "script": {{{limits}, "max_number_of_steps": 5000000}}}}}}"#
    )
}

/// Returns a fleet of ten robots, each with 16 lamps that hold their values and 20 axes that move.
fn fleet() -> Fleet {
    let robot = |index: usize| {
        let lamps = (0..16).map(|lamp| device(&format!("lamp {lamp}"), "hold"));
        let axes = (0..20).map(|axis| device(&format!("axis {axis}"), "linear"));
        let devices: Vec<String> = lamps.chain(axes).collect();
        let text =
            format!(r#"{{"id": "r{index}", "api_version": "1", "devices": [{}]}}"#, devices.join(", "));
        simulated(serde_json::from_str(&text).unwrap())
    };
    Fleet { robots: (0..10).map(robot).collect(), ..Fleet::default() }
}

/// Returns a scenario for ten robots with `each` tracks per robot. `items` keyframes are distributed evenly over all tracks.
fn tracks(items: usize, names: &str, each: usize, item: impl Fn(usize, usize) -> String) -> String {
    let mut text = "scenario: large\ncues:\n".to_owned();
    for robot in 0..10 {
        let _infallible = writeln!(text, "  - cue: c{robot}\n    at: 0s\n    robots: r{robot}\n    tracks:");
        for track in 0..each {
            let _infallible = writeln!(text, "      {names} {track}:");
            for index in 0..items / 10 / each {
                let _infallible = writeln!(text, "        - {}", item(track, index));
            }
        }
    }
    text
}

/// Returns a value that changes with every index and is a multiple of every device's granularity.
fn value(track: usize, index: usize) -> f64 {
    ((index * 37 + track * 11) % 255) as f64 / 8.0
}

/// Returns a scenario with lamps that are switched every 40 ms.
fn light_show(steps: usize) -> String {
    tracks(steps, "lamp", 16, |track, index| format!("{{at: {}ms, to: {}}}", index * 40, value(track, index)))
}

/// Returns a scenario with lamps whose keyframes have three values, one per primary colour.
fn colours(steps: usize) -> String {
    tracks(steps, "lamp", 16, |track, index| {
        let colour = [index % 256, index * 7 % 256, (index + track) % 256];
        format!("{{at: {}ms, to: [{}, {}, {}]}}", index * 40, colour[0], colour[1], colour[2])
    })
}

/// Returns a scenario with axes as `downbeat import` writes them. Every eighth keyframe is a fade.
fn faded(keyframes: usize) -> String {
    tracks(keyframes, "axis", 20, |track, index| {
        let ease = if index % 8 == 1 { ", ease: smooth" } else { "" };
        format!("{{at: {}ms, to: {}{ease}}}", index * 40, value(track, index))
    })
}

/// Returns a scenario in JSON as programs write it: each keyframe is an object, and all keyframes of a track are on one line.
fn json(keyframes: usize) -> String {
    let mut text = "{\"scenario\": \"large\", \"cues\": [".to_owned();
    for robot in 0..10 {
        let comma = if robot == 0 { "" } else { "," };
        let _infallible = write!(text, "{comma}\n{{\"at\": \"0s\", \"robots\": \"r{robot}\", \"tracks\": {{");
        for track in 0..16 {
            let comma = if track == 0 { "" } else { ", " };
            let keyframe =
                |index: usize| format!("{{\"at\": \"{}ms\", \"to\": {}}}", index * 40, value(track, index));
            let all: Vec<String> = (0..keyframes / 160).map(keyframe).collect();
            let _infallible = write!(text, "{comma}\"lamp {track}\": [{}]", all.join(", "));
        }
        text.push_str("}}");
    }
    text + "]}\n"
}

/// Returns a scenario with short motions of a humanoid, one act each, with a few keyframes for every axis.
fn acts(count: usize) -> String {
    let mut text = "scenario: motions\nacts:\n".to_owned();
    for act in 0..count {
        let _infallible = writeln!(
            text,
            "  - act: motion {act}\n    cues:\n      - cue: all\n        at: 0s\n        robots: r0\n        tracks:"
        );
        for axis in 0..20 {
            let _infallible = writeln!(text, "          axis {axis}:");
            for index in 0..12 {
                let at = index * (250 + act % 7 * 10);
                let _infallible = writeln!(
                    text,
                    "            - {{at: {at}ms, to: {}, ease: smooth}}",
                    value(axis + act, index)
                );
            }
        }
    }
    text
}

/// Returns a scenario with a YAML anchor, followed only by aliases of the anchor.
fn aliases(bytes: usize) -> String {
    let mut text = "scenario: bomb\nvariables:\n  a: &a {b: [1, 2, 3], c: x}\n  l:\n".to_owned();
    while text.len() < bytes {
        text.push_str("  - *a\n");
    }
    text
}

/// Runs in a separate process: reads a file and prints the seconds, the bytes of memory, the number of steps and the first finding.
fn measure(what: &str, path: &str) {
    let fleet = fleet();
    let (before, begin) = (peak_memory(), Instant::now());
    let (count, finding) = match what {
        "plain" => {
            let text = std::fs::read_to_string(path).unwrap();
            let read = black_box(serde_yaml::from_str::<Value>(&text));
            (0, read.err().map(|error| error.to_string()))
        }
        _ => {
            let source = Source::read(Path::new(path)).unwrap();
            let compiled = black_box(compile(&source, &fleet, &NoFiles));
            let error = compiled
                .findings
                .first()
                .map(|finding| format!("{}: {}", finding.code.as_str(), finding.message));
            (steps(&compiled), error)
        }
    };
    let (time, memory) = (begin.elapsed(), peak_memory() - before);
    println!("{} {memory} {count} {}", time.as_secs_f64(), finding.unwrap_or_default());
}

struct Measured {
    seconds: f64,
    bytes: f64,
    steps: f64,
    finding: String,
}

fn child(what: &str, path: &Path) -> Measured {
    let output =
        Command::new(std::env::current_exe().unwrap()).args(["--measure", what]).arg(path).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let mut words = text.trim_end().splitn(4, ' ');
    let mut number = || words.next().unwrap_or_default().parse().unwrap();
    let (seconds, bytes, steps) = (number(), number(), number());
    Measured { seconds, bytes, steps, finding: words.next().unwrap_or_default().to_owned() }
}

fn compare(case: &Case, folder: &Path) {
    let path = folder.join("show.yaml");
    let text = (case.text)();
    let megabytes = text.len() as f64 / 1e6;
    std::fs::write(&path, text).unwrap();
    let (mut plain, mut ours) = (child("plain", &path), child("ours", &path));
    for _ in 1..RUNS {
        // In turn, so that other load disturbs both equally.
        let (other, again) = (child("plain", &path), child("ours", &path));
        plain = Measured {
            seconds: plain.seconds.min(other.seconds),
            bytes: plain.bytes.max(other.bytes),
            ..plain
        };
        ours =
            Measured { seconds: ours.seconds.min(again.seconds), bytes: ours.bytes.max(again.bytes), ..ours };
    }
    println!(
        "{}: {megabytes:.1} MB, {} steps: {:.2} s and {:.0} MB; YAML library alone {:.2} s and {:.0} MB: ratios {:.2} and {:.2}",
        case.name,
        ours.steps,
        ours.seconds,
        ours.bytes / 1e6,
        plain.seconds,
        plain.bytes / 1e6,
        ours.seconds / plain.seconds,
        ours.bytes / plain.bytes
    );
    if case.bounded {
        let (time, memory) = (ours.seconds / ours.steps * 1e6, ours.bytes / ours.steps);
        println!("  {time:.2} s for a million steps (bound 1), {memory:.0} bytes a step (bound 300)");
    }
    if !ours.finding.is_empty() {
        println!("  {}", ours.finding);
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let [flag, what, path] = arguments.as_slice()
        && flag == "--measure"
    {
        return measure(what, path);
    }
    let only = arguments.first().filter(|name| !name.starts_with('-'));
    let folder = tempfile::tempdir().unwrap();
    for case in CASES.iter().filter(|case| only.is_none_or(|only| case.name.contains(only.as_str()))) {
        compare(case, folder.path());
    }
}
