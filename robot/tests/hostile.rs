//! Tests robots behind real sockets with a hostile peer. The peer receives an error, its link continues if possible, other links and
//! robots are not affected, and memory stays bounded. These tests run in a separate process, because they measure its memory.
#![expect(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::net::SocketAddr;
use std::time::Duration;

use downbeat_robot::simulated::{Settings, SimulatedRobot};
use downbeat_robot::{Host, HostOptions, serve};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Mutex, MutexGuard};
use urrcp::{ControlResponse, ErrorCode, InitializationBlock, LINE_BYTES_MAX, Message, Status};

/// Lock that lets only one test run at a time, so that each test measures only its own memory.
static ALONE: Mutex<()> = Mutex::const_new(());

const ARM: &str = r#""name": "arm", "available_control_types": {
    "position": {"min_value": 0, "max_value": 90, "granularity": 1},
    "script": {"min_value": 0, "max_value": 90, "granularity": 1, "max_number_of_steps": 4}}"#;
const ASK: &[u8] = b"{\"availability_request\": {}}\n";
const CLAIM: &[u8] = b"{\"availability_request\": {\"session\": \"hostile\"}}\n";
/// Maximum time to wait for a response, however busy the machine is.
const PATIENCE: Duration = Duration::from_secs(60);
const MIB: usize = 1024 * 1024;

