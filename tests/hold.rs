//! The operator's hold: every robot stops, and stays where it is.

use std::time::Duration;

use crate::robots::play::SOON;
use crate::robots::{Process, Running, Stage, Via, one_device};
use crate::terminal::Terminal;

/// Two robots whose default state is far from where their script takes them.
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
    let running = stage.start(&["run", "play.yaml"]);
    stage.robots.iter().for_each(|robot| robot.await_sets(5, SOON));
    running
}

/// Neither goes to its default state, nor on.
#[track_caller]
fn stand_where_they_were(stage: &Stage) {
    let logs = || stage.robots.iter().map(|robot| robot.log().len()).collect::<Vec<_>>();
    let before = logs();
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(logs(), before, "a robot still moves");
    for robot in &stage.robots {
        let log = robot.log();
        let stood = log.iter().rfind(|entry| entry.motion == "set").unwrap().value;
        let moved = log.iter().find(|entry| entry.motion == "default" && (entry.value - stood).abs() > 1.5);
        assert!(moved.is_none(), "{}: {moved:?}, it stood at {stood}", robot.id);
    }
}

fn only_mission(stage: &Stage) -> String {
    let missions: Vec<_> = std::fs::read_dir(stage.path("state")).unwrap().flatten().collect();
    let [mission] = missions.as_slice() else { panic!("{missions:?}") };
    mission.file_name().into_string().unwrap()
}

const BOTH: [&str; 2] = ["r0: held where it was, confirmed", "r1: held where it was, confirmed"];

#[test]
fn a_stop_that_holds_leaves_every_robot_where_it_is_and_says_so() {
    let stage = stage();
    let mission = playing(&stage);
    let stopped = stage.run(&["stop", "--hold"]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    BOTH.iter().for_each(|said| assert!(stopped.out.contains(said), "{stopped}"));
    assert_eq!(mission.ended().code, Some(3));
    stand_where_they_were(&stage);
    let again = stage.run(&["stop", &only_mission(&stage)]);
    assert!(again.out.contains("r0: default state confirmed"), "what holds can be sent home:\n{again}");
}

#[test]
fn a_stop_that_holds_reaches_the_robots_of_a_scheduler_that_was_killed() {
    let stage = stage();
    playing(&stage).process.kill();
    let stopped = stage.run(&["stop", "--hold"]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    BOTH.iter().for_each(|said| assert!(stopped.out.contains(said), "{stopped}"));
    stand_where_they_were(&stage);
}

#[test]
fn the_key_h_holds() {
    let stage = stage();
    let terminal = Terminal::new(100, 30);
    let watched = terminal.watch();
    let mut command = stage.command(&["run", "play.yaml"]);
    terminal.attach(&mut command);
    let mut process = Process(command.spawn().unwrap());
    watched.shows("h hold", SOON);
    stage.robots.iter().for_each(|robot| robot.await_sets(5, SOON));
    terminal.type_keys("h");
    assert_eq!(process.0.wait().unwrap().code(), Some(3), "{}", watched.screen());
    watched.shows("r1: held where it was, confirmed", SOON);
    stand_where_they_were(&stage);
}

#[test]
fn a_stop_while_the_mission_still_waits_for_a_hold_sends_to_the_default_state_what_holds() {
    let mut stage = stage();
    let terminal = Terminal::new(100, 30);
    let watched = terminal.watch();
    let mut command = stage.command(&["run", "play.yaml", "--patience", "10s"]);
    terminal.attach(&mut command);
    let mut process = Process(command.spawn().unwrap());
    stage.robots.iter().for_each(|robot| robot.await_sets(5, SOON));
    stage.robots[1].freeze();
    terminal.type_keys("h");
    watched.shows("hold confirmed", SOON);
    terminal.type_keys("s");
    watched.shows("stop confirmed", SOON);
    stage.robots[1].thaw();
    let code = process.0.wait().unwrap().code();
    assert_eq!(code, Some(3), "{}", watched.screen());
    for robot in &mut stage.robots {
        watched.shows(&format!("{}: default state confirmed", robot.id), SOON);
        assert_eq!(robot.log().last().unwrap().value, 0.0, "{}", robot.id);
    }
}
