//! The permissions of an operator, and the permissions that a message requires.

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use crate::message::{Command, ControlRequest, Message};
use crate::text::Label;

/// A permission of an operator. Each permission is independent of the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Permission to query descriptions, availability, sensor readings and the states of requests.
    Observe,
    /// Permission to start missions, that is, to claim free robots and to send them commands.
    Drive,
    /// Permission to stop any robot, regardless of the session that it belongs to.
    Stop,
    /// Together with [`Role::Drive`]: permission to take a robot from its current session.
    Seize,
}

impl Role {
    /// All roles, in the order in which they are listed.
    pub const ALL: [Self; 4] = [Self::Observe, Self::Drive, Self::Stop, Self::Seize];

    /// The name of the role, such as `observe`.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Observe => "observe",
            Self::Drive => "drive",
            Self::Stop => "stop",
            Self::Seize => "seize",
        }
    }

    /// Returns the roles that permit sending `message` to a robot; any one of them is enough. Sensor readings and queries without a
    /// session need [`Role::Observe`]. Messages that claim or move a robot need [`Role::Drive`]. A message that seizes a robot
    /// additionally needs [`Role::Seize`].
    #[must_use]
    pub fn needed_for(message: &Message) -> &'static [Self] {
        match message {
            Message::AvailabilityRequest(request) if request.session.is_none() => {
                &[Self::Observe, Self::Drive, Self::Stop]
            }
            Message::InitializationRequest(_) => &[Self::Observe, Self::Drive, Self::Stop],
            Message::Inquiry(inquiry) if inquiry.session.is_none() => &[Self::Observe, Self::Drive],
            Message::ControlRequest(request) => Self::needed_for_request(request),
            _ => &[Self::Drive],
        }
    }

    /// Returns the roles that permit sending `request` to a robot; any one of them is enough.
    #[must_use]
    pub fn needed_for_request(request: &ControlRequest) -> &'static [Self] {
        match &request.command {
            Command::ReadSensor => &[Self::Observe, Self::Drive],
            _ if request.is_stop() => &[Self::Stop, Self::Drive],
            _ => &[Self::Drive],
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// The error for a text that is not the name of a role.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown role `{0}`, expected observe, drive, stop or seize")]
pub struct UnknownRole(pub String);

impl FromStr for Role {
    type Err = UnknownRole;

    fn from_str(text: &str) -> Result<Self, UnknownRole> {
        let known = Self::ALL.into_iter().find(|role| role.as_str() == text);
        known.ok_or_else(|| UnknownRole(text.to_owned()))
    }
}

/// A set of roles.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Roles(BTreeSet<Role>);

impl Roles {
    /// Whether the set contains this role.
    #[must_use]
    pub fn has(&self, role: Role) -> bool {
        self.0.contains(&role)
    }

    /// Returns the roles in words, for messages: `no role`, `the role observe` or `the roles observe, drive`.
    #[must_use]
    pub fn in_words(&self) -> String {
        match self.0.len() {
            0 => "no role".to_owned(),
            1 => format!("the role {self}"),
            _ => format!("the roles {self}"),
        }
    }

    /// Iterates over the roles in the set, in the order of [`Role::ALL`].
    pub fn iter(&self) -> impl Iterator<Item = Role> + '_ {
        self.0.iter().copied()
    }
}

impl FromIterator<Role> for Roles {
    fn from_iter<I: IntoIterator<Item = Role>>(roles: I) -> Self {
        Self(roles.into_iter().collect())
    }
}

impl fmt::Display for Roles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = self.iter().map(Role::as_str).collect();
        f.write_str(&if names.is_empty() { "no role".to_owned() } else { names.join(", ") })
    }
}

/// The identity and the permissions that a peer has proven.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Proof {
    /// The peer's name.
    pub name: Label,
    /// The peer's permissions.
    pub roles: Roles,
    /// Serial number of the key with which the peer has proven its name. `None` if unknown.
    pub serial: Option<Label>,
}
