//! A robot's output to its peers, with hardware or in a simulated world.

use urrcp::Message;

use crate::ids::LinkId;

/// An outgoing message, or the end of a link.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "nearly all values are messages")]
pub enum Outgoing {
    /// A message on a link.
    Message {
        /// The link that carries it.
        link: LinkId,
        /// The message.
        message: Message,
    },
    /// The robot closes a link.
    Close {
        /// The link to close.
        link: LinkId,
    },
}
