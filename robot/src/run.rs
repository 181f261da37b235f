//! Runs a robot as a complete program with a single call, which returns once the program has been asked to end.

use std::io;
use std::net::{TcpListener, ToSocketAddrs};

use tokio::signal::unix::{SignalKind, signal};

use crate::host::{Host, HostError, HostOptions, Hosted, NotAtRest};
use crate::serve::serve;

/// The reason why a robot did not run, or did not end properly.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// Listening on the address failed, or the system has no resources for another task.
    #[error("cannot listen: {0}")]
    Listen(io::Error),
    /// The host could not be started. Nothing was moved.
    #[error(transparent)]
    Host(#[from] HostError),
    /// The robot has ended, but its devices may not be at rest.
    #[error(transparent)]
    NotAtRest(#[from] NotAtRest),
}

/// Runs one robot on a port until Ctrl-C or SIGTERM, and then brings its devices to rest. A program needs only this call. For several
/// robots, or a robot next to other tasks, use [`Host`] and [`serve()`].
///
/// This function prints nothing: install a `tracing` subscriber to see its events.
///
/// # Errors
/// [`RunError`]. All errors except [`RunError::NotAtRest`] occur before the first server can connect.
pub fn run(
    robot: impl Into<Hosted>,
    address: impl ToSocketAddrs,
    options: HostOptions,
) -> Result<(), RunError> {
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(RunError::Listen)?;
    // Opens the port before anything moves.
    let listener = TcpListener::bind(address).map_err(RunError::Listen)?;
    listener.set_nonblocking(true).map_err(RunError::Listen)?;
    let host = Host::start(vec![robot.into()], options)?;
    let ended = runtime.block_on(serve_until_asked_to_end(listener, &host));
    let not_at_rest = host.stop().into_iter().next();
    ended.map_err(RunError::Listen)?;
    not_at_rest.map_or(Ok(()), |robot| Err(robot.into()))
}

async fn serve_until_asked_to_end(listener: TcpListener, host: &Host) -> io::Result<()> {
    let mut interrupted = signal(SignalKind::interrupt())?;
    let mut terminated = signal(SignalKind::terminate())?;
    let listener = tokio::net::TcpListener::from_std(listener)?;
    tokio::select! {
        ended = serve(listener, host.handle(), 0) => ended,
        _ = interrupted.recv() => Ok(()),
        _ = terminated.recv() => Ok(()),
    }
}
