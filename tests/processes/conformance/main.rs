//! Tests of the conformance check: correct robots pass, and each planted fault fails exactly the requirements that it breaks.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

mod copied;
mod faults;
mod proxy;
mod sloppy;
mod starters;

use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use downbeat::conformance::{Examined, Options, Verdict, examine, requirements};
use downbeat_robot::simulated::Settings;
use rustix::process::Signal;
use urrcp::Span;

use faults::{Mutant, Robot};
use stage::quiet::await_that;
use stage::session::{Session, program, root};
use stage::signal;
use stage::standstill::undisturbed;

const ARM: &str = "id: arm
api_version: '1'
reports: true
devices:
  - id: shoulder
    name: shoulder servo
    unit: deg
    default_value: 0
    interpolation: linear
    script_queue: 2
    available_control_types:
      position: {min_value: 0, max_value: 90, granularity: 0.5}
      script: {min_value: 0, max_value: 90, granularity: 0.5, max_number_of_steps: 8}
";

const ROVER: &str = "id: rover
api_version: '1'
reports: true
devices:
  - id: wheel
    name: wheel
    default_value: 0
    script_queue: 3
    available_control_types:
      speed: {min_value: -1, max_value: 1, granularity: 0.01}
      acceleration: {min_value: -2, max_value: 2, granularity: 0.01}
      script: {min_value: -1, max_value: 1, granularity: 0.01, max_number_of_steps: 16, control_types: [speed]}
  - id: range
    name: distance ahead
    available_control_types:
      sensor: {min_value: 0.02, max_value: 4, max_error: 0.01, max_delay: 50}
";

/// The description of a robot without scripts and reports; the limits of its brightness are not multiples of the granularity.
const LAMP: &str = "id: lamp
api_version: '1'
devices:
  - id: colour
    name: red green blue
    available_control_types:
      custom_1: {values: 3}
  - id: brightness
    name: brightness
    available_control_types:
      position: {min_value: 0.03, max_value: 0.97, granularity: 0.05}
";

/// The expensive requirements, whose checks transfer megabytes or wait for a long time. Only robots that must fail them are checked for
/// them.
const HEAVY: [&str; 5] = ["huge-line", "slow-reader", "deep-nesting", "session-silence", "silent-peers"];

fn options(only: &[&str]) -> Options {
    Options {
        tolerance: Span::from_millis(150),
        patience: Span::from_millis(1_500),
        only: only.iter().map(|name| (*name).to_owned()).collect(),
        ..Options::default()
    }
}

fn examined(address: SocketAddr, options: Options) -> Examined {
    examine(address, options, Arc::new(AtomicBool::new(false)), &mut |_, _| {}).unwrap()
}

/// Examines a correct robot. Repeats the examination if it found a failure while this machine stalled.
fn examined_undisturbed(robot: impl Fn() -> SocketAddr, options: Options) -> Examined {
    undisturbed(|| examined(robot(), options.clone()), |examined| told(examined, Verdict::Fail).is_empty())
}

fn told(examined: &Examined, verdict: Verdict) -> String {
    let lines = examined.judged.iter().filter(|judged| judged.verdict == verdict);
    lines.map(|judged| format!("  {}: {}\n", judged.requirement, judged.why)).collect()
}

/// The requirements that do not apply to a robot with one device that can be moved, whose scripts have the limits of their control type.
const ONE_DEVICE: [&str; 7] = [
    "devices-stop",
    "devices-lease",
    "devices-unsupported",
    "devices-at-once",
    "devices-take-back",
    "devices-request-id",
    "script-narrower",
];

#[track_caller]
fn check_passes(robot: &str, not_applicable: &[&str]) {
    let examined = examined_undisturbed(|| proxy::robot(robot, Settings::default()), options(&[]));
    assert_eq!(told(&examined, Verdict::Fail), "");
    let open = examined.judged.iter().filter(|judged| judged.verdict == Verdict::NotApplicable);
    let open: BTreeSet<_> = open.map(|judged| judged.requirement).collect();
    let expected: BTreeSet<_> = not_applicable.iter().chain(&ONE_DEVICE).copied().collect();
    assert_eq!(open, expected, "{}", told(&examined, Verdict::NotApplicable));
    assert!(examined.at_rest);
}

#[test]
fn arm_passes_all_applicable_requirements() {
    check_passes(ARM, &["sensor", "session-sensor", "lease-left-on", "lease-left-on-kept"]);
}

#[test]
fn rover_with_sensor_passes_everything_except_position_checks() {
    check_passes(
        ROVER,
        &[
            "inquiry-position",
            "stays-stopped",
            "stays-connected",
            "lease-stays-pending",
            "lease-stays-running",
            "home-position",
        ],
    );
}

#[test]
fn robot_does_not_fail_requirements_for_undeclared_features() {
    let examined = examined_undisturbed(|| proxy::robot(LAMP, Settings::default()), options(&[]));
    assert_eq!(told(&examined, Verdict::Fail), "");
    let passed = examined.judged.iter().filter(|judged| judged.verdict == Verdict::Pass).count();
    assert!(passed > 30, "{}", told(&examined, Verdict::NotApplicable));
}

