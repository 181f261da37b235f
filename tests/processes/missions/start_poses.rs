//! Devices that are not where an act expects them: the start is refused, or they move there first (an approach).

use std::time::Duration;

use rustix::process::Signal;
use stage::quiet::await_that;
use stage::{Stage, Via, with_devices};

/// Returns a stage with two robots, whose joint moves linearly at 60 degrees per second or less.
fn stage() -> Stage {
    stage_with(Via::Direct)
}

/// Returns the stage of [`stage`], with this connection to the second robot.
fn stage_with(second: Via) -> Stage {
    let mut stage = Stage::new();
    let joint = "  - id: joint
    name: joint
    interpolation: linear
    default_value: 0
    available_control_types:
      position: {min_value: -180, max_value: 180, granularity: 0.5}
      speed: {min_value: -60, max_value: 60, granularity: 1}
      script: {min_value: -180, max_value: 180, granularity: 0.5, max_number_of_steps: 200}
";
    stage.file("arm.yaml", with_devices(joint));
    for (name, from, to) in [("out", 0, 80), ("back", 0, 40)] {
        let track = format!("[{{at: 0s, to: {from}}}, {{at: 3s, to: {to}, ease: smooth}}]");
        let cue = format!("{{at: 0s, robots: all, tracks: {{joint: {track}}}}}");
        stage
            .file(&format!("{name}.yaml"), format!("scenario: {name}\nstart_tolerance: 1s\ncues: [{cue}]\n"));
    }
    stage.robot("arm.yaml", Via::Direct);
    stage.robot("arm.yaml", second);
    stage
}

/// Plays the scenario that leaves both joints at 80 degrees. Returns the number of log entries of each robot.
#[track_caller]
fn left_at_80(stage: &Stage) -> Vec<usize> {
    let played = stage.run(&["run", "out.yaml"]);
    assert_eq!(played.code, Some(0), "{played}");
    let ends_at_80 = |robot: &stage::Robot| robot.log().last().is_some_and(|entry| entry.value == 80.0);
    stage::quiet::await_that("the last value", || stage.robots.iter().all(ends_at_80));
    stage.robots.iter().map(|robot| robot.log().len()).collect()
}

#[test]
fn start_with_a_device_jump_is_refused_without_movement() {
    let stage = stage();
    let before = left_at_80(&stage);
    for command in ["preflight", "run"] {
        let refused = stage.run(&[command, "back.yaml"]);
        assert_eq!(refused.code, Some(1), "{refused}");
        let said = format!("{}{}", refused.out, refused.told);
        assert!(said.contains("`joint` is at 80, but its first keyframe expects 0"), "{refused}");
        assert!(said.contains("--approach"), "{refused}");
    }
    for (robot, before) in stage.robots.iter().zip(before) {
        assert_eq!(robot.log().len(), before, "{} moved", robot.id);
    }
}

#[test]
fn approach_moves_devices_to_first_positions_within_speed_limits() {
    let stage = stage();
    let before = left_at_80(&stage);
    let too_fast = stage.run(&["run", "back.yaml", "--approach", "1s"]);
    assert_eq!(too_fast.code, Some(1), "{too_fast}");
    assert!(too_fast.told.contains("cannot reach their first positions in 1 s"), "{too_fast}");
    let played = stage.run(&["run", "back.yaml", "--approach", "3s", "--record", "back.mcap"]);
    assert_eq!(played.code, Some(0), "{played}");
    let page = stage.run(&["report", "back.mcap", "--html", "back.html", "--scenario", "back.yaml"]);
    assert_eq!(page.code, Some(0), "the approach is no other scenario: {page}");
    for (robot, before) in stage.robots.iter().zip(before) {
        let moved = robot.log_since(before);
        let sets: Vec<_> = moved.iter().filter(|entry| entry.motion == "set").collect();
        assert_eq!(sets.first().map(|entry| entry.value), Some(80.0), "{}: {moved:?}", robot.id);
        assert!(sets.iter().any(|entry| entry.value == 0.0), "{}: {moved:?}", robot.id);
        assert_eq!(sets.last().map(|entry| entry.value), Some(40.0), "{}: {moved:?}", robot.id);
        for pair in sets.windows(2) {
            let seconds = (pair[1].due - pair[0].due) as f64 / 1e9;
            let way = (pair[1].value - pair[0].value).abs();
            assert!(way <= 60.0 * seconds + 1.0, "{} jumps: {pair:?}", robot.id);
        }
    }
}

/// Whether this process, and the programs that it starts, ignore a signal. For example, a shell makes background programs ignore Ctrl-C.
fn is_ignored(signal: Signal) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap();
    u64::from_str_radix(ignored.trim(), 16).unwrap() >> (signal.as_raw() - 1) & 1 == 1
}

