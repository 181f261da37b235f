//! Tests a robot behind a real socket on the loopback interface.

mod places;
#[cfg(feature = "sealed")]
mod sealed_door;

use std::collections::BTreeSet;

use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use urrcp::{Command, Decoder, Encoding, Message, Status, encode, encode_as};

use super::connection::{FREE_LINE_MAX, STRANGERS_LINE_MAX};
use super::places::{CONNECTIONS_MAX, OWNER_PLACES, PLACES};
use super::*;
use crate::host::tests::{LEAD_MS, LogFile, arms, arms_with_steps, paper};
use crate::host::{Host, HostOptions};
use crate::peer::Peer as Remote;
use crate::refusals::Reason;
use crate::simulated::Settings;

/// Maximum time to wait for an event that must occur, however busy the machine is.
const PATIENCE: Duration = Duration::from_secs(60);

/// Starts a robot that is reachable over TCP. Returns its host and its address.
async fn served(log: &LogFile) -> (Host, SocketAddr) {
    let options = HostOptions { log: Some(log.0.clone()), ..HostOptions::default() };
    served_as(Host::start(arms(1, &Settings::default()), options).unwrap(), PATIENT).await
}

/// Maximum time in which the robot decides on a claim, however busy the machine is. A line that follows a refused claim has to wait this
/// long.
const CLAIM_WITHIN: Duration = Duration::from_secs(10);

/// Generous time limits for tests that do not test the time limits.
const PATIENT: Patience =
    Patience { silence: PATIENCE, first_message: PATIENCE, message: PATIENCE, claim: CLAIM_WITHIN };

