//! Checks of request ids, content hashes and sessions.

use urrcp::{
    AvailabilityRequest, AvailabilityResponse, Command, ContentHash, ControlRequest, ErrorCode, Message,
    RequestId, SessionId, Status,
};

use super::heard::Received;
use super::line::Line;
use super::requirement::{Checked, Requirement, Unmet, differs, not_applicable, pass};
use super::trial::{LATER_MS, LEASE_MS, Refusable, Shaped, Trial};

pub(super) const ALL: [Requirement; 8] = [
    Requirement {
        name: "request-id",
        number: "core-48",
        demands: "Every response (acceptance, report or refusal) carries the request_id of its request.",
        section: "Control response",
        check: request_id,
    },
    Requirement {
        name: "repeated-request",
        number: "core-49",
        demands: "A request that is repeated with the same request_id is answered again and not executed again.",
        section: "Asked twice (D)",
        check: repeated_request,
    },
    Requirement {
        name: "repeated-refusal",
        number: "core-50",
        demands: "A refused request that is repeated is refused again with the same error code, even if its content differs.",
        section: "Asked twice (D)",
        check: repeated_refusal,
    },
    Requirement {
        name: "kept-answers",
        number: "core-51",
        demands: "The last answer to a request is kept until 256 others have ended, or 8 others if no device accepts scripts: if the request is repeated before that, the robot repeats the answer and does not execute the request again.",
        section: "Asked twice (D)",
        check: kept_answers,
    },
    Requirement {
        name: "no-request-id",
        number: "core-52",
        demands: "A request without a request_id is processed.",
        section: "Control response",
        check: no_request_id,
    },
    Requirement {
        name: "content-hash",
        number: "core-53",
        demands: "If a device accepts scripts, the content_hash of a request is checked: a correct one is repeated in the response, a wrong one is refused with `malformed`.",
        section: "Content hash (D)",
        check: content_hash,
    },
    Requirement {
        name: "session",
        number: "core-54",
        demands: "A robot that belongs to a session refuses other sessions with `busy` and does not reveal the name of its session; once that session has ended, another session can claim the robot.",
        section: "Sessions and connections (D)",
        check: session,
    },
    Requirement {
        name: "session-reading",
        number: "core-55",
        demands: "If another session requests a reading from a device that is not a sensor, the robot refuses the request with `busy` and does not end any command.",
        section: "Sensors",
        check: session_reading,
    },
];

fn request_id(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    // A string of the maximum length that also contains non-ASCII characters.
    let mut set = trial.set(actor, actor.rest).leased(LEASE_MS);
    let id = format!("{}/", trial.fresh_id());
    let long = format!("{id}{}", "\u{44f}".repeat(urrcp::STRING_CHARS_MAX - id.chars().count()));
    set.request_id = RequestId::new(long).ok();
    let beyond = trial.refusable(actor).request;
    let mut tickets = vec![line.held(&set)?];
    if trial.reports() {
        line.report(tickets[0], &Status::Ok, trial.patience())?;
    }
    for request in [beyond, trial.cancel(actor)] {
        let ticket = line.ask(&request)?;
        line.answer(ticket)?;
        tickets.push(ticket);
    }
    for ticket in tickets {
        let asked = line.asked(ticket);
        let without = asked.heard.iter().find(|heard| heard.message.request_id.is_none());
        if let Some(heard) = without {
            return Err(differs(
                &asked.text,
                &heard.text,
                "the request_id of the request in every response to it",
            ));
        }
    }
    pass()
}

fn repeated_request(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let pending = line.held(&trial.pending(actor))?;
    line.ask_again(pending)?;
    let again = line.nth_answer(pending, 1)?;
    if again.message.status != Status::Accepted {
        let sent = format!("the same request again: {}", line.asked(pending).text);
        return Err(differs(
            &sent,
            &again.text,
            "`Accepted`, as before: the request is answered again and not executed again",
        ));
    }
    let cancel = line.ask(&trial.cancel(actor))?;
    line.answer(cancel)?;
    if !trial.reports() {
        return Ok("answered twice; without `reports`, it is unknown how often it was executed".to_owned());
    }
    let ticket = line.held(&trial.set(actor, actor.rest).starting_in(300.0).leased(LEASE_MS))?;
    line.ask_again(ticket)?;
    line.report(ticket, &Status::Ok, trial.patience())?;
    line.listen(trial.soon(150), |_| false)?;
    let asked = line.asked(ticket);
    let started = asked.heard.iter().filter(|heard| heard.message.status == Status::Started).count();
    match started {
        1 => pass(),
        n => Err(differs(
            &format!("twice: {}", asked.text),
            &format!("{n} reports `Started`"),
            "only one such report, because the request is executed only once",
        )),
    }
}

