//! One end of a connection, for both directions and without I/O: its flow control, its input, and how it ends.

use std::collections::VecDeque;
use std::io;
use std::task::{Context, Poll, Waker};

use urrcp::ContentHash;

use super::frame::{Frame, Next, TextPart};

/// Maximum number of bytes in flight: one side has written them, and the other side has not read them yet.
pub(super) const WINDOW: usize = 1024 * 1024;
/// Maximum size of a frame's content, in bytes.
pub(super) const CONTENT_MAX: usize = 64 * 1024;

/// How the input of a connection has ended.
#[derive(Clone, Debug, PartialEq, Eq)]
enum End {
    /// The other side has closed its direction.
    Said,
    /// The connection broke, so that bytes may be lost. Contains the reason.
    Broken(String),
}

/// A received piece of the stream that has not been read yet.
#[derive(Debug)]
enum Piece {
    Here(Vec<u8>),
    /// A part of a separately published text that has not arrived yet. Later pieces of the stream are not read before it.
    Awaited(TextPart),
}

/// How many bytes were written: of a frame's content, and of the text inserted into it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Written {
    pub(super) content: usize,
    pub(super) text: usize,
}

/// One end of a connection.
#[derive(Debug, Default)]
pub(super) struct Pipe {
    waiting: VecDeque<Piece>,
    /// How many bytes of the first unread piece have already been read.
    begun: usize,
    next: u64,
    came: u64,
    read: u64,
    /// Total number of bytes read that this side last reported to the other side.
    told: u64,
    end: Option<End>,
    number: u64,
    written: u64,
    /// Total number of bytes that the other side has reported as read.
    taken: u64,
    has_ended: bool,
    /// Whether a published text that this side needs did not arrive.
    lacks: bool,
    /// Whether a published text to which this side referred did not reach the other side.
    is_lacked: bool,
    reader: Option<Waker>,
    writer: Option<Waker>,
}

fn count(bytes: usize) -> u64 {
    u64::try_from(bytes).unwrap_or(u64::MAX)
}

impl Pipe {
    /// Handles a frame from the other side. If the frame refers to a published text, returns the text's hash: the text must be supplied
    /// before later bytes can be read.
    #[must_use]
    pub(super) fn receive(&mut self, bytes: &[u8]) -> Option<ContentHash> {
        if self.end.is_some() {
            return None;
        }
        match Frame::decode(bytes) {
            Some(frame) => {
                let is_taken = self.take(&frame);
                frame.part.filter(|_| is_taken).map(|part| part.text)
            }
            None => {
                self.break_off("received data that is not a frame");
                None
            }
        }
    }

    /// Adds the content of a frame to the input. Returns false if the frame breaks the connection instead.
    fn take(&mut self, frame: &Frame<'_>) -> bool {
        let refused = self.check(frame);
        if let Some(why) = refused {
            self.is_lacked |= frame.next == Next::Lacking;
            self.break_off(&why);
            return false;
        }
        self.next += 1;
        self.taken = self.taken.max(frame.read);
        let ahead = frame.part.and_then(|part| usize::try_from(part.at).ok()).unwrap_or(frame.content.len());
        let (ahead, behind) = frame.content.split_at(ahead.min(frame.content.len()));
        let pieces = [Some(Piece::Here(ahead.to_vec())), frame.part.map(Piece::Awaited)];
        let pieces = pieces.into_iter().flatten().chain([Piece::Here(behind.to_vec())]);
        self.waiting.extend(pieces.filter(|piece| !matches!(piece, Piece::Here(bytes) if bytes.is_empty())));
        if frame.next == Next::End {
            self.end = Some(End::Said);
        }
        self.wake();
        true
    }

    /// Checks a frame and updates the counts. If the frame breaks the connection, returns the reason.
    fn check(&mut self, frame: &Frame<'_>) -> Option<String> {
        match frame.next {
            Next::Broken => return Some("the peer has lost a message or its connection".to_owned()),
            Next::Lacking => {
                return Some("the peer did not receive a script that was published".to_owned());
            }
            Next::More | Next::End => {}
        }
        if frame.number != self.next {
            let (came, expected) = (frame.number, self.next);
            return Some(format!("a message was lost: received number {came}, expected {expected}"));
        }
        let part = frame.part.map_or(0, |part| u64::from(part.count));
        self.came = self.came.saturating_add(count(frame.content.len())).saturating_add(part);
        let too_much = self.came.saturating_sub(self.read) > count(WINDOW) || frame.read > self.written;
        too_much.then(|| "the peer exceeded its send limit".to_owned())
    }

