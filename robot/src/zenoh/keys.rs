//! The key of a robot in a Zenoh network, and the keys below it.

use std::fmt;
use std::str::FromStr;

use ::zenoh::bytes::ZBytes;

/// Key of a robot in a Zenoh network, for example `hall-2/arm-1`.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Key(String);

/// Error: a string cannot be a robot's key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected a Zenoh key without wildcards, such as hall-2/arm-1")]
pub struct NoKey;

impl FromStr for Key {
    type Err = NoKey;

    fn from_str(text: &str) -> Result<Self, NoKey> {
        let is_chunk = |chunk: &str| {
            !chunk.is_empty() && !chunk.contains(['*', '$', '?', '#']) && !chunk.contains(char::is_whitespace)
        };
        if text.split('/').all(is_chunk) { Ok(Self(text.to_owned())) } else { Err(NoKey) }
    }
}

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Key {
    pub(super) fn open(&self) -> String {
        format!("{}/open", self.0)
    }

    /// Returns the key of the liveliness token of a robot's session. With `*` as the session, the key matches the tokens of all sessions
    /// at this robot's key.
    pub(super) fn robot(&self, session: &str) -> String {
        format!("{}/robot/{session}", self.0)
    }

    /// Returns a key that matches the liveliness tokens of this robot and of all robots in the same place (with the same key except for
    /// the last chunk).
    pub(super) fn robots_beside(&self) -> String {
        self.beside("*/robot/*")
    }

    /// Returns the key of the liveliness token of a scheduler's session for the robots in this place. With `*` as the session, the key
    /// matches the tokens of all sessions.
    pub(super) fn scheduler(&self, session: &str) -> String {
        self.beside(&format!("scheduler/{session}"))
    }

    pub(super) fn to(&self) -> String {
        format!("{}/to", self.0)
    }

    pub(super) fn from(&self, session: &str) -> String {
        format!("{}/from/{session}", self.0)
    }

    /// Returns the place that the robot shares with others: its key without the last chunk. Returns an empty string if the key has only
    /// one chunk.
    #[must_use]
    pub fn place(&self) -> &str {
        self.0.rsplit_once('/').map_or("", |(place, _)| place)
    }

    /// Returns the key at which a scheduler's session answers requests for texts that it has published for several robots in this place.
    /// The session publishes the texts below that key.
    pub(super) fn shared(&self, session: &str) -> String {
        self.beside(&format!("shared/{session}"))
    }

    fn beside(&self, what: &str) -> String {
        match self.place() {
            "" => what.to_owned(),
            place => format!("{place}/{what}"),
        }
    }
}

/// Identifies a connection by the session that has opened it and a number in this session. The id is attached to every frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct LinkId {
    session: u128,
    number: u64,
}

impl LinkId {
    /// Returns the id of a connection. `None` if `session` is not the id of a session.
    pub(super) fn new(session: &str, number: u64) -> Option<Self> {
        u128::from_str_radix(session, 16).ok().map(|session| Self { session, number })
    }

    pub(super) fn session(&self) -> String {
        format!("{:x}", self.session)
    }

    pub(super) fn encode(&self) -> Vec<u8> {
        [&self.session.to_le_bytes()[..], &self.number.to_le_bytes()].concat()
    }

    pub(super) fn decode(bytes: &[u8]) -> Option<Self> {
        let (session, number) = bytes.split_first_chunk()?;
        let number = number.try_into().ok()?;
        Some(Self { session: u128::from_le_bytes(*session), number: u64::from_le_bytes(number) })
    }
}

impl fmt::Display for LinkId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:x}.{}", self.session, self.number)
    }
}

impl FromStr for LinkId {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let (session, number) = text.split_once('.').ok_or(())?;
        Self::new(session, number.parse().map_err(|_| ())?).ok_or(())
    }
}

/// Returns the key of the robot to which a liveliness token belongs. `None` if the token does not belong to a robot.
pub(super) fn robot_of(token: &str) -> Option<&str> {
    token.rsplit_once('/')?.0.strip_suffix("/robot")
}

/// Attachment to the answer of a robot that receives the texts that are published for several robots.
pub(super) const HEARS: &str = "shared-1";

/// Number of an audience: a group of robots that receive the same publications. The number is unique in the scheduler's session.
pub(super) type Audience = u32;

/// Maximum number of audiences (groups of robots that receive the same publications) to which one robot may belong.
pub const AUDIENCES_MAX: usize = 32;

