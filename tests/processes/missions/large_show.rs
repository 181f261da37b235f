//! Two robots with hundreds of devices and megabytes of scripts: the inquiries before the start do not grow with the scripts.
//!
//! If `DOWNBEAT_LARGE_SHOWS=20` is set, the show is played 20 times while every core is kept busy.
#![expect(clippy::print_stdout, reason = "a test may print")]

use stage::busy::with_cores_busy;
use stage::{Stage, Via};

const DEVICES: usize = 278;
const STEPS: usize = 90;

fn init() -> String {
    let device = |d: usize| {
        format!(
            "  - id: d{d}
    name: d{d}
    available_control_types:
      position: {{min_value: 0, max_value: 90, granularity: 1}}
      script: {{min_value: 0, max_value: 90, granularity: 1, max_number_of_steps: {STEPS}}}
"
        )
    };
    let devices: String = (0..DEVICES).map(device).collect();
    format!("id: robot\napi_version: '1'\nreports: true\ninquiry: true\ndevices:\n{devices}")
}

/// Returns a scenario in which every device takes every step.
fn scenario() -> String {
    let keyframe = |step: usize| format!("{{at: {}ms, to: {}}}", step * 20, 1 + (step * 37) % 89);
    let track = (0..STEPS).map(keyframe).collect::<Vec<_>>().join(", ");
    let tracks: Vec<_> = (0..DEVICES).map(|d| format!("d{d}: [{track}]")).collect();
    format!(
        "scenario: large\nstart_tolerance: 1s\ncues:\n  - {{at: 0s, robots: all, tracks: {{{}}}}}\n",
        tracks.join(", ")
    )
}

#[test]
fn show_of_several_megabytes_starts_and_sets_every_value() {
    let busy = std::env::var("DOWNBEAT_LARGE_SHOWS").ok().and_then(|shows| shows.parse().ok());
    let shows = busy.unwrap_or(1);
    let mut stage = Stage::new();
    stage.file("robot.yaml", init()).file("large.yaml", scenario());
    for _ in 0..2 {
        stage.robot("robot.yaml", Via::Direct);
    }
    let play = || {
        for show in 0..shows {
            let ended = stage.run(&["run", "large.yaml", "--patience", "30s", "--format", "json"]);
            let report = ended.report();
            assert_eq!(report["outcome"], "done", "show {show}: {} {}", report["failures"], ended.told);
            println!("show {show}: lead {}, doubt {} ms", report["lead"], report["acts"][0]["doubt_ms"]);
        }
    };
    match busy {
        Some(_) => with_cores_busy(std::thread::available_parallelism().map_or(2, usize::from), play),
        None => play(),
    }
    for robot in &stage.robots {
        assert_eq!(robot.sets().len(), DEVICES * STEPS * shows, "{}", robot.id);
    }
}
