use super::check::LEAD_LEAST;
use super::*;
use downbeat_mission::report::Outcome;
use downbeat_mission::{ActCourse, ActFate, Failure, FailureKind, Progress, TransferReport};

#[test]
fn thousands_of_seeds_with_faults_violate_no_invariant() {
    let seeds = std::env::var("DOWNBEAT_SEEDS").ok().and_then(|seeds| seeds.parse().ok()).unwrap_or(1_000);
    let mut violated = Vec::new();
    let mut mixed = 0;
    for seed in 0..seeds {
        // Ten violations are enough to show a general fault.
        if violated.len() >= 10 {
            break;
        }
        let verdict = judge(&run(seed));
        mixed += verdict.acts.iter().filter(|act| act.starts == Starts::Mixed).count();
        violated.extend(verdict.violations.into_iter().map(|violation| (seed, violation)));
    }
    let first: Vec<_> =
        violated.iter().take(10).map(|(seed, violation)| format!("seed {seed}: {violation}")).collect();
    assert!(violated.is_empty(), "{} violations, {mixed} mixed in the window: {first:#?}", violated.len());
}

#[test]
fn same_seed_replays_exactly() {
    // With the last three seeds, the mission repeatedly queries robots for the resting positions of their devices.
    for seed in [3, 77, 1_234, 171, 237, 246] {
        assert_eq!(trace(&run_verbosely(seed)), trace(&run_verbosely(seed)));
    }
}

#[test]
fn seeds_without_faults_complete_or_are_refused_for_their_links() {
    let clean = |drawn: &Drawn| {
        let honest = drawn.robots.iter().all(|robot| robot.lie.is_none());
        drawn.faults.is_empty()
            && drawn.disk.capacity.is_none()
            && honest
            && drawn.network == Network::Stream
            && drawn.tail == 0.0
    };
    let (mut done, mut refused) = (0, 0);
    // A mission without faults may fail because of uncertain clocks, scripts that cannot be sent in time, or wrong start positions.
    let unplayable = |failure: &Failure| {
        use FailureKind::{Clock, NoTimeToSend, Position};
        matches!(failure.kind, Clock { .. } | NoTimeToSend { .. } | Position { .. })
    };
    let timed_out = |act: &ActCourse| matches!(act.fate, ActFate::TimedOut { .. });
    let deserted = |act: &ActCourse| act.fate == ActFate::NobodyLeft;
    for seed in (0..2_000).filter(|seed| clean(&draw(*seed))) {
        let ran = run(seed);
        for (_, record) in &ran.records {
            let downbeat_mission::Record::Prepared(promise) = record else { continue };
            let lead = promise.start - promise.timestamp;
            assert!(lead >= LEAD_LEAST, "seed {seed}: {lead}, and shorter ones would not be compared");
        }
        let mute = ran.drawn.robots.iter().any(|robot| !robot.block.reports && !robot.block.inquiry);
        let Some(report) = ran.report else { panic!("seed {seed} has no report") };
        assert!(report.preflight.is_some(), "seed {seed}: its robots were greeted");
        match report.outcome {
            Outcome::Done => done += 1,
            Outcome::Unknown if mute => done += 1,
            Outcome::NotStarted | Outcome::DoneWithout if report.failures.iter().all(unplayable) => {
                refused += 1;
            }
            // Another act may follow the act that was not started.
            Outcome::Failed if !report.failures.is_empty() && report.failures.iter().all(unplayable) => {
                refused += 1;
            }
            Outcome::DoneWithout
                if report.failures.iter().all(|f| matches!(f.kind, FailureKind::NeverJoined { .. })) =>
            {
                done += 1;
            }
            // The mission meets or refuses the leads and leases of the scenario.
            Outcome::LeadTooShort { .. } | Outcome::LeaseTooShort { .. } => refused += 1,
            Outcome::Failed | Outcome::DoneSkipping { .. }
                if report.failures.is_empty()
                    && report.course.iter().any(|act| timed_out(act) || deserted(act)) =>
            {
                done += 1;
            }
            outcome => panic!("seed {seed}: {outcome}, {:?}", report.failures),
        }
    }
    assert!(done > 30 && refused * 5 < done, "{done} done, {refused} refused");
}

