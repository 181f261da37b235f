//! Robots as processes that accept only operators of their authority. Permitted operators move them, and no attempt of others moves
//! anything.

use std::process::Stdio;

use rustix::process::Signal;

use stage::meddler::Wire;
use stage::operators::{Operators, fails_with};
use stage::session::{Ran, Session};
use stage::site::{LONG_SCRIPT, SCENARIO, Site, listens, on_the_way, python_robot};
use stage::{Process, free_port};

/// The conformance requirements for robots that require a proof of identity.
const REQUIREMENTS: &str = "no-plain,proven-in-time,altered,repeated,reordered,no-certificate,roles";

#[test]
fn tls_mission_plays_and_all_unauthorized_attempts_are_refused() {
    let site = Site::new();
    site.run().says(0, &["test: done"]);
    let moved = site.moved();
    assert!(moved > 0);
    site.session.run(&["fleet", "ping"]).says(0, &["r2"]);
    let address = &site.addresses("tls")[0];
    let conformance =
        ["conformance", address, "--observer", "keys/operators/bert.pem", "--only", REQUIREMENTS];
    let mut command = site.session.command(&conformance);
    let ran = Ran(command.env("DOWNBEAT_IDENTITY", "keys/operators/anna.pem").output().unwrap());
    ran.says(0, &["7 passed, 0 failed"]);

    // Without the role.
    site.fleet(&site.addresses("tls"), "bert");
    site.refused(&["operator bert has the role observe, but this requires the role drive"]);
    site.session.run(&["fleet", "ping"]).says(0, &["r2"]);
    site.fleet(&site.addresses("tls"), "dora");
    site.refused(&["operator dora has the role stop, but this requires the role drive"]);

    // Another robot than the intended one.
    let mut swapped = site.addresses("tls");
    swapped.swap(0, 1);
    site.fleet(&swapped, "anna");
    site.refused(&["its certificate belongs to robot r1, expected robot r0"]);

    // Without TLS, to a robot that has it.
    site.fleet(&site.addresses("tcp"), "anna");
    site.refused(&["r0"]);

    // Of another authority.
    site.session.run(&["keys", "init", "--keys", "others"]).says(0, &["others"]);
    site.session.run(&["keys", "operator", "anna", "--role", "drive", "--keys", "others"]).says(0, &["anna"]);
    site.fleet(&site.addresses("tls"), "anna");
    let other = |args: &[&str]| {
        Ran(site
            .session
            .command(args)
            .env("DOWNBEAT_IDENTITY", "others/operators/anna.pem")
            .output()
            .unwrap())
    };
    other(&["run", "test.yaml"]).says(2, &["keys/revoked.pem", "signed by another authority"]);
    site.list("others/revoked.pem");
    other(&["run", "test.yaml", "--patience", "3s"]).says(1, &["a different authority"]);
    site.list("keys/revoked.pem");

    // Without a name.
    let fleet = std::fs::read_to_string(site.session.path("fleet.yaml")).unwrap();
    let (_, nameless) = fleet.split_once("revoked: keys/revoked.pem\n").unwrap();
    site.session.file("fleet.yaml", nameless);
    site.refused(&["the robot requires your identity: set `identity` in the fleet file"]);

    // Revoked while the robots continue to run; other operators are still permitted.
    site.session.run(&["keys", "revoke", "--operator", "cleo"]).says(0, &["copy"]);
    site.fleet(&site.addresses("tls"), "cleo");
    site.refused(&["revoked"]);
    assert_eq!(site.moved(), moved);
    assert!(site.logged(0).contains("a peer was disconnected because it did not prove its identity"));
    site.fleet(&site.addresses("tls"), "anna");
    site.run().says(0, &["test: done"]);
    assert_eq!(site.moved(), 2 * moved);
}

#[test]
fn remotely_reachable_robot_requires_a_key_or_the_insecure_flag() {
    let session = Session::new();
    let listen = format!("0.0.0.0:{}", free_port());
    let args = ["robot", "--init", "arm.yaml", "--listen", &listen];
    session.run(&args).says(2, &["anyone who can reach", "--identity", "--insecure"]);
    let mut insecure = session.command(&args).arg("--insecure").stdout(Stdio::piped()).spawn().unwrap();
    listens(&mut insecure);
    let mut insecure = Process(insecure);
    insecure.signal(Signal::TERM);
    assert!(insecure.0.wait().unwrap().success());
    session.run(&["keys", "init"]).says(0, &[]);
    session.run(&["keys", "robot", "other"]).says(0, &[]);
    let mut command = session.command(&args);
    let ran = Ran(command.args(["--identity", "keys/robots/other.pem"]).output().unwrap());
    ran.says(2, &["this is the identity of robot other, expected that of robot arm"]);
}

