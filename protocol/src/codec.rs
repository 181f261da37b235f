//! The canonical encoding: JSON, UTF-8, one message a line. Bytes in, messages out; memory bounded by the line limit.

use std::fmt;

use serde::Deserialize;

use crate::limits::LINE_BYTES_MAX;
use crate::message::Message;
use crate::text::{DeviceId, RequestId};

/// Appends a message and its newline.
pub fn encode(message: &Message, line: &mut Vec<u8>) {
    // Writing a message into memory cannot fail: keys are strings, numbers finite.
    let written = serde_json::to_writer(&mut *line, message);
    debug_assert!(written.is_ok(), "{written:?}");
    line.push(b'\n');
}

/// Cuts a stream of bytes into lines and reads each as a message.
///
/// ```
/// let mut decoder = urrcp::LineDecoder::default();
/// decoder.push(b"{\"availability_request\": {}}\n{\"avail");
/// assert!(matches!(decoder.next_message(), Some(Ok(urrcp::Message::AvailabilityRequest(_)))));
/// assert!(decoder.next_message().is_none());
/// ```
#[derive(Debug)]
pub struct LineDecoder {
    buffer: Vec<u8>,
    /// Start of what has not been read yet.
    read: usize,
    /// Up to where no newline is known to stand.
    searched: usize,
    limit: usize,
    /// An overlong line is dropped up to its newline.
    skipping: bool,
}

impl Default for LineDecoder {
    fn default() -> Self {
        Self::new(LINE_BYTES_MAX)
    }
}

impl LineDecoder {
    /// A decoder for lines of at most `limit` bytes.
    #[must_use]
    pub const fn new(limit: usize) -> Self {
        Self { buffer: Vec::new(), read: 0, searched: 0, limit, skipping: false }
    }

    /// Takes bytes as they came. Read the messages out before pushing again: what is buffered is then never more than
    /// one line and one push.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.read > 0 {
            self.buffer.drain(..self.read);
            self.searched -= self.read;
            self.read = 0;
        }
        self.buffer.extend_from_slice(bytes);
    }

    /// The next message or the error that stands in its place; `None` until more bytes come. Empty lines are skipped.
    pub fn next_message(&mut self) -> Option<Result<Message, DecodeError>> {
        loop {
            let newline = self.buffer[self.searched..].iter().position(|byte| *byte == b'\n');
            let Some(newline) = newline.map(|at| self.searched + at) else {
                self.searched = self.buffer.len();
                return self.overflow();
            };
            let line = self.read..newline;
            self.read = newline + 1;
            self.searched = self.read;
            if std::mem::take(&mut self.skipping) {
                continue;
            }
            if line.len() > self.limit {
                return Some(Err(self.too_long()));
            }
            let line = self.buffer[line].trim_ascii();
            if !line.is_empty() {
                return Some(decode_line(line));
            }
        }
    }

    /// Drops the beginning of a line that has grown beyond the limit, and says so once.
    fn overflow(&mut self) -> Option<Result<Message, DecodeError>> {
        if !self.skipping && self.buffer.len() - self.read <= self.limit {
            return None;
        }
        self.buffer = Vec::new();
        self.read = 0;
        self.searched = 0;
        let first = !std::mem::replace(&mut self.skipping, true);
        first.then(|| Err(self.too_long()))
    }

    fn too_long(&self) -> DecodeError {
        DecodeError::bare(DecodeErrorKind::LineTooLong { limit: self.limit })
    }
}

/// Why a line is no message, and whom an answer would concern.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct DecodeError {
    /// What is wrong.
    pub kind: DecodeErrorKind,
    /// The device of a control request that could be made out all the same.
    pub device_id: Option<DeviceId>,
    /// The request id that could be made out all the same.
    pub request_id: Option<RequestId>,
}

/// What is wrong with a line.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum DecodeErrorKind {
    /// Longer than the decoder's limit, in bytes.
    LineTooLong {
        /// The limit.
        limit: usize,
    },
    /// Not UTF-8 from this byte on.
    NotUtf8 {
        /// Count of good bytes ahead.
        valid_up_to: usize,
    },
    /// Not JSON.
    NotJson {
        /// Column of the fault, from 1.
        column: usize,
        /// What the parser says.
        message: String,
    },
    /// JSON, but no message of the protocol.
    Invalid {
        /// Path of the offending key, as `control_request.control_value[3].control_type`.
        path: String,
        /// What was found and expected.
        message: String,
    },
}

impl DecodeError {
    const fn bare(kind: DecodeErrorKind) -> Self {
        Self { kind, device_id: None, request_id: None }
    }
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.kind {
            DecodeErrorKind::LineTooLong { limit } => write!(f, "a line longer than {limit} bytes"),
            DecodeErrorKind::NotUtf8 { valid_up_to } => {
                write!(f, "bytes that are not UTF-8 after byte {valid_up_to}")
            }
            DecodeErrorKind::NotJson { column, message } => {
                write!(f, "text that is not JSON at column {column}: {message}")
            }
            DecodeErrorKind::Invalid { path, message } => write!(f, "{message} (at `{path}`)"),
        }
    }
}

/// Reads one line without its newline.
fn decode_line(line: &[u8]) -> Result<Message, DecodeError> {
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
    let path = path_of_fault(text);
    let addressee = addressee(text);
    DecodeError {
        kind: DecodeErrorKind::Invalid { path, message: without_place(error) },
        device_id: addressee.device_id.and_then(|id| DeviceId::new(id).ok()),
        request_id: addressee.request_id.and_then(|id| RequestId::new(id).ok()),
    }
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

#[derive(Default, Deserialize)]
struct Addressee {
    #[serde(default)]
    device_id: Option<String>,
    #[serde(default)]
    request_id: Option<String>,
}

fn addressee(text: &str) -> Addressee {
    #[derive(Deserialize)]
    struct Envelope {
        control_request: Addressee,
    }
    serde_json::from_str::<Envelope>(text).map(|e| e.control_request).unwrap_or_default()
}
