//! Reports about stops, leases and starts: they agree with the events in real processes.

use rustix::process::Signal;

use stage::play::{LONG, Play, SHORT};
use stage::{Robot, Stage, Via, sleep_until};

/// Checks that the end of a script confirms no stop. Messages to the first robot are lost, and its script ends after the stop was sent.
#[track_caller]
fn check_that_a_late_ok_confirms_nothing(keys: &'static [&'static str]) {
    let stage = Play { steps: 14, ..LONG }.stage(&[Via::Proxy, Via::Direct]);
    let link = stage.robots[0].link.as_ref().unwrap();
    link.leave_out(keys);
    let mut running = stage.begin(&["run", "play.yaml", "--patience", "2s"], [0], 10);
    link.deafen();
    running.process.signal(Signal::INT);
    running.line("stopping all robots");
    let ended = running.ended();
    let confirmed = ended.out.contains("r0: stop confirmed");
    assert!(!confirmed && ended.code == Some(4), "no stop has reached r0\n{ended}");
}

#[test]
fn script_end_does_not_confirm_a_stop_sent_earlier() {
    check_that_a_late_ok_confirms_nothing(&[]);
}

#[test]
fn script_end_does_not_confirm_stop_if_responses_lack_request_ids() {
    check_that_a_late_ok_confirms_nothing(&["request_id", "content_hash", "inquiry"]);
}

#[test]
fn stopped_robots_are_not_reported_in_their_default_state() {
    let mut stage = Play { on_failure: "stop", ..LONG }.stage(&[Via::Direct, Via::Direct]);
    let running = stage.begin(&["run", "play.yaml", "--patience", "1s"], [1], 3);
    stage.robots[1].kill();
    let ended = running.ended();
    assert!(!ended.out.contains("default state"), "{ended}");
    assert!(ended.out.contains("r0: stop confirmed"), "what became of the other one? {ended}");
    let held = stage.robots[0].values("d").last().copied();
    let moved =
        stage.robots[0].log().into_iter().find(|entry| entry.motion != "set" && Some(entry.value) != held);
    assert!(moved.is_none(), "{moved:?}, it stood at {held:?}");
}

#[test]
fn starts_measured_outside_tolerance_are_reported() {
    let stage = Play { tolerance: "15ms", ..SHORT }.stage(&[Via::Direct, Via::Direct]);
    let mut running = stage.start(&["run", "play.yaml", "--lead", "1s", "--patience", "1s"]);
    let start = running.start();
    sleep_until(start - 8_000_000);
    stage.robots[1].freeze();
    sleep_until(start + 40_000_000);
    stage.robots[1].thaw();
    let ended = running.ended();
    let first = |robot: &Robot| robot.sets().first().map(|set| set.at);
    let (Some(one), Some(other)) = (first(&stage.robots[0]), first(&stage.robots[1])) else {
        return assert_ne!(ended.code, Some(0), "{ended}");
    };
    if (one - other).abs() > 20_000_000 {
        let told = ended.code != Some(0) || ended.out.contains("start_tolerance");
        assert!(told, "{} ms apart\n{ended}", (one - other).abs() / 1_000_000);
    }
}

#[test]
fn late_steps_beyond_tolerance_are_named_and_prevent_success() {
    let stage = Play { steps: 20, tolerance: "100ms", ..LONG }.stage(&[Via::Direct, Via::Direct]);
    let running = stage.begin(&["run", "play.yaml", "--patience", "2s"], 0..2, 3);
    stage.robots[1].freeze();
    std::thread::sleep(std::time::Duration::from_millis(300));
    stage.robots[1].thaw();
    let ended = running.ended();
    assert_eq!(ended.code, Some(6), "{ended}");
    let headline = ended.out.starts_with("play: played to the end, but steps were up to ");
    assert!(headline && ended.out.contains("start_tolerance is 100 ms"), "{ended}");
    let line = ended.out.lines().find(|line| line.starts_with("r1: "));
    assert!(line.is_some_and(|line| line.contains(" of `d` more than 1 ms late, ")), "{ended}");
}

/// Freezes the second robot once both have set this number of values, and stops the mission by Ctrl-C. Checks that the report states no
/// end of a lease.
#[track_caller]
fn check_that_no_lease_is_printed(stage: &Stage, sets: usize) {
    let mut running = stage.begin(&["run", "play.yaml", "--patience", "1s"], 0..stage.robots.len(), sets);
    stage.robots[1].freeze();
    running.process.signal(Signal::INT);
    running.line("stopping all robots");
    let ended = running.ended();
    assert_eq!(ended.code, Some(4), "{ended}");
    assert!(ended.out.contains("r1: stop NOT confirmed"), "{ended}");
    assert!(!ended.out.contains("lease ends"), "{ended}");
}

#[test]
fn lease_end_is_not_printed_for_robots_without_a_lease() {
    let stage = Play { running: "none", ..LONG }.stage(&[Via::Direct, Via::Direct]);
    check_that_no_lease_is_printed(&stage, 3);
}

#[test]
fn lease_end_is_not_printed_for_cues_without_a_lease() {
    let stage = LONG.stage(&[Via::Direct, Via::Direct]);
    let cue = |at: u32, to: u32| {
        format!(
            "  - {{at: {at}s, robots: all, stop_condition: {{running: none}}, tracks: {{d: [{{at: 0s, to: {to}}}, {{at: 4s, to: {}}}]}}}}\n",
            to + 1
        )
    };
    stage
        .file("play.yaml", format!("scenario: play\nstart_tolerance: 1s\ncues:\n{}{}", cue(0, 1), cue(5, 3)));
    check_that_no_lease_is_printed(&stage, 1);
}
