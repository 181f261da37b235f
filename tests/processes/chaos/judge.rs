//! Checks whether the reports of a mission agree with the robots' logs, and whether the robots' actions were permitted.

use std::collections::{BTreeMap, HashSet};

use downbeat::mission::PromisedScript;
use downbeat_robot::set_log::{LogEntry, MotionKind};
use downbeat_scripts::DeviceScript;
use downbeat_simulation::trajectory::{Promised, unexplained};
use serde_json::Value;

use super::draw::{Back, DELAY_MS, Fault, STEPS, VALUES, value};
use super::held_up;
use super::play::{Kind, Played, Struck, Told, What};
use stage::{Logged, nanos};

const MILLIS: i64 = 1_000_000;
/// Maximum delay of a start, in nanoseconds: a robot that would start later than this does not start.
const START_LATE: i64 = 51 * MILLIS;
/// Maximum delay of a step, in nanoseconds, that a busy machine excuses if the step is reported as late. Excused steps are counted.
const STEP_LATE: i64 = 500 * MILLIS;
/// Time that a message and its answer may take, in nanoseconds, including the handling by a process.
const UNDER_WAY: i64 = (2 * DELAY_MS as i64 + 20) * MILLIS;
/// Time before the start, in nanoseconds, after which a stop may cancel the start of some robots but not of others: three round trips, 20
/// ms, and the time to send the stop.
const NO_RETURN: i64 = 3 * UNDER_WAY + 40 * MILLIS;
/// Time within which an operator's stop brings every reachable robot to rest, in nanoseconds, however busy the machine is.
const AT_REST: i64 = 3_000 * MILLIS;
/// Time after which `downbeat stop` no longer waits for a scheduler that does not answer, in nanoseconds.
const GIVEN_UP: i64 = 1_000 * MILLIS;
/// A pause of the machine, in nanoseconds, that may make a robot seem silent, if it occurs within `SHORTLY` before the end of the
/// program.
const HELD_UP: i64 = 30 * MILLIS;
const SHORTLY: i64 = 3_000 * MILLIS;
/// Time to start a process on a busy machine, in nanoseconds.
const PROCESS: i64 = 500 * MILLIS;

/// The findings about a mission.
#[derive(Default)]
pub struct Verdict {
    pub wrong: Vec<String>,
    /// For each promised act: `all` or `none` if all or no robots started, otherwise why only some did.
    pub acts: Vec<&'static str>,
    /// Other deviations, excused because the machine was busy.
    pub busy: Vec<String>,
    /// Number of robots that were reported as failed because the scheduler was suspended before it promised any act.
    pub greetings: u32,
}

pub fn judge(played: &Played) -> Verdict {
    let promises = promises(&played.journal);
    let acts = played.drawn.acts.len();
    let homes = promises.iter().filter(|promise| promise.act >= acts).flat_map(|home| home.scripts.keys());
    let homes: HashSet<&str> = homes.map(String::as_str).collect();
    let is_home = |entry: &Logged| homes.contains(entry.request.as_str());
    let sets = played.sets.iter().map(|sets| sets.iter().filter(|set| !is_home(set)).cloned().collect());
    let home = played.sets.iter().map(|sets| sets.iter().filter(|set| is_home(set)).cloned().collect());
    let (sets, home) = (sets.collect(), home.collect());
    let mut judge = Judge { played, sets, home, promises: promises.clone(), verdict: Verdict::default() };
    judge.programs();
    judge.starts();
    for robot in 0..played.drawn.robots() {
        judge.log(robot);
        judge.in_time(robot);
        judge.leases(robot);
        judge.confirmed(robot);
        judge.movements(robot);
    }
    judge.operators_stop();
    for told in &played.told {
        if let Some(report) = told.report() {
            judge.report(told, &report);
        }
    }
    judge.verdict
}

/// Whether this is the report of a `downbeat stop` that stopped the robots itself, which contains no information about the acts.
fn is_withdrawal(report: &Value) -> bool {
    report["acts"].is_null()
}

