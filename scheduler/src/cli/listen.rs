//! The address at which a robot of this process listens: a TCP address, or a key of a Zenoh network.

use std::path::{Path, PathBuf};

#[cfg(feature = "zenoh")]
use downbeat_robot::zenoh;
use downbeat_robot::{Door, HostHandle, serve_behind};
use downbeat_scripts::{Address, Attempt, Refusal, address_fault};
use tokio::net::TcpListener;
use urrcp::RobotId;

use super::identity;
use super::robot::GuardArgs;

/// The prefix of an address that is a Zenoh key.
const ZENOH: &str = "zenoh:";

/// The network on which robots of this process can be reached.
#[derive(Debug, clap::Args)]
pub(super) struct NetworkArgs {
    /// The configuration of Zenoh, JSON5 or YAML, for robots at zenoh: addresses. By default, DOWNBEAT_ZENOH names it.
    #[arg(long = "zenoh", value_name = "FILE")]
    file: Option<PathBuf>,
}

impl NetworkArgs {
    /// Returns the access to Zenoh. Its configuration file is named on the command line, or else in the environment, or else in the fleet
    /// file.
    pub(super) fn way(&self, of_fleet: Option<&Path>) -> NetworkAccess {
        let file = identity::zenoh(self.file.as_deref());
        NetworkAccess {
            file: file.or_else(|| of_fleet.map(Path::to_owned)),
            #[cfg(feature = "zenoh")]
            joined: None,
        }
    }
}

/// Access to a Zenoh network. The network is joined when a robot first needs it.
#[derive(Debug)]
pub(super) struct NetworkAccess {
    #[cfg_attr(not(feature = "zenoh"), expect(dead_code, reason = "named, though this build has no Zenoh"))]
    file: Option<PathBuf>,
    #[cfg(feature = "zenoh")]
    joined: Option<zenoh::Networks>,
}

/// Whether the operator accepts a network where anyone on the path could drive the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Exposure {
    Accepted,
    Refused,
}

/// An opened address of a robot whose clients are not served yet.
#[derive(Debug)]
pub(super) enum Listening {
    Tcp(TcpListener, Door),
    #[cfg(feature = "zenoh")]
    Zenoh(zenoh::Listener),
}

impl Listening {
    /// Opens the address that `--listen` names.
    pub(super) async fn at(
        place: &str,
        robot: &RobotId,
        guard: &GuardArgs,
        way: &mut NetworkAccess,
    ) -> Result<Self, String> {
        if place.starts_with(ZENOH) {
            let Ok(Address::Zenoh { key }) = place.parse() else {
                let (fault, hint) = address_fault(place);
                return Err(format!("--listen {place} {fault}; {}", hint.unwrap_or_default()));
            };
            guard.refuse_at_key()?;
            let exposure = if guard.permits_anyone() { Exposure::Accepted } else { Exposure::Refused };
            return way.listen(&key, exposure).await;
        }
        let listener = Self::bind(place).await?;
        let door = guard.door(robot, &listener)?;
        Ok(Self::Tcp(listener, door))
    }

    /// Opens a TCP socket at the address `place`, given as HOST:PORT.
    pub(super) async fn bind(place: &str) -> Result<TcpListener, String> {
        let refused = |error| format!("cannot listen on {place}: {}", Refusal::of(Attempt::Listen, &error));
        TcpListener::bind(place).await.map_err(refused)
    }

    /// Returns the address at which the robot listens. `None` if the system has closed the socket.
    pub(super) fn place(&self) -> Option<String> {
        match self {
            Self::Tcp(listener, _) => listener.local_addr().ok().map(|address| address.to_string()),
            #[cfg(feature = "zenoh")]
            Self::Zenoh(listener) => Some(format!("{ZENOH}{}", listener.key())),
        }
    }

    /// Serves clients of a robot at this address until the host, which runs the robot, stops.
    pub(super) async fn serve(self, host: HostHandle, robot: usize) -> std::io::Result<()> {
        match self {
            Self::Tcp(listener, door) => serve_behind(listener, host, robot, door).await,
            #[cfg(feature = "zenoh")]
            Self::Zenoh(listener) => downbeat_robot::serve_zenoh(listener, host, robot).await,
        }
    }
}

#[cfg(feature = "zenoh")]
impl NetworkAccess {
    /// Listens at a key of the Zenoh network.
    pub(super) async fn listen(&mut self, key: &str, exposure: Exposure) -> Result<Listening, String> {
        let networks = match &self.joined {
            Some(networks) => networks.clone(),
            None => {
                let file = self.file.clone();
                // Joining waits for routers, so another thread does it.
                let joining = tokio::task::spawn_blocking(move || crate::link::join(file.as_deref()));
                joining.await.map_err(|error| error.to_string())??
            }
        };
        if let Some(endpoint) = networks.open_endpoint().filter(|_| exposure == Exposure::Refused) {
            return Err(format!(
                "the Zenoh configuration uses {endpoint}, where anyone on the network path could drive the robot; use a tls/ endpoint, or add --insecure if the network is isolated"
            ));
        }
        self.joined = Some(networks.clone());
        let joining = tokio::task::spawn_blocking(move || networks.for_one_more());
        let network = joining.await.map_err(|error| error.to_string())?;
        let key = key.parse().map_err(|error| format!("{ZENOH}{key}: {error}"))?;
        let place = format!("{ZENOH}{key}");
        let listener = zenoh::Listener::bind(&network, key).await;
        listener.map(Listening::Zenoh).map_err(|error| format!("cannot listen on {place}: {error}"))
    }
}

#[cfg(not(feature = "zenoh"))]
impl NetworkAccess {
    pub(super) async fn listen(&mut self, _: &str, _: Exposure) -> Result<Listening, String> {
        Err(crate::link::NOT_BUILT.to_owned())
    }
}
