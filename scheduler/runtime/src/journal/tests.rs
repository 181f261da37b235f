use urrcp::Span;

use super::simulated::SimulatedDisk;
use super::*;
use downbeat_mission::Cause;
use downbeat_mission::report::Outcome;
use downbeat_mission::{
    ActFate, ActFlaws, ActIndex, ActNumber, ActOver, Failure, FailureKind, Fate, Kept, OutOfTolerance,
    Progressed, Promise, PromisedScript, Rest, StepsLate, Stopping, Torn, line,
};

fn opened() -> Opened {
    Opened {
        session: SessionId::new("s").unwrap(),
        key: serde_json::from_str("\"000102030405060708090a0b0c0d0e0f\"").unwrap(),
        pid: 1,
        name: Some("show".to_owned()),
        scenario: "s.yaml".into(),
        fleet: "fleet.yaml".into(),
        folder: Some("/show".into()),
        project: None,
        asked: OperatorChoices { speed: Some(0.5), ..OperatorChoices::default() },
        plan_hash: Some(urrcp::Command::ReadSensor.content_hash()),
        fixed: FixedStarts::default(),
        greeting: Greeting::Full,
        clock_offset: Span::from_millis(3),
        keys: OpenedKeys::default(),
        robots: vec![OpenedRobot {
            robot: RobotId::new("arm").unwrap(),
            own_id: Some(RobotId::new("UR5-1").unwrap()),
            address: "tcp://a:1".into(),
            init: None,
            limits: std::collections::BTreeMap::new(),
        }],
    }
}

fn at(millis: i64) -> Timestamp<Server> {
    Timestamp::from_nanos(millis * 1_000_000)
}

fn prepared(number: u32) -> Record {
    Record::Prepared(Promise {
        number: ActNumber::new(number),
        act: ActIndex::new(0),
        timestamp: at(10),
        start: at(500),
        lease: Span::from_millis(240),
        prepared_again: 0,
        scripts: vec![],
    })
}

fn written(folder: &Path) -> PathBuf {
    let mut journal = Journal::open(folder).unwrap();
    journal.begin(at(1), &opened()).unwrap();
    for record in [
        prepared(0),
        Record::Decided { number: ActNumber::new(0), unnamed: vec![], doubt: Span::ZERO },
        prepared(1),
    ] {
        journal.append(at(2), &record).unwrap();
    }
    assert_eq!(journal.sync(), Ok(2));
    folder.join("journal")
}

#[test]
fn mission_has_begun_once_its_fleet_is_checked() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    assert!(!has_begun(folder.path()));
    let mut bytes = std::fs::read(&path).unwrap();
    bytes.extend(line(&serde_json::json!({"at": at(9), "record": "checked"})).unwrap());
    std::fs::write(&path, bytes).unwrap();
    assert!(has_begun(folder.path()));
}

#[test]
fn promises_are_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let Contents { opened: first, kept, .. } = read(&written(folder.path())).unwrap();
    assert_eq!(first, opened());
    let promises: Vec<_> =
        kept.promises.iter().map(|(promise, progressed)| (promise.number.get(), *progressed)).collect();
    assert_eq!(promises, [(0, Progressed::Decided), (1, Progressed::Prepared)]);
    assert_eq!((kept.outcome, kept.torn), (None, None));
}

#[test]
fn ended_mission_is_recognized() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let mut journal = Journal::open(folder.path()).unwrap();
    journal.append(at(3), &Record::Ended { outcome: Outcome::Done }).unwrap();
    assert_eq!(read(&path).unwrap().kept.outcome, Some(Outcome::Done));
}

fn promised_script(robot: &str, device: &str, running: Option<urrcp::Millis>) -> PromisedScript {
    PromisedScript {
        robot: RobotId::new(robot).unwrap(),
        device: device.parse().unwrap(),
        request_id: format!("s/{device}").parse().unwrap(),
        content_hash: urrcp::Command::ReadSensor.content_hash(),
        shift: Span::from_millis(40),
        start: urrcp::Millis::default(),
        duration: Span::from_millis(500),
        running,
    }
}

fn promise(number: u32, scripts: Vec<PromisedScript>) -> Record {
    match prepared(number) {
        Record::Prepared(promise) => Record::Prepared(Promise { scripts, ..promise }),
        other => other,
    }
}

