//! Nobody moves a robot without permission: robots as processes that hear only operators of their authority, and every attempt of
//! others, which moves nothing.

use std::process::{Child, Command, Stdio};

use rustix::process::Signal;

use crate::robots::{Process, free_port};
use crate::session::{ARM, PROGRAM, Ran, Session, root};

const SCENARIO: &str = "scenario: test
cues: [{at: 0s, robots: all, tracks: {shoulder: [{at: 0s, to: 45}, {at: 300ms, to: 10}]}}]
";

/// Three robots with keys, and operators.
struct Site {
    session: Session,
    ports: Vec<u16>,
    robots: Vec<Process>,
}

impl Site {
    fn new() -> Self {
        let session = Session::new();
        session.file("arm.yaml", ARM).file("test.yaml", SCENARIO);
        session.run(&["keys", "init"]).says(0, &["keys/authority.key"]);
        session.run(&["keys", "robot", "r0", "r1", "r2"]).says(0, &["robots/r2.pem", "365 days"]);
        for (name, roles) in
            [("anna", "observe,drive"), ("bert", "observe"), ("cleo", "observe,drive"), ("dora", "stop")]
        {
            session.run(&["keys", "operator", name, "--role", roles]).says(0, &[name]);
        }
        let mut site = Self { session, ports: Vec::new(), robots: Vec::new() };
        for id in 0..3 {
            site.start(id);
        }
        site.fleet(&site.addresses("tls"), "anna");
        site
    }

    fn start(&mut self, id: usize) {
        let port = free_port();
        let mut command = Command::new(PROGRAM);
        let listen = format!("127.0.0.1:{port}");
        command.args(["robot", "--init", "arm.yaml", "--id", &format!("r{id}"), "--listen", &listen]);
        command.args(["--identity", &format!("keys/robots/r{id}.pem"), "--revoked", "keys/revoked.pem"]);
        command.args(["--log-file", &format!("r{id}.jsonl")]).current_dir(self.session.path(""));
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        listens(&mut child);
        self.ports.push(port);
        self.robots.push(Process(child));
    }

    fn addresses(&self, scheme: &str) -> Vec<String> {
        self.ports.iter().map(|port| format!("{scheme}://127.0.0.1:{port}")).collect()
    }

    fn fleet(&self, addresses: &[String], operator: &str) {
        let robot = |(id, address)| format!("  r{id}: {{init: arm.yaml, address: '{address}'}}\n");
        let robots: String = addresses.iter().enumerate().map(robot).collect();
        let head = format!("identity: keys/operators/{operator}.pem\nrevoked: keys/revoked.pem\n");
        let fleet = format!("{head}robots:\n{robots}groups: {{all: [r0, r1, r2]}}\n");
        self.session.file("fleet.yaml", fleet);
    }

    fn run(&self) -> Ran {
        self.session.run(&["run", "test.yaml", "--patience", "3s"])
    }

    /// How often the robots have set anything.
    fn moved(&self) -> usize {
        let lines =
            |id| std::fs::read_to_string(self.session.path(&format!("r{id}.jsonl"))).unwrap().lines().count();
        (0..3).map(lines).sum()
    }

    /// Runs the mission, which has to be refused with these words while nothing moves.
    #[track_caller]
    fn refused(&self, words: &[&str]) {
        let before = self.moved();
        self.run().says(1, words);
        assert_eq!(self.moved(), before);
    }
}

/// Waits until a robot says where it listens.
pub fn listens(child: &mut Child) -> String {
    use std::io::{BufRead, BufReader};
    let mut line = String::new();
    BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
    assert!(line.contains("listens on") || line.contains("listening on"), "{line}");
    line
}

