//! Nodes that answer a poll of Art-Net, and sources of sACN that announce their universes.
#![expect(clippy::disallowed_methods, reason = "answers of the network in real time")]

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use artnet_protocol::{ArtCommand, Poll, PollReply};
use socket2::{Domain, Socket, Type};

use super::transport::{DISCOVERY_UNIVERSE, Protocol, multicast};

/// A node or a controller that answered a poll of Art-Net.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub struct ArtNetNode {
    /// The address that the answer came from.
    pub from: IpAddr,
    /// Its name, as configured on the node; may be empty.
    pub name: String,
    /// The universes that it outputs, with net and sub-net, in ascending order.
    pub universes: Vec<u16>,
}

/// A source that announced its sACN universes.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub struct SacnSource {
    /// The address that the announcement came from.
    pub from: IpAddr,
    /// Its name, as configured on the source; may be empty.
    pub name: String,
    /// The universes that it sends, in ascending order.
    pub universes: Vec<u16>,
}

/// Asks all Art-Net nodes at the addresses `to`, which may be broadcast addresses, and returns the nodes that answer within `wait`.
///
/// # Errors
/// Fails if no socket can be opened. Networks that cannot be reached have no nodes.
pub fn poll_art_net(to: &[Ipv4Addr], wait: Duration) -> io::Result<Vec<ArtNetNode>> {
    // Nodes answer to this port, whichever port asked.
    let socket = shared_socket(Ipv4Addr::UNSPECIFIED, Protocol::ArtNet.port())?;
    socket.set_broadcast(true)?;
    let poll = ArtCommand::Poll(Poll::default()).write_to_buffer();
    let poll = poll.map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error.to_string()))?;
    for ip in to {
        if let Err(error) = socket.send_to(&poll, (*ip, Protocol::ArtNet.port())) {
            tracing::info!("cannot ask Art-Net nodes at {ip}: {error}");
        }
    }
    let mut nodes: Vec<ArtNetNode> = Vec::new();
    receive(&socket, wait, |bytes, from| {
        let Ok(ArtCommand::PollReply(reply)) = ArtCommand::from_buffer(bytes) else { return };
        // A node with more than four outputs answers several times.
        let known = nodes.iter().position(|node| node.from == from);
        let known = known.unwrap_or_else(|| {
            nodes.push(ArtNetNode { from, name: name_of(&reply), universes: Vec::new() });
            nodes.len() - 1
        });
        nodes[known].universes.extend(outputs_of(&reply));
    })?;
    for node in &mut nodes {
        node.universes.sort_unstable();
        node.universes.dedup();
    }
    nodes.sort_unstable();
    Ok(nodes)
}

/// Returns the sources of sACN that announce their universes within `wait` on the interfaces with these addresses. Sources announce them
/// every 10 s.
///
/// # Errors
/// Fails if no socket can be opened. Interfaces without multicast have no sources.
pub fn hear_sacn(interfaces: &[Ipv4Addr], wait: Duration) -> io::Result<Vec<SacnSource>> {
    let socket = shared_socket(Ipv4Addr::UNSPECIFIED, Protocol::Sacn.port())?;
    let IpAddr::V4(group) = multicast(DISCOVERY_UNIVERSE) else { return Ok(Vec::new()) };
    for interface in interfaces {
        if let Err(error) = socket.join_multicast_v4(&group, interface) {
            tracing::info!("cannot hear sACN at {interface}: {error}");
        }
    }
    let mut sources: Vec<SacnSource> = Vec::new();
    receive(&socket, wait, |bytes, from| {
        let Some((name, universes)) = announced(bytes) else { return };
        match sources.iter_mut().find(|source| source.from == from && source.name == name) {
            // Each page lists 512 universes.
            Some(source) => source.universes.extend(universes),
            None => sources.push(SacnSource { from, name, universes }),
        }
    })?;
    for source in &mut sources {
        source.universes.sort_unstable();
        source.universes.dedup();
    }
    sources.sort_unstable();
    Ok(sources)
}

/// Opens a socket that other programs of this machine can share, such as a lighting desk.
pub(super) fn shared_socket(host: Ipv4Addr, port: u16) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, None)?;
    socket.set_reuse_address(true)?;
    socket.bind(&SocketAddr::from((host, port)).into())?;
    Ok(socket.into())
}

/// Calls `take` for each packet that arrives within `wait`.
fn receive(socket: &UdpSocket, wait: Duration, mut take: impl FnMut(&[u8], IpAddr)) -> io::Result<()> {
    let until = Instant::now() + wait;
    let mut buffer = [0; 2_048];
    loop {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(());
        }
        socket.set_read_timeout(Some(left))?;
        match socket.recv_from(&mut buffer) {
            Ok((length, from)) => take(&buffer[..length], from.ip().to_canonical()),
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {}
            // A node that is switched off is no reason to miss the others.
            Err(error) => tracing::info!("a packet was lost: {error}"),
        }
    }
}

