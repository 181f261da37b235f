//! Plays missions with faults from any number of seeds on all cores. Reports the violations, how often starts are mixed and why, and how
//! a broadcast or sequential "go" performs with the same acts and faults.
//!
//! `cargo run --release -p soak -- --seeds 1000000`; `--seed N` prints the shortest mission that shows the violation of a seed, `--trace
//! N` the full one.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use clap::Parser;
use downbeat_simulation::baseline::{self, Go};
use downbeat_simulation::{
    self as simulation, Cause, Excuse, FaultKind, Situation, Stage, Starts, Verdict, Violation,
};
use indicatif::{ProgressBar, ProgressStyle};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Prints a line to standard output. Ignores a closed pipe, because the exit code reports the result.
macro_rules! say {
    ($($text:tt)*) => {
        let _nobody_reads = writeln!(io::stdout(), $($text)*);
    };
}

/// Maximum number of violations whose traces are printed by default.
const STORIES_MAX: usize = 1;

/// The number of seeds after which each fault must have occurred at each possible stage.
const SEEDS_FOR_EACH_STAGE: u64 = 20_000;

/// The exit code if no invariant is violated, but the missions lack a possible combination of fault and stage, or a situation.
const NOT_MET: u8 = 3;

/// Plays seeds with faults and checks the invariants against the actual behaviour of the robots.
#[derive(Parser)]
struct Args {
    /// Number of seeds.
    #[arg(long, default_value_t = 10_000)]
    seeds: u64,
    /// The first seed.
    #[arg(long, default_value_t = 0)]
    from: u64,
    /// The distance between consecutive seeds. `--from 40 --step 50` plays only one family of missions.
    #[arg(long, default_value_t = 1)]
    step: u64,
    /// Play only this seed, and print the shortest mission that shows its violation, or that it violates nothing.
    #[arg(long, value_name = "SEED")]
    seed: Option<u64>,
    /// Print the full trace of this seed instead.
    #[arg(long, value_name = "SEED")]
    trace: Option<u64>,
    /// Maximum number of violations to list.
    #[arg(long, default_value_t = 20)]
    list: usize,
    /// Number of threads; one per core by default.
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
        say!(
            "{name:<22} {:>10} {:>9.3} % {:>9.3} % {:>9.3} %",
            self.acts,
            percent(self.all, self.acts),
            percent(self.none, self.acts),
            percent(self.mixed, self.acts)
        );
    }
}

fn percent(count: u64, of: u64) -> f64 {
    100.0 * count as f64 / of.max(1) as f64
}

/// The number of violations that a cause excused, and the first seed with such a violation.
#[derive(Clone, Copy)]
struct Excused {
    count: u64,
    first: u64,
}

#[derive(Default)]
struct Found {
    counts: [Counts; 3],
    excuses: BTreeMap<(char, Cause), Excused>,
    violations: Vec<(u64, Violation)>,
    met: BTreeMap<(FaultKind, Stage), u64>,
    situations: BTreeMap<Situation, Reached>,
}

/// How often missions reached a situation, and the first seed whose mission reached it.
#[derive(Clone, Copy)]
struct Reached {
    count: u64,
    first: u64,
}

impl Found {
    fn add(&mut self, other: Self) {
        for (sum, counts) in self.counts.iter_mut().zip(&other.counts) {
            sum.add(counts);
        }
        for (excuse, Excused { count, first }) in other.excuses {
            let sum = self.excuses.entry(excuse).or_insert(Excused { count: 0, first });
            *sum = Excused { count: sum.count + count, first: sum.first.min(first) };
        }
        self.violations.extend(other.violations);
        for (cell, count) in other.met {
            *self.met.entry(cell).or_default() += count;
        }
        for (situation, Reached { count, first }) in other.situations {
            let sum = self.situations.entry(situation).or_insert(Reached { count: 0, first });
            *sum = Reached { count: sum.count + count, first: sum.first.min(first) };
        }
    }