#[test]
fn devices_clock_shift_and_leases_left_on_robots_are_read_back() {
    let lease = urrcp::Millis::new(2_000.0).ok();
    let folder = tempfile::tempdir().unwrap();
    let mut journal = Journal::open(folder.path()).unwrap();
    journal.begin(at(1), &opened()).unwrap();
    for record in [
        promise(0, vec![promised_script("arm", "a", lease)]),
        promise(1, vec![promised_script("arm", "b", None)]),
    ] {
        journal.append(at(2), &record).unwrap();
    }
    let left = read(&folder.path().join("journal")).unwrap().kept.left();
    let on = &left.robots[&RobotId::new("arm").unwrap()];
    assert_eq!(on.devices.iter().map(|device| device.as_str()).collect::<Vec<_>>(), ["a", "b"]);
    assert_eq!((on.shift, on.leases.as_slice()), (Span::from_millis(40), [lease, None].as_slice()));
}

#[test]
fn leases_are_not_renewed_after_first_stop_unless_new_act_is_promised() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let renewed_until = || read(&path).unwrap().kept.left().renewed_until;
    let append = |millis, record| Journal::open(folder.path()).unwrap().append(at(millis), &record).unwrap();
    let stopping = || Record::Stopping { outcome: Outcome::Stopped, rest: Rest::InPlace, by: None };
    assert_eq!(renewed_until(), None);
    append(5, stopping());
    append(9, stopping());
    assert_eq!(renewed_until(), Some(at(5)));
    append(12, prepared(2));
    assert_eq!(renewed_until(), None);
    append(15, stopping());
    assert_eq!(renewed_until(), Some(at(15)));
}

#[test]
fn dropping_a_robot_clears_its_stop_confirmation() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let robot = || RobotId::new("arm").unwrap();
    let append = |record| Journal::open(folder.path()).unwrap().append(at(5), &record).unwrap();
    assert_eq!(read(&path).unwrap().kept.stopped, []);
    append(Record::StopConfirmed { robot: robot() });
    assert_eq!(read(&path).unwrap().kept.stopped, [robot()]);
    append(Record::Dropped { robot: robot() });
    let kept = read(&path).unwrap().kept;
    assert_eq!((kept.stopped, kept.dropped), (vec![], vec![robot()]));
}

/// Returns the journal line for the end of act 0, with only those parts of the act's report that a reader of the journal needs.
fn ended_line(fate: ActFate, flaws: ActFlaws, again: bool) -> Vec<u8> {
    #[derive(serde::Serialize)]
    struct Ended {
        record: &'static str,
        report: serde_json::Value,
        #[serde(flatten)]
        flaws: ActFlaws,
        #[serde(flatten)]
        over: ActOver,
        again: bool,
    }
    let (report, over) = (serde_json::json!({"number": 0}), ActOver { act: ActIndex::new(0), fate });
    dated_line(at(9), &Ended { record: "act_ended", report, flaws, over, again }).unwrap()
}

#[test]
fn flaws_of_ended_acts_are_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let mut bytes = std::fs::read(&path).unwrap();
    let spread = Span::from_micros(12_500);
    let expected = ActFlaws {
        unaccounted: vec![RobotId::new("arm").unwrap()],
        out_of_tolerance: Some(OutOfTolerance { spread, tolerance: Span::from_millis(10) }),
        steps_late: Some(StepsLate { late: Span::from_millis(225), tolerance: Span::from_millis(10) }),
    };
    for flaws in [ActFlaws::default(), expected.clone()] {
        bytes.extend(ended_line(ActFate::Played, flaws, false));
    }
    std::fs::write(&path, bytes).unwrap();
    let kept = read(&path).unwrap().kept;
    assert_eq!((kept.ended_acts, kept.flaws, kept.torn), (2, vec![expected], None));
}

#[test]
fn fates_of_played_and_skipped_acts_are_read_back_after_a_crash() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let mut bytes = std::fs::read(&path).unwrap();
    let timed_out = ActFate::TimedOut { awaited: "the operator's go".into(), within: Span::from_millis(5) };
    let skipped = ActOver { act: ActIndex::new(1), fate: timed_out };
    bytes.extend(ended_line(ActFate::Played, ActFlaws::default(), false));
    bytes.extend(dated_line(at(10), &Record::ActSkipped(skipped.clone())).unwrap());
    std::fs::write(&path, bytes).unwrap();
    assert_eq!(
        read(&path).unwrap().kept.course,
        [ActOver { act: ActIndex::new(0), fate: ActFate::Played }, skipped]
    );
}

