//! Tests of the appearance of frames, on ratatui's test terminal.

use std::sync::Arc;

use downbeat_scripts::{Act, Folder, Source, compile, read_fleet};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use urrcp::{RobotId, Server, Span, Timestamp};

use super::frame::{Frame, Help};
use super::model::Model;
use crate::mission::{
    ActFate, Check, Failure, FailureKind, Greeting, Preflight, PreflightRow, Progress, Rest, Verdict,
};

const SECOND: Span = Span::from_millis(1_000);

/// Returns the model of the example `meeting`, with its fleet of two arms and a rover.
fn meeting() -> Model {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let (fleet, findings) = read_fleet(&root.join("fleet.yaml"));
    let source = Source::read(&root.join("scripts/examples/meeting.yaml")).unwrap();
    let folder = Folder::new(root.join("scripts/examples"));
    let compiled = compile(&source, &fleet.unwrap_or_else(|| panic!("{findings:?}")), &folder);
    let choreography = compiled.choreography.unwrap();
    let robots: Vec<RobotId> = ["arm-1", "arm-2", "rover-1"].map(|robot| robot.parse().unwrap()).into();
    Model::new(Arc::new(choreography), robots, at(0))
}

fn at(millis: i64) -> Timestamp<Server> {
    Timestamp::from_nanos(1_700_000_000_000_000_000) + Span::from_millis(millis)
}

fn robot(name: &str) -> RobotId {
    name.parse().unwrap()
}

/// Returns the contents of a terminal with this many columns and rows.
fn drawn(model: &Model, now: i64, columns: u16, rows: u16) -> String {
    let mut terminal = Terminal::new(TestBackend::new(columns, rows)).unwrap();
    let frame = Frame::of(model, at(now), Help::Hidden, columns, rows);
    terminal.draw(|target| frame.draw(target.area(), target.buffer_mut())).unwrap();
    let buffer = terminal.backend().buffer().clone();
    let line =
        |y: u16| (0..columns).map(|x| buffer[(x, y)].symbol()).collect::<String>().trim_end().to_owned();
    let text: Vec<_> = (0..rows).map(line).collect();
    text.join("\n").trim_end().to_owned()
}

#[track_caller]
fn check(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "`{part}` is missing in\n{text}");
    }
}

fn decided(model: &mut Model) {
    let progress = Progress::Decided {
        act: "arrival".to_owned(),
        start: at(5_000),
        duration: SECOND * 40,
        leases_end: at(0),
        no_return: at(4_700),
        doubt: Span::from_millis(50),
    };
    model.tell(at(1_000), &progress);
}

#[test]
fn greeted_robot_shows_clock_offset_in_same_format_as_later() {
    let mut model = meeting();
    let row = PreflightRow {
        robot: robot("arm-1"),
        checks: vec![(Check::Clock, Verdict::Pass("1.25 ±0.30 ms, measured".to_owned()))],
        clock_offset: Some(Span::from_nanos(1_250_000)),
        positions: std::collections::BTreeMap::new(),
        readings: Vec::new(),
    };
    let preflight =
        Preflight { greeting: Greeting::Full, rows: vec![row], skew: None, after_failures: Vec::new() };
    model.tell(at(10), &Progress::Greeted { clock_offset_max: None, preflight });
    let text = drawn(&model, 20, 100, 20);
    check(&text, &["ready", "+1.25 ms"]);
    assert!(!text.contains('±'), "{text}");
}

#[test]
fn decision_is_shown_with_its_point_of_no_return() {
    let mut model = meeting();
    decided(&mut model);
    let text = drawn(&model, 2_000, 100, 20);
    check(
        &text,
        &[
            "meeting  act `arrival` (1 of 2)  starting",
            "in 3.0 s",
            "if a robot fails in the next 2.7 s, until 22:13:24.700, no robot will start",
            "accepted",
        ],
    );
    model.tell(at(4_800), &Progress::Committed { act: "arrival".to_owned(), window: None });
    check(&drawn(&model, 4_900, 100, 20), &["past the point of no return: the robots start"]);
}

#[test]
fn playing_act_shows_its_cues_and_robot_reports() {
    let mut model = meeting();
    decided(&mut model);
    model.tell(at(5_001), &Progress::Started { robot: robot("arm-1"), error: Some(Span::from_millis(2)) });
    let heard =
        Progress::Heard { robot: robot("arm-1"), steps_done: 3, clock_offset: Some(Span::from_millis(-150)) };
    model.tell(at(6_000), &heard);
    for columns in [60, 100, 160] {
        let text = drawn(&model, 7_000, columns, 24);
        check(&text, &["playing", "2.0 s of 40.0 s", "greeting (", "next ", "arm-1", "-150.00 ms", "s stop"]);
        assert!(text.lines().all(|line| line.chars().count() <= usize::from(columns)), "{text}");
    }
    check(&drawn(&model, 7_000, 100, 24), &["started +2.00 ms", "running for 7.0 s"]);
}

#[test]
fn wait_shows_sensor_reading_and_remaining_time() {
    let mut model = meeting();
    decided(&mut model);
    let awaits = "`rover-1/range` below 0.5".to_owned();
    model.tell(at(6_000), &Progress::Waiting { act: "bow".to_owned(), awaits, at: None });
    check(&drawn(&model, 7_000, 100, 24), &["playing", "then    `bow` waits for"]);
    model.tell(at(45_000), &Progress::ActEnded { act: "arrival".to_owned() });
    model.tell(at(46_000), &Progress::Reading { act: "bow".to_owned(), value: Some(1.25) });
    check(&drawn(&model, 48_000, 100, 24), &["waiting", "reading 1.25; 17.0 s left, then the mission ends"]);
}

