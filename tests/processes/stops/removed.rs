//! The state folder is removed while a mission plays. The mission restores its journal, reports this, and can still be stopped.

use std::path::{Path, PathBuf};
use std::time::Duration;

use stage::quiet::{await_that, stays};
use stage::{Ended, Running, Stage, Via, one_device};

/// Returns a stage with two robots that play for half a minute without a lease, with a step every 300 ms.
fn stage() -> Stage {
    let steps: Vec<_> = (0..100).map(|step| format!("{{at: {}ms, to: {step}}}", step * 300)).collect();
    let mut stage = Stage::new();
    stage.file("robot.yaml", one_device(2, 100, 200)).file(
        "long.yaml",
        format!(
            "scenario: long\nstart_tolerance: 1s\nstop_condition: {{running: none}}\ncues:\n  - {{cue: up, robots: all, at: 0s, tracks: {{d: [{}]}}}}\n",
            steps.join(", ")
        ),
    );
    stage.robot("robot.yaml", Via::Direct);
    stage.robot("robot.yaml", Via::Direct);
    stage
}

/// Returns the folders of the missions in a state folder.
fn missions(state: &Path) -> Vec<PathBuf> {
    let Ok(missions) = std::fs::read_dir(state) else { return Vec::new() };
    missions.flatten().map(|mission| mission.path()).collect()
}

/// Waits until commands find a mission again whose folder was removed.
#[track_caller]
fn await_found_again(stage: &Stage) {
    await_that("its folder", || {
        missions(&stage.path("state")).iter().any(|mission| mission.join("control").exists())
            && stage.journals().contains("committed")
    });
}

/// Stops the mission by `downbeat stop`. Checks that the robots confirm the stop, and that their logs agree.
#[track_caller]
fn is_stopped(stage: &Stage, mission: Running) -> Ended {
    let stop = stage.run(&["stop"]);
    let told = format!("{}{}", stop.out, stop.told);
    assert_eq!(stop.code, Some(0), "{told}");
    for robot in ["r0: stop confirmed", "r1: stop confirmed"] {
        assert!(told.contains(robot), "{told}");
    }
    let ended = mission.ended();
    assert_eq!(ended.code, Some(3), "{ended}");
    stage.await_rest();
    let sets = stays(Duration::from_millis(1_000), || {
        stage.robots.iter().map(|robot| robot.sets().len()).collect::<Vec<_>>()
    });
    assert!(sets.iter().all(|sets| *sets < 100), "{sets:?}");
    ended
}

#[test]
fn mission_reports_its_removed_state_folder_and_can_still_be_stopped() {
    let stage = stage();
    let mut mission = stage.begin(&["run", "long.yaml"], [0, 1], 2);
    std::fs::remove_dir_all(stage.path("state")).unwrap();
    mission.line("was removed or replaced and has been restored");
    await_found_again(&stage);
    let ended = is_stopped(&stage, mission);
    assert!(ended.out.contains("the journal was removed or replaced, and was restored"), "{ended}");
    let journal = stage.journals();
    for record in ["\"opened\"", "\"prepared\"", "\"committed\"", "\"ended\""] {
        assert!(journal.contains(record), "{record} is missing in {journal}");
    }
}

#[test]
fn mission_with_moved_state_folder_is_listed_and_stopped_at_old_path() {
    let stage = stage();
    let mission = stage.begin(&["run", "long.yaml", "--format", "json"], [0, 1], 2);
    std::fs::rename(stage.path("state"), stage.path("elsewhere")).unwrap();
    await_found_again(&stage);
    // A command that finds the moved folder detects that the mission still runs, and does not resume it.
    let mut resume = stage.command(&["resume"]);
    let resume = resume.env("DOWNBEAT_STATE", stage.path("elsewhere")).output().unwrap();
    assert_eq!(resume.status.code(), Some(2), "{}", String::from_utf8_lossy(&resume.stderr));
    let listed = stage.run(&["missions"]);
    assert!(listed.out.contains("running"), "{listed}");
    let ended = is_stopped(&stage, mission);
    assert_eq!(ended.report()["journal_written_again"], 1, "{ended}");
}

#[test]
fn mission_recreates_its_socket_if_only_the_socket_is_removed() {
    let stage = stage();
    let mission = stage.begin(&["run", "long.yaml", "--format", "json"], [0, 1], 2);
    let socket = missions(&stage.path("state"))[0].join("control");
    std::fs::remove_file(&socket).unwrap();
    await_that("its socket", || socket.exists());
    let ended = is_stopped(&stage, mission);
    assert!(ended.report()["journal_written_again"].is_null(), "{ended}");
}

#[test]
fn background_mission_recreates_its_log() {
    let stage = stage();
    let detached = stage.run(&["run", "long.yaml", "--detach", "--format", "json"]);
    assert_eq!(detached.code, Some(0), "{detached}");
    let log = PathBuf::from(detached.report()["log"].as_str().unwrap());
    await_that("the robots' steps", || stage.robots.iter().all(|robot| robot.sets().len() >= 2));
    std::fs::remove_dir_all(stage.path("state")).unwrap();
    await_that("its log", || log.exists());
    await_found_again(&stage);
    let stop = stage.run(&["stop"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    await_that("its report", || std::fs::read_to_string(&log).is_ok_and(|log| log.contains("\"outcome\"")));
    stage.await_rest();
}

#[test]
fn mission_that_cannot_recreate_its_journal_stops_its_robots() {
    let stage = stage();
    let mission = stage.begin(&["run", "long.yaml"], [0, 1], 2);
    std::fs::remove_dir_all(stage.path("state")).unwrap();
    stage.file("state", "a file where the folder was");
    let ended = mission.ended();
    assert_eq!(ended.code, Some(1), "{ended}");
    let said = ended.said();
    assert!(said.contains("was removed or replaced and cannot be restored"), "{said}");
    stage.await_rest();
}
