//! Cuts runs of keyframes out of a YAML text, and puts them back into the tree that is parsed from the remaining text.

use std::sync::Arc;

use super::run::{Run, Start, next_start};
use super::{Items, Rows};
use crate::node::Node;

/// Minimum number of rows (keyframes) in a run that is cut out. Shorter runs are left to the YAML library.
const ROWS_MIN: usize = 8;
/// In the text, each run is replaced by its number between two of these characters. Texts that already contain this character are left to
/// the YAML library.
const MARK: char = '\u{e000}';

/// A YAML text with a marker in place of each run of keyframes, and the runs that were cut out.
pub struct Condensed {
    pub text: String,
    runs: Vec<Arc<Rows>>,
}

/// Cuts all long runs of keyframes out of a text; `None` if it has none.
pub fn condense(text: &str) -> Option<Condensed> {
    if text.contains(MARK) {
        return None;
    }
    let mut condensed = Condensed { text: String::new(), runs: Vec::new() };
    let (mut at, mut kept) = (0, 0);
    while let Some(start @ Start { from, .. }) = next_start(text, at) {
        let mut run = Run::new(text, &start);
        let end = run.read();
        if run.rows.count() < ROWS_MIN {
            at = from + 1;
            continue;
        }
        run.rows.shrink();
        condensed.text.push_str(&text[kept..from]);
        condensed.text.push_str(&format!("\"{MARK}{}{MARK}\"", condensed.runs.len()));
        condensed.runs.push(Arc::new(run.rows));
        (at, kept) = (end, end);
    }
    condensed.text.push_str(&text[kept..]);
    (!condensed.runs.is_empty()).then_some(condensed)
}

impl Condensed {
    /// Puts the runs back into `root`, the tree of the remaining text. `None` if the marker of a run is not a list item, or if aliases
    /// repeat more than `aliased_max` keyframes.
    pub fn restore(&self, mut root: Node, aliased_max: usize) -> Option<Node> {
        let mut used = vec![0; self.runs.len()];
        self.put_back(&mut root, &mut used)?;
        let again = |(run, used): (&Arc<Rows>, &usize)| run.count().saturating_mul(used.saturating_sub(1));
        let aliased = self.runs.iter().zip(&used).map(again).fold(0, usize::saturating_add);
        (!used.contains(&0) && aliased <= aliased_max).then_some(root)
    }

    fn put_back(&self, node: &mut Node, used: &mut [usize]) -> Option<()> {
        match node {
            Node::Text(text) | Node::Tagged(text) if text.contains(MARK) => None,
            Node::Map(entries) => entries.iter_mut().try_for_each(|(key, node)| {
                (!key.contains(MARK)).then_some(())?;
                self.put_back(node, used)
            }),
            Node::List(Items::Nodes(nodes)) => {
                if let [only] = nodes.as_slice()
                    && let Some(run) = self.run(only, used)
                {
                    *node = Node::List(Items::Rows(run));
                    return Some(());
                }
                self.put_back_among(nodes, used)
            }
            _ => Some(()),
        }
    }

    /// Puts runs back into a list that also contains other items.
    fn put_back_among(&self, nodes: &mut Vec<Node>, used: &mut [usize]) -> Option<()> {
        if nodes.iter().any(|node| matches!(node, Node::Text(text) if text.contains(MARK))) {
            let mut all = Vec::with_capacity(nodes.len());
            for node in std::mem::take(nodes) {
                match self.run(&node, used) {
                    Some(run) => all.extend((0..run.count()).map(|row| run.node(row))),
                    None => all.push(node),
                }
            }
            *nodes = all;
        }
        nodes.iter_mut().try_for_each(|node| self.put_back(node, used))
    }

    fn run(&self, node: &Node, used: &mut [usize]) -> Option<Arc<Rows>> {
        let Node::Text(text) = node else { return None };
        let index: usize = text.strip_prefix(MARK)?.strip_suffix(MARK)?.parse().ok()?;
        *used.get_mut(index)? += 1;
        Some(self.runs.get(index)?.clone())
    }
}