#[test]
fn a_mission_by_tls_is_played_and_every_attempt_of_others_is_refused() {
    let site = Site::new();
    site.run().says(0, &["test: done"]);
    let moved = site.moved();
    assert!(moved > 0);
    site.session.run(&["fleet", "ping"]).says(0, &["r2"]);

    // Without the role.
    site.fleet(&site.addresses("tls"), "bert");
    site.refused(&["operator bert may observe, and this takes drive"]);
    site.session.run(&["fleet", "ping"]).says(0, &["r2"]);
    site.fleet(&site.addresses("tls"), "dora");
    site.refused(&["operator dora may stop, and this takes drive"]);

    // Another robot than the one that is meant.
    let mut swapped = site.addresses("tls");
    swapped.swap(0, 1);
    site.fleet(&swapped, "anna");
    site.refused(&["its certificate is that of robot r1, expected robot r0"]);

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
    other(&["run", "test.yaml", "--patience", "3s"]).says(1, &["another authority"]);

    // Without a name.
    let fleet = std::fs::read_to_string(site.session.path("fleet.yaml")).unwrap();
    let (_, nameless) = fleet.split_once("revoked: keys/revoked.pem\n").unwrap();
    site.session.file("fleet.yaml", nameless);
    site.refused(&["name your identity file"]);

    // Revoked, while the robots run on; others still may.
    site.session.run(&["keys", "revoke", "--operator", "cleo"]).says(0, &["copy"]);
    site.fleet(&site.addresses("tls"), "cleo");
    site.refused(&["revoked"]);
    assert_eq!(site.moved(), moved);
    site.fleet(&site.addresses("tls"), "anna");
    site.run().says(0, &["test: done"]);
    assert_eq!(site.moved(), 2 * moved);
}

#[test]
fn a_robot_that_listens_for_more_than_this_machine_needs_a_key_or_a_word() {
    let session = Session::new();
    let listen = format!("0.0.0.0:{}", free_port());
    let args = ["robot", "--init", "arm.yaml", "--listen", &listen];
    session.run(&args).says(2, &["anyone who reaches", "--identity", "--insecure"]);
    let mut insecure = session.command(&args).arg("--insecure").stdout(Stdio::piped()).spawn().unwrap();
    listens(&mut insecure);
    let mut insecure = Process(insecure);
    insecure.signal(Signal::TERM);
    assert!(insecure.0.wait().unwrap().success());
    session.run(&["keys", "init"]).says(0, &[]);
    session.run(&["keys", "robot", "other"]).says(0, &[]);
    let mut command = session.command(&args);
    let ran = Ran(command.args(["--identity", "keys/robots/other.pem"]).output().unwrap());
    ran.says(2, &["this is the identity of robot other, expected robot arm"]);
}

#[test]
fn a_fleet_with_open_robots_elsewhere_says_so_or_is_refused() {
    let session = Session::new();
    let fleet = "robots:\n  left: {init: arm.yaml, address: 'tcp://192.0.2.1:7401'}\n";
    let scenario = "scenario: s\ncues: [{at: 0s, robots: left, tracks: {shoulder: [{at: 0s, to: 45}]}}]\n";
    session.file("fleet.yaml", fleet).file("s.yaml", scenario);
    session.run(&["check", "s.yaml"]).says(1, &["DB0058", "fleet.yaml:2:", "insecure: true"]);
    session.file("fleet.yaml", format!("insecure: true\n{fleet}"));
    session.run(&["check", "s.yaml"]).says(0, &[]);
    session.file("fleet.yaml", fleet.replace("tcp:", "tls:"));
    session.run(&["check", "s.yaml"]).says(0, &[]);
}

