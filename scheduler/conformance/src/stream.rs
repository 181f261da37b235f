//! The byte stream of a test client's connection: plain TCP, TLS, or authenticated records. It is blocking, and lets checks alter
//! messages in transit.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::time::Duration;

use downbeat_robot::sealed::{
    Held, Hello, Keys, NotSealed, Opening, Refused, Sealing, fresh_nonce, proof_of_operator,
};
use downbeat_robot::tls::SERVER_NAME;
use rustls::client::ResolvesClientCert;
use rustls::pki_types::ServerName;
use rustls::sign::CertifiedKey;
use rustls::{ClientConfig, ClientConnection, SignatureScheme, StreamOwned};

use downbeat_runtime::link::{Security, Tls};

/// Maximum length in bytes of a line of the handshake.
const LINE_BYTES_MAX: usize = 8 * 1024;

/// The byte stream of a connection to a robot.
pub(super) enum Stream {
    Plain(TcpStream),
    Tls(Box<StreamOwned<ClientConnection, TcpStream>>),
    Hmac(Box<Sealed>),
}

/// A byte stream in records, each with an authentication code.
pub(super) struct Sealed {
    socket: TcpStream,
    sealing: Sealing,
    opening: Opening,
    opened: Vec<u8>,
    read: usize,
}

impl Stream {
    /// Connects to a robot and proves the client's identity, within the timeout `patience`.
    pub(super) fn connect(address: SocketAddr, security: &Security, patience: Duration) -> io::Result<Self> {
        let socket = dial(address, patience)?;
        match security {
            Security::Plain => Ok(Self::Plain(socket)),
            Security::Nameless => Err(io::Error::other(
                "missing identity: set DOWNBEAT_IDENTITY to the path of your identity file",
            )),
            Security::Tls(tls) => Self::by_tls(socket, Arc::clone(tls.config())),
            Security::Hmac(hmac) => Ok(Self::Hmac(Box::new(greet(socket, hmac.pass()?)?))),
        }
    }

    /// Connects by TLS like [`Stream::connect`], but presents no client certificate.
    pub(super) fn without_certificate(
        address: SocketAddr,
        tls: &Tls,
        patience: Duration,
    ) -> io::Result<Self> {
        let mut config = ClientConfig::clone(tls.config());
        config.client_auth_cert_resolver = Arc::new(NoCertificate);
        Self::by_tls(dial(address, patience)?, Arc::new(config))
    }

    fn by_tls(socket: TcpStream, config: Arc<ClientConfig>) -> io::Result<Self> {
        let name = ServerName::try_from(SERVER_NAME).map_err(io::Error::other)?;
        let client = ClientConnection::new(config, name).map_err(io::Error::other)?;
        let mut stream = StreamOwned::new(client, socket);
        stream.conn.complete_io(&mut stream.sock)?;
        Ok(Self::Tls(Box::new(stream)))
    }

    pub(super) fn socket(&self) -> &TcpStream {
        match self {
            Self::Plain(socket) => socket,
            Self::Tls(stream) => &stream.sock,
            Self::Hmac(sealed) => &sealed.socket,
        }
    }

    /// Returns `bytes` as they would be sent, after encryption. The state of the encryption advances as if they had been sent.
    pub(super) fn wrapped(&mut self, bytes: &[u8]) -> io::Result<Vec<u8>> {
        let mut wrapped = Vec::new();
        match self {
            Self::Plain(_) => wrapped.extend_from_slice(bytes),
            Self::Tls(stream) => {
                stream.conn.writer().write_all(bytes)?;
                while stream.conn.wants_write() {
                    stream.conn.write_tls(&mut wrapped)?;
                }
            }
            Self::Hmac(sealed) => sealed.sealing.seal(bytes, &mut wrapped),
        }
        Ok(wrapped)
    }
}

/// A certificate resolver that presents no client certificate.
#[derive(Debug)]
struct NoCertificate;

impl ResolvesClientCert for NoCertificate {
    fn resolve(&self, _issuers: &[&[u8]], _schemes: &[SignatureScheme]) -> Option<Arc<CertifiedKey>> {
        None
    }

