//! The canonical encoding: JSON in UTF-8, one message per line.

use std::fmt;

use memchr::memmem;
use serde::de::{IgnoredAny, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::error::{DecodeError, DecodeErrorKind, Envelope, UnknownType};
use super::{KnownScripts, carried};
use crate::message::{Message, OnLine};
use crate::text::shortened;

/// The byte that ends a line.
pub(super) const END: u8 = b'\n';

/// Appends `message` and a newline to `line`.
pub(super) fn write(message: &Message, line: &mut Vec<u8>) {
    const WITHOUT_SCRIPT: usize = 512;
    let written = match OnLine(message).gap() {
        None => serde_json::to_writer(&mut *line, message),
        Some((key, text)) => {
            line.reserve(WITHOUT_SCRIPT + text.len());
            let begin = line.len();
            serde_json::to_writer(&mut *line, &OnLine(message)).map(|()| fill(line, begin, key, text))
        }
    };
    // Serialization into memory cannot fail: keys are strings, numbers finite.
    debug_assert!(written.is_ok(), "{written:?}");
    line.push(END);
}

/// Replaces the empty list after `key` with `text`, in the part of `line` from `begin`. The first match is the key itself, because quotes
/// in strings are escaped.
fn fill(line: &mut Vec<u8>, begin: usize, key: &str, text: &str) {
    let gap = memmem::find(&line[begin..], key.as_bytes()).map_or(line.len(), |at| begin + at + key.len());
    let rest = line.split_off(gap);
    line.extend_from_slice(text.as_bytes());
    line.extend_from_slice(rest.strip_prefix(b"[]").unwrap_or_default());
}

/// Parses one line, given without its newline.
pub(super) fn read(line: &[u8], known: Option<&KnownScripts>) -> Result<Message, DecodeError> {
    let text = std::str::from_utf8(line)
        .map_err(|e| DecodeError::bare(DecodeErrorKind::NotUtf8 { valid_up_to: e.valid_up_to() }))?;
    if let Some(message) = carried::read(text, known) {
        return Ok(message);
    }
    serde_json::from_str(text).or_else(|error| match serde_json::from_str::<UnknownType>(text) {
        Ok(unknown) => Ok(unknown.into()),
        Err(_) => Err(explain(text, &error)),
    })
}

/// Parses an invalid line again, more slowly, to find the path of the error and the ids for a response.
fn explain(text: &str, error: &serde_json::Error) -> DecodeError {
    // A number beyond the range of a double, for example, is still JSON.
    if !error.is_data() && serde_json::from_str::<IgnoredAny>(text).is_err() {
        let message = shortened(&without_place(error));
        return DecodeError::bare(DecodeErrorKind::NotJson { column: error.column(), message });
    }
    let (path, message) = match serde_json::from_str::<KeyCount>(text) {
        Ok(KeyCount(count)) if count != 1 => {
            (".".to_owned(), format!("found {count} keys, expected exactly one: the name of the message"))
        }
        _ => (path_of_fault(text), without_place(error)),
    };
    let addressee = serde_json::from_str::<Envelope>(text).map(|envelope| envelope.control_request);
    DecodeError::invalid(path, message, addressee.unwrap_or_default())
}

/// The number of keys of an object, counted by deserializing it.
struct KeyCount(usize);

impl<'de> Deserialize<'de> for KeyCount {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(KeyCount(0))
    }
}

impl<'de> Visitor<'de> for KeyCount {
    type Value = Self;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self, A::Error> {
        let mut count = 0;
        while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {
            count += 1;
        }
        Ok(Self(count))
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
