//! Effects of Downbeat on its own host: the files it opens, the programs it starts, and who can read the files it writes.

use std::os::unix::fs::{MetadataExt, PermissionsExt, chown, symlink};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rustix::fs::{CWD, FileType, Mode, mknodat};

use stage::session::{ARM, Ran, Session, program};

const SHOW: &str = "scenario: show
start_tolerance: 1s
cues: [{at: 0s, robots: arms, tracks: {shoulder: [{at: 0s, to: 0}, {at: 300ms, to: 20}]}}]
";

/// Longest permitted duration of a command that must not wait.
const AT_ONCE: Duration = Duration::from_secs(5);

/// Id of a foreign user, to whom root gives a file to test that Downbeat refuses the file.
const NOBODY: u32 = 65_534;

fn session() -> Session {
    let session = Session::new();
    session.file("show.yaml", SHOW);
    session
}

#[expect(clippy::print_stderr, reason = "says that the test shows less")]
fn is_root() -> bool {
    let root = rustix::process::geteuid().is_root();
    if !root {
        eprintln!("only root can give files to another user: this test shows nothing here");
    }
    root
}

fn mode(path: &Path) -> u32 {
    path.metadata().unwrap().mode() & 0o7777
}

fn pipe(path: &Path) {
    mknodat(CWD, path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
}

/// Runs a command that must not wait for anything.
#[track_caller]
fn at_once(mut command: Command) -> Ran {
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let begin = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begin.elapsed() > AT_ONCE {
            child.kill().unwrap();
            panic!("it waits: {}", Ran(child.wait_with_output().unwrap()).text());
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    Ran(child.wait_with_output().unwrap())
}

/// Returns the folders of the missions in a state folder.
fn missions(state: &Path) -> Vec<std::path::PathBuf> {
    std::fs::read_dir(state).unwrap().map(|entry| entry.unwrap().path()).collect()
}

#[test]
fn shared_folder_is_not_used_if_home_is_unset() {
    let session = session();
    let without = |args: &[&str]| {
        let mut command = session.command(args);
        command.env_remove("DOWNBEAT_STATE").env_remove("XDG_STATE_HOME").env_remove("HOME");
        let temporary = session.path("tmp");
        std::fs::create_dir_all(&temporary).unwrap();
        Ran(command.env("TMPDIR", temporary).output().unwrap())
    };
    let how = "HOME is not set; set HOME, or set DOWNBEAT_STATE to a folder of your own";
    for args in [&["stop"][..], &["missions"], &["go"], &["resume"], &["run", "show.yaml", "--detach"]] {
        without(args).says(2, &[how]);
    }
    without(&["run", "show.yaml"]).says(2, &[how, "or run with --no-journal"]);
    without(&["run", "show.yaml", "--no-journal"]).says(0, &["show: done"]);
    assert_eq!(
        std::fs::read_dir(session.path("tmp")).unwrap().count(),
        0,
        "something is in the shared folder"
    );
}

#[test]
fn mission_files_are_accessible_only_to_their_user() {
    let session = session();
    session.file(
        "wait.yaml",
        SHOW.replace("cues: [", "acts: [{act: one, wait: operator, cues: [").replace("}]\n", "}]}]\n"),
    );
    let mut command = session.command(&["run", "wait.yaml", "--detach"]);
    // The most permissive umask.
    let umask = rustix::process::umask(Mode::empty());
    let ran = Ran(command.output().unwrap());
    rustix::process::umask(umask);
    ran.says(0, &["is running in the background"]);
    let state = session.path("state");
    let folder = missions(&state).pop().unwrap();
    let found = [&state, &folder].map(|path| mode(path));
    let files = ["journal", "control", "log"].map(|name| mode(&folder.join(name)));
    session.run(&["stop"]).says(0, &[]);
    assert_eq!((found, files), ([0o700; 2], [0o600; 3]));
}

#[test]
fn state_folder_owned_or_writable_by_others_is_refused() {
    let session = session();
    session.play(&["run", "show.yaml"]).says(0, &["show: done"]);
    let state = session.path("state");
    let permit = |mode| std::fs::set_permissions(&state, std::fs::Permissions::from_mode(mode)).unwrap();
    permit(0o755);
    session.run(&["missions", "--all"]).says(0, &["show@"]);
    assert_eq!(mode(&state), 0o700, "others could still read it");
    permit(0o1777);
    for args in [&["missions"][..], &["stop"], &["resume"], &["go"], &["run", "show.yaml"]] {
        session.run(args).says(2, &["is writable by other users (mode 1777)", "chmod -R go= "]);
    }
    session.play(&["run", "show.yaml", "--no-journal"]).says(0, &["warning: ", "is writable by other users"]);
    permit(0o700);
    let link = session.path("link");
    symlink(&state, &link).unwrap();
    let by_link = Ran(session.command(&["stop"]).env("DOWNBEAT_STATE", &link).output().unwrap());
    by_link.says(2, &["link is a symbolic link"]);
    if is_root() {
        chown(&state, Some(NOBODY), None).unwrap();
        for args in [&["missions"][..], &["stop"], &["resume"], &["run", "show.yaml"]] {
            session
                .run(args)
                .says(2, &["belongs to user 65534, but this process runs as user 0", "set DOWNBEAT_STATE"]);
        }
    }
}

#[test]
fn planted_mission_folder_is_reported_and_ignored() {
    let session = session();
    session.play(&["run", "show.yaml"]).says(0, &["show: done"]);
    let state = session.path("state");
    let folder = missions(&state).pop().unwrap();
    symlink(&folder, state.join("a-link")).unwrap();
    std::fs::create_dir(state.join("a-pipe")).unwrap();
    pipe(&state.join("a-pipe/journal"));
    std::fs::create_dir(state.join("linked")).unwrap();
    std::fs::hard_link(folder.join("journal"), state.join("linked/journal")).unwrap();
    let named = [
        "a-link is a symbolic link",
        "a-pipe/journal is not a file",
        "linked/journal has several hard links",
    ];
    at_once(session.command(&["stop"])).says(1, &named);
    at_once(session.command(&["missions", "--all"])).says(0, &named);
    at_once(session.command(&["run", "show.yaml"])).says(0, &named);
    if is_root() {
        chown(state.join("a-pipe"), Some(NOBODY), None).unwrap();
        at_once(session.command(&["stop"])).says(1, &["a-pipe belongs to user 65534"]);
    }
}

/// Creates a fleet in which a program drives one of the two robots. The program creates the file `started` when it starts.
fn programmed() -> Session {
    let session = session();
    let fleet = "robots:
  left: {init: arm.yaml, address: sim}
  right: {init: arm.yaml, address: 'program:touch started; while read -r line; do echo ok; done'}
groups: {arms: [left, right]}
";
    session.file("fleet.yaml", fleet);
    session
}

#[test]
fn read_only_command_starts_no_program_without_explicit_option() {
    let session = programmed();
    let started = session.path("started");
    let told = "its program is not started without --start-programs";
    let looks =
        [&["fleet", "ping"][..], &["fleet", "show"], &["preflight", "show.yaml"]].map(<[&str]>::to_vec);
    for args in &looks {
        at_once(session.command(args)).says(1, &["right", told]);
        assert!(!started.exists(), "{args:?} started it");
    }
    let others = [
        &["check", "show.yaml"][..],
        &["plan", "show.yaml"],
        &["graph", "show.yaml"],
        &["dry-run", "show.yaml"],
        &["dry-run", "show.yaml", "--certify", "show.cert.json"],
        &["export", "joint-trajectory", "show.yaml", "--output", "out"],
        &["diff", "show.yaml", "show.yaml"],
        &["sim"],
        &["missions"],
        &["stop"],
    ];
    for args in others {
        let ran = session.run(args);
        assert!(!started.exists(), "{args:?} started it: {}", ran.text());
    }
    for mut args in looks {
        args.push("--start-programs");
        session.run(&args).says(0, &[]);
        assert!(started.exists(), "{args:?} did not start it");
        std::fs::remove_file(&started).unwrap();
    }
    session.play(&["run", "show.yaml"]).says(0, &["show: done"]);
    assert!(started.exists());
}

const SECRET: &str = "root:x:0:0:the secret";

/// Creates a project, and next to it the file `secret`, whose content must not be disclosed.
fn outside(fleet: &str, show: &str) -> Session {
    let session = session();
    session.file("secret", SECRET).file("show/arm.yaml", ARM);
    session.file("show/fleet.yaml", fleet).file("show/show.yaml", show);
    session
}

const FLEET: &str = "robots: {left: {init: arm.yaml, address: sim}}\ngroups: {arms: [left]}\n";

#[track_caller]
fn refused(session: &Session, place: &str) {
    let mut command = session.command(&["check", "show.yaml"]);
    command.current_dir(session.path("show"));
    let ran = at_once(command);
    ran.says(2, &["error[DB0057]: this file is outside the project", place, "`--project DIR`"]);
    assert!(!ran.text().contains("root:"), "{}", ran.text());
}

#[test]
fn files_outside_project_are_not_read_when_named_by_other_files() {
    let named = |file: &str| {
        let samples = format!("{{samples: {{file: {file}, time: 1, value: 2}}}}");
        [
            (FLEET.replace("arm.yaml", file), SHOW.to_owned(), "fleet.yaml:1:23"),
            (FLEET.to_owned(), format!("include: {file}\n{SHOW}"), "show.yaml:1:10"),
            (FLEET.to_owned(), format!("include: [{file}]\n{SHOW}"), "show.yaml:1:11"),
            (FLEET.to_owned(), format!("fleet: {file}\n{SHOW}"), "show.yaml:1:8"),
            (
                FLEET.to_owned(),
                SHOW.replace("[{at: 0s, to: 0}, {at: 300ms, to: 20}]", &samples),
                "show.yaml:3:",
            ),
            (
                FLEET.replace("sim}", &format!("sim, body: {{x: 0, y: 0, z: 0, urdf: {file}}}}}")),
                SHOW.to_owned(),
                "fleet.yaml:1:",
            ),
        ]
    };
    for file in
        ["../secret", "/etc/shadow", "/etc/none", "../none/secret", "link", "folder/secret", "/dev/stdin"]
    {
        for (fleet, show, place) in named(file) {
            let session = outside(&fleet, &show);
            symlink("../secret", session.path("show/link")).unwrap();
            symlink("..", session.path("show/folder")).unwrap();
            refused(&session, place);
        }
    }
}

#[test]
fn no_line_of_a_file_that_is_named_by_mistake_is_quoted() {
    for text in [
        "password: \"hunter2\nuser: anna\n",
        "the password: is: hunter2\n",
        "user: hunter1\n  password: hunter2\n",
        "{\"user\": \"hunter1\", \"password\": \"hunter2}\n",
        "user: hunter1\npassword: hunter2\n",
        "- hunter2: 3\n- a: *hunter1\n",
        "- hunter2: 3\n",
        "hunter2",
    ] {
        for file in ["fleet.yaml", "arm.yaml", "parts.yaml"] {
            let session = session();
            session
                .file("show.yaml", format!("include: parts.yaml\n{SHOW}"))
                .file("parts.yaml", "moves: {}\n");
            session.file(file, text);
            for args in [&["check", "show.yaml"][..], &["check", "show.yaml", "--format", "json"]] {
                let ran = Ran(session.command(args).output().unwrap());
                assert!(
                    matches!(ran.code(), 1 | 2) && ran.text().contains(file),
                    "{file}: {text}: {}",
                    ran.text()
                );
                assert!(!ran.text().contains("hunter"), "{file}: {text}: {}", ran.text());
            }
        }
    }
}

#[test]
fn line_of_a_broken_file_of_the_show_is_quoted() {
    for (file, text, line) in [
        ("fleet.yaml", "robots: {left: {init: arm.yaml, address: \"sim}}\n", "fleet.yaml:1:42"),
        ("arm.yaml", "id: arm\ndevices: [{id: a\n", "arm.yaml:2:"),
        ("parts.yaml", "moves:\n  bow: [a\n", "parts.yaml:2:"),
    ] {
        let session = session();
        session.file("show.yaml", format!("include: parts.yaml\n{SHOW}")).file("parts.yaml", "moves: {}\n");
        session.file(file, text).run(&["check", "show.yaml"]).says(1, &[line, text.lines().last().unwrap()]);
    }
}

#[test]
fn operator_can_widen_project_with_option() {
    let session = outside(&FLEET.replace("arm.yaml", "../arm.yaml"), SHOW);
    let check = |args: &[&str]| {
        let mut command = session.command(args);
        Ran(command.current_dir(session.path("show")).output().unwrap())
    };
    // The folder above has a fleet file too, but the nearest one is used.
    check(&["check", "show.yaml"]).says(2, &["DB0057", "fleet.yaml:1:23"]);
    check(&["check", "show.yaml", "--project", ".."]).says(0, &["no errors"]);
    check(&["fleet", "ping"]).says(2, &["DB0057"]);
    check(&["fleet", "ping", "--project", ".."]).says(0, &["left"]);
    check(&["run", "show.yaml", "--project", ".."]).says(0, &["show: done"]);
    check(&["check", "show.yaml", "--project", "none"]).says(2, &["the folder does not exist"]);
    check(&["check", "show.yaml", "--project", "show.yaml"]).says(2, &["it is not a folder"]);
    // A repository is its own project.
    std::fs::create_dir(session.path(".git")).unwrap();
    check(&["check", "show.yaml"]).says(0, &["no errors"]);
}

#[test]
fn pipe_or_device_instead_of_file_is_refused_immediately() {
    for file in ["show.yaml", "fleet.yaml", "arm.yaml", "parts.yaml"] {
        let session = session();
        session.file("show.yaml", format!("include: parts.yaml\n{SHOW}")).file("parts.yaml", "moves: {}\n");
        std::fs::remove_file(session.path(file)).unwrap();
        pipe(&session.path(file));
        at_once(session.command(&["check", "show.yaml"])).says(2, &["this is a pipe, not a file"]);
    }
    let session = session();
    for args in [
        &["check", "/dev/zero"][..],
        &["check", "show.yaml", "--fleet", "/dev/zero"],
        &["report", "/dev/zero"],
    ] {
        at_once(session.command(args)).says(2, &["this is a device, not a file"]);
    }
    pipe(&session.path("pipe"));
    let named = |args: &[&str]| at_once(session.command(args)).says(2, &["this is a pipe, not a file"]);
    named(&["report", "pipe"]);
    named(&["diff", "pipe", "pipe"]);
    named(&["robot", "--init", "pipe"]);
    named(&["dry-run", "show.yaml", "--world", "pipe"]);
    named(&["preflight", "show.yaml", "--require-certificate", "pipe"]);
    named(&["import", "midi", "pipe"]);
    named(&["import", "urdf", "pipe"]);
    named(&["import", "fixture", "pipe"]);
}

#[test]
fn scenario_can_be_read_from_shell_pipe() {
    let (session, program) = (session(), program());
    let mut shell = Command::new("bash");
    shell.arg("-c").arg(format!(
        "'{program}' check <(sleep 0.2; cat show.yaml) && '{program}' check /dev/stdin < show.yaml"
    ));
    shell.current_dir(session.path(""));
    Ran(shell.output().unwrap()).says(0, &["no errors, 2 robots"]);
    let mut piped = Command::new("bash");
    piped
        .arg("-c")
        .arg(format!("cat show.yaml | '{program}' check /dev/stdin"))
        .current_dir(session.path(""));
    Ran(piped.output().unwrap()).says(0, &["no errors, 2 robots"]);
}
