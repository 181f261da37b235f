//! A file of a show with its tree and the names in it.

use std::path::PathBuf;

use downbeat_reader::keys::{Declaration, Item, Naming};
use downbeat_scripts::{fleet_keys, included_keys, latency_keys, scenario_keys, world_keys};
use downbeat_yaml::identify::Document;
use downbeat_yaml::tree::Tree;

use crate::text::Text;
use crate::typed::{Mention, Typed, devices, typed};

/// The content of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Content {
    Scenario,
    /// A file that scenarios include.
    Included,
    Fleet,
    Robot,
    World,
    /// Measured latencies.
    Latency,
    /// Something else.
    Other,
}

impl Content {
    /// Recognizes the content by the keys of the file.
    fn of(tree: &Tree) -> Self {
        let has = |key: &str| tree.value(0, key).is_some();
        match Document::of(has) {
            Some(Document::Scenario) => Self::Scenario,
            Some(Document::World) => Self::World,
            Some(Document::Fleet) => Self::Fleet,
            Some(Document::Robot) => Self::Robot,
            None if has("latency") => Self::Latency,
            None if included_keys().keys.iter().any(|key| has(key.name)) => Self::Included,
            None => Self::Other,
        }
    }

    /// Returns the keys of such files, if they are declared.
    pub(crate) fn keys(self) -> Option<&'static Declaration> {
        match self {
            Self::Scenario => Some(scenario_keys()),
            Self::Included => Some(included_keys()),
            Self::Fleet => Some(fleet_keys()),
            Self::World => Some(world_keys()),
            Self::Latency => Some(latency_keys()),
            Self::Robot | Self::Other => None,
        }
    }
}

/// A file with its tree and the names in it.
#[derive(Clone, Debug)]
pub(crate) struct File {
    pub(crate) path: PathBuf,
    pub(crate) text: Text,
    pub(crate) tree: Tree,
    pub(crate) content: Content,
    pub(crate) typed: Typed,
}

impl File {
    pub(crate) fn new(path: PathBuf, text: Text) -> Self {
        Self::edited(path, text, Content::Other)
    }

    /// Creates a file that had a certain content before an edit. The content remains if the text no longer shows it, for example because
    /// its first line is not yet valid.
    pub(crate) fn edited(path: PathBuf, text: Text, before: Content) -> Self {
        let tree = Tree::of(text.as_str());
        let content = match Content::of(&tree) {
            Content::Other => before,
            content => content,
        };
        let mut of_tree = content.keys().map(|keys| typed(text.as_str(), &tree, keys)).unwrap_or_default();
        if content == Content::Robot {
            of_tree.mentions = devices(&tree);
        }
        Self { path, text, tree, content, typed: of_tree }
    }

    /// Returns the name at a byte, if there is one.
    pub(crate) fn mention_at(&self, byte: usize) -> Option<&Mention> {
        let here = self.typed.mentions.iter().filter(|name| name.span.start <= byte && byte <= name.span.end);
        here.min_by_key(|name| name.span.len())
    }

    /// Returns the innermost node at a byte.
    pub(crate) fn node_at(&self, byte: usize) -> Option<usize> {
        let nodes = self.tree.nodes.iter().enumerate();
        let here = nodes.filter(|(_, node)| node.span.start <= byte && byte <= node.span.end);
        // Nodes follow their parents.
        here.map(|(index, _)| index).next_back()
    }

    /// Returns the nodes that contain a node, the innermost first.
    pub(crate) fn ancestors(&self, node: usize) -> impl Iterator<Item = usize> + '_ {
        let nodes = &self.tree.nodes;
        let parent = |node: usize| nodes.get(node).and_then(|node| node.parent);
        std::iter::successors(parent(node), move |node| parent(*node))
    }

    /// Returns the paths to other files in this file.
    pub(crate) fn links(&self) -> impl Iterator<Item = &Mention> {
        self.typed.mentions.iter().filter(|name| name.naming == Naming::Uses(Item::File))
    }

    /// Returns the value of a key at the root of the file.
    pub(crate) fn root_value(&self, key: &str) -> Option<&str> {
        self.tree.scalar(self.tree.value(0, key)?)
    }

    /// Returns the map that contains a node and the key of the node in that map.
    pub(crate) fn entry_of(&self, node: usize) -> Option<InMap<'_>> {
        let map = self.tree.nodes.get(node)?.parent?;
        let entry = self.tree.entries(map).iter().find(|entry| entry.value == node || entry.key == node)?;
        Some(InMap { map, key: self.tree.scalar(entry.key)? })
    }
}

/// The place of a node in a map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InMap<'f> {
    /// The index of the map.
    pub(crate) map: usize,
    /// The key of the node.
    pub(crate) key: &'f str,
}
