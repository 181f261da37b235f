//! Measures how fast scenarios compile, compared with the YAML library alone, and how memory and time grow with the number of steps.
//!
//! `cargo bench -p downbeat-scripts --bench compile`
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark at a terminal")]
#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]

mod compiling;

use std::collections::BTreeMap;
use std::fmt::Write;
use std::hint::black_box;
use std::time::{Duration, Instant};

use compiling::{peak_memory, simulated, steps};
use downbeat_scripts::{Fleet, NoFiles, Source, compile, render};
use serde::Deserialize;

/// A scenario as plain structs, which the YAML library alone parses as the baseline.
#[derive(Deserialize)]
#[expect(dead_code, reason = "read, not used")]
struct PlainScenario {
    scenario: String,
    cues: Vec<PlainCue>,
}

#[derive(Deserialize)]
#[expect(dead_code, reason = "read, not used")]
struct PlainCue {
    cue: String,
    at: String,
    robots: String,
    tracks: BTreeMap<String, Vec<PlainKeyframe>>,
}

#[derive(Deserialize)]
#[expect(dead_code, reason = "read, not used")]
struct PlainKeyframe {
    at: String,
    to: f64,
    ease: Option<String>,
}

fn init(id: &str, steps: u32, queue: u32) -> urrcp::InitializationBlock {
    let limits = r#""min_value": -1000, "max_value": 1000, "granularity": 0.001, "max_error": 0.01"#;
    let device = |name: &str| {
        format!(
            r#"{{"id": "{name}", "name": "{name}", "interpolation": "linear", "script_queue": {queue},
            "available_control_types": {{"position": {{{limits}}},
            "script": {{{limits}, "max_number_of_steps": {steps}}}}}}}"#
        )
    };
    let devices: Vec<_> = ["x", "y", "z", "yaw"].iter().map(|name| device(name)).collect();
    let text = format!(r#"{{"id": "{id}", "api_version": "1", "devices": [{}]}}"#, devices.join(", "));
    serde_json::from_str(&text).unwrap()
}

fn fleet(robots: usize, steps: u32, queue: u32) -> Fleet {
    let robot = |index: usize| simulated(init(&format!("r{index}"), steps, queue));
    let robots: Vec<_> = (0..robots).map(robot).collect();
    let groups = BTreeMap::from([("all".to_owned(), robots.iter().map(|robot| robot.id.clone()).collect())]);
    Fleet { robots, groups, ..Fleet::default() }
}

/// Returns a scenario of about `bytes` bytes: timed keyframes for robots with four devices each. Every `eased`th keyframe is eased; none
/// is if `eased` is 0.
fn keyframes(bytes: usize, robots: usize, eased: usize) -> String {
    let mut text = "scenario: large\ncues:\n".to_owned();
    let each = bytes / robots / 4;
    for robot in 0..robots {
        let _infallible = writeln!(text, "  - cue: c{robot}\n    at: 0s\n    robots: r{robot}\n    tracks:");
        for device in ["x", "y", "z", "yaw"] {
            let _infallible = writeln!(text, "      {device}:");
            let end = text.len() + each;
            let mut index = 0usize;
            while text.len() < end {
                let value = (index * 7 % 2_000) as f64 / 1_000.0 - 1.0;
                let ease = if eased > 0 && index % eased == 1 { ", ease: smooth" } else { "" };
                let _infallible = writeln!(text, "        - {{at: {}ms, to: {value}{ease}}}", index * 20);
                index += 1;
            }
        }
    }
    text
}

fn compiled(text: &str, fleet: &Fleet) -> downbeat_scripts::Compiled {
    compile(&Source { name: "bench.yaml".into(), text: text.to_owned() }, fleet, &NoFiles)
}

/// Returns the shortest time of `runs` runs of `work`.
fn shortest<T>(runs: usize, mut work: impl FnMut() -> T) -> Duration {
    let once = |work: &mut dyn FnMut() -> T| {
        let begin = Instant::now();
        let result = black_box(work());
        let time = begin.elapsed();
        drop(result);
        time
    };
    (0..runs).map(|_| once(&mut work)).min().unwrap()
}

fn large_file(name: &str, eased: usize) {
    let text = keyframes(20_000_000, 10, eased);
    let fleet = fleet(10, 10_000_000, 1);
    let plain = || serde_yaml::from_str::<PlainScenario>(&text).unwrap();
    let whole = || {
        let compiled = compiled(&text, &fleet);
        assert!(compiled.choreography.is_some(), "{}", render(&compiled.findings[..1], false));
        compiled
    };
    let (mut library, mut ours) = (Duration::MAX, Duration::MAX);
    // In turn, so that other load disturbs both equally.
    for _ in 0..4 {
        library = library.min(shortest(1, plain));
        ours = ours.min(shortest(1, whole));
    }
    let ratio = ours.as_secs_f64() / library.as_secs_f64();
    let size = text.len() as f64 / 1e6;
    println!(
        "{name}: {size:.1} MB, {} steps: YAML library into plain structs {:.0} ms, parse, check and compile {:.0} ms, ratio {ratio:.2} (bound 2)",
        steps(&whole()),
        library.as_secs_f64() * 1e3,
        ours.as_secs_f64() * 1e3,
    );
}

