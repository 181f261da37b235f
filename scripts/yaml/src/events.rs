//! Parses a YAML text into events (scalars, and starts and ends of lists and maps) with their positions, without building a tree.
//!
//! A brace at the beginning of a text might begin a key, so the parser would buffer everything until the brace is closed. `---` is
//! therefore written before such a text: after `---`, a brace cannot begin a key.

use std::borrow::Cow;

use saphyr_parser::{Event, Marker, Parser, Span, StrInput};

const DOCUMENT: &str = "--- ";

/// A text that is parsed event by event.
pub struct Events<'t> {
    text: Cow<'t, str>,
    /// Number of lines that were skipped before the parsed text. `ahead` is the number of characters that were skipped in its first line.
    lines: usize,
    ahead: usize,
    added: usize,
}

/// The start and the end of an event in the text, each as a line (counted from 1) and a column (counted from 0).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    pub start: (usize, usize),
    pub end: (usize, usize),
}

impl<'t> Events<'t> {
    pub fn of(text: &'t str) -> Self {
        let rest = text.trim_start_matches([' ', '\n']);
        if !rest.starts_with('{') {
            return Self { text: Cow::Borrowed(text), lines: 0, ahead: 0, added: 0 };
        }
        let blank = &text[..text.len() - rest.len()];
        let ahead = blank.len() - blank.rfind('\n').map_or(0, |end| end + 1);
        let lines = blank.matches('\n').count();
        Self { text: Cow::Owned([DOCUMENT, rest].concat()), lines, ahead, added: DOCUMENT.len() }
    }

    /// Passes each event to `wanted`. Stops where the text is not valid YAML, or when `wanted` returns false.
    pub fn each(&self, mut wanted: impl FnMut(Event<'_>, Extent) -> bool) {
        let mut parser: Parser<'_, StrInput<'_>> = Parser::new_from_str(&self.text);
        while let Some(Ok((event, span))) = parser.next_event() {
            if !wanted(event, self.extent(span)) {
                return;
            }
        }
    }

    fn extent(&self, span: Span) -> Extent {
        Extent { start: self.place(span.start), end: self.place(span.end) }
    }

    fn place(&self, marker: Marker) -> (usize, usize) {
        let column = match marker.line() {
            1 => (marker.col() + self.ahead).saturating_sub(self.added),
            _ => marker.col(),
        };
        (marker.line() + self.lines, column)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scalars(text: &str) -> Vec<(String, Extent)> {
        let mut found = Vec::new();
        Events::of(text).each(|event, extent| {
            if let Event::Scalar(text, ..) = event {
                found.push((text.into_owned(), extent));
            }
            true
        });
        found
    }

    #[test]
    fn scalar_positions_match_text_inside_braces() {
        for text in [
            "{a: 1,\n b: [x, y]}",
            "\n\n  {a: 1,\n b: [x, y]}\n",
            "a: 1\nb: [x, y]",
            "{\"a\": *b, c: &d {}}\n",
        ] {
            for (scalar, extent) in scalars(text) {
                let line = text.lines().nth(extent.start.0 - 1).unwrap();
                let shown = &line[extent.start.1..extent.end.1];
                assert_eq!(shown.trim_matches('"'), scalar, "{text}");
            }
        }
    }

    #[test]
    fn unclosed_brackets_are_read_incrementally() {
        let text = format!("{{a: [{}", "1, ".repeat(1_000));
        let mut count = 0;
        Events::of(&text).each(|_, _| {
            count += 1;
            true
        });
        assert!(count > 1_000, "{count}");
    }
}
