use urrcp::Span;

use super::simulated::SimulatedDisk;
use super::*;
use crate::mission::Promise;
use crate::report::Outcome;

fn opened() -> Opened {
    Opened {
        session: SessionId::new("s").unwrap(),
        pid: 1,
        scenario: "s.yaml".into(),
        fleet: "fleet.yaml".into(),
        asked: Asked { speed: Some(0.5), ..Asked::default() },
        robots: vec![(RobotId::new("arm").unwrap(), "tcp://a:1".into())],
    }
}

fn at(millis: i64) -> Timestamp<Server> {
    Timestamp::from_nanos(millis * 1_000_000)
}

fn prepared(number: u32) -> Record {
    Record::Prepared(Promise {
        number,
        act: 0,
        timestamp: at(10),
        start: at(500),
        lease: Span::from_millis(240),
        scripts: vec![],
    })
}

fn written(folder: &Path) -> PathBuf {
    let mut journal = Journal::open(folder).unwrap();
    journal.begin(at(1), &opened()).unwrap();
    for record in
        [prepared(0), Record::Decided { number: 0, unnamed: vec![], doubt: Span::ZERO }, prepared(1)]
    {
        journal.append(at(2), &record).unwrap();
    }
    assert_eq!(journal.sync(), Ok(2));
    folder.join("journal")
}

#[test]
fn what_was_promised_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let kept = read(&written(folder.path())).unwrap();
    assert_eq!(kept.opened, opened());
    let promises: Vec<_> =
        kept.promises.iter().map(|(promise, progressed)| (promise.number, *progressed)).collect();
    assert_eq!(promises, [(0, Progressed::Decided), (1, Progressed::Prepared)]);
    assert_eq!((kept.outcome, kept.torn), (None, None));
}

#[test]
fn a_mission_that_ended_is_known_as_such() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let mut journal = Journal::open(folder.path()).unwrap();
    journal.append(at(3), &Record::Ended { outcome: Outcome::Done }).unwrap();
    assert_eq!(read(&path).unwrap().outcome, Some(serde_json::json!("done")));
}

#[test]
fn a_line_that_was_cut_off_or_changed_ends_what_is_believed() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let bytes = std::fs::read(&path).unwrap();
    let lines: Vec<usize> = bytes.iter().enumerate().filter(|(_, b)| **b == b'\n').map(|(i, _)| i).collect();
    for cut in lines[0] + 1..bytes.len() {
        std::fs::write(&path, &bytes[..cut]).unwrap();
        let whole = lines.iter().filter(|end| **end < cut).count();
        let kept = read(&path).unwrap();
        assert_eq!(kept.torn.is_some(), !lines.iter().any(|end| end + 1 == cut), "cut at {cut}");
        assert_eq!(kept.promises.len(), [0, 0, 1, 1, 2][whole]);
    }
    let mut changed = bytes;
    changed[lines[1] + 15] ^= 1;
    std::fs::write(&path, &changed).unwrap();
    let kept = read(&path).unwrap();
    let bytes = changed.len() - lines[1] - 1;
    assert_eq!(kept.torn, Some(Torn { line: 3, bytes, whole_after: 1 }));
    assert_eq!(kept.fate(), Fate::Withdraw("its journal is damaged"));
}

#[test]
fn a_journal_has_one_writer() {
    let folder = tempfile::tempdir().unwrap();
    let _held = Journal::open(folder.path()).unwrap();
    assert!(Journal::open(folder.path()).is_err());
}

#[test]
fn a_journal_cut_anywhere_takes_further_records_and_all_are_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let bytes = std::fs::read(&path).unwrap();
    let lines: Vec<usize> = bytes.iter().enumerate().filter(|(_, b)| **b == b'\n').map(|(i, _)| i).collect();
    for cut in lines[0] + 1..=bytes.len() {
        std::fs::write(&path, &bytes[..cut]).unwrap();
        let mut journal = Journal::open(folder.path()).unwrap();
        for record in
            [prepared(7), Record::Decided { number: 7, unnamed: vec![], doubt: Span::ZERO }, prepared(8)]
        {
            journal.append(at(9), &record).unwrap();
        }
        drop(journal);
        let kept = read(&path).unwrap();
        let whole = lines.iter().filter(|end| **end < cut).count();
        let before: &[_] = [
            &[][..],
            &[],
            &[(0, Progressed::Prepared)],
            &[(0, Progressed::Decided)],
            &[(0, Progressed::Decided), (1, Progressed::Prepared)],
        ][whole];
        let promises: Vec<_> =
            kept.promises.iter().map(|(promise, progressed)| (promise.number, *progressed)).collect();
        assert_eq!(
            promises,
            [before, &[(7, Progressed::Decided), (8, Progressed::Prepared)]].concat(),
            "cut at {cut}"
        );
        assert_eq!(kept.torn, None, "cut at {cut}");
    }
}

