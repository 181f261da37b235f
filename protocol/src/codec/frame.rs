//! The compact encoding. A frame consists of a mark byte that no line contains, the payload length, and the payload in MessagePack.

use rmp_serde::decode::Error;
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};

use super::error::{DecodeError, DecodeErrorKind, Envelope, UnknownType};
use super::line;
use crate::message::Message;
use crate::text::shortened;

/// The first byte of a frame, which occurs neither in valid UTF-8 nor in MessagePack.
pub(super) const MARK: u8 = 0xC1;
/// Size of a frame's header in bytes: the mark and the payload length as a big-endian 32-bit integer.
pub(super) const HEAD_BYTES: usize = 5;
/// Maximum nesting of lists and dictionaries, as in serde_json.
const DEPTH_MAX: usize = 128;

/// Appends `message` to `bytes` as a frame, or as a line if it is too long for a frame.
pub(super) fn write(message: &Message, bytes: &mut Vec<u8>) {
    let begin = bytes.len();
    bytes.extend_from_slice(&[MARK, 0, 0, 0, 0]);
    let mut serializer = rmp_serde::Serializer::new(&mut *bytes).with_struct_map();
    // Serialization into memory cannot fail: lengths are known, numbers finite.
    let written = message.serialize(&mut serializer);
    debug_assert!(written.is_ok(), "{written:?}");
    match u32::try_from(bytes.len() - begin - HEAD_BYTES) {
        Ok(length) => bytes[begin + 1..begin + HEAD_BYTES].copy_from_slice(&length.to_be_bytes()),
        // The message is too long for a frame. Every peer also accepts a line.
        Err(_) => {
            bytes.truncate(begin);
            line::write(message, bytes);
        }
    }
}

/// Returns the payload length in bytes; `None` if the header has not been received completely.
pub(super) fn length(head: &[u8]) -> Option<usize> {
    let length = head.get(1..HEAD_BYTES)?.try_into().map(u32::from_be_bytes).ok()?;
    // On platforms where the length exceeds `usize`, it is beyond any limit.
    Some(usize::try_from(length).unwrap_or(usize::MAX))
}

/// Parses the payload of one frame.
pub(super) fn read(payload: &[u8]) -> Result<Message, DecodeError> {
    let message = if names_one_message(payload) {
        read_whole(payload)
    } else {
        Err(Error::Syntax("expected a dictionary with one key, the name of the message".to_owned()))
    };
    message.or_else(|error| match names_one_message(payload).then(|| read_whole::<UnknownType>(payload)) {
        Some(Ok(unknown)) => Ok(unknown.into()),
        _ => Err(explain(payload, &error)),
    })
}

/// Whether the payload starts with a MessagePack dictionary of one entry. This check is necessary because the parser would also accept a
/// list.
const fn names_one_message(payload: &[u8]) -> bool {
    matches!(payload, [0x81, ..] | [0xDE, 0, 1, ..] | [0xDF, 0, 0, 0, 1, ..])
}

type Deserializer<'a> = rmp_serde::Deserializer<rmp_serde::decode::ReadRefReader<'a, [u8]>>;

fn deserializer(payload: &[u8]) -> Deserializer<'_> {
    let mut deserializer = rmp_serde::Deserializer::from_read_ref(payload);
    deserializer.set_max_depth(DEPTH_MAX);
    deserializer
}

fn read_whole<'a, T: Deserialize<'a>>(payload: &'a [u8]) -> Result<T, Error> {
    let mut deserializer = deserializer(payload);
    let value = T::deserialize(&mut deserializer)?;
    match IgnoredAny::deserialize(&mut deserializer) {
        Err(Error::InvalidMarkerRead(_)) => Ok(value),
        _ => Err(Error::Syntax("unexpected bytes after the message".to_owned())),
    }
}

/// Parses an invalid payload again, more slowly, to find the path of the error and the ids for a response.
fn explain(payload: &[u8], error: &Error) -> DecodeError {
    let well_formed = read_whole::<IgnoredAny>(payload);
    if let Err(fault) = well_formed {
        return DecodeError::bare(DecodeErrorKind::NotMessagePack { message: told(&fault) });
    }
    let addressee = read_whole::<Envelope>(payload).map(|envelope| envelope.control_request);
    DecodeError::invalid(path_of_fault(payload), told(error), addressee.unwrap_or_default())
}

fn told(error: &Error) -> String {
    match error {
        Error::InvalidMarkerRead(_) | Error::InvalidDataRead(_) => "unexpected end".to_owned(),
        Error::DepthLimitExceeded => format!("more than {DEPTH_MAX} nested levels"),
        other => shortened(&other.to_string()),
    }
}

fn path_of_fault(payload: &[u8]) -> String {
    match serde_path_to_error::deserialize::<_, Message>(&mut deserializer(payload)) {
        Ok(_) => "end of frame".to_owned(),
        Err(error) => error.path().to_string(),
    }
}
