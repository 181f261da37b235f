//! The canonical encoding: JSON, UTF-8, one message a line.

use super::error::{DecodeError, DecodeErrorKind, Envelope};
use crate::message::Message;

/// What ends a line.
pub(super) const END: u8 = b'\n';

/// Appends a message and its newline.
pub(super) fn write(message: &Message, line: &mut Vec<u8>) {
    // Writing a message into memory cannot fail: keys are strings, numbers finite.
    let written = serde_json::to_writer(&mut *line, message);
    debug_assert!(written.is_ok(), "{written:?}");
    line.push(END);
}

/// Reads one line without its newline.
pub(super) fn read(line: &[u8]) -> Result<Message, DecodeError> {
    let text = std::str::from_utf8(line)
        .map_err(|e| DecodeError::bare(DecodeErrorKind::NotUtf8 { valid_up_to: e.valid_up_to() }))?;
    serde_json::from_str(text).map_err(|error| explain(text, &error))
}

/// Reads a bad line once more, slower, for the path of the fault and the ids that an answer needs.
fn explain(text: &str, error: &serde_json::Error) -> DecodeError {
    if !error.is_data() {
        let kind = DecodeErrorKind::NotJson { column: error.column(), message: without_place(error) };
        return DecodeError::bare(kind);
    }
    let addressee = serde_json::from_str::<Envelope>(text).map(|envelope| envelope.control_request);
    DecodeError::invalid(path_of_fault(text), without_place(error), addressee.unwrap_or_default())
}

fn without_place(error: &serde_json::Error) -> String {
    let text = error.to_string();
    let end = text.rfind(" at line ").unwrap_or(text.len());
    text[..end].to_owned()
}

fn path_of_fault(text: &str) -> String {
    let mut json = serde_json::Deserializer::from_str(text);
    match serde_path_to_error::deserialize::<_, Message>(&mut json) {
        Ok(_) => "end of line".to_owned(),
        Err(error) => error.path().to_string(),
    }
}
