//! How often peers were refused, slowed down or hung up on, and why.
#![expect(clippy::disallowed_methods, reason = "logs each reason once a second of real time")]

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use crate::peer::Peer;

macro_rules! reasons {
    ($($(#[$doc:meta])* $reason:ident = $sentence:literal,)*) => {
        /// Why a peer was refused, slowed down or hung up on.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[non_exhaustive]
        pub enum Reason {
            $($(#[$doc])* $reason,)*
        }

        impl Reason {
            /// All of them.
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
    /// Hung up on: what was said to it and not read is more than its share.
    Unread = "a peer that does not read what it is told is hung up on",
    /// Hung up on: it took no bytes for 10 s.
    Stuck = "a peer that takes no bytes is hung up on",
    /// Hung up on: no whole message in the first 5 s.
    SaidNothing = "a connection that brings no message is closed",
    /// Hung up on: a message was begun and not ended within 10 s.
    HalfAMessage = "a connection that ends no message that it begins is closed",
    /// Hung up on: another connection needed its place.
    MadeRoom = "a connection without the session of the robot gives way",
    /// Hung up on: too many connections from one host.
    ManyFromOneHost = "one host has too many connections: one of them is closed",
    /// Slowed down: it sends more than its share.
    Paused = "a peer that sends too much is read more slowly",
    /// Refused: a line longer than a peer may send that does not have the session of the robot.
    LongLine = "a long line of a peer without the session of the robot is skipped",
    /// Hung up on: it has not proven, by TLS or a pass, who it is.
    NotProven = "a peer that does not prove who it is is hung up on",
    /// Hung up on: bytes came that the peer did not send, or not in this order.
    Altered = "a connection with something altered, repeated or put in another order is closed",
    /// Refused: the robot belongs to another session, or holds as much as it can.
    Busy = "a peer is refused because the robot is busy",
}

/// How often each reason applied, since the host was started.
#[derive(Debug)]
pub struct Refusals {
    counts: [AtomicU64; Reason::ALL.len()],
    /// When each was logged last, in milliseconds since `begin`, plus one; 0: never.
    logged: [AtomicU64; Reason::ALL.len()],
    begin: Instant,
    /// Whom each applied to, as often as it did.
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

/// Between two lines in the log about one reason, in milliseconds.
const LOG_INTERVAL_MS: u64 = 1_000;

impl Refusals {
    /// How often this applied.
    #[must_use]
    pub fn count(&self, reason: Reason) -> u64 {
        self.counts[reason as usize].load(Ordering::Relaxed)
    }

    /// Each reason that applied, with how often.
    pub fn iter(&self) -> impl Iterator<Item = (Reason, u64)> + '_ {
        Reason::ALL.iter().map(|reason| (*reason, self.count(*reason))).filter(|(_, count)| *count > 0)
    }

    /// Whom this applied to, each of them once.
    #[cfg(test)]
    pub(crate) fn peers(&self, reason: Reason) -> std::collections::BTreeSet<String> {
        let peers = self.peers.lock().unwrap();
        peers.iter().filter(|(noted, _)| *noted == reason).map(|(_, peer)| peer.clone()).collect()
    }

    /// Counts, and logs once a second at most. Returns whether it was logged.
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
