//! Compares dry runs with reality. Processes play each example over TCP, and the mission is recorded. `downbeat world` measures the links
//! and clocks of that mission. A dry run with these measurements has to make the same decisions and set the same values.
//!
//! The report of the real mission states the delay with which a busy machine wakes a robot: as its largest start error, its allowance for
//! wake-ups, and its robots' late steps. These figures and the clock errors that `downbeat world` states are the permitted differences. A
//! slow machine therefore increases the figures without failing a test.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use downbeat::dry_run::{Logs, Played};
use downbeat::mission::MissionOptions;
use downbeat::trials::Trials;
use downbeat_scripts::{ClockWorld, Folder, Project, Source, World, compile, read_fleet_within, read_world};
use serde_json::{Value, json};
use urrcp::Span;

use stage::session::root;
use stage::{Logged, Stage, nanos};

/// Delay in milliseconds from which a robot counts a step as late (`late_steps` in docs/protocol.md).
const LATE_MS: f64 = 1.0;
/// Precision to which a report rounds times, in milliseconds.
const ROUNDED_MS: f64 = 0.001;

struct Show {
    name: &'static str,
    robots: &'static [&'static str],
    /// Whether an operator gives the go, which the second act waits for.
    attended: bool,
}

const SHOWS: [Show; 6] = [
    Show { name: "wave", robots: &["arm-1", "arm-2"], attended: false },
    Show { name: "swap", robots: &["cf1", "cf2", "cf3", "cf4", "cf5", "cf6"], attended: false },
    Show { name: "tank", robots: &["tank-1"], attended: false },
    Show { name: "meeting", robots: &["arm-1", "arm-2", "rover-1"], attended: false },
    Show { name: "dance", robots: &["wolf-1", "wolf-2", "wolf-3"], attended: false },
    Show { name: "cue", robots: &["tank-1"], attended: true },
];

/// A scenario that waits for an operator, which none of the repository's examples does.
const CUE: &str = "scenario: cue
stop_condition: {running: 1s}
acts:
  - act: there
    cues: [{at: 0s, robots: tank-1, tracks: {left_engine: [{at: 0s, to: 20}, {at: 400ms, to: 0}]}}]
  - act: back
    wait: operator
    cues: [{at: 0s, robots: tank-1, tracks: {left_engine: [{at: 0s, to: -20}, {at: 400ms, to: 0}]}}]
";

/// Returns the path of the description of a robot of the demo fleet.
fn init_of(robot: &str) -> String {
    let name = match robot.split(['-', '1', '2', '3', '4', '5', '6']).next() {
        Some("arm") => "ur5e",
        Some("cf") => "crazyflie",
        Some("rover") => "rover",
        Some("tank") => "tank",
        Some("wolf") => "wolfgang",
        _ => panic!("no description of {robot}"),
    };
    root().join(format!("scripts/examples/robots/{name}.yaml")).display().to_string()
}

impl Show {
    /// Starts the robots of the show, and writes its scenario and the demo fleet with their addresses. The start tolerance becomes 1 s: a
    /// busy machine may start a robot later than the example tolerates, which would change the outcome.
    fn stage(&self) -> Stage {
        let mut stage = Stage::new();
        let scripts = format!("init: {}/scripts/", root().display());
        let mut fleet =
            std::fs::read_to_string(root().join("fleet.yaml")).unwrap().replace("init: scripts/", &scripts);
        for id in self.robots {
            let readings: &[&str] = match *id {
                "rover-1" => &["--reading", "range=0.4", "--reading", "battery=80"],
                _ => &[],
            };
            let args = readings.iter().map(|arg| (*arg).to_owned()).collect();
            let port = stage.robot_called(id, &init_of(id), args);
            let row = fleet.find(&format!("\n  {id}:")).unwrap();
            let rest = fleet.split_off(row);
            fleet += &rest.replacen("address: sim", &format!("address: \"tcp://127.0.0.1:{port}\""), 1);
        }
        let scenario = match self.name {
            "cue" => CUE.to_owned(),
            name => std::fs::read_to_string(root().join(format!("scripts/examples/{name}.yaml"))).unwrap(),
        };
        let scenario = scenario.replace("start_tolerance: 5ms\n", "");
        stage.file("fleet.yaml", fleet).file("show.yaml", format!("start_tolerance: 1s\n{scenario}"));
        stage
    }

