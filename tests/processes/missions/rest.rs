//! Where robots come to rest: a stop leaves them where they are, and `--home` sends them to their default state.

use std::time::Duration;

use rustix::process::Signal;

use stage::play::SOON;
use stage::quiet::{await_that, stays};
use stage::terminal::Terminal;
use stage::{Process, Running, Stage, Via, epoch_nanos, one_device};

/// Returns a stage with two robots, whose default state is far from the positions of their script.
fn stage() -> Stage {
    let mut stage = Stage::new();
    let arm = one_device(1, 600, 600).replace("    name: d\n", "    name: d\n    default_value: 0\n");
    stage.file("arm.yaml", arm);
    let key = |step: u32| format!("{{at: {}ms, to: {}}}", step * 50, step + 20);
    let keys = (0..400).map(key).collect::<Vec<_>>().join(", ");
    let scenario = "scenario: play\nstart_tolerance: 1s\nstop_condition: {running: none}\ncues:\n";
    stage.file("play.yaml", format!("{scenario}  - {{at: 0s, robots: all, tracks: {{d: [{keys}]}}}}\n"));
    stage.robot("arm.yaml", Via::Direct);
    stage.robot("arm.yaml", Via::Direct);
    stage
}

fn playing(stage: &Stage) -> Running {
    stage.begin(&["run", "play.yaml"], 0..stage.robots.len(), 5)
}

/// Checks that no robot continues its script or moves to its default state.
#[track_caller]
fn stand_where_they_were(stage: &Stage) {
    let by_now = epoch_nanos();
    std::thread::sleep(Duration::from_millis(500));
    for robot in &stage.robots {
        let log = robot.log();
        assert!(log.iter().all(|entry| entry.at <= by_now), "{} still moves: {log:?}", robot.id);
        let stood = log.iter().rfind(|entry| entry.motion == "set").unwrap().value;
        let moved = log.iter().find(|entry| entry.motion != "set" && (entry.value - stood).abs() > 1.5);
        assert!(moved.is_none(), "{}: {moved:?}, it stood at {stood}", robot.id);
    }
}

fn only_mission(stage: &Stage) -> String {
    let missions: Vec<_> = std::fs::read_dir(stage.path("state")).unwrap().flatten().collect();
    let [mission] = missions.as_slice() else { panic!("{missions:?}") };
    mission.file_name().into_string().unwrap()
}

const BOTH: [&str; 2] = ["r0: stop confirmed", "r1: stop confirmed"];

