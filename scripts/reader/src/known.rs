//! The lists of keys and words that the reader knows. Each list that it compares with a document is recorded, with the place. Tests
//! compare the schemas with these lists.

use std::cell::RefCell;

use downbeat_yaml::at::At;
use downbeat_yaml::finding::Place;

/// A list with its place and kind.
#[derive(Clone, Debug)]
pub enum Known {
    /// The keys of a map.
    Keys(Place, Vec<&'static str>),
    /// The words that a value may have.
    Words(Place, Vec<&'static str>),
}

thread_local! {
    static RECORDED: RefCell<Option<Vec<Known>>> = const { RefCell::new(None) };
}

/// Records a list of keys.
pub(crate) fn keys(at: &At<'_>, keys: &[&'static str]) {
    record(|| Known::Keys(at.place(), keys.to_vec()));
}

/// Records a list of words.
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

/// Runs `read`, and returns the lists that this thread compares meanwhile.
pub fn while_reading(read: impl FnOnce()) -> Vec<Known> {
    RECORDED.set(Some(Vec::new()));
    read();
    RECORDED.take().unwrap_or_default()
}
