//! Six processes that only wait for a given instant: with tokio's timer, or as precisely as this machine allows.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Duration;

use super::figures::{Round, Start};
use super::witness::{Witness, become_first, stay_on};
use super::{ROBOTS, epoch_nanos};

/// Time from sending an instant to the processes until that instant.
const AHEAD_NS: i64 = 150_000_000;
/// Time before the instant during which an ideal waiter spins, regardless of other load on its core.
const SPIN_NS: i64 = 2_000_000;

/// Time after the instant during which an ideal waiter lets the other waiters on its core run.
const TURNS_NS: i64 = 200_000;

/// How a process waits.
#[derive(Clone, Copy, PartialEq)]
pub enum Kind {
    /// With tokio's timer: the usual way without a dedicated thread.
    Tokio,
    /// With the highest priority on its core and no other work: the bound that no robot can beat.
    Ideal,
}

/// Waiting processes, which are killed on drop.
pub struct Waiters {
    children: Vec<Child>,
    inputs: Vec<ChildStdin>,
    outputs: Vec<BufReader<ChildStdout>>,
    pub rounds: Vec<Round>,
}

impl Waiters {
    pub fn start(kind: Kind) -> Self {
        let start = |id: usize| {
            let mut command = Command::new(std::env::current_exe().unwrap());
            let word = if kind == Kind::Tokio { "tokio".to_owned() } else { id.to_string() };
            command.env("WAITER", word).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap()
        };
        let mut children: Vec<_> = (0..ROBOTS).map(start).collect();
        let inputs = children.iter_mut().map(|child| child.stdin.take().unwrap()).collect();
        let outputs = children.iter_mut().map(|child| BufReader::new(child.stdout.take().unwrap())).collect();
        Self { children, inputs, outputs, rounds: Vec::new() }
    }

    pub fn round(&mut self, witness: Option<&Witness>) {
        let target = epoch_nanos() + AHEAD_NS;
        self.inputs.iter_mut().for_each(|input| writeln!(input, "{target}").unwrap());
        witness.into_iter().for_each(|witness| witness.attend(target));
        let woken = self.outputs.iter_mut().map(|output| {
            let mut line = String::new();
            output.read_line(&mut line).unwrap();
            let true_ns: i64 = line.trim().parse().unwrap();
            Start { true_ns, late_ns: true_ns - target }
        });
        let mut round: Round = woken.collect();
        round.sort_by_key(|start| start.true_ns);
        self.rounds.push(round);
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

/// Runs a waiter process: answers each instant on standard input with the time when it woke.
pub fn be_a_waiter(word: &str) {
    match word.parse() {
        Ok(id) => be_ideal(id),
        Err(_) => be_a_timer(),
    }
}

fn be_a_timer() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
    runtime.block_on(async {
        for target in targets() {
            tokio::time::sleep(ahead(target)).await;
            println!("{}", epoch_nanos());
        }
    });
}

/// Waits for each instant with a priority above all other programs on its core, except other ideal waiters.
fn be_ideal(id: usize) {
    let cores = std::thread::available_parallelism().map_or(1, Into::into);
    stay_on(id % cores);
    become_first(60);
    for target in targets() {
        std::thread::sleep(ahead(target - SPIN_NS));
        let woken = loop {
            let now = epoch_nanos();
            if now >= target {
                break now;
            }
            std::thread::yield_now();
        };
        // Gives the others on this core their turn.
        while epoch_nanos() < target + TURNS_NS {
            std::thread::yield_now();
        }
        println!("{woken}");
    }
}

fn targets() -> impl Iterator<Item = i64> {
    std::io::stdin().lock().lines().map(|line| line.unwrap().trim().parse().unwrap())
}

fn ahead(target: i64) -> Duration {
    Duration::from_nanos(u64::try_from(target - epoch_nanos()).unwrap_or(0))
}
