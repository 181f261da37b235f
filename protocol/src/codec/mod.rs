//! Bytes in, messages out, and back. A message travels as a line of JSON or, where the reader has said that it
//! understands it, as a frame of MessagePack. Both may follow each other on one stream: each says by its first byte what
//! it is.

mod canonical;
mod carried;
mod decoder;
mod error;
mod frame;
mod line;

use std::fmt;

pub use carried::KnownScripts;
pub use decoder::{Decoder, Front};
pub use error::{DecodeError, DecodeErrorKind};

use crate::message::Message;

/// How one message is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Encoding {
    /// A line of JSON, which everybody understands.
    #[default]
    Json,
    /// A frame of MessagePack, a fraction of the size.
    MessagePack,
}

impl Encoding {
    /// The word in an initialization block and in a fleet file.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::MessagePack => "msgpack",
        }
    }
}

impl fmt::Display for Encoding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

/// Appends a message as a line of JSON, its newline included.
pub fn encode(message: &Message, bytes: &mut Vec<u8>) {
    line::write(message, bytes);
}

/// Appends a message in this encoding.
///
/// ```
/// use urrcp::{Encoding, Decoder, Message, encode_as};
/// let message = Message::AvailabilityRequest(urrcp::AvailabilityRequest::default());
/// let mut bytes = Vec::new();
/// encode_as(Encoding::MessagePack, &message, &mut bytes);
/// encode_as(Encoding::Json, &message, &mut bytes);
/// let mut decoder = Decoder::default();
/// decoder.push(&bytes);
/// assert_eq!(decoder.next_message(), Some(Ok(message.clone())));
/// assert_eq!(decoder.encoding(), Encoding::MessagePack);
/// assert_eq!(decoder.next_message(), Some(Ok(message)));
/// assert_eq!(decoder.encoding(), Encoding::Json);
/// ```
pub fn encode_as(encoding: Encoding, message: &Message, bytes: &mut Vec<u8>) {
    match encoding {
        Encoding::Json => line::write(message, bytes),
        Encoding::MessagePack => frame::write(message, bytes),
    }
}

#[cfg(test)]
mod tests;
