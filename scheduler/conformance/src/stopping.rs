//! Checks of cancelling, holding, and stops that arrive before the command that they refer to.

use urrcp::{ControlRequest, ErrorCode, Span, Status};

use super::heard::Ticket;
use super::line::Line;
use super::requirement::{Checked, Requirement, Unmet, differs, pass};
use super::trial::{LATER_MS, LEASE_MS, Shaped, Trial};

pub(super) const ALL: [Requirement; 5] = [
    Requirement {
        name: "cancel-pending",
        number: "core-35",
        demands: "An empty script without a start time is answered with `OK`, and pending commands end with `Failed` and `cancelled`.",
        section: "Cancelling (D)",
        check: cancel_pending,
    },
    Requirement {
        name: "cancel-from",
        number: "script-21",
        demands: "An empty script with the start time S cancels commands that start at S or later, but none that start earlier.",
        section: "Cancelling (D)",
        check: cancel_from,
    },
    Requirement {
        name: "cancel-running",
        number: "script-22",
        demands: "An empty script without a start time ends running commands, which report `Failed` with `cancelled`.",
        section: "Cancelling (D)",
        check: cancel_running,
    },
    Requirement {
        name: "home",
        number: "script-23",
        demands: "An empty script with `home: true` is answered with `OK` and also ends pending commands.",
        section: "Cancelling (D)",
        check: home,
    },
    Requirement {
        name: "take-back",
        number: "script-24",
        demands: "After a stop with a timestamp, commands that were sent no later than this timestamp but arrive after the stop are also refused with `cancelled`; commands that were sent later are not.",
        section: "Cancelling (D)",
        check: take_back,
    },
];

/// Sends `cancel`, an empty script, and waits until the robot confirms that the device is at rest.
pub(super) fn cancels(trial: &Trial, line: &mut Line, cancel: &ControlRequest) -> Result<(), Unmet> {
    let ticket = line.ask(cancel)?;
    let answer = line.answer(ticket)?;
    if trial.confirms_rest(&answer.message) {
        Ok(())
    } else {
        Err(differs(&line.asked(ticket).text, &answer.text, "status `OK` to an empty script"))
    }
}

/// Waits for the report that an empty script has cancelled the request of `ticket`, if the robot sends reports.
fn is_cancelled(trial: &Trial, line: &mut Line, ticket: Ticket) -> Result<(), Unmet> {
    if trial.reports() {
        line.failure(ticket, ErrorCode::Cancelled, trial.patience())?;
    }
    Ok(())
}

fn cancel_pending(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let pending = line.held(&trial.pending(actor))?;
    cancels(trial, &mut line, &trial.cancel(actor))?;
    is_cancelled(trial, &mut line, pending)?;
    // The device no longer holds any command, so it can accept one for the same time again.
    line.held(&trial.pending(actor))?;
    pass()
}

fn cancel_from(trial: &Trial) -> Checked {
    trial.reporting()?;
    let actor = trial.scripted()?;
    let mut line = trial.connect()?;
    let first = trial.pending(actor);
    let ticket = line.held(&first)?;
    let from = |millis: f64| {
        let cancel = ControlRequest { timestamp: first.timestamp, ..trial.cancel(actor) };
        cancel.starting_in(millis)
    };
    cancels(trial, &mut line, &from(LATER_MS + 1.0))?;
    line.listen(trial.soon(100), |line| line.asked(ticket).heard.len() > 1)?;
    if let Some(more) = line.asked(ticket).heard.get(1) {
        let expected = "nothing: the empty script starts 1 ms after the command and must not affect it";
        return Err(differs(&line.asked(ticket).text, &more.text, expected));
    }
    cancels(trial, &mut line, &from(LATER_MS))?;
    line.failure(ticket, ErrorCode::Cancelled, trial.patience())?;
    pass()
}

fn cancel_running(trial: &Trial) -> Checked {
    trial.reporting()?;
    let actor = trial.scripted()?;
    let mut line = trial.connect()?;
    let request = trial.there_and_back(actor, 4_000.0).starting_in(100.0).leased(LEASE_MS);
    let ticket = line.held(&request)?;
    line.report(ticket, &Status::Started, trial.patience())?;
    cancels(trial, &mut line, &trial.cancel(actor))?;
    line.failure(ticket, ErrorCode::Cancelled, trial.patience())?;
    pass()
}

fn home(trial: &Trial) -> Checked {
    let actor = trial.scripted()?;
    let mut line = trial.connect()?;
    let pending = line.held(&trial.pending(actor))?;
    cancels(trial, &mut line, &ControlRequest { home: true, ..trial.cancel(actor) })?;
    is_cancelled(trial, &mut line, pending)?;
    pass()
}

fn take_back(trial: &Trial) -> Checked {
    let actor = trial.scripted()?;
    let mut upload = trial.connect()?;
    let mut stop = trial.connect_second()?;
    let overtaken = trial.pending(actor);
    let stopping = trial.cancel(actor);
    cancels(
        trial,
        &mut stop,
        &ControlRequest { timestamp: Some(trial.stamp() + Span::from_micros(1)), ..stopping },
    )?;
    let ticket = upload.ask(&overtaken)?;
    upload.refused(ticket, &[ErrorCode::Cancelled]).map_err(|unmet| {
        unmet.within(|why| {
            format!("a stop with a later timestamp arrived before the command on another connection: {why}")
        })
    })?;
    upload.held(&trial.pending(actor))?;
    pass()
}
