//! Robots that share a secret with their authority: Downbeat's own, and the example robot in C that users copy. Each is a process. Nobody
//! else's attempt moves anything.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::{Command, Stdio};
use std::time::Duration;

use downbeat_robot::sealed::{
    Claim, Hello, Keys, NotSealed, Opening, Pass, Passes, Refused, Sealing, Secret, proof_of_operator,
};
use serde_json::Value;

use stage::meddler::Wire;
use stage::operators::{Operators, fails_with};
use stage::session::{Ran, Session, root};
use stage::site::{LONG_SCRIPT, Site, built, listens, on_the_way, starter};
use stage::{Process, free_port};

#[test]
fn hmac_mission_plays_and_all_unauthorized_attempts_are_refused() {
    let site = Site::with("hmac");
    let fleet = |operator: &str| site.fleet(&site.addresses("hmac"), operator);
    site.run().says(0, &["test: done"]);
    let moved = site.moved();
    assert!(moved > 0);
    site.session.run(&["fleet", "ping"]).says(0, &["r2"]);
    conforms(&site, "repeated-connection");
    let passes = |operator: &str| site.session.path(&format!("keys/operators/{operator}.passes"));

    // Without the role.
    fleet("bert");
    site.refused(&["operator bert has the role observe, but this requires the role drive"]);
    site.session.run(&["fleet", "ping"]).says(0, &["r2"]);
    fleet("dora");
    site.refused(&["operator dora has the role stop, but this requires the role drive"]);

    // With roles that the pass does not prove.
    let own = std::fs::read_to_string(passes("bert")).unwrap();
    std::fs::write(passes("bert"), own.replace(" observe ", " observe,drive ")).unwrap();
    fleet("bert");
    site.refused(&[
        "the robot does not have the secret that matches your pass: copy the robot's secret file to it",
    ]);
    std::fs::write(passes("bert"), own).unwrap();

    // Another robot than the intended one.
    let mut swapped = site.addresses("hmac");
    swapped.swap(0, 1);
    site.fleet(&swapped, "anna");
    site.refused(&["it is robot r1, but your pass is for a different robot"]);

    // By other protocols than the robot's.
    site.fleet(&site.addresses("tcp"), "anna");
    site.refused(&["r0"]);
    site.fleet(&site.addresses("tls"), "anna");
    site.refused(&["r0"]);

    // Of another authority.
    site.session.run(&["keys", "init", "--keys", "others"]).says(0, &["others"]);
    site.session.run(&["keys", "operator", "anna", "--role", "drive", "--keys", "others"]).says(0, &["anna"]);
    site.session.run(&["keys", "secret", "r0", "r1", "r2", "--keys", "others"]).says(0, &["r2"]);
    fleet("anna");
    let other = |args: &[&str]| {
        let mut command = site.session.command(args);
        Ran(command.env("DOWNBEAT_IDENTITY", "others/operators/anna.pem").output().unwrap())
    };
    site.list("others/revoked.pem");
    other(&["run", "test.yaml", "--patience", "3s"])
        .says(1, &["the robot does not have the secret that matches your pass"]);
    // Without a pass for one of them.
    site.session.run(&["keys", "revoke", "r1", "--keys", "others"]).says(0, &["revoked 1"]);
    other(&["run", "test.yaml", "--patience", "3s"]).says(1, &["you have no pass for robot r1"]);
    site.list("keys/revoked.pem");

    // Without a name.
    let text = std::fs::read_to_string(site.session.path("fleet.yaml")).unwrap();
    let (_, nameless) = text.split_once("revoked: keys/revoked.pem\n").unwrap();
    site.session.file("fleet.yaml", nameless);
    site.refused(&["the robot requires your identity: set `identity` in the fleet file"]);

    // Revoked while the robots continue to run; other operators are still permitted. Its passes are deleted, so a copy of them is used.
    let copy = std::fs::read(passes("cleo")).unwrap();
    site.session.run(&["keys", "revoke", "--operator", "cleo"]).says(0, &["keys/revoked.serials"]);
    fleet("cleo");
    site.refused(&["you have no pass"]);
    site.session.file("keys/operators/cleo.passes", copy);
    let private = std::os::unix::fs::PermissionsExt::from_mode(0o600);
    std::fs::set_permissions(passes("cleo"), private).unwrap();
    site.refused(&["your pass has been revoked"]);

    assert_eq!(site.moved(), moved);
    assert!(site.logged(0).contains("a peer was disconnected because it did not prove its identity"));
    fleet("anna");
    site.run().says(0, &["test: done"]);
    assert_eq!(site.moved(), 2 * moved);
}

