//! Tests which connections have a place, and which are closed for others.

use super::*;
use crate::serve::places::STOP_CONNECTIONS_MAX;
use urrcp::{Label, Proof, Role};

/// Returns the places of a robot. A connection may be closed for another one as soon as it is silent.
fn places(host: &Host) -> Arc<Places> {
    Places::new(host.handle(), 0, Duration::ZERO).unwrap()
}

fn at(address: &str) -> Remote {
    Remote::at(format!("{address}:1000").parse().unwrap())
}

/// Establishes a connection of this peer.
fn established(places: &Arc<Places>, peer: &Remote) -> Ticket {
    let ticket = places.admit(peer).unwrap();
    ticket.establish(peer);
    ticket
}

/// Establishes one connection from each of `count` remote hosts.
fn tickets(places: &Arc<Places>, count: usize) -> Vec<Ticket> {
    (0..count).map(|i| established(places, &at(&format!("192.0.2.{}", i + 1)))).collect()
}

/// Returns a peer that has proven this name and role.
fn proven(address: &str, name: &str, role: Role) -> Remote {
    let roles = [role].into_iter().collect();
    at(address).with_proof(Proof { name: Label::new(name).unwrap(), roles, serial: None })
}

/// Returns the indices of the connections that were asked to close.
async fn hung_up(tickets: &[Ticket]) -> Vec<usize> {
    let mut gone = Vec::new();
    for (i, ticket) in tickets.iter().enumerate() {
        if tokio::time::timeout(Duration::ZERO, ticket.hung_up()).await.is_ok() {
            gone.push(i);
        }
    }
    gone
}

#[tokio::test]
async fn connection_silent_for_longest_loses_its_place_first() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let places = places(&host);
    let tickets = tickets(&places, PLACES + 1);
    for ticket in &tickets[..PLACES] {
        ticket.take(false).await;
    }
    tickets[0].heard();
    tickets[1].spoke(None);
    tickets[PLACES].take(false).await;
    assert_eq!(hung_up(&tickets).await, [2]);
    assert_eq!(host.refusals().count(Reason::MadeRoom), 1);
}

#[tokio::test]
async fn connection_keeps_its_place_and_takes_no_second_one() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let places = places(&host);
    let tickets = tickets(&places, PLACES);
    for ticket in tickets.iter().chain(&tickets) {
        ticket.take(false).await;
    }
    assert_eq!(hung_up(&tickets).await, [0_usize; 0]);
}

#[tokio::test]
async fn oldest_connection_without_a_place_is_closed_for_a_new_one() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let places = places(&host);
    let tickets = tickets(&places, CONNECTIONS_MAX);
    tickets[0].take(false).await;
    tickets[1].spoke(None);
    let _late = established(&places, &at("192.0.2.200"));
    // A connection without a message is closed before a connection with a message. A connection with a place is closed last.
    assert_eq!(hung_up(&tickets).await, [2]);
}

#[tokio::test]
async fn flood_closes_only_connections_of_its_own_network() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let places = places(&host);
    let other = established(&places, &at("198.51.100.1"));
    let flood: Vec<_> =
        (0..100).map(|i| established(&places, &at(&format!("192.0.2.{}", i % 250)))).collect();
    assert_eq!(hung_up(&flood).await.len(), 101 - CONNECTIONS_MAX);
    assert_eq!(hung_up(&[other]).await, [0_usize; 0]);
}

#[tokio::test]
async fn operator_on_many_hosts_closes_only_its_own_connections() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let places = places(&host);
    let other = established(&places, &proven("192.0.2.1", "berta", Role::Observe));
    let from = |i| proven(&format!("10.0.{i}.1"), "anna", Role::Observe);
    let flood: Vec<_> = (0..100).map(|i| established(&places, &from(i))).collect();
    assert_eq!(hung_up(&flood).await.len(), 101 - CONNECTIONS_MAX);
    assert_eq!(hung_up(&[other]).await, [0_usize; 0]);
}

