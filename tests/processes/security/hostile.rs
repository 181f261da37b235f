//! Missions with a robot that sends invalid messages, or texts that attack the operator's terminal.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;

use stage::session::{Session, arm_at};
use stage::terminal::{Terminal, Watched};

const BOTH: &str = "scenario: both
start_tolerance: 1s
cues:
  - at: 0s
    robots: arms
    tracks:
      shoulder: [{at: 0s, to: 45}, {at: 300ms, to: 0}]
";

/// Creates a fleet of a simulated arm and a hostile robot. `answer` returns the robot's answer to a request; `None` if it does not
/// answer.
fn beside(answer: impl Fn(&str) -> Option<String> + Send + 'static) -> Session {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    // Ends with the scheduler's connection.
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            for request in BufReader::new(stream.try_clone().unwrap()).lines() {
                let Ok(request) = request else { break };
                let Some(answer) = answer(&request) else { continue };
                if writeln!(stream, "{answer}").is_err() {
                    break;
                }
            }
        }
    });
    let session = Session::new();
    session.file("arm.yaml", arm_at(45)).file("both.yaml", BOTH).file(
        "fleet.yaml",
        format!(
            "robots:\n  left: {{init: arm.yaml, address: sim}}\n  right: {{init: arm.yaml, address: 'tcp://127.0.0.1:{port}'}}\ngroups:\n  arms: [left, right]\n"
        ),
    );
    session
}

/// Creates a fleet with a robot that is available and sends `line` as its description.
fn described(line: String) -> Session {
    beside(move |request| {
        if request.contains("initialization_request") { Some(line.clone()) } else { Some(available(request)) }
    })
}

