//! Tests which connections have a place, and which are closed for others.

use super::*;

/// Returns the places of a robot. A connection may be closed for another one as soon as it is silent.
fn places(host: &Host) -> Arc<Places> {
    Places::new(host.handle(), 0, Duration::ZERO).unwrap()
}

/// Admits one connection from each of `count` remote hosts.
fn tickets(places: &Arc<Places>, count: usize) -> Vec<Ticket> {
    let peer = |i| Remote::at(format!("192.0.2.{}:1000", i + 1).parse().unwrap());
    (0..count).map(|i| places.admit(&peer(i)).unwrap()).collect()
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
async fn of_connections_with_a_place_the_one_that_was_not_heard_for_longest_gives_way() {
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
async fn a_connection_that_has_its_place_keeps_it_and_takes_no_second_one() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let places = places(&host);
    let tickets = tickets(&places, PLACES);
    for ticket in tickets.iter().chain(&tickets) {
        ticket.take(false).await;
    }
    assert_eq!(hung_up(&tickets).await, [0_usize; 0]);
}

#[tokio::test]
async fn beyond_all_connections_the_oldest_without_a_place_gives_way_once_it_is_not_young() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let (places, begun) = (places(&host), now());
    let tickets = tickets(&places, CONNECTIONS_MAX);
    tickets[0].take(false).await;
    tickets[1].spoke(None);
    let late = Remote::at("192.0.2.200:1000".parse().unwrap());
    let refused = places.admit(&late).is_none();
    assert!(refused || begun.elapsed() >= Duration::from_millis(50), "all others are as new");
    tokio::time::sleep(Duration::from_millis(60)).await;
    let admitted = places.admit(&late);
    assert!(admitted.is_some());
    // A connection without a message is closed before a connection with a message. A connection with a place is closed last.
    assert_eq!(hung_up(&tickets).await, [2]);
}

#[tokio::test]
async fn connections_that_are_told_to_go_and_do_not_are_not_joined_by_ever_more() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let places = places(&host);
    let one_host = || places.admit(&Remote::at("192.0.2.7:1000".parse().unwrap()));
    let taken: Vec<_> = std::iter::repeat_with(one_host).map_while(|ticket| ticket).take(1_000).collect();
    assert_eq!(taken.len(), 2 * CONNECTIONS_MAX);
    drop(taken);
    assert!(one_host().is_some(), "they have gone");
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
async fn a_connection_stands_to_the_robot_as_the_session_that_it_speaks_for() {
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
async fn the_places_that_are_kept_for_the_owner_are_for_its_connections_alone() {
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
