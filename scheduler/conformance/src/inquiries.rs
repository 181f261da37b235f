//! Checks of inquiries: the robot answers them truthfully, and they have no effect.

use urrcp::{
    Command, ControlRequest, ControlType, DeviceId, ErrorCode, Inquiry, Millis, RequestId, RequestReport,
    RequestState, Script, Server, SessionId, Span, Status, Timestamp,
};

use super::heard::Ticket;
use super::line::{Inquired, Line};
use super::requirement::{Checked, Requirement, Unmet, differs, not_applicable, pass};
use super::starting::{EARLY_MAX, until_started};
use super::trial::{LATER_MS, LEASE_MS, Shaped, Trial};

pub(super) const ALL: [Requirement; 13] = [
    Requirement {
        name: "inquiry",
        number: "inquiry-1",
        demands: "An inquiry is answered with `OK`, the times of the exchange, and one entry for each request in the same order, with `unknown` for a request that never arrived.",
        section: "Inquiry (D)",
        check: inquiry,
    },
    Requirement {
        name: "inquiry-held",
        number: "inquiry-2",
        demands: "An accepted request that has not started is reported as `held`, with the time at which it will start.",
        section: "Inquiry (D)",
        check: held,
    },
    Requirement {
        name: "inquiry-running",
        number: "inquiry-3",
        demands: "A request whose start time has come is reported as `running`, with the number of completed steps and, once it has actually started, the time of that start.",
        section: "Inquiry (D)",
        check: running,
    },
    Requirement {
        name: "inquiry-ended",
        number: "inquiry-4",
        demands: "A request that has ended is reported as `ended`, with its actual start and the number of completed steps, or with the reason why it was refused or ended early.",
        section: "Inquiry (D)",
        check: ended,
    },
    Requirement {
        name: "inquiry-hash",
        number: "inquiry-5",
        demands: "The answer to an inquiry contains the content_hash of the accepted request.",
        section: "Inquiry (D)",
        check: hash,
    },
    Requirement {
        name: "inquiry-room",
        number: "inquiry-6",
        demands: "The room of a device is script_queue minus the number of commands that have not ended; a device that the robot does not have is omitted.",
        section: "Inquiry (D)",
        check: room,
    },
    Requirement {
        name: "inquiry-position",
        number: "inquiry-7",
        demands: "If the answer to an inquiry states the position of a device, this is the last commanded position.",
        section: "Inquiry (D)",
        check: position,
    },
    Requirement {
        name: "inquiry-no-effect",
        number: "inquiry-8",
        demands: "An inquiry about held requests and about requests that were never sent does not start, cancel or end any command.",
        section: "Inquiry (D)",
        check: no_effect,
    },
    Requirement {
        name: "inquiry-session",
        number: "inquiry-9",
        demands: "An inquiry does not claim the robot; if the robot belongs to another session, the answer contains only the error `busy`.",
        section: "Inquiry (D)",
        check: session,
    },
    Requirement {
        name: "lease-inquiry",
        number: "inquiry-10",
        demands: "An inquiry renews the leases of the server that sends it.",
        section: "Inquiry (D)",
        check: renews,
    },
    Requirement {
        name: "lease-inquiry-pending",
        number: "inquiry-11",
        demands: "pending_lease can shorten, but not extend, the lease of named requests that have not started; it does not affect other requests.",
        section: "Inquiry (D)",
        check: pending_lease,
    },
    Requirement {
        name: "lease-inquiry-until",
        number: "inquiry-12",
        demands: "pending_until ends the lease of each named request that has not started by that time on the robot's clock, whatever the robot receives in the meantime; a later inquiry with a different time changes it, and one without a time leaves it unchanged.",
        section: "Inquiry (D)",
        check: pending_until,
    },
    Requirement {
        name: "lease-until",
        number: "inquiry-13",
        demands: "A control request that has not started by its pending_until ends at that time, whatever the robot receives in the meantime; a request that arrives after its pending_until is refused with `late`.",
        section: "Inquiry (D)",
        check: own_pending_until,
    },
];

