//! A connection that transfers its bytes in records.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadBuf};

use super::handshake::{
    Hello, Keys, LINE_BYTES_MAX, NotSealed, Refused, check_operator, fresh_nonce, proof_of_operator,
};
use super::passes::Held;
use super::record::{Opening, RECORD_BYTES_MAX, Sealing};
use super::secret::Pass;

/// Number of bytes requested per read.
const READ_BATCH: usize = 8 * 1024;

/// A connection whose two sides have proven their identity, and that transfers records. Written bytes may be buffered until they are
/// flushed.
#[derive(Debug)]
pub struct Sealed<S> {
    stream: S,
    sealing: Sealing,
    opening: Opening,
    /// Bytes of opened records. The first `read` of them have been consumed.
    opened: Vec<u8>,
    read: usize,
    /// Bytes of sealed records. The first `written` of them have been sent.
    sealed: Vec<u8>,
    written: usize,
}

impl<S> Sealed<S> {
    fn new(stream: S, (sealing, mut opening): (Sealing, Opening), came: &[u8]) -> Self {
        opening.push(came);
        Self { stream, sealing, opening, opened: Vec::new(), read: 0, sealed: Vec::new(), written: 0 }
    }
}

impl<S: AsyncWrite + Unpin> Sealed<S> {
    fn poll_written(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        while self.written < self.sealed.len() {
            let rest = &self.sealed[self.written..];
            match ready!(Pin::new(&mut self.stream).poll_write(context, rest))? {
                0 => return Poll::Ready(Err(io::ErrorKind::WriteZero.into())),
                written => self.written += written,
            }
        }
        self.sealed.clear();
        self.written = 0;
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Sealed<S> {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let own = self.get_mut();
        loop {
            if own.read < own.opened.len() {
                let count = buffer.remaining().min(own.opened.len() - own.read);
                buffer.put_slice(&own.opened[own.read..own.read + count]);
                own.read += count;
                return Poll::Ready(Ok(()));
            }
            own.opened.clear();
            own.read = 0;
            let bad = |bad| io::Error::new(io::ErrorKind::InvalidData, bad);
            if own.opening.open(&mut own.opened).map_err(bad)? {
                continue;
            }
            let mut raw = [0; READ_BATCH];
            let mut raw = ReadBuf::new(&mut raw);
            ready!(Pin::new(&mut own.stream).poll_read(context, &mut raw))?;
            if raw.filled().is_empty() {
                return Poll::Ready(if own.opening.is_within_record() {
                    Err(io::ErrorKind::UnexpectedEof.into())
                } else {
                    Ok(())
                });
            }
            own.opening.push(raw.filled());
        }
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Sealed<S> {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let own = self.get_mut();
        ready!(own.poll_written(context))?;
        let count = bytes.len().min(RECORD_BYTES_MAX);
        own.sealing.seal(&bytes[..count], &mut own.sealed);
        // Bytes that the peer does not take now are written by the next call, or by a flush.
        if let Poll::Ready(Err(error)) = own.poll_written(context) {
            return Poll::Ready(Err(error));
        }
        Poll::Ready(Ok(count))
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let own = self.get_mut();
        ready!(own.poll_written(context))?;
        Pin::new(&mut own.stream).poll_flush(context)
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let own = self.get_mut();
        ready!(own.poll_written(context))?;
        Pin::new(&mut own.stream).poll_shutdown(context)
    }
}

fn not_sealed(why: NotSealed) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, why)
}

/// Reads the next line, including the newline. Bytes that were received after the line stay in `came`. Fails at once if the line does not
/// start with `begin`.
async fn line<S: AsyncRead + Unpin>(stream: &mut S, came: &mut Vec<u8>, begin: &[u8]) -> io::Result<String> {
    loop {
        let known = came.len().min(begin.len());
        if came[..known] != begin[..known] {
            return Err(not_sealed(NotSealed::NotSpoken));
        }
        let within = came.len().min(LINE_BYTES_MAX);
        if let Some(end) = came[..within].iter().position(|byte| *byte == b'\n') {
            let rest = came.split_off(end + 1);
            let line = String::from_utf8(std::mem::replace(came, rest));
            return line.map_err(|_| not_sealed(NotSealed::NotSpoken));
        }
        if came.len() >= LINE_BYTES_MAX {
            return Err(not_sealed(NotSealed::NotSpoken));
        }
        if stream.read_buf(came).await? == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
    }
}

const BEGIN: &[u8] = b"URRCP-HMAC 1 ";

/// Connects to a robot as an operator.
///
/// # Errors
/// The connection breaks; or, with [`NotSealed`] as the inner error, the robot refuses the claim, or does not prove that it knows the
/// secret.
pub async fn connect<S>(mut stream: S, held: &Held) -> io::Result<Sealed<S>>
where
    S: AsyncRead + AsyncWrite + Unpin,
{
    let hello = Hello { nonce: fresh_nonce()?, robot: held.robot.clone(), claim: held.claim.clone() };
    let said = hello.line();
    stream.write_all(said.as_bytes()).await?;
    stream.flush().await?;
    let mut came = Vec::new();
    let answer = line(&mut stream, &mut came, BEGIN).await?;
    hello.check_answer(&held.pass, &answer).map_err(not_sealed)?;
    stream.write_all(proof_of_operator(&held.pass, &said, &answer).as_bytes()).await?;
    stream.flush().await?;
    Ok(Sealed::new(stream, Keys::of(&held.pass, &said, &answer).of_operator(), &came))
}

/// Accepts the connection of an operator, on the robot's side. `judge` returns the pass that proves the operator's claim, or the reason
/// for refusing the claim.
pub(super) async fn accept<S, J>(mut stream: S, judge: J) -> io::Result<(Sealed<S>, Hello)>
where
    S: AsyncRead + AsyncWrite + Unpin,
    J: FnOnce(&Hello) -> Result<Pass, Refused>,
{
    let mut came = Vec::new();
    let said = line(&mut stream, &mut came, BEGIN).await?;
    let judged = Hello::read(&said)
        .and_then(|hello| judge(&hello).map(|pass| (hello, pass)).map_err(NotSealed::Refused));
    let (hello, pass) = match judged {
        Ok(judged) => judged,
        Err(why) => {
            if let NotSealed::Refused(refused) = &why {
                stream.write_all(refused.line().as_bytes()).await?;
                stream.shutdown().await?;
            }
            return Err(not_sealed(why));
        }
    };
    let answer = hello.answer(&pass, &fresh_nonce()?);
    stream.write_all(answer.as_bytes()).await?;
    stream.flush().await?;
    let proof = line(&mut stream, &mut came, b"").await?;
    check_operator(&pass, &said, &answer, &proof).map_err(not_sealed)?;
    Ok((Sealed::new(stream, Keys::of(&pass, &said, &answer).of_robot(), &came), hello))
}
