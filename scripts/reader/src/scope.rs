//! The variables in scope: those that the files define, and the parameters of moves, which shadow variables of the same name.

use std::collections::HashMap;
use std::sync::Arc;

use downbeat_yaml::finding::Place;
use downbeat_yaml::node::Node;

/// Variables with their values. An inner variable shadows outer ones of the same name.
#[derive(Clone, Debug, Default)]
pub struct Scope {
    all: Vec<Variable>,
    /// For each name, the indices in `all` of the variables with that name, innermost last.
    by_name: HashMap<String, Vec<usize>>,
}

/// A variable or parameter with its value.
#[derive(Clone, Debug)]
pub struct Variable {
    name: String,
    value: Node,
    /// The place that assigns the value, for a parameter of a move or a sequence; otherwise `None`.
    place: Option<Arc<Place>>,
}

impl Scope {
    /// The value of the innermost variable with this name.
    pub fn get(&self, name: &str) -> Option<&Node> {
        self.last(name).map(|place| &self.all[place].value)
    }

    fn last(&self, name: &str) -> Option<usize> {
        self.by_name.get(name).and_then(|places| places.last().copied())
    }

    /// Returns the names of all variables in scope.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.all.iter().map(|variable| variable.name.as_str())
    }

    /// Sets a variable. Null marks a missing or wrong value that is already reported: the reader silently ignores uses of such a
    /// variable.
    pub fn set(&mut self, name: impl Into<String>, value: Node) {
        self.set_given(name, value, None);
    }

    /// Sets a parameter, with the place that assigns its value.
    pub fn set_given(&mut self, name: impl Into<String>, value: Node, place: Option<Arc<Place>>) {
        self.add(Variable { name: name.into(), value, place });
    }

    fn add(&mut self, variable: Variable) {
        self.by_name.entry(variable.name.clone()).or_default().push(self.all.len());
        self.all.push(variable);
    }

    /// The place that assigns the value of a variable, if the variable is a parameter of a move or a sequence.
    pub fn place(&self, name: &str) -> Option<&Arc<Place>> {
        self.last(name).and_then(|last| self.all[last].place.as_ref())
    }

    /// Returns a mark for [`Self::forget`] and [`Self::hide`]: the number of variables.
    pub fn mark(&self) -> usize {
        self.all.len()
    }

    /// Removes all variables that were set after the mark. Returns them for [`Self::restore`].
    pub fn hide(&mut self, mark: usize) -> Vec<Variable> {
        let hidden = self.all.get(mark..).map(<[_]>::to_vec).unwrap_or_default();
        self.forget(mark);
        hidden
    }

    /// Restores variables that [`Self::hide`] has removed.
    pub fn restore(&mut self, hidden: impl IntoIterator<Item = Variable>) {
        hidden.into_iter().for_each(|variable| self.add(variable));
    }

    /// Drops all variables that were set after the mark.
    pub fn forget(&mut self, mark: usize) {
        for variable in self.all.drain(mark.min(self.all.len())..) {
            if let Some(places) = self.by_name.get_mut(&variable.name) {
                places.pop();
            }
        }
    }
}
