//! Keys that become invalid while their operators are connected.

use std::os::unix::fs::PermissionsExt;
use std::process::Command;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use downbeat_robot::tls::Name;
use downbeat_runtime::keys::Authority;
use stage::Process;
use stage::operators::{Operators, fails_with};
use stage::session::{Ran, Session, root};
use stage::site::{Site, built, starter};
use stage::terminal::Terminal;
use urrcp::Role;

use super::hmac::Spoken;
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

#[test]
fn robot_refuses_an_older_list_when_it_starts() {
    for (scheme, list) in [("tls", "keys/revoked.pem"), ("hmac", "keys/revoked.serials")] {
        let site = Site::with(scheme);
        let session = &site.session;
        let older = std::fs::read(session.path(list)).unwrap();
        session.run(&["keys", "revoke", "--operator", "cleo"]).says(0, &[]);
        std::fs::copy(session.path(list), session.path("copy")).unwrap();
        let number = |path: &str| std::fs::read_to_string(session.path(path)).unwrap().trim().to_owned();
        drop(site.another(0, "copy"));
        let used = number("copy.number");
        session.file("copy", older);
        let (kind, key) = if scheme == "tls" {
            ("--identity", "keys/robots/r0.pem")
        } else {
            ("--secret", "keys/secrets/r0.secret")
        };
        let robot = ["robot", "--init", "arm.yaml", "--id", "r0", "--listen", "127.0.0.1:0", kind, key];
        let started = || session.run(&[&robot[..], &["--revoked", "copy"]].concat());
        started()
            .says(2, &["copy: this is list ", &format!("but list {used} was already in use"), "copy.number"]);
        assert_eq!(number("copy.number"), used);
        // The operator has replaced the authority.
        std::fs::remove_file(session.path("copy.number")).unwrap();
        drop(site.another(0, "copy"));
        assert_ne!(number("copy.number"), used);
    }
}

/// A robot that users copy, with its own copy of the list of revoked keys. Anna and Bert may drive it.
struct Starter {
    session: Session,
    scheme: &'static str,
    address: String,
    _robot: Process,
}

impl Starter {
    fn new(scheme: &'static str) -> Self {
        let session = Session::new();
        session.run(&["keys", "init"]).says(0, &[]);
        let (kind, id) = if scheme == "tls" { ("robot", "arm-1") } else { ("secret", "arm-2") };
        session.run(&["keys", kind, id]).says(0, &[]);
        for name in ["anna", "bert"] {
            session.run(&["keys", "operator", name, "--role", "observe,drive"]).says(0, &[]);
        }
        let list = if scheme == "tls" { "keys/revoked.pem" } else { "keys/revoked.serials" };
        std::fs::copy(session.path(list), session.path("list")).unwrap();
        let (robot, address) = starter(&session, scheme, "list");
        Self { session, scheme, address, _robot: robot }
    }

    fn id(&self) -> &'static str {
        if self.is_tls() { "arm-1" } else { "arm-2" }
    }

    fn is_tls(&self) -> bool {
        self.scheme == "tls"
    }

    /// Returns the description of the robot, its fleet and the missions `long` and `short` for the commands of operators.
    fn operators(&self) -> Operators<'_> {
        let operators = Operators::of(&self.session, self.id(), &self.address, "bert");
        operators.scenario("long", "60s");
        operators.scenario("short", "400ms");
        operators
    }

    /// Returns the list that the authority made last.
    fn made(&self) -> Vec<u8> {
        let list = if self.is_tls() { "keys/revoked.pem" } else { "keys/revoked.serials" };
        std::fs::read(self.session.path(list)).unwrap()
    }

    /// Replaces the list of the robot.
    fn give(&self, list: impl AsRef<[u8]>) {
        self.session.file("next", list);
        std::fs::rename(self.session.path("next"), self.session.path("list")).unwrap();
    }

    /// Waits until the robot's log contains `words` this number of times.
    #[track_caller]
    fn logs(&self, words: &str, times: usize) {
        let begun = Instant::now();
        let logged = || std::fs::read_to_string(self.session.path("err")).unwrap();
        while logged().matches(words).count() < times {
            assert!(begun.elapsed() < ENDED_WITHIN, "{}", logged());
            std::thread::sleep(Duration::from_millis(20));
        }
        assert_eq!(logged().matches(words).count(), times, "{}", logged());
    }

    /// Revokes Anna's key, and gives the robot the new list. Anna keeps a copy of the passes.
    fn revoke_anna(&self) {
        let passes = self.session.path("keys/operators/anna.passes");
        let copy = std::fs::read(&passes);
        self.session.run(&["keys", "revoke", "--operator", "anna"]).says(0, &["revoked 1"]);
        if let Ok(copy) = copy {
            std::fs::write(&passes, copy).unwrap();
            std::fs::set_permissions(&passes, std::fs::Permissions::from_mode(0o600)).unwrap();
        }
        self.give(self.made());
    }
}

const REMAINS: &str = "remains in use";
const NOT_A_LIST: &str = "expected a list that `downbeat keys` wrote";