fn repeated_refusal(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let Refusable { request, code } = trial.refusable(actor);
    line.refuses(&request, code.clone())?;
    let right = ControlRequest { request_id: request.request_id, ..trial.pending(actor) };
    line.refuses(&right, code.clone()).map_err(|unmet| {
        unmet.within(|why| format!("the same request_id has just been refused with `{code}`: {why}"))
    })?;
    pass()
}

/// Number of ended requests whose responses a robot has to remember, to answer repeated requests.
const KEPT: usize = 256;
/// The same number for a robot without scripts.
const KEPT_IN_CORE: usize = 8;

fn kept_answers(trial: &Trial) -> Checked {
    const AT_A_TIME: usize = 15;
    let actor = trial.actor()?;
    let kept = if trial.accepts_scripts() { KEPT } else { KEPT_IN_CORE };
    let mut line = trial.connect()?;
    let ends = |line: &mut Line, ticket| {
        if trial.reports() {
            line.report(ticket, &Status::Ok, trial.patience()).map(drop)
        } else {
            trial.pause(urrcp::Span::from_millis(500))
        }
    };
    // If the robot has forgotten the request, it refuses the repetition as late.
    let first = line.held(&trial.set(actor, actor.rest).starting_in(300.0).leased(LEASE_MS))?;
    ends(&mut line, first)?;
    let mut others = 1;
    while others < kept {
        let set = line.held(&trial.set(actor, actor.rest).leased(LEASE_MS))?;
        others += 1;
        if trial.reports() {
            ends(&mut line, set)?;
        }
        let refused = || trial.refusable(actor).request;
        let some = (kept - others).min(AT_A_TIME);
        let tickets: Result<Vec<_>, _> = (0..some).map(|_| line.ask(&refused())).collect();
        for ticket in tickets? {
            line.answer(ticket)?;
        }
        others += some;
    }
    let heard = line.asked(first).heard.clone();
    line.ask_again(first)?;
    let again = line.nth_answer(first, heard.len())?;
    // A robot that does not declare `reports` does not report the end of the request.
    let same = match heard.last() {
        Some(last) if trial.reports() => {
            (&last.message.status, last.message.event_timestamp)
                == (&again.message.status, again.message.event_timestamp)
        }
        _ => again.message.status != Status::Failed,
    };
    if same {
        Ok(format!("the answer was still remembered after {} other requests", kept - 1))
    } else {
        Err(differs(
            &format!("the same request again, after {} others: {}", kept - 1, line.asked(first).text),
            &again.text,
            &format!("the same final response as before: {}", heard.last().map_or("", |last| &last.text)),
        ))
    }
}

fn no_request_id(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    line.held(&ControlRequest { request_id: None, ..trial.pending(actor) })?;
    pass()
}

fn content_hash(trial: &Trial) -> Checked {
    trial.checking_hashes()?;
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let mut requests = vec![trial.set(actor, actor.near).starting_in(LATER_MS).leased(LEASE_MS)];
    if actor.in_script {
        requests.push(trial.pending(actor));
    }
    for mut request in requests {
        request.content_hash = Some(request.command.content_hash());
        let ticket = line.held(&request)?;
        let accepted = line.answer(ticket)?;
        if accepted.message.content_hash != request.content_hash {
            let expected = "the same content_hash, as computed by the robot";
            return Err(differs(&line.asked(ticket).text, &accepted.text, expected));
        }
        let cancel = line.ask(&trial.cancel(actor))?;
        line.answer(cancel)?;
        request.content_hash = Some(ContentHash::of(b"something else"));
        request.request_id = RequestId::new(trial.fresh_id()).ok();
        line.refuses(&request, ErrorCode::Malformed)?;
    }
    pass()
}

