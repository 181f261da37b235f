//! A text with its lines, which converts between bytes and the positions of the protocol: lines, and columns in UTF-16.

use std::ops::Range;

use downbeat_yaml::render::line_starts;
use lsp_types::Position;

/// The text of a file.
#[derive(Clone, Debug)]
pub(crate) struct Text {
    text: String,
    lines: Vec<usize>,
}

impl Text {
    pub(crate) fn new(text: String) -> Self {
        let lines = line_starts(&text).collect();
        Self { text, lines }
    }

    pub(crate) fn as_str(&self) -> &str {
        &self.text
    }

    /// Returns the index of the line that contains a byte, counted from 0.
    pub(crate) fn line_of(&self, byte: usize) -> usize {
        self.lines.partition_point(|start| *start <= byte).saturating_sub(1)
    }

    /// Returns the bytes of a line without its end. `line` counts from 0.
    pub(crate) fn line(&self, line: usize) -> Range<usize> {
        let Some(start) = self.lines.get(line).copied() else { return self.text.len()..self.text.len() };
        let end = self.lines.get(line + 1).copied().unwrap_or(self.text.len());
        let written = self.text[start..end].trim_end_matches(['\r', '\n']).len();
        start..start + written
    }

    pub(crate) fn position(&self, byte: usize) -> Position {
        let line = self.line_of(byte);
        let units = self.text[self.lines[line]..byte].encode_utf16().count();
        Position { line: number(line), character: number(units) }
    }

    pub(crate) fn range(&self, bytes: Range<usize>) -> lsp_types::Range {
        lsp_types::Range { start: self.position(bytes.start), end: self.position(bytes.end) }
    }

    /// Returns the byte at a position. A column beyond the end of its line means that end.
    pub(crate) fn byte(&self, position: Position) -> usize {
        let line = self.line(usize::try_from(position.line).unwrap_or(usize::MAX));
        let mut units = 0;
        let column = usize::try_from(position.character).unwrap_or(usize::MAX);
        let reached = self.text[line.clone()].char_indices().find(|(_, c)| {
            let is_reached = units >= column;
            units += c.len_utf16();
            is_reached
        });
        reached.map_or(line.end, |(byte, _)| line.start + byte)
    }

    /// Returns the byte at a line and a column in characters, both counted from 1.
    pub(crate) fn byte_at(&self, line: usize, column: usize) -> usize {
        let line = self.line(line.saturating_sub(1));
        let found = self.text[line.clone()].char_indices().nth(column.saturating_sub(1));
        found.map_or(line.end, |(byte, _)| line.start + byte)
    }

    /// Replaces a part of the text, or the whole text if there is no range.
    pub(crate) fn change(&mut self, range: Option<lsp_types::Range>, new: &str) {
        match range {
            None => new.clone_into(&mut self.text),
            Some(range) => {
                let start = self.byte(range.start);
                let end = self.byte(range.end).max(start);
                self.text.replace_range(start..end, new);
            }
        }
        self.lines = line_starts(&self.text).collect();
    }
}

/// Converts an index to a number of the protocol.
pub(crate) fn number(index: usize) -> u32 {
    u32::try_from(index).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_count_utf16_units() {
        let mut text = Text::new("a\n🤖é: x\r\nlast".to_owned());
        let at = |line, character| Position { line, character };
        assert_eq!(text.byte(at(1, 3)), "a\n🤖é".len());
        assert_eq!(text.position("a\n🤖é".len()), at(1, 3));
        assert_eq!(text.byte(at(1, 99)), "a\n🤖é: x".len());
        assert_eq!(text.byte(at(9, 0)), text.as_str().len());
        assert_eq!(text.byte_at(2, 3), "a\n🤖é".len());
        text.change(Some(lsp_types::Range { start: at(1, 2), end: at(2, 0) }), "!");
        assert_eq!(text.as_str(), "a\n🤖!last");
        text.change(None, "new");
        assert_eq!(text.position(3), at(0, 3));
    }
}