#[test]
fn unprotected_remote_robots_require_the_insecure_setting() {
    let session = Session::new();
    let fleet = "robots:\n  left: {init: arm.yaml, address: 'tcp://192.0.2.1:7401'}\n";
    let scenario = "scenario: s\nstart_tolerance: 1s\ncues: [{at: 0s, robots: left, tracks: {shoulder: [{at: 0s, to: 45}]}}]\n";
    session.file("fleet.yaml", fleet).file("s.yaml", scenario);
    session.run(&["check", "s.yaml"]).says(1, &["DB0058", "fleet.yaml:2:", "insecure: true"]);
    session.file("fleet.yaml", format!("insecure: true\n{fleet}"));
    session.run(&["check", "s.yaml"]).says(0, &[]);
    for protected in ["tls:", "hmac:"] {
        session.file("fleet.yaml", fleet.replace("tcp:", protected));
        session.run(&["check", "s.yaml"]).says(0, &[]);
    }
}

#[test]
fn simulated_robots_of_a_fleet_have_keys() {
    let session = Session::new();
    let port = free_port();
    session.file(
        "fleet.yaml",
        format!("robots: {{arm: {{init: arm.yaml, address: 'tls://127.0.0.1:{port}'}}}}\n"),
    );
    session.run(&["sim"]).says(2, &["--keys"]);
    session.run(&["keys", "init"]).says(0, &[]);
    session.run(&["sim", "--keys", "keys"]).says(2, &["robots/arm.pem"]);
    session.run(&["keys", "robot", "arm"]).says(0, &[]);
    session.run(&["keys", "operator", "anna", "--role", "observe"]).says(0, &[]);
    let mut sim = session.command(&["sim", "--keys", "keys"]).stdout(Stdio::piped()).spawn().unwrap();
    listens(&mut sim);
    let _sim = Process(sim);
    let mut ping = session.command(&["fleet", "ping"]);
    Ran(ping.env("DOWNBEAT_IDENTITY", "keys/operators/anna.pem").output().unwrap()).says(0, &["arm"]);
}

