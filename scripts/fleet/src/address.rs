//! Addresses of robots, as written in the fleet file and on the command line.

mod driven;
mod middleware;

use std::fmt;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};
use std::str::FromStr;

pub use driven::{DEFAULT_PRIORITY, DmxAddress, DmxProtocol, OscAddress};
pub use middleware::{MavlinkAddress, VehicleEnd};
use urrcp::RobotId;

/// The address of a robot.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// `sim`: the robot is simulated in the same process.
    Simulated,
    /// `tls://host:port`, `hmac://host:port`, or `tcp://host:port` without protection.
    Tcp {
        /// Host name or IP address of the robot.
        host: String,
        /// TCP port of the robot.
        port: u16,
        /// The protection of the connection.
        protection: Protection,
    },
    /// `thrift://host:port` or `thrift://host:port?id=NAME`: a robot that speaks the early protocol, based on Thrift. This process drives it.
    Thrift {
        /// Host name or IP address of the robot.
        host: String,
        /// TCP port of the robot.
        port: u16,
        /// The id that the hardware reports. `None` if it is the robot's own.
        id: Option<RobotId>,
    },
    /// `zenoh:KEY`: a robot at a key of a Zenoh network.
    Zenoh {
        /// The Zenoh key of the robot, without wildcards.
        key: String,
    },
    /// `sacn:...` or `artnet:...`: a DMX fixture. This process drives it.
    Dmx(DmxAddress),
    /// `osc:...`: a receiver of Open Sound Control. This process drives it.
    Osc(OscAddress),
    /// `mavlink:...`: a vehicle that speaks MAVLink. This process drives it.
    Mavlink(MavlinkAddress),
    /// `program:COMMAND`: a robot that this process drives through a separate program.
    Program {
        /// The command line of the program, for a shell.
        command: String,
    },
}

/// The protection of a connection, which prevents others from sending commands to the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Protection {
    /// `tcp`: no protection.
    Open,
    /// `tls`: both sides authenticate, and nobody else can read the messages.
    Tls,
    /// `hmac`: both sides authenticate, and nobody can alter or replay messages; but others can read them.
    Hmac,
}

impl Protection {
    /// Returns the URL scheme of addresses with this protection.
    #[must_use]
    pub const fn scheme(self) -> &'static str {
        match self {
            Self::Open => "tcp",
            Self::Tls => "tls",
            Self::Hmac => "hmac",
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Simulated => f.write_str("sim"),
            Self::Tcp { host, port, protection } => write!(f, "{}://{host}:{port}", protection.scheme()),
            Self::Thrift { host, port, id: None } => write!(f, "thrift://{host}:{port}"),
            Self::Thrift { host, port, id: Some(id) } => write!(f, "thrift://{host}:{port}?id={id}"),
            Self::Zenoh { key } => write!(f, "zenoh:{key}"),
            Self::Dmx(address) => address.fmt(f),
            Self::Osc(address) => address.fmt(f),
            Self::Mavlink(address) => address.fmt(f),
            Self::Program { command } => write!(f, "program:{command}"),
        }
    }
}

/// The place in the network at which a robot is reached, in canonical form: a host and port, or a Zenoh key. Two addresses with equal
/// places lead to the same robot.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Reached {
    host: ReachedHost,
    port: u16,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum ReachedHost {
    Ip(IpAddr),
    /// A host name in lower case, without the final dot. Only DNS can resolve it.
    Name(String),
    /// A key of a Zenoh network, or the address of a fixture: neither has a port.
    Key(String),
}

impl Address {
    /// Returns the places in the network to which the address leads, as far as they are known without DNS. Empty if the robot has no
    /// place in the network.
    pub fn places(&self) -> Vec<Reached> {
        match self {
            Self::Tcp { host, port, .. } | Self::Thrift { host, port, .. } => {
                hosts(host).into_iter().map(|host| Reached { host, port: *port }).collect()
            }
            Self::Zenoh { key } => vec![Reached { host: ReachedHost::Key(key.clone()), port: 0 }],
            Self::Dmx(address) => {
                let fixture = DmxAddress { priority: None, blackout: false, ..address.clone() };
                vec![Reached { host: ReachedHost::Key(fixture.to_string()), port: 0 }]
            }
            Self::Osc(address) => vec![Reached { host: ReachedHost::Key(address.to_string()), port: 0 }],
            // Two processes cannot listen at the same port.
            Self::Mavlink(MavlinkAddress { host, port, .. }) => {
                vec![Reached { host: ReachedHost::Key(format!("mavlink:{host}")), port: *port }]
            }
            Self::Simulated | Self::Program { .. } => Vec::new(),
        }
    }
}

impl Address {
    /// Whether the robot is a separate process that a scheduler connects to.
    #[must_use]
    pub const fn is_served(&self) -> bool {
        matches!(self, Self::Tcp { .. } | Self::Zenoh { .. })
    }