/// Returns the attachment to the query that opens a connection to a robot. It lists the robot's audiences. `None` if the robot has none.
pub(super) fn asks_to_hear(audiences: &[Audience]) -> Option<String> {
    let numbers = || audiences.iter().map(|audience| format!(" {audience}"));
    (!audiences.is_empty()).then(|| HEARS.to_owned() + &numbers().collect::<String>())
}

/// Returns the audiences that an attachment lists. Returns an empty list if the attachment contains anything else, or more than
/// [`AUDIENCES_MAX`] audiences.
pub(super) fn asked_to_hear(attachment: Option<&ZBytes>) -> Vec<Audience> {
    let text = attachment.map(|attached| String::from_utf8_lossy(&attached.to_bytes()).into_owned());
    let numbers = text.as_deref().and_then(|text| text.strip_prefix(HEARS)?.strip_prefix(' '));
    let numbers = numbers.into_iter().flat_map(|numbers| numbers.split(' '));
    let audiences = numbers.map(str::parse).collect::<Result<Vec<_>, _>>().unwrap_or_default();
    if audiences.len() <= AUDIENCES_MAX { audiences } else { Vec::new() }
}

/// Whether the attachment to a robot's answer shows that the robot receives texts that are published for several robots.
pub(super) fn hears(attachment: Option<&ZBytes>) -> bool {
    attachment.is_some_and(|attached| *attached.to_bytes() == *HEARS.as_bytes())
}

/// Word in the query that opens a connection, if the connection is opened for stops. It follows the name of the connection and a space.
pub(super) const STOPS: &str = "stop";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_has_chunks_and_no_wildcards() {
        for right in ["a", "hall-2/arm-1", "a/b/c.d", "höhle/1"] {
            assert_eq!(right.parse::<Key>().map(|key| key.to_string()).as_deref(), Ok(right));
        }
        for wrong in ["", "/", "a/", "/a", "a//b", "a/*", "**", "a$*", "a?b", "a#b", "a b"] {
            assert_eq!(wrong.parse::<Key>(), Err(NoKey), "{wrong:?}");
        }
    }

    #[test]
    fn sibling_keys_of_a_robot_share_its_place() {
        let key = |key: &str| key.parse::<Key>().unwrap();
        assert_eq!(key("site/hall/arm").robots_beside(), "site/hall/*/robot/*");
        assert_eq!(key("site/hall/arm").scheduler("7"), "site/hall/scheduler/7");
        assert_eq!(key("site/hall/arm").shared("7"), "site/hall/shared/7");
        assert_eq!(key("arm").robots_beside(), "*/robot/*");
        assert_eq!(key("arm").scheduler("7"), "scheduler/7");
        assert_eq!(robot_of(&key("site/hall/arm").robot("7")), Some("site/hall/arm"));
        assert_eq!(robot_of(&key("site/hall/arm").scheduler("7")), None);
    }

    #[test]
    fn audiences_round_trip_and_other_attachments_are_ignored() {
        let read = |text: &str| asked_to_hear(Some(&ZBytes::from(text)));
        assert_eq!(asks_to_hear(&[]), None);
        assert_eq!(read(&asks_to_hear(&[0, 7, u32::MAX]).unwrap()), [0, 7, u32::MAX]);
        let many = asks_to_hear(&[1; AUDIENCES_MAX + 1]).unwrap();
        for wrong in
            ["", "shared-1", "shared-1 ", "shared-1 x", "shared-1 1 -2", "shared-2 1", "shared-10 1", &many]
        {
            assert_eq!(read(wrong), [0; 0], "{wrong:?}");
        }
        assert_eq!(asked_to_hear(None), [0; 0]);
    }

    #[test]
    fn connection_id_round_trips_and_invalid_ids_are_rejected() {
        let link = LinkId::new("f00d", 258).unwrap();
        assert_eq!(LinkId::decode(&link.encode()), Some(link));
        assert_eq!(link.to_string().parse(), Ok(link));
        assert_eq!((link.session().as_str(), link.to_string().as_str()), ("f00d", "f00d.258"));
        assert_eq!(LinkId::decode(&link.encode()[1..]), None);
        for wrong in ["", "f00d", "f00d.", ".1", "x.1", "f00d.1.2"] {
            assert_eq!(wrong.parse::<LinkId>(), Err(()), "{wrong:?}");
        }
    }
}
