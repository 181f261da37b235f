//! Splits a stream into lines and frames. A maximum message length bounds the memory that a decoder uses.

use super::error::{DecodeError, DecodeErrorKind};
use super::{Encoding, KnownScripts, frame, line};
use crate::limits::LINE_BYTES_MAX;
use crate::message::Message;

/// Splits a stream of bytes into lines of JSON and frames of MessagePack, and decodes each as a message.
///
/// ```
/// let mut decoder = urrcp::Decoder::default();
/// decoder.push(b"{\"availability_request\": {}}\n{\"avail");
/// assert!(matches!(decoder.next_message(), Some(Ok(urrcp::Message::AvailabilityRequest(_)))));
/// assert!(decoder.next_message().is_none());
/// ```
#[derive(Debug)]
pub struct Decoder {
    buffer: Vec<u8>,
    /// Index in `buffer` of the first byte that has not been read.
    read: usize,
    /// Index in `buffer` at which the search for a newline continues. The bytes from `read` to this index contain no newline.
    searched: usize,
    limit: usize,
    skipping: Skipping,
    encoding: Encoding,
    known: Option<KnownScripts>,
}

/// Capacity in bytes up to which a buffer that contains data is not shrunk.
const KEPT_MAX: usize = 64 * 1024;

/// The buffered part of the next message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Front {
    /// Length of the message in bytes. A frame states its length in its header. For a line that is not complete, this is the number of
    /// bytes received so far.
    pub bytes: usize,
    /// Whether the message has been received completely.
    pub whole: bool,
}

/// The result of decoding the item at the start of the buffer. `None` if the item is an empty line or the rest of an overlong line.
type Found = Option<Result<Message, DecodeError>>;

/// The part of an overlong message that is still to be discarded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Skipping {
    Nothing,
    /// The rest of an overlong line: everything up to the next newline.
    Line,
    /// The rest of an overlong frame: the given number of bytes.
    Frame(usize),
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new(LINE_BYTES_MAX)
    }
}

impl Decoder {
    /// Creates a decoder for lines and payloads of at most `limit` bytes.
    #[must_use]
    pub const fn new(limit: usize) -> Self {
        Self {
            buffer: Vec::new(),
            read: 0,
            searched: 0,
            limit,
            skipping: Skipping::Nothing,
            encoding: Encoding::Json,
            known: None,
        }
    }

    /// Returns this decoder with known scripts. It recognizes these scripts in lines without parsing them step by step.
    #[must_use]
    pub fn that_knows(mut self, scripts: KnownScripts) -> Self {
        self.known = Some(scripts);
        self
    }

    /// Returns the encoding of the last message or decoding error; JSON before the first one. A response should use the encoding of its
    /// request.
    #[must_use]
    pub const fn encoding(&self) -> Encoding {
        self.encoding
    }

