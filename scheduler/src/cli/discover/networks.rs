//! The networks of this machine.

use std::fmt;
use std::io;
use std::net::Ipv4Addr;

use nix::ifaddrs::getifaddrs;
use nix::net::if_::InterfaceFlags;
use nix::sys::socket::SockaddrStorage;

/// Largest number of addresses of a network of which each is asked.
const ADDRESSES_MAX: u32 = 256;

/// An IPv4 network to which this machine is connected.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Network {
    /// The name of the interface, such as `eth0`.
    pub(super) interface: String,
    /// The address of this machine.
    pub(super) own: Ipv4Addr,
    mask: Ipv4Addr,
    /// The address of all machines of the network.
    pub(super) broadcast: Ipv4Addr,
}

/// Returns the networks of all interfaces that are up, and that of the loopback.
///
/// # Errors
/// Fails if the system does not list its interfaces.
pub(super) fn own() -> io::Result<Vec<Network>> {
    let ip =
        |address: Option<SockaddrStorage>| address?.as_sockaddr_in().map(nix::sys::socket::SockaddrIn::ip);
    let mut networks = Vec::new();
    for interface in getifaddrs()? {
        let (Some(own), Some(mask)) = (ip(interface.address), ip(interface.netmask)) else { continue };
        let broadcast = own | !mask;
        let network = Network { interface: interface.interface_name, own, mask, broadcast };
        if interface.flags.contains(InterfaceFlags::IFF_UP) && !networks.contains(&network) {
            networks.push(network);
        }
    }
    Ok(networks)
}

impl Network {
    /// Returns the addresses of the other machines. Empty for the loopback and for networks of more than [`ADDRESSES_MAX`] addresses.
    pub(super) fn others(&self) -> impl Iterator<Item = Ipv4Addr> + use<> {
        let (own, first, last) = (self.own, self.own & self.mask, self.broadcast);
        let count = u32::from(last) - u32::from(first);
        let is_asked = count < ADDRESSES_MAX && !own.is_loopback();
        let all = u32::from(first)..=u32::from(last);
        let ends = count > 1;
        all.filter(move |_| is_asked)
            .map(Ipv4Addr::from)
            .filter(move |ip| *ip != own && !(ends && (*ip == first || *ip == last)))
    }
}

impl fmt::Display for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({}/{})", self.interface, self.own & self.mask, u32::from(self.mask).count_ones())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn network(own: [u8; 4], bits: u32) -> Network {
        let (own, mask) = (Ipv4Addr::from(own), Ipv4Addr::from(u32::MAX << (32 - bits)));
        Network { interface: "eth0".to_owned(), own, mask, broadcast: own | !mask }
    }

    #[test]
    fn each_other_machine_of_a_small_network_is_asked() {
        let hall = network([10, 0, 0, 7], 24);
        let others: Vec<_> = hall.others().collect();
        assert_eq!(
            (others.len(), others[0], others[252]),
            (253, [10, 0, 0, 1].into(), [10, 0, 0, 254].into())
        );
        assert!(!others.contains(&hall.own));
        assert_eq!(hall.to_string(), "eth0 (10.0.0.0/24)");
        assert_eq!(hall.broadcast, Ipv4Addr::new(10, 0, 0, 255));
        let pair = network([10, 0, 0, 6], 31);
        assert_eq!(pair.others().collect::<Vec<_>>(), [Ipv4Addr::new(10, 0, 0, 7)]);
        assert_eq!(network([10, 0, 0, 7], 23).others().count(), 0);
        assert_eq!(network([127, 0, 0, 1], 8).others().count(), 0);
    }

    #[test]
    fn loopback_is_a_network_of_this_machine() {
        assert!(own().unwrap().iter().any(|network| network.own.is_loopback()));
    }
}