/// Duration of the leases in these checks, and time from an inquiry to the `pending_until` instant that it sets.
const PERIOD: Span = Span::from_millis(300);

/// Returns [`Unmet::NotApplicable`] if the robot does not answer inquiries.
pub(super) fn answering(trial: &Trial) -> Result<(), Unmet> {
    if trial.block()?.inquiry { Ok(()) } else { Err(not_applicable("the robot does not declare `inquiry`")) }
}

pub(super) fn about(requests: &[&ControlRequest]) -> Inquiry {
    let requests = requests.iter().filter_map(|request| request.request_id.clone()).collect();
    Inquiry { requests, ..Inquiry::default() }
}

/// Sends an inquiry about one request, and returns the robot's report on it.
fn told(line: &mut Line, request: &ControlRequest) -> Result<(Inquired, RequestReport), Unmet> {
    let inquired = line.inquire(&about(&[request]))?;
    match inquired.response.requests.as_slice() {
        [report] => Ok((inquired.clone(), report.clone())),
        _ => Err(inquired.differs("exactly one entry, about the request that the inquiry names")),
    }
}

/// Sends an inquiry about one request, and checks that the request is in the given state.
pub(super) fn in_state(
    line: &mut Line,
    request: &ControlRequest,
    state: RequestState,
) -> Result<(Inquired, RequestReport), Unmet> {
    let (inquired, report) = told(line, request)?;
    if report.state == state {
        Ok((inquired, report))
    } else {
        let word = format!("{state:?}").to_lowercase();
        Err(inquired.differs(&format!("state `{word}`")))
    }
}

fn inquiry(trial: &Trial) -> Checked {
    answering(trial)?;
    let mut line = trial.connect()?;
    let ids: Vec<_> = (0..3).filter_map(|_| RequestId::new(trial.fresh_id()).ok()).collect();
    let (_, _, before) = line.availability()?;
    let timestamp = Some(trial.stamp());
    let inquired = line.inquire(&Inquiry { timestamp, requests: ids.clone(), ..Inquiry::default() })?;
    let (_, _, after) = line.availability()?;
    let said = &inquired.response;
    if said.status != Status::Ok || said.error.is_some() {
        return Err(inquired.differs("status `OK`"));
    }
    if said.originate_timestamp != timestamp || said.receive_timestamp > said.timestamp {
        return Err(inquired
            .differs("originate_timestamp equal to the timestamp of the inquiry, and receive_timestamp no later than timestamp"));
    }
    let (from, until) = (before.message.timestamp, after.message.receive_timestamp);
    if said.receive_timestamp < from || said.timestamp > until {
        let expected =
            format!("times from {from} to {until}, between the exchanges before and after the inquiry");
        return Err(inquired.differs(&expected));
    }
    let unknown = ids.into_iter().map(|id| RequestReport::new(id, RequestState::Unknown));
    if said.requests.iter().cloned().eq(unknown) {
        pass()
    } else {
        Err(inquired.differs("only the three requests in the same order, each `unknown`"))
    }
}

/// Maximum difference due to rounding between a reported and a requested instant. The protocol sends milliseconds as doubles.
const ROUNDING: Span = Span::from_micros(1);

pub(super) fn is_at(told: Option<Timestamp<urrcp::Robot>>, request: &ControlRequest) -> bool {
    let start = request.starts_at().map(Timestamp::assume_clock);
    told.zip(start).is_some_and(|(told, start)| told - start <= ROUNDING && start - told <= ROUNDING)
}

fn held(trial: &Trial) -> Checked {
    answering(trial)?;
    let request = trial.pending(trial.actor()?);
    let mut line = trial.connect()?;
    line.held(&request)?;
    let (inquired, report) = in_state(&mut line, &request, RequestState::Held)?;
    let right = is_at(report.start_timestamp, &request) && report.event_timestamp.is_none();
    if right && report.error.is_none() {
        pass()
    } else {
        Err(inquired.differs(
            "start_timestamp equal to timestamp + time_offset_to_start of the request, no event_timestamp and no error",
        ))
    }
}

