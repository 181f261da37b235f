//! A text as a tree of nodes with their positions. For editors: the tree of a text that is not valid YAML ends where the fault begins.

use std::ops::Range;

use saphyr_parser::Event;

use crate::events::{Events, Extent};
use crate::render::line_starts;

/// The nodes of a text.
#[derive(Clone, Debug, Default)]
pub struct Tree {
    /// The nodes, each after its parent, the root first. Empty for a text without values.
    pub nodes: Vec<Spanned>,
    /// Whether the text is valid YAML to its end.
    pub is_whole: bool,
}

/// A node with its position in the text.
#[derive(Clone, Debug)]
pub struct Spanned {
    /// The bytes that the node covers, with quotes and brackets.
    pub span: Range<usize>,
    /// The content of the node.
    pub shape: Shape,
    /// The index of the list or map that contains the node; `None` for the root.
    pub parent: Option<usize>,
}

/// The content of a node. Other nodes are given by their indices in [`Tree::nodes`].
#[derive(Clone, Debug)]
pub enum Shape {
    /// A text, a number, a truth value or nothing, as text without quotes.
    Scalar(String),
    /// A map, in the order of the text.
    Map(Vec<Entry>),
    /// A list.
    List(Vec<usize>),
    /// A value that is written elsewhere.
    Alias,
}

/// A key of a map and its value.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// The index of the key.
    pub key: usize,
    /// The index of the value.
    pub value: usize,
}

impl Tree {
    /// Parses a text as far as it is valid YAML.
    #[must_use]
    pub fn of(text: &str) -> Self {
        let mut builder = Builder { places: Places::of(text), tree: Self::default(), open: Vec::new() };
        Events::of(text).each(|event, extent| builder.take(event, extent));
        builder.finish()
    }

    /// Returns the text of a scalar, or `None` for other nodes.
    #[must_use]
    pub fn scalar(&self, node: usize) -> Option<&str> {
        match &self.nodes.get(node)?.shape {
            Shape::Scalar(text) => Some(text),
            _ => None,
        }
    }

    /// Returns the entries of a map; none for other nodes.
    #[must_use]
    pub fn entries(&self, node: usize) -> &[Entry] {
        match self.nodes.get(node).map(|node| &node.shape) {
            Some(Shape::Map(entries)) => entries,
            _ => &[],
        }
    }

    /// Returns the value of a key in a map.
    #[must_use]
    pub fn value(&self, map: usize, key: &str) -> Option<usize> {
        let entry = self.entries(map).iter().find(|entry| self.scalar(entry.key) == Some(key))?;
        Some(entry.value)
    }

    /// Returns the items of a list; none for other nodes.
    #[must_use]
    pub fn items(&self, node: usize) -> &[usize] {
        match self.nodes.get(node).map(|node| &node.shape) {
            Some(Shape::List(items)) => items,
            _ => &[],
        }
    }
}

/// Converts lines and columns to bytes. Consecutive positions on one line cost only the characters between them.
struct Places<'t> {
    text: &'t str,
    lines: Vec<usize>,
    /// The last position: its line, its column and its byte.
    last: [usize; 3],
}

impl<'t> Places<'t> {
    fn of(text: &'t str) -> Self {
        Self { text, lines: line_starts(text).collect(), last: [0, 0, 0] }
    }

    fn byte(&mut self, line: usize, column: usize) -> usize {
        let Some(start) = line.checked_sub(1).and_then(|line| self.lines.get(line)).copied() else {
            return self.text.len();
        };
        let [last_line, last_column, last_byte] = self.last;
        let is_ahead = last_line == line && last_column <= column;
        let (from, skipped) = if is_ahead { (last_byte, column - last_column) } else { (start, column) };
        let rest = &self.text[from..];
        let byte = rest.char_indices().nth(skipped).map_or(self.text.len(), |(byte, _)| from + byte);
        self.last = [line, column, byte];
        byte
    }

    fn range(&mut self, extent: Extent) -> Range<usize> {
        let start = self.byte(extent.start.0, extent.start.1);
        start..self.byte(extent.end.0, extent.end.1).max(start)
    }
}