/// Returns a short scenario whose repeated move produces `steps` steps on one device.
fn expanding(steps: usize) -> String {
    let keyframes: String = (0..100)
        .map(|i| format!("{{at: {}ms, to: {}}}, ", i * 10, f64::from((i * 37) % 100) / 10.0))
        .collect();
    format!(
        "scenario: short\nmoves:\n  shake:\n    tracks:\n      x: [{keyframes}{{at: 1s, to: 0}}]\ncues:\n  - {{at: 0s, robots: r0, move: shake, repeat: {}}}\n",
        steps / 100
    )
}

fn expansion() {
    let text = expanding(10_000_000);
    let fleet = fleet(1, 20_000_000, 1);
    let before = peak_memory();
    let first = compiled(&text, &fleet);
    let count = steps(&first);
    let output = count * size_of::<urrcp::Step>();
    let memory = (peak_memory() - before) as f64 / output as f64;
    drop(first);
    let time = shortest(3, || compiled(&text, &fleet));
    println!(
        "expansion: {} bytes of YAML to {count} steps in {:.0} ms: {:.1} million steps a second (bound 5), peak memory {memory:.2} times the {:.0} MB of output (bound 3)",
        text.len(),
        time.as_secs_f64() * 1e3,
        count as f64 / time.as_secs_f64() / 1e6,
        output as f64 / 1e6,
    );
}

/// Returns the exponent with which time grows with size: the slope of log time over log size, by least squares.
fn exponent(points: &[(f64, f64)]) -> f64 {
    let logs: Vec<_> = points.iter().map(|(size, time)| (size.ln(), time.ln())).collect();
    let mean = |values: &dyn Fn(&(f64, f64)) -> f64| logs.iter().map(values).sum::<f64>() / logs.len() as f64;
    let (mean_x, mean_y) = (mean(&|p| p.0), mean(&|p| p.1));
    let covariance: f64 = logs.iter().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    covariance / logs.iter().map(|(x, _)| (x - mean_x).powi(2)).sum::<f64>()
}

fn growth() {
    // Larger than the reserve of an allocator, so that all sizes need fresh memory.
    let sizes = [1_000_000usize, 2_000_000, 4_000_000, 8_000_000, 16_000_000];
    let one = fleet(1, 20_000_000, 1);
    let points: Vec<_> = sizes
        .iter()
        .map(|size| {
            let text = expanding(*size);
            let time = shortest(3, || compiled(&text, &one)).as_secs_f64();
            println!("  {size} steps: {:.1} ms", time * 1e3);
            (*size as f64, time)
        })
        .collect();
    println!("growth in steps, 1 to 16 million: exponent {:.3} (bound 1.1)", exponent(&points));
    let points: Vec<_> = [1_250usize, 2_500, 5_000, 10_000]
        .iter()
        .map(|robots| {
            let fleet = fleet(*robots, 100_000, 1);
            let text = "scenario: many\ncues:\n  - {at: 0s, robots: all, canon: 1ms, repeat: 100, tracks: {x: [{at: 0s, to: 0}, {at: 2s, to: 5, ease: smooth}, {at: 3s, to: 0, ease: smooth}], y: [{at: 0s, to: 0}, {at: 1s, to: 1}, {at: 3s, to: 0}]}}\n";
            let time = shortest(3, || compiled(text, &fleet)).as_secs_f64();
            let count = steps(&compiled(text, &fleet));
            println!("  {robots} robots, {count} steps: {:.1} ms", time * 1e3);
            (*robots as f64, time)
        })
        .collect();
    println!("growth in robots, 1,250 to 10,000: exponent {:.3} (bound 1.1)", exponent(&points));
}

fn many_findings() {
    let mut text = "scenario: wrong\ncues:\n  - at: 0s\n    robots: r0\n    tracks:\n      x:\n".to_owned();
    for index in 0..10_000 {
        let _infallible = writeln!(text, "        - {{at: {index}ms, to: 0.0003}}");
    }
    let fleet = fleet(1, 20_000, 1);
    let mut shown = 0;
    let time = shortest(3, || {
        let compiled = compiled(&text, &fleet);
        shown = compiled.findings.len();
        render(&compiled.findings, false)
    });
    println!(
        "{shown} findings found, placed and rendered in {:.0} ms (bound 1,000)",
        time.as_secs_f64() * 1e3
    );
}

fn main() {
    let only = std::env::args().nth(1).filter(|name| !name.starts_with('-'));
    let wanted = |name: &str| only.as_ref().is_none_or(|only| only == name);
    // First, because peak memory never falls: no other benchmark may have raised it.
    if wanted("expansion") {
        expansion();
    }
    if wanted("file") {
        large_file("keyframes", 0);
        large_file("keyframes, every tenth eased", 10);
    }
    if wanted("growth") {
        growth();
    }
    if wanted("findings") {
        many_findings();
    }
}
