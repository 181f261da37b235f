//! Checks of the keys and values of control responses, and of their order.

use serde_json::Value;
use urrcp::{ErrorCode, Span, Status};

use super::heard::Ticket;
use super::line::Line;
use super::requirement::{Checked, Requirement, Unmet, differs, pass};
use super::stopping::cancels;
use super::trial::{LATER_MS, LEASE_MS, Shaped, Trial};

pub(super) const ALL: [Requirement; 4] = [
    Requirement {
        name: "response-keys",
        number: "core-22",
        demands: "Every control response has its required keys: always timestamp, device_id, status and status_value, an error with code and message if and only if it is `Failed`, and in reports event_timestamp, steps_done and late_steps.",
        section: "Control response",
        check: response_keys,
    },
    Requirement {
        name: "failed-report",
        number: "script-12",
        demands: "The report of a command that ended early has the status_value null, its event_timestamp, and the number of executed steps as steps_done.",
        section: "Reports (D)",
        check: failed_report,
    },
    Requirement {
        name: "script-values",
        number: "script-13",
        demands: "The status_value of a script is its first value in `Started` and its last one in `OK`.",
        section: "Control response",
        check: script_values,
    },
    Requirement {
        name: "stop-after-reports",
        number: "reports-2",
        demands: "The `OK` to an empty script follows the reports of all commands that it ends.",
        section: "Cancelling (D)",
        check: after_reports,
    },
];

/// Checks that a response has its required keys with values of the right type. Returns the first violation.
fn fault(text: &str) -> Option<String> {
    let json: Value = serde_json::from_str(text).ok()?;
    let response = json.get("control_response")?;
    let status = response["status"].as_str().unwrap_or_default();
    let is_report = response.get("event_timestamp").is_some_and(|at| !at.is_null());
    let mut required = vec!["timestamp", "device_id", "status", "status_value"];
    match status {
        "Started" => required.push("event_timestamp"),
        "OK" if !response["status_value"].is_null() => {
            required.extend(["event_timestamp", "steps_done", "late_steps"]);
        }
        "Failed" => required.push("error"),
        _ => {}
    }
    if let Some(missing) = required.into_iter().find(|key| response.get(key).is_none()) {
        return Some(format!("the key `{missing}` with `{status}`"));
    }
    let error = response.get("error").filter(|error| !error.is_null());
    match error {
        Some(_) if status != "Failed" => Some(format!("no key `error` with `{status}`")),
        Some(error) if !error["code"].is_string() || !error["message"].is_string() => {
            Some("an error with `code` and `message`".to_owned())
        }
        Some(_) if !is_report && !response["status_value"].is_null() => {
            Some("the status_value null in a refusal".to_owned())
        }
        _ => None,
    }
}

fn has_its_keys(line: &Line, ticket: Ticket) -> Result<(), Unmet> {
    let asked = line.asked(ticket);
    let wrong = asked.heard.iter().find_map(|heard| Some((heard, fault(&heard.text)?)));
    wrong.map_or(Ok(()), |(heard, expected)| Err(differs(&asked.text, &heard.text, &expected)))
}

fn response_keys(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let done = line.held(&trial.set(actor, actor.rest).leased(LEASE_MS))?;
    if trial.reports() {
        line.report(done, &Status::Ok, trial.patience())?;
    }
    let cancelled = line.held(&trial.pending(actor))?;
    let stop = line.ask(&trial.cancel(actor))?;
    line.answer(stop)?;
    line.ends(cancelled, ErrorCode::Cancelled)?;
    let refused = line.ask(&trial.refusable(actor).request)?;
    line.answer(refused)?;
    let id = trial.fresh_id();
    let malformed = format!(
        "{{\"control_request\":{{\"device_id\":{},\"request_id\":\"{id}\",\"control_type\":7,\"control_value\":1}}}}\n",
        serde_json::json!(actor.device.id)
    );
    let malformed = line.ask_text(Some(id), actor.device.id.as_str(), &malformed)?;
    line.answer(malformed)?;
    [done, cancelled, stop, refused, malformed].iter().try_for_each(|ticket| has_its_keys(&line, *ticket))?;
    pass()
}

fn failed_report(trial: &Trial) -> Checked {
    trial.reporting()?;
    let actor = trial.scripted()?;
    let mut line = trial.connect()?;
    let script = trial.script(actor, &[(0.0, actor.rest), (50.0, actor.near), (4_000.0, actor.rest)]);
    let running = line.held(&script.starting_in(100.0).leased(LEASE_MS))?;
    line.report(running, &Status::Started, trial.patience())?;
    line.listen(trial.soon(150), |_| false)?;
    line.ends_after(running, &trial.cancel(actor), 1..=2)?;
    let pending = line.held(&trial.pending(actor))?;
    line.ends_after(pending, &trial.cancel(actor), 0..=0)?;
    pass()
}

fn script_values(trial: &Trial) -> Checked {
    trial.reporting()?;
    let actor = trial.scripted()?;
    let mut line = trial.connect()?;
    let script = trial.script(actor, &[(0.0, actor.near), (50.0, actor.near), (100.0, actor.rest)]);
    let ticket = line.held(&script.starting_in(100.0).leased(LEASE_MS))?;
    for (status, value) in [(Status::Started, actor.near), (Status::Ok, actor.rest)] {
        let report = line.report(ticket, &status, trial.patience() + Span::from_millis(300))?;
        let stated = match report.message.status_value {
            urrcp::StatusValue::Number(stated) => Some(stated),
            _ => None,
        };
        if stated.is_none_or(|stated| (stated - value).abs() > 1e-9 * value.abs().max(1.0)) {
            return Err(differs(&line.asked(ticket).text, &report.text, &format!("status_value {value}")));
        }
    }
    pass()
}

fn after_reports(trial: &Trial) -> Checked {
    trial.reporting()?;
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let mut tickets = vec![line.held(&trial.pending(actor))?];
    if actor.device.script_queue >= 2 {
        tickets.push(line.held(&trial.pending(actor).starting_in(LATER_MS + 1_000.0))?);
    }
    let stop = line.ask(&trial.cancel(actor))?;
    let answer = line.answer(stop)?;
    for ticket in tickets {
        if line.is_held_until(ticket, stop) {
            let sent = format!("{}, then {}", line.asked(ticket).text.trim_end(), line.asked(stop).text);
            let came = format!("{} before the report of the command", answer.text);
            return Err(differs(&sent, &came, "the report `Failed` of the command, and then this `OK`"));
        }
    }
    cancels(trial, &mut line, &trial.cancel(actor))?;
    pass()
}