/// Waits until a condition is true.
async fn until(is_so: impl Fn() -> bool) {
    let waiting = async {
        while !is_so() {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    tokio::time::timeout(PATIENCE, waiting).await.unwrap();
}

async fn served_as(host: Host, patience: Patience) -> (Host, SocketAddr) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    tokio::spawn(serve_with(listener, host.handle(), 0, patience, Door::Open));
    (host, address)
}

/// A server's end of a connection to the robot. It reads whole lines.
struct Peer(BufReader<TcpStream>);

impl Peer {
    async fn connected(address: SocketAddr) -> Self {
        Self(BufReader::new(TcpStream::connect(address).await.unwrap()))
    }

    /// Returns a peer that has claimed the robot.
    async fn owner(address: SocketAddr) -> Self {
        let mut owner = Self::connected(address).await;
        owner.write(CLAIM).await;
        owner.soon().await;
        owner
    }

    async fn write(&mut self, bytes: &[u8]) {
        self.0.get_mut().write_all(bytes).await.unwrap();
    }

    async fn send(&mut self, message: &Message) {
        let mut line = Vec::new();
        encode(message, &mut line);
        self.write(&line).await;
    }

    async fn read(&mut self) -> Message {
        let mut line = String::new();
        self.0.read_line(&mut line).await.unwrap();
        serde_json::from_str(&line).unwrap()
    }
}

#[tokio::test]
async fn script_over_tcp_reports_its_progress_and_sets_values_in_order() {
    let log = LogFile::new("tcp");
    let (host, address) = served(&log).await;
    let mut peer = Peer::connected(address).await;
    peer.send(&paper(LEAD_MS)).await;
    for expected in [Status::Accepted, Status::Started, Status::Ok] {
        let Message::ControlResponse(response) = peer.read().await else { panic!() };
        assert_eq!(response.status, expected);
    }
    host.stop();
    let lines = log.lines();
    let values: Vec<_> = lines.iter().map(|line| line["value"].as_f64().unwrap()).collect();
    assert_eq!(values, [45.0, 0.0, 45.0]);
    assert!(lines.iter().all(|line| line["set_at"].as_str() >= line["due"].as_str()), "never early");
}

#[tokio::test]
async fn garbage_is_answered_and_the_connection_stays_open() {
    let log = LogFile::new("garbage");
    let (_host, address) = served(&log).await;
    let mut peer = Peer::connected(address).await;
    peer.write(b"\xff\xfe\nnonsense\n{\"control_request\": {\"device_id\": \"arm\"}}\n").await;
    for _ in 0..2 {
        let Message::AvailabilityResponse(response) = peer.read().await else { panic!() };
        assert_eq!(response.status, Status::Failed);
    }
    let Message::ControlResponse(response) = peer.read().await else { panic!() };
    assert_eq!(response.error.map(|error| error.code), Some(urrcp::ErrorCode::Malformed));
    peer.write(b"{\"availability_request\": {}}\n").await;
    let Message::AvailabilityResponse(response) = peer.read().await else { panic!() };
    assert_eq!(response.status, Status::Ok);
}

/// A server's end of a connection to the robot. It reads messages in any encoding.
struct Listener {
    stream: TcpStream,
    decoder: Decoder,
}

impl Listener {
    async fn send(&mut self, encoding: Encoding, message: &Message) {
        let mut bytes = Vec::new();
        encode_as(encoding, message, &mut bytes);
        self.stream.write_all(&bytes).await.unwrap();
    }

    async fn read(&mut self) -> (Encoding, Message) {
        loop {
            if let Some(decoded) = self.decoder.next_message() {
                return (self.decoder.encoding(), decoded.unwrap());
            }
            let mut bytes = [0; 1024];
            let n = self.stream.read(&mut bytes).await.unwrap();
            self.decoder.push(&bytes[..n]);
        }
    }
}

#[tokio::test]
async fn robot_answers_in_the_encoding_of_the_last_received_message() {
    let log = LogFile::new("encodings");
    let (_host, address) = served(&log).await;
    let stream = TcpStream::connect(address).await.unwrap();
    let mut peer = Listener { stream, decoder: Decoder::default() };
    let describe = Message::InitializationRequest(urrcp::InitializationRequest::default());
    for encoding in [Encoding::Json, Encoding::MessagePack, Encoding::MessagePack, Encoding::Json] {
        peer.send(encoding, &describe).await;
        let (answered, Message::InitializationBlock(block)) = peer.read().await else { panic!() };
        assert_eq!(answered, encoding);
        assert!(block.understands(Encoding::MessagePack));
    }
    peer.send(Encoding::MessagePack, &paper(LEAD_MS)).await;
    for expected in [Status::Accepted, Status::Started, Status::Ok] {
        let (answered, Message::ControlResponse(response)) = peer.read().await else { panic!() };
        assert_eq!((answered, response.status), (Encoding::MessagePack, expected));
    }
    // The robot answers a frame that is not a message with a frame, and reads the following frame.
    peer.stream.write_all(b"\xC1\x00\x00\x00\x02\x91\x00").await.unwrap();
    let (answered, Message::AvailabilityResponse(response)) = peer.read().await else { panic!() };
    assert_eq!((answered, response.status), (Encoding::MessagePack, Status::Failed));
    peer.send(Encoding::Json, &describe).await;
    assert!(matches!(peer.read().await, (Encoding::Json, Message::InitializationBlock(_))));
}

#[tokio::test]
async fn peer_that_sends_without_reading_affects_only_itself() {
    let log = LogFile::new("flood");
    let (_host, address) = served(&log).await;
    let mut flood = TcpStream::connect(address).await.unwrap();
    let lines = b"{\"initialization_request\": {}}\n".repeat(1_000);
    let flooding = tokio::spawn(async move {
        // Ends when the robot no longer reads, because its responses are not read.
        while flood.write_all(&lines).await.is_ok() {}
    });
    let mut peer = Peer::connected(address).await;
    for _ in 0..50 {
        peer.write(b"{\"availability_request\": {}}\n").await;
        assert!(matches!(peer.read().await, Message::AvailabilityResponse(_)));
    }
    flooding.abort();
}

/// Returns [`PLACES`] peers that have a place and have received a response.
async fn all_places_taken(address: SocketAddr) -> Vec<Peer> {
    let mut peers = Vec::new();
    for _ in 0..PLACES {
        let mut peer = Peer::connected(address).await;
        peer.write(INQUIRE).await;
        peer.read().await;
        peers.push(peer);
    }
    peers
}

fn is_accepted(message: &Message) -> bool {
    matches!(message, Message::ControlResponse(response) if response.status == Status::Accepted)
}

#[tokio::test]
async fn connection_beyond_the_limit_waits_for_a_place() {
    let log = LogFile::new("limit");
    let (_host, address) = served(&log).await;
    let mut peers = all_places_taken(address).await;
    let mut waiting = Peer::connected(address).await;
    waiting.send(&paper(60_000.0)).await;
    let answer = tokio::time::timeout(Duration::from_millis(100), waiting.read()).await;
    assert!(answer.is_err(), "obeyed although {PLACES} others are connected");
    peers.pop();
    assert!(is_accepted(&waiting.read().await), "obeyed once one has gone");
}

#[tokio::test]
async fn peer_that_claims_a_free_robot_has_priority_over_those_that_do_not() {
    let log = LogFile::new("claim");
    let (host, address) = served(&log).await;
    let _peers = all_places_taken(address).await;
    let mut claiming = Peer::connected(address).await;
    claiming.write(CLAIM).await;
    let Message::AvailabilityResponse(response) = claiming.soon().await else { panic!() };
    assert_eq!(response.status, Status::Ok);
    assert_eq!(host.refusals().count(Reason::MadeRoom), 0, "it has a place that is kept for this");
}

const ASK: &[u8] = b"{\"availability_request\": {}}\n";
/// An inquiry that needs a place, because it is about commands.
const INQUIRE: &[u8] = b"{\"inquiry\": {}}\n";
const CLAIM: &[u8] = b"{\"availability_request\": {\"session\": \"show\"}}\n";

impl Peer {
    /// Reads the next message, with a generous time limit.
    async fn soon(&mut self) -> Message {
        tokio::time::timeout(PATIENCE, self.read()).await.unwrap()
    }

    /// Whether the robot closes the connection without a further message.
    async fn is_hung_up_on(&mut self) -> bool {
        let mut line = String::new();
        let ended = tokio::time::timeout(PATIENCE, self.0.read_line(&mut line)).await;
        matches!(ended, Ok(Ok(0) | Err(_)))
    }
}

fn with_session(message: Message, session: &str) -> Message {
    let Message::ControlRequest(request) = message else { panic!() };
    let session = urrcp::SessionId::new(session).ok();
    Message::ControlRequest(urrcp::ControlRequest { session, ..request })
}

#[tokio::test]
async fn strangers_that_hold_all_places_cannot_block_owner_or_its_stop() {
    let log = LogFile::new("owner-first");
    let (host, address) = served(&log).await;
    let first = Peer::owner(address).await;
    // The owner's connection breaks. Strangers take all places and connections, and keep sending.
    drop(first);
    let mut strangers = Vec::new();
    for _ in 0..CONNECTIONS_MAX + 8 {
        let mut stranger = Peer::connected(address).await;
        stranger.write(INQUIRE).await;
        stranger.write(b"{").await;
        strangers.push(stranger);
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    let mut owners = Vec::new();
    for i in 0..8 {
        let mut owner = Peer::connected(address).await;
        owner.write(CLAIM).await;
        let Message::AvailabilityResponse(response) = owner.soon().await else { panic!() };
        assert_eq!(response.status, Status::Ok, "{i}");
        owners.push(owner);
    }
    owners[7].send(&with_session(paper(60_000.0), "show")).await;
    assert!(is_accepted(&owners[7].soon().await));
    let device = urrcp::DeviceId::new("arm").unwrap();
    let stop = urrcp::ControlRequest::immediate(device, Command::Script(urrcp::Script::cancel()));
    let mut stopping = Peer::connected(address).await;
    stopping.send(&with_session(Message::ControlRequest(stop), "show")).await;
    let Message::ControlResponse(response) = stopping.soon().await else { panic!() };
    assert_eq!(response.status, Status::Failed, "its script is cancelled, and it hears that");
    assert!(host.refusals().count(Reason::MadeRoom) >= 4, "{:?}", host.refusals());
}

#[tokio::test]
async fn connection_without_a_valid_message_in_time_is_closed() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    // The limit is long enough for peers that send a message in time, however busy the machine is.
    let patience = Patience { first_message: Duration::from_secs(4), ..PATIENT };
    let (host, address) = served_as(host, patience).await;
    let mut silent = Peer::connected(address).await;
    let mut noisy = Peer::connected(address).await;
    noisy.write(b"noise\n").await;
    noisy.soon().await;
    let mut talking = Peer::connected(address).await;
    talking.write(ASK).await;
    talking.soon().await;
    let dripping = Peer::connected(address).await;
    let (mut reader, mut writer) = dripping.0.into_inner().into_split();
    let drip = tokio::spawn(async move {
        while writer.write_all(b"{").await.is_ok() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    });
    let ended = tokio::time::timeout(PATIENCE, reader.read(&mut [0; 8])).await;
    assert!(matches!(ended, Ok(Ok(0) | Err(_))), "{ended:?}");
    assert!(silent.is_hung_up_on().await && noisy.is_hung_up_on().await);
    drip.await.unwrap();
    talking.write(ASK).await;
    talking.soon().await;
    assert_eq!(host.refusals().count(Reason::SaidNothing), 3);
}

#[tokio::test]
async fn stranger_must_finish_each_message_in_time_and_owner_need_not() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let patience = Patience { message: Duration::from_millis(200), ..PATIENT };
    let (host, address) = served_as(host, patience).await;
    let mut owner = Peer::owner(address).await;
    owner.write(&CLAIM[..20]).await;
    let mut stranger = Peer::connected(address).await;
    stranger.write(ASK).await;
    stranger.soon().await;
    stranger.write(&ASK[..20]).await;
    assert!(stranger.is_hung_up_on().await);
    assert_eq!(host.refusals().count(Reason::HalfAMessage), 1);
    owner.write(&CLAIM[20..]).await;
    owner.soon().await;
}

