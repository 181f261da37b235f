//! Keys that become invalid while their operators are connected.

use std::time::{Duration, Instant};

use stage::Process;
use stage::session::Ran;
use stage::site::Site;
use stage::terminal::Terminal;

use super::seize::anna_plays;

/// Time within which a mission must have ended after its operator's key was revoked. Robots check their lists once per second.
const ENDED_WITHIN: Duration = Duration::from_secs(20);

#[test]
fn mission_of_revoked_operator_ends_and_its_robots_are_free() {
    for scheme in ["tls", "hmac"] {
        let (site, mut playing) = anna_plays(scheme);
        site.session.run(&["keys", "revoke", "--operator", "anna"]).says(0, &["revoked 1"]);
        let revoked = Instant::now();
        while playing.try_wait().unwrap().is_none() {
            assert!(revoked.elapsed() < ENDED_WITHIN, "the mission continues");
            std::thread::sleep(Duration::from_millis(20));
        }
        let ended = Ran(playing.wait_with_output().unwrap());
        let report = ended.json();
        assert_ne!(report["outcome"]["outcome"], "done", "{report}");
        assert!(report["failures"].to_string().contains("key was revoked"), "{report}");
        // Each robot has reported that it rests.
        let robots = report["robots"].as_array().unwrap();
        assert!(robots.iter().all(|robot| robot["stop"]["state"] == "confirmed"), "{report}");
        // Robots check their lists at different times.
        let ends = "the commands of operator anna end: the operator's key was revoked";
        while !(0..3).all(|robot| site.logged(robot).contains(ends)) {
            assert!(revoked.elapsed() < ENDED_WITHIN, "{}", site.logged(0));
            std::thread::sleep(Duration::from_millis(20));
        }
        site.fleet(&site.addresses(scheme), "cleo");
        site.run().says(0, &["test: done"]);
    }
}

/// A robot that obeyed such a list would refuse every operator, and also every stop.
#[test]
fn revocation_list_of_another_authority_locks_nobody_out() {
    let (site, mut playing) = anna_plays("tls");
    let session = &site.session;
    session.run(&["keys", "init", "--keys", "others"]).says(0, &[]);
    std::fs::copy(session.path("others/revoked.pem"), session.path("keys/revoked.pem")).unwrap();
    let mut stop = session.command(&["stop", "--fleet", "fleet.yaml"]);
    stop.env("DOWNBEAT_IDENTITY", "keys/operators/dora.pem");
    Ran(stop.output().unwrap())
        .says(0, &["without a list of revoked certificates", "signed by another authority", "r0"]);
    assert!(site.logged(0).contains("signed by another authority"), "{}", site.logged(0));
    let _report = playing.wait().unwrap();
    session.run(&["run", "test.yaml"]).says(2, &["signed by another authority"]);
}

#[test]
fn revocation_list_is_sent_to_all_robots_and_each_states_its_version() {
    for scheme in ["tls", "hmac"] {
        let site = Site::with(scheme);
        let session = &site.session;
        // Each robot has its own copy of the list, as on its own machine.
        let list = if scheme == "tls" { "revoked.pem" } else { "revoked.serials" };
        let copy = |robot: usize| session.path(&format!("copy-{robot}"));
        let (own, mut robots) = (session.path(&format!("keys/{list}")), Vec::new());
        let mut addresses = Vec::new();
        for robot in 0..3 {
            std::fs::copy(&own, copy(robot)).unwrap();
            let (address, process) = site.another(robot, &format!("copy-{robot}"));
            addresses.push(address);
            robots.push(process);
        }
        site.fleet(&addresses, "anna");
        session.run(&["fleet", "ping"]).says(0, &["list of revoked keys", "less than a day old"]);
        session.run(&["keys", "revoke", "--operator", "cleo"]).says(0, &["downbeat keys push FLEET"]);
        // One robot is off.
        robots.pop();
        session
            .run(&["keys", "push"])
            .says(1, &["r0: uses the latest list", "r1: uses the latest list", "r2: "]);
        assert_eq!(std::fs::read(copy(0)).unwrap(), std::fs::read(&own).unwrap());
        assert_ne!(std::fs::read(copy(2)).unwrap(), std::fs::read(&own).unwrap());
        let (address, process) = site.another(2, "copy-2");
        addresses[2] = address;
        robots.push(process);
        site.fleet(&addresses, "anna");
        session
            .run(&["fleet", "ping"])
            .says(1, &["r2: its list of revoked keys is older", "downbeat keys push"]);
        session
            .run(&["keys", "revoke", "--operator", "bert", "--fleet", "fleet.yaml"])
            .says(0, &["r2: uses the latest list"]);
        session.run(&["fleet", "ping"]).says(0, &[]);
        session.run(&["keys", "push"]).says(0, &["r0: uses the latest list"]);
        site.fleet(&addresses, "bert");
        session.run(&["fleet", "ping"]).says(1, &[if scheme == "tls" { "revoked" } else { "no pass" }]);
    }
}

