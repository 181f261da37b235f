//! Compares two plans, or two missions that were played. Values are compared exactly; `text` formats the differences for people.

mod acts;
pub(crate) mod listed;
mod played;
mod runs;
mod scripts;
mod steps;
pub mod text;

use serde::Serialize;

pub use acts::{PlanDifferences, plans};
pub use runs::{RunDifferences, runs};

/// A value that differs between the first plan or mission, `a`, and the second, `b`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Change<T> {
    pub(crate) a: T,
    pub(crate) b: T,
}

impl<T: PartialEq> Change<T> {
    /// Creates a change from `a` to `b`; `None` if the values are equal.
    fn of(a: T, b: T) -> Option<Self> {
        (a != b).then_some(Self { a, b })
    }
}

/// Which of two plans or missions contains an item.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Presence {
    /// Both contain the item, but it differs.
    Changed,
    /// Only the second contains the item.
    Added,
    /// Only the first contains the item.
    Removed,
}

impl Presence {
    const fn of<T, U>(a: Option<&T>, b: Option<&U>) -> Self {
        match (a, b) {
            (Some(_), None) => Self::Removed,
            (None, Some(_)) => Self::Added,
            _ => Self::Changed,
        }
    }
}

/// Pairs the items of two lists by key. Returns all items of `a` in order with their counterparts, then the items that only `b` has.
/// Among items with equal keys, the nth item of `a` is paired with the nth item of `b`.
fn matched<'a, T, K: Ord>(
    a: &'a [T],
    b: &'a [T],
    key: impl Fn(&'a T) -> K,
) -> Vec<(Option<&'a T>, Option<&'a T>)> {
    use std::collections::{BTreeMap, VecDeque};
    let mut of_b: BTreeMap<K, VecDeque<usize>> = BTreeMap::new();
    for (index, item) in b.iter().enumerate() {
        of_b.entry(key(item)).or_default().push_back(index);
    }
    let mut taken = vec![false; b.len()];
    let mut pairs = Vec::with_capacity(a.len().max(b.len()));
    for item in a {
        let other = of_b.get_mut(&key(item)).and_then(VecDeque::pop_front);
        if let Some(index) = other {
            taken[index] = true;
        }
        pairs.push((Some(item), other.map(|index| &b[index])));
    }
    pairs.extend(b.iter().zip(taken).filter(|(_, taken)| !taken).map(|(item, _)| (None, Some(item))));
    pairs
}

/// Returns whether each of the distinct `numbers` is out of order, that is, not part of a longest increasing subsequence.
fn out_of_order(numbers: &[usize]) -> Vec<bool> {
    // `rows`: the last index of the best sequence of each length. `before`: the predecessor of each number in its best sequence.
    let mut rows: Vec<usize> = Vec::new();
    let mut before: Vec<Option<usize>> = Vec::with_capacity(numbers.len());
    for (index, number) in numbers.iter().enumerate() {
        let length = rows.partition_point(|last| numbers[*last] < *number);
        before.push(length.checked_sub(1).map(|shorter| rows[shorter]));
        match rows.get_mut(length) {
            Some(last) => *last = index,
            None => rows.push(index),
        }
    }
    let mut moved = vec![true; numbers.len()];
    let mut next = rows.last().copied();
    while let Some(index) = next {
        moved[index] = false;
        next = before[index];
    }
    moved
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_moved_items_are_out_of_order() {
        assert_eq!(out_of_order(&[0, 3, 1, 2]), [false, true, false, false]);
        assert_eq!(out_of_order(&[1, 0]).iter().filter(|moved| **moved).count(), 1);
        assert_eq!(out_of_order(&[]), [] as [bool; 0]);
    }

    #[test]
    fn equal_keys_are_matched_in_order() {
        let (a, b) = ([("x", 1), ("x", 2), ("y", 3)], [("z", 4), ("x", 5)]);
        let pairs: Vec<_> =
            matched(&a, &b, |item| item.0).iter().map(|(a, b)| (a.map(|a| a.1), b.map(|b| b.1))).collect();
        assert_eq!(pairs, [(Some(1), Some(5)), (Some(2), None), (Some(3), None), (None, Some(4))]);
    }
}
