//! The output of the program: it delays nothing, and if it cannot be printed, the exit code indicates a failure.

use std::fs::File;
use std::process::Stdio;
use std::time::{Duration, Instant};

use rustix::process::Signal;

use stage::play::{LONG, Play, SHORT, SOON};
use stage::session::{Session, arm_at};
use stage::terminal::{Terminal, fill};
use stage::{Process, Stage, Via};

/// Returns a stage with two robots that play for 40 seconds without a lease, and therefore do not depend on the scheduler.
fn stage() -> Stage {
    Play { steps: 200, every_ms: 200, running: "none", ..LONG }.stage(&[Via::Direct, Via::Direct])
}

/// Checks that a mission whose output is not read plays, and stops by Ctrl-C.
#[track_caller]
fn check_that_it_plays_and_stops(out: Stdio, err: Stdio) {
    let stage = stage();
    let mut command = stage.command(&["run", "play.yaml", "--patience", "2s", "--log", "debug"]);
    let mut scheduler = Process(command.stdout(out).stderr(err).spawn().unwrap());
    stage.robots[0].await_sets(3, SOON);
    scheduler.signal(Signal::INT);
    let began = Instant::now();
    let code = loop {
        if let Some(status) = scheduler.0.try_wait().unwrap() {
            break status.code();
        }
        assert!(began.elapsed() < Duration::from_secs(60), "the scheduler hangs");
        std::thread::sleep(Duration::from_millis(5));
    };
    assert_eq!(code, Some(3), "stopped, and every robot confirmed it");
    for robot in &stage.robots {
        let sets = robot.sets().len();
        assert!(sets < 180, "{} set {sets} values of 200 although it was to stop", robot.id);
    }
}

#[test]
fn stalled_terminal_does_not_block_a_mission() {
    let terminal = Terminal::new(100, 30).stall();
    check_that_it_plays_and_stops(terminal.end(), terminal.end());
}

/// Returns a full pipe: its reading end, which nobody reads, and its writing end.
fn full_pipe() -> (File, File) {
    let (reader, writer) = rustix::pipe::pipe().unwrap();
    let writer = File::from(writer);
    fill(&writer);
    (File::from(reader), writer)
}

#[test]
fn full_standard_error_pipe_does_not_block_a_mission() {
    let (_reader, full) = full_pipe();
    check_that_it_plays_and_stops(Stdio::null(), full.into());
}

#[test]
fn full_standard_output_pipe_does_not_block_a_mission() {
    let (_reader, full) = full_pipe();
    check_that_it_plays_and_stops(full.into(), Stdio::null());
}

#[test]
fn output_lines_are_whole_when_reading_resumes() {
    let stage = stage();
    let (reader, writer) = full_pipe();
    let mut command = stage.command(&["run", "play.yaml", "--patience", "2s", "--log", "trace"]);
    let mut scheduler = Process(command.stdout(Stdio::null()).stderr(writer).spawn().unwrap());
    // It holds the pipe open as well.
    drop(command);
    stage.robots[0].await_sets(5, SOON);
    let text = std::thread::spawn(move || std::io::read_to_string(reader).unwrap());
    scheduler.signal(Signal::INT);
    assert_eq!(scheduler.0.wait().unwrap().code(), Some(3));
    let text = text.join().unwrap();
    let text = text.trim_start_matches('x');
    assert!(text.contains("stopping all robots"), "{text}");
    let whole = text.lines().all(|line| !line.contains('x') || line.len() < 2_000);
    assert!(whole, "lines are whole or missing:\n{text}");
}

const SCENARIO: &str = "scenario: hello
start_tolerance: 1s
cues:
  - at: 0s
    robots: arms
    tracks: {shoulder: [{at: 0s, to: 45}, {at: 300ms, to: 0}]}
";

/// Checks the exit code and the message of a command whose standard output is on a full disk.
#[track_caller]
fn check_on_a_full_disk(args: &[&str], code: i32) {
    let session = Session::new();
    session
        .file("arm.yaml", arm_at(45))
        .file("hello.yaml", SCENARIO)
        .file("bad.yaml", SCENARIO.replace("45", "450"));
    let full = File::options().write(true).open("/dev/full").unwrap();
    let ended = session.command(args).stdout(full).output().unwrap();
    let told = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert_eq!(ended.status.code(), Some(code), "{args:?}: {told}");
    assert_eq!(told.matches("cannot write to standard output").count(), 1, "{args:?}: {told}");
}

