//! Tests the exact bytes of messages on the wire, and the rejection of invalid messages.

mod arbitrary;

use crate::{
    Command, ControlRequest, ControlResponse, ControlType, DecodeErrorKind, Decoder, DeviceId, Encoding,
    ErrorCode, InitializationBlock, Interpolation, Message, Millis, RequestId, RobotType, Script, Setpoint,
    StatusValue, Step, StopCondition, encode, encode_as,
};

/// The example script of the paper with the values 45, 0, 45, as `docs/protocol.md` shows it.
const PAPER_SCRIPT: &str = r#"{"control_request":{"timestamp":"2026-11-20T19:00:00.000000000Z","time_offset_to_start":1500,"device_id":"shoulder","stop_condition":2000,"request_id":"wave/arm-1/shoulder/0","control_type":"script","control_value":[{"time_offset_to_start":0,"control_type":"position","control_value":45},{"time_offset_to_start":1000,"control_type":"position","control_value":0},{"time_offset_to_start":2000,"control_type":"position","control_value":45}]}}"#;

const SERVO_ARM: &str = r#"{"initialization_block": {"id": "arm-1", "name": "left arm", "type": "Industrial", "manufacture": "Example", "version": "2.1",
  "api_version": "1", "reports": true, "devices": [
  {"id": "shoulder", "name": "shoulder servo", "unit": "deg", "default_value": 0, "interpolation": "linear", "script_queue": 2,
   "available_control_types": {
     "position": {"min_value": 0, "max_value": 90, "granularity": 0.5, "max_error": 0.25},
     "script":   {"min_value": 0, "max_value": 90, "granularity": 0.5, "max_error": 0.25, "max_number_of_steps": 64, "control_types": ["position"]}}}]}}"#;

fn decode_one(line: &str) -> Result<Message, crate::DecodeError> {
    let mut decoder = Decoder::default();
    decoder.push(line.replace('\n', " ").as_bytes());
    decoder.push(b"\n");
    decoder.next_message().expect("a whole line gives a message or an error")
}

fn line_of(message: &Message) -> String {
    let mut line = Vec::new();
    encode(message, &mut line);
    String::from_utf8(line).unwrap()
}

fn frame_of(message: &Message) -> Vec<u8> {
    let mut frame = Vec::new();
    encode_as(Encoding::MessagePack, message, &mut frame);
    frame
}

fn step(millis: f64, value: f64) -> Step {
    Step {
        offset: Millis::new(millis).unwrap(),
        setpoint: Setpoint::new(ControlType::Position, value),
        stop_condition: None,
    }
}

#[test]
fn script_of_the_paper_round_trips_byte_for_byte() {
    let Ok(Message::ControlRequest(decoded)) = decode_one(PAPER_SCRIPT) else { panic!() };
    let steps = vec![step(0.0, 45.0), step(1000.0, 0.0), step(2000.0, 45.0)];
    let built = ControlRequest {
        timestamp: decoded.timestamp,
        time_offset_to_start: Some(Millis::new(1500.0).unwrap()),
        stop_condition: Some(StopCondition::both(Millis::new(2000.0).unwrap())),
        request_id: Some(RequestId::new("wave/arm-1/shoulder/0").unwrap()),
        ..ControlRequest::immediate(
            DeviceId::new("shoulder").unwrap(),
            Command::Script(Script::new(steps).unwrap()),
        )
    };
    assert_eq!(decoded, built);
    assert_eq!(line_of(&Message::ControlRequest(built)), format!("{PAPER_SCRIPT}\n"));
}

#[test]
fn initialization_block_survives_a_round_trip() {
    let block = decode_one(SERVO_ARM).unwrap();
    assert_eq!(decode_one(&line_of(&block)).unwrap(), block);
    let Message::InitializationBlock(block) = block else { panic!() };
    let shoulder = block.device("shoulder").unwrap();
    assert_eq!(shoulder.primary_control_type(), Some(ControlType::Position));
    assert_eq!(shoulder.script_control_types(), [ControlType::Position]);
    let refusal = |value| {
        let setpoint = Setpoint::new(ControlType::Position, value);
        shoulder.check_in_script(&setpoint).map_err(|e| e.code)
    };
    assert_eq!(refusal(45.5), Ok(()));
    assert_eq!(refusal(90.5), Err(ErrorCode::OutOfRange));
    assert_eq!(refusal(f64::NAN), Err(ErrorCode::OutOfRange));
    assert_eq!(refusal(45.25), Err(ErrorCode::OffGranularity));
}