/// Runs the conformance test on the first robot, for the requirements about proofs and sessions and for `requirement`. All have to pass.
fn conforms(site: &Site, requirement: &str) {
    let only = format!("no-plain,proven-in-time,altered,repeated,reordered,roles,session,{requirement}");
    let address = &site.addresses("hmac")[0];
    let mut command = site.session.command(&[
        "conformance",
        address,
        "--observer",
        "keys/operators/bert.pem",
        "--only",
        &only,
    ]);
    let ran = Ran(command.env("DOWNBEAT_IDENTITY", "keys/operators/anna.pem").output().unwrap());
    ran.says(0, &["8 passed, 0 failed"]);
}

#[test]
fn altered_repeated_or_reordered_data_ends_connection_and_moves_nothing() {
    let site = Site::with("hmac");
    site.session.file("test.yaml", LONG_SCRIPT);
    on_the_way(&site, Wire::Hmac, 1);
}

#[test]
fn robot_without_a_secret_is_not_accepted_as_an_hmac_robot() {
    let session = Session::new();
    session.run(&["keys", "init"]).says(0, &[]);
    session.run(&["keys", "operator", "anna", "--role", "drive"]).says(0, &[]);
    session.run(&["keys", "secret", "arm"]).says(0, &[]);
    let listen = format!("127.0.0.1:{}", free_port());
    let mut open = session.command(&["robot", "--init", "arm.yaml", "--listen", &listen]);
    let mut open = open.stdout(Stdio::piped()).spawn().unwrap();
    listens(&mut open);
    let _open = Process(open);
    let mut describe = session.command(&["fleet", "describe", &format!("hmac://{listen}")]);
    let described = describe.env("DOWNBEAT_IDENTITY", "keys/operators/anna.pem").output().unwrap();
    Ran(described).says(1, &["the program at this address does not use hmac"]);
    // A secret that other users can read is refused, and a list has no effect without one.
    let secret = session.path("keys/secrets/arm.secret");
    let all = std::os::unix::fs::PermissionsExt::from_mode(0o644);
    std::fs::set_permissions(&secret, all).unwrap();
    let robot =
        ["robot", "--init", "arm.yaml", "--listen", "127.0.0.1:0", "--secret", "keys/secrets/arm.secret"];
    session.run(&robot).says(2, &["other users can read this key (mode 644)"]);
    session.run(&["robot", "--init", "arm.yaml", "--revoked", "keys/revoked.serials"]).says(2, &["--secret"]);
}

