//! Unicode normalization of names. The same name may be encoded in several ways: file names on macOS, and texts copied from them, are
//! decomposed. Names are therefore compared in normalization form C (Unicode Standard Annex 15).
//!
//! Names in scenarios are converted to form C when they are read. Names of robots and devices remain unchanged, because robots compare
//! bytes.

use std::borrow::Cow;

use icu_normalizer::ComposingNormalizerBorrowed;

/// Converts a name to normalization form C.
pub fn composed(name: &str) -> Cow<'_, str> {
    if name.is_ascii() { Cow::Borrowed(name) } else { ComposingNormalizerBorrowed::new_nfc().normalize(name) }
}

/// Whether two names are equal after normalization, even if they are encoded differently.
pub fn is_same(a: &str, b: &str) -> bool {
    a == b || !(a.is_ascii() && b.is_ascii()) && composed(a) == composed(b)
}

/// Converts a text to normalization form C in place.
pub fn compose_text(text: &mut String) {
    if let Cow::Owned(composed) = composed(text) {
        *text = composed;
    }
}
