//! The reasons why a robot refuses a command or ends it early.

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::text::{self, Label};

/// The reason why a request failed (key `error` of a response, our extension).
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[error("{code}: {message}")]
pub struct ControlError {
    /// The kind of failure, for programs.
    pub code: ErrorCode,
    /// The value found and the value expected, for people. Deserialization keeps only the first 256 characters.
    #[serde(default, deserialize_with = "text::shortened_on_reading")]
    pub message: String,
}

impl ControlError {
    /// Creates an error from a code and a message for people.
    pub fn new(code: ErrorCode, message: impl Into<String>) -> Self {
        Self { code, message: message.into() }
    }
}

macro_rules! error_codes {
    ($($(#[$doc:meta])* $variant:ident = $word:literal,)*) => {
        /// The kind of failure of a command.
        #[derive(Clone, Debug, PartialEq, Eq, Hash)]
        #[non_exhaustive]
        pub enum ErrorCode {
            $($(#[$doc])* $variant,)*
            /// A code that this version of the protocol does not know.
            Other(Label),
        }

        impl ErrorCode {
            /// The words that represent the codes on the wire, for all codes that this version knows.
            pub const WORDS: &[&str] = &[$($word,)*];

            /// The word that represents the code on the wire.
            #[must_use]
            pub fn as_str(&self) -> &str {
                match self {
                    $(Self::$variant => $word,)*
                    Self::Other(label) => label.as_str(),
                }
            }

            fn from_label(label: Label) -> Self {
                match label.as_str() {
                    $($word => Self::$variant,)*
                    _ => Self::Other(label),
                }
            }
        }
    };
}

error_codes! {
    /// The device does not list this control type. As a result, the device goes to its default state.
    UnsupportedControlType = "unsupported_control_type",
    /// The robot has no such device.
    UnknownDevice = "unknown_device",
    /// A value is below `min_value` or above `max_value`.
    OutOfRange = "out_of_range",
    /// A value is not a multiple of the granularity.
    OffGranularity = "off_granularity",
    /// The script has more steps than `max_number_of_steps`.
    TooManySteps = "too_many_steps",
    /// The requested start time has already passed.
    Late = "late",
    /// The device already has a command at the requested time.
    Overlap = "overlap",
    /// The server has been silent for longer than `stop_condition` permits.
    LinkLost = "link_lost",
    /// The message is malformed.
    Malformed = "malformed",
    /// The script queue is full, or the robot cannot accept commands now.
    Busy = "busy",
    /// The peer has proven its identity, but lacks the permission for the request (our extension).
    Forbidden = "forbidden",
    /// The robot failed internally.
    Internal = "internal",
    /// An empty script cancelled the command (our extension).
    Cancelled = "cancelled",
}

impl fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl Serialize for ErrorCode {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

impl<'de> Deserialize<'de> for ErrorCode {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Label::deserialize(deserializer).map(Self::from_label)
    }
}
