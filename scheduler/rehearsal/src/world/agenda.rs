//! The events of a virtual world and their order.

use std::collections::BTreeMap;

use urrcp::{Server, Timestamp};

/// The scheduled items of a world, ordered by the instants at which they are due. Items that are due at the same instant keep the order
/// of insertion.
#[derive(Debug)]
pub struct Agenda<T> {
    items: BTreeMap<(Timestamp<Server>, u64), T>,
    /// Number of items inserted so far.
    count: u64,
}

impl<T> Agenda<T> {
    /// Adds an item that is due at `at`.
    pub fn put(&mut self, at: Timestamp<Server>, item: T) {
        self.items.insert((at, self.count), item);
        self.count += 1;
    }

    /// Returns the next item and the instant at which it is due; `None` if there is no item.
    #[must_use]
    pub fn peek(&self) -> Option<(Timestamp<Server>, &T)> {
        self.items.first_key_value().map(|((at, _), item)| (*at, item))
    }

    /// Removes and returns the next item if it is due at or before `now`.
    pub fn pop_due(&mut self, now: Timestamp<Server>) -> Option<T> {
        let first = self.items.first_entry()?;
        (first.key().0 <= now).then(|| first.remove())
    }

    /// Iterates over all items, in the order in which they are due.
    pub fn items(&self) -> impl Iterator<Item = &T> {
        self.items.values()
    }
}

impl<T> Default for Agenda<T> {
    fn default() -> Self {
        Self { items: BTreeMap::new(), count: 0 }
    }
}

#[cfg(test)]
mod tests {
    use urrcp::Span;

    use super::Agenda;
    use crate::dry_run::BEGIN;

    #[test]
    fn items_at_one_time_keep_their_order_and_later_ones_wait() {
        let mut agenda = Agenda::default();
        let later = BEGIN + Span::from_millis(1);
        for (at, item) in [(later, 'd'), (BEGIN, 'a'), (BEGIN, 'b'), (later, 'e'), (BEGIN, 'c')] {
            agenda.put(at, item);
        }
        let due: String = std::iter::from_fn(|| agenda.pop_due(BEGIN)).collect();
        assert_eq!((due.as_str(), agenda.peek()), ("abc", Some((later, &'d'))));
    }
}