    /// Inserts a published text at all places in the input that wait for it.
    pub(super) fn fill(&mut self, text: ContentHash, bytes: &[u8]) {
        let mut fits = true;
        for piece in &mut self.waiting {
            if let Piece::Awaited(part) = piece
                && part.text == text
            {
                match part.of(bytes) {
                    Some(bytes) => *piece = Piece::Here(bytes.to_vec()),
                    None => fits = false,
                }
            }
        }
        if !fits {
            self.fail("the peer referred to a part of a script that does not exist");
        }
        self.wake();
    }

    /// Records that a published text will not arrive. Breaks the connection if its input waits for this text.
    pub(super) fn lack(&mut self, text: ContentHash) {
        let awaits = |piece: &Piece| matches!(piece, Piece::Awaited(part) if part.text == text);
        if self.waiting.iter().any(awaits) {
            self.lacks = true;
            self.fail("a script that was published for several robots did not arrive");
        }
    }

    /// Whether a published text to which this side referred did not reach the other side.
    pub(super) const fn is_lacked(&self) -> bool {
        self.is_lacked
    }

    /// Breaks the connection, even if the other side has already closed its direction.
    fn fail(&mut self, why: &str) {
        if self.end == Some(End::Said) {
            self.end = None;
        }
        self.break_off(why);
    }

    /// Breaks the connection: no further bytes arrive in either direction.
    pub(super) fn break_off(&mut self, why: &str) {
        if self.end.is_none() {
            self.end = Some(End::Broken(why.to_owned()));
        }
        self.wake();
    }

    #[cfg(test)]
    pub(super) const fn is_broken(&self) -> bool {
        matches!(self.end, Some(End::Broken(_)))
    }

    #[cfg(test)]
    pub(super) fn waits_for_a_text(&self) -> bool {
        self.waiting.iter().any(|piece| matches!(piece, Piece::Awaited(_)))
    }

    fn wake(&mut self) {
        self.reader.take().into_iter().chain(self.writer.take()).for_each(Waker::wake);
    }

    fn error(&self) -> Option<io::Error> {
        match &self.end {
            Some(End::Broken(why)) => Some(io::Error::new(io::ErrorKind::ConnectionReset, why.clone())),
            _ => None,
        }
    }

    /// Reads into a buffer. At the end of the input, reads zero bytes. All bytes that were received can be read before the end or the
    /// error, however the connection ended.
    pub(super) fn poll_read(
        &mut self,
        context: &Context<'_>,
        into: &mut tokio::io::ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let awaits = matches!(self.waiting.front(), Some(Piece::Awaited(_)));
        if awaits || self.waiting.is_empty() {
            return match (&self.end, self.error()) {
                (Some(_), Some(error)) => Poll::Ready(Err(error)),
                (Some(_), None) if !awaits => Poll::Ready(Ok(())),
                _ => {
                    self.reader = Some(context.waker().clone());
                    Poll::Pending
                }
            };
        }
        while let Some(Piece::Here(first)) = self.waiting.front().filter(|_| into.remaining() > 0) {
            let left = &first[self.begun..];
            let n = left.len().min(into.remaining());
            into.put_slice(&left[..n]);
            self.begun += n;
            self.read = self.read.saturating_add(count(n));
            if self.begun == first.len() {
                self.waiting.pop_front();
                self.begun = 0;
            }
        }
        Poll::Ready(Ok(()))
    }

    /// Returns the next frame, and the number of bytes in it. It contains as much of `bytes`, and of the part inserted into them, as may
    /// be written now.
    pub(super) fn poll_write(
        &mut self,
        context: &Context<'_>,
        bytes: &[u8],
        part: Option<TextPart>,
    ) -> Poll<io::Result<(Written, Vec<u8>)>> {
        if let Some(error) = self.error() {
            return Poll::Ready(Err(error));
        }
        if self.has_ended || self.end.is_some() {
            return Poll::Ready(Err(io::ErrorKind::BrokenPipe.into()));
        }
        let under_way = usize::try_from(self.written.saturating_sub(self.taken)).unwrap_or(usize::MAX);
        let (written, part) = fitting(WINDOW.saturating_sub(under_way), bytes, part);
        if written == Written::default() && !bytes.is_empty() {
            self.writer = Some(context.waker().clone());
            return Poll::Pending;
        }
        self.written = self.written.saturating_add(count(written.content + written.text));
        Poll::Ready(Ok((written, self.frame(&bytes[..written.content], part, Next::More))))
    }

