//! Driver programs that time scripts by themselves: compares their own logs with the reports.

use std::time::Duration;

use rustix::process::Signal;

use super::processes::Edge;
use super::programs::python;
use super::{LEAD, await_that, session};
use stage::session::{Ran, Session};
use stage::signal;

/// A driver that logs each value with the time at which it is set, in nanoseconds. The value 66 makes it fail, and 77 ends it. In the
/// mode `mute` it sends no reports about its plans.
const AHEAD: &str = r#"
import os, sys, time
from downbeat_driver import Driver

mode = sys.argv[2]

class Ahead(Driver):
    lookahead = 300 if mode == "horizon" else "script"

    def __init__(self):
        super().__init__()
        self.driven = open(sys.argv[1], "a", buffering=1)

    def note(self, *words):
        self.driven.write(" ".join(map(str, words)) + "\n")

    def set(self, device, control_type, value, *more):
        if value == 66:
            raise RuntimeError("torque")
        self.note(time.time_ns(), device, f"{value:g}")
        if value == 77:
            os._exit(3)

    def play(self, plan):
        self.note(time.time_ns(), "plan", plan.device, len(plan.steps()), plan.start_ns)
        super().play(plan)

    def stop(self):
        self.note(time.time_ns(), "end")

    def _push(self, line):
        if mode != "mute":
            super()._push(line)

    # A controller that has died: only the clock says that it plays.
    if mode == "dead":
        def play(self, plan):
            plan.begin(assumed=True)
            for step in plan:
                plan.wait_until(step.at)
                plan.reached(step, assumed=True)
            plan.finished(assumed=True)

    # It reported until its first value was due.
    if mode == "silent":
        hardware_silence_ms = 400
        reported = None

        def ping(self):
            now = time.monotonic()
            if self.reported is None or not os.path.getsize(sys.argv[1]):
                self.reported = now
            return now - self.reported

Ahead().run()
"#;

/// A session, and in it an edge whose driver is the program `AHEAD` in one of its modes.
struct Rig {
    session: Session,
    edge: Edge,
}

/// A line of the program's log: time in nanoseconds, and event.
type Line = (i64, String);

impl Rig {
    fn start(mode: &str, args: &[&str]) -> Option<Self> {
        let python = python()?;
        let session = session();
        session.file("ahead.py", AHEAD);
        let driver = format!("program:{python} ahead.py driven.txt {mode}");
        let edge = Edge::start_with(&session, "tank.json", &driver, args);
        let fleet =
            format!("robots: {{tank-1: {{init: tank.json, address: 'tcp://127.0.0.1:{}'}}}}\n", edge.1);
        session.file("fleet.yaml", fleet);
        edge.await_hardware();
        Some(Self { session, edge })
    }

    fn log(&self) -> Vec<Line> {
        let text = std::fs::read_to_string(self.session.path("driven.txt")).unwrap_or_default();
        let whole = text.split_inclusive('\n').filter_map(|line| line.strip_suffix('\n'));
        let line = |line: &str| {
            let (at, what) = line.split_once(' ').unwrap();
            (at.parse().unwrap(), what.to_owned())
        };
        whole.map(line).collect()
    }

    fn of(&self, plans: bool) -> Vec<Line> {
        let is_plan = |line: &Line| line.1.starts_with("plan");
        self.log().into_iter().filter(|line| line.1 != "end" && is_plan(line) == plans).collect()
    }

    fn sets(&self) -> Vec<Line> {
        self.of(false)
    }

    /// Returns the values that the program has set, as `device value`.
    fn played(&self) -> Vec<String> {
        self.sets().into_iter().map(|(_, what)| what).collect()
    }

    fn play(&self, left: &str, right: &str) -> Ran {
        self.scenario(left, right);
        self.session.run(&["run", "play.yaml", "--lead", LEAD, "--format", "json"])
    }

    fn scenario(&self, left: &str, right: &str) {
        let scenario = format!(
            "scenario: play\nstart_tolerance: 1s\nstop_condition: {{running: none}}\ncues: [{{at: 0s, robots: tank-1, tracks: {{left: [{left}], right: [{right}]}}}}]\n"
        );
        self.session.file("play.yaml", scenario);
    }

