//! Three routers with a fleet behind two of them and the scheduler behind the third; some tests kill and restart a router. `.ci/zenoh`
//! runs these tests, because they need the program `zenohd`, whose path is in the variable `ZENOHD`. `ZENOH_ROBOTS` is the size of the
//! fleet.
#![expect(clippy::print_stdout, reason = "figures for docs/zenoh.md")]

use std::time::{Duration, Instant};

use crate::network::{
    Router, STEPS, client, fleet, lies, names, outcome, sets, simulated, stage, stage_where, start,
};
use stage::{Ended, Process, Stage};

/// A fleet of robots, and the routers through which the scheduler reaches them.
struct Hall {
    stage: Stage,
    count: usize,
    routers: [Router; 3],
    _robots: [Process; 2],
}

impl Hall {
    fn open(running: &str) -> Self {
        Self::of(stage(running))
    }

    fn of(stage: Stage) -> Self {
        let count: usize = std::env::var("ZENOH_ROBOTS").map_or(1_000, |count| count.parse().unwrap());
        let a = Router::start(&stage, "a", &[]);
        let b = Router::start(&stage, "b", &[a.port]);
        let c = Router::start(&stage, "c", &[a.port]);
        stage.file("scheduler.json5", client(a.port));
        stage.file("fleet.yaml", fleet(&names(0, count), "scheduler.json5"));
        let half = count / 2;
        let robots =
            [("b", &b, 0, half), ("c", &c, half, count - half)].map(|(name, router, first, count)| {
                let (file, config) = (format!("{name}.yaml"), format!("robots-{name}.json5"));
                stage.file(&config, client(router.port)).file(&file, fleet(&names(first, count), &config));
                simulated(&stage, &file, count, &[])
            });
        Self { stage, count, routers: [a, b, c], _robots: robots }
    }

    fn run(&self) -> stage::Running {
        self.stage.start(&["run", "play.yaml", "--format", "json", "--patience", "60s"])
    }

    /// Checks the report against the logs. Returns how many robots moved, and how many of them played to the end.
    #[track_caller]
    fn agree(&self, ended: &Ended, what: &str) -> (usize, usize) {
        let sets = sets(&self.stage, &["b.yaml", "c.yaml"]);
        assert_eq!(lies(ended, &sets), [""; 0], "{what}: {ended}");
        let whole = sets.values().filter(|sets| sets.len() == STEPS as usize).count();
        let report = ended.report();
        println!(
            "{what}: {}, exit code {:?}; of {} robots {} moved, {whole} to the end; spread {}, reports agree with all logs",
            outcome(ended),
            ended.code,
            self.count,
            sets.len(),
            report["spread_ms"],
        );
        (sets.len(), whole)
    }

    /// Plays a mission while the router of the first half of the fleet is down for 0.7 s, starting `after` milliseconds after the first
    /// request.
    fn prepare_without_router(&mut self, after: u64) -> Ended {
        let run = self.run();
        start(&self.stage);
        std::thread::sleep(Duration::from_millis(after));
        self.routers[1].kill();
        std::thread::sleep(Duration::from_millis(700));
        self.routers[1].restart();
        run.ended_within(Duration::from_secs(180)).unwrap()
    }
}

#[test]
#[ignore = "needs zenohd: .ci/zenoh runs it"]
fn fleet_behind_two_routers_prepares_starts_and_reports() {
    let hall = Hall::open("5s");
    let began = Instant::now();
    let ended = hall.run().ended_within(Duration::from_secs(180)).unwrap();
    assert_eq!(ended.code, Some(0), "{ended}");
    assert_eq!(hall.agree(&ended, "undisturbed"), (hall.count, hall.count));
    println!("all of it took {:.1} s", began.elapsed().as_secs_f64());
}

#[test]
#[ignore = "needs zenohd: .ci/zenoh runs it"]
fn all_or_no_robots_start_if_a_router_is_killed_during_script_transfer() {
    for after in [5, 60, 150] {
        let mut hall = Hall::of(stage_where("5s", "stop"));
        let ended = hall.prepare_without_router(after);
        let (moved, _) = hall.agree(&ended, &format!("killed {after} ms after the first request"));
        assert!(moved == 0 || moved == hall.count, "{moved} moved: {ended}");
    }
}

#[test]
#[ignore = "needs zenohd: .ci/zenoh runs it"]
fn router_killed_during_script_transfer_affects_at_most_its_own_robots() {
    for after in [5, 60, 150] {
        let mut hall = Hall::open("5s");
        let ended = hall.prepare_without_router(after);
        let what = format!("killed {after} ms after the first request, others play without");
        let (moved, whole) = hall.agree(&ended, &what);
        assert!(moved == whole && moved >= hall.count - hall.count / 2, "{moved} moved: {ended}");
    }
}

#[test]
#[ignore = "needs zenohd: .ci/zenoh runs it"]
fn router_restarted_within_the_lease_affects_nothing() {
    let mut hall = Hall::open("20s");
    let run = hall.run();
    stage::sleep_until(start(&hall.stage) + 1_000_000_000);
    hall.routers[1].kill();
    std::thread::sleep(Duration::from_millis(300));
    hall.routers[1].restart();
    let ended = run.ended_within(Duration::from_secs(180)).unwrap();
    hall.agree(&ended, "killed for 0.3 s while it played, under a lease of 20 s");
    assert_eq!(ended.code, Some(0), "{ended}");
}

#[test]
#[ignore = "needs zenohd: .ci/zenoh runs it"]
fn permanently_lost_router_ends_only_its_robots_at_their_lease_end() {
    let mut hall = Hall::open("1s");
    let run = hall.run();
    stage::sleep_until(start(&hall.stage) + 1_000_000_000);
    hall.routers[1].kill();
    let ended = run.ended_within(Duration::from_secs(180)).unwrap();
    hall.agree(&ended, "killed for good while it played, under a lease of 1 s");
    // The robots behind this router cannot confirm that they stopped.
    assert_eq!(ended.code, Some(4), "{ended}");
}
