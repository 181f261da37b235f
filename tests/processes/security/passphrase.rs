//! The passphrase of the authority's key, in a file and typed on a terminal.

use std::os::unix::fs::PermissionsExt;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use stage::Process;
use stage::session::{Ran, Session, program};
use stage::terminal::Terminal;

/// The time within which the program asks, or ends. It derives a key from the passphrase.
const ASKED_WITHIN: Duration = Duration::from_secs(30);

fn passphrase_file(session: &Session, name: &str, passphrase: &str) {
    session.file(name, format!("{passphrase}\n"));
    std::fs::set_permissions(session.path(name), std::fs::Permissions::from_mode(0o600)).unwrap();
}

/// Runs a command whose passphrase is in this file.
fn with_file(session: &Session, name: &str, args: &[&str]) -> Ran {
    Ran(session.command(args).env("DOWNBEAT_PASSPHRASE_FILE", name).stdin(Stdio::null()).output().unwrap())
}

#[test]
fn file_states_the_passphrase_and_only_signing_needs_it() {
    let session = Session::new();
    passphrase_file(&session, "sesame", "open sesame");
    passphrase_file(&session, "barley", "open barley");
    let without = |args: &[&str]| Ran(session.command(args).stdin(Stdio::null()).output().unwrap());
    without(&["keys", "init", "--passphrase"]).says(
        2,
        &["cannot ask for a passphrase: standard input is not a terminal", "DOWNBEAT_PASSPHRASE_FILE"],
    );
    with_file(&session, "none", &["keys", "init", "--passphrase"]).says(2, &["none: No such file"]);
    without(&["keys", "list"]).says(2, &["contains no authority"]);
    with_file(&session, "sesame", &["keys", "init", "--passphrase"]).says(0, &["created an authority"]);
    with_file(&session, "sesame", &["keys", "robot", "arm"]).says(0, &["arm"]);
    without(&["keys", "robot", "arm-2"])
        .says(2, &["keys/authority.key has a passphrase, and there is no terminal to ask for it"]);
    with_file(&session, "barley", &["keys", "robot", "arm-2"])
        .says(2, &["wrong passphrase for keys/authority.key"]);
    without(&["keys", "list"]).says(0, &["arm"]);
    without(&["keys", "secret", "mcu1"]).says(0, &["mcu1"]);
    session.file("fleet.yaml", "robots: {arm: {init: arm.yaml, address: 'tls://127.0.0.1:1'}}\n");
    // The list is current; no robot answers.
    without(&["keys", "push", "--patience", "1s"]).says(1, &["arm: "]);

    with_file(&session, "sesame", &["keys", "passphrase", "--new", "barley"])
        .says(0, &["has a new passphrase"]);
    with_file(&session, "sesame", &["keys", "revoke", "arm"]).says(2, &["wrong passphrase"]);
    with_file(&session, "barley", &["keys", "revoke", "arm"]).says(0, &["revoked 1 key"]);
    with_file(&session, "barley", &["keys", "passphrase", "--remove"]).says(0, &["has no passphrase"]);
    without(&["keys", "robot", "arm"]).says(0, &["arm"]);
    with_file(&session, "sesame", &["keys", "passphrase"]).says(0, &["keys/authority.key has a passphrase;"]);
    without(&["keys", "robot", "arm-2"]).says(2, &["has a passphrase"]);
    std::fs::set_permissions(session.path("sesame"), std::fs::Permissions::from_mode(0o644)).unwrap();
    with_file(&session, "sesame", &["keys", "robot", "arm-2"]).says(2, &["other users can read"]);
}

#[test]
fn both_keys_of_a_replacement_have_the_passphrase() {
    let session = Session::new();
    passphrase_file(&session, "sesame", "open sesame");
    passphrase_file(&session, "barley", "open barley");
    let by = |name: &str, args: &[&str]| with_file(&session, name, &[&["keys"], args].concat());
    by("sesame", &["init", "--passphrase"]).says(0, &[]);
    by("sesame", &["robot", "arm"]).says(0, &[]);
    by("barley", &["rotate"]).says(2, &["wrong passphrase for keys/authority.key"]);
    by("sesame", &["rotate"]).says(0, &["keep a copy of successor.key"]);
    by("sesame", &["passphrase", "--new", "barley"])
        .says(0, &["keys/authority.key has a new passphrase", "keys/successor.key has a new passphrase"]);
    by("sesame", &["renew", "--all"]).says(2, &["wrong passphrase for keys/successor.key"]);

    session.run(&["keys", "request", "robot", "arm-2"]).says(0, &[]);
    by("barley", &["sign", "arm-2.csr"])
        .says(0, &["fingerprint of the authority: ", "fingerprint of the old authority: "]);
    session.run(&["keys", "install", "arm-2.crt"]).says(
        0,
        &[
            "robot arm-2: arm-2.pem is complete",
            "fingerprint of the authority, which it trusts: ",
            "fingerprint of the old authority, which it trusts: ",
        ],
    );
    by("barley", &["renew", "--all"]).says(0, &["robot arm: keys/robots/arm.pem"]);
    by("sesame", &["rotate", "--end"]).says(2, &["wrong passphrase for keys/authority.key"]);
    by("barley", &["rotate", "--end"]).says(0, &["its key was deleted"]);
    by("barley", &["robot", "arm-3"]).says(0, &["arm-3"]);
}

