//! Tests our decoder, encoder and robot, and the published schema, with the test vectors of the protocol.

use std::fs;

use downbeat_robot::{Input, LinkId, Output, Robot};
use serde::Deserialize;
use serde_json::Value;
use urrcp::{ControlError, DecodeError, Decoder, Encoding, Message, Status, Timestamp};

use stage::schema::validator;
use stage::session::root;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Vector {
    file: String,
    verdict: String,
    code: Option<String>,
    written: Option<String>,
    device_id: Option<String>,
    request_id: Option<String>,
    schema: Option<String>,
    /// `may`: a robot decides itself whether it refuses the line.
    robot: Option<String>,
    why: String,
}

impl Vector {
    fn bytes(&self) -> Vec<u8> {
        fs::read(root().join("tests/vectors").join(&self.file))
            .unwrap_or_else(|e| panic!("{}: {e}", self.file))
    }

    #[track_caller]
    fn message(&self) -> Message {
        decode(&self.bytes()).unwrap_or_else(|error| panic!("{}: {error}", self.file))
    }
}

fn vectors() -> Vec<Vector> {
    let index = fs::read_to_string(root().join("tests/vectors/index.json")).unwrap();
    serde_json::from_str(&index).unwrap()
}

fn decode(bytes: &[u8]) -> Result<Message, DecodeError> {
    let mut decoder = Decoder::default();
    decoder.push(bytes);
    let decoded = decoder.next_message().unwrap();
    assert!(decoder.next_message().is_none(), "one line");
    decoded
}

fn written(message: &Message) -> String {
    let mut line = Vec::new();
    urrcp::encode(message, &mut line);
    String::from_utf8(line).unwrap()
}

#[test]
fn every_vector_file_is_listed_once() {
    let mut listed: Vec<String> = vectors().into_iter().map(|vector| vector.file).collect();
    let mut found = vec!["robot.json".to_owned()];
    for folder in ["valid", "invalid", "requests"] {
        for entry in fs::read_dir(root().join("tests/vectors").join(folder)).unwrap() {
            found.push(format!("{folder}/{}", entry.unwrap().file_name().display()));
        }
    }
    listed.sort();
    found.sort();
    assert_eq!(listed, found);
}

#[test]
fn valid_messages_are_read_and_written_as_listed() {
    for vector in vectors().into_iter().filter(|vector| vector.verdict == "valid") {
        let text = written(&vector.message());
        let expected = match &vector.written {
            Some(written) => format!("{written}\n").into_bytes(),
            None => vector.bytes(),
        };
        assert_eq!(text, String::from_utf8(expected).unwrap(), "{}: {}", vector.file, vector.why);
    }
}

#[test]
fn valid_messages_round_trip_through_compact_encoding() {
    for vector in vectors().into_iter().filter(|vector| vector.code.is_none()) {
        let message = vector.message();
        let mut frame = Vec::new();
        urrcp::encode_as(Encoding::MessagePack, &message, &mut frame);
        assert_eq!(frame[0], 0xC1, "{}", vector.file);
        assert_eq!(decode(&frame), Ok(message), "{}: {}", vector.file, vector.why);
    }
}

#[test]
fn invalid_lines_are_refused_with_affected_device_and_request() {
    let mut wrong = Vec::new();
    for vector in vectors().into_iter().filter(|vector| vector.verdict == "invalid") {
        let (file, why) = (&vector.file, &vector.why);
        assert_eq!(vector.code.as_deref(), Some("malformed"), "{file}");
        match decode(&vector.bytes()) {
            Ok(message) => wrong.push(format!("{file}, {why}: read as {message:?}")),
            Err(error) => {
                let device_id = error.device_id.as_ref().map(ToString::to_string);
                let request_id = error.request_id.as_ref().map(ToString::to_string);
                if (device_id, request_id) != (vector.device_id.clone(), vector.request_id.clone()) {
                    wrong.push(format!("{file}, {why}: {error:?}"));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Whether only a robot sends messages with this beginning.
fn is_of_robot(bytes: &[u8]) -> bool {
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(60)]).into_owned();
    head.contains("_response") || head.contains("initialization_block")
}

#[test]
fn conformance_test_sends_every_invalid_message_of_a_server() {
    let invalid =
        vectors().into_iter().filter(|vector| vector.verdict == "invalid" && vector.robot.is_none());
    let lines = invalid.map(|vector| vector.bytes()).filter(|bytes| !is_of_robot(bytes));
    let texts: Vec<String> = lines.map(|bytes| bytes.into_iter().map(char::from).collect()).collect();
    let path = root().join("scheduler/conformance/src/vectors.json");
    let listed: Vec<String> = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
    if std::env::var_os("DOWNBEAT_BLESS").is_some() && listed != texts {
        return fs::write(path, serde_json::to_string_pretty(&texts).unwrap() + "\n").unwrap();
    }
    assert!(listed == texts, "{} lists other messages than tests/vectors/index.json", path.display());
}

#[test]
fn schema_verdicts_match_listed_verdicts() {
    let validator = validator("protocol");
    let mut wrong = Vec::new();
    for vector in vectors() {
        let expected = vector.schema.as_deref().unwrap_or("accepts");
        let verdict = match serde_json::from_slice::<Value>(&vector.bytes()) {
            Err(_) => "unreadable",
            Ok(document) if validator.is_valid(&document) => "accepts",
            Ok(_) => "refuses",
        };
        if verdict != expected {
            wrong.push(format!("{}, {}: {verdict}, not {expected}", vector.file, vector.why));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn robot_responds_to_requests_as_listed() {
    let robot = vectors().into_iter().find(|vector| vector.file == "robot.json").unwrap();
    let Message::InitializationBlock(block) = robot.message() else { panic!("robot.json is no block") };
    let now: Timestamp<urrcp::Robot> = serde_json::from_str("\"2026-11-20T19:00:00.001Z\"").unwrap();
    for vector in vectors().into_iter().filter(|vector| vector.file.starts_with("requests/")) {
        let mut out = Vec::new();
        Robot::new(block.clone()).handle(now, LinkId(1), Input::Message(vector.message()), &mut out);
        let (status, error) = first_answer(&out);
        let code = error.as_ref().map(|error| error.code.to_string());
        assert_eq!(
            (status.to_string(), code),
            (vector.verdict, vector.code),
            "{}: {}",
            vector.file,
            vector.why
        );
    }
}

fn first_answer(out: &[Output]) -> (&Status, &Option<ControlError>) {
    let mut answers = out.iter().filter_map(|output| match output {
        Output::Send { message: Message::ControlResponse(response), .. } => {
            Some((&response.status, &response.error))
        }
        Output::Send { message: Message::InquiryResponse(response), .. } => {
            Some((&response.status, &response.error))
        }
        _ => None,
    });
    answers.next().unwrap()
}
