//! Planted faults in the answers to inquiries.

use serde_json::{Value, json};

use super::super::proxy::{Passing, Then, Way};
use super::*;

/// Edits an answer to an inquiry, and passes the line.
fn edit_answer(passing: &mut Passing, edit: impl Fn(&mut Value)) -> Then {
    if let Some(answer) = passing.json.get_mut("inquiry_response") {
        edit(answer);
    }
    Then::Pass
}

/// Edits an answer to an inquiry: all of its reports about requests in this state.
fn edit_told(passing: &mut Passing, state: &str, edit: impl Fn(&mut Value)) -> Then {
    edit_answer(passing, |answer| {
        let told = answer.get_mut("requests").and_then(Value::as_array_mut).into_iter().flatten();
        told.filter(|report| report["state"] == state).for_each(&edit);
    })
}

fn inquiry(passing: &Passing) -> Option<&Value> {
    passing.json.get("inquiry").filter(|_| passing.way == Way::ToRobot)
}

/// Passes the received line after `line`.
fn after(line: &Value, passing: &Passing) -> Then {
    let mut bytes = format!("{line}\n").into_bytes();
    bytes.extend_from_slice(&passing.raw);
    Then::Instead(bytes)
}

pub fn of_inquiries() -> Vec<Mutant> {
    vec![
        mutant("inquiry answers come in reverse order", &["inquiry"], |_, passing| {
            edit_answer(passing, |answer| {
                if let Some(told) = answer.get_mut("requests").and_then(Value::as_array_mut) {
                    told.reverse();
                }
            })
        }),
        mutant("the time of an inquiry is not echoed", &["inquiry"], |_, passing| {
            edit_answer(passing, |answer| remove(answer, "originate_timestamp"))
        }),
        mutant("an inquiry is answered by a clock that is behind", &["inquiry"], |_, passing| {
            edit_answer(passing, |answer| {
                shift(&mut answer["receive_timestamp"], -1_000);
                shift(&mut answer["timestamp"], -1_000);
            })
        }),
        mutant("the planned start is reported a second late", &["inquiry-held"], |_, passing| {
            edit_told(passing, "held", |report| {
                shift(&mut report["start_timestamp"], 1_000);
            })
        }),
        Mutant {
            robot: Robot::Rover,
            ..mutant(
                "a script that waits for its first value is reported as started",
                &["inquiry-running"],
                |_, passing| {
                    edit_told(passing, "running", |report| {
                        report["event_timestamp"] = report["start_timestamp"].clone();
                    })
                },
            )
        },
        mutant("steps are reported only when all are done", &["inquiry-running"], |_, passing| {
            edit_told(passing, "running", |report| report["steps_done"] = json!(0))
        }),
        mutant("why something ended is not told", &["inquiry-ended"], |_, passing| {
            edit_told(passing, "ended", |report| remove(report, "error"))
        }),
        mutant("the hash of a held script is not reported", &["inquiry-hash"], |_, passing| {
            edit_told(passing, "held", |report| remove(report, "content_hash"))
        }),
        mutant("the room ignores held scripts", &["inquiry-room"], |_, passing| {
            edit_answer(passing, |answer| {
                for device in answer.get_mut("devices").and_then(Value::as_array_mut).into_iter().flatten() {
                    device["room"] = json!(2);
                }
            })
        }),
        mutant("the position is not the one commanded last", &["inquiry-position"], |_, passing| {
            edit_answer(passing, |answer| {
                for device in answer.get_mut("devices").and_then(Value::as_array_mut).into_iter().flatten() {
                    if let Some(position) = device.get_mut("position") {
                        *position = json!(position.as_f64().unwrap_or_default() + 7.0);
                    }
                }
            })
        }),
        // As a probe by an empty script once did.
        mutant("an inquiry about something unknown cancels", &["inquiry-no-effect"], |_, passing| {
            let Some(asked) = inquiry(passing) else { return Then::Pass };
            let (Some(device), Some(request)) = (asked["devices"].get(0), asked["requests"].get(1)) else {
                return Then::Pass;
            };
            let probe = json!({"control_request": {"device_id": device, "request_id": request,
                "control_type": "script", "control_value": []}});
            after(&probe, passing)
        }),
        mutant("an inquiry claims the robot", &["inquiry-session"], |_, passing| {
            match inquiry(passing).and_then(|asked| asked.get("session")) {
                Some(session) => after(&json!({"availability_request": {"session": session}}), passing),
                None => Then::Pass,
            }
        }),
        mutant("every peer receives all answers", &["inquiry-session"], |_, passing| {
            edit_answer(passing, |answer| {
                if answer["error"]["code"] == "busy" {
                    answer["status"] = json!("OK");
                    remove(answer, "error");
                }
            })
        }),
    ]
}