/// Repeats an inquiry until the request is in the given state or the timeout expires.
pub(super) fn reaches(
    trial: &Trial,
    line: &mut Line,
    request: &ControlRequest,
    state: RequestState,
) -> Result<(Inquired, RequestReport), Unmet> {
    let until = trial.patience() + Span::from_millis(1_000);
    loop {
        let (inquired, report) = told(line, request)?;
        if report.state == state || trial.now() >= until {
            return in_state(line, request, state).map(|_| (inquired, report));
        }
        trial.pause(Span::from_millis(20))?;
    }
}

fn running(trial: &Trial) -> Checked {
    answering(trial)?;
    running_ahead_of_its_first_value(trial)?;
    let request = trial.there_and_back(trial.scripted()?, 800.0).starting_in(100.0).leased(LEASE_MS);
    let mut line = trial.connect()?;
    line.held(&request)?;
    let (inquired, report) = reaches(trial, &mut line, &request, RequestState::Running)?;
    let began = report.event_timestamp.zip(report.start_timestamp);
    let late = began.map(|(event, start)| event - start);
    let in_time = late.is_some_and(|late| late >= Span::ZERO && late <= trial.options().tolerance);
    if !in_time || !is_at(report.start_timestamp, &request) {
        return Err(inquired.differs(&format!(
            "the start_timestamp of the request, and an event_timestamp at most {} later",
            trial.options().tolerance
        )));
    }
    // The robot sets the first step at the start and the second 400 ms later; the third one ends the script.
    if !matches!(report.steps_done, Some(1 | 2)) || report.error.is_some() {
        return Err(inquired.differs("steps_done 1, or 2 after 400 ms, and no error"));
    }
    Ok(late.map(|late| format!("started {late} after the scheduled time")).unwrap_or_default())
}

fn running_ahead_of_its_first_value(trial: &Trial) -> Result<(), Unmet> {
    let actor = trial.scripted()?;
    let steps = [(500.0, actor.rest), (800.0, actor.rest)];
    let request = trial.script(actor, &steps).starting_in(100.0).leased(LEASE_MS);
    let mut line = trial.connect()?;
    line.held(&request)?;
    let (inquired, report) = reaches(trial, &mut line, &request, RequestState::Running)?;
    let start = request.starts_at().map(|start| start + until_started(actor, &request));
    let Some(start) = start.map(Timestamp::assume_clock::<urrcp::Robot>) else { return Ok(()) };
    let tolerance = trial.options().tolerance;
    let right = match report.event_timestamp {
        Some(at) => at >= start - EARLY_MAX && at <= start + tolerance,
        None => inquired.response.timestamp <= start + tolerance,
    };
    if !right {
        return Err(inquired.differs(&format!(
            "an event_timestamp from {start} to {tolerance} later, and none before the script has started"
        )));
    }
    reaches(trial, &mut line, &request, RequestState::Ended).map(|_| ())
}

fn ended(trial: &Trial) -> Checked {
    answering(trial)?;
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let completed = trial.set(actor, actor.rest).leased(LEASE_MS);
    line.held(&completed)?;
    let (inquired, report) = reaches(trial, &mut line, &completed, RequestState::Ended)?;
    if report.event_timestamp.is_none() || report.steps_done != Some(1) || report.error.is_some() {
        return Err(inquired
            .differs("an event_timestamp, steps_done 1 and no error, because the request was completed"));
    }
    let refused = trial.refusable(actor).request;
    let ticket = line.ask(&refused)?;
    // The requirement `range` checks the refusal itself.
    if line.answer(ticket)?.message.status == Status::Failed {
        ended_early(&mut line, &refused, None)?;
    }
    let cancelled = trial.pending(actor);
    line.held(&cancelled)?;
    let stop = line.ask(&trial.cancel(actor))?;
    line.answer(stop)?;
    ended_early(&mut line, &cancelled, Some(&ErrorCode::Cancelled))?;
    pass()
}

