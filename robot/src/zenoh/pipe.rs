//! Both directions of one connection, without a network: what may be written, what can be read, and how it ends.

use std::collections::VecDeque;
use std::io;
use std::task::{Context, Poll, Waker};

use super::frame::{Frame, Next};

/// Bytes that one side may have written and the other not yet read.
pub(super) const WINDOW: usize = 1024 * 1024;
/// Content of one frame at most.
pub(super) const CONTENT_MAX: usize = 64 * 1024;

/// How nothing more comes.
#[derive(Clone, Debug, PartialEq, Eq)]
enum End {
    /// The other side says nothing more.
    Said,
    /// It is not known what was lost.
    Broken(String),
}

/// One end of a connection.
#[derive(Debug, Default)]
pub(super) struct Pipe {
    waiting: VecDeque<Vec<u8>>,
    /// How much of the first that waits is read.
    begun: usize,
    next: u64,
    came: u64,
    read: u64,
    /// How much was read when the other side was told last.
    told: u64,
    end: Option<End>,
    number: u64,
    written: u64,
    /// How much the other side has read.
    taken: u64,
    has_ended: bool,
    reader: Option<Waker>,
    writer: Option<Waker>,
}

fn count(bytes: usize) -> u64 {
    u64::try_from(bytes).unwrap_or(u64::MAX)
}

impl Pipe {
    /// A publication of the other side has come.
    pub(super) fn receive(&mut self, bytes: &[u8]) {
        if self.end.is_some() {
            return;
        }
        let Some(frame) = Frame::decode(bytes) else {
            return self.break_off("something came that is no frame");
        };
        if frame.next == Next::Broken {
            return self.break_off("the other side has lost a message, or its way here");
        }
        if frame.number != self.next {
            let what = format!(
                "a message was lost on the way: number {} came, expected {}",
                frame.number, self.next
            );
            return self.break_off(&what);
        }
        self.next += 1;
        self.came = self.came.saturating_add(count(frame.content.len()));
        if self.came.saturating_sub(self.read) > count(WINDOW) || frame.read > self.written {
            return self.break_off("the other side does not keep to what it may send");
        }
        self.taken = self.taken.max(frame.read);
        if !frame.content.is_empty() {
            self.waiting.push_back(frame.content.to_vec());
        }
        if frame.next == Next::End {
            self.end = Some(End::Said);
        }
        self.wake();
    }

    /// Nothing more comes, and nothing more arrives.
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

    fn wake(&mut self) {
        self.reader.take().into_iter().chain(self.writer.take()).for_each(Waker::wake);
    }

    fn error(&self) -> Option<io::Error> {
        match &self.end {
            Some(End::Broken(why)) => Some(io::Error::new(io::ErrorKind::ConnectionReset, why.clone())),
            _ => None,
        }
    }

