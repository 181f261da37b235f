//! Planted faults in names, lines and connections.

use serde_json::{Value, json};

use super::super::proxy::{Memory, Passing, Serving, TWICE, Then, Way};
use super::*;

/// Makes the robot forget requests: sends those that `is_forgotten` selects under another id, so that the robot treats them as new.
/// `is_noted` selects the responses whose ids are remembered, in the order of their arrival.
fn forgets(
    memory: &mut Memory,
    passing: &mut Passing,
    is_forgotten: fn(&[String], &str) -> bool,
    is_noted: fn(&Value) -> bool,
) -> Then {
    if let Some(request) = passing.request() {
        let id = request["request_id"].as_str().unwrap_or_default().to_owned();
        if is_forgotten(&memory.order, &id) {
            request["request_id"] = json!(format!("{id}#again"));
        }
        return Then::Pass;
    }
    let Some(response) = passing.response() else { return Then::Pass };
    let id = response["request_id"].as_str().unwrap_or_default().to_owned();
    if let Some(id) = id.strip_suffix("#again") {
        response["request_id"] = json!(id);
    } else if is_noted(response) {
        memory.order.push(id);
    }
    Then::Pass
}

pub fn of_identity() -> Vec<Mutant> {
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
            &["repeated-request", "repeated-refusal", "kept-answers"],
            |memory, passing| if repeated(memory, passing) { Then::Drop } else { Then::Pass },
        ),
        mutant(
            "repeated requests are executed again",
            &["repeated-request", "repeated-refusal", "kept-answers"],
            |memory, passing| {
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
            },
        ),
        mutant("eight answers are kept", &["kept-answers"], |memory, passing| {
            forgets(
                memory,
                passing,
                |order, id| {
                    let behind = order.iter().rposition(|ended| ended == id);
                    behind.is_some_and(|index| order.len() - index > 8)
                },
                |response| ["OK", "Failed"].contains(&response["status"].as_str().unwrap_or_default()),
            )
        }),
        mutant("refusals are not kept", &["repeated-refusal"], |memory, passing| {
            forgets(
                memory,
                passing,
                |order, id| order.iter().any(|refused| refused == id),
                |response| response["status"] == "Failed" && response.get("steps_done").is_none(),
            )
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
        mutant("hashes are echoed unread", &["content-hash", "inquiry-hash"], |memory, passing| {
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
        mutant(
            "sessions are unknown",
            &["session", "session-reading", "session-stop", "reports-follow", "inquiry-session"],
            |_, passing| {
                for message in ["availability_request", "control_request"] {
                    if let Some(inside) = passing.json.get_mut(message)
                    // A session that is too long is still a string that is too long.
                    && inside["session"].as_str().is_some_and(|session| session.len() <= 256)
                    {
                        remove(inside, "session");
                    }
                }
                Then::Pass
            },
        ),
        mutant("the owner of the robot is revealed", &["session"], |memory, passing| {
            if let Some(session) =
                passing.json.pointer("/availability_request/session").and_then(Value::as_str)
            {
                memory.seen.insert((u64::MAX, session.to_owned()));
            }
            let sessions =
                memory.seen.iter().filter(|(link, _)| *link == u64::MAX).map(|(_, name)| name.as_str());
            let sessions: Vec<&str> = sessions.collect();
            for message in ["availability_response", "control_response"] {
                if let Some(error) = passing.json.pointer_mut(&format!("/{message}/error"))
                    && error["code"] == "busy"
                {
                    error["message"] = json!(format!("not now: {}", sessions.join(", ")));
                }
            }
            Then::Pass
        }),
    ]
}

pub fn of_lines() -> Vec<Mutant> {
    vec![
        mutant("unknown keys are refused", &["unknown-keys"], |_, passing| {
            if passing.is_from_server("x_unknown") && passing.raw.len() < 10_000 {
                Then::Answer(malformed())
            } else {
                Then::Pass
            }
        }),
        mutant("unknown messages are hung up on", &["unknown-message"], |_, passing| {
            if passing.is_from_server("x_greeting") { Then::HangUp } else { Then::Pass }
        }),
        mutant("what is not JSON is hung up on", &["malformed-line"], |_, passing| {
            if passing.is_from_server("this is not JSON") || passing.is_from_server("noise on the line") {
                Then::HangUp
            } else {
                Then::Pass
            }
        }),
        mutant("what is not JSON is not answered", &["malformed-line"], |_, passing| {
            if passing.is_from_server("this is not JSON") { Then::Drop } else { Then::Pass }
        }),
        mutant("a word for a number is zero", &["wrong-type"], |_, passing| {
            replace(passing, "\"much\"", "0")
        }),
        mutant("what is not UTF-8 is fixed", &["not-utf8"], |_, passing| {
            replace(passing, "\u{fffd}\u{fffd}", "x")
        }),
        mutant("deep nesting is the end", &["deep-nesting"], |_, passing| {
            if passing.is_from_server("[[[[[[[[") { Then::HangUp } else { Then::Pass }
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
                if passing.way == Way::ToRobot && passing.raw.len() > 17_000_000 {
                    Then::Drop
                } else {
                    Then::Pass
                }
            })
        },
        Mutant {
            serving: Serving::WithoutBuffer,
            only: &["availability", "range", "malformed-line", "half-line", "reconnect"],
            ..mutant("half a line is taken for one", &["half-line"], pass)
        },
        mutant("empty lines are malformed", &["empty-lines"], |_, passing| {
            if passing.way == Way::ToRobot && passing.raw.trim_ascii().is_empty() {
                Then::Answer(malformed())
            } else {
                Then::Pass
            }
        }),
    ]
}

pub fn of_links() -> Vec<Mutant> {
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
            ..mutant("a peer that does not read delays all others", &["slow-reader"], pass)
        },
        Mutant {
            serving: Serving::AtMost(15),
            only: &["availability", "reconnect"],
            ..mutant("it is tired after fifteen connections", &["reconnect"], pass)
        },
        Mutant {
            serving: Serving::AtATime(16),
            only: &["availability", "two-links", "silent-peers"],
            ..mutant("sixteen silent peers are all it serves", &["silent-peers"], pass)
        },
        // Requirements with a second connection are then not applicable.
        Mutant {
            serving: Serving::OneByOne,
            ..mutant("one connection at a time", &["initialization", "two-links"], pass)
        },
    ]
}