fn life(folder: &Path) -> MissionState {
    Found::look_at(folder).unwrap().unwrap().life
}

fn end(folder: &Path) {
    let mut journal = Journal::open(folder).unwrap();
    journal.append(at(3), &Record::Ended { outcome: Outcome::Done }).unwrap();
}

#[test]
fn mission_state_is_read_from_its_lock_and_last_journal_lines() {
    let folder = tempfile::tempdir().unwrap();
    written(folder.path());
    assert_eq!(life(folder.path()), MissionState::CutOff);
    let held = Journal::open(folder.path()).unwrap();
    assert_eq!(life(folder.path()), MissionState::Running);
    assert!(Journal::open(folder.path()).is_err(), "looking does not break the lock");
    drop(held);
    end(folder.path());
    assert_eq!(life(folder.path()), MissionState::Ended);
}

#[test]
fn lock_of_another_kind_does_not_block_opening_a_journal() {
    let folder = tempfile::tempdir().unwrap();
    let foreign = std::fs::File::open(written(folder.path())).unwrap();
    foreign.lock().unwrap();
    assert_eq!(life(folder.path()), MissionState::CutOff);
    Journal::open(folder.path()).unwrap();
}

#[test]
fn journal_with_a_damaged_first_line_is_named() {
    let state = tempfile::tempdir().unwrap();
    let path = written(&state.path().join("a"));
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[15] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    let missions = Missions::of(state.path()).unwrap();
    assert_eq!((missions.found.len(), missions.damaged), (0, vec![path.clone()]));
    // The first line is cut off, so the mission had sent nothing.
    std::fs::write(&path, &bytes[..40]).unwrap();
    assert!(Missions::of(state.path()).unwrap().damaged.is_empty());
}

/// Creates a mission whose journal is `megabytes` MiB long, most of it a hole in the file. If `ends`, the journal states that the mission
/// has ended.
fn mission(state: &Path, number: i64, megabytes: u64, ends: bool) {
    let folder = state.join(format!("m{number}"));
    let mut journal = Journal::open(&folder).unwrap();
    journal.begin(at(number), &opened()).unwrap();
    drop(journal);
    if megabytes > 0 {
        let mut file = std::fs::OpenOptions::new().append(true).open(folder.join("journal")).unwrap();
        file.set_len(megabytes * 1024 * 1024).unwrap();
        std::io::Write::write_all(&mut file, b"\n").unwrap();
    }
    if ends {
        let record = Record::Ended { outcome: Outcome::Done };
        let line = dated_line(at(number), &record).unwrap();
        let mut file = std::fs::OpenOptions::new().append(true).open(folder.join("journal")).unwrap();
        std::io::Write::write_all(&mut file, &line).unwrap();
    }
}

#[test]
fn missing_state_folder_contains_no_missions() {
    let state = tempfile::tempdir().unwrap();
    let missions = Missions::of(&state.path().join("none")).unwrap();
    assert_eq!((missions.found.len(), missions.unread()), (0, 0));
    let file = state.path().join("file");
    std::fs::write(&file, "text").unwrap();
    assert!(Missions::of(&file).is_err());
}

#[test]
fn damaged_and_refused_mission_folders_are_counted_as_unread() {
    let state = tempfile::tempdir().unwrap();
    for number in 1..=3 {
        mission(state.path(), number, 0, true);
    }
    let missions = Missions::of(state.path()).unwrap();
    assert_eq!((missions.found.len(), missions.unread()), (3, 0));
    for folder in [&missions.found[0].folder, &missions.found[1].folder] {
        let path = folder.join("journal");
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[3] ^= 1;
        std::fs::write(path, bytes).unwrap();
    }
    std::os::unix::fs::symlink(&missions.found[2].folder, state.path().join("elsewhere")).unwrap();
    let missions = Missions::of(state.path()).unwrap();
    assert_eq!((missions.found.len(), missions.damaged.len(), missions.refused.len()), (1, 2, 1));
    assert_eq!(missions.unread(), 3);
}

