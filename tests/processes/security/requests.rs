//! Keys that are made on the machines that use them, and signed by the authority.

use std::process::Stdio;

use stage::session::{Ran, Session};
use stage::site::listens;
use stage::{Process, free_port};

/// Returns the fingerprint of the key in the JSON output of `keys request`.
fn fingerprint(ran: &Ran) -> String {
    ran.json()["fingerprint"].as_str().unwrap().to_owned()
}

#[test]
fn robot_and_operator_with_requested_keys_accept_each_other() {
    let session = Session::new();
    for folder in ["robot", "anna"] {
        std::fs::create_dir(session.path(folder)).unwrap();
    }
    session.run(&["keys", "init"]).says(0, &[]);
    let request = ["keys", "request", "robot", "arm", "--out", "robot", "--format", "json"];
    let of_robot = fingerprint(&session.run(&request));
    session.run(&request).says(1, &["robot/arm.pem exists, and is not replaced"]);
    let request =
        ["keys", "request", "operator", "anna", "--role", "drive,seize", "--out", "anna", "--format", "json"];
    let of_anna = fingerprint(&session.run(&request));

    session
        .run(&["keys", "sign", "robot/arm.csr", "--fingerprint", &of_anna])
        .says(2, &["robot/arm.csr: the key has the fingerprint", &of_robot, &of_anna]);
    session
        .run(&["keys", "sign", "anna/anna.csr"])
        .says(2, &["asks for the roles drive, seize", "add --role"]);
    session.run(&["keys", "sign", "robot/arm.csr", "--role", "drive"]).says(2, &["robots have no roles"]);
    session.run(&["keys", "list"]).says(0, &[]);
    assert!(!session.path("robot/arm.crt").exists());

    session
        .run(&["keys", "sign", "robot/arm.csr", "--fingerprint", &of_robot.to_uppercase()])
        .says(0, &["robot arm: robot/arm.crt, valid for 365 days", &of_robot, "send robot/arm.crt,"]);
    session.run(&["keys", "secret", "mcu1"]).says(0, &[]);
    session.run(&["keys", "sign", "anna/anna.csr", "--role", "observe", "--days", "90"]).says(
        0,
        &[
            "valid for 90 days",
            "granted: observe; the request asked for the roles drive, seize",
            &of_anna,
            "before you send the certificate, compare it",
            "send anna/anna.crt and keys/operators/anna.passes",
        ],
    );
    session.run(&["keys", "sign", "robot/arm.csr"]).says(1, &["already has a certificate", "--renew"]);
    session.run(&["keys", "renew", "arm"]).says(2, &["`downbeat keys request robot arm`"]);

    session
        .run(&["keys", "install", "robot/arm.crt", "--key", "anna/anna.pem"])
        .says(2, &["does not belong to the key"]);
    session.run(&["keys", "install", "robot/arm.crt"]).says(0, &["robot arm: robot/arm.pem is complete"]);
    session.run(&["keys", "install", "anna/anna.crt"]).says(0, &["operator anna: anna/anna.pem is complete"]);

    let listen = format!("127.0.0.1:{}", free_port());
    let robot = [
        "robot",
        "--init",
        "arm.yaml",
        "--listen",
        &listen,
        "--identity",
        "robot/arm.pem",
        "--revoked",
        "keys/revoked.pem",
    ];
    let mut robot = session.command(&robot).stdout(Stdio::piped()).spawn().unwrap();
    listens(&mut robot);
    let _robot = Process(robot);
    session.file(
        "fleet.yaml",
        format!("identity: anna/anna.pem\nrobots: {{arm: {{init: arm.yaml, address: 'tls://{listen}'}}}}\n"),
    );
    session.run(&["fleet", "ping"]).says(0, &["arm"]);
    session.run(&["keys", "revoke", "--operator", "anna"]).says(0, &["revoked 1"]);
    session.run(&["fleet", "ping"]).says(1, &["revoked"]);
}

#[test]
fn unusable_names_and_requests_make_and_sign_nothing() {
    let session = Session::new();
    session.run(&["keys", "init"]).says(0, &[]);
    session.run(&["keys", "request", "robot", ""]).says(2, &["`` cannot be a name"]);
    session.run(&["keys", "request", "operator", " "]).says(2, &["expected a name of 1 to 256 characters"]);
    session.run(&["keys", "request", "robot", "cf1", "--role", "drive"]).says(2, &["robots have no roles"]);
    session
        .run(&["keys", "request", "robot", "cf1", "--out", "none"])
        .says(2, &["none/cf1.pem: No such file"]);
    let files = std::fs::read_dir(session.path("")).unwrap().count();
    session.file("x.csr", "no request");
    session.run(&["keys", "sign", "x.csr"]).says(2, &["x.csr: this is not a request for a certificate"]);
    session.run(&["keys", "sign", "y.csr"]).says(2, &["y.csr: No such file"]);
    session.run(&["keys", "sign", "."]).says(2, &["not a regular file"]);
    session.run(&["keys", "sign", "x.csr", "--fingerprint", "3f:a2"]).says(2, &["64 hexadecimal digits"]);
    session.run(&["keys", "install", "x.csr"]).says(2, &["x.csr: this is not a certificate that"]);
    assert_eq!(std::fs::read_dir(session.path("")).unwrap().count(), files + 1);
    let listed = session.run(&["keys", "list", "--format", "json"]).json();
    assert_eq!(listed["certificates"].as_array().unwrap().len(), 0);
}

#[test]
fn names_with_requested_keys_are_left_to_new_requests_when_the_authority_is_replaced() {
    let session = Session::new();
    session.run(&["keys", "init"]).says(0, &[]);
    session.run(&["keys", "robot", "cf1"]).says(0, &[]);
    session.run(&["keys", "request", "robot", "arm"]).says(0, &[]);
    session.run(&["keys", "sign", "arm.csr"]).says(0, &[]);
    session.run(&["keys", "rotate"]).says(0, &[]);
    session.run(&["keys", "renew", "--all"]).says(
        0,
        &["robot cf1: keys/robots/cf1.pem", "robot arm: not renewed: ", "`downbeat keys request robot arm`"],
    );
    session.run(&["keys", "rotate", "--end"]).says(1, &["robot arm has only a key of the old authority"]);
    let again = session.run(&["keys", "renew", "--all", "--format", "json"]).json();
    assert_eq!(again, serde_json::json!({ "keys": [], "requested": ["robot arm"] }));
    std::fs::create_dir(session.path("second")).unwrap();
    session.run(&["keys", "request", "robot", "arm", "--out", "second"]).says(0, &[]);
    session.run(&["keys", "sign", "second/arm.csr", "--renew"]).says(0, &[]);
    session.run(&["keys", "renew", "--all"]).says(0, &["every name with a valid key has one"]);
    session.run(&["keys", "rotate", "--end"]).says(0, &[]);
}