/// Returns the answer to an availability request from a robot that is available. Its clock agrees with that of the server.
fn available(request: &str) -> String {
    let asked = request.split("\"timestamp\":\"").nth(1).and_then(|rest| rest.split('"').next());
    let originate = asked.map(|asked| format!(r#""originate_timestamp":"{asked}","#)).unwrap_or_default();
    let now = asked.unwrap_or("2026-01-01T00:00:00.000000000Z");
    format!(
        r#"{{"availability_response":{{{originate}"receive_timestamp":"{now}","timestamp":"{now}","status":"OK"}}}}"#
    )
}

#[track_caller]
fn check_refused(line: String, says: &str) {
    let session = described(line);
    let ran = session.run(&["run", "both.yaml", "--format", "json"]);
    ran.says(1, &[says]);
    let report = ran.json();
    assert_eq!(report["outcome"], "not_started");
    let failures = report["failures"].as_array().unwrap();
    assert_eq!(failures.len(), 1, "{report}");
    assert_eq!((&failures[0]["failure"], &failures[0]["robot"]), (&"garbled".into(), &"right".into()));
}

#[test]
fn no_robot_moves_if_one_description_exceeds_the_limits() {
    let device = |i: usize| format!(r#"{{"id":"d{i}","name":"","available_control_types":{{}}}}"#);
    let devices: Vec<_> = (0..32_001).map(device).collect();
    let block = format!(
        r#"{{"initialization_block":{{"id":"right","api_version":"1","devices":[{}]}}}}"#,
        devices.join(",")
    );
    check_refused(block, "32001 devices, expected 1 to 32000");
    check_refused("x".repeat(17 * 1024 * 1024), "the line is too long, expected at most 16777216 bytes");
    check_refused(r#"{"initialization_block":"#.repeat(100_000), "invalid JSON at column");
}

/// A text that sets the window's title, clears the screen and writes to the clipboard. It also forges a line that an operator would
/// believe.
const EVIL: &str = "\u{1b}]0;pwned\u{7}\u{1b}[2J\u{1b}[H\u{1b}]52;c;cHduZWQ=\u{7}\n\u{1b}[32mall robots: default state confirmed\u{1b}[0m\r\n\u{9b}2J\u{202e}";

/// Runs a command with this fleet on a terminal, and returns the output.
fn on_terminal(session: &Session, args: &[&str]) -> Watched {
    let terminal = Terminal::new(100, 30);
    let watched = terminal.watch();
    let mut command = session.command(args);
    terminal.attach(&mut command);
    command.status().unwrap();
    // The last output of the process may still be in flight.
    terminal.settle(&watched);
    watched
}

/// Checks that no control sequence of [`EVIL`] reaches the terminal, and that the screen shows the text `seen`.
#[track_caller]
fn check_harmless(watched: &Watched, seen: &str) {
    let raw = watched.raw();
    for sequence in ["\u{1b}]", "\u{7}", "\u{1b}[2J", "\u{1b}[H", "\u{1b}[32mall", "\u{9b}", "\u{202e}"] {
        assert!(!raw.contains(sequence), "{sequence:?} reaches the terminal: {raw:?}");
    }
    let screen = watched.screen();
    assert!(!screen.lines().any(|line| line.trim_start().starts_with("all robots:")), "{screen}");
    assert!(screen.contains(seen), "`{seen}` is not shown:\n{screen}");
}

/// Creates a fleet with a robot that answers availability requests with a failure for this reason.
fn unavailable(reason: &str) -> Session {
    let error = serde_json::json!({"code": "internal", "message": reason});
    let range =
        serde_json::json!({"min_value": 0, "max_value": 90, "granularity": 0.5, "max_number_of_steps": 8});
    let shoulder = serde_json::json!({"id": "shoulder", "name": "shoulder", "available_control_types":
        {"position": {"min_value": 0, "max_value": 90, "granularity": 0.5}, "script": range}});
    let block = serde_json::json!({"initialization_block":
        {"id": "right", "api_version": "1", "devices": [shoulder]}});
    beside(move |request| match request {
        _ if request.contains("initialization_request") => Some(block.to_string()),
        _ if request.contains("availability_request") => {
            let failed = format!(r#""status":"Failed","error":{error}"#);
            Some(available(request).replace(r#""status":"OK""#, &failed))
        }
        _ => None,
    })
}

#[test]
fn no_control_sequences_in_robot_messages_reach_the_terminal() {
    let session = unavailable(EVIL);
    for args in [&["run", "both.yaml", "--log", "debug"][..], &["preflight", "both.yaml"], &["fleet", "ping"]]
    {
        check_harmless(&on_terminal(&session, args), "]0;pwned");
    }
}

#[test]
fn no_control_sequences_in_robot_descriptions_reach_the_terminal() {
    let device = serde_json::json!({"id": EVIL, "name": EVIL, "unit": EVIL, "available_control_types":
        {"position": {"min_value": 0, "max_value": 90, "granularity": 0.5}}});
    let block = serde_json::json!({"initialization_block":
        {"id": EVIL, "name": EVIL, "api_version": EVIL, "devices": [device]}});
    let session = described(block.to_string());
    for args in [
        &["run", "both.yaml"][..],
        &["preflight", "both.yaml"],
        &["preflight", "both.yaml", "--format", "json"],
        &["fleet", "show"],
    ] {
        let watched = on_terminal(&session, args);
        check_harmless(&watched, "]0;pwned");
    }
}

/// Creates a scenario in which the names are [`EVIL`].
fn evil_names() -> Session {
    // YAML accepts these characters only in escapes.
    let evil =
        serde_json::json!(EVIL).to_string().replace('\u{9b}', "\\u009b").replace('\u{202e}', "\\u202e");
    let session = Session::new();
    session.file(
        "evil.yaml",
        format!("scenario: {evil}\nstart_tolerance: 1s\ncues:\n  - {{cue: {evil}, at: 0s, robots: arms, tracks: {{shoulder: [{{at: 1s, to: 45}}]}}}}\n"),
    );
    session.file(
        "bad.yaml",
        format!("scenario: bad\ncues:\n  - {{cue: {evil}, at: 0s, robots: {evil}, tracks: {{}}}}\n"),
    );
    session
}

#[test]
fn no_control_sequences_in_names_from_files_reach_the_terminal() {
    let session = evil_names();
    // It does not print a scenario's names if it finds nothing.
    check_harmless(&on_terminal(&session, &["check", "evil.yaml"]), "no errors");
    let all = [
        &["check", "bad.yaml"][..],
        &["plan", "evil.yaml"],
        &["plan", "evil.yaml", "--gantt"],
        &["plan", "evil.yaml", "--format", "json"],
        &["dry-run", "evil.yaml"],
        &["run", "evil.yaml"],
    ];
    for args in all {
        check_harmless(&on_terminal(&session, args), "]0;pwned");
    }
}

#[test]
fn picture_with_control_characters_in_names_is_valid_xml() {
    let session = evil_names();
    let ran = session.run(&["dry-run", "evil.yaml", "--picture", "evil.svg"]);
    let picture =
        std::fs::read_to_string(session.path("evil.svg")).unwrap_or_else(|_| panic!("{}", ran.text()));
    let parsed = roxmltree::Document::parse(&picture);
    assert!(parsed.is_ok(), "{parsed:?}");
    assert!(picture.contains("]0;pwned"), "{picture}");
}
