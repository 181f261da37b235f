//! Checks that only the intended robot moves. The robots are processes, and some addresses lead to a wrong robot.

use std::time::Duration;

use stage::play::{LONG, Play, SHORT};
use stage::quiet::stays;
use stage::session::Session;
use stage::{Ended, Stage, Via};

/// Writes a fleet file. Each row of `places` contains the index of a robot, the index of the robot whose port it gets, and further keys.
fn addresses(stage: &Stage, places: &[(usize, usize, &str)]) {
    let row = |(robot, at, more): &(usize, usize, &str)| {
        let port = stage.robots[*at].port();
        format!("  r{robot}: {{init: robot.yaml, address: \"tcp://127.0.0.1:{port}\"{more}}}\n")
    };
    let rows: String = places.iter().map(row).collect();
    let ids: Vec<String> = places.iter().map(|(robot, ..)| format!("r{robot}")).collect();
    stage.file("fleet.yaml", format!("robots:\n{rows}groups:\n  all: [{}]\n", ids.join(", ")));
}

fn swapped(play: &Play) -> Stage {
    let stage = play.stage(&[Via::Direct, Via::Direct]);
    addresses(&stage, &[(0, 1, ""), (1, 0, "")]);
    stage
}

#[track_caller]
fn says(ended: &Ended, code: i32, parts: &[&str]) {
    assert_eq!(ended.code, Some(code), "{ended}");
    let text = format!("{}{}", ended.told, ended.out);
    for part in parts {
        assert!(text.contains(part), "`{part}` is missing in:\n{text}");
    }
}

#[track_caller]
fn has_another_robot(ended: &Ended, robot: &str, told: &str) {
    let report = ended.report();
    let failures = report["failures"].as_array().unwrap();
    let found = failures.iter().any(|failure| {
        failure["robot"] == robot && failure["failure"] == "another_robot" && failure["told"] == told
    });
    assert!(found, "{report}");
}

#[test]
fn robots_with_swapped_addresses_do_not_move() {
    let stage = swapped(&SHORT);
    for command in [&["preflight", "play.yaml"][..], &["run", "play.yaml"]] {
        let ended = stage.run(command);
        says(&ended, 1, &["its id is `r1`", "its id is `r0`"]);
    }
    let ended = stage.run(&["run", "play.yaml", "--format", "json"]);
    assert_eq!(ended.report()["outcome"], "not_started", "{ended}");
    has_another_robot(&ended, "r0", "r1");
    has_another_robot(&ended, "r1", "r0");
    for robot in &stage.robots {
        assert!(robot.log().is_empty(), "{:?}", robot.log());
    }
}

#[test]
fn ping_reports_two_swapped_addresses() {
    let stage = swapped(&SHORT);
    says(&stage.run(&["fleet", "ping"]), 1, &["its id is `r1`", "its id is `r0`"]);
    says(&stage.run(&["fleet", "show"]), 1, &["its id is `r1`"]);
}

#[test]
fn robot_with_the_id_from_the_fleet_file_is_accepted() {
    let stage = SHORT.stage(&[Via::Direct, Via::Direct]);
    addresses(&stage, &[(0, 1, ", robot_id: r1"), (1, 0, ", robot_id: r0")]);
    says(&stage.run(&["fleet", "ping"]), 0, &["yes"]);
    says(&stage.run(&["preflight", "play.yaml"]), 0, &["ready"]);
    says(&stage.run(&["run", "play.yaml"]), 0, &["play: done"]);
    stage.robots.iter().for_each(|robot| SHORT.was_played_by(robot));
}

#[test]
fn preflight_reports_that_robot_ids_are_unknown_without_handshake() {
    let stage = swapped(&SHORT);
    let fleet = std::fs::read_to_string(stage.path("fleet.yaml")).unwrap();
    stage.file("fleet.yaml", format!("handshake: skip\n{fleet}"));
    says(&stage.run(&["preflight", "play.yaml"]), 0, &["`handshake: skip`", "`downbeat fleet ping`"]);
    says(&stage.run(&["fleet", "ping"]), 1, &["its id is `r1`"]);
}

