//! Measures three tasks. Temporal networks of 100,000 cues are solved, compared with petgraph's Bellman-Ford on graphs of the same shape.
//! A single change is compared with solving the network again. Orders of job shops are compared with their proven optima.
//!
//! `cargo bench -p downbeat-timing --bench temporal_network`
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark at a terminal")]
#![expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
#![expect(clippy::cast_precision_loss, reason = "figures for people")]

use std::hint::black_box;
use std::time::{Duration, Instant};

use downbeat_timing::{ConstraintId, Effort, Event, Network, Ordering, Solved, Task, order};
use petgraph::algo::bellman_ford;
use petgraph::graph::{DiGraph, NodeIndex};
use urrcp::Span;

const CUES: usize = 100_000;

/// A network and its original bounds. Each bound has two events and the minimum and maximum time between them, in nanoseconds.
struct Shape {
    name: &'static str,
    events: usize,
    bounds: Vec<(usize, usize, Option<i64>, Option<i64>)>,
}

/// Marsaglia's xorshift generator, which gives the same graphs in every run.
struct Random(u64);

impl Random {
    fn below(&mut self, most: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as usize % most
    }
}

impl Shape {
    /// Returns cues with a start event and an end event each, and a function from a cue to its events. Event 0 is the origin; events 1
    /// and 2 belong to the cue that `number` maps to 0.
    fn cues(
        name: &'static str,
        cues: usize,
        number: impl Fn(usize) -> usize,
    ) -> (Self, impl Fn(usize) -> (usize, usize)) {
        let events: Vec<_> = (0..cues).map(|cue| (1 + 2 * number(cue), 2 + 2 * number(cue))).collect();
        let bounds = events.iter().map(|(start, end)| (*start, *end, Some(1_000), Some(1_000))).collect();
        (Self { name, events: 1 + 2 * cues, bounds }, move |cue| events[cue])
    }

    /// Returns a network in which each cue follows the previous one, optionally with a maximum gap. Each cue also has a constraint to an
    /// earlier cue.
    fn chain(name: &'static str, cues: usize, largest: Option<i64>, number: impl Fn(usize) -> usize) -> Self {
        let (mut shape, event) = Self::cues(name, cues, number);
        for cue in 1..cues {
            shape.bounds.push((event(cue - 1).1, event(cue).0, Some(10), largest));
            shape.bounds.push((event(cue.saturating_sub(7)).0, event(cue).0, Some(5), None));
        }
        shape
    }

    /// Returns a network in which each cue follows two random earlier cues.
    fn layered(cues: usize) -> Self {
        let (mut shape, event) = Self::cues("random, each after two others", cues, |cue| cue);
        let mut random = Random(7);
        for cue in 1..cues {
            for _ in 0..2 {
                shape.bounds.push((
                    event(random.below(cue)).1,
                    event(cue).0,
                    Some(random.below(100) as i64),
                    None,
                ));
            }
        }
        shape
    }

    /// Returns a network in which each cue has a fixed time, shortly after the previous cue.
    fn tied(cues: usize) -> Self {
        let (mut shape, event) = Self::cues("every cue at a fixed time", cues, |cue| cue);
        for cue in 0..cues {
            let at = 1_010 * cue as i64;
            shape.bounds.push((0, event(cue).0, Some(at), Some(at)));
            if cue > 0 {
                shape.bounds.push((event(cue - 1).1, event(cue).0, Some(0), Some(5_000)));
            }
        }
        shape
    }

    fn network(&self) -> (Network, Vec<ConstraintId>) {
        let mut network = Network::new();
        let mut events: Vec<Event> = vec![network.origin()];
        events.extend((1..self.events).map(|_| network.event()));
        let span = |nanos: Option<i64>| nanos.map(Span::from_nanos);
        let ids = self.bounds.iter().map(|(from, to, min, max)| {
            network.constrain(events[*from], events[*to], span(*min), span(*max))
        });
        let ids = ids.collect();
        (network, ids)
    }

    /// Returns the bounds as edge lengths of a graph, for an algorithm that finds shortest paths.
    fn graph(&self) -> DiGraph<(), f64> {
        let mut graph = DiGraph::with_capacity(self.events, self.bounds.len() * 2 + self.events);
        for _ in 0..self.events {
            graph.add_node(());
        }
        let node = NodeIndex::new;
        for (from, to, min, max) in &self.bounds {
            if let Some(min) = min {
                graph.add_edge(node(*from), node(*to), -(*min as f64));
            }
            if let Some(max) = max {
                graph.add_edge(node(*to), node(*from), *max as f64);
            }
        }
        for event in 1..self.events {
            graph.add_edge(node(0), node(event), 0.0);
        }
        graph
    }
}

fn timed<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let begin = Instant::now();
    let result = black_box(work());
    (result, begin.elapsed())
}

fn shapes(cues: usize) -> Vec<Shape> {
    let forwards = |cue| cue;
    let backwards = move |cue| cues - 1 - cue;
    // A fixed permutation: 100,003 is prime.
    let shuffled = move |cue: usize| cue * 48_271 % cues;
    vec![
        Shape::chain("chain, listed forwards", cues, None, forwards),
        Shape::chain("chain, listed backwards", cues, None, backwards),
        Shape::chain("chain, shuffled", cues, None, shuffled),
        Shape::chain("chain of cues with a least and a largest gap", cues, Some(50), backwards),
        Shape::layered(cues),
        Shape::tied(cues),
    ]
}