    /// Reads into a buffer; zero bytes at the end. What has come is read first, however the connection ended.
    pub(super) fn poll_read(
        &mut self,
        context: &Context<'_>,
        into: &mut tokio::io::ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if self.waiting.is_empty() {
            return match (&self.end, self.error()) {
                (None, _) => {
                    self.reader = Some(context.waker().clone());
                    Poll::Pending
                }
                (Some(_), None) => Poll::Ready(Ok(())),
                (Some(_), Some(error)) => Poll::Ready(Err(error)),
            };
        }
        while let Some(first) = self.waiting.front().filter(|_| into.remaining() > 0) {
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

    /// The next frame with as much of these bytes as may be written.
    pub(super) fn poll_write(
        &mut self,
        context: &Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<(usize, Vec<u8>)>> {
        if let Some(error) = self.error() {
            return Poll::Ready(Err(error));
        }
        if self.has_ended || self.end.is_some() {
            return Poll::Ready(Err(io::ErrorKind::BrokenPipe.into()));
        }
        let under_way = usize::try_from(self.written.saturating_sub(self.taken)).unwrap_or(usize::MAX);
        let n = WINDOW.saturating_sub(under_way).min(CONTENT_MAX).min(bytes.len());
        if n == 0 && !bytes.is_empty() {
            self.writer = Some(context.waker().clone());
            return Poll::Pending;
        }
        self.written = self.written.saturating_add(count(n));
        Poll::Ready(Ok((n, self.frame(&bytes[..n], Next::More))))
    }

    /// A frame that says how much was read, once the other side may wait for that.
    pub(super) fn acknowledgement(&mut self) -> Option<Vec<u8>> {
        let due = self.read.saturating_sub(self.told) >= count(WINDOW / 2);
        (due && self.end.is_none() && !self.has_ended).then(|| self.frame(&[], Next::More))
    }

    /// The last frame, once: a side whose connection broke tells the other, which may have noticed nothing.
    pub(super) fn ending(&mut self) -> Option<Vec<u8>> {
        let next = if matches!(self.end, Some(End::Broken(_))) { Next::Broken } else { Next::End };
        (!std::mem::replace(&mut self.has_ended, true)).then(|| self.frame(&[], next))
    }

    fn frame(&mut self, content: &[u8], next: Next) -> Vec<u8> {
        let frame = Frame { number: self.number, read: self.read, next, content };
        self.number += 1;
        self.told = self.read;
        frame.encode()
    }
}

#[cfg(test)]
mod tests {
    use tokio::io::ReadBuf;

    use super::*;

    fn write(pipe: &mut Pipe, bytes: &[u8]) -> Poll<io::Result<(usize, Vec<u8>)>> {
        pipe.poll_write(&Context::from_waker(Waker::noop()), bytes)
    }

    fn written(pipe: &mut Pipe, bytes: &[u8]) -> Vec<u8> {
        let Poll::Ready(Ok((n, frame))) = write(pipe, bytes) else { panic!("no room") };
        assert_eq!(n, bytes.len());
        frame
    }

    /// What can be read now: bytes, none at the end, or why the connection broke; `None` where nothing is there.
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
    fn what_is_written_is_read_in_order_and_then_the_end() {
        let (mut near, mut far) = (Pipe::default(), Pipe::default());
        for words in [&b"one"[..], b"two"] {
            far.receive(&written(&mut near, words));
        }
        assert_eq!(read(&mut far, 4), Some(Ok(b"onet".to_vec())));
        far.receive(&near.ending().unwrap());
        assert_eq!(near.ending(), None, "it ends once");
        assert_eq!(read(&mut far, 9), Some(Ok(b"wo".to_vec())));
        assert_eq!(read(&mut far, 9), Some(Ok(Vec::new())));
        assert!(
            matches!(write(&mut far, b"x"), Poll::Ready(Err(error)) if error.kind() == io::ErrorKind::BrokenPipe)
        );
        assert!(matches!(write(&mut near, b"x"), Poll::Ready(Err(_))), "nothing is written behind the end");
    }

    #[test]
    fn a_frame_that_is_lost_repeated_or_overtaken_breaks_the_connection_behind_what_came() {
        for order in [&[0_usize, 2][..], &[0, 0], &[1], &[0, 2, 1]] {
            let (mut near, mut far) = (Pipe::default(), Pipe::default());
            let frames: Vec<_> = (0..3).map(|i| written(&mut near, &[b'a' + i])).collect();
            order.iter().for_each(|i| far.receive(&frames[*i]));
            if order[0] == 0 {
                assert_eq!(read(&mut far, 9), Some(Ok(b"a".to_vec())), "{order:?}");
            }
            let broken = read(&mut far, 9).unwrap().unwrap_err();
            assert!(broken.contains("a message was lost on the way"), "{broken}");
            assert!(matches!(write(&mut far, b"x"), Poll::Ready(Err(_))));
            near.receive(&far.ending().unwrap());
            assert_eq!(far.ending(), None, "said once");
            let told = read(&mut near, 9).unwrap().unwrap_err();
            assert!(told.contains("the other side has lost a message"), "{told}");
        }
    }

    #[test]
    fn a_reader_that_is_slow_holds_its_writer_back_and_its_progress_is_told() {
        let (mut near, mut far) = (Pipe::default(), Pipe::default());
        let piece = vec![7; CONTENT_MAX];
        let mut sent = 0;
        while let Poll::Ready(Ok((n, frame))) = write(&mut near, &piece) {
            far.receive(&frame);
            sent += n;
            assert!(sent <= WINDOW);
        }
        assert_eq!(sent, WINDOW);
        assert_eq!(far.acknowledgement(), None);
        assert_eq!(read(&mut far, WINDOW / 2).unwrap().unwrap().len(), WINDOW / 2);
        near.receive(&far.acknowledgement().unwrap());
        assert_eq!(far.acknowledgement(), None, "told once");
        assert!(matches!(write(&mut near, &piece), Poll::Ready(Ok((CONTENT_MAX, _)))));
    }

    #[test]
    fn who_does_not_keep_to_the_window_or_speaks_otherwise_is_cut_off() {
        let mut far = Pipe::default();
        let content = vec![0; WINDOW + 1];
        far.receive(&Frame { number: 0, read: 0, next: Next::More, content: &content }.encode());
        assert!(read(&mut far, 1).unwrap().is_err(), "nothing of it is kept");
        let mut far = Pipe::default();
        far.receive(&Frame { number: 0, read: 1, next: Next::More, content: b"" }.encode());
        assert!(read(&mut far, 1).unwrap().unwrap_err().contains("does not keep"));
        let mut far = Pipe::default();
        far.receive(b"GET / HTTP/1.1");
        assert!(read(&mut far, 1).unwrap().unwrap_err().contains("no frame"));
    }

    #[test]
    fn a_connection_that_breaks_wakes_both_who_read_and_who_write() {
        let mut pipe = Pipe::default();
        assert_eq!(read(&mut pipe, 1), None);
        pipe.break_off("it is gone");
        pipe.break_off("it is gone again");
        assert_eq!(read(&mut pipe, 1), Some(Err("it is gone".to_owned())));
        assert!(pipe.reader.is_none() && pipe.writer.is_none());
    }
}
