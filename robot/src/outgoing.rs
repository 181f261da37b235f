//! A robot's output to its peers, both with hardware and in a simulated world.

use urrcp::Message;

use crate::ids::LinkId;

/// An action that a robot requests for a link: send a message, or close the link.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "nearly all values are messages")]
pub enum Outgoing {
    /// Send a message on a link.
    Message {
        /// Link on which to send the message.
        link: LinkId,
        /// Message to send.
        message: Message,
    },
    /// Close a link.
    Close {
        /// Link to close.
        link: LinkId,
    },
}