    /// Returns a frame that reports the number of bytes read. `None` if fewer bytes than half of [`WINDOW`] were read since the last
    /// report: the other side cannot be waiting yet.
    pub(super) fn acknowledgement(&mut self) -> Option<Vec<u8>> {
        let due = self.read.saturating_sub(self.told) >= count(WINDOW / 2);
        (due && self.end.is_none() && !self.has_ended).then(|| self.frame(&[], None, Next::More))
    }

    /// Returns the last frame at the first call, and `None` afterwards. If the connection broke on this side, the frame informs the other
    /// side, which may not have noticed.
    pub(super) fn ending(&mut self) -> Option<Vec<u8>> {
        let next = match self.end {
            Some(End::Broken(_)) if self.lacks => Next::Lacking,
            Some(End::Broken(_)) => Next::Broken,
            Some(End::Said) | None => Next::End,
        };
        (!std::mem::replace(&mut self.has_ended, true)).then(|| self.frame(&[], None, next))
    }

    fn frame(&mut self, content: &[u8], part: Option<TextPart>, next: Next) -> Vec<u8> {
        let frame = Frame { number: self.number, read: self.read, next, part, content };
        self.number += 1;
        self.told = self.read;
        frame.encode()
    }
}

/// Returns how much of `bytes` and of the part fits into the next frame, if `room` bytes may be written.
fn fitting(room: usize, bytes: &[u8], part: Option<TextPart>) -> (Written, Option<TextPart>) {
    let size = |number: u32| usize::try_from(number).unwrap_or(usize::MAX);
    let at = part.map_or(bytes.len(), |part| size(part.at).min(bytes.len()));
    let ahead = at.min(room).min(CONTENT_MAX);
    let Some(part) = part.filter(|_| ahead == at) else {
        return (Written { content: ahead, text: 0 }, None);
    };
    let count = part.count.min(u32::try_from(room - ahead).unwrap_or(u32::MAX));
    if count == 0 {
        return (Written { content: ahead, text: 0 }, None);
    }
    let text = size(count);
    let left = (room - ahead - text).min(CONTENT_MAX - ahead).min(bytes.len() - ahead);
    let behind = if count == part.count { left } else { 0 };
    (Written { content: ahead + behind, text }, Some(TextPart { count, ..part }))
}

#[cfg(test)]
mod tests {
    use tokio::io::ReadBuf;

    use super::*;

    fn write(pipe: &mut Pipe, bytes: &[u8]) -> Poll<io::Result<(usize, Vec<u8>)>> {
        let written = pipe.poll_write(&Context::from_waker(Waker::noop()), bytes, None);
        written.map_ok(|(written, frame)| (written.content, frame))
    }

    /// Writes `bytes` with a text inserted after the first `at` bytes. Returns all frames that this takes.
    fn written_around(pipe: &mut Pipe, bytes: &[u8], at: usize, text: &[u8]) -> Vec<Vec<u8>> {
        let (mut frames, mut done) = (Vec::new(), Written::default());
        while done != (Written { content: bytes.len(), text: text.len() }) {
            let small = |size: usize| u32::try_from(size).unwrap();
            let part = (done.text < text.len()).then(|| TextPart {
                text: ContentHash::of(text),
                from: small(done.text),
                count: small(text.len() - done.text),
                at: small(at - done.content),
            });
            let context = Context::from_waker(Waker::noop());
            let Poll::Ready(Ok((n, frame))) = pipe.poll_write(&context, &bytes[done.content..], part) else {
                return frames;
            };
            done = Written { content: done.content + n.content, text: done.text + n.text };
            frames.push(frame);
        }
        frames
    }

    fn receive(pipe: &mut Pipe, frame: &[u8]) {
        assert_eq!(pipe.receive(frame), None);
    }

    fn written(pipe: &mut Pipe, bytes: &[u8]) -> Vec<u8> {
        let Poll::Ready(Ok((n, frame))) = write(pipe, bytes) else { panic!("no room") };
        assert_eq!(n, bytes.len());
        frame
    }

