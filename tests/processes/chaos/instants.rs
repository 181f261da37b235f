//! Missions of three robots, two or three acts, and two or three scripts per device. One robot is frozen, killed, cut off or restarted at
//! a random instant. Report and exit code have to agree with the robots' own logs. `DOWNBEAT_INSTANTS=100` sets the number of missions,
//! `DOWNBEAT_INSTANTS_FIRST=17` the number of the first one.

use std::collections::{BTreeMap, HashSet};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use serde_json::Value;
use stage::{Ended, Logged, Stage, Via, epoch_nanos, nanos};

const ROBOTS: usize = 3;
/// Number of steps of one script.
const STEPS: usize = 4;
/// Number of consecutive values that are reserved for each act, so that a value identifies its act.
const VALUES: usize = 20;
/// Lease of the scripts, in nanoseconds: how long a robot plays without a message from the scheduler.
const LEASE: i64 = 700_000_000;
/// Maximum delay that a busy machine may cause, in nanoseconds.
const BUSY: i64 = 250_000_000;

/// A fault of a robot, and its duration; `None` if it is permanent.
#[derive(Clone, Copy, Debug)]
enum Fault {
    Frozen(Option<Duration>),
    /// The robot's link is closed, and new connections are refused.
    Cut(Option<Duration>),
    /// The robot's link is closed; new connections stay open and carry nothing.
    Interrupted(Option<Duration>),
    /// The robot's link stays open and carries nothing.
    Muted(Option<Duration>),
    Killed,
    Restarted,
}

/// A random mission and its fault, all derived from one seed.
#[derive(Debug)]
struct Drawn {
    queue: usize,
    on_failure: &'static str,
    /// Number of scripts per device, for each act.
    acts: Vec<usize>,
    /// Interval between two steps, in milliseconds.
    every_ms: usize,
    victim: usize,
    fault: Fault,
    after: Duration,
}

impl Drawn {
    fn of(seed: u64) -> Self {
        let mut rng = fastrand::Rng::with_seed(seed);
        let acts: Vec<usize> = (0..rng.usize(2..=3)).map(|_| rng.usize(2..=3)).collect();
        let queue = rng.usize(2..=3);
        // A device that receives a chain in parts needs scripts of one second.
        let every_ms = if acts.iter().all(|scripts| *scripts <= queue) { 100 } else { 260 };
        let lasts = rng.bool().then(|| Duration::from_millis(rng.u64(20..1_500)));
        let fault = match rng.u8(0..6) {
            0 => Fault::Frozen(lasts),
            1 => Fault::Cut(lasts),
            2 => Fault::Interrupted(lasts),
            3 => Fault::Muted(lasts),
            4 => Fault::Killed,
            _ => Fault::Restarted,
        };
        let on_failure = if rng.u8(0..4) == 0 { "without" } else { "stop" };
        let steps: usize = acts.iter().map(|scripts| scripts * STEPS).sum();
        let whole = 900 + 300 * acts.len() + steps * every_ms;
        let after = Duration::from_millis(rng.u64(0..whole as u64));
        Self { queue, on_failure, acts, every_ms, victim: rng.usize(0..ROBOTS), fault, after }
    }

    fn values(&self) -> Vec<f64> {
        let of_act = |(act, scripts): (usize, &usize)| (0..scripts * STEPS).map(move |step| value(act, step));
        self.acts.iter().enumerate().flat_map(of_act).collect()
    }

    fn scenario(&self) -> String {
        let Self { on_failure, every_ms, .. } = self;
        let head = format!("scenario: instants\nstart_tolerance: 1s\non_failure: {on_failure}\n");
        let act = |(act, scripts): (usize, &usize)| {
            let keyframe = |step| format!("{{at: {}ms, to: {}}}", step * every_ms, value(act, step));
            let track = (0..scripts * STEPS).map(keyframe).collect::<Vec<_>>().join(", ");
            format!(
                "  - act: act-{act}\n    cues:\n      - {{at: 0s, robots: all, tracks: {{d: [{track}]}}}}\n"
            )
        };
        let acts: String = self.acts.iter().enumerate().map(act).collect();
        format!("{head}stop_condition: {{running: {}ms}}\nacts:\n{acts}", LEASE / 1_000_000)
    }

    fn stage(&self) -> Stage {
        let mut stage = Stage::new();
        stage
            .file("robot.yaml", stage::one_device(self.queue, 90, STEPS))
            .file("instants.yaml", self.scenario());
        for id in 0..ROBOTS {
            stage.robot("robot.yaml", if id == self.victim { Via::Proxy } else { Via::Direct });
        }
        stage
    }

