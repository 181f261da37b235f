//! Missions whose messages are encoded in MessagePack, with robots and scheduler as real processes.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};

use urrcp::{Decoder, Encoding, Message};

use stage::session::{Session, arm_at, program};

const SCENARIO: &str = "scenario: test
start_tolerance: 1s
cues:
  - at: 0s
    robots: all
    tracks:
      shoulder: [{at: 0s, to: 45}, {at: 300ms, to: 0}, {at: 600ms, to: 45}]
";

/// A simulated robot in a process of its own, which is killed when this is dropped.
struct Robot {
    process: Child,
    port: u16,
}

impl Robot {
    fn start(session: &Session, id: &str) -> Self {
        let mut command = Command::new(program());
        command
            .args(["robot", "--listen", "127.0.0.1:0", "--id", id, "--init"])
            .arg(session.path("arm.yaml"));
        let mut process = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut line).unwrap();
        Self { process, port: line.trim().rsplit(':').next().unwrap().parse().unwrap() }
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        let _gone = self.process.kill();
        let _reaped = self.process.wait();
    }
}

/// The bytes that passed through a relay between server and robot, in each direction.
#[derive(Clone, Default)]
struct Overheard {
    to_robot: Arc<Mutex<Vec<u8>>>,
    to_server: Arc<Mutex<Vec<u8>>>,
}

impl Overheard {
    fn messages(bytes: &Mutex<Vec<u8>>) -> Vec<(Encoding, Message)> {
        let mut decoder = Decoder::default();
        decoder.push(&bytes.lock().unwrap());
        let next = || decoder.next_message().map(|decoded| (decoder.encoding(), decoded.unwrap()));
        std::iter::from_fn(next).collect()
    }
}

/// Starts a relay in front of a robot's port. The relay forwards all bytes, and applies `change` to those from the robot. Returns its
/// port. The threads of a connection end with the connection, and the thread that accepts connections ends with the process.
fn relay(robot: u16, change: fn(Vec<u8>) -> Vec<u8>) -> (u16, Overheard) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let overheard = Overheard::default();
    let heard = overheard.clone();
    std::thread::spawn(move || {
        for server in listener.incoming() {
            let server = server.unwrap();
            let robot = TcpStream::connect(("127.0.0.1", robot)).unwrap();
            let (back, forth) = (robot.try_clone().unwrap(), server.try_clone().unwrap());
            let (there, here) = (Arc::clone(&heard.to_robot), Arc::clone(&heard.to_server));
            std::thread::spawn(move || carry(forth, robot, &there, |bytes| bytes));
            std::thread::spawn(move || carry(back, server, &here, change));
        }
    });
    (port, overheard)
}

fn carry(mut from: TcpStream, mut to: TcpStream, heard: &Mutex<Vec<u8>>, change: fn(Vec<u8>) -> Vec<u8>) {
    let mut bytes = vec![0; 64 * 1024];
    while let Ok(n @ 1..) = from.read(&mut bytes) {
        let bytes = change(bytes[..n].to_vec());
        heard.lock().unwrap().extend_from_slice(&bytes);
        if to.write_all(&bytes).is_err() {
            break;
        }
    }
    let _closed_already = to.shutdown(std::net::Shutdown::Both);
}

/// Writes a fleet of two robots at these ports, which receive MessagePack.
fn fleet(session: &Session, handshake: &str, ports: [u16; 2]) {
    let robot = |(id, port)| {
        format!("  r{id}: {{init: arm.yaml, address: 'tcp://127.0.0.1:{port}', encoding: msgpack}}\n")
    };
    let robots: String = ports.into_iter().enumerate().map(robot).collect();
    let yaml = format!("handshake: {handshake}\nrobots:\n{robots}groups: {{all: [r0, r1]}}\n");
    session.file("fleet.yaml", yaml);
}

#[track_caller]
fn check_done(session: &Session) {
    let ran = session.run(&["run", "test.yaml", "--format", "json"]);
    assert_eq!(ran.code(), 0, "{}", ran.text());
    let report = ran.json();
    assert!(report["robots"].as_array().unwrap().iter().all(|robot| robot["steps_done"] == 3), "{report}");
}

