//! Connections that are new: their peers have neither proven an identity nor sent a message. All robots of a host share a limited number
//! of them. Once they are too many, the host closes one from the part of the network that has most of them at the same robot. Someone who
//! opens many connections therefore closes only their own, and everyone else has time for a handshake.

use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rustix::process::{Resource, getrlimit};
use tokio::sync::Notify;

use crate::peer::{Peer, Prefix};

/// Maximum number of new connections of a host. At 5,000 connections per second from as many places, each of them has 0.2 s.
pub(crate) const NEWCOMERS_MAX: usize = 1024;

/// The new connections of a host.
#[derive(Debug)]
pub(crate) struct Newcomers {
    most: usize,
    waiting: Mutex<Waiting>,
}

#[derive(Debug, Default)]
struct Waiting {
    last: u64,
    /// All new connections by number, which increases with each connection. Includes connections that were asked to close.
    all: BTreeMap<u64, Entry>,
    /// Number of connections from each part of the network at each robot, without those that were asked to close.
    counts: HashMap<(usize, Prefix), Arc<AtomicUsize>>,
    /// Number of connections that were not asked to close.
    staying: usize,
}

#[derive(Debug)]
struct Entry {
    peer: Peer,
    hang_up: Arc<Notify>,
    /// The counts that include this connection: of its network, then of its host. Empty if the connection was asked to close, or if
    /// its address is not known.
    counted: Vec<((usize, Prefix), Arc<AtomicUsize>)>,
    leaving: bool,
}

impl Entry {
    /// Returns the numbers of connections from the same network and from the same host, including this one.
    fn weight(&self) -> [usize; 2] {
        let count = |at: usize| self.counted.get(at).map_or(1, |(_, count)| count.load(Ordering::Relaxed));
        [count(0), count(1)]
    }
}

impl Default for Newcomers {
    fn default() -> Self {
        // Other connections and files need descriptors as well.
        let files = getrlimit(Resource::Nofile).current.unwrap_or(u64::MAX) / 2;
        Self::of(usize::try_from(files).unwrap_or(usize::MAX).min(NEWCOMERS_MAX))
    }
}

impl Newcomers {
    fn of(most: usize) -> Self {
        Self { most, waiting: Mutex::default() }
    }