    /// Causes the fault. If it is temporary, waits for its duration and ends it.
    fn strike(&self, stage: &mut Stage) {
        let wait = |lasts: Option<Duration>| lasts.map(std::thread::sleep).is_some();
        let robot = &mut stage.robots[self.victim];
        match self.fault {
            Fault::Killed => robot.kill(),
            Fault::Restarted => stage.restart(self.victim),
            Fault::Frozen(lasts) => {
                robot.freeze();
                if wait(lasts) {
                    robot.thaw();
                }
            }
            Fault::Cut(lasts) | Fault::Interrupted(lasts) | Fault::Muted(lasts) => {
                let link = robot.link.as_ref().unwrap();
                match self.fault {
                    Fault::Cut(_) => link.cut(),
                    Fault::Interrupted(_) => link.interrupt(),
                    _ => link.freeze(),
                }
                if wait(lasts) {
                    link.open();
                }
            }
        }
    }

    /// Whether the faulty robot's process is killed, so that the end of its log may be missing.
    fn loses_its_memory(&self) -> bool {
        matches!(self.fault, Fault::Killed | Fault::Restarted)
    }
}

fn value(act: usize, step: usize) -> f64 {
    (1 + VALUES * act + step) as f64
}

struct Played {
    drawn: Drawn,
    ended: Ended,
    report: Value,
    /// Time at which the program ended, by the host's clock, in nanoseconds.
    gone: i64,
    /// For each robot, the values of scripts that it set.
    sets: Vec<Vec<Logged>>,
}

fn play(seed: u64) -> Played {
    let drawn = Drawn::of(seed);
    let mut stage = drawn.stage();
    let running = stage.start(&["run", "instants.yaml", "--format", "json", "--patience", "2s"]);
    std::thread::sleep(drawn.after);
    drawn.strike(&mut stage);
    let ended = running.ended();
    let gone = epoch_nanos();
    // After this, every lease has ended; a robot that is frozen permanently does nothing more.
    std::thread::sleep(Duration::from_nanos((LEASE + BUSY).unsigned_abs()));
    let sets = stage.robots.iter().map(stage::Robot::sets).collect();
    let report = ended.report();
    Played { drawn, ended, report, gone, sets }
}

/// Collects contradictions between the report of a mission and the robots' logs.
struct Judge<'a> {
    played: &'a Played,
    wrong: Vec<String>,
}

