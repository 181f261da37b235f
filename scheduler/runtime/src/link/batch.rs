//! A batch of messages that are written at once. It omits the bytes of scripts that were published once for several robots.

use urrcp::{Command, ControlRequest, Encoding, Message, Script, encode_as};

use super::reach::Text;

/// The last bytes of an encoded request whose script has no steps.
const NO_STEPS: &[u8] = b"[]}}\n";

/// Encoded messages, and the published texts that the robot's side inserts into them.
#[derive(Debug, Default)]
pub(crate) struct Batch {
    bytes: Vec<u8>,
    /// The published texts, each with its position in `bytes`.
    texts: Vec<(usize, Text)>,
    text_bytes: usize,
}

impl Batch {
    /// Returns the bytes without the published texts.
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Returns the published texts, each with its position in the bytes.
    #[cfg(feature = "zenoh")]
    pub(crate) fn texts(&self) -> &[(usize, Text)] {
        &self.texts
    }

    /// Number of bytes that the robot reads, including the published texts.
    pub(crate) const fn len(&self) -> usize {
        self.bytes.len() + self.text_bytes
    }

    /// Appends a message. Returns the number of bytes that the robot reads for it, including a published text. `offer` publishes the
    /// message's script if other robots receive the same script.
    pub(crate) fn push(
        &mut self,
        encoding: Encoding,
        message: &Message,
        offer: impl FnOnce(&Script) -> Option<Text>,
    ) -> usize {
        let before = self.len();
        let published = match message {
            // A published text is always JSON.
            Message::ControlRequest(request) if encoding == Encoding::Json => published(request, offer),
            _ => None,
        };
        match published {
            Some((rest, text)) => self.push_around(&rest, text),
            None => encode_as(encoding, message, &mut self.bytes),
        }
        self.len() - before
    }

    fn push_around(&mut self, rest: &Message, text: Text) {
        encode_as(Encoding::Json, rest, &mut self.bytes);
        debug_assert!(self.bytes.ends_with(NO_STEPS), "the steps are the last of a request");
        self.bytes.truncate(self.bytes.len() - NO_STEPS.len());
        self.text_bytes += text.len();
        self.texts.push((self.bytes.len(), text));
        self.bytes.extend(&NO_STEPS[2..]);
    }
}

/// Publishes the script of a request by calling `offer`. Returns the request without the script, and the published text; `None` if
/// `offer` did not publish the script.
fn published(
    request: &ControlRequest,
    offer: impl FnOnce(&Script) -> Option<Text>,
) -> Option<(Message, Text)> {
    let Command::Script(script) = &request.command else { return None };
    let text = offer(script)?;
    let command = Command::Script(Script::cancel());
    Some((Message::ControlRequest(ControlRequest { command, ..request.clone() }), text))
}

#[cfg(feature = "zenoh")]
#[cfg(test)]
mod tests {
    use urrcp::{AvailabilityRequest, ControlType, Setpoint, Step};

    use super::*;

    /// Inserts the published texts into the batch, as the robot's side does.
    fn put_together(batch: &Batch) -> Vec<u8> {
        let (mut all, mut done) = (Vec::new(), 0);
        for (at, text) in batch.texts() {
            all.extend(&batch.bytes()[done..*at]);
            all.extend(text.bytes());
            done = *at;
        }
        all.extend(&batch.bytes()[done..]);
        all
    }

    fn request() -> Message {
        let step = |i: u32| Step {
            offset: urrcp::Millis::new(f64::from(i)).unwrap(),
            setpoint: Setpoint::new(ControlType::Position, 0.1 * f64::from(i)),
            stop_condition: None,
        };
        let script = Script::new((0..20).map(step).collect()).unwrap();
        let request = ControlRequest::immediate("d".parse().unwrap(), Command::Script(script));
        let named = request.with_request_id("[]}}".parse().unwrap()).with_content_hash();
        Message::ControlRequest(named)
    }

    fn text_of(script: &Script) -> Option<Text> {
        Some(serde_json::to_vec(script).unwrap().into())
    }

    #[test]
    fn robot_reads_same_bytes_with_published_scripts_as_without() {
        let question = Message::AvailabilityRequest(AvailabilityRequest::default());
        let cancel = Message::ControlRequest(ControlRequest::immediate(
            "d".parse().unwrap(),
            Command::Script(Script::cancel()),
        ));
        let (mut batch, mut whole) = (Batch::default(), Vec::new());
        for message in [&question, &request(), &cancel, &request(), &question] {
            let (read, before) = (batch.push(Encoding::Json, message, text_of), whole.len());
            encode_as(Encoding::Json, message, &mut whole);
            assert_eq!(read, whole.len() - before);
        }
        assert_eq!(String::from_utf8(put_together(&batch)), String::from_utf8(whole));
        assert_eq!(batch.len(), put_together(&batch).len());
        assert!(batch.bytes().len() < batch.len() / 2);
    }

    #[test]
    fn script_is_sent_whole_if_unpublished_or_in_another_encoding() {
        for (encoding, is_published) in [(Encoding::MessagePack, true), (Encoding::Json, false)] {
            let (mut batch, mut whole) = (Batch::default(), Vec::new());
            batch.push(encoding, &request(), |script| text_of(script).filter(|_| is_published));
            encode_as(encoding, &request(), &mut whole);
            assert_eq!(batch.bytes(), whole);
        }
    }
}
