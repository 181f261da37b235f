//! The origin of a value in a movement, if the value does not come from its own place in the file. It comes from a parameter that a cue
//! passes to a move, or from a change by the cue.

use std::sync::Arc;

use crate::fields::{At, Reader};
use crate::finding::Place;
use crate::node::Node;

/// A change of all values of a movement: `about + factor * (value - about)`.
#[derive(Clone, Debug)]
pub(crate) struct Changed {
    pub(crate) change: Change,
    pub(crate) about: f64,
    pub(crate) factor: f64,
    pub(crate) place: Place,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Change {
    Scale,
    Mirror,
}

impl Changed {
    /// Returns the value that this change turns into `value`.
    pub(crate) fn undone(&self, value: f64) -> f64 {
        self.about + (value - self.about) / self.factor
    }
}

/// Items (by index) whose values depend on a parameter, each with the place of the parameter's argument.
pub(crate) type Givens = Vec<(u32, Given)>;

/// The place of a parameter's argument, on which a value depends.
#[derive(Clone, Debug)]
pub(crate) struct Given {
    pub(crate) place: Arc<Place>,
    /// Whether the value is just the parameter, as opposed to an expression that contains it.
    pub(crate) is_alone: bool,
}

/// Returns the place of the argument for the first parameter on which the value at `at` depends.
pub(super) fn given(reader: &Reader, at: &At<'_>) -> Option<Given> {
    let Node::Text(text) = at.node else { return None };
    let is_part = |c: char| c.is_alphanumeric() || c == '_';
    let names = text.split('$').skip(1).map(|rest| rest.split(|c| !is_part(c)).next().unwrap_or_default());
    let place = names.filter_map(|name| reader.scope.place(name)).next().cloned()?;
    Some(Given {
        place,
        is_alone: text.trim().strip_prefix('$').is_some_and(|name| name.chars().all(is_part)),
    })
}
