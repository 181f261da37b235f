//! Checks of leases: how a device behaves when the server falls silent.

use urrcp::{
    AvailabilityRequest, Command, ControlRequest, ControlType, ErrorCode, Inquiry, Message, Millis, Script,
    SessionId, Setpoint, Span, Status, Step, StopCondition,
};

use super::heard::Ticket;
use super::line::Line;
use super::owners::session;
use super::requirement::{Checked, Requirement, Unmet, differs, not_applicable, pass};
use super::trial::{LATER_MS, Shaped, Trial};

pub(super) const ALL: [Requirement; 13] = [
    Requirement {
        name: "lease-pending",
        number: "core-23",
        demands: "A pending command ends with `Failed` and `link_lost` once the server has been silent for stop_condition, not before and not much later.",
        section: "The lease",
        check: lease_pending,
    },
    Requirement {
        name: "lease-running",
        number: "script-14",
        demands: "A running command ends with `Failed` and `link_lost` once the server has been silent for stop_condition.",
        section: "The lease",
        check: lease_running,
    },
    Requirement {
        name: "lease-silence",
        number: "core-24",
        demands: "Silence before a start or a step also counts towards the lease that applies after it: if that lease would already have expired, the script does not start, or the step is not executed.",
        section: "The lease",
        check: lease_silence,
    },
    Requirement {
        name: "lease-queued",
        number: "script-15",
        demands: "When the lease of a command that waits behind a running script expires, that command ends, and the running script continues under its own lease.",
        section: "The lease",
        check: lease_queued,
    },
    Requirement {
        name: "lease-pair",
        number: "script-16",
        demands: "A stop_condition with a `pending` limit and `running: null` no longer applies once the command has started.",
        section: "The lease",
        check: lease_pair,
    },
    Requirement {
        name: "lease-step",
        number: "script-17",
        demands: "A step's own stop_condition replaces that of the script while this step is the current one.",
        section: "The lease",
        check: lease_step,
    },
    Requirement {
        name: "lease-left-on",
        number: "reports-3",
        demands: "A speed that continues after its command has ended remains subject to the lease of that command.",
        section: "The lease",
        check: lease_left_on,
    },
    Requirement {
        name: "lease-left-on-kept",
        number: "reports-4",
        demands: "Commands that do not change a continuing speed do not change its lease.",
        section: "The lease",
        check: lease_left_on_kept,
    },
    Requirement {
        name: "lease-renewal",
        number: "core-25",
        demands: "Every message from the server renews the lease, including availability requests.",
        section: "The lease",
        check: lease_renewal,
    },
    Requirement {
        name: "lease-noise",
        number: "core-26",
        demands: "A line that is not a message does not renew the lease.",
        section: "The lease",
        check: lease_noise,
    },
    Requirement {
        name: "lease-link-down",
        number: "core-27",
        demands: "A broken connection counts as silence: the lease expires, and a server that reconnects and repeats its request receives `Failed` with `link_lost`.",
        section: "The lease",
        check: lease_link_down,
    },
    Requirement {
        name: "lease-two-links",
        number: "core-28",
        demands: "Messages from another party on a different connection do not renew the lease.",
        section: "Sessions and connections (D)",
        check: lease_two_links,
    },
    Requirement {
        name: "lease-stranger",
        number: "core-29",
        demands: "Refused requests from a session that does not own the robot do not renew the owner's leases.",
        section: "Sessions and connections (D)",
        check: lease_stranger,
    },
];

/// The duration of the lease in checks that wait for its expiry.
pub(super) const PERIOD: Span = Span::from_millis(300);
/// Maximum drift between the clocks of two machines during `PERIOD`.
const EARLY_MAX: Span = Span::from_millis(3);

fn short(request: ControlRequest) -> ControlRequest {
    request.leased(PERIOD.as_millis_f64())
}

/// Creates a script that starts soon and lasts so long that only the expiry of its lease ends it.
fn long(trial: &Trial) -> Result<ControlRequest, Unmet> {
    Ok(trial.there_and_back(trial.scripted()?, 4_000.0).starting_in(100.0))
}

/// Sends nothing, waits for the report that the lease has expired, and judges the time of expiry.
fn runs_out(trial: &Trial, line: &mut Line, ticket: Ticket) -> Checked {
    runs_out_after(trial, line, ticket, ticket)
}

