//! Identifiers of links and commands.

/// Identifies a connection between a server and this robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LinkId(pub u64);

/// Sequence number of an accepted command of one device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct CommandId(pub(crate) u64);
