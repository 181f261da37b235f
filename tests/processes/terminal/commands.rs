//! The output and exit codes of individual commands in unusual situations, for example without any mission.

use std::fs::File;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use stage::play::{LONG, SHORT};
use stage::quiet::await_that;
use stage::session::{Session, root};
use stage::{Process, Via};

const SCENARIO: &str = "scenario: hello
start_tolerance: 1s
cues:
  - at: 0s
    robots: arms
    tracks: {shoulder: [{at: 0s, to: 45}, {at: 300ms, to: 0}]}
";

const TABLE: &str = "scenario: hello
cues:
  - at: 0s
    robots: arms
    tracks: {shoulder: {samples: {file: nowhere.csv, time: t, value: q}}}
";

#[test]
fn stop_and_go_without_a_running_mission_print_json() {
    let session = Session::new();
    for args in [&["stop"][..], &["stop", "nobody"], &["go"], &["go", "--mission", "nobody"], &["resume"]] {
        let ran = session.run(&[args, &["--format", "json"]].concat());
        assert_eq!(ran.code(), 2, "{args:?}: {}", ran.text());
        let error = ran.json()["error"].as_str().unwrap().to_owned();
        assert!(error.starts_with("no mission "), "{args:?}: {error}");
    }
    let all = session.run(&["stop", "--all", "--format", "json"]);
    assert_eq!((all.code(), all.json()), (2, serde_json::json!([])));
}

#[test]
fn several_running_or_interrupted_missions_require_a_name() {
    let stage = LONG.stage(&[Via::Direct, Via::Direct]);
    let play = std::fs::read_to_string(stage.path("play.yaml")).unwrap();
    let one = |robot: &str| play.replace("robots: all", &format!("robots: {robot}"));
    stage.file("one.yaml", one("r0")).file("two.yaml", one("r1"));
    let mut one = stage.start(&["run", "one.yaml"]);
    let mut two = stage.start(&["run", "two.yaml"]);
    for run in [&mut one, &mut two] {
        run.line("connected");
    }
    let go = stage.run(&["go"]);
    assert_eq!(go.code, Some(2), "{go}");
    assert!(go.told.contains("several missions are running; name one of them"), "{go}");
    one.process.kill();
    two.process.kill();
    let resume = stage.run(&["resume"]);
    assert!(resume.told.contains("several missions were cut off; name one of them"), "{resume}");
}

#[test]
fn selecting_an_act_in_a_scenario_without_acts_is_explained() {
    let session = Session::new();
    session.file("hello.yaml", SCENARIO);
    let ran = session.run(&["dry-run", "hello.yaml", "--act", "finale"]);
    ran.says(2, &["unknown act `finale`", "leave out --act"]);
    assert!(!ran.text().contains("``"), "{}", ran.text());
}

#[test]
fn help_output_that_cannot_be_written_is_a_failure() {
    let session = Session::new();
    for args in [&["--help"][..], &["run", "--help"], &["--version"]] {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let ended = session.command(args).stdout(full).output().unwrap();
        let told = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert_eq!(ended.status.code(), Some(7), "{args:?}: {told}");
        assert!(told.contains("cannot write to standard output"), "{args:?}: {told}");
        let (reader, writer) = rustix::pipe::pipe().unwrap();
        drop(reader);
        let ended = session.command(args).stdout(File::from(writer)).output().unwrap();
        assert_eq!(ended.status.code(), Some(0), "a reader that has gone is no error");
    }
    session.run(&["--help"]).says(0, &["Usage:"]);
    session.run(&["run"]).says(2, &["required"]);
}

