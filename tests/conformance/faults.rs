//! Robots with one planted fault each, and the requirements that this must break: these and no others.

use std::time::Duration;

use serde_json::{Value, json};

use super::proxy::{Fault, Memory, Passing, Serving, TWICE, Then, Way};

/// A robot with a fault.
pub struct Mutant {
    pub name: &'static str,
    pub robot: Robot,
    pub serving: Serving,
    pub fault: Fault,
    /// Whether the leases are checked as well, which is waiting for the most part.
    pub waits: bool,
    /// What is checked; empty: everything but the heavy ones.
    pub only: &'static [&'static str],
    /// What must fail. Why several do, where they do, stands beside it.
    pub fails: &'static [&'static str],
}

/// Which robot stands behind the fault.
#[derive(Clone, Copy)]
pub enum Robot {
    /// One linear device with scripts, two of them in its queue.
    Arm,
    /// A driven wheel, and a sensor.
    Rover,
    /// The arm, its clock two seconds ahead.
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

/// Another code in place of one.
fn recode(passing: &mut Passing, code: &str) -> Then {
    if let Some(response) = passing.response()
        && response["error"]["code"] == code
    {
        response["error"]["code"] = json!("internal");
    }
    Then::Pass
}

/// Edits control requests on their way to the robot.
fn edit(passing: &mut Passing, edit: impl Fn(&mut Value)) -> Then {
    if let Some(request) = passing.request() {
        edit(request);
    }
    Then::Pass
}

/// Edits what the robot answers and reports.
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

/// Every line from the server that holds this text is passed as `to`.
fn replace(passing: &mut Passing, text: &str, to: &str) -> Then {
    match passing.is_from_server(text) {
        true => Then::Instead(String::from_utf8_lossy(&passing.raw).replace(text, to).into_bytes()),
        false => Then::Pass,
    }
}

/// All of them.
pub fn all() -> Vec<Mutant> {
    let waiting =
        [of_times(), of_leases()].into_iter().flatten().map(|mutant| Mutant { waits: true, ..mutant });
    let quick = [of_greeting(), of_values(), of_stops(), of_identity(), of_lines(), of_links()];
    waiting.chain(quick.into_iter().flatten()).collect()
}

fn of_greeting() -> Vec<Mutant> {
    vec![
        mutant("the request's time is not echoed", &["availability"], |_, passing| {
            if let Some(response) = passing.json.get_mut("availability_response") {
                remove(response, "originate_timestamp");
            }
            Then::Pass
        }),
        mutant("the default value lies out of range", &["initialization"], |_, passing| {
            declare(passing, |device| device["default_value"] = json!(5_000))
        }),
        mutant(
            "no readable block, so nothing else is known of the robot",
            &["initialization"],
            |_, passing| declare(passing, |device| device["id"] = json!("x".repeat(300))),
        ),
        mutant("whoever does not greet is hung up on", &["skip-handshake"], |memory, passing| {
            if passing.way == Way::ToRobot && passing.json.get("initialization_request").is_some() {
                memory.seen.insert((passing.link, String::new()));
            }
            let greeted = memory.seen.contains(&(passing.link, String::new()));
            match passing.request().is_some() && !greeted {
                true => Then::HangUp,
                false => Then::Pass,
            }
        }),
        Mutant { robot: Robot::ClockAhead, ..mutant("the clock is two seconds ahead", &["clock"], pass) },
    ]
}

fn of_values() -> Vec<Mutant> {
    let mut all = vec![
        // What lies beyond for a plain value lies beyond for a step.
        mutant("less is declared than it takes", &["range", "script-range"], |_, passing| {
            declare(passing, |device| device["available_control_types"]["position"]["max_value"] = json!(80))
        }),
        mutant("more is declared than it takes", &["range"], |_, passing| {
            declare(passing, |device| device["available_control_types"]["position"]["max_value"] = json!(120))
        }),
        // So it is with what lies between.
        mutant("a coarser grid is declared", &["granularity", "script-range"], |_, passing| {
            declare(passing, |device| device["available_control_types"]["position"]["granularity"] = json!(1))
        }),
        mutant("steps out of range are cut to it", &["script-range"], |_, passing| {
            edit(passing, |request| {
                for step in request["control_value"].as_array_mut().into_iter().flatten() {
                    step["control_value"] = json!(step["control_value"].as_f64().unwrap_or(0.0).min(90.0));
                }
            })
        }),
        mutant("unknown devices are taken for the first", &["unknown-device"], |_, passing| {
            edit(passing, |request| {
                if request["device_id"].as_str().is_some_and(|id| id.starts_with("no-such")) {
                    request["device_id"] = json!("shoulder");
                }
            })
        }),
        mutant(
            "an unsupported control type leaves what is pending",
            &["unsupported-control-type"],
            |_, passing| match passing.request() {
                Some(request) if request["control_type"] == "acceleration" => {
                    Then::Answer(answer(request, "Failed", "unsupported_control_type"))
                }
                _ => Then::Pass,
            },
        ),
        mutant("every step is taken for a position", &["script-control-types"], |_, passing| {
            edit(passing, |request| {
                for step in request["control_value"].as_array_mut().into_iter().flatten() {
                    step["control_type"] = json!("position");
                }
            })
        }),
        mutant("everything reads something", &["sensor-not-a-sensor"], |_, passing| {
            match passing.request() {
                Some(request) if request["control_type"] == "sensor" => {
                    Then::Answer(answer(request, "Provide", ""))
                }
                _ => Then::Pass,
            }
        }),
        // Its code is what three of them are told by.
        mutant(
            "unsupported control types have a code of their own",
            &["unsupported-control-type", "script-control-types", "sensor-not-a-sensor"],
            |_, passing| recode(passing, "unsupported_control_type"),
        ),
    ];
    let sensors: [(&'static str, Fault); 3] = [
        ("readings lie out of range", |_, passing| {
            edit_response(passing, |response| {
                if response["status"] == "Provide" {
                    response["status_value"] = json!(1_000);
                }
            })
        }),
        ("readings are answered with OK", |_, passing| {
            edit_response(passing, |response| {
                if response["status"] == "Provide" {
                    response["status"] = json!("OK");
                }
            })
        }),
        ("readings come late", |_, passing| match passing.response() {
            Some(response) if response["status"] == "Provide" => Then::After(Duration::from_millis(600)),
            _ => Then::Pass,
        }),
    ];
    for (name, fault) in sensors {
        let only: &[&str] = &["availability", "sensor", "sensor-not-a-sensor", "range"];
        all.push(Mutant { robot: Robot::Rover, only, ..mutant(name, &["sensor"], fault) });
    }
    all
}

fn of_times() -> Vec<Mutant> {
    fn shifted(passing: &mut Passing, by: f64) -> Then {
        edit(passing, |request| {
            if !is_script(request) && (0.0..5_000.0).contains(&offset(request)) && !is_cancel(request) {
                request["time_offset_to_start"] = json!(offset(request) + by);
            }
        })
    }
    vec![
        mutant("starts come 400 ms late", &["deferred-start"], |_, passing| shifted(passing, 400.0)),
        mutant("starts come 200 ms early", &["deferred-start"], |_, passing| shifted(passing, -200.0)),
        // Without the time of the start neither it nor the script's length can be judged.
        mutant("starts are told without their time", &["deferred-start", "script-timing"], |_, passing| {
            edit_response(passing, |response| {
                if response["status"] == "Started" {
                    remove(response, "event_timestamp");
                }
            })
        }),
        mutant("at once means in half a second", &["immediate-start"], |_, passing| {
            edit(passing, |request| {
                if request.get("time_offset_to_start").is_none() && !is_cancel(request) {
                    request["time_offset_to_start"] = json!(500);
                }
            })
        }),
        mutant("late commands are played at once", &["late"], |_, passing| {
            edit(passing, |request| {
                if offset(request) == 1_000.0 {
                    remove(request, "time_offset_to_start");
                }
            })
        }),
        mutant("acceptances carry no value", &["status-value"], |_, passing| {
            edit_response(passing, |response| {
                if response["status"] == "Accepted" {
                    response["status_value"] = Value::Null;
                }
            })
        }),
        mutant("steps are put in order", &["script-order"], |_, passing| {
            edit(passing, |request| {
                if let Some(steps) = request["control_value"].as_array_mut() {
                    steps.sort_by(|a, b| offset(a).total_cmp(&offset(b)));
                }
            })
        }),
        mutant("the last step comes 400 ms late", &["script-timing"], |_, passing| {
            edit(passing, |request| {
                if let Some(step) = request["control_value"].as_array_mut().and_then(|steps| steps.last_mut())
                    && offset(step) == 300.0
                {
                    step["time_offset_to_start"] = json!(700);
                }
            })
        }),
        mutant("one step too few is told", &["script-timing"], |_, passing| {
            edit_response(passing, |response| {
                if response["status"] == "OK" && response["steps_done"] == 3 {
                    response["steps_done"] = json!(2);
                }
            })
        }),
        mutant("more steps are declared than it takes", &["max-steps"], |_, passing| {
            declare(passing, |d| d["available_control_types"]["script"]["max_number_of_steps"] = json!(9))
        }),
        mutant("fewer steps are declared than it takes", &["one-step-too-many"], |_, passing| {
            declare(passing, |d| d["available_control_types"]["script"]["max_number_of_steps"] = json!(7))
        }),
        mutant("a longer queue is declared than there is", &["queue"], |_, passing| {
            declare(passing, |device| device["script_queue"] = json!(3))
        }),
        mutant("a shorter queue is declared than there is", &["queue"], |_, passing| {
            declare(passing, |device| device["script_queue"] = json!(1))
        }),
        mutant("what overlaps is put off", &["overlap"], |_, passing| {
            edit(passing, |request| {
                if offset(request) == 20_250.0 {
                    request["time_offset_to_start"] = json!(25_000);
                }
            })
        }),
    ]
}

fn of_leases() -> Vec<Mutant> {
    fn with_lease(passing: &mut Passing, change: impl Fn(&mut Value)) -> Then {
        edit(passing, |request| {
            if request.get("stop_condition").is_some() {
                change(&mut request["stop_condition"]);
            }
        })
    }
    vec![
        // All that shows a lease running out; a step's own stays.
        mutant(
            "stop_condition is not read",
            &["lease-pending", "lease-running", "lease-noise", "lease-link-down", "lease-two-links"],
            |_, passing| edit(passing, |request| remove(request, "stop_condition")),
        ),
        mutant("leases end with the start", &["lease-running"], |_, passing| {
            with_lease(passing, |lease| {
                if !lease.is_object() {
                    *lease = json!({"pending": lease, "running": null});
                } else {
                    lease["running"] = Value::Null;
                }
            })
        }),
        mutant(
            "leases begin with the start",
            &["lease-pending", "lease-noise", "lease-link-down", "lease-two-links"],
            |_, passing| {
                with_lease(passing, |lease| {
                    if !lease.is_object() {
                        *lease = json!({"pending": null, "running": lease});
                    }
                })
            },
        ),
        mutant("pending leases are twice as long", &["lease-pending"], |_, passing| {
            with_lease(passing, |lease| {
                if let Some(millis) = lease.as_f64().filter(|millis| *millis == 300.0) {
                    *lease = json!({"pending": 2.0 * millis, "running": millis});
                }
            })
        }),
        mutant("running null means as pending", &["lease-pair"], |_, passing| {
            with_lease(passing, |lease| {
                if lease.get("running").is_some_and(Value::is_null) {
                    *lease = lease["pending"].clone();
                }
            })
        }),
        mutant("a step's own lease is not read", &["lease-step"], |_, passing| {
            edit(passing, |request| {
                for step in request["control_value"].as_array_mut().into_iter().flatten() {
                    remove(step, "stop_condition");
                }
            })
        }),
        Mutant {
            robot: Robot::Rover,
            ..mutant("a speed that is left on has no lease", &["lease-left-on"], |_, passing| {
                edit(passing, |request| {
                    if request["control_type"] == "speed" && request.get("time_offset_to_start").is_none() {
                        remove(request, "stop_condition");
                    }
                })
            })
        },
        mutant("availability requests renew nothing", &["lease-renewal"], |_, passing| {
            match passing.json.get("availability_request") {
                Some(request)
                    if request.get("session").is_none()
                        && request["timestamp"].is_string()
                        && passing.way == Way::ToRobot =>
                {
                    let now = &request["timestamp"];
                    Then::Answer(json!({"availability_response": {
                        "originate_timestamp": now, "receive_timestamp": now, "timestamp": now, "status": "OK"}}))
                }
                _ => Then::Pass,
            }
        }),
        mutant("noise renews", &["lease-noise"], |_, passing| {
            if passing.is_from_server("noise on the line") {
                return Then::Instead(b"{\"availability_request\":{}}\n".to_vec());
            }
            let unasked = passing
                .json
                .get("availability_response")
                .is_some_and(|r| r.get("originate_timestamp").is_none() && r["status"] == "OK");
            match unasked {
                true => Then::Instead(format!("{}\n", malformed()).into_bytes()),
                false => Then::Pass,
            }
        }),
        mutant("what was asked on another connection is forgotten", &["lease-link-down"], |_, passing| {
            let mark = format!("#{}", passing.link);
            let way = passing.way;
            let key = if way == Way::ToRobot { "control_request" } else { "control_response" };
            if let Some(id) = passing.json.pointer_mut(&format!("/{key}/request_id")) {
                let text = id.as_str().unwrap_or_default();
                // The longest ids leave no room for a mark.
                if text.chars().count() < 200 {
                    *id = json!(if way == Way::ToRobot {
                        format!("{text}{mark}")
                    } else {
                        text.replace(&mark, "")
                    });
                }
            }
            Then::Pass
        }),
        // By a session that everybody shares, so that `session` itself cannot be judged.
        Mutant {
            only: &[
                "availability",
                "lease-pending",
                "lease-renewal",
                "lease-link-down",
                "lease-two-links",
                "two-links",
            ],
            ..mutant("any connection renews", &["lease-two-links"], |_, passing| {
                for message in ["availability_request", "control_request"] {
                    if passing.way == Way::ToRobot
                        && let Some(inside) = passing.json.get_mut(message)
                        && inside.get("session").is_none()
                        && inside.is_object()
                    {
                        inside["session"] = json!("everybody");
                    }
                }
                Then::Pass
            })
        },
    ]
}

fn of_stops() -> Vec<Mutant> {
    vec![
        // Each of them waits for what a stop brings about; `hold` and `take-back` are stops too.
        Mutant {
            only: &[
                "availability",
                "late",
                "lease-pending",
                "cancel-pending",
                "cancel-from",
                "cancel-running",
                "hold",
                "take-back",
                "no-request-id",
            ],
            ..mutant(
                "stops are answered and not done",
                &["cancel-pending", "cancel-from", "cancel-running", "hold", "take-back"],
                |_, passing| match passing.request() {
                    Some(request) if is_cancel(request) => Then::Answer(answer(request, "OK", "")),
                    _ => Then::Pass,
                },
            )
        },
        mutant("a stop for later stops all", &["cancel-from"], |_, passing| {
            edit(passing, |request| {
                if is_cancel(request) {
                    remove(request, "time_offset_to_start");
                }
            })
        }),
        mutant("what runs is not stopped", &["cancel-running"], |memory, passing| {
            if let Some(response) = passing.response() {
                match response["status"].as_str() {
                    Some("Started") => memory.running = true,
                    Some("OK") if response.get("steps_done").is_some() => memory.running = false,
                    Some("Failed") if response.get("steps_done").is_some() => memory.running = false,
                    _ => {}
                }
            }
            let running = memory.running;
            match passing.request() {
                Some(request) if is_cancel(request) && running => Then::Answer(answer(request, "OK", "")),
                _ => Then::Pass,
            }
        }),
        mutant("hold is not understood", &["hold"], |_, passing| match passing.request() {
            Some(request) if request.get("hold").is_some() => {
                Then::Answer(answer(request, "Failed", "malformed"))
            }
            _ => Then::Pass,
        }),
        mutant("nothing is taken back", &["take-back"], |_, passing| {
            edit(passing, |request| {
                if is_cancel(request) && request.get("time_offset_to_start").is_none() {
                    remove(request, "timestamp");
                }
            })
        }),
    ]
}

fn of_identity() -> Vec<Mutant> {
    fn repeated(memory: &mut Memory, passing: &mut Passing) -> bool {
        let link = passing.link;
        let id = passing.request().and_then(|request| request["request_id"].as_str().map(str::to_owned));
        id.is_some_and(|id| !memory.seen.insert((link, id)))
    }
    vec![
        mutant("answers name no request", &["request-id"], |_, passing| {
            edit_response(passing, |response| remove(response, "request_id"))
        }),
        mutant("reports name no request", &["request-id"], |_, passing| {
            edit_response(passing, |response| {
                if response["status"] == "Started" {
                    remove(response, "request_id");
                }
            })
        }),
        mutant(
            "repeated requests are not answered",
            &["repeated-request"],
            |memory, passing| match repeated(memory, passing) {
                true => Then::Drop,
                false => Then::Pass,
            },
        ),
        mutant("repeated requests are executed again", &["repeated-request"], |memory, passing| {
            if repeated(memory, passing) {
                return edit(passing, |request| {
                    request["request_id"] =
                        json!(format!("{}#2", request["request_id"].as_str().unwrap_or_default()));
                });
            }
            edit_response(passing, |response| {
                if let Some(id) = response["request_id"].as_str().and_then(|id| id.strip_suffix("#2")) {
                    response["request_id"] = json!(id);
                }
            })
        }),
        mutant("a request must have an id", &["no-request-id"], |_, passing| match passing.request() {
            Some(request) if request.is_object() && request.get("request_id").is_none() => {
                Then::Answer(answer(request, "Failed", "malformed"))
            }
            _ => Then::Pass,
        }),
        mutant("hashes are not echoed", &["content-hash"], |_, passing| {
            edit_response(passing, |response| remove(response, "content_hash"))
        }),
        mutant("hashes are echoed unread", &["content-hash"], |memory, passing| {
            if let Some(request) = passing.request() {
                let hash = request.get("content_hash").cloned();
                remove(request, "content_hash");
                let id = request["request_id"].as_str().unwrap_or_default();
                if let Some(Value::String(hash)) = hash {
                    memory.seen.insert((0, format!("{id} {hash}")));
                }
                return Then::Pass;
            }
            edit_response(passing, |response| {
                let id = format!("{} ", response["request_id"].as_str().unwrap_or_default());
                let hash = memory.seen.iter().find_map(|(_, known)| known.strip_prefix(&id));
                if let (Some(hash), "Accepted") = (hash, response["status"].as_str().unwrap_or_default()) {
                    response["content_hash"] = json!(hash);
                }
            })
        }),
        mutant("sessions are not known", &["session"], |_, passing| {
            for message in ["availability_request", "control_request"] {
                if let Some(inside) = passing.json.get_mut(message)
                    // A session that is too long is still a string that is too long.
                    && inside["session"].as_str().is_some_and(|session| session.len() <= 256)
                {
                    remove(inside, "session");
                }
            }
            Then::Pass
        }),
        mutant("who has the robot is a secret", &["session"], |_, passing| {
            for message in ["availability_response", "control_response"] {
                if let Some(error) = passing.json.pointer_mut(&format!("/{message}/error"))
                    && error["code"] == "busy"
                {
                    error["message"] = json!("not now");
                }
            }
            Then::Pass
        }),
    ]
}

fn of_lines() -> Vec<Mutant> {
    vec![
        mutant("unknown keys are refused", &["unknown-keys"], |_, passing| {
            match passing.is_from_server("x_unknown") && passing.raw.len() < 10_000 {
                true => Then::Answer(malformed()),
                false => Then::Pass,
            }
        }),
        mutant("unknown messages are hung up on", &["unknown-message"], |_, passing| {
            match passing.is_from_server("x_greeting") {
                true => Then::HangUp,
                false => Then::Pass,
            }
        }),
        mutant("what is not JSON is hung up on", &["malformed-line"], |_, passing| {
            match passing.is_from_server("this is not JSON") || passing.is_from_server("noise on the line") {
                true => Then::HangUp,
                false => Then::Pass,
            }
        }),
        mutant("what is not JSON is not answered", &["malformed-line"], |_, passing| {
            match passing.is_from_server("this is not JSON") {
                true => Then::Drop,
                false => Then::Pass,
            }
        }),
        mutant("a word for a number is zero", &["wrong-type"], |_, passing| {
            replace(passing, "\"much\"", "0")
        }),
        mutant("what is not UTF-8 is mended", &["not-utf8"], |_, passing| {
            replace(passing, "\u{fffd}\u{fffd}", "x")
        }),
        mutant("deep nesting is the end", &["deep-nesting"], |_, passing| {
            match passing.is_from_server("[[[[[[[[") {
                true => Then::HangUp,
                false => Then::Pass,
            }
        }),
        mutant("1e999 is a number", &["bad-numbers"], |_, passing| replace(passing, ":1e999", ":0")),
        mutant("NaN is a number", &["bad-numbers"], |_, passing| replace(passing, ":NaN", ":0")),
        mutant("long ids are cut", &["long-strings"], |_, passing| {
            replace(passing, &"x".repeat(257), &"x".repeat(256))
        }),
        mutant("of two keys the last counts", &["duplicate-keys"], |_, passing| {
            replace(passing, TWICE, "{\"control_request\":{")
        }),
        Mutant {
            only: &["malformed-line", "huge-line", "half-line"],
            ..mutant("huge lines are swallowed", &["huge-line"], |_, passing| {
                match passing.way == Way::ToRobot && passing.raw.len() > 17_000_000 {
                    true => Then::Drop,
                    false => Then::Pass,
                }
            })
        },
        Mutant {
            serving: Serving::WithoutBuffer,
            only: &["availability", "range", "malformed-line", "half-line", "reconnect"],
            ..mutant("half a line is taken for one", &["half-line"], pass)
        },
        mutant("empty lines are malformed", &["empty-lines"], |_, passing| {
            match passing.way == Way::ToRobot && passing.raw.trim_ascii().is_empty() {
                true => Then::Answer(malformed()),
                false => Then::Pass,
            }
        }),
    ]
}

fn of_links() -> Vec<Mutant> {
    vec![
        mutant("five hundred messages are enough", &["many-messages"], |memory, passing| {
            if passing.way == Way::ToRobot && passing.json.get("availability_request").is_some() {
                let count = memory.count.entry(passing.link).or_default();
                *count += 1;
                if *count > 500 {
                    return Then::Drop;
                }
            }
            Then::Pass
        }),
        Mutant {
            serving: Serving::UnderOneLock,
            only: &["availability", "two-links", "slow-reader"],
            ..mutant("who does not read holds up all", &["slow-reader"], pass)
        },
        Mutant {
            serving: Serving::AtMost(15),
            only: &["availability", "reconnect"],
            ..mutant("it is tired after fifteen connections", &["reconnect"], pass)
        },
        // What needs a second connection is not applicable then.
        Mutant { serving: Serving::OneByOne, ..mutant("one connection at a time", &["two-links"], pass) },
    ]
}