#[test]
fn seeds_of_past_violations_no_longer_violate_anything() {
    let seeds = [
        472, 4_923, 9_343, 10_660, 11_569, 11_967, 12_824, 12_996, 19_295, 21_600, 22_396, 28_290, 29_437,
        37_047, 41_459, 47_015, 49_981, 58_170, 62_670, 75_772, 80_659, 84_131, 101_316, 104_663, 107_576,
        81_395, 95_135, 109_425, 205_918, 220_900, 234_241, 247_153, 257_709, 4_441, 65_227, 124_268,
        130_977, 145_293, 157_825, 199_283, 244_220, 274_129, 346_783, 378_963, 381_866, 383_180, 419_728,
        419_769, 431_484, 437_149, 437_770, 449_978, 457_458, 493_607, 503_605, 519_894, 534_796, 536_266,
        537_591, 539_691, 550_634, 561_484, 563_502, 567_101, 583_634, 586_958, 610_322, 615_371, 619_182,
        627_918, 628_569, 638_748, 653_701, 654_748, 660_431, 664_869, 681_161, 699_448, 748_806, 755_839,
        799_394, 815_334, 722_592, 942_741, 949_252, 25_400, 144_166, 198_152, 268_517, 272_188, 278_477,
        291_907, 395_152, 416_264, 447_814, 471_206, 479_785, 502_334, 619_713, 675_668, 684_902, 844_450,
        862_374, 38_413, 251, 377, 6_847, 354_054, 412_670, 649_861, 673_968, 932_655, 1_043_431, 1_116_819,
        1_196_860, 1_197_036, 1_132_889, 1_133_795, 1_163_508, 2_030_834, 2_058_854, 2_162_016, 2_235_369,
        2_272_235, 2_296_505, 3_010_363, 3_087_999, 3_096_047, 3_129_620, 3_138_542, 315_662, 616_662,
        958_762, 5_026_775, 5_023_426, 5_165_425, 6_194_923, 6_134_414, 6_116_344, 6_193_752, 6_287_374,
        7_033_286, 7_118_962, 278_869, 31_707, 53_934, 99_086, 125_101, 125_893, 412_815, 224_368, 287_213,
        665_535, 477_736, 439_359, 535_003, 392_793, 701_514, 248_072, 129_771, 182_581, 342_539, 769_237,
        103_426, 483_244, 550_592, 557_262, 566_829, 952_076, 980_089, 280_401, 1_242_344, 551_924, 9_210,
        17_792, 1_225_899, 1_298_823, 3_190, 140, 101_590, 67_638, 171_940, 10_529,
    ];
    for seed in seeds {
        assert_eq!(judge(&run(seed)).violations, [], "seed {seed}");
    }
}

#[test]
fn fault_free_run_cut_at_last_compared_act_makes_the_same_promises() {
    let mut compared = 0;
    for ran in (0..400).map(run).filter(|ran| !ran.drawn.faults.is_empty()) {
        let Some(last) = ran.last_to_compare() else { continue };
        let promises = |ran: &Ran| -> Vec<_> {
            let up_to = |record: &downbeat_mission::Record| match record {
                downbeat_mission::Record::Prepared(promise) => Some(promise.clone()),
                _ => None,
            };
            let promises = ran.records.iter().filter_map(|(_, record)| up_to(record));
            promises.filter(|promise| promise.number <= last).collect()
        };
        let undisturbed = ran.drawn.clone().without_faults();
        let whole = promises(&play(undisturbed.clone()));
        assert_eq!(promises(&world::play_up_to(undisturbed, last)), whole, "seed {}", ran.drawn.seed);
        compared += 1;
    }
    assert!(compared > 10, "{compared}");
}

#[test]
fn some_seeds_lose_the_journal_and_stop_the_mission() {
    let full = (0..2_000).filter(|seed| draw(*seed).disk.capacity.is_some());
    let lost = |ran: &Ran| {
        let lost = |progress: &Progress| matches!(progress, Progress::JournalLost { .. });
        let told = |happened: &Happened| matches!(happened, Happened::Told(progress) if lost(progress));
        ran.history.iter().any(|(_, happened)| told(happened))
    };
    let lost: Vec<Ran> = full.map(run_verbosely).filter(lost).collect();
    assert!(lost.len() > 3, "{}", lost.len());
    for ran in lost {
        assert_eq!(ran.verdict().violations, []);
        let done = ran.report.is_some_and(|report| report.outcome == Outcome::Done);
        assert!(!done, "seed {}", ran.drawn.seed);
    }
}

#[test]
fn stalled_disk_ends_the_mission_before_any_movement() {
    let seeds: Vec<u64> = (0..100).filter(|seed| draw(*seed).faults.is_empty()).collect();
    for seed in &seeds {
        let mut drawn = draw(*seed);
        drawn.disk = DrawnDisk { sync: Span::from_millis(600_000), capacity: None, loses_power: false };
        let ran = world::play(drawn, world::HistoryDetail::Trace);
        assert_eq!(ran.verdict().violations, [], "seed {seed}");
        let outcome = ran.report.map(|report| report.outcome);
        let refused = matches!(outcome, Some(Outcome::JournalLost { .. } | Outcome::NotStarted));
        assert!(refused, "seed {seed}: {outcome:?}");
        assert!(ran.logs.iter().flatten().all(|entry| entry.request_id.is_none()), "seed {seed}");
    }
    assert!(seeds.len() > 10, "{}", seeds.len());
}

