//! Fast parsing of messages that contain a script. Two kinds of scripts can be parsed faster than general JSON: known scripts, which were
//! sent or received recently, and scripts in canonical JSON.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use memchr::memmem;

use super::canonical;
use crate::message::{Command, ControlRequest, ControlResponse, Message, Script, StatusValue};

/// Number of scripts to keep. If an older script is received again, it is parsed step by step.
const KEPT: usize = 16;
/// For each kind of message that can contain a script: the start of the message and the key of the script.
const CARRIERS: [(&str, &str); 2] =
    [(r#"{"control_request":{"#, r#""control_value":"#), (r#"{"control_response":{"#, r#""status_value":"#)];

/// The most recent scripts in sent and received requests. Scripts recur, because a robot repeats each script that it accepts, and all
/// robots of a group receive the same script. A [`Decoder`](crate::Decoder) reuses a known script and its cached results; the decoded
/// messages are the same as without `KnownScripts`. Clones share their content.
#[derive(Clone, Debug, Default)]
pub struct KnownScripts(Arc<Mutex<VecDeque<Script>>>);

impl KnownScripts {
    /// Keeps the script of `request` if its canonical text is cached, that is, if its hash was computed and the script is not too long.
    pub fn note(&self, request: &ControlRequest) {
        let Command::Script(script) = &request.command else { return };
        if script.is_empty() || script.kept_text().is_none() {
            return;
        }
        let mut scripts = self.scripts();
        if !scripts.iter().any(|known| known.is_same(script)) {
            scripts.truncate(KEPT - 1);
            scripts.push_front(script.clone());
        }
    }

    /// Finds the known script whose canonical JSON is at the start of `value`. Returns the script and the rest of `value`.
    fn find<'a>(&self, value: &'a str) -> Option<(Script, &'a str)> {
        self.scripts().iter().find_map(|script| {
            let rest = value.strip_prefix(script.kept_text()?)?;
            Some((script.clone(), rest))
        })
    }

    fn scripts(&self) -> MutexGuard<'_, VecDeque<Script>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Parses the message on `line` if its script is in `known` or is written in canonical JSON. Returns `None` if the general JSON parser
/// has to parse the message.
pub(super) fn read(line: &str, known: Option<&KnownScripts>) -> Option<Message> {
    let (_, key) = CARRIERS.iter().find(|(begin, _)| line.starts_with(begin))?;
    let at = memmem::find(line.as_bytes(), key.as_bytes())?;
    let (head, value) = line.split_at_checked(at + key.len())?;
    if !is_where_keys_of_a_message_are(&head[..at]) {
        return None;
    }
    let (script, text, rest) = match known.and_then(|known| known.find(value)) {
        Some((script, rest)) => (script, None, rest),
        None => canonical::read(value).map(|(script, text, rest)| (script, Some(text), rest))?,
    };
    let mut message = serde_json::from_str(&[head, "[]", rest].concat()).ok()?;
    let place = match &mut message {
        Message::ControlRequest(ControlRequest { command: Command::Script(steps), content_hash, .. }) => {
            // The robot compares a hash in the request with the hash of the script.
            if let (Some(text), Some(_)) = (text, content_hash) {
                script.hash_as(text);
            }
            steps
        }
        Message::ControlResponse(ControlResponse { status_value: StatusValue::Script(steps), .. }) => steps,
        _ => return None,
    };
    *place = script;
    Some(message)
}

/// Whether the end of `head`, the start of a line, is directly inside the message's object, not in a nested value or a string.
fn is_where_keys_of_a_message_are(head: &str) -> bool {
    let (mut depth, mut in_string, mut escaped) = (0_i32, false, false);
    for byte in head.bytes() {
        match byte {
            _ if escaped => escaped = false,
            b'\\' => escaped = in_string,
            b'"' => in_string = !in_string,
            b'{' | b'[' if !in_string => depth += 1,
            b'}' | b']' if !in_string => depth -= 1,
            _ => {}
        }
    }
    depth == 2 && !in_string
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ContentHash, ControlType, DeviceId, Millis, Setpoint, Step};

    fn script(values: &[f64]) -> Script {
        let step =
            |value: &f64| Step::new(Millis::new(5.0).unwrap(), Setpoint::new(ControlType::Position, *value));
        Script::new(values.iter().map(step).collect()).unwrap()
    }

    fn note(known: &KnownScripts, script: &Script) -> String {
        let command = Command::Script(script.clone());
        let _hash = command.content_hash();
        known.note(&ControlRequest::immediate(DeviceId::new("d").unwrap(), command));
        serde_json::to_string(script).unwrap()
    }

    /// Returns a response line and a request line, each with `keys` after the mandatory keys.
    fn lines(keys: &str) -> [String; 2] {
        let time = "2026-11-20T19:00:00.000000000Z";
        [
            format!(
                r#"{{"control_response":{{"timestamp":"{time}","device_id":"d","status":"Accepted"{keys}}}}}"#
            ),
            format!(r#"{{"control_request":{{"device_id":"d","control_type":"script"{keys}}}}}"#)
                .replace("status_value", "control_value"),
        ]
    }

    fn script_of(message: Message) -> Script {
        match message {
            Message::ControlResponse(ControlResponse {
                status_value: StatusValue::Script(script), ..
            })
            | Message::ControlRequest(ControlRequest { command: Command::Script(script), .. }) => script,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn repeated_script_reuses_the_known_steps() {
        let known = KnownScripts::default();
        let scripts = [script(&[1.0, 2.0]), script(&[1.0])];
        for (script, text) in scripts.each_ref().map(|script| (script, note(&known, script))) {
            for line in
                lines(&format!(r#","stop_condition":{{"pending":5}},"status_value":{text},"request_id":"r""#))
            {
                let read = read(&line, Some(&known)).unwrap();
                assert_eq!(read, serde_json::from_str(&line).unwrap());
                assert!(script_of(read).is_same(script));
            }
        }
    }

    #[test]
    fn canonical_script_is_hashed_without_serialization() {
        for (script, is_kept) in [(script(&[1.5, -2.0]), true), (script(&[0.5; 2_000]), false)] {
            let text = serde_json::to_string(&script).unwrap();
            let request =
                ControlRequest::immediate(DeviceId::new("d").unwrap(), Command::Script(script.clone()));
            let mut line = serde_json::to_string(&Message::ControlRequest(request.clone())).unwrap();
            assert_eq!(script_of(read(&line, None).unwrap()).kept_text(), None, "nobody asks for its hash");
            line = serde_json::to_string(&Message::ControlRequest(request.with_content_hash())).unwrap();
            let came = script_of(read(&line, None).unwrap());
            assert_eq!(came.kept_text(), is_kept.then_some(text.as_str()));
            assert_eq!(Command::Script(came).content_hash(), ContentHash::of(text.as_bytes()));
        }
    }

    #[test]
    fn script_hash_is_computed_despite_a_different_hash_in_the_message() {
        let [response, request] = lines(&format!(
            r#","status_value":{},"content_hash":"{}""#,
            note(&KnownScripts::default(), &script(&[1.0])),
            ContentHash::of(b"other")
        ));
        assert!(read(&response, None).is_some());
        let Some(Message::ControlRequest(request)) = read(&request, None) else { panic!("{request}") };
        assert_eq!(request.content_hash, Some(ContentHash::of(b"other")));
        assert_eq!(request.command.content_hash(), Command::Script(script(&[1.0])).content_hash());
    }

    #[test]
    fn only_the_latest_scripts_are_kept_without_duplicates() {
        let known = KnownScripts::default();
        let scripts: Vec<_> = (0..=KEPT).map(|value| script(&[value as f64])).collect();
        let texts: Vec<_> = scripts.iter().map(|script| note(&known, script)).collect();
        note(&known, &scripts[KEPT]);
        let is_known = |text: &String| known.find(text).is_some();
        assert_eq!(texts.iter().map(is_known).collect::<Vec<_>>(), [&[false][..], &[true; KEPT]].concat());
    }

    #[test]
    fn script_without_cached_text_is_not_kept() {
        let known = KnownScripts::default();
        let hashed = |script: &Script| {
            note(&known, script);
            known.scripts().len()
        };
        assert_eq!(hashed(&Script::cancel()), 0);
        assert_eq!(hashed(&script(&[0.5; 2_000])), 0, "it is long");
        let command = Command::Script(script(&[1.0]));
        known.note(&ControlRequest::immediate(DeviceId::new("d").unwrap(), command));
        assert_eq!(known.scripts().len(), 0, "nobody asked for its hash");
    }

    /// Checks that lines with `keys` decode to the same messages with and without known scripts.
    #[track_caller]
    fn check_as_any_other(keys: &str, known: &KnownScripts) {
        for line in lines(keys) {
            let without = serde_json::from_str::<Message>(&line).ok();
            for known in [Some(known), None] {
                assert_eq!(read(&line, known).or_else(|| without.clone()), without, "{line}");
            }
        }
    }

    #[test]
    fn script_elsewhere_in_the_message_is_not_taken_as_its_value() {
        let known = KnownScripts::default();
        let text = note(&known, &script(&[1.0]));
        for keys in [
            format!(r#","error":{{"code":"late","message":"m","status_value":{text}}},"status_value":[]"#),
            format!(r#","x":["status_value":{text}],"status_value":[]"#),
            format!(r#","x":[1,"status_value":{text}"#),
            format!(r#","a\"status_value":{text},"status_value":[]"#),
            format!(r#","a\\"status_value":{text},"status_value":[]"#),
            format!(r#","a,\"status_value":{text},"status_value":[]"#),
            format!(r#","x":{{"\\":{{"status_value":{text}}}}},"status_value":[]"#),
            format!(r#","x":{{"}}":{{"status_value":{text}}}}},"status_value":[]"#),
            format!(r#","x":{{"\"}}\"":0,"status_value":{text}}},"status_value":[]"#),
            format!(r#","request_id":"a\"status_value":{text}"#),
            format!(r#","request_id":"a,"status_value":{text}"#),
            format!(r#","status_value":{text},"status_value":[]"#),
            format!(r#","status_value":[],"status_value":{text}"#),
            format!(r#","status_value":{text}{text}"#),
            format!(r#","status_value":{text}5"#),
            format!(r#","status_value":{text},"status":"OK""#),
            format!(r#","status_value":{text},"control_type":"position""#),
            format!(r#","status_value":{text},"error":{{"code":7}}"#),
            format!(r#"}},"x":{{"status_value":{text}"#),
        ] {
            check_as_any_other(&keys, &known);
        }
        let other_type = format!(
            r#"{{"control_request":{{"device_id":"d","control_type":"spin","control_value":{text}}}}}"#
        );
        assert_eq!(read(&other_type, Some(&known)), None, "its values are not read");
    }

    proptest::proptest! {
        #[test]
        fn fast_parser_agrees_with_the_general_parser(
            parts in proptest::collection::vec(0..10_usize, 0..8), cut in 0..400_usize,
        ) {
            let known = KnownScripts::default();
            let text = note(&known, &script(&[1.0]));
            let parts = parts.into_iter().map(|part| match part {
                0 => r#""status_value":"#,
                1 => text.as_str(),
                2 => ",",
                3 => "{",
                4 => "}",
                5 => "[]",
                6 => r#"",""#,
                7 => r#"\""#,
                8 => "\\\\",
                _ => r#""x":"#,
            });
            let keys = parts.collect::<String>();
            check_as_any_other(&format!(",{keys}"), &known);
            check_as_any_other(keys.get(..cut.min(keys.len())).unwrap_or_default(), &known);
        }
    }
}