/// Checks that the request ended without having started, and that the robot reports the reason.
fn ended_early(line: &mut Line, request: &ControlRequest, code: Option<&ErrorCode>) -> Result<(), Unmet> {
    let (inquired, report) = in_state(line, request, RequestState::Ended)?;
    let error = report.error.as_ref();
    let told = error.is_some_and(|error| code.is_none_or(|code| error.code == *code));
    if told && report.event_timestamp.is_none() {
        Ok(())
    } else {
        let code = code.map(|code| format!(" with error code `{code}`")).unwrap_or_default();
        Err(inquired.differs(&format!(
            "the reason why it ended{code}, and no event_timestamp, because it never started"
        )))
    }
}

fn hash(trial: &Trial) -> Checked {
    answering(trial)?;
    let mut request = trial.pending(trial.actor()?);
    request.content_hash = Some(request.command.content_hash());
    let mut line = trial.connect()?;
    line.held(&request)?;
    let (inquired, report) = in_state(&mut line, &request, RequestState::Held)?;
    if report.content_hash == request.content_hash {
        pass()
    } else {
        Err(inquired.differs("the content_hash of the request"))
    }
}

fn room(trial: &Trial) -> Checked {
    answering(trial)?;
    let actor = trial.actor()?;
    let device = actor.device.id.clone();
    let lacking = DeviceId::new(format!("{device}-that-is-not-there"));
    let devices: Vec<_> = lacking.into_iter().chain([device.clone()]).collect();
    let asks = Inquiry { devices, ..Inquiry::default() };
    let mut line = trial.connect()?;
    for held in 0..=1 {
        let inquired = line.inquire(&asks)?;
        let room = actor.device.script_queue.saturating_sub(held);
        let right = matches!(inquired.response.devices.as_slice(),
            [told] if told.device_id == device && told.room == room);
        if !right {
            return Err(inquired.differs(&format!(
                "only an entry for `{device}`, with room {room} (held commands: {held})"
            )));
        }
        if held == 0 {
            line.held(&trial.pending(actor))?;
        }
    }
    pass()
}

fn position(trial: &Trial) -> Checked {
    answering(trial)?;
    let actor = trial.actor()?;
    if actor.control_type != ControlType::Position {
        return Err(not_applicable("the device is not driven by `position`"));
    }
    let mut line = trial.connect()?;
    for value in [actor.near, actor.rest] {
        let request = trial.set(actor, value).leased(LEASE_MS);
        line.held(&request)?;
        reaches(trial, &mut line, &request, RequestState::Ended)?;
        let inquired =
            line.inquire(&Inquiry { devices: vec![actor.device.id.clone()], ..Inquiry::default() })?;
        let stated = inquired.response.devices.first().and_then(|device| device.position);
        match stated {
            None => return Err(not_applicable("the robot does not report the position of the device")),
            Some(stated) if (stated - value).abs() < actor.limits.granularity / 2.0 => {}
            Some(_) => return Err(inquired.differs(&format!("position {value}, which was commanded last"))),
        }
    }
    pass()
}

/// Checks that the robot sends no response to a held (accepted, not yet ended) request after having accepted it.
fn stays_held(trial: &Trial, line: &mut Line, ticket: Ticket) -> Result<(), Unmet> {
    line.listen(trial.soon(150), |line| line.asked(ticket).heard.len() > 1)?;
    match line.asked(ticket).heard.get(1) {
        None => Ok(()),
        Some(more) => {
            let sent = format!("{}, then an inquiry about it", line.asked(ticket).text.trim_end());
            Err(differs(&sent, &more.text, "nothing: an inquiry must not affect any command"))
        }
    }
}

fn no_effect(trial: &Trial) -> Checked {
    answering(trial)?;
    let actor = trial.actor()?;
    let request = trial.pending(actor);
    let mut line = trial.connect()?;
    let ticket = line.held(&request)?;
    let never_sent = trial.set(actor, actor.near);
    let everything = Inquiry {
        timestamp: Some(trial.stamp()),
        devices: vec![actor.device.id.clone()],
        pending_lease: Millis::new(LEASE_MS).ok(),
        ..about(&[&request, &never_sent])
    };
    line.inquire(&everything)?;
    stays_held(trial, &mut line, ticket)?;
    in_state(&mut line, &request, RequestState::Held)?;
    in_state(&mut line, &never_sent, RequestState::Unknown)?;
    pass()
}

