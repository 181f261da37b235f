//! Variables in force: those of the files, and inside a move its parameters before them.

use std::collections::HashMap;

use crate::node::Node;

/// Names with their values, the innermost last.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scope {
    all: Vec<(String, Node)>,
    /// Where the values of a name stand.
    by_name: HashMap<String, Vec<usize>>,
}

impl Scope {
    pub(crate) fn get(&self, name: &str) -> Option<&Node> {
        self.by_name.get(name).and_then(|places| places.last()).map(|place| &self.all[*place].1)
    }

    /// Every name that has a value.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.all.iter().map(|(name, _)| name.as_str())
    }

    pub(crate) fn set(&mut self, name: impl Into<String>, value: Node) {
        let name = name.into();
        self.by_name.entry(name.clone()).or_default().push(self.all.len());
        self.all.push((name, value));
    }

    /// How many there are, for [`Self::forget`].
    pub(crate) fn mark(&self) -> usize {
        self.all.len()
    }

    /// Takes out everything set after the mark, to be put back by [`Self::restore`].
    pub(crate) fn hide(&mut self, mark: usize) -> Vec<(String, Node)> {
        let hidden = self.all.get(mark..).map(<[_]>::to_vec).unwrap_or_default();
        self.forget(mark);
        hidden
    }

    /// Puts back what was hidden.
    pub(crate) fn restore(&mut self, hidden: Vec<(String, Node)>) {
        hidden.into_iter().for_each(|(name, value)| self.set(name, value));
    }

    /// Drops everything set after the mark.
    pub(crate) fn forget(&mut self, mark: usize) {
        for (name, _) in self.all.drain(mark.min(self.all.len())..) {
            if let Some(places) = self.by_name.get_mut(&name) {
                places.pop();
            }
        }
    }
}
