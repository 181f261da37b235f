//! Missions in everyday use: several acts, commands from other terminals, and crashes.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::time::Duration;

use stage::quiet::await_that;
use stage::session::{Ran, Session, arm_at};
use stage::{Logged, Process, Proxy, free_port};

const TWO_ACTS: &str = "scenario: evening
start_tolerance: 1s
acts:
  - act: opening
    cues:
      - cue: up
        robots: arms
        at: 0s
        tracks:
          shoulder: [{at: 0s, to: 0}, {at: 400ms, to: 20}]
  - act: finale
    WAIT
    cues:
      - cue: down
        robots: arms
        at: 0s
        tracks:
          shoulder: [{at: 0s, to: 20}, {at: 400ms, to: 0}]
";

pub fn evening(wait: &str) -> Session {
    let session = Session::new();
    session.file("evening.yaml", TWO_ACTS.replace("WAIT", wait));
    session
}

/// Starts a mission, and waits until it prints the text `says`.
fn start(session: &Session, args: &[&str], says: &str) -> Process {
    start_command(session.command(args), says).0
}

/// Starts a command, and waits until it prints the text `says`. Returns everything that it has printed until then.
pub fn start_command(mut command: Command, says: &str) -> (Process, String) {
    let mut child = Process(command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap());
    let mut lines = BufReader::new(child.0.stderr.take().unwrap());
    let mut told = String::new();
    while !told.contains(says) {
        assert!(lines.read_line(&mut told).unwrap() > 0, "never said `{says}`:\n{told}");
    }
    // Further output must not block it.
    std::thread::spawn(move || lines.lines().count());
    (child, told)
}

fn finished(mut child: Process) -> Ran {
    let status = child.0.wait().unwrap();
    let mut out = Vec::new();
    std::io::Read::read_to_end(&mut child.0.stdout.take().unwrap(), &mut out).unwrap();
    Ran(std::process::Output { status, stdout: out, stderr: Vec::new() })
}

#[test]
fn acts_play_in_sequence_and_each_is_reported() {
    let session = evening("wait: done");
    let ran = session.run(&["run", "evening.yaml", "--format", "json"]);
    assert_eq!(ran.code(), 0, "{}", ran.text());
    let report = ran.json();
    let acts: Vec<_> =
        report["acts"].as_array().unwrap().iter().map(|act| act["act"].as_str().unwrap()).collect();
    assert_eq!(acts, ["opening", "finale"]);
    assert_eq!(report["robots"][0]["steps_done"], 4);
    assert_eq!(report["robots"][0]["scripts"], 2);
}

#[test]
fn device_with_two_script_slots_plays_two_acts_without_gap() {
    let session = evening("wait: done");
    let arm =
        stage::session::ARM.replace("interpolation: linear", "interpolation: linear\n    script_queue: 2");
    session.file("arm.yaml", arm);
    let ran = session.run(&["dry-run", "evening.yaml", "--format", "json"]);
    assert_eq!(ran.code(), 0, "{}", ran.text());
    // The act of 400 ms is shorter than the lead; a longer one leaves time to prepare the next.
    let long = TWO_ACTS.replace("WAIT", "").replace("at: 400ms", "at: 3s");
    session.file("long.yaml", long);
    let report = session.run(&["dry-run", "long.yaml", "--format", "json"]).json();
    assert_eq!(report["acts"][1]["gap_ms"], 0, "{report}");
}

#[test]
fn operator_starts_an_act_from_another_terminal() {
    let session = evening("wait: operator");
    let child =
        start(&session, &["run", "evening.yaml", "--format", "text"], "`finale` waits for the operator's go");
    session.run(&["missions"]).says(0, &["running", "2 robots"]);
    session.run(&["go"]).says(0, &[]);
    finished(child).says(0, &["evening: done", "finale"]);
    session.run(&["missions"]).says(0, &["no mission is running"]);
    session.run(&["go"]).says(2, &["no mission is running"]);
}

#[test]
fn mission_is_stopped_from_another_terminal() {
    let session = evening("wait: operator");
    let child = start(&session, &["run", "evening.yaml"], "waits for the operator's go");
    session.run(&["stop"]).says(0, &["left: stop confirmed", "right: stop confirmed"]);
    finished(child).says(3, &["stopped by the operator"]);
}

#[test]
fn rehearsal_runs_at_lower_speed_with_fewer_robots_from_a_later_act() {
    let session = evening("wait: operator");
    let args = [
        "dry-run",
        "evening.yaml",
        "--speed",
        "0.5",
        "--only",
        "left",
        "--from",
        "finale",
        "--format",
        "json",
    ];
    let report = session.run(&args).json();
    assert_eq!(report["outcome"], "done");
    assert_eq!(report["acts"].as_array().unwrap().len(), 1);
    let robots: Vec<_> = report["robots"].as_array().unwrap().iter().map(|r| r["robot"].clone()).collect();
    assert_eq!(robots, ["left"]);
    session.run(&["dry-run", "evening.yaml", "--only", "middle"]).says(2, &["does not move `middle`"]);
    session
        .run(&["dry-run", "evening.yaml", "--from", "intermezzo"])
        .says(2, &["unknown act `intermezzo`", "`opening`"]);
}

