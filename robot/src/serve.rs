//! Transfers messages over TCP for a robot of a host: lines of JSON, or frames of MessagePack if the peer sends these.

mod connection;
mod described;
mod door;
#[cfg(any(feature = "sealed", feature = "tls"))]
mod keys;
mod places;

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

#[cfg(any(feature = "sealed", feature = "tls"))]
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};

use self::connection::{Patience, Shared, carry};
pub use self::door::Door;
#[cfg(any(feature = "sealed", feature = "tls"))]
use self::keys::Key;
use self::places::{Places, Ticket};
use crate::host::HostHandle;
use crate::peer::Peer;
#[cfg(any(feature = "sealed", feature = "tls"))]
use crate::refusals::Reason;
#[cfg(feature = "zenoh")]
use crate::zenoh;
#[cfg(feature = "sealed")]
use downbeat_sealed as sealed;

/// Interval between attempts to admit a new connection. An attempt fails while too many connections that were asked to close have not yet
/// done so.
const ROOM_RETRY: Duration = Duration::from_millis(5);
/// Delay before the next attempt to accept a connection after one has failed, for example because no file descriptor was left. Other
/// connections may close in the meantime.
const ACCEPT_RETRY: Duration = Duration::from_millis(50);

/// Accepts connections for one robot of a host until the host stops. `robot` is the robot's index in the list with which the host was
/// started.
///
/// # Errors
/// The listening socket fails.
pub async fn serve(listener: TcpListener, host: HostHandle, robot: usize) -> io::Result<()> {
    serve_with(listener, host, robot, Patience::default(), Door::Open).await
}

/// Like [`serve()`], but admits only the peers that `door` permits.
///
/// # Errors
/// Those of [`serve()`].
pub async fn serve_behind(
    listener: TcpListener,
    host: HostHandle,
    robot: usize,
    door: Door,
) -> io::Result<()> {
    serve_with(listener, host, robot, Patience::default(), door).await
}

/// Accepts connections for one robot of a host at its key in a Zenoh network, until the host stops. The network decides which peers may
/// open a connection.
///
/// # Errors
/// The Zenoh session ends.
#[cfg(feature = "zenoh")]
pub async fn serve_zenoh(mut listener: zenoh::Listener, host: HostHandle, robot: usize) -> io::Result<()> {
    let patience = Patience::default();
    let Some(places) = Places::new(host.clone(), robot, patience.silence) else { return Ok(()) };
    let shared = Shared::new(host.clone(), patience, Door::Open);
    loop {
        let stream = listener.accept().await?;
        let peer = Peer::through(&format!("zenoh:{}", stream.name()));
        let ticket = ticket(&places, &peer).await;
        if host.has_stopped() {
            return Ok(());
        }
        let Some(link) = host.connect_as(robot, peer.clone()) else { return Ok(()) };
        let shared = shared.clone();
        // One task per connection, as with TCP.
        tokio::spawn(async move {
            let (reader, writer) = stream.split();
            if let Err(error) = carry(reader, writer, peer.clone(), link, ticket, shared).await {
                tracing::debug!(%peer, "connection ended: {error}");
            }
        });
    }
}

/// Waits until the new connection of this peer is admitted, and returns its ticket.
async fn ticket(places: &Arc<Places>, peer: &Peer) -> Ticket {
    loop {
        match places.admit(peer) {
            Some(ticket) => return ticket,
            None => tokio::time::sleep(ROOM_RETRY).await,
        }
    }
}

async fn serve_with(
    listener: TcpListener,
    host: HostHandle,
    robot: usize,
    patience: Patience,
    door: Door,
) -> io::Result<()> {
    let Some(places) = Places::new(host.clone(), robot, patience.silence) else { return Ok(()) };
    let shared = Shared::new(host.clone(), patience, door);
    let accepting = async {
        loop {
            let (stream, address) = accept(&listener).await?;
            let peer = Peer::at(address);
            let ticket = ticket(&places, &peer).await;
            if host.has_stopped() {
                return Ok(());
            }
            let shared = shared.clone();
            // Each connection has its own task, so that a slow or broken peer harms only itself. The task ends when either side closes the
            // connection, or when another connection needs its place.
            tokio::spawn(async move {
                if let Err(error) = admit(stream, peer.clone(), robot, ticket, shared).await {
                    tracing::debug!(%peer, "connection ended: {error}");
                }
            });
        }
    };
    #[cfg(any(feature = "sealed", feature = "tls"))]
    if !matches!(shared.door, Door::Open) {
        return tokio::select! {
            ended = accepting => ended,
            () = shared.keys.watch(&shared.door, &host, robot) => Ok(()),
        };
    }
    accepting.await
}

