//! Limits the work that a drawing causes, before it is done. References and style sheets multiply: a drawing of a few kilobytes could
//! otherwise take hours.

use std::collections::HashMap;

use usvg::roxmltree::{Document, Node, NodeId};

use super::SVG;
use crate::formation::Unfit;

/// Maximum number of comparisons of elements with selectors of style sheets, in the worst case.
const COMPARISONS_MAX: u64 = 100_000_000;
/// Maximum number of declarations of style sheets that can apply to elements, counted once per element.
const DECLARATIONS_MAX: u64 = 10_000_000;
/// Returns the reason why a drawing would take too long. `None` if it would not.
pub(super) fn excess(document: &Document<'_>) -> Option<Unfit> {
    let sheets: Vec<&str> = document
        .descendants()
        .filter(|node| node.has_tag_name((SVG, "style")))
        .flat_map(|style| style.children().filter_map(|node| node.text()))
        .collect();
    let styling = Styling::of(document, &sheets);
    if styling.comparisons > COMPARISONS_MAX || styling.declarations > DECLARATIONS_MAX {
        let message = "the style sheets of the drawing are too long for its number of elements".to_owned();
        let expected = "a drawing with presentation attributes (`fill`, `stroke`) instead of style sheets";
        return Some(Unfit { message, expected });
    }
    None
}

/// Properties that do not change the paths of a drawing. Each reference in them may be converted again for each element and for each
/// reference inside the target, so that nested ones multiply.
const EFFECTS: [&str; 7] =
    ["mask", "clip-path", "filter", "marker", "marker-start", "marker-mid", "marker-end"];

/// Returns the text of a drawing with `none` in place of the references in [`EFFECTS`], in attributes as in style sheets.
pub(super) fn without_effects(text: &str) -> String {
    let mut kept = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find("url(") {
        let (before, reference) = rest.split_at(at);
        kept.push_str(before);
        let value = kept.trim_end_matches(|c: char| c.is_whitespace() || c == '"' || c == '\'');
        let name = value.strip_suffix([':', '=']).map(str::trim_end);
        let is_effect = name.is_some_and(|name| {
            let of_name = |c: char| c.is_ascii_alphabetic() || c == '-';
            let name = name.rsplit(|c| !of_name(c)).next().unwrap_or_default();
            EFFECTS.iter().any(|effect| name.eq_ignore_ascii_case(effect))
        });
        let end = reference.find(')').map_or(reference.len(), |end| end + 1);
        kept.push_str(if is_effect { "none" } else { &reference[..end] });
        rest = &reference[end..];
    }
    kept.push_str(rest);
    kept
}

/// The work of style sheets.
struct Styling {
    comparisons: u64,
    declarations: u64,
}

impl Styling {
    fn of(document: &Document<'_>, sheets: &[&str]) -> Self {
        let elements = document.descendants().filter(Node::is_element).count() as u64;
        let depth = depth(document);
        let (mut comparisons, mut declarations) = (0_u64, 0_u64);
        for rule in sheets.iter().flat_map(|sheet| sheet.split('}')) {
            let (selectors, body) = rule.split_once('{').unwrap_or((rule, ""));
            declarations = declarations.saturating_add(1 + body.matches(';').count() as u64);
            for selector in selectors.split(',') {
                comparisons = comparisons.saturating_add(of_selector(selector, depth));
            }
        }
        Self {
            comparisons: comparisons.saturating_mul(elements),
            declarations: if sheets.is_empty() { 0 } else { declarations.saturating_mul(elements) },
        }
    }
}

/// Returns the number of comparisons of one element with a selector. The library tries all combinations of ancestors for the parts of a
/// selector that are separated by blanks.
fn of_selector(selector: &str, depth: u64) -> u64 {
    let (mut parts, mut ancestors, mut joined) = (0_u64, 0_u32, true);
    for word in selector.split_whitespace() {
        if [">", "+", "~"].contains(&word) {
            joined = true;
            continue;
        }
        ancestors += u32::from(!joined);
        parts += 1 + word.matches(['>', '+', '~']).count() as u64;
        joined = word.ends_with(['>', '+', '~']);
    }
    parts.saturating_add(depth.saturating_pow(ancestors))
}

/// Returns the maximum number of ancestors of an element.
fn depth(document: &Document<'_>) -> u64 {
    let mut depths: HashMap<NodeId, u64> = HashMap::new();
    for node in document.descendants() {
        let above = node.parent().and_then(|parent| depths.get(&parent.id())).copied().unwrap_or(0);
        depths.insert(node.id(), above + 1);
    }
    depths.into_values().max().unwrap_or(0)
}