#[test]
fn limits_are_checked_again_at_changed_speed() {
    let session = evening("wait: done");
    session.file(
        "fleet.yaml",
        "robots:\n  left: {init: arm.yaml, address: sim, limits: {shoulder: {speed: 60}}}\n  right: {init: arm.yaml, address: sim}\ngroups:\n  arms: [left, right]\n",
    );
    session.run(&["dry-run", "evening.yaml", "--speed", "1.1"]).says(0, &["done"]);
    let too_fast =
        ["robot `left`, device `shoulder`: it can move at most 1.200 times as fast as written (act `"];
    session.run(&["dry-run", "evening.yaml", "--speed", "2"]).says(1, &too_fast);
}

#[test]
fn preflight_shows_every_robot_and_its_problems() {
    let session = evening("wait: done");
    let arm = format!(
        "{}  - id: battery\n    name: battery\n    available_control_types:\n      sensor: {{min_value: 0, max_value: 100}}\n",
        stage::session::ARM
    );
    session.file("arm.yaml", arm).file(
        "fleet.yaml",
        "robots:\n  left: {init: arm.yaml, address: sim, require: {battery: above 30}}\n  right: {init: arm.yaml, address: sim, require: {battery: {within: [60, 100]}}}\ngroups:\n  arms: [left, right]\n",
    );
    let ran = session.run(&["preflight", "evening.yaml"]);
    ran.says(
        1,
        &[
            "not ready",
            "right sensors: `battery` reads 50, but the fleet file requires within 60 and 100",
            "FAILURE",
        ],
    );
    session.file(
        "fleet.yaml",
        "robots:\n  left: {init: arm.yaml, address: sim, require: {battery: above 30}}\n  right: {init: arm.yaml, address: sim}\ngroups:\n  arms: [left, right]\n",
    );
    session.run(&["preflight", "evening.yaml"]).says(0, &["ready", "battery 50", "version", "above 30"]);
    let json = session.run(&["preflight", "evening.yaml", "--format", "json"]).json();
    assert_eq!(json["preflight"]["rows"].as_array().unwrap().len(), 2);
}

#[test]
fn second_mission_is_refused_and_names_the_robots_in_use() {
    let session = evening("wait: operator");
    let _sim = on_tcp(&session);
    let first = start(&session, &["run", "evening.yaml"], "waits for the operator's go");
    session
        .run(&["run", "evening.yaml"])
        .says(1, &["robot `left` already takes part in the running mission `evening@", "robot `right`"]);
    // A scheduler on another machine, without the journal of the first mission, learns of it from the robots.
    let mut elsewhere = session.command(&["run", "evening.yaml"]);
    let elsewhere = Ran(elsewhere.env("DOWNBEAT_STATE", session.path("elsewhere")).output().unwrap());
    elsewhere.says(1, &["not started", "`left` belongs to another session", "end it with `downbeat stop`"]);
    session.run(&["stop"]).says(0, &["confirmed"]);
    finished(first).says(3, &["stopped by the operator"]);
    session.run(&["run", "evening.yaml", "--act", "opening", "--approach", "1s"]).says(0, &["done"]);
}

pub fn on_tcp(session: &Session) -> Process {
    let _both = ports(session);
    let mut sim = session.command(&["sim", "fleet.yaml", "--log-file", "sim.jsonl"]);
    let mut sim = Process(sim.stdout(Stdio::piped()).spawn().unwrap());
    let mut listening = BufReader::new(sim.0.stdout.take().unwrap()).lines();
    for robot in ["left", "right"] {
        let line = listening.next().unwrap().unwrap();
        assert!(line.starts_with(&format!("robot {robot} listens on ")), "{line}");
    }
    sim
}

/// Waits until both robots have set a value of a script, according to these log files.
#[track_caller]
fn await_moves(session: &Session, logs: &[&str]) {
    let text = |log: &&str| std::fs::read_to_string(session.path(log)).unwrap_or_default();
    let moves = |robot: &str| {
        let all: String = logs.iter().map(text).collect();
        let mut entries = all.lines().filter_map(Logged::read);
        entries.any(|entry| entry.robot == robot && ["set", "ramp"].contains(&entry.motion.as_str()))
    };
    await_that("a move of each robot", || ["left", "right"].into_iter().all(moves));
}

