//! The eight messages of the protocol. On the wire, each is an object with exactly one key, which names the message.

mod availability;
mod channels;
mod control_request;
mod control_response;
mod control_types;
mod device;
mod devices;
mod growth;
mod initialization_block;
mod inquiry;
mod latency;
mod on_line;
mod parameters;
mod script;
mod step;
mod stop_condition;

use serde::{Deserialize, Serialize};

use crate::object;

pub use availability::{AvailabilityRequest, AvailabilityResponse, RevocationList};
pub use channels::{CHANNELS_PER_UNIVERSE, Channels};
pub(crate) use control_request::OfUnknownType;
pub use control_request::{Command, ControlRequest};
pub use control_response::{ControlResponse, Status, StatusValue};
pub use control_types::{ControlParameters, ControlTypes, Limits, ScriptParameters, SensorParameters};
pub use device::{Device, Interpolation};
pub use devices::Devices;
pub use initialization_block::{API_VERSION, InitializationBlock, InitializationRequest, RobotType};
pub use inquiry::{DeviceReport, Inquiry, InquiryResponse, RequestReport, RequestState};
pub use latency::Latency;
pub(crate) use on_line::OnLine;
pub use script::{Script, Setpoint};
pub use step::Step;
pub use stop_condition::StopCondition;

/// Any message of the protocol.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Message {
    /// Step 1, server to robot: asks whether the robot is available.
    #[serde(deserialize_with = "object::deserialize")]
    AvailabilityRequest(AvailabilityRequest),
    /// Step 2, robot to server: the response to an availability request.
    #[serde(deserialize_with = "object::deserialize")]
    AvailabilityResponse(AvailabilityResponse),
    /// Step 3, server to robot: asks for the robot's description.
    #[serde(deserialize_with = "object::deserialize")]
    InitializationRequest(InitializationRequest),
    /// Step 4, robot to server: the robot's description.
    #[serde(deserialize_with = "growth::block")]
    InitializationBlock(InitializationBlock),
    /// Step 5, server to robot: drives, reads or stops one device.
    ControlRequest(ControlRequest),
    /// Step 6, robot to server: the response to a control request.
    #[serde(deserialize_with = "object::deserialize")]
    ControlResponse(ControlResponse),
    /// Server to robot: queries the states of requests and devices, without any effect on them (our extension).
    #[serde(deserialize_with = "object::deserialize")]
    Inquiry(Inquiry),
    /// Robot to server: the response to an inquiry (our extension).
    #[serde(deserialize_with = "object::deserialize")]
    InquiryResponse(InquiryResponse),
}

/// Implements the conversion of each kind of message into a [`Message`].
macro_rules! is_a_message {
    ($($kind:ident),*) => {
        $(impl From<$kind> for Message {
            fn from(message: $kind) -> Self {
                Self::$kind(message)
            }
        })*
    };
}

is_a_message!(
    AvailabilityRequest,
    AvailabilityResponse,
    InitializationRequest,
    InitializationBlock,
    ControlRequest,
    ControlResponse,
    Inquiry,
    InquiryResponse
);