#[test]
fn simulated_robots_of_a_fleet_have_their_keys_too() {
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
fn who_may_stop_stops_the_missions_of_others_and_is_named_in_their_reports() {
    let site = Site::new();
    let long = SCENARIO.replace("{at: 300ms, to: 10}", "{at: 60s, to: 10}");
    site.session.file("long.yaml", long);
    let mut playing = site.session.command(&["run", "long.yaml", "--format", "json"]);
    let playing = playing.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let begun = std::time::Instant::now();
    while site.moved() < 3 {
        assert!(begun.elapsed().as_secs() < 30, "nothing moves");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    // Another terminal, which knows of no mission.
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
    stop("dora").says(
        0,
        &["r0: default state confirmed", "r1: default state confirmed", "r2: default state confirmed"],
    );
    let ended = Ran(playing.wait_with_output().unwrap());
    assert_eq!(ended.code(), 1, "{}", ended.text());
    assert!(ended.text().contains("stopped by operator dora"), "{}", ended.text());
}

#[test]
fn certificates_that_end_soon_are_told_of_weeks_ahead() {
    let session = Session::new();
    let port = free_port();
    let fleet = format!(
        "identity: keys/operators/anna.pem\nrobots: {{arm: {{init: arm.yaml, address: 'tls://127.0.0.1:{port}'}}}}\n"
    );
    session.file("fleet.yaml", fleet).file(
        "s.yaml",
        "scenario: s\ncues: [{at: 0s, robots: arm, tracks: {shoulder: [{at: 1s, to: 45}]}}]\n",
    );
    session.run(&["keys", "init"]).says(0, &[]);
    session.run(&["keys", "robot", "arm", "--days", "12"]).says(0, &[]);
    session.run(&["keys", "operator", "anna", "--role", "drive", "--days", "9"]).says(0, &[]);
    let mut sim = session.command(&["sim", "--keys", "keys"]).stdout(Stdio::piped()).spawn().unwrap();
    listens(&mut sim);
    let _sim = Process(sim);
    session.run(&["preflight", "s.yaml"]).says(
        0,
        &[
            "certificate counts for 11 days more: `downbeat keys renew arm`",
            "operator anna counts for 8 more days",
        ],
    );
    session.run(&["keys", "list"]).says(0, &["counts for 11 days", "counts for 8 days"]);
}

#[test]
fn the_robot_to_copy_in_python_hears_its_operators_and_no_others() {
    let session = Session::new();
    session.run(&["keys", "init"]).says(0, &[]);
    session.run(&["keys", "robot", "arm-1"]).says(0, &[]);
    for (name, roles) in [("anna", "observe,drive"), ("bert", "observe"), ("dora", "stop")] {
        session.run(&["keys", "operator", name, "--role", roles]).says(0, &[]);
    }
    let python = std::env::var("DOWNBEAT_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let robot = root().join("robot/starters/python/robot.py");
    let mut command = Command::new(python);
    command.arg(robot).args(["--identity", "keys/robots/arm-1.pem", "--revoked", "keys/revoked.pem"]);
    command.env("PYTHONDONTWRITEBYTECODE", "1").current_dir(session.path("")).stdout(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let said = listens(&mut child);
    let _robot = Process(child);
    let address = format!("tls://{}", said.rsplit(' ').next().unwrap().trim());
    let by = |operator: &str, args: &[&str]| {
        let mut command = session.command(args);
        Ran(command.env("DOWNBEAT_IDENTITY", format!("keys/operators/{operator}.pem")).output().unwrap())
    };
    session.file("arm-1.yaml", by("anna", &["fleet", "describe", &address]).out());
    session.file("fleet.yaml", format!("robots: {{arm-1: {{init: arm-1.yaml, address: '{address}'}}}}\n"));
    let scenario = |last: &str| {
        let track = format!("shoulder: [{{at: 100ms, to: 45}}, {{at: {last}, to: 0}}]");
        format!(
            "scenario: test\nstart_tolerance: 1s\ncues: [{{at: 0s, robots: arm-1, tracks: {{{track}}}}}]\n"
        )
    };
    session.file("short.yaml", scenario("400ms")).file("long.yaml", scenario("60s"));
    by("anna", &["run", "short.yaml"]).says(0, &["test: done"]);
    by("bert", &["run", "short.yaml"]).says(1, &["operator bert may observe, and this takes drive"]);
    by("bert", &["fleet", "ping"]).says(0, &["arm-1"]);
    session.run(&["run", "short.yaml"]).says(1, &["name your identity file"]);
    let mut playing = session.command(&["run", "long.yaml"]);
    playing.env("DOWNBEAT_IDENTITY", "keys/operators/anna.pem").stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut playing = playing.spawn().unwrap();
    std::io::BufRead::lines(std::io::BufReader::new(playing.stderr.as_mut().unwrap()))
        .map_while(Result::ok)
        .find(|line| line.contains("all have accepted"))
        .unwrap();
    by("dora", &["stop", "--fleet", "fleet.yaml", "--patience", "5s"])
        .says(0, &["arm-1: default state confirmed"]);
    let mut report = String::new();
    std::io::Read::read_to_string(playing.stdout.as_mut().unwrap(), &mut report).unwrap();
    assert!(report.contains("stopped by operator dora"), "{report}");
    assert!(!playing.wait().unwrap().success());
}