#[test]
fn only_finished_journals_are_limited_in_number_and_size() {
    let state = tempfile::tempdir().unwrap();
    mission(state.path(), 0, 0, false);
    (1..=60).for_each(|number| mission(state.path(), number, 0, true));
    forget_old(state.path());
    let left = |number: i64| state.path().join(format!("m{number}")).exists();
    assert!(left(0) && !left(10) && left(11) && left(60));
    mission(state.path(), 61, 40, true);
    mission(state.path(), 62, 40, true);
    forget_old(state.path());
    assert!(left(0) && !left(60) && !left(61) && left(62), "the newest is kept however long it is");
}

#[test]
fn truncated_or_changed_line_ends_the_trusted_part_of_a_journal() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let bytes = std::fs::read(&path).unwrap();
    let lines: Vec<usize> = bytes.iter().enumerate().filter(|(_, b)| **b == b'\n').map(|(i, _)| i).collect();
    for cut in lines[0] + 1..bytes.len() {
        std::fs::write(&path, &bytes[..cut]).unwrap();
        let whole = lines.iter().filter(|end| **end < cut).count();
        let kept = read(&path).unwrap().kept;
        assert_eq!(kept.torn.is_some(), !lines.iter().any(|end| end + 1 == cut), "cut at {cut}");
        assert_eq!(kept.promises.len(), [0, 0, 1, 1, 2][whole]);
    }
    let mut changed = bytes;
    changed[lines[1] + 15] ^= 1;
    std::fs::write(&path, &changed).unwrap();
    let kept = read(&path).unwrap().kept;
    let bytes = changed.len() - lines[1] - 1;
    assert_eq!(kept.torn, Some(Torn { line: 3, bytes, whole_after: 1 }));
    assert_eq!(kept.fate(), Fate::Withdraw("its journal is damaged"));
}

#[test]
fn robots_named_only_after_journal_damage_are_withdrawn() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("journal");
    let mut journal = Journal::open(folder.path()).unwrap();
    journal.begin(at(1), &opened()).unwrap();
    let scripts = [("arm", "a"), ("lamp", "b"), ("wheel", "c")];
    for (number, (robot, device)) in (0..).zip(scripts) {
        journal.append(at(2), &promise(number, vec![promised_script(robot, device, None)])).unwrap();
    }
    let mut bytes = std::fs::read(&path).unwrap();
    let second = bytes.iter().enumerate().filter(|(_, byte)| **byte == b'\n').nth(1).unwrap().0;
    bytes[second + 15] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    let kept = read(&path).unwrap().kept;
    assert_eq!(kept.fate(), Fate::Withdraw("its journal is damaged"));
    let left = kept.left();
    let robots: Vec<_> = left.robots.iter().map(|(robot, on)| (robot.as_str(), on.devices.len())).collect();
    assert_eq!(robots, [("arm", 1), ("wheel", 1)], "the damaged line alone is unknown");
}

#[test]
fn journal_has_one_writer() {
    let folder = tempfile::tempdir().unwrap();
    let _held = Journal::open(folder.path()).unwrap();
    assert!(Journal::open(folder.path()).is_err());
}

#[test]
fn journal_truncated_anywhere_takes_further_records_and_reads_all_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let bytes = std::fs::read(&path).unwrap();
    let lines: Vec<usize> = bytes.iter().enumerate().filter(|(_, b)| **b == b'\n').map(|(i, _)| i).collect();
    for cut in lines[0] + 1..=bytes.len() {
        std::fs::write(&path, &bytes[..cut]).unwrap();
        let mut journal = Journal::open(folder.path()).unwrap();
        for record in [
            prepared(7),
            Record::Decided { number: ActNumber::new(7), unnamed: vec![], doubt: Span::ZERO },
            prepared(8),
        ] {
            journal.append(at(9), &record).unwrap();
        }
        drop(journal);
        let kept = read(&path).unwrap().kept;
        let whole = lines.iter().filter(|end| **end < cut).count();
        let before: &[_] = [
            &[][..],
            &[],
            &[(0, Progressed::Prepared)],
            &[(0, Progressed::Decided)],
            &[(0, Progressed::Decided), (1, Progressed::Prepared)],
        ][whole];
        let promises: Vec<_> =
            kept.promises.iter().map(|(promise, progressed)| (promise.number.get(), *progressed)).collect();
        assert_eq!(
            promises,
            [before, &[(7, Progressed::Decided), (8, Progressed::Prepared)]].concat(),
            "cut at {cut}"
        );
        assert_eq!(kept.torn, None, "cut at {cut}");
    }
}

