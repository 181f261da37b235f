//! The indices and numbers of robots and acts. Each has its own type, so that one cannot be used in place of another.

use std::fmt;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut, Index, IndexMut};

use serde::{Deserialize, Serialize};

/// Defines types that contain a number, and are written like that number.
macro_rules! numbers {
    ($($(#[$doc:meta])* $name:ident($number:ty);)+) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(transparent)]
        pub struct $name($number);

        impl $name {
            /// The index or number with this value, counted from 0.
            #[must_use]
            pub const fn new(value: $number) -> Self {
                Self(value)
            }

            /// The value, counted from 0.
            #[must_use]
            pub const fn get(self) -> $number {
                self.0
            }
        }

        impl From<$number> for $name {
            fn from(value: $number) -> Self {
                Self(value)
            }
        }

        impl From<$name> for $number {
            fn from(of: $name) -> Self {
                of.0
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
    )+};
}

numbers! {
    /// The index of a robot among the participants of a mission.
    RobotIndex(usize);
    /// The index of a robot among the members of one act: the robots that take part in it.
    MemberIndex(usize);
    /// The index of an act in the choreography.
    ActIndex(usize);
    /// The number of an act among the acts that a mission has begun. An act that is played again gets another number.
    ActNumber(u32);
}

/// A vector with indices of its own type.
#[derive(Clone, Debug)]
pub struct IndexVec<I, T> {
    items: Vec<T>,
    index: PhantomData<fn(I)>,
}

impl<I: From<usize> + Into<usize>, T> IndexVec<I, T> {
    /// The indices of all items, in order.
    pub fn indices(&self) -> impl ExactSizeIterator<Item = I> + use<I, T> {
        (0..self.items.len()).map(I::from)
    }

    /// All items, in order, each with its index.
    pub fn enumerated(&self) -> impl ExactSizeIterator<Item = (I, &T)> {
        self.items.iter().enumerate().map(|(index, item)| (I::from(index), item))
    }

    /// The index of the first item for which `is_meant` returns true.
    pub fn position(&self, is_meant: impl FnMut(&T) -> bool) -> Option<I> {
        self.items.iter().position(is_meant).map(I::from)
    }

    /// Adds an item at the end.
    pub fn push(&mut self, item: T) {
        self.items.push(item);
    }
}

impl<I, T> FromIterator<T> for IndexVec<I, T> {
    fn from_iter<Items: IntoIterator<Item = T>>(items: Items) -> Self {
        Vec::from_iter(items).into()
    }
}

impl<I, T> From<Vec<T>> for IndexVec<I, T> {
    fn from(items: Vec<T>) -> Self {
        Self { items, index: PhantomData }
    }
}

impl<I, T> Default for IndexVec<I, T> {
    fn default() -> Self {
        Vec::new().into()
    }
}

impl<I: Into<usize>, T> Index<I> for IndexVec<I, T> {
    type Output = T;

    fn index(&self, index: I) -> &T {
        &self.items[index.into()]
    }
}

impl<I: Into<usize>, T> IndexMut<I> for IndexVec<I, T> {
    fn index_mut(&mut self, index: I) -> &mut T {
        &mut self.items[index.into()]
    }
}

impl<I, T> Deref for IndexVec<I, T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.items
    }
}

impl<I, T> DerefMut for IndexVec<I, T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.items
    }
}

impl<'a, I, T> IntoIterator for &'a IndexVec<I, T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.items.iter()
    }
}

impl<'a, I, T> IntoIterator for &'a mut IndexVec<I, T> {
    type Item = &'a mut T;
    type IntoIter = std::slice::IterMut<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.items.iter_mut()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_and_read_like_plain_numbers() {
        let number = ActNumber::new(7);
        assert_eq!(format!("{number} {number:?}"), "7 7");
        assert_eq!(serde_json::to_string(&number).unwrap(), "7");
        assert_eq!(serde_json::from_str::<ActNumber>("7").unwrap(), number);
        assert!(serde_json::from_str::<ActNumber>("-7").is_err());
    }

    #[test]
    fn items_are_found_by_their_own_index() {
        let mut items: IndexVec<RobotIndex, _> = vec!['a', 'b', 'c'].into();
        let place = items.position(|item| *item == 'b').unwrap();
        items[place] = 'x';
        assert_eq!((place, items[place]), (RobotIndex::new(1), 'x'));
        let pairs: Vec<_> = items.enumerated().map(|(index, item)| (index.get(), *item)).collect();
        assert_eq!(pairs, [(0, 'a'), (1, 'x'), (2, 'c')]);
    }
}
