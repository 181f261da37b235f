//! Tests streams that contain messages in both encodings: complete, cut, overlong and invalid messages.

use super::*;
use crate::{AvailabilityRequest, Command, ControlRequest, Script};

/// Encodes `payload` as a frame.
fn frame(payload: &[u8]) -> Vec<u8> {
    let length = u32::try_from(payload.len()).unwrap();
    [&[frame::MARK], length.to_be_bytes().as_slice(), payload].concat()
}

fn ping() -> Message {
    Message::AvailabilityRequest(AvailabilityRequest::default())
}

fn cancel(device: &str) -> Message {
    let command = Command::Script(Script::cancel());
    Message::ControlRequest(ControlRequest::immediate(device.parse().unwrap(), command))
}

fn written(encoding: Encoding, message: &Message) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode_as(encoding, message, &mut bytes);
    bytes
}

/// Returns the decoding error for a frame with `payload`. Checks that the decoder still reads the next message.
#[track_caller]
fn refused(payload: &[u8]) -> DecodeError {
    let mut decoder = Decoder::default();
    decoder.push(&frame(payload));
    decoder.push(&written(Encoding::Json, &ping()));
    let error = decoder.next_message().unwrap().unwrap_err();
    assert_eq!(decoder.encoding(), Encoding::MessagePack);
    assert_eq!(decoder.next_message(), Some(Ok(ping())), "what follows");
    error
}

#[track_caller]
fn check_not_message_pack(payload: &[u8], says: &str) {
    let error = refused(payload);
    let DecodeErrorKind::NotMessagePack { message } = &error.kind else { panic!("{error:?}") };
    assert!(message.contains(says), "{message}");
}

/// Encodes a control request in MessagePack, with `fields` in addition to the mandatory ones.
fn request(fields: &[(&str, &[u8])]) -> Vec<u8> {
    let text = |text: &str| [&[0xD9, u8::try_from(text.len()).unwrap()], text.as_bytes()].concat();
    let mut payload = [&[0x81], text("control_request").as_slice()].concat();
    payload.push(0x80 | u8::try_from(fields.len() + 2).unwrap());
    payload.extend([text("device_id"), text("d"), text("request_id"), text("r")].concat());
    for (key, value) in fields {
        payload.extend(text(key));
        payload.extend_from_slice(value);
    }
    payload
}

#[track_caller]
fn check_invalid(payload: &[u8], path: &str, says: &str) {
    let error = refused(payload);
    let DecodeErrorKind::Invalid { path: found, message } = &error.kind else { panic!("{error:?}") };
    assert!(message.contains(says), "{message}");
    assert_eq!(found, path);
    assert_eq!(error.device_id.unwrap().as_str(), "d");
    assert_eq!(error.request_id.unwrap().as_str(), "r");
}

const POSITION: &[u8] = b"\xA8position";
const SCRIPT: &[u8] = b"\xA6script";

#[test]
fn mixed_lines_and_frames_are_decoded_wherever_the_stream_is_split() {
    let expected = [
        (Encoding::Json, ping()),
        (Encoding::MessagePack, cancel("a")),
        (Encoding::MessagePack, ping()),
        (Encoding::Json, cancel("b")),
        (Encoding::MessagePack, cancel("c")),
    ];
    let mut stream: Vec<u8> = expected.iter().flat_map(|(encoding, m)| written(*encoding, m)).collect();
    stream.extend_from_slice(b"\r\n \n");
    for cut in 0..=stream.len() {
        let mut decoder = Decoder::default();
        let mut found = Vec::new();
        for part in [&stream[..cut], &stream[cut..]] {
            decoder.push(part);
            while let Some(decoded) = decoder.next_message() {
                found.push((decoder.encoding(), decoded.unwrap()));
            }
        }
        assert_eq!(found, expected, "cut at {cut}");
    }
}

#[test]
fn frame_received_byte_by_byte_is_decoded_at_its_last_byte() {
    let bytes = written(Encoding::MessagePack, &cancel("a"));
    let mut decoder = Decoder::default();
    for byte in &bytes[..bytes.len() - 1] {
        decoder.push(&[*byte]);
        assert_eq!(decoder.next_message(), None);
    }
    decoder.push(&bytes[bytes.len() - 1..]);
    assert_eq!(decoder.next_message(), Some(Ok(cancel("a"))));
}