/// Transfers the messages of a connection. If `door` requires it, the peer must first prove its identity.
async fn admit(
    stream: TcpStream,
    peer: Peer,
    robot: usize,
    ticket: Ticket,
    shared: Shared,
) -> io::Result<()> {
    stream.set_nodelay(true)?;
    match shared.door.clone() {
        Door::Open => {
            let Some(link) = shared.host.connect_as(robot, peer.clone()) else { return Ok(()) };
            let (reader, writer) = stream.into_split();
            carry(reader, writer, peer, link, ticket, shared).await
        }
        #[cfg(feature = "tls")]
        Door::Tls(guard) => carry_proven(guard.accept(stream), peer, robot, ticket, shared).await,
        #[cfg(feature = "sealed")]
        Door::Sealed(guard) => carry_proven(guard.accept(stream), peer, robot, ticket, shared).await,
    }
}

#[cfg(any(feature = "sealed", feature = "tls"))]
async fn carry_proven<S, K>(
    proving: impl Future<Output = io::Result<(S, K)>>,
    peer: Peer,
    robot: usize,
    ticket: Ticket,
    shared: Shared,
) -> io::Result<()>
where
    S: AsyncRead + AsyncWrite,
    K: Into<Key>,
{
    let proven = tokio::select! {
        proven = tokio::time::timeout(shared.patience.first_message, proving) => {
            proven.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()))
        }
        () = ticket.hung_up() => return Ok(()),
    };
    let host = shared.host.clone();
    let refusals = host.refusals();
    let proven = match proven {
        Ok((stream, key)) => shared.keys.admit(&shared.door, key.into()).await.map(|proof| (stream, proof)),
        Err(error) => Err(error),
    };
    let (stream, proof) = proven.inspect_err(|error| {
        refusals.note(Reason::NotProven, &peer);
        if let Some(audit) = host.audit() {
            audit.not_admitted(robot, &peer, &error.to_string());
        }
    })?;
    let peer = peer.with_proof(proof.clone());
    ticket.establish(&peer);
    let Some(link) = shared.host.connect_as(robot, peer.clone()) else { return Ok(()) };
    if !shared.keys.contains(&proof) {
        return Err(io::Error::other("the key has become invalid"));
    }
    let (reader, writer) = tokio::io::split(stream);
    let carried = carry(reader, writer, peer.clone(), link, ticket, shared).await;
    carried.inspect_err(|error| {
        if is_altered(error) {
            refusals.note(Reason::Altered, &peer);
        }
    })
}

/// Whether a connection ended because the data that arrived is not exactly what the peer sent.
#[cfg(any(feature = "sealed", feature = "tls"))]
fn is_altered(error: &io::Error) -> bool {
    let Some(inner) = error.get_ref() else { return false };
    #[cfg(feature = "sealed")]
    if inner.is::<sealed::BadRecord>() {
        return true;
    }
    #[cfg(feature = "tls")]
    if let Some(error) = inner.downcast_ref::<rustls::Error>() {
        return !matches!(error, rustls::Error::AlertReceived(_));
    }
    false
}

/// Accepts the next connection. Tries again if a connection breaks before it is accepted, or if the system is short of resources such as
/// file descriptors.
async fn accept(listener: &TcpListener) -> io::Result<(TcpStream, SocketAddr)> {
    loop {
        match listener.accept().await {
            Ok(accepted) => return Ok(accepted),
            Err(error) if is_passing(&error) => {
                tracing::warn!("cannot accept a connection: {error}");
                tokio::time::sleep(ACCEPT_RETRY).await;
            }
            Err(error) => return Err(error),
        }
    }
}

fn is_passing(error: &io::Error) -> bool {
    use rustix::io::Errno;
    let passing = [Errno::CONNABORTED, Errno::INTR, Errno::MFILE, Errno::NFILE, Errno::NOBUFS, Errno::NOMEM];
    Errno::from_io_error(error).is_some_and(|errno| passing.contains(&errno))
}

#[cfg(test)]
mod tests;
