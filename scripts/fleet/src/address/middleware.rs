//! Addresses of vehicles that speak MAVLink.

use std::fmt;

/// What a vehicle does when its edge ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum VehicleEnd {
    /// `hold`: it keeps its last position.
    #[default]
    Hold,
    /// `land`: it lands where it is.
    Land,
    /// `rtl`: it returns to where it took off, and lands there.
    ReturnToLaunch,
}

const END_WORDS: [(&str, VehicleEnd); 3] =
    [("hold", VehicleEnd::Hold), ("land", VehicleEnd::Land), ("rtl", VehicleEnd::ReturnToLaunch)];
/// Largest height of a take-off, in millimetres.
const TAKEOFF_MAX_MM: f64 = 100_000.0;

/// `mavlink:udp:HOST:PORT`: a vehicle that sends heartbeats to this process, which drives it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MavlinkAddress {
    /// Host name or IP address at which this process listens.
    pub host: String,
    /// UDP port at which this process listens.
    pub port: u16,
    /// `?system=N`: the system id of the vehicle. `None`: that of the first vehicle that is heard.
    pub system: Option<u8>,
    /// `?takeoff=METRES`: the height of a take-off, in millimetres.
    pub takeoff_mm: Option<u32>,
    /// `?end=WORD`: what the vehicle does at the end.
    pub at_end: VehicleEnd,
}

impl MavlinkAddress {
    pub(super) fn parse(rest: &str) -> Option<Self> {
        let rest = rest.strip_prefix("udp:")?;
        let (place, options) = rest.split_once('?').map_or((rest, None), |(place, rest)| (place, Some(rest)));
        let (host, port) = place.rsplit_once(':')?;
        let port = port.parse().ok().filter(|port| *port > 0)?;
        let host = host.trim_start_matches('[').trim_end_matches(']').to_owned();
        if host.is_empty() || host.contains(['/', '@', ' ']) {
            return None;
        }
        let mut address = Self { host, port, system: None, takeoff_mm: None, at_end: VehicleEnd::Hold };
        for option in options.into_iter().flat_map(|options| options.split('&')) {
            match option.split_once('=')? {
                ("system", text) if address.system.is_none() => {
                    address.system = Some(text.parse().ok().filter(|system| *system > 0)?);
                }
                ("takeoff", text) if address.takeoff_mm.is_none() => {
                    let millimetres = (text.parse::<f64>().ok()? * 1_000.0).round();
                    let is_height = (100.0..=TAKEOFF_MAX_MM).contains(&millimetres);
                    #[expect(
                        clippy::cast_possible_truncation,
                        clippy::cast_sign_loss,
                        reason = "between 100 and 100,000"
                    )]
                    let height = is_height.then_some(millimetres as u32)?;
                    address.takeoff_mm = Some(height);
                }
                ("end", word) => {
                    address.at_end =
                        END_WORDS.iter().find(|(known, _)| *known == word).map(|(_, end)| *end)?;
                }
                _ => return None,
            }
        }
        Some(address)
    }
}

impl fmt::Display for MavlinkAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let host = if self.host.contains(':') { format!("[{}]", self.host) } else { self.host.clone() };
        write!(f, "mavlink:udp:{host}:{}", self.port)?;
        let end = END_WORDS.iter().find(|(_, end)| *end == self.at_end && *end != VehicleEnd::Hold);
        let options = [
            self.system.map(|system| format!("system={system}")),
            self.takeoff_mm.map(|height| format!("takeoff={}", f64::from(height) / 1_000.0)),
            end.map(|(word, _)| format!("end={word}")),
        ];
        let options: Vec<String> = options.into_iter().flatten().collect();
        if options.is_empty() { Ok(()) } else { write!(f, "?{}", options.join("&")) }
    }
}

/// Describes the fault of a text that begins like one of these addresses but is none, and how to correct it.
pub(super) fn fault(text: &str) -> Option<(&'static str, String)> {
    let (scheme, _) = text.split_once(':')?;
    match scheme {
        "mavlink" => Some((
            "is not a MAVLink address",
            "write the host and the UDP port at which this machine listens for the vehicle, as in `mavlink:udp:0.0.0.0:14550` or `mavlink:udp:0.0.0.0:14551?system=2&takeoff=1.5&end=land` (hold, land or rtl)"
                .to_owned(),
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
    fn addresses_are_written_as_they_were_read() {
        for text in [
            "mavlink:udp:0.0.0.0:14550",
            "mavlink:udp:[::]:14551?system=2&takeoff=1.5&end=land",
            "mavlink:udp:station.local:14550?end=rtl",
        ] {
            assert_eq!(parsed(text).to_string(), text);
        }
        assert_eq!(parsed("mavlink:udp:a:1?end=hold").to_string(), "mavlink:udp:a:1");
    }

    #[test]
    fn invalid_addresses_are_refused_with_the_valid_form() {
        for text in [
            "mavlink:0.0.0.0:14550",
            "mavlink:udp:14550",
            "mavlink:udp:a:0",
            "mavlink:udp:a:1?system=0",
            "mavlink:udp:a:1?takeoff=0",
            "mavlink:udp:a:1?takeoff=nan",
            "mavlink:udp:a:1?end=fly",
            "mavlink:udp:a:1?",
        ] {
            assert_eq!(text.parse::<Address>(), Err(InvalidAddress), "{text}");
            let (_, hint) = address_fault(text);
            assert!(hint.is_some_and(|hint| hint.starts_with("write ")), "{text}");
        }
    }

    #[test]
    fn robots_that_would_drive_the_same_have_equal_places() {
        let places = |text: &str| parsed(text).places();
        assert_eq!(places("mavlink:udp:a:1?system=1"), places("mavlink:udp:a:1?system=2"));
    }
}
