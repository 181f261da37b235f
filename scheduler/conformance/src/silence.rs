//! Checks of leases of several commands, of unusual leases, and of the messages that renew a lease.

use serde_json::json;
use urrcp::{ControlRequest, ErrorCode, Message, Millis, Span, Status, StopCondition, encode};

use super::actor::Actor;
use super::heard::Ticket;
use super::ids::line_of;
use super::leases::{PERIOD, chatter, runs_out_after};
use super::line::Line;
use super::requirement::{Checked, Requirement, Unmet, not_applicable, pass};
use super::trial::{LATER_MS, Shaped, Trial, millis_of};
use super::wire::{line_of as line_of_json, sound};

pub(super) const ALL: [Requirement; 8] = [
    Requirement {
        name: "lease-each",
        number: "script-18",
        demands: "Each command of a device has its own lease: one that is accepted later neither shortens nor extends the lease of a running script.",
        section: "The lease",
        check: each,
    },
    Requirement {
        name: "lease-running-all",
        number: "script-19",
        demands: "When the lease of a running command ends, all commands of the device end with `link_lost`.",
        section: "The lease",
        check: running_all,
    },
    Requirement {
        name: "lease-pending-later",
        number: "script-20",
        demands: "When the lease of a command that has not begun ends, commands that start later end as well, and those that start earlier do not.",
        section: "The lease",
        check: pending_later,
    },
    Requirement {
        name: "lease-zero",
        number: "core-30",
        demands: "A stop_condition of 0 is a lease that ends at once, not a command without a lease.",
        section: "The lease",
        check: zero,
    },
    Requirement {
        name: "lease-half-pair",
        number: "core-31",
        demands: "A missing key of a stop_condition with two limits means no limit.",
        section: "The lease",
        check: half_pair,
    },
    Requirement {
        name: "lease-renewal-each",
        number: "core-32",
        demands: "Initialization requests and refused control requests renew the lease, too.",
        section: "The lease",
        check: renewal_each,
    },
    Requirement {
        name: "lease-ignored",
        number: "core-33",
        demands: "Messages that only robots send, unknown messages and malformed requests do not renew the lease.",
        section: "The lease",
        check: ignored,
    },
    Requirement {
        name: "stays-held",
        number: "core-34",
        demands: "A closed connection ends nothing by itself: until its lease ends, a command stays held.",
        section: "Sessions and connections (D)",
        check: stays_held,
    },
];

/// Creates a lease with a limit before the start and one after it, in milliseconds.
fn lease(pending: f64, running: f64) -> Option<StopCondition> {
    Some(StopCondition { pending: Some(millis_of(pending)), running: Some(millis_of(running)) })
}

/// Returns the device to move, if it accepts scripts and holds two of them.
fn queueing(trial: &Trial) -> Result<&Actor, Unmet> {
    let actor = trial.scripted()?;
    if actor.device.script_queue >= 2 {
        return Ok(actor);
    }
    Err(not_applicable(format!("`{}` can hold only one command at a time", actor.device.id)))
}

/// Sends a script that runs for four seconds and one that waits behind it. Returns when the first one has started.
fn run_and_wait(
    trial: &Trial,
    line: &mut Line,
    running: Option<StopCondition>,
    waiting: Option<StopCondition>,
) -> Result<[Ticket; 2], Unmet> {
    let actor = queueing(trial)?;
    let runs = trial.there_and_back(actor, 4_000.0).starting_in(100.0);
    let first = line.held(&ControlRequest { stop_condition: running, ..runs })?;
    line.report(first, &Status::Started, trial.patience())?;
    let second = line.held(&ControlRequest { stop_condition: waiting, ..trial.pending(actor) })?;
    Ok([first, second])
}

fn each(trial: &Trial) -> Checked {
    trial.reporting()?;
    let mut line = trial.connect()?;
    let long = lease(LATER_MS, LATER_MS);
    let [first, _] = run_and_wait(trial, &mut line, long, lease(LATER_MS, PERIOD.as_millis_f64()))?;
    line.stays_held(first, 600, "the shorter lease is that of the command that waits")?;
    let cancel = line.ask(&trial.cancel(trial.actor()?))?;
    line.answer(cancel)?;
    let [first, second] = run_and_wait(trial, &mut line, lease(LATER_MS, PERIOD.as_millis_f64()), long)?;
    runs_out_after(trial, &mut line, first, second)
}

fn running_all(trial: &Trial) -> Checked {
    trial.reporting()?;
    let mut line = trial.connect()?;
    let short = lease(LATER_MS, PERIOD.as_millis_f64());
    let tickets = run_and_wait(trial, &mut line, short, lease(LATER_MS, LATER_MS))?;
    let until = trial.patience() + PERIOD;
    for ticket in tickets {
        line.failure(ticket, ErrorCode::LinkLost, until)?;
    }
    pass()
}