#[tokio::test]
async fn one_host_cannot_use_more_than_its_share_of_the_connections() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let places = Places::new(host.handle(), 0, Duration::from_secs(30)).unwrap();
    let admitted = |address: &str| {
        let peer = Remote::at(address.parse().unwrap());
        let ticket = places.admit(&peer).unwrap();
        ticket.establish(&peer);
        ticket
    };
    let other = admitted("192.0.2.8:1000");
    other.spoke(None);
    let tickets: Vec<_> = (0..100).map(|i| admitted(&format!("192.0.2.7:{}", 1_000 + i))).collect();
    assert_eq!(host.refusals().count(Reason::ManyFromOneHost), 100 - 16);
    let hung_up = tokio::time::timeout(Duration::ZERO, other.hung_up()).await;
    assert!(hung_up.is_err(), "another host's connection stands");
    // The oldest connections of this remote host are closed first.
    for (i, ticket) in tickets.iter().enumerate() {
        let hung_up = tokio::time::timeout(Duration::ZERO, ticket.hung_up()).await;
        assert_eq!(hung_up.is_ok(), i < 100 - 16, "{i}");
    }
}

#[tokio::test]
async fn dead_connections_of_the_owner_release_their_places() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let patience = Patience { silence: Duration::from_millis(300), ..PATIENT };
    let (_host, address) = served_as(host, patience).await;
    let mut connections = Vec::new();
    for _ in 0..PLACES + OWNER_PLACES + 2 {
        let owner = Peer::owner(address).await;
        connections.push(owner);
    }
}

