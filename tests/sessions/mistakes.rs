//! Beginners' mistakes over the whole program: sessions at a shell in `tests/mistakes/`, one file a mistake, whole as they were
//! approved. A file tells the mistake in its first line, then come commands after `$ ` (and `> ` where they go on), each with
//! what it prints. They are run in a copy of `tests/mistakes/folder`. With `DOWNBEAT_BLESS=1` the texts are written again; then
//! read every change as a beginner would: is it clear what is wrong and where, and is it clear what to do?

use std::fmt::Write as _;
use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;

use rustix::thread::CapabilitySet;
use tempfile::TempDir;

use stage::session::{program, root};

fn folder() -> PathBuf {
    root().join("tests/mistakes")
}

fn sessions() -> Vec<PathBuf> {
    let entries = fs::read_dir(folder()).unwrap().map(|entry| entry.unwrap().path());
    let mut sessions: Vec<_> =
        entries.filter(|path| path.extension().is_some_and(|end| end == "txt")).collect();
    sessions.sort();
    sessions
}

/// What is typed: the title and the commands, without what they print.
struct Typed {
    title: String,
    commands: Vec<String>,
}

impl Typed {
    fn of(session: &str) -> Self {
        let title = session.lines().next().unwrap_or_default().to_owned();
        let mut commands: Vec<String> = Vec::new();
        let mut goes_on = false;
        for line in session.lines() {
            if let Some(command) = line.strip_prefix("$ ") {
                commands.push(command.to_owned());
                goes_on = true;
            } else if let Some(more) = line.strip_prefix("> ").filter(|_| goes_on) {
                let command = commands.last_mut().unwrap();
                let _written = write!(command, "\n{more}");
            } else {
                goes_on = false;
            }
        }
        Self { title, commands }
    }
}

/// A folder to make mistakes in, and the ports that they name: `$USED` belongs to this process and never answers.
struct Stage {
    folder: TempDir,
    listener: TcpListener,
}

impl Stage {
    fn new() -> Self {
        let stage = folder().join("folder");
        let folder = TempDir::new().unwrap();
        for file in fs::read_dir(stage).unwrap().map(Result::unwrap) {
            fs::copy(file.path(), folder.path().join(file.file_name())).unwrap();
        }
        Self { folder, listener: TcpListener::bind("127.0.0.1:0").unwrap() }
    }

    fn port(&self) -> String {
        self.listener.local_addr().unwrap().port().to_string()
    }

    /// What one command prints, and how it ends, without what differs from run to run.
    fn run(&self, command: &str) -> (String, i32) {
        let program = Path::new(program()).parent().unwrap().display().to_string();
        let path = format!("{program}:{}", std::env::var("PATH").unwrap());
        let mut shell = Command::new("bash");
        shell.arg("-c").arg(format!("set -o pipefail\nexec 2>&1\n{command}")).current_dir(self.folder.path());
        shell.stdin(Stdio::null()).env("PATH", path).env("USED", self.port());
        shell.env("DOWNBEAT_STATE", self.folder.path().join(".state")).env("TZ", "UTC").env("LC_ALL", "C");
        let ran = shell.output().unwrap();
        let text = String::from_utf8(ran.stdout).unwrap();
        let text =
            text.replace(&self.folder.path().display().to_string(), "$PWD").replace(&self.port(), "$USED");
        (without_sessions(&text), ran.status.code().unwrap())
    }
}

/// Missions are named by machine, process and time.
fn without_sessions(text: &str) -> String {
    let mut pieces = text.split("show@");
    let mut plain = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        let end = piece.find(|c: char| !c.is_ascii_alphanumeric() && c != '-').unwrap_or(piece.len());
        plain += "show@...";
        plain += &piece[end..];
    }
    plain
}

fn played(session: &str) -> String {
    let typed = Typed::of(session);
    let stage = Stage::new();
    let mut text = format!("{}\n\n", typed.title);
    for (number, command) in typed.commands.iter().enumerate() {
        let (printed, code) = stage.run(command);
        let shown = command.replace('\n', "\n> ");
        let _written = write!(text, "$ {shown}\n{printed}");
        let last = number + 1 == typed.commands.len();
        if last || code != 0 {
            let _written = writeln!(text, "exit code {code}");
        }
    }
    text
}

/// The superuser may read and write everything, a beginner may not. Concerns this thread and what it starts.
fn give_up_privileges() {
    for capability in
        [CapabilitySet::DAC_OVERRIDE, CapabilitySet::DAC_READ_SEARCH, CapabilitySet::NET_BIND_SERVICE]
    {
        // Without privileges there is nothing to give up.
        let _unprivileged = rustix::thread::remove_capability_from_bounding_set(capability);
    }
}

#[test]
fn every_mistake_is_told_as_it_was_approved() {
    let sessions = sessions();
    assert!(sessions.len() >= 60, "{} mistakes", sessions.len());
    let bless = std::env::var_os("DOWNBEAT_BLESS").is_some();
    let (left, changed) = (Mutex::new(sessions.iter()), Mutex::new(Vec::new()));
    let work = || {
        give_up_privileges();
        loop {
            let Some(path) = left.lock().unwrap().next() else { return };
            let approved = fs::read_to_string(path).unwrap();
            let now = played(&approved);
            if now != approved {
                let name = path.file_name().unwrap().display();
                changed.lock().unwrap().push(format!("{name}\n--- approved\n{approved}\n--- now\n{now}"));
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

/// With these a message says what to do, or what would be right.
/// What a text has that says what to do: a mark, or an instruction that begins with one of the verbs.
const ADVICE: [&str; 16] = [
    "help: ",
    "tip: ",
    "possible values",
    "did you mean",
    " such as ",
    ", as in ",
    ": add ",
    ": write ",
    "Name another ",
    "Usage: ",
    "so leave out ",
    "so there is nothing to",
    "` lists ",
    ", or choose ",
    "expected sim, ",
    "joint-trajectory takes any robot",
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

fn advises(told: &str) -> bool {
    ADVICE.iter().any(|advice| told.contains(advice))
        || INSTRUCTIONS
            .iter()
            .any(|verb| ["; ", "; `"].iter().any(|before| told.contains(&format!("{before}{verb}"))))
}

#[test]
fn every_mistake_is_told_with_what_to_do() {
    for path in sessions() {
        let text = fs::read_to_string(&path).unwrap();
        let told: Vec<_> = text.lines().filter(|line| !line.starts_with(['$', '>'])).skip(1).collect();
        let told = told.join("\n");
        assert!(advises(&told), "{}: {told}", path.display());
    }
}

#[test]
fn no_mistake_is_told_without_a_word_or_with_empty_names() {
    for path in sessions() {
        let text = fs::read_to_string(&path).unwrap();
        let (name, typed) = (path.display(), Typed::of(&text));
        assert!(!typed.commands.is_empty(), "{name}: no command");
        for empty in ["``", "one of none", "one of: \n", "expected one of\n", "(os error"] {
            assert!(!text.contains(empty), "{name} prints `{empty}`");
        }
        let ended = text.rsplit('\n').nth(2).unwrap_or_default();
        assert!(!ended.starts_with("$ ") && !ended.starts_with("> "), "{name}: nothing is said");
    }
}