fn name_of(reply: &PollReply) -> String {
    let long = text_of(&reply.long_name);
    if long.is_empty() { text_of(&reply.short_name) } else { long }
}

/// Returns a text that zeros fill up to a fixed length.
fn text_of(bytes: &[u8]) -> String {
    let text = bytes.split(|byte| *byte == 0).next().unwrap_or_default();
    String::from_utf8_lossy(text).trim().to_owned()
}

/// Returns the universes that a node outputs.
fn outputs_of(reply: &PollReply) -> Vec<u16> {
    const OUTPUT: u8 = 0x80;
    let [net, sub_net] = reply.port_address;
    let ports = reply.port_types.iter().zip(reply.swout).filter(|(kind, _)| **kind & OUTPUT != 0);
    let universe =
        |own: u8| u16::from(net & 0x7f) << 8 | u16::from(sub_net & 0x0f) << 4 | u16::from(own & 0x0f);
    ports.map(|(_, own)| universe(own)).collect()
}

/// Returns the name of a source and the universes that it announces (ANSI E1.31, 6.4 and 8). `None` for any other packet. The parser of
/// the crate `sacn` panics on packets with damaged lengths.
fn announced(packet: &[u8]) -> Option<(String, Vec<u16>)> {
    const IDENTIFIER: &[u8] = b"ASC-E1.17\0\0\0";
    const ROOT_EXTENDED: &[u8] = &[0, 0, 0, 8];
    const FRAMING_DISCOVERY: &[u8] = &[0, 0, 0, 2];
    let is_announcement = packet.get(4..16)? == IDENTIFIER
        && packet.get(18..22)? == ROOT_EXTENDED
        && packet.get(40..44)? == FRAMING_DISCOVERY;
    let universes = packet.get(120..)?.chunks_exact(2).map(|two| u16::from_be_bytes([two[0], two[1]]));
    is_announcement.then(|| (text_of(&packet[44..108]), universes.collect()))
}

#[cfg(test)]
mod tests {
    use super::super::transport::Transport;
    use super::super::{DmxAddress, Protocol};
    use super::*;

    /// Returns an address on the loopback that no other process uses for these tests.
    fn own_address(last: u8) -> Ipv4Addr {
        let [_, _, high, low] = std::process::id().to_be_bytes();
        Ipv4Addr::new(127, high, low, last)
    }

    /// A node with an address of its own on the loopback, which answers one poll and ignores everything else.
    fn node(host: Ipv4Addr, replies: Vec<Vec<u8>>) -> std::thread::JoinHandle<()> {
        let socket = shared_socket(host, 6454).unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        std::thread::spawn(move || {
            let mut buffer = [0; 600];
            let (length, from) = socket.recv_from(&mut buffer).unwrap();
            let asked = ArtCommand::from_buffer(&buffer[..length]).unwrap();
            assert!(matches!(asked, ArtCommand::Poll(_)), "{asked:?}");
            for reply in &replies {
                socket.send_to(reply, from).unwrap();
            }
        })
    }

    fn reply(ports: &[u8]) -> Vec<u8> {
        let mut reply = PollReply { port_address: [1, 2], ..PollReply::default() };
        reply.long_name[..9].copy_from_slice(b"Front row");
        for (index, port) in ports.iter().enumerate() {
            (reply.port_types[index], reply.swout[index]) = (0x80, *port);
        }
        ArtCommand::PollReply(Box::new(reply)).write_to_buffer().unwrap()
    }

    #[test]
    fn node_is_listed_once_with_all_universes_that_it_outputs() {
        let damaged = vec![0; 20];
        let node = node(own_address(61), vec![reply(&[5, 3]), damaged, reply(&[4, 5])]);
        let nodes = poll_art_net(&[own_address(61)], Duration::from_secs(2)).unwrap();
        node.join().unwrap();
        let from = own_address(61).into();
        let first = 256 + 2 * 16;
        let universes = vec![first + 3, first + 4, first + 5];
        assert_eq!(nodes, [ArtNetNode { from, name: "Front row".to_owned(), universes }]);
    }

    #[test]
    fn announcement_of_a_universe_is_understood_and_damaged_ones_are_ignored() {
        let receiver = shared_socket(own_address(62), 5568).unwrap();
        receiver.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let address = DmxAddress::new(Protocol::Sacn, 301, 1, Some(own_address(62).to_string()));
        let mut source = Transport::open(&address, receiver.local_addr().unwrap()).unwrap();
        source.announce().unwrap();
        let mut buffer = [0; 1_500];
        let length = receiver.recv(&mut buffer).unwrap();
        let packet = &buffer[..length];
        assert_eq!(announced(packet), Some(("Downbeat".to_owned(), vec![301])));
        for end in 0..120 {
            assert_eq!(announced(&packet[..end]), None, "{end} bytes");
        }
        source.send(&[1, 2]).unwrap();
        let length = receiver.recv(&mut buffer).unwrap();
        assert_eq!(announced(&buffer[..length]), None, "a frame announces nothing");
    }
}