#[test]
fn wait_for_a_time_shows_a_countdown() {
    let mut model = meeting();
    let waits = |act: &str, millis: i64| Progress::Waiting {
        act: act.to_owned(),
        awaits: "19:30:00.000".to_owned(),
        at: Some(at(millis)),
    };
    model.tell(at(1_000), &waits("arrival", 7_506_000));
    check(&drawn(&model, 2_000, 60, 24), &["waiting", "for 19:30:00.000", "start   in 2:05:04 h"]);
    check(&drawn(&model, 7_500_700, 60, 24), &["start   in 5.3 s"]);
    decided(&mut model);
    model.tell(at(6_000), &waits("bow", 66_000));
    check(&drawn(&model, 6_000, 100, 24), &["then    `bow` waits for 19:30:00.000 (in 1:00 min)"]);
}

#[test]
fn start_on_another_day_shows_its_date() {
    let mut model = meeting();
    let tomorrow = 24 * 3_600_000 + 5_000;
    let progress = Progress::Decided {
        act: "arrival".to_owned(),
        start: at(tomorrow),
        duration: SECOND * 40,
        leases_end: at(0),
        no_return: at(tomorrow),
        doubt: Span::from_millis(50),
    };
    model.tell(at(1_000), &progress);
    let text = drawn(&model, 2_000, 100, 24);
    assert_eq!(text.matches(" Nov 2023").count(), 2, "{text}");
    let text = drawn(&model, tomorrow - 1, 100, 24);
    assert!(!text.contains(" Nov 2023"), "{text}");
}

#[test]
fn skipped_act_is_no_longer_shown_as_waiting() {
    let mut model = meeting();
    let awaits = "the operator's go".to_owned();
    model.tell(at(1_000), &Progress::Waiting { act: "arrival".to_owned(), awaits, at: None });
    check(&drawn(&model, 2_000, 100, 24), &["the operator's go"]);
    model.tell(at(3_000), &Progress::ActSkipped { act: "arrival".to_owned(), fate: ActFate::NobodyLeft });
    let text = drawn(&model, 4_000, 100, 24);
    assert!(!text.contains("the operator's go"), "{text}");
}

#[test]
fn failed_robots_are_listed_first_if_not_all_fit() {
    let mut model = meeting();
    let choreography = Arc::clone(&model.choreography);
    model = Model::new(choreography, (0..200).map(|i| robot(&format!("r{i}"))), at(0));
    model.tell(at(1), &Progress::Connected { robots: 200 });
    let kind = FailureKind::LinkDown { reason: "reset\u{1b}[2J".to_owned() };
    model.tell(at(2), &Progress::Failed(Failure { robot: robot("r150"), kind }));
    let text = drawn(&model, 10, 100, 16);
    check(&text, &["r150", "FAILED", "link down: reset\\u{1b}[2J", "more: ", "ready"]);
    assert!(text.find("r150").unwrap() < text.find("r0 ").unwrap(), "{text}");
    assert!(text.lines().count() <= 16, "{text}");
}

#[test]
fn stop_shows_robots_that_have_not_confirmed() {
    let mut model = meeting();
    decided(&mut model);
    for name in ["arm-1", "arm-2"] {
        model.tell(at(5_001), &Progress::Started { robot: robot(name), error: None });
    }
    model.tell(
        at(8_000),
        &Progress::Stopping { reason: "stopped by the operator".to_owned(), rest: Rest::InPlace },
    );
    let heard = Progress::Heard { robot: robot("arm-1"), steps_done: 7, clock_offset: None };
    model.tell(at(8_010), &heard);
    model.tell(at(8_010), &Progress::AtRest { robot: robot("arm-1") });
    let text = drawn(&model, 8_100, 100, 24);
    check(
        &text,
        &["STOPPING", "stopped by the operator", "robots not confirmed yet", "at rest", "stop confirmed"],
    );
    let row = |name: &str| text.lines().find(|line| line.starts_with(name)).unwrap().to_owned();
    assert!(row("arm-1").contains(" 7/") && row("arm-2").contains(" 0+/"), "{text}");
    assert!(!text.contains("s stop"), "{text}");
}

#[test]
fn going_home_and_a_following_stop_are_shown_as_such() {
    let mut model = meeting();
    decided(&mut model);
    let started = |name: &str| Progress::Started { robot: robot(name), error: None };
    ["arm-1", "arm-2"].iter().for_each(|name| model.tell(at(5_001), &started(name)));
    let stopping =
        || Progress::Stopping { reason: "stopped by the operator".to_owned(), rest: Rest::InPlace };
    model.tell(at(8_000), &stopping());
    let ended = model.acts[0].name.clone();
    model.tell(at(8_010), &Progress::ActEnded { act: ended });
    let mut home = (*model.choreography).clone();
    home.acts.push(Act { name: "home".to_owned(), ..home.acts[0].clone() });
    model.tell(at(8_020), &Progress::GoingHome { act: "home".to_owned(), choreography: home.into() });
    model.tell(
        at(8_030),
        &Progress::Waiting { act: "home".to_owned(), awaits: "robots".to_owned(), at: None },
    );
    let text = drawn(&model, 8_100, 100, 24);
    check(&text, &["GOING HOME", "act `home`", "s stop"]);
    assert!(!text.contains("STOPPING") && !text.contains("H home"), "{text}");
    model.tell(at(8_200), &stopping());
    check(&drawn(&model, 8_300, 100, 24), &["STOPPING", "robots not confirmed yet", "H home"]);
}
