//! Measures how long scenarios take to compile in which groups move from formation to formation. The baseline is the same movements
//! written out as keyframes, as a custom script would write them with all places and assignments already known. The difference is the
//! time to search for places and routes. Also compares the total distance of all robots with that of an assignment in which each robot in
//! turn takes the nearest free place.
//!
//! `cargo bench -p downbeat-scripts --bench formations`
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark at a terminal")]
#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
#![expect(clippy::cast_precision_loss, reason = "figures for people")]

mod compiling;

use std::collections::BTreeMap;
use std::fmt::Write;
use std::time::{Duration, Instant};

use compiling::{peak_memory, simulated, steps};
use downbeat_scripts::{
    Act, Body, Compiled, Coordinate, Fleet, FleetRobot, NoFiles, Shape, Source, Space, compile,
};

/// For each group, the number of robots and the number of times that it is compiled. The shortest time is used.
const GROUPS: [(usize, usize); 3] = [(100, 5), (300, 3), (1_000, 1)];
const RADIUS: f64 = 0.25;
const DISTANCE: f64 = 1.0;

type Place = [f64; 3];

fn robot(index: usize, [x, y, z]: Place) -> FleetRobot {
    let limits = r#""min_value": -500, "max_value": 500, "granularity": 0.01, "max_error": 0.01"#;
    let device = |(name, home): (&str, f64)| {
        format!(
            r#"{{"id": "{name}", "name": "{name}", "unit": "m", "interpolation": "linear", "default_value": {home}, "available_control_types":
            {{"position": {{{limits}}}, "script": {{{limits}, "max_number_of_steps": 100000}}}}}}"#
        )
    };
    let devices = [("x", x), ("y", y), ("z", z)].map(device).join(", ");
    let text = format!(r#"{{"id": "r{index}", "api_version": "1", "devices": [{devices}]}}"#);
    let mut robot = simulated(serde_json::from_str(&text).unwrap());
    let device = |name: &str| Coordinate::Device { device: name.parse().unwrap(), scale: 1.0, offset: 0.0 };
    robot.body = Some(Body {
        coordinates: [device("x"), device("y"), device("z"), Coordinate::Fixed(0.0)],
        shape: Shape::Ball { radius: RADIUS },
        ..Body::default()
    });
    robot
}

/// Returns a fleet of robots on the ground, two metres apart.
fn fleet(count: usize) -> Fleet {
    let columns = (count as f64).sqrt().ceil() as usize;
    let place = |index: usize| [2.0 * (index % columns) as f64, 2.0 * (index / columns) as f64, 0.0];
    let robots: Vec<FleetRobot> = (0..count).map(|index| robot(index, place(index))).collect();
    let groups = BTreeMap::from([("all".to_owned(), robots.iter().map(|robot| robot.id.clone()).collect())]);
    let space = Space { distance: Some(DISTANCE), ..Space::default() };
    Fleet { robots, groups, space, ..Fleet::default() }
}

fn formed(count: usize) -> String {
    // For a thousand robots, a text would be a kilometre wide.
    let word = match count {
        ..=300 => format!("{{text: DOWNBEAT, size: {}, at: [0, 0, 100]}}", 18.0 * (count as f64).sqrt()),
        _ => "{sphere: {radius: 40}, at: [0, 0, 100]}".to_owned(),
    };
    format!(
        "scenario: formed
formations:
  ring: {{circle: {{spacing: 2}}, at: [0, 0, 60]}}
  word: {word}
  block: {{grid: {{spacing: 2}}, at: [0, 0, 60]}}
cues:
  - {{cue: ring, at: 0s, robots: all, form: ring, over: 300s}}
  - {{cue: word, after: ring, robots: all, form: word, over: 300s}}
  - {{cue: block, after: word, robots: all, form: block, over: 300s}}
"
    )
}

/// Returns the times in milliseconds and the values of each moving device, by robot and device.
fn tracks(act: &Act, fleet: &Fleet) -> BTreeMap<(String, String), Vec<(f64, f64)>> {
    let mut tracks: BTreeMap<(String, String), Vec<(f64, f64)>> = BTreeMap::new();
    for plan in &act.plan.robots {
        for script in &plan.scripts {
            let track = tracks.entry((plan.robot.to_string(), script.device.to_string())).or_default();
            let home = || home(fleet, plan.robot.as_str(), script.device.as_str());
            let before = track.last().map_or_else(home, |(_, to)| *to);
            let own = script.script.steps().iter();
            let own = own.map(|step| (script.start.get() + step.offset.get(), step.setpoint.value));
            for (at, to) in std::iter::once((script.start.get(), before)).chain(own) {
                // Consecutive scripts share a value.
                if track.last().is_none_or(|(until, _)| at > until + 1e-3) {
                    track.push((at, to));
                }
            }
        }
    }
    tracks
}

