//! What an operator may do, and what a message takes.

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use crate::message::{Command, ControlRequest, Message};
use crate::text::Label;

/// What an operator may do, each by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Ask: descriptions, availability, readings, states.
    Observe,
    /// Begin missions: claim free robots and send them commands.
    Drive,
    /// Stop any robot, whichever session it belongs to.
    Stop,
    /// Take a robot from the session to which it belongs, together with [`Role::Drive`].
    Seize,
}

impl Role {
    /// All, in the order in which they are told.
    pub const ALL: [Self; 4] = [Self::Observe, Self::Drive, Self::Stop, Self::Seize];

    /// As it is written.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Observe => "observe",
            Self::Drive => "drive",
            Self::Stop => "stop",
            Self::Seize => "seize",
        }
    }

    /// What a message to a robot takes: any of these. A reading and a question without a session observe; what claims a robot or
    /// moves it drives. What seizes a robot takes [`Role::Seize`] as well.
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

    /// The roles that permit a control request; any one of them is enough.
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

impl FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = Self::ALL.into_iter().find(|role| role.as_str() == text);
        known.ok_or_else(|| format!("`{text}` is no role: expected observe, drive, stop or seize"))
    }
}

/// A set of roles.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Roles(BTreeSet<Role>);

impl Roles {
    /// Whether this one is among them.
    #[must_use]
    pub fn has(&self, role: Role) -> bool {
        self.0.contains(&role)
    }

    /// In their order.
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

/// What a peer has proven: who it is, and what it may do.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Proof {
    /// Its name.
    pub name: Label,
    /// What it may do.
    pub roles: Roles,
}
