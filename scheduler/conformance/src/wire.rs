//! Checks with lines that no server sends: the robot answers or ignores them and continues to work.

use serde_json::{Value, json};
use urrcp::{Message, STRING_CHARS_MAX};

use super::heard::says_malformed;
use super::line::Line;
use super::requirement::{Checked, Requirement, Unmet, differs, pass};
use super::trial::{LATER_MS, LEASE_MS, Trial};

pub(super) const ALL: [Requirement; 12] = [
    Requirement {
        name: "unknown-keys",
        number: "core-74",
        demands: "Unknown keys in a message are ignored.",
        section: "Messages (D)",
        check: unknown_keys,
    },
    Requirement {
        name: "unknown-message",
        number: "core-75",
        demands: "A message with an unknown name is ignored or answered with `malformed`, and the connection remains usable.",
        section: "Messages (D)",
        check: unknown_message,
    },
    Requirement {
        name: "malformed-line",
        number: "core-76",
        demands: "A line that is not JSON is answered with `malformed`, and the connection remains usable.",
        section: "Framing (D)",
        check: malformed_line,
    },
    Requirement {
        name: "wrong-type",
        number: "core-77",
        demands: "A message with a missing key or a value of the wrong type is answered with `malformed`, and the connection remains usable.",
        section: "Messages (D)",
        check: wrong_type,
    },
    Requirement {
        name: "not-utf8",
        number: "core-78",
        demands: "A line that is not UTF-8 is answered with `malformed`, and the connection remains usable.",
        section: "Framing (D)",
        check: not_utf8,
    },
    Requirement {
        name: "deep-nesting",
        number: "core-79",
        demands: "A line with 100,000 nested levels is answered, and the connection remains usable.",
        section: "Framing (D)",
        check: deep_nesting,
    },
    Requirement {
        name: "bad-numbers",
        number: "core-80",
        demands: "Numbers that are not finite (NaN, Infinity and 1e999) are answered with `malformed`.",
        section: "Framing (D)",
        check: bad_numbers,
    },
    Requirement {
        name: "long-strings",
        number: "core-81",
        demands: "A string of 256 characters is accepted; one of 257 characters is answered with `malformed`.",
        section: "Messages (D)",
        check: long_strings,
    },
    Requirement {
        name: "duplicate-keys",
        number: "core-82",
        demands: "A duplicate key is answered with `malformed`.",
        section: "Messages (D)",
        check: duplicate_keys,
    },
    Requirement {
        name: "huge-line",
        number: "core-83",
        demands: "A line of 17 MB is answered with `malformed` or ends the connection, and the robot accepts new connections.",
        section: "Framing (D)",
        check: huge_line,
    },
    Requirement {
        name: "half-line",
        number: "core-84",
        demands: "A message that arrives in two halves is read as one; half a message followed by a closed connection does no harm.",
        section: "Framing (D)",
        check: half_line,
    },
    Requirement {
        name: "empty-lines",
        number: "core-85",
        demands: "Empty lines are skipped.",
        section: "Framing (D)",
        check: empty_lines,
    },
];

/// Creates a valid control request that the robot accepts and holds, as a base for invalid requests.
pub(super) fn sound(trial: &Trial) -> Result<Value, Unmet> {
    let actor = trial.actor()?;
    Ok(json!({
        "timestamp": trial.stamp(), "time_offset_to_start": LATER_MS, "device_id": actor.device.id,
        "stop_condition": LEASE_MS, "request_id": trial.fresh_id(), "control_type": actor.control_type,
        "control_value": actor.rest,
    }))
}

pub(super) fn line_of(request: &Value) -> Vec<u8> {
    format!("{}\n", json!({"control_request": request})).into_bytes()
}

