//! Any number of seeds of faults on all cores: what is violated, how often starts are mixed within the stated window, and
//! how a broadcast or a sequential "go" fares under the same faults.
//!
//! `cargo run --release --bin soak -- --seeds 1000000`; `--trace SEED` prints the story of one.
#![expect(clippy::print_stdout, reason = "a program that reports to a terminal")]

use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use clap::Parser;
use downbeat::simulation::baseline::{self, Go};
use downbeat::simulation::{self, Starts, Violation};
use urrcp::Span;

/// Plays seeds of faults and holds the invariants against what the robots really did.
#[derive(Parser)]
struct Args {
    /// How many seeds.
    #[arg(long, default_value_t = 10_000)]
    seeds: u64,
    /// The first one.
    #[arg(long, default_value_t = 0)]
    from: u64,
    /// Print the story of this seed instead.
    #[arg(long, value_name = "SEED")]
    trace: Option<u64>,
    /// Threads; otherwise one a core.
    #[arg(long)]
    threads: Option<usize>,
}

#[derive(Clone, Copy, Default)]
struct Counts {
    acts: u64,
    all: u64,
    none: u64,
    mixed: u64,
}

impl Counts {
    fn take(&mut self, starts: Starts) {
        self.acts += 1;
        match starts {
            Starts::All => self.all += 1,
            Starts::None => self.none += 1,
            Starts::Mixed => self.mixed += 1,
        }
    }

    fn add(&mut self, other: &Self) {
        self.acts += other.acts;
        self.all += other.all;
        self.none += other.none;
        self.mixed += other.mixed;
    }

    fn row(&self, name: &str) {
        let part = |count: u64| 100.0 * count as f64 / self.acts.max(1) as f64;
        println!(
            "{name:<22} {:>10} {:>9.3} % {:>9.3} % {:>9.3} %",
            self.acts,
            part(self.all),
            part(self.none),
            part(self.mixed)
        );
    }
}

#[derive(Default)]
struct Found {
    counts: [Counts; 3],
    violations: Vec<(u64, Violation)>,
}

fn main() -> ExitCode {
    let args = Args::parse();
    if let Some(seed) = args.trace {
        print!("{}", simulation::trace(&simulation::run_verbosely(seed)));
        return ExitCode::SUCCESS;
    }
    let threads =
        args.threads.or_else(|| std::thread::available_parallelism().ok().map(Into::into)).unwrap_or(1);
    let next = AtomicU64::new(args.from);
    let end = args.from + args.seeds;
    let all = Mutex::new(Found::default());
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                let mut mine = Found::default();
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= end {
                        break;
                    }
                    look_at(seed, &mut mine);
                }
                if let Ok(mut all) = all.lock() {
                    for (sum, counts) in all.counts.iter_mut().zip(&mine.counts) {
                        sum.add(counts);
                    }
                    all.violations.append(&mut mine.violations);
                }
            });
        }
    });
    let mut found = all.into_inner().unwrap_or_default();
    found.violations.sort_by_key(|(seed, _)| *seed);
    println!("{} seeds", args.seeds);
    println!("{:<22} {:>10} {:>11} {:>11} {:>11}", "", "starts", "all", "none", "mixed");
    for (name, counts) in ["downbeat", "broadcast go", "sequential go"].iter().zip(&found.counts) {
        counts.row(name);
    }
    for invariant in 'a'..='e' {
        let of = found.violations.iter().filter(|(_, violation)| violation.invariant == invariant);
        println!("({invariant}) violated {} times", of.count());
    }
    for (seed, violation) in found.violations.iter().take(20) {
        println!("seed {seed}: {violation}");
    }
    if found.violations.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn look_at(seed: u64, found: &mut Found) {
    let ran = simulation::run(seed);
    let verdict = ran.verdict();
    verdict.starts.iter().for_each(|starts| found.counts[0].take(*starts));
    found.violations.extend(verdict.violations.into_iter().map(|violation| (seed, violation)));
    // The word is given when the first act would have started, or where that never came, after a second and a half.
    let start = ran.records.iter().find_map(|(_, record)| match record {
        downbeat::mission::Record::Prepared(promise) => Some(promise.start - downbeat::dry_run::BEGIN),
        _ => None,
    });
    let at = start.unwrap_or(Span::from_millis(1_500));
    found.counts[1].take(baseline::starts(&ran.drawn, Go::Broadcast, at));
    found.counts[2].take(baseline::starts(&ran.drawn, Go::Sequential, at));
}