fn starter_cuts_off(scheme: &'static str) {
    let robot = Starter::new(scheme);
    let session = &robot.session;
    let first = robot.made();
    let operators = robot.operators();
    let playing = operators.playing("anna", "long.yaml");

    // Neither a part of a list, nor another file, nor its removal changes the list in use, and each is logged once.
    robot.give(&first[..first.len() - 3]);
    robot.logs(REMAINS, 1);
    robot.give("something else\n");
    robot.logs(NOT_A_LIST, 2);
    std::fs::remove_file(session.path("list")).unwrap();
    robot.logs(REMAINS, 3);
    operators.by("bert", &["fleet", "ping"]).says(0, &[robot.id()]);

    robot.revoke_anna();
    fails_with(playing, "forbidden: the operator's key was revoked");
    robot.logs(REMAINS, 3);
    operators.by("bert", &["run", "short.yaml"]).says(0, &["short: done"]);
    let refused = || operators.by("anna", &["run", "short.yaml", "--patience", "2s"]).says(1, &["revoked"]);
    refused();

    robot.give(first);
    robot.logs("is smaller than", 1);
    refused();
    operators.by("bert", &["run", "short.yaml"]).says(0, &["short: done"]);
}

#[test]
fn starter_robot_in_python_cuts_off_revoked_operator_and_keeps_the_last_good_list() {
    starter_cuts_off("tls");
}

#[test]
fn starter_robot_in_c_cuts_off_revoked_operator_and_keeps_the_last_good_list() {
    starter_cuts_off("hmac");
}

#[test]
fn starter_robot_in_python_does_not_use_list_of_another_authority() {
    let robot = Starter::new("tls");
    robot.session.run(&["keys", "init", "--keys", "others"]).says(0, &[]);
    let others = robot.session.path("others/revoked.pem");
    robot.give(std::fs::read(others).unwrap());
    robot.logs(NOT_A_LIST, 1);
    robot.operators().by("bert", &["run", "short.yaml"]).says(0, &["short: done"]);
}

/// Makes a key for the operator Eva that expires after 12 s, during a mission.
fn starter_ends_commands_of_expired_key(scheme: &'static str) {
    let robot = Starter::new(scheme);
    let operators = robot.operators();
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs().cast_signed();
    let authority = Authority::open(&robot.session.path("keys")).unwrap();
    let eva = [Name::Operator("eva".to_owned())].into();
    let roles = [Role::Observe, Role::Drive].into_iter().collect();
    authority.issue(&eva, &roles, now - 24 * 3600 + 12, 1).unwrap();
    drop(authority);
    let playing = operators.playing("eva", "long.yaml");
    fails_with(playing, "forbidden: the operator's key has expired");
    operators.by("bert", &["run", "short.yaml"]).says(0, &["short: done"]);
}

#[test]
fn starter_robot_in_python_ends_commands_when_the_key_of_their_operator_expires() {
    starter_ends_commands_of_expired_key("tls");
}

#[test]
fn starter_robot_in_c_ends_commands_when_the_key_of_their_operator_expires() {
    starter_ends_commands_of_expired_key("hmac");
}

/// The arm has no session, and its connection has broken: only the key remains.
#[test]
fn starter_robot_in_c_halts_where_it_is_when_a_key_without_session_is_revoked() {
    let robot = Starter::new("hmac");
    let address = robot.address.trim_start_matches("hmac://");
    let mut bert = Spoken::by(&robot.session, "bert", "arm-2", address);
    let mut position = || {
        let told = bert.says(r#"{"inquiry":{"devices":["shoulder"]}}"#);
        let told: serde_json::Value = serde_json::from_str(&told).unwrap();
        told["inquiry_response"]["devices"][0].clone()
    };
    let mut anna = Spoken::by(&robot.session, "anna", "arm-2", address);
    let moves = anna.says(
        r#"{"control_request":{"device_id":"shoulder","request_id":"a","control_type":"script","control_value":[{"time_offset_to_start":90000,"control_type":"position","control_value":90}]}}"#,
    );
    assert!(moves.contains("Accepted"), "{moves}");
    drop(anna);
    robot.revoke_anna();
    let begun = Instant::now();
    while position()["room"] != 2 {
        assert!(begun.elapsed() < ENDED_WITHIN, "the command continues");
        std::thread::sleep(Duration::from_millis(20));
    }
    let halted = position();
    assert!(halted["position"].as_f64().is_some_and(|at| at > 0.0 && at < 60.0), "{halted}");
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(position(), halted);
}

#[test]
fn starter_robots_do_not_start_with_an_unusable_list() {
    let session = Session::new();
    session.run(&["keys", "init"]).says(0, &[]);
    session.run(&["keys", "robot", "arm-1"]).says(0, &[]);
    session.run(&["keys", "secret", "arm-2"]).says(0, &[]);
    session.file("bad", "something else\n");
    let python = std::env::var("DOWNBEAT_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let in_python = root().join("robot/starters/python/robot.py").to_str().unwrap().to_owned();
    let in_c = built(&session, "robot").to_str().unwrap().to_owned();
    for start in [
        vec![python.as_str(), &in_python, "--identity", "keys/robots/arm-1.pem", "--revoked"],
        vec![in_c.as_str(), "--secret", "keys/secrets/arm-2.secret", "--revoked"],
    ] {
        for (list, words) in [("bad", NOT_A_LIST), ("missing", "No such file")] {
            let mut robot = Command::new(start[0]);
            robot.args(&start[1..]).arg(list).env("PYTHONDONTWRITEBYTECODE", "1");
            let ended = Ran(robot.current_dir(session.path("")).output().unwrap());
            ended.says(1, &[list, words]);
        }
    }
}
