//! The encodings of messages.

use std::fmt;

/// The encoding of one message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Encoding {
    /// A line of JSON. Every peer supports it.
    #[default]
    Json,
    /// A frame of MessagePack, which is much shorter than the line of JSON.
    MessagePack,
}

impl Encoding {
    /// The name of the encoding in an initialization block and in a fleet file.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::MessagePack => "msgpack",
        }
    }
}

impl fmt::Display for Encoding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}
