//! Checks that the judge (`judge.rs`) detects faults: one faultless mission, whose record is falsified in one respect at a time.

use downbeat_robot::set_log::{LogEntry, MotionKind};
use serde_json::{Value, json};

use super::draw::{Clock, Drawn, Fault, Tells};
use super::judge::judge;
use super::play::{Kind, Played, Struck, Told, What, play};
use stage::Ended;

const SECOND: i64 = 1_000_000_000;

/// Plays a mission with two robots, two acts, and two scripts per act and device, without any fault.
fn faultless() -> Played {
    play(Drawn {
        seed: 0,
        clocks: vec![Clock::Ntp(1_000), Clock::Measured(1_000)],
        tells: vec![Tells::Everything, Tells::WhenAsked],
        queue: 2,
        on_failure: "stop",
        on_doubt: "start",
        acts: vec![2, 2],
        every_ms: 150,
        lease_ms: 700,
        patience_ms: 2_000,
        strikes: Vec::new(),
    })
}

fn of_run(played: &mut Played) -> &mut Ended {
    played.told[0].ended.as_mut().unwrap()
}

fn reported(played: &mut Played, change: impl FnOnce(&mut Value)) {
    let mut report = of_run(played).report();
    change(&mut report);
    of_run(played).out = report.to_string();
}

fn struck(played: &mut Played, robot: Option<usize>, what: What) {
    let from = played.sets[0][2].at;
    played.struck.push(Struck { robot, what, from, until: i64::MAX });
}

/// Adds a movement without a request to a robot's log, after the end of the mission.
fn moved(played: &mut Played, motion: MotionKind) {
    let mut last = played.logs[0][0].last().unwrap().clone();
    (last.motion, last.step, last.request_id) = (motion, None, None);
    last.value += 1.0;
    played.logs[0][0].push(last);
}

/// The name of the finding that the judge must report, and the function that falsifies the mission's record.
type Doctored = (&'static str, fn(&mut Played));

const DOCTORED: &[Doctored] = &[
    ("(hang)", |played| played.told[0].ended = Err("waits".to_owned())),
    ("(code)", |played| of_run(played).code = Some(5)),
    ("(code)", |played| reported(played, |report| report["outcome"] = json!("failed"))),
    ("(code)", |played| of_run(played).out.clear()),
    ("(mixed)", |played| played.logs[1][0].clear()),
    ("(mixed)", |played| played.logs[0][0].retain(|entry| entry.value < 21.0)),
    ("(done)", |played| drop(played.sets[1].pop())),
    ("(more)", |played| drop(played.sets[1].remove(3))),
    ("(script)", |played| drop(played.sets[1].remove(3))),
    ("(order)", |played| played.sets[0].swap(2, 4)),
    ("(twice)", |played| {
        let again = played.sets[0][5].clone();
        played.sets[0].insert(6, again);
    }),
    ("(foreign)", |played| played.sets[0][15].value = 89.0),
    ("(promise)", |played| played.sets[0][3].request = "another/1".to_owned()),
    ("(movement)", |played| moved(played, MotionKind::Default)),
    ("(movement)", |played| moved(played, MotionKind::Rest)),
    ("(movement)", |played| moved(played, MotionKind::Slow)),
    ("(movement)", |played| played.logs[1][0][7].value += 1.0),
    ("(movement)", |played| {
        let ramp = |entry: &&mut LogEntry| entry.motion == MotionKind::Ramp;
        played.logs[1][0].iter_mut().find(ramp).unwrap().request_id = Some("another/1".to_owned());
    }),
    ("(stranger)", |played| played.strangers = 1),
    ("(early)", |played| played.sets[0][0].at -= 30_000_000),
    ("(late)", |played| played.sets[0][0].at += 90_000_000),
    ("(late)", |played| played.sets[0][6].at += SECOND),
    ("(lease)", |played| struck(played, Some(0), What::Robot(Fault::Cut))),
    ("(lease)", |played| struck(played, Some(0), What::Robot(Fault::Deaf))),
    ("(lease)", |played| struck(played, None, What::SchedulerKilled)),
    ("(lease)", |played| {
        // The link holds messages for a quarter of a second.
        let at = played.sets[0][2].at;
        let (what, from, until) = (What::Robot(Fault::Muted), at - SECOND / 20, at + SECOND / 4);
        played.struck.push(Struck { robot: Some(0), what, from, until });
        struck(played, None, What::SchedulerFrozen);
    }),
    ("(stop)", |played| {
        let at = played.sets[1][9].at;
        played.journal.push((at, json!({"record": "stop_confirmed", "robot": "r1"})));
    }),
    ("(stop)", |played| {
        // As if the whole mission had happened after the stop, which was requested earlier.
        let (began, code) = (played.sets[0][0].at - 3 * SECOND, Some(0));
        let ended =
            Ok(Ended { code, out: r#"{"outcome":"stopped","robots":[]}"#.to_owned(), told: String::new() });
        played.told.push(Told { kind: Kind::Stop, began, gone: began + SECOND / 5, ended });
    }),
    ("(named)", |played| played.told[0].gone = played.sets[0][9].at),
    ("(named)", |played| {
        let at = played.sets[0][9].at;
        played.told[0].gone = at;
        let ends = chrono::DateTime::from_timestamp_nanos(at).to_rfc3339();
        reported(played, |report| {
            report["robots"][0]["stop"] = json!({"state": "unconfirmed", "lease_ends": ends})
        });
    }),
    ("(fewer)", |played| reported(played, |report| report["robots"][0]["steps_done"] = json!(15))),
    ("(moved)", |played| reported(played, |report| report["robots"][0]["started"] = json!(0))),
    ("(moved)", |played| reported(played, |report| report["outcome"] = json!("not_started"))),
    ("(more)", |played| reported(played, |report| report["robots"][0]["late_steps"] = json!(17))),
    ("(script)", |played| {
        reported(played, |r| r["acts"][0]["robots"][0]["devices"][0]["state"] = json!("planned"))
    }),
    ("(script)", |played| {
        reported(played, |r| r["acts"][1]["robots"][1]["devices"][1]["steps_done"] = json!(3))
    }),
    ("(blame)", |played| {
        reported(played, |report| report["failures"] = json!([{"robot": "r1", "failure": "link_down"}]));
    }),
    ("(blame)", |played| {
        struck(played, None, What::SchedulerFrozen);
        reported(played, |report| report["failures"] = json!([{"robot": "r1", "failure": "silent"}]));
    }),
];

#[test]
fn judge_detects_every_false_report_and_wrong_movement() {
    super::held_up::watch();
    let mut played = faultless();
    let found = judge(&played).wrong;
    assert!(found.is_empty(), "{found:#?}");
    let mut missed = Vec::new();
    for (which, (name, doctor)) in DOCTORED.iter().enumerate() {
        let whole = played.clone();
        doctor(&mut played);
        let verdict = judge(&played);
        // On a busy machine the judge notices that a robot is blamed, or has not started, and excuses it.
        let excused = match *name {
            "(blame)" => !verdict.busy.is_empty(),
            "(mixed)" => verdict.acts.contains(&"the machine was busy"),
            _ => false,
        };
        if !excused && !verdict.wrong.iter().any(|wrong| wrong.starts_with(name)) {
            missed.push(format!("{which} {name}: {:?}, busy {:?}", verdict.wrong, verdict.busy));
        }
        played = whole;
    }
    assert!(missed.is_empty(), "{missed:#?}");
}
