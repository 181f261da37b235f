//! `downbeat discover`: lists what answers on this network, and writes a fleet file to begin with.

mod draft;
mod networks;

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;

use downbeat_robot::driver::{ArtNetNode, SacnSource, hear_sacn, poll_art_net};
use downbeat_scripts::counted;
use downbeat_scripts::shown::shown;
use serde::Serialize;
use tokio::net::TcpStream;
use tokio::sync::Semaphore;
use urrcp::{InitializationBlock, Span};

use self::networks::Network;
use super::run::parse_span;
use super::{Exit, Format, console, fleet};
use crate::link::{Endpoint, LinkEncoding, Security};
use crate::show::table::Rows;

/// List robots, lights and other hardware that answer on this network.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The command asks every address of this machine's networks with at most 256 addresses, and this machine itself, for \
a robot on the port of --port; it polls Art-Net nodes; and it listens for sources that announce sACN universes, which they do every 10 s. \
It moves nothing and reserves nothing. Robots that require a key are listed without their description.

Examples:
  downbeat discover
  downbeat discover --interface eth0 --wait 3s --format json
  downbeat discover --host 10.1.0.7 --fleet fleet.yaml     also asks 10.1.0.7, and writes a fleet file"
)]
pub(super) struct DiscoverArgs {
    /// How long to wait for answers and announcements.
    #[arg(long, value_parser = wait, default_value = "11s", value_name = "TIME")]
    wait: Duration,
    /// The TCP port on which robots listen.
    #[arg(long, default_value_t = 7401, value_parser = clap::value_parser!(u16).range(1..), value_name = "PORT")]
    port: u16,
    /// Ask only on this interface, such as eth0. May be repeated.
    #[arg(long, value_name = "NAME")]
    interface: Vec<String>,
    /// Ask this host as well, such as one beyond a router. May be repeated.
    #[arg(long, value_name = "HOST")]
    host: Vec<String>,
    /// Write a fleet file to begin with, and the descriptions of its robots next to it. Existing files are not overwritten.
    #[arg(long, value_name = "FILE")]
    fleet: Option<PathBuf>,
}

fn wait(text: &str) -> Result<Duration, String> {
    let wait = parse_span(text)?.to_duration();
    let fits = wait >= Duration::from_millis(100) && wait <= Duration::from_secs(600);
    if fits { Ok(wait) } else { Err("expected a time from 100ms to 600s".to_owned()) }
}

/// Everything that answered.
#[derive(Debug, Default, Serialize)]
struct Found {
    robots: Vec<FoundRobot>,
    art_net: Vec<FoundLights>,
    sacn: Vec<FoundLights>,
    mavlink: Vec<FoundVehicle>,
    /// Kinds that could not be asked, each with the reason.
    not_asked: Vec<NotAsked>,
}

/// A program that listens on the port of robots.
#[derive(Debug, Serialize)]
struct FoundRobot {
    address: String,
    /// Its description. `None` if it does not describe itself without a key.
    block: Option<InitializationBlock>,
    /// Why there is no description.
    problem: Option<String>,
}

/// An Art-Net node or an sACN source.
#[derive(Debug, Serialize)]
struct FoundLights {
    address: IpAddr,
    name: String,
    universes: Vec<u16>,
}

/// A vehicle that sends heartbeats of MAVLink.
#[derive(Debug, Serialize)]
struct FoundVehicle {
    address: SocketAddr,
    system: u8,
    kind: String,
}

#[derive(Debug, Serialize)]
struct NotAsked {
    kind: &'static str,
    reason: String,
}