#[test]
fn robot_without_inquiry_support_receives_no_inquiries() {
    let silent: proxy::Fault = |_, passing| {
        if let Some(block) = passing.json.get_mut("initialization_block") {
            block["inquiry"] = serde_json::json!(false);
        }
        match passing.json.get("inquiry") {
            Some(_) => proxy::Then::HangUp,
            None => proxy::Then::Pass,
        }
    };
    let robot = proxy::faulty(proxy::robot(ARM, Settings::default()), proxy::Serving::All, silent);
    let names: Vec<_> = requirements().map(|r| r.name).filter(|name| name.contains("inquiry")).collect();
    let examined = examined(robot, options(&names));
    let open = examined.judged.iter().filter(|judged| judged.verdict == Verdict::NotApplicable).count();
    assert_eq!((names.len(), open), (15, 15), "{}", told(&examined, Verdict::Fail));
}

#[test]
fn clock_offset_is_measured_on_request() {
    let mut options = options(&["clock", "deferred-start", "late", "script-timing"]);
    options.clock_measured = true;
    let examined = examined_undisturbed(|| proxy::robot(ARM, ahead()), options);
    assert_eq!(told(&examined, Verdict::Fail), "");
}

fn ahead() -> Settings {
    Settings { clock_offset: Span::from_millis(2_000), ntp_error: None, ..Settings::default() }
}

/// Returns the requirements that a robot with this planted fault fails, and the messages about these failures.
fn failed_by(mutant: &Mutant) -> (BTreeSet<&'static str>, String) {
    let robot = match mutant.robot {
        Robot::Arm => proxy::robot(ARM, Settings::default()),
        Robot::Rover => proxy::robot(ROVER, Settings::default()),
        Robot::ClockAhead => proxy::robot(ARM, ahead()),
    };
    let names = requirements().map(|requirement| requirement.name);
    let planted = with_planted_fault();
    let wanted = |name: &&str| {
        let costs = HEAVY.contains(name) || !mutant.waits && name.starts_with("lease-");
        planted.contains(name) && (!costs || mutant.fails.contains(name))
    };
    let light: Vec<_> = names.filter(wanted).collect();
    let only = if mutant.only.is_empty() { light.as_slice() } else { mutant.only };
    let examined = examined(proxy::faulty(robot, mutant.serving, mutant.fault), options(only));
    let failed = examined.judged.iter().filter(|judged| judged.verdict == Verdict::Fail);
    (failed.map(|judged| judged.requirement).collect(), told(&examined, Verdict::Fail))
}

/// Number of robots that are examined at the same time. Nearly all of the time is waiting.
const AT_A_TIME: usize = 8;

#[test]
fn each_injected_fault_fails_only_the_requirements_it_violates() {
    let mutants = faults::all();
    let (next, wrong) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..AT_A_TIME {
            scope.spawn(|| {
                while let Some(mutant) = mutants.get(next.fetch_add(1, Ordering::Relaxed)) {
                    if failed_by(mutant).0 != mutant.fails.iter().copied().collect() {
                        wrong.lock().unwrap().push(mutant);
                    }
                }
            });
        }
    });
    // Other examinations may have delayed one that failed.
    let mut report = String::new();
    for mutant in wrong.into_inner().unwrap() {
        let fails = mutant.fails.iter().copied().collect();
        let (failed, why) = undisturbed(|| failed_by(mutant), |(failed, _)| *failed == fails);
        if failed != fails {
            report.push_str(&format!("{}: expected {fails:?}, found {failed:?}\n{why}", mutant.name));
        }
    }
    assert_eq!(report, "");
}

#[test]
fn checks_do_not_wait_for_a_dead_robot() {
    let robot = proxy::faulty(proxy::robot(ARM, Settings::default()), proxy::Serving::AtMost(15), |_, _| {
        proxy::Then::Pass
    });
    let examined = examined(robot, options(&["reconnect", "two-links", "availability"]));
    let last = examined.judged.last().unwrap();
    assert_eq!((last.requirement, last.verdict), ("two-links", Verdict::Fail));
    assert!(last.why.contains("since the check `reconnect`"), "{}", last.why);
    assert!(!examined.at_rest);
}

/// Returns the requirements for which a fault is planted here.
fn with_planted_fault() -> BTreeSet<&'static str> {
    faults::all().iter().flat_map(|mutant| mutant.fails.iter().copied()).collect()
}

#[test]
fn every_requirement_has_a_fault_that_fails_it() {
    let mut failed = with_planted_fault();
    // Faults of doors that require a proof.
    failed.extend(sloppy::OF_PROOFS.iter().copied().chain(["roles", "no-certificate"]));
    // Mistakes in the example robot, which `lab/mistakes.py` plants.
    let mistakes = std::fs::read_to_string(root().join("lab/downbeat_lab/mistakes.py")).unwrap();
    let listed = |name: &&str| mistakes.split(['"', ' ']).any(|word| word == *name);
    let missing: Vec<_> =
        requirements().map(|r| r.name).filter(|name| !failed.contains(name) && !listed(name)).collect();
    assert_eq!(missing, Vec::<&str>::new());
}