/// Checks that the robot answers each line with `malformed` and keeps the connection open.
fn all_malformed(line: &mut Line, lines: &[Vec<u8>]) -> Checked {
    for bytes in lines {
        line.is_malformed(bytes)?;
    }
    let last = lines.last().map(|bytes| String::from_utf8_lossy(bytes).into_owned()).unwrap_or_default();
    line.survives(&last)?;
    pass()
}

fn unknown_keys(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let more = json!({"nested": [1, {"deep": null}], "text": "x"});
    let hello = json!({"availability_request": {"timestamp": trial.stamp(), "x_unknown": more}});
    let hello = format!("{hello}\n");
    line.send(hello.as_bytes())?;
    match line.other(trial.patience())? {
        Some(heard)
            if matches!(heard.message, Message::AvailabilityResponse(_))
                && !says_malformed(&heard.message) => {}
        other => {
            let came = other.map_or_else(|| "nothing".to_owned(), |other| other.text);
            return Err(differs(&hello, &came, "an availability_response with status `OK`"));
        }
    }
    let mut request = sound(trial)?;
    request["x_unknown"] = more;
    let text = String::from_utf8_lossy(&line_of(&request)).into_owned();
    let id = request["request_id"].as_str().map(str::to_owned);
    let device = trial.actor()?.device.id.clone();
    let ticket = line.ask_text(id, device.as_str(), &text)?;
    line.accepted(ticket)?;
    pass()
}

fn unknown_message(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let sent = "{\"x_greeting\":{\"text\":\"hello\"}}\n";
    line.send(sent.as_bytes())?;
    line.survives(sent)?;
    pass()
}

fn malformed_line(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let lines = [
        "this is not JSON\n",
        "{\"availability_request\":{}\n",
        "{\"availability_request\":{}} {}\n",
        "17\n",
    ];
    all_malformed(&mut line, &lines.map(|line| line.as_bytes().to_vec()))
}

fn wrong_type(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let spoilt = |key: &str, value: Option<Value>| -> Result<Vec<u8>, Unmet> {
        let mut request = sound(trial)?;
        if let Some(map) = request.as_object_mut() {
            match value {
                Some(value) => map.insert(key.to_owned(), value),
                None => map.remove(key),
            };
        }
        Ok(line_of(&request))
    };
    let lines = [
        spoilt("time_offset_to_start", Some(json!("soon")))?,
        spoilt("time_offset_to_start", Some(json!(-1)))?,
        spoilt("device_id", Some(json!(7)))?,
        spoilt("control_value", Some(json!("much")))?,
        spoilt("timestamp", Some(json!("yesterday")))?,
        spoilt("device_id", None)?,
        spoilt("control_type", None)?,
        spoilt("control_value", None)?,
        b"{\"control_request\":[]}\n".to_vec(),
    ];
    all_malformed(&mut line, &lines)
}

fn not_utf8(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    all_malformed(&mut line, &[b"{\"availability_request\":{\"session\":\"\xff\xfe\"}}\n".to_vec()])
}

fn deep_nesting(trial: &Trial) -> Checked {
    const DEPTH: usize = 100_000;
    let mut line = trial.connect()?;
    let sent = format!(
        "{{\"availability_request\":{{\"x_unknown\":{}{}}}}}\n",
        "[".repeat(DEPTH),
        "]".repeat(DEPTH)
    );
    line.send(sent.as_bytes())?;
    if line.other(trial.patience())?.is_none() {
        let expected = "an answer: `OK`, since unknown keys are ignored, or `malformed`";
        return Err(differs(&sent, "nothing", expected));
    }
    line.survives(&sent)?;
    pass()
}

fn bad_numbers(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let mut lines = Vec::new();
    for number in ["1e999", "-1e999", "NaN", "Infinity"] {
        let mut request = sound(trial)?;
        request["control_value"] = json!("NUMBER");
        let text = String::from_utf8_lossy(&line_of(&request)).replace("\"NUMBER\"", number);
        lines.push(text.into_bytes());
    }
    all_malformed(&mut line, &lines)
}