#[track_caller]
fn check_round_trip(line: &str) {
    let message = decode_one(line).unwrap();
    assert_eq!(line_of(&message).trim_end(), line);
}

#[test]
fn every_kind_of_message_round_trips() {
    check_round_trip(r#"{"availability_request":{"timestamp":"2026-11-20T19:00:00.000000000Z"}}"#);
    check_round_trip(
        r#"{"availability_response":{"originate_timestamp":"2026-11-20T19:00:00.000000000Z","receive_timestamp":"2026-11-20T19:00:00.000100000Z","timestamp":"2026-11-20T19:00:00.000200000Z","status":"OK"}}"#,
    );
    check_round_trip(r#"{"initialization_request":{}}"#);
    check_round_trip(
        r#"{"control_request":{"device_id":"d","control_type":"custom_2","control_value":1,"control_value_2":0.5,"control_value_3":-7}}"#,
    );
    check_round_trip(r#"{"control_request":{"device_id":"d","control_type":"sensor"}}"#);
    check_round_trip(
        r#"{"control_request":{"device_id":"d","stop_condition":{"pending":500,"running":null},"control_type":"script","control_value":[]}}"#,
    );
    check_round_trip(
        r#"{"control_response":{"timestamp":"2026-11-20T19:00:00.000000000Z","device_id":"d","status":"Provide","status_value":36.6}}"#,
    );
    check_round_trip(
        r#"{"control_response":{"timestamp":"2026-11-20T19:00:00.000000000Z","device_id":"d","status":"Failed","status_value":null,"request_id":"r","error":{"code":"late","message":"by 3 ms"}}}"#,
    );
}

#[track_caller]
fn check_invalid(line: &str, path: &str, says: &str) {
    let error = decode_one(line).unwrap_err();
    let DecodeErrorKind::Invalid { path: found, message } = &error.kind else { panic!("{error:?}") };
    assert!(message.contains(says), "{message}");
    assert_eq!(found, path);
}

#[test]
fn message_beyond_the_limits_is_refused_with_its_path() {
    let long = "x".repeat(257);
    check_invalid(
        &format!(r#"{{"control_request":{{"device_id":"{long}","control_type":"sensor"}}}}"#),
        "control_request.device_id",
        "257 characters",
    );
    check_invalid(
        r#"{"control_request":{"device_id":"d","time_offset_to_start":-1,"control_type":"sensor"}}"#,
        "control_request.time_offset_to_start",
        "-1 ms",
    );
    check_invalid(
        r#"{"control_request":{"device_id":"d","control_type":"position"}}"#,
        "control_request",
        "missing field `control_value`",
    );
    check_invalid(
        r#"{"control_request":{"device_id":"d","device_id":"e","control_type":"sensor"}}"#,
        "control_request",
        "duplicate field `device_id`",
    );
    check_invalid(
        r#"{"control_request":{"device_id":"d","control_type":"script","control_value":[{"time_offset_to_start":0,"control_type":"script","control_value":1}]}}"#,
        "control_request.control_value[0]",
        "in a script step",
    );
    check_invalid(
        r#"{"control_request":{"device_id":"d","control_type":"script","control_value":[{"time_offset_to_start":9,"control_type":"speed","control_value":1},{"time_offset_to_start":8,"control_type":"speed","control_value":1}]}}"#,
        "control_request.control_value",
        "step 2 is at 8 ms, before",
    );
    check_invalid(r#"{"hello":{}}"#, ".", "unknown variant");
    check_invalid(
        r#"{"initialization_block":{"id":"r","api_version":"1","devices":[]}}"#,
        "initialization_block",
        "0 devices, expected 1 to 32000",
    );
    check_invalid(
        r#"{"initialization_block":{"id":"r","api_version":"1","devices":[{"id":"d","name":"d","available_control_types":{"position":{"min_value":1,"max_value":0,"granularity":1}}}]}}"#,
        "initialization_block.devices[0].available_control_types.position",
        "min_value 1 is greater than max_value 0",
    );
}

#[test]
fn words_of_a_later_version_are_skipped_in_messages_and_refused_elsewhere() {
    let block = r#"{"id":"r","type":"Dancer","api_version":"1.7","devices":[
        {"id":"d","interpolation":"cubic","available_control_types":{
            "torque":{"limit":[1,{"peak":2}]},
            "position":{"min_value":0,"max_value":1,"granularity":0.5},
            "script":{"max_number_of_steps":4,"control_types":["torque","position"]}}},
        {"id":"e","available_control_types":{"torque":{},"script":{"max_number_of_steps":4}}}]}"#;
    let message = decode_one(&format!("{{\"initialization_block\":{}}}", block.replace('\n', ""))).unwrap();
    let Message::InitializationBlock(read) = message else { panic!("{message:?}") };
    assert_eq!(read.robot_type, Some(RobotType::Other));
    let [first, second] = [&read.devices[0], &read.devices[1]];
    assert_eq!(first.interpolation, Interpolation::Hold);
    assert_eq!(first.script_control_types(), [ControlType::Position]);
    assert_eq!(first.available_control_types.iter().count(), 2);
    assert_eq!(second.available_control_types.iter().count(), 0);
    for alone in [
        r#"{"id":"r","type":"Dancer","api_version":"1","devices":[{"id":"d","available_control_types":{}}]}"#,
        r#"{"id":"r","api_version":"1","devices":[{"id":"d","interpolation":"cubic","available_control_types":{}}]}"#,
        r#"{"id":"r","api_version":"1","devices":[{"id":"d","available_control_types":{"torque":{}}}]}"#,
    ] {
        assert!(serde_json::from_str::<InitializationBlock>(alone).is_err(), "{alone}");
    }
}

#[test]
fn custom_parameters_are_limited_including_nested_values() {
    let block = |list: String| {
        decode_one(&format!(
            r#"{{"initialization_block":{{"id":"r","api_version":"1","devices":[{{"id":"d","name":"d","available_control_types":{{"custom_1":{{"deep":{list}}}}}}}]}}}}"#
        ))
    };
    // The list itself counts as one value.
    assert!(block(format!("[{}0]", "0,".repeat(4_094))).is_ok());
    assert!(block(format!("[{}[0]]", "0,".repeat(4_094))).unwrap_err().to_string().contains("4096 values"));
}

#[test]
fn custom_parameters_of_a_robot_are_limited_in_total() {
    let block = |types: usize, values: usize| {
        let custom = |i: usize| format!(r#""custom_{i}":{{"deep":[{}0]}}"#, "0,".repeat(values - 1));
        let devices: Vec<_> = (0..2)
            .map(|device| {
                let types: Vec<_> = (0..types).map(custom).collect();
                format!(
                    r#"{{"id":"d{device}","name":"d","available_control_types":{{{}}}}}"#,
                    types.join(",")
                )
            })
            .collect();
        let devices = devices.join(",");
        decode_one(&format!(
            r#"{{"initialization_block":{{"id":"r","api_version":"1","devices":[{devices}]}}}}"#
        ))
    };
    // Each of 64 control types has 4,096 values: the dictionary, the list and 4,094 numbers.
    assert!(block(32, 4_094).is_ok());
    assert!(block(32, 4_094).is_ok(), "of every block by itself");
    let more = block(33, 4_094).unwrap_err().to_string();
    assert!(more.contains("more than 262144 values in the parameters of all"), "{more}");
}

#[test]
fn strings_in_custom_parameters_have_the_usual_length_limit() {
    let block = |parameters: String| {
        decode_one(&format!(
            r#"{{"initialization_block":{{"id":"r","api_version":"1","devices":[{{"id":"d","name":"d","available_control_types":{{"custom_1":{parameters}}}}}]}}}}"#
        ))
    };
    for (chars, taken) in [(256, true), (257, false)] {
        let text = "x".repeat(chars);
        assert_eq!(block(format!(r#"{{"a":"{text}"}}"#)).is_ok(), taken);
        assert_eq!(block(format!(r#"{{"{text}":1}}"#)).is_ok(), taken);
    }
}

#[test]
fn at_most_64_encodings_are_accepted() {
    let block = |count: usize| {
        let encodings = vec![r#""x""#; count].join(",");
        decode_one(&format!(
            r#"{{"initialization_block":{{"id":"r","api_version":"1","encodings":[{encodings}],"devices":[{{"id":"d","name":"d","available_control_types":{{}}}}]}}}}"#
        ))
    };
    assert!(block(64).is_ok());
    assert!(block(65).unwrap_err().to_string().contains("more than 64 encodings"));
}

#[test]
fn at_most_32000_devices_are_accepted() {
    let block = |count: usize| {
        let devices: Vec<_> = (0..count)
            .map(|i| format!(r#"{{"id":"d{i}","name":"d","available_control_types":{{}}}}"#))
            .collect();
        let devices = devices.join(",");
        decode_one(&format!(
            r#"{{"initialization_block":{{"id":"r","api_version":"1","devices":[{devices}]}}}}"#
        ))
    };
    assert!(block(32_000).is_ok());
    assert!(block(32_001).unwrap_err().to_string().contains("32001 devices"));
}

#[test]
fn at_most_32000_names_in_an_inquiry_are_accepted() {
    let inquiry = |key: &str, count: usize| {
        format!(r#"{{"inquiry":{{"{key}":[{}]}}}}"#, vec![r#""a""#; count].join(","))
    };
    for key in ["requests", "devices"] {
        assert!(decode_one(&inquiry(key, 32_000)).is_ok());
        let error = decode_one(&inquiry(key, 32_001)).unwrap_err();
        assert!(error.to_string().contains("more than 32000 names"), "{error}");
    }
}

#[test]
fn decode_error_names_device_and_request_for_the_response() {
    let error = decode_one(
        r#"{"control_request":{"device_id":"d","request_id":"r","control_type":"position","control_value":"x"}}"#,
    )
    .unwrap_err();
    assert_eq!(error.device_id.unwrap().as_str(), "d");
    assert_eq!(error.request_id.unwrap().as_str(), "r");
}

#[test]
fn unknown_keys_are_ignored_for_compatibility() {
    let line = r#"{"control_request":{"device_id":"d","colour":{"r":[1]},"control_type":"sensor"}}"#;
    assert!(decode_one(line).is_ok());
}

#[test]
fn unknown_control_type_is_decoded_with_any_values_in_any_key_order() {
    for value in ["[1,2]", "\"fast\"", "{\"x\":1}", "true", "[{\"time_offset_to_start\":0}]", "null"] {
        for request in [
            format!(
                r#"{{"control_request":{{"device_id":"d","control_type":"dance","control_value":{value}}}}}"#
            ),
            format!(
                r#"{{"control_request":{{"control_value":{value},"device_id":"d","control_type":"dance"}}}}"#
            ),
            format!(
                r#"{{"control_request":{{"control_value_2":"x","control_value":{value},"control_type":"dance","device_id":"d"}}}}"#
            ),
        ] {
            let Ok(Message::ControlRequest(read)) = decode_one(&request) else { panic!("{request}") };
            assert!(matches!(&read.command, Command::Unknown(name) if name.as_str() == "dance"), "{request}");
            let document: serde_json::Value = serde_json::from_str(&request).unwrap();
            let payload = rmp_serde::to_vec_named(&document).unwrap();
            let mut decoder = Decoder::default();
            decoder.push(&[0xC1]);
            decoder.push(&u32::try_from(payload.len()).unwrap().to_be_bytes());
            decoder.push(&payload);
            assert_eq!(decoder.next_message(), Some(Ok(Message::ControlRequest(read))), "{request}");
        }
    }
    // The values of a known control type are read, and no other error in a request is tolerated.
    for wrong in [
        r#"{"control_request":{"device_id":"d","control_type":"speed","control_value":"fast"}}"#,
        r#"{"control_request":{"device_id":"","control_type":"dance","control_value":[1]}}"#,
        r#"{"control_request":{"control_value":[1],"control_type":"dance"}}"#,
        r#"{"control_request":{"device_id":"d","control_type":7,"control_value":[1]}}"#,
    ] {
        assert!(decode_one(wrong).is_err(), "{wrong}");
    }
}

#[test]
fn overlong_line_is_dropped_once_and_the_next_line_is_read() {
    let mut decoder = Decoder::new(64);
    for _ in 0..1000 {
        decoder.push(&[b'x'; 50]);
        if let Some(error) = decoder.next_message() {
            assert_eq!(error.unwrap_err().kind, DecodeErrorKind::LineTooLong { limit: 64 });
        }
    }
    decoder.push(b"\n{\"availability_request\":{}}\n");
    assert!(matches!(decoder.next_message(), Some(Ok(Message::AvailabilityRequest(_)))));
    assert!(decoder.next_message().is_none());
}

#[test]
fn invalid_bytes_cause_typed_errors() {
    let mut decoder = Decoder::default();
    decoder.push(b"\xff\xfe\nnot json\n");
    decoder.push("[".repeat(100_000).as_bytes());
    decoder.push(b"\n{\"availability_request\":{},\"x\":1}\n");
    let mut kind = || decoder.next_message().unwrap().unwrap_err().kind;
    assert_eq!(kind(), DecodeErrorKind::NotUtf8 { valid_up_to: 0 });
    assert!(matches!(kind(), DecodeErrorKind::NotJson { .. }));
    assert!(!matches!(kind(), DecodeErrorKind::LineTooLong { .. }));
    assert!(matches!(kind(), DecodeErrorKind::NotJson { .. } | DecodeErrorKind::Invalid { .. }));
    assert!(decoder.next_message().is_none());
}

#[test]
fn json_object_with_two_keys_is_not_a_message() {
    for line in [
        r#"{"availability_request":{},"x":1}"#,
        r#"{"availability_request":{},"availability_request":{}}"#,
        r#"{"availability_request":{},"initialization_request":{}}"#,
    ] {
        check_invalid(line, ".", "2 keys, expected exactly one");
    }
    assert!(matches!(
        decode_one("{\"availability_request\":{}}]").unwrap_err().kind,
        DecodeErrorKind::NotJson { .. }
    ));
}

#[test]
fn decode_error_quotes_a_limited_part_of_the_line() {
    let long = "ж".repeat(100_000);
    for line in [
        format!(r#"{{"{long}":{{}}}}"#),
        format!(r#"{{"control_request":"{long}"}}"#),
        format!(r#"{{"initialization_block":{{"id":"r","api_version":"1","type":"{long}","devices":[]}}}}"#),
        format!(r#"{{"control_request":{{"control_value_{long}":1}}}}"#),
        format!(
            r#"{{"initialization_block":{{"id":"r","api_version":"1","devices":[{{"{long}":1e999}}]}}}}"#
        ),
        "[".repeat(100_000),
    ] {
        let text = decode_one(&line).unwrap_err().to_string();
        assert!(text.chars().count() < 600, "{} characters", text.chars().count());
    }
}

#[test]
fn non_finite_number_is_refused_with_its_device() {
    for number in ["1e999", "-1e999"] {
        let line = format!(
            r#"{{"control_request":{{"device_id":"d","control_type":"speed","control_value":{number}}}}}"#
        );
        check_invalid(&line, "control_request.control_value", "number out of range");
        assert_eq!(decode_one(&line).unwrap_err().device_id.unwrap().as_str(), "d");
    }
    let line = r#"{"control_request":{"device_id":"d","control_type":"speed","control_value":NaN}}"#;
    assert!(matches!(decode_one(line).unwrap_err().kind, DecodeErrorKind::NotJson { .. }));
}

#[test]
fn tiny_numbers_and_negative_zero_are_read_as_zero() {
    for number in ["1e-400", "-1e-400", "-0", "-0.0", "0e999"] {
        let line = format!(
            r#"{{"control_request":{{"device_id":"d","control_type":"speed","control_value":{number}}}}}"#
        );
        let message = decode_one(&line).unwrap();
        assert!(line_of(&message).contains(r#""control_value":0}"#), "{}", line_of(&message));
    }
}

#[test]
fn deeply_nested_line_is_decoded_or_refused() {
    let nested = |open: &str, close: &str| format!("{}1{}", open.repeat(100_000), close.repeat(100_000));
    for deep in [nested("[", "]"), nested("{\"a\":", "}")] {
        let request =
            format!(r#"{{"control_request":{{"device_id":"d","x":{deep},"control_type":"sensor"}}}}"#);
        assert!(decode_one(&request).is_ok(), "unknown keys are ignored");
        let value = format!(
            r#"{{"control_request":{{"device_id":"d","control_type":"speed","control_value":{deep}}}}}"#
        );
        assert_eq!(decode_one(&value).unwrap_err().device_id.unwrap().as_str(), "d");
        let custom = format!(
            r#"{{"initialization_block":{{"id":"r","api_version":"1","devices":[{{"id":"d","name":"d","available_control_types":{{"custom_1":{{"x":{deep}}}}}}}]}}}}"#
        );
        let path = "initialization_block.devices[0].available_control_types.custom_1";
        let error = decode_one(&custom).unwrap_err();
        assert!(
            error.to_string().contains("recursion limit exceeded") && error.to_string().contains(path),
            "{error}"
        );
        assert!(decode_one(&deep).is_err());
    }
    let unclosed = r#"{"control_request":"#.repeat(100_000);
    assert!(matches!(decode_one(&unclosed).unwrap_err().kind, DecodeErrorKind::NotJson { .. }));
}

#[test]
fn duplicate_key_is_refused_at_every_level() {
    let device = |types: &str| {
        format!(
            r#"{{"initialization_block":{{"id":"r","api_version":"1","devices":[{{"id":"d","name":"d","available_control_types":{types}}}]}}}}"#
        )
    };
    let limits = r#""min_value":0,"max_value":1,"granularity":1"#;
    let request =
        |inner: &str| format!(r#"{{"control_request":{{"device_id":"d","control_type":"script",{inner}}}}}"#);
    let step = r#""time_offset_to_start":0,"control_type":"speed","control_value":1"#;
    for line in [
        request(r#""control_value":[],"control_value":[]"#),
        request(&format!(r#""control_value":[{{{step},"control_value":2}}]"#)),
        request(&format!(r#""control_value":[{{{step},"control_value_2":2,"control_value_2":2}}]"#)),
        request(r#""control_value":[],"stop_condition":{"pending":1,"pending":2}"#),
        request(r#""control_value":[],"timestamp":null,"timestamp":null"#),
        device(&format!(r#"{{"speed":{{{limits},"max_value":2}}}}"#)),
        device(&format!(r#"{{"speed":{{{limits}}},"speed":{{{limits}}}}}"#)),
        device(&format!(r#"{{"script":{{{limits},"max_number_of_steps":1,"max_number_of_steps":2}}}}"#)),
        device(&format!(r#"{{"script":{{{limits},"max_value":2,"max_number_of_steps":1}}}}"#)),
        device(r#"{"sensor":{"min_value":0,"max_value":1,"max_value":1}}"#),
        device("{}").replace(r#""id":"r""#, r#""id":"r","id":"s""#),
        device("{}").replace(r#""id":"d""#, r#""id":"d","id":"e""#),
        r#"{"availability_request":{"timestamp":null,"timestamp":null}}"#.to_owned(),
    ] {
        let error = decode_one(&line).expect_err(&line);
        assert!(error.to_string().contains("duplicate"), "{error}: {line}");
    }
}

#[test]
fn lone_surrogate_is_refused_and_control_characters_round_trip() {
    let line = r#"{"control_request":{"device_id":"\ud800","control_type":"sensor"}}"#;
    assert!(decode_one(line).is_err());
    let control = r#"{"control_request":{"device_id":"d\u0000\n","control_type":"sensor"}}"#;
    let message = decode_one(control).unwrap();
    assert_eq!(line_of(&message).trim_end(), control);
}

#[test]
fn content_hash_depends_only_on_the_steps() {
    let script = |value| Command::Script(Script::new(vec![step(0.0, value)]).unwrap());
    assert_eq!(script(1.0).content_hash(), script(1.0).content_hash());
    assert_ne!(script(1.0).content_hash(), script(2.0).content_hash());
}

/// Encodes a message and decodes it again. Returns the decoded message.
fn through(encoding: Encoding, message: &Message) -> Message {
    let mut bytes = Vec::new();
    encode_as(encoding, message, &mut bytes);
    let mut decoder = Decoder::default();
    decoder.push(&bytes);
    let decoded = decoder.next_message().unwrap().unwrap();
    assert_eq!(decoder.encoding(), encoding);
    assert!(decoder.next_message().is_none());
    decoded
}

proptest::proptest! {
    #[test]
    fn every_message_round_trips_through_both_encodings(message in arbitrary::message()) {
        let framed = through(Encoding::MessagePack, &message);
        proptest::prop_assert_eq!(&framed, &message);
        proptest::prop_assert_eq!(&through(Encoding::Json, &message), &message);
        if let (Message::ControlRequest(framed), Message::ControlRequest(message)) = (&framed, &message) {
            proptest::prop_assert_eq!(framed.command.content_hash(), message.command.content_hash());
        }
    }

    #[test]
    fn script_with_cached_text_is_written_like_one_without(message in arbitrary::message()) {
        let (before, compact) = (line_of(&message), frame_of(&message));
        match &message {
            Message::ControlRequest(request) => {
                let _hash = request.command.content_hash();
            }
            Message::ControlResponse(ControlResponse { status_value: StatusValue::Script(script), .. }) => {
                let _hash = Command::Script(script.clone()).content_hash();
            }
            _ => {}
        }
        proptest::prop_assert_eq!(&line_of(&message), &before);
        proptest::prop_assert_eq!(format!("{}\n", serde_json::to_string(&message).unwrap()), before);
        proptest::prop_assert_eq!(frame_of(&message), compact);
    }

    #[test]
    fn decoder_never_panics(bytes: Vec<u8>, cut in 0usize..64) {
        let mut decoder = Decoder::new(256);
        let (a, b) = bytes.split_at(cut.min(bytes.len()));
        decoder.push(a);
        while decoder.next_message().is_some() {}
        decoder.push(b);
        while decoder.next_message().is_some() {}
    }

    #[test]
    fn stream_split_anywhere_yields_the_same_messages(cut in 0usize..PAPER_SCRIPT.len()) {
        let mut decoder = Decoder::default();
        decoder.push(&PAPER_SCRIPT.as_bytes()[..cut]);
        proptest::prop_assert!(decoder.next_message().is_none());
        decoder.push(&PAPER_SCRIPT.as_bytes()[cut..]);
        decoder.push(b"\n");
        proptest::prop_assert!(decoder.next_message().unwrap().is_ok());
    }
}

#[cfg(feature = "schema")]
mod schema {
    use std::collections::BTreeSet;

    use serde_json::Value;

    use super::*;

    /// Collects in `found` the keys of a message that the schema does not list for their object. Ignores the keys of control values,
    /// which the schema lists separately, and the keys of a `custom_N`, which its robot defines.
    fn unlisted(root: &Value, schema: &Value, message: &Value, found: &mut BTreeSet<String>) {
        if let Some(reference) = schema["$ref"].as_str() {
            let definition = &root["$defs"][reference.rsplit('/').next().unwrap()];
            if let (Some(listed), Value::Object(map)) = (definition["properties"].as_object(), message) {
                let apart = |key: &&String| key.starts_with("control_value") || key.starts_with("custom_");
                found.extend(map.keys().filter(|key| !listed.contains_key(*key) && !apart(key)).cloned());
            }
            return unlisted(root, definition, message, found);
        }
        let forms =
            ["anyOf", "oneOf"].into_iter().flat_map(|word| schema[word].as_array().into_iter().flatten());
        forms.for_each(|form| unlisted(root, form, message, found));
        match message {
            Value::Object(map) => {
                map.iter().for_each(|(key, inner)| unlisted(root, &schema["properties"][key], inner, found));
            }
            Value::Array(items) => {
                items.iter().for_each(|item| unlisted(root, &schema["items"], item, found));
            }
            _ => {}
        }
    }

    proptest::proptest! {
        #[test]
        fn schema_lists_every_written_key(message in arbitrary::message()) {
            let schema = crate::message_schema();
            let written: Value = serde_json::from_str(&line_of(&message)).unwrap();
            let mut found = BTreeSet::new();
            unlisted(&schema, &schema, &written, &mut found);
            proptest::prop_assert_eq!(found, BTreeSet::new());
        }
    }
}