/// While both robots play, the proxy of `r0` is redirected to another robot, `r2`.
#[test]
fn robot_taking_over_an_address_receives_nothing_and_predecessor_fails() {
    let stage = LONG.stage(&[Via::Proxy, Via::Direct, Via::Direct]);
    let link = stage.robots[0].link.as_ref().unwrap();
    let fleet = format!(
        "robots:\n  r0: {{init: robot.yaml, address: \"tcp://127.0.0.1:{}\"}}\n  r1: {{init: robot.yaml, address: \"tcp://127.0.0.1:{}\"}}\ngroups: {{all: [r0, r1]}}\n",
        link.port,
        stage.robots[1].port()
    );
    stage.file("fleet.yaml", fleet);
    let run = stage.begin(&["run", "play.yaml", "--patience", "2s", "--format", "json"], [0], 5);
    link.lead_to(stage.robots[2].port());
    link.interrupt();
    link.open();
    let ended = run.ended();
    has_another_robot(&ended, "r0", "r2");
    assert_eq!(ended.report()["outcome"], "failed", "{ended}");
    assert_eq!(ended.report()["robots"][0]["stop"]["state"], "unconfirmed", "{ended}");
    assert_eq!(ended.code, Some(4), "{ended}");
    assert!(stage.robots[2].sets().is_empty(), "{:?}", stage.robots[2].log());
}

#[test]
fn same_named_process_cannot_confirm_stop_while_the_robot_may_move() {
    let mut stage = Play { running: "3s", ..LONG }.stage(&[Via::Proxy]);
    let other = stage.robot_called("r0", "robot.yaml", Vec::new());
    let run = stage.begin(&["run", "play.yaml", "--patience", "1s", "--format", "json"], [0], 5);
    let link = stage.robots[0].link.as_ref().unwrap();
    link.lead_to(other);
    link.interrupt();
    link.open();
    let ended = run.ended();
    assert_eq!(ended.report()["outcome"], "failed", "{ended}");
    assert_eq!(ended.report()["robots"][0]["stop"]["state"], "unconfirmed", "{ended}");
    assert_eq!(ended.code, Some(4), "{ended}");
    assert!(stage.robots[1].sets().is_empty(), "{:?}", stage.robots[1].log());
}

#[test]
fn same_robot_continues_after_reconnecting() {
    let play = Play { steps: 30, running: "2s", ..LONG };
    let stage = play.stage(&[Via::Proxy, Via::Direct]);
    let run = stage.begin(&["run", "play.yaml"], [0], 5);
    let link = stage.robots[0].link.as_ref().unwrap();
    link.interrupt();
    link.open();
    says(&run.ended(), 0, &["play: done"]);
    stage.robots.iter().for_each(|robot| play.was_played_by(robot));
}

/// Plays a mission and kills its scheduler. Then replaces the robot `r0` by another one, `stranger`.
fn left_behind() -> Stage {
    let mut stage = Play { running: "20s", ..LONG }.stage(&[Via::Direct, Via::Direct]);
    let mut run = stage.begin(&["run", "play.yaml"], [0], 5);
    run.process.kill();
    stage.replace(0, "stranger");
    stage
}

#[test]
fn another_robot_cannot_confirm_a_stop_after_a_crash() {
    let stage = left_behind();
    let since = stage.robots[0].log().len();
    let stopped = stage.run(&["stop", "--patience", "2s"]);
    says(&stopped, 4, &["r0", "another robot", "its id is `stranger`", "r0: stop NOT confirmed"]);
    says(&stopped, 4, &["r1: stop confirmed"]);
    // Also if several missions are possible targets, with the missions' results.
    let again = stage.run(&["stop", "--all", "--patience", "2s"]);
    says(&again, 4, &["  r0: stop NOT confirmed"]);
    assert!(again.out.contains("  r0: another robot answers at its address"), "{again}");
    // It belongs to no session and would accept a stop: it was sent none.
    assert!(stage.robots[0].log_since(since).is_empty(), "{:?}", stage.robots[0].log());
}

#[test]
fn stop_after_crash_reaches_unidentified_robot_but_remains_unconfirmed() {
    let play = Play { running: "none", steps: 200, every_ms: 200, ..LONG };
    let stage = play.stage(&[Via::Proxy, Via::Direct]);
    let mut run = stage.begin(&["run", "play.yaml"], [0], 5);
    run.process.kill();
    stage.robots[0].link.as_ref().unwrap().rewrite(|message| {
        if message.get("initialization_block").is_some() {
            let at = "2026-11-20T19:00:00.000000000Z";
            *message = serde_json::json!({"availability_response":
                {"timestamp": at, "receive_timestamp": at, "originate_timestamp": null, "status": "OK"}});
        }
    });
    let stopped = stage.run(&["stop", "--patience", "2s"]);
    says(&stopped, 4, &["r0: stop NOT confirmed", "r1: stop confirmed"]);
    stage.await_rest();
    // Its steps would occur every 200 ms.
    let sets = stays(Duration::from_secs(1), || stage.robots[0].sets().len());
    assert!(sets < 180, "it played on to its end: {sets} of 200");
}

