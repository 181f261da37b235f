//! Stops by the operator, with robots and scheduler as processes, while something in or around the scheduler stalls. By its own log,
//! every reachable robot comes to rest at once. The report names the others.

mod background;
mod cell;
mod flood;
mod scheduler_signals;
mod show;
mod standstill;

use rustix::process::Signal;

use cell::check_row;
use show::TROUBLES;
use stage::{Stage, Via, one_device};

/// How the operator stops a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    CtrlC,
    Terminate,
    HangUp,
    /// The command `downbeat stop`.
    Command,
    /// The command `downbeat stop`, after the scheduler was killed.
    AfterCrash,
    /// The command `downbeat stop`, while the scheduler's process is suspended.
    WhileFrozen,
    /// Ctrl-\ (SIGQUIT).
    Quit,
}

fn text(stage: &Stage, name: &str) -> String {
    std::fs::read_to_string(stage.path(name)).unwrap_or_default()
}

#[test]
fn ctrl_c_stops_every_robot_despite_other_faults() {
    check_row(Way::CtrlC, &TROUBLES);
}

#[test]
fn sigterm_stops_every_robot_despite_other_faults() {
    check_row(Way::Terminate, &TROUBLES);
}

#[test]
fn closed_terminal_stops_every_robot_despite_other_faults() {
    check_row(Way::HangUp, &TROUBLES);
}

#[test]
fn stop_command_stops_every_robot_despite_other_faults() {
    check_row(Way::Command, &TROUBLES);
}

#[test]
fn stop_command_stops_every_robot_of_a_killed_scheduler() {
    check_row(Way::AfterCrash, &TROUBLES);
}

#[test]
fn stop_command_stops_every_robot_of_a_frozen_scheduler() {
    check_row(Way::WhileFrozen, &TROUBLES);
}

#[test]
fn stop_does_not_move_robots_already_stopped_by_a_failure() {
    let mut stage = Stage::new();
    let arm = one_device(1, 600, 600).replace("    name: d\n", "    name: d\n    default_value: 0\n");
    stage.file("arm.yaml", arm);
    stage.robot("arm.yaml", Via::Direct);
    stage.robot("arm.yaml", Via::Direct);
    let keys = (0..100)
        .map(|step| format!("{{at: {}ms, to: {}}}", step * 50, step + 1))
        .collect::<Vec<_>>()
        .join(", ");
    stage.file("play.yaml", format!("scenario: play\nstart_tolerance: 1s\non_failure: stop\nstop_condition: {{running: none}}\ncues:\n  - {{at: 0s, robots: all, tracks: {{d: [{keys}]}}}}\n"));
    let mut running = stage.begin(&["run", "play.yaml", "--patience", "2s"], [1], 5);
    stage.robots[1].kill();
    running.line("stopping all robots");
    stage.await_record(r#""record":"stop_confirmed","robot":"r0""#);
    running.process.signal(Signal::INT);
    let ended = running.ended();
    assert!(ended.out.contains("r0: stop confirmed"), "{ended}");
    let log = stage.robots[0].log();
    let held = log.iter().rfind(|entry| entry.motion == "set").unwrap().value;
    let moved = log.iter().find(|entry| entry.motion != "set" && (entry.value - held).abs() > 0.5);
    assert!(moved.is_none(), "{moved:?}, it stood at {held}\n{ended}");
}
