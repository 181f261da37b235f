//! Names in Unicode. A name may have several encodings; names are compared in normalization form C (Unicode Standard Annex 15). File
//! names on macOS, and texts copied from them, are decomposed.
//!
//! Names in scenarios are composed when they are read. Names of robots and devices stay as they are, because robots compare bytes.

use std::borrow::Cow;

use icu_normalizer::ComposingNormalizerBorrowed;

/// Converts a name to normalization form C.
pub fn composed(name: &str) -> Cow<'_, str> {
    if name.is_ascii() { Cow::Borrowed(name) } else { ComposingNormalizerBorrowed::new_nfc().normalize(name) }
}

/// Whether two names differ at most in their encoding.
pub fn is_same(a: &str, b: &str) -> bool {
    a == b || !(a.is_ascii() && b.is_ascii()) && composed(a) == composed(b)
}

/// Puts a text into normalization form C.
pub fn compose_text(text: &mut String) {
    if let Cow::Owned(composed) = composed(text) {
        *text = composed;
    }
}
