//! Measures how close together and how late six robots start. It compares a deferred (planned) start with and without real-time
//! scheduling, a start on receipt, tokio's timer, and the best that this machine can do. All of these take turns within one run, on an
//! idle machine and with all cores busy.
//!
//! The robots are six processes on TCP, each with its own clock that is up to 300 ms off. The true starts, by the host's clock, are read
//! from the robots' own logs. A witness (threads that watch the cores) detects whether the host or another program took a core away
//! around the start. Every second row leaves out these missions. This separates the tail of Downbeat from that of the machine.
//!
//! `cargo bench --bench start_spread -- [one-host] [idle | busy] [missions N] [auto] [off] [receipt] [tokio] [ideal]`
#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a program that measures, and stops if it cannot"
)]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]
#![expect(clippy::cast_precision_loss, reason = "figures for people")]

mod starting;

use std::process::{Child, Command};
use std::sync::atomic::Ordering;
use std::time::Duration;

use starting::ROBOTS;
use starting::figures::{Measured, raw, rows};
use starting::fleet::{Fleet, Settings};
use starting::missions::{REPEATED, deferred, on_receipt};
use starting::waiters::{Kind, Waiters, be_a_waiter};
use starting::witness::{Group, Witness};

const MISSIONS: usize = 100;
/// Time after the last mission within which each idle robot has written its log.
const LOGS_WRITTEN: Duration = Duration::from_millis(200);

/// Child processes that keep every core busy until they are dropped.
struct Load(Vec<Child>);

impl Load {
    fn start() -> Self {
        let cores = std::thread::available_parallelism().map_or(1, Into::into);
        let busy = |_| Command::new("sh").args(["-c", "while :; do :; done"]).spawn().unwrap();
        Self((0..cores).map(busy).collect())
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _gone = child.kill();
            let _reaped = child.wait();
        }
    }
}

/// Arguments of the command line.
struct Arguments(Vec<String>);

impl Arguments {
    fn has(&self, word: &str) -> bool {
        self.0.iter().any(|argument| argument == word)
    }

    /// Whether starts of the kind `way`, such as `auto` or `receipt`, are measured. By default, all kinds are.
    fn measures(&self, way: &str) -> bool {
        self.has(way) || !["auto", "off", "receipt", "tokio", "ideal"].iter().any(|way| self.has(way))
    }

    fn missions(&self) -> usize {
        let at = self.0.iter().position(|argument| argument == "missions");
        at.map_or(MISSIONS, |at| self.0[at + 1].parse().unwrap())
    }
}

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap()
}

/// Measures deferred starts and starts on receipt, over a simulated network with delays.
fn over_a_network(missions: usize) {
    let network = Settings { delay: "80ms", ntp_error: "40us", realtime: "auto" };
    let fleets = [Fleet::start(network), Fleet::start(network)];
    runtime().block_on(async {
        for _ in 0..missions {
            deferred(&fleets[0], None).await;
            on_receipt(&fleets[1]).await;
        }
    });
    std::thread::sleep(LOGS_WRITTEN);
    rows("deferred start", &fleets[0].rounds(), None);
    Measured::of(fleets[1].rounds().iter()).row_of_spreads("start on receipt (baseline)");
}

/// The ways of starting robots that are compared on one host, each with its name.
struct OneHost {
    fleets: Vec<(&'static str, Fleet)>,
    receiving: Option<Fleet>,
    waiters: Vec<(&'static str, Waiters)>,
    witness: Option<Witness>,
}

impl OneHost {
    fn start(arguments: &Arguments, group: Option<&Group>) -> Self {
        let fleet = |realtime| Fleet::start(Settings { delay: "1ms", ntp_error: "0s", realtime });
        let fleets = [("auto", "deferred start, --realtime auto"), ("off", "deferred start, --realtime off")];
        let waiters = [
            ("tokio", "tokio's timer (baseline)", Kind::Tokio),
            ("ideal", "nothing to do (what this machine can do)", Kind::Ideal),
        ];
        let fleets = fleets.into_iter().filter(|(way, _)| arguments.measures(way));
        let waiters = waiters.into_iter().filter(|(way, ..)| arguments.measures(way));
        Self {
            fleets: fleets.map(|(way, name)| (name, fleet(way))).collect(),
            receiving: arguments.measures("receipt").then(|| fleet("auto")),
            waiters: waiters.map(|(_, name, kind)| (name, Waiters::start(kind))).collect(),
            witness: group.and_then(Witness::start),
        }
    }

    /// Runs one mission for each way of starting. They take turns, so that other load affects all of them equally.
    fn round(&mut self, runtime: &tokio::runtime::Runtime) {
        let witness = self.witness.as_ref();
        self.fleets.iter().for_each(|(_, fleet)| runtime.block_on(deferred(fleet, witness)));
        self.receiving.iter().for_each(|fleet| runtime.block_on(on_receipt(fleet)));
        self.waiters.iter_mut().for_each(|(_, waiters)| waiters.round(witness));
    }

    /// Prints the figures. Returns every start as text for other programs.
    fn tell(&self) -> String {
        let witness = self.witness.as_ref();
        if witness.is_none() {
            println!(
                "  no witness: it needs permission for SCHED_FIFO and for a group of cpuacct (cgroup v1)"
            );
        }
        let fleets = self.fleets.iter().map(|(name, fleet)| (*name, fleet.rounds()));
        let waiters = self.waiters.iter().map(|(name, waiters)| (*name, waiters.rounds.clone()));
        let told: Vec<_> = fleets.chain(waiters).collect();
        told.iter().for_each(|(name, rounds)| rows(name, rounds, witness));
        if let Some(receiving) = &self.receiving {
            Measured::of(receiving.rounds().iter()).row_of_spreads("start on receipt (baseline)");
        }
        println!("  not done and played again: {}", REPEATED.swap(0, Ordering::Relaxed));
        told.iter().map(|(name, rounds)| raw(name, rounds, witness)).collect()
    }
}

fn main() {
    if let Ok(word) = std::env::var("WAITER") {
        return be_a_waiter(&word);
    }
    let arguments = Arguments(std::env::args().skip(1).collect());
    let missions = arguments.missions();
    println!("{ROBOTS} processes, {missions} missions, ms");
    println!("  {:<44}{:>36}   {:>36}", "", "apart: p50, p90, p99, max", "late: p50, p90, p99, max");
    // `-- one-host` leaves out the slow part.
    if !arguments.has("one-host") {
        println!("clocks known to 40 us, answers up to 80 ms late");
        over_a_network(missions);
    }
    let group = Group::of_this_program();
    let loads = [(false, "idle", "busy"), (true, "busy", "idle")];
    for (loaded, name, _) in loads.into_iter().filter(|(_, _, other)| !arguments.has(other)) {
        println!("one clock, {}", if loaded { "all cores busy" } else { name });
        let _load = loaded.then(Load::start);
        let mut one_host = OneHost::start(&arguments, group.as_ref());
        let runtime = runtime();
        for _ in 0..missions {
            one_host.round(&runtime);
        }
        std::thread::sleep(LOGS_WRITTEN);
        let lines = one_host.tell();
        // Writes every start to a file, for an analysis of the tail.
        if let Ok(file) = std::env::var("START_SPREAD_RAW") {
            std::fs::write(format!("{file}.{name}"), lines).unwrap();
        }
    }
}
