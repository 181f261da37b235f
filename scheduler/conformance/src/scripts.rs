//! Checks of scripts: order and timing of steps, number of steps, and number of queued scripts.

use urrcp::{ControlRequest, ErrorCode, Span, Status};

use super::actor::Actor;
use super::requirement::{Checked, Requirement, differs, not_applicable, pass};
use super::trial::{LATER_MS, LEASE_MS, Shaped, Trial};

pub(super) const ALL: [Requirement; 6] = [
    Requirement {
        name: "script-order",
        number: "script-6",
        demands: "A script whose steps go back in time is refused with `malformed`.",
        section: "Control request",
        check: script_order,
    },
    Requirement {
        name: "script-timing",
        number: "script-7",
        demands: "A script reports `Accepted`, `Started` and `OK` in this order, with all its steps done, and ends at the time of the last step.",
        section: "Reports (D)",
        check: script_timing,
    },
    Requirement {
        name: "max-steps",
        number: "script-8",
        demands: "A script with exactly max_number_of_steps steps is accepted.",
        section: "Refusing",
        check: max_steps,
    },
    Requirement {
        name: "one-step-too-many",
        number: "script-9",
        demands: "A script with one step more than max_number_of_steps is refused with `too_many_steps`.",
        section: "Refusing",
        check: one_step_too_many,
    },
    Requirement {
        name: "queue",
        number: "script-10",
        demands: "A device accepts script_queue scripts in direct succession; one more is refused with `busy`.",
        section: "Refusing",
        check: queue,
    },
    Requirement {
        name: "overlap",
        number: "script-11",
        demands: "A script that overlaps an accepted one is refused with `overlap`, or with `busy` if the queue holds only one.",
        section: "Refusing",
        check: overlap,
    },
];

/// Maximum number of steps to test, because a robot may declare an impractically large number.
pub(super) const STEPS_TRIED_MAX: u32 = 10_000;
/// Maximum number of queued scripts to test.
const QUEUE_TRIED_MAX: u32 = 256;

fn script_order(trial: &Trial) -> Checked {
    let actor = trial.scripted()?;
    let mut line = trial.connect()?;
    let (id, device) = (trial.fresh_id(), actor.device.id.as_str());
    let step = |millis: u32| serde_json::json!({"time_offset_to_start": millis, "control_type": actor.control_type, "control_value": actor.rest});
    let request = serde_json::json!({"control_request": {
        "timestamp": trial.stamp(), "time_offset_to_start": LATER_MS, "device_id": device, "stop_condition": LEASE_MS,
        "request_id": id, "control_type": "script", "control_value": [step(0), step(100), step(50)],
    }});
    line.is_malformed(format!("{request}\n").as_bytes())?;
    pass()
}

fn script_timing(trial: &Trial) -> Checked {
    trial.reporting()?;
    let actor = trial.scripted()?;
    let mut line = trial.connect()?;
    let length = Span::from_millis(300);
    let request = trial.there_and_back(actor, length.as_millis_f64()).starting_in(200.0).leased(LEASE_MS);
    let ticket = line.held(&request)?;
    let started = line.report(ticket, &Status::Started, trial.patience())?;
    let ended = line.report(ticket, &Status::Ok, trial.patience())?;
    let asked = line.asked(ticket);
    let order: Vec<_> = asked.heard.iter().map(|heard| heard.message.status.as_str()).collect();
    if order != ["Accepted", "Started", "OK"] {
        return Err(differs(
            &asked.text,
            &order.join(", "),
            "`Accepted`, `Started`, `OK`, in this order, each once",
        ));
    }
    if ended.message.steps_done != Some(3) {
        return Err(differs(&asked.text, &ended.text, "steps_done 3"));
    }
    let (Some(from), Some(to)) = (started.message.event_timestamp, ended.message.event_timestamp) else {
        return Err(differs(&asked.text, &ended.text, "an event_timestamp in `Started` and in `OK`"));
    };
    let error = to - from - length;
    if error.abs() <= trial.options().tolerance {
        Ok(format!("a script of {length} ended {error} after its scheduled end"))
    } else {
        let expected = format!(
            "an event_timestamp {length} after that of `Started` ({from}), which is the time of the last step; it is off by {error}"
        );
        Err(differs(&asked.text, &ended.text, &expected))
    }
}

/// Creates a script of `count` steps at intervals of one millisecond. The check ends before the script starts.
pub(super) fn of_steps(trial: &Trial, actor: &Actor, count: u32) -> ControlRequest {
    let steps: Vec<_> = (0..count).map(|i| (f64::from(i), actor.rest)).collect();
    trial.script(actor, &steps).starting_in(LATER_MS).leased(LEASE_MS)
}

pub(super) fn steps_declared(actor: &Actor) -> u32 {
    actor.device.available_control_types.script().map_or(0, |script| script.max_number_of_steps)
}

fn max_steps(trial: &Trial) -> Checked {
    let actor = trial.scripted()?;
    let declared = steps_declared(actor);
    let tried = declared.min(STEPS_TRIED_MAX);
    let mut line = trial.connect()?;
    line.held(&of_steps(trial, actor, tried))?;
    if tried == declared {
        Ok(format!("{tried} steps"))
    } else {
        Ok(format!(
            "{tried} steps were tested; {declared} are declared, but at most {STEPS_TRIED_MAX} are tested"
        ))
    }
}

fn one_step_too_many(trial: &Trial) -> Checked {
    let actor = trial.scripted()?;
    let declared = steps_declared(actor);
    if declared >= STEPS_TRIED_MAX {
        return Err(not_applicable(format!(
            "{declared} steps are declared, but at most {STEPS_TRIED_MAX} are tested"
        )));
    }
    let mut line = trial.connect()?;
    line.refuses(&of_steps(trial, actor, declared + 1), ErrorCode::TooManySteps)?;
    pass()
}

/// Creates the n-th of several scripts that follow each other without gaps.
fn nth(trial: &Trial, actor: &Actor, timestamp: &ControlRequest, n: u32) -> ControlRequest {
    let request = trial.there_and_back(actor, 500.0).leased(LEASE_MS);
    let request = ControlRequest { timestamp: timestamp.timestamp, ..request };
    request.starting_in(LATER_MS + 500.0 * f64::from(n))
}

fn queue(trial: &Trial) -> Checked {
    let actor = trial.scripted()?;
    let declared = actor.device.script_queue;
    if declared > QUEUE_TRIED_MAX {
        return Err(not_applicable(format!(
            "a queue of {declared} scripts is declared, but at most {QUEUE_TRIED_MAX} are tested"
        )));
    }
    let mut line = trial.connect()?;
    let first = trial.pending(actor);
    for n in 0..declared {
        line.held(&nth(trial, actor, &first, n))?;
    }
    line.refuses(&nth(trial, actor, &first, declared), ErrorCode::Busy)?;
    Ok(format!("{} held", downbeat_yaml::render::counted(declared as usize, "script")))
}

fn overlap(trial: &Trial) -> Checked {
    let actor = trial.scripted()?;
    let mut line = trial.connect()?;
    let first = trial.pending(actor);
    line.held(&first)?;
    let second = ControlRequest { timestamp: first.timestamp, ..trial.there_and_back(actor, 500.0) };
    let ticket = line.ask(&second.starting_in(LATER_MS + 250.0).leased(LEASE_MS))?;
    let codes: &[ErrorCode] = match actor.device.script_queue {
        1 => &[ErrorCode::Overlap, ErrorCode::Busy],
        _ => &[ErrorCode::Overlap],
    };
    line.refused(ticket, codes)?;
    pass()
}