pub fn of_leases() -> Vec<Mutant> {
    vec![
        mutant("inquiries renew nothing", &["lease-inquiry"], |_, passing| match inquiry(passing) {
            Some(asked) if asked.get("requests").is_none() && asked["timestamp"].is_string() => {
                let now = &asked["timestamp"];
                Then::Answer(json!({"inquiry_response": {
                    "originate_timestamp": now, "receive_timestamp": now, "timestamp": now, "status": "OK"}}))
            }
            _ => Then::Pass,
        }),
        mutant("pending_lease is not read", &["lease-inquiry-pending"], |_, passing| {
            if passing.way == Way::ToRobot
                && let Some(asked) = passing.json.get_mut("inquiry")
            {
                remove(asked, "pending_lease");
            }
            Then::Pass
        }),
        mutant(
            "pending_lease counts for what is not named",
            &["lease-inquiry-pending"],
            |memory, passing| {
                if let Some(request) = passing.request()
                    && !is_cancel(request)
                    && let Some(id) = request["request_id"].as_str()
                {
                    memory.seen.insert((0, id.to_owned()));
                }
                if passing.way == Way::ToRobot
                    && let Some(asked) = passing.json.get_mut("inquiry")
                    && asked["pending_lease"] == 300
                {
                    asked["requests"] = json!(memory.seen.iter().map(|(_, id)| id).collect::<Vec<_>>());
                }
                Then::Pass
            },
        ),
        Mutant {
            only: &["lease-inquiry-until"],
            ..mutant("pending_until is never moved", &["lease-inquiry-until"], |memory, passing| {
                if passing.way == Way::ToRobot
                    && let Some(asked) = passing.json.get_mut("inquiry")
                    && let Some(until) = asked["pending_until"].as_str().map(str::to_owned)
                {
                    memory.seen.insert((1, until));
                    let first = memory.seen.iter().map(|(_, until)| until).min();
                    first.into_iter().for_each(|first| asked["pending_until"] = json!(first));
                }
                Then::Pass
            })
        },
        Mutant {
            only: &["lease-inquiry-until", "lease-until"],
            ..mutant(
                "an inquiry lifts pending_until",
                &["lease-inquiry-until", "lease-until"],
                |_, passing| {
                    if passing.way == Way::ToRobot
                        && let Some(asked) = passing.json.get_mut("inquiry")
                        && asked.get("pending_until").is_none()
                    {
                        asked["pending_until"] = json!("2200-01-01T00:00:00Z");
                    }
                    Then::Pass
                },
            )
        },
        mutant("the pending_until of requests is not read", &["lease-until"], |_, passing| {
            if passing.way == Way::ToRobot
                && let Some(request) = passing.json.get_mut("control_request")
            {
                remove(request, "pending_until");
            }
            Then::Pass
        }),
        // The report of the queued one is lost as well.
        mutant("the end of a pending lease ends what runs", &["lease-queued"], |memory, passing| {
            let Some(report) = passing.response() else { return Then::Pass };
            let id = report["request_id"].as_str().unwrap_or_default().to_owned();
            match report["status"].as_str() {
                Some("Started") => memory.running = memory.seen.insert((0, id)),
                Some("OK") if report.get("steps_done").is_some() => memory.running = false,
                Some("Failed") if report["error"]["code"] == "link_lost" => {
                    if memory.running && !memory.seen.contains(&(0, id)) {
                        let device = report["device_id"].clone();
                        return Then::Answer(json!({"control_request": {"device_id": device,
                            "control_type": "script", "control_value": []}}));
                    }
                    memory.running = false;
                }
                Some("Failed") => memory.running = false,
                _ => {}
            }
            Then::Pass
        }),
    ]
}
