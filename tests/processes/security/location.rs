//! The folder of the authority, and the paths of key files in the user's home folder.

use std::process::{Command, Stdio};

use stage::session::{Ran, Session};
use stage::site::listens;
use stage::{Process, free_port};

/// Returns a command of a user whose home folder is `home` in the session's folder, and who has set no other variable.
fn at_home(session: &Session, args: &[&str]) -> Command {
    let mut command = session.command(args);
    command.env_remove("DOWNBEAT_KEYS").env_remove("XDG_DATA_HOME").env("HOME", session.path("home"));
    command
}

fn run(session: &Session, args: &[&str]) -> Ran {
    Ran(at_home(session, args).output().unwrap())
}

#[test]
fn authority_is_in_data_folder_and_fleet_file_finds_its_keys_by_tilde() {
    let session = Session::new();
    let identity = "identity: ~/.local/share/downbeat/keys/operators/";
    let revoked = "revoked: ~/.local/share/downbeat/keys/revoked.pem\n";
    let folder = session.path("home/.local/share/downbeat/keys");
    run(&session, &["keys", "init"])
        .says(0, &[&format!("created an authority in {}", folder.display()), identity, revoked]);
    assert!(!session.path("keys").exists());
    run(&session, &["keys", "robot", "arm"]).says(0, &[]);
    run(&session, &["keys", "operator", "anna", "--role", "observe"]).says(0, &[]);
    run(&session, &["keys", "list"]).says(0, &["arm", "anna"]);

    let robots = format!("robots: {{arm: {{init: arm.yaml, address: 'tls://127.0.0.1:{}'}}}}\n", free_port());
    session.file("fleet.yaml", format!("{identity}anna.pem\n{revoked}{robots}"));
    let keys = folder.display().to_string();
    let mut sim = at_home(&session, &["sim", "--keys", &keys]).stdout(Stdio::piped()).spawn().unwrap();
    listens(&mut sim);
    let _sim = Process(sim);
    run(&session, &["fleet", "ping"]).says(0, &["arm"]);

    // The variable of the environment, which no shell has expanded.
    session.file("fleet.yaml", robots);
    let mut ping = at_home(&session, &["fleet", "ping"]);
    ping.env("DOWNBEAT_IDENTITY", "~/.local/share/downbeat/keys/operators/anna.pem");
    Ran(ping.output().unwrap()).says(0, &["arm"]);
    // This user does not exist.
    let mut ping = at_home(&session, &["fleet", "ping"]);
    ping.env("DOWNBEAT_IDENTITY", "~nobody/anna.pem");
    Ran(ping.output().unwrap()).says(1, &["~nobody/anna.pem"]);
}

#[test]
fn variables_name_the_folder_and_without_them_nothing_is_created() {
    let session = Session::new();
    let init = |variables: &[(&str, &str)]| {
        let mut command = at_home(&session, &["keys", "init"]);
        command.env_remove("HOME").envs(variables.iter().copied());
        Ran(command.output().unwrap())
    };
    init(&[]).says(2, &["no folder for keys: HOME is not set", "--keys"]);
    init(&[("XDG_DATA_HOME", "data")]).says(2, &["no folder for keys: HOME is not set"]);
    assert!(!session.path("data").exists());
    let data = session.path("data").display().to_string();
    init(&[("XDG_DATA_HOME", &data)]).says(0, &[&format!("{data}/downbeat/keys")]);
    init(&[("XDG_DATA_HOME", &data), ("DOWNBEAT_KEYS", "my keys")])
        .says(0, &["created an authority in my keys", "identity: \"my keys/operators/NAME.pem\""]);
    assert!(session.path("data/downbeat/keys/authority.key").exists());
    assert!(session.path("my keys/authority.key").exists());
}

#[test]
fn authority_in_the_former_default_folder_is_pointed_out() {
    let session = Session::new();
    session.run(&["keys", "init", "--keys", "keys"]).says(0, &["keys/authority.key"]);
    for args in [&["keys", "robot", "arm"][..], &["keys", "list"], &["keys", "init"]] {
        run(&session, args).says(2, &["but the folder `keys` does", "`--keys keys`"]);
    }
    assert!(!session.path("home").exists(), "nothing was created");
    run(&session, &["keys", "robot", "arm", "--keys", "keys"]).says(0, &["arm"]);
    run(&session, &["keys", "init", "--keys", "others"]).says(0, &["others"]);
}