/// An act that the scheduler has promised by a record in the journal.
#[derive(Clone)]
struct Promise {
    /// Index of the promise in the journal.
    place: usize,
    act: usize,
    /// Number of the act in the mission. An act that is prepared again gets another number.
    number: u64,
    sent: i64,
    start: i64,
    lease: i64,
    /// Time before the start, in nanoseconds: if a robot falls silent later than this, the scheduler may notice it too late.
    doubt: i64,
    /// The act's robots, and for each the time at which it was left out; `None` if it was not.
    members: BTreeMap<usize, Option<i64>>,
    /// The promised scripts, by their request ids.
    scripts: BTreeMap<String, PromisedScript>,
}

fn index(robot: &Value) -> usize {
    robot.as_str().map(index_of).unwrap()
}

fn index_of(robot: &str) -> usize {
    robot[1..].parse().unwrap()
}

fn span(millis: &Value) -> i64 {
    (millis.as_f64().unwrap_or(0.0) * 1e6) as i64
}

fn promises(journal: &[(i64, Value)]) -> Vec<Promise> {
    let of = |kind: &'static str| journal.iter().filter(move |(_, record)| record["record"] == kind);
    let dropped: BTreeMap<usize, i64> =
        of("dropped").map(|(at, record)| (index(&record["robot"]), *at)).collect();
    let promise = |(place, (_, record)): (usize, &(i64, Value))| {
        let decided = of("decided").find(|(_, decided)| decided["number"] == record["number"]);
        let (start, lease) = (nanos(record["start"].as_str().unwrap()), span(&record["lease_ms"]));
        let scripts = record["scripts"].as_array().unwrap();
        Promise {
            place,
            act: record["act"].as_u64().unwrap() as usize,
            number: record["number"].as_u64().unwrap(),
            sent: nanos(record["timestamp"].as_str().unwrap()),
            start,
            lease,
            doubt: decided.map_or(lease, |(_, decided)| span(&decided["doubt_ms"])),
            members: scripts
                .iter()
                .map(|script| index(&script["robot"]))
                .map(|robot| (robot, dropped.get(&robot).copied()))
                .collect(),
            scripts: scripts
                .iter()
                .map(|script| serde_json::from_value(script.clone()).unwrap())
                .map(|script: PromisedScript| (script.request_id.as_str().to_owned(), script))
                .collect(),
        }
    };
    journal
        .iter()
        .enumerate()
        .filter(|(_, (_, record))| record["record"] == "prepared")
        .map(promise)
        .collect()
}

/// Collects contradictions between the reports, the journal and the robots' logs.
struct Judge<'a> {
    played: &'a Played,
    /// For each robot, the values that it set, except while it moved to the default positions.
    sets: Vec<Vec<Logged>>,
    /// For each robot, the values that it set while it moved to the default positions.
    home: Vec<Vec<Logged>>,
    promises: Vec<Promise>,
    verdict: Verdict,
}

