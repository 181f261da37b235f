//! A node of a YAML tree with the path that leads to it. Findings refer to their places by these paths.

use std::sync::Arc;

use crate::finding::{PathStep, Place, Use};
use crate::node::Node;

/// A node with the path that leads to it.
#[derive(Clone, Copy)]
pub struct At<'a> {
    /// The node.
    pub node: &'a Node,
    trail: Trail<'a>,
}

#[derive(Clone, Copy)]
enum Trail<'a> {
    Document(u16, Option<&'a Arc<Use>>),
    Key(&'a At<'a>, &'a str, usize),
    Index(&'a At<'a>, usize),
}

impl<'a> At<'a> {
    /// Creates the root of a file. `file` is the number of the file: 0 for the scenario itself.
    pub fn document(node: &'a Node, file: u16) -> Self {
        Self { node, trail: Trail::Document(file, None) }
    }

    /// Creates the root of a file. `used` is the use that led to reading the file, such as an include.
    pub fn used(node: &'a Node, file: u16, used: Option<&'a Arc<Use>>) -> Self {
        Self { node, trail: Trail::Document(file, used) }
    }

    /// Returns another node with the place of this one.
    pub fn with(&self, node: &'a Node) -> At<'a> {
        At { node, trail: self.trail }
    }

    /// Returns an item of this node, which is a list.
    pub fn item(&'a self, index: usize, node: &'a Node) -> At<'a> {
        At { node, trail: Trail::Index(self, index) }
    }

    /// Returns the value of a key of this node, which is a map. `occurrence` counts equal keys from 0.
    pub fn entry(&'a self, key: &'a str, occurrence: usize, node: &'a Node) -> At<'a> {
        At { node, trail: Trail::Key(self, key, occurrence) }
    }

    /// The place of this node, for findings.
    pub fn place(&self) -> Place {
        let (file, used, path) = self.path();
        Place { file, path, key: false, within: None, used: used.cloned() }
    }

    /// The place of the key that leads to this node.
    pub fn key_place(&self) -> Place {
        let (file, used, path) = self.path();
        Place { file, path, key: true, within: None, used: used.cloned() }
    }

    fn path(&self) -> (u16, Option<&'a Arc<Use>>, Vec<PathStep>) {
        match self.trail {
            Trail::Document(file, used) => (file, used, Vec::new()),
            Trail::Key(parent, key, occurrence) => {
                let (file, used, mut path) = parent.path();
                path.push(PathStep::Key(key.to_owned(), occurrence));
                (file, used, path)
            }
            Trail::Index(parent, index) => {
                let (file, used, mut path) = parent.path();
                path.push(PathStep::Index(index));
                (file, used, path)
            }
        }
    }
}
