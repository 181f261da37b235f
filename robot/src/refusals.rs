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
    /// Disconnected: the messages that the peer has not read exceed the limit.
    Unread = "a peer was disconnected because it does not read its messages",
    /// Disconnected: the peer accepted no bytes for 10 s.
    Stuck = "a peer was disconnected because it accepts no bytes",
    /// Disconnected: the peer sent no complete message in the first 5 s.
    SaidNothing = "a connection was closed because no message arrived",
    /// Disconnected: the peer did not complete a message within 10 s after its first byte.
    HalfAMessage = "a connection was closed because a message remained incomplete",
    /// Disconnected: this connection was closed to give its place to another one.
    MadeRoom = "a connection was closed to make room for another; it did not belong to the session that owns the robot",
    /// Disconnected: one remote host has too many connections.
    ManyFromOneHost = "a connection was closed because its host has too many connections",
    /// Slowed down: the peer sends more than its budget permits.
    Paused = "a peer was throttled because it sends too much",
    /// Refused: the line is longer than a peer that does not own the robot may send.
    LongLine = "a long line was ignored because its sender does not own the robot",
    /// Disconnected: the peer has not proven its identity by TLS or a pass.
    NotProven = "a peer was disconnected because it did not prove its identity",
    /// Disconnected: the key with which the peer has proven its identity was revoked, or has expired.
    KeyInvalid = "an operator was disconnected because the key is no longer valid",
    /// Disconnected: bytes arrived that the peer did not send, or did not send in this order.
    Altered = "a connection was closed because its data was altered, repeated or reordered",
    /// Refused: the robot belongs to another session, or holds as many commands as it can.
    Busy = "a peer was refused because the robot is busy",
}

/// Numbers of refusals, delays and disconnections since the start of the host, by reason.
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
    /// Returns how often peers were refused, slowed down or disconnected for this reason.
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

    /// Counts one case of this reason. Logs the case unless a case of this reason was logged in the last second. Returns whether it was
    /// logged.
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
    fn every_refusal_is_counted_and_each_reason_is_logged_once_a_second() {
        let refusals = Refusals::default();
        let peer = Peer::in_process();
        let logged = [0, 1, 999, 1_000, 1_500, 2_000].map(|at| refusals.note_at(Reason::Unread, &peer, at));
        assert_eq!(logged, [true, false, false, true, false, true]);
        assert!(refusals.note_at(Reason::Paused, &peer, 2_000), "of another reason nothing was logged yet");
        assert_eq!(refusals.iter().collect::<Vec<_>>(), [(Reason::Unread, 6), (Reason::Paused, 1)]);
    }
}