#[test]
fn output_to_a_full_disk_is_a_failure() {
    for args in [
        &["check", "hello.yaml"][..],
        &["check", "hello.yaml", "--format", "json"],
        &["plan", "hello.yaml"],
        &["plan", "hello.yaml", "--format", "json"],
        &["dry-run", "hello.yaml"],
        &["run", "hello.yaml"],
        &["run", "hello.yaml", "--format", "json"],
        &["preflight", "hello.yaml"],
        &["missions", "--all", "--format", "json"],
        &["fleet", "ping"],
        &["schema", "scenario"],
        &["explain"],
    ] {
        check_on_a_full_disk(args, 7);
    }
}

#[test]
fn output_to_a_full_disk_hides_no_other_failure() {
    check_on_a_full_disk(&["check", "bad.yaml", "--format", "json"], 1);
}

#[test]
fn closed_output_pipe_is_not_an_error() {
    let session = Session::new();
    session.file("arm.yaml", arm_at(45)).file("hello.yaml", SCENARIO);
    for args in [&["check", "hello.yaml"][..], &["run", "hello.yaml"], &["schema", "scenario"]] {
        let (reader, writer) = rustix::pipe::pipe().unwrap();
        drop(reader);
        let ended = session.command(args).stdout(File::from(writer)).output().unwrap();
        let told = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert_eq!(ended.status.code(), Some(0), "{args:?}: {told}");
        assert!(!told.contains("error:"), "{args:?}: {told}");
    }
}

#[test]
fn failed_recording_does_not_change_the_mission_outcome() {
    let stage = SHORT.stage(&[Via::Direct, Via::Direct]);
    let ended = stage.run(&["run", "play.yaml", "--record", "/dev/full"]);
    assert_eq!(ended.code, Some(7), "{ended}");
    assert!(ended.out.contains("play: done"), "{ended}");
    assert_eq!((ended.out.clone() + &ended.told).matches("No space left").count(), 1, "{ended}");
    for robot in &stage.robots {
        SHORT.was_played_by(robot);
    }
    let ended = stage.run(&["run", "play.yaml", "--record", "/dev/full", "--format", "json"]);
    assert_eq!((ended.code, &ended.report()["outcome"]), (Some(7), &"done".into()), "{ended}");
    let recording = &ended.report()["recording"];
    assert_eq!(recording["path"], "/dev/full");
    assert!(recording["failure"].as_str().unwrap().contains("No space left"), "{recording}");
}

#[test]
fn failed_recording_hides_no_unconfirmed_stop() {
    let stage = stage();
    let mut running = stage.begin(&["run", "play.yaml", "--record", "/dev/full", "--patience", "1s"], [0], 3);
    stage.robots[1].freeze();
    running.process.signal(Signal::INT);
    running.line("stopping all robots");
    let ended = running.ended();
    assert_eq!(ended.code, Some(4), "{ended}");
    assert!(ended.out.contains("r1: stop NOT confirmed"), "{ended}");
    assert!(ended.out.contains("the recording is incomplete: No space left"), "{ended}");
}

#[test]
fn recording_that_cannot_start_is_reported_before_any_movement() {
    let stage = SHORT.stage(&[Via::Direct]);
    let ended = stage.run(&["run", "play.yaml", "--record", "no/such/folder/play.mcap"]);
    assert_eq!(ended.code, Some(2), "{ended}");
    assert_eq!(ended.told.matches("cannot write the recording no/such/folder").count(), 1, "{ended}");
    assert!(stage.robots[0].sets().is_empty());
}

#[test]
fn log_has_no_colours_in_a_pipe_or_with_no_color() {
    let session = Session::new();
    session.file("arm.yaml", arm_at(45)).file("hello.yaml", SCENARIO);
    let ran = session.run(&["run", "hello.yaml", "--log", "trace"]);
    assert!(!ran.text().contains('\u{1b}'), "{}", ran.text());
    let terminal = Terminal::new(100, 30);
    let watched = terminal.watch();
    let mut command = session.command(&["check", "hello.yaml", "--fleet", "missing.yaml"]);
    terminal.attach(&mut command);
    command.env("NO_COLOR", "1").status().unwrap();
    watched.shows("error", SOON);
    assert!(!watched.raw().contains('\u{1b}'), "{}", watched.raw());
}
