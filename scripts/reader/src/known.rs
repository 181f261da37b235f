//! What the reader knows where: every list of keys and words that it compares with a document, with the place. Tests compare the schemas
//! with it.

use std::cell::RefCell;

use downbeat_yaml::at::At;
use downbeat_yaml::finding::Place;

/// One list, and what it is a list of.
#[derive(Clone, Debug)]
pub enum Known {
    /// The keys of a map.
    Keys(Place, Vec<&'static str>),
    /// The words that a value may be.
    Words(Place, Vec<&'static str>),
}

thread_local! {
    static RECORDED: RefCell<Option<Vec<Known>>> = const { RefCell::new(None) };
}

/// Notes a list of keys.
pub(crate) fn keys(at: &At<'_>, keys: &[&'static str]) {
    record(|| Known::Keys(at.place(), keys.to_vec()));
}

/// Notes a list of words.
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

/// Everything that this thread compares while it reads.
pub fn while_reading(read: impl FnOnce()) -> Vec<Known> {
    RECORDED.set(Some(Vec::new()));
    read();
    RECORDED.take().unwrap_or_default()
}