    fn look_at(&mut self, seed: u64) {
        let ran = simulation::run(seed);
        let verdict = simulation::judge(&ran);
        for cell in simulation::faults_met(&ran) {
            *self.met.entry(cell).or_default() += 1;
        }
        for situation in verdict.situations {
            let sum = self.situations.entry(situation).or_insert(Reached { count: 0, first: seed });
            *sum = Reached { count: sum.count + 1, first: sum.first.min(seed) };
        }
        for act in &verdict.acts {
            self.counts[0].take(act.starts);
            self.counts[1].take(baseline::starts(&ran.drawn, Go::Broadcast, act));
            self.counts[2].take(baseline::starts(&ran.drawn, Go::Sequential, act));
        }
        for Excuse { invariant, cause } in verdict.excuses {
            let sum = self.excuses.entry((invariant, cause)).or_insert(Excused { count: 0, first: seed });
            *sum = Excused { count: sum.count + 1, first: sum.first.min(seed) };
        }
        self.violations.extend(verdict.violations.into_iter().map(|violation| (seed, violation)));
    }

    fn print(&self, seeds: u64, list: usize) {
        say!("{seeds} seeds");
        say!("{:<22} {:>10} {:>11} {:>11} {:>11}", "", "starts", "all", "none", "mixed");
        for (name, counts) in ["downbeat", "broadcast go", "sequential go"].iter().zip(&self.counts) {
            counts.row(name);
        }
        let causes = "why starts were mixed: a fault within its window";
        self.print_excuses('a', causes, self.counts[0].acts);
        self.print_excuses('f', "why robots started outside the skew budget", self.counts[0].acts);
        self.print_met();
        self.print_situations();
        say!("");
        for (invariant, name) in Verdict::INVARIANTS {
            let of = self.violations.iter().filter(|(_, violation)| violation.invariant == invariant);
            say!("({invariant}) {name:<36} violated {} times", of.count());
        }
        for (seed, violation) in self.violations.iter().take(list) {
            say!("seed {seed}: {violation}");
        }
        for what in self.beyond_limits() {
            say!("all seeds: {what}");
        }
    }

    /// Prints how often each fault occurred at each stage of a mission; `-` if the fault cannot occur at the stage.
    fn print_met(&self) {
        say!("");
        let stages: String = Stage::ALL.iter().map(|stage| format!("{stage:>10}")).collect();
        say!("{:<24}{stages}", "faults by stage");
        for kind in FaultKind::ALL {
            let count = |stage: &Stage| match self.met.get(&(kind, *stage)) {
                _ if !stage.meets(kind) => format!("{:>10}", "-"),
                count => format!("{:>10}", count.copied().unwrap_or_default()),
            };
            say!("{kind:<24}{}", Stage::ALL.iter().map(count).collect::<String>());
        }
    }

    /// Prints how often each situation was reached.
    fn print_situations(&self) {
        say!("\n{:<58} {:>8} {:>10}", "situations", "reached", "first seed");
        for situation in Situation::ALL {
            let (count, first) = match self.situations.get(&situation) {
                Some(Reached { count, first }) => (*count, first.to_string()),
                None => (0, "-".to_owned()),
            };
            say!("  {situation:<56} {count:>8} {first:>10}");
        }
    }

    /// Lists the faults that have not occurred at a possible stage, and the situations that no mission reached. The list is empty if too
    /// few missions were played.
    fn not_met(&self, seeds: u64) -> Vec<String> {
        let cells = FaultKind::ALL.iter().flat_map(|kind| Stage::ALL.map(|stage| (*kind, stage)));
        let missing = cells.filter(|cell| cell.1.meets(cell.0) && !self.met.contains_key(cell));
        let missing = missing.filter(|_| seeds >= SEEDS_FOR_EACH_STAGE);
        let missing =
            missing.map(|(kind, stage)| format!("the fault `{kind}` never occurred at the stage `{stage}`"));
        let reached = |situation: &Situation| self.situations.contains_key(situation);
        let never = Situation::ALL.into_iter().filter(|_| seeds >= SEEDS_FOR_EACH_STAGE);
        let never = never.filter(|situation| !reached(situation));
        missing
            .chain(never.map(|situation| format!("no mission reached this situation: {situation}")))
            .collect()
    }

    /// Lists the causes that excuse violations in more acts than permitted.
    fn beyond_limits(&self) -> Vec<String> {
        let acts = self.counts[0].acts;
        let beyond = |(&(invariant, cause), excused): (&(char, Cause), &Excused)| {
            let expected = cause.largest_share(invariant) * acts as f64;
            // By chance, a few seeds may exceed the expected number.
            let most = expected + 4.0 * expected.sqrt() + 1.0;
            let share = percent(excused.count, acts);
            let largest = 100.0 * cause.largest_share(invariant);
            let what = format!(
                "({invariant}) `{cause}` excuses {share:.3} % of acts, but at most {largest:.3} % are allowed; the first \
                 such seed is {}",
                excused.first
            );
            (excused.count as f64 > most).then_some(what)
        };
        self.excuses.iter().filter_map(beyond).collect()
    }

