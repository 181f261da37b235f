//! What a robot says to its peers, whether hardware or a simulated world is around it.

use urrcp::Message;

use crate::ids::LinkId;

/// What leaves a robot.
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
