//! Checks of the start of commands and of the robot's reports on it.

use urrcp::{Command, ControlRequest, ErrorCode, Span, Status, StatusValue};

use super::actor::Actor;
use super::greeting::compare_clocks;
use super::heard::Ticket;
use super::line::Line;
use super::requirement::{Checked, Requirement, Unmet, differs, pass};
use super::trial::{LEASE_MS, Shaped, Trial};

pub(super) const ALL: [Requirement; 6] = [
    Requirement {
        name: "deferred-start",
        number: "reports-1",
        demands: "A command starts at timestamp + time_offset_to_start by the robot's clock, within the tolerance and never early.",
        section: "Time (D)",
        check: deferred_start,
    },
    Requirement {
        name: "script-start",
        number: "script-4",
        demands: "If the first value of a script is due after its start, a device with `hold` reports `Started` when that value is due; with `linear`, at the start.",
        section: "Reports (D)",
        check: script_start,
    },
    Requirement {
        name: "immediate-start",
        number: "core-14",
        demands: "A command without time_offset_to_start is accepted and starts as soon as it is received.",
        section: "Control request",
        check: immediate_start,
    },
    Requirement {
        name: "late",
        number: "core-15",
        demands: "A command that arrives after its start is refused with `late` and not executed.",
        section: "Time (D)",
        check: late,
    },
    Requirement {
        name: "late-by-little",
        number: "core-16",
        demands: "A command that arrives only a few milliseconds after its start is refused with `late` as well, even a script whose other steps are still in the future.",
        section: "Time (D)",
        check: late_by_little,
    },
    Requirement {
        name: "status-value",
        number: "core-17",
        demands: "The status_value is the accepted value in `Accepted`, the first value set in `Started` and the last one in `OK`; it is null in a refusal and in the `OK` to an empty script.",
        section: "Control response",
        check: status_value,
    },
];

/// Maximum time by which a robot may report a start early, because of rounding.
pub(super) const EARLY_MAX: Span = Span::from_millis(1);
/// Time in milliseconds from a request's timestamp to the planned start, in checks that judge the start.
const SOON_MS: f64 = 400.0;

fn deferred_start(trial: &Trial) -> Checked {
    trial.reporting()?;
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let request = trial.set(actor, actor.rest).starting_in(SOON_MS).leased(LEASE_MS);
    starts(trial, &mut line, &request, Span::ZERO)
}

/// Offset of the first script step in milliseconds, long enough to distinguish that step from the start of the script.
const FIRST_MS: f64 = 300.0;

fn script_start(trial: &Trial) -> Checked {
    trial.reporting()?;
    let actor = trial.scripted()?;
    let mut line = trial.connect()?;
    let request = trial.script(actor, &[(FIRST_MS, actor.rest)]).starting_in(SOON_MS).leased(LEASE_MS);
    starts(trial, &mut line, &request, until_started(actor, &request))
}

/// Returns the time from a request's scheduled start to the instant at which the robot has to report the start.
pub(super) fn until_started(actor: &Actor, request: &ControlRequest) -> Span {
    match &request.command {
        Command::Script(script) => script.until_started(actor.device.interpolation),
        _ => Span::ZERO,
    }
}

/// Sends a request, and checks that the robot reports it as started in time. The report is due `after` the scheduled start of the
/// request.
fn starts(trial: &Trial, line: &mut Line, request: &ControlRequest, after: Span) -> Checked {
    let planned = request.starts_at().map(|start| (start + after).assume_clock::<urrcp::Robot>());
    let ticket = line.held(request)?;
    let sent = line.asked(ticket).text.clone();
    let started = line.report(ticket, &Status::Started, trial.patience())?;
    let (Some(planned), Some(at)) = (planned, started.message.event_timestamp) else {
        return Err(differs(&sent, &started.text, "an event_timestamp with the actual start of the command"));
    };
    let error = at - planned;
    let tolerance = trial.options().tolerance;
    if error < -EARLY_MAX || error > tolerance {
        let expected =
            format!("an event_timestamp from {planned} to {tolerance} later; it is off by {error}");
        return Err(differs(&sent, &started.text, &expected));
    }
    // A report that arrives before the start is due is false, regardless of the timestamp in it.
    let arrived = started.at + trial.shift - planned.assume_clock();
    let clocks = Span::from_millis(50);
    if arrived < -clocks {
        let expected = format!("no report before the start; it came {} early", arrived.abs());
        return Err(differs(&sent, &started.text, &expected));
    }
    Ok(format!("started {error} after the scheduled time"))
}

