//! Names in Unicode: of the encodings that one name may have, that in normalization form C (Unicode Standard Annex 15) is compared. File
//! names of a Macintosh, and texts copied from them, are decomposed.
//!
//! Names in scenarios are composed when they are read. Those of robots and devices stay as they are, for robots compare bytes.

use std::borrow::Cow;

use icu_normalizer::ComposingNormalizerBorrowed;

use crate::node::Node;

/// A name in normalization form C.
pub(crate) fn composed(name: &str) -> Cow<'_, str> {
    match name.is_ascii() {
        true => Cow::Borrowed(name),
        false => ComposingNormalizerBorrowed::new_nfc().normalize(name),
    }
}

/// Whether two names differ in their encoding at most.
pub(crate) fn is_same(a: &str, b: &str) -> bool {
    a == b || !(a.is_ascii() && b.is_ascii()) && composed(a) == composed(b)
}

/// Composes all keys and texts of a tree.
pub(crate) fn compose(node: &mut Node) {
    match node {
        Node::Text(text) => compose_text(text),
        Node::List(items) => items.nodes_mut().iter_mut().for_each(compose),
        Node::Map(entries) => {
            for (key, value) in entries {
                compose_text(key);
                compose(value);
            }
        }
        Node::Null | Node::Bool(_) | Node::Number(_) | Node::Tagged(_) => {}
    }
}

fn compose_text(text: &mut String) {
    if let Cow::Owned(composed) = composed(text) {
        *text = composed;
    }
}