#[tokio::test]
async fn connections_of_peers_with_role_stop_are_reserved() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let places = places(&host);
    let of = |role, from: usize, count| {
        (from..from + count)
            .map(|i| established(&places, &proven(&format!("10.0.{i}.1"), &format!("p{i}"), role)))
            .collect::<Vec<_>>()
    };
    let stopping = of(Role::Stop, 0, STOP_CONNECTIONS_MAX);
    let _observing = of(Role::Observe, 100, 2 * CONNECTIONS_MAX);
    assert_eq!(hung_up(&stopping).await, [0_usize; 0]);
    let _more = of(Role::Stop, 50, 2);
    assert_eq!(hung_up(&stopping).await, [0, 1], "they are limited themselves");
}

#[tokio::test]
async fn number_of_closing_connections_is_limited() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let places = places(&host);
    let most = 2 * (CONNECTIONS_MAX + STOP_CONNECTIONS_MAX);
    let from = |i: usize| at(&format!("10.0.{}.1", i % 250));
    let tickets: Vec<_> = (0..most + 3).map(|i| established(&places, &from(i))).collect();
    let last: Vec<_> = hung_up(&tickets).await.into_iter().filter(|i| *i >= most).collect();
    assert_eq!(last, [most, most + 1, most + 2]);
}

/// Claims the robot from within this process. The claim lasts until the link is dropped.
async fn claimed(host: &Host) -> (crate::host::RobotLink, crate::parties::Claimant) {
    let mut link = host.handle().connect(0).unwrap();
    let session = urrcp::SessionId::new("show").unwrap();
    let claim = urrcp::AvailabilityRequest { session: Some(session.clone()), ..Default::default() };
    link.send(Message::AvailabilityRequest(claim));
    link.recv().await.unwrap();
    (link, crate::parties::Claimant { session, peer: None })
}

#[tokio::test]
async fn standing_of_a_connection_is_that_of_its_session() {
    use crate::hardware::Standing;
    use crate::parties::Claimant;
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let ticket = tickets(&places(&host), 1).remove(0);
    let of = |session: &str| Claimant { session: urrcp::SessionId::new(session).unwrap(), peer: None };
    assert_eq!(ticket.standing(Some(&of("show"))), Standing::Free);
    let (_link, owner) = claimed(&host).await;
    assert_eq!(ticket.standing(Some(&owner)), Standing::Owner);
    assert_eq!(ticket.standing(Some(&of("other"))), Standing::Stranger);
    assert_eq!(ticket.standing(None), Standing::Stranger);
    // A task that waits for the claim continues at once.
    ticket.await_claim(&owner, Duration::from_secs(3_600)).await;
}

#[tokio::test]
async fn places_reserved_for_the_owner_are_used_only_by_its_connections() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let places = Places::new(host.handle(), 0, Duration::from_secs(3_600)).unwrap();
    let (_link, owner) = claimed(&host).await;
    let tickets = tickets(&places, PLACES + OWNER_PLACES + 2);
    for ticket in &tickets[..PLACES] {
        ticket.take(false).await;
    }
    let waits = async |ticket: &Ticket, claims| {
        tokio::time::timeout(Duration::from_millis(20), ticket.take(claims)).await.is_err()
    };
    assert!(waits(&tickets[PLACES], true).await, "a stranger, whatever it claims");
    for ticket in &tickets[PLACES..PLACES + OWNER_PLACES] {
        ticket.spoke(Some(&owner));
        assert!(!waits(ticket, false).await);
    }
    assert_eq!(hung_up(&tickets).await, [0_usize; 0]);
    tickets[PLACES + OWNER_PLACES].spoke(Some(&owner));
    assert!(!waits(&tickets[PLACES + OWNER_PLACES], false).await);
    assert_eq!(hung_up(&tickets).await, [0], "a stranger makes room for the owner");
}
