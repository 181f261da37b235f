//! Steps 1 and 2: is the equipment available, and what does its clock show?

use serde::{Deserialize, Deserializer, Serialize};

use super::Status;
use crate::error::ControlError;
use crate::object;
use crate::text::SessionId;
use crate::time::{Robot, Server, Timestamp};

/// Step 1. Also renews the leases on a quiet link.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AvailabilityRequest {
    /// When the server sent it, T1 of RFC 5905 (our extension).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub timestamp: Option<Timestamp<Server>>,
    /// Claims the robot for this session; a robot that belongs to another answers `Failed` with `busy` (our extension).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<SessionId>,
    /// With a session: takes the robot from its current session, whose commands end (our extension). A robot complies if the peer has
    /// proven by TLS that it has the role `seize`, and refuses otherwise.
    #[serde(default, deserialize_with = "flag", skip_serializing_if = "is_off")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<bool>"))]
    pub seize: bool,
}

/// Treats `null` like an omitted flag.
fn flag<'de, D: Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
    Option::deserialize(deserializer).map(Option::unwrap_or_default)
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands over a reference")]
const fn is_off(flag: &bool) -> bool {
    !*flag
}

/// Step 2. Together with the time of arrival, its three timestamps determine offset and delay as in NTP (RFC 5905, section 8).
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AvailabilityResponse {
    /// The request's own timestamp, echoed: T1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub originate_timestamp: Option<Timestamp<Server>>,
    /// When the robot received the request: T2.
    pub receive_timestamp: Timestamp<Robot>,
    /// When the robot sent this: T3.
    pub timestamp: Timestamp<Robot>,
    /// `OK`, or `Failed` with an error: then the mission stops.
    pub status: Status,
    /// Why the check failed.
    #[serde(default, deserialize_with = "object::optional", skip_serializing_if = "Option::is_none")]
    pub error: Option<ControlError>,
}

impl AvailabilityResponse {
    /// The answer to a request that was received at one instant of the robot's clock and is answered at another.
    #[must_use]
    pub const fn new(
        request: &AvailabilityRequest,
        received: Timestamp<Robot>,
        sent: Timestamp<Robot>,
        status: Status,
    ) -> Self {
        Self {
            originate_timestamp: request.timestamp,
            receive_timestamp: received,
            timestamp: sent,
            status,
            error: None,
        }
    }
}