#[test]
fn stop_leaves_robots_in_place_and_stop_home_moves_them_home() {
    let stage = stage();
    let mission = playing(&stage);
    let stopped = stage.run(&["stop"]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    BOTH.iter().for_each(|said| assert!(stopped.out.contains(said), "{stopped}"));
    assert_eq!(mission.ended().code, Some(3));
    stand_where_they_were(&stage);
    let home = stage.run(&["stop", &only_mission(&stage), "--home"]);
    assert!(home.out.contains("r0: default state confirmed"), "{home}");
    for robot in &stage.robots {
        await_that("the default state", || robot.log().last().is_some_and(|entry| entry.value == 0.0));
    }
}

#[test]
fn stop_after_scheduler_kill_leaves_robots_in_place() {
    let stage = stage();
    playing(&stage).process.kill();
    let stopped = stage.run(&["stop"]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    BOTH.iter().for_each(|said| assert!(stopped.out.contains(said), "{stopped}"));
    stand_where_they_were(&stage);
}

#[test]
fn s_key_stops_the_mission() {
    let stage = stage();
    let terminal = Terminal::new(100, 30);
    let watched = terminal.watch();
    let mut command = stage.command(&["run", "play.yaml"]);
    terminal.attach(&mut command);
    let mut process = Process(command.spawn().unwrap());
    watched.shows("s stop", SOON);
    stage.robots.iter().for_each(|robot| robot.await_sets(5, SOON));
    terminal.type_keys("s");
    assert_eq!(process.0.wait().unwrap().code(), Some(3), "{}", watched.screen());
    watched.shows("r1: stop confirmed", SOON);
    stand_where_they_were(&stage);
}

#[test]
fn home_key_moves_stopped_robots_home_once_all_have_confirmed() {
    let mut stage = stage();
    let terminal = Terminal::new(100, 30);
    let watched = terminal.watch();
    let mut command = stage.command(&["run", "play.yaml", "--patience", "10s"]);
    terminal.attach(&mut command);
    let mut process = Process(command.spawn().unwrap());
    stage.robots.iter().for_each(|robot| robot.await_sets(5, SOON));
    stage.robots[1].freeze();
    terminal.type_keys("s");
    watched.shows("stop confirmed", SOON);
    terminal.type_keys("H");
    watched.shows("then home", SOON);
    stage.robots[1].thaw();
    watched.shows("default state confirmed", SOON);
    let code = process.0.wait().unwrap().code();
    assert_eq!(code, Some(3), "{}", watched.screen());
    for robot in &mut stage.robots {
        watched.shows(&format!("{}: default state confirmed", robot.id), SOON);
        assert_eq!(robot.log().last().unwrap().value, 0.0, "{}", robot.id);
    }
}

/// Checks a stop while the scheduler does not answer: `stop` stops the robots itself. The scheduler has to report this stop and must not
/// move the robots.
#[track_caller]
fn is_stopped_past_the_scheduler(stage: &Stage, mission: Running) {
    let stopped = stage.run(&["stop"]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    BOTH.iter().for_each(|said| assert!(stopped.out.contains(said), "{stopped}"));
    mission.process.signal(Signal::CONT);
    let ended = mission.ended();
    assert_eq!(ended.code, Some(3), "{ended}");
    BOTH.iter().for_each(|said| assert!(ended.out.contains(said), "{ended}"));
    stand_where_they_were(stage);
}

#[test]
fn stalled_scheduler_moves_no_robot_stopped_in_the_meantime() {
    let stage = stage();
    let mission = playing(&stage);
    mission.process.signal(Signal::STOP);
    is_stopped_past_the_scheduler(&stage, mission);
}

#[test]
fn scheduler_without_socket_moves_no_stopped_robot() {
    let stage = stage();
    let mission = playing(&stage);
    std::fs::remove_file(stage.path("state").join(only_mission(&stage)).join("control")).unwrap();
    is_stopped_past_the_scheduler(&stage, mission);
}

#[test]
fn lost_terminal_moves_no_stopped_robot() {
    let stage = stage();
    let mission = playing(&stage);
    stage.robots[1].freeze();
    let stopping = stage.start(&["stop"]);
    stage.await_record(r#""record":"stop_confirmed""#);
    mission.process.signal(Signal::HUP);
    stays(Duration::from_millis(300), || stage.robots[0].log().len());
    stage.robots[1].thaw();
    let stopped = stopping.ended();
    assert_eq!(stopped.code, Some(0), "{stopped}");
    BOTH.iter().for_each(|said| assert!(stopped.out.contains(said), "{stopped}"));
    assert_eq!(mission.ended().code, Some(3));
    stand_where_they_were(&stage);
}

#[test]
fn resuming_a_stopped_mission_moves_no_robot() {
    let stage = stage();
    let mut mission = playing(&stage);
    stage.robots[1].freeze();
    let mut stopping = stage.start(&["stop"]);
    stage.await_record(r#""record":"stop_confirmed""#);
    // Otherwise it would resume the mission itself.
    stopping.process.kill();
    mission.process.kill();
    stage.robots[1].thaw();
    let resumed = stage.run(&["resume"]);
    assert_eq!(resumed.code, Some(3), "{resumed}");
    assert!(resumed.out.contains("stopped by the operator"), "{resumed}");
    BOTH.iter().for_each(|said| assert!(resumed.out.contains(said), "{resumed}"));
    stand_where_they_were(&stage);
}

/// Returns a stage with one robot. Its driver is a program that the scheduler starts.
fn driven() -> Stage {
    let stage = Stage::new();
    let arm = one_device(1, 600, 600).replace("    name: d\n", "    name: d\n    default_value: 0\n");
    stage.file("arm.yaml", arm).file("drive.sh", include_str!("../drivers/drive.sh"));
    stage.file("own.yaml", "robots: {w: {init: arm.yaml, address: 'program:sh drive.sh driven.txt'}}\n");
    let keys = (0..400).map(|step| format!("{{at: {}ms, to: {}}}", step * 50, step + 20));
    let keys = keys.collect::<Vec<_>>().join(", ");
    let scenario = "scenario: play\nstart_tolerance: 1s\nstop_condition: {running: none}\ncues:\n";
    stage.file("play.yaml", format!("{scenario}  - {{at: 0s, robots: w, tracks: {{d: [{keys}]}}}}\n"));
    stage
}

/// Returns the input that the robot's driver program has received.
fn told(stage: &Stage) -> String {
    std::fs::read_to_string(stage.path("driven.txt")).unwrap_or_default()
}

/// A driver program that logs the time and the value of each `set`.
const LOGGING: &str = "import sys, time
for line in sys.stdin:
    words = line.split()
    if words[0] == 'set':
        with open('driven.txt', 'a') as driven:
            driven.write(f'{time.time()} {words[3]}\\n')
    print('ok', flush=True)
";

#[test]
fn scheduler_driven_hardware_goes_home_within_fleet_file_limits() {
    let mut stage = Stage::new();
    let arm = "id: arm\napi_version: '1'\nreports: true\ndevices:\n  - {id: d, name: d, default_value: 0, interpolation: linear, available_control_types: {position: {min_value: 0, max_value: 600, granularity: 1}, speed: {min_value: -1000, max_value: 1000, granularity: 1}, script: {min_value: -1000, max_value: 1000, granularity: 1, max_number_of_steps: 20}}}\n";
    stage.file("arm.yaml", arm).file("drive.py", LOGGING);
    stage.robot("arm.yaml", Via::Direct);
    let served = stage.robots[0].port();
    stage.file("own.yaml", format!("robots:\n  w: {{init: arm.yaml, address: 'program:python3 drive.py', limits: {{d: {{speed: 50}}}}}}\n  r0: {{init: arm.yaml, address: 'tcp://127.0.0.1:{served}'}}\n"));
    stage.file("play.yaml", "scenario: play\nstart_tolerance: 1s\nstop_condition: {running: none}\ncues:\n  - {at: 0s, robots: [w, r0], tracks: {d: [{at: 0s, to: 0}, {at: 4s, to: 160}, {at: 60s, to: 170}]}}\n");
    let driven = || -> Vec<(f64, f64)> {
        let text = std::fs::read_to_string(stage.path("driven.txt")).unwrap_or_default();
        let numbers = |line: &str| {
            let (at, value) = line.split_once(' ')?;
            Some((at.parse().ok()?, value.parse().ok()?))
        };
        text.lines().filter_map(numbers).collect()
    };
    let mission = stage.start(&["run", "play.yaml", "--fleet", "own.yaml", "--lead", "2s"]);
    await_that("the way up", || driven().last().is_some_and(|(_, value)| *value >= 150.0));
    assert_eq!(stage.run(&["stop", "--home"]).code, Some(0));
    let ended = mission.ended();
    assert!(ended.out.contains("w: default state confirmed"), "{ended}");
    assert!(ended.out.contains("act `home`: played"), "{ended}");
    assert!(driven().last().is_some_and(|(_, value)| *value == 0.0), "{:?}", driven());
    let driven = driven();
    let below = |limit: f64| {
        let top = driven.iter().rposition(|(_, value)| *value >= 150.0).unwrap();
        driven[top..].iter().find(|(_, value)| *value <= limit).unwrap().0
    };
    // 100 units take 2 s at the speed of the fleet file, and 0.1 s at that of the device.
    let seconds = below(20.0) - below(120.0);
    assert!(seconds > 1.0, "{seconds} s: {driven:?}");
    let together = stage.robots[0].sets();
    assert!(together.last().is_some_and(|entry| entry.value == 0.0), "{together:?}");
    let defaults = stage.robots[0].log().iter().filter(|entry| entry.motion == "default").count();
    assert_eq!(defaults, 0, "no robot goes home on its own");
}

#[test]
fn act_after_a_failure_begins_where_the_stop_left_the_robots() {
    let mut stage = Stage::new();
    let device = "{id: NAME, name: NAME, default_value: 0, interpolation: linear, available_control_types: {position: {min_value: 0, max_value: 600, granularity: 1}, speed: {min_value: -100, max_value: 100, granularity: 1}, script: {min_value: 0, max_value: 600, granularity: 1, max_number_of_steps: 100}}}";
    let [d, e] = ["d", "e"].map(|name| device.replace("NAME", name));
    let arm = format!("id: arm\napi_version: '1'\nreports: true\ninquiry: true\ndevices: [{d}, {e}]\n");
    stage.file("arm.yaml", arm);
    for _ in 0..3 {
        stage.robot("arm.yaml", Via::Direct);
    }
    stage.file("play.yaml", "scenario: play\nstart_tolerance: 1s\non_failure: stop\nacts:\n  - {act: rise, on_failure: {default: stop, then: bow}, next: end, cues: [{at: 0s, robots: all, tracks: {d: [{at: 0s, to: 0}, {at: 9s, to: 450}], e: [{at: 0s, to: 0}, {at: 9s, to: 300}]}}]}\n  - {act: bow, cues: [{at: 0s, robots: [r0, r1], tracks: {d: [{at: 0s, to: 10}, {at: 1s, to: 0}]}}]}\n  - {act: leave, cues: [{at: 0s, robots: [r0, r1], tracks: {e: [{at: 0s, to: 0}, {at: 1s, to: 20}]}}]}\n");
    let mission = stage.begin(&["run", "play.yaml"], 0..2, 1);
    std::thread::sleep(Duration::from_secs(2));
    stage.robots[2].kill();
    let ended = mission.ended();
    // The stop of a robot that is gone is not confirmed.
    assert_eq!(ended.code, Some(4), "{ended}");
    for act in ["act `approach`: played", "act `bow`: played", "act `leave`: played"] {
        assert!(ended.out.contains(act), "{ended}");
    }
    for robot in &stage.robots[..2] {
        // `bow` does not move `e`, but `leave` does.
        for (device, ends_at) in [("d", 0.0), ("e", 20.0)] {
            let log: Vec<_> = robot.log().into_iter().filter(|entry| entry.device == device).collect();
            let stop = log.iter().position(|entry| matches!(entry.motion.as_str(), "rest" | "slow")).unwrap();
            assert!(log[stop].value > 20.0, "{log:?}");
            let off = (log[stop + 1].value - log[stop].value).abs();
            assert!(off <= 2.0, "{} jumped by {off}: {log:?}", robot.id);
            assert_eq!(log.last().unwrap().value, ends_at);
        }
    }
}

#[test]
fn scheduler_driven_hardware_stays_in_place_when_scheduler_ends() {
    let stage = driven();
    let mission = stage.start(&["run", "play.yaml", "--fleet", "own.yaml", "--lead", "2s"]);
    await_that("the fifth step", || told(&stage).contains("set d position 24\n"));
    let stopped = stage.run(&["stop"]);
    assert!(stopped.out.contains("w: stop confirmed"), "{stopped}");
    assert_eq!(mission.ended().code, Some(3));
    assert!(!told(&stage).contains("set d position 0\n"), "{}", told(&stage));
}

#[test]
fn hardware_of_killed_scheduler_is_not_reported_stopped_and_does_not_move() {
    let stage = driven();
    let mut mission = stage.start(&["run", "play.yaml", "--fleet", "own.yaml", "--lead", "2s"]);
    await_that("the fifth step", || told(&stage).contains("set d position 24\n"));
    mission.process.kill();
    let stopped = stage.run(&["stop"]);
    assert_eq!(stopped.code, Some(4), "{stopped}");
    assert!(stopped.out.contains("w: stop NOT confirmed; it was driven by a program"), "{stopped}");
    assert!(!told(&stage).contains("set d position 0\n"), "{}", told(&stage));
}

#[test]
fn plain_terminal_accepts_commands_but_not_every_line_as_go() {
    let stage = stage();
    let waiting = "scenario: wait\nstart_tolerance: 1s\nacts:\n  - {act: one, wait: operator, cues: [{at: 0s, robots: all, tracks: {d: [{at: 0s, to: 20}, {at: 30s, to: 21}]}}]}\n";
    stage.file("wait.yaml", waiting);
    let terminal = Terminal::new(40, 30);
    let watched = terminal.watch();
    let mut command = stage.command(&["run", "wait.yaml"]);
    terminal.attach(&mut command);
    let mut process = Process(command.spawn().unwrap());
    watched.shows("waits for", SOON);
    terminal.type_keys("start\n");
    watched.shows("unknown command `start`", SOON);
    terminal.type_keys("\n");
    stage.robots.iter().for_each(|robot| robot.await_sets(1, SOON));
    terminal.type_keys("stop\n");
    assert_eq!(process.0.wait().unwrap().code(), Some(3), "{}", watched.screen());
    watched.shows("r1: stop confirmed", SOON);
}
