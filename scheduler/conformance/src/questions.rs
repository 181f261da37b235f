//! Checks of inquiries about several, repeated, running and foreign requests, about stops, and about nothing.

use urrcp::{ControlRequest, Inquiry, Millis, RequestState, Span, Status, StopCondition};

use super::inquiries::{about, answering, in_state};
use super::requirement::{Checked, Requirement, pass};
use super::trial::{LATER_MS, LEASE_MS, Shaped, Trial, millis_of};

pub(super) const ALL: [Requirement; 6] = [
    Requirement {
        name: "inquiry-nothing",
        number: "inquiry-14",
        demands: "The answer to an inquiry that names no requests and no devices lists none.",
        section: "Inquiry (D)",
        check: nothing,
    },
    Requirement {
        name: "inquiry-twice",
        number: "inquiry-15",
        demands: "A request that an inquiry names twice has two entries in the answer.",
        section: "Inquiry (D)",
        check: twice,
    },
    Requirement {
        name: "inquiry-stop",
        number: "inquiry-16",
        demands: "An answered empty script is reported as `ended`, without event_timestamp and steps_done.",
        section: "Inquiry (D)",
        check: stop,
    },
    Requirement {
        name: "room-running",
        number: "script-26",
        demands: "A running command counts against the room of its device.",
        section: "Inquiry (D)",
        check: room_running,
    },
    Requirement {
        name: "pending-lease-stranger",
        number: "inquiry-17",
        demands: "The pending_lease of an inquiry does not shorten leases of requests that were sent on another connection without a session.",
        section: "Inquiry (D)",
        check: of_stranger,
    },
    Requirement {
        name: "pending-lease-running",
        number: "script-27",
        demands: "The pending_lease of an inquiry does not shorten the lease of a running request.",
        section: "Inquiry (D)",
        check: of_running,
    },
];

fn nothing(trial: &Trial) -> Checked {
    answering(trial)?;
    let mut line = trial.connect()?;
    line.held(&trial.pending(trial.actor()?))?;
    let inquired = line.inquire(&Inquiry::default())?;
    if inquired.response.requests.is_empty() && inquired.response.devices.is_empty() {
        return pass();
    }
    Err(inquired.differs("no requests and no devices, because the inquiry names none"))
}

fn twice(trial: &Trial) -> Checked {
    answering(trial)?;
    let request = trial.pending(trial.actor()?);
    let mut line = trial.connect()?;
    line.held(&request)?;
    let inquired = line.inquire(&about(&[&request, &request]))?;
    match inquired.response.requests.as_slice() {
        [first, second] if first == second => pass(),
        _ => Err(inquired.differs("two equal entries, because the inquiry names the request twice")),
    }
}

fn stop(trial: &Trial) -> Checked {
    answering(trial)?;
    let request = trial.cancel(trial.actor()?);
    let mut line = trial.connect()?;
    let ticket = line.ask(&request)?;
    line.answer(ticket)?;
    let (inquired, report) = in_state(&mut line, &request, RequestState::Ended)?;
    if report.event_timestamp.is_none() && report.steps_done.is_none() {
        return pass();
    }
    Err(inquired.differs("neither event_timestamp nor steps_done, because an empty script executes nothing"))
}

fn room_running(trial: &Trial) -> Checked {
    answering(trial)?;
    let actor = trial.scripted()?;
    let mut line = trial.connect()?;
    let request = trial.there_and_back(actor, 4_000.0).starting_in(100.0).leased(LEASE_MS);
    line.held(&request)?;
    super::inquiries::reaches(trial, &mut line, &request, RequestState::Running)?;
    let devices = vec![actor.device.id.clone()];
    let inquired = line.inquire(&Inquiry { devices, ..Inquiry::default() })?;
    let room = actor.device.script_queue - 1;
    if inquired.response.devices.first().is_some_and(|device| device.room == room) {
        return pass();
    }
    Err(inquired.differs(&format!("room {room}: one command runs")))
}

fn of_stranger(trial: &Trial) -> Checked {
    answering(trial)?;
    let request = trial.pending(trial.actor()?);
    let mut line = trial.connect()?;
    let mut stranger = trial.connect_second()?;
    let ticket = line.held(&request)?;
    let shorter =
        Inquiry { pending_lease: Some(Millis::from_span(Span::from_millis(50))), ..about(&[&request]) };
    stranger.inquire(&shorter)?;
    line.stays_held(ticket, 300, "an inquiry on another connection requested a shorter lease")?;
    pass()
}

fn of_running(trial: &Trial) -> Checked {
    answering(trial)?;
    trial.reporting()?;
    let mut line = trial.connect()?;
    let request = trial.there_and_back(trial.scripted()?, 4_000.0).starting_in(100.0);
    let lease = StopCondition { pending: Some(millis_of(LATER_MS)), running: Some(millis_of(LATER_MS)) };
    let request = ControlRequest { stop_condition: Some(lease), ..request };
    let ticket = line.held(&request)?;
    line.report(ticket, &Status::Started, trial.patience())?;
    line.inquire(&Inquiry {
        pending_lease: Some(Millis::from_span(Span::from_millis(50))),
        ..about(&[&request])
    })?;
    line.stays_held(ticket, 300, "a pending_lease applies only before the start")?;
    pass()
}