fn robot(id: &str, devices: usize) -> SimulatedRobot {
    let devices: Vec<_> = (0..devices).map(|i| format!(r#"{{"id": "d{i}", {ARM}}}"#)).collect();
    let devices = devices.join(",");
    let block = format!(r#"{{"id": "{id}", "api_version": "1", "reports": true, "devices": [{devices}]}}"#);
    SimulatedRobot::new(serde_json::from_str::<InitializationBlock>(&block).unwrap(), Settings::default())
}

/// Two robots of one host, and one well-behaved peer for each robot. The second robot has many devices.
struct Stage {
    _host: Host,
    addresses: Vec<SocketAddr>,
    others: Vec<Peer>,
    _alone: MutexGuard<'static, ()>,
}

impl Stage {
    async fn set() -> Self {
        let alone = ALONE.lock().await;
        let host = Host::start(vec![robot("r0", 1), robot("r1", 3_000)], HostOptions::default()).unwrap();
        let (mut addresses, mut others) = (Vec::new(), Vec::new());
        for robot in 0..2 {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            addresses.push(listener.local_addr().unwrap());
            tokio::spawn(serve(listener, host.handle(), robot));
            others.push(Peer::connected(addresses[robot]).await);
        }
        let mut stage = Self { _host: host, addresses, others, _alone: alone };
        stage.others_notice_nothing().await;
        stage
    }

    /// Returns a peer that has claimed the first robot, so that the robot accepts long lines from it.
    async fn hostile(&self) -> Peer {
        let mut peer = Peer::connected(self.addresses[0]).await;
        peer.write(CLAIM).await;
        let Message::AvailabilityResponse(response) = peer.read().await else { panic!() };
        assert_eq!(response.status, Status::Ok);
        peer
    }

    async fn others_notice_nothing(&mut self) {
        for other in &mut self.others {
            other.asks_and_is_answered().await;
        }
    }
}

struct Peer(BufReader<TcpStream>);

impl Peer {
    async fn connected(address: SocketAddr) -> Self {
        Self(BufReader::new(TcpStream::connect(address).await.unwrap()))
    }

    async fn write(&mut self, bytes: &[u8]) {
        tokio::time::timeout(PATIENCE, self.0.get_mut().write_all(bytes)).await.unwrap().unwrap();
    }

    async fn read(&mut self) -> Message {
        let mut line = String::new();
        tokio::time::timeout(PATIENCE, self.0.read_line(&mut line)).await.unwrap().unwrap();
        serde_json::from_str(&line).unwrap()
    }

    async fn asks_and_is_answered(&mut self) {
        self.write(ASK).await;
        let Message::AvailabilityResponse(response) = self.read().await else { panic!() };
        assert_eq!(response.status, Status::Ok);
    }

    /// Checks that the robot refuses the peer once, that the error contains `says`, and that the link continues.
    async fn is_refused(&mut self, says: &str) {
        let error = match self.read().await {
            Message::AvailabilityResponse(response) => response.error,
            Message::ControlResponse(ControlResponse { status: Status::Failed, error, .. }) => error,
            other => panic!("{other:?}"),
        };
        let error = error.unwrap();
        assert_eq!(error.code, ErrorCode::Malformed);
        assert!(error.message.contains(says), "{}", error.message);
        self.asks_and_is_answered().await;
    }
}

/// Resets the peak of the process's memory usage.
fn forget_peak() {
    std::fs::write("/proc/self/clear_refs", "5").unwrap();
}

/// Returns the value of a line in `/proc/self/status`, in bytes.
fn memory(line: &str) -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let found = status.lines().find_map(|l| l.strip_prefix(line)).unwrap();
    found.trim().trim_end_matches(" kB").parse::<usize>().unwrap() * 1024
}

/// Measures by how much the memory usage of the process grows from a start to its peak.
struct Growth(usize);

impl Growth {
    fn begins() -> Self {
        forget_peak();
        Self(memory("VmRSS:"))
    }

    #[track_caller]
    fn is_at_most(&self, bytes: usize) {
        let grown = memory("VmHWM:").saturating_sub(self.0);
        assert!(grown <= bytes, "{} MiB", grown / MIB);
    }
}

fn request(inner: &str) -> String {
    format!(r#"{{"control_request":{{"device_id":"d0","control_type":"position",{inner}}}}}"#)
}

#[tokio::test]
async fn invalid_messages_are_refused_and_the_connection_stays_open() {
    let mut stage = Stage::set().await;
    let mut peer = stage.hostile().await;
    let long = "ж".repeat(257);
    let deep = format!("{}{}", "[".repeat(100_000), "]".repeat(100_000));
    let ping = r#"{"availability_request":{}"#;
    let init = r#"{"initialization_block":{"id":"r","api_version":"1","devices":["#;
    let many: Vec<_> =
        (0..32_001).map(|i| format!(r#"{{"id":"{i}","name":"","available_control_types":{{}}}}"#)).collect();
    let cases = [
        (r#"{"control_request":"#.repeat(100_000), "invalid JSON"),
        (r#"{"control_request":{"x":"#.repeat(100_000), "invalid JSON"),
        ("[".repeat(100_000), ""),
        (deep.clone(), ""),
        (request(&format!(r#""control_value":{deep}"#)), "at `control_request"),
        (request(r#""control_value":1e999"#), "number out of range"),
        (request(r#""control_value":-1e999"#), "number out of range"),
        (request(r#""control_value":NaN"#), "invalid JSON"),
        (request(r#""control_value":1,"control_value":2"#), "duplicate field `control_value`"),
        (format!("{ping},\"availability_request\":{{}}}}"), "2 keys, expected exactly one"),
        (format!("{ping},\"initialization_request\":{{}}}}"), "2 keys, expected exactly one"),
        ("{}".to_owned(), ""),
        (request(&format!(r#""control_value":1,"request_id":"{long}""#)), "257 characters"),
        (request(r#""control_value":1,"request_id":"\ud800""#), "at `control_request.request_id`"),
        (format!(r#"{init}{{"id":"d","id":"e"}}]}}}}"#), "duplicate field `id`"),
        (format!("{init}{}]}}}}", many.join(",")), "32001 devices, expected 1 to 32000"),
    ];
    for (line, says) in cases {
        peer.write(line.as_bytes()).await;
        peer.write(b"\n").await;
        peer.is_refused(says).await;
    }
    peer.write(b"{\"availability_request\"\xc3\x28:{}}\n").await;
    peer.is_refused("invalid UTF-8 after byte 23").await;
    stage.others_notice_nothing().await;
}

#[tokio::test]
async fn unusual_but_valid_messages_are_accepted() {
    let mut stage = Stage::set().await;
    let mut peer = Peer::connected(stage.addresses[0]).await;
    let deep = format!("{}{}", "[".repeat(100_000), "]".repeat(100_000));
    for inner in [
        r#""control_value":-0"#.to_owned(),
        r#""control_value":1e-400"#.to_owned(),
        format!(r#""control_value":7,"x":{deep}"#),
    ] {
        peer.write(request(&inner).as_bytes()).await;
        peer.write(b"\n\r\n  \n").await;
        for expected in [Status::Accepted, Status::Started, Status::Ok] {
            let Message::ControlResponse(response) = peer.read().await else { panic!() };
            assert_eq!(response.status, expected);
        }
    }
    peer.asks_and_is_answered().await;
    stage.others_notice_nothing().await;
}

#[tokio::test]
async fn overlong_line_is_refused_once_and_uses_bounded_memory() {
    let mut stage = Stage::set().await;
    let mut peer = stage.hostile().await;
    let growth = Growth::begins();
    let chunk = vec![b'x'; MIB];
    for megabytes in [17, 200] {
        for _ in 0..megabytes {
            peer.write(&chunk).await;
        }
        stage.others_notice_nothing().await;
        peer.write(b"\n").await;
        peer.is_refused("the line is too long, expected at most 16777216 bytes").await;
    }
    // The growing line, and its shorter predecessor, which is copied into it.
    growth.is_at_most(4 * LINE_BYTES_MAX);
}

#[tokio::test]
async fn never_ending_line_is_refused_while_it_is_received() {
    let mut stage = Stage::set().await;
    let mut peer = stage.hostile().await;
    let chunk = vec![b'['; MIB];
    for _ in 0..17 {
        peer.write(&chunk).await;
    }
    let Message::AvailabilityResponse(response) = peer.read().await else { panic!() };
    assert_eq!(response.error.unwrap().code, ErrorCode::Malformed);
    peer.write(&chunk).await;
    stage.others_notice_nothing().await;
}

#[tokio::test]
async fn incomplete_line_does_no_harm() {
    let mut stage = Stage::set().await;
    let mut silent = stage.hostile().await;
    silent.write(b"{\"availability_requ").await;
    stage.others_notice_nothing().await;
    drop(silent);
    let mut hung_up = stage.hostile().await;
    hung_up.write(b"{\"availability_request\": {}}\n{\"control_request\":").await;
    assert!(matches!(hung_up.read().await, Message::AvailabilityResponse(_)));
    hung_up.0.get_mut().shutdown().await.unwrap();
    let mut rest = String::new();
    tokio::time::timeout(PATIENCE, hung_up.0.read_line(&mut rest)).await.unwrap().unwrap();
    assert_eq!(rest, "", "hung up on without an answer to half a line");
    stage.others_notice_nothing().await;
}

#[tokio::test]
async fn many_requests_of_a_peer_that_does_not_read_use_bounded_memory() {
    let mut stage = Stage::set().await;
    let mut deaf = Peer::connected(stage.addresses[1]).await;
    let growth = Growth::begins();
    let questions = b"{\"initialization_request\":{}}\n".repeat(10_000);
    // Ends when the robot no longer reads, because its responses of a megabyte each are not read.
    let asking = tokio::spawn(async move { deaf.write(&questions).await });
    for _ in 0..20 {
        stage.others_notice_nothing().await;
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    asking.abort();
    growth.is_at_most(128 * MIB);
}