#[test]
fn journal_truncated_in_its_first_line_can_begin_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let bytes = std::fs::read(&path).unwrap();
    let first = bytes.iter().position(|byte| *byte == b'\n').unwrap();
    for cut in 0..=first {
        std::fs::write(&path, &bytes[..cut]).unwrap();
        let mut journal = Journal::open(folder.path()).unwrap();
        assert!(journal.contents().is_none(), "cut at {cut}");
        journal.begin(at(1), &opened()).unwrap();
        journal.append(at(2), &prepared(3)).unwrap();
        drop(journal);
        assert_eq!(read(&path).unwrap().kept.promises.len(), 1, "cut at {cut}");
    }
}

fn on(disk: SimulatedDisk) -> Journal<SimulatedDisk> {
    Journal::on(disk, "journal".into()).unwrap()
}

#[test]
fn synced_records_survive_power_loss_wherever_unsynced_data_is_torn() {
    let mut survive = 0;
    loop {
        let mut journal = on(SimulatedDisk::default());
        journal.begin(at(1), &opened()).unwrap();
        journal.append(at(2), &prepared(0)).unwrap();
        assert_eq!(journal.sync(), Ok(1));
        journal
            .append(at(2), &Record::Decided { number: ActNumber::new(0), unnamed: vec![], doubt: Span::ZERO })
            .unwrap();
        let mut disk = journal.into_disk();
        let at_risk = disk.at_risk();
        disk.lose_power(survive);
        let mut journal = on(disk);
        let kept = journal.contents().unwrap().kept.clone();
        assert_eq!(
            kept.promises[0].1 == Progressed::Decided,
            survive == at_risk,
            "{survive} of {at_risk} bytes"
        );
        assert_eq!(kept.torn.is_some(), survive > 0 && survive < at_risk);
        journal.append(at(3), &Record::Ended { outcome: Outcome::Stopped }).unwrap();
        let again = on(journal.into_disk());
        assert_eq!(again.contents().unwrap().kept.outcome, Some(Outcome::Stopped));
        if survive == at_risk {
            return;
        }
        survive += 1;
    }
}

#[test]
fn full_disk_error_is_permanent_and_leaves_a_usable_journal() {
    let mut whole = on(SimulatedDisk::default());
    whole.begin(at(1), &opened()).unwrap();
    let begun = whole.into_disk().bytes().len();
    for room in 0..600 {
        let mut journal = on(SimulatedDisk::with_capacity(Some(begun + room)));
        journal.begin(at(1), &opened()).unwrap();
        let mut taken = 0;
        while journal.append(at(2), &prepared(taken)).is_ok() {
            taken += 1;
        }
        assert!(journal.sync().is_err() && journal.append(at(2), &prepared(9)).is_err());
        let mut disk = journal.into_disk();
        disk.make_room();
        let mut journal = on(disk);
        assert_eq!(journal.contents().unwrap().kept.promises.len(), taken as usize, "room {room}");
        journal.append(at(2), &prepared(taken)).unwrap();
        assert_eq!(on(journal.into_disk()).contents().unwrap().kept.promises.len(), taken as usize + 1);
    }
}

#[tokio::test]
async fn writer_thread_reports_number_of_durable_records_on_disk() {
    let mut journal = on(SimulatedDisk::default());
    journal.begin(at(1), &opened()).unwrap();
    let mut writer = Writer::start(journal).unwrap();
    for record in [
        prepared(0),
        Record::Decided { number: ActNumber::new(0), unnamed: vec![], doubt: Span::ZERO },
        prepared(1),
    ] {
        writer.write(at(2), record).unwrap();
    }
    let mut recorded = 0;
    while recorded < 2 {
        let news = writer.next().await;
        recorded = if let News::Recorded(count) = news { count } else { panic!("{news:?}") };
    }
    let journal = writer.finish().await.unwrap();
    assert_eq!(on(journal.into_disk()).contents().unwrap().kept.promises.len(), 2);
}

#[tokio::test]
async fn writer_thread_reports_lost_journal() {
    let mut journal = on(SimulatedDisk::with_capacity(Some(1_000)));
    journal.begin(at(1), &opened()).unwrap();
    let mut writer = Writer::start(journal).unwrap();
    for number in 0..10 {
        writer.write(at(2), prepared(number)).unwrap();
    }
    while !matches!(writer.next().await, News::Lost(_)) {}
}

