//! Limits YAML aliases. An alias repeats a value, and aliases of aliases multiply, so that a few lines could exhaust the memory. Before the
//! reader builds a tree of the file, a first pass counts the values with a parser that builds no tree.

use saphyr_parser::Event;

use crate::events::Events;
use crate::finding::{Code, Finding};
use crate::render::line_of;
use crate::source::Source;

/// Maximum number of values to which all aliases of a file may expand.
pub const ALIASED_MAX: usize = 250_000;
/// Maximum nesting depth up to which values are counted. Files that nest more deeply are rejected elsewhere.
const NESTING_MAX: usize = 1_000;
/// Maximum length of the source line in a finding, in characters. Longer lines are cut.
const LINE_CHARS_MAX: usize = 1_000;

/// Returns a finding if the aliases expand to too many values. Invalid YAML is not reported here, but by the parser that builds the tree.
pub fn check(source: &Source, text: &str) -> Option<Finding> {
    if !text.contains('*') || exceeding(text).is_none() {
        return None;
    }
    // The text may be shorter than the file, so the place is searched in the file itself.
    exceeding(&source.text).map(|place| exceeded(source, Some(place)))
}

/// Returns the finding for aliases that expand to too many values. `place` is the line (from 1) and the column (from 0) of the alias that
/// exceeds [`ALIASED_MAX`]; `None` if it is unknown.
pub fn exceeded(source: &Source, place: Option<(usize, usize)>) -> Finding {
    let up_to = if place.is_some() { " up to here" } else { "" };
    let message = format!("the aliases{up_to} expand to more than {ALIASED_MAX} values");
    let hint = Some("write out the values, or define a move and use it in several cues".to_owned());
    let expected = format!("at most {ALIASED_MAX} values from aliases");
    let mut finding = Finding::about_file(Code::TooMuch, &source.name, message, &expected, hint);
    if let Some((line, column)) = place {
        (finding.line, finding.column, finding.width) = (line, column + 1, 1);
        finding.source_line = line_of(&source.text, line).chars().take(LINE_CHARS_MAX).collect();
    }
    finding
}

/// A list or map that is being read: its anchor, and the number of values in it so far.
struct Open {
    anchor: usize,
    values: usize,
}

/// Returns the line (from 1) and column (from 0) of the alias that exceeds [`ALIASED_MAX`]; `None` if no alias does.
fn exceeding(text: &str) -> Option<(usize, usize)> {
    let mut sizes: Vec<usize> = Vec::new();
    let mut open: Vec<Open> = Vec::new();
    let mut aliased = 0usize;
    let mut place = None;
    Events::of(text).each(|event, extent| {
        let (anchor, values) = match event {
            Event::Scalar(_, _, anchor, _) => (anchor, 1),
            Event::SequenceStart(anchor, _) | Event::MappingStart(anchor, _) => {
                open.push(Open { anchor, values: 1 });
                // The reader rejects this nesting.
                return open.len() <= NESTING_MAX;
            }
            Event::SequenceEnd | Event::MappingEnd => match open.pop() {
                Some(Open { anchor, values }) => (anchor, values),
                None => return true,
            },
            Event::Alias(anchor) => {
                let values = sizes.get(anchor).copied().unwrap_or(1);
                aliased = aliased.saturating_add(values);
                if aliased > ALIASED_MAX {
                    place = Some(extent.start);
                    return false;
                }
                (0, values)
            }
            _ => return true,
        };
        if let Some(parent) = open.last_mut() {
            parent.values = parent.values.saturating_add(values);
        }
        if anchor > 0 {
            sizes.resize(sizes.len().max(anchor + 1), 1);
            sizes[anchor] = values;
        }
        true
    });
    place
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::parse;

    fn found(text: &str) -> Option<Finding> {
        parse(&Source { name: "s.yaml".into(), text: text.to_owned() }).err()
    }

    #[test]
    fn long_alias_list_is_refused_where_it_exceeds_limit() {
        let text = format!("a: &a {{b: [1, 2, 3], c: x}}\nl:\n{}", "  - *a\n".repeat(1_300_000));
        let finding = found(&text).unwrap();
        assert_eq!((finding.code, finding.column), (Code::TooMuch, 5));
        // Each alias expands to a map, two keys, a list, three numbers and a text.
        assert_eq!(finding.line, 2 + ALIASED_MAX / 8 + 1);
    }

    #[test]
    fn nested_aliases_count_with_their_full_expansion() {
        let mut text = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n".to_owned();
        for level in 1..9 {
            let before = format!("*a{}, ", level - 1).repeat(9);
            text.push_str(&format!("a{level}: &a{level} [{before}]\n"));
        }
        assert_eq!(found(&text).map(|finding| finding.code), Some(Code::TooMuch));
    }

    #[test]
    fn aliased_keyframes_count_with_all_their_rows() {
        let rows = "  - {at: 1s, to: 2}\n".repeat(10_000);
        let text = |uses: usize| format!("a: &a\n{rows}b: [{}]\n", "*a, ".repeat(uses));
        assert_eq!(found(&text(2)), None);
        let finding = found(&text(26)).unwrap();
        assert_eq!((finding.code, finding.line), (Code::TooMuch, 10_002));
    }

    #[test]
    fn aliases_are_limited_in_text_that_parser_of_events_refuses() {
        // The parser of events demands that the `2` is indented.
        let list = "1, ".repeat(5_000);
        for refused in ["x: [1,\n2]\n", "x: \"a\nb\"\n"] {
            let few = format!("{refused}a: &a [{list}]\nb: [*a, *a]\n");
            assert_eq!(found(&few), None, "{refused}");
            let many = format!("{refused}a: &a [{list}]\nb: [{}]\n", "*a, ".repeat(20_000));
            let finding = found(&many).unwrap();
            assert_eq!((finding.code, finding.line), (Code::TooMuch, 0), "{refused}");
            let deep = format!("{many}c: {}", "[".repeat(2_000));
            assert!(found(&deep).is_some(), "{refused}");
        }
    }

    #[test]
    fn text_without_aliases_has_no_limit_of_values() {
        for value in ["{a},", "~,", "[],"] {
            let text = format!("a: [{}]\n", value.repeat(200_000));
            assert!(found(&text).is_none(), "{value}");
        }
        assert!(found(&"?\n".repeat(200_000)).is_none());
    }

    #[test]
    fn realistic_number_of_aliases_is_accepted() {
        let text = format!("a: &a {{b: 1}}\nl:\n{}", "  - *a\n".repeat(10_000));
        assert_eq!(found(&text), None);
    }
}