    /// Plays a show of a minute, which must fail, and calls `what` after the third value. Returns the output of the mission.
    fn meanwhile(&mut self, what: impl FnOnce(&mut Self)) -> String {
        let steps: Vec<_> = (0..60).map(|i| format!("{{at: {}s, to: {}}}", i, i + 1)).collect();
        self.scenario(&steps.join(", "), "{at: 0s, to: 5}");
        let mut run = self.session.command(&["run", "play.yaml", "--lead", LEAD]);
        let run =
            run.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped()).spawn().unwrap();
        await_that("the third value", || self.played().contains(&"left 3".to_owned()));
        what(self);
        let ran = run.wait_with_output().unwrap();
        assert_ne!(ran.status.code(), Some(0));
        String::from_utf8_lossy(&ran.stdout).into_owned() + &String::from_utf8_lossy(&ran.stderr)
    }
}

#[test]
#[expect(clippy::print_stdout, reason = "figures for people")]
fn program_plays_whole_script_and_report_matches_its_log() {
    let Some(rig) = Rig::start("script", &["--log-file", "edge.jsonl"]) else { return };
    let ran = rig.play(
        "{at: 0s, to: 40}, {at: 300ms, to: 20}, {at: 600ms, to: 0}",
        "{at: 0s, to: 5}, {at: 400ms, to: 6}",
    );
    assert_eq!(ran.json()["outcome"], "done", "{}", ran.text());
    let plans = rig.of(true);
    assert_eq!(plans.len(), 2, "{plans:?}");
    let starts: Vec<i64> =
        plans.iter().map(|(_, what)| what.rsplit(' ').next().unwrap().parse().unwrap()).collect();
    assert_eq!(starts[0], starts[1], "both start at one instant");
    assert!(plans.iter().all(|(at, _)| *at < starts[0] - 20_000_000), "told ahead: {plans:?}");
    let mut sets = rig.sets();
    let firsts: Vec<i64> = sets[..2].iter().map(|(at, _)| at - starts[0]).collect();
    assert!(firsts.iter().all(|late| *late >= 0), "before the start: {firsts:?} ns");
    println!(
        "starts after the plan by the driver's own log: {firsts:?} ns, spread {} ns",
        (firsts[0] - firsts[1]).abs()
    );
    // The edge's log of set values contains the program's reports, not the plan.
    let (_, said) = rig.edge.end();
    assert!(!said.contains("warning"), "{said}");
    let text = std::fs::read_to_string(rig.session.path("edge.jsonl")).unwrap();
    let entry = |line: &str| serde_json::from_str::<serde_json::Value>(line).unwrap();
    let logged: Vec<_> = text.lines().map(entry).filter(|entry| entry["step"].is_u64()).collect();
    let mut told: Vec<_> = logged
        .iter()
        .map(|e| {
            (e["true_ns"].as_i64().unwrap(), format!("{} {}", e["device"].as_str().unwrap(), e["value"]))
        })
        .collect();
    told.sort();
    sets.sort();
    assert_eq!(told.len(), 5, "{text}");
    let plain = |line: &Line| line.1.trim_end_matches(".0").to_owned();
    for device in ["left", "right"] {
        let of = |lines: &[Line]| {
            lines.iter().filter(|line| line.1.starts_with(device)).cloned().collect::<Vec<_>>()
        };
        for (told, set) in of(&told).iter().zip(of(&sets)) {
            assert_eq!(plain(told), plain(&set));
            assert!(told.0 >= set.0 && told.0 - set.0 < 500_000_000, "{told:?} {set:?}");
        }
    }
}

#[test]
fn program_with_horizon_receives_steps_incrementally() {
    let Some(rig) = Rig::start("horizon", &[]) else { return };
    let ran = rig
        .play("{at: 0s, to: 1}, {at: 500ms, to: 2}, {at: 1s, to: 3}, {at: 1500ms, to: 4}", "{at: 0s, to: 5}");
    assert_eq!(ran.json()["outcome"], "done", "{}", ran.text());
    let left: Vec<_> = rig.played().into_iter().filter(|set| set.starts_with("left")).collect();
    assert_eq!(left, ["left 1", "left 2", "left 3", "left 4"]);
    let plans = rig.of(true);
    let told = plans.iter().find(|(_, what)| what.starts_with("plan left")).unwrap();
    assert!(!told.1.starts_with("plan left 4"), "all at once: {told:?}");
}