#[test]
fn simulated_robots_have_secrets_and_expiring_passes_are_reported() {
    let session = Session::new();
    let port = free_port();
    session.file(
        "fleet.yaml",
        format!("identity: keys/operators/anna.pem\nrobots: {{arm: {{init: arm.yaml, address: 'hmac://127.0.0.1:{port}'}}}}\n"),
    );
    session.run(&["keys", "init"]).says(0, &[]);
    session.run(&["sim", "--keys", "keys"]).says(2, &["secrets/arm.secret"]);
    session.run(&["keys", "secret", "arm"]).says(0, &[]);
    session.run(&["keys", "operator", "anna", "--role", "observe", "--days", "9"]).says(0, &[]);
    let mut sim = session.command(&["sim", "--keys", "keys"]).stdout(Stdio::piped()).spawn().unwrap();
    listens(&mut sim);
    let _sim = Process(sim);
    session.run(&["fleet", "ping"]).says(0, &["arm", "the certificate of operator anna expires in"]);
    // Only the identity was renewed on this machine.
    let passes = std::fs::read(session.path("keys/operators/anna.passes")).unwrap();
    session.run(&["keys", "renew", "--operator", "anna"]).says(0, &["365 days"]);
    session.run(&["fleet", "ping"]).says(0, &["arm"]);
    std::fs::write(session.path("keys/operators/anna.passes"), passes).unwrap();
    session.run(&["fleet", "ping"]).says(0, &["the pass for robot arm expires in"]);
    session.run(&["keys", "list"]).says(0, &["has a secret"]);
}

#[test]
fn starter_robot_in_c_obeys_only_its_authorized_operators() {
    let session = Session::new();
    session.run(&["keys", "init"]).says(0, &[]);
    for (name, roles) in [("anna", "observe,drive"), ("bert", "observe"), ("dora", "stop")] {
        session.run(&["keys", "operator", name, "--role", roles]).says(0, &[name]);
    }
    session.run(&["keys", "secret", "arm-2", "other"]).says(0, &[]);
    let (_robot, address) = starter(&session, "hmac", "keys/revoked.serials");
    // The robot itself reports its id.
    let operators = Operators::of(&session, "arm-2", &address, "anna");
    let by = |operator: &str, args: &[&str]| operators.by(operator, args);
    operators.scenario("short", "400ms");
    operators.scenario("long", "60s");
    by("anna", &["run", "short.yaml"]).says(0, &["short: done"]);
    by("bert", &["run", "short.yaml"])
        .says(1, &["operator bert has the role observe, but this requires the role drive"]);
    by("dora", &["run", "short.yaml"])
        .says(1, &["operator dora has the role stop, but this requires the role drive"]);
    by("bert", &["fleet", "ping"]).says(0, &["arm-2"]);
    session
        .run(&["run", "short.yaml"])
        .says(1, &["the robot requires your identity: set `identity` in the fleet file"]);
    operators.fleet(&address.replace("hmac", "tcp"));
    by("anna", &["run", "short.yaml", "--patience", "2s"]).says(1, &["arm-2"]);
    operators.fleet(&address);

    let conformance = ["conformance", &address, "--observer", "keys/operators/bert.pem", "--only"];
    let requirements = "no-plain,altered,repeated,reordered,wrong-secret,expired-claim,other-robot,forged-roles,repeated-connection,roles";
    by("anna", &[&conformance[..], &[requirements]].concat()).says(0, &["10 passed, 0 failed"]);

    // An operator with the role stops the mission of another, and is named.
    let playing = operators.playing("anna", "long.yaml");
    by("bert", &["stop", "--fleet", "fleet.yaml", "--patience", "1s"]).says(4, &["arm-2"]);
    by("dora", &["stop", "--fleet", "fleet.yaml", "--patience", "5s"]).says(0, &["arm-2: stop confirmed"]);
    fails_with(playing, "stopped by operator dora");

    // The authority has made another secret, which the robot does not have.
    let passes = std::fs::read(session.path("keys/operators/anna.passes")).unwrap();
    session.run(&["keys", "secret", "--renew", "arm-2"]).says(0, &[]);
    by("anna", &["run", "short.yaml"])
        .says(1, &["the robot does not have the secret that matches your pass"]);

    // Revoked while the robot continues to run.
    session.run(&["keys", "revoke", "--operator", "anna"]).says(0, &[]);
    session.file("keys/operators/anna.passes", &passes);
    let private = std::os::unix::fs::PermissionsExt::from_mode(0o600);
    std::fs::set_permissions(session.path("keys/operators/anna.passes"), private).unwrap();
    by("anna", &["run", "short.yaml"]).says(1, &["your pass has been revoked"]);
    let logged = std::fs::read_to_string(session.path("err")).unwrap();
    assert!(logged.contains("a peer was disconnected because it did not prove its identity"), "{logged}");
}

