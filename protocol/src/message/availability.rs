//! Steps 1 and 2 of the protocol: whether the robot is available, and what its clock shows.

use serde::{Deserialize, Deserializer, Serialize};

use super::Status;
use crate::error::ControlError;
use crate::object;
use crate::text::SessionId;
use crate::time::{Robot, Server, Timestamp};

/// Step 1 of the protocol: asks whether the robot is available. Also renews leases (limits on the silence of the server) while the server
/// has no other message to send.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AvailabilityRequest {
    /// When the server sent the request, T1 of RFC 5905 (our extension).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub timestamp: Option<Timestamp<Server>>,
    /// The session (a run of a scheduler) that claims the robot (our extension). A robot that belongs to another session responds with
    /// `Failed` and `busy`. `None`: the request does not claim the robot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<SessionId>,
    /// With `session`: whether to take the robot from its current session, whose commands then end (our extension). The robot refuses
    /// unless the peer has proven by TLS that it has the role `seize`.
    #[serde(default, deserialize_with = "flag", skip_serializing_if = "is_off")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<bool>"))]
    pub seize: bool,
    /// The text of a list of revoked keys, as in the file that the authority made (our extension). The robot should use the list if it is
    /// newer than its own. Only for robots that require a proven identity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub revocation_list: Option<String>,
}

/// Deserializes a flag; `null` counts as omitted, which means `false`.
fn flag<'de, D: Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
    Option::deserialize(deserializer).map(Option::unwrap_or_default)
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands over a reference")]
const fn is_off(flag: &bool) -> bool {
    !*flag
}

/// Step 2 of the protocol: the robot's response to an availability request. Its three timestamps and its arrival time determine the clock
/// offset and the delay, as in NTP (RFC 5905, section 8).
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AvailabilityResponse {
    /// The timestamp of the request, T1. `None` if the request had none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub originate_timestamp: Option<Timestamp<Server>>,
    /// When the robot received the request, T2.
    pub receive_timestamp: Timestamp<Robot>,
    /// When the robot sent this response, T3.
    pub timestamp: Timestamp<Robot>,
    /// `OK`, or `Failed` with an error. If it is `Failed`, the mission stops.
    pub status: Status,
    /// The reason why the status is `Failed`; `None` if it is `OK`.
    #[serde(default, deserialize_with = "object::optional", skip_serializing_if = "Option::is_none")]
    pub error: Option<ControlError>,
    /// The list of revoked keys that the robot uses (our extension). `None` if the robot has no list.
    #[serde(default, deserialize_with = "object::optional", skip_serializing_if = "Option::is_none")]
    pub revocation_list: Option<RevocationList>,
}

/// Identifies the list of revoked keys that a robot uses.
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RevocationList {
    /// Number of the list. A newer list has a larger number.
    pub number: u64,
    /// The reason why the robot did not accept the last list that it received on this connection.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
}

impl AvailabilityResponse {
    /// Creates the response to `request` from the robot's clock readings at receipt and at sending.
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
            revocation_list: None,
        }
    }
}
