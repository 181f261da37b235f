//! Messages over TCP round a robot of a host: lines of JSON, or frames of MessagePack to a peer that writes these.

mod budget;
mod connection;
mod described;
mod places;

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};

pub(crate) use self::budget::Strangers;
use self::connection::{Patience, Shared, carry};
use self::described::Described;
use self::places::{Places, Ticket};
use crate::host::HostHandle;
use crate::peer::Peer;
#[cfg(feature = "tls")]
use crate::refusals::Reason;
#[cfg(feature = "tls")]
use crate::tls::Guard;

/// How often a new connection asks for room again, where all others are as new.
const ROOM_RETRY: Duration = Duration::from_millis(5);
/// Before the next try when the system has no file descriptor left: others must close first.
const ACCEPT_RETRY: Duration = Duration::from_millis(50);

/// Accepts servers for one robot of a host, by its index in the list that the host was started with, until the host stops.
///
/// # Errors
/// When the listening socket fails.
pub async fn serve(listener: TcpListener, host: HostHandle, robot: usize) -> io::Result<()> {
    serve_with(listener, host, robot, Patience::default(), Door::Open).await
}

/// The same for operators who prove by TLS who they are, and for nobody else.
///
/// # Errors
/// As [`serve()`].
#[cfg(feature = "tls")]
pub async fn serve_guarded(
    listener: TcpListener,
    host: HostHandle,
    robot: usize,
    guard: Arc<Guard>,
) -> io::Result<()> {
    serve_with(listener, host, robot, Patience::default(), Door::Guarded(guard)).await
}

/// Who may come in.
#[derive(Clone)]
enum Door {
    /// Anyone.
    Open,
    /// Operators of the authority.
    #[cfg(feature = "tls")]
    Guarded(Arc<Guard>),
}

async fn serve_with(
    listener: TcpListener,
    host: HostHandle,
    robot: usize,
    patience: Patience,
    door: Door,
) -> io::Result<()> {
    let Some(places) = Places::new(host.clone(), robot, patience.silence) else { return Ok(()) };
    let strangers = host.strangers();
    let shared =
        Shared { host: host.clone(), described: Arc::new(Described::default()), strangers, patience };
    loop {
        let (stream, address) = accept(&listener).await?;
        let peer = Peer::at(address);
        let ticket = loop {
            match places.admit(&peer) {
                Some(ticket) => break ticket,
                None => tokio::time::sleep(ROOM_RETRY).await,
            }
        };
        if host.has_stopped() {
            return Ok(());
        }
        let (shared, door) = (shared.clone(), door.clone());
        // One task a connection, so that a slow or broken peer harms only itself; ends when either side closes, or when
        // its place is needed.
        tokio::spawn(async move {
            if let Err(error) = admit(stream, door, peer.clone(), robot, ticket, shared).await {
                tracing::debug!(%peer, "connection ended: {error}");
            }
        });
    }
}

/// Carries a connection, once its peer has proven who it is where that is asked for.
async fn admit(
    stream: TcpStream,
    door: Door,
    peer: Peer,
    robot: usize,
    ticket: Ticket,
    shared: Shared,
) -> io::Result<()> {
    stream.set_nodelay(true)?;
    match door {
        Door::Open => {
            let Some(link) = shared.host.connect_as(robot, peer.clone()) else { return Ok(()) };
            carry(stream.into_split(), peer, link, ticket, shared).await
        }
        #[cfg(feature = "tls")]
        Door::Guarded(guard) => {
            let proving = tokio::time::timeout(shared.patience.first_message, guard.accept(stream));
            let proven = tokio::select! {
                proven = proving => proven.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into())),
                () = ticket.hung_up() => return Ok(()),
            };
            let (stream, proof) = match proven {
                Ok(proven) => proven,
                Err(error) => {
                    shared.host.refusals().note(Reason::NotProven, &peer);
                    return Err(error);
                }
            };
            let peer = peer.with_proof(proof);
            let Some(link) = shared.host.connect_as(robot, peer.clone()) else { return Ok(()) };
            carry(tokio::io::split(stream), peer, link, ticket, shared).await
        }
    }
}

/// The next connection. One that breaks before it is accepted, or a system short of file descriptors, is no reason to
/// stop serving.
async fn accept(listener: &TcpListener) -> io::Result<(TcpStream, SocketAddr)> {
    loop {
        match listener.accept().await {
            Ok(accepted) => return Ok(accepted),
            Err(error) if is_passing(&error) => {
                tracing::warn!("a connection was not accepted: {error}");
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