    /// Prints the excused violations of an invariant: one line per cause, and their sum.
    fn print_excuses(&self, invariant: char, title: &str, acts: u64) {
        say!("\n{title:<58} {:>8} {:>11} {:>11} {:>10}", "", "of acts", "at most", "first seed");
        let excused =
            Cause::ALL.iter().filter_map(|cause| Some((cause, self.excuses.get(&(invariant, *cause))?)));
        let mut sum = 0;
        for (cause, Excused { count, first }) in excused {
            sum += count;
            let (share, most) = (percent(*count, acts), 100.0 * cause.largest_share(invariant));
            say!("  {:<56} {count:>8} {share:>9.3} % {most:>9.3} % {first:>10}", cause.to_string());
        }
        say!("  {:<56} {sum:>8} {:>9.3} %", "in all", percent(sum, acts));
    }
}

fn main() -> ExitCode {
    let args = Args::parse();
    // Failed assertions are violations, which are printed with their seeds.
    std::panic::set_hook(Box::new(|_| {}));
    if let Some(seed) = args.trace {
        say!("{}", simulation::trace(&simulation::run_verbosely(seed)).trim_end());
        return ExitCode::SUCCESS;
    }
    if let Some(seed) = args.seed {
        return tell(seed);
    }
    let mut found = play_all(&args);
    found.violations.sort_by_key(|(seed, _)| *seed);
    found.print(args.seeds, args.list);
    let mut seeds: Vec<u64> = found.violations.iter().map(|(seed, _)| *seed).collect();
    seeds.dedup();
    seeds.into_iter().take(STORIES_MAX).for_each(|seed| {
        let _failure = tell(seed);
    });
    if !found.violations.is_empty() || !found.beyond_limits().is_empty() {
        return ExitCode::FAILURE;
    }
    let not_met = found.not_met(args.seeds);
    for what in &not_met {
        say!("{what}");
    }
    if not_met.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(NOT_MET) }
}

fn play_all(args: &Args) -> Found {
    let threads =
        args.threads.or_else(|| std::thread::available_parallelism().ok().map(Into::into)).unwrap_or(1);
    let next = AtomicU64::new(args.from);
    let step = args.step.max(1);
    let end = args.from.saturating_add(args.seeds.saturating_mul(step));
    let all = Mutex::new(Found::default());
    let progress = progress(args.seeds);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                let mut mine = Found::default();
                loop {
                    let seed = next.fetch_add(step, Ordering::Relaxed);
                    if seed >= end {
                        break;
                    }
                    mine.look_at(seed);
                    progress.inc(1);
                }
                if let Ok(mut all) = all.lock() {
                    all.add(mine);
                }
            });
        }
    });
    progress.finish_and_clear();
    all.into_inner().unwrap_or_default()
}

/// A progress bar, shown only on a terminal.
fn progress(seeds: u64) -> ProgressBar {
    let progress = ProgressBar::new(seeds);
    let style =
        ProgressStyle::with_template("{bar:40} {human_pos} of {human_len} seeds, {per_sec}, {eta} left");
    if let Ok(style) = style {
        progress.set_style(style);
    }
    progress.enable_steady_tick(Duration::from_millis(200));
    progress
}

/// Prints the shortest mission that shows the violation of a seed, and the command to repeat it.
fn tell(seed: u64) -> ExitCode {
    let Some(shrunk) = simulation::shrunk(seed) else {
        say!("\nseed {seed} violates no invariant; `soak --trace {seed}` prints its trace");
        return ExitCode::SUCCESS;
    };
    say!("\nThe shortest trace of seed {seed} that violates invariant ({}):\n", shrunk.invariant);
    say!("{}", simulation::trace(&simulation::play_verbosely(shrunk.drawn)).trim_end());
    say!("\nTo reproduce it: `soak --seed {seed}`; for the whole trace: `soak --trace {seed}`");
    ExitCode::FAILURE
}