/// Returns the line, padded with leading blanks to `bytes` bytes.
fn padded(line: &[u8], bytes: usize) -> Vec<u8> {
    let mut padded = vec![b' '; bytes - line.len()];
    padded.extend_from_slice(line);
    padded
}

fn malformed(message: &Message) -> Option<&str> {
    let Message::AvailabilityResponse(response) = message else { panic!("{message:?}") };
    response.error.as_ref().map(|error| error.message.as_str())
}

/// Maximum number of steps of a robot's script. With this number, the longest permitted script exceeds every line in these tests.
const MANY_STEPS: u32 = 100_000;

#[tokio::test]
async fn line_length_limit_depends_on_the_owner_of_the_robot() {
    let robots = arms_with_steps(1, MANY_STEPS, &Settings::default());
    let (host, address) = served_as(Host::start(robots, HostOptions::default()).unwrap(), PATIENT).await;
    let mut stranger = Peer::connected(address).await;
    for length in [FREE_LINE_MAX, 3 * FREE_LINE_MAX, 3 * FREE_LINE_MAX] {
        stranger.write(&padded(ASK, length)).await;
        assert_eq!(malformed(&stranger.soon().await), None);
    }
    // The first owner sends its claim and a long line at once.
    let mut owner = Peer::connected(address).await;
    let mut bytes = CLAIM.to_vec();
    bytes.extend(padded(ASK, 3 * FREE_LINE_MAX));
    owner.write(&bytes).await;
    for _ in 0..2 {
        assert_eq!(malformed(&owner.soon().await), None);
    }
    stranger.write(&padded(ASK, STRANGERS_LINE_MAX)).await;
    assert_eq!(malformed(&stranger.soon().await), None);
    stranger.write(&padded(ASK, STRANGERS_LINE_MAX + 2)).await;
    assert_eq!(malformed(&stranger.soon().await), Some("the line is too long, expected at most 65536 bytes"));
    // A refused claim permits no longer line.
    stranger.write(b"{\"availability_request\": {\"session\": \"other\"}}\n").await;
    stranger.write(&padded(ASK, STRANGERS_LINE_MAX + 2)).await;
    assert_eq!(
        malformed(&stranger.soon().await),
        Some("`r0` belongs to another session until that session ends")
    );
    assert_eq!(malformed(&stranger.soon().await), Some("the line is too long, expected at most 65536 bytes"));
    // Once the session is over, the robot is free again, even if no other session has claimed it since.
    drop(owner);
    until(|| host.figures().robots()[0].connections() == 1).await;
    stranger.write(&padded(ASK, STRANGERS_LINE_MAX + 2)).await;
    assert_eq!(malformed(&stranger.soon().await), None);
}