#[test]
fn overlong_frame_is_refused_from_its_header_and_skipped() {
    for chunk in [1, 7, 64, 10_000] {
        let mut stream = frame(&vec![b'x'; 5_000]);
        stream.extend(written(Encoding::MessagePack, &ping()));
        let mut decoder = Decoder::new(4_999);
        let mut found = Vec::new();
        for part in stream.chunks(chunk) {
            decoder.push(part);
            found.extend(std::iter::from_fn(|| decoder.next_message()));
        }
        let kind = DecodeErrorKind::FrameTooLong { length: 5_000, limit: 4_999 };
        assert_eq!(found, [Err(DecodeError::bare(kind)), Ok(ping())], "by {chunk}");
    }
}

#[test]
fn garbage_between_messages_causes_one_error_each_and_loses_no_message() {
    let mut decoder = Decoder::new(100);
    let stream = [
        written(Encoding::MessagePack, &ping()),
        b"\xff\xC1 garbage\n".to_vec(),
        written(Encoding::MessagePack, &cancel("a")),
        frame(b"\xC1\xC1\xC1"),
        [&[b'x'; 101], b"\n".as_slice()].concat(),
        written(Encoding::Json, &ping()),
    ];
    decoder.push(&stream.concat());
    let found: Vec<_> = std::iter::from_fn(|| decoder.next_message()).map(|m| m.ok()).collect();
    assert_eq!(found, [Some(ping()), None, Some(cancel("a")), None, None, Some(ping())]);
}

#[test]
fn error_for_invalid_message_pack_states_the_reason() {
    check_not_message_pack(b"", "unexpected end");
    check_not_message_pack(b"\x81", "unexpected end");
    check_not_message_pack(b"\xC1", "Reserved");
    let whole = written(Encoding::MessagePack, &ping());
    check_not_message_pack(&[&whole[5..], b"\xC0"].concat(), "unexpected bytes after the message");
}

#[test]
fn payload_is_a_dictionary_with_one_key() {
    let ping = &written(Encoding::MessagePack, &ping())[6..];
    let two = [b"\x82".as_slice(), ping, ping].concat();
    let list = [b"\x92".as_slice(), ping].concat();
    for payload in [&two, &list, b"\xC0".as_slice(), b"\x05", b"\x80"] {
        let DecodeErrorKind::Invalid { message, .. } = refused(payload).kind else { panic!("{payload:?}") };
        assert!(message.contains("a dictionary with one key"), "{message}");
    }
    let long_form = [b"\xDE\x00\x01".as_slice(), ping].concat();
    let mut decoder = Decoder::default();
    decoder.push(&frame(&long_form));
    assert!(decoder.next_message().unwrap().is_ok());
}

#[test]
fn nesting_depth_is_limited() {
    check_not_message_pack(&b"\x91".repeat(1_000_000), "more than 128 nested levels");
    check_not_message_pack(&request(&[("colour", &b"\x91".repeat(200))]), "more than 128 nested levels");
    check_not_message_pack(&b"\x81\xA1a".repeat(1_000_000), "more than 128 nested levels");
}

#[test]
fn false_lengths_allocate_no_memory() {
    // Headers of a text, a list of steps and a dictionary that state four billion entries, without any entries.
    for lie in [b"\xDB\xFF\xFF\xFF\xFF", b"\xDD\xFF\xFF\xFF\xFF", b"\xDF\xFF\xFF\xFF\xFF"] {
        check_not_message_pack(
            &request(&[("control_type", SCRIPT), ("control_value", lie)]),
            "unexpected end",
        );
        check_not_message_pack(lie, "unexpected end");
    }
}