#[test]
fn unnamed_stop_confirmation_ends_no_script_that_has_not_begun() {
    let unnamed = |drawn: &Drawn| drawn.robots.iter().any(|robot| robot.names == Names::LeftOut);
    let mut stopped = 0;
    for mut drawn in (0..400).map(draw).filter(unnamed) {
        let ready = world::play(Drawn { faults: Vec::new(), ..drawn.clone() }, world::HistoryDetail::Checks);
        let promise = ready.records.iter().find_map(|(_, record)| match record {
            downbeat_mission::Record::Prepared(promise) => Some(promise.start),
            _ => None,
        });
        let Some(start) = promise else { continue };
        let before = start - downbeat_rehearsal::dry_run::BEGIN - Span::from_millis(150);
        drawn.faults = vec![(before, Fault::Stop)];
        let seed = drawn.seed;
        assert_eq!(world::play(drawn, world::HistoryDetail::Checks).verdict().violations, [], "seed {seed}");
        stopped += 1;
    }
    assert!(stopped > 30, "{stopped}");
}

#[test]
fn robot_with_clock_ahead_within_tolerance_keeps_lease_until_commitment() {
    let steady = |drawn: &Drawn| drawn.network == Network::Stream && drawn.tail == 0.0;
    let mut played = 0;
    for mut drawn in (0..400).map(draw).filter(steady) {
        drawn.robots.iter_mut().for_each(|robot| robot.lie = None);
        drawn.robots[0].clock = downbeat_mission::ClockMode::Ntp;
        drawn.robots[0].settings.clock_offset = Span::from_millis(35);
        drawn.choreography.acts.iter_mut().for_each(|act| act.plan.start_tolerance = Span::from_millis(60));
        let ran = world::play(drawn.without_faults(), world::HistoryDetail::Checks);
        let Some(report) = ran.report else { continue };
        let lost = |failure: &&Failure| failure.kind.to_string().contains("link_lost");
        let lost: Vec<_> = report.failures.iter().filter(lost).collect();
        assert!(lost.is_empty(), "seed {}: {lost:?}", ran.drawn.seed);
        played += usize::from(report.outcome == Outcome::Done);
    }
    assert!(played > 30, "{played}");
}

/// Adds faults to missions without faults whose first act is decided. `faults` receives the instants of the promise, the decision and the
/// start of that act, relative to the start of the mission.
fn with_faults_around_the_decision(
    seeds: std::ops::Range<u64>,
    faults: impl Fn([Span; 3]) -> Vec<(Span, Fault)>,
) -> impl Iterator<Item = Ran> {
    seeds.filter_map(move |seed| {
        let drawn = draw(seed).without_faults();
        let ready = run_calmly(drawn.clone());
        let promise = ready.records.iter().find_map(|(at, record)| match record {
            downbeat_mission::Record::Prepared(promise) => Some([*at, promise.start]),
            _ => None,
        });
        let decided = ready.records.iter().find_map(|(at, record)| match record {
            downbeat_mission::Record::Decided { .. } => Some(*at),
            _ => None,
        });
        let ([promised, start], decided) = promise.zip(decided)?;
        let faults = faults([promised, decided, start].map(|at| at - downbeat_rehearsal::dry_run::BEGIN));
        Some(run_calmly(Drawn { faults, ..drawn }))
    })
}

fn run_calmly(drawn: Drawn) -> Ran {
    world::play(drawn, world::HistoryDetail::Checks)
}

#[test]
fn clock_set_forward_around_the_decision_starts_no_robot_alone() {
    let mut set = 0;
    for (part, far) in (0..8).flat_map(|part| [0.2, 0.5, 0.8].map(|far| (part, far))) {
        let faults = |[promised, _, start]: [Span; 3]| {
            let from = promised - Span::from_millis(60);
            let at = from + (start - from) / 8 * part;
            let by = Span::from_millis_f64((start - at).as_millis_f64() * far);
            vec![(at, Fault::ClockStep { robot: 0, by })]
        };
        for ran in with_faults_around_the_decision(0..60, faults) {
            assert_eq!(ran.verdict().violations, [], "seed {}, {:?}", ran.drawn.seed, ran.drawn.faults);
            set += 1;
        }
    }
    assert!(set > 500, "{set}");
}