    fn has_certs(&self) -> bool {
        false
    }
}

impl Read for Stream {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Plain(socket) => socket.read(bytes),
            Self::Tls(stream) => stream.read(bytes),
            Self::Hmac(sealed) => sealed.read(bytes),
        }
    }
}

impl Write for Stream {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Plain(socket) => socket.write(bytes),
            Self::Tls(stream) => stream.write(bytes),
            Self::Hmac(sealed) => {
                let mut records = Vec::new();
                sealed.sealing.seal(bytes, &mut records);
                sealed.socket.write_all(&records).map(|()| bytes.len())
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Tls(stream) => stream.flush(),
            Self::Plain(_) | Self::Hmac(_) => Ok(()),
        }
    }
}

impl Read for Sealed {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        loop {
            if self.read < self.opened.len() {
                let count = bytes.len().min(self.opened.len() - self.read);
                bytes[..count].copy_from_slice(&self.opened[self.read..self.read + count]);
                self.read += count;
                return Ok(count);
            }
            self.opened.clear();
            self.read = 0;
            let bad = |bad| io::Error::new(ErrorKind::InvalidData, bad);
            if self.opening.open(&mut self.opened).map_err(bad)? {
                continue;
            }
            let mut raw = [0; 16 * 1024];
            match self.socket.read(&mut raw)? {
                0 => return Ok(0),
                came => self.opening.push(&raw[..came]),
            }
        }
    }
}

/// Opens a TCP connection, without sending anything.
pub(super) fn dial(address: SocketAddr, patience: Duration) -> io::Result<TcpStream> {
    let socket = TcpStream::connect_timeout(&address, patience)?;
    socket.set_nodelay(true)?;
    socket.set_write_timeout(Some(patience))?;
    socket.set_read_timeout(Some(patience))?;
    Ok(socket)
}

/// Reads the next line of the handshake, including the newline, and nothing beyond it.
pub(super) fn line(socket: &mut TcpStream) -> io::Result<String> {
    let (mut line, mut byte) = (Vec::new(), [0]);
    while line.last() != Some(&b'\n') && line.len() < LINE_BYTES_MAX {
        socket.read_exact(&mut byte)?;
        line.push(byte[0]);
    }
    String::from_utf8(line).map_err(|_| io::Error::other(NotSealed::NotSpoken))
}

/// Creates the first line of the handshake from `held`, a pass with the identity that it proves.
pub(super) fn hello(held: &Held) -> io::Result<Hello> {
    Ok(Hello { nonce: fresh_nonce()?, robot: held.robot.clone(), claim: held.claim.clone() })
}

fn greet(mut socket: TcpStream, held: &Held) -> io::Result<Sealed> {
    let hello = hello(held)?;
    let said = hello.line();
    socket.write_all(said.as_bytes())?;
    let answer = line(&mut socket)?;
    hello.check_answer(&held.pass, &answer).map_err(io::Error::other)?;
    socket.write_all(proof_of_operator(&held.pass, &said, &answer).as_bytes())?;
    let (sealing, opening) = Keys::of(&held.pass, &said, &answer).of_operator();
    Ok(Sealed { socket, sealing, opening, opened: Vec::new(), read: 0 })
}

/// Asks the robot at `address` for its id, and selects the pass for that robot if there is one.
pub(super) fn for_robot_at(address: SocketAddr, security: Security, patience: Duration) -> Security {
    let Security::Hmac(hmac) = &security else { return security };
    let named = || {
        let (held, mut socket) = (hmac.pass().ok()?, dial(address, patience).ok()?);
        let hello = hello(held).ok()?;
        socket.write_all(hello.line().as_bytes()).ok()?;
        match hello.check_answer(&held.pass, &line(&mut socket).ok()?) {
            Err(NotSealed::Refused(Refused::OtherRobot(own))) => Some(own),
            _ => Some(held.robot.clone()),
        }
    };
    named().map_or_else(|| security.clone(), |own| Security::Hmac(Arc::new(hmac.for_robot(own))))
}