    /// Adds received bytes to the buffer. If the caller reads all messages before each push, the buffer contains at most one message and
    /// the bytes of one push.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.drain(..self.read);
        self.searched -= self.read;
        self.read = 0;
        let needed = self.buffer.len() + bytes.len();
        let capacity = self.buffer.capacity();
        if needed > capacity {
            // The capacity doubles, so that a long message is rarely copied, but never exceeds the maximum buffer size.
            let most = self.limit.saturating_add(frame::HEAD_BYTES).saturating_add(bytes.len());
            let grown = capacity.saturating_mul(2).min(most).max(needed);
            self.buffer.reserve_exact(grown - self.buffer.len());
        }
        self.buffer.extend_from_slice(bytes);
    }

    /// Changes the maximum length in bytes of subsequent lines and payloads. Buffered bytes are kept.
    pub const fn set_limit(&mut self, limit: usize) {
        self.limit = limit;
    }

    /// Describes the buffered part of the next message without decoding it. An empty line also counts as a message. The caller can use
    /// this to choose where to decode a long message. Returns `None` if the buffer is empty, contains only the rest of an overlong
    /// message, or contains only a part of a frame's header.
    pub fn front(&mut self) -> Option<Front> {
        let unread = self.buffer.get(self.read..).filter(|unread| !unread.is_empty())?;
        match (self.skipping, unread.first()?) {
            (Skipping::Nothing, &frame::MARK) => {
                let bytes = frame::length(unread)?.saturating_add(frame::HEAD_BYTES);
                Some(Front { bytes, whole: unread.len() >= bytes })
            }
            (Skipping::Nothing, _) => {
                let newline = memchr::memchr(line::END, &self.buffer[self.searched..]);
                let end = newline.map(|at| self.searched + at + 1);
                self.searched = end.map_or(self.buffer.len(), |end| end - 1);
                Some(Front { bytes: end.unwrap_or(self.buffer.len()) - self.read, whole: end.is_some() })
            }
            (Skipping::Line | Skipping::Frame(_), _) => None,
        }
    }

    /// Whether the decoder still has to discard the rest of an overlong message.
    #[must_use]
    pub fn is_skipping(&self) -> bool {
        self.skipping != Skipping::Nothing
    }

    /// Returns the number of buffered bytes that have not been decoded.
    #[must_use]
    pub fn buffered(&self) -> usize {
        self.buffer.len() - self.read
    }

    /// Returns the next message, or an error if its bytes are invalid. Returns `None` if more bytes must be pushed first. Skips empty
    /// lines.
    pub fn next_message(&mut self) -> Option<Result<Message, DecodeError>> {
        let found = self.find();
        if self.read == self.buffer.len() {
            // Thousands of connections are idle at a time. When the next connection allocates the released memory, it is still in the
            // processor's cache.
            (self.buffer, self.read, self.searched) = (Vec::new(), 0, 0);
        } else if self.buffer.capacity() > KEPT_MAX && self.buffered() <= self.buffer.capacity() / 4 {
            // Otherwise the first bytes of the next message would keep a long message's allocation alive.
            self.buffer = self.buffer[self.read..].to_vec();
            (self.read, self.searched) = (0, self.searched - self.read);
        }
        found
    }

    fn find(&mut self) -> Option<Result<Message, DecodeError>> {
        loop {
            let found = match (self.skipping, self.buffer.get(self.read)?) {
                (Skipping::Frame(left), _) => {
                    self.skip(left);
                    continue;
                }
                (Skipping::Nothing, &frame::MARK) => self.next_frame()?,
                (Skipping::Nothing | Skipping::Line, _) => self.next_line()?,
            };
            if found.is_some() {
                return found;
            }
        }
    }

    fn skip(&mut self, left: usize) {
        let skipped = left.min(self.buffer.len() - self.read);
        self.take(skipped);
        self.skipping = match left - skipped {
            0 => Skipping::Nothing,
            left => Skipping::Frame(left),
        };
    }

    /// Marks the next `bytes` bytes as read.
    fn take(&mut self, bytes: usize) {
        self.read += bytes;
        self.searched = self.read;
    }

    fn next_frame(&mut self) -> Option<Found> {
        let unread = &self.buffer[self.read..];
        let length = frame::length(unread)?;
        if length > self.limit {
            self.take(frame::HEAD_BYTES);
            self.skipping = Skipping::Frame(length);
            self.encoding = Encoding::MessagePack;
            let kind = DecodeErrorKind::FrameTooLong { length, limit: self.limit };
            return Some(Some(Err(DecodeError::bare(kind))));
        }
        let payload = unread[frame::HEAD_BYTES..].get(..length)?;
        let decoded = frame::read(payload);
        self.take(frame::HEAD_BYTES + length);
        self.encoding = Encoding::MessagePack;
        Some(Some(decoded))
    }

    fn next_line(&mut self) -> Option<Found> {
        let newline = memchr::memchr(line::END, &self.buffer[self.searched..]);
        let Some(newline) = newline.map(|at| self.searched + at) else {
            self.searched = self.buffer.len();
            return self.overflow();
        };
        let text = self.read..newline;
        self.take(newline + 1 - self.read);
        if std::mem::replace(&mut self.skipping, Skipping::Nothing) == Skipping::Line {
            return Some(None);
        }
        if text.len() > self.limit {
            return Some(Some(Err(self.too_long())));
        }
        let text = self.buffer[text].trim_ascii();
        if text.is_empty() {
            return Some(None);
        }
        self.encoding = Encoding::Json;
        Some(Some(line::read(text, self.known.as_ref())))
    }

    /// Discards the buffered part of an incomplete line that exceeds the limit. Returns the error only once for each line.
    fn overflow(&mut self) -> Option<Found> {
        if self.skipping != Skipping::Line && self.buffer.len() - self.read <= self.limit {
            return None;
        }
        self.take(self.buffer.len() - self.read);
        let first = std::mem::replace(&mut self.skipping, Skipping::Line) != Skipping::Line;
        first.then(|| Some(Err(self.too_long())))
    }

    fn too_long(&mut self) -> DecodeError {
        self.encoding = Encoding::Json;
        DecodeError::bare(DecodeErrorKind::LineTooLong { limit: self.limit })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_of_a_long_message_is_freed_when_the_next_one_has_begun() {
        let mut decoder = Decoder::default();
        decoder.push(&[b" ".repeat(1_000_000).as_slice(), b"[]\n{\"avail"].concat());
        assert!(decoder.next_message().is_some_and(|read| read.is_err()));
        assert!(decoder.buffer.capacity() <= KEPT_MAX, "{}", decoder.buffer.capacity());
        decoder.push(b"ability_request\": {}}\n");
        assert!(matches!(decoder.next_message(), Some(Ok(Message::AvailabilityRequest(_)))));
    }

    const LIMIT: usize = 4 * 1024 * 1024;
    const CHUNK: usize = 8 * 1024;

    /// Pushes the stream in chunks, as a socket would provide it. Returns the largest capacity of the buffer in bytes.
    #[track_caller]
    fn largest_buffer(stream: impl Iterator<Item = u8>) -> usize {
        let mut decoder = Decoder::new(LIMIT);
        let mut largest = 0;
        let mut stream = stream.peekable();
        while stream.peek().is_some() {
            decoder.push(&stream.by_ref().take(CHUNK).collect::<Vec<_>>());
            largest = largest.max(decoder.buffer.capacity());
            while decoder.next_message().is_some() {}
        }
        largest
    }

    fn repeated(byte: u8, count: usize) -> impl Iterator<Item = u8> + Clone {
        std::iter::repeat_n(byte, count)
    }

    fn head(length: usize) -> [u8; frame::HEAD_BYTES] {
        let [a, b, c, d] = u32::try_from(length).unwrap().to_be_bytes();
        [frame::MARK, a, b, c, d]
    }

    #[test]
    fn buffer_never_exceeds_one_message_and_one_push() {
        let most = LIMIT + frame::HEAD_BYTES + CHUNK;
        assert!(largest_buffer(repeated(b'x', 5 * LIMIT)) <= most, "an endless line");
        assert!(largest_buffer(repeated(b' ', LIMIT - 1).chain([b'\n'])) <= most, "the longest line");
        assert!(
            largest_buffer(head(LIMIT).into_iter().chain(repeated(0, LIMIT))) <= most,
            "the longest frame"
        );
        let skipped = head(5 * LIMIT).into_iter().chain(repeated(0, 5 * LIMIT));
        assert!(largest_buffer(skipped) <= 2 * CHUNK, "a frame that is too long");
        assert!(largest_buffer(head(LIMIT).into_iter()) <= 2 * CHUNK, "a head alone");
        let lines = repeated(b'x', 99).chain([b'\n']).cycle().take(LIMIT);
        assert!(largest_buffer(lines) <= 2 * CHUNK, "short lines");
    }

    #[track_caller]
    fn check_front(pushed: &[u8], expected: Option<Front>) {
        let mut decoder = Decoder::new(LIMIT);
        decoder.push(pushed);
        assert_eq!((decoder.front(), decoder.front()), (expected, expected), "{pushed:?}");
    }

    #[test]
    fn next_message_is_measured_without_parsing() {
        check_front(b"", None);
        check_front(b"{\"a", Some(Front { bytes: 3, whole: false }));
        check_front(b"{}\n{}\n", Some(Front { bytes: 3, whole: true }));
        check_front(&[frame::MARK, 0, 0], None);
        check_front(&[frame::MARK, 0, 0, 0, 2, 1], Some(Front { bytes: 7, whole: false }));
        check_front(&[frame::MARK, 0, 0, 0, 2, 1, 2, 3], Some(Front { bytes: 7, whole: true }));
        let mut decoder = Decoder::new(LIMIT);
        decoder.push(b"{\"availability_request\": ");
        assert!(!decoder.front().unwrap().whole);
        decoder.push(b"{}}\n{");
        assert_eq!(decoder.front(), Some(Front { bytes: 29, whole: true }));
        assert!(matches!(decoder.next_message(), Some(Ok(Message::AvailabilityRequest(_)))));
        assert_eq!(decoder.front(), Some(Front { bytes: 1, whole: false }));
    }

    #[test]
    fn lowered_limit_applies_to_buffered_bytes() {
        let mut decoder = Decoder::new(LIMIT);
        decoder.push(&[b' '; 100]);
        decoder.set_limit(50);
        assert!(matches!(decoder.next_message(), Some(Err(_))));
        assert_eq!(decoder.front(), None);
    }

    #[test]
    fn buffer_is_freed_after_its_message_is_read() {
        for text in [&vec![b' '; LIMIT - 1], &b"{\"initialization_request\": {}}".to_vec()] {
            let mut decoder = Decoder::new(LIMIT);
            decoder.push(text);
            decoder.push(b"\n");
            let _message = decoder.next_message();
            assert_eq!(decoder.buffer.capacity(), 0);
            decoder.push(b"{");
            assert_eq!(decoder.buffered(), 1);
        }
    }
}
