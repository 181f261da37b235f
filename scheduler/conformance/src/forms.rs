//! Checks of the forms in which a message may be written, and of messages that resemble valid ones.

use serde_json::{Value, json};
use urrcp::{AvailabilityRequest, Encoding, ErrorCode, Message, Status, encode_as};

use super::line::Line;
use super::requirement::{Checked, Requirement, Unmet, differs, not_applicable, pass};
use super::trial::{LATER_MS, LEASE_MS, Shaped, Trial};
use super::wire::{line_of, sound};

pub(super) const ALL: [Requirement; 7] = [
    Requirement {
        name: "line-endings",
        number: "core-86",
        demands: "A `\\r` before the `\\n` and white space around a message are skipped, and so are lines that consist of white space.",
        section: "Framing (D)",
        check: line_endings,
    },
    Requirement {
        name: "null-keys",
        number: "core-87",
        demands: "`null` in an optional key means that the key is omitted.",
        section: "Messages (D)",
        check: null_keys,
    },
    Requirement {
        name: "number-forms",
        number: "core-88",
        demands: "Numbers may have a fraction of zeros or an exponent, and keys may be in any order.",
        section: "Framing (D)",
        check: number_forms,
    },
    Requirement {
        name: "fractions",
        number: "core-89",
        demands: "Offsets and periods may be fractions of a millisecond.",
        section: "Control request",
        check: fractions,
    },
    Requirement {
        name: "two-values",
        number: "core-90",
        demands: "A second value of a position, speed or acceleration, or next to a script, is refused with `malformed`.",
        section: "Refusing",
        check: two_values,
    },
    Requirement {
        name: "vectors",
        number: "core-91",
        demands: "Each invalid message of the test vectors is answered with `malformed`, and the connection remains usable.",
        section: "Messages (D)",
        check: vectors,
    },
    Requirement {
        name: "encodings",
        number: "core-92",
        demands: "A robot that lists the encoding `msgpack` reads frames of it, and answers a frame with a frame.",
        section: "Initialization",
        check: encodings,
    },
];

/// The invalid messages of `tests/vectors` that a server could send, as the bytes of a line, each as the character with its number. The
/// list is generated from `tests/vectors/index.json`, without those messages that a robot may accept.
const INVALID: &str = include_str!("vectors.json");

fn line_endings(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    for blank in ["\r\n", "  \n", "\t\r\n"] {
        line.send(blank.as_bytes())?;
    }
    let hello = |stamp| json!({"availability_request": {"timestamp": stamp}}).to_string();
    for [before, after] in [["", "\r\n"], ["  ", " \r\n"], ["\t", "\t\n"]] {
        let stamp = trial.stamp();
        let text = format!("{before}{}{after}", hello(stamp));
        line.send(text.as_bytes())?;
        let heard = line.other(trial.patience())?;
        let is_answer = |message: &Message| {
            matches!(message, Message::AvailabilityResponse(response)
                if response.status == Status::Ok && response.originate_timestamp == Some(stamp))
        };
        if !heard.as_ref().is_some_and(|heard| is_answer(&heard.message)) {
            let came = heard.map_or_else(|| "nothing".to_owned(), |heard| heard.text);
            let sent = format!("blank lines, then {text:?}");
            return Err(differs(&sent, &came, "only an availability_response with status `OK`"));
        }
    }
    pass()
}

/// Sends the text of a control request, checks that the robot accepts it, and cancels it.
fn is_accepted(trial: &Trial, line: &mut Line, id: &Value, text: &str) -> Result<(), Unmet> {
    let actor = trial.actor()?;
    let ticket = line.ask_text(id.as_str().map(str::to_owned), actor.device.id.as_str(), text)?;
    line.accepted(ticket)?;
    let cancel = line.ask(&trial.cancel(actor))?;
    line.answer(cancel).map(drop)
}

fn text_of(request: &Value) -> String {
    String::from_utf8_lossy(&line_of(request)).into_owned()
}

fn null_keys(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let mut request = sound(trial)?;
    for key in ["session", "content_hash", "pending_until", "home", "control_value_2"] {
        request[key] = Value::Null;
    }
    request["stop_condition"] = json!({"pending": LEASE_MS, "running": null});
    is_accepted(trial, &mut line, &request["request_id"], &text_of(&request))?;
    let mut request = sound(trial)?;
    request["stop_condition"] = Value::Null;
    is_accepted(trial, &mut line, &request["request_id"], &text_of(&request))?;
    pass()
}

