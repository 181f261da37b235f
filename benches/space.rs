//! The closest approach of a hundred bodies over ten minutes, between all steps, compared with looking at every pair every ten
//! milliseconds, which may miss what happens between two looks.
//!
//! `cargo bench -p downbeat-scripts --bench space`
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark at a terminal")]
#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
#![expect(clippy::cast_precision_loss, reason = "figures for people")]

mod compiling;

use std::fmt::Write;
use std::time::{Duration, Instant};

use compiling::{peak_memory, simulated, steps};
use downbeat_scripts::{Body, Compiled, Coordinate, Fleet, NoFiles, Shape, Source, Space, compile};

const ROBOTS: usize = 100;
const SECONDS: usize = 600;
/// Keyframes a second.
const RATE: usize = 10;
const RADIUS: f64 = 0.06;
const LOOK_MS: usize = 10;

/// The size of each robot.
type Shapes = fn(usize) -> Shape;

fn fleet(shape: Option<Shapes>) -> Fleet {
    let limits = r#""min_value": -100, "max_value": 100, "granularity": 0.001, "max_error": 0.01"#;
    let device = |name: &str| {
        format!(
            r#"{{"id": "{name}", "name": "{name}", "unit": "m", "interpolation": "linear", "available_control_types":
            {{"position": {{{limits}}}, "script": {{{limits}, "max_number_of_steps": 100000}}}}}}"#
        )
    };
    let devices = ["x", "y", "z"].map(device).join(", ");
    let robot = |index: usize| {
        let text = format!(r#"{{"id": "r{index}", "api_version": "1", "devices": [{devices}]}}"#);
        let mut robot = simulated(serde_json::from_str(&text).unwrap());
        let device =
            |name: &str| Coordinate::Device { device: name.parse().unwrap(), scale: 1.0, offset: 0.0 };
        robot.body = shape.map(|shape| Body {
            coordinates: [device("x"), device("y"), device("z"), Coordinate::Fixed(0.0)],
            shape: shape(index),
            ..Body::default()
        });
        robot
    };
    let space = Space { distance: Some(0.01), ..Space::default() };
    Fleet { robots: (0..ROBOTS).map(robot).collect(), space, ..Fleet::default() }
}

/// Where a robot is: on a loop about its place in a grid, so wide that neighbours pass close to each other.
fn place(robot: usize, second: f64) -> [f64; 3] {
    let (row, column) = (robot / 10, robot % 10);
    let phase = (robot * 7 % 13) as f64;
    let (slow, fast) = (0.21 * second + phase, 0.37 * second + 2.0 * phase);
    [
        2.0 * column as f64 + 0.9 * slow.cos(),
        2.0 * row as f64 + 0.9 * fast.sin(),
        2.0 + 0.5 * (slow + fast).sin(),
    ]
}

fn scenario() -> Source {
    let mut text = "scenario: large\ncues:\n".to_owned();
    for robot in 0..ROBOTS {
        let _infallible = writeln!(text, "  - cue: c{robot}\n    at: 0s\n    robots: r{robot}\n    tracks:");
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            let _infallible = writeln!(text, "      {name}:");
            for index in 0..=SECONDS * RATE {
                let to = place(robot, index as f64 / RATE as f64)[axis];
                let _infallible = writeln!(text, "        - {{at: {}ms, to: {to:.3}}}", index * 1_000 / RATE);
            }
        }
    }
    Source { name: "large.yaml".to_owned(), text }
}

fn compiled(source: &Source, shape: Option<Shapes>) -> (Compiled, Duration) {
    let fleet = fleet(shape);
    let began = Instant::now();
    let compiled = compile(source, &fleet, &NoFiles);
    let took = began.elapsed();
    assert!(compiled.choreography.is_some(), "{:?}", compiled.findings.first());
    (compiled, took)
}

/// Every pair at every look: the least distance of two balls.
fn looked(compiled: &Compiled) -> f64 {
    let act = &compiled.choreography.as_ref().unwrap().acts[0];
    let looks = SECONDS * 1_000 / LOOK_MS;
    let axes: Vec<[Vec<f64>; 3]> = act
        .plan
        .robots
        .iter()
        .map(|robot| {
            ["x", "y", "z"].map(|name| {
                let script = robot.scripts.iter().find(|script| script.device.as_str() == name).unwrap();
                let steps = script.script.steps();
                let mut next = 1;
                let value = |look: usize| {
                    let at = (look * LOOK_MS) as f64;
                    while next + 1 < steps.len() && steps[next].offset.get() < at {
                        next += 1;
                    }
                    let (from, to) = (&steps[next - 1], &steps[next]);
                    let share = (at - from.offset.get()) / (to.offset.get() - from.offset.get());
                    from.setpoint.value + share * (to.setpoint.value - from.setpoint.value)
                };
                (0..=looks).map(value).collect()
            })
        })
        .collect();
    let mut least = f64::INFINITY;
    for (index, a) in axes.iter().enumerate() {
        for b in &axes[index + 1..] {
            for look in 0..=looks {
                let squares = (0..3).map(|axis| (a[axis][look] - b[axis][look]).powi(2));
                least = least.min(squares.sum::<f64>());
            }
        }
    }
    least.sqrt() - 2.0 * RADIUS
}

fn main() {
    let source = scenario();
    let (plain, without) = compiled(&source, None);
    let began = Instant::now();
    let seen = looked(&plain);
    let looking = began.elapsed();
    println!("{ROBOTS} robots, {SECONDS} s, {} steps, {} pairs", steps(&plain), ROBOTS * (ROBOTS - 1) / 2);
    println!("compiled without bodies: {without:.2?}");
    println!("all pairs every {LOOK_MS} ms: {looking:.2?}, closest {seen:.4} m");
    drop(plain);
    let shapes: [(&str, Shapes); 2] = [
        ("balls", |_| Shape::Ball { radius: RADIUS }),
        ("every second a box", |index| match index % 2 {
            0 => Shape::Ball { radius: RADIUS },
            _ => Shape::Box { size: [0.1, 0.1, 0.06] },
        }),
    ];
    for (name, shape) in shapes {
        let (compiled, with) = compiled(&source, Some(shape));
        let closest = compiled.choreography.unwrap().acts.remove(0).in_space.closest.unwrap();
        let check = with.saturating_sub(without);
        println!(
            "{name}: {check:.2?} more to compile, {:.2} times looking; closest {:.4} m at {}",
            check.as_secs_f64() / looking.as_secs_f64(),
            closest.distance,
            closest.at
        );
    }
    println!("peak memory: {} MB", peak_memory() >> 20);
}