fn immediate_start(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let ticket = line.held(&trial.set(actor, actor.rest).leased(LEASE_MS))?;
    if !trial.reports() {
        return Ok("accepted; without `reports`, it is unknown whether it started".to_owned());
    }
    let accepted = line.answer(ticket)?;
    let started = line.report(ticket, &Status::Started, trial.patience())?;
    let took = started.at - accepted.at;
    if took > trial.slack() {
        let came = format!("{} {took} after `Accepted`", started.text);
        return Err(differs(&line.asked(ticket).text, &came, "`Started` immediately after `Accepted`"));
    }
    line.report(ticket, &Status::Ok, trial.patience())?;
    pass()
}

fn late(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let mut request = trial.set(actor, actor.rest).starting_in(1_000.0).leased(LEASE_MS);
    request.timestamp = Some(trial.stamp() - Span::from_millis(5_000));
    let ticket = line.ask(&request)?;
    refused_for_good(trial, &mut line, ticket)?;
    pass()
}

fn refused_for_good(trial: &Trial, line: &mut Line, ticket: Ticket) -> Result<(), Unmet> {
    line.refused(ticket, &[ErrorCode::Late])?;
    line.listen(trial.soon(150), |line| line.asked(ticket).heard.len() > 1)?;
    match line.asked(ticket).heard.get(1) {
        None => Ok(()),
        Some(more) => {
            Err(differs(&line.asked(ticket).text, &more.text, "no further response after the refusal"))
        }
    }
}

/// Time by which a start must precede the present, in addition to the clock uncertainty, so that it is certainly in the past.
const JUST_PASSED: Span = Span::from_millis(10);

fn late_by_little(trial: &Trial) -> Checked {
    const AHEAD_MS: i64 = 1_000;
    let actor = trial.actor()?;
    let reading = compare_clocks(trial)?;
    let passed = reading.uncertainty + JUST_PASSED;
    let mut requests = vec![trial.set(actor, actor.rest)];
    if actor.in_script {
        requests.push(trial.there_and_back(actor, 1_000.0));
    }
    let mut line = trial.connect()?;
    for mut request in requests {
        let robot_now = trial.now() + reading.offset;
        request.timestamp = Some(robot_now - passed - Span::from_millis(AHEAD_MS));
        let ticket = line.ask(&request.starting_in(1_000.0).leased(LEASE_MS))?;
        refused_for_good(trial, &mut line, ticket).map_err(|unmet| {
            unmet.within(|why| format!("the request was sent {passed} after its start: {why}"))
        })?;
    }
    Ok(format!("a request sent {passed} after its start was refused"))
}

fn status_value(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let request = trial.set(actor, actor.near).leased(LEASE_MS);
    let ticket = line.held(&request)?;
    let sent = line.asked(ticket).text.clone();
    let is = |value: &StatusValue, wanted: f64| match value {
        StatusValue::Number(value) => (value - wanted).abs() <= 1e-9 * wanted.abs().max(1.0),
        _ => false,
    };
    let accepted = line.answer(ticket)?;
    if !is(&accepted.message.status_value, actor.near) {
        return Err(differs(&sent, &accepted.text, &format!("status_value {}", actor.near)));
    }
    if trial.reports() {
        for status in [Status::Started, Status::Ok] {
            let report = line.report(ticket, &status, trial.patience())?;
            if !is(&report.message.status_value, actor.near) {
                return Err(differs(&sent, &report.text, &format!("status_value {}", actor.near)));
            }
        }
    }
    let ticket = line.ask(&trial.refusable(actor).request)?;
    let refusal = line.answer(ticket)?;
    match (&refusal.message.status, &refusal.message.status_value) {
        (Status::Failed, StatusValue::Null) => {}
        (Status::Failed, _) => {
            return Err(differs(&line.asked(ticket).text, &refusal.text, "status_value null on failure"));
        }
        // Another requirement checks which requests may be refused.
        _ => {}
    }
    drop(line);
    script_value(trial)
}

fn script_value(trial: &Trial) -> Checked {
    let Ok(actor) = trial.scripted() else { return pass() };
    let mut line = trial.connect()?;
    let cancel = line.ask(&trial.cancel(actor))?;
    let rests = line.answer(cancel)?;
    // The requirement `cancel-pending` checks the confirmation.
    if rests.message.status == Status::Ok && rests.message.status_value != StatusValue::Null {
        let expected = "status_value null with the `OK` to an empty script";
        return Err(differs(&line.asked(cancel).text, &rests.text, expected));
    }
    let request = trial.pending(actor);
    let ticket = line.held(&request)?;
    let accepted = line.answer(ticket)?;
    match (&accepted.message.status_value, &request.command) {
        (StatusValue::Script(accepted), urrcp::Command::Script(script)) if accepted == script => pass(),
        _ => Err::<String, Unmet>(differs(
            &line.asked(ticket).text,
            &accepted.text,
            "the whole script as status_value of `Accepted`",
        )),
    }
}