    /// Reads up to `most` bytes, and returns them (none at the end of the input) or the reason why the connection broke. `None` if no
    /// bytes have arrived yet.
    fn read(pipe: &mut Pipe, most: usize) -> Option<Result<Vec<u8>, String>> {
        let mut buffer = vec![0; most];
        let mut buffer = ReadBuf::new(&mut buffer);
        match pipe.poll_read(&Context::from_waker(Waker::noop()), &mut buffer) {
            Poll::Pending => None,
            Poll::Ready(Ok(())) => Some(Ok(buffer.filled().to_vec())),
            Poll::Ready(Err(error)) => Some(Err(error.to_string())),
        }
    }

    #[test]
    fn written_bytes_are_read_in_order_followed_by_the_end() {
        let (mut near, mut far) = (Pipe::default(), Pipe::default());
        for words in [&b"one"[..], b"two"] {
            receive(&mut far, &written(&mut near, words));
        }
        assert_eq!(read(&mut far, 4), Some(Ok(b"onet".to_vec())));
        receive(&mut far, &near.ending().unwrap());
        assert_eq!(near.ending(), None, "it ends once");
        assert_eq!(read(&mut far, 9), Some(Ok(b"wo".to_vec())));
        assert_eq!(read(&mut far, 9), Some(Ok(Vec::new())));
        assert!(
            matches!(write(&mut far, b"x"), Poll::Ready(Err(error)) if error.kind() == io::ErrorKind::BrokenPipe)
        );
        assert!(matches!(write(&mut near, b"x"), Poll::Ready(Err(_))), "nothing is written behind the end");
    }

    #[test]
    fn lost_duplicate_or_overtaken_frame_breaks_connection_after_valid_data() {
        for order in [&[0_usize, 2][..], &[0, 0], &[1], &[0, 2, 1]] {
            let (mut near, mut far) = (Pipe::default(), Pipe::default());
            let frames: Vec<_> = (0..3).map(|i| written(&mut near, &[b'a' + i])).collect();
            order.iter().for_each(|i| receive(&mut far, &frames[*i]));
            if order[0] == 0 {
                assert_eq!(read(&mut far, 9), Some(Ok(b"a".to_vec())), "{order:?}");
            }
            let broken = read(&mut far, 9).unwrap().unwrap_err();
            assert!(broken.contains("a message was lost: received number"), "{broken}");
            assert!(matches!(write(&mut far, b"x"), Poll::Ready(Err(_))));
            receive(&mut near, &far.ending().unwrap());
            assert_eq!(far.ending(), None, "said once");
            let told = read(&mut near, 9).unwrap().unwrap_err();
            assert!(told.contains("the peer has lost a message"), "{told}");
        }
    }

    #[test]
    fn slow_reader_throttles_its_writer_and_reports_its_progress() {
        let (mut near, mut far) = (Pipe::default(), Pipe::default());
        let piece = vec![7; CONTENT_MAX];
        let mut sent = 0;
        while let Poll::Ready(Ok((n, frame))) = write(&mut near, &piece) {
            receive(&mut far, &frame);
            sent += n;
            assert!(sent <= WINDOW);
        }
        assert_eq!(sent, WINDOW);
        assert_eq!(far.acknowledgement(), None);
        assert_eq!(read(&mut far, WINDOW / 2).unwrap().unwrap().len(), WINDOW / 2);
        receive(&mut near, &far.acknowledgement().unwrap());
        assert_eq!(far.acknowledgement(), None, "told once");
        assert!(matches!(write(&mut near, &piece), Poll::Ready(Ok((CONTENT_MAX, _)))));
    }

    #[test]
    fn peer_that_exceeds_window_or_sends_invalid_frame_is_disconnected() {
        let mut far = Pipe::default();
        let content = vec![0; WINDOW + 1];
        receive(
            &mut far,
            &Frame { number: 0, read: 0, next: Next::More, part: None, content: &content }.encode(),
        );
        assert!(read(&mut far, 1).unwrap().is_err(), "nothing of it is kept");
        let mut far = Pipe::default();
        receive(&mut far, &Frame { number: 0, read: 1, next: Next::More, part: None, content: b"" }.encode());
        assert!(read(&mut far, 1).unwrap().unwrap_err().contains("exceeded its send limit"));
        let mut far = Pipe::default();
        receive(&mut far, b"GET / HTTP/1.1");
        assert!(read(&mut far, 1).unwrap().unwrap_err().contains("not a frame"));
    }