pub(super) fn discover(args: &DiscoverArgs, format: Format) -> Exit {
    if let Some(taken) = args.fleet.as_deref().filter(|path| path.symlink_metadata().is_ok()) {
        console::error(&format!(
            "`{}` already exists; choose another name for --fleet, and copy the robots that you need",
            taken.display()
        ));
        return Exit::Usage;
    }
    let networks = match networks::own() {
        Ok(networks) => networks,
        Err(error) => {
            console::error(&format!("cannot list the networks of this machine: {error}"));
            return Exit::Failed;
        }
    };
    let networks = match chosen(&args.interface, networks) {
        Ok(networks) => networks,
        Err(reason) => {
            console::error(&reason);
            return Exit::Usage;
        }
    };
    let mut found = Found::default();
    super::with_runtime(async {
        found = listen(args, &networks).await;
        Exit::Done
    });
    match format {
        Format::Json => console::print_json(&found),
        Format::Text => print(args, &networks, &found),
    }
    match args.fleet.as_deref().map(|path| draft::write(path, &found)) {
        Some(Err(reason)) => {
            console::error(&reason);
            Exit::Usage
        }
        Some(Ok(files)) => {
            let files: Vec<_> = files.iter().map(|file| file.display().to_string()).collect();
            console::note(&format!("wrote {}", files.join(", ")));
            Exit::Done
        }
        None => Exit::Done,
    }
}

/// Returns the networks of the named interfaces, or all networks if none is named.
fn chosen(interfaces: &[String], networks: Vec<Network>) -> Result<Vec<Network>, String> {
    let has = |name: &String| networks.iter().any(|network| network.interface == *name);
    if let Some(unknown) = interfaces.iter().find(|name| !has(name)) {
        let known: Vec<_> = networks.iter().map(|network| format!("`{}`", network.interface)).collect();
        return Err(format!(
            "no interface `{}` with an IPv4 address is up; expected one of {}",
            shown(unknown),
            known.join(", ")
        ));
    }
    let is_chosen = |network: &Network| interfaces.is_empty() || interfaces.contains(&network.interface);
    Ok(networks.into_iter().filter(is_chosen).collect())
}

/// Asks and listens on all networks at the same time.
async fn listen(args: &DiscoverArgs, networks: &[Network]) -> Found {
    let wait = args.wait;
    let broadcasts: Vec<Ipv4Addr> = networks.iter().map(|network| network.broadcast).collect();
    let own: Vec<Ipv4Addr> = networks.iter().map(|network| network.own).collect();
    let art_net = tokio::task::spawn_blocking(move || poll_art_net(&broadcasts, wait));
    let sacn = tokio::task::spawn_blocking(move || hear_sacn(&own, wait));
    let vehicles = tokio::task::spawn_blocking(move || vehicles(wait));
    let robots = robots(args, networks).await;
    let mut found = Found { robots, ..Found::default() };
    let lights =
        |node: ArtNetNode| FoundLights { address: node.from, name: node.name, universes: node.universes };
    match joined(art_net.await) {
        Ok(nodes) => found.art_net = nodes.into_iter().map(lights).collect(),
        Err(reason) => found.not_asked.push(NotAsked { kind: "Art-Net", reason }),
    }
    let source = |source: SacnSource| FoundLights {
        address: source.from,
        name: source.name,
        universes: source.universes,
    };
    match joined(sacn.await) {
        Ok(sources) => found.sacn = sources.into_iter().map(source).collect(),
        Err(reason) => found.not_asked.push(NotAsked { kind: "sACN", reason }),
    }
    match vehicles.await.map_err(|error| error.to_string()).flatten() {
        Ok(vehicles) => found.mavlink = vehicles,
        Err(reason) => found.not_asked.push(NotAsked { kind: "MAVLink", reason }),
    }
    found
}

#[cfg(feature = "mavlink")]
fn vehicles(wait: Duration) -> Result<Vec<FoundVehicle>, String> {
    use downbeat_robot::driver::{HeardVehicle, hear_mavlink};
    let vehicle =
        |heard: HeardVehicle| FoundVehicle { address: heard.from, system: heard.system, kind: heard.kind };
    let heard = hear_mavlink(wait).map_err(|error| error.to_string())?;
    Ok(heard.into_iter().map(vehicle).collect())
}

#[cfg(not(feature = "mavlink"))]
fn vehicles(_: Duration) -> Result<Vec<FoundVehicle>, String> {
    Err("this build lacks the feature `mavlink`".to_owned())
}

fn joined<T>(ended: Result<std::io::Result<T>, tokio::task::JoinError>) -> Result<T, String> {
    ended.map_err(|error| error.to_string())?.map_err(|error| error.to_string())
}

/// Number of addresses to which connections are opened at the same time.
const AT_ONCE: usize = 128;
/// Time for a connection to an address of the own network.
const CONNECT_MAX: Duration = Duration::from_millis(1_000);

