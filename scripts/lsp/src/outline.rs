//! Symbols (acts with their cues, moves, robots), folding ranges, and inlay hints with the solved times of cues.

use downbeat_reader::keys::{Item, Naming};
use downbeat_yaml::tree::Shape;
use lsp_types::{DocumentSymbol, FoldingRange, InlayHint, InlayHintLabel, Range, SymbolKind};

use crate::about::value_of;
use crate::file::File;
use crate::hover::Compiled;
use crate::text::number;
use crate::typed::Mention;

/// Returns the items that a file defines. Cues are in their act.
pub(crate) fn symbols(file: &File) -> Vec<DocumentSymbol> {
    let mut symbols: Vec<Found> = Vec::new();
    for mention in &file.typed.mentions {
        if let Naming::Defines(item) = mention.naming
            && let Some(kind) = kind_of(item)
        {
            let span = whole(file, mention);
            let symbol = symbol(file, mention, kind, span.clone());
            let around = symbols
                .iter_mut()
                .rev()
                .find(|found| found.span.start < span.start && span.end <= found.span.end);
            match around {
                Some(found) => found.symbol.children.get_or_insert_default().push(symbol),
                None => symbols.push(Found { symbol, span }),
            }
        }
    }
    symbols.into_iter().map(|found| found.symbol).collect()
}

struct Found {
    symbol: DocumentSymbol,
    span: std::ops::Range<usize>,
}

/// Returns the bytes of a definition: the map that has the name as a value, or the key with its value.
fn whole(file: &File, mention: &Mention) -> std::ops::Range<usize> {
    let nodes = &file.tree.nodes;
    match value_of(file, mention.node) {
        Some(value) => {
            nodes[mention.node].span.start..nodes[value].span.end.max(nodes[mention.node].span.end)
        }
        None => {
            let map =
                nodes[mention.node].parent.filter(|parent| matches!(nodes[*parent].shape, Shape::Map(_)));
            nodes[map.unwrap_or(mention.node)].span.clone()
        }
    }
}

#[expect(deprecated, reason = "the protocol's struct has a deprecated field")]
fn symbol(file: &File, mention: &Mention, kind: SymbolKind, span: std::ops::Range<usize>) -> DocumentSymbol {
    DocumentSymbol {
        name: mention.name.clone(),
        detail: None,
        kind,
        tags: None,
        deprecated: None,
        range: file.text.range(span),
        selection_range: file.text.range(mention.span.clone()),
        children: None,
    }
}

const fn kind_of(item: Item) -> Option<SymbolKind> {
    match item {
        Item::Act => Some(SymbolKind::NAMESPACE),
        Item::Cue => Some(SymbolKind::EVENT),
        Item::Move | Item::Sequence => Some(SymbolKind::FUNCTION),
        Item::Robot => Some(SymbolKind::OBJECT),
        Item::Device => Some(SymbolKind::FIELD),
        Item::Formation | Item::Path => Some(SymbolKind::STRUCT),
        Item::Variable => Some(SymbolKind::VARIABLE),
        Item::Zone | Item::Parameter | Item::File | Item::RobotDevice => None,
    }
}

/// Returns the lists and maps of a file that cover several lines.
pub(crate) fn folds(file: &File) -> Vec<FoldingRange> {
    let mut folds: Vec<FoldingRange> = Vec::new();
    for (index, node) in file.tree.nodes.iter().enumerate().skip(1) {
        if !matches!(node.shape, Shape::Map(_) | Shape::List(_)) || node.span.is_empty() {
            continue;
        }
        // A block begins below its key, whose line remains visible.
        let parent = node.parent.map_or(&[][..], |parent| file.tree.entries(parent));
        let key = parent.iter().find(|entry| entry.value == index).map(|entry| entry.key);
        let begin = key.map_or(node.span.start, |key| file.tree.nodes[key].span.start);
        let (first, last) = (file.text.line_of(begin), file.text.line_of(node.span.end.saturating_sub(1)));
        let is_known = folds.last().is_some_and(|fold| fold.start_line == number(first));
        if last > first && !is_known {
            folds.push(FoldingRange {
                start_line: number(first),
                end_line: number(last),
                ..FoldingRange::default()
            });
        }
    }
    folds
}

/// Returns the solved starts and durations of the cues in a range of a file.
pub(crate) fn hints(file: &File, compiled: &Compiled, range: Range) -> Vec<InlayHint> {
    let mut hints: Vec<InlayHint> = Vec::new();
    for solved in compiled.cues_in(&file.path) {
        let line = file.text.line(solved.written.first_line.saturating_sub(1));
        let position = file.text.position(line.end);
        let is_here = position.line >= range.start.line && position.line <= range.end.line;
        // A cue of a sequence that is played several times has the times of the first.
        if !is_here || hints.iter().any(|hint| hint.position == position) {
            continue;
        }
        let length = solved.cue.end - solved.cue.start;
        hints.push(InlayHint {
            position,
            label: InlayHintLabel::String(format!("{} for {length}", solved.cue.start)),
            kind: None,
            text_edits: None,
            tooltip: None,
            padding_left: Some(true),
            padding_right: None,
            data: None,
        });
    }
    hints
}
