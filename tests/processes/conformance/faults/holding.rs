//! Planted faults in leases and stops.

use serde_json::{Value, json};

use super::super::proxy::{Passing, Then, Way};
use super::*;

pub fn of_leases() -> Vec<Mutant> {
    fn with_lease(passing: &mut Passing, change: impl Fn(&mut Value)) -> Then {
        edit(passing, |request| {
            if request.get("stop_condition").is_some() {
                change(&mut request["stop_condition"]);
            }
        })
    }
    vec![
        // All requirements that depend on the end of a lease; a step's own limit still applies.
        mutant(
            "stop_condition is not read",
            &[
                "lease-pending",
                "lease-running",
                "lease-silence",
                "lease-queued",
                "lease-noise",
                "lease-link-down",
                "lease-two-links",
                "lease-stranger",
            ],
            |_, passing| edit(passing, |request| remove(request, "stop_condition")),
        ),
        mutant("leases end with the start", &["lease-running", "lease-silence"], |_, passing| {
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
            &["lease-pending", "lease-noise", "lease-link-down", "lease-two-links", "lease-stranger"],
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
        mutant("leases count from the start", &["lease-silence"], |_, passing| {
            if unasked(passing) {
                return Then::Drop;
            }
            let link = passing.link;
            match passing.request() {
                Some(request)
                    if offset(request) >= 500.0 && offset(request) < 5_000.0 && !is_cancel(request) =>
                {
                    let start = Duration::from_secs_f64((offset(request) - 5.0) / 1e3);
                    Then::With(vec![presence(link, start)])
                }
                _ => Then::Pass,
            }
        }),
        mutant("a step's lease counts from the step", &["lease-silence"], |_, passing| {
            if unasked(passing) {
                return Then::Drop;
            }
            let link = passing.link;
            let Some(request) = passing.request() else { return Then::Pass };
            let start = offset(request);
            let steps = request["control_value"].as_array().into_iter().flatten();
            let leased = steps.filter(|step| step.get("stop_condition").is_some() && offset(step) > 0.0);
            let before = |step: &Value| Duration::from_secs_f64((start + offset(step) - 5.0) / 1e3);
            Then::With(leased.map(|step| presence(link, before(step))).collect())
        }),
        mutant("running null means as pending", &["lease-pair"], |_, passing| {
            with_lease(passing, |lease| {
                if lease.get("running").is_some_and(Value::is_null) {
                    *lease = lease["pending"].clone();
                }
            })
        }),
        mutant("a step's own lease is not read", &["lease-silence", "lease-step"], |_, passing| {
            edit(passing, |request| {
                for step in request["control_value"].as_array_mut().into_iter().flatten() {
                    remove(step, "stop_condition");
                }
            })
        }),
        Mutant {
            robot: Robot::Rover,
            ..mutant(
                "a speed that is left on has no lease",
                &["lease-left-on", "lease-left-on-kept"],
                |_, passing| {
                    edit(passing, |request| {
                        if request["control_type"] == "speed" && request.get("time_offset_to_start").is_none()
                        {
                            remove(request, "stop_condition");
                        }
                    })
                },
            )
        },
        Mutant {
            robot: Robot::Rover,
            ..mutant(
                "any other command ends the lease of a continuing speed",
                &["lease-left-on-kept"],
                |memory, passing| {
                    if let Some(request) = passing.request() {
                        memory.order.extend(request["request_id"].as_str().map(str::to_owned));
                        return Then::Pass;
                    }
                    let Some(response) = passing.response() else { return Then::Pass };
                    let id = response["request_id"].as_str().unwrap_or_default().to_owned();
                    let last = memory.order.last() == Some(&id);
                    match response["status"].as_str() {
                        Some("OK") => drop(memory.seen.insert((0, id))),
                        Some("Failed") if memory.seen.contains(&(0, id)) && !last => return Then::Drop,
                        _ => {}
                    }
                    Then::Pass
                },
            )
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
            if unasked(passing) {
                Then::Instead(format!("{}\n", malformed()).into_bytes())
            } else {
                Then::Pass
            }
        }),
        mutant(
            "requests on another connection are forgotten",
            &["lease-link-down", "reports-follow"],
            |_, passing| {
                let mark = format!("#{}", passing.link);
                let way = passing.way;
                for id in passing
                    .json
                    .pointer_mut("/inquiry/requests")
                    .and_then(Value::as_array_mut)
                    .into_iter()
                    .flatten()
                {
                    *id = json!(format!("{}{mark}", id.as_str().unwrap_or_default()));
                }
                let told =
                    passing.json.pointer_mut("/inquiry_response/requests").and_then(Value::as_array_mut);
                for report in told.into_iter().flatten() {
                    let id = report["request_id"].as_str().unwrap_or_default();
                    report["request_id"] = json!(id.replace(&mark, ""));
                }
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
            },
        ),
        // By a session that all peers share, so that `session` itself cannot be judged.
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

pub fn of_stops() -> Vec<Mutant> {
    vec![
        // Each of them waits for an effect of a stop; `hold` and `take-back` are stops too.
        Mutant {
            only: &[
                "availability",
                "late",
                "lease-pending",
                "cancel-pending",
                "cancel-from",
                "cancel-running",
                "home",
                "take-back",
                "no-request-id",
            ],
            ..mutant(
                "stops are answered and not done",
                &["cancel-pending", "cancel-from", "cancel-running", "home", "take-back"],
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
        mutant("home is not understood", &["home"], |_, passing| match passing.request() {
            Some(request) if request.get("home").is_some() => {
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