/// Creates a journal that promises an act in a mission's folder, and returns it with its contents.
fn promised(mission: &Path) -> (Journal, Vec<u8>) {
    let mut journal = Journal::open(mission).unwrap();
    journal.begin(at(1), &opened()).unwrap();
    journal.append(at(2), &prepared(0)).unwrap();
    assert_eq!(journal.sync(), Ok(1));
    let bytes = std::fs::read(mission.join("journal")).unwrap();
    (journal, bytes)
}

#[test]
fn removed_moved_or_truncated_journal_is_rewritten_under_its_lock() {
    let mode = |path: &Path| std::os::unix::fs::MetadataExt::mode(&path.metadata().unwrap()) & 0o7777;
    let removals: [fn(&Path); 4] = [
        |state| std::fs::remove_dir_all(state).unwrap(),
        |state| std::fs::remove_file(state.join("m/journal")).unwrap(),
        |state| std::fs::rename(state, state.with_extension("elsewhere")).unwrap(),
        // The journal is replaced by a copy of its beginning.
        |state| {
            let journal = state.join("m/journal");
            let bytes = std::fs::read(&journal).unwrap();
            std::fs::remove_file(&journal).unwrap();
            std::fs::write(&journal, &bytes[..bytes.len() / 2]).unwrap();
            std::fs::set_permissions(&journal, std::os::unix::fs::PermissionsExt::from_mode(0o600)).unwrap();
        },
    ];
    for remove in removals {
        let stage = tempfile::tempdir().unwrap();
        let (state, mission) = (stage.path().join("state"), stage.path().join("state/m"));
        let (mut journal, bytes) = promised(&mission);
        assert_eq!(journal.keep_name(), Ok(Name::Kept));
        remove(&state);
        assert_eq!(journal.keep_name(), Ok(Name::WrittenAgain));
        assert_eq!(journal.keep_name(), Ok(Name::Kept));
        assert_eq!(std::fs::read(mission.join("journal")).unwrap(), bytes);
        assert_eq!([mode(&state), mode(&mission), mode(&mission.join("journal"))], [0o700, 0o700, 0o600]);
        for place in [mission, state.with_extension("elsewhere").join("m")] {
            let found = Found::look_at(&place).ok().flatten();
            assert!(found.is_none_or(|found| found.life == MissionState::Running), "{}", place.display());
        }
        journal.append(at(3), &prepared(1)).unwrap();
        assert_eq!(journal.sync(), Ok(2));
        drop(journal);
        assert_eq!(read(&state.join("m/journal")).unwrap().kept.promises.len(), 2);
    }
}

#[test]
fn journal_that_cannot_be_rewritten_accepts_no_records_and_reports_why() {
    let stage = tempfile::tempdir().unwrap();
    let (state, mission) = (stage.path().join("state"), stage.path().join("state/m"));
    let (mut journal, _) = promised(&mission);
    std::fs::write(mission.join("other"), "another file").unwrap();
    std::fs::rename(mission.join("other"), mission.join("journal")).unwrap();
    let broken = journal.keep_name().unwrap_err();
    let reason = broken.to_string();
    assert!(
        reason.contains("removed or replaced") && reason.contains("another file is in its place"),
        "{reason}"
    );
    assert_eq!(std::fs::read(mission.join("journal")).unwrap(), b"another file");
    assert_eq!(journal.append(at(3), &prepared(1)), Err(broken));
    drop(journal);
    std::fs::remove_dir_all(&state).unwrap();
    let (mut journal, _) = promised(&mission);
    std::fs::remove_dir_all(&state).unwrap();
    std::fs::write(&state, "a file where the folder was").unwrap();
    assert!(journal.keep_name().unwrap_err().to_string().contains("cannot be restored"));
}

#[tokio::test]
async fn writer_thread_rewrites_removed_journal_before_reporting_records() {
    let stage = tempfile::tempdir().unwrap();
    let mission = stage.path().join("state/m");
    let (journal, _) = promised(&mission);
    let mut writer = Writer::start(journal).unwrap();
    assert_eq!(writer.next().await, News::Recorded(1));
    std::fs::remove_dir_all(stage.path().join("state")).unwrap();
    writer.write(at(3), prepared(1)).unwrap();
    assert_eq!(writer.next().await, News::WrittenAgain);
    while writer.next().await != News::Recorded(2) {}
    assert_eq!(read(&mission.join("journal")).unwrap().kept.promises.len(), 2);
    // The thread also notices the removal when no record arrives.
    std::fs::remove_dir_all(stage.path().join("state")).unwrap();
    assert_eq!(writer.next().await, News::WrittenAgain);
    assert_eq!(read(&mission.join("journal")).unwrap().kept.promises.len(), 2);
}

