//! Planted faults in the greeting, in the values that a robot accepts, and in its starts.

use std::time::Duration;

use serde_json::{Value, json};

use super::super::proxy::{Fault, Passing, Then, Way};
use super::*;

pub fn of_greeting() -> Vec<Mutant> {
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
        mutant("no readable block, so the robot is otherwise unknown", &["initialization"], |_, passing| {
            declare(passing, |device| device["id"] = json!("x".repeat(300)))
        }),
        mutant("a peer that does not greet is disconnected", &["skip-handshake"], |memory, passing| {
            if passing.way == Way::ToRobot && passing.json.get("initialization_request").is_some() {
                memory.seen.insert((passing.link, String::new()));
            }
            let greeted = memory.seen.contains(&(passing.link, String::new()));
            if passing.request().is_some() && !greeted { Then::HangUp } else { Then::Pass }
        }),
        Mutant { robot: Robot::ClockAhead, ..mutant("the clock is two seconds ahead", &["clock"], pass) },
    ]
}

pub fn of_values() -> Vec<Mutant> {
    let mut all = vec![
        // A limit for plain values also applies to steps.
        mutant(
            "less is declared than it takes",
            &["range", "script-range", "repeated-refusal", "kept-answers"],
            |_, passing| {
                declare(passing, |device| {
                    device["available_control_types"]["position"]["max_value"] = json!(80)
                })
            },
        ),
        mutant("more is declared than it takes", &["range"], |_, passing| {
            declare(passing, |device| device["available_control_types"]["position"]["max_value"] = json!(120))
        }),
        // The same applies to the grid.
        mutant("a coarser grid is declared", &["granularity", "script-range"], |_, passing| {
            declare(passing, |device| device["available_control_types"]["position"]["granularity"] = json!(1))
        }),
        mutant("steps out of range are cut to it", &["script-range"], |_, passing| {
            edit(passing, |request| {
                for step in steps_of(request) {
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
        mutant("an unknown control type is malformed", &["unknown-control-type"], |_, passing| match passing
            .request()
        {
            Some(request) if request["control_type"] == "no_such_control" => {
                Then::Answer(answer(request, "Failed", "malformed"))
            }
            _ => Then::Pass,
        }),
        mutant(
            "an unknown control type with a list or a text is malformed",
            &["unknown-control-type"],
            |_, passing| match passing.request() {
                Some(request)
                    if request["control_type"] == "no_such_control"
                        && !request["control_value"].is_number() =>
                {
                    Then::Answer(answer(request, "Failed", "malformed"))
                }
                _ => Then::Pass,
            },
        ),
        mutant(
            "an unknown control type with a text leaves what is pending",
            &["unknown-control-type"],
            |_, passing| match passing.request() {
                Some(request)
                    if request["control_type"] == "no_such_control"
                        && request["control_value"].is_string() =>
                {
                    Then::Answer(answer(request, "Failed", "unsupported_control_type"))
                }
                _ => Then::Pass,
            },
        ),
        mutant("every step is taken for a position", &["script-control-types"], |_, passing| {
            edit(passing, |request| {
                for step in steps_of(request) {
                    step["control_type"] = json!("position");
                }
            })
        }),
        mutant("readings are refused without regard to the owner", &["session-reading"], |_, passing| {
            match passing.request() {
                Some(request) if request["control_type"] == "sensor" => {
                    Then::Answer(answer(request, "Failed", "unsupported_control_type"))
                }
                _ => Then::Pass,
            }
        }),
        // A reading of its owner's device also succeeds.
        mutant("everything reads something", &["sensor-not-a-sensor", "session-reading"], |_, passing| {
            match passing.request() {
                Some(request) if request["control_type"] == "sensor" => {
                    Then::Answer(answer(request, "Provide", ""))
                }
                _ => Then::Pass,
            }
        }),
        // Three of the requirements are recognised by this code.
        mutant(
            "unsupported control types have a code of their own",
            &[
                "unsupported-control-type",
                "unknown-control-type",
                "script-control-types",
                "sensor-not-a-sensor",
            ],
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

/// Returns the steps of a script.
fn steps_of(request: &mut Value) -> impl Iterator<Item = &mut Value> {
    let listed = request["control_value"].as_array_mut().into_iter().flatten();
    listed.filter(|step| step.is_object())
}

/// Returns how long ago a request was due to start; `None` if its start is in the future or missing.
fn passed_by(request: &Value) -> Option<urrcp::Span> {
    let sent: urrcp::Timestamp<urrcp::Server> = serde_json::from_value(request["timestamp"].clone()).ok()?;
    let start = sent + urrcp::Span::from_millis_f64(Some(offset(request)).filter(|ms| *ms >= 0.0)?);
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).ok()?;
    let now = urrcp::Timestamp::from_nanos(i64::try_from(since.as_nanos()).ok()?);
    Some(now - start).filter(|passed| *passed > urrcp::Span::ZERO)
}

/// Shifts the reported start of each script whose first value is due 300 ms after its start, by this many milliseconds.
fn start_of_later_scripts(memory: &mut Memory, passing: &mut Passing, by: i64) -> Then {
    if let Some(request) = passing.request() {
        if steps_of(request).next().is_some_and(|step| offset(step) == 300.0) {
            memory.order.extend(request["request_id"].as_str().map(str::to_owned));
        }
        return Then::Pass;
    }
    edit_response(passing, |response| {
        let later = memory.order.iter().any(|id| response["request_id"] == id.as_str());
        if later && response["status"] == "Started" {
            shift(&mut response["event_timestamp"], by);
        }
    })
}

pub fn of_times() -> Vec<Mutant> {
    fn shifted(passing: &mut Passing, by: f64) -> Then {
        edit(passing, |request| {
            if !is_script(request) && (0.0..5_000.0).contains(&offset(request)) && !is_cancel(request) {
                request["time_offset_to_start"] = json!(offset(request) + by);
            }
        })
    }
    vec![
        mutant("starts come 400 ms late", &["deferred-start", "late-by-little"], |_, passing| {
            shifted(passing, 400.0)
        }),
        mutant("starts come 200 ms early", &["deferred-start"], |_, passing| shifted(passing, -200.0)),
        // Without the start time, neither the start nor the script's length can be judged.
        mutant(
            "starts are reported without their time",
            &["deferred-start", "script-start", "script-timing"],
            |_, passing| {
                edit_response(passing, |response| {
                    if response["status"] == "Started" {
                        remove(response, "event_timestamp");
                    }
                })
            },
        ),
        mutant("a linear movement to the first value is no start", &["script-start"], |memory, passing| {
            start_of_later_scripts(memory, passing, 300)
        }),
        Mutant {
            robot: Robot::Rover,
            ..mutant(
                "a script is reported as started before its first value",
                &["script-start"],
                |memory, passing| start_of_later_scripts(memory, passing, -300),
            )
        },
        mutant("at once means in half a second", &["immediate-start"], |_, passing| {
            edit(passing, |request| {
                if request.get("time_offset_to_start").is_none() && !is_cancel(request) {
                    request["time_offset_to_start"] = json!(500);
                }
            })
        }),
        mutant("late commands are played at once", &["late", "late-by-little"], |_, passing| {
            edit(passing, |request| {
                if offset(request) == 1_000.0 {
                    remove(request, "time_offset_to_start");
                }
            })
        }),
        mutant("starts are taken up to 150 ms late", &["late-by-little"], |_, passing| {
            edit(passing, |request| {
                if passed_by(request).is_some_and(|passed| passed <= urrcp::Span::from_millis(150)) {
                    remove(request, "time_offset_to_start");
                }
            })
        }),
        mutant("late scripts begin in their middle", &["late-by-little"], |_, passing| {
            edit(passing, |request| {
                if is_script(request) && passed_by(request).is_some() {
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
        mutant("stops are answered with a value", &["status-value"], |memory, passing| {
            if let Some(request) = passing.request() {
                let id = request["request_id"].as_str().filter(|_| is_cancel(request)).map(str::to_owned);
                memory.order.extend(id);
                return Then::Pass;
            }
            edit_response(passing, |response| {
                let stops = memory.order.iter().any(|id| response["request_id"] == id.as_str());
                if stops && response["status"] == "OK" {
                    response["status_value"] = json!(0);
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
        mutant("one step too few is reported", &["script-timing"], |_, passing| {
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
        // The reported room is that of the true queue.
        mutant("a longer queue is declared than there is", &["queue", "inquiry-room"], |_, passing| {
            declare(passing, |device| device["script_queue"] = json!(3))
        }),
        mutant("a shorter queue is declared than there is", &["queue", "inquiry-room"], |_, passing| {
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