impl Judge<'_> {
    const fn lease(&self) -> i64 {
        self.played.drawn.lease_ms as i64 * MILLIS
    }

    fn say(&mut self, is_wrong: bool, what: impl FnOnce() -> String) {
        if is_wrong {
            self.verdict.wrong.push(what());
        }
    }

    fn faults(&self, robot: Option<usize>) -> impl Iterator<Item = &Struck> {
        self.played.struck.iter().filter(move |struck| struck.robot == robot)
    }

    fn struck_within(&self, robot: Option<usize>, from: i64, until: i64) -> bool {
        self.faults(robot).any(|struck| struck.from <= until && struck.until >= from)
    }

    /// Whether the robot's process was killed, so that its log may lack the last values.
    fn lost_its_memory(&self, robot: usize) -> bool {
        self.faults(Some(robot))
            .any(|struck| matches!(struck.what, What::Robot(Fault::Killed | Fault::Restarted(_))))
    }

    /// Checks that every program ends, and that its exit code fits its report.
    fn programs(&mut self) {
        for told in &self.played.told {
            let killed =
                told.kind == Kind::Run && self.faults(None).any(|s| matches!(s.what, What::SchedulerKilled));
            let Ok(ended) = &told.ended else {
                let text =
                    format!("(hang) {:?} never ends: {}", told.kind, told.ended.as_ref().err().unwrap());
                self.verdict.wrong.push(text);
                continue;
            };
            if killed && ended.code.is_none() {
                continue;
            }
            let fits = match told.report() {
                Some(report) => self.code_fits(told, &report),
                None => self.may_have_no_report(told),
            };
            self.say(!fits, || format!("(code) {:?}: {ended}", told.kind));
        }
    }

    fn code_fits(&self, told: &Told, report: &Value) -> bool {
        let rows = report["robots"].as_array().into_iter().flatten();
        let unconfirmed = rows.clone().any(|row| row["stop"]["state"] == "unconfirmed");
        let outcome =
            report["outcome"].as_str().or_else(|| report["outcome"].as_object()?.keys().next().map(|k| &**k));
        let expected = match (outcome, unconfirmed) {
            (None, _) => return false,
            (Some("done"), _) => 0,
            (_, true) => 4,
            _ if told.kind == Kind::Stop => 0,
            (Some("done_without" | "done_skipping"), _) => 5,
            (Some("stopped"), _) => 3,
            (Some("out_of_tolerance" | "steps_late" | "unknown"), _) => 6,
            _ => 1,
        };
        told.code() == Some(expected)
    }

    /// Whether a program may end without a report. Before the mission has a journal and after its end, nothing can be stopped or resumed.
    fn may_have_no_report(&self, told: &Told) -> bool {
        let record = |kind: &str| self.played.journal.iter().find(|(_, record)| record["record"] == kind);
        let before = record("opened").is_none_or(|(at, _)| *at >= told.began);
        let over = record("ended").is_some_and(|(at, _)| *at <= told.gone);
        match told.kind {
            // Stopped before anything was sent.
            Kind::Run => told.code() == Some(3),
            Kind::Stop | Kind::Resume => {
                matches!(told.code(), Some(1 | 2))
                    && (before || over || (told.kind == Kind::Resume && self.lives(told)))
            }
        }
    }

    /// Whether the scheduler is still alive when `resume` begins, so that the mission cannot be resumed. A killed scheduler is alive
    /// until its process is gone, which takes some time on a busy machine.
    fn lives(&self, resume: &Told) -> bool {
        let run = self.played.told.iter().find(|told| told.kind == Kind::Run);
        run.is_none_or(|run| resume.began < run.gone)
    }

    /// Checks for each promised act that all of its robots start or none does, unless a fault explains the difference.
    fn starts(&mut self) {
        for which in 0..self.promises.len() {
            let cause = self.how_it_started(which);
            match cause {
                Ok(how) => self.verdict.acts.push(how),
                Err(what) => self.verdict.wrong.push(what),
            }
        }
    }

    fn how_it_started(&self, which: usize) -> Result<&'static str, String> {
        let promise = &self.promises[which];
        let begins = |entry: &LogEntry| {
            let promised = |id: &String| promise.scripts.contains_key(id);
            matches!(entry.motion, MotionKind::Set | MotionKind::Ramp)
                && entry.request_id.as_ref().is_some_and(promised)
        };
        let started = |robot: usize| self.played.logs[robot].iter().flatten().any(begins);
        let (starters, missing): (Vec<_>, Vec<_>) =
            promise.members.iter().map(|(robot, out)| (*robot, *out)).partition(|(robot, _)| started(*robot));
        if missing.is_empty() {
            return Ok("all");
        }
        if starters.is_empty() {
            return Ok("none");
        }
        let left_out = |out: Option<i64>| out.is_some_and(|at| at < promise.start);
        let missed: Vec<usize> =
            missing.iter().filter(|(_, out)| !left_out(*out)).map(|(robot, _)| *robot).collect();
        if missed.is_empty() {
            return Ok("left out before the start, as on_failure says");
        }
        let (from, until) = (promise.start - promise.doubt - UNDER_WAY / 2, promise.start + START_LATE);
        // If a robot answers no inquiries, its restart goes unnoticed.
        let forgot = |robot: usize| {
            !self.played.drawn.tells[robot].answers_inquiries()
                && self.lost_its_memory(robot)
                && self.struck_within(Some(robot), promise.sent, until)
        };
        let own = |robot: usize| self.struck_within(Some(robot), from, until) || forgot(robot);
        if missed.iter().all(|robot| own(*robot)) {
            return Ok("a fault of the robots that did not start");
        }
        if starters.iter().all(|(robot, _)| own(*robot)) {
            return Ok("a fault of the robots that started");
        }
        if self.struck_within(None, from, until) {
            return Ok("a fault of the scheduler");
        }
        if self.stopped_within(promise.start - NO_RETURN - held_up::longest(from, until), until) {
            return Ok("a stop after the point of no return");
        }
        if held_up::longest(from, until) > 0 {
            return Ok("the machine was busy");
        }
        let starters: Vec<_> = starters.iter().map(|(robot, _)| *robot).collect();
        Err(format!("(mixed) act {}: {starters:?} started, {missed:?} did not", promise.act))
    }

    /// Whether a stop was sent within this time, for any reason.
    fn stopped_within(&self, from: i64, until: i64) -> bool {
        let recorded = self
            .played
            .journal
            .iter()
            .any(|(at, record)| record["record"] == "stopping" && (from..=until).contains(at));
        let asked = |told: &&Told| told.kind == Kind::Stop && (from - PROCESS..=until).contains(&told.began);
        recorded || self.played.told.iter().any(|told| asked(&told))
    }

    /// Checks a robot's log: each step occurs once, the values of a device are in order, and none belongs to another robot.
    fn log(&mut self, robot: usize) {
        let sets = self.sets[robot].clone();
        let values: Vec<f64> = sets.iter().map(|entry| entry.value).collect();
        let ascend = |device: &str| {
            let own: Vec<f64> = sets.iter().filter(|set| set.device == device).map(|set| set.value).collect();
            own.windows(2).all(|pair| pair[0] < pair[1])
        };
        self.say(!ascend("d") || !ascend("arm"), || format!("(order) r{robot} set {values:?}"));
        let mut seen = HashSet::new();
        let twice = sets.iter().any(|entry| !seen.insert((&entry.request, entry.step)));
        self.say(twice, || format!("(twice) r{robot} did a step twice: {values:?}"));
        let planned = self.played.drawn.values();
        let foreign = values.iter().any(|value| !planned.contains(value));
        self.say(foreign, || format!("(foreign) r{robot} set {values:?}"));
        let unpromised =
            sets.iter().find(|entry| !self.promises.iter().any(|p| p.scripts.contains_key(&entry.request)));
        self.say(unpromised.is_some(), || {
            format!("(promise) r{robot} did what the journal does not promise: {unpromised:?}")
        });
        self.say(robot == 0 && self.played.strangers > 0, || "(stranger) another robot was moved".to_owned());
    }

    /// Checks that every logged movement of a robot has a reason: a promised script, or the way to the default positions.
    fn movements(&mut self, robot: usize) {
        let promised = |id: &str| {
            let (act, script) = self.promises.iter().find_map(|p| Some((p.act, p.scripts.get(id)?)))?;
            // The mission plans the move to the default positions while it plays.
            let acts = self.played.choreography.acts.get(act);
            let planned = acts.into_iter().flat_map(|act| &act.plan.robots);
            let of_robot = planned.filter(|planned| planned.robot == script.robot);
            let same = |written: &&DeviceScript| {
                written.device == script.device && written.start.get() == script.start.get()
            };
            let written =
                of_robot.flat_map(|planned| &planned.scripts).find(same).map(|written| &written.script);
            (index_of(script.robot.as_str()) == robot).then_some(Promised { device: &script.device, written })
        };
        let may_go_home = self.played.drawn.on_failure == "home";
        let home_from = if may_go_home { Some(0) } else { self.played.home_from };
        let goes_home = |entry: &LogEntry| home_from.is_some_and(|from| entry.true_ns >= from);
        for process in &self.played.logs[robot] {
            for what in unexplained(process, promised, goes_home, |_| None) {
                self.verdict.wrong.push(format!("(movement) r{robot} {what}"));
            }
        }
    }

    /// Returns the planned time of a step by the true clock, in nanoseconds; `None` if no promised script contains the step.
    fn due(&self, entry: &Logged) -> Option<i64> {
        let promise = self.promises.iter().find(|promise| promise.scripts.contains_key(&entry.request))?;
        let every = self.played.drawn.every_ms;
        let later = if entry.device == "arm" { every / 2 } else { 0 };
        let step = step_of(entry) * every + later;
        Some(promise.start + i64::try_from(step).unwrap() * MILLIS)
    }

    /// Checks that a robot sets its values at their planned times by the true clock, within the timing error that the report states.
    fn in_time(&mut self, robot: usize) {
        for entry in self.sets[robot].clone() {
            let Some(due) = self.due(&entry) else { continue };
            let (early, late) = self.budget(robot, &entry);
            let off = entry.at - due;
            let what = || {
                format!("r{robot} set {} {} us off its plan, {early} to {late} ns", entry.value, off / 1_000)
            };
            self.say(off < early - 2 * MILLIS, || format!("(early) {}", what()));
            let starts = step_of(&entry) == 0 && entry.device == "d";
            self.say(starts && off > late + START_LATE, || format!("(late) {}", what()));
            let frozen = self.faults(Some(robot)).any(|struck| {
                matches!(struck.what, What::Robot(Fault::Frozen))
                    && struck.from <= entry.at
                    && struck.until >= due
            });
            let behind = off > late + 10 * MILLIS && !frozen;
            match behind && off > late + held_up::longest(due, entry.at) + STEP_LATE {
                true => self.say(true, || format!("(late) {}", what())),
                false if behind => self.verdict.busy.push(what()),
                false => {}
            }
        }
    }

    /// Returns how early (negative) and how late a robot may start an act, in nanoseconds, as the report states. If no report states it,
    /// returns the largest tolerated error.
    fn budget(&self, robot: usize, entry: &Logged) -> (i64, i64) {
        let unknown = (-60 * MILLIS, 60 * MILLIS);
        let Some(promise) = self.promises.iter().find(|promise| promise.scripts.contains_key(&entry.request))
        else {
            return unknown;
        };
        // The robot restarted with another clock after the budget was stated, or so shortly before that no attempt could show it.
        let unseen = |struck: &Struck| {
            matches!(struck.what, What::Robot(Fault::Restarted(Back::OtherClock)))
                && struck.from <= promise.start
                && struck.until >= promise.sent - UNDER_WAY
        };
        if self.faults(Some(robot)).any(unseen) {
            return unknown;
        }
        let reports = self.played.told.iter().filter_map(Told::report);
        let acts = reports.flat_map(|report| report["acts"].as_array().cloned().unwrap_or_default());
        let mut of_act = acts.filter(|act| act["number"] == promise.number);
        let robots = of_act.find_map(|act| act["skew"]["robots"].as_array().cloned());
        let of_robot =
            robots.and_then(|robots| robots.into_iter().find(|skew| skew["robot"] == format!("r{robot}")));
        of_robot.map_or(unknown, |skew| {
            let (offset, uncertainty) = (span(&skew["offset_ms"]), span(&skew["uncertainty_ms"]));
            (-offset - uncertainty, -offset + uncertainty + span(&skew["wake_up_ms"]))
        })
    }

    /// Returns the periods in which no message of the mission reaches a robot.
    fn unheard(&self, robot: usize) -> Vec<(i64, i64)> {
        let own = self.faults(Some(robot)).filter(|struck| {
            let deaf = [Fault::Cut, Fault::Interrupted, Fault::Muted, Fault::Deaf, Fault::Frozen];
            matches!(struck.what, What::Robot(fault) if deaf.iter().any(|d| std::mem::discriminant(d) == std::mem::discriminant(&fault)))
        });
        let scheduler = self.faults(None);
        // Until another process sends messages for the mission.
        let heard = |from: i64| {
            let others = self.played.told.iter().filter(|told| told.kind != Kind::Run);
            others.map(|told| told.began).filter(|at| *at >= from).min().unwrap_or(i64::MAX)
        };
        let silent = scheduler.map(|struck| (struck.from, struck.until.min(heard(struck.from))));
        own.map(|struck| (struck.from, struck.until)).chain(silent).collect()
    }

    /// Returns when a robot last received a message of the mission, if the mission sends nothing after `silent_from`. A link may hold
    /// messages at that instant: they arrive when it passes them, and renew a lease that still runs.
    fn last_heard(&self, robot: usize, silent_from: i64) -> i64 {
        let holds = |struck: &&Struck| {
            matches!(struck.what, What::Robot(Fault::Muted | Fault::Deaf))
                && (struck.from..struck.until).contains(&silent_from)
                && struck.until - struck.from < self.lease()
        };
        self.faults(Some(robot)).filter(holds).map(|struck| struck.until).max().unwrap_or(silent_from)
    }

    /// Checks that a robot plays nothing after the end of its lease, the time for which it may continue without a message.
    fn leases(&mut self, robot: usize) {
        for (from, until) in self.unheard(robot) {
            let from = self.last_heard(robot, from);
            let slow = self.faults(Some(robot)).filter_map(|struck| match struck.what {
                What::Robot(Fault::Slow(delay)) => i64::try_from(delay.as_nanos()).ok(),
                _ => None,
            });
            let under_way = UNDER_WAY + slow.max().unwrap_or(0);
            let beyond = self.sets[robot].iter().find(|entry| {
                let due = entry.at - (entry.set_at - entry.due).max(0);
                let pending =
                    self.promises.iter().find(|promise| promise.scripts.contains_key(&entry.request));
                let pending = pending.map_or(0, |promise| promise.lease).max(self.lease());
                let lease = if entry.step == Some(0) { pending } else { self.lease() };
                due > from + lease + under_way && due < until
            });
            let beyond = beyond.map(|entry| ((entry.at - from) / MILLIS, entry.clone()));
            self.say(beyond.is_some(), || {
                format!("(lease) r{robot} moved after its lease had run out: {beyond:?}")
            });
        }
    }

    /// Checks that a robot that has confirmed a stop plays no script that was promised before. It may play later scripts, for an act that
    /// is prepared again.
    fn confirmed(&mut self, robot: usize) {
        let is_stop =
            |record: &Value| record["record"] == "stop_confirmed" && index(&record["robot"]) == robot;
        let journal = self.played.journal.iter().enumerate();
        let stops: Vec<(usize, i64)> =
            journal.filter(|(_, (_, record))| is_stop(record)).map(|(place, (at, _))| (place, *at)).collect();
        for (place, at) in stops {
            let before = |entry: &&Logged| {
                let promise =
                    self.promises.iter().find(|promise| promise.scripts.contains_key(&entry.request));
                promise.is_none_or(|promise| promise.place < place)
            };
            let sets = self.sets[robot].iter().filter(|entry| entry.at > at);
            let after = sets.filter(before).count();
            self.say(after > 0, || {
                format!("(stop) r{robot} played {after} steps after it confirmed its stop")
            });
        }
    }

    /// Checks that `downbeat stop` brings every reachable robot to rest within `AT_REST`.
    fn operators_stop(&mut self) {
        for told in self.played.told.iter().filter(|told| told.kind == Kind::Stop && told.code() != Some(2)) {
            let frozen = self.struck_within(None, told.began, told.began + GIVEN_UP);
            let rest = told.began
                + AT_REST
                + if frozen { GIVEN_UP } else { 0 }
                + held_up::longest(told.began, told.gone);
            for robot in 0..self.played.drawn.robots() {
                if self.struck_within(Some(robot), told.began - 2 * self.lease(), rest) {
                    continue;
                }
                let after = self.sets[robot].iter().filter(|entry| entry.at > rest).count();
                self.say(after > 0, || {
                    format!("(stop) r{robot} did {after} steps long after `downbeat stop`")
                });
            }
        }
    }

    fn report(&mut self, told: &Told, report: &Value) {
        let outcome = report["outcome"].as_str().unwrap_or_default().to_owned();
        for row in report["robots"].as_array().into_iter().flatten() {
            self.at_rest(told, row);
            if !is_withdrawal(report) {
                self.row(&outcome, report, row);
            }
        }
        for act in report["acts"].as_array().into_iter().flatten().filter(|act| place_of(act).is_some()) {
            for said in act["robots"].as_array().into_iter().flatten() {
                let devices = said["devices"].as_array().into_iter().flatten();
                for name in ["d", "arm"] {
                    let own = devices.clone().filter(|device| device["device"] == name).enumerate();
                    own.for_each(|(script, device)| self.script(act, index(&said["robot"]), script, device));
                }
            }
        }
        for failure in report["failures"].as_array().into_iter().flatten() {
            self.blame(told, failure);
        }
        if report["outcome"] == "done" || report["outcome"] == "done_without" {
            self.done(report);
        }
    }

    /// Checks that a report names each robot that still moves after the report, and states an instant by which the robot is at rest.
    fn at_rest(&mut self, told: &Told, row: &Value) {
        let robot = index(&row["robot"]);
        let rests = |entry: &&LogEntry| matches!(entry.motion, MotionKind::Rest | MotionKind::Slow);
        let moves = self.played.logs[robot].iter().flatten().filter(|entry| !rests(entry));
        let moves: Vec<i64> = moves.map(|entry| entry.true_ns).filter(|at| *at > told.gone).collect();
        let stop = &row["stop"];
        self.say(!moves.is_empty() && stop["state"] != "unconfirmed", || {
            format!("(named) r{robot} did {} steps after {:?} had said of it {stop}", moves.len(), told.kind)
        });
        // A message in flight, or one held by a stalled link, renews a lease that still runs when it arrives.
        let held = self.faults(Some(robot)).map(|struck| match struck.what {
            What::Robot(Fault::Muted | Fault::Deaf) => (struck.until - struck.from).min(self.lease()),
            What::Robot(Fault::Slow(delay)) => i64::try_from(delay.as_nanos()).unwrap(),
            _ => 0,
        });
        let held = held.max().unwrap_or(0) + UNDER_WAY;
        let ends = stop["lease_ends"].as_str().map(nanos);
        let beyond = ends.map(|ends| moves.iter().filter(|at| **at > ends + held).count()).unwrap_or(0);
        self.say(beyond > 0, || {
            format!("(named) r{robot} did {beyond} steps after the end of its lease as told: {stop}")
        });
    }

    /// Checks the row of a report about one robot against the robot's log, for the acts that the report covers.
    fn row(&mut self, outcome: &str, report: &Value, row: &Value) {
        let robot = index(&row["robot"]);
        let acts = report["acts"].as_array().into_iter().flatten();
        let acts: Vec<Option<usize>> = acts.map(place_of).collect();
        let of_acts = |entry: &&Logged| acts.contains(&Some(act_of(entry)));
        let home: &[Logged] = if acts.contains(&None) { &self.home[robot] } else { &[] };
        let sets: Vec<&Logged> = self.sets[robot].iter().filter(of_acts).collect();
        let (said, set) = (row["steps_done"].as_u64().unwrap(), (sets.len() + home.len()) as u64);
        let begins = |entry: &&LogEntry| {
            matches!(entry.motion, MotionKind::Set | MotionKind::Ramp)
                && acts.contains(&Some((entry.value as usize).saturating_sub(1) / VALUES))
        };
        let begun = self.played.logs[robot].iter().flatten().filter(begins).count();
        let all = sets.iter().copied().chain(home);
        let late = all.filter(|entry| entry.set_at - entry.due > MILLIS).count() as u64;
        let torn = u64::from(self.lost_its_memory(robot));
        let certain = row["stop"]["state"] != "unconfirmed" && row["unaccounted"] == 0;
        self.say(said > set + torn, || format!("(more) r{robot} reportedly did {said} steps, but did {set}"));
        self.say(certain && said < set, || {
            format!("(fewer) r{robot} certainly did {said} steps by its report, but did {set}")
        });
        self.say(certain && row["started"] == 0 && begun > 0, || {
            format!("(moved) r{robot} is reported as not started, and began {begun} movements")
        });
        self.say(outcome == "not_started" && certain && begun > 0, || {
            format!("(moved) not started, and r{robot} began {begun} movements")
        });
        let claimed = row["late_steps"].as_u64().unwrap();
        self.say(claimed > late + torn, || {
            format!("(more) r{robot} reportedly had {claimed} late steps, but had {late}")
        });
    }

    fn script(&mut self, act: &Value, robot: usize, script: usize, device: &Value) {
        let Some(act) = place_of(act) else { return };
        let first = value(act, script * STEPS);
        let own = first..first + STEPS as f64;
        let sets = self.sets[robot].iter().filter(|entry| device["device"] == entry.device);
        let set = sets.filter(|entry| own.contains(&entry.value)).count() as u64;
        let (state, said) = (device["state"].as_str().unwrap(), device["steps_done"].as_u64().unwrap());
        let torn = u64::from(self.lost_its_memory(robot));
        let ended = state == "ended" && (said != STEPS as u64 || set + torn < STEPS as u64);
        let never = matches!(state, "planned") && set > 0;
        self.say(said > set + torn || ended || never, || {
            format!("(script) act {act}, r{robot}, script {script}: `{state}` with {said} steps, did {set}")
        });
    }

    /// Checks that a robot that is reported as failed had a fault, or lost its scripts because the scheduler failed. If this machine
    /// stalled, all robots may seem to have failed.
    fn blame(&mut self, told: &Told, failure: &Value) {
        let robot = index(&failure["robot"]);
        let struck = self.faults(Some(robot)).any(|struck| struck.from <= told.gone);
        let scheduler = self.faults(None).any(|struck| struck.from <= told.gone);
        // Leases run out while the scheduler is suspended.
        if struck || (scheduler && failure["failure"] == "script") {
            return;
        }
        // Before any promise, a suspended scheduler counts as the robots' silence.
        let promised = self.promises.iter().any(|promise| promise.sent <= told.gone);
        if scheduler && !promised {
            self.verdict.greetings += 1;
            return;
        }
        if held_up::longest(told.gone - SHORTLY, told.gone) > HELD_UP {
            self.verdict.busy.push(format!("r{robot} was blamed"))
        } else {
            self.verdict.wrong.push(format!("(blame) nothing befell it: {failure}"))
        }
    }

    /// Checks a report of success: each robot has played everything, unless it failed.
    fn done(&mut self, report: &Value) {
        let failures = report["failures"].as_array().unwrap();
        let rows = report["robots"].as_array().unwrap();
        for robot in 0..self.played.drawn.robots() {
            let failed = failures.iter().any(|failure| index(&failure["robot"]) == robot)
                || rows.iter().any(|row| index(&row["robot"]) == robot && row["standing"] == "out");
            let mut set: Vec<f64> = self.sets[robot].iter().map(|entry| entry.value).collect();
            set.sort_by(f64::total_cmp);
            let planned = self.played.drawn.values();
            let torn = usize::from(self.lost_its_memory(robot));
            let all = set == planned || (torn > 0 && set.len() + torn >= planned.len());
            self.say(!failed && !all, || format!("(done) {}, and r{robot} set {set:?}", report["outcome"]));
        }
    }
}

/// Returns the index of an act in the scenario; `None` for the act that moves the robots to the default positions. The act's number in
/// the mission is higher if an act was prepared again.
fn place_of(act: &Value) -> Option<usize> {
    act["act"].as_str().and_then(|name| name.strip_prefix("act-")?.parse().ok())
}

fn act_of(entry: &Logged) -> usize {
    (entry.value as usize - 1) / VALUES
}

/// Returns the index of a step in its act.
fn step_of(entry: &Logged) -> usize {
    (entry.value as usize - 1) % VALUES
}