#[test]
fn robot_taking_over_an_address_receives_no_stop_from_the_mission() {
    let stage = LONG.stage(&[Via::Proxy, Via::Direct, Via::Direct]);
    let link = stage.robots[0].link.as_ref().unwrap();
    let fleet = std::fs::read_to_string(stage.path("fleet.yaml")).unwrap();
    stage.file("fleet.yaml", fleet.replace("[r0, r1, r2]", "[r0, r1]"));
    let run = stage.begin(&["run", "play.yaml", "--patience", "2s", "--format", "json"], [0], 5);
    link.lead_to(stage.robots[2].port());
    let since = stage.robots[2].log().len();
    link.interrupt();
    link.open();
    let ended = run.ended();
    has_another_robot(&ended, "r0", "r2");
    assert!(stage.robots[2].log_since(since).is_empty(), "{:?}", stage.robots[2].log());
}

#[test]
fn mission_is_not_resumed_on_another_robot() {
    let stage = left_behind();
    let before = stage.robots[0].sets().len();
    let resumed = stage.run(&["resume", "--patience", "2s", "--format", "json"]);
    assert!(resumed.code.is_some_and(|code| code != 0), "{resumed}");
    has_another_robot(&resumed, "r0", "stranger");
    assert_eq!(stage.robots[0].sets().len(), before);
}

#[test]
fn duplicate_robot_addresses_are_reported_in_any_notation() {
    let session = Session::new();
    let fleet = |left: &str, right: &str| {
        let row = |id: &str, address: &str| format!("  {id}: {{init: arm.yaml, address: '{address}'}}\n");
        let robots = format!("{}{}", row("left", left), row("right", right));
        format!("robots:\n{robots}groups: {{arms: [left, right]}}\ninsecure: true\n")
    };
    session.file(
        "test.yaml",
        "scenario: test\ncues: [{at: 0s, robots: arms, tracks: {shoulder: [{at: 0s, to: 0}]}}]\n",
    );
    let same = [
        ("tcp://192.0.2.7:7401", "tcp://192.0.2.7:7401"),
        ("tcp://localhost:7401", "tcp://127.0.0.1:7401"),
        ("tcp://Stage.local:7401", "tcp://stage.local.:7401"),
        ("tcp://[::1]:7401", "tcp://localhost:7401"),
        ("tcp://[2001:db8::1]:7401", "tcp://[2001:DB8:0::1]:7401"),
        ("tcp://[::ffff:192.0.2.7]:7401", "tcp://192.0.2.7:7401"),
    ];
    for (left, right) in same {
        session.file("fleet.yaml", fleet(left, right));
        let checked = session.run(&["check", "test.yaml"]);
        checked.says(1, &["DB0050", "`left`", "`right`", "fleet.yaml:3:", "fleet.yaml:2:"]);
    }
    for (left, right) in [
        ("tcp://192.0.2.7:7401", "tcp://192.0.2.7:7402"),
        ("tcp://192.0.2.7:7401", "tcp://192.0.2.8:7401"),
        ("tcp://127.0.0.1:7401", "tcp://127.0.0.2:7401"),
        ("sim", "sim"),
    ] {
        session.file("fleet.yaml", fleet(left, right));
        session.run(&["check", "test.yaml"]).says(0, &["no errors"]);
    }
}

#[test]
fn invalid_robot_id_is_reported_at_its_location() {
    let session = Session::new();
    session.file(
        "test.yaml",
        "scenario: test\ncues: [{at: 0s, robots: left, tracks: {shoulder: [{at: 0s, to: 0}]}}]\n",
    );
    for wrong in ["''", "[a]"] {
        session.file(
            "fleet.yaml",
            format!("robots:\n  left: {{init: arm.yaml, address: sim, robot_id: {wrong}}}\n"),
        );
        session
            .run(&["check", "test.yaml"])
            .says(1, &["DB0003", "fleet.yaml:2:50", "the id that the robot declares"]);
    }
}

#[test]
fn robot_with_the_id_from_the_fleet_file_is_stopped_after_a_crash() {
    let stage = LONG.stage(&[Via::Direct, Via::Direct]);
    addresses(&stage, &[(0, 1, ", robot_id: r1"), (1, 0, ", robot_id: r0")]);
    let mut run = stage.begin(&["run", "play.yaml"], [0], 5);
    run.process.kill();
    says(&stage.run(&["stop"]), 0, &["r0: stop confirmed", "r1: stop confirmed"]);
}
