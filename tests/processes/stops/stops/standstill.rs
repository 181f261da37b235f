//! Schedulers that are suspended in part (for example, while they wait for the disk) before or after the stop.

use std::io::{Read, pipe};
use std::process::Stdio;
use std::time::Duration;

use rustix::process::Signal;

use super::Way;
use super::cell::{AT_REST_MAX, ended, stop};
use super::show::{STEPS, Show, Trouble, fill, program, scenario};
use stage::quiet::{await_that, stays};
use stage::{Process, Robot, Stage, Via, epoch_nanos, one_device};

#[test]
fn disk_stall_before_start_does_not_prevent_operator_from_ending_mission() {
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
    await_that("what waits for the disk", || stage.path("disk-stalled.waits").exists());
    running.signal(Signal::TERM);
    let code = ended(&mut running.0);
    let mut said = String::new();
    running.0.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert_eq!(code, Some(3), "{said}");
    assert!(said.contains("nothing was sent"), "{said}");
}

#[test]
fn report_is_printed_during_a_disk_stall() {
    let mut show = Show::begin(Trouble::DiskStalled);
    show.strike();
    let stopped = stop(&mut show, Way::Terminate);
    let said = stopped.said.unwrap();
    assert!(said.contains("stopped by the operator") && said.contains("r0: stop confirmed"), "{said}");
    assert_eq!(stopped.code, Some(3));
}

/// Returns for each robot the number of its connections.
fn connections(show: &Show) -> Vec<usize> {
    show.stage.robots.iter().map(Robot::connections).collect()
}

#[test]
fn robots_of_killed_scheduler_are_stopped_while_its_successor_stalls() {
    let mut show = Show::begin(Trouble::Nothing);
    show.kill();
    await_that("the end of its connections", || connections(&show) == [0; 6]);
    let (_kept, full) = pipe().unwrap();
    fill(&full);
    let mut resume = show.stage.command(&["resume"]);
    resume.stdout(full.try_clone().unwrap()).stderr(full);
    let resume = Process(resume.spawn().unwrap());
    await_that("its connections", || connections(&show).iter().all(|count| *count > 0));
    let at = epoch_nanos();
    resume.signal(Signal::TERM);
    show.stage.await_rest();
    stays(Duration::from_secs(1), || {
        show.stage.robots.iter().map(|robot| robot.sets().len()).collect::<Vec<_>>()
    });
    let bound = i64::try_from(AT_REST_MAX.as_nanos()).unwrap();
    for robot in &show.stage.robots {
        let log = robot.log();
        let moved = log.iter().rev().find(|entry| entry.motion == "set").unwrap().at;
        assert!(moved < at + bound, "{} still moved {} ms later", robot.id, (moved - at) / 1_000_000);
        let last = log.last().unwrap();
        assert!(last.value < f64::from(STEPS), "{} played its script to its end", robot.id);
    }
}
