//! Robots with one planted fault each, and exactly the requirements that this fault must break.

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

/// A robot with a fault.
pub struct Mutant {
    pub name: &'static str,
    pub robot: Robot,
    pub serving: Serving,
    pub fault: Fault,
    /// Whether the leases are checked as well, which mostly means waiting.
    pub waits: bool,
    /// The requirements to check; empty: all except the heavy ones.
    pub only: &'static [&'static str],
    /// The requirements that must fail. If there are several, a comment next to them explains why.
    pub fails: &'static [&'static str],
}

/// The robot behind the fault.
#[derive(Clone, Copy)]
pub enum Robot {
    /// One linear device with scripts, two of them in its queue.
    Arm,
    /// A driven wheel, and a sensor.
    Rover,
    /// The arm, with its clock two seconds ahead.
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

/// Replaces one error code by another.
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

/// Shifts a timestamp by milliseconds.
fn shift(timestamp: &mut Value, by: i64) {
    let at: urrcp::Timestamp<urrcp::Robot> = serde_json::from_value(timestamp.clone()).unwrap();
    *timestamp = json!(at + urrcp::Span::from_millis(by));
}

/// Edits control requests on their way to the robot.
fn edit(passing: &mut Passing, edit: impl Fn(&mut Value)) -> Then {
    if let Some(request) = passing.request() {
        edit(request);
    }
    Then::Pass
}

/// Edits the robot's answers and reports.
fn edit_response(passing: &mut Passing, edit: impl Fn(&mut Value)) -> Then {
    if let Some(response) = passing.response() {
        edit(response);
    }
    Then::Pass
}

/// Edits the first device of the initialization block.
fn declare(passing: &mut Passing, edit: impl Fn(&mut Value)) -> Then {
    if let Some(device) = passing.json.pointer_mut("/initialization_block/devices/0") {
        edit(device);
    }
    Then::Pass
}

/// Returns a request of the proxy itself; `unasked` recognises the answer.
fn presence(link: u64, after: Duration) -> More {
    More { after, link, line: json!({"availability_request": {}}) }
}

/// Whether this answers a request of the proxy.
fn unasked(passing: &Passing) -> bool {
    let response = passing.json.get("availability_response");
    response.is_some_and(|r| r.get("originate_timestamp").is_none() && r["status"] == "OK")
}

/// Replaces `text` by `to` in every line from the server that contains it.
fn replace(passing: &mut Passing, text: &str, to: &str) -> Then {
    if passing.is_from_server(text) {
        Then::Instead(String::from_utf8_lossy(&passing.raw).replace(text, to).into_bytes())
    } else {
        Then::Pass
    }
}

/// Returns all mutants.
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