fn long_strings(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let mut request = sound(trial)?;
    // The limit is in characters, not bytes.
    let actor = trial.actor()?;
    for letter in ["\u{44f}", "\u{1f916}", "x"] {
        let id = letter.repeat(STRING_CHARS_MAX - 16) + &format!("{:016x}", fastrand::u64(..));
        request["request_id"] = json!(id);
        let text = String::from_utf8_lossy(&line_of(&request)).into_owned();
        let ticket = line.ask_text(Some(id), actor.device.id.as_str(), &text)?;
        line.accepted(ticket)?;
        let cancel = line.ask(&trial.cancel(actor))?;
        line.answer(cancel)?;
    }
    let long = "x".repeat(STRING_CHARS_MAX + 1);
    // A letter and an accent are two characters, even if they are shown as one.
    let decomposed = "e\u{301}".repeat(STRING_CHARS_MAX / 2) + "x";
    let mut lines = Vec::new();
    for [key, long] in
        [["request_id", &long], ["device_id", &long], ["session", &long], ["request_id", &decomposed]]
    {
        let mut request = sound(trial)?;
        request[key] = json!(long);
        lines.push(line_of(&request));
    }
    all_malformed(&mut line, &lines)
}

fn duplicate_keys(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let request = sound(trial)?;
    let text = String::from_utf8_lossy(&line_of(&request)).into_owned();
    let twice = text.replacen('{', "{\"control_request\":{", 1);
    let twice = twice.replacen(
        "{\"control_request\":{\"control_request\":{",
        "{\"control_request\":{\"control_value\":0,",
        1,
    );
    all_malformed(&mut line, &[twice.into_bytes()])
}

fn huge_line(trial: &Trial) -> Checked {
    const BYTES: usize = 17 * 1024 * 1024;
    let mut line = trial.connect()?;
    let mut bytes = vec![b'x'; BYTES];
    bytes.push(b'\n');
    // A robot may answer and hang up before the whole line is sent. A robot that only stops reading does neither.
    let sent = line.send(&bytes);
    let heard = line.other(trial.patience())?;
    let what = format!("a line of {BYTES} `x` characters");
    match heard {
        Some(heard) if says_malformed(&heard.message) => {
            if sent.is_ok() {
                line.survives(&what)?;
            }
        }
        Some(heard) => return Err(differs(&what, &heard.text, "`malformed`, or the end of the connection")),
        None if line.has_ended() => {}
        None => return Err(differs(&what, "nothing", "`malformed`, or the end of the connection")),
    }
    trial.connect()?.survives(&what)?;
    pass()
}

fn half_line(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    let hello = format!("{}\n", json!({"availability_request": {"timestamp": trial.stamp()}}));
    let (half, rest) = hello.as_bytes().split_at(hello.len() / 2);
    line.send(half)?;
    line.listen(trial.soon(150), |_| false)?;
    line.send(rest)?;
    let heard = line.other(trial.patience())?;
    match heard {
        Some(heard)
            if matches!(heard.message, Message::AvailabilityResponse(_))
                && !says_malformed(&heard.message) => {}
        other => {
            let came = other.map_or_else(|| "nothing".to_owned(), |other| other.text);
            let sent = format!("{} in two halves, 150 ms apart", hello.trim_end());
            return Err(differs(&sent, &came, "an availability_response with status `OK`"));
        }
    }
    line.send(half)?;
    drop(line);
    trial.connect()?.survives("half a message and a closed connection")?;
    pass()
}

fn empty_lines(trial: &Trial) -> Checked {
    let mut line = trial.connect()?;
    line.send(b"\n\n\n")?;
    let (_, _, _) = line.availability()?;
    line.send(b"\n\n\n")?;
    match line.other(trial.soon(150))? {
        None => pass(),
        Some(heard) => Err(differs("three empty lines", &heard.text, "nothing: empty lines are skipped")),
    }
}
