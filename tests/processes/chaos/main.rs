//! Missions of several acts with real processes. Robots, links and schedulers are frozen, killed, cut off and restarted at random
//! moments, and other processes resume and stop missions. All reports have to agree with the robots' own logs. `DOWNBEAT_CHAOS=300` sets
//! the number of missions, `DOWNBEAT_CHAOS_FIRST=17` the number of the first one.

#![expect(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test in a binary of its own")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

mod doctored;
mod draw;
mod held_up;
mod instants;
mod judge;
mod play;

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use draw::Drawn;
use judge::{Verdict, judge};
use play::{Kind, Played, play};

/// Number of missions that are played at the same time. They sleep most of the time.
const AT_ONCE: usize = 4;
/// Maximum share of the promised acts that some of their robots start and others do not, for any reason.
const MIXED_MAX: f64 = 0.12;
/// Maximum share of the missions in which a busy machine excuses a deviation.
const BUSY_MAX: f64 = 0.15;

/// The combined results of all missions of a test run.
#[derive(Default)]
struct Tally {
    outcomes: BTreeMap<String, u32>,
    acts: BTreeMap<&'static str, u32>,
    busy: u32,
    greetings: u32,
    violations: Vec<String>,
}

impl Tally {
    fn count(&mut self, played: &Played, verdict: Verdict) {
        for told in &played.told {
            let outcome =
                told.report().map_or("no report".to_owned(), |report| report["outcome"].to_string());
            *self
                .outcomes
                .entry(format!("{:?}: {outcome}, exit code {:?}", told.kind, told.code()))
                .or_default() += 1;
        }
        verdict.acts.iter().for_each(|how| *self.acts.entry(how).or_default() += 1);
        let busy = !verdict.busy.is_empty() || verdict.acts.contains(&"the machine was busy");
        self.busy += u32::from(busy);
        self.greetings += verdict.greetings;
        if !verdict.wrong.is_empty() {
            let wrong = verdict.wrong.join("\n  ");
            println!("mission {}: {wrong}", played.drawn.seed);
            self.violations.push(format!("mission {}:\n  {wrong}\n{}", played.drawn.seed, story(played)));
        }
    }

    fn show(&self, missions: u64) {
        println!("{missions} missions, {} with violations", self.violations.len());
        self.outcomes.iter().for_each(|(what, count)| println!("{count:5}  {what}"));
        println!("acts that were promised:");
        self.acts.iter().for_each(|(what, count)| println!("{count:5}  {what}"));
        println!("{:5}  missions with something late or silent because the machine was busy", self.busy);
        println!("{:5}  robots blamed because the scheduler stalled in the greeting", self.greetings);
    }

    /// Returns the share of the promised acts that some robots started and others did not, although these were not left out before.
    fn mixed(&self) -> f64 {
        let of = |counted: &dyn Fn(&str) -> bool| -> u32 {
            self.acts.iter().filter(|(how, _)| counted(how)).map(|(_, count)| count).sum()
        };
        let whole = |how: &str| how == "all" || how == "none" || how.starts_with("left out");
        f64::from(of(&|how| !whole(how))) / f64::from(of(&|_| true)).max(1.0)
    }
}

/// Returns the events of a mission in chronological order: faults, journal records, set values, and programs.
fn story(played: &Played) -> String {
    let drawn = format!("{:?}", played.drawn);
    let began = played.told[0].began;
    let mut lines: Vec<(i64, String)> = Vec::new();
    for struck in &played.struck {
        lines.push((struck.from, format!("begins {struck:?}")));
        lines.push((struck.until, format!("ends {:?}", struck.what)));
    }
    for (at, record) in &played.journal {
        let mut record = record.clone();
        ["scripts", "report", "robots", "at"]
            .iter()
            .for_each(|key| drop(record.as_object_mut().unwrap().remove(*key)));
        lines.push((*at, format!("journal {record}")));
    }
    for (robot, sets) in played.sets.iter().enumerate() {
        lines.extend(
            sets.iter().map(|set| (set.at, format!("r{robot} set {} of {}", set.value, set.request))),
        );
    }
    for told in &played.told {
        lines.push((told.began, format!("begins {:?}", told.kind)));
        let ended = match &told.ended {
            Ok(ended) => ended.to_string(),
            Err(said) => said.clone(),
        };
        lines.push((told.gone, format!("ends {:?}: {ended}", told.kind)));
    }
    lines.sort_by_key(|(at, _)| *at);
    let line = |(at, what): &(i64, String)| format!("{:8.3} {what}\n", at.saturating_sub(began) as f64 / 1e9);
    format!("{drawn}\n{}", lines.iter().map(line).collect::<String>())
}

fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok().and_then(|text| text.parse().ok())
}

#[test]
fn reports_and_exit_codes_agree_with_robot_logs_under_random_faults() {
    let first = number("DOWNBEAT_CHAOS_FIRST").unwrap_or(0);
    let missions = number("DOWNBEAT_CHAOS").unwrap_or(12);
    held_up::watch();
    let (next, tally) = (AtomicU64::new(first), Mutex::new(Tally::default()));
    std::thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= first + missions {
                        return;
                    }
                    let played = play(Drawn::of(seed));
                    let verdict = judge(&played);
                    tally.lock().unwrap().count(&played, verdict);
                }
            });
        }
    });
    let tally = tally.into_inner().unwrap();
    tally.show(missions);
    assert!(tally.violations.is_empty(), "{}", tally.violations.join("\n\n"));
    // With few missions, shares are meaningless.
    let enough = missions >= 50;
    assert!(!enough || tally.mixed() <= MIXED_MAX, "mixed: {:.3} of the acts", tally.mixed());
    let busy = f64::from(tally.busy) / missions as f64;
    assert!(!enough || busy <= BUSY_MAX, "busy: {busy:.3} of the missions");
    let played = tally.outcomes.keys().any(|outcome| outcome.starts_with(&format!("{:?}", Kind::Run)));
    assert!(played, "nothing was played");
}