#[test]
fn journal_records_are_read_with_times_up_to_the_damage() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let mut bytes = std::fs::read(&path).unwrap();
    let told = |bytes: &[u8]| records(bytes, &path).unwrap();
    let whole = told(&bytes);
    let kinds = |records: &Records| -> Vec<(i64, String)> {
        let kind = |(at, record): &(Timestamp<Server>, Record)| {
            let written = serde_json::to_value(record).unwrap();
            (at.as_nanos() / 1_000_000, written["record"].as_str().unwrap().to_owned())
        };
        records.all.iter().map(kind).collect()
    };
    let expected = [(2, "prepared"), (2, "decided"), (2, "prepared")].map(|(at, kind)| (at, kind.to_owned()));
    assert_eq!((kinds(&whole), whole.torn, whole.opened), (expected.to_vec(), None, opened()));
    let last = bytes.len() - 2;
    bytes[last] ^= 1;
    let damaged = told(&bytes);
    assert_eq!(kinds(&damaged), expected[..2]);
    assert_eq!(damaged.torn.map(|torn| (torn.line, torn.whole_after)), Some((4, 0)));
    assert!(matches!(records(b"", &path), Err(Unreadable::NoBegin { .. })));
}

#[test]
fn journal_of_another_version_is_not_read() {
    let state = tempfile::tempdir().unwrap();
    let path = written(&state.path().join("a"));
    let text = std::fs::read_to_string(&path).unwrap();
    let (first, others) = text.split_once('\n').unwrap();
    let mut opened: serde_json::Value = serde_json::from_str(&first[9..]).unwrap();
    assert_eq!(opened["version"], VERSION);
    opened["version"] = (VERSION + 1).into();
    let first = String::from_utf8(line(&opened).unwrap()).unwrap();
    std::fs::write(&path, first + others).unwrap();
    let error = read(&path).unwrap_err().to_string();
    assert!(
        error.ends_with(
            "is a version 2 journal, expected version 1; open it with the version of Downbeat that wrote it"
        ),
        "{error}"
    );
    let missions = Missions::of(state.path()).unwrap();
    assert_eq!((missions.found.len(), missions.damaged), (0, vec![path]));
}

#[test]
fn interrupted_mission_can_be_resumed_if_all_its_promises_are_decided() {
    let decided =
        |number| Record::Decided { number: ActNumber::new(number), unnamed: vec![], doubt: Span::ZERO };
    let fate = |records: Vec<Record>| {
        let folder = tempfile::tempdir().unwrap();
        let mut journal = Journal::open(folder.path()).unwrap();
        journal.begin(at(1), &opened()).unwrap();
        records.iter().for_each(|record| journal.append(at(2), record).unwrap());
        assert!(journal.sync().is_ok());
        read(&folder.path().join("journal")).unwrap().kept.fate()
    };
    assert_eq!(fate(vec![]), Fate::Withdraw("no act was under way"));
    assert_eq!(fate(vec![prepared(0), decided(0)]), Fate::Resume);
    let undecided = Fate::Withdraw("an act was sent, but its start was not decided");
    assert_eq!(fate(vec![prepared(0), decided(0), prepared(1)]), undecided);
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let mut bytes = std::fs::read(&path).unwrap();
    // Cut off within the second promise, which had not been sent because it was not on the disk yet.
    bytes.truncate(bytes.len() - 5);
    std::fs::write(&path, bytes).unwrap();
    assert_eq!(read(&path).unwrap().kept.fate(), Fate::Resume);
    let stopping = Record::Stopping { outcome: Outcome::Stopped, rest: Rest::InPlace, by: None };
    assert_eq!(
        fate(vec![prepared(0), decided(0), stopping]),
        Fate::Withdraw("the mission was being stopped")
    );
}