fn session(trial: &Trial) -> Checked {
    answering(trial)?;
    let actor = trial.actor()?;
    let name = |n: u32| {
        SessionId::new(format!("{}/inquiry-{n}", trial.fresh_id())).map_err(|e| not_applicable(e.to_string()))
    };
    let (ours, theirs) = (name(1)?, name(2)?);
    let mut stranger = trial.connect()?;
    let mut line = trial.connect_second()?;
    stranger.inquire(&Inquiry { session: Some(theirs.clone()), ..Inquiry::default() })?;
    // The stranger has only inquired and claimed nothing, so another session may claim the robot.
    let request = ControlRequest { session: Some(ours.clone()), ..trial.pending(actor) };
    line.held(&request).map_err(|unmet| {
        unmet.within(|why| {
            format!("`{theirs}` had only sent an inquiry, which must not claim the robot: {why}")
        })
    })?;
    let judged = told_nothing(&mut stranger, &request, theirs);
    // The session owns the held command, so only that session can withdraw it.
    let empty = Command::Script(Script::cancel());
    let stop = ControlRequest { session: Some(ours), command: empty, ..trial.cancel(actor) };
    let stop = line.ask(&stop)?;
    line.answer(stop)?;
    judged
}

fn told_nothing(stranger: &mut Line, request: &ControlRequest, theirs: SessionId) -> Checked {
    for session in [Some(theirs), None] {
        let devices = vec![request.device_id.clone()];
        let inquired = stranger.inquire(&Inquiry { session, devices, ..about(&[request]) })?;
        let said = &inquired.response;
        let busy = said.error.as_ref().is_some_and(|error| error.code == ErrorCode::Busy);
        let silent = said.requests.is_empty() && said.devices.is_empty();
        if said.status != Status::Failed || !busy || !silent {
            return Err(inquired.differs(
                "status `Failed` with error code `busy`, no requests and no devices: the robot belongs to another session",
            ));
        }
    }
    pass()
}

fn renews(trial: &Trial) -> Checked {
    answering(trial)?;
    trial.reporting()?;
    let mut line = trial.connect()?;
    let ticket = line.held(&trial.pending(trial.actor()?).leased(PERIOD.as_millis_f64()))?;
    let until = trial.soon(900);
    while trial.now() < until {
        line.inquire(&Inquiry { timestamp: Some(trial.stamp()), ..Inquiry::default() })?;
        line.listen(trial.soon(PERIOD.as_nanos() / 3_000_000), |_| false)?;
    }
    match line.asked(ticket).heard.get(1) {
        None => Ok(format!("inquiries kept the command alive for 900 ms, with a lease of {PERIOD}")),
        Some(more) => Err(differs(
            &format!("{}, then an inquiry every 100 ms", line.asked(ticket).text.trim_end()),
            &more.text,
            "nothing: each inquiry renews the lease",
        )),
    }
}

fn pending_lease(trial: &Trial) -> Checked {
    answering(trial)?;
    trial.reporting()?;
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let other = if actor.device.script_queue > 1 { Some(line.held(&trial.pending(actor))?) } else { None };
    let named = trial.pending(actor).starting_in(LATER_MS + 1_000.0);
    let ticket = line.held(&named)?;
    let shorter = Inquiry { pending_lease: Some(Millis::from_span(PERIOD)), ..about(&[&named]) };
    line.inquire(&shorter)?;
    let sent = trial.now();
    let longer = Inquiry { pending_lease: Millis::new(LATER_MS).ok(), ..about(&[&named]) };
    let longer = line.inquire(&longer)?;
    let latest = PERIOD + trial.slack();
    line.listen(sent + latest, |line| line.asked(ticket).heard.len() > 1)?;
    if line.asked(ticket).heard.len() < 2 {
        let asked = format!("{}, after an inquiry with a pending_lease of {PERIOD}", longer.sent.trim_end());
        let expected = format!("the end of that lease after {PERIOD}, at the latest after {latest}");
        return Err(differs(&asked, "nothing", &expected));
    }
    other.map_or_else(pass, |other| stays_held(trial, &mut line, other).and_then(|()| pass()))
}

