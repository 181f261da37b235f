//! `downbeat jog`: a robot that is moved by hand.

use std::time::Duration;

use rustix::process::Signal;
use serde_json::Value;

use stage::play::{LONG, SOON};
use stage::quiet::await_that;
use stage::terminal::{Terminal, Watched};
use stage::{Process, Stage, Via};

/// A joint that moves by at most 60 degrees per second, and a hand that holds its value.
const ARM: &str = "  - id: elbow
    unit: deg
    default_value: 0
    interpolation: linear
    available_control_types:
      position: {min_value: -90, max_value: 90, granularity: 0.5}
      speed: {min_value: -60, max_value: 60, granularity: 1}
      script: {min_value: -90, max_value: 90, granularity: 0.5, max_number_of_steps: 100, control_types: [position]}
  - id: hand
    default_value: 1
    available_control_types:
      position: {min_value: 0, max_value: 5, granularity: 1}
      script: {min_value: 0, max_value: 5, granularity: 1, max_number_of_steps: 100}
";

fn arm() -> Stage {
    let mut stage = Stage::new();
    stage.file("robot.yaml", stage::with_devices(ARM));
    stage.robot("robot.yaml", Via::Direct);
    stage
}

/// Returns the commanded positions of elbow and hand, as `jog` prints them.
fn positions(stage: &Stage) -> [f64; 2] {
    let ran = stage.run(&["jog", "r0", "--format", "json"]);
    assert_eq!(ran.code, Some(0), "{ran}");
    let json: Value = serde_json::from_str(&ran.out).unwrap();
    [0, 1].map(|index| json["devices"][index]["position"].as_f64().unwrap())
}

#[test]
fn devices_move_within_their_speed_and_a_scenario_plays_the_saved_pose() {
    let stage = arm();
    let began = std::time::Instant::now();
    let ran = stage.run(&["jog", "r0", "--set", "elbow=-30", "--set", "hand=3", "--yes", "--save", "ready"]);
    assert_eq!(ran.code, Some(0), "{ran}");
    // 1.875 * 30 / 30 s: half of the largest speed at the peak.
    assert!(began.elapsed() > Duration::from_millis(1_875), "{:?}", began.elapsed());
    assert!(ran.told.contains("saved `ready` to poses.yaml"), "{ran}");
    assert_eq!(positions(&stage), [-30.0, 3.0]);
    let poses = std::fs::read_to_string(stage.path("poses.yaml")).unwrap();
    assert!(poses.contains("elbow: [{at: $time, to: -30}]\n      hand: [{at: 0s, to: 3}]"), "{poses}");
    stage.file(
        "show.yaml",
        "scenario: show\ninclude: poses.yaml\ncues: [{at: 0s, robots: r0, move: ready}]\n",
    );
    let check = stage.run(&["check", "show.yaml"]);
    assert_eq!(check.code, Some(0), "{check}");
    let again = stage.run(&["jog", "r0", "--save", "ready=other.yaml", "--format", "json"]);
    let json: Value = serde_json::from_str(&again.out).unwrap();
    assert_eq!(json["saved"], serde_json::json!({"pose": "ready", "file": "other.yaml"}));
    assert_eq!(std::fs::read_to_string(stage.path("other.yaml")).unwrap(), poses);
}

#[test]
fn nothing_moves_if_a_request_is_invalid_or_not_confirmed() {
    let stage = arm();
    stage.file("mine.yaml", "moves: {}\n");
    for (args, reason) in [
        (&["r1"][..], "unknown robot `r1`"),
        (&["r0", "--set", "elbow=10"], "add --yes if the movement is safe"),
        (&["r0", "--set", "elbow=91", "--yes"], "`elbow` cannot be moved to 91: expected -90 to 90"),
        (&["r0", "--set", "elbow=0.3", "--yes"], "expected a multiple of 0.5, such as 0.5"),
        (&["r0", "--set", "wrist=1", "--yes"], "no device `wrist` to move; expected one of `elbow`, `hand`"),
        (&["r0", "--set", "hand=1", "--set", "hand=2", "--yes"], "--set names `hand` twice"),
        (&["r0", "--set", "elbow", "--yes"], "expected a device and its position"),
        (&["r0", "--set", "hand=2", "--yes", "--save", "ready=mine.yaml"], "is not a file of poses"),
        (&["r0", "--set", "hand=2", "--yes", "--save", "1st"], "the name of a pose consists of"),
        (&["r0", "--set", "hand=2", "--yes", "--save", "ready=nowhere/poses.yaml"], "cannot write"),
    ] {
        let ran = stage.run(&[&["jog"], args].concat());
        assert_eq!(ran.code, Some(2), "{args:?}: {ran}");
        assert!(ran.told.contains(reason), "{args:?}: {ran}");
    }
    assert!(stage.robots[0].log().is_empty());
    assert_eq!(std::fs::read_to_string(stage.path("mine.yaml")).unwrap(), "moves: {}\n");
}

