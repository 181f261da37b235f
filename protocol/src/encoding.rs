//! The encodings of messages.

use std::fmt;

/// How one message is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Encoding {
    /// A line of JSON, which everybody understands.
    #[default]
    Json,
    /// A frame of MessagePack, a fraction of the size.
    MessagePack,
}

impl Encoding {
    /// The name in an initialization block and in a fleet file.
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
