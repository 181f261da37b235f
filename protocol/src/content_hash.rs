//! The hash of a command's values. It ensures that a robot executes exactly the values that the server checked.

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de, ser};
use sha2::{Digest, Sha256};

/// SHA-256 over the canonical JSON of a `control_value` (our extension): 64 hexadecimal digits in JSON, 32 bytes in a
/// binary encoding.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct ContentHash([u8; 32]);

impl ContentHash {
    /// Hashes the canonical JSON text of a `control_value`.
    #[must_use]
    pub fn of(canonical_json: &[u8]) -> Self {
        Self(Sha256::digest(canonical_json).into())
    }

    /// The 32 bytes of the hash.
    #[must_use]
    pub const fn bytes(&self) -> &[u8; 32] {
        &self.0
    }
}

impl From<[u8; 32]> for ContentHash {
    fn from(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }
}

impl ContentHash {
    fn digits(&self) -> [u8; 64] {
        const DIGITS: &[u8; 16] = b"0123456789abcdef";
        let mut text = [0; 64];
        for (digits, byte) in text.chunks_exact_mut(2).zip(self.0) {
            digits.copy_from_slice(&[DIGITS[usize::from(byte >> 4)], DIGITS[usize::from(byte & 0xf)]]);
        }
        text
    }
}

impl fmt::Display for ContentHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(std::str::from_utf8(&self.digits()).map_err(|_| fmt::Error)?)
    }
}

impl fmt::Debug for ContentHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl Serialize for ContentHash {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            serializer.serialize_str(std::str::from_utf8(&self.digits()).map_err(ser::Error::custom)?)
        } else {
            serializer.serialize_bytes(&self.0)
        }
    }
}

impl<'de> Deserialize<'de> for ContentHash {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            deserializer.deserialize_str(Digits)
        } else {
            deserializer.deserialize_any(Digits)
        }
    }
}

/// A visitor that deserializes a hash from hexadecimal digits or from raw bytes.
struct Digits;

impl de::Visitor<'_> for Digits {
    type Value = ContentHash;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a SHA-256 hash of 64 hexadecimal digits")
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<ContentHash, E> {
        parse(text).ok_or_else(|| E::custom("invalid content_hash, expected 64 hexadecimal digits"))
    }

    fn visit_bytes<E: de::Error>(self, bytes: &[u8]) -> Result<ContentHash, E> {
        bytes.try_into().map(ContentHash).map_err(|_| E::custom("invalid content_hash, expected 32 bytes"))
    }
}

fn parse(text: &str) -> Option<ContentHash> {
    let mut bytes = [0; 32];
    if text.len() != 64 {
        return None;
    }
    for (byte, pair) in bytes.iter_mut().zip(text.as_bytes().chunks_exact(2)) {
        *byte = digit(pair[0])? << 4 | digit(pair[1])?;
    }
    Some(ContentHash(bytes))
}

/// Returns the value of a hexadecimal digit; `None` for other bytes. Uses a table, because a branch between digits and letters is
/// unpredictable and a misprediction is expensive.
fn digit(letter: u8) -> Option<u8> {
    const NONE: u8 = 0xff;
    const VALUES: [u8; 256] = {
        let (mut values, mut value) = ([NONE; 256], 0);
        while value < 16 {
            values[b"0123456789abcdef"[value] as usize] = value as u8;
            values[b"0123456789ABCDEF"[value] as usize] = value as u8;
            value += 1;
        }
        values
    };
    Some(VALUES[usize::from(letter)]).filter(|value| *value != NONE)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(digits: &str) -> Option<ContentHash> {
        serde_json::from_str(&format!("\"{digits}\"")).ok()
    }

    #[test]
    fn hash_round_trips_and_is_accepted_in_uppercase() {
        for byte in 0..=255 {
            let hash = ContentHash([byte; 32]);
            let text = format!("{byte:02x}").repeat(32);
            assert_eq!(serde_json::to_string(&hash).unwrap(), format!("\"{text}\""));
            assert_eq!((hash.to_string(), read(&text)), (text.clone(), Some(hash)));
            assert_eq!(read(&text.to_ascii_uppercase()), Some(hash));
        }
    }

    #[test]
    fn hash_has_exactly_64_hexadecimal_digits() {
        for other in (1..128_u8).map(char::from).filter(|letter| !letter.is_ascii_hexdigit()) {
            let mut digits = "0".repeat(63);
            digits.insert(usize::from(other as u8) % 64, other);
            assert_eq!(parse(&digits), None, "{other:?}");
        }
        for other in ["", "0", &"0".repeat(63), &"0".repeat(65), &"é".repeat(32)] {
            assert_eq!(read(other), None, "{other}");
        }
    }
}