fn number_forms(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    let mut line = trial.connect()?;
    let id = json!(trial.fresh_id());
    let keys = [
        format!("\"control_value\":{:e}", actor.rest),
        format!("\"stop_condition\":{LEASE_MS:.3}"),
        format!("\"request_id\":{id}"),
        format!("\"device_id\":{}", json!(actor.device.id)),
        "\"time_offset_to_start\":2.0E+4".to_owned(),
        format!("\"control_type\":{}", json!(actor.control_type)),
        format!("\"timestamp\":{}", json!(trial.stamp())),
    ];
    is_accepted(trial, &mut line, &id, &format!("{{\"control_request\" : {{{}}}}}\n", keys.join(" ,\t")))?;
    pass()
}

fn fractions(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let mut request = sound(trial)?;
    request["time_offset_to_start"] = json!(LATER_MS + 0.25);
    request["stop_condition"] = json!(LEASE_MS + 0.5);
    is_accepted(trial, &mut line, &request["request_id"], &text_of(&request))?;
    if let Ok(actor) = trial.scripted() {
        let script = trial.script(actor, &[(0.5, actor.rest), (100.125, actor.near), (200.75, actor.rest)]);
        line.held(&script.starting_in(LATER_MS).leased(LEASE_MS))?;
    }
    pass()
}

fn two_values(trial: &Trial) -> Checked {
    let actor = trial.actor()?;
    if !actor.is_bounded() {
        return Err(not_applicable(format!("a {} may have several values", actor.control_type)));
    }
    let doubled = |mut request: Value| {
        request["control_value_2"] = json!(actor.rest);
        request
    };
    let step =
        json!({"time_offset_to_start": 0, "control_type": actor.control_type, "control_value": actor.rest});
    let script = |steps: Value| -> Result<Value, Unmet> {
        let mut request = sound(trial)?;
        request["control_type"] = json!("script");
        request["control_value"] = steps;
        Ok(request)
    };
    let mut requests = vec![doubled(sound(trial)?)];
    if actor.in_script {
        requests.extend([script(json!([doubled(step.clone())]))?, doubled(script(json!([step]))?)]);
    }
    let mut line = trial.connect()?;
    for request in requests {
        let id = request["request_id"].as_str().map(str::to_owned);
        let ticket = line.ask_text(id, actor.device.id.as_str(), &text_of(&request))?;
        line.refused(ticket, &[ErrorCode::Malformed])?;
    }
    pass()
}

fn vectors(trial: &Trial) -> Checked {
    let invalid: Vec<String> =
        serde_json::from_str(INVALID).map_err(|error| not_applicable(error.to_string()))?;
    // A robot without scripts refuses them unseen.
    let scripts = trial.accepts_scripts();
    let tried: Vec<_> =
        invalid.iter().filter(|text| scripts || !text.contains("\"control_type\":\"script\"")).collect();
    let mut line = trial.connect()?;
    for text in &tried {
        let bytes: Vec<u8> = text.chars().filter_map(|c| u8::try_from(u32::from(c)).ok()).collect();
        line.is_malformed(&bytes)?;
    }
    line.survives("all of these messages")?;
    Ok(format!("{} invalid messages", tried.len()))
}

fn encodings(trial: &Trial) -> Checked {
    let named = Encoding::MessagePack.as_str();
    if !trial.block()?.encodings.iter().any(|encoding| encoding.as_str() == named) {
        return Err(not_applicable(format!("the robot does not list the encoding `{named}`")));
    }
    let timestamp = Some(trial.stamp());
    let request =
        Message::AvailabilityRequest(AvailabilityRequest { timestamp, ..AvailabilityRequest::default() });
    let mut frame = Vec::new();
    encode_as(Encoding::MessagePack, &request, &mut frame);
    let what = format!("a frame of {} bytes with an availability_request", frame.len());
    let mut line = trial.connect()?;
    match line.exchange_frame(&frame)? {
        Some(Message::AvailabilityResponse(response)) if response.originate_timestamp == timestamp => pass(),
        other => {
            let came = other.map_or_else(|| "no frame".to_owned(), |other| format!("{other:?}"));
            Err(differs(&what, &came, "an availability_response in a frame"))
        }
    }
}
