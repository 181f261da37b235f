use super::*;

#[test]
fn thousands_of_seeds_of_faults_violate_nothing() {
    let seeds = std::env::var("DOWNBEAT_SEEDS").ok().and_then(|seeds| seeds.parse().ok()).unwrap_or(3_000);
    let mut violated = Vec::new();
    let mut mixed = 0;
    for seed in 0..seeds {
        let verdict = run(seed).verdict();
        mixed += verdict.starts.iter().filter(|starts| **starts == Starts::Mixed).count();
        violated.extend(verdict.violations.into_iter().map(|violation| (seed, violation)));
    }
    let first: Vec<_> =
        violated.iter().take(10).map(|(seed, violation)| format!("seed {seed}: {violation}")).collect();
    assert!(violated.is_empty(), "{} violations, {mixed} mixed in the window: {first:#?}", violated.len());
}

#[test]
fn a_seed_replays_exactly() {
    for seed in [3, 77, 1_234] {
        assert_eq!(trace(&run_verbosely(seed)), trace(&run_verbosely(seed)));
    }
}

#[test]
fn most_seeds_without_faults_come_to_their_end() {
    let clean = |drawn: &Drawn| {
        let honest = drawn.robots.iter().all(|robot| robot.lie.is_none());
        drawn.faults.is_empty()
            && drawn.disk.capacity.is_none()
            && honest
            && drawn.network == Network::Stream
            && drawn.tail == 0.0
    };
    let mut done = 0;
    let mut all = 0;
    // What cannot be sent in time, because a device's queue is short and its scripts follow each other closely, is late.
    let playable = |drawn: &Drawn| {
        let slowest = drawn.robots.iter().map(|robot| robot.slow).max().unwrap_or_default();
        let sending = drawn.delay.1 * 3 + slowest * 2 + Span::from_millis(120);
        let queue = |id: &urrcp::RobotId, device: &urrcp::DeviceId| {
            let robot = drawn.robots.iter().find(|robot| robot.block.id == *id)?;
            Some(robot.block.device(device.as_str())?.script_queue)
        };
        let tightest = downbeat_scripts::tightest_refill(&drawn.choreography, queue, sending);
        tightest.is_none_or(|refill| refill.time >= sending)
    };
    for seed in (0..2_000).filter(|seed| clean(&draw(*seed)) && playable(&draw(*seed))) {
        let ran = run(seed);
        all += 1;
        let outcome = ran.report.map(|report| report.outcome);
        done += usize::from(outcome == Some(crate::report::Outcome::Done));
    }
    assert!(all > 30 && done * 10 >= all * 9, "{done} of {all} done");
}

#[test]
fn seeds_that_found_something_once_find_nothing_any_more() {
    for seed in [300, 876, 1_440, 2_117, 3_695, 9_687, 14_909, 51_973, 81_677, 229_698, 1_295_971] {
        assert_eq!(run(seed).verdict().violations, [], "seed {seed}");
    }
}

#[test]
fn the_journal_of_some_seeds_is_lost_and_the_mission_is_stopped() {
    let full = (0..2_000).filter(|seed| draw(*seed).disk.capacity.is_some());
    let lost = |ran: &Ran| {
        let told =
            |happened: &Happened| matches!(happened, Happened::Told(text) if text.contains("journal_lost"));
        ran.history.iter().any(|(_, happened)| told(happened))
    };
    let lost: Vec<Ran> = full.map(run_verbosely).filter(lost).collect();
    assert!(lost.len() > 3, "{}", lost.len());
    for ran in lost {
        assert_eq!(ran.verdict().violations, []);
        let done = ran.report.is_some_and(|report| report.outcome == crate::report::Outcome::Done);
        assert!(!done, "seed {}", ran.drawn.seed);
    }
}
