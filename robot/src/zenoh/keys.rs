//! The key of a robot, and the keys below it.

use std::fmt;
use std::str::FromStr;

/// Where a robot is in a Zenoh network, for example `hall-2/arm-1`.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Key(String);

/// A text is no key of a robot.
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

    /// The token of a robot's session, or with `*` those of all.
    pub(super) fn robot(&self, session: &str) -> String {
        format!("{}/robot/{session}", self.0)
    }

    pub(super) fn to(&self, link: &str) -> String {
        format!("{}/link/{link}/to", self.0)
    }

    pub(super) fn from(&self, link: &str) -> String {
        format!("{}/link/{link}/from", self.0)
    }

    pub(super) fn scheduler(&self, link: &str) -> String {
        format!("{}/link/{link}/scheduler", self.0)
    }
}

/// Stands behind the name of a connection, after a space, when one is opened for stops.
pub(super) const STOPS: &str = "stop";

/// The connection that a key below a robot's belongs to: its last chunk but one.
pub(super) fn link_of(key: &str) -> Option<&str> {
    key.rsplit('/').nth(1)
}

/// Which session declared the token of a robot: its last chunk.
pub(super) fn session_of(key: &str) -> Option<&str> {
    key.rsplit('/').next()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_has_chunks_and_no_wildcards() {
        for right in ["a", "hall-2/arm-1", "a/b/c.d", "höhle/1"] {
            assert_eq!(right.parse::<Key>().map(|key| key.to_string()).as_deref(), Ok(right));
        }
        for wrong in ["", "/", "a/", "/a", "a//b", "a/*", "**", "a$*", "a?b", "a#b", "a b"] {
            assert_eq!(wrong.parse::<Key>(), Err(NoKey), "{wrong:?}");
        }
    }

    #[test]
    fn what_belongs_to_a_connection_is_found_by_its_key() {
        let key: Key = "hall/arm".parse().unwrap();
        assert_eq!(link_of(&key.to("l7")), Some("l7"));
        assert_eq!(link_of(&key.scheduler("l7")), Some("l7"));
        assert_eq!(session_of(&key.robot("z")), Some("z"));
    }
}