#[tokio::test]
async fn free_robot_reads_at_most_two_long_lines_at_a_time() {
    let robots = arms_with_steps(1, MANY_STEPS, &Settings::default());
    let host = Host::start(robots, HostOptions::default()).unwrap();
    let patience = Patience { message: Duration::from_millis(500), ..PATIENT };
    let (host, address) = served_as(host, patience).await;
    let mut peers = Vec::new();
    for _ in 0..2 {
        let mut peer = Peer::connected(address).await;
        peer.write(&vec![b' '; 2 * FREE_LINE_MAX]).await;
        peers.push(peer);
    }
    let strangers = host.handle().strangers();
    until(|| strangers.long_lines_left() == 0).await;
    let mut third = Peer::connected(address).await;
    let long = padded(ASK, 2 * FREE_LINE_MAX);
    third.write(&long).await;
    assert_eq!(malformed(&third.soon().await), Some("the line is too long, expected at most 1048576 bytes"));
    assert_eq!(host.refusals().count(Reason::LongLine), 1);
    drop(peers);
    until(|| strangers.long_lines_left() == 2).await;
    third.write(&long).await;
    assert_eq!(malformed(&third.soon().await), None);
}

#[tokio::test]
async fn free_robot_limits_strangers_lines_to_its_longest_command() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let (host, address) = served_as(host, PATIENT).await;
    let mut stranger = Peer::connected(address).await;
    stranger.write(&padded(ASK, FREE_LINE_MAX + 2)).await;
    assert_eq!(
        malformed(&stranger.soon().await),
        Some("the line is too long, expected at most 1048576 bytes")
    );
    assert_eq!(host.handle().strangers().long_lines_left(), 2);
}

#[tokio::test]
async fn long_line_waits_for_the_claim_before_it_on_a_slow_link() {
    let delay = Some((urrcp::Span::from_millis(200), urrcp::Span::from_millis(200)));
    let host = Host::start(arms(1, &Settings { delay, ..Settings::default() }), HostOptions::default());
    let (_host, address) = served_as(host.unwrap(), PATIENT).await;
    let mut owner = Peer::connected(address).await;
    let mut bytes = CLAIM.to_vec();
    bytes.extend(padded(ASK, 3 * FREE_LINE_MAX));
    owner.write(&bytes).await;
    for _ in 0..2 {
        assert_eq!(malformed(&owner.soon().await), None);
    }
}

