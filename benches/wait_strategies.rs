//! How late six processes that wait for one instant wake up, and how far apart: ways of waiting side by side with tokio's
//! timer, in turn within one run, idle or with all cores busy.
//!
//! `cargo bench -p downbeat-realtime --bench wait_strategies -- [busy] [rounds N] ['sleep' 'spin 200 us' ...]`
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a program that measures, and stops if it cannot"
)]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]
#![expect(clippy::cast_precision_loss, reason = "figures for people")]

use std::io::{BufRead, BufReader, Write};
use std::num::NonZeroU64;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant, SystemTime};

use downbeat_realtime::{PreciseWait, Realtime, Scheduling, Woken};

const PROCESSES: usize = 6;
/// What a robot does once it has set its first value.
const WORK: Duration = Duration::from_micros(20);
const AHEAD: Duration = Duration::from_millis(25);

/// Every way of waiting, with its name.
const STRATEGIES: [(&str, Strategy); 9] = [
    ("tokio's timer", Strategy::Tokio),
    ("sleep", Strategy::Spin { micros: 0, pause: Pause::Spin, slice: Slice::Usual }),
    ("spin 500 us, yield", Strategy::Spin { micros: 500, pause: Pause::Yield, slice: Slice::Usual }),
    ("spin 500 us", Strategy::Spin { micros: 500, pause: Pause::Spin, slice: Slice::Usual }),
    ("spin 200 us", Strategy::Spin { micros: 200, pause: Pause::Spin, slice: Slice::Usual }),
    ("sleep, short slice", Strategy::Spin { micros: 0, pause: Pause::Spin, slice: Slice::Short }),
    ("spin 100 us, short slice", Strategy::Spin { micros: 100, pause: Pause::Spin, slice: Slice::Short }),
    ("Downbeat, --realtime off", Strategy::Downbeat(Realtime::Off)),
    ("Downbeat, --realtime auto", Strategy::Downbeat(Realtime::Auto)),
];

#[derive(Clone, Copy)]
enum Strategy {
    Tokio,
    /// Sleeps until so long before the instant.
    Spin {
        micros: u64,
        pause: Pause,
        slice: Slice,
    },
    Downbeat(Realtime),
}

#[derive(Clone, Copy, PartialEq)]
enum Pause {
    Yield,
    Spin,
}

#[derive(Clone, Copy, PartialEq)]
enum Slice {
    Usual,
    Short,
}

fn epoch_nanos() -> i64 {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap();
    i64::try_from(now.as_nanos()).unwrap()
}

fn ahead(target: i64) -> Duration {
    Duration::from_nanos(u64::try_from(target - epoch_nanos()).unwrap_or(0))
}

/// Waits for each instant on standard input, and answers when it woke.
fn be_a_waiter(strategy: Strategy) {
    match strategy {
        Strategy::Tokio => {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
            runtime.block_on(async {
                for line in std::io::stdin().lock().lines() {
                    let target = line.unwrap().trim().parse().unwrap();
                    tokio::time::sleep(ahead(target)).await;
                    answer(epoch_nanos());
                }
            });
        }
        Strategy::Spin { micros, pause, slice } => {
            prepare(slice);
            let (_open, messages) = channel();
            for_each_target(|deadline| spin(&messages, deadline, Duration::from_micros(micros), pause));
        }
        Strategy::Downbeat(realtime) => {
            let mut waits = PreciseWait::new(&Scheduling::of_this_thread(realtime));
            let (_open, messages) = flume::unbounded::<()>();
            for line in std::io::stdin().lock().lines() {
                let target = line.unwrap().trim().parse().unwrap();
                let deadline = Instant::now() + ahead(target);
                assert!(matches!(waits.wait(&messages, Some(deadline)), Woken::Deadline));
                let woken = epoch_nanos();
                waits.let_others_move(None);
                answer(woken);
            }
        }
    }
}

fn for_each_target(wait: impl Fn(Instant)) {
    for line in std::io::stdin().lock().lines() {
        let target = line.unwrap().trim().parse().unwrap();
        wait(Instant::now() + ahead(target));
        answer(epoch_nanos());
    }
}

fn prepare(slice: Slice) {
    rustix::thread::set_current_timer_slack(NonZeroU64::new(1)).unwrap();
    if slice == Slice::Short {
        let mut attributes = uapi::sched_getattr(0, 0).unwrap();
        attributes.sched_runtime = 100_000;
        uapi::sched_setattr(0, &attributes, 0).unwrap();
    }
}

