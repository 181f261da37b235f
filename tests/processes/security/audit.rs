//! Audit trails of robots: who connected, claimed, moved and stopped them.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use serde_json::Value;
use stage::session::{Ran, Session};
use stage::site::{Site, listens};
use stage::{Process, free_port};

/// Maximum time until a record is on the disk, however busy the machine is.
const RECORDED_WITHIN: Duration = Duration::from_secs(30);

/// Waits until the trails contain a record that satisfies the condition. Returns the output of `downbeat audit`.
fn audit(session: &Session, args: &[&str], is_complete: impl Fn(&[Value]) -> bool) -> Value {
    let begun = Instant::now();
    loop {
        let ran = session.run(&[&["audit", "--format", "json"], args].concat());
        let printed = ran.json();
        if printed["records"].as_array().is_some_and(|records| is_complete(records)) {
            assert_eq!(ran.code(), 0, "{printed}");
            return printed;
        }
        assert!(begun.elapsed() < RECORDED_WITHIN, "{printed}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

fn has(records: &[Value], event: &str, operator: &str) -> bool {
    records.iter().any(|record| record["event"] == event && record["operator"] == operator)
}

#[test]
fn trails_of_secured_robots_name_the_operators_who_moved_and_stopped_them() {
    for scheme in ["tls", "hmac"] {
        let site = Site::with(scheme);
        site.run().says(0, &["test: done"]);
        let mut stop = site.session.command(&["stop", "--fleet", "fleet.yaml"]);
        Ran(stop.env("DOWNBEAT_IDENTITY", "keys/operators/dora.pem").output().unwrap()).says(0, &["r0"]);
        let mut stranger = TcpStream::connect(("127.0.0.1", site.ports[0])).unwrap();
        stranger.write_all(b"{\"availability_request\": {}}\n").unwrap();
        let _refusal = stranger.read_to_end(&mut Vec::new());
        let refused = |records: &[Value]| records.iter().any(|record| record["event"] == "refused");
        let printed = audit(&site.session, &["--robot", "r0"], |records| {
            refused(records) && has(records, "stopped", "dora")
        });
        let records = printed["records"].as_array().unwrap();
        assert!(has(records, "connected", "anna") && has(records, "moved", "anna"), "{printed}");
        assert!(!has(records, "moved", "dora"), "{printed}");
        let moved = records.iter().find(|record| record["event"] == "moved").unwrap();
        assert!(moved["session"].as_str().unwrap().starts_with("test@"), "{moved}");
        assert!(!moved["session"].as_str().unwrap().contains('/'), "the key of the session: {moved}");
        assert_eq!(moved["device"], "shoulder");
        assert!(moved["serial"].as_str().is_some_and(|serial| serial.contains(':')), "{moved}");
        // The state at the time of the movement.
        let at = site.session.run(&["audit", "--robot", "r0", "--at", moved["at"].as_str().unwrap()]);
        at.says(0, &["moved", "anna", "shoulder", "claimed"]);
        assert!(!at.text().contains("stopped"), "{}", at.text());
        site.session.run(&["audit", "--operator", "dora"]).says(0, &["stopped", "dora", "last hash"]);
    }
}

#[test]
fn changed_trail_is_detected() {
    let site = Site::new();
    site.run().says(0, &["test: done"]);
    let printed = audit(&site.session, &["--robot", "r0"], |records| has(records, "moved", "anna"));
    let trail = &printed["trails"][0];
    let (path, hash) = (trail["file"].as_str().unwrap(), trail["hash"].as_str().unwrap());
    site.session.run(&["audit", path, "--contains", hash]).says(0, &["complete"]);
    let text = std::fs::read_to_string(path).unwrap();
    std::fs::write(path, text.replacen("anna", "bert", 1)).unwrap();
    site.session.run(&["audit", path]).says(1, &["the previous line was changed or removed"]);
    let cut = text.lines().count() - 1;
    let kept: String = text.lines().take(cut).map(|line| format!("{line}\n")).collect();
    std::fs::write(path, kept).unwrap();
    site.session.run(&["audit", path]).says(0, &["complete"]);
    site.session
        .run(&["audit", path, "--contains", hash])
        .says(1, &["no trail contains the record with this hash"]);
}

#[test]
fn other_files_are_refused_with_one_error() {
    let site = Site::new();
    let session = &site.session;
    let no_records = |name: &str, content: &[u8]| {
        std::fs::write(session.path(name), content).unwrap();
        let ran = session.run(&["audit", name]);
        ran.says(1, &["contains no records of an audit trail"]);
        assert_eq!(ran.text().matches("error:").count(), 1, "{}", ran.text());
    };
    no_records("empty.jsonl", b"");
    no_records("binary.jsonl", &[0xff, 0, b'\n'].repeat(100_000));
    no_records("long.jsonl", &b"{\"a\": 1}\n".repeat(100_000));
    session.run(&["audit", "missing.jsonl"]).says(2, &["missing.jsonl: there is no such file"]);
    session.run(&["audit", "keys"]).says(2, &["this is a folder"]);
    session.run(&["audit", "--robot", "nobody"]).says(2, &["`nobody`", "robots with records: r0, r1, r2"]);
    let printed = audit(session, &["--robot", "r0"], |records| !records.is_empty());
    let path = printed["trails"][0]["file"].as_str().unwrap();
    let line = std::fs::read_to_string(path).unwrap().lines().next().unwrap().to_owned();
    std::fs::write(session.path("repeated.jsonl"), format!("{line}\n").repeat(1_000)).unwrap();
    let ran = session.run(&["audit", "repeated.jsonl"]);
    ran.says(1, &["repeated.jsonl, line 2: the previous line was changed", "979 faults more"]);
    let robot = ["robot", "--init", "arm.yaml", "--listen", "127.0.0.1:0", "--audit"];
    for (path, why) in [("keys", "this is a folder"), ("missing/r.jsonl", "missing/r.jsonl")] {
        let ran = session.run(&[&robot[..], &[path]].concat());
        ran.says(2, &["cannot write the audit trail", why]);
        assert!(!ran.text().contains("os error"), "{}", ran.text());
    }
}

#[test]
fn trail_is_written_by_default_only_by_secured_robots_and_edges() {
    let session = Session::new();
    session.run(&["audit"]).says(2, &["no robot of this machine has written an audit trail"]);
    let start = |args: &[&str]| {
        let mut command = session.command(args);
        let mut child = command.stdout(std::process::Stdio::piped()).spawn().unwrap();
        listens(&mut child);
        Process(child)
    };
    let listen = format!("127.0.0.1:{}", free_port());
    let robot = ["robot", "--init", "arm.yaml", "--listen", &listen];
    drop(start(&robot));
    session.run(&["audit"]).says(2, &["no robot of this machine has written an audit trail"]);
    let _robot = start(&[&robot[..], &["--audit", "own.jsonl"]].concat());
    session.run(&["audit", "own.jsonl"]).says(0, &["started", "records 1 to 1"]);
    let listen = format!("127.0.0.1:{}", free_port());
    let edge = ["edge", "--init", "arm.yaml", "--listen", &listen, "--driver", "program:cat"];
    drop(start(&[&edge[..], &["--no-audit"]].concat()));
    session.run(&["audit"]).says(2, &["no robot of this machine has written an audit trail"]);
    let _edge = start(&edge);
    session.run(&["audit"]).says(0, &["started", "records 1 to 1"]);
    // A second process with this id has no trail, but runs.
    let second = format!("127.0.0.1:{}", free_port());
    drop(start(&["edge", "--init", "arm.yaml", "--listen", &second, "--driver", "program:cat"]));
}
