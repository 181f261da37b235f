//! Another authority replaces the one that issued all keys, while robots and operators continue to use either.

use std::io::{BufRead, BufReader};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use stage::Process;
use stage::operators::fails_with;
use stage::session::Ran;
use stage::site::Site;

const LONG: &str = "scenario: long
start_tolerance: 1s
cues: [{at: 0s, robots: all, tracks: {shoulder: [{at: 0s, to: 45}, {at: 60s, to: 10}]}}]
";
/// Time within which the robots must have ended the commands of a key of the old authority. They check their lists once per second.
const ENDED_WITHIN: Duration = Duration::from_secs(20);

/// Robots that each have their own copy of the list, as on their own machines.
struct Rotation {
    site: Site,
    robots: Vec<Option<Process>>,
    addresses: Vec<String>,
}

impl Rotation {
    fn new() -> Self {
        let site = Site::new();
        site.session.file("long.yaml", LONG);
        let mut own = Self { site, robots: Vec::new(), addresses: Vec::new() };
        for robot in 0..3 {
            let list = own.site.session.path("keys/revoked.pem");
            std::fs::copy(list, own.site.session.path(&format!("copy-{robot}"))).unwrap();
            own.robots.push(None);
            own.addresses.push(String::new());
            own.start(robot);
        }
        own.fleet(0..3);
        own
    }

    /// Starts a robot again, with its present key and its own list.
    fn start(&mut self, robot: usize) {
        self.robots[robot] = None;
        let (address, process) = self.site.another(robot, &format!("copy-{robot}"));
        self.addresses[robot] = address;
        self.robots[robot] = Some(process);
    }

    /// Writes a fleet file with these robots. Each operator names its own key.
    fn fleet(&self, robots: std::ops::Range<usize>) {
        let robot = |id: usize| format!("  r{id}: {{init: arm.yaml, address: '{}'}}\n", self.addresses[id]);
        let lines: String = robots.clone().map(robot).collect();
        let all: Vec<String> = robots.map(|id| format!("r{id}")).collect();
        let fleet =
            format!("revoked: keys/revoked.pem\nrobots:\n{lines}groups: {{all: [{}]}}\n", all.join(", "));
        self.site.session.file("fleet.yaml", fleet);
    }

    fn keys(&self, args: &[&str]) -> Ran {
        self.site.session.run(&[&["keys"], args].concat())
    }

    /// Runs a command with this identity file, with a state folder of its own as on another machine.
    fn by(&self, identity: &str, args: &[&str]) -> Ran {
        let mut command = self.site.session.command(args);
        command.env("DOWNBEAT_IDENTITY", identity).env("DOWNBEAT_STATE", self.site.session.path("elsewhere"));
        Ran(command.output().unwrap())
    }

    /// Starts the long mission with this identity file. Returns once the robots have accepted its scripts.
    fn playing(&self, identity: &str) -> Child {
        let mut command = self.site.session.command(&["run", "long.yaml"]);
        command.env("DOWNBEAT_IDENTITY", identity);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut said = BufReader::new(child.stderr.as_mut().unwrap()).lines().map_while(Result::ok);
        said.find(|line| line.contains("all robots have accepted")).unwrap();
        child
    }

    /// Stops a mission with the identity file of the operator Dora.
    #[track_caller]
    fn is_stopped(&self, playing: Child, dora: &str) {
        self.by(dora, &["stop", "--fleet", "fleet.yaml", "--patience", "5s"]).says(0, &["stop confirmed"]);
        fails_with(playing, "stopped by operator dora");
    }
}

const ANNA: &str = "keys/operators/anna.pem";
const CLEO: &str = "keys/operators/cleo.pem";
const DORA: &str = "keys/operators/dora.pem";

