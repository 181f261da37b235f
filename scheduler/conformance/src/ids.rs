//! Checks that the robot compares and repeats ids and names character by character.

use serde_json::json;
use urrcp::{
    Command, ControlRequest, DeviceId, ErrorCode, Message, RequestId, SessionId, Setpoint, Status, encode,
};

use super::identity::claim;
use super::line::Line;
use super::requirement::{Checked, Requirement, Unmet, differs, not_applicable, pass};
use super::stopping::cancels;
use super::trial::{LATER_MS, LEASE_MS, Shaped, Trial};

pub(super) const ALL: [Requirement; 4] = [
    Requirement {
        name: "odd-ids",
        number: "core-56",
        demands: "A request_id is repeated character by character, with its capitals, spaces, quotation marks and control characters, in composed or decomposed form, and in each way of escaping.",
        section: "Messages (D)",
        check: odd_ids,
    },
    Requirement {
        name: "similar-ids",
        number: "core-57",
        demands: "Request ids that differ only in case, in composition or in their last character are different.",
        section: "Messages (D)",
        check: similar_ids,
    },
    Requirement {
        name: "similar-devices",
        number: "core-58",
        demands: "A device_id that resembles that of a device, but differs in case, in a space or in its last character, is unknown.",
        section: "Messages (D)",
        check: similar_devices,
    },
    Requirement {
        name: "similar-sessions",
        number: "core-59",
        demands: "Sessions whose names differ only in case or in a space are different.",
        section: "Messages (D)",
        check: similar_sessions,
    },
];

/// Ends of ids that implementers have changed: capitals, spaces, a decomposed letter, letters beyond 16 bits, characters that JSON
/// escapes.
const ODD: [&str; 7] = [
    "Capital\u{c4}",
    " two  spaces ",
    "decomposed e\u{301}",
    "\u{1d11e}\u{1f9be}",
    "\"quoted\" \\ and / ",
    "nul \u{0} and \u{1}\u{7f}",
    "\t",
];

/// Encodes a request as a line.
pub(super) fn line_of(request: &ControlRequest) -> String {
    let mut bytes = Vec::new();
    encode(&Message::ControlRequest(request.clone()), &mut bytes);
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Writes a string in JSON with each UTF-16 unit escaped.
fn escaped(text: &str) -> String {
    text.encode_utf16().map(|unit| format!("\\u{unit:04X}")).collect()
}

fn odd_ids(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    for odd in ODD {
        for escapes in [false, true] {
            let id = format!("{odd}{}{odd}", trial.fresh_id());
            let request = ControlRequest { request_id: RequestId::new(&id).ok(), ..trial.pending(actor) };
            let mut text = line_of(&request);
            if escapes {
                let plain = json!(id).to_string();
                text = text.replace(&plain, &format!("\"{}\"", escaped(&id)));
            }
            let ticket = line.ask_text(Some(id), actor.device.id.as_str(), &text)?;
            line.accepted(ticket)?;
            cancels(trial, &mut line, &trial.cancel(actor))?;
        }
    }
    // The empty id may have been used before, so its answer may be one that the robot has kept.
    let empty = ControlRequest { request_id: RequestId::new("").ok(), ..trial.pending(actor) };
    let ticket = line.ask(&empty)?;
    let answer = line.answer(ticket)?;
    if answer.message.request_id == empty.request_id {
        return pass();
    }
    Err(differs(&line.asked(ticket).text, &answer.text, "the empty request_id of the request"))
}

fn similar_ids(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let common = trial.fresh_id() + &"/long".repeat(40);
    for [one, other] in [["a", "A"], ["\u{e9}", "e\u{301}"], ["1", "2"], ["", " "]] {
        for (end, before) in [(one, None), (other, Some(one))] {
            let id = RequestId::new(format!("{common}{end}")).ok();
            let held = line.held(&ControlRequest { request_id: id, ..trial.pending(actor) });
            held.map_err(|unmet| match before {
                Some(before) => {
                    unmet.within(|why| format!("the request_id ...`{before}` was used before: {why}"))
                }
                None => unmet,
            })?;
            cancels(trial, &mut line, &trial.cancel(actor))?;
        }
    }
    pass()
}

/// Swaps small and capital letters.
fn case_swapped(text: &str) -> String {
    let swap = |c: char| if c.is_lowercase() { c.to_ascii_uppercase() } else { c.to_ascii_lowercase() };
    text.chars().map(swap).collect()
}

fn similar_devices(trial: &Trial) -> Checked {
    let (block, id) = (trial.block()?, trial.actor()?.device.id.to_string());
    let shorter: String = id.chars().take(id.chars().count() - 1).collect();
    let similar = [case_swapped(&id), format!("{id} "), format!(" {id}"), format!("{id}0"), shorter];
    let mut line = trial.connect()?;
    for name in similar.into_iter().filter(|name| block.device(name).is_none()) {
        let Ok(device) = DeviceId::new(name) else { continue };
        let command = Command::Set(Setpoint::new(trial.actor()?.control_type, trial.actor()?.rest));
        let request = trial.request(&device, command).starting_in(LATER_MS).leased(LEASE_MS);
        line.refuses(&request, ErrorCode::UnknownDevice)?;
    }
    pass()
}

fn similar_sessions(trial: &Trial) -> Checked {
    let name = format!("{}/Session", trial.fresh_id());
    let session = |name: String| SessionId::new(name).map_err(|error| not_applicable(error.to_string()));
    let ours = session(name.clone())?;
    let mut stranger = trial.connect()?;
    let mut line = trial.connect_second()?;
    let (sent, taken) = claim(trial, &mut line, &ours)?;
    if taken.message.status != Status::Ok {
        return Err(differs(&sent, &taken.text, "status `OK`: the robot is free"));
    }
    for similar in [case_swapped(&name), format!("{name} "), format!(" {name}")] {
        is_busy_for(trial, &mut stranger, &session(similar)?, &ours)?;
    }
    pass()
}

/// Checks that a session cannot claim the robot, which belongs to the session `owner`.
pub(super) fn is_busy_for(
    trial: &Trial,
    stranger: &mut Line,
    session: &SessionId,
    owner: &SessionId,
) -> Result<(), Unmet> {
    let (sent, answer) = claim(trial, stranger, session)?;
    let busy = answer.message.error.as_ref().is_some_and(|error| error.code == ErrorCode::Busy);
    if answer.message.status == Status::Failed && busy {
        return Ok(());
    }
    let expected =
        format!("status `Failed` with error code `busy`: the robot belongs to the session `{owner}`");
    Err(differs(&sent, &answer.text, &expected))
}