    /// Plays the show with processes, measures the links and clocks of that mission, and returns its report.
    fn play(&self, stage: &Stage) -> Value {
        // The descriptions of the robots are in the repository, outside the stage.
        let run = ["run", "show.yaml", "--project", "/", "--record", "real.mcap", "--format", "json"];
        let running = stage.start(&run);
        while self.attended && stage.run(&["go"]).code != Some(0) {
            std::thread::sleep(Duration::from_millis(50));
        }
        let ended = running.ended_within(Duration::from_secs(120));
        let ended = ended.unwrap_or_else(|told| panic!("{} hangs: {told}", self.name));
        let measured = stage.run(&["world", "real.mcap", "--output", "world.yaml"]);
        assert_eq!(measured.code, Some(0), "{}: {ended}{measured}", self.name);
        let measured = stage.run(&["world", "real.mcap", "--format", "json"]).report();
        let surely_off = largest(&measured, "surely_off_ms");
        assert!(surely_off < 1.0, "{}: all read one clock, and one is {surely_off} ms off", self.name);
        ended.report()
    }

    /// Plays the show in virtual time, with the links and clocks that were measured in the real mission.
    fn rehearse(&self, stage: &Stage) -> (Played, World) {
        let (fleet, findings) =
            read_fleet_within(&stage.path("fleet.yaml"), &Project::within(Path::new("/")).unwrap());
        let fleet = fleet.unwrap_or_else(|| panic!("{findings:?}"));
        let source = Source::read(&stage.path("show.yaml")).unwrap();
        let compiled = compile(&source, &fleet, &Folder::new(stage.path("")));
        let choreography = compiled.choreography.unwrap_or_else(|| panic!("{:?}", compiled.findings));
        let acts: Vec<_> = choreography.acts.iter().map(|act| act.called()).collect();
        let (world, findings) = read_world(&stage.path("world.yaml"), &fleet, &acts);
        let world = world.unwrap_or_else(|| panic!("{findings:?}"));
        let options =
            MissionOptions { greeting: downbeat::fleet::greeting(&fleet), ..MissionOptions::default() };
        let trials = Trials::new(&choreography, &fleet, &world, options, 0);
        let played = trials.play_one(0, Logs::Kept, &mut ()).unwrap();
        (played, world)
    }
}

/// Returns some rows of a report, reduced to these keys.
fn only(rows: &Value, keys: &[&str]) -> Value {
    let row = |row: &Value| keys.iter().map(|key| ((*key).to_owned(), row[*key].clone())).collect();
    rows.as_array().into_iter().flatten().map(row).map(Value::Object).collect()
}

/// Returns the part of a report that is the same in every run of a plan: everything except times, session names and repetitions. The
/// numbers of acts count repetitions, so they are omitted too.
fn decided(report: &Value) -> Value {
    let robot = |robot: &Value| json!([robot["robot"], robot["left_out"], only(&robot["devices"], &DEVICE)]);
    let act = |act: &Value| {
        let robots: Vec<_> = act["robots"].as_array().unwrap().iter().map(robot).collect();
        json!([act["act"], robots, only(&act["readings"], &["robot", "sensor", "value"])])
    };
    let acts: Vec<_> = report["acts"].as_array().unwrap().iter().map(act).collect();
    json!({
        "outcome": report["outcome"],
        "course": report["course"],
        "acts": acts,
        "robots": only(&report["robots"], &ROBOT),
        "failures": report["failures"],
    })
}