#[test]
fn document_and_program_list_the_same_requirements() {
    let document = std::fs::read_to_string(root().join("docs/conformance.md")).unwrap();
    let rows: String = requirements()
        .map(|r| format!("| {} | `{}` | {} | {} |\n", r.number, r.name, r.demands, r.section))
        .collect();
    assert!(document.contains(&rows), "docs/conformance.md should have these rows:\n{rows}");
    let read = |page| std::fs::read_to_string(root().join("docs").join(page)).unwrap();
    let protocol = ["protocol.md", "transport.md", "proof.md"].map(read).concat();
    for requirement in requirements() {
        let heading =
            |line: &str| line.trim_start_matches('#').trim() == requirement.section && line.starts_with('#');
        assert!(protocol.lines().any(heading), "`{}`: no section {}", requirement.name, requirement.section);
    }
}

#[test]
fn conformance_command_shows_table_and_returns_correct_exit_code() {
    let session = Session::new();
    let robot = proxy::robot(ARM, Settings::default());
    let right = format!("tcp://{robot}");
    session.run(&["conformance", &right, "--only", "availability,sensor,queue"]).says(
        0,
        &[
            "availability",
            "pass",
            "the robot has no sensor",
            "2 scripts held",
            "2 passed, 0 failed, 1 not applicable",
        ],
    );
    session
        .run(&["conformance", &right, "--device", "elbow"])
        .says(2, &["no device `elbow`", "one of `shoulder`"]);
    let late: proxy::Fault =
        faults::all().into_iter().find(|mutant| mutant.fails.contains(&"late")).unwrap().fault;
    let wrong = format!("tcp://{}", proxy::faulty(robot, proxy::Serving::All, late));
    session.run(&["conformance", &wrong, "--only", "late"]).says(
        1,
        &[
            "fail",
            "sent {\"control_request\":",
            "received {\"control_response\":",
            "expected status `Failed`",
        ],
    );
    let json = session.run(&["conformance", &wrong, "--only", "late,clock", "--format", "json"]);
    assert_eq!(json.code(), 1);
    let judged = json.json();
    assert_eq!(
        (judged[0]["requirement"].as_str(), judged[0]["verdict"].as_str()),
        (Some("clock"), Some("pass"))
    );
    assert_eq!(
        (judged[1]["requirement"].as_str(), judged[1]["verdict"].as_str()),
        (Some("late"), Some("fail"))
    );
    assert!(judged[1]["millis"].is_u64() && judged[1]["why"].as_str().unwrap().contains("received"));
    session.run(&["conformance", &right, "--only", "lat"]).says(2, &["unknown requirement `lat`"]);
    session.run(&["conformance", "nowhere"]).says(2, &["write tcp://HOST:PORT"]);
    session.run(&["conformance", "tcp://127.0.0.1:1"]).says(1, &["no connection to 127.0.0.1:1"]);
    session
        .run(&["conformance", "--list"])
        .says(0, &["lease-noise", "A line that is not a message does not renew the lease."]);
}

#[test]
fn robot_that_cannot_be_moved_is_no_success() {
    const COLOUR: &str = "id: lamp
api_version: '1'
devices: [{id: colour, available_control_types: {custom_1: {values: 3}}}]
";
    let session = Session::new();
    let address = format!("tcp://{}", proxy::robot(COLOUR, Settings::default()));
    session
        .run(&["conformance", &address, "--only", "availability,queue,late"])
        .says(5, &["nothing was moved", "--custom VALUE", "1 passed, 0 failed, 2 not applicable"]);
    session.run(&["conformance", &address, "--only", "core-1"]).says(0, &["1 passed, 0 failed"]);
    session
        .run(&["conformance", &address, "--only", "late,cancel-pending", "--custom", "0.5"])
        .says(0, &["2 passed, 0 failed"]);
    session.run(&["conformance", &address, "--custom", "red"]).says(2, &["expected a number"]);
}

#[test]
fn ctrl_c_leaves_robot_at_rest() {
    static HOLDS: AtomicBool = AtomicBool::new(false);
    let robot = proxy::robot(ARM, Settings::default());
    let watched = proxy::faulty(robot, proxy::Serving::All, |_, passing| {
        if passing.response().is_some_and(|response| response["status"] == "Accepted") {
            HOLDS.store(true, Ordering::Relaxed);
        }
        proxy::Then::Pass
    });
    let mut command = std::process::Command::new(program());
    command.args([
        "conformance",
        &format!("tcp://{watched}"),
        "--only",
        "lease-renewal,lease-noise,lease-two-links",
    ]);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    await_that("a script that the robot holds", || HOLDS.load(Ordering::Relaxed));
    signal(&child, Signal::INT);
    let ended = child.wait_with_output().unwrap();
    let printed = String::from_utf8_lossy(&ended.stdout);
    assert_eq!(ended.status.code(), Some(3), "{printed}");
    assert!(printed.contains("ended by the operator"), "{printed}");
    // Held commands are no longer held.
    let after = examined(robot, options(&["queue"]));
    assert_eq!(told(&after, Verdict::Fail), "");
}
