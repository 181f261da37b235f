//! A mission with a robot that writes what is no message.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;

use crate::session::Session;

const BOTH: &str = "scenario: both
cues:
  - at: 0s
    robots: arms
    tracks:
      shoulder: [{at: 0s, to: 45}, {at: 300ms, to: 0}]
";

/// A fleet of a simulated arm and one that is available and then describes itself by this line.
fn beside(line: String) -> Session {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    // Ends with the scheduler's connection.
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            for request in BufReader::new(stream.try_clone().unwrap()).lines() {
                let Ok(request) = request else { break };
                let answer = if request.contains("initialization_request") {
                    line.clone()
                } else {
                    available(&request)
                };
                if writeln!(stream, "{answer}").is_err() {
                    break;
                }
            }
        }
    });
    let session = Session::new();
    session.file("both.yaml", BOTH).file(
        "fleet.yaml",
        format!(
            "robots:\n  left: {{init: arm.yaml, address: sim}}\n  right: {{init: arm.yaml, address: 'tcp://127.0.0.1:{port}'}}\ngroups:\n  arms: [left, right]\n"
        ),
    );
    session
}

/// The robot's clock is the server's.
fn available(request: &str) -> String {
    let timestamp = request.split("\"timestamp\":\"").nth(1).and_then(|rest| rest.split('"').next()).unwrap();
    format!(
        r#"{{"availability_response":{{"originate_timestamp":"{timestamp}","receive_timestamp":"{timestamp}","timestamp":"{timestamp}","status":"OK"}}}}"#
    )
}

#[track_caller]
fn check_refused(line: String, says: &str) {
    let session = beside(line);
    let ran = session.run(&["run", "both.yaml", "--format", "json"]);
    ran.says(1, &[says]);
    let report = ran.json();
    assert_eq!(report["outcome"], "not_started");
    let failures = report["failures"].as_array().unwrap();
    assert_eq!(failures.len(), 1, "{report}");
    assert_eq!((&failures[0]["failure"], &failures[0]["robot"]), (&"garbled".into(), &"right".into()));
}

#[test]
fn no_robot_moves_when_one_describes_itself_beyond_the_limits() {
    let device = |i: usize| format!(r#"{{"id":"d{i}","name":"","available_control_types":{{}}}}"#);
    let devices: Vec<_> = (0..32_001).map(device).collect();
    let block = format!(
        r#"{{"initialization_block":{{"id":"right","api_version":"1","devices":[{}]}}}}"#,
        devices.join(",")
    );
    check_refused(block, "32001 devices, expected 1 to 32000");
    check_refused("x".repeat(17 * 1024 * 1024), "a line longer than 16777216 bytes");
    check_refused(r#"{"initialization_block":"#.repeat(100_000), "not JSON");
}
