//! Operators with identities who share a computer, and control a mission by `stop` and `go`: their certificates decide what they may do.

use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use stage::session::{Ran, Session};
use stage::site::Site;

const WAITS: &str = "scenario: waits
start_tolerance: 1s
acts:
  - act: one
    wait: operator
    cues: [{at: 0s, robots: all, tracks: {shoulder: [{at: 0s, to: 45}, {at: 60s, to: 10}]}}]
";

/// Starts a mission of the operator Anna, whose act waits for the command `go`. Waits until the mission accepts commands.
fn anna_waits() -> (Site, Child) {
    let site = Site::new();
    site.session.file("waits.yaml", WAITS);
    site.session.run(&["keys", "operator", "fay", "--role", "observe,drive,stop"]).says(0, &["fay"]);
    site.session.run(&["keys", "revoke", "--operator", "fay"]).says(0, &[]);
    site.session.run(&["keys", "init", "--keys", "others"]).says(0, &[]);
    site.session.run(&["keys", "operator", "dora", "--role", "drive,stop", "--keys", "others"]).says(0, &[]);
    let mut playing = site.session.command(&["run", "waits.yaml", "--format", "json"]);
    let playing = playing.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let begun = Instant::now();
    while !by(&site.session, None, &["go", "two"]).text().contains("unknown act `two`") {
        assert!(begun.elapsed() < Duration::from_secs(30), "no mission listens");
        std::thread::sleep(Duration::from_millis(50));
    }
    (site, playing)
}

/// Runs a command with this identity file; `None` for the default identity.
fn by(session: &Session, identity: Option<&str>, args: &[&str]) -> Ran {
    let mut command = session.command(args);
    if let Some(identity) = identity {
        command.env("DOWNBEAT_IDENTITY", identity);
    }
    Ran(command.output().unwrap())
}

/// Gives the command `go`, and repeats it while the mission still checks the fleet, for at most 30 s.
fn go(session: &Session, identity: &str) -> Ran {
    let begun = Instant::now();
    loop {
        let ran = by(session, Some(identity), &["go"]);
        if !ran.text().contains("still being checked") || begun.elapsed() > Duration::from_secs(30) {
            return ran;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}

fn journal(site: &Site) -> String {
    let missions = std::fs::read_dir(site.session.path("state")).unwrap().flatten();
    // The folder also contains the audit trails of the robots.
    let journals = missions.map(|folder| folder.path().join("journal")).filter(|journal| journal.exists());
    journals.map(|journal| std::fs::read_to_string(journal).unwrap()).collect()
}

#[test]
fn operators_issue_only_commands_their_roles_permit_and_are_named() {
    let (site, mut playing) = anna_waits();
    let session = &site.session;
    go(session, "keys/operators/bert.pem")
        .says(1, &["operator bert has the role observe, but a go requires the role drive"]);
    go(session, "keys/operators/dora.pem")
        .says(1, &["operator dora has the role stop, but a go requires the role drive"]);
    go(session, "keys/operators/fay.pem").says(1, &["its certificate is not valid here", "evoked"]);
    go(session, "others/operators/dora.pem").says(1, &["its certificate is not valid here"]);
    go(session, "keys/operators/nobody.pem").says(1, &["nobody.pem"]);
    assert_eq!(site.moved(), 0);
    go(session, "keys/operators/cleo.pem").says(0, &["`one` begins"]);
    let begun = Instant::now();
    // Two lines of each robot.
    while site.moved() < 6 {
        assert!(begun.elapsed() < Duration::from_secs(30), "nothing moves");
        std::thread::sleep(Duration::from_millis(20));
    }
    let moved = site.moved();
    for (identity, reason) in [
        ("keys/operators/bert.pem", "operator bert has the role observe, but a stop requires the role stop"),
        (
            "keys/operators/cleo.pem",
            "operator cleo has the roles observe, drive, but a stop requires the role stop",
        ),
        ("keys/robots/r0.pem", "its certificate is not valid here"),
        ("others/operators/dora.pem", "its certificate is not valid here"),
    ] {
        by(session, Some(identity), &["stop"]).says(4, &["refused", reason]);
    }
    assert_eq!(site.moved(), moved);
    assert!(playing.try_wait().unwrap().is_none(), "anna's mission continues");
    by(session, Some("keys/operators/dora.pem"), &["stop"]).says(0, &[]);
    let anna = Ran(playing.wait_with_output().unwrap());
    assert_eq!(anna.code(), 3, "{}", anna.text());
    assert_eq!(anna.json()["because"], "stopped by operator dora", "{}", anna.text());
    let journal = journal(&site);
    assert!(journal.contains(r#""record":"go","act":"one","by":"operator cleo""#), "{journal}");
    assert!(journal.contains(r#""by":"operator dora""#), "{journal}");
}

#[test]
fn mission_operator_and_keyless_terminal_may_stop_the_mission() {
    for identity in [None, Some("keys/operators/anna.pem"), Some("keys/operators/nobody.pem")] {
        let (site, playing) = anna_waits();
        by(&site.session, identity, &["stop"]).says(0, &[]);
        let anna = Ran(playing.wait_with_output().unwrap());
        assert_eq!(anna.code(), 3, "{identity:?}: {}", anna.text());
        assert_eq!(anna.json()["because"], serde_json::Value::Null, "{}", anna.text());
    }
}
