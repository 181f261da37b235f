//! Encodes and decodes messages. A message is sent as a line of JSON or, if the receiver supports it, as a frame of MessagePack. One
//! stream may contain both: the first byte distinguishes them.

mod canonical;
mod carried;
mod decoder;
mod error;
mod frame;
mod line;

pub use carried::KnownScripts;
pub use decoder::{Decoder, Front};
pub use error::{DecodeError, DecodeErrorKind};

use crate::encoding::Encoding;
use crate::message::Message;

/// Appends `message` to `bytes` as a line of JSON, including the newline.
pub fn encode(message: &Message, bytes: &mut Vec<u8>) {
    line::write(message, bytes);
}

/// Appends `message` to `bytes` in the given encoding.
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