    /// Whether this process drives the hardware at the address by itself, without another program.
    #[must_use]
    pub const fn is_driven(&self) -> bool {
        matches!(self, Self::Thrift { .. } | Self::Dmx(_) | Self::Osc(_) | Self::Mavlink(_))
    }

    /// Whether commands to the robot cross a network where others can send commands as well: plain TCP to a different machine.
    #[must_use]
    pub fn is_open(&self) -> bool {
        matches!(self, Self::Tcp { protection: Protection::Open, .. }) && self.is_beyond()
    }

    /// Whether the address leads, or may lead, to another machine.
    fn is_beyond(&self) -> bool {
        let is_here = |place: &ReachedHost| matches!(place, ReachedHost::Ip(ip) if ip.is_loopback());
        match self {
            Self::Tcp { host, .. } => !hosts(host).iter().all(is_here),
            _ => false,
        }
    }
}

/// Returns the canonical hosts for a host name or IP address. `localhost` means this machine, over both IPv4 and IPv6. The unspecified
/// address (`0.0.0.0` or `::`) also means this machine, because clients that connect to it reach their own machine.
fn hosts(host: &str) -> Vec<ReachedHost> {
    let ip = host.parse::<IpAddr>().map(|ip| match ip.to_canonical() {
        IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
        ip => ip,
    });
    let name = host.strip_suffix('.').unwrap_or(host).to_ascii_lowercase();
    match ip {
        Ok(ip) => vec![ReachedHost::Ip(ip)],
        Err(_) if name == "localhost" => {
            [Ipv4Addr::LOCALHOST.into(), Ipv6Addr::LOCALHOST.into()].map(ReachedHost::Ip).to_vec()
        }
        Err(_) => vec![ReachedHost::Name(name)],
    }
}

/// Whether a text is a Zenoh key expression without wildcards.
fn is_key(text: &str) -> bool {
    let is_chunk = |chunk: &str| {
        !chunk.is_empty() && !chunk.contains(['*', '$', '?', '#']) && !chunk.contains(char::is_whitespace)
    };
    text.split('/').all(is_chunk)
}

/// The error for a text that is not an address.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InvalidAddress;

/// The accepted forms of addresses, for messages to the user.
pub const ADDRESS: &str = "`sim`, tls://host:port, hmac://host:port, tcp://host:port, zenoh:KEY, sacn:UNIVERSE/CHANNEL, artnet:UNIVERSE/CHANNEL@host, osc:host:port/path, mavlink:udp:host:port, thrift://host:port or program:COMMAND";

impl fmt::Display for InvalidAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "expected {ADDRESS}")
    }
}

impl std::error::Error for InvalidAddress {}

/// Describes the fault of a text that is not an address, with a hint that shows the correct form.
#[must_use]
pub fn address_fault(text: &str) -> (&'static str, Option<String>) {
    if text.starts_with("zenoh:") {
        let hint = "a key consists of words separated by slashes, without wildcards or spaces, as in `zenoh:hall-2/arm-1`";
        return ("has no valid key", Some(hint.to_owned()));
    }
    if let Some((what, hint)) = driven::fault(text).or_else(|| middleware::fault(text)) {
        return (what, Some(hint));
    }
    let (scheme, rest) = match text.split_once("://") {
        Some((scheme, rest)) => (Some(scheme), rest),
        None => (None, text),
    };
    if scheme == Some("thrift") && rest.ends_with("?id=") {
        return (
            "has no id after `?id=`",
            Some("write the id that the hardware reports, as in `?id=tank`".to_owned()),
        );
    }
    let place = rest.trim_end_matches('/');
    let port = place.rsplit_once(':').map(|(_, port)| port);
    let has_port = port.is_some_and(|port| port.parse::<u16>().is_ok_and(|port| port > 0));
    let known = scheme.filter(|scheme| ["tcp", "tls", "hmac", "thrift"].contains(scheme));
    match (known, port) {
        (Some(_), Some(port)) if !has_port && port.bytes().all(|byte| byte.is_ascii_digit()) => {
            ("has no valid port", Some("a port is a number from 1 to 65535".to_owned()))
        }
        (Some(scheme), _) if !has_port => {
            let host = place.split(':').next().unwrap_or_default();
            let hint = format!("add the port on which the robot listens, as in `{scheme}://{host}:7401`");
            ("has no port", Some(hint))
        }
        (None, _) if has_port => {
            let tls = format!("tls://{place}");
            let here = tls.parse().is_ok_and(|address: Address| !address.is_beyond());
            let write = if here { format!("write `tcp://{place}`") } else { format!("write `{tls}`") };
            ("does not begin with `tls://` or `tcp://`", Some(write))
        }
        _ => {
            let simulated =
                ["simulated", "simulation", "simulator", "virtual", "sim:", "sim://"].contains(&text);
            let hint = match text.parse::<IpAddr>() {
                _ if simulated => Some("write `sim`".to_owned()),
                Ok(IpAddr::V4(ip)) => Some(format!("add the protocol and the port, as in `tls://{ip}:7401`")),
                _ => None,
            };
            ("is not an address", hint.or_else(|| of_another_bus(text)))
        }
    }
}

