//! Schedulers of which something stands still before or after the stop.

use std::io::{Read, pipe};
use std::process::Stdio;
use std::time::Duration;

use rustix::process::{Signal, kill_process};

use super::cell::{bound, ended, held_up, stop};
use super::show::{Show, Trouble, fill, program, scenario};
use super::{Way, await_that};
use stage::{Process, Stage, Via, epoch_nanos, one_device};

#[test]
fn a_disk_that_stands_still_before_the_mission_has_begun_does_not_keep_the_operator_from_ending_it() {
    let mut stage = Stage::new();
    stage.file("arm.yaml", one_device(1, 600, 600)).file("disk-stalled", "");
    for _ in 0..6 {
        stage.robot("arm.yaml", Via::Direct);
    }
    stage.file(
        "play.yaml",
        scenario().lines().filter(|line| !line.contains("r4,")).collect::<Vec<_>>().join("\n"),
    );
    let mut command = program(&stage, &["run", "play.yaml"], Trouble::DiskStalled);
    let mut running = Process(command.stderr(Stdio::piped()).spawn().unwrap());
    await_that("the journal", || stage.path("state").is_dir());
    std::thread::sleep(Duration::from_millis(300));
    running.signal(Signal::TERM);
    let code = ended(&mut running.0);
    let mut said = String::new();
    running.0.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert_eq!(code, Some(3), "{said}");
    assert!(said.contains("nothing was sent"), "{said}");
}

#[test]
fn a_report_is_printed_while_the_disk_stands_still() {
    let mut show = Show::begin(Trouble::DiskStalled);
    show.strike();
    let stopped = stop(&mut show, Way::Terminate);
    let said = stopped.said.unwrap();
    assert!(
        said.contains("stopped by the operator") && said.contains("r0: default state confirmed"),
        "{said}"
    );
    assert_eq!(stopped.code, Some(3));
}

#[test]
fn what_a_killed_scheduler_has_moved_is_stopped_while_the_one_that_takes_over_stands_still() {
    let show = Show::begin(Trouble::Nothing);
    kill_process(show.pid, Signal::KILL).unwrap();
    std::thread::sleep(Duration::from_millis(100));
    let (_kept, full) = pipe().unwrap();
    fill(&full);
    let mut resume = show.stage.command(&["resume"]);
    resume.stdout(full.try_clone().unwrap()).stderr(full);
    let resume = Process(resume.spawn().unwrap());
    await_that("its socket", || {
        let folders = std::fs::read_dir(show.stage.path("state")).unwrap();
        let log = |folder: std::fs::DirEntry| {
            std::fs::metadata(folder.path().join("control")).ok()?.modified().ok()
        };
        let latest = folders.flatten().filter_map(log).max().unwrap();
        latest > std::fs::metadata(show.stage.path("told")).unwrap().modified().unwrap()
    });
    std::thread::sleep(Duration::from_millis(500));
    let at = epoch_nanos();
    let ((), held_up) = held_up(|| {
        resume.signal(Signal::TERM);
        std::thread::sleep(Duration::from_secs(2));
    });
    let bound = i64::try_from(bound(Duration::from_millis(700) + held_up * 2).as_nanos()).unwrap();
    for robot in &show.stage.robots {
        let log = robot.log();
        let moved = log.iter().rev().find(|entry| entry.motion == "set").unwrap().at;
        assert!(moved < at + bound, "{} still moved {} ms later", robot.id, (moved - at) / 1_000_000);
        assert_ne!(log.last().unwrap().motion, "set", "{}", robot.id);
    }
}
