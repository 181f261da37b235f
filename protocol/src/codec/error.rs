//! Errors in bytes that are not a valid message.

use std::fmt;

use serde::Deserialize;

use crate::message::{Message, OfUnknownType};
use crate::text::{DeviceId, RequestId, shortened};

/// Why a line or frame is not a message, and the device and request for an answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct DecodeError {
    /// The error.
    pub kind: DecodeErrorKind,
    /// The device of a control request, if it can be recognized.
    pub device_id: Option<DeviceId>,
    /// The request id, if it can be recognized.
    pub request_id: Option<RequestId>,
}

/// An error in a line or frame.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum DecodeErrorKind {
    /// A line longer than the decoder's limit, in bytes.
    LineTooLong {
        /// The limit.
        limit: usize,
    },
    /// A frame whose payload is longer than the decoder's limit, in bytes.
    FrameTooLong {
        /// The length in its head.
        length: usize,
        /// The limit.
        limit: usize,
    },
    /// The line is not valid UTF-8 from this byte.
    NotUtf8 {
        /// Number of valid bytes before it.
        valid_up_to: usize,
    },
    /// Not JSON.
    NotJson {
        /// Column of the error, from 1.
        column: usize,
        /// The parser's message.
        message: String,
    },
    /// The payload of a frame is not one whole value of MessagePack.
    NotMessagePack {
        /// The parser's message.
        message: String,
    },
    /// JSON or MessagePack, but no message of the protocol.
    Invalid {
        /// Path of the invalid key, such as `control_request.control_value[3].control_type`.
        path: String,
        /// The found and the expected value.
        message: String,
    },
}

impl DecodeError {
    pub(super) const fn bare(kind: DecodeErrorKind) -> Self {
        Self { kind, device_id: None, request_id: None }
    }

    /// An error in text that is well formed but not a message.
    pub(super) fn invalid(path: String, message: String, of: Addressee) -> Self {
        Self {
            // The message may quote the line and be just as long, but an answer must be short.
            kind: DecodeErrorKind::Invalid { path: shortened(&path), message: shortened(&message) },
            device_id: of.device_id.and_then(|id| DeviceId::new(id).ok()),
            request_id: of.request_id.and_then(|id| RequestId::new(id).ok()),
        }
    }
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.kind {
            DecodeErrorKind::LineTooLong { limit } => write!(f, "a line longer than {limit} bytes"),
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

/// The device and the id of a control request, read independently of the rest.
#[derive(Default, Deserialize)]
pub(super) struct Addressee {
    #[serde(default)]
    device_id: Option<String>,
    #[serde(default)]
    request_id: Option<String>,
}

/// A control request of a control type that this version does not know, with any values.
#[derive(Deserialize)]
pub(super) struct UnknownType {
    control_request: OfUnknownType,
}

impl From<UnknownType> for Message {
    fn from(unknown: UnknownType) -> Self {
        Self::ControlRequest(unknown.control_request.0)
    }
}

/// A control request around its addressee.
#[derive(Deserialize)]
pub(super) struct Envelope {
    pub(super) control_request: Addressee,
}
