//! Variables in force: those of the files, and inside a move its parameters before them.

use std::collections::HashMap;
use std::sync::Arc;

use downbeat_yaml::finding::Place;
use downbeat_yaml::node::Node;

/// Names with their values, the innermost last.
#[derive(Clone, Debug, Default)]
pub struct Scope {
    all: Vec<Variable>,
    /// Where the values of a name stand.
    by_name: HashMap<String, Vec<usize>>,
}

/// A name with its value.
#[derive(Clone, Debug)]
pub struct Variable {
    name: String,
    value: Node,
    /// Where a parameter of a sequence is given its value.
    place: Option<Arc<Place>>,
}

impl Scope {
    /// The value of a variable.
    pub fn get(&self, name: &str) -> Option<&Node> {
        self.last(name).map(|place| &self.all[place].value)
    }

    fn last(&self, name: &str) -> Option<usize> {
        self.by_name.get(name).and_then(|places| places.last().copied())
    }

    /// Every name that has a value.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.all.iter().map(|variable| variable.name.as_str())
    }

    /// Null stands for a value that is missing or wrong, which is told elsewhere: what uses it is left out without a word.
    pub fn set(&mut self, name: impl Into<String>, value: Node) {
        self.set_given(name, value, None);
    }

    /// The value of a parameter, and where it is given.
    pub fn set_given(&mut self, name: impl Into<String>, value: Node, place: Option<Arc<Place>>) {
        self.add(Variable { name: name.into(), value, place });
    }

    fn add(&mut self, variable: Variable) {
        self.by_name.entry(variable.name.clone()).or_default().push(self.all.len());
        self.all.push(variable);
    }

    /// Where the value of a name is given, if it is a parameter of a sequence.
    pub fn place(&self, name: &str) -> Option<&Arc<Place>> {
        self.last(name).and_then(|last| self.all[last].place.as_ref())
    }

    /// How many there are, for [`Self::forget`].
    pub fn mark(&self) -> usize {
        self.all.len()
    }

    /// Takes out everything set after the mark, to be put back by [`Self::restore`].
    pub fn hide(&mut self, mark: usize) -> Vec<Variable> {
        let hidden = self.all.get(mark..).map(<[_]>::to_vec).unwrap_or_default();
        self.forget(mark);
        hidden
    }

    /// Puts back what was hidden.
    pub fn restore(&mut self, hidden: impl IntoIterator<Item = Variable>) {
        hidden.into_iter().for_each(|variable| self.add(variable));
    }

    /// Drops everything set after the mark.
    pub fn forget(&mut self, mark: usize) {
        for variable in self.all.drain(mark.min(self.all.len())..) {
            if let Some(places) = self.by_name.get_mut(&variable.name) {
                places.pop();
            }
        }
    }
}
