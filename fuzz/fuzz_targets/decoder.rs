//! Decodes any bytes, pushed in chunks of any size. The messages do not depend on the chunks. The decoder buffers at most one message and
//! one chunk. Each message is unchanged if it is written and read again in either encoding.
#![no_main]

use libfuzzer_sys::fuzz_target;
use urrcp::{DecodeError, Decoder, Encoding, Message, encode_as};

/// Maximum length of a message in bytes. It is short, so that overlong lines are common.
const LIMIT: usize = 1_024;
/// Number of bytes before a frame's payload.
const HEAD: usize = 5;

fn drain(decoder: &mut Decoder, read: &mut Vec<Result<Message, DecodeError>>) {
    while let Some(decoded) = decoder.next_message() {
        read.push(decoded);
    }
}

fn read_again(message: &Message, encoding: Encoding) {
    let mut written = Vec::new();
    encode_as(encoding, message, &mut written);
    let mut decoder = Decoder::default();
    decoder.push(&written);
    let Some(Ok(again)) = decoder.next_message() else { panic!("not read again as {encoding:?}: {message:?}") };
    assert_eq!((&again, decoder.encoding()), (message, encoding));
    assert!(decoder.next_message().is_none(), "one message");
    let mut once_more = Vec::new();
    encode_as(encoding, &again, &mut once_more);
    assert_eq!(written, once_more);
}

fuzz_target!(|bytes: &[u8]| {
    let mut whole = Decoder::new(LIMIT);
    let mut at_once = Vec::new();
    whole.push(bytes);
    drain(&mut whole, &mut at_once);

    let mut cut = Decoder::new(LIMIT);
    let mut piecemeal = Vec::new();
    let mut rest = bytes;
    // The bytes themselves determine the cuts.
    let mut random = bytes.iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
    });
    while !rest.is_empty() {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        let size = (1 + (random >> 33) as usize % 200).min(rest.len());
        let (chunk, behind) = rest.split_at(size);
        cut.push(chunk);
        assert!(cut.buffered() <= HEAD + LIMIT + chunk.len(), "{} bytes held", cut.buffered());
        drain(&mut cut, &mut piecemeal);
        rest = behind;
    }
    assert_eq!(at_once, piecemeal);
    for decoded in at_once {
        match decoded {
            Ok(message) => {
                read_again(&message, Encoding::Json);
                read_again(&message, Encoding::MessagePack);
            }
            Err(error) => assert!(error.to_string().chars().count() <= 1_000, "{error}"),
        }
    }
});