#[test]
fn robots_without_or_unable_to_store_a_revocation_list_are_reported() {
    let site = Site::new();
    let session = &site.session;
    let none = session.run(&["keys", "push", "--keys", "others"]);
    none.says(2, &["contains no authority"]);
    let folder = session.path("fixed");
    std::fs::create_dir(&folder).unwrap();
    std::fs::copy(session.path("keys/revoked.pem"), folder.join("revoked.pem")).unwrap();
    let (address, _robot) = site.another(0, "fixed/revoked.pem");
    // The folder in which the robot has to store the list has gone.
    std::fs::rename(&folder, session.path("elsewhere")).unwrap();
    session.run(&["keys", "revoke", "--operator", "cleo"]).says(0, &[]);
    session.file(
        "fleet.yaml",
        format!(
            "identity: keys/operators/anna.pem\nrobots:\n  r0: {{init: arm.yaml, address: '{address}'}}\n"
        ),
    );
    session.run(&["keys", "push"]).says(1, &["r0: still uses list", "cannot write fixed/revoked.pem"]);
    session.file("fleet.yaml", "robots:\n  r0: {init: arm.yaml, address: sim}\n");
    session.run(&["keys", "push"]).says(2, &["no robot has a tls:// or hmac:// address"]);
}

#[test]
fn key_is_not_revoked_if_named_fleet_cannot_be_read() {
    let site = Site::new();
    let session = &site.session;
    let revoke = |fleet: &str| session.run(&["keys", "revoke", "--operator", "cleo", "--fleet", fleet]);
    revoke("none.yaml").says(2, &["none.yaml"]);
    session.file("open.yaml", "robots:\n  r0: {init: arm.yaml, address: sim}\n");
    revoke("open.yaml").says(2, &["no robot has a tls:// or hmac:// address"]);
    site.fleet(&site.addresses("tls"), "cleo");
    session.run(&["fleet", "ping"]).says(0, &["r0"]);
    // Cleo cannot send the list that revokes Cleo.
    revoke("fleet.yaml").says(2, &["operator cleo would send the list", "DOWNBEAT_IDENTITY"]);
    session.run(&["fleet", "ping"]).says(0, &["r0"]);
    site.fleet(&site.addresses("tls"), "anna");
    let revoked =
        session.run(&["keys", "revoke", "--operator", "cleo", "--fleet", "fleet.yaml", "--format", "json"]);
    let json = revoked.json();
    assert_eq!(
        (revoked.code(), &json["name"], &json["revoked"]),
        (0, &"operator cleo".into(), &1.into()),
        "{json}"
    );
    assert!(json["robots"].as_array().unwrap().iter().all(|robot| robot["problem"].is_null()), "{json}");
    // A second attempt sends the list again.
    revoke("fleet.yaml").says(0, &["revoked 0 keys", "r0: uses the latest list"]);
    site.fleet(&site.addresses("tls"), "cleo");
    session.run(&["fleet", "ping"]).says(1, &["revoked"]);
}

#[test]
fn robot_unknown_to_the_authority_does_not_block_list_for_others() {
    let site = Site::with("hmac");
    let session = &site.session;
    std::fs::remove_file(session.path("keys/secrets/r1.secret")).unwrap();
    session.run(&["keys", "push"]).says(
        1,
        &[
            "r0: uses the latest list",
            "robot r1 has no key in this folder; names with a key: r0, r2",
            "keys secret r1",
            "r2: uses the latest list",
        ],
    );
}

#[test]
fn mission_waiting_for_its_operator_ends_when_the_key_is_revoked() {
    let site = Site::new();
    let waiting = "scenario: waiting\nstart_tolerance: 1s\nacts:\n  - act: one\n    wait: operator\n    cues: [{at: 0s, robots: all, tracks: {shoulder: [{at: 0s, to: 45}]}}]\n";
    site.session.file("waiting.yaml", waiting);
    let terminal = Terminal::new(80, 30);
    let watched = terminal.watch();
    let mut command = site.session.command(&["run", "waiting.yaml"]);
    terminal.attach(&mut command);
    let mut process = Process(command.spawn().unwrap());
    watched.shows("waits for", ENDED_WITHIN);
    site.session.run(&["keys", "revoke", "--operator", "anna"]).says(0, &["revoked 1"]);
    watched.shows("your certificate is revoked", ENDED_WITHIN);
    assert_eq!(process.0.wait().unwrap().code(), Some(1), "{}", watched.screen());
    assert_eq!(site.moved(), 0);
}