/// Like [`runs_out`], but the lease of the request `ticket` counts from the later request `last`.
pub(super) fn runs_out_after(trial: &Trial, line: &mut Line, ticket: Ticket, last: Ticket) -> Checked {
    let answered = line.answer(last)?;
    let sent = line.asked(last).sent;
    trial.saw_round_trip(answered.at - sent);
    let until = trial.patience() + PERIOD;
    let lost = line.failure(ticket, ErrorCode::LinkLost, until)?;
    let asked = line.asked(ticket);
    let silent = lost.at - sent;
    let (earliest, latest) = (PERIOD - EARLY_MAX, PERIOD + trial.slack());
    if silent >= earliest && silent <= latest {
        Ok(format!("`link_lost` after {silent} of silence; the lease allows {PERIOD}"))
    } else {
        let came = format!("{} after {silent} of silence", lost.text);
        let expected = format!(
            "this report after {PERIOD}, at the latest after {latest}, which is stop_condition plus the measured round trip and the tolerance"
        );
        Err(differs(&asked.text, &came, &expected))
    }
}

fn lease_pending(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let ticket = line.held(&short(trial.pending(trial.actor()?)))?;
    if trial.reports() {
        return runs_out(trial, &mut line, ticket);
    }
    // Each question renews the lease, so the end can only be bounded.
    trial.pause(PERIOD / 2)?;
    line.stays_held(ticket, 0, "half of its lease has passed")?;
    trial.pause(PERIOD + trial.slack())?;
    line.ends(ticket, ErrorCode::LinkLost)?;
    Ok("without `reports`, the end of the lease is known only roughly".to_owned())
}

fn lease_running(trial: &Trial) -> Checked {
    trial.reporting()?;
    let request = long(trial)?;
    let mut line = trial.connect()?;
    let lease = StopCondition { pending: Some(millis(20_000)), running: Some(millis(300)) };
    let ticket = line.held(&ControlRequest { stop_condition: Some(lease), ..request })?;
    line.report(ticket, &Status::Started, trial.patience())?;
    runs_out(trial, &mut line, ticket)
}

fn lease_silence(trial: &Trial) -> Checked {
    trial.reporting()?;
    let actor = trial.actor()?;
    let starts = trial.set(actor, actor.rest).starting_in(SILENT_MS);
    let lease = StopCondition { pending: Some(millis(20_000)), running: Some(millis(300)) };
    not_done(trial, &ControlRequest { stop_condition: Some(lease), ..starts }, SILENT_MS, 0)?;
    if !actor.in_script {
        return pass();
    }
    let steps = trial.script(actor, &[(0.0, actor.rest), (SILENT_MS, actor.near)]).starting_in(100.0);
    let Command::Script(script) = &steps.command else { return pass() };
    let mut own: Vec<Step> = script.steps().to_vec();
    own[1].stop_condition = Some(StopCondition::both(millis(300)));
    let command = Command::Script(Script::new(own).unwrap_or_default());
    not_done(trial, &ControlRequest { command, ..steps }.leased(20_000.0), 100.0 + SILENT_MS, 1)?;
    pass()
}

/// Time in milliseconds during which the server is silent before a start or a step. Even half of it exceeds the lease.
const SILENT_MS: f64 = 700.0;

/// Sends a request whose start or step is due `at_ms` after its timestamp. Checks that the device does not perform it, because the lease
/// expires earlier.
fn not_done(trial: &Trial, request: &ControlRequest, at_ms: f64, steps_done: u32) -> Result<(), Unmet> {
    let mut line = trial.connect()?;
    let ticket = line.held(request)?;
    let until = trial.patience() + Span::from_millis_f64(at_ms);
    let lost = line.failure(ticket, ErrorCode::LinkLost, until)?;
    let asked = line.asked(ticket);
    let silent = lost.at - asked.sent;
    let started = asked.heard.iter().any(|heard| heard.message.status == Status::Started);
    let right = started == (steps_done > 0) && lost.message.steps_done == Some(steps_done);
    // Until the start or step, a different, longer lease applies.
    if right && silent > PERIOD + PERIOD / 2 {
        return Ok(());
    }
    let came = format!("{} after {silent} of silence", lost.text);
    let expected = format!(
        "this report after {at_ms} ms with steps_done {steps_done}, because the silence before that time counts towards the lease of {PERIOD} that applies afterwards"
    );
    Err(differs(&asked.text, &came, &expected))
}

