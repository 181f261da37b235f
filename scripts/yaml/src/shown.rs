//! Makes untrusted text safe to display: text from a robot, a file or a peer can neither control a terminal nor break a table.
//!
//! All text that the program prints passes through [`shown`]: lines, tables, pictures, the log. JSON is escaped by its own rules.

use std::borrow::Cow;

use unicode_width::UnicodeWidthChar;

/// Maximum number of terminal columns that one text may take. Strings in the protocol have at most 256 characters.
const COLUMNS_MAX: usize = 1_000;

/// Ranges of characters that are invisible or change how other characters are displayed: text direction, joiners without a glyph,
/// annotations.
const INVISIBLE: [(char, char); 9] = [
    ('\u{ad}', '\u{ad}'),
    ('\u{61c}', '\u{61c}'),
    ('\u{180e}', '\u{180e}'),
    ('\u{200b}', '\u{200b}'),
    ('\u{200e}', '\u{200f}'),
    ('\u{2028}', '\u{202e}'),
    ('\u{2060}', '\u{206f}'),
    ('\u{feff}', '\u{feff}'),
    ('\u{fff9}', '\u{fffb}'),
];

/// Converts a text to one harmless line: control characters, escape sequences, line ends and direction changes are escaped, as in `\n` or
/// `\u{1b}`. A text of more than 1000 columns is cut.
#[must_use]
pub fn shown(text: &str) -> Cow<'_, str> {
    within(text, COLUMNS_MAX)
}

/// Shortens a text for a message. A text of more than 60 characters is cut after 60 and ends with `...`.
pub fn shortened(text: &str) -> String {
    match text.char_indices().nth(60) {
        Some((at, _)) => format!("{}...", &text[..at]),
        None => text.to_owned(),
    }
}

/// Like [`shown`], but limited to `columns` terminal columns. A text that is cut ends with `…`.
#[must_use]
pub fn within(text: &str, columns: usize) -> Cow<'_, str> {
    if text.len() <= columns && text.bytes().all(|byte| matches!(byte, b' '..=b'~')) {
        return Cow::Borrowed(text);
    }
    let mut line = String::new();
    let (mut taken, mut characters) = (0, 0);
    // The cut position that leaves room for the ellipsis.
    let mut cut = 0;
    for character in text.chars() {
        let columns_before = taken;
        let length = line.len();
        put(&mut line, character, &mut taken);
        characters += 1;
        // Characters without width can be stacked in any number.
        if taken > columns || characters > columns.saturating_mul(4) {
            line.truncate(cut);
            line.push('…');
            break;
        }
        if taken < columns {
            cut = line.len();
        } else if columns_before < columns {
            cut = length;
        }
    }
    Cow::Owned(line)
}

fn put(line: &mut String, character: char, columns: &mut usize) {
    if is_harmless(character) {
        line.push(character);
        *columns += character.width().unwrap_or(0);
        return;
    }
    let before = line.len();
    line.extend(character.escape_default());
    *columns += line.len() - before;
}

fn is_harmless(character: char) -> bool {
    let invisible = INVISIBLE.iter().any(|(first, last)| (*first..=*last).contains(&character));
    let tag = ('\u{e0000}'..='\u{e0fff}').contains(&character);
    !character.is_control() && !invisible && !tag
}

/// Escapes control characters in a text of several lines, except line ends, tabs and the escape sequences for colours. Untrusted parts of
/// the text must already have been escaped, because their colours would pass.
#[must_use]
pub fn block(text: &str) -> Cow<'_, str> {
    if text.chars().all(|character| character == '\n' || is_harmless(character)) {
        return Cow::Borrowed(text);
    }
    let mut safe = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(character) = rest.chars().next() {
        let length = colour(rest).unwrap_or(0);
        if length > 0 {
            safe.push_str(&rest[..length]);
            rest = &rest[length..];
            continue;
        }
        match character {
            '\n' | '\t' => safe.push(character),
            _ => put(&mut safe, character, &mut 0),
        }
        rest = &rest[character.len_utf8()..];
    }
    Cow::Owned(safe)
}

