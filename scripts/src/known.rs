//! What the reader knows where: every list of keys and words that it compared with a document, with the place. Only for tests,
//! which compare the schemas with it.

use std::cell::RefCell;

use crate::at::At;
use crate::finding::Place;

/// One list, and what it is a list of.
#[derive(Clone, Debug)]
pub(crate) enum Known {
    Keys(Place, Vec<&'static str>),
    Words(Place, Vec<&'static str>),
}

thread_local! {
    static RECORDED: RefCell<Vec<Known>> = const { RefCell::new(Vec::new()) };
}

pub(crate) fn keys(at: &At<'_>, keys: &[&'static str]) {
    RECORDED.with_borrow_mut(|recorded| recorded.push(Known::Keys(at.place(), keys.to_vec())));
}

pub(crate) fn words(at: &At<'_>, words: impl Iterator<Item = &'static str>) {
    RECORDED.with_borrow_mut(|recorded| recorded.push(Known::Words(at.place(), words.collect())));
}

/// Everything that was compared on this thread since the last call.
pub(crate) fn take() -> Vec<Known> {
    RECORDED.take()
}
