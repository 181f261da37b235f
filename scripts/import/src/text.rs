//! Reads text files as other programs save them. They may be in UTF-8, or in UTF-16 with a byte order mark. Lines may end with `\n`, with
//! `\r\n`, or with `\r` as on old Macs.

use downbeat_yaml::finding::Finding;
use downbeat_yaml::source::Source;

/// Decodes the text of a file, with `\n` at the end of each line.
///
/// # Errors
/// Returns a finding if the bytes are not text.
pub(super) fn source(name: &str, bytes: Vec<u8>) -> Result<Source, Finding> {
    let mut source = match of_utf16(&bytes) {
        Some(text) => Source { name: name.to_owned(), text },
        None => Source::of_bytes(name, bytes)?,
    };
    if source.text.contains('\r') {
        source.text = source.text.replace("\r\n", "\n").replace('\r', "\n");
    }
    Ok(source)
}

/// Decodes UTF-16 that begins with a byte order mark. `None` if the mark is missing or the text is invalid.
fn of_utf16(bytes: &[u8]) -> Option<String> {
    let unit: fn([u8; 2]) -> u16 = match bytes.get(..2)? {
        [0xff, 0xfe] => u16::from_le_bytes,
        [0xfe, 0xff] => u16::from_be_bytes,
        _ => return None,
    };
    let (pairs, rest) = bytes[2..].as_chunks::<2>();
    let units = pairs.iter().map(|pair| unit(*pair));
    let text: Result<String, _> = char::decode_utf16(units).collect();
    text.ok().filter(|_| rest.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn utf16_text_and_old_line_endings_are_read() {
        let text = "t;Hüfte\r\n1;2\r3;4\n🦾";
        let le: Vec<u8> =
            [0xfeff].into_iter().chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect();
        let be: Vec<u8> =
            [0xfeff].into_iter().chain(text.encode_utf16()).flat_map(u16::to_be_bytes).collect();
        for bytes in [le.clone(), be, text.as_bytes().to_vec()] {
            assert_eq!(source("t.csv", bytes).unwrap().text, "t;Hüfte\n1;2\n3;4\n🦾");
        }
        for broken in [&le[..le.len() - 1], &[0xff, 0xfe, 0x00, 0xd8]] {
            let message = source("t.csv", broken.to_vec()).unwrap_err().message;
            assert!(message.contains("UTF-16"), "{message}");
        }
    }
}
