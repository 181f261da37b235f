//! Replays shell sessions, and compares their complete text with the approved text.
//!
//! `findings/` has a session for each kind of mistake in a scenario or fleet; `mistakes/` has the mistakes that beginners make with the
//! program. A session is one file: a title in its first line, then commands after `$ ` (continued after `> `), each with its output. The
//! commands run in a copy of `folder/`. `DOWNBEAT_BLESS=1` rewrites the approved texts. Read every change as a user would: is it clear
//! what is wrong, where, and how to fix it?
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fmt::Write as _;
use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;

use rustix::thread::CapabilitySet;
use stage::session::{Ran, program, root};
use tempfile::TempDir;

const FINDINGS: &str = "findings";
const MISTAKES: &str = "mistakes";

fn folder(kind: &str) -> PathBuf {
    root().join("tests/sessions").join(kind)
}

/// Returns the paths of the sessions of one kind, sorted by name.
fn sessions(kind: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder(kind)).unwrap().map(|entry| entry.unwrap().path());
    let mut sessions: Vec<_> =
        entries.filter(|path| path.extension().is_some_and(|end| end == "txt")).collect();
    sessions.sort();
    sessions
}

fn name(session: &Path) -> &str {
    session.file_stem().unwrap().to_str().unwrap()
}

/// The title and the commands of a session, without their output.
struct Typed {
    title: String,
    commands: Vec<String>,
}

impl Typed {
    fn of(session: &str) -> Self {
        let title = session.lines().next().unwrap_or_default().to_owned();
        let mut commands: Vec<String> = Vec::new();
        let mut continues = false;
        for line in session.lines() {
            if let Some(command) = line.strip_prefix("$ ") {
                commands.push(command.to_owned());
                continues = true;
            } else if let Some(more) = line.strip_prefix("> ").filter(|_| continues) {
                let command = commands.last_mut().unwrap();
                let _written = write!(command, "\n{more}");
            } else {
                continues = false;
            }
        }
        Self { title, commands }
    }
}

/// A copy of the folder in which the sessions of a kind run. `listener` is the port `$USED`, on which this process listens without ever
/// answering.
struct Desk {
    folder: TempDir,
    listener: TcpListener,
}

fn copy(from: &Path, to: &Path) {
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let copied = to.join(entry.file_name());
        if entry.path().is_dir() {
            fs::create_dir(&copied).unwrap();
            copy(&entry.path(), &copied);
        } else {
            fs::copy(entry.path(), copied).unwrap();
        }
    }
}

impl Desk {
    fn new(kind: &str) -> Self {
        let own =
            Self { folder: TempDir::new().unwrap(), listener: TcpListener::bind("127.0.0.1:0").unwrap() };
        copy(&folder(kind).join("folder"), own.folder.path());
        own
    }

    fn port(&self) -> String {
        self.listener.local_addr().unwrap().port().to_string()
    }

    /// Runs one command. Returns its exit code and its output without the parts that differ from run to run.
    fn run(&self, command: &str) -> (String, i32) {
        let folder = Path::new(program()).parent().unwrap().display().to_string();
        let path = format!("{folder}:{}", std::env::var("PATH").unwrap());
        let mut shell = Command::new("bash");
        shell.arg("-c").arg(format!("set -o pipefail\nexec 2>&1\n{command}")).current_dir(self.folder.path());
        shell.stdin(Stdio::null()).env("PATH", path).env("USED", self.port());
        shell.env("DOWNBEAT_STATE", self.folder.path().join(".state")).env("TZ", "UTC").env("LC_ALL", "C");
        let ran = shell.output().unwrap();
        let text = String::from_utf8(ran.stdout).unwrap();
        let text =
            text.replace(&self.folder.path().display().to_string(), "$PWD").replace(&self.port(), "$USED");
        (without_mission_names(&text), ran.status.code().unwrap())
    }

    /// Repeats the commands of an approved session. Returns the session with the current output.
    fn replay(&self, session: &str) -> String {
        let typed = Typed::of(session);
        let mut text = format!("{}\n\n", typed.title);
        for (number, command) in typed.commands.iter().enumerate() {
            let (printed, code) = self.run(command);
            let shown = command.replace('\n', "\n> ");
            let _written = write!(text, "$ {shown}\n{printed}");
            let last = number + 1 == typed.commands.len();
            if last || code != 0 {
                let _written = writeln!(text, "exit code {code}");
            }
        }
        text
    }
}

/// Removes mission names, because they contain machine, process and time.
fn without_mission_names(text: &str) -> String {
    let mut pieces = text.split("show@");
    let mut plain = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        let end = piece.find(|c: char| !c.is_ascii_alphanumeric() && c != '-').unwrap_or(piece.len());
        plain += "show@...";
        plain += &piece[end..];
    }
    plain
}

/// Drops the superuser's right to read and write everything, because a beginner does not have it. Affects this thread and the processes
/// that it starts.
fn give_up_privileges() {
    for capability in
        [CapabilitySet::DAC_OVERRIDE, CapabilitySet::DAC_READ_SEARCH, CapabilitySet::NET_BIND_SERVICE]
    {
        // Fails without privileges; then there is nothing to drop.
        let _unprivileged = rustix::thread::remove_capability_from_bounding_set(capability);
    }
}

