//! Certificates that a site's own PKI has issued: the recipe for OpenSSL in `docs/security.md`.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use stage::session::{Ran, Session, arm_at, root};
use stage::site::listens;
use stage::{Process, free_port};

/// The time within which a robot uses a new list. Robots check their lists once per second.
const APPLIED_WITHIN: Duration = Duration::from_secs(20);

/// Returns the scripts in the section of the document.
fn recipes() -> Vec<String> {
    let document = std::fs::read_to_string(root().join("docs/security.md")).unwrap();
    let (_, section) = document.split_once("\n## Certificates from your own PKI\n").unwrap();
    let (section, _) = section.split_once("\n## ").unwrap();
    let blocks = section.split("\n```sh\n").skip(1);
    blocks.map(|block| block.split_once("\n```").unwrap().0.to_owned()).collect()
}

#[expect(clippy::print_stderr, reason = "says that the test shows nothing")]
fn has_openssl() -> bool {
    let found = Command::new("openssl").arg("version").output().is_ok_and(|ran| ran.status.success());
    if !found {
        eprintln!("no `openssl`: this test shows nothing here");
    }
    found
}

/// Runs a script in the session's folder. Confirms each question of OpenSSL.
#[track_caller]
fn follow(session: &Session, recipe: &str) {
    let mut command = Command::new("sh");
    command.args(["-e", "-c", recipe]).current_dir(session.path("")).stdin(Stdio::null());
    Ran(command.output().unwrap()).says(0, &[]);
}

#[test]
fn robots_and_operators_with_certificates_of_openssl_accept_each_other() {
    if !has_openssl() {
        return;
    }
    let recipes = recipes();
    let [issue, revoke] = recipes.as_slice() else { panic!("{recipes:?}") };
    let session = Session::new();
    follow(&session, issue);
    session.file("cf1.yaml", arm_at(45).replace("id: arm", "id: cf1"));
    let listen = format!("127.0.0.1:{}", free_port());
    let args =
        ["--init", "cf1.yaml", "--listen", &listen, "--identity", "cf1.pem", "--revoked", "revoked.pem"];
    let mut robot =
        session.command(&[&["robot"], &args[..]].concat()).stdout(Stdio::piped()).spawn().unwrap();
    listens(&mut robot);
    let _robot = Process(robot);
    session.file(
        "fleet.yaml",
        format!("identity: anna.pem\nrevoked: revoked.pem\nrobots: {{cf1: {{init: cf1.yaml, address: 'tls://{listen}'}}}}\n"),
    );
    session.file(
        "show.yaml",
        "scenario: show\nstart_tolerance: 1s\ncues: [{at: 0s, robots: cf1, tracks: {shoulder: [{at: 0s, to: 45}, {at: 300ms, to: 10}, {at: 600ms, to: 45}]}}]\n",
    );
    session.play(&["run", "show.yaml", "--patience", "10s"]).says(0, &["show: done"]);
    session.run(&["stop", "--fleet", "fleet.yaml"]).says(0, &["cf1: stop confirmed"]);

    follow(&session, revoke);
    // The terminal itself need not know the list.
    session.file(
        "fleet.yaml",
        format!("identity: anna.pem\nrobots: {{cf1: {{init: cf1.yaml, address: 'tls://{listen}'}}}}\n"),
    );
    let revoked = Instant::now();
    loop {
        let ping = session.run(&["fleet", "ping"]);
        if ping.code() == 1 && ping.text().contains("revoked") {
            break;
        }
        assert!(revoked.elapsed() < APPLIED_WITHIN, "{}", ping.text());
        std::thread::sleep(Duration::from_millis(100));
    }
}
