//! A site of three robots with keys, and operators whose certificates permit different actions.

use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use crate::meddler::{Tamperer, Tampering, Wire};
use crate::session::{Ran, Session, arm_at, program, root};
use crate::{Process, free_port};

/// A scenario that moves every robot of the site.
pub const SCENARIO: &str = "scenario: test
start_tolerance: 1s
cues: [{at: 0s, robots: all, tracks: {shoulder: [{at: 0s, to: 45}, {at: 300ms, to: 10}, {at: 600ms, to: 45}]}}]
";

/// Three robots with keys, and operators with different permissions.
pub struct Site {
    pub session: Session,
    /// Transport of the robots: `tls` or `hmac`.
    scheme: &'static str,
    pub ports: Vec<u16>,
    robots: Vec<Process>,
}

impl Site {
    pub fn new() -> Self {
        Self::with("tls")
    }

    pub fn with(scheme: &'static str) -> Self {
        let session = Session::new();
        session.file("arm.yaml", arm_at(45)).file("test.yaml", SCENARIO);
        session.run(&["keys", "init"]).says(0, &["keys/authority.key"]);
        let (make, says) =
            if scheme == "tls" { ("robot", "365 days") } else { ("secret", "secrets/r1.secret") };
        session.run(&["keys", make, "r0", "r1", "r2"]).says(0, &["r2", says]);
        for (name, roles) in
            [("anna", "observe,drive"), ("bert", "observe"), ("cleo", "observe,drive"), ("dora", "stop")]
        {
            session.run(&["keys", "operator", name, "--role", roles]).says(0, &[name]);
        }
        let mut site = Self { session, scheme, ports: Vec::new(), robots: Vec::new() };
        for id in 0..3 {
            site.start(id);
        }
        site.fleet(&site.addresses(scheme), "anna");
        site
    }

    fn start(&mut self, id: usize) {
        let list = if self.scheme == "tls" { "keys/revoked.pem" } else { "keys/revoked.serials" };
        let (port, robot) = self.spawn(id, list);
        self.ports.push(port);
        self.robots.push(robot);
    }

    /// Starts another process of a robot, with its own list of revoked keys. Returns its address.
    pub fn another(&self, id: usize, list: &str) -> (String, Process) {
        let (port, robot) = self.spawn(id, list);
        (format!("{}://127.0.0.1:{port}", self.scheme), robot)
    }

    fn spawn(&self, id: usize, list: &str) -> (u16, Process) {
        let port = free_port();
        let mut command = Command::new(program());
        let listen = format!("127.0.0.1:{port}");
        command.args([
            "--log",
            "warn",
            "robot",
            "--init",
            "arm.yaml",
            "--id",
            &format!("r{id}"),
            "--listen",
            &listen,
        ]);
        match self.scheme {
            "tls" => command.args(["--identity", &format!("keys/robots/r{id}.pem")]),
            _ => command.args(["--secret", &format!("keys/secrets/r{id}.secret")]),
        };
        command.args(["--revoked", list, "--log-file", &format!("r{id}.jsonl")]);
        command.current_dir(self.session.path("")).env("DOWNBEAT_STATE", self.session.path("state"));
        command.stderr(std::fs::File::create(self.session.path(&format!("r{id}.log"))).unwrap());
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        listens(&mut child);
        (port, Process(child))
    }

    pub fn addresses(&self, scheme: &str) -> Vec<String> {
        self.ports.iter().map(|port| format!("{scheme}://127.0.0.1:{port}")).collect()
    }

    pub fn fleet(&self, addresses: &[String], operator: &str) {
        let robot = |(id, address)| format!("  r{id}: {{init: arm.yaml, address: '{address}'}}\n");
        let robots: String = addresses.iter().enumerate().map(robot).collect();
        let head = format!("identity: keys/operators/{operator}.pem\nrevoked: keys/revoked.pem\n");
        let fleet = format!("{head}robots:\n{robots}groups: {{all: [r0, r1, r2]}}\n");
        self.session.file("fleet.yaml", fleet);
    }

    /// Makes the fleet file name this list of revoked certificates.
    pub fn list(&self, path: &str) {
        let fleet = std::fs::read_to_string(self.session.path("fleet.yaml")).unwrap();
        let is_list = |line: &&str| line.starts_with("revoked: ");
        let before = fleet.lines().find(is_list).unwrap();
        self.session.file("fleet.yaml", fleet.replace(before, &format!("revoked: {path}")));
    }

    pub fn run(&self) -> Ran {
        self.session.run(&["run", "test.yaml", "--patience", "3s"])
    }

    /// Returns the log of a robot.
    pub fn logged(&self, id: usize) -> String {
        std::fs::read_to_string(self.session.path(&format!("r{id}.log"))).unwrap()
    }

    /// Returns the number of movements that all robots have logged.
    pub fn moved(&self) -> usize {
        let text = |id| std::fs::read_to_string(self.session.path(&format!("r{id}.jsonl"))).unwrap();
        let moved = |id| text(id).lines().count();
        (0..3).map(moved).sum()
    }

