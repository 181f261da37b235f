//! The peer at the other end of a link.

use std::fmt;
use std::net::SocketAddr;
#[cfg(feature = "host")]
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};
use std::sync::Arc;

use urrcp::Label;

use urrcp::Proof;

/// The peer at the other end of a link: its origin, as far as it is known, and its name if it has proven one.
///
/// A session belongs to the name of the peer that claims it. If a peer with another name, or without a name, uses the same session id,
/// that is a different session.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Peer {
    origin: Origin,
    proof: Option<Proof>,
}

/// Where a peer connects from.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
enum Origin {
    #[default]
    InProcess,
    Address(SocketAddr),
    /// The peer comes through a network that hides addresses. Contains the name that the network gives the peer.
    Network(Arc<str>),
}

impl Peer {
    /// Returns a peer that is a part of this process. It is trusted: no quota and no budget applies to it.
    #[must_use]
    pub const fn in_process() -> Self {
        Self { origin: Origin::InProcess, proof: None }
    }

    /// Returns an unproven peer that connects from this address.
    #[must_use]
    pub const fn at(address: SocketAddr) -> Self {
        Self { origin: Origin::Address(address), proof: None }
    }

    /// Returns an unproven peer that connects through a network. The network gives the peer this name, but hides its address.
    #[must_use]
    pub fn through(network: &str) -> Self {
        Self { origin: Origin::Network(network.into()), proof: None }
    }

    /// Returns the peer with a proven identity, for example from a certificate.
    #[must_use]
    pub fn with_proof(mut self, proof: Proof) -> Self {
        self.proof = Some(proof);
        self
    }

    /// Returns the peer's address. `None` if the peer is a part of this process, or if a network hides the address.
    #[must_use]
    pub const fn address(&self) -> Option<SocketAddr> {
        match self.origin {
            Origin::Address(address) => Some(address),
            Origin::InProcess | Origin::Network(_) => None,
        }
    }

    /// Returns the peer's name, if it has proven one.
    #[must_use]
    pub fn name(&self) -> Option<&Label> {
        self.proof.as_ref().map(|proof| &proof.name)
    }

    /// Returns the peer's proven identity, if it has proven one.
    #[must_use]
    pub const fn proof(&self) -> Option<&Proof> {
        self.proof.as_ref()
    }

    /// Returns where the peer connects from: an address and a port, or the name that a network gives the peer.
    #[cfg(feature = "host")]
    pub(crate) fn origin(&self) -> String {
        Self { proof: None, ..self.clone() }.to_string()
    }

    /// Whether the peer is a part of this process.
    #[must_use]
    pub const fn is_in_process(&self) -> bool {
        matches!(self.origin, Origin::InProcess)
    }

    /// Returns the network and the host that share their quotas with the peer. `None` if the address is unknown or may represent many
    /// peers: within this process, on the loopback interface, and through networks that hide addresses.
    #[cfg(feature = "host")]
    pub(crate) fn prefixes(&self) -> Option<[Prefix; 2]> {
        let ip = self.address()?.ip().to_canonical();
        let [network, host] = if ip.is_ipv4() { [24, 32] } else { [48, 64] };
        (!ip.is_loopback()).then(|| [Prefix::of(ip, network), Prefix::of(ip, host)])
    }
}

/// A range of IP addresses: those whose first bits are equal.
#[cfg(feature = "host")]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Prefix {
    /// The first address of the range.
    ip: IpAddr,
    bits: u32,
}

#[cfg(feature = "host")]
impl Prefix {
    fn of(ip: IpAddr, bits: u32) -> Self {
        let ip = match ip {
            IpAddr::V4(ip) => {
                let mask = u32::MAX.checked_shl(u32::BITS - bits).unwrap_or(0);
                IpAddr::V4(Ipv4Addr::from_bits(ip.to_bits() & mask))
            }
            IpAddr::V6(ip) => {
                let mask = u128::MAX.checked_shl(u128::BITS - bits).unwrap_or(0);
                IpAddr::V6(Ipv6Addr::from_bits(ip.to_bits() & mask))
            }
        };
        Self { ip, bits }
    }
}

#[cfg(feature = "host")]
impl fmt::Display for Prefix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.ip, self.bits)
    }
}

impl fmt::Display for Peer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.name(), &self.origin) {
            (Some(name), Origin::Address(address)) => write!(f, "`{name}` at {address}"),
            (Some(name), Origin::InProcess) => write!(f, "`{name}` in this process"),
            (Some(name), Origin::Network(place)) => write!(f, "`{name}` at {place}"),
            (None, Origin::Address(address)) => write!(f, "{address}"),
            (None, Origin::InProcess) => f.write_str("this process"),
            (None, Origin::Network(place)) => f.write_str(place),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use urrcp::Roles;

    #[cfg(feature = "host")]
    #[test]
    fn quotas_apply_per_network_and_host_except_on_loopback() {
        let of = |address: &str| {
            Peer::at(address.parse().unwrap()).prefixes().map(|both| both.map(|prefix| prefix.to_string()))
        };
        let both = |network: &str, host: &str| Some([network.to_owned(), host.to_owned()]);
        assert_eq!(of("192.0.2.7:1000"), both("192.0.2.0/24", "192.0.2.7/32"));
        assert_eq!(of("[::ffff:192.0.2.7]:1001"), both("192.0.2.0/24", "192.0.2.7/32"));
        assert_eq!(of("[2001:db8:1:2:3::4]:1000"), both("2001:db8:1::/48", "2001:db8:1:2::/64"));
        assert_eq!(of("127.0.0.1:1000"), None);
        assert_eq!(of("[::1]:1000"), None);
        assert_eq!(Peer::in_process().prefixes(), None);
    }

    #[test]
    fn peer_with_hidden_address_is_not_taken_as_in_process() {
        let hidden = Peer::through("zenoh:a1.7");
        assert_eq!(hidden.address(), None);
        #[cfg(feature = "host")]
        assert_eq!(hidden.prefixes(), None);
        assert!(!hidden.is_in_process() && Peer::in_process().is_in_process());
        assert_eq!(hidden.to_string(), "zenoh:a1.7");
    }

    #[test]
    fn log_names_a_peer_by_its_proven_name_and_address() {
        let peer = Peer::at("192.0.2.7:1000".parse().unwrap());
        assert_eq!(peer.to_string(), "192.0.2.7:1000");
        assert_eq!(
            peer.with_proof(Proof {
                name: Label::new("desk").unwrap(),
                roles: Roles::default(),
                serial: None
            })
            .to_string(),
            "`desk` at 192.0.2.7:1000"
        );
    }
}