/// Returns the length, in bytes, of the escape sequence for a colour or font weight at the beginning of the text; `None` if there is
/// none.
fn colour(text: &str) -> Option<usize> {
    let parameters = text.strip_prefix("\u{1b}[")?;
    let end = parameters.find(|c: char| !c.is_ascii_digit() && c != ';')?;
    (parameters[end..].starts_with('m')).then_some("\u{1b}[".len() + end + 1)
}

/// Converts JSON to equivalent JSON in which characters that terminals interpret are escaped.
#[must_use]
pub fn json(text: &str) -> Cow<'_, str> {
    if text.chars().all(|character| character == '\n' || is_harmless(character)) {
        return Cow::Borrowed(text);
    }
    let mut safe = String::with_capacity(text.len());
    for character in text.chars() {
        if character == '\n' || is_harmless(character) {
            safe.push(character);
            continue;
        }
        // JSON contains such characters only within strings.
        let mut units = [0; 2];
        for unit in character.encode_utf16(&mut units) {
            safe.push_str(&format!("\\u{unit:04x}"));
        }
    }
    Cow::Owned(safe)
}

#[cfg(test)]
mod tests {
    use unicode_width::UnicodeWidthStr;

    use super::*;

    #[track_caller]
    fn check(text: &str, expected: &str) {
        assert_eq!(shown(text), expected);
        assert_eq!(shown(expected), expected, "what is shown is harmless");
    }

    #[test]
    fn plain_text_in_any_language_is_unchanged() {
        check(
            "arm-1: \"too hot\" 4 µm \\ Größe, рука, 腕, 🦾",
            "arm-1: \"too hot\" 4 µm \\ Größe, рука, 腕, 🦾",
        );
    }

    #[test]
    fn control_characters_and_escape_sequences_are_escaped() {
        check("\u{1b}]0;title\u{7}", "\\u{1b}]0;title\\u{7}");
        check("\u{1b}[2J\u{1b}[32mall robots", "\\u{1b}[2J\\u{1b}[32mall robots");
        check("\u{9b}2J\u{7f}\0", "\\u{9b}2J\\u{7f}\\u{0}");
    }

    #[test]
    fn output_lines_cannot_be_forged() {
        check("hot\nall robots: default state confirmed\r", "hot\\nall robots: default state confirmed\\r");
        check("a\u{2028}b\u{85}", "a\\u{2028}b\\u{85}");
    }

    #[test]
    fn text_direction_cannot_be_reversed() {
        check("arm\u{202e}1-mra\u{2066}", "arm\\u{202e}1-mra\\u{2066}");
        check("a\u{200b}b\u{feff}\u{e0041}", "a\\u{200b}b\\u{feff}\\u{e0041}");
    }

    #[test]
    fn long_text_is_cut_at_column_limit() {
        assert_eq!(within("arm", 3), "arm");
        assert_eq!(within("arms", 3), "ar…");
        assert_eq!(within("腕腕腕", 5), "腕腕…");
        assert_eq!(within("腕腕", 4), "腕腕");
        assert!(shown(&"x".repeat(5_000)).width() <= COLUMNS_MAX);
        assert!(shown(&format!("a{}", "\u{301}".repeat(90_000))).len() < 10_000);
        for columns in 1..12 {
            let cut = within("a\u{1b}腕b\u{1b}腕", columns);
            assert!(cut.width() <= columns, "{cut} in {columns}");
        }
    }

    #[test]
    fn block_keeps_only_line_ends_and_colours() {
        let ours = "\u{1b}[1m\u{1b}[31merror\u{1b}[0m: x\n";
        assert_eq!(block(ours), ours);
        assert_eq!(block("\u{1b}[2J\u{1b}]52;c;aGk=\u{7}a\rb\n"), "\\u{1b}[2J\\u{1b}]52;c;aGk=\\u{7}a\\rb\n");
    }

    #[test]
    fn json_keeps_its_meaning_without_terminal_control_characters() {
        let text = serde_json::to_string_pretty(&["a\u{9b}2J\u{202e}\u{7f}", "腕\n"]).unwrap();
        let safe = json(&text);
        assert!(!safe.contains(['\u{9b}', '\u{202e}', '\u{7f}']), "{safe}");
        assert_eq!(
            serde_json::from_str::<Vec<String>>(&safe).unwrap(),
            serde_json::from_str::<Vec<String>>(&text).unwrap()
        );
    }
}
