//! Long runs of plain keyframes, such as `- {at: 40ms, to: 12.5, ease: smooth}`, read without a tree of the YAML library, which
//! takes a kilobyte for each.
//!
//! Every run is cut out of the text and a marker put in its place. The library reads what is left. A run counts only if its
//! marker comes back as an item of a list: then the run stood where items stand, and not in a text or a comment. In all
//! other cases the whole text is read by the library alone, so that nothing is read otherwise than it would be by itself.

mod condense;
mod run;
#[cfg(test)]
mod tests;

use std::ops::Deref;
use std::sync::{Arc, OnceLock};

use urrcp::Span;

use crate::duration::written;
use crate::motion::Easing;
use crate::node::Node;

pub(crate) use condense::condense;

/// The items of a list. Those of a long run of keyframes become nodes only where they are looked at.
#[derive(Clone, Debug)]
pub(crate) enum Items {
    Nodes(Vec<Node>),
    Rows(Arc<Rows>),
}

impl Items {
    /// Its nodes, but for long runs of keyframes, in which there is no name.
    pub(crate) fn nodes_mut(&mut self) -> &mut [Node] {
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
                rows.nodes.get_or_init(|| (0..rows.len()).map(|row| rows.node(row)).collect())
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

/// Keyframes of one device, each with as many values.
#[derive(Debug, Default)]
pub(crate) struct Rows {
    times: Vec<Span>,
    /// Those of each row one after another.
    pub(super) values: Vec<f64>,
    pub(super) width: Width,
    /// The easing of each row; empty if no row has one.
    eases: Vec<Option<Easing>>,
    nodes: OnceLock<Vec<Node>>,
}

/// How the values of a row are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Width {
    #[default]
    One,
    /// A list of this many.
    List(usize),
}

impl Width {
    pub(crate) fn count(self) -> usize {
        match self {
            Self::One => 1,
            Self::List(count) => count,
        }
    }
}

/// One keyframe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row<'a> {
    pub(crate) at: Span,
    pub(crate) values: &'a [f64],
    pub(crate) ease: Option<Easing>,
}

impl Rows {
    pub(crate) fn len(&self) -> usize {
        self.times.len()
    }

    pub(crate) fn width(&self) -> Width {
        self.width
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = Row<'_>> {
        (0..self.len()).map(|row| self.row(row))
    }

    fn row(&self, row: usize) -> Row<'_> {
        let width = self.width.count();
        Row {
            at: self.times[row],
            values: &self.values[row * width..(row + 1) * width],
            ease: self.eases.get(row).copied().flatten(),
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
        let word = Easing::WORDS.iter().find(|(_, easing)| Some(*easing) == ease);
        entries.extend(word.map(|(word, _)| ("ease".to_owned(), Node::Text((*word).to_owned()))));
        Node::Map(entries)
    }

    pub(super) fn push(&mut self, at: Span, ease: Option<Easing>) {
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
