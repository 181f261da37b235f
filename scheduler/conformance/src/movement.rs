//! Checks that stops, ends of leases and new connections cause no motion. The robot states its commanded positions in responses to
//! inquiries.

use urrcp::{ControlRequest, ControlType, Inquiry, RequestState, Span, StopCondition};

use super::actor::Actor;
use super::inquiries::{answering, reaches};
use super::leases::PERIOD;
use super::line::{Inquired, Line};
use super::requirement::{Checked, Requirement, Unmet, not_applicable, pass};
use super::stopping::cancels;
use super::trial::{LATER_MS, LEASE_MS, Shaped, Trial, millis_of};

pub(super) const ALL: [Requirement; 5] = [
    Requirement {
        name: "stays-stopped",
        number: "inquiry-18",
        demands: "A stop does not move the device: it keeps the last commanded position.",
        section: "Coming to rest (D)",
        check: stays_stopped,
    },
    Requirement {
        name: "stays-connected",
        number: "inquiry-19",
        demands: "Closing a connection and opening a new one do not move the device.",
        section: "Coming to rest (D)",
        check: stays_connected,
    },
    Requirement {
        name: "lease-stays-pending",
        number: "inquiry-20",
        demands: "If the lease of a command ends before its start, the device keeps its position.",
        section: "Coming to rest (D)",
        check: stays_pending,
    },
    Requirement {
        name: "lease-stays-running",
        number: "script-28",
        demands: "If the lease of a running script ends, the device keeps the position of the last step.",
        section: "Coming to rest (D)",
        check: stays_running,
    },
    Requirement {
        name: "home-position",
        number: "script-29",
        demands: "An empty script with `home: true` moves the device to its default_value.",
        section: "Coming to rest (D)",
        check: home_position,
    },
];

/// Time within which an erroneous movement to the default state would begin.
const WATCHED: Span = Span::from_millis(300);

/// Moves the device away from its default position. Returns the device and the connection.
fn moved_away(trial: &Trial) -> Result<(&Actor, Line<'_>), Unmet> {
    answering(trial)?;
    let actor = trial.actor()?;
    if actor.control_type != ControlType::Position || actor.near == actor.rest {
        return Err(not_applicable("the device does not have two different positions"));
    }
    let mut line = trial.connect()?;
    let request = trial.set(actor, actor.near).leased(LEASE_MS);
    line.held(&request)?;
    reaches(trial, &mut line, &request, RequestState::Ended)?;
    match stated(&mut line, actor)?.0 {
        Some(position) if is_at(actor, position, actor.near) => Ok((actor, line)),
        Some(_) => Err(not_applicable(
            "the robot reports a different position from the one that it was sent (see `inquiry-position`)",
        )),
        None => Err(not_applicable("the robot does not report the position of the device")),
    }
}

/// Queries the commanded position of the device; `None` if the robot does not state it. Also returns the inquiry with its response.
fn stated(line: &mut Line, actor: &Actor) -> Result<(Option<f64>, Inquired), Unmet> {
    let devices = vec![actor.device.id.clone()];
    let inquired = line.inquire(&Inquiry { devices, ..Inquiry::default() })?;
    Ok((inquired.response.devices.first().and_then(|device| device.position), inquired))
}

fn is_at(actor: &Actor, stated: f64, position: f64) -> bool {
    (stated - position).abs() < actor.limits.granularity / 2.0
}

/// Checks that the device is still at its commanded position and has not started to move elsewhere.
fn stays(trial: &Trial, line: &mut Line, actor: &Actor, what: &str) -> Checked {
    for pause in [Span::ZERO, WATCHED] {
        trial.pause(pause)?;
        let (position, inquired) = stated(line, actor)?;
        if !position.is_some_and(|position| is_at(actor, position, actor.near)) {
            let expected =
                format!("position {}, the last commanded one: {what} must not move the device", actor.near);
            return Err(inquired.differs(&expected));
        }
    }
    pass()
}

fn stays_stopped(trial: &Trial) -> Checked {
    let (actor, mut line) = moved_away(trial)?;
    cancels(trial, &mut line, &trial.cancel(actor))
        .map_err(|_| not_applicable("the robot does not confirm a stop (see `cancel-pending`)"))?;
    stays(trial, &mut line, actor, "a stop")
}

fn stays_connected(trial: &Trial) -> Checked {
    let (actor, line) = moved_away(trial)?;
    drop(line);
    let mut line = trial.connect()?;
    line.availability()?;
    stays(trial, &mut line, actor, "a connection")
}

fn stays_pending(trial: &Trial) -> Checked {
    let (actor, mut line) = moved_away(trial)?;
    let pending = trial.set(actor, actor.rest).starting_in(LATER_MS).leased(PERIOD.as_millis_f64());
    line.held(&pending)?;
    stays_after_lease(trial, &mut line, actor)
}

fn stays_running(trial: &Trial) -> Checked {
    let (actor, mut line) = moved_away(trial)?;
    trial.scripted()?;
    let there = trial.script(actor, &[(0.0, actor.near), (4_000.0, actor.near)]).starting_in(100.0);
    let lease = StopCondition {
        pending: Some(millis_of(LATER_MS)),
        running: Some(millis_of(PERIOD.as_millis_f64())),
    };
    line.held(&ControlRequest { stop_condition: Some(lease), ..there })?;
    trial.pause(Span::from_millis(100))?;
    stays_after_lease(trial, &mut line, actor)
}

/// Checks that the device does not move after a lease has expired. Other requirements check whether and when the lease expires.
fn stays_after_lease(trial: &Trial, line: &mut Line, actor: &Actor) -> Checked {
    trial.pause(PERIOD + trial.slack())?;
    stays(trial, line, actor, "the end of a lease")
}

fn home_position(trial: &Trial) -> Checked {
    let (actor, mut line) = moved_away(trial)?;
    trial.scripted()?;
    let Some(home) = actor.device.default_value.filter(|home| *home == actor.rest) else {
        return Err(not_applicable("the device declares no default_value for its position"));
    };
    cancels(trial, &mut line, &ControlRequest { home: true, ..trial.cancel(actor) }).map_err(|_| {
        not_applicable("the robot does not confirm an empty script with `home: true` (see `home`)")
    })?;
    let until = trial.patience();
    loop {
        let (position, inquired) = stated(&mut line, actor)?;
        if position.is_some_and(|position| is_at(actor, position, home)) {
            return pass();
        }
        if trial.now() >= until {
            return Err(inquired.differs(&format!(
                "position {home}, the default_value, because the empty script had `home: true`"
            )));
        }
        trial.pause(Span::from_millis(50))?;
    }
}