#[test]
fn signal_ends_the_command_during_robot_queries_without_movement() {
    let stage = stage_with(Via::Proxy);
    let before = left_at_80(&stage);
    // The second robot never answers, and the first one is asked at the same time.
    stage.robots[1].link.as_ref().unwrap().silence();
    for signal in [Signal::INT, Signal::TERM].into_iter().filter(|signal| !is_ignored(*signal)) {
        await_that("the end of earlier connections", || stage.robots[0].connections() == 0);
        let running = stage.start(&["run", "back.yaml", "--approach", "3s", "--patience", "120s"]);
        await_that("the question", || stage.robots[0].connections() > 0);
        running.process.signal(signal);
        let ended = running.ended_within(Duration::from_secs(60));
        let ended = ended.unwrap_or_else(|told| panic!("{signal:?} does not end it: {told}"));
        // There is nothing to stop, so the signal itself ends the process.
        assert_eq!(ended.code, None, "{ended}");
    }
    for (robot, before) in stage.robots.iter().zip(before) {
        assert_eq!(robot.log().len(), before, "{} moved", robot.id);
    }
}

#[test]
fn mission_killed_during_approach_continues_after_resume() {
    let stage = stage();
    left_at_80(&stage);
    let mut running = stage.start(&["run", "back.yaml", "--approach", "3s"]);
    stage::sleep_until(running.start() + 1_000_000_000);
    running.process.kill();
    let resumed = stage.run(&["resume"]);
    assert_eq!(resumed.code, Some(0), "{resumed}");
    let is_there = |robot: &stage::Robot| robot.log().last().is_some_and(|entry| entry.value == 40.0);
    stage::quiet::await_that("the last value", || stage.robots.iter().all(is_there));
}

#[test]
fn devices_move_home_within_speed_limits_at_the_end_of_a_show() {
    let stage = stage();
    let show = std::fs::read_to_string(stage.path("out.yaml")).unwrap();
    stage.file("home.yaml", show.replace("cues:", "at_end: home\ncues:"));
    let played = stage.play(&["run", "home.yaml"]);
    assert_eq!(played.code, Some(0), "{played}");
    assert!(
        ["out", "home"].iter().all(|act| played.out.contains(&format!("act `{act}`: played"))),
        "{played}"
    );
    for robot in &stage.robots {
        let log = robot.log();
        assert!(log.iter().any(|entry| entry.value == 80.0), "{}: {log:?}", robot.id);
        assert_eq!(log.last().map(|entry| entry.value), Some(0.0), "{}: {log:?}", robot.id);
        let alone = |entry: &&stage::Logged| !matches!(entry.motion.as_str(), "set" | "ramp");
        assert_eq!(log.iter().find(alone).map(|entry| &entry.motion), None, "{}", robot.id);
    }
    // The show leaves joints at 80 degrees.
    let home = stage.play(&["run", "home.yaml", "--act", "home", "--approach", "3s"]);
    assert_eq!(home.code, Some(0), "{home}");
}

/// Returns arguments that play `back` after an approach, with a start in `seconds`, and the instant of this start in nanoseconds since
/// the epoch. The approach moves the joints to the first positions of the act.
fn in_seconds(seconds: i64) -> ([String; 6], i64) {
    let start = chrono::Utc::now() + chrono::TimeDelta::seconds(seconds);
    let args = ["run", "back.yaml", "--approach", "3s", "--at", &start.to_rfc3339()].map(str::to_owned);
    (args, start.timestamp_nanos_opt().unwrap())
}

#[track_caller]
fn approached_and_started_at(stage: &Stage, before: &[usize], start: i64) {
    let is_there = |robot: &stage::Robot| robot.log().last().is_some_and(|entry| entry.value == 40.0);
    stage::quiet::await_that("the last value", || stage.robots.iter().all(is_there));
    for (robot, before) in stage.robots.iter().zip(before) {
        let moved = robot.log_since(*before);
        let sets = |later: bool| moved.iter().filter(move |entry| (entry.due >= start) == later);
        assert_eq!(sets(false).next_back().map(|entry| entry.value), Some(0.0), "{}: {moved:?}", robot.id);
        assert_eq!(sets(true).next().map(|entry| entry.due), Some(start), "{}: {moved:?}", robot.id);
    }
}

#[test]
fn approach_plays_immediately_and_show_starts_on_time() {
    let stage = stage();
    let before = left_at_80(&stage);
    let (args, _) = in_seconds(2);
    let early = stage.run(&args.each_ref().map(String::as_str));
    assert_eq!(early.code, Some(2), "{early}");
    assert!(early.told.contains("the approach takes 3 s"), "{early}");
    for (robot, before) in stage.robots.iter().zip(&before) {
        assert_eq!(robot.log().len(), *before, "{} moved", robot.id);
    }
    let (args, start) = in_seconds(15);
    let played = stage.run(&args.each_ref().map(String::as_str));
    assert_eq!(played.code, Some(0), "{played}");
    approached_and_started_at(&stage, &before, start);
}

#[test]
fn mission_killed_during_approach_starts_its_show_at_the_fixed_time() {
    let stage = stage();
    let before = left_at_80(&stage);
    let (args, start) = in_seconds(20);
    let mut running = stage.start(&args.each_ref().map(String::as_str));
    stage::sleep_until(running.start() + 1_000_000_000);
    running.process.kill();
    let resumed = stage.run(&["resume"]);
    assert_eq!(resumed.code, Some(0), "{resumed}");
    approached_and_started_at(&stage, &before, start);
}