/// Replays all sessions of a kind, several at once because they mostly wait for timeouts.
#[track_caller]
fn check(kind: &str, desk_for_each: bool) {
    let bless = std::env::var_os("DOWNBEAT_BLESS").is_some();
    let sessions = sessions(kind);
    let (left, changed) = (Mutex::new(sessions.iter()), Mutex::new(Vec::new()));
    let work = || {
        give_up_privileges();
        let shared = Desk::new(kind);
        loop {
            let Some(path) = left.lock().unwrap().next() else { return };
            let approved = fs::read_to_string(path).unwrap();
            let now =
                if desk_for_each { Desk::new(kind).replay(&approved) } else { shared.replay(&approved) };
            if now != approved {
                let text = format!("{}\n--- approved\n{approved}\n--- now\n{now}", name(path));
                changed.lock().unwrap().push(text);
                if bless {
                    fs::write(path, &now).unwrap();
                }
            }
        }
    };
    std::thread::scope(|scope| (0..4).for_each(|_| drop(scope.spawn(work))));
    let changed = changed.into_inner().unwrap();
    assert!(changed.is_empty() || bless, "{}", changed.join("\n"));
}

#[test]
fn every_finding_matches_its_approved_output() {
    assert!(sessions(FINDINGS).len() >= 100);
    check(FINDINGS, false);
}

#[test]
fn every_mistake_matches_its_approved_output() {
    assert!(sessions(MISTAKES).len() >= 300);
    check(MISTAKES, true);
}

#[test]
fn session_named_after_a_finding_code_shows_that_code() {
    for path in sessions(FINDINGS).iter().filter(|path| name(path).starts_with("DB")) {
        let code = format!("[{}]", &name(path)[..6]);
        assert!(fs::read_to_string(path).unwrap().contains(&code), "{} does not show {code}", name(path));
    }
}

#[test]
fn every_findings_scenario_has_a_session() {
    // Files that others include.
    const PARTS: [&str; 3] = ["fleet", "hand", "shared"];
    let typed: String = sessions(FINDINGS).iter().map(|path| fs::read_to_string(path).unwrap()).collect();
    for entry in fs::read_dir(folder(FINDINGS).join("folder")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|end| end == "yaml") && !PARTS.contains(&name(&path)) {
            assert!(typed.contains(&format!("$ downbeat check {}.yaml", name(&path))), "{}", path.display());
        }
    }
}

#[test]
fn every_code_has_a_test_that_triggers_it() {
    let mut tests: String =
        ["language/findings.rs", "files/host.rs", "files/import.rs", "files/import_real.rs"]
            .map(|file| fs::read_to_string(root().join("tests").join(file)).unwrap())
            .concat();
    sessions(FINDINGS).iter().for_each(|path| tests.push_str(name(path)));
    for code in downbeat_scripts::Code::ALL {
        assert!(tests.contains(code.as_str()), "no test triggers {}", code.as_str());
        let explained = Ran(Command::new(program()).args(["explain", code.as_str()]).output().unwrap());
        explained.says(0, &[code.as_str(), code.title(), "Fix it"]);
    }
}

/// Phrases that identify advice in a message. An instruction that begins with one of [`INSTRUCTIONS`] is advice as well.
const ADVICE: [&str; 16] = [
    "help: ",
    "tip: ",
    "possible values",
    "did you mean",
    " such as ",
    ", as in ",
    ": add ",
    ": write ",
    "; expected a file that `downbeat run --record FILE` wrote",
    "Usage: ",
    "so leave out ",
    "so there is nothing to",
    "` lists ",
    ", or choose ",
    "expected sim, ",
    "joint-trajectory supports any robot",
];
const INSTRUCTIONS: [&str; 14] = [
    "add",
    "check",
    "choose",
    "correct",
    "create",
    "downbeat run",
    "give",
    "leave out",
    "listen on",
    "make sure",
    "name",
    "set",
    "start",
    "write",
];

fn advises(printed: &str) -> bool {
    ADVICE.iter().any(|advice| printed.contains(advice))
        || INSTRUCTIONS
            .iter()
            .any(|verb| ["; ", "; `"].iter().any(|before| printed.contains(&format!("{before}{verb}"))))
}

#[test]
fn output_for_every_mistake_contains_advice() {
    for path in sessions(MISTAKES) {
        let text = fs::read_to_string(&path).unwrap();
        let printed: Vec<_> = text.lines().filter(|line| !line.starts_with(['$', '>'])).skip(1).collect();
        let printed = printed.join("\n");
        assert!(advises(&printed), "{}: {printed}", path.display());
    }
}

#[test]
fn every_session_prints_output_without_empty_names() {
    for path in [FINDINGS, MISTAKES].into_iter().flat_map(sessions) {
        let text = fs::read_to_string(&path).unwrap();
        let (name, typed) = (path.display(), Typed::of(&text));
        assert!(!typed.commands.is_empty(), "{name}: no command");
        for empty in ["``", "one of none", "one of: \n", "expected one of\n", "(os error"] {
            assert!(!text.contains(empty), "{name} prints `{empty}`");
        }
        let last = text.rsplit('\n').nth(2).unwrap_or_default();
        assert!(!last.starts_with("$ ") && !last.starts_with("> "), "{name}: nothing is printed");
    }
}
