//! The live display on a terminal, with real missions.

use std::os::unix::process::ExitStatusExt;
use std::time::Duration;

use rustix::process::Signal;

use stage::compiled::{SHARED, compiled};
use stage::play::{LONG, Play, SOON};
use stage::quiet::await_that;
use stage::session::Session;
use stage::terminal::{Terminal, Watched};
use stage::{Process, Stage, Via};

const ACTS: &str = "scenario: evening
start_tolerance: 1s
acts:
  - act: opening
    cues:
      - {cue: up, at: 0s, robots: arms, tracks: {shoulder: [{at: 500ms, to: 45}, {at: 1s, to: 0}]}}
  - act: finale
    wait: operator
    cues:
      - {cue: down, at: 0s, robots: arms, tracks: {shoulder: [{at: 500ms, to: 20}, {at: 1s, to: 0}]}}
";

/// A mission that runs on a terminal.
struct OnTerminal {
    terminal: Terminal,
    /// The terminal's settings before the mission.
    before: String,
    watched: Watched,
    process: Process,
}

impl OnTerminal {
    fn start(mut command: std::process::Command, columns: u16) -> Self {
        let terminal = Terminal::new(columns, 30);
        let before = terminal.settings();
        let watched = terminal.watch();
        terminal.attach(&mut command);
        let process = Process(command.spawn().unwrap());
        Self { terminal, before, watched, process }
    }

    /// Starts a mission that lasts many seconds, and waits until its display says that it plays.
    fn playing(stage: &Stage) -> Self {
        let mission = Self::start(stage.command(&["run", "play.yaml"]), 100);
        mission.watched.shows("playing", SOON);
        mission
    }

    /// Waits until the terminal's settings are as before the mission, or differ if not `wanted`. Returns `false` after a minute.
    fn is_as_before(&self, wanted: bool) -> bool {
        (0..6_000).any(|_| {
            std::thread::sleep(Duration::from_millis(10));
            (self.terminal.settings() == self.before) == wanted
        })
    }

    /// Waits for the end of the mission. Returns its exit code, and the final text on the terminal.
    fn ended(mut self) -> (Option<i32>, String) {
        let code = self.process.0.wait().unwrap().code();
        self.terminal.settle(&self.watched);
        (code, self.watched.screen())
    }
}

fn evening() -> Session {
    let session = Session::new();
    session.file("evening.yaml", ACTS);
    session
}

#[test]
fn key_starts_waiting_act_and_report_remains_on_the_terminal() {
    for columns in [60, 100] {
        let session = evening();
        let mission = OnTerminal::start(session.command(&["run", "evening.yaml"]), columns);
        mission.watched.shows("g go", SOON);
        assert_ne!(mission.terminal.settings(), mission.before, "keys come without Enter");
        mission.terminal.type_keys("g");
        mission.watched.shows("act `finale`", SOON);
        let (code, screen) = mission.ended();
        assert_eq!(code, Some(0), "{screen}");
        assert!(screen.contains("evening: done"), "{screen}");
        assert!(!screen.contains("g go") && !screen.contains("? help"), "the display is gone:\n{screen}");
        assert!(screen.lines().all(|line| line.chars().count() <= usize::from(columns)), "{screen}");
    }
}

fn long() -> Stage {
    Play { running: "2s", ..LONG }.stage(&[Via::Direct, Via::Direct])
}

#[test]
fn stop_key_ends_the_mission_and_restores_the_terminal() {
    let stage = long();
    let mut mission = OnTerminal::playing(&stage);
    stage.robots[0].await_sets(3, SOON);
    mission.terminal.type_keys("s");
    assert_eq!(mission.process.0.wait().unwrap().code(), Some(3), "{}", mission.watched.screen());
    mission.watched.shows("r1: stop confirmed", SOON);
    assert_eq!(mission.terminal.settings(), mission.before);
    assert!(mission.watched.raw().ends_with('\n'), "nothing is drawn after the report");
}

#[test]
fn second_ctrl_c_ends_a_stalled_scheduler_and_restores_the_terminal() {
    let stage = long();
    let mut command = stage.command(&["run", "play.yaml"]);
    command.env("LD_PRELOAD", compiled("processes/terminal/standstill.c", SHARED));
    command.env("STAND_STILL", stage.path("stand-still"));
    let mut mission = OnTerminal::start(command, 100);
    mission.watched.shows("playing", SOON);
    stage.file("stand-still", "");
    await_that("the standstill", || stage.run(&["go"]).to_string().contains("no answer within 1 s"));
    assert_ne!(mission.terminal.settings(), mission.before);
    mission.process.signal(Signal::INT);
    // Two signals that the process has not read yet would be merged into one.
    await_that("the stop of the robots", || stage.robots.iter().all(|robot| robot.rests()));
    mission.process.signal(Signal::INT);
    assert_eq!(mission.process.0.wait().unwrap().signal(), Some(Signal::INT.as_raw()));
    assert_eq!(mission.terminal.settings(), mission.before);
}

#[test]
fn suspended_mission_restores_the_terminal() {
    let stage = long();
    let mut mission = OnTerminal::playing(&stage);
    mission.process.signal(Signal::TSTP);
    mission.watched.shows("suspended", SOON);
    assert!(mission.is_as_before(true), "{}", mission.terminal.settings());
    mission.process.signal(Signal::CONT);
    assert!(mission.is_as_before(false), "the keys come without Enter again");
    mission.process.signal(Signal::INT);
    mission.process.0.wait().unwrap();
    assert_eq!(mission.terminal.settings(), mission.before);
}

#[test]
fn display_without_colours_uses_only_cursor_movements() {
    let session = evening();
    let mut command = session.command(&["run", "evening.yaml", "--act", "opening"]);
    let terminal = Terminal::new(100, 30);
    let watched = terminal.watch();
    terminal.attach(&mut command);
    command.env("NO_COLOR", "1");
    assert_eq!(command.status().unwrap().code(), Some(0));
    watched.shows("evening: done", SOON);
    let raw = watched.raw();
    assert!(raw.contains("playing"), "{raw:?}");
    let coloured = raw
        .split("\u{1b}[")
        .skip(1)
        .any(|rest| rest.trim_start_matches(|c: char| c.is_ascii_digit() || c == ';').starts_with('m'));
    assert!(!coloured, "{raw:?}");
}

#[test]
fn only_plain_lines_are_printed_in_a_pipe_or_narrow_terminal() {
    let session = evening();
    let ran = session.run(&["run", "evening.yaml", "--act", "opening"]);
    ran.says(0, &["all robots have accepted", "evening: done"]);
    assert!(!ran.text().contains("played") && !ran.text().contains('\u{1b}'), "{}", ran.text());
    let narrow = OnTerminal::start(session.command(&["run", "evening.yaml", "--act", "opening"]), 50);
    let (code, screen) = narrow.ended();
    assert_eq!(code, Some(0));
    assert!(screen.contains("all robots have accepted") && !screen.contains("s stop"), "{screen}");
}