impl Judge<'_> {
    fn find(played: &Played) -> Vec<String> {
        let mut judge = Judge { played, wrong: Vec::new() };
        judge.exit_code();
        for robot in 0..ROBOTS {
            judge.row(robot);
            judge.log(robot);
        }
        judge.acts();
        judge.together();
        judge.blame();
        judge.wrong
    }

    fn say(&mut self, is_wrong: bool, what: impl FnOnce() -> String) {
        if is_wrong {
            self.wrong.push(what());
        }
    }

    fn outcome(&self) -> &str {
        self.played.report["outcome"].as_str().unwrap_or("?")
    }

    fn exit_code(&mut self) {
        let rows = self.played.report["robots"].as_array().unwrap();
        let unconfirmed = rows.iter().any(|row| row["stop"]["state"] == "unconfirmed");
        let (code, outcome) = (self.played.ended.code, self.outcome());
        let fits = match (outcome, unconfirmed) {
            ("done", _) => code == Some(0),
            (_, true) => code == Some(4),
            ("done_without", _) => code == Some(5),
            _ => code == Some(1),
        };
        let what = format!("(code) outcome {outcome}, unconfirmed stops: {unconfirmed}, exit code {code:?}");
        self.say(!fits, || what);
    }

    /// Checks the row of the report about one robot, which covers all acts, against the robot's log.
    fn row(&mut self, robot: usize) {
        let row = &self.played.report["robots"][robot];
        let victim = robot == self.played.drawn.victim;
        let set = self.played.sets[robot].len() as u64;
        let said = row["steps_done"].as_u64().unwrap();
        let confirmed = row["stop"]["state"] == "confirmed";
        let certain = row["stop"]["state"] != "unconfirmed" && row["unaccounted"] == 0;
        let torn = u64::from(victim && self.played.drawn.loses_its_memory());
        self.say(said > set + torn, || format!("(more) r{robot} reportedly did {said} steps, but did {set}"));
        self.say(certain && said < set, || {
            format!("(fewer) r{robot} certainly did {said} steps by its report, but did {set}")
        });
        let still = row["started"] == 0 && certain;
        self.say(still && set > 0, || {
            format!("(moved) r{robot} reportedly did not start, but did {set} steps")
        });
        let unstarted = self.outcome() == "not_started" && (certain || !victim);
        self.say(unstarted && set > 0, || format!("(moved) not started, and r{robot} did {set} steps"));
        let gone = self.played.gone;
        let after = self.played.sets[robot].iter().filter(|entry| entry.at > gone).count();
        self.say(confirmed && after > 0, || {
            format!("(stop) r{robot} has confirmed its stop, and then did {after} steps")
        });
        let lease_ends = row["stop"]["lease_ends"].as_str().map(nanos);
        let beyond = |end: i64| self.played.sets[robot].iter().filter(|entry| entry.at > end + BUSY).count();
        let beyond = lease_ends.map_or(0, beyond);
        self.say(beyond > 0, || format!("(lease) r{robot} did {beyond} steps after the end of its lease"));
    }

    /// Checks a robot's log: every value occurs at most once, and in order. If the mission is done, all values occur.
    fn log(&mut self, robot: usize) {
        let planned = self.played.drawn.values();
        let set: Vec<f64> = self.played.sets[robot].iter().map(|entry| entry.value).collect();
        let sorted = set.windows(2).all(|pair| pair[0] < pair[1]);
        self.say(!sorted, || format!("(order) r{robot} set {set:?}"));
        let mut seen = HashSet::new();
        let twice = self.played.sets[robot].iter().any(|entry| !seen.insert((&entry.request, entry.step)));
        self.say(twice, || format!("(twice) r{robot} did a step twice: {set:?}"));
        let failures = self.played.report["failures"].as_array().unwrap();
        let failed = failures.iter().any(|failure| failure["robot"] == format!("r{robot}"));
        let all = self.outcome() == "done" || (self.outcome() == "done_without" && !failed);
        let what = format!("(done) {}, and r{robot} set {set:?} of {planned:?}", self.outcome());
        self.say(all && set != planned, || what);
    }

    /// Checks the report about each script against the robots' logs.
    fn acts(&mut self) {
        for act in self.played.report["acts"].as_array().unwrap() {
            let number: usize = act["act"].as_str().unwrap().rsplit('-').next().unwrap().parse().unwrap();
            for said in act["robots"].as_array().unwrap() {
                let robot = said["robot"].as_str().unwrap()[1..].parse().unwrap();
                for (script, device) in said["devices"].as_array().unwrap().iter().enumerate() {
                    self.script((number, robot, script), device);
                }
            }
        }
    }

    fn script(&mut self, (act, robot, script): (usize, usize, usize), device: &Value) {
        let first = value(act, script * STEPS);
        let own = first..first + STEPS as f64;
        let set = self.played.sets[robot].iter().filter(|entry| own.contains(&entry.value)).count() as u64;
        let (state, said) = (device["state"].as_str().unwrap(), device["steps_done"].as_u64().unwrap());
        let torn = u64::from(robot == self.played.drawn.victim && self.played.drawn.loses_its_memory());
        let which = format!("act {act}, r{robot}, script {script}: `{state}` with {said} steps, did {set}");
        let ended = state == "ended" && (said != STEPS as u64 || set + torn < STEPS as u64);
        let never = state == "planned" && set > 0;
        self.say(said > set + torn || ended || never, || format!("(script) {which}"));
    }

    /// Checks for each act that all robots without a fault start it, or none of them does.
    fn together(&mut self) {
        let sound = || (0..ROBOTS).filter(|robot| *robot != self.played.drawn.victim);
        for act in 0..self.played.drawn.acts.len() {
            let first = value(act, 0);
            let began = |robot: &usize| self.played.sets[*robot].iter().any(|entry| entry.value == first);
            let count = sound().filter(began).count();
            self.say(count % (ROBOTS - 1) != 0, || {
                format!("(mixed) act {act} was started by {count} of the others")
            });
        }
    }

    /// Checks that no robot without a fault has failed. These robots may only seem silent, because the machine is busy.
    fn blame(&mut self) {
        let victim = format!("r{}", self.played.drawn.victim);
        for failure in self.played.report["failures"].as_array().unwrap() {
            let blamed = failure["robot"] != victim && failure["failure"] != "silent";
            self.say(blamed, || format!("(blame) {failure}"));
        }
    }
}

fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok().and_then(|text| text.parse().ok())
}

#[test]
fn report_and_exit_code_agree_with_robot_logs_under_random_faults() {
    let first = number("DOWNBEAT_INSTANTS_FIRST").unwrap_or(0);
    let missions = number("DOWNBEAT_INSTANTS").unwrap_or(8);
    let next = AtomicU64::new(first);
    let all = Mutex::new((Vec::new(), BTreeMap::<String, u32>::new()));
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= first + missions {
                        return;
                    }
                    let played = play(seed);
                    let found = Judge::find(&played);
                    let mut all = all.lock().unwrap();
                    *all.1.entry(played.report["outcome"].to_string()).or_default() += 1;
                    if !found.is_empty() {
                        let found = found.join("\n  ");
                        all.0.push(format!(
                            "mission {seed}, {:?}:\n  {found}\n{}",
                            played.drawn, played.ended
                        ));
                    }
                }
            });
        }
    });
    let (wrong, outcomes) = all.into_inner().unwrap();
    println!("{missions} missions: {outcomes:?}");
    assert!(wrong.is_empty(), "{} of {missions} missions:\n{}", wrong.len(), wrong.join("\n\n"));
}
