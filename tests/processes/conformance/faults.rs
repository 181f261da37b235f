//! Robots with one planted fault each, and for each fault exactly the requirements that it must break.

mod asking;
mod codes;
mod commands;
mod holding;
mod moving;
mod owning;
mod talking;

use std::time::Duration;

use serde_json::{Value, json};

use super::proxy::{Fault, Memory, More, Passing, Serving, Then};

/// A robot with one planted fault.
pub struct Mutant {
    pub name: &'static str,
    pub robot: Robot,
    pub serving: Serving,
    pub fault: Fault,
    /// Whether the requirements about leases are checked as well. They take long, because they mostly wait.
    pub waits: bool,
    /// The requirements to check; if empty, all except those that are expensive or about leases.
    pub only: &'static [&'static str],
    /// The requirements that the robot must fail. If there are several, a comment next to them explains why.
    pub fails: &'static [&'static str],
}

/// The correct robot to which the fault is added.
#[derive(Clone, Copy)]
pub enum Robot {
    /// An arm: one linear device, which holds two scripts in its queue.
    Arm,
    /// A rover: a driven wheel and a sensor.
    Rover,
    /// The arm, with a clock that is two seconds ahead.
    ClockAhead,
}

const fn mutant(name: &'static str, fails: &'static [&'static str], fault: Fault) -> Mutant {
    Mutant { name, robot: Robot::Arm, serving: Serving::All, fault, waits: false, only: &[], fails }
}

fn pass(_: &mut Memory, _: &mut Passing) -> Then {
    Then::Pass
}

fn is_script(request: &Value) -> bool {
    request["control_type"] == "script" && request["control_value"] != json!([])
}

fn is_cancel(request: &Value) -> bool {
    request["control_value"] == json!([])
}

fn offset(request: &Value) -> f64 {
    request["time_offset_to_start"].as_f64().unwrap_or(-1.0)
}

fn remove(value: &mut Value, key: &str) {
    if let Some(map) = value.as_object_mut() {
        map.remove(key);
    }
}

fn answer(request: &Value, status: &str, code: &str) -> Value {
    let mut response = json!({
        "timestamp": "2026-11-20T19:00:00.000000000Z", "device_id": request["device_id"], "status": status,
        "status_value": null,
    });
    if request["request_id"].is_string() {
        response["request_id"] = request["request_id"].clone();
    }
    if status == "Failed" {
        response["error"] = json!({"code": code, "message": "planted"});
    }
    json!({"control_response": response})
}

fn malformed() -> Value {
    json!({"availability_response": {
        "receive_timestamp": "2026-11-20T19:00:00.000000000Z", "timestamp": "2026-11-20T19:00:00.000000000Z",
        "status": "Failed", "error": {"code": "malformed", "message": "planted"},
    }})
}

/// Replaces the error code `code` in a response by `internal`.
fn recode(passing: &mut Passing, code: &str) -> Then {
    for message in ["availability_response", "control_response"] {
        if let Some(said) = passing.json.pointer_mut(&format!("/{message}/error/code"))
            && said == code
        {
            *said = json!("internal");
        }
    }
    Then::Pass
}

/// Shifts a timestamp by this many milliseconds.
fn shift(timestamp: &mut Value, by: i64) {
    let at: urrcp::Timestamp<urrcp::Robot> = serde_json::from_value(timestamp.clone()).unwrap();
    *timestamp = json!(at + urrcp::Span::from_millis(by));
}

/// Edits a control request on its way to the robot, and passes the line.
fn edit(passing: &mut Passing, edit: impl Fn(&mut Value)) -> Then {
    if let Some(request) = passing.request() {
        edit(request);
    }
    Then::Pass
}

/// Edits a control response of the robot (an answer or a report), and passes the line.
fn edit_response(passing: &mut Passing, edit: impl Fn(&mut Value)) -> Then {
    if let Some(response) = passing.response() {
        edit(response);
    }
    Then::Pass
}

/// Edits the first device of the initialization block, and passes the line.
fn declare(passing: &mut Passing, edit: impl Fn(&mut Value)) -> Then {
    if let Some(device) = passing.json.pointer_mut("/initialization_block/devices/0") {
        edit(device);
    }
    Then::Pass
}

/// Returns an availability request that the proxy itself sends; `unasked` recognises the answer.
fn presence(link: u64, after: Duration) -> More {
    More { after, link, line: json!({"availability_request": {}}) }
}

/// Whether this line answers a request that the proxy itself sent.
fn unasked(passing: &Passing) -> bool {
    let response = passing.json.get("availability_response");
    response.is_some_and(|r| r.get("originate_timestamp").is_none() && r["status"] == "OK")
}

/// Replaces `text` by `to` if the line comes from the server and contains `text`, and passes the line.
fn replace(passing: &mut Passing, text: &str, to: &str) -> Then {
    if passing.is_from_server(text) {
        Then::Instead(String::from_utf8_lossy(&passing.raw).replace(text, to).into_bytes())
    } else {
        Then::Pass
    }
}

/// Returns all mutants: the robots with one planted fault each.
pub fn all() -> Vec<Mutant> {
    let waiting = [
        commands::of_times(),
        holding::of_leases(),
        owning::of_leases(),
        asking::of_leases(),
        codes::lease(),
    ]
    .into_iter()
    .flatten()
    .map(|mutant| Mutant { waits: true, ..mutant });
    let quick = [
        commands::of_greeting(),
        codes::all(),
        commands::of_values(),
        holding::of_stops(),
        moving::of_movements(),
        asking::of_inquiries(),
        owning::of_sessions(),
        talking::of_identity(),
        talking::of_lines(),
        talking::of_links(),
    ];
    waiting.chain(quick.into_iter().flatten()).collect()
}
