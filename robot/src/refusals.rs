//! Counts how often peers were refused, slowed down or disconnected, by reason.
#![expect(clippy::disallowed_methods, reason = "logs each reason once a second of real time")]

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use crate::peer::Peer;

macro_rules! reasons {
    ($($(#[$doc:meta])* $reason:ident = $sentence:literal,)*) => {
        /// Why a peer was refused, slowed down or disconnected.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[non_exhaustive]
        pub enum Reason {
            $($(#[$doc])* $reason,)*
        }

        impl Reason {
            /// All reasons.
            pub const ALL: &[Self] = &[$(Self::$reason,)*];
        }

        impl fmt::Display for Reason {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(match self {
                    $(Self::$reason => $sentence,)*
                })
            }
        }
    };
}

reasons! {
    /// Disconnected: the peer's unread messages exceed its share.
    Unread = "a peer that does not read its messages is disconnected",
    /// Disconnected: the peer accepted no bytes for 10 s.
    Stuck = "a peer that accepts no bytes is disconnected",
    /// Disconnected: the peer sent no complete message in the first 5 s.
    SaidNothing = "a connection without a message is closed",
    /// Disconnected: the peer did not complete a message within 10 s after its first byte.
    HalfAMessage = "a connection with an incomplete message is closed",
    /// Disconnected: another connection took this one's place.
    MadeRoom = "a connection without the session of the robot is closed to make room",
    /// Disconnected: one host has too many connections.
    ManyFromOneHost = "one host has too many connections: one of them is closed",
    /// Slowed down: the peer sends more than its share.
    Paused = "a peer that sends too much is throttled",
    /// Refused: the line is longer than a peer that does not own the robot may send.
    LongLine = "a long line of a peer without the session of the robot is skipped",
    /// Disconnected: the peer has not proven its identity by TLS or a pass.
    NotProven = "a peer that does not prove its identity is disconnected",
    /// Disconnected: the key with which the peer has proven its identity was revoked, or has expired.
    KeyInvalid = "an operator whose key is no longer valid is disconnected",
    /// Disconnected: bytes arrived that the peer did not send, or did not send in this order.
    Altered = "a connection with altered, repeated or reordered data is closed",
    /// Refused: the robot belongs to another session, or holds as many commands as it can.
    Busy = "a peer is refused because the robot is busy",
}

/// Counts since the start of the host, by reason.
#[derive(Debug)]
pub struct Refusals {
    counts: [AtomicU64; Reason::ALL.len()],
    /// Time of the last log line about each reason, in milliseconds since `begin`, plus one. 0: no log line yet.
    logged: [AtomicU64; Reason::ALL.len()],
    begin: Instant,
    /// The peers to which each reason applied, with one entry per case.
    #[cfg(test)]
    peers: std::sync::Mutex<Vec<(Reason, String)>>,
}

impl Default for Refusals {
    fn default() -> Self {
        let zeros = || std::array::from_fn(|_| AtomicU64::new(0));
        Self {
            counts: zeros(),
            logged: zeros(),
            begin: Instant::now(),
            #[cfg(test)]
            peers: std::sync::Mutex::default(),
        }
    }
}

/// Minimum interval between two log lines about the same reason, in milliseconds.
const LOG_INTERVAL_MS: u64 = 1_000;

impl Refusals {
    /// Returns how often a reason applied.
    #[must_use]
    pub fn count(&self, reason: Reason) -> u64 {
        self.counts[reason as usize].load(Ordering::Relaxed)
    }

    /// Returns all reasons that have applied, each with its count.
    pub fn iter(&self) -> impl Iterator<Item = (Reason, u64)> + '_ {
        Reason::ALL.iter().map(|reason| (*reason, self.count(*reason))).filter(|(_, count)| *count > 0)
    }

    /// Returns the peers to which a reason applied, without duplicates.
    #[cfg(test)]
    pub(crate) fn peers(&self, reason: Reason) -> std::collections::BTreeSet<String> {
        let peers = self.peers.lock().unwrap();
        peers.iter().filter(|(noted, _)| *noted == reason).map(|(_, peer)| peer.clone()).collect()
    }

    /// Counts a case. Logs it unless the same reason was logged in the last second, and returns whether it was logged.
    pub(crate) fn note(&self, reason: Reason, peer: &Peer) -> bool {
        self.note_at(reason, peer, u64::try_from(self.begin.elapsed().as_millis()).unwrap_or(u64::MAX))
    }

    fn note_at(&self, reason: Reason, peer: &Peer, millis: u64) -> bool {
        #[cfg(test)]
        self.peers.lock().unwrap().push((reason, peer.to_string()));
        let times = self.counts[reason as usize].fetch_add(1, Ordering::Relaxed) + 1;
        let logged = &self.logged[reason as usize];
        let before = logged.load(Ordering::Relaxed);
        if before != 0 && millis + 1 < before.saturating_add(LOG_INTERVAL_MS) {
            return false;
        }
        let mine = logged.compare_exchange(before, millis + 1, Ordering::Relaxed, Ordering::Relaxed).is_ok();
        if mine {
            tracing::warn!(%peer, times, "{reason}");
        }
        mine
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_reason_is_counted_and_logged_once_a_second() {
        let refusals = Refusals::default();
        let peer = Peer::in_process();
        let logged = [0, 1, 999, 1_000, 1_500, 2_000].map(|at| refusals.note_at(Reason::Unread, &peer, at));
        assert_eq!(logged, [true, false, false, true, false, true]);
        assert!(refusals.note_at(Reason::Paused, &peer, 2_000), "of another reason nothing was logged yet");
        assert_eq!(refusals.iter().collect::<Vec<_>>(), [(Reason::Unread, 6), (Reason::Paused, 1)]);
    }
}