fn lease_queued(trial: &Trial) -> Checked {
    trial.reporting()?;
    let actor = trial.scripted()?;
    if actor.device.script_queue < 2 {
        return Err(not_applicable(format!("`{}` can hold only one command at a time", actor.device.id)));
    }
    let mut line = trial.connect()?;
    let lease =
        |pending| Some(StopCondition { pending: Some(millis(pending)), running: Some(millis(20_000)) });
    let running = trial.there_and_back(actor, 1_000.0).starting_in(100.0);
    let running = line.held(&ControlRequest { stop_condition: lease(20_000), ..running })?;
    let queued = trial.there_and_back(actor, 500.0).starting_in(LATER_MS);
    let queued = line.held(&ControlRequest { stop_condition: lease(300), ..queued })?;
    line.failure(queued, ErrorCode::LinkLost, trial.patience() + PERIOD)?;
    line.report(running, &Status::Ok, trial.patience() + Span::from_millis(1_100)).map_err(|unmet| {
        unmet.within(|why| format!("the lease of a script that waited behind this one had expired: {why}"))
    })?;
    pass()
}

fn millis(millis: i64) -> Millis {
    Millis::from_span(Span::from_millis(millis))
}

fn lease_pair(trial: &Trial) -> Checked {
    trial.reporting()?;
    let actor = trial.scripted()?;
    let mut line = trial.connect()?;
    let lease = StopCondition { pending: Some(millis(300)), running: None };
    let request = trial.there_and_back(actor, 700.0).starting_in(100.0);
    let ticket = line.held(&ControlRequest { stop_condition: Some(lease), ..request })?;
    line.report(ticket, &Status::Ok, trial.patience() + Span::from_millis(800))?;
    pass()
}

fn lease_step(trial: &Trial) -> Checked {
    trial.reporting()?;
    let request = long(trial)?;
    let Command::Script(script) = &request.command else { return pass() };
    let mut steps: Vec<Step> = script.steps().to_vec();
    steps[0].stop_condition = Some(StopCondition::both(millis(300)));
    let script = Script::new(steps).unwrap_or_default();
    let request = ControlRequest { command: Command::Script(script), ..request }.leased(20_000.0);
    let mut line = trial.connect()?;
    let ticket = line.held(&request)?;
    line.report(ticket, &Status::Started, trial.patience())?;
    runs_out(trial, &mut line, ticket)
}

/// Sets a speed or an acceleration, which continues after the command has ended. Returns the connection and the ticket of the command.
fn left_on(trial: &Trial) -> Result<(Line<'_>, Ticket), Unmet> {
    trial.reporting()?;
    let actor = trial.actor()?;
    if !actor.is_rate() || actor.near == actor.rest || actor.near == 0.0 {
        return Err(not_applicable(format!(
            "`{}` is driven by {}, so it stops by itself",
            actor.device.id, actor.control_type
        )));
    }
    let mut line = trial.connect()?;
    let ticket = line.held(&short(trial.set(actor, actor.near)))?;
    line.report(ticket, &Status::Ok, trial.patience())?;
    Ok((line, ticket))
}

fn lease_left_on(trial: &Trial) -> Checked {
    let (mut line, ticket) = left_on(trial)?;
    runs_out(trial, &mut line, ticket)
}

fn lease_left_on_kept(trial: &Trial) -> Checked {
    let (mut line, ticket) = left_on(trial)?;
    let actor = trial.actor()?;
    let refusable = trial.refusable(actor);
    line.refuses(&refusable.request.leased(20_000.0), refusable.code)?;
    let others = actor.device.available_control_types.iter().map(|(control_type, _)| control_type);
    let mut rates = others.filter(|t| matches!(t, ControlType::Speed | ControlType::Acceleration));
    if let Some(other) = rates.find(|control_type| *control_type != actor.control_type) {
        let still = trial.request(&actor.device.id, Command::Set(Setpoint::new(other, 0.0)));
        let still = line.held(&still.leased(20_000.0))?;
        line.report(still, &Status::Ok, trial.patience())?;
    }
    if actor.in_script {
        let nothing = ControlRequest { timestamp: Some(trial.stamp()), ..trial.cancel(actor) };
        let nothing = line.ask(&nothing.starting_in(2.0 * LATER_MS))?;
        line.answer(nothing)?;
    }
    let later = line.held(&trial.pending(actor).leased(20_000.0))?;
    let note = runs_out_after(trial, &mut line, ticket, later).map_err(|unmet| {
        unmet.within(|why| format!("commands that do not change the continuing speed had arrived: {why}"))
    })?;
    // When the movement ends, all held commands end too.
    line.failure(later, ErrorCode::LinkLost, trial.patience())?;
    Ok(note)
}

/// Sends `bytes` repeatedly for the duration `span`.
pub(super) fn chatter(
    trial: &Trial,
    line: &mut Line,
    bytes: &dyn Fn() -> Vec<u8>,
    span: Span,
) -> Result<(), Unmet> {
    let until = trial.now() + span;
    while trial.now() < until && !line.has_ended() {
        line.send(&bytes())?;
        line.listen(trial.soon(PERIOD.as_nanos() / 3_000_000), |_| false)?;
    }
    Ok(())
}