const DEVICE: [&str; 4] = ["device", "state", "steps_done", "steps_planned"];
const ROBOT: [&str; 8] =
    ["robot", "standing", "accepted", "started", "scripts", "steps_done", "steps_planned", "unaccounted"];

/// A value that a device was set to.
#[derive(Debug)]
struct Set {
    /// Kind of motion; robot and script as `robot/script`; step; value.
    what: (String, String, Option<u64>, f64),
    /// Number of the act; `None` if the value belongs to no act.
    act: Option<u64>,
    /// Time at which the value was set, by the true clock, in nanoseconds.
    at: i64,
}

impl Set {
    fn new(motion: &str, request: &str, step: Option<u64>, value: f64, at: i64) -> Self {
        // Ids end with act, robot and script; sessions and times precede them.
        let mut parts = request.rsplitn(4, '/');
        let (script, robot, act) = (parts.next(), parts.next(), parts.next());
        let of = [robot, script].map(Option::unwrap_or_default).join("/");
        let act = act.and_then(|act| act.parse().ok());
        Self { what: (motion.to_owned(), of, step, value), act, at }
    }
}

/// Groups the set values by device, in order. Ramps are omitted, because a late robot skips a ramp whose time is over.
fn by_device(sets: impl Iterator<Item = (String, Set)>) -> BTreeMap<String, Vec<Set>> {
    let mut devices: BTreeMap<String, Vec<Set>> = BTreeMap::new();
    for (device, set) in sets.filter(|(_, set)| set.what.0 != "ramp") {
        devices.entry(device).or_default().push(set);
    }
    devices
}

fn really_set(log: Vec<Logged>) -> BTreeMap<String, Vec<Set>> {
    let set = |entry: &Logged| Set::new(&entry.motion, &entry.request, entry.step, entry.value, entry.at);
    by_device(log.iter().map(|entry| (entry.device.clone(), set(entry))))
}

fn set_in_dry_run(played: &Played, robot: &str) -> BTreeMap<String, Vec<Set>> {
    let log = played.log_of(&robot.parse().unwrap()).unwrap();
    by_device(log.iter().map(|entry| {
        let request = entry.request_id.as_deref().unwrap_or_default();
        let step = entry.step.map(u64::from);
        (
            entry.device.to_string(),
            Set::new(&entry.motion.to_string(), request, step, entry.value, entry.true_ns),
        )
    }))
}

/// Returns the largest number under this key, anywhere in a report.
fn largest(value: &Value, key: &str) -> f64 {
    let inside = |value: &Value| largest(value, key);
    match value {
        Value::Object(map) => {
            let own = map.get(key).and_then(Value::as_f64).map_or(0.0, f64::abs);
            map.values().map(inside).fold(own, f64::max)
        }
        Value::Array(values) => values.iter().map(inside).fold(0.0, f64::max),
        _ => 0.0,
    }
}

/// Returns the act to which a value belongs; `None` if it belongs to no act of the report.
fn act_of<'a>(set: &Set, report: &'a Value) -> Option<&'a Value> {
    let number = set.act?;
    report["acts"].as_array().unwrap().iter().find(|act| act["number"] == number)
}

fn name_of_act(set: &Set, report: &Value) -> Option<String> {
    act_of(set, report).map(|act| act["act"].to_string())
}

/// Skips the rests at the beginning. Each attempt that this machine was too slow for ends with a stop, and a device at rest logs this
/// stop as a rest.
fn after_attempts<'s>(sets: &'s [Set], report: &Value) -> &'s [Set] {
    let attempts = report["acts"][0]["prepared_again"].as_u64().unwrap_or_default();
    let rests = sets.iter().take_while(|set| set.act.is_none() && set.what.0 == "rest").count();
    &sets[rests.min(usize::try_from(attempts).unwrap())..]
}