struct Builder<'t> {
    places: Places<'t>,
    tree: Tree,
    /// The lists and maps that are not complete yet, each with the key whose value is awaited.
    open: Vec<Open>,
}

struct Open {
    node: usize,
    key: Option<usize>,
}

impl Builder<'_> {
    fn take(&mut self, event: Event<'_>, extent: Extent) -> bool {
        match event {
            Event::Scalar(text, ..) => {
                self.add(Shape::Scalar(text.into_owned()), extent);
            }
            Event::Alias(_) => {
                self.add(Shape::Alias, extent);
            }
            Event::MappingStart(..) => self.begin(Shape::Map(Vec::new()), extent),
            Event::SequenceStart(..) => self.begin(Shape::List(Vec::new()), extent),
            Event::MappingEnd | Event::SequenceEnd => {
                // A block has no end mark: the parser reports the place of the following token.
                let end = (extent.start != extent.end).then(|| self.places.range(extent).end);
                self.end(end);
            }
            Event::DocumentEnd => {
                self.tree.is_whole = true;
                return false;
            }
            _ => {}
        }
        true
    }

    fn begin(&mut self, shape: Shape, extent: Extent) {
        let node = self.add(shape, extent);
        self.open.push(Open { node, key: None });
    }

    fn end(&mut self, end: Option<usize>) {
        let Some(Open { node, key }) = self.open.pop() else { return };
        if let Some(key) = key {
            // The text ends between a key and its value.
            let end = self.tree.nodes[key].span.end;
            self.tree.nodes.push(Spanned {
                span: end..end,
                shape: Shape::Scalar(String::new()),
                parent: Some(node),
            });
            self.attach(node, Entry { key, value: self.tree.nodes.len() - 1 });
        }
        let last = match &self.tree.nodes[node].shape {
            Shape::Map(entries) => entries.last().map(|entry| entry.value),
            Shape::List(items) => items.last().copied(),
            Shape::Scalar(_) | Shape::Alias => None,
        };
        let end = end.or_else(|| last.map(|last| self.tree.nodes[last].span.end));
        let span = &mut self.tree.nodes[node].span;
        span.end = end.unwrap_or(span.end).max(span.end);
    }

    fn add(&mut self, shape: Shape, extent: Extent) -> usize {
        let span = self.places.range(extent);
        let node = self.tree.nodes.len();
        let parent = self.open.last().map(|open| open.node);
        self.tree.nodes.push(Spanned { span, shape, parent });
        let Some(open) = self.open.last_mut() else { return node };
        let parent = open.node;
        let key = open.key.take();
        match (&mut self.tree.nodes[parent].shape, key) {
            (Shape::List(items), _) => items.push(node),
            (_, Some(key)) => self.attach(parent, Entry { key, value: node }),
            (_, None) => open.key = Some(node),
        }
        node
    }

    fn attach(&mut self, map: usize, entry: Entry) {
        if let Shape::Map(entries) = &mut self.tree.nodes[map].shape {
            entries.push(entry);
        }
    }

    fn finish(mut self) -> Tree {
        while !self.open.is_empty() {
            self.end(None);
        }
        self.tree
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(text: &str, key: &str) -> String {
        let tree = Tree::of(text);
        text[tree.nodes[tree.value(0, key).unwrap()].span.clone()].to_owned()
    }

    #[test]
    fn nodes_span_their_text() {
        let text = "é: 'ü ä'\nlist:\n  - {a: [1, 2]} # one\n  - x\n\nlast: \"q\"\n";
        assert_eq!(written(text, "é"), "'ü ä'");
        assert_eq!(written(text, "list"), "- {a: [1, 2]} # one\n  - x");
        assert_eq!(written(text, "last"), "\"q\"");
        assert!(Tree::of(text).is_whole);
        assert_eq!(written("{a: {b: c}, d: [e]}", "a"), "{b: c}");
    }

    #[test]
    fn tree_of_invalid_text_ends_at_the_fault() {
        let text = "a: 1\nb:\n  c: 2\n  d\nx: 3\n";
        let tree = Tree::of(text);
        assert!(!tree.is_whole);
        assert_eq!(
            tree.value(tree.value(0, "b").unwrap(), "c").map(|node| tree.scalar(node)),
            Some(Some("2"))
        );
    }
}
