//! Measures how late a robot can fail before the start so that the mission is still withdrawn, that is, no robot starts. One of six robot
//! processes is killed, frozen, cut off or muted at some instant in the last second before the start. The robots' own logs show which of
//! them started. The baseline is a scheduler that decides once, when all robots have accepted. The mode `false_withdrawals` counts
//! missions without a fault that are withdrawn while every core is busy.
//!
//! `cargo bench --bench kill_window -- MODE TRIALS EARLIEST_MS DOUBT`, each optional. MODE is `killed`, `frozen`, `cut`, `muted` or
//! `false_withdrawals`. TRIALS is 200 by default. EARLIEST_MS, the earliest instant of a fault before the start, is 1000 by default.
//! DOUBT is the value of `on_doubt` in the scenario: `start` or `withdraw`.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a program that measures, and stops if it cannot"
)]
#![expect(clippy::cast_precision_loss, reason = "figures for people")]

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use stage::busy::with_cores_busy;
use stage::{Ended, Stage, Via, epoch_nanos, one_device, sleep_until};

const ROBOTS: usize = 6;
const TRIALS: usize = 200;
/// Number of stages (fleets of robot processes) that play trials concurrently.
const STAGES: usize = 2;
/// Time from sending the scripts to the start. It is longer than the time from the earliest fault to the start.
const LEAD: &str = "1100ms";
/// Time from the start until the scripts have ended and the robots have written their logs, in nanoseconds.
const PLAYED: i64 = 450_000_000;
/// Time within which every mission ends, unless it hangs.
const PATIENCE: Duration = Duration::from_secs(30);
/// The constant lease of a second baseline, in nanoseconds: a fault in this time before the start counts as a mixed start.
const CONSTANT_LEASE: i64 = 240_000_000;

const SCENARIO: &str = "scenario: window
start_tolerance: 1s
on_failure: stop
cues:
  - {at: 0s, robots: all, tracks: {d: [{at: 0s, to: 1}, {at: 150ms, to: 2}, {at: 300ms, to: 3}]}}
";

/// A fault of one robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    /// SIGKILL: its socket closes, and no process listens any longer.
    Killed,
    /// SIGSTOP: its socket stays open, but it neither sends nor does anything.
    Frozen,
    /// The robot keeps running; its link is closed, and new links are refused.
    Cut,
    /// The robot keeps running; its link stays open, but passes no data.
    Muted,
}

impl Fault {
    const ALL: [Self; 4] = [Self::Killed, Self::Frozen, Self::Cut, Self::Muted];

    fn name(self) -> &'static str {
        match self {
            Self::Killed => "killed",
            Self::Frozen => "frozen",
            Self::Cut => "cut",
            Self::Muted => "muted",
        }
    }

    /// How the scheduler reaches the first robot: directly if the process is killed or frozen, because a proxy would still accept
    /// connections for it.
    fn via(self) -> Via {
        match self {
            Self::Killed | Self::Frozen => Via::Direct,
            Self::Cut | Self::Muted => Via::Proxy,
        }
    }

    fn strike(self, stage: &mut Stage, victim: usize) {
        let robot = &mut stage.robots[victim];
        match (self, &robot.link) {
            (Self::Killed, _) => robot.kill(),
            (Self::Frozen, _) => robot.freeze(),
            (Self::Cut, Some(link)) => link.cut(),
            (Self::Muted, Some(link)) => link.freeze(),
            (Self::Cut | Self::Muted, None) => panic!("no proxy"),
        }
    }

    fn heal(self, stage: &mut Stage, victim: usize) {
        stage.restart(victim);
        if let Some(link) = &stage.robots[victim].link {
            link.open();
        }
    }
}

/// One mission and its result. All instants are in nanoseconds before the start.
struct Trial {
    struck: i64,
    /// The instant at which all robots had accepted, and the printed deadline up to which a failure withdraws the mission. `None` if
    /// nothing was printed.
    printed: Option<Printed>,
    others: usize,
    victim: bool,
}

struct Printed {
    accepted: i64,
    deadline: i64,
}

impl Trial {
    /// Whether some robots started and others did not.
    fn is_mixed(&self) -> bool {
        !matches!((self.others, self.victim), (0, false)) && (self.others < ROBOTS - 1 || !self.victim)
    }

    /// Whether the mission broke the printed promise: the fault came before the deadline, but some of the six robots started and others
    /// did not. If all robots start, the promise is kept: only a link failed, and its robot kept running.
    fn broke_its_word(&self) -> bool {
        self.is_mixed() && self.printed.as_ref().is_some_and(|printed| self.struck > printed.deadline)
    }
}

