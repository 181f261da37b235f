//! Addresses of lights and of programs that receive Open Sound Control.

use std::fmt;

/// A protocol that carries DMX512 over IP.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DmxProtocol {
    /// `sacn`: ANSI E1.31, streaming ACN.
    Sacn,
    /// `artnet`: Art-Net 4.
    ArtNet,
}

impl DmxProtocol {
    /// Returns the scheme of addresses with this protocol.
    #[must_use]
    pub const fn scheme(self) -> &'static str {
        match self {
            Self::Sacn => "sacn",
            Self::ArtNet => "artnet",
        }
    }

    /// Returns the smallest and the largest number of a universe.
    #[must_use]
    pub const fn universes(self) -> (u16, u16) {
        match self {
            Self::Sacn => (1, 63_999),
            Self::ArtNet => (0, 32_767),
        }
    }
}

/// Largest number of a channel of a universe.
const CHANNEL_MAX: u16 = 512;
/// Largest priority of an sACN source.
const PRIORITY_MAX: u8 = 200;

/// `sacn:UNIVERSE/CHANNEL` or `artnet:UNIVERSE/CHANNEL@HOST`: a fixture that this process drives.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DmxAddress {
    /// The protocol of the frames.
    pub protocol: DmxProtocol,
    /// The number of the universe.
    pub universe: u16,
    /// The fixture's first channel, 1 to 512.
    pub channel: u16,
    /// Host name or IP address of the receiver. `None`: the multicast address of the universe.
    pub host: Option<String>,
    /// `?priority=N`: the priority of the source, 0 to 200.
    pub priority: Option<u8>,
    /// `?end=blackout`: whether all channels of the fixture go to zero at the end. Otherwise they keep their values.
    pub blackout: bool,
}

impl DmxAddress {
    pub(super) fn parse(protocol: DmxProtocol, rest: &str) -> Option<Self> {
        let (place, options) = rest.split_once('?').map_or((rest, None), |(place, rest)| (place, Some(rest)));
        let (place, host) = place.split_once('@').map_or((place, None), |(place, host)| (place, Some(host)));
        let (universe, channel) = place.split_once('/')?;
        let (first, last) = protocol.universes();
        let universe = number(universe).filter(|universe| (first..=last).contains(universe))?;
        let channel = number(channel).filter(|channel| (1..=CHANNEL_MAX).contains(channel))?;
        let is_host = |host: &&str| !host.is_empty() && !host.contains(['/', '@', ' ']);
        // A frame of Art-Net is sent to a single receiver, or to a broadcast address that is named.
        if host.is_some_and(|host| !is_host(&host)) || (protocol == DmxProtocol::ArtNet && host.is_none()) {
            return None;
        }
        let host = host.map(|host| host.trim_start_matches('[').trim_end_matches(']').to_owned());
        let (mut priority, mut blackout) = (None, false);
        for option in options.into_iter().flat_map(|options| options.split('&')) {
            match option.split_once('=')? {
                ("priority", text) if protocol == DmxProtocol::Sacn && priority.is_none() => {
                    priority = Some(text.parse().ok().filter(|priority| *priority <= PRIORITY_MAX)?);
                }
                ("end", "blackout") => blackout = true,
                ("end", "hold") => blackout = false,
                _ => return None,
            }
        }
        Some(Self { protocol, universe, channel, host, priority, blackout })
    }
}

/// Parses a number without sign, blanks or leading zeros, so that equal numbers have equal texts.
fn number(text: &str) -> Option<u16> {
    text.parse().ok().filter(|number: &u16| number.to_string() == text)
}

impl fmt::Display for DmxAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}/{}", self.protocol.scheme(), self.universe, self.channel)?;
        match &self.host {
            Some(host) if host.contains(':') => write!(f, "@[{host}]")?,
            Some(host) => write!(f, "@{host}")?,
            None => {}
        }
        let priority = self.priority.map(|priority| format!("priority={priority}"));
        let options: Vec<String> =
            priority.into_iter().chain(self.blackout.then(|| "end=blackout".to_owned())).collect();
        if options.is_empty() { Ok(()) } else { write!(f, "?{}", options.join("&")) }
    }
}

/// `osc:HOST:PORT/PATH`: a program or machine that receives Open Sound Control, and that this process drives.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OscAddress {
    /// Host name or IP address of the receiver.
    pub host: String,
    /// UDP port of the receiver.
    pub port: u16,
    /// Beginning of the OSC addresses of all devices, with a slash at its start and none at its end; may be empty.
    pub path: String,
}

