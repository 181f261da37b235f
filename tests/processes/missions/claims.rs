//! Robots that report something impossible: the mission compares a robot's claims with what is possible, and none of these lies ends in
//! `done`.

use serde_json::{Value, json};

use stage::play::{LONG, Play};
use stage::{Ended, Stage, Via};

/// A script of ten steps, one every 100 ms, with a start tolerance of 100 ms.
const PLAY: Play = Play { steps: 10, tolerance: "100ms", ..LONG };

/// Plays a show on two robots. `lie` falsifies the messages of the first one, so that it reports something other than it does.
fn played(lie: fn(&mut Value)) -> (Stage, Ended) {
    let stage = PLAY.stage(&[Via::Proxy, Via::Direct]);
    stage.robots[0].link.as_ref().unwrap().rewrite(lie);
    let ended = begun(&stage);
    (stage, ended)
}

fn begun(stage: &Stage) -> Ended {
    stage.play(&["run", "play.yaml", "--patience", "2s", "--format", "json"])
}

fn response(message: &mut Value) -> Option<&mut Value> {
    message.get_mut("control_response")
}

/// Adds `millis` to the event time in a response.
fn later(response: &mut Value, millis: i64) {
    let Some(at) = response["event_timestamp"].as_str().map(stage::nanos) else { return };
    let at = urrcp::Timestamp::<urrcp::Robot>::from_nanos(at + millis * 1_000_000);
    response["event_timestamp"] = serde_json::to_value(at).unwrap();
}

#[track_caller]
fn claims(lie: fn(&mut Value), claim: &str, possible: (&str, Value)) {
    let (_, ended) = played(lie);
    let report = ended.report();
    assert_eq!(report["outcome"], "failed", "{ended}");
    let failure = report["failures"].as_array().unwrap().iter().find(|failure| failure["failure"] == "claim");
    let failure = failure.unwrap_or_else(|| panic!("{report}"));
    assert_eq!(
        (&failure["robot"], &failure["device"], &failure["claim"]),
        (&json!("r0"), &json!("d"), &json!(claim))
    );
    assert_eq!(failure[possible.0], possible.1, "{failure}");
    assert_ne!(ended.code, Some(0), "{ended}");
    assert!(report["robots"][0]["steps_done"].as_u64().unwrap() <= 10, "{report}");
}

#[test]
fn truthful_reports_are_accepted() {
    let (stage, ended) = played(|_| {});
    assert_eq!(ended.code, Some(0), "{ended}");
    stage.robots.iter().for_each(|robot| PLAY.was_played_by(robot));
}

#[test]
fn report_of_more_steps_than_planned_is_rejected() {
    let lie = |message: &mut Value| {
        if let Some(done) = response(message).and_then(|response| response.get_mut("steps_done")) {
            *done = json!(u32::MAX);
        }
    };
    claims(lie, "steps", ("claimed", json!(u32::MAX)));
}

#[test]
fn completion_reported_at_script_start_is_rejected() {
    let lie = |message: &mut Value| {
        if let Some(response) = response(message).filter(|response| response["status"] == "Started") {
            response["status"] = json!("OK");
            response["steps_done"] = json!(10);
        }
    };
    let (_, ended) = played(lie);
    assert_eq!(ended.report()["outcome"], "failed", "{ended}");
    assert_eq!(ended.report()["failures"][0]["claim"], "ended_early", "{ended}");
}

#[test]
fn completion_with_a_remaining_step_is_rejected() {
    let lie = |message: &mut Value| {
        if let Some(response) = response(message).filter(|response| response["status"] == "OK") {
            response["steps_done"] = json!(9);
        }
    };
    claims(lie, "completed", ("planned", json!(10)));
}

#[test]
fn start_time_a_minute_in_the_past_or_future_is_rejected() {
    let lie = |message: &mut Value| {
        response(message).filter(|r| r["status"] == "Started").into_iter().for_each(|r| later(r, -60_000));
    };
    claims(lie, "before_sent", ("device", json!("d")));
    let lie = |message: &mut Value| {
        response(message).filter(|r| r["status"] == "Started").into_iter().for_each(|r| later(r, 60_000));
    };
    claims(lie, "ahead", ("device", json!("d")));
}

/// Both robots report starts 344 ms late: these starts are simultaneous, but not when they were planned.
#[test]
fn simultaneous_starts_off_their_planned_time_are_out_of_tolerance() {
    let stage = PLAY.stage(&[Via::Proxy, Via::Proxy]);
    for robot in &stage.robots {
        robot.link.as_ref().unwrap().rewrite(|message| {
            // Reported at a plausible time.
            if let Some(response) = response(message).filter(|r| r["status"] == "Started") {
                std::thread::sleep(std::time::Duration::from_millis(344));
                later(response, 344);
            }
        });
    }
    let ended = begun(&stage);
    assert_eq!(ended.code, Some(6), "{ended}");
    let spread = ended.report()["outcome"]["out_of_tolerance"]["spread_ms"].as_f64().unwrap();
    assert!(spread >= 343.0, "{ended}");
}