/// Returns the command-line arguments that are not options.
fn words() -> Vec<String> {
    std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect()
}

fn stage(first: Via) -> Stage {
    let doubt = words().into_iter().find(|word| word == "start" || word == "withdraw");
    let doubt = doubt.map_or(String::new(), |word| format!("on_doubt: {word}\n"));
    let mut stage = Stage::new();
    stage.file("robot.yaml", one_device(1, 90, 8)).file("window.yaml", format!("{SCENARIO}{doubt}"));
    for id in 0..ROBOTS {
        stage.robot("robot.yaml", if id == 0 { first } else { Via::Direct });
    }
    stage
}

fn trial(stage: &mut Stage, fault: Fault, number: usize, before: i64) -> Option<Trial> {
    // Only the first robot has a link that can be cut.
    let victim = if fault.via() == Via::Proxy { 0 } else { number % ROBOTS };
    let began = epoch_nanos();
    let mut running = stage.start(&["run", "window.yaml", "--verbose", "--lead", LEAD, "--patience", "1s"]);
    let Some(start) = running.start_if_prepared() else {
        println!("  trial {number} was never prepared: {}", running.ended().told);
        return None;
    };
    sleep_until(start - before);
    fault.strike(stage, victim);
    let struck = start - epoch_nanos();
    let ended = match running.ended_within(PATIENCE) {
        Ok(ended) => ended,
        Err(told) => {
            println!(
                "  trial {number}, struck {:.1} ms before the start, never ended:\n{told}",
                millis(struck)
            );
            fault.heal(stage, victim);
            return None;
        }
    };
    sleep_until(start + PLAYED);
    let moved = |robot: usize| stage.robots[robot].sets().iter().any(|set| set.at >= began);
    let others = (0..ROBOTS).filter(|robot| *robot != victim && moved(*robot)).count();
    let trial = Trial { struck, printed: printed(&ended, fault), others, victim: moved(victim) };
    fault.heal(stage, victim);
    Some(trial)
}

/// Parses the line `starts in 1.07 s; if a robot fails in the next 950.1 ms, no robot starts; silence is detected if it begins at least
/// 46 ms before the start`. The first deadline applies to a killed process, which is known to have failed. The second one applies to all
/// other faults, which are silence.
fn printed(ended: &Ended, fault: Fault) -> Option<Printed> {
    let line = ended.told.lines().find(|line| line.contains("all robots have accepted"))?;
    let after = |words: &str| span(line.split(words).nth(1)?);
    let (ahead, open, silence) = (after("starts in ")?, after("in the next ")?, after("begins at least ")?);
    let deadline = if fault == Fault::Killed { ahead - open } else { silence };
    Some(Printed { accepted: ahead, deadline })
}

/// Parses a time such as `347.787 ms` at the beginning of a text. Returns it in nanoseconds.
fn span(text: &str) -> Option<i64> {
    let mut words = text.split([' ', ';', ',']);
    let number: f64 = words.next()?.parse().ok()?;
    let unit = match words.next()? {
        "ns" => 1.0,
        "us" => 1e3,
        "ms" => 1e6,
        "s" => 1e9,
        _ => return None,
    };
    Some((number * unit) as i64)
}

fn millis(nanos: i64) -> f64 {
    nanos as f64 / 1e6
}

/// Runs `count` trials of one fault, on several stages at once.
fn trials(fault: Fault, count: usize, earliest: i64) -> Vec<Trial> {
    let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..STAGES {
            scope.spawn(|| {
                let mut stage = stage(fault.via());
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= count {
                        return;
                    }
                    let before = earliest * (2 * (count - number) as i64 - 1) / (2 * count as i64);
                    done.lock().unwrap().extend(trial(&mut stage, fault, number, before));
                }
            });
        }
    });
    done.into_inner().unwrap()
}

fn largest<'a>(trials: impl Iterator<Item = &'a Trial>) -> String {
    trials.map(|trial| trial.struck).max().map_or_else(|| "-".into(), |at| format!("{:.1}", millis(at)))
}