/// The authenticated connection of an operator to a robot.
pub struct Spoken {
    socket: TcpStream,
    sealing: Sealing,
    opening: Opening,
    heard: Vec<u8>,
}

impl Spoken {
    pub fn by(session: &Session, operator: &str, robot: &str, address: &str) -> Self {
        let identity = session.path(&format!("keys/operators/{operator}.pem"));
        let passes = Passes::read(&Passes::next_to(&identity)).unwrap();
        let held = passes.of(&robot.parse().unwrap()).unwrap();
        let hello = Hello { nonce: [9; 16], robot: held.robot.clone(), claim: held.claim.clone() };
        let mut socket = TcpStream::connect(address).unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        socket.write_all(hello.line().as_bytes()).unwrap();
        let (mut answer, mut byte) = (String::new(), [0]);
        while !answer.ends_with('\n') {
            socket.read_exact(&mut byte).unwrap();
            answer.push(char::from(byte[0]));
        }
        hello.check_answer(&held.pass, &answer).unwrap();
        socket.write_all(proof_of_operator(&held.pass, &hello.line(), &answer).as_bytes()).unwrap();
        let (sealing, opening) = Keys::of(&held.pass, &hello.line(), &answer).of_operator();
        Self { socket, sealing, opening, heard: Vec::new() }
    }

    /// Sends a line, and returns the next line from the robot.
    pub fn says(&mut self, line: &str) -> String {
        let mut records = Vec::new();
        self.sealing.seal(format!("{line}\n").as_bytes(), &mut records);
        self.socket.write_all(&records).unwrap();
        let mut raw = [0; 4096];
        loop {
            if let Some(end) = self.heard.iter().position(|byte| *byte == b'\n') {
                let rest = self.heard.split_off(end + 1);
                return String::from_utf8(std::mem::replace(&mut self.heard, rest)).unwrap();
            }
            let n = self.socket.read(&mut raw).unwrap();
            assert!(n > 0, "hung up");
            self.opening.push(&raw[..n]);
            while self.opening.open(&mut self.heard).unwrap() {}
        }
    }
}