fn home(fleet: &Fleet, robot: &str, device: &str) -> f64 {
    let robot = fleet.robots.iter().find(|known| known.id.as_str() == robot).unwrap();
    let devices = &robot.init.as_ref().unwrap().devices;
    devices.iter().find(|known| known.id.as_str() == device).unwrap().default_value.unwrap()
}

/// Returns a scenario with the movements of `act` as keyframes.
fn written_out(act: &Act, fleet: &Fleet) -> String {
    let mut text = "scenario: written\ncues:\n".to_owned();
    let mut robot = "";
    let tracks = tracks(act, fleet);
    for ((name, device), steps) in &tracks {
        if robot != name {
            let _infallible = writeln!(text, "  - cue: {name}\n    at: 0s\n    robots: {name}\n    tracks:");
            robot = name;
        }
        let _infallible = writeln!(text, "      {device}:");
        for (at, to) in steps {
            let _infallible = writeln!(text, "        - {{at: {at}ms, to: {to}}}");
        }
    }
    text
}

fn timed(fleet: &Fleet, text: String, times: usize) -> (Compiled, Duration) {
    let source = Source { name: "s.yaml".to_owned(), text };
    let one = || {
        let began = Instant::now();
        let compiled = compile(&source, fleet, &NoFiles);
        let took = began.elapsed();
        assert!(compiled.choreography.is_some(), "{:?}", compiled.findings.first());
        (compiled, took)
    };
    (0..times).map(|_| one()).min_by_key(|(_, took)| *took).unwrap()
}

/// Returns the position of each robot after its last step at or before `at_ms`.
fn places(act: &Act, fleet: &Fleet, at_ms: f64) -> Vec<Place> {
    let tracks = tracks(act, fleet);
    let value = |robot: &FleetRobot, device: &str| {
        let steps = tracks.get(&(robot.id.to_string(), device.to_owned()));
        let last = steps.into_iter().flatten().rfind(|(at, _)| *at <= at_ms + 1e-6);
        last.map_or_else(|| home(fleet, robot.id.as_str(), device), |(_, to)| *to)
    };
    fleet.robots.iter().map(|robot| ["x", "y", "z"].map(|device| value(robot, device))).collect()
}

fn metres(a: &Place, b: &Place) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

/// Returns the total distance in metres if each robot in turn takes the nearest free place.
fn nearest_first(from: &[Place], to: &[Place]) -> f64 {
    let mut free: Vec<&Place> = to.iter().collect();
    let mut sum = 0.0;
    for start in from {
        let nearest =
            (0..free.len()).min_by(|a, b| metres(start, free[*a]).total_cmp(&metres(start, free[*b])));
        sum += metres(start, free.swap_remove(nearest.unwrap()));
    }
    sum
}

fn main() {
    println!(
        "a circle, a text, a grid (1,000: a circle, a sphere, a grid)\n                         formed  written out   ratio   closest   ways of nearest first to these"
    );
    for (count, times) in GROUPS {
        let fleet = fleet(count);
        let (formed, took) = timed(&fleet, formed(count), times);
        let act = &formed.choreography.as_ref().unwrap().acts[0];
        let (written, baseline) = timed(&fleet, written_out(act, &fleet), times);
        let closest = |act: &Act| act.in_space.closest.as_ref().unwrap().distance;
        let other = closest(&written.choreography.as_ref().unwrap().acts[0]);
        assert!((closest(act) - other).abs() < 1e-6, "{} {other}", closest(act));
        let stops = [0.0, 300e3, 600e3, 900e3].map(|at| places(act, &fleet, at));
        let sum = |from: &[Place], to: &[Place]| from.iter().zip(to).map(|(a, b)| metres(a, b)).sum::<f64>();
        let own: f64 = stops.windows(2).map(|pair| sum(&pair[0], &pair[1])).sum();
        let nearest: f64 = stops.windows(2).map(|pair| nearest_first(&pair[0], &pair[1])).sum();
        println!(
            "{count:>5} robots        {:>10.1} ms {:>9.1} ms {:>7.2} {:>7} {:>7.3} m {:>12.3}",
            took.as_secs_f64() * 1e3,
            baseline.as_secs_f64() * 1e3,
            took.as_secs_f64() / baseline.as_secs_f64(),
            steps(&formed),
            closest(act),
            nearest / own
        );
    }
    println!("peak memory: {} MB", peak_memory() >> 20);
}