    /// Runs the mission of the site. Checks that it is refused with the message `words` and that nothing moves.
    #[track_caller]
    pub fn refused(&self, words: &[&str]) {
        let before = self.moved();
        self.run().says(1, words);
        assert_eq!(self.moved(), before);
    }
}

/// Waits until a robot's process prints its address, and returns the address.
pub fn listens(child: &mut Child) -> String {
    use std::io::{BufRead, BufReader};
    let mut line = String::new();
    BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
    assert!(line.contains("listens on") || line.contains("listening on"), "{line}");
    line
}

/// A scenario whose scripts are the only long messages to a robot.
pub const LONG_SCRIPT: &str = "scenario: test
start_tolerance: 1s
cues: [{at: 0s, robots: all, tracks: {shoulder: [{at: 0s, to: 45}, {at: 100ms, to: 10}, {at: 200ms, to: 20}, {at: 300ms, to: 30},
{at: 400ms, to: 40}, {at: 500ms, to: 50}, {at: 600ms, to: 45}]}}]
";

/// Plays missions while a tamperer manipulates the messages to one robot. `long_record` is the number of the manipulated record among the
/// long ones.
pub fn on_the_way(site: &Site, wire: Wire, long_record: usize) {
    let meddler = Tamperer::to(site.ports[1], wire, long_record);
    let mut addresses = site.addresses(site.scheme);
    addresses[1] = format!("{}://127.0.0.1:{}", site.scheme, meddler.port);
    site.fleet(&addresses, "anna");
    let before = site.moved();
    site.run().says(0, &["test: done"]);
    let once = site.moved() - before;
    for deed in [Tampering::Alter, Tampering::Reorder, Tampering::Repeat] {
        // Robots log each reason at most once a second.
        std::thread::sleep(std::time::Duration::from_millis(1_100));
        let (logged, before) = (site.logged(1).len(), site.moved());
        meddler.does(deed);
        if deed == Tampering::Repeat {
            // The first copy is genuine, so the mission may continue on another connection. Exit code 6: the mission was played, but with
            // late steps.
            let played = usize::from(matches!(site.run().code(), 0 | 6));
            assert_eq!(site.moved(), before + played * once);
        } else {
            site.refused(&["r1"]);
        }
        assert!(meddler.done() > 0, "{deed:?}");
        let logged = site.logged(1).split_off(logged);
        assert!(logged.contains("its data was altered, repeated or reordered"), "{deed:?}: {logged}");
    }
    // Sends the bytes of an earlier connection again.
    let before = site.moved();
    assert!(meddler.said_again().is_empty() || site.scheme == "tls");
    let begun = std::time::Instant::now();
    while !site.logged(1).contains("it did not prove its identity") {
        assert!(begun.elapsed().as_secs() < 10, "{}", site.logged(1));
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    assert_eq!(site.moved(), before);
    meddler.does(Tampering::Pass);
    site.run().says(0, &["test: done"]);
}

/// Starts the Python starter (an example robot that users copy) with the keys of `arm-1`. Returns its process and its address.
pub fn python_robot(session: &Session) -> (Process, String) {
    starter(session, "tls", "keys/revoked.pem")
}

/// Starts a starter with this list of revoked keys: with `tls`, the one in Python with the keys of `arm-1`; with `hmac`, the one in C with
/// the secret of `arm-2`. Its log is the file `err`. Returns its process and its address.
pub fn starter(session: &Session, scheme: &str, list: &str) -> (Process, String) {
    let mut command = if scheme == "tls" {
        let python = std::env::var("DOWNBEAT_PYTHON").unwrap_or_else(|_| "python3".to_owned());
        let mut command = Command::new(python);
        command.arg(root().join("robot/starters/python/robot.py")).env("PYTHONDONTWRITEBYTECODE", "1");
        command.args(["--identity", "keys/robots/arm-1.pem"]);
        command
    } else {
        let mut command = Command::new(built(session, "robot"));
        command.args(["--secret", "keys/secrets/arm-2.secret"]);
        command
    };
    command.args(["--listen", "127.0.0.1:0", "--revoked", list]).current_dir(session.path(""));
    command.stdout(Stdio::piped()).stderr(std::fs::File::create(session.path("err")).unwrap());
    let mut child = command.spawn().unwrap();
    let said = listens(&mut child);
    (Process(child), format!("{scheme}://{}", said.rsplit(' ').next().unwrap().trim()))
}

/// Compiles a C program from the folder of the starter (the example robot that users copy). Returns its path.
pub fn built(session: &Session, program: &str) -> PathBuf {
    let from = root().join("robot/starters/c");
    let built = session.path(program);
    let mut cc = Command::new(std::env::var("CC").unwrap_or_else(|_| "cc".to_owned()));
    cc.args(["-std=c99", "-D_POSIX_C_SOURCE=200809L", "-O1", "-o"]).arg(&built);
    cc.args([&format!("{program}.c"), "json.c", "sealed.c", "sha256.c", "-lm"]).current_dir(from);
    assert!(cc.status().unwrap().success());
    built
}