#[test]
fn session_read_in_transit_cannot_be_used_by_another_operator() {
    let session = Session::new();
    session.run(&["keys", "init"]).says(0, &[]);
    for operator in ["anna", "cleo"] {
        session.run(&["keys", "operator", operator, "--role", "drive"]).says(0, &[]);
    }
    session.run(&["keys", "secret", "arm", "arm-2"]).says(0, &[]);
    let mut ours = session.command(&["robot", "--init", "arm.yaml", "--listen", "127.0.0.1:0"]);
    ours.args(["--secret", "keys/secrets/arm.secret"]);
    let mut copied = Command::new(built(&session, "robot"));
    copied.args(["--listen", "127.0.0.1:0", "--secret", "keys/secrets/arm-2.secret"]);
    copied.current_dir(session.path(""));
    for (id, mut robot) in [("arm", ours), ("arm-2", copied)] {
        let mut robot = robot.stdout(Stdio::piped()).spawn().unwrap();
        let address = listens(&mut robot).rsplit(' ').next().unwrap().trim().to_owned();
        let _robot = Process(robot);
        let of = |request: &str| {
            format!(
                r#"{{"control_request":{{"device_id":"shoulder","session":"s@1","stop_condition":{{"pending":9000,"running":9000}},{request}}}}}"#
            )
        };
        let long = of(
            r#""request_id":"a","control_type":"script","control_value":[{"time_offset_to_start":60000,"control_type":"position","control_value":10}]"#,
        );
        let mut anna = Spoken::by(&session, "anna", id, &address);
        let accepted = anna.says(&long);
        assert!(accepted.contains("Accepted"), "{accepted}");
        let mut cleo = Spoken::by(&session, "cleo", id, &address);
        for request in [
            r#""request_id":"b","control_type":"script","control_value":[]"#,
            r#""request_id":"c","control_type":"position","control_value":10"#,
        ] {
            let refused = cleo.says(&of(request));
            assert!(refused.contains("busy"), "{id}: {refused}");
        }
        let asked = cleo.says(r#"{"inquiry":{"session":"s@1","requests":["a"]}}"#);
        assert!(asked.contains("busy"), "{id}: {asked}");
    }
}

fn vectors() -> Value {
    let text = std::fs::read_to_string(root().join("tests/vectors/hmac.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

fn text<'a>(object: &'a Value, key: &str) -> &'a str {
    object[key].as_str().unwrap()
}

fn bytes(object: &Value, key: &str) -> Vec<u8> {
    let digits = text(object, key);
    (0..digits.len()).step_by(2).map(|at| u8::from_str_radix(&digits[at..at + 2], 16).unwrap()).collect()
}

#[test]
fn hmac_connection_matches_the_test_vector_byte_for_byte() {
    let vectors = vectors();
    let claim: Claim = text(&vectors, "claim").parse().unwrap();
    let (hello, answer) = (text(&vectors, "hello"), text(&vectors, "answer"));
    let known = Pass::of_bytes(bytes(&vectors, "pass").try_into().unwrap());
    let made = Secret::of_bytes(bytes(&vectors, "secret").try_into().unwrap()).pass(&claim);
    let nonce = bytes(&vectors, "operators_number").try_into().unwrap();
    let read = Hello { nonce, robot: text(&vectors, "robot").parse().unwrap(), claim };
    assert_eq!(read.line(), hello);
    assert_eq!(Hello::read(hello), Ok(read.clone()));
    let robots = bytes(&vectors, "robots_number").try_into().unwrap();
    for pass in [known, made] {
        assert_eq!(read.answer(&pass, &robots), answer);
        read.check_answer(&pass, answer).unwrap();
        assert_eq!(proof_of_operator(&pass, hello, answer), text(&vectors, "proof"));
        let keys = Keys::of(&pass, hello, answer);
        for (way, (mut sealing, _), (_, mut opening)) in [
            ("to_robot", keys.of_operator(), keys.of_robot()),
            ("to_operator", keys.of_robot(), keys.of_operator()),
        ] {
            for record in vectors[way].as_array().unwrap() {
                let (mut sealed, mut opened) = (Vec::new(), Vec::new());
                sealing.seal(&bytes(record, "bytes"), &mut sealed);
                assert_eq!(sealed, bytes(record, "record"));
                opening.push(&sealed);
                assert_eq!(opening.open(&mut opened), Ok(true));
                assert_eq!(opened, bytes(record, "bytes"));
            }
        }
    }
    let refused = vectors["refused"].as_array().unwrap();
    let of = |hello: &str| match Hello::read(hello) {
        Err(NotSealed::Refused(refused)) => refused.line(),
        Err(_) => String::new(),
        Ok(hello) if hello.robot != read.robot => Refused::OtherRobot(read.robot.clone()).line(),
        Ok(hello) if hello.claim.expires < 2_000_000_000 => Refused::Expired.line(),
        Ok(_) => Refused::Revoked.line(),
    };
    assert!(refused.iter().all(|case| of(text(case, "hello")) == text(case, "answer")), "{refused:#?}");
}

#[test]
fn starter_robot_in_c_matches_the_hmac_test_vector() {
    let session = Session::new();
    let test = built(&session, "test");
    let vectors = root().join("tests/vectors/hmac.json");
    let ran = Ran(Command::new(test).arg(vectors).current_dir(session.path("")).output().unwrap());
    ran.says(0, &["all is as published"]);
}
