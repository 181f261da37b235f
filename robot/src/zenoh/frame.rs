//! What one publication carries: a number, how much its sender has read, and bytes.

/// What stands behind a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Next {
    /// Others may follow.
    More,
    /// The sender says nothing more.
    End,
    /// The sender has lost something of the connection, and says and hears nothing more.
    Broken,
}

/// Bytes ahead of the content: kind, number, bytes read.
const HEADER: usize = 17;

/// One publication of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Frame<'a> {
    /// Counted from 0 in each direction.
    pub(super) number: u64,
    /// Bytes of content that the sender has read on this connection in all.
    pub(super) read: u64,
    pub(super) next: Next,
    /// The next bytes of the stream.
    pub(super) content: &'a [u8],
}

impl<'a> Frame<'a> {
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER + self.content.len());
        bytes.push(match self.next {
            Next::More => 0,
            Next::End => 1,
            Next::Broken => 2,
        });
        bytes.extend(self.number.to_le_bytes());
        bytes.extend(self.read.to_le_bytes());
        bytes.extend(self.content);
        bytes
    }

    /// `None` for bytes that are no frame.
    pub(super) fn decode(bytes: &'a [u8]) -> Option<Self> {
        let (kind, rest) = bytes.split_first()?;
        let (number, rest) = rest.split_first_chunk::<8>()?;
        let (read, content) = rest.split_first_chunk::<8>()?;
        let next = match kind {
            0 => Next::More,
            1 => Next::End,
            2 => Next::Broken,
            _ => return None,
        };
        Some(Self { number: u64::from_le_bytes(*number), read: u64::from_le_bytes(*read), next, content })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_read_as_it_was_written_and_nothing_else_is_a_frame() {
        let frame = Frame { number: 258, read: u64::MAX, next: Next::End, content: b"abc" };
        let bytes = frame.encode();
        assert_eq!(Frame::decode(&bytes), Some(frame));
        let empty = Frame { content: b"", next: Next::Broken, ..frame };
        assert_eq!(Frame::decode(&empty.encode()), Some(empty));
        assert_eq!(Frame::decode(&bytes[..HEADER - 1]), None);
        assert_eq!(Frame::decode(b""), None);
        let mut unknown = bytes;
        unknown[0] = 3;
        assert_eq!(Frame::decode(&unknown), None);
    }
}
