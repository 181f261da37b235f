//! URRCP, the Universal Remote Robotics Control Protocol: its messages, their limits and their encoding.
//!
//! Here live the message types, the timestamps, the JSON-lines codec (bytes in, messages out) and the matching of
//! answers to open requests. No I/O, no clock and no runtime: the caller carries the bytes and knows the time.
//!
//! The protocol is that of Arkhipenka, Shilin, Naurotsky and Kuznetsov, "Methodology to identify robots given the type
//! of control designation", Doklady BGUIR 18(6), 2020, 41-48, doi 10.35596/1729-7648-2020-18-6-41-48. Where the paper
//! is silent, `docs/protocol.md` says what this project chose.

mod codec;
mod content_hash;
mod control_type;
mod error;
mod exchange;
mod limits;
mod message;
mod number;
mod object;
#[cfg(feature = "schema")]
mod schema;
mod text;
mod time;
#[cfg(test)]
mod wire_tests;

pub use codec::{DecodeError, DecodeErrorKind, Decoder, Encoding, encode, encode_as};
pub use content_hash::ContentHash;
pub use control_type::ControlType;
pub use error::{ControlError, ErrorCode};
pub use exchange::OpenRequests;
pub use limits::{
    CONTROL_VALUES_MAX, DEVICES_MAX, INQUIRY_NAMES_MAX, LINE_BYTES_MAX, LimitError, OFFSET_MS_MAX,
    PARAMETERS_MAX, SCRIPT_STEPS_MAX, STRING_CHARS_MAX,
};
pub use message::{
    API_VERSION, AvailabilityRequest, AvailabilityResponse, Command, ControlParameters, ControlRequest,
    ControlResponse, ControlTypes, Device, DeviceRoom, InitializationBlock, InitializationRequest, Inquiry,
    InquiryResponse, Interpolation, Limits, Message, RequestReport, RequestState, RobotType, Script,
    ScriptParameters, SensorParameters, Setpoint, Status, StatusValue, Step, StopCondition,
};
#[cfg(feature = "schema")]
pub use schema::message_schema;
pub use text::{DeviceId, Label, RequestId, RobotId, SessionId};
pub use time::{Millis, Robot, Server, Span, Timestamp};

/// The examples of the README are compiled with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
