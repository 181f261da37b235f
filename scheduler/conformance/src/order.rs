//! Checks of the order in which a robot checks a request: each request here has two faults, and the first one in the order gives the
//! answer.

use urrcp::{Command, ContentHash, ControlRequest, DeviceId, ErrorCode, Setpoint, Span};

use super::actor::Actor;
use super::line::Line;
use super::owners::{of, session};
use super::requirement::{Checked, Requirement, Unmet, pass};
use super::scripts::{STEPS_TRIED_MAX, of_steps, steps_declared};
use super::stopping::cancels;
use super::trial::{LATER_MS, LEASE_MS, Shaped, Trial};

pub(super) const ALL: [Requirement; 1] = [Requirement {
    name: "check-order",
    number: "core-13",
    demands: "A request with several faults is refused because of the first one in the order of the checks.",
    section: "Refusing",
    check: check_order,
}];

/// Checks that a request is refused with `first`, although the later check with `second` would refuse it as well.
fn refuses(line: &mut Line, request: &ControlRequest, first: ErrorCode, second: &str) -> Result<(), Unmet> {
    line.refuses(request, first).map_err(|unmet| {
        unmet.within(|why| format!("the request also violates the later check `{second}`: {why}"))
    })
}

/// Shifts a request's start into the past.
fn passed(trial: &Trial, request: ControlRequest) -> ControlRequest {
    let timestamp = Some(trial.stamp() - Span::from_millis(5_000));
    ControlRequest { timestamp, ..request }.starting_in(1_000.0)
}

fn check_order(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    if trial.accepts_scripts() {
        hashes(trial, &mut line, actor)?;
    }
    if let Ok([_, above]) = actor.beyond() {
        let late = passed(trial, trial.set(actor, above));
        refuses(&mut line, &late, ErrorCode::OutOfRange, "late")?;
    }
    if actor.in_script {
        scripts(trial, &mut line, actor)?;
    }
    drop(line);
    stranger(trial, actor)
}

fn hashes(trial: &Trial, line: &mut Line, actor: &Actor) -> Result<(), Unmet> {
    let wrong_hash = Some(ContentHash::of(b"something else"));
    let lacking = trial.request(&actor.device.id, Command::Set(Setpoint::new(actor.lacks(), 0.0)));
    let lacking = ControlRequest { content_hash: wrong_hash, ..lacking.starting_in(LATER_MS) };
    refuses(line, &lacking, ErrorCode::Malformed, "unsupported_control_type")?;
    let unknown = ControlRequest { content_hash: wrong_hash, ..elsewhere(trial, actor)? };
    refuses(line, &unknown, ErrorCode::UnknownDevice, "malformed")
}

/// Creates a request to a device that the robot does not have.
fn elsewhere(trial: &Trial, actor: &Actor) -> Result<ControlRequest, Unmet> {
    let device = DeviceId::new(trial.fresh_id()).unwrap_or_else(|_| actor.device.id.clone());
    let command = Command::Set(Setpoint::new(actor.control_type, actor.rest));
    Ok(trial.request(&device, command).starting_in(LATER_MS).leased(LEASE_MS))
}

fn scripts(trial: &Trial, line: &mut Line, actor: &Actor) -> Result<(), Unmet> {
    let declared = steps_declared(actor);
    if declared < STEPS_TRIED_MAX
        && let Ok([_, above]) = actor.beyond()
    {
        let mut long = of_steps(trial, actor, declared + 1);
        if let Command::Script(script) = &mut long.command {
            let mut steps = script.steps().to_vec();
            steps.iter_mut().for_each(|step| step.setpoint.value = above);
            *script = urrcp::Script::new(steps).unwrap_or_default();
        }
        refuses(line, &long, ErrorCode::TooManySteps, "out_of_range")?;
    }
    let first = trial.pending(actor);
    line.held(&first)?;
    let long = trial.script(actor, &[(0.0, actor.rest), (2.0 * LATER_MS, actor.rest)]).leased(LEASE_MS);
    refuses(line, &passed(trial, long), ErrorCode::Late, "overlap")?;
    let queue = actor.device.script_queue;
    if !(2..=16).contains(&queue) {
        return Ok(());
    }
    for n in 1..queue {
        let next = ControlRequest { timestamp: first.timestamp, ..trial.pending(actor) };
        line.held(&next.starting_in(LATER_MS + 500.0 * f64::from(n)))?;
    }
    let overlapping = ControlRequest { timestamp: first.timestamp, ..trial.pending(actor) };
    refuses(line, &overlapping.starting_in(LATER_MS + 250.0), ErrorCode::Overlap, "busy")?;
    cancels(trial, line, &trial.cancel(actor))
}

fn stranger(trial: &Trial, actor: &Actor) -> Checked {
    let (ours, theirs) = (session(trial)?, session(trial)?);
    let mut stranger = trial.connect()?;
    let mut owner = trial.connect_second()?;
    let kept = owner.held(&of(&ours, trial.pending(actor)))?;
    let unknown = of(&theirs, elsewhere(trial, actor)?);
    refuses(&mut stranger, &unknown, ErrorCode::Busy, "unknown_device")?;
    let lacking = trial.request(&actor.device.id, Command::Set(Setpoint::new(actor.lacks(), 0.0)));
    refuses(&mut stranger, &of(&theirs, lacking), ErrorCode::Busy, "unsupported_control_type")?;
    owner.stays_held(kept, 50, "the requests of another session were refused")?;
    cancels(trial, &mut owner, &of(&ours, trial.cancel(actor)))?;
    pass()
}
