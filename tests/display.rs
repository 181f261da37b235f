//! The live display on a terminal, with real missions.

use std::time::Duration;

use rustix::process::Signal;

use crate::robots::play::{LONG, Play, SOON};
use crate::robots::{Process, Stage, Via};
use crate::session::Session;
use crate::terminal::{Terminal, Watched};

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

/// A mission on a terminal.
struct OnTerminal {
    terminal: Terminal,
    watched: Watched,
    process: Process,
}

impl OnTerminal {
    fn start(mut command: std::process::Command, columns: u16) -> Self {
        let terminal = Terminal::new(columns, 30);
        let watched = terminal.watch();
        terminal.attach(&mut command);
        let process = Process(command.spawn().unwrap());
        Self { terminal, watched, process }
    }

    /// Its exit code, and what stands on the terminal in the end.
    fn ended(mut self) -> (Option<i32>, String) {
        let code = self.process.0.wait().unwrap().code();
        // What it wrote last may still be on its way.
        std::thread::sleep(Duration::from_millis(200));
        (code, self.watched.screen())
    }
}

fn evening() -> Session {
    let session = Session::new();
    session.file("evening.yaml", ACTS);
    session
}

#[test]
fn an_act_that_waits_begins_with_a_key_and_the_report_stays_on_the_terminal() {
    for columns in [60, 100] {
        let session = evening();
        let mission = OnTerminal::start(session.command(&["run", "evening.yaml"]), columns);
        let before = mission.terminal.settings();
        mission.watched.shows("g go", SOON);
        assert_ne!(mission.terminal.settings(), before, "keys come without Enter");
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
fn a_key_stops_and_the_terminal_is_as_before() {
    let stage = long();
    let terminal = Terminal::new(100, 30);
    let before = terminal.settings();
    let watched = terminal.watch();
    let mut command = stage.command(&["run", "play.yaml"]);
    terminal.attach(&mut command);
    let mut process = Process(command.spawn().unwrap());
    watched.shows("playing", SOON);
    stage.robots[0].await_sets(3, SOON);
    terminal.type_keys("s");
    assert_eq!(process.0.wait().unwrap().code(), Some(3), "{}", watched.screen());
    watched.shows("r1: default state confirmed", SOON);
    assert_eq!(terminal.settings(), before);
    assert!(watched.raw().ends_with('\n'), "nothing is drawn after the report");
}

#[test]
fn a_mission_that_is_suspended_leaves_the_terminal_as_it_was() {
    let stage = long();
    let terminal = Terminal::new(100, 30);
    let before = terminal.settings();
    let watched = terminal.watch();
    let mut command = stage.command(&["run", "play.yaml"]);
    terminal.attach(&mut command);
    let mut process = Process(command.spawn().unwrap());
    watched.shows("playing", SOON);
    process.signal(Signal::TSTP);
    watched.shows("suspended", SOON);
    let settled = |wanted: bool| {
        (0..500).any(|_| {
            std::thread::sleep(Duration::from_millis(10));
            (terminal.settings() == before) == wanted
        })
    };
    assert!(settled(true), "{}", terminal.settings());
    process.signal(Signal::CONT);
    assert!(settled(false), "the keys come without Enter again");
    process.signal(Signal::INT);
    process.0.wait().unwrap();
    assert_eq!(terminal.settings(), before);
}

#[test]
fn without_colours_the_display_only_moves() {
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
fn in_a_pipe_or_on_a_narrow_terminal_there_are_lines_alone() {
    let session = evening();
    let ran = session.run(&["run", "evening.yaml", "--act", "opening"]);
    ran.says(0, &["all have accepted", "evening: done"]);
    assert!(!ran.text().contains("played") && !ran.text().contains('\u{1b}'), "{}", ran.text());
    let narrow = OnTerminal::start(session.command(&["run", "evening.yaml", "--act", "opening"]), 50);
    let (code, screen) = narrow.ended();
    assert_eq!(code, Some(0));
    assert!(screen.contains("all have accepted") && !screen.contains("s stop"), "{screen}");
}