const LONG: &str = "scenario: long
start_tolerance: 1s
stop_condition: {running: 20s}
cues:
  - cue: up
    robots: arms
    at: 0s
    tracks:
      shoulder: [{at: 0s, to: 0}, {at: 2500ms, to: 20}]
";

#[test]
fn mission_with_killed_scheduler_is_resumed_and_completed() {
    let session = Session::new();
    let _sim = on_tcp(&session);
    session.file("long.yaml", LONG);
    let child = start(&session, &["run", "long.yaml"], "starting `");
    await_moves(&session, &["sim.jsonl"]);
    drop(child);
    session.run(&["missions"]).says(0, &["cut off"]);
    session.run(&["resume"]).says(0, &["long: done", "2/2"]);
    session.run(&["missions"]).says(0, &["no mission is running"]);
}

#[test]
fn mission_with_killed_scheduler_is_stopped() {
    let session = Session::new();
    let _sim = on_tcp(&session);
    session.file("long.yaml", LONG);
    let child = start(&session, &["run", "long.yaml"], "starting `");
    await_moves(&session, &["sim.jsonl"]);
    drop(child);
    session.run(&["stop"]).says(0, &["left: stop confirmed", "right: stop confirmed"]);
    // No mission can be resumed, and the robots are free.
    session.run(&["resume"]).says(2, &["no mission was cut off"]);
    session.run(&["run", "long.yaml"]).says(0, &["long: done"]);
}

#[test]
fn recording_is_an_mcap_file_with_all_messages() {
    let session = evening("wait: done");
    session.run(&["run", "evening.yaml", "--record", "evening.mcap"]).says(0, &["done"]);
    let bytes = std::fs::read(session.path("evening.mcap")).unwrap();
    let mut of_topic: std::collections::BTreeMap<String, usize> = std::collections::BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        serde_json::from_slice::<serde_json::Value>(&message.data).unwrap();
        *of_topic.entry(message.channel.topic.clone()).or_default() += 1;
    }
    for (topic, at_least) in [
        ("/robots/left/requests", 10),
        ("/robots/left/responses", 10),
        ("/robots/left/clock", 8),
        ("/robots/left/shoulder/planned", 4),
        ("/robots/left/shoulder/reported", 4),
        ("/mission/decisions", 6),
        ("/mission/progress", 8),
    ] {
        assert!(of_topic.get(topic).copied().unwrap_or(0) >= at_least, "{topic}: {of_topic:?}");
    }
}

#[test]
fn every_kind_of_report_conforms_to_its_schema() {
    let session = evening("wait: operator");
    let schema = session.run(&["schema", "report"]).json();
    let validator = jsonschema::validator_for(&schema).unwrap();
    let faulty = "robots:\n  left: {init: arm.yaml, address: sim}\n  right: {init: arm.yaml, address: sim, simulate: {fault: FAULT, delay: [0ms, 5ms]}}\ngroups:\n  arms: [left, right]\n";
    for fault in ["refuse", "silent", "disconnect"] {
        session.file(&format!("{fault}.yaml"), faulty.replace("FAULT", fault));
    }
    let runs: [&[&str]; 7] = [
        &["dry-run", "evening.yaml"],
        &["dry-run", "evening.yaml", "--fleet", "refuse.yaml"],
        &["dry-run", "evening.yaml", "--fleet", "silent.yaml"],
        &["dry-run", "evening.yaml", "--fleet", "disconnect.yaml"],
        &["preflight", "evening.yaml"],
        &["run", "evening.yaml", "--act", "opening"],
        &["run", "evening.yaml", "--act", "opening", "--lead", "1ms"],
    ];
    for args in runs {
        let report = session.run(&[args, &["--format", "json"]].concat()).json();
        let faults: Vec<_> =
            validator.iter_errors(&report).map(|e| format!("{}: {e}", e.instance_path)).collect();
        assert!(faults.is_empty(), "{args:?}: {faults:#?}\n{report:#}");
    }
}

pub fn ports(session: &Session) -> (u16, u16) {
    let ports = (free_port(), free_port());
    session.file(
        "fleet.yaml",
        format!(
            "robots:\n  left: {{init: arm.yaml, address: \"tcp://127.0.0.1:{}\"}}\n  right: {{init: arm.yaml, address: \"tcp://127.0.0.1:{}\"}}\ngroups:\n  arms: [left, right]\n",
            ports.0, ports.1
        ),
    );
    ports
}

pub fn robot(session: &Session, id: &str, port: u16) -> Process {
    robot_of(session, "arm.yaml", id, port)
}

fn robot_of(session: &Session, init: &str, id: &str, port: u16) -> Process {
    let mut command = session.command(&["robot", "--init", init, "--id", id, "--listen"]);
    command.arg(format!("127.0.0.1:{port}")).args(["--log-file", &format!("{id}.jsonl")]);
    let mut child = Process(command.stdout(Stdio::piped()).spawn().unwrap());
    let mut line = String::new();
    BufReader::new(child.0.stdout.take().unwrap()).read_line(&mut line).unwrap();
    child
}

