//! Strings of bounded length: identifiers and labels.

use std::fmt;
use std::sync::Arc;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::limits::{LimitError, STRING_CHARS_MAX};

/// A text for people as displayed: cut if it exceeds the maximum length of a string.
pub(crate) fn shortened(text: &str) -> String {
    match text.char_indices().nth(STRING_CHARS_MAX - 1) {
        Some((end, last)) if end + last.len_utf8() < text.len() => format!("{}…", &text[..end]),
        _ => text.to_owned(),
    }
}

/// Reads a text for people and keeps only the displayed part, so that another party cannot make it arbitrarily long.
pub(crate) fn shortened_on_reading<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    struct Text;

    impl de::Visitor<'_> for Text {
        type Value = String;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a string")
        }

        fn visit_str<E: de::Error>(self, text: &str) -> Result<String, E> {
            Ok(shortened(text))
        }
    }

    deserializer.deserialize_str(Text)
}

/// Checks that a string is within the protocol's limit.
pub(crate) fn check_length(text: &str) -> Result<(), LimitError> {
    // The number of bytes is an upper bound of the number of characters, so most strings need no counting.
    if text.len() <= STRING_CHARS_MAX {
        return Ok(());
    }
    match text.chars().count() {
        chars if chars <= STRING_CHARS_MAX => Ok(()),
        chars => Err(LimitError::StringTooLong { chars }),
    }
}

fn check_identifier(text: &str) -> Result<(), LimitError> {
    if text.is_empty() { Err(LimitError::EmptyIdentifier) } else { check_length(text) }
}

// Clones share their text, because every step of a script names its device and its request.
macro_rules! bounded_string {
    ($(#[$doc:meta])* $name:ident, $check:ident) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(Arc<str>);

        impl $name {
            /// Creates it from a string of at most 256 characters.
            ///
            /// # Errors
            /// [`LimitError`] if the string is longer or, for an identifier, empty.
            pub fn new(text: impl Into<String>) -> Result<Self, LimitError> {
                let text = text.into();
                $check(&text)?;
                Ok(Self(text.into()))
            }

            /// The text itself.
            #[must_use]
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(&self.0)
            }
        }

        impl std::borrow::Borrow<str> for $name {
            fn borrow(&self) -> &str {
                &self.0
            }
        }

        impl std::str::FromStr for $name {
            type Err = LimitError;

            fn from_str(text: &str) -> Result<Self, LimitError> {
                Self::new(text)
            }
        }

        impl Serialize for $name {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_str(&self.0)
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                Self::new(String::deserialize(deserializer)?).map_err(de::Error::custom)
            }
        }
    };
}

bounded_string!(
    /// Identifies a robot uniquely (initialization block, key `id`).
    RobotId,
    check_identifier
);
bounded_string!(
    /// Identifies a device among the devices of its robot.
    DeviceId,
    check_identifier
);
bounded_string!(
    /// Associates responses with the request that they answer (our extension).
    RequestId,
    check_length
);
bounded_string!(
    /// One run of a scheduler: the robot belongs to the session that drives it until that ends (our extension).
    SessionId,
    check_identifier
);
bounded_string!(
    /// A text for people, or a word that only the peer interprets.
    Label,
    check_length
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_counts_characters_and_not_bytes() {
        assert!(Label::new("я".repeat(256)).is_ok());
        assert_eq!(Label::new("я".repeat(257)), Err(LimitError::StringTooLong { chars: 257 }));
    }

    #[test]
    fn of_the_reason_of_an_error_as_much_is_kept_as_any_string_may_have() {
        for (chars, kept) in [(256, 256), (257, 256), (1_000_000, 256)] {
            let json = format!(r#"{{"code":"internal","message":"{}"}}"#, "я".repeat(chars));
            let error: crate::ControlError = serde_json::from_str(&json).unwrap();
            assert_eq!(error.message.chars().count(), kept);
            assert_eq!(error.message.ends_with('…'), chars > 256);
        }
    }

    #[test]
    fn an_identifier_is_not_empty() {
        assert_eq!(DeviceId::new(""), Err(LimitError::EmptyIdentifier));
    }
}
