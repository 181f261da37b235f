//! Planted faults of a robot that belongs to a session.

use std::time::Instant;

use super::super::proxy::{Memory, Way};
use super::*;

/// Returns the session that is named in a message to the robot.
fn session_of(passing: &Passing) -> Option<String> {
    let names = ["availability_request", "control_request"];
    let mut inside =
        names.iter().filter_map(|name| passing.json.get(name)).filter(|_| passing.way == Way::ToRobot);
    inside.find_map(|inside| inside["session"].as_str().map(str::to_owned))
}

/// Whether this message is a refusal because the robot belongs to another session.
fn is_busy(passing: &Passing) -> bool {
    let names = ["availability_response", "control_response", "inquiry_response"];
    names.iter().any(|name| passing.json[name]["error"]["code"] == "busy")
}

/// Returns the session that was last named on another connection, with that connection and the time.
fn owner<'a>(memory: &'a Memory, passing: &Passing) -> Option<(&'a String, &'a (u64, Instant))> {
    let others = memory.heard.iter().filter(|(_, (link, _))| *link != passing.link);
    others.max_by_key(|(_, (_, at))| *at)
}

fn note(memory: &mut Memory, passing: &Passing) {
    if let Some(session) = session_of(passing) {
        memory.heard.insert(session, (passing.link, Instant::now()));
    }
}

pub fn of_sessions() -> Vec<Mutant> {
    vec![
        mutant("anybody may stop", &["session-stop"], |memory, passing| {
            // A check opens the connection of the stranger before that of the owner. A later connection brings the robot to rest after
            // the check: the owner is gone then, and its name would claim the robot again.
            let present = owner(memory, passing).filter(|(_, (link, _))| *link > passing.link);
            let owner = present.map(|(session, _)| session.clone());
            if let (Some(request), Some(owner)) =
                (passing.request().filter(|request| is_cancel(request)), owner)
            {
                request["session"] = json!(owner);
                return Then::Pass;
            }
            note(memory, passing);
            Then::Pass
        }),
        Mutant {
            only: &["availability", "session", "session-silence", "session-stop"],
            ..mutant("silence never ends a session", &["session-silence"], |_, passing| {
                if unasked(passing) {
                    return Then::Drop;
                }
                match passing.json.pointer("/availability_request/session") {
                    Some(_) => {
                        let beats = (1..=8).map(|second| presence(passing.link, Duration::from_secs(second)));
                        Then::With(beats.collect())
                    }
                    None => Then::Pass,
                }
            })
        },
        Mutant {
            only: &["availability", "session", "session-silence", "session-stop"],
            ..mutant("a second of silence ends a session", &["session-silence"], |memory, passing| {
                let silent =
                    owner(memory, passing).filter(|(_, (_, at))| at.elapsed() > Duration::from_secs(1));
                let silent = silent.map(|(session, _)| session.clone());
                if let Some(silent) = silent
                    && passing.way == Way::ToRobot
                    && let Some(named) = passing.json.pointer_mut("/availability_request/session")
                {
                    *named = json!(silent);
                    return Then::Pass;
                }
                note(memory, passing);
                Then::Pass
            })
        },
        // Reports about the end of a command are sent to the command's connection.
        mutant("reports go to the connection of the command", &["reports-follow"], |memory, passing| {
            let link = passing.link;
            if let Some(request) = passing.request().filter(|request| request.get("session").is_some()) {
                let id = request["request_id"].as_str().unwrap_or_default().to_owned();
                memory.heard.insert(id, (link, Instant::now()));
                return Then::Pass;
            }
            let Some(response) = passing.response() else { return Then::Pass };
            let came_on = memory.heard.get(response["request_id"].as_str().unwrap_or_default());
            match came_on {
                Some((came_on, _)) if *came_on != link && response.get("event_timestamp").is_some() => {
                    Then::On(*came_on)
                }
                _ => Then::Pass,
            }
        }),
        mutant(
            "reports go to the newest connection of the session",
            &["reports-follow"],
            |memory, passing| {
                if let Some(session) = session_of(passing) {
                    let newest =
                        memory.heard.entry(session.clone()).or_insert((passing.link, Instant::now()));
                    newest.0 = newest.0.max(passing.link);
                    if let Some(request) = passing.request() {
                        let id = request["request_id"].as_str().unwrap_or_default();
                        memory.order.push(format!("{session} {id}"));
                    }
                    return Then::Pass;
                }
                let link = passing.link;
                let Some(response) = passing.response() else { return Then::Pass };
                let id = response["request_id"].as_str().unwrap_or_default();
                let session = memory.order.iter().filter_map(|known| known.strip_suffix(id)).next_back();
                let newest = session.and_then(|session| memory.heard.get(session.trim_end()));
                match newest {
                    Some((newest, _)) if *newest != link && response.get("event_timestamp").is_some() => {
                        Then::On(*newest)
                    }
                    _ => Then::Pass,
                }
            },
        ),
    ]
}

pub fn of_leases() -> Vec<Mutant> {
    vec![mutant("a stranger that is refused renews", &["lease-stranger"], |memory, passing| {
        if unasked(passing) {
            return Then::Drop;
        }
        if is_busy(passing) {
            let others = memory.heard.values().map(|(link, _)| *link).filter(|link| *link != passing.link);
            return Then::With(others.map(|link| presence(link, Duration::ZERO)).collect());
        }
        note(memory, passing);
        Then::Pass
    })]
}
