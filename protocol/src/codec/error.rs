//! Errors for bytes that are not a valid message.

use std::fmt;

use serde::Deserialize;

use crate::message::{Message, OfUnknownType};
use crate::text::{DeviceId, RequestId, shortened};

/// The reason why a line or frame is not a message. Contains the device id and request id, which the error response needs.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct DecodeError {
    /// The kind of error.
    pub kind: DecodeErrorKind,
    /// Id of the device that a control request addresses; `None` if it cannot be recognized.
    pub device_id: Option<DeviceId>,
    /// Id of the control request; `None` if the request has no id or the id cannot be recognized.
    pub request_id: Option<RequestId>,
}

/// An error in a line or frame.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum DecodeErrorKind {
    /// A line is longer than the decoder's limit.
    LineTooLong {
        /// The maximum length in bytes.
        limit: usize,
    },
    /// The payload of a frame is longer than the decoder's limit.
    FrameTooLong {
        /// The payload length in bytes, as stated in the frame's header.
        length: usize,
        /// The maximum length in bytes.
        limit: usize,
    },
    /// A line is not valid UTF-8.
    NotUtf8 {
        /// Number of valid bytes before the first invalid one.
        valid_up_to: usize,
    },
    /// A line is not valid JSON.
    NotJson {
        /// Column of the error in the line, from 1.
        column: usize,
        /// The parser's error message.
        message: String,
    },
    /// The payload of a frame is not exactly one MessagePack value.
    NotMessagePack {
        /// The parser's error message.
        message: String,
    },
    /// A line or payload is valid JSON or MessagePack, but not a message of the protocol.
    Invalid {
        /// Path of the invalid key, such as `control_request.control_value[3].control_type`.
        path: String,
        /// The value found and the value expected.
        message: String,
    },
}

impl DecodeError {
    pub(super) const fn bare(kind: DecodeErrorKind) -> Self {
        Self { kind, device_id: None, request_id: None }
    }

    /// Creates the error for a line or payload that is well-formed JSON or MessagePack, but not a message.
    pub(super) fn invalid(path: String, message: String, of: Addressee) -> Self {
        Self {
            // The parser's message may quote the whole line, but a response must be short.
            kind: DecodeErrorKind::Invalid { path: shortened(&path), message: shortened(&message) },
            device_id: of.device_id.and_then(|id| DeviceId::new(id).ok()),
            request_id: of.request_id.and_then(|id| RequestId::new(id).ok()),
        }
    }
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.kind {
            DecodeErrorKind::LineTooLong { limit } => {
                write!(f, "the line is too long, expected at most {limit} bytes")
            }
            DecodeErrorKind::FrameTooLong { length, limit } => {
                write!(f, "a frame of {length} bytes, expected at most {limit}")
            }
            DecodeErrorKind::NotUtf8 { valid_up_to } => {
                write!(f, "invalid UTF-8 after byte {valid_up_to}")
            }
            DecodeErrorKind::NotJson { column, message } => {
                write!(f, "invalid JSON at column {column}: {message}")
            }
            DecodeErrorKind::NotMessagePack { message } => {
                write!(f, "invalid MessagePack: {message}")
            }
            DecodeErrorKind::Invalid { path, message } => write!(f, "{message} (at `{path}`)"),
        }
    }
}

/// The device id and request id of a control request, parsed even if the rest of the request is invalid.
#[derive(Default, Deserialize)]
pub(super) struct Addressee {
    #[serde(default)]
    device_id: Option<String>,
    #[serde(default)]
    request_id: Option<String>,
}

/// A message with a control request whose control type this version does not know. The values of the request may be of any kind.
#[derive(Deserialize)]
pub(super) struct UnknownType {
    control_request: OfUnknownType,
}

impl From<UnknownType> for Message {
    fn from(unknown: UnknownType) -> Self {
        Self::ControlRequest(unknown.control_request.0)
    }
}

/// A message with a control request. Only the device id and request id of the request are parsed.
#[derive(Deserialize)]
pub(super) struct Envelope {
    pub(super) control_request: Addressee,
}