#[test]
fn authority_is_replaced_while_missions_play_and_stops_work() {
    let mut rotation = Rotation::new();
    let session_path = |name: &str| rotation.site.session.path(name);
    for (name, old) in [(CLEO, "old-cleo.pem"), (DORA, "old-dora.pem")] {
        std::fs::copy(session_path(name), session_path(old)).unwrap();
    }

    // The robots do not have the new list yet.
    let mut playing = rotation.playing(CLEO);
    rotation.keys(&["rotate"]).says(0, &["keys push FLEET", "keys renew --all"]);
    rotation.keys(&["rotate"]).says(1, &["already being replaced"]);
    rotation.is_stopped(playing, DORA);

    // Robots that play for another operator accept it.
    playing = rotation.playing(CLEO);
    let latest = ["r0: uses the latest list", "r1: uses the latest list", "r2: uses the latest list"];
    rotation.by(ANNA, &["keys", "push"]).says(0, &latest);
    assert!(playing.try_wait().unwrap().is_none(), "the mission continues");
    rotation.is_stopped(playing, DORA);

    // One robot and some operators have new keys.
    rotation.keys(&["renew", "r1"]).says(0, &["robots/r1.pem"]);
    for operator in ["anna", "dora"] {
        rotation.keys(&["renew", "--operator", operator]).says(0, &[operator]);
    }
    rotation.start(1);
    rotation.fleet(0..3);
    for identity in [ANNA, CLEO] {
        rotation.by(identity, &["fleet", "ping"]).says(0, &["r0", "r1", "r2"]);
        rotation.by(identity, &["run", "test.yaml"]).says(0, &["test: done"]);
    }
    let checked = rotation.by(ANNA, &["preflight", "test.yaml"]);
    checked.says(0, &["is being replaced", "keys renew r0", "keys renew r2"]);
    assert!(!checked.text().contains("keys renew r1"), "{}", checked.text());
    rotation
        .by(CLEO, &["preflight", "test.yaml"])
        .says(0, &["the certificate of operator cleo is of an authority"]);
    for (player, dora) in [(ANNA, "old-dora.pem"), (CLEO, DORA)] {
        rotation.is_stopped(rotation.playing(player), dora);
    }

    rotation
        .keys(&["rotate", "--end"])
        .says(1, &["robot r0, robot r2, operator bert, operator cleo have only a key of the old authority"]);
    rotation.keys(&["renew", "--all"]).says(0, &["robot r0", "robot r2", "operator bert", "operator cleo"]);
    rotation.keys(&["list"]).says(0, &["of the old authority", "every name has a key of the new authority"]);
    rotation.start(2);
    rotation.fleet(1..3);
    let old = rotation.playing("old-cleo.pem");
    rotation.keys(&["rotate", "--end"]).says(0, &["its key was deleted"]);
    rotation.by("old-cleo.pem", &["keys", "push"]).says(2, &["set DOWNBEAT_IDENTITY"]);
    rotation.by(ANNA, &["keys", "push"]).says(0, &latest[1..]);
    fails_with(old, "the authority of the operator's key was replaced");
    let ended = Instant::now();
    let ends = "the commands of operator cleo end: the authority of the operator's key was replaced";
    while !(1..3).all(|robot| rotation.site.logged(robot).contains(ends)) {
        assert!(ended.elapsed() < ENDED_WITHIN, "{}", rotation.site.logged(1));
        std::thread::sleep(Duration::from_millis(20));
    }
    rotation.by("old-cleo.pem", &["fleet", "ping"]).says(1, &["r1", "trusts a different authority"]);
    rotation.by(CLEO, &["run", "test.yaml"]).says(0, &["test: done"]);
    rotation.is_stopped(rotation.playing(ANNA), DORA);
    // This robot still has its old key.
    rotation.fleet(0..1);
    rotation.by(ANNA, &["fleet", "ping"]).says(1, &["r0", "issued by a different authority"]);
    rotation.start(0);
    rotation.fleet(0..1);
    rotation.by(ANNA, &["keys", "push"]).says(0, &latest[..1]);
}

/// Begins a mission whose operator has a key of the old authority, with operators that have a key of either.
#[test]
fn mission_obeys_signed_commands_of_both_authorities() {
    let site = Site::new();
    let session = &site.session;
    let waits = "scenario: waits\nstart_tolerance: 1s\nacts:\n  - act: one\n    wait: operator\n    cues: [{at: 0s, robots: all, tracks: {shoulder: [{at: 0s, to: 45}, {at: 60s, to: 10}]}}]\n";
    session.file("waits.yaml", waits);
    let mut command = session.command(&["run", "waits.yaml"]);
    let playing = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    session.run(&["keys", "rotate"]).says(0, &[]);
    session.run(&["keys", "renew", "--operator", "cleo"]).says(0, &[]);
    let by = |identity: &str, args: &[&str]| {
        Ran(session.command(args).env("DOWNBEAT_IDENTITY", identity).output().unwrap())
    };
    let begun = Instant::now();
    let go = loop {
        let go = by(CLEO, &["go"]);
        if go.text().contains("`one` begins") || begun.elapsed() > Duration::from_secs(30) {
            break go;
        }
        std::thread::sleep(Duration::from_millis(50));
    };
    go.says(0, &["`one` begins"]);
    by(DORA, &["stop"]).says(0, &[]);
    fails_with(playing, "stopped by operator dora");
}

#[test]
fn starter_robot_in_python_accepts_keys_of_both_authorities_until_the_old_one_ends() {
    let session = stage::session::Session::new();
    session.run(&["keys", "init"]).says(0, &[]);
    session.run(&["keys", "robot", "arm-1"]).says(0, &[]);
    for operator in ["anna", "bert"] {
        session.run(&["keys", "operator", operator, "--role", "observe"]).says(0, &[]);
    }
    let ping = |operator: &str, address: &str| {
        session.file("fleet.yaml", format!("robots: {{arm-1: {{init: arm.yaml, address: '{address}'}}}}\n"));
        let identity = format!("keys/operators/{operator}.pem");
        Ran(session
            .command(&["fleet", "describe", address])
            .env("DOWNBEAT_IDENTITY", identity)
            .output()
            .unwrap())
        .code()
    };
    let (old, address) = stage::site::python_robot(&session);
    assert_eq!(ping("anna", &address), 0);
    drop(old);
    session.run(&["keys", "rotate"]).says(0, &[]);
    session.run(&["keys", "renew", "--operator", "bert"]).says(0, &[]);
    let (old, address) = stage::site::python_robot(&session);
    // Bert's new file trusts both authorities.
    assert_eq!([ping("anna", &address), ping("bert", &address)], [0, 0]);
    drop(old);
    session.run(&["keys", "renew", "arm-1"]).says(0, &[]);
    let (new, address) = stage::site::python_robot(&session);
    assert_eq!(ping("bert", &address), 0);
    drop(new);
    session.run(&["keys", "rotate", "--end", "--force"]).says(0, &[]);
    let (_new, address) = stage::site::python_robot(&session);
    assert_eq!([ping("anna", &address), ping("bert", &address)], [1, 0]);
}