/// Writes a journal with `records` and reads it back.
fn kept(records: &[Record]) -> Kept {
    let folder = tempfile::tempdir().unwrap();
    let mut journal = Journal::open(folder.path()).unwrap();
    journal.begin(at(1), &opened()).unwrap();
    records.iter().for_each(|record| journal.append(at(2), record).unwrap());
    assert!(journal.sync().is_ok());
    read(&folder.path().join("journal")).unwrap().kept
}

#[test]
fn withdrawn_mission_has_outcome_of_its_latest_stop_or_failed() {
    let ending = |records: &[Record]| kept(records).ending("no act was under way");
    let died = "the process of the mission died: no act was under way".to_owned();
    let failed = Cause { outcome: Outcome::Failed, reason: died.clone() };
    assert_eq!(ending(&[]), failed);
    let stopping = |outcome| Record::Stopping { outcome, rest: Rest::Home, by: None };
    assert_eq!(ending(&[stopping(Outcome::Failed)]), failed);
    let late = Outcome::DecisionLate { by: Span::from_millis(3) };
    assert_eq!(ending(&[stopping(late.clone())]), Cause { outcome: late.clone(), reason: died });
    let reason = "stopped by the operator".to_owned();
    let stopped = Cause { outcome: Outcome::Stopped, reason };
    assert_eq!(ending(&[stopping(late), stopping(Outcome::Stopped)]), stopped, "the latest stop counts");
    let kept = kept(&[stopping(Outcome::Stopped)]);
    assert_eq!(kept.stopping, Some(Stopping { outcome: Outcome::Stopped, rest: Rest::Home }));
}

#[test]
fn robots_may_have_moved_once_an_act_was_committed() {
    let moved = |records: &[Record]| kept(records).left().moved;
    let decided = || Record::Decided { number: ActNumber::new(0), unnamed: vec![], doubt: Span::ZERO };
    assert!(!moved(&[]));
    assert!(!moved(&[prepared(0), decided()]));
    assert!(moved(&[prepared(0), decided(), Record::Committed { number: ActNumber::new(0) }]));
    let skipped = |fate| Record::ActSkipped(ActOver { act: ActIndex::new(0), fate });
    for fate in [ActFate::Played, ActFate::Stopped, ActFate::Unknown] {
        assert!(moved(&[skipped(fate)]));
    }
    for fate in [ActFate::NobodyLeft, ActFate::Withdrawn] {
        assert!(!moved(&[skipped(fate)]));
    }
}

#[test]
fn failures_are_read_back() {
    let robot = || RobotId::new("arm").unwrap();
    let kind = FailureKind::Silent { awaited: "an answer".to_owned(), within: Span::from_millis(5) };
    let failure = Failure { robot: robot(), kind };
    let records = [Record::Failed(failure.clone()), Record::Dropped { robot: robot() }];
    let kept = kept(&records);
    assert_eq!((&kept.failures, &kept.dropped), (&vec![failure.clone()], &vec![robot()]));
    assert_eq!(kept.left().failures, [failure]);
}

#[test]
fn mission_with_act_withdrawn_and_prepared_again_can_be_resumed() {
    let folder = tempfile::tempdir().unwrap();
    let mut journal = Journal::open(folder.path()).unwrap();
    journal.begin(at(1), &opened()).unwrap();
    let decided =
        |number| Record::Decided { number: ActNumber::new(number), unnamed: vec![], doubt: Span::ZERO };
    let stopping =
        Record::Stopping { outcome: Outcome::DecisionLate { by: Span::ZERO }, rest: Rest::InPlace, by: None };
    for record in [prepared(0), decided(0), stopping] {
        journal.append(at(2), &record).unwrap();
    }
    assert!(journal.sync().is_ok());
    let path = folder.path().join("journal");
    let mut bytes = std::fs::read(&path).unwrap();
    let mut append = |line: Vec<u8>| {
        bytes.extend(line);
        std::fs::write(&path, &bytes).unwrap();
        read(&path).unwrap().kept
    };
    let withdrawn = append(ended_line(ActFate::Withdrawn, ActFlaws::default(), true));
    assert_eq!(withdrawn.fate(), Fate::Withdraw("no act was under way"));
    append(dated_line(at(4), &prepared(1)).unwrap());
    let again = append(dated_line(at(5), &decided(1)).unwrap());
    assert_eq!(again.fate(), Fate::Resume);
    assert_eq!((again.ended_acts, again.course.len()), (0, 0), "the attempt is no act that has ended");
}