#[test]
fn robot_of_a_mission_is_not_moved() {
    let stage = LONG.stage(&[Via::Direct]);
    let mission = stage.begin(&["run", "play.yaml"], [0], 2);
    let ran = stage.run(&["jog", "r0", "--set", "d=150", "--yes"]);
    assert_eq!(ran.code, Some(1), "{ran}");
    assert!(ran.told.contains("the robot belongs to another session"), "{ran}");
    assert!(!stage.robots[0].values("d").contains(&150.0));
    drop(mission);
}

/// The command on a terminal.
struct OnTerminal {
    terminal: Terminal,
    before: String,
    watched: Watched,
    process: Process,
}

impl OnTerminal {
    fn start(stage: &Stage) -> Self {
        let terminal = Terminal::new(100, 20);
        let (before, watched) = (terminal.settings(), terminal.watch());
        let mut command = stage.command(&["jog", "r0"]);
        terminal.attach(&mut command);
        let process = Process(command.spawn().unwrap());
        watched.shows("r0: reserved", SOON);
        Self { terminal, before, watched, process }
    }

    fn ends_with(mut self, code: i32) {
        assert_eq!(self.process.0.wait().unwrap().code(), Some(code), "{}", self.watched.screen());
        assert_eq!(self.terminal.settings(), self.before);
    }
}

#[test]
fn keys_move_the_robot_and_save_a_pose() {
    let stage = arm();
    let jog = OnTerminal::start(&stage);
    jog.terminal.type_keys("12.5\r");
    await_that("the position", || jog.watched.raw().contains("12.5 deg"));
    jog.terminal.type_keys("\x1b[B\x1b[C");
    await_that("the hand", || stage.robots[0].values("hand").contains(&2.0));
    jog.terminal.type_keys("sslow down\r");
    await_that("the pose", || stage.path("poses.yaml").exists());
    jog.terminal.type_keys("q");
    jog.ends_with(0);
    let poses = std::fs::read_to_string(stage.path("poses.yaml")).unwrap();
    assert!(poses.contains("  slow down:\n"), "{poses}");
    assert!(poses.contains("to: 12.5}]\n      hand: [{at: 0s, to: 2}]"), "{poses}");
    assert_eq!(positions(&stage), [12.5, 2.0]);
}

/// Moves the elbow by 90 degrees, which takes more than five seconds, and ends this as `end` says. Returns where the elbow has stopped.
fn stopped_by(end: impl FnOnce(OnTerminal)) -> f64 {
    let stage = arm();
    let jog = OnTerminal::start(&stage);
    jog.terminal.type_keys("90\r");
    await_that("movement", || !stage.robots[0].values("elbow").is_empty());
    std::thread::sleep(Duration::from_millis(500));
    end(jog);
    // Longer than the lease.
    std::thread::sleep(Duration::from_millis(1_500));
    let [stopped, _] = positions(&stage);
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(positions(&stage)[0], stopped, "it rests");
    stopped
}

#[test]
fn robot_stays_where_it_is_when_the_operator_leaves() {
    let leaves: [fn(OnTerminal); 3] = [
        |jog| {
            jog.terminal.type_keys("q");
            jog.ends_with(0);
        },
        |jog| {
            jog.process.signal(Signal::INT);
            jog.ends_with(3);
        },
        |jog| {
            jog.terminal.type_keys(" ");
            jog.watched.shows("stopped", SOON);
            jog.terminal.type_keys("q");
            jog.ends_with(0);
        },
    ];
    for leave in leaves {
        let stopped = stopped_by(leave);
        assert!(stopped > 0.0 && stopped < 60.0, "{stopped}");
    }
}

#[test]
fn robot_stops_by_itself_if_the_program_is_killed() {
    let stopped = stopped_by(|mut jog| jog.process.kill());
    assert!(stopped > 0.0 && stopped < 80.0, "{stopped}");
}