impl OscAddress {
    pub(super) fn parse(rest: &str) -> Option<Self> {
        let (place, path) = rest.split_once('/').map_or((rest, ""), |(place, path)| (place, path));
        let (host, port) = place.rsplit_once(':')?;
        let port = number(port).filter(|port| *port > 0)?;
        let host = host.trim_start_matches('[').trim_end_matches(']').to_owned();
        let path = path.trim_end_matches('/');
        let is_part = |part: &str| {
            !part.is_empty() && part.chars().all(|c| c.is_ascii_graphic() && !"#*,?[]{}".contains(c))
        };
        if host.is_empty() || host.contains([' ', '@']) || !(path.is_empty() || path.split('/').all(is_part))
        {
            return None;
        }
        let path = if path.is_empty() { String::new() } else { format!("/{path}") };
        Some(Self { host, port, path })
    }
}

impl fmt::Display for OscAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let host = if self.host.contains(':') { format!("[{}]", self.host) } else { self.host.clone() };
        write!(f, "osc:{host}:{}{}", self.port, self.path)
    }
}

/// Describes the fault of a text that begins like one of these addresses but is none, and how to correct it.
pub(super) fn fault(text: &str) -> Option<(&'static str, String)> {
    let (scheme, _) = text.split_once(':')?;
    match scheme {
        "sacn" => Some((
            "is not an sACN address",
            "write universe (1 to 63999) and first channel (1 to 512), as in `sacn:1/13`, `sacn:1/13@10.0.0.5` or `sacn:1/13?priority=120&end=blackout`"
                .to_owned(),
        )),
        "artnet" => Some((
            "is not an Art-Net address",
            "write universe (0 to 32767), first channel (1 to 512) and receiver, as in `artnet:1/13@10.0.0.5` or `artnet:1/13@10.0.0.5?end=blackout`"
                .to_owned(),
        )),
        "osc" => Some((
            "is not an OSC address",
            "write host, UDP port and the beginning of the OSC addresses, as in `osc:10.0.0.5:53000/cue`".to_owned(),
        )),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Address, InvalidAddress, address_fault};

    fn parsed(text: &str) -> Address {
        text.parse().unwrap_or_else(|InvalidAddress| panic!("{text}"))
    }

    #[test]
    fn addresses_of_fixtures_are_written_as_they_were_read() {
        for text in [
            "sacn:1/13",
            "sacn:63999/512@10.0.0.5",
            "sacn:1/13?priority=120&end=blackout",
            "sacn:1/1@[fe80::1]?end=blackout",
            "artnet:0/1@dimmers.local",
            "osc:10.0.0.5:53000/cue",
            "osc:localhost:7000",
            "osc:[::1]:7000/a/b",
        ] {
            assert_eq!(parsed(text).to_string(), text);
        }
        assert_eq!(parsed("sacn:1/13?end=hold").to_string(), "sacn:1/13");
        assert_eq!(parsed("osc:localhost:7000/").to_string(), "osc:localhost:7000");
    }

    #[test]
    fn invalid_addresses_of_fixtures_are_refused_with_the_valid_form() {
        for text in [
            "sacn:0/1",
            "sacn:64000/1",
            "sacn:1/0",
            "sacn:1/513",
            "sacn:1",
            "sacn:01/1",
            "sacn:1/1@",
            "sacn:1/1?priority=201",
            "sacn:1/1?priority=1&priority=2",
            "sacn:1/1?end=dark",
            "sacn:1/1?",
            "artnet:1/13",
            "artnet:32768/1@a",
            "artnet:1/1@a?priority=100",
            "sacn://1/1",
            "osc:host",
            "osc:host:0/a",
            "osc::7000/a",
            "osc:host:7000/a b",
            "osc:host:7000//a",
            "osc:host:7000/a*",
        ] {
            assert_eq!(text.parse::<Address>(), Err(InvalidAddress), "{text}");
            let (_, hint) = address_fault(text);
            assert!(hint.is_some_and(|hint| hint.starts_with("write ")), "{text}");
        }
    }

    #[test]
    fn two_robots_cannot_be_the_same_fixture() {
        assert_eq!(parsed("sacn:1/13").places(), parsed("sacn:1/13?priority=120").places());
        assert_ne!(parsed("sacn:1/13").places(), parsed("sacn:1/14").places());
        assert_ne!(parsed("sacn:1/13").places(), parsed("sacn:1/13@10.0.0.5").places());
        assert!(!parsed("sacn:1/13").is_served() && !parsed("osc:a:1").is_open());
    }
}