#[tokio::test]
async fn flooding_strangers_are_throttled_and_the_owner_is_not() {
    let log = LogFile::new("flooded");
    let (host, address) = served(&log).await;
    let mut owner = Peer::owner(address).await;
    let owners = owner.0.get_ref().local_addr().unwrap().to_string();
    let (mut floods, mut addresses) = (Vec::new(), BTreeSet::new());
    for lines in
        [ASK.repeat(200), b"noise\n".repeat(1_000), b"{\"initialization_request\": {}}\n".repeat(200)]
    {
        for _ in 0..4 {
            let stream = TcpStream::connect(address).await.unwrap();
            addresses.insert(stream.local_addr().unwrap().to_string());
            let (mut reader, mut writer) = stream.into_split();
            let lines = lines.clone();
            floods.push(tokio::spawn(async move { while writer.write_all(&lines).await.is_ok() {} }));
            floods.push(tokio::spawn(async move {
                let mut bytes = vec![0; 65_536];
                while reader.read(&mut bytes).await.is_ok_and(|n| n > 0) {}
            }));
        }
    }
    // A stranger has to pause after a hundred messages. The owner's speed depends on the machine, but the owner never has to pause.
    let mut asked = 0;
    while asked < 500 || !addresses.is_subset(&host.refusals().peers(Reason::Paused)) {
        owner.write(CLAIM).await;
        assert!(malformed(&owner.soon().await).is_none());
        asked += 1;
        assert!(asked < 100_000, "{:?} of {addresses:?}", host.refusals().peers(Reason::Paused));
    }
    floods.iter().for_each(tokio::task::JoinHandle::abort);
    let paused = host.refusals().peers(Reason::Paused);
    assert!(!paused.contains(&owners), "the owner is read slowly");
}

#[tokio::test]
async fn stop_is_obeyed_even_when_all_connections_are_taken() {
    let log = LogFile::new("stop-beyond");
    let (_host, address) = served(&log).await;
    let mut peers = all_places_taken(address).await;
    peers[0].send(&paper(60_000.0)).await;
    assert!(is_accepted(&peers[0].read().await));
    // The peers also take all connections without a place, and send messages that wait.
    let mut beyond = Vec::new();
    for _ in 0..CONNECTIONS_MAX - PLACES {
        let mut peer = Peer::connected(address).await;
        peer.send(&paper(60_000.0)).await;
        beyond.push(peer);
    }
    let device = urrcp::DeviceId::new("arm").unwrap();
    let stop = urrcp::ControlRequest::immediate(device, Command::Script(urrcp::Script::cancel()));
    let mut stopping = Peer::connected(address).await;
    stopping.send(&Message::ControlRequest(stop)).await;
    let answer = tokio::time::timeout(PATIENCE, stopping.read()).await;
    let Ok(Message::ControlResponse(response)) = answer else { panic!("{answer:?}") };
    assert!(matches!(response.status, Status::Ok | Status::Accepted), "{response:?}");
}

#[tokio::test]
async fn long_silent_peer_is_replaced_by_a_waiting_one() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let patience = Patience { silence: Duration::from_secs(1), ..PATIENT };
    let (host, address) = served_as(host, patience).await;
    let hello = Message::AvailabilityRequest(urrcp::AvailabilityRequest::default());
    let mut peers = all_places_taken(address).await;
    let mut talking = peers.pop().unwrap();
    let mut waiting = Peer::connected(address).await;
    waiting.send(&paper(60_000.0)).await;
    let served = async {
        loop {
            talking.send(&hello).await;
            talking.read().await;
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    let answered = tokio::select! {
        () = served => None,
        answer = tokio::time::timeout(PATIENCE, waiting.read()) => answer.ok(),
    };
    assert!(answered.as_ref().is_some_and(is_accepted), "{answered:?}");
    host.stop();
}

#[tokio::test]
async fn connection_without_a_place_can_only_identify_and_stop_the_robot() {
    let log = LogFile::new("no-place");
    let (_host, address) = served(&log).await;
    let mut peers = all_places_taken(address).await;
    peers[0].send(&paper(60_000.0)).await;
    assert!(is_accepted(&peers[0].read().await));
    let device = || urrcp::DeviceId::new("arm").unwrap();
    let mut beyond = Peer::connected(address).await;
    beyond.write(ASK).await;
    assert!(matches!(beyond.soon().await, Message::AvailabilityResponse(_)));
    beyond.send(&Message::InitializationRequest(urrcp::InitializationRequest::default())).await;
    assert!(matches!(beyond.soon().await, Message::InitializationBlock(_)));
    let stop = urrcp::ControlRequest::immediate(device(), Command::Script(urrcp::Script::cancel()));
    beyond.send(&Message::ControlRequest(stop.clone())).await;
    let Message::ControlResponse(response) = beyond.soon().await else { panic!() };
    assert_eq!(response.status, Status::Ok);
    // Only an immediate stop needs no place.
    let later = urrcp::ControlRequest {
        timestamp: Some(urrcp::Timestamp::from_nanos(0)),
        time_offset_to_start: Some(urrcp::Millis::new(1.0).unwrap()),
        ..stop
    };
    let read = urrcp::ControlRequest::immediate(device(), Command::ReadSensor);
    for request in [later, read] {
        let mut waiting = Peer::connected(address).await;
        waiting.send(&Message::ControlRequest(request)).await;
        let answer = tokio::time::timeout(Duration::from_millis(100), waiting.read()).await;
        assert!(answer.is_err(), "{answer:?}");
    }
}

#[test]
fn listener_continues_after_transient_errors_and_ends_on_others() {
    use rustix::io::Errno;
    for passing in [Errno::CONNABORTED, Errno::MFILE, Errno::NFILE, Errno::NOBUFS] {
        assert!(is_passing(&passing.into()), "{passing}");
    }
    assert!(!is_passing(&Errno::BADF.into()) && !is_passing(&io::ErrorKind::InvalidInput.into()));
}

#[tokio::test]
async fn listener_ends_when_its_host_has_stopped() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let handle = host.handle();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let serving = tokio::spawn(serve(listener, handle.clone(), 0));
    assert!(!handle.has_stopped());
    host.stop();
    assert!(handle.has_stopped());
    let mut peer = Peer::connected(address).await;
    assert!(peer.is_hung_up_on().await);
    let ended = tokio::time::timeout(PATIENCE, serving).await;
    assert!(matches!(ended, Ok(Ok(Ok(())))), "{ended:?}");
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    serve(listener, handle, 9).await.unwrap();
}

