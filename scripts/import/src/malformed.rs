//! The error of readers of binary formats.

/// The fault of a file that cannot be imported, as a sentence for people. A finding reports it; no code distinguishes the faults.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub(super) struct Malformed(String);

impl From<String> for Malformed {
    fn from(sentence: String) -> Self {
        Self(sentence)
    }
}

impl From<&str> for Malformed {
    fn from(sentence: &str) -> Self {
        Self(sentence.to_owned())
    }
}