    #[test]
    fn published_text_is_read_at_its_position_and_holds_back_later_bytes() {
        let (mut near, mut far) = (Pipe::default(), Pipe::default());
        let (bytes, text, hash) = (b"<>\n", b"a script", ContentHash::of(b"a script"));
        let frames = written_around(&mut near, bytes, 1, text);
        assert_eq!(frames.len(), 1);
        assert_eq!(far.receive(&frames[0]), Some(hash));
        receive(&mut far, &written(&mut near, b"next"));
        receive(&mut far, &near.ending().unwrap());
        assert_eq!(read(&mut far, 99), Some(Ok(b"<".to_vec())));
        assert_eq!(read(&mut far, 99), None, "it waits, though nothing more comes");
        far.fill(ContentHash::of(b"another"), b"another");
        assert_eq!(read(&mut far, 99), None);
        far.fill(hash, text);
        assert_eq!(read(&mut far, 99), Some(Ok(b"a script>\nnext".to_vec())));
        assert_eq!(read(&mut far, 99), Some(Ok(Vec::new())));
    }

    #[test]
    fn long_text_passes_through_the_window_in_parts() {
        let (mut near, mut far) = (Pipe::default(), Pipe::default());
        let text: Vec<u8> = (0..WINDOW + 9).map(|i| u8::try_from(i % 251).unwrap()).collect();
        let hash = ContentHash::of(&text);
        let first = written_around(&mut near, b"<>", 1, &text);
        assert_eq!(first.len(), 1);
        assert_eq!(far.receive(&first[0]), Some(hash));
        far.fill(hash, &text);
        let mut came = read(&mut far, 2 * WINDOW).unwrap().unwrap();
        assert_eq!(came.len(), WINDOW);
        assert!(matches!(write(&mut near, b"x"), Poll::Pending), "the text counts as what is written");
        receive(&mut near, &far.acknowledgement().unwrap());
        let part = TextPart { text: hash, from: u32::try_from(WINDOW - 1).unwrap(), count: 10, at: 0 };
        let context = Context::from_waker(Waker::noop());
        let Poll::Ready(Ok((_, frame))) = near.poll_write(&context, b">", Some(part)) else { panic!() };
        assert_eq!(far.receive(&frame), Some(hash));
        far.fill(hash, &text);
        came.extend(read(&mut far, 99).unwrap().unwrap());
        assert!(came == [&b"<"[..], &text, b">"].concat());
    }

    #[test]
    fn missing_or_short_text_breaks_connection_and_reason_is_reported() {
        for (fills, told) in [(false, "did not receive a script"), (true, "has lost a message")] {
            let (mut near, mut far) = (Pipe::default(), Pipe::default());
            let part = TextPart { text: ContentHash::of(b"text"), from: 1, count: 4, at: 1 };
            let context = Context::from_waker(Waker::noop());
            let Poll::Ready(Ok((_, frame))) = near.poll_write(&context, b"<>", Some(part)) else { panic!() };
            let awaited = far.receive(&frame).unwrap();
            receive(&mut far, &near.ending().unwrap());
            assert_eq!(read(&mut far, 9), Some(Ok(b"<".to_vec())));
            if fills {
                far.fill(awaited, b"text")
            } else {
                far.lack(awaited)
            }
            read(&mut far, 9).unwrap().unwrap_err();
            receive(&mut near, &far.ending().unwrap());
            assert_eq!(near.is_lacked(), !fills);
            assert!(read(&mut near, 9).unwrap().unwrap_err().contains(told));
        }
    }

    #[test]
    fn part_longer_than_the_window_breaks_the_connection() {
        let mut far = Pipe::default();
        let part = TextPart { text: ContentHash::of(b"x"), from: 0, count: u32::MAX, at: 0 };
        let frame = Frame { number: 0, read: 0, next: Next::More, part: Some(part), content: b"" };
        receive(&mut far, &frame.encode());
        assert!(read(&mut far, 1).unwrap().unwrap_err().contains("exceeded its send limit"));
    }

    #[test]
    fn broken_connection_wakes_reader_and_writer() {
        let mut pipe = Pipe::default();
        assert_eq!(read(&mut pipe, 1), None);
        pipe.break_off("it is gone");
        pipe.break_off("it is gone again");
        assert_eq!(read(&mut pipe, 1), Some(Err("it is gone".to_owned())));
        assert!(pipe.reader.is_none() && pipe.writer.is_none());
    }
}
