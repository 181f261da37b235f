//! Strings of bounded length: identifiers and labels.

use std::fmt;
use std::sync::Arc;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::limits::{LimitError, STRING_CHARS_MAX};

/// Shortens a text for people to the protocol's maximum string length. A shortened text ends with `…`.
pub(crate) fn shortened(text: &str) -> String {
    match text.char_indices().nth(STRING_CHARS_MAX - 1) {
        Some((end, last)) if end + last.len_utf8() < text.len() => format!("{}…", &text[..end]),
        _ => text.to_owned(),
    }
}

/// Deserializes a text for people and shortens it, so that a peer cannot make it arbitrarily long.
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

/// Checks that a string does not exceed the protocol's maximum length.
pub(crate) fn check_length(text: &str) -> Result<(), LimitError> {
    // A string never has more characters than bytes, so the characters of most strings need not be counted.
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

// Clones share the text, because the same ids occur in very many places.
macro_rules! bounded_string {
    ($(#[$doc:meta])* $name:ident, $check:ident) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(Arc<str>);

        impl $name {
            /// Creates a value from a string of at most 256 characters.
            ///
            /// # Errors
            /// [`LimitError`] if the string is longer or, for an identifier, empty.
            pub fn new(text: impl Into<String>) -> Result<Self, LimitError> {
                let text = text.into();
                $check(&text)?;
                Ok(Self(text.into()))
            }

            /// The string.
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
    /// The unique id of a robot (key `id` of the initialization block).
    RobotId,
    check_identifier
);
bounded_string!(
    /// The id of a device, unique within its robot.
    DeviceId,
    check_identifier
);
bounded_string!(
    /// The id of a control request, by which responses refer to it (our extension).
    RequestId,
    check_length
);
bounded_string!(
    /// The id of a session, which is one run of a scheduler (our extension). A robot belongs to the session that drives it until that
    /// session ends.
    SessionId,
    check_identifier
);
bounded_string!(
    /// A text for people, or a protocol word that this version does not know.
    Label,
    check_length
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn string_limit_counts_characters_instead_of_bytes() {
        assert!(Label::new("я".repeat(256)).is_ok());
        assert_eq!(Label::new("я".repeat(257)), Err(LimitError::StringTooLong { chars: 257 }));
    }

    #[test]
    fn error_message_is_truncated_to_the_string_limit() {
        for (chars, kept) in [(256, 256), (257, 256), (1_000_000, 256)] {
            let json = format!(r#"{{"code":"internal","message":"{}"}}"#, "я".repeat(chars));
            let error: crate::ControlError = serde_json::from_str(&json).unwrap();
            assert_eq!(error.message.chars().count(), kept);
            assert_eq!(error.message.ends_with('…'), chars > 256);
        }
    }

    #[test]
    fn empty_identifier_is_rejected() {
        assert_eq!(DeviceId::new(""), Err(LimitError::EmptyIdentifier));
    }
}
