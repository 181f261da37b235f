//! Who is at the other end of a link.

use std::fmt;
use std::net::{IpAddr, SocketAddr};

use urrcp::Label;

use crate::role::Proof;

/// Who is at the other end of a link, as far as this is known: from where it connects, and under which name if it has proven one.
///
/// A session belongs to the name of the peer that claims it: another name, or none, with the same session is another session.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Peer {
    address: Option<SocketAddr>,
    proof: Option<Proof>,
}

impl Peer {
    /// A part of this process. It is trusted: no quota or budget holds for it.
    #[must_use]
    pub const fn in_process() -> Self {
        Self { address: None, proof: None }
    }

    /// A stranger that connects from there.
    #[must_use]
    pub const fn at(address: SocketAddr) -> Self {
        Self { address: Some(address), proof: None }
    }

    /// The same peer, which has proven who it is, for example by a certificate.
    #[must_use]
    pub fn with_proof(mut self, proof: Proof) -> Self {
        self.proof = Some(proof);
        self
    }

    /// From where it connects; `None` for a part of this process.
    #[must_use]
    pub const fn address(&self) -> Option<SocketAddr> {
        self.address
    }

    /// The name that it has proven.
    #[must_use]
    pub fn name(&self) -> Option<&Label> {
        self.proof.as_ref().map(|proof| &proof.name)
    }

    /// What it has proven.
    #[must_use]
    pub const fn proof(&self) -> Option<&Proof> {
        self.proof.as_ref()
    }

    /// Whether it is a part of this process.
    #[must_use]
    pub const fn is_in_process(&self) -> bool {
        self.address.is_none()
    }

    /// What quotas are counted by: the host that it connects from. `None` where one address stands for many peers: within this
    /// process, and on the loopback interface.
    #[must_use]
    pub fn quota_key(&self) -> Option<IpAddr> {
        self.address.map(|address| address.ip().to_canonical()).filter(|ip| !ip.is_loopback())
    }
}

impl fmt::Display for Peer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.name(), self.address) {
            (Some(name), Some(address)) => write!(f, "`{name}` at {address}"),
            (Some(name), None) => write!(f, "`{name}` in this process"),
            (None, Some(address)) => write!(f, "{address}"),
            (None, None) => f.write_str("this process"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::role::Roles;

    #[test]
    fn quotas_are_counted_by_host_and_not_on_the_loopback_interface() {
        let key = |address: &str| Peer::at(address.parse().unwrap()).quota_key().map(|ip| ip.to_string());
        assert_eq!(key("192.0.2.7:1000").as_deref(), Some("192.0.2.7"));
        assert_eq!(key("[::ffff:192.0.2.7]:1001").as_deref(), Some("192.0.2.7"));
        assert_eq!(key("127.0.0.1:1000"), None);
        assert_eq!(key("[::1]:1000"), None);
        assert_eq!(Peer::in_process().quota_key(), None);
    }

    #[test]
    fn a_log_names_a_peer_by_its_proven_name_and_address() {
        let peer = Peer::at("192.0.2.7:1000".parse().unwrap());
        assert_eq!(peer.to_string(), "192.0.2.7:1000");
        assert_eq!(
            peer.with_proof(Proof { name: Label::new("desk").unwrap(), roles: Roles::default() }).to_string(),
            "`desk` at 192.0.2.7:1000"
        );
    }
}