#[test]
fn unwritable_robot_log_is_reported_immediately_and_in_the_exit_code() {
    let stage = SHORT.stage(&[]);
    let told = stage.path("told");
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let address = format!("127.0.0.1:{port}");
    let mut robot = stage.command(&["robot", "--init", "robot.yaml", "--id", "r0", "--listen", &address]);
    robot.args(["--log-file", "/dev/full"]).stderr(File::create(&told).unwrap());
    let mut robot = Process(robot.spawn().unwrap());
    stage.file(
        "fleet.yaml",
        format!("robots:\n  r0: {{init: robot.yaml, address: 'tcp://{address}'}}\ngroups: {{all: [r0]}}\n"),
    );
    await_that("the robot's port", || std::net::TcpStream::connect(&address).is_ok());
    let ran = stage.run(&["run", "play.yaml"]);
    assert_eq!(ran.code, Some(0), "the robot continues: {ran}");
    let says = || std::fs::read_to_string(&told).unwrap();
    await_that("the error", || says().contains("error: cannot write the log /dev/full: No space left"));
    kill_process(Pid::from_child(&robot.0), Signal::TERM).unwrap();
    assert_eq!(robot.0.wait().unwrap().code(), Some(7), "{}", says());
    assert_eq!(says().matches("No space left").count(), 1, "{}", says());
}

#[test]
fn ping_output_is_not_truncated_in_a_pipe() {
    let session = Session::new();
    let host = format!("{}.invalid", "a-long-name".repeat(6));
    session.file(
        "fleet.yaml",
        format!("insecure: true\nrobots:\n  left: {{init: arm.yaml, address: 'tcp://{host}:7401'}}\n  right: {{init: arm.yaml, address: sim}}\n"),
    );
    let ran = session.run(&["fleet", "ping"]);
    assert!(ran.out().contains(&format!("tcp://{host}:7401 ")), "{}", ran.out());
    assert!(ran.text().contains(&format!("no connection to {host}:7401: ")), "{}", ran.text());
    assert!(!ran.text().contains('…'), "{}", ran.text());
}

#[test]
fn preflight_messages_contain_no_duplicate_words() {
    let mut stage = SHORT.stage(&[Via::Direct, Via::Direct]);
    stage.robots[1].kill();
    let ran = stage.run(&["preflight", "play.yaml"]);
    assert!(ran.out.contains("r1: link down: "), "{ran}");
    assert!(!ran.out.contains("link: link"), "{ran}");
}

#[test]
fn stop_after_a_failure_names_the_robot_and_the_reason() {
    let mut stage = LONG.stage(&[Via::Direct, Via::Direct]);
    let mut run = stage.begin(&["run", "play.yaml", "--patience", "1s"], [1], 3);
    stage.robots[1].kill();
    let line = run.line("stopping all robots: ");
    let ended = run.ended();
    assert!(line.contains("stopping all robots: r1: link down: "), "{ended}");
}

#[test]
fn stop_after_a_wait_timeout_names_the_act_and_its_wait() {
    let stage = SHORT.stage(&[Via::Direct]);
    let cues = "cues: [{robots: all, tracks: {d: [{at: 0s, to: 1}, {at: 100ms, to: 2}]}}]";
    stage.file("show.yaml", format!("scenario: show\nstart_tolerance: 1s\nacts:\n  - {{act: one, {cues}}}\n  - {{act: two, wait: {{for: operator, timeout: 300ms}}, {cues}}}\n"));
    let ended = stage.run(&["run", "show.yaml"]);
    let stopping = "stopping all robots: `two` skipped: the operator's go did not occur within 300 ms";
    assert!(ended.told.contains(stopping), "{ended}");
}

#[test]
fn rejected_start_claim_is_not_reported_as_a_start() {
    let stage = SHORT.stage(&[Via::Proxy]);
    stage.robots[0].link.as_ref().unwrap().rewrite(|message| {
        let response = message.get_mut("control_response").filter(|response| response["status"] == "Started");
        if let Some(response) = response {
            response["event_timestamp"] = Value::from("2026-01-01T00:00:00.000000000Z");
        }
    });
    let ended = stage.run(&["run", "play.yaml", "--patience", "2s"]);
    assert!(ended.out.contains("before the script was sent"), "{ended}");
    assert!(ended.out.contains("1/1 claimed"), "{ended}");
    assert!(ended.out.contains("r0: its reported start time is impossible"), "{ended}");
    assert!(!ended.out.contains("no robot reported that it started"), "{ended}");
}