#[test]
fn late_joiner_is_refused_or_joins_at_next_act() {
    let session = evening("wait: operator");
    let (left, right) = ports(&session);
    let _left = robot(&session, "left", left);
    session.run(&["run", "evening.yaml"]).says(1, &["not started", "right: link down"]);
    // The first position of the finale is 20.
    session.file("at-20.yaml", arm_at(20));
    let ran = joins_late(&session, "at-20.yaml", right);
    ran.says(0, &["evening: done"]);
    let row =
        |robot: &str| ran.out().lines().find(|line| line.trim_start().starts_with(robot)).unwrap().to_owned();
    assert!(row("left").contains("2/2") && row("right").contains("1/1"), "{}", ran.out());
}

#[test]
fn late_joiner_that_would_jump_is_left_out_and_does_not_move() {
    let session = evening("wait: operator");
    let (left, right) = ports(&session);
    let _left = robot(&session, "left", left);
    let ran = joins_late(&session, "arm.yaml", right);
    ran.says(5, &["right: device `shoulder` is at 0, but its first keyframe in the act `finale` expects 20"]);
    assert_eq!(std::fs::read_to_string(session.path("right.jsonl")).unwrap(), "");
}

/// Plays the scenario `evening`. Its robot `right` is missing, and is started only before the last act.
fn joins_late(session: &Session, init: &str, port: u16) -> Ran {
    let args = ["run", "evening.yaml", "--join", "next_act", "--format", "text"];
    let told = session.path("told");
    let mut command = session.command(&args);
    command.stdout(Stdio::piped()).stderr(std::fs::File::create(&told).unwrap());
    let child = Process(command.spawn().unwrap());
    let await_line = |text: &str| await_that(text, || std::fs::read_to_string(&told).unwrap().contains(text));
    await_line("waits for the operator's go");
    let _right = robot_of(session, init, "right", port);
    await_line("right: reconnected");
    session.run(&["go"]).says(0, &[]);
    finished(child)
}

#[test]
fn robot_that_never_joins_is_named_and_mission_is_done_without_it() {
    let session = evening("wait: done");
    let (left, _) = ports(&session);
    let _left = robot(&session, "left", left);
    let ran = session.run(&["run", "evening.yaml", "--join", "next_act", "--format", "text"]);
    ran.says(5, &["evening: done, without", "right: it never joined: link down"]);
}

#[test]
fn link_lost_during_mission_is_reconnected_and_mission_continues() {
    let session = Session::new();
    session.file("long.yaml", LONG);
    let (left, right) = ports(&session);
    let _robots = [robot(&session, "left", left), robot(&session, "right", right)];
    let link = Proxy::to(right);
    let fleet = std::fs::read_to_string(session.path("fleet.yaml")).unwrap();
    session.file("fleet.yaml", fleet.replace(&right.to_string(), &link.port.to_string()));
    let child = start(&session, &["run", "long.yaml", "--format", "json"], "");
    await_moves(&session, &["left.jsonl", "right.jsonl"]);
    link.interrupt();
    // Duration of the outage.
    std::thread::sleep(Duration::from_millis(5));
    link.open();
    let ran = finished(child);
    let report = ran.json();
    assert_eq!(report["outcome"], "done", "{report:#}");
    assert_eq!(report["robots"][1]["reconnects"], 1, "{report:#}");
    assert_eq!(report["robots"][1]["steps_done"], 2);
}

#[test]
fn two_missions_play_simultaneously_on_separate_robots() {
    let session = evening("wait: operator");
    let _sim = on_tcp(&session);
    let first = start(&session, &["run", "evening.yaml", "--only", "left"], "waits for the operator's go");
    session.run(&["run", "evening.yaml", "--only", "right", "--act", "opening"]).says(0, &["done"]);
    session
        .run(&["run", "evening.yaml"])
        .says(1, &["robot `left` already takes part in the running mission"]);
    session.run(&["stop"]).says(0, &["left: stop confirmed"]);
    finished(first).says(3, &["stopped by the operator"]);
}

#[test]
fn past_or_too_early_start_is_refused_with_earliest_safe_start() {
    let session = evening("wait: done");
    let refused = ["not sent: the start at ", "has passed", "the earliest safe start was"];
    session.run(&["run", "evening.yaml", "--at", "2020-01-01T00:00:00Z"]).says(1, &refused);
    session
        .run(&["run", "evening.yaml", "--record", "no/such.mcap"])
        .says(2, &["the folder does not exist", "mkdir -p no"]);
    let no_sensor = ["unknown sensor `left/lid`"];
    session.run(&["dry-run", "evening.yaml", "--reading", "left/lid=1"]).says(2, &no_sensor);
}
