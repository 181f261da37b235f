//! Checks of stops with a start, and of the requests that a stop takes back.

use urrcp::{ControlRequest, ErrorCode, Span, Status};

use super::owners::{of, session};
use super::requirement::{Checked, Requirement, not_applicable, pass};
use super::stopping::cancels;
use super::trial::{LATER_MS, LEASE_MS, Shaped, Trial};

pub(super) const ALL: [Requirement; 6] = [
    Requirement {
        name: "stop-passed",
        number: "core-36",
        demands: "An empty script whose start has passed stops at once.",
        section: "Cancelling (D)",
        check: passed,
    },
    Requirement {
        name: "stop-later",
        number: "script-25",
        demands: "An empty script with a start in the future does not end the running command.",
        section: "Cancelling (D)",
        check: later,
    },
    Requirement {
        name: "take-back-equal",
        number: "core-37",
        demands: "A stop takes back requests whose timestamp equals its own.",
        section: "Cancelling (D)",
        check: equal,
    },
    Requirement {
        name: "take-back-none",
        number: "core-38",
        demands: "A request without a timestamp cannot be taken back.",
        section: "Cancelling (D)",
        check: none,
    },
    Requirement {
        name: "take-back-ahead",
        number: "core-39",
        demands: "A stop whose timestamp is far ahead of the robot's clock counts as at most 5 s ahead, so a request with a later timestamp is accepted.",
        section: "Cancelling (D)",
        check: ahead,
    },
    Requirement {
        name: "take-back-claimed",
        number: "core-40",
        demands: "A stop of the free robot with a timestamp in the future takes nothing back from a session that claims the robot afterwards.",
        section: "Cancelling (D)",
        check: claimed,
    },
];

fn passed(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let pending = line.held(&trial.pending(actor))?;
    let sent = Some(trial.stamp() - Span::from_millis(2_000));
    let stop = ControlRequest { timestamp: sent, ..trial.cancel(actor) };
    cancels(trial, &mut line, &stop.starting_in(1_000.0))?;
    line.ends(pending, ErrorCode::Cancelled)?;
    pass()
}

fn later(trial: &Trial) -> Checked {
    trial.reporting()?;
    let actor = trial.scripted()?;
    let mut line = trial.connect()?;
    let running = trial.there_and_back(actor, 4_000.0).starting_in(100.0).leased(LEASE_MS);
    let running = line.held(&running)?;
    line.report(running, &Status::Started, trial.patience())?;
    let stop = ControlRequest { timestamp: Some(trial.stamp()), ..trial.cancel(actor) };
    cancels(trial, &mut line, &stop.starting_in(LATER_MS))?;
    line.stays_held(running, 150, "it runs, and the empty script has a start in the future")?;
    pass()
}

fn equal(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let overtaken = trial.pending(actor);
    cancels(trial, &mut line, &ControlRequest { timestamp: overtaken.timestamp, ..trial.cancel(actor) })?;
    line.refuses(&overtaken, ErrorCode::Cancelled)?;
    pass()
}

fn none(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let stop = ControlRequest { timestamp: Some(trial.stamp()), ..trial.cancel(actor) };
    cancels(trial, &mut line, &stop)?;
    line.held(&ControlRequest { timestamp: None, ..trial.set(actor, actor.rest).leased(LEASE_MS) })?;
    pass()
}

fn ahead(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let hour = Some(trial.stamp() + Span::from_millis(3_600_000));
    cancels(trial, &mut line, &ControlRequest { timestamp: hour, ..trial.cancel(actor) })?;
    // Its timestamp is ahead as well, so that the check need not wait.
    let after = Some(trial.stamp() + Span::from_millis(7_000));
    line.held(&ControlRequest { timestamp: after, ..trial.pending(actor) })?;
    pass()
}

fn claimed(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut stranger = trial.connect()?;
    let mut line = trial.connect_second()?;
    let soon = Some(trial.stamp() + Span::from_millis(3_000));
    cancels(trial, &mut stranger, &ControlRequest { timestamp: soon, ..trial.cancel(actor) })?;
    let ours = session(trial)?;
    let (sent, answer) = super::identity::claim(trial, &mut line, &ours)?;
    if answer.message.status != Status::Ok {
        return Err(not_applicable(format!("the robot cannot be claimed (see `session`): {sent}")));
    }
    // A timestamp later than the claim by the robot's clock, even if the clocks differ a little.
    trial.pause(Span::from_millis(100))?;
    let held = line.held(&of(&ours, trial.pending(actor)));
    cancels(trial, &mut line, &of(&ours, trial.cancel(actor)))?;
    held.map(drop).map_err(|unmet| {
        unmet.within(|why| format!("a stop that arrived before the claim had a later timestamp: {why}"))
    })?;
    pass()
}