fn pending_later(trial: &Trial) -> Checked {
    let actor = queueing(trial)?;
    let mut line = trial.connect()?;
    for [earlier_ms, later_ms] in [[LATER_MS, PERIOD.as_millis_f64()], [PERIOD.as_millis_f64(), LATER_MS]] {
        let earlier = line.held(&trial.pending(actor).leased(earlier_ms))?;
        let later = line.held(&trial.pending(actor).starting_in(LATER_MS + 1_000.0).leased(later_ms))?;
        line.listen(trial.now() + PERIOD + trial.slack(), |line| !line.asked(later).is_held())?;
        line.ends(later, ErrorCode::LinkLost)?;
        if earlier_ms > later_ms {
            line.stays_held(earlier, 50, "the lease that ended was that of a command that starts later")?;
            let cancel = line.ask(&trial.cancel(actor))?;
            line.answer(cancel)?;
        } else {
            line.ends(earlier, ErrorCode::LinkLost)?;
        }
    }
    pass()
}

fn zero(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let ticket = line.held(&trial.pending(trial.actor()?).leased(0.0))?;
    line.ends(ticket, ErrorCode::LinkLost)?;
    pass()
}

fn half_pair(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let mut waits = sound(trial)?;
    waits["stop_condition"] = json!({"running": PERIOD.as_millis_f64()});
    let id = waits["request_id"].as_str().map(str::to_owned);
    let text = String::from_utf8_lossy(&line_of_json(&waits)).into_owned();
    let ticket = line.ask_text(id, actor.device.id.as_str(), &text)?;
    line.accepted(ticket)?;
    line.stays_held(ticket, 500, "there is no limit before the start")?;
    let cancel = line.ask(&trial.cancel(actor))?;
    line.answer(cancel)?;
    if !actor.in_script || !trial.reports() {
        return pass();
    }
    let runs = trial.there_and_back(actor, 700.0).starting_in(100.0);
    let limit = Millis::from_span(PERIOD);
    let runs = ControlRequest {
        stop_condition: Some(StopCondition { pending: Some(limit), running: None }),
        ..runs
    };
    let text = line_of(&runs).replace(",\"running\":null", "");
    let id = runs.request_id.as_ref().map(ToString::to_string);
    let ticket = line.ask_text(id, actor.device.id.as_str(), &text)?;
    line.report(ticket, &Status::Ok, trial.patience() + Span::from_millis(800))?;
    pass()
}

fn renewal_each(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let initialization = || {
        let mut bytes = Vec::new();
        encode(&Message::InitializationRequest(urrcp::InitializationRequest::default()), &mut bytes);
        bytes
    };
    let refused = || line_of(&trial.refusable(actor).request).into_bytes();
    let kinds: [&dyn Fn() -> Vec<u8>; 2] = [&initialization, &refused];
    for bytes in kinds {
        let ticket = line.held(&trial.pending(actor).leased(PERIOD.as_millis_f64()))?;
        chatter(trial, &mut line, bytes, Span::from_millis(600))?;
        let sent = String::from_utf8_lossy(&bytes()).into_owned();
        line.stays_held(ticket, 0, &format!("every 100 ms, this was sent: {sent}"))?;
        let cancel = line.ask(&trial.cancel(actor))?;
        line.answer(cancel)?;
    }
    pass()
}

fn ignored(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let stamp = trial.stamp();
    let device = &actor.device.id;
    let lines = [
        json!({"availability_response": {"receive_timestamp": stamp, "timestamp": stamp, "status": "OK"}}),
        json!({"control_response": {"timestamp": stamp, "device_id": device, "status": "Accepted", "status_value": 0}}),
        json!({"initialization_block": trial.block()?}),
        json!({"x_unknown": {}}),
        json!({"control_request": {"device_id": device, "request_id": trial.fresh_id(), "control_type": 7}}),
    ];
    let bytes: String = lines.iter().map(|line| format!("{line}\n")).collect();
    let ticket = line.held(&trial.pending(actor).leased(PERIOD.as_millis_f64()))?;
    chatter(trial, &mut line, &|| bytes.clone().into_bytes(), Span::from_millis(900))?;
    if line.has_ended() {
        return Err(not_applicable("the robot closed the connection after messages that no server sends"));
    }
    line.ends_by(ticket, ErrorCode::LinkLost, trial.now()).map_err(|unmet| {
        unmet.within(|why| format!("for 900 ms, only messages that are not a server's were sent: {why}"))
    })?;
    pass()
}

fn stays_held(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let request = trial.pending(actor);
    line.held(&request)?;
    line.cut();
    trial.pause(Span::from_millis(300))?;
    let mut line = trial.connect()?;
    let again = line.ask(&request)?;
    line.accepted(again).map_err(|unmet| {
        unmet.within(|why| {
            format!("the connection of this request was closed, and the request was repeated on another one: {why}")
        })
    })?;
    let cancel = line.ask(&trial.cancel(actor))?;
    line.answer(cancel)?;
    pass()
}