fn spin(messages: &Receiver<()>, deadline: Instant, lead: Duration, pause: Pause) {
    let sleep = (deadline - lead).saturating_duration_since(Instant::now());
    if !sleep.is_zero() {
        let _nothing_is_sent = messages.recv_timeout(sleep);
    }
    while Instant::now() < deadline {
        match pause {
            Pause::Yield => std::thread::yield_now(),
            Pause::Spin => std::hint::spin_loop(),
        }
    }
}

fn answer(woken: i64) {
    let begun = Instant::now();
    while begun.elapsed() < WORK {}
    println!("{woken}");
}

/// Six processes of one strategy, and what was measured of them.
struct Waiters {
    name: &'static str,
    children: Vec<Child>,
    inputs: Vec<ChildStdin>,
    outputs: Vec<BufReader<ChildStdout>>,
    late: Vec<f64>,
    spreads: Vec<f64>,
}

impl Waiters {
    fn start(name: &'static str) -> Self {
        let start = |_| {
            let mut command = Command::new(std::env::current_exe().unwrap());
            command.env("WAITER", name).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap()
        };
        let mut children: Vec<_> = (0..PROCESSES).map(start).collect();
        let inputs = children.iter_mut().map(|child| child.stdin.take().unwrap()).collect();
        let outputs = children.iter_mut().map(|child| BufReader::new(child.stdout.take().unwrap())).collect();
        Self { name, children, inputs, outputs, late: Vec::new(), spreads: Vec::new() }
    }

    fn round(&mut self) {
        let target = epoch_nanos() + i64::try_from(AHEAD.as_nanos()).unwrap();
        self.inputs.iter_mut().for_each(|input| writeln!(input, "{target}").unwrap());
        let woken: Vec<i64> = self
            .outputs
            .iter_mut()
            .map(|output| {
                let mut line = String::new();
                output.read_line(&mut line).unwrap();
                line.trim().parse().unwrap()
            })
            .collect();
        self.late.extend(woken.iter().map(|woken| (woken - target) as f64 / 1e6));
        self.spreads.push((woken.iter().max().unwrap() - woken.iter().min().unwrap()) as f64 / 1e6);
    }

    fn row(&mut self) {
        let (late, spread) = (percentiles(&mut self.late), percentiles(&mut self.spreads));
        println!("{:<28}{late}   {spread}", self.name);
    }
}

impl Drop for Waiters {
    fn drop(&mut self) {
        for child in &mut self.children {
            let _gone = child.kill();
            let _reaped = child.wait();
        }
    }
}

fn percentiles(values: &mut [f64]) -> String {
    values.sort_by(f64::total_cmp);
    // Nearest rank.
    let rank = |percent: usize| values[(values.len() * percent).div_ceil(100) - 1];
    [50, 90, 99, 100].map(|percent| format!("{:>9.3}", rank(percent))).concat()
}

fn main() {
    if let Ok(name) = std::env::var("WAITER") {
        let found = STRATEGIES.iter().find(|(of, _)| *of == name);
        return be_a_waiter(found.unwrap_or_else(|| panic!("no strategy `{name}`")).1);
    }
    let arguments: Vec<_> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let busy = arguments.iter().any(|argument| argument == "busy");
    let rounds = arguments.iter().position(|argument| argument == "rounds");
    let rounds = rounds.map_or(200, |at| arguments[at + 1].parse().unwrap());
    let mut load = Vec::new();
    if busy {
        let cores = std::thread::available_parallelism().map_or(1, Into::into);
        load.extend(
            (0..cores).map(|_| Command::new("sh").args(["-c", "while :; do :; done"]).spawn().unwrap()),
        );
    }
    let named = |name: &str| arguments.iter().any(|argument| argument == name);
    let all = !STRATEGIES.iter().any(|(name, _)| named(name));
    let chosen = STRATEGIES.iter().filter(|(name, _)| all || named(name));
    let mut waiters: Vec<_> = chosen.map(|(name, _)| Waiters::start(name)).collect();
    for round in 0..rounds {
        for turn in 0..waiters.len() {
            let next = (round + turn) % waiters.len();
            waiters[next].round();
            std::thread::sleep(Duration::from_millis(7));
        }
    }
    let state = if busy { "all cores busy" } else { "no load of its own" };
    println!("{PROCESSES} processes, {rounds} instants each, {state}, ms");
    println!("{:<28}{:>36}   {:>36}", "", "late: p50, p90, p99, max", "apart: p50, p90, p99, max");
    waiters.iter_mut().for_each(Waiters::row);
    for mut child in load {
        let _gone = child.kill();
        let _reaped = child.wait();
    }
}
