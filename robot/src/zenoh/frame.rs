//! A frame, the content of one publication: a sequence number, the number of bytes that its sender has read, and bytes of the stream. A
//! frame may replace some bytes by a reference to an earlier publication.

use urrcp::ContentHash;

/// What the receiver of a frame must expect after it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Next {
    /// More frames may follow.
    More,
    /// No further frames follow: the sender has closed its direction.
    End,
    /// No further frames follow: the sender's connection has broken, and the sender no longer reads either.
    Broken,
    /// Like `Broken`, because the sender did not receive a text (a separate publication) to which a frame referred.
    Lacking,
}

/// Size in bytes of the header before the content: the kind, the sequence number, and the number of bytes read.
const HEADER: usize = 17;
/// Kind of a frame that refers to a part of a separately published text. More frames may follow.
const WITH_PART: u8 = 3;
/// Size in bytes of the reference to a part of a text, which follows the header: a hash and three numbers.
const PART: usize = 44;

/// A reference to bytes of a text that was published separately.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TextPart {
    /// Hash of the whole text.
    pub(super) text: ContentHash,
    /// Number of bytes of the text that precede the part.
    pub(super) from: u32,
    /// Number of bytes in the part; at least 1.
    pub(super) count: u32,
    /// Number of bytes of the frame's content that precede the part.
    pub(super) at: u32,
}

/// One publication on a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Frame<'a> {
    /// Sequence number of the frame, which starts at 0 in each direction.
    pub(super) number: u64,
    /// Total number of bytes that the sender has read from this connection.
    pub(super) read: u64,
    pub(super) next: Next,
    /// The part of a separately published text that is inserted into the content. Only permitted if more frames may follow. `None`: no
    /// text is inserted.
    pub(super) part: Option<TextPart>,
    /// The next bytes of the stream, except those of the part.
    pub(super) content: &'a [u8],
}

impl TextPart {
    fn encode(&self, bytes: &mut Vec<u8>) {
        bytes.extend(self.text.bytes());
        for number in [self.from, self.count, self.at] {
            bytes.extend(number.to_le_bytes());
        }
    }

    fn decode(bytes: &[u8]) -> Option<(Self, &[u8])> {
        let (text, rest) = bytes.split_first_chunk::<32>()?;
        let (from, rest) = rest.split_first_chunk::<4>()?;
        let (count, rest) = rest.split_first_chunk::<4>()?;
        let (at, content) = rest.split_first_chunk::<4>()?;
        let [from, count, at] = [from, count, at].map(|number| u32::from_le_bytes(*number));
        let fits = count > 0 && usize::try_from(at).is_ok_and(|at| at <= content.len());
        fits.then_some((Self { text: (*text).into(), from, count, at }, content))
    }

    /// Returns the bytes to which the part refers. `None` if the text is too short.
    pub(super) fn of<'t>(&self, text: &'t [u8]) -> Option<&'t [u8]> {
        let from = usize::try_from(self.from).ok()?;
        text.get(from..from.checked_add(usize::try_from(self.count).ok()?)?)
    }
}

impl<'a> Frame<'a> {
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER + PART + self.content.len());
        bytes.push(match (self.next, self.part) {
            (Next::More, None) => 0,
            (Next::End, _) => 1,
            (Next::Broken, _) => 2,
            (Next::More, Some(_)) => WITH_PART,
            (Next::Lacking, _) => 4,
        });
        bytes.extend(self.number.to_le_bytes());
        bytes.extend(self.read.to_le_bytes());
        if let (Next::More, Some(part)) = (self.next, self.part) {
            part.encode(&mut bytes);
        }
        bytes.extend(self.content);
        bytes
    }

    /// Decodes a frame. `None` if the bytes are not a frame.
    pub(super) fn decode(bytes: &'a [u8]) -> Option<Self> {
        let (kind, rest) = bytes.split_first()?;
        let (number, rest) = rest.split_first_chunk::<8>()?;
        let (read, rest) = rest.split_first_chunk::<8>()?;
        let (part, content) = match *kind {
            WITH_PART => TextPart::decode(rest).map(|(part, content)| (Some(part), content))?,
            _ => (None, rest),
        };
        let next = match *kind {
            0 | WITH_PART => Next::More,
            1 => Next::End,
            2 => Next::Broken,
            4 => Next::Lacking,
            _ => return None,
        };
        Some(Self {
            number: u64::from_le_bytes(*number),
            read: u64::from_le_bytes(*read),
            next,
            part,
            content,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_round_trips_and_other_bytes_are_rejected() {
        let frame = Frame { number: 258, read: u64::MAX, next: Next::End, part: None, content: b"abc" };
        let bytes = frame.encode();
        assert_eq!(Frame::decode(&bytes), Some(frame));
        for next in [Next::Broken, Next::Lacking] {
            let empty = Frame { content: b"", next, ..frame };
            assert_eq!(Frame::decode(&empty.encode()), Some(empty));
        }
        assert_eq!(Frame::decode(&bytes[..HEADER - 1]), None);
        assert_eq!(Frame::decode(b""), None);
        let mut unknown = bytes;
        unknown[0] = 5;
        assert_eq!(Frame::decode(&unknown), None);
    }

    #[test]
    fn part_is_inserted_within_the_content_and_is_never_empty() {
        let part = TextPart { text: ContentHash::of(b"text"), from: 1, count: 2, at: 3 };
        let frame = Frame { number: 1, read: 2, next: Next::More, part: Some(part), content: b"abc" };
        let bytes = frame.encode();
        assert_eq!(Frame::decode(&bytes), Some(frame));
        assert_eq!(Frame::decode(&bytes[..bytes.len() - 1]), None, "it would go in behind the end");
        assert_eq!(Frame::decode(&bytes[..HEADER + PART - 1]), None);
        let empty = Frame { part: Some(TextPart { count: 0, ..part }), ..frame };
        assert_eq!(Frame::decode(&empty.encode()), None);
        assert_eq!(part.of(b"text"), Some(&b"ex"[..]));
        assert_eq!(part.of(b"te"), None);
        assert_eq!(TextPart { from: u32::MAX, count: u32::MAX, ..part }.of(b"text"), None);
    }
}