#[test]
fn operator_with_stop_role_stops_missions_of_others_and_is_named() {
    let site = Site::new();
    let long = SCENARIO.replace("{at: 300ms, to: 10}, {at: 600ms, to: 45}", "{at: 60s, to: 10}");
    site.session.file("long.yaml", long);
    let mut playing = site.session.command(&["run", "long.yaml", "--format", "json"]);
    let playing = playing.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let begun = std::time::Instant::now();
    // Two lines of each robot.
    while site.moved() < 6 {
        assert!(begun.elapsed().as_secs() < 30, "nothing moves");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    // Another terminal, without a journal of the mission.
    let stop = |operator: &str| {
        let mut command = site.session.command(&["stop", "--fleet", "fleet.yaml", "--patience", "3s"]);
        let identity = format!("keys/operators/{operator}.pem");
        let command =
            command.env("DOWNBEAT_IDENTITY", identity).env("DOWNBEAT_STATE", site.session.path("elsewhere"));
        Ran(command.output().unwrap())
    };
    stop("cleo").says(4, &["r0: not stopped", "belongs to another session"]);
    let moved = site.moved();
    assert_eq!(stop("bert").code(), 4);
    assert_eq!(site.moved(), moved, "who may only observe stops nothing");
    stop("dora").says(0, &["r0: stop confirmed", "r1: stop confirmed", "r2: stop confirmed"]);
    let ended = Ran(playing.wait_with_output().unwrap());
    assert_eq!(ended.code(), 1, "{}", ended.text());
    assert!(ended.text().contains("stopped by operator dora"), "{}", ended.text());
}

#[test]
fn expiring_certificates_are_reported_weeks_in_advance() {
    let session = Session::new();
    let port = free_port();
    let fleet = format!(
        "identity: keys/operators/anna.pem\nrobots: {{arm: {{init: arm.yaml, address: 'tls://127.0.0.1:{port}'}}}}\n"
    );
    session.file("fleet.yaml", fleet).file(
        "s.yaml",
        "scenario: s\nstart_tolerance: 1s\ncues: [{at: 0s, robots: arm, tracks: {shoulder: [{at: 1s, to: 45}]}}]\n",
    );
    session.run(&["keys", "init"]).says(0, &[]);
    session.run(&["keys", "robot", "arm", "--days", "12"]).says(0, &[]);
    session.run(&["keys", "operator", "anna", "--role", "drive", "--days", "9"]).says(0, &[]);
    let mut sim = session.command(&["sim", "--keys", "keys"]).stdout(Stdio::piped()).spawn().unwrap();
    listens(&mut sim);
    let _sim = Process(sim);
    // Days count as whole ones, and times of certificates as whole seconds: in the same second, 9 days remain.
    std::thread::sleep(std::time::Duration::from_millis(1_100));
    session.run(&["preflight", "s.yaml"]).says(
        0,
        &[
            "its certificate expires in 11 days: make a new one with `downbeat keys renew arm`",
            "operator anna expires in 8 days",
        ],
    );
    session.run(&["keys", "list"]).says(0, &["valid for 11 days", "valid for 8 days"]);
}

#[test]
fn starter_robot_in_python_obeys_only_its_authorized_operators() {
    let session = Session::new();
    session.run(&["keys", "init"]).says(0, &[]);
    session.run(&["keys", "robot", "arm-1"]).says(0, &[]);
    for (name, roles) in [("anna", "observe,drive"), ("bert", "observe"), ("dora", "stop")] {
        session.run(&["keys", "operator", name, "--role", roles]).says(0, &[]);
    }
    let (_robot, address) = python_robot(&session);
    let operators = Operators::of(&session, "arm-1", &address, "anna");
    let by = |operator: &str, args: &[&str]| operators.by(operator, args);
    operators.scenario("short", "400ms");
    operators.scenario("long", "60s");
    by("anna", &["run", "short.yaml"]).says(0, &["short: done"]);
    by("bert", &["run", "short.yaml"])
        .says(1, &["operator bert has the role observe, but this requires the role drive"]);
    by("bert", &["fleet", "ping"]).says(0, &["arm-1"]);
    let conformance =
        ["conformance", &address, "--observer", "keys/operators/bert.pem", "--only", REQUIREMENTS];
    by("anna", &conformance).says(0, &["7 passed, 0 failed"]);
    session
        .run(&["run", "short.yaml"])
        .says(1, &["the robot requires your identity: set `identity` in the fleet file"]);
    let playing = operators.playing("anna", "long.yaml");
    by("dora", &["stop", "--fleet", "fleet.yaml", "--patience", "5s"]).says(0, &["arm-1: stop confirmed"]);
    fails_with(playing, "stopped by operator dora");
}

#[test]
fn altered_repeated_or_reordered_data_ends_connection_and_moves_nothing() {
    let site = Site::new();
    site.session.file("test.yaml", LONG_SCRIPT);
    // The first long record carries the operator's certificate, the second the script.
    on_the_way(&site, Wire::Tls, 2);
}

/// Starts a robot that requests no certificate by TLS, and answers the first line of each connection. Returns its address.
fn asks_nobody(identity: &std::path::Path) -> std::net::SocketAddr {
    use std::io::{BufRead, BufReader, Write};

    use rustls::pki_types::pem::PemObject;
    use rustls::pki_types::{CertificateDer, PrivateKeyDer};
    let certificate = CertificateDer::from_pem_file(identity).unwrap();
    let key = PrivateKeyDer::from_pem_file(identity).unwrap();
    let provider = std::sync::Arc::new(rustls::crypto::ring::default_provider());
    let config = rustls::ServerConfig::builder_with_provider(provider).with_safe_default_protocol_versions();
    let config = config.unwrap().with_no_client_auth().with_single_cert(vec![certificate], key).unwrap();
    let config = std::sync::Arc::new(config);
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    // Ends with the process.
    std::thread::spawn(move || {
        for socket in listener.incoming() {
            let server = rustls::ServerConnection::new(std::sync::Arc::clone(&config)).unwrap();
            let mut stream = BufReader::new(rustls::StreamOwned::new(server, socket.unwrap()));
            let answer = "{\"availability_response\":{\"receive_timestamp\":\"2026-11-20T19:00:00Z\",\"timestamp\":\"2026-11-20T19:00:00Z\",\"status\":\"OK\"}}\n";
            if stream.read_line(&mut String::new()).is_ok_and(|n| n > 0) {
                let _hung_up = stream.get_mut().write_all(answer.as_bytes());
            }
        }
    });
    address
}

#[test]
fn robot_that_requests_no_certificate_fails_the_conformance_test() {
    let session = Session::new();
    session.run(&["keys", "init"]).says(0, &[]);
    session.run(&["keys", "robot", "arm"]).says(0, &[]);
    session.run(&["keys", "operator", "anna", "--role", "drive"]).says(0, &[]);
    let address = format!("tls://{}", asks_nobody(&session.path("keys/robots/arm.pem")));
    let mut command =
        session.command(&["conformance", &address, "--only", "no-certificate", "--patience", "1s"]);
    let ran = Ran(command.env("DOWNBEAT_IDENTITY", "keys/operators/anna.pem").output().unwrap());
    ran.says(1, &["no answer, and the robot to close the connection", "0 passed, 1 failed"]);
}
