//! What is wrong with bytes that are no message.

use std::fmt;

use serde::Deserialize;

use crate::message::{Message, OfUnknownType};
use crate::text::{DeviceId, RequestId, shortened};

/// Why a line or frame is not a message, and the device and request that an answer would concern.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct DecodeError {
    /// What is wrong.
    pub kind: DecodeErrorKind,
    /// The device of a control request that can be recognised all the same.
    pub device_id: Option<DeviceId>,
    /// The request id that can be recognised all the same.
    pub request_id: Option<RequestId>,
}

/// What is wrong with a line or frame.
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
        /// What its head says.
        length: usize,
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
    /// The payload of a frame is not one whole value of MessagePack.
    NotMessagePack {
        /// What the parser says.
        message: String,
    },
    /// JSON or MessagePack, but no message of the protocol.
    Invalid {
        /// Path of the offending key, as `control_request.control_value[3].control_type`.
        path: String,
        /// What was found and expected.
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
            // What is wrong may be quoted from the line, so it may be as long as that: an answer is short.
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
                write!(f, "bytes that are not UTF-8 after byte {valid_up_to}")
            }
            DecodeErrorKind::NotJson { column, message } => {
                write!(f, "text that is not JSON at column {column}: {message}")
            }
            DecodeErrorKind::NotMessagePack { message } => {
                write!(f, "a frame that is not MessagePack: {message}")
            }
            DecodeErrorKind::Invalid { path, message } => write!(f, "{message} (at `{path}`)"),
        }
    }
}

/// Whom a control request is for, read without regard to the rest.
#[derive(Default, Deserialize)]
pub(super) struct Addressee {
    #[serde(default)]
    device_id: Option<String>,
    #[serde(default)]
    request_id: Option<String>,
}

/// A control request of a control type that this version does not know, whatever its values are.
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