#[cfg(feature = "tls")]
#[test]
fn altered_data_is_distinguished_from_tls_alerts_of_the_peer() {
    use rustls::{AlertDescription, Error};
    let of = |error: Error| io::Error::new(io::ErrorKind::InvalidData, error);
    assert!(is_altered(&of(Error::DecryptError)));
    assert!(!is_altered(&of(Error::AlertReceived(AlertDescription::CloseNotify))));
    assert!(!is_altered(&io::ErrorKind::ConnectionReset.into()));
    assert!(!is_altered(&io::Error::other("of something else")));
}

#[tokio::test]
async fn connection_acts_for_the_session_named_in_any_of_its_messages() {
    let log = LogFile::new("speaks-for");
    let (_host, address) = served(&log).await;
    let mut owner = Peer::connected(address).await;
    owner.send(&with_session(paper(60_000.0), "show")).await;
    assert!(is_accepted(&owner.soon().await));
    let mut asking = Peer::connected(address).await;
    let session = urrcp::SessionId::new("show").ok();
    asking.send(&Message::Inquiry(urrcp::Inquiry { session, ..urrcp::Inquiry::default() })).await;
    let Message::InquiryResponse(response) = asking.soon().await else { panic!() };
    assert_eq!(response.status, Status::Ok);
    let mut stranger = Peer::connected(address).await;
    for (peer, expected) in [
        (&mut owner, None),
        (&mut asking, None),
        (&mut stranger, Some("the line is too long, expected at most 65536 bytes")),
    ] {
        peer.write(&padded(ASK, STRANGERS_LINE_MAX + 2)).await;
        assert_eq!(malformed(&peer.soon().await), expected);
    }
}

#[tokio::test]
async fn long_script_is_compared_with_its_hash_like_a_short_one() {
    let log = LogFile::new("long-hash");
    let (_host, address) = served(&log).await;
    let mut owner = Peer::owner(address).await;
    let Message::ControlRequest(request) = with_session(paper(60_000.0), "show") else { panic!() };
    let hash = request.command.content_hash();
    let wrong = Command::ReadSensor.content_hash();
    for (content_hash, status) in [(wrong, Status::Failed), (hash, Status::Accepted)] {
        let request_id = urrcp::RequestId::new(content_hash.to_string()).ok();
        let request =
            urrcp::ControlRequest { content_hash: Some(content_hash), request_id, ..request.clone() };
        let mut line = Vec::new();
        encode(&Message::ControlRequest(request), &mut line);
        // The line exceeds the limit for reading it in the connection's own task.
        owner.write(&padded(&line, 100 * 1024)).await;
        let Message::ControlResponse(response) = owner.soon().await else { panic!() };
        assert_eq!(response.status, status, "{response:?}");
    }
}