fn presence(trial: &Trial) -> Vec<u8> {
    let mut bytes = Vec::new();
    let request = AvailabilityRequest {
        timestamp: Some(trial.stamp()),
        session: None,
        seize: false,
        revocation_list: None,
    };
    urrcp::encode(&Message::AvailabilityRequest(request), &mut bytes);
    bytes
}

fn lease_renewal(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let ticket = line.held(&short(trial.pending(trial.actor()?)))?;
    chatter(trial, &mut line, &|| presence(trial), Span::from_millis(900))?;
    line.stays_held(ticket, 0, "an availability request every 100 ms renews the lease")?;
    Ok(format!("availability requests kept the command alive for 900 ms, with a lease of {PERIOD}"))
}

fn lease_noise(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let ticket = line.held(&short(trial.pending(trial.actor()?)))?;
    chatter(trial, &mut line, &|| b"noise on the line\n".to_vec(), Span::from_millis(900))?;
    if line.has_ended() {
        return Err(not_applicable(
            "the robot closed the connection after a line that is not a message (see `malformed-line`)",
        ));
    }
    line.ends_by(ticket, ErrorCode::LinkLost, trial.now()).map_err(|unmet| {
        unmet.within(|why| {
            format!("for 900 ms, only lines that are not messages were sent, one every 100 ms: {why}")
        })
    })?;
    pass()
}

fn lease_link_down(trial: &Trial) -> Checked {
    let request = short(trial.pending(trial.actor()?));
    let mut line = trial.connect()?;
    line.held(&request)?;
    line.cut();
    trial.pause(PERIOD + PERIOD + trial.options().tolerance)?;
    let mut line = trial.connect()?;
    let ticket = line.ask(&request)?;
    line.refused(ticket, &[ErrorCode::LinkLost]).map_err(|unmet| unmet.within(|why| format!(
            "a request was accepted with a lease of {PERIOD}, its connection was closed, and the same request was repeated on a new connection {} later: {why}",
            PERIOD + PERIOD
        )))?;
    pass()
}

fn lease_two_links(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let mut other = trial.connect_second()?;
    let ticket = line.held(&short(trial.pending(trial.actor()?)))?;
    chatter(trial, &mut other, &|| presence(trial), Span::from_millis(900))?;
    line.ends_by(ticket, ErrorCode::LinkLost, trial.now() + trial.slack()).map_err(|unmet| {
        unmet.within(|why| {
            format!("the server was silent for 900 ms while availability requests arrived on another connection: {why}")
        })
    })?;
    pass()
}

/// Encodes one message of each kind with which `session` could address a robot that another session owns. The robot rejects them.
fn sends_rejected_requests(trial: &Trial, session: &SessionId) -> Result<Vec<u8>, Unmet> {
    let actor = trial.actor()?;
    let (named, timestamp) = (Some(session.clone()), Some(trial.stamp()));
    let mut messages = vec![
        Message::AvailabilityRequest(AvailabilityRequest {
            timestamp,
            session: named.clone(),
            seize: false,
            revocation_list: None,
        }),
        Message::ControlRequest(ControlRequest { session: named.clone(), ..trial.pending(actor) }),
        Message::ControlRequest(trial.cancel(actor)),
    ];
    if trial.block()?.inquiry {
        messages.push(Message::Inquiry(Inquiry { timestamp, session: named, ..Inquiry::default() }));
    }
    let mut bytes = Vec::new();
    messages.iter().for_each(|message| urrcp::encode(message, &mut bytes));
    Ok(bytes)
}

fn lease_stranger(trial: &Trial) -> Checked {
    let (ours, theirs) = (session(trial)?, session(trial)?);
    let mut line = trial.connect()?;
    let mut stranger = trial.connect_second()?;
    let request = short(trial.pending(trial.actor()?));
    let ticket = line.held(&ControlRequest { session: Some(ours), ..request })?;
    sends_rejected_requests(trial, &theirs)?;
    let asks = || sends_rejected_requests(trial, &theirs).unwrap_or_default();
    chatter(trial, &mut stranger, &asks, Span::from_millis(900))?;
    line.ends_by(ticket, ErrorCode::LinkLost, trial.now() + trial.slack()).map_err(|unmet| {
        unmet.within(|why| {
            format!(
                "the server was silent for 900 ms while requests from another session were refused: {why}"
            )
        })
    })?;
    pass()
}