fn solve_all() {
    println!(
        "{:<34} {:>11} {:>11} {:>10} {:>16} {:>8}",
        "100,000 cues", "constraints", "solve", "cues", "Bellman-Ford", "ratio"
    );
    // Bellman-Ford is quadratic on most of these graphs, so it runs on fewer cues, which take it seconds.
    for (shape, small) in shapes(CUES).iter().zip(shapes(2_000)) {
        let (network, _) = shape.network();
        let (solved, time) = timed(|| network.solve());
        assert!(solved.is_ok(), "{}", shape.name);
        let (small_network, _) = small.network();
        let (_, small_time) = timed(|| small_network.solve());
        let graph = small.graph();
        let (paths, theirs) = timed(|| bellman_ford(&graph, NodeIndex::new(0)));
        assert!(paths.is_ok());
        println!(
            "{:<34} {:>11} {:>8.1} ms {:>10} {:>13.1} ms {:>8.0}",
            shape.name,
            shape.bounds.len(),
            time.as_secs_f64() * 1e3,
            2_000,
            theirs.as_secs_f64() * 1e3,
            theirs.as_secs_f64() / small_time.as_secs_f64()
        );
    }
}

/// Measures how fast a contradiction is found: the last cue of a chain has to end a nanosecond earlier than possible.
fn conflict() {
    let mut shape = Shape::chain("chain with a contradiction", CUES, Some(50), |cue| cue);
    let (network, _) = shape.network();
    let last = network.solve().unwrap().makespan().as_nanos();
    shape.bounds.push((0, shape.events - 1, None, Some(last - 1)));
    let (network, _) = shape.network();
    let (conflict, time) = timed(|| network.solve().unwrap_err());
    println!(
        "{:<34} {:>11} {:>8.1} ms to a chain of {} links, {} corrections",
        shape.name,
        shape.bounds.len(),
        time.as_secs_f64() * 1e3,
        conflict.chain.len(),
        conflict.corrections.len()
    );
}

fn changes() {
    for shape in shapes(CUES) {
        let (network, ids) = shape.network();
        let (_, again) = timed(|| network.solve());
        let mut solved = Solved::new(network).unwrap();
        let mut worst = Duration::ZERO;
        let mut total = Duration::ZERO;
        let mut random = Random(11);
        for turn in 0..40 {
            // Makes a cue longer, then restores its length.
            let cue = if turn % 2 == 0 { random.below(CUES) } else { 0 };
            let id = ids[cue];
            for length in [1_001, 1_000] {
                let length = Some(Span::from_nanos(length));
                let (changed, time) = timed(|| solved.change(id, length, length));
                let _too_tight = changed;
                worst = worst.max(time);
                total += time;
            }
        }
        println!(
            "{:<34} one change: mean {:.3} ms, worst {:.3} ms (bound 10); solving again {:.1} ms",
            shape.name,
            total.as_secs_f64() * 1e3 / 80.0,
            worst.as_secs_f64() * 1e3,
            again.as_secs_f64() * 1e3
        );
    }
}

fn orders() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/fixtures/jobshop/instances.json");
    let all: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    println!("{:<8} {:>6} {:>8} {:>8} {:>7} {:>9}", "shop", "tasks", "optimum", "found", "gap", "time");
    for (name, shop) in all.as_object().unwrap() {
        let mut network = Network::new();
        let mut tasks = Vec::new();
        let rows = shop["duration_matrix"]
            .as_array()
            .unwrap()
            .iter()
            .zip(shop["machines_matrix"].as_array().unwrap());
        for (durations, machines) in rows {
            let mut last = network.origin();
            for (duration, machine) in durations.as_array().unwrap().iter().zip(machines.as_array().unwrap())
            {
                let (start, end) = (network.event(), network.event());
                let duration = Span::from_millis(duration.as_i64().unwrap());
                network.constrain(start, end, Some(duration), Some(duration));
                network.constrain(last, start, Some(Span::ZERO), None);
                tasks.push(Task { start, end, zone: machine.as_u64().unwrap() as usize });
                last = end;
            }
        }
        let optimum = shop["metadata"]["optimum"].as_i64().unwrap();
        let (ordering, time) = timed(|| order(&network, &tasks, Effort::default()));
        let Ordering::Found(found) = ordering else { continue };
        let makespan = found.makespan.as_nanos() / 1_000_000;
        println!(
            "{name:<8} {:>6} {optimum:>8} {makespan:>8} {:>6.1}% {:>7.2} s",
            tasks.len(),
            (makespan as f64 / optimum as f64 - 1.0) * 100.0,
            time.as_secs_f64()
        );
    }
}

fn main() {
    let only = std::env::args().nth(1).filter(|name| !name.starts_with('-'));
    let parts: [(&str, fn()); 4] =
        [("solve", solve_all), ("conflict", conflict), ("change", changes), ("order", orders)];
    for (name, part) in parts {
        if only.as_ref().is_none_or(|only| only == name) {
            part();
        }
    }
}
