//! Checks of repeated requests: which answers a robot keeps, for whom, and how it compares hashes.

use serde_json::json;
use urrcp::{ContentHash, ControlRequest, ErrorCode, RequestId, Status};

use super::ids::line_of;
use super::owners::{of, session};
use super::requirement::{Checked, Requirement, Unmet, differs, pass};
use super::stopping::cancels;
use super::trial::{Shaped, Trial};
use super::wire::{line_of as line_of_json, sound};

pub(super) const ALL: [Requirement; 6] = [
    Requirement {
        name: "repeated-elsewhere",
        number: "core-60",
        demands: "A request that is repeated on another connection is answered again and not executed again.",
        section: "Asked twice (D)",
        check: repeated_elsewhere,
    },
    Requirement {
        name: "repeated-stop",
        number: "core-61",
        demands: "A repeated empty script is answered with `OK` again, and ends no command that was accepted since.",
        section: "Asked twice (D)",
        check: repeated_stop,
    },
    Requirement {
        name: "malformed-kept",
        number: "core-62",
        demands: "A refusal because of a wrong content_hash is kept: a repetition of the request is refused as well.",
        section: "Asked twice (D)",
        check: malformed_kept,
    },
    Requirement {
        name: "malformed-not-kept",
        number: "core-63",
        demands: "The answer to a line that is not a message is not kept: a valid request may use its request_id.",
        section: "Messages (D)",
        check: malformed_not_kept,
    },
    Requirement {
        name: "busy-not-kept",
        number: "core-64",
        demands: "A refusal with `busy` because of the session is not kept: the same request is accepted once the robot is free.",
        section: "Asked twice (D)",
        check: busy_not_kept,
    },
    Requirement {
        name: "hash-digits",
        number: "core-65",
        demands: "A content_hash in capital digits is equal to the same one in small digits, and is answered in small digits.",
        section: "Content hash (D)",
        check: hash_digits,
    },
];

fn repeated_elsewhere(trial: &Trial) -> Checked {
    let request = trial.pending(trial.actor()?);
    let mut line = trial.connect()?;
    let mut other = trial.connect_second()?;
    line.held(&request)?;
    let again = other.ask(&request)?;
    other.accepted(again).map_err(|unmet| {
        unmet.within(|why| format!("the same request was accepted before on another connection: {why}"))
    })?;
    pass()
}

fn repeated_stop(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let stop = line.ask(&trial.cancel(actor))?;
    line.answer(stop)?;
    let held = line.held(&trial.pending(actor))?;
    line.ask_again(stop)?;
    let again = line.nth_answer(stop, 1)?;
    if !trial.confirms_rest(&again.message) {
        let sent = format!("the same request again: {}", line.asked(stop).text);
        return Err(differs(&sent, &again.text, "status `OK`, as before"));
    }
    line.stays_held(held, 50, "the stop had been answered before this command was sent")?;
    pass()
}

fn malformed_kept(trial: &Trial) -> Checked {
    trial.checking_hashes()?;
    let request = trial.pending(trial.actor()?);
    let wrong = ControlRequest { content_hash: Some(ContentHash::of(b"something else")), ..request.clone() };
    let mut line = trial.connect()?;
    line.refuses(&wrong, ErrorCode::Malformed)?;
    line.refuses(&request, ErrorCode::Malformed).map_err(|unmet| {
        unmet.within(|why| format!("this request_id was refused because of a wrong content_hash: {why}"))
    })?;
    pass()
}

fn malformed_not_kept(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut wrong = sound(trial)?;
    wrong["control_type"] = json!(7);
    let mut line = trial.connect()?;
    line.is_malformed(&line_of_json(&wrong))?;
    let id = wrong["request_id"].as_str().and_then(|id| RequestId::new(id).ok());
    line.held(&ControlRequest { request_id: id, ..trial.pending(actor) }).map_err(|unmet| {
        unmet.within(|why| format!("a line that was not a message had this request_id: {why}"))
    })?;
    pass()
}

fn busy_not_kept(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let (ours, theirs) = (session(trial)?, session(trial)?);
    let mut stranger = trial.connect()?;
    let mut owner = trial.connect_second()?;
    owner.held(&of(&ours, trial.pending(actor)))?;
    let request = of(&theirs, trial.pending(actor));
    stranger.refuses(&request, ErrorCode::Busy)?;
    cancels(trial, &mut owner, &of(&ours, trial.cancel(actor)))?;
    drop(owner);
    let until = trial.patience();
    loop {
        let ticket = stranger.ask(&request)?;
        let answer = stranger.answer(ticket)?;
        let busy = answer.message.error.as_ref().is_some_and(|error| error.code == ErrorCode::Busy);
        match answer.message.status {
            Status::Accepted => break,
            _ if busy && trial.now() < until => trial.pause(urrcp::Span::from_millis(50))?,
            _ => {
                let expected = "`Accepted`: the robot is free, and refusals with `busy` are not kept";
                return Err(differs(&stranger.asked(ticket).text, &answer.text, expected));
            }
        }
    }
    cancels(trial, &mut stranger, &of(&theirs, trial.cancel(actor)))?;
    pass()
}

fn hash_digits(trial: &Trial) -> Checked {
    trial.checking_hashes()?;
    let actor = trial.actor()?;
    let mut request = trial.pending(actor).leased(1_000.0);
    let hash = request.command.content_hash();
    request.content_hash = Some(hash);
    let small = hash.to_string();
    let text = line_of(&request).replace(&small, &small.to_uppercase());
    let id = request.request_id.as_ref().map(ToString::to_string);
    let mut line = trial.connect()?;
    let ticket = line.ask_text(id, actor.device.id.as_str(), &text)?;
    let answer = line.accepted(ticket)?;
    if answer.text.contains(&small) {
        return pass();
    }
    Err::<String, Unmet>(differs(&text, &answer.text, &format!("content_hash {small}")))
}