/// Asks all addresses for robots.
async fn robots(args: &DiscoverArgs, networks: &[Network]) -> Vec<FoundRobot> {
    let mut hosts: Vec<String> = vec![Ipv4Addr::LOCALHOST.to_string()];
    hosts.extend(networks.iter().flat_map(Network::others).map(|ip| ip.to_string()));
    hosts.extend(args.host.iter().filter(|host| !hosts.contains(host)).cloned().collect::<Vec<_>>());
    let room = std::sync::Arc::new(Semaphore::new(AT_ONCE));
    let ask = |host: String| {
        let (room, port, wait) = (std::sync::Arc::clone(&room), args.port, args.wait);
        tokio::spawn(async move {
            let _place = room.acquire_owned().await;
            robot_at(host, port, wait).await
        })
    };
    let asked: Vec<_> = hosts.into_iter().map(ask).collect();
    let mut found = Vec::new();
    for task in asked {
        found.extend(task.await.ok().flatten());
    }
    found
}

/// Returns the robot at an address. `None` if nothing listens there.
async fn robot_at(host: String, port: u16, wait: Duration) -> Option<FoundRobot> {
    let connected =
        tokio::time::timeout(CONNECT_MAX.min(wait), TcpStream::connect((host.as_str(), port))).await;
    let connection = connected.ok()?.ok()?;
    // A connection to oneself has the same port at both ends.
    if connection.local_addr().ok() == connection.peer_addr().ok() {
        return None;
    }
    let place = match host.parse::<IpAddr>() {
        Ok(ip) => SocketAddr::new(ip, port).to_string(),
        Err(_) => format!("{host}:{port}"),
    };
    drop(connection);
    let endpoint = Endpoint::Tcp { host, port, encoding: LinkEncoding::default(), security: Security::Plain };
    let patience = Span::from_millis_f64(wait.as_secs_f64() * 1_000.0);
    let told = fleet::description(endpoint, patience).await;
    let address = format!("tcp://{place}");
    Some(match told {
        Ok(block) => FoundRobot { address, block: Some(block), problem: None },
        Err(problem) => FoundRobot { address, block: None, problem: Some(problem) },
    })
}

fn print(args: &DiscoverArgs, networks: &[Network], found: &Found) {
    let mut table = Rows::new(&["kind", "address", "name", "details"], 3);
    for FoundRobot { address, block, problem } in &found.robots {
        let (name, details) = match block {
            Some(block) => (shown(block.id.as_str()).to_string(), counted(block.devices.len(), "device")),
            None => {
                let problem = problem.as_deref().unwrap_or_default();
                ("-".to_owned(), format!("no description without a key: {}", shown(problem)))
            }
        };
        table.add(["robot".to_owned(), address.clone(), name, details]);
    }
    let lights = [("Art-Net node", &found.art_net), ("sACN source", &found.sacn)];
    for (kind, lights) in lights {
        for FoundLights { address, name, universes } in lights {
            let universes: Vec<_> = universes.iter().map(ToString::to_string).collect();
            let details = match universes.as_slice() {
                [] => "no universes".to_owned(),
                [one] => format!("universe {one}"),
                all => format!("universes {}", all.join(", ")),
            };
            table.add([kind.to_owned(), address.to_string(), shown(name).to_string(), details]);
        }
    }
    for FoundVehicle { address, system, kind } in &found.mavlink {
        table.add([
            "MAVLink vehicle".to_owned(),
            address.to_string(),
            format!("system {system}"),
            kind.clone(),
        ]);
    }
    if table.is_empty() {
        console::note("nothing answered");
    } else {
        console::print(&table.text(console::columns()));
    }
    for NotAsked { kind, reason } in &found.not_asked {
        console::note(&format!("{kind} was not asked: {reason}"));
    }
    for network in
        networks.iter().filter(|network| network.others().next().is_none() && !network.own.is_loopback())
    {
        console::note(&format!(
            "the network {network} is too large to ask each address for robots; name some with --host"
        ));
    }
    console::note(&format!(
        "waited {} s on {}; robots were asked on port {}",
        args.wait.as_secs_f64(),
        networks.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "),
        args.port
    ));
}