/// Returns [`Unmet::NotApplicable`] if the robot does not support `pending_until`, the instant at which a pending request ends.
fn limiting(trial: &Trial) -> Result<(), Unmet> {
    answering(trial)?;
    if trial.block()?.pending_until {
        trial.reporting()
    } else {
        Err(not_applicable("the robot does not declare `pending_until`"))
    }
}

fn pending_until(trial: &Trial) -> Checked {
    limiting(trial)?;
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let moved = trial.pending(actor);
    let ticket = line.held(&moved)?;
    line.inquire(&until_after(trial, PERIOD, &moved))?;
    let moving = line.inquire(&until_after(trial, PERIOD * 20, &moved))?;
    let over = trial.now() + PERIOD + trial.slack();
    line.listen(over, |line| line.asked(ticket).heard.len() > 1)?;
    if let Some(more) = line.asked(ticket).heard.get(1) {
        let sent = format!("{}, after an inquiry with an earlier pending_until", moving.sent.trim_end());
        return Err(differs(&sent, &more.text, "nothing: the later pending_until replaces the earlier one"));
    }
    // Read the clock first, so that a pause between these two lines does not make the robot appear early.
    let until = trial.now() + PERIOD;
    let inquired = line.inquire(&until_after(trial, PERIOD, &moved))?;
    ends_at(trial, &mut line, ticket, Limited { request: &moved, until, sent: &inquired.sent })
}

fn own_pending_until(trial: &Trial) -> Checked {
    limiting(trial)?;
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let limited = |after: Span| {
        let until = Some((trial.stamp() + after).assume_clock());
        ControlRequest { pending_until: until, ..trial.pending(actor) }
    };
    let passed = line.ask(&limited(Span::from_millis(-1_000)))?;
    line.refused(passed, &[ErrorCode::Late])?;
    let until = trial.now() + PERIOD;
    let request = limited(PERIOD);
    let ticket = line.held(&request)?;
    let sent = line.asked(ticket).text.clone();
    ends_at(trial, &mut line, ticket, Limited { request: &request, until, sent: &sent })
}

/// A request that ends at the instant `until`, and the text of the message that has set this instant.
struct Limited<'a> {
    request: &'a ControlRequest,
    until: Timestamp<Server>,
    sent: &'a str,
}

/// Checks that a request ends at its `pending_until` instant, even if further inquiries arrive before it.
fn ends_at(trial: &Trial, line: &mut Line, ticket: Ticket, limited: Limited<'_>) -> Checked {
    let Limited { request, until, sent } = limited;
    // The first inquiry renews the lease without naming the request. The second names the request, but sets no instant.
    let asks = [Inquiry::default(), about(&[request])];
    for inquiry in asks.iter().cycle() {
        if trial.now() >= until + trial.slack() || line.asked(ticket).heard.len() > 1 {
            break;
        }
        line.inquire(&Inquiry { timestamp: Some(trial.stamp()), ..inquiry.clone() })?;
        line.listen(trial.soon(50), |line| line.asked(ticket).heard.len() > 1)?;
    }
    match line.asked(ticket).heard.get(1) {
        None => Err(differs(sent, "nothing", "the end of the request at `pending_until`")),
        Some(end) if end.at < until - ROUNDING => {
            Err(differs(sent, &end.text, "the end of the request at `pending_until`, not before"))
        }
        Some(end) => Ok(format!("the request ended {} after its `pending_until`", end.at - until)),
    }
}

/// Creates an inquiry that sets the `pending_until` instant of a request to `after` from now.
fn until_after(trial: &Trial, after: Span, request: &ControlRequest) -> Inquiry {
    Inquiry { pending_until: Some((trial.stamp() + after).assume_clock()), ..about(&[request]) }
}