fn tell(fault: Fault, trials: &[Trial]) {
    let count = |which: &dyn Fn(&&Trial) -> bool| trials.iter().filter(which).count();
    println!("{}: {} trials that ended, one of {ROBOTS} robots, lead {LEAD}", fault.name(), trials.len());
    println!("  {:<62}{:>8}", "none of the others started", count(&|t| t.others == 0));
    println!("  {:<62}{:>8}", "all others started", count(&|t| t.others == ROBOTS - 1));
    println!("  {:<62}{:>8}", "some of the others started", count(&|t| t.others % (ROBOTS - 1) != 0));
    println!("  {:<62}{:>8}", "the robot itself started", count(&|t| t.victim));
    println!("  {:<62}{:>8}", "mixed starts", count(&|t| t.is_mixed()));
    let mixed = largest(trials.iter().filter(|trial| trial.is_mixed()));
    println!("  {:<62}{mixed:>8}", "largest instant with a mixed start, ms before the start");
    let deadlines = || trials.iter().filter_map(|trial| Some(trial.printed.as_ref()?.deadline));
    if let Some((least, most)) = deadlines().min().zip(deadlines().max()) {
        let range = format!("{:.1} to {:.1}", millis(least), millis(most));
        println!("  {:<52}{range:>18}", "printed: withdrawn until this many ms before the start");
    }
    println!("  {:<62}{:>8}", "trials that printed no deadline", count(&|t| t.printed.is_none()));
    println!("  {:<62}{:>8}", "trials in which what was printed was false", count(&|t| t.broke_its_word()));
    let broken = largest(trials.iter().filter(|trial| trial.broke_its_word()));
    println!("  {:<62}{broken:>8}", "largest instant of these, ms before the start");
    let decided = |t: &&Trial| t.printed.as_ref().is_some_and(|printed| t.struck <= printed.accepted);
    println!("  {:<62}{:>8}", "baseline, decided once all have accepted: mixed starts", count(&decided));
    println!(
        "  {:<62}{:>8}",
        "  largest instant, ms before the start",
        largest(trials.iter().filter(decided))
    );
    let leased = |t: &&Trial| t.struck <= CONSTANT_LEASE;
    println!("  {:<62}{:>8}", "baseline, a constant lease of 240 ms alone: mixed starts", count(&leased));
    println!(
        "  {:<62}{:>8}",
        "  largest instant, ms before the start",
        largest(trials.iter().filter(leased))
    );
}

/// Prints the shortest and the longest round trip to the robots, as `downbeat fleet ping` measures them.
fn tell_round_trips() {
    let stage = stage(Via::Direct);
    let ping = stage.run(&["fleet", "ping", "fleet.yaml", "--format", "json"]).report();
    let delays = |key: &str| {
        let rows = ping.as_array().or_else(|| ping["robots"].as_array()).unwrap();
        rows.iter().filter_map(|row| row["clock"][key].as_f64()).collect::<Vec<_>>()
    };
    let least = delays("delay_min_ms").into_iter().fold(f64::INFINITY, f64::min);
    let longest = delays("delay_max_ms").into_iter().fold(0.0, f64::max);
    println!(
        "round trips {least:.3} to {longest:.3} ms; three of the longest and 20 ms: {:.1} ms",
        3.0 * longest + 20.0
    );
}

/// Runs missions without a fault next to two busy threads, and counts those that were not done.
fn false_withdrawals(missions: usize) {
    let (mut done, mut reasons) = (0, BTreeMap::<String, usize>::new());
    let stage = stage(Via::Direct);
    with_cores_busy(2, || {
        for number in 0..missions {
            let began = epoch_nanos();
            let ended = stage.run(&["run", "window.yaml", "--patience", "5s"]);
            let moved = |robot: &&stage::Robot| robot.sets().iter().any(|set| set.at >= began);
            let moved = stage.robots.iter().filter(moved).count();
            let outcome = ended.out.lines().take(2).collect::<Vec<_>>().join(";");
            if ended.code == Some(0) && moved == ROBOTS {
                done += 1;
                continue;
            }
            println!("  mission {number}: {moved} of {ROBOTS} robots started: {outcome}");
            *reasons.entry(format!("code {:?}, {moved} started", ended.code)).or_default() += 1;
        }
    });
    println!(
        "false_withdrawals: {missions} missions without a fault next to two busy threads: {done} done; {reasons:?}"
    );
}

fn main() {
    let words = words();
    let mut numbers = words.iter().filter_map(|word| word.parse::<usize>().ok());
    let (count, earliest) = (numbers.next().unwrap_or(TRIALS), numbers.next().unwrap_or(1_000));
    let modes: Vec<_> = Fault::ALL.iter().map(|fault| fault.name()).chain(["false_withdrawals"]).collect();
    let named = |word: &&String| modes.contains(&word.as_str());
    let asked = |name: &str| words.iter().find(named).is_none_or(|word| word == name);
    tell_round_trips();
    for fault in Fault::ALL.into_iter().filter(|fault| asked(fault.name())) {
        tell(fault, &trials(fault, count, i64::try_from(earliest).unwrap() * 1_000_000));
    }
    if asked("false_withdrawals") {
        false_withdrawals(count);
    }
}