/// Sends an availability request that claims the robot for `session`.
pub(super) fn claim(
    trial: &Trial,
    line: &mut Line,
    name: &SessionId,
) -> Result<(String, Received<AvailabilityResponse>), Unmet> {
    let request = AvailabilityRequest {
        timestamp: Some(trial.stamp()),
        session: Some(name.clone()),
        seize: false,
        revocation_list: None,
    };
    let sent = line.say(&Message::AvailabilityRequest(request))?;
    match line.other(trial.patience())? {
        Some(Received { at, text, message: Message::AvailabilityResponse(message) }) => {
            Ok((sent, Received { at, text, message }))
        }
        other => {
            let came = other
                .map_or_else(|| format!("nothing within {}", trial.options().patience), |other| other.text);
            Err(differs(&sent, &came, "an availability_response"))
        }
    }
}

fn session_reading(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    if actor.device.available_control_types.sensor().is_some() {
        return Err(not_applicable(format!(
            "`{}` is also a sensor, so it may answer requests for a reading",
            actor.device.id
        )));
    }
    let name = format!("{}/owner", trial.fresh_id());
    let owner = SessionId::new(name).map_err(|error| not_applicable(error.to_string()))?;
    let mut stranger = trial.connect()?;
    let mut line = trial.connect_second()?;
    let ticket = line.held(&ControlRequest { session: Some(owner.clone()), ..trial.pending(actor) })?;
    let refused = stranger.refuses(&trial.request(&actor.device.id, Command::ReadSensor), ErrorCode::Busy);
    line.listen(trial.soon(100), |line| line.asked(ticket).heard.len() > 1)?;
    let ended = line.asked(ticket).heard.get(1).map(|more| {
        differs(
            &line.asked(ticket).text,
            &more.text,
            "nothing: requests from other sessions must not end the owner's commands",
        )
    });
    // The session owns the held command, so only that session can withdraw it.
    let stop = line.ask(&ControlRequest { session: Some(owner), ..trial.cancel(actor) })?;
    line.answer(stop)?;
    refused?;
    ended.map_or_else(pass, Err)
}

fn session(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let name = |n: u32| {
        SessionId::new(format!("{}/session-{n}", trial.fresh_id())).map_err(|e| not_applicable(e.to_string()))
    };
    let (ours, theirs) = (name(1)?, name(2)?);
    let mut second = trial.connect()?;
    let mut first = trial.connect_second()?;
    let (sent, taken) = claim(trial, &mut first, &ours)?;
    if taken.message.status != Status::Ok {
        return Err(differs(&sent, &taken.text, "status `OK`: the robot is free"));
    }
    let holder = format!(
        "status `Failed` with error code `busy`, without the name `{ours}`, which only the owning session may know"
    );
    let told = |error: Option<&urrcp::ControlError>| {
        error.is_some_and(|e| e.code == ErrorCode::Busy && !e.message.contains(ours.as_str()))
    };
    let (sent, refused) = claim(trial, &mut second, &theirs)?;
    if refused.message.status != Status::Failed || !told(refused.message.error.as_ref()) {
        return Err(differs(&sent, &refused.text, &holder));
    }
    for session in [Some(theirs.clone()), None] {
        let ticket = second.ask(&ControlRequest { session, ..trial.pending(actor) })?;
        let answer = second.answer(ticket)?;
        if answer.message.status != Status::Failed || !told(answer.message.error.as_ref()) {
            return Err(differs(&second.asked(ticket).text, &answer.text, &holder));
        }
    }
    first.held(&ControlRequest { session: Some(ours.clone()), ..trial.pending(actor) })?;
    let stop = first.ask(&ControlRequest { session: Some(ours.clone()), ..trial.cancel(actor) })?;
    first.answer(stop)?;
    drop(first);
    let until = trial.patience();
    loop {
        let (sent, answer) = claim(trial, &mut second, &theirs)?;
        if answer.message.status == Status::Ok {
            return pass();
        }
        if trial.now() >= until {
            let expected =
                format!("status `OK`: the connection of `{ours}` is closed and the robot holds no commands");
            return Err(differs(&sent, &answer.text, &expected));
        }
        trial.pause(urrcp::Span::from_millis(50))?;
    }
}
