//! Reads long runs of plain keyframes, such as `- {at: 40ms, to: 12.5, ease: smooth}`, without the YAML library. The tree of the library
//! needs a kilobyte per keyframe.
//!
//! Each run is cut out of the text and replaced by a marker, and the library reads the remaining text. If the library parses each marker
//! as an item of a list, the runs are put back in their place. Otherwise, for example if a run is in a comment, the library reads the
//! whole text. The result is therefore always the same as with the library alone.

mod condense;
mod run;
#[cfg(test)]
mod tests;

use std::ops::Deref;
use std::sync::{Arc, OnceLock};

use urrcp::Span;

use crate::duration::written;
use crate::node::Node;

pub use condense::condense;

/// The items of a list. A long run of keyframes is converted to nodes only when the items are accessed.
#[derive(Clone, Debug)]
pub enum Items {
    /// The items as nodes.
    Nodes(Vec<Node>),
    /// The items as a long run of keyframes.
    Rows(Arc<Rows>),
}

impl Items {
    /// Returns the nodes of the list, to normalize the names in them. Empty for a long run of keyframes, which contains no names.
    pub fn nodes_mut(&mut self) -> &mut [Node] {
        match self {
            Self::Nodes(nodes) => nodes,
            Self::Rows(_) => &mut [],
        }
    }
}

impl Deref for Items {
    type Target = [Node];

    fn deref(&self) -> &[Node] {
        match self {
            Self::Nodes(nodes) => nodes,
            Self::Rows(rows) => {
                rows.nodes.get_or_init(|| (0..rows.count()).map(|row| rows.node(row)).collect())
            }
        }
    }
}

impl PartialEq for Items {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl<'a> IntoIterator for &'a Items {
    type Item = &'a Node;
    type IntoIter = std::slice::Iter<'a, Node>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

/// The words that may follow `ease:` in a run. A keyframe with another word is read as an ordinary node, so this list need not be
/// complete.
pub const EASES: [&str; 4] = ["linear", "smooth", "cubic", "step"];

/// A run of keyframes of one device, called rows. Each has the same number of values.
#[derive(Debug, Default)]
pub struct Rows {
    times: Vec<Span>,
    /// The values of all rows, concatenated in the order of the rows.
    pub(super) values: Vec<f64>,
    pub(super) width: Width,
    /// For each row, the index of its easing in [`EASES`], or `None`. The list is empty if no row has an easing.
    eases: Vec<Option<u8>>,
    nodes: OnceLock<Vec<Node>>,
}

/// Whether each row has a single number or a list of values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Width {
    /// Each row has a single number.
    #[default]
    One,
    /// Each row has a list with this number of values.
    List(usize),
}

impl Width {
    /// Returns the number of values in a row.
    pub fn count(self) -> usize {
        match self {
            Self::One => 1,
            Self::List(count) => count,
        }
    }
}

/// One keyframe of a run.
#[derive(Clone, Copy, Debug)]
pub struct Row<'a> {
    /// The time of the keyframe.
    pub at: Span,
    /// The values of the keyframe.
    pub values: &'a [f64],
    /// The name of the easing, one of [`EASES`]; `None` if the row has no `ease:`.
    pub ease: Option<&'static str>,
}

impl Rows {
    /// The number of rows.
    pub fn count(&self) -> usize {
        self.times.len()
    }

    /// Returns whether each row has a single number or a list of values.
    pub fn width(&self) -> Width {
        self.width
    }

    /// The rows in order.
    pub fn iter(&self) -> impl Iterator<Item = Row<'_>> {
        (0..self.count()).map(|row| self.row(row))
    }

    fn row(&self, row: usize) -> Row<'_> {
        let width = self.width.count();
        Row {
            at: self.times[row],
            values: &self.values[row * width..(row + 1) * width],
            ease: self.eases.get(row).copied().flatten().map(|ease| EASES[usize::from(ease)]),
        }
    }

    pub(super) fn node(&self, row: usize) -> Node {
        let Row { at, values, ease } = self.row(row);
        let number = |value: &f64| Node::Number(*value);
        let to = match self.width {
            Width::One => number(&values[0]),
            Width::List(_) => Node::List(Items::Nodes(values.iter().map(number).collect())),
        };
        let mut entries = vec![("at".to_owned(), Node::Text(written(at))), ("to".to_owned(), to)];
        entries.extend(ease.map(|word| ("ease".to_owned(), Node::Text(word.to_owned()))));
        Node::Map(entries)
    }

    pub(super) fn push(&mut self, at: Span, ease: Option<u8>) {
        if ease.is_some() || !self.eases.is_empty() {
            self.eases.resize(self.times.len(), None);
            self.eases.push(ease);
        }
        self.times.push(at);
    }

    pub(super) fn shrink(&mut self) {
        self.times.shrink_to_fit();
        self.values.shrink_to_fit();
        self.eases.shrink_to_fit();
    }
}
