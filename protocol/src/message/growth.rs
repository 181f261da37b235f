//! Blocks of robots of a later version. A message may contain words that this version does not know; they are skipped. In a file, the same
//! words are mistakes, which are reported.

use std::cell::Cell;

use serde::{Deserialize, Deserializer};

use super::InitializationBlock;

thread_local! {
    /// Whether a message is read. Serde passes no context to the types within a block.
    static IN_MESSAGE: Cell<bool> = const { Cell::new(false) };
}

/// Deserializes the block of a message, and skips unknown types of robots, control types and interpolations.
pub(super) fn block<'de, D: Deserializer<'de>>(deserializer: D) -> Result<InitializationBlock, D::Error> {
    let before = IN_MESSAGE.replace(true);
    let block = InitializationBlock::deserialize(deserializer);
    IN_MESSAGE.set(before);
    block
}

/// Whether unknown words are skipped.
pub(super) fn skips_unknown_words() -> bool {
    IN_MESSAGE.get()
}

/// A word of a list of a version: a known one, or one of a later version.
pub(super) enum Word<T> {
    Known(T),
    Later,
}

impl<'de, T: Deserialize<'de>> Word<T> {
    /// Deserializes a text with the deserializer of `T`. An unknown word is an error, except in a message.
    pub(super) fn read<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if !skips_unknown_words() {
            return T::deserialize(deserializer).map(Self::Known);
        }
        let text = crate::text::Label::deserialize(deserializer)?;
        let known = T::deserialize(serde::de::value::StrDeserializer::<D::Error>::new(text.as_str()));
        Ok(known.map_or(Self::Later, Self::Known))
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Word<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::read(deserializer)
    }
}