#[expect(clippy::print_stderr, reason = "says that the test shows nothing")]
#[test]
fn openssl_reads_the_protected_key() {
    if Command::new("openssl").arg("version").output().is_err() {
        eprintln!("no `openssl`: this test shows nothing here");
        return;
    }
    let session = Session::new();
    passphrase_file(&session, "sesame", "open sesame");
    with_file(&session, "sesame", &["keys", "init", "--passphrase"]).says(0, &[]);
    let openssl = |args: &[&str]| {
        Ran(Command::new("openssl").args(args).current_dir(session.path("keys")).output().unwrap())
    };
    let decrypt = ["pkcs8", "-in", "authority.key", "-passin", "file:../sesame"];
    openssl(&decrypt).says(0, &["-----BEGIN PRIVATE KEY-----"]);
    let key = openssl(&["pkey", "-in", "authority.key", "-passin", "file:../sesame", "-pubout"]).out();
    let certified = openssl(&["x509", "-in", "authority.pem", "-noout", "-pubkey"]).out();
    assert_eq!(key, certified);
    passphrase_file(&session, "barley", "open barley");
    let refused = openssl(&["pkcs8", "-in", "authority.key", "-passin", "file:../barley"]);
    assert_ne!(refused.code(), 0);
    // A key that OpenSSL has encrypted by its defaults.
    let plain = openssl(&decrypt).out();
    session.file("keys/plain.key", plain);
    let encrypt = [
        "pkcs8",
        "-topk8",
        "-v2",
        "aes-256-cbc",
        "-in",
        "plain.key",
        "-passout",
        "file:../barley",
        "-out",
        "authority.key",
    ];
    openssl(&encrypt).says(0, &[]);
    with_file(&session, "barley", &["keys", "robot", "arm"]).says(0, &["arm"]);
}

/// Starts a command on a terminal, as the first process of a session that this terminal controls.
fn on_terminal(session: &Session, terminal: &Terminal, args: &[&str]) -> Process {
    let mut command = Command::new("setsid");
    command.args(["--ctty", program()]).args(args).current_dir(session.path(""));
    command.env("DOWNBEAT_KEYS", "keys").env_remove("DOWNBEAT_PASSPHRASE_FILE");
    terminal.attach(&mut command);
    Process(command.spawn().unwrap())
}

/// Types keys once the terminal no longer shows them. `settings` are those that show them.
fn type_hidden(terminal: &Terminal, settings: &str, keys: &str) {
    let begun = Instant::now();
    while terminal.settings() == settings {
        assert!(begun.elapsed() < ASKED_WITHIN, "the terminal still shows its input");
        std::thread::sleep(Duration::from_millis(5));
    }
    terminal.type_keys(keys);
}

#[test]
fn typed_passphrase_is_not_shown_and_must_be_repeated() {
    let session = Session::new();
    let init = |entries: &[&str]| {
        let terminal = Terminal::new(120, 30);
        let (watched, settings) = (terminal.watch(), terminal.settings());
        let mut process = on_terminal(&session, &terminal, &["keys", "init", "--passphrase"]);
        let prompts = ["new passphrase for keys/authority.key: ", "the same passphrase again: "];
        for (prompt, entry) in prompts.iter().zip(entries) {
            watched.shows(prompt.trim_end(), ASKED_WITHIN);
            type_hidden(&terminal, &settings, entry);
        }
        let code = process.0.wait().unwrap().code();
        terminal.settle(&watched);
        assert_eq!(terminal.settings(), settings, "the terminal is as before");
        (code, watched.screen())
    };
    let (code, screen) = init(&["sesame\r", "sesam\r"]);
    assert!(code == Some(2) && screen.contains("the two passphrases differ"), "{screen}");
    let (code, screen) = init(&["\r"]);
    assert!(code == Some(2) && screen.contains("the passphrase is empty"), "{screen}");
    let (code, screen) = init(&["sesame\u{3}"]);
    assert!(code == Some(2) && screen.contains("cannot ask for a passphrase: interrupted"), "{screen}");
    assert!(!session.path("keys/authority.key").exists());
    let (code, screen) = init(&["open sesame\r", "open sesame\r"]);
    assert!(code == Some(0) && !screen.contains("open sesame"), "{screen}");

    let terminal = Terminal::new(120, 30);
    let (watched, settings) = (terminal.watch(), terminal.settings());
    let mut process = on_terminal(&session, &terminal, &["keys", "robot", "arm", "arm-2"]);
    watched.shows("passphrase for keys/authority.key:", ASKED_WITHIN);
    type_hidden(&terminal, &settings, "open sesame\r");
    watched.shows("robot arm-2", ASKED_WITHIN);
    assert_eq!(process.0.wait().unwrap().code(), Some(0));
    assert_eq!(watched.screen().matches("passphrase for").count(), 1, "the question appears once");
}