/// Returns how long after the planned start of its act a value was set, in milliseconds.
fn after_start(set: &Set, report: &Value) -> f64 {
    let act = act_of(set, report).unwrap();
    (set.at - nanos(act["start"].as_str().unwrap())) as f64 / 1e6
}

/// Returns the largest clock error of a measured world, in milliseconds: the error that the recording cannot exclude.
fn clock_error(world: &World) -> f64 {
    let error = |clock: &ClockWorld| clock.error.unwrap_or(Span::ZERO).as_millis_f64();
    world.clocks.iter().flatten().map(error).fold(0.0, f64::max)
}

/// The largest differences between the times of two runs.
#[derive(Default)]
struct Apart {
    steps: usize,
    /// Largest difference for the first steps of scripts, in milliseconds; `others` is that of all other steps.
    starts: f64,
    others: f64,
    /// Number of steps whose difference is larger than that of a robot that is not late.
    beyond: u64,
}

#[track_caller]
#[expect(clippy::print_stdout, reason = "the figures that docs/rehearse.md shows")]
fn agree(show: &Show, stage: &Stage, real: &Value, (dry, world): &(Played, World)) {
    let name = show.name;
    let report = serde_json::to_value(&dry.report).unwrap();
    assert_eq!(decided(real), decided(&report), "{name}: what was decided");
    assert_eq!(real["outcome"], "done", "{name}");
    let (start_error, clock) = (largest(real, "start_error_ms"), clock_error(world));
    let within = largest(real, "wake_up_ms") + clock;
    let mut apart = Apart::default();
    for (robot, process) in show.robots.iter().zip(&stage.robots) {
        let (really, dry) = (really_set(process.log()), set_in_dry_run(dry, robot));
        assert!(really.keys().eq(dry.keys()) && !really.is_empty(), "{name}: devices of {robot}");
        for ((device, really_set), dry_set) in really.iter().zip(dry.values()) {
            let (really_set, dry_set) = (after_attempts(really_set, real), after_attempts(dry_set, &report));
            let what = |sets: &[Set], report: &Value| {
                sets.iter().map(|set| (name_of_act(set, report), set.what.clone())).collect::<Vec<_>>()
            };
            assert_eq!(what(really_set, real), what(dry_set, &report), "{name}: {robot}/{device}");
            for (really, dry) in really_set.iter().zip(dry_set).filter(|(really, _)| really.act.is_some()) {
                let by = (after_start(really, real) - after_start(dry, &report)).abs();
                apart.steps += 1;
                if really.what.2 == Some(0) {
                    apart.starts = apart.starts.max(by);
                } else {
                    apart.others = apart.others.max(by);
                    apart.beyond += u64::from(by > LATE_MS + within);
                }
            }
        }
    }
    let Apart { steps, starts, others, beyond } = apart;
    let rows = real["robots"].as_array().unwrap().iter();
    let late: u64 = rows.map(|robot| robot["late_steps"].as_u64().unwrap()).sum();
    println!(
        "{name}: {steps} steps the same; starts at most {starts:.3} ms apart, other steps {others:.3} ms (start error {start_error:.3} ms, \
         clocks {clock:.3} ms); {beyond} steps more than {:.3} ms apart, {late} reported late",
        LATE_MS + within
    );
    assert!(starts <= start_error + within + ROUNDED_MS, "{name}: a start {starts} ms apart");
    assert!(beyond <= late, "{name}: {beyond} steps apart, and only {late} were late");
}

#[test]
fn dry_runs_in_measured_world_agree_with_real_missions() {
    std::thread::scope(|scope| {
        for show in &SHOWS {
            scope.spawn(move || {
                let play = || {
                    let stage = show.stage();
                    let real = show.play(&stage);
                    (stage, real)
                };
                let (stage, real) = stage::held_up::played(play, |(_, real)| real.to_string());
                agree(show, &stage, &real, &show.rehearse(&stage));
            });
        }
    });
}