#[test]
fn clock_set_forward_while_scheduler_is_down_starts_no_robot_alone() {
    let mut set = 0;
    for (resumed, far) in [10, 40].into_iter().flat_map(|resumed| [0.2, 0.5, 0.8].map(|far| (resumed, far))) {
        let faults = |[_, decided, start]: [Span; 3]| {
            let crash = decided + Span::from_millis(1);
            let by = Span::from_millis_f64((start - crash).as_millis_f64() * far);
            let resumed_after = Some(Span::from_millis(resumed));
            vec![
                (crash, Fault::SchedulerCrash { resumed_after }),
                (crash + Span::from_millis(5), Fault::ClockStep { robot: 0, by }),
            ]
        };
        for ran in with_faults_around_the_decision(0..200, faults) {
            assert_eq!(ran.verdict().violations, [], "seed {}, {:?}", ran.drawn.seed, ran.drawn.faults);
            set += 1;
        }
    }
    assert!(set > 500, "{set}");
}

#[test]
fn request_arriving_while_scheduler_stalls_starts_nothing() {
    let mut late = 0;
    for far in [0.5, 0.7, 0.8, 0.9, 0.97] {
        let faults = |[promised, decided, start]: [Span; 3]| {
            let lasts = Span::from_millis_f64((start - promised).as_millis_f64() * far);
            vec![
                (promised, Fault::Partition { robot: 0, lasts, breaks: false }),
                (decided, Fault::SchedulerPause { lasts: Span::from_millis(5_000) }),
            ]
        };
        for ran in with_faults_around_the_decision(0..160, faults) {
            assert_eq!(ran.verdict().violations, [], "seed {}, {:?}", ran.drawn.seed, ran.drawn.faults);
            late += 1;
        }
    }
    assert!(late > 400, "{late}");
}

#[test]
fn act_whose_robots_all_dropped_out_is_not_reported_as_played() {
    let mut left = 0;
    for mut drawn in (0..300).map(|seed| draw(seed).without_faults()) {
        for act in &mut drawn.choreography.acts {
            act.on_failure.default = downbeat_plan::OnFailure::Without;
            act.on_failure.robots.clear();
        }
        let ready = run_calmly(drawn.clone());
        let promise = ready.records.into_iter().find_map(|(_, record)| match record {
            downbeat_mission::Record::Prepared(promise) => Some(promise),
            _ => None,
        });
        let Some(promise) = promise else { continue };
        let plays = |robot: &DrawnRobot| promise.scripts.iter().any(|script| script.robot == robot.block.id);
        let players: Vec<usize> = (0..drawn.robots.len()).filter(|at| plays(&drawn.robots[*at])).collect();
        if players.len() == drawn.robots.len() {
            continue;
        }
        let at = promise.start - downbeat_rehearsal::dry_run::BEGIN + Span::from_millis(1);
        let dies = |robot: usize| (at, Fault::RobotCrash { robot, back_after: None, told: true });
        drawn.faults = players.into_iter().map(dies).collect();
        let ran = run_calmly(drawn);
        assert_eq!(ran.verdict().violations, [], "seed {}", ran.drawn.seed);
        let fate = |report: downbeat_mission::report::Report| report.course[promise.act.get()].fate.clone();
        left += usize::from(ran.report.map(fate) == Some(ActFate::Stopped));
    }
    assert!(left > 20, "{left}");
}

#[test]
fn after_a_stop_robots_move_together_or_the_reason_is_reported() {
    let schema = serde_json::from_str(downbeat_mission::report::SCHEMA).unwrap();
    let schema = jsonschema::validator_for(&schema).unwrap();
    let (mut arrived, mut on_the_way, mut stayed) = ([0; 2], [0; 2], [0; 2]);
    for seed in 0..2_000 {
        let Some(report) = run(seed).report else { continue };
        if let Err(error) = schema.validate(&serde_json::to_value(&report).unwrap()) {
            panic!("seed {seed}: {error} at {}", error.instance_path);
        }
        for (to, transfer) in [&report.home, &report.approach].into_iter().enumerate() {
            match transfer {
                Some(TransferReport::Planned { act, .. }) => {
                    let played = report.course.iter().any(|course| course.act == *act && course.played == 1);
                    *if played { &mut arrived[to] } else { &mut on_the_way[to] } += 1;
                }
                Some(TransferReport::NotPlanned { .. }) => stayed[to] += 1,
                Some(TransferReport::NothingToMove) | None => {}
            }
        }
    }
    let [home, approach] = arrived;
    let seldom = (on_the_way, stayed);
    assert!(home >= 10 && approach >= 3 && on_the_way[0] >= 1 && stayed[0] >= 5, "{arrived:?}, {seldom:?}");
}