#[test]
fn a_journal_cut_within_its_first_line_can_begin_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let bytes = std::fs::read(&path).unwrap();
    let first = bytes.iter().position(|byte| *byte == b'\n').unwrap();
    for cut in 0..=first {
        std::fs::write(&path, &bytes[..cut]).unwrap();
        let mut journal = Journal::open(folder.path()).unwrap();
        assert!(journal.kept().is_none(), "cut at {cut}");
        journal.begin(at(1), &opened()).unwrap();
        journal.append(at(2), &prepared(3)).unwrap();
        drop(journal);
        assert_eq!(read(&path).unwrap().promises.len(), 1, "cut at {cut}");
    }
}

fn on(disk: SimulatedDisk) -> Journal<SimulatedDisk> {
    Journal::on(disk, "journal".into()).unwrap()
}

#[test]
fn what_was_synced_survives_a_loss_of_power_wherever_it_tears_the_rest() {
    let mut survive = 0;
    loop {
        let mut journal = on(SimulatedDisk::default());
        journal.begin(at(1), &opened()).unwrap();
        journal.append(at(2), &prepared(0)).unwrap();
        assert_eq!(journal.sync(), Ok(1));
        journal.append(at(2), &Record::Decided { number: 0, unnamed: vec![], doubt: Span::ZERO }).unwrap();
        let mut disk = journal.into_disk();
        let at_risk = disk.at_risk();
        disk.lose_power(survive);
        let mut journal = on(disk);
        let kept = journal.kept().unwrap().clone();
        assert_eq!(
            kept.promises[0].1 == Progressed::Decided,
            survive == at_risk,
            "{survive} of {at_risk} bytes"
        );
        assert_eq!(kept.torn.is_some(), survive > 0 && survive < at_risk);
        journal.append(at(3), &Record::Ended { outcome: Outcome::Stopped }).unwrap();
        let again = on(journal.into_disk());
        assert_eq!(again.kept().unwrap().outcome, Some(serde_json::json!("stopped")));
        if survive == at_risk {
            return;
        }
        survive += 1;
    }
}

#[test]
fn a_full_disk_is_said_once_for_all_and_leaves_a_journal_that_can_be_taken_up() {
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
        assert_eq!(journal.kept().unwrap().promises.len(), taken as usize, "room {room}");
        journal.append(at(2), &prepared(taken)).unwrap();
        assert_eq!(on(journal.into_disk()).kept().unwrap().promises.len(), taken as usize + 1);
    }
}

#[tokio::test]
async fn the_thread_tells_how_many_durable_records_are_on_the_disk() {
    let mut journal = on(SimulatedDisk::default());
    journal.begin(at(1), &opened()).unwrap();
    let mut writer = Writer::start(journal).unwrap();
    for record in
        [prepared(0), Record::Decided { number: 0, unnamed: vec![], doubt: Span::ZERO }, prepared(1)]
    {
        writer.write(at(2), record).unwrap();
    }
    let mut written = Written::default();
    while written.count < 2 {
        written = writer.next().await;
    }
    assert_eq!(written, Written { count: 2, lost: None });
    let journal = writer.finish().await.unwrap();
    assert_eq!(on(journal.into_disk()).kept().unwrap().promises.len(), 2);
}

#[tokio::test]
async fn the_thread_tells_that_the_journal_is_lost() {
    let mut journal = on(SimulatedDisk::with_capacity(Some(1_000)));
    journal.begin(at(1), &opened()).unwrap();
    let mut writer = Writer::start(journal).unwrap();
    for number in 0..10 {
        writer.write(at(2), prepared(number)).unwrap();
    }
    while writer.next().await.lost.is_none() {}
}