#[test]
fn messages_switch_from_json_to_message_pack_once_robot_lists_it() {
    let session = Session::new();
    session.file("arm.yaml", arm_at(45)).file("test.yaml", SCENARIO);
    let robots = [Robot::start(&session, "r0"), Robot::start(&session, "r1")];
    let (port, overheard) = relay(robots[0].port, |bytes| bytes);
    fleet(&session, "full", [port, robots[1].port]);
    check_done(&session);
    let sent = Overheard::messages(&overheard.to_robot);
    // The connection for stops may be checked first.
    let first = sent.iter().find(|(_, message)| !matches!(message, Message::AvailabilityRequest(_)));
    assert!(
        matches!(first, Some((Encoding::Json, Message::InitializationRequest(_)))),
        "no encoding was listed yet: {first:?}"
    );
    let scripts: Vec<_> = sent.iter().filter(|(_, m)| matches!(m, Message::ControlRequest(_))).collect();
    assert!(!scripts.is_empty());
    assert!(scripts.iter().all(|(encoding, _)| *encoding == Encoding::MessagePack), "{scripts:?}");
    for (encoding, answer) in Overheard::messages(&overheard.to_server) {
        match answer {
            Message::InitializationBlock(_) => assert_eq!(encoding, Encoding::Json),
            Message::ControlResponse(_) => assert_eq!(encoding, Encoding::MessagePack, "{answer:?}"),
            _ => {}
        }
    }
}

#[test]
fn without_handshake_encodings_are_taken_from_the_init_file() {
    let session = Session::new();
    session.file("arm.yaml", arm_at(45)).file("test.yaml", SCENARIO);
    let robots = [Robot::start(&session, "r0"), Robot::start(&session, "r1")];
    let (port, overheard) = relay(robots[0].port, |bytes| bytes);
    fleet(&session, "skip", [port, robots[1].port]);
    session.run(&["run", "test.yaml"]).says(
        1,
        &["DB0018", "the robot does not list the encoding `msgpack`", "`encodings: [msgpack]` in its"],
    );
    session.file("arm.yaml", format!("encodings: [msgpack]\n{}", arm_at(45)));
    check_done(&session);
    let all = [Overheard::messages(&overheard.to_robot), Overheard::messages(&overheard.to_server)].concat();
    assert!(all.len() >= 4);
    // The connection for stops is checked in the encoding that every robot supports.
    let of_mission = |(_, message): &&(Encoding, Message)| match message {
        Message::AvailabilityRequest(request) => request.session.is_some(),
        Message::AvailabilityResponse(response) => response.originate_timestamp.is_some(),
        _ => true,
    };
    assert!(all.iter().filter(of_mission).all(|(encoding, _)| *encoding == Encoding::MessagePack), "{all:?}");
}

#[test]
fn robot_without_required_encoding_is_refused_and_receives_only_json() {
    fn unlisted(bytes: Vec<u8>) -> Vec<u8> {
        let text = String::from_utf8(bytes).unwrap();
        text.replace(r#""encodings":["msgpack"]"#, r#""encodings":["cbor"]"#).into_bytes()
    }
    let session = Session::new();
    session.file("arm.yaml", arm_at(45)).file("test.yaml", SCENARIO);
    let robots = [Robot::start(&session, "r0"), Robot::start(&session, "r1")];
    let (port, overheard) = relay(robots[0].port, unlisted);
    fleet(&session, "full", [port, robots[1].port]);
    let says = [
        "r0",
        "it does not support the encoding `msgpack`, which the fleet file requires (it supports, besides JSON: `cbor`)",
        "use `encoding: json`, which every robot supports",
    ];
    session.run(&["preflight", "test.yaml"]).says(1, &says);
    session.run(&["run", "test.yaml"]).says(1, &says);
    assert!(Overheard::messages(&overheard.to_robot).iter().all(|(encoding, _)| *encoding == Encoding::Json));
}
