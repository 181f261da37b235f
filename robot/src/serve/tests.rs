//! A robot behind a real socket on the loopback interface.

use tokio::io::{AsyncBufReadExt, BufReader};
use urrcp::{Message, Status, encode};

use super::*;
use crate::host::tests::{LogFile, arms, paper};
use crate::host::{Host, HostOptions};
use crate::simulated::Settings;

/// A served robot and the address at which it listens.
async fn served(log: &LogFile) -> (Host, SocketAddr) {
    let options = HostOptions { log: Some(log.0.clone()), ..HostOptions::default() };
    let host = Host::start(arms(1, &Settings::default()), options).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    tokio::spawn(serve(listener, host.handle(), 0));
    (host, address)
}

/// A server's end of the connection, reading whole lines.
struct Peer(BufReader<TcpStream>);

impl Peer {
    async fn connected(address: SocketAddr) -> Self {
        Self(BufReader::new(TcpStream::connect(address).await.unwrap()))
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
async fn a_script_over_tcp_is_accepted_started_and_done_and_sets_its_values_in_order() {
    let log = LogFile::new("tcp");
    let (host, address) = served(&log).await;
    let mut peer = Peer::connected(address).await;
    peer.send(&paper(200.0)).await;
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
async fn garbage_is_answered_and_the_link_goes_on() {
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

/// A server's end of the connection that reads what comes in whichever encoding.
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
async fn a_robot_answers_in_the_encoding_of_what_it_heard_last() {
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
    peer.send(Encoding::MessagePack, &paper(200.0)).await;
    for expected in [Status::Accepted, Status::Started, Status::Ok] {
        let (answered, Message::ControlResponse(response)) = peer.read().await else { panic!() };
        assert_eq!((answered, response.status), (Encoding::MessagePack, expected));
    }
    // A frame that is no message is answered by a frame, and what follows it is read.
    peer.stream.write_all(b"\xC1\x00\x00\x00\x02\x91\x00").await.unwrap();
    let (answered, Message::AvailabilityResponse(response)) = peer.read().await else { panic!() };
    assert_eq!((answered, response.status), (Encoding::MessagePack, Status::Failed));
    peer.send(Encoding::Json, &describe).await;
    assert!(matches!(peer.read().await, (Encoding::Json, Message::InitializationBlock(_))));
}

#[tokio::test]
async fn a_peer_that_sends_without_reading_harms_only_itself() {
    let log = LogFile::new("flood");
    let (_host, address) = served(&log).await;
    let mut flood = TcpStream::connect(address).await.unwrap();
    let lines = b"{\"initialization_request\": {}}\n".repeat(1_000);
    let flooding = tokio::spawn(async move {
        // Ends when the robot no longer reads, since its answers are not read.
        while flood.write_all(&lines).await.is_ok() {}
    });
    let mut peer = Peer::connected(address).await;
    for _ in 0..50 {
        peer.write(b"{\"availability_request\": {}}\n").await;
        assert!(matches!(peer.read().await, Message::AvailabilityResponse(_)));
    }
    flooding.abort();
}

/// So many peers have a place and have been answered.
async fn all_places_taken(address: SocketAddr) -> Vec<Peer> {
    let mut peers = Vec::new();
    for _ in 0..PLACES {
        let mut peer = Peer::connected(address).await;
        peer.write(b"{\"availability_request\": {}}\n").await;
        peer.read().await;
        peers.push(peer);
    }
    peers
}

fn is_accepted(message: &Message) -> bool {
    matches!(message, Message::ControlResponse(response) if response.status == Status::Accepted)
}

#[tokio::test]
async fn no_more_than_the_limit_of_connections_is_obeyed_at_a_time() {
    let log = LogFile::new("limit");
    let (_host, address) = served(&log).await;
    let mut peers = all_places_taken(address).await;
    let mut waiting = Peer::connected(address).await;
    waiting.send(&paper(10_000.0)).await;
    let answer = tokio::time::timeout(Duration::from_millis(100), waiting.read()).await;
    assert!(answer.is_err(), "obeyed although {PLACES} others are connected");
    peers.pop();
    assert!(is_accepted(&waiting.read().await), "obeyed once one has gone");
}

#[tokio::test]
async fn no_connection_claims_a_robot_without_a_place() {
    let log = LogFile::new("claim");
    let (_host, address) = served(&log).await;
    let mut peers = all_places_taken(address).await;
    let mut waiting = Peer::connected(address).await;
    waiting.write(b"{\"availability_request\": {}}\n").await;
    assert!(matches!(waiting.read().await, Message::AvailabilityResponse(_)), "a mere question is answered");
    waiting.write(b"{\"availability_request\": {\"session\": \"show\"}}\n").await;
    let answer = tokio::time::timeout(Duration::from_millis(100), waiting.read()).await;
    assert!(answer.is_err(), "claimed although {PLACES} others are connected");
    peers.pop();
    assert!(matches!(waiting.read().await, Message::AvailabilityResponse(_)));
}

#[tokio::test]
async fn a_stop_is_obeyed_however_many_are_connected() {
    let log = LogFile::new("stop-beyond");
    let (_host, address) = served(&log).await;
    let mut peers = all_places_taken(address).await;
    peers[0].send(&paper(10_000.0)).await;
    assert!(is_accepted(&peers[0].read().await));
    // They also take all that is beyond the places, and say what waits.
    let mut beyond = Vec::new();
    for _ in 0..WAITING_MAX {
        let mut peer = Peer::connected(address).await;
        peer.send(&paper(10_000.0)).await;
        beyond.push(peer);
    }
    let device = urrcp::DeviceId::new("arm").unwrap();
    let stop = urrcp::ControlRequest::immediate(device, Command::Script(urrcp::Script::cancel()));
    let mut stopping = Peer::connected(address).await;
    stopping.send(&Message::ControlRequest(stop)).await;
    let answer = tokio::time::timeout(Duration::from_secs(20), stopping.read()).await;
    let Ok(Message::ControlResponse(response)) = answer else { panic!("{answer:?}") };
    assert!(matches!(response.status, Status::Ok | Status::Accepted), "{response:?}");
}

#[tokio::test]
async fn a_peer_that_has_long_been_silent_makes_room_for_one_that_waits() {
    let host = Host::start(arms(1, &Settings::default()), HostOptions::default()).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    tokio::spawn(serve_with(listener, host.handle(), 0, Duration::from_secs(1)));
    let hello = Message::AvailabilityRequest(urrcp::AvailabilityRequest::default());
    let mut peers = all_places_taken(address).await;
    let mut talking = peers.pop().unwrap();
    let mut waiting = Peer::connected(address).await;
    waiting.send(&paper(10_000.0)).await;
    let served = async {
        loop {
            talking.send(&hello).await;
            talking.read().await;
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    let answered = tokio::select! {
        () = served => None,
        answer = tokio::time::timeout(Duration::from_secs(20), waiting.read()) => answer.ok(),
    };
    assert!(answered.as_ref().is_some_and(is_accepted), "{answered:?}");
    host.stop();
}
