//! Records each list of valid keys or words that the reader uses, and the place in the document where it uses the list. Tests compare the
//! schemas with these lists.

use std::cell::RefCell;

use downbeat_yaml::at::At;
use downbeat_yaml::finding::Place;

/// A list of valid keys or words, with the place where the reader used it.
#[derive(Clone, Debug)]
pub enum Known {
    /// The keys that the map at a place may have.
    Keys(Place, Vec<&'static str>),
    /// The words that are valid for the value at a place.
    Words(Place, Vec<&'static str>),
}

thread_local! {
    static RECORDED: RefCell<Option<Vec<Known>>> = const { RefCell::new(None) };
}

/// Records the valid keys of a map.
pub(crate) fn keys(at: &At<'_>, keys: &[&'static str]) {
    record(|| Known::Keys(at.place(), keys.to_vec()));
}

/// Records the valid words of a value.
pub(crate) fn words(at: &At<'_>, words: impl Iterator<Item = &'static str>) {
    record(|| Known::Words(at.place(), words.collect()));
}

fn record(known: impl FnOnce() -> Known) {
    RECORDED.with_borrow_mut(|recorded| {
        if let Some(recorded) = recorded {
            recorded.push(known());
        }
    });
}

/// Runs `read`, and returns the lists that are recorded in this thread meanwhile.
pub fn while_reading(read: impl FnOnce()) -> Vec<Known> {
    RECORDED.set(Some(Vec::new()));
    read();
    RECORDED.take().unwrap_or_default()
}