impl FromStr for Address {
    type Err = InvalidAddress;

    /// Parses an address as written in the fleet file.
    fn from_str(text: &str) -> Result<Self, InvalidAddress> {
        Self::parse(text).ok_or(InvalidAddress)
    }
}

impl Address {
    fn parse(text: &str) -> Option<Self> {
        if text == "sim" {
            return Some(Self::Simulated);
        }
        let (scheme, rest) = text.split_once(':')?;
        if scheme == "program" {
            let command = rest.trim().to_owned();
            return (!command.is_empty()).then_some(Self::Program { command });
        }
        match scheme {
            "zenoh" => return is_key(rest).then(|| Self::Zenoh { key: rest.to_owned() }),
            "sacn" => return DmxAddress::parse(DmxProtocol::Sacn, rest).map(Self::Dmx),
            "artnet" => return DmxAddress::parse(DmxProtocol::ArtNet, rest).map(Self::Dmx),
            "osc" => return OscAddress::parse(rest).map(Self::Osc),
            "mavlink" => return MavlinkAddress::parse(rest).map(Self::Mavlink),
            _ => {}
        }
        let (rest, id) = match rest.split_once("?id=").filter(|_| scheme == "thrift") {
            Some((rest, id)) => (rest, Some(RobotId::new(id).ok()?)),
            None => (rest, None),
        };
        let (host, port) = rest.strip_prefix("//")?.rsplit_once(':')?;
        let port = port.parse::<u16>().ok().filter(|port| *port > 0)?;
        let host = host.trim_start_matches('[').trim_end_matches(']').to_owned();
        match scheme {
            _ if host.is_empty() => None,
            "tcp" => Some(Self::Tcp { host, port, protection: Protection::Open }),
            "tls" => Some(Self::Tcp { host, port, protection: Protection::Tls }),
            "hmac" => Some(Self::Tcp { host, port, protection: Protection::Hmac }),
            "thrift" => Some(Self::Thrift { host, port, id }),
            _ => None,
        }
    }
}

/// Returns a hint if a text is a serial port or an address of another bus or middleware, such as CAN or ROS.
fn of_another_bus(text: &str) -> Option<String> {
    let is_serial = text.starts_with("/dev/")
        || text.strip_prefix("COM").is_some_and(|number| number.parse::<u8>().is_ok());
    let is_other = ["ros", "ros2", "can", "serial", "usb", "mqtt"]
        .iter()
        .any(|scheme| text.strip_prefix(scheme).is_some_and(|rest| rest.starts_with(':')));
    (is_serial || is_other)
        .then(|| "this kind of connection requires a driver: `downbeat drivers` lists the existing ones, `program:COMMAND` runs your own".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_robots_with_one_hardware_id_are_two_places() {
        let [first, second] = ["thrift://a:9090?id=tank", "thrift://b:9090?id=tank"].map(|text| {
            let address: Address = text.parse().unwrap();
            assert_eq!(address.to_string(), text);
            address
        });
        assert!(matches!(&first, Address::Thrift { id: Some(id), .. } if id.as_str() == "tank"));
        assert_ne!(first.places(), second.places());
        assert_eq!(first.places(), "thrift://a:9090".parse::<Address>().unwrap().places());
        assert!(
            "thrift://a:9090?id=".parse::<Address>().is_err()
                && "tcp://a:9090?id=b".parse::<Address>().is_err()
        );
    }

    #[test]
    fn zenoh_key_is_an_address_of_one_place() {
        let address: Address = "zenoh:hall-2/arm-1".parse().unwrap();
        assert_eq!(address, Address::Zenoh { key: "hall-2/arm-1".to_owned() });
        assert_eq!(address.to_string(), "zenoh:hall-2/arm-1");
        assert_eq!(address.places(), "zenoh:hall-2/arm-1".parse::<Address>().unwrap().places());
        assert_ne!(address.places(), "zenoh:hall-2/arm-2".parse::<Address>().unwrap().places());
        assert!(address.is_served() && !address.is_open());
        for wrong in
            ["zenoh:", "zenoh:/a", "zenoh:a/", "zenoh:a//b", "zenoh:a/*", "zenoh:a b", "zenoh://a", "zenoh"]
        {
            assert_eq!(wrong.parse::<Address>(), Err(InvalidAddress), "{wrong}");
        }
        assert_eq!(address_fault("zenoh:a/**").0, "has no valid key");
    }
}
