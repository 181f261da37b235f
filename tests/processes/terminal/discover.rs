//! `downbeat discover` on the loopback of this machine.

use std::net::TcpListener;
use std::time::Duration;

use stage::{Stage, Via};

/// Returns the arguments that ask on the loopback alone.
fn args<'a>(port: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["discover", "--interface", "lo", "--wait", "1s", "--port", port], more].concat()
}

#[test]
fn robot_is_found_and_the_written_fleet_reaches_it() {
    let mut stage = Stage::new();
    if stage.path("keys").exists() {
        return; // DOWNBEAT_TLS: the robot describes itself only with a key.
    }
    stage.file("robot.yaml", stage::one_device(1, 200, 20));
    stage.robot("robot.yaml", Via::Direct);
    let port = stage.robots[0].port().to_string();
    let found = stage.run(&args(&port, &["--format", "json", "--fleet", "found.yaml"]));
    assert_eq!(found.code, Some(0), "{found}");
    let json: serde_json::Value = serde_json::from_str(&found.out).unwrap();
    let address = format!("tcp://127.0.0.1:{port}");
    assert_eq!(
        (&json["robots"][0]["address"], &json["robots"][0]["block"]["id"]),
        (&address.into(), &"r0".into())
    );
    let ping = stage.run(&["fleet", "ping", "found.yaml"]);
    assert_eq!(ping.code, Some(0), "{ping}");
    let again = stage.run(&args(&port, &["--fleet", "found.yaml"]));
    assert_eq!(again.code, Some(2), "{again}");
    assert!(again.told.contains("`found.yaml` already exists"), "{again}");
}

#[test]
fn program_that_is_no_robot_and_unknown_interfaces_are_reported() {
    let stage = Stage::new();
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = silent.local_addr().unwrap().port().to_string();
    let began = std::time::Instant::now();
    let found = stage.run(&args(&port, &[]));
    assert_eq!(found.code, Some(0), "{found}");
    assert!(found.out.contains("no description without a key"), "{found}");
    assert!(began.elapsed() < Duration::from_secs(20));
    drop(silent);
    let nothing = stage.run(&args(&port, &[]));
    assert!(nothing.told.contains("nothing answered"), "{nothing}");
    let unknown = stage.run(&["discover", "--interface", "nowhere"]);
    assert_eq!(unknown.code, Some(2), "{unknown}");
    assert!(unknown.told.contains("no interface `nowhere`") && unknown.told.contains("`lo`"), "{unknown}");
}