#[test]
fn stop_during_script_is_confirmed_after_the_program_ended_it() {
    let Some(mut rig) = Rig::start("script", &[]) else { return };
    let said = rig.meanwhile(|rig| {
        rig.session.run(&["stop"]).says(0, &["confirmed"]);
        let stopped = rig.played();
        std::thread::sleep(Duration::from_millis(1_300));
        assert_eq!(rig.played(), stopped, "it moves after its stop");
    });
    assert!(!said.contains("NOT confirmed"), "{said}");
}

#[test]
fn mission_is_not_done_if_program_reports_nothing_about_its_scripts() {
    let Some(rig) = Rig::start("mute", &[]) else { return };
    let ran = rig.play("{at: 0s, to: 1}, {at: 300ms, to: 2}", "{at: 0s, to: 5}");
    assert!([1, 4].contains(&ran.code()), "{}", ran.text());
    assert_ne!(ran.json()["outcome"], "done");
    assert!(ran.text().contains("its driver did not report its start"), "{}", ran.text());
}

#[test]
fn step_failure_is_reported_with_step_number_and_reason() {
    let Some(rig) = Rig::start("script", &[]) else { return };
    let ran = rig.play(
        "{at: 0s, to: 1}, {at: 300ms, to: 2}, {at: 600ms, to: 66}, {at: 900ms, to: 3}",
        "{at: 0s, to: 5}",
    );
    assert!([1, 4].contains(&ran.code()), "{}", ran.text());
    assert!(ran.text().contains("the hardware failed in step 3: RuntimeError: torque"), "{}", ran.text());
    assert!(!rig.played().contains(&"left 3".to_owned()), "{:?}", rig.sets());
}

#[test]
fn program_death_during_script_fails_the_mission_and_restarts_the_program() {
    let Some(rig) = Rig::start("script", &[]) else { return };
    let ran = rig.play("{at: 0s, to: 1}, {at: 300ms, to: 77}, {at: 900ms, to: 3}", "{at: 0s, to: 5}");
    assert!([1, 4].contains(&ran.code()), "{}", ran.text());
    assert!(ran.text().contains("has ended"), "{}", ran.text());
    rig.edge.await_hardware();
    assert!(!rig.played().contains(&"left 3".to_owned()), "{:?}", rig.sets());
}

#[test]
fn killing_the_edge_ends_the_script_in_the_program() {
    let Some(mut rig) = Rig::start("script", &[]) else { return };
    rig.meanwhile(|rig| {
        signal(&rig.edge.0, Signal::KILL);
        await_that("the end of the program", || rig.log().iter().any(|line| line.1 == "end"));
        let ended = rig.sets().len();
        std::thread::sleep(Duration::from_millis(1_300));
        assert_eq!(rig.sets().len(), ended, "{:?}", rig.sets());
        // The mission would wait for its robot for a while.
        let _said = rig.session.run(&["stop"]);
    });
}

#[test]
fn show_with_only_assumed_steps_is_not_done() {
    let Some(rig) = Rig::start("dead", &[]) else { return };
    let ran = rig.play("{at: 0s, to: 1}, {at: 300ms, to: 2}", "{at: 0s, to: 5}");
    assert!([1, 4].contains(&ran.code()), "{}", ran.text());
    assert_eq!(ran.json()["outcome"], "failed", "{}", ran.text());
    assert!(ran.text().contains("its driver did not observe its end"), "{}", ran.text());
}

#[test]
fn controller_death_before_start_prevents_start() {
    let Some(rig) = Rig::start("silent", &[]) else { return };
    let ran = rig.play("{at: 0s, to: 1}, {at: 300ms, to: 2}", "{at: 0s, to: 5}");
    assert_ne!(ran.code(), 0, "{}", ran.text());
    assert_ne!(ran.json()["outcome"], "done");
    assert!(ran.text().contains("the hardware has "), "{}", ran.text());
    assert!(rig.sets().is_empty(), "{:?}", rig.sets());
}