#[test]
fn failed_background_start_returns_its_own_exit_code_and_reason() {
    let mut stage = SHORT.stage(&[Via::Direct, Via::Direct]);
    stage.robots[1].kill();
    let detached = stage.run(&["run", "play.yaml", "--detach", "--patience", "1s"]);
    assert_eq!(detached.code, Some(1), "{detached}");
    assert!(detached.told.contains("r1: link down: "), "{detached}");
    assert!(!detached.out.contains("is running in the background"), "{detached}");
}

#[test]
fn background_mission_waiting_for_its_start_time_is_reported_as_running() {
    let stage = SHORT.stage(&[Via::Direct]);
    let detached = stage.run(&["run", "play.yaml", "--detach", "--at", "2100-01-01T00:00:00Z"]);
    assert_eq!(detached.code, Some(0), "{detached}");
    assert!(detached.out.contains("is running in the background"), "{detached}");
    let stopped = stage.run(&["stop"]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
}

/// Commands that fail, each with its exit code. Code 2: arguments or files cannot be read, or name something that does not exist. Code 1:
/// the content of a file is wrong, or no robot answers.
const FAILURES: [(u8, &str); 52] = [
    (2, "frobnicate"),
    (2, "check"),
    (2, "check nowhere.yaml"),
    (1, "check wrong.yaml"),
    (1, "check hello.yaml --fleet bad-fleet.yaml"),
    (2, "check hello.yaml --fleet nowhere.yaml"),
    (2, "check hello.yaml --sarif /proc/nowhere/x"),
    (2, "explain DB9999"),
    (2, "plan hello.yaml --act finale"),
    (1, "plan wrong.yaml"),
    (2, "dry-run hello.yaml --act finale"),
    (2, "dry-run hello.yaml --only nobody"),
    (2, "dry-run hello.yaml --reading left/lid=1"),
    (2, "dry-run hello.yaml --reading x"),
    (2, "dry-run hello.yaml --picture /proc/x.svg"),
    (1, "preflight hello.yaml --fleet far.yaml --patience 500ms"),
    (1, "run hello.yaml --fleet far.yaml --patience 500ms"),
    (2, "run hello.yaml --at 99:99"),
    (2, "run hello.yaml --record /proc/x.mcap"),
    (2, "go"),
    (2, "stop"),
    (2, "resume"),
    (1, "conformance tcp://127.0.0.1:1"),
    (2, "conformance nowhere"),
    (2, "robot --init nowhere.yaml"),
    (1, "robot --init bad.yaml"),
    (1, "edge --init bad.yaml --driver sim"),
    (1, "sim bad-fleet.yaml"),
    (1, "fleet ping far.yaml"),
    (1, "fleet describe tcp://127.0.0.1:1"),
    (2, "import csv nowhere.csv"),
    (2, "import midi nowhere.mid"),
    (2, "man /proc/x"),
    (2, "init /proc/x"),
    // A file that another file names is missing, or an existing one is in the way.
    (2, "check hello.yaml --fleet without-robot.yaml"),
    (2, "check without-moves.yaml"),
    (2, "check without-table.yaml"),
    (2, "plan without-moves.yaml"),
    (2, "run hello.yaml --fleet without-robot.yaml"),
    (2, "fleet show without-robot.yaml"),
    (2, "sim without-robot.yaml"),
    (2, "init"),
    (2, "export joint-trajectory hello.yaml --output full"),
    (2, "export joint-trajectory hello.yaml --output /proc/x"),
    (2, "export joint-trajectory nowhere.yaml --output x"),
    (1, "export joint-trajectory wrong.yaml --output x"),
    (2, "import csv log.csv --time t --time-unit s --map left/shoulder=q --output full"),
    (1, "import csv log.csv --time t --time-unit s --map left/shoulder=p"),
    (1, "fleet show bad-fleet.yaml"),
    (2, "missions show"),
    (2, "schema nothing"),
    (2, "completions nothing"),
];

#[test]
fn failures_of_one_kind_share_an_exit_code_and_print_json_documents() {
    let session = Session::new();
    session.file("hello.yaml", SCENARIO).file("wrong.yaml", SCENARIO.replace("shoulder", "hip"));
    session
        .file("bad.yaml", "id: arm\n")
        .file("bad-fleet.yaml", "robots: {left: {init: bad.yaml, address: sim}}\n");
    let far = "robots: {left: {init: arm.yaml, address: 'tcp://127.0.0.1:1'}}\ngroups: {arms: [left]}\n";
    session.file("far.yaml", far);
    session
        .file("without-robot.yaml", "robots: {left: {init: nowhere.yaml, address: sim}}\n")
        .file("without-moves.yaml", format!("include: nowhere.yaml\n{SCENARIO}"))
        .file("without-table.yaml", TABLE)
        .file("log.csv", "t,q\n0,0\n1,45\n")
        .file("full/left.yaml", "")
        .file("full/scenario.yaml", "");
    for (code, line) in FAILURES {
        let args: Vec<&str> = line.split(' ').collect();
        let text = session.run(&args);
        assert_eq!(text.code(), i32::from(code), "`{line}`: {}", text.text());
        assert!(!text.text().trim().is_empty(), "`{line}` fails without a word");
        let ran = session.run(&[&args[..], &["--format", "json"]].concat());
        assert_eq!(ran.code(), i32::from(code), "`{line}` in JSON: {}", ran.text());
        let document = ran.json();
        let errors = document["error"].as_str().is_some_and(|error| !error.is_empty());
        let says_why = ["findings", "failures", "robots", "rows"].iter().any(|key| !document[key].is_null());
        assert!(errors || says_why || document.is_array(), "`{line}`: {document}");
    }
}

#[test]
fn plan_chart_is_available_only_as_text() {
    let session = Session::new();
    let arm = "scenario: chart\ncues:\n  - {cue: raise, at: 0s, robots: left, tracks: {elbow: [{at: 0s, to: 0}, {at: 2s, to: 30}]}}\n";
    session.file("chart.yaml", arm);
    let fleet = root().join("tests/sessions/findings/folder/fleet.yaml");
    let args = ["plan", "chart.yaml", "--fleet", fleet.to_str().unwrap(), "--gantt"];
    session.run(&args).says(
        0,
        &["raise * ━━━", "left    ━━━", "┊0.5 s", "◆ mark, * critical", "path: determines when the act ends"],
    );
    let json = session.run(&[&args[..], &["--format", "json"]].concat());
    assert_eq!(json.code(), 2);
    assert!(json.json()["error"].as_str().unwrap().contains("--gantt"), "{}", json.text());
}

#[cfg(not(feature = "zenoh"))]
#[test]
fn build_without_zenoh_names_the_required_feature_for_zenoh_addresses() {
    let session = Session::new();
    session.file("keys.yaml", "zenoh: z.json5\nrobots:\n  left: {init: arm.yaml, address: 'zenoh:hall/left'}\ngroups: {arms: [left]}\n");
    session.file("hello.yaml", SCENARIO);
    session.run(&["check", "hello.yaml", "--fleet", "keys.yaml"]).says(0, &["no errors"]);
    for args in [
        &["run", "hello.yaml", "--fleet", "keys.yaml"][..],
        &["fleet", "ping", "keys.yaml"],
        &["fleet", "describe", "zenoh:hall/left"],
        &["sim", "keys.yaml"],
        &["robot", "--init", "arm.yaml", "--listen", "zenoh:hall/left", "--zenoh", "z.json5"],
    ] {
        let ran = session.run(args);
        assert!(matches!(ran.code(), 1 | 2), "{args:?}: {}", ran.text());
        assert!(ran.text().contains("--features zenoh"), "{args:?}: {}", ran.text());
    }
}
