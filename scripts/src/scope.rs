//! Variables in force: those of the files, and inside a move its parameters before them.

use crate::node::Node;

/// Names with their values, the innermost last.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scope(Vec<(String, Node)>);

impl Scope {
    pub(crate) fn get(&self, name: &str) -> Option<&Node> {
        self.0.iter().rev().find(|(known, _)| known == name).map(|(_, value)| value)
    }

    /// Every name that has a value.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|(name, _)| name.as_str())
    }

    pub(crate) fn set(&mut self, name: impl Into<String>, value: Node) {
        self.0.push((name.into(), value));
    }

    /// How many there are, for [`Self::forget`].
    pub(crate) fn mark(&self) -> usize {
        self.0.len()
    }

    /// Drops everything set after the mark.
    pub(crate) fn forget(&mut self, mark: usize) {
        self.0.truncate(mark);
    }
}
