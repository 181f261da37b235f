//! URRCP, the Universal Remote Robotics Control Protocol: its messages, their limits and their encoding.
//!
//! ```text
//!              server                                robot
//!   availability_request     ──────────▶   is it there, what does its clock show?
//!   availability_response    ◀──────────
//!   initialization_request   ──────────▶   which devices does it have?
//!   initialization_block     ◀──────────
//!   control_request          ──────────▶   set a device, read a sensor, or play a script from an instant on
//!   control_response         ◀──────────   Accepted, Started, OK, Provide or Failed
//!   inquiry                  ──────────▶   what became of these requests? (our extension)
//!   inquiry_response         ◀──────────
//! ```
//!
//! [`Message`] is any of these eight messages. [`encode`] writes a message as a line of JSON, [`encode_as`] also as a frame of
//! MessagePack, and a [`Decoder`] splits a received stream into messages. [`OpenRequests`] finds the request that a response answers.
//!
//! The crate does no I/O, reads no clock and needs no runtime: the caller transports the bytes and provides the time. Types enforce the
//! limits of the protocol, so that every value can be sent: a [`DeviceId`] has at most 256 characters, a [`Script`] is in order of time,
//! [`Millis`] is finite. The type of an instant contains its clock, [`Timestamp<Server>`](Timestamp) or [`Timestamp<Robot>`](Timestamp),
//! so that two clocks cannot be mixed.
//!
//! Messages have public fields. A message with many fields has a constructor `new` that takes the mandatory ones. Set the other fields
//! with `..ControlResponse::new(...)`, so that the code still compiles when later versions add fields.
//!
//! A scheduler asks a robot to move a joint in one second:
//!
//! ```
//! use urrcp::{Command, ControlRequest, ControlType, DeviceId, Millis, Setpoint, Timestamp, encode};
//!
//! let now = Timestamp::from_nanos(1_700_000_000_000_000_000);
//! let command = Command::Set(Setpoint::new(ControlType::Position, 30.0));
//! let request = ControlRequest::deferred(now, Millis::new(1_000.0)?, DeviceId::new("elbow")?, command)
//!     .with_request_id("1".parse()?)
//!     .with_content_hash();
//! let mut bytes = Vec::new();
//! encode(&request.into(), &mut bytes);
//! # Ok::<(), urrcp::LimitError>(())
//! ```
//!
//! The crate `downbeat-robot` contains robots that implement the protocol. The feature `schema` adds `message_schema`, the JSON Schema of
//! the messages.
//!
//! The paper that defines the protocol is: Arkhipenka, Shilin, Naurotsky and Kuznetsov, "Methodology to identify robots given the type of
//! control designation", Doklady BGUIR 18(6), 2020, 41-48, doi 10.35596/1729-7648-2020-18-6-41-48. `docs/protocol.md` of the repository
//! states this project's choices for all points that the paper leaves open.

mod codec;
mod content_hash;
mod control_type;
mod encoding;
mod error;
mod exchange;
mod limits;
mod message;
mod number;
mod object;
mod role;
#[cfg(feature = "schema")]
mod schema;
mod text;
mod time;
#[cfg(test)]
mod wire_tests;

pub use codec::{DecodeError, DecodeErrorKind, Decoder, Front, KnownScripts, encode, encode_as};
pub use content_hash::ContentHash;
pub use control_type::ControlType;
pub use encoding::Encoding;
pub use error::{ControlError, ErrorCode};
pub use exchange::OpenRequests;
pub use limits::{
    CONTROL_VALUES_MAX, DEVICES_MAX, ENCODINGS_MAX, INQUIRY_NAMES_MAX, LATENCY_MS_MAX, LINE_BYTES_MAX,
    LimitError, OFFSET_MS_MAX, PARAMETERS_MAX, ROBOT_PARAMETERS_MAX, SCRIPT_STEPS_MAX, STRING_CHARS_MAX,
};
pub use message::{
    API_VERSION, AvailabilityRequest, AvailabilityResponse, Channels, Command, ControlParameters,
    ControlRequest, ControlResponse, ControlTypes, Device, DeviceReport, Devices, InitializationBlock,
    InitializationRequest, Inquiry, InquiryResponse, Interpolation, Latency, Limits, Message, RequestReport,
    RequestState, RevocationList, RobotType, Script, ScriptParameters, SensorParameters, Setpoint, Status,
    StatusValue, Step, StopCondition,
};
pub use role::{Proof, Role, Roles, UnknownRole};
#[cfg(feature = "schema")]
pub use schema::message_schema;
pub use text::{DeviceId, Label, RequestId, RobotId, SessionId};
pub use time::{Millis, Robot, Server, Span, Timestamp};

/// Includes the README, so that its examples are compiled with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