    /// Admits a new connection to a robot. If they are too many, asks another one to close, and returns its peer as well. Returns `None`
    /// if too many connections that were asked to close have not yet done so.
    pub(crate) fn admit(
        self: &Arc<Self>,
        robot: usize,
        peer: &Peer,
        hang_up: &Arc<Notify>,
    ) -> Option<(Newcomer, Option<Peer>)> {
        let mut waiting = self.lock();
        if waiting.all.len() >= 2 * self.most {
            return None;
        }
        let id = waiting.add(robot, peer, hang_up);
        let gives_way = if waiting.staying > self.most { waiting.close_one() } else { None };
        Some((Newcomer { newcomers: Arc::clone(self), id }, gives_way))
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Waiting {
    fn add(&mut self, robot: usize, peer: &Peer, hang_up: &Arc<Notify>) -> u64 {
        let mut counted = |prefix: Prefix| {
            let key = (robot, prefix);
            let count = Arc::clone(self.counts.entry(key).or_default());
            count.fetch_add(1, Ordering::Relaxed);
            (key, count)
        };
        let counted = peer.prefixes().into_iter().flatten().map(&mut counted).collect();
        self.last += 1;
        self.staying += 1;
        let entry = Entry { peer: peer.clone(), hang_up: Arc::clone(hang_up), counted, leaving: false };
        self.all.insert(self.last, entry);
        self.last
    }

    /// Asks one connection to close: the oldest one of the host with most connections, in the network with most connections.
    fn close_one(&mut self) -> Option<Peer> {
        let staying = self.all.iter_mut().filter(|(_, entry)| !entry.leaving);
        let (_, heaviest) = staying.max_by_key(|(id, entry)| (entry.weight(), std::cmp::Reverse(**id)))?;
        heaviest.leaving = true;
        heaviest.hang_up.notify_one();
        let (peer, counted) = (heaviest.peer.clone(), std::mem::take(&mut heaviest.counted));
        self.no_longer(counted);
        Some(peer)
    }

    fn no_longer(&mut self, counted: Vec<((usize, Prefix), Arc<AtomicUsize>)>) {
        self.staying -= 1;
        for (key, count) in counted {
            if count.fetch_sub(1, Ordering::Relaxed) == 1 {
                self.counts.remove(&key);
            }
        }
    }
}

/// A new connection. It is no longer new once this value is dropped.
#[derive(Debug)]
pub(crate) struct Newcomer {
    newcomers: Arc<Newcomers>,
    id: u64,
}

impl Drop for Newcomer {
    fn drop(&mut self) {
        let mut waiting = self.newcomers.lock();
        if let Some(entry) = waiting.all.remove(&self.id).filter(|entry| !entry.leaving) {
            waiting.no_longer(entry.counted);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peer(address: &str) -> Peer {
        Peer::at(format!("{address}:1000").parse().unwrap())
    }

    /// Admits a connection from each of these addresses, and returns the addresses whose connections give way.
    fn closed(newcomers: &Arc<Newcomers>, robot: usize, addresses: &[&str]) -> (Vec<Newcomer>, Vec<String>) {
        let mut admitted = Vec::new();
        let mut closed = Vec::new();
        for address in addresses {
            let (newcomer, gives_way) = newcomers.admit(robot, &peer(address), &Arc::default()).unwrap();
            admitted.push(newcomer);
            closed.extend(gives_way.and_then(|peer| peer.address()).map(|at| at.ip().to_string()));
        }
        (admitted, closed)
    }

    #[test]
    fn host_with_most_connections_loses_one() {
        let newcomers = Arc::new(Newcomers::of(20));
        let (_first, none) =
            closed(&newcomers, 0, &["192.0.2.1", "198.51.100.7", "198.51.100.7", "203.0.113.1"]);
        assert!(none.is_empty());
        let (_flood, gone) = closed(&newcomers, 0, &["198.51.100.7"; 36]);
        assert_eq!(gone, ["198.51.100.7"; 20]);
    }

    #[test]
    fn network_with_most_connections_loses_one() {
        let newcomers = Arc::new(Newcomers::of(4));
        let (_first, _) =
            closed(&newcomers, 0, &["192.0.2.1", "198.51.100.1", "198.51.100.2", "198.51.100.3"]);
        let (_more, gone) = closed(&newcomers, 0, &["198.51.100.4", "198.51.100.5", "203.0.113.1"]);
        assert_eq!(gone, ["198.51.100.1", "198.51.100.2", "198.51.100.3"]);
        let newcomers = Arc::new(Newcomers::of(4));
        let (_first, _) = closed(
            &newcomers,
            0,
            &["[2001:db8::1]", "[2001:db8:1:1::1]", "[2001:db8:1:2::1]", "[2001:db8:1:1::2]"],
        );
        let (_more, gone) = closed(&newcomers, 0, &["[2001:db8:1:3::1]"]);
        assert_eq!(gone, ["2001:db8:1:1::1"], "two addresses of one /64 are one host");
    }

    #[test]
    fn oldest_connection_of_unknown_origin_is_closed() {
        let newcomers = Arc::new(Newcomers::of(2));
        let (_first, _) = closed(&newcomers, 0, &["127.0.0.1", "127.0.0.1"]);
        let hang_up = Arc::<Notify>::default();
        let (_hidden, gone) = newcomers.admit(0, &Peer::through("zenoh:a1.7"), &hang_up).unwrap();
        assert_eq!(gone, Some(peer("127.0.0.1")));
    }

    #[test]
    fn connections_of_a_host_are_counted_per_robot() {
        let newcomers = Arc::new(Newcomers::of(4));
        // One operator connects to three robots, while someone else opens two connections to one robot.
        let (_other, _) = closed(&newcomers, 0, &["198.51.100.7"]);
        let _operator: Vec<_> = (0..3).map(|robot| closed(&newcomers, robot, &["192.0.2.1"])).collect();
        let (_flood, gone) = closed(&newcomers, 0, &["198.51.100.7", "198.51.100.7"]);
        assert_eq!(gone, ["198.51.100.7", "198.51.100.7"]);
    }

    #[test]
    fn number_of_closing_newcomers_is_limited() {
        let newcomers = Arc::new(Newcomers::of(2));
        let (admitted, _) = closed(&newcomers, 0, &["192.0.2.1"; 4]);
        let one = || newcomers.admit(0, &peer("192.0.2.1"), &Arc::default());
        assert!(one().is_none());
        drop(admitted);
        assert!(one().is_some());
        assert!(newcomers.lock().counts.is_empty(), "nothing is left of closed connections");
    }
}
