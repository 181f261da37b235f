//! Trials of the example `swap`, six robots, in the world `wifi`: their number a second on one core and on all, and whether the time grows
//! with their number alone. The baseline is the single dry run in a perfect world, played as often.
//!
//! `cargo bench -p downbeat --bench trials -- TRIALS`, 1000 if not given.
#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a benchmark at a terminal")]
#![expect(clippy::disallowed_methods, reason = "a benchmark takes real time")]

use std::path::Path;
use std::time::Instant;

use downbeat::mission::MissionOptions;
use downbeat::trials::Trials;
use downbeat_scripts::{Act, Choreography, Fleet, Folder, Source, World, compile, read_fleet, read_world};

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

fn seconds(work: impl FnOnce()) -> f64 {
    let begin = Instant::now();
    work();
    begin.elapsed().as_secs_f64()
}

fn load() -> (Choreography, Fleet, World) {
    let root = Path::new(ROOT);
    let fleet = read_fleet(&root.join("fleet.yaml")).0.unwrap();
    let source = Source::read(&root.join("scripts/examples/swap.yaml")).unwrap();
    let choreography =
        compile(&source, &fleet, &Folder::new(root.join("scripts/examples"))).choreography.unwrap();
    let acts: Vec<&str> = choreography.acts.iter().map(Act::called).collect();
    let world = read_world(&root.join("scripts/examples/worlds/wifi.yaml"), &fleet, &acts).0.unwrap();
    (choreography, fleet, world)
}

fn main() {
    let count = std::env::args().skip(1).find_map(|arg| arg.parse().ok()).unwrap_or(1_000_u32);
    let (choreography, fleet, world) = load();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let play = |world: &World, count: u32, threads: usize| {
        let trials = Trials::new(&choreography, &fleet, world, MissionOptions::default(), 7);
        seconds(|| drop(trials.play(count, threads, |_| true).unwrap()))
    };
    let rate = |seconds: f64| f64::from(count) / seconds;
    let perfect = play(&World::default(), count, 1);
    let one = play(&world, count, 1);
    let all = play(&world, count, cores);
    let twice = play(&world, count * 2, cores);
    let four = play(&world, count * 4, cores);
    println!(
        "{count} missions, perfect world, one core:  {perfect:.2} s, {:.0} a second (baseline)",
        rate(perfect)
    );
    println!("{count} trials, one core:                   {one:.2} s, {:.2} of the baseline", one / perfect);
    println!("{count} trials, {cores} cores:                    {all:.2} s, {:.2} of one core", all / one);
    println!("twice as many:                        {:.2} times as long", twice / all);
    println!("four times as many:                   {:.2} times as long", four / all);
}