#[test]
fn request_beyond_the_limits_is_refused_with_its_path() {
    let nan = [&[0xCB], f64::NAN.to_be_bytes().as_slice()].concat();
    let infinite = [&[0xCA], f32::INFINITY.to_be_bytes().as_slice()].concat();
    for bad in [nan.as_slice(), &infinite] {
        check_invalid(
            &request(&[("control_type", POSITION), ("control_value", bad)]),
            "control_request.control_value",
            "expected a finite number",
        );
        let step = [b"\x91\x93\x00\x00", bad].concat();
        check_invalid(
            &request(&[("control_type", SCRIPT), ("control_value", &step)]),
            "control_request.control_value[0][2]",
            "expected a finite number",
        );
        check_invalid(
            &request(&[("time_offset_to_start", bad), ("control_type", POSITION)]),
            "control_request.time_offset_to_start",
            "expected a finite number",
        );
    }
    let short = [
        (b"\x91\x92\x00\x00".as_slice(), "control_request.control_value[0]", "invalid length 2"),
        (b"\x91\x93\x00\x03\x00", "control_request.control_value[0][1]", "0 (position)"),
        (
            b"\x91\x93\x00\xA6sensor\x00",
            "control_request.control_value[0]",
            "control type `sensor` is not supported in a script step",
        ),
        (
            b"\x92\x93\x01\x00\x00\x93\x00\x00\x00",
            "control_request.control_value",
            "before the previous step",
        ),
    ];
    for (steps, path, says) in short {
        check_invalid(&request(&[("control_type", SCRIPT), ("control_value", steps)]), path, says);
    }
}

#[test]
fn value_of_negative_zero_is_zero() {
    let minus = [&[0xCB], (-0.0f64).to_be_bytes().as_slice()].concat();
    let mut decoder = Decoder::default();
    decoder.push(&frame(&request(&[("control_type", POSITION), ("control_value", &minus)])));
    let Some(Ok(Message::ControlRequest(read))) = decoder.next_message() else { panic!() };
    let Command::Set(setpoint) = &read.command else { panic!() };
    assert_eq!(setpoint.value, 0.0);
    let zero = Command::Set(crate::Setpoint::new(crate::ControlType::Position, 0.0));
    assert_eq!(read.command.content_hash(), zero.content_hash());
}

#[test]
fn steps_with_named_fields_are_accepted() {
    let step = b"\x91\x83\xB4time_offset_to_start\x07\xACcontrol_type\xA5speed\xADcontrol_value\x01";
    let mut decoder = Decoder::default();
    decoder.push(&frame(&request(&[("control_type", SCRIPT), ("control_value", step)])));
    let Some(Ok(Message::ControlRequest(read))) = decoder.next_message() else { panic!() };
    let Command::Script(script) = &read.command else { panic!() };
    assert_eq!(script.steps()[0].offset.get(), 7.0);
}

#[test]
fn steps_of_a_script_are_limited_in_frames_and_in_lines() {
    let script = |count: usize| {
        let mut steps = vec![0xDD];
        steps.extend(u32::try_from(count).unwrap().to_be_bytes());
        steps.extend(b"\x93\x00\x00\x00".repeat(count));
        request(&[("control_type", SCRIPT), ("control_value", &steps)])
    };
    let mut decoder = Decoder::default();
    decoder.push(&frame(&script(crate::SCRIPT_STEPS_MAX)));
    assert!(decoder.next_message().unwrap().is_ok());
    check_invalid(
        &script(crate::SCRIPT_STEPS_MAX + 1),
        "control_request.control_value",
        "more than 262144 steps",
    );
    let shortest = br#"{"time_offset_to_start":0,"control_type":"speed","control_value":0},"#.len();
    assert!(crate::LINE_BYTES_MAX / shortest <= crate::SCRIPT_STEPS_MAX);
}

#[test]
fn non_finite_custom_parameter_is_refused() {
    let block = serde_json::json!({"initialization_block": {"id": "r", "api_version": "1", "devices": [
        {"id": "d", "name": "d", "available_control_types": {"custom_1": {"gain": 0.1}}}]}});
    let mut payload = rmp_serde::to_vec_named(&block).unwrap();
    let gain = payload.windows(8).position(|bytes| *bytes == 0.1f64.to_be_bytes()).unwrap();
    payload[gain..gain + 8].copy_from_slice(&f64::NAN.to_be_bytes());
    let DecodeErrorKind::Invalid { path, message } = refused(&payload).kind else { panic!() };
    assert!(message.contains("expected a finite number"), "{message}");
    assert!(path.ends_with("custom_1.gain"), "{path}");
}
