use urrcp::Span;

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
    for record in [prepared(0), Record::Decided { number: 0, unnamed: vec![] }, prepared(1)] {
        journal.write(at(2), &record).unwrap();
    }
    folder.join("journal")
}

#[test]
fn what_was_promised_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let kept = read(&written(folder.path())).unwrap();
    assert_eq!(kept.opened, opened());
    let promises: Vec<_> =
        kept.promises.iter().map(|(promise, decided)| (promise.number, *decided)).collect();
    assert_eq!(promises, [(0, true), (1, false)]);
    assert_eq!((kept.outcome, kept.torn_at_line), (None, None));
}

#[test]
fn a_mission_that_ended_is_known_as_such() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let mut journal = Journal::open(folder.path()).unwrap();
    journal.write(at(3), &Record::Ended { outcome: Outcome::Done }).unwrap();
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
        assert_eq!(kept.torn_at_line.is_some(), !lines.iter().any(|end| end + 1 == cut), "cut at {cut}");
        assert_eq!(kept.promises.len(), [0, 0, 1, 1, 2][whole]);
    }
    let mut changed = bytes;
    changed[lines[1] + 15] ^= 1;
    std::fs::write(&path, &changed).unwrap();
    assert_eq!(read(&path).unwrap().torn_at_line, Some(3));
}

#[test]
fn a_journal_has_one_writer() {
    let folder = tempfile::tempdir().unwrap();
    let _held = Journal::open(folder.path()).unwrap();
    assert!(Journal::open(folder.path()).is_err());
}
