//! The packets of sACN and Art-Net, and the sockets that send them.

use std::borrow::Cow;
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket};

use artnet_protocol::{ArtCommand, Output, PortAddress};
use sacn::packet::{
    AcnRootLayerProtocol, DataPacketDmpLayer, DataPacketFramingLayer, E131RootLayer, E131RootLayerData,
    UniverseDiscoveryPacketFramingLayer, UniverseDiscoveryPacketUniverseDiscoveryLayer,
};
use uuid::Uuid;

use super::DmxAddress;

/// A protocol that carries DMX512 over IP.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Protocol {
    /// ANSI E1.31, streaming ACN.
    Sacn,
    /// Art-Net 4.
    ArtNet,
}

impl Protocol {
    const fn port(self) -> u16 {
        match self {
            Self::Sacn => 5568,
            Self::ArtNet => 6454,
        }
    }

    /// Minimum and maximum number of a universe.
    #[must_use]
    pub const fn universes(self) -> (u16, u16) {
        match self {
            Self::Sacn => (1, 63_999),
            Self::ArtNet => (0, 32_767),
        }
    }
}

/// Name of the source in lists of lighting consoles.
const SOURCE: &str = "Downbeat";
/// The universe to which sources send the lists of their universes.
const DISCOVERY_UNIVERSE: u16 = 64_214;

/// Sends the frames of one universe.
#[derive(Debug)]
pub(super) struct Transport {
    protocol: Protocol,
    universe: u16,
    priority: u8,
    to: SocketAddr,
    /// Where lists of universes are sent: to the receiver, or to everyone.
    discovery: SocketAddr,
    socket: UdpSocket,
    /// Identifies the source: its universe and its process.
    source: Uuid,
    sequence: u8,
}

/// Returns where the frames of an address are sent.
pub(super) fn destination(address: &DmxAddress) -> io::Result<SocketAddr> {
    let port = address.protocol.port();
    match &address.host {
        None => Ok((multicast(address.universe), port).into()),
        Some(host) => {
            let mut found = (host.as_str(), port).to_socket_addrs()?;
            found
                .next()
                .ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, "no address is known for this name"))
        }
    }
}

/// Returns the multicast address of an sACN universe (ANSI E1.31, 9.3.1).
fn multicast(universe: u16) -> IpAddr {
    let [high, low] = universe.to_be_bytes();
    Ipv4Addr::new(239, 255, high, low).into()
}

const fn is_broadcast(to: SocketAddr) -> bool {
    matches!(to.ip(), IpAddr::V4(ip) if ip.is_broadcast() || ip.octets()[3] == u8::MAX)
}

impl Transport {
    pub(super) fn open(address: &DmxAddress, to: SocketAddr) -> io::Result<Self> {
        let any: IpAddr =
            if to.is_ipv4() { Ipv4Addr::UNSPECIFIED.into() } else { Ipv6Addr::UNSPECIFIED.into() };
        let socket = UdpSocket::bind((any, 0))?;
        socket.set_broadcast(true)?;
        socket.set_nonblocking(true)?;
        // The system of a receiver without a program that takes frames then reports that.
        if address.host.is_some() && !is_broadcast(to) {
            socket.connect(to)?;
        }
        let discovery = match address.host {
            None => (multicast(DISCOVERY_UNIVERSE), to.port()).into(),
            Some(_) => to,
        };
        let DmxAddress { protocol, universe, priority, .. } = *address;
        Ok(Self { protocol, universe, priority, to, discovery, socket, source: Uuid::new_v4(), sequence: 0 })
    }

    /// Sends the levels of all channels.
    pub(super) fn send(&mut self, channels: &[u8]) -> io::Result<()> {
        self.send_frame(channels, Stream::Continues)
    }

    /// Informs receivers that no further frames come.
    pub(super) fn end(&mut self, channels: &[u8]) -> io::Result<()> {
        // ANSI E1.31, 6.2.6: three packets. Art-Net has no such message.
        match self.protocol {
            Protocol::Sacn => (0..3).try_for_each(|_| self.send_frame(channels, Stream::Ends)),
            Protocol::ArtNet => Ok(()),
        }
    }

    fn send_frame(&mut self, channels: &[u8], stream: Stream) -> io::Result<()> {
        self.sequence = self.sequence.wrapping_add(1);
        let packet = match self.protocol {
            Protocol::Sacn => self.sacn(channels, stream)?,
            Protocol::ArtNet => self.art_net(channels)?,
        };
        self.socket.send_to(&packet, self.to).map(drop)
    }

    /// Sends the list of universes that sACN sources owe every 10 s (ANSI E1.31, 4.3).
    pub(super) fn announce(&self) -> io::Result<()> {
        if self.protocol != Protocol::Sacn {
            return Ok(());
        }
        let universes = UniverseDiscoveryPacketUniverseDiscoveryLayer {
            page: 0,
            last_page: 0,
            universes: Cow::Owned(vec![self.universe]),
        };
        let framing = UniverseDiscoveryPacketFramingLayer { source_name: SOURCE.into(), data: universes };
        let packet = self.packed(E131RootLayerData::UniverseDiscoveryPacket(framing))?;
        self.socket.send_to(&packet, self.discovery).map(drop)
    }

    fn sacn(&self, channels: &[u8], stream: Stream) -> io::Result<Vec<u8>> {
        // The first value is the start code 0: levels.
        let values: Vec<u8> = std::iter::once(0).chain(channels.iter().copied()).collect();
        self.packed(E131RootLayerData::DataPacket(DataPacketFramingLayer {
            source_name: SOURCE.into(),
            priority: self.priority,
            synchronization_address: 0,
            sequence_number: self.sequence,
            preview_data: false,
            stream_terminated: stream == Stream::Ends,
            force_synchronization: false,
            universe: self.universe,
            data: DataPacketDmpLayer { property_values: values.into() },
        }))
    }

    fn packed(&self, data: E131RootLayerData<'_>) -> io::Result<Vec<u8>> {
        let packet = AcnRootLayerProtocol { pdu: E131RootLayer { cid: self.source, data } };
        packet.pack_alloc().map_err(|error| io::Error::other(error.to_string()))
    }

    fn art_net(&self, channels: &[u8]) -> io::Result<Vec<u8>> {
        let invalid = |error: artnet_protocol::Error| io::Error::other(error.to_string());
        let output = Output {
            // 0 would switch off the receiver's ordering.
            sequence: self.sequence.max(1),
            port_address: PortAddress::try_from(self.universe).map_err(invalid)?,
            data: channels.to_vec().into(),
            ..Output::default()
        };
        ArtCommand::Output(output).write_to_buffer().map_err(invalid)
    }
}

/// Whether further frames follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stream {
    Continues,
    Ends,
}
