//! Explains invalid YAML to users who do not know its grammar.

use crate::finding::{Code, Finding};
use crate::render::{line_of, line_starts};
use crate::shown::shortened;
use crate::source::{BYTE_ORDER_MARK, Source};

/// The text that the YAML library's error for excessive nesting contains.
pub const RECURSION: &str = "recursion limit";

/// Returns the finding for a text that the YAML library rejects.
pub fn syntax_finding(source: &Source, error: &serde_yaml::Error) -> Finding {
    let whole = error.to_string();
    let end = whole.find(" at line ").unwrap_or(whole.len());
    let message = shortened_to(&whole[..end], 300);
    let mut finding = Finding::about_file(Code::Syntax, &source.name, message, "one YAML document", None);
    if let Some(at) = error.location() {
        (finding.line, finding.column) = line_and_column(&source.text, at.index());
        finding.width = 1;
        explain(&mut finding, &whole, &source.text);
        finding.source_line = line_of(&source.text, finding.line).to_owned();
    }
    if let Some(hint) = slip(source, &mut finding) {
        finding.hint = Some(hint);
    } else if whole.contains("repetition limit") {
        finding.hint = Some("the aliases expand to too many values: use fewer of them".into());
    } else if whole.contains(RECURSION) {
        finding.hint = Some("reduce the nesting: valid files have only a few levels".into());
    } else if whole.contains("more than one document") {
        several_documents(source, &mut finding);
    }
    finding
}

/// Removes the text of the file from a finding about its syntax, unless the file has one of these keys at its top level. A file that is
/// named by mistake may contain passwords, and findings are often published.
#[must_use]
pub fn conceal(mut finding: Finding, source: &Source, known: &[&str]) -> Finding {
    if finding.line == 0 || has_key(&source.text, known) {
        return finding;
    }
    finding.source_line.clear();
    // The reports show no part of the line.
    finding.width = 0;
    // These are the only messages that contain a part of the file.
    if finding.message.starts_with(DEEPER) {
        finding.message = format!("{DEEPER} the line above, which already has a value");
        "the indentation of the line above".clone_into(&mut finding.expected);
    }
    let keys = known.iter().take(3).map(|key| format!("`{key}`")).collect::<Vec<_>>().join(", ");
    finding.hint = Some(format!(
        "the line is not shown, because the file has none of the expected keys, such as {keys}: check the path"
    ));
    finding
}

/// Whether a text has one of these keys at its top level. The text need not be valid YAML.
#[must_use]
pub fn has_key(text: &str, known: &[&str]) -> bool {
    let text = text.trim_start_matches(BYTE_ORDER_MARK);
    let is_known = |key: &str| known.contains(&key.trim().trim_matches(['"', '\'']));
    if text.trim_start().starts_with('{') {
        return keys_in_braces(text).any(is_known);
    }
    // A line that lacks its colon is a mistake in a key as well.
    let key = |line: &str| line.split([':', '=']).next().is_some_and(is_known);
    text.lines().filter(|line| !line.starts_with([' ', '\t'])).any(key)
}

/// Returns the keys of the outermost braces in a text.
fn keys_in_braces(text: &str) -> impl Iterator<Item = &str> {
    let (mut depth, mut quote, mut begin) = (0, None, 0);
    text.char_indices().filter_map(move |(at, c)| {
        let is_outside = quote.is_none();
        match c {
            '"' | '\'' if is_outside => quote = Some(c),
            c if Some(c) == quote => quote = None,
            '{' | '[' if is_outside => {
                depth += 1;
                begin = at + 1;
            }
            '}' | ']' if is_outside => depth -= 1,
            ',' if is_outside => begin = at + 1,
            ':' if is_outside && depth == 1 => return text.get(begin..at),
            _ => {}
        }
        None
    })
}

/// Adds the message, hint and place to the finding for a file with several documents. The place is the first `---` after other content,
/// where the second document begins.
fn several_documents(source: &Source, finding: &mut Finding) {
    "the file has more than one document".clone_into(&mut finding.message);
    finding.hint = Some("keep one document per file: remove the `---` between the documents".into());
    let says_nothing =
        |line: &str| line.trim().is_empty() || line.starts_with(['#', '%']) || line.starts_with("---");
    let mut lines = source.text.lines().enumerate().skip_while(|(_, line)| says_nothing(line));
    if let Some((index, line)) = lines.find(|(_, line)| line.starts_with("---")) {
        (finding.line, finding.column, finding.width) = (index + 1, 1, 3);
        line.clone_into(&mut finding.source_line);
    }
}

/// Detects common mistakes near the error: byte order marks, tabs, a colon without a space. Returns a hint, and may change the message.
fn slip(source: &Source, finding: &mut Finding) -> Option<String> {
    let marked = source.text.trim_start_matches(BYTE_ORDER_MARK).contains(BYTE_ORDER_MARK);
    if marked {
        let hint = "remove the byte order mark within the file, for example where two files were joined";
        return Some(hint.to_owned());
    }
    let place = finding.line;
    let near = || {
        [place, place.saturating_sub(1)]
            .into_iter()
            .filter(|line| *line > 0)
            .map(|line| line_of(&source.text, line))
    };
    let indented = |line: &str| line[..line.len() - line.trim_start().len()].contains('\t');
    if near().any(indented) {
        "this line is indented with a tab".clone_into(&mut finding.message);
        "spaces".clone_into(&mut finding.expected);
        return Some("indent YAML with spaces: replace each tab with spaces".to_owned());
    }
    if near().any(|line| line.contains(NO_BREAK_SPACE)) {
        "this line contains a no-break space, for example copied from a web page"
            .clone_into(&mut finding.message);
        "ordinary spaces".clone_into(&mut finding.expected);
        return Some("retype the spaces in this line".to_owned());
    }
    if let Some(name) = near().find_map(braced) {
        "braces around the name of a variable".clone_into(&mut finding.message);
        "a variable such as `$a`".clone_into(&mut finding.expected);
        return Some(format!("write `${name}`"));
    }
    let entry = |line: &'_ str| line.trim_start().trim_start_matches("- ").to_owned();
    if let Some(hint) = near().find_map(|line| without_space_at_all(&entry(line))) {
        if finding.message == NO_COLON {
            "there is no space after the colon".clone_into(&mut finding.message);
        }
        return Some(hint);
    }
    let line = entry(line_of(&source.text, place.max(1)));
    let (key, value) = line.split_once(' ').filter(|_| finding.message == NO_COLON)?;
    let value = value.trim_start_matches(['=', ':', ' ']);
    Some(format!("write a colon after the key: `{}: {}`", shortened(key), shortened(value.trim())))
}

const NO_BREAK_SPACE: char = '\u{a0}';

/// Returns the name in `${name}`; `None` if the line contains no such braces.
fn braced(line: &str) -> Option<&str> {
    let (_, rest) = line.split_once("${")?;
    let name = &rest[..rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len())];
    (!name.is_empty()).then_some(name)
}

/// Returns a hint for a known key without a space after its colon, as in `at:0s`, which YAML reads as a single word.
pub fn without_space(key: &str, known: &[&str]) -> Option<String> {
    let (name, rest) = key.split_once(':')?;
    known.contains(&name.trim()).then(|| spaced(name, rest))
}

/// Returns a hint for a known key without a colon, as in `to 30`.
pub fn without_colon(key: &str, known: &[&str]) -> Option<String> {
    let (name, rest) = key.split_once(' ')?;
    known
        .contains(&name)
        .then(|| format!("write a colon after the key: `{name}: {}`", shortened(rest.trim())))
}

/// Like [`without_space`], but accepts any word as the key.
pub fn without_space_at_all(text: &str) -> Option<String> {
    let (name, rest) = text.split_once(':')?;
    let word = !name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || c == '_' || c == '-');
    let joined = rest.starts_with(|c: char| !c.is_whitespace());
    (word && joined).then(|| spaced(name, rest))
}

fn spaced(name: &str, rest: &str) -> String {
    let value = rest.split_whitespace().next().unwrap_or_default();
    format!("write a space after the colon: `{}: {}`", shortened(name), shortened(value))
}

/// Returns the line and column of a byte offset, both counted from 1, as editors count them. The positions of the parser differ: it also
/// ends lines at the additional line breaks of YAML 1.1.
fn line_and_column(text: &str, byte: usize) -> (usize, usize) {
    let byte = (0..=byte.min(text.len())).rev().find(|at| text.is_char_boundary(*at)).unwrap_or(0);
    let (line, start) =
        line_starts(text).take_while(|start| *start <= byte).enumerate().last().unwrap_or((0, 0));
    (line + 1, text[start..byte].chars().count() + 1)
}

fn shortened_to(text: &str, chars: usize) -> String {
    text.chars().take(chars).collect()
}

const NO_COLON: &str = "this line has no colon";

/// The construct that the parser could not complete, and its start. Both are taken from the parser's message: `while parsing a flow
/// sequence at line 8 column 17`.
struct Begun<'a> {
    what: &'a str,
    line: usize,
    column: usize,
}

impl<'a> Begun<'a> {
    fn of(whole: &'a str, text: &str) -> Option<Self> {
        let (_, context) = whole.rsplit_once(", while ")?;
        let (what, place) = context.split_once(" at line ")?;
        let (line, column) = place.split_once(" column ")?;
        let byte = byte_of(text, line.parse().ok()?, column.parse().ok()?);
        let (line, column) = line_and_column(text, byte);
        Some(Self { what, line, column })
    }
}

/// Returns the byte offset of a position that the parser reports. The parser counts more characters as line breaks than editors do.
fn byte_of(text: &str, line: usize, column: usize) -> usize {
    let ends = |c: char| matches!(c, '\n' | '\r' | '\u{85}' | '\u{2028}' | '\u{2029}');
    let mut start = 0;
    for _ in 1..line {
        let Some(at) = text[start..].find(ends) else { break };
        let rest = &text[start + at..];
        start +=
            at + if rest.starts_with("\r\n") { 2 } else { rest.chars().next().map_or(0, char::len_utf8) };
    }
    let ahead = text[start..].chars().take(column.saturating_sub(1)).map(char::len_utf8);
    start + ahead.sum::<usize>()
}

/// Returns the key in the line above line `number`, and the column of the key, counted from 1. `None` unless that key already has a value
/// and line `number` is indented more deeply.
fn deeper_than(text: &str, number: usize) -> Option<(&str, usize)> {
    let indented = |line: &str| line.chars().take_while(|c| *c == ' ').count();
    let line = line_of(text, number);
    let above = (1..number).rev().map(|above| line_of(text, above)).find(|above| !above.trim().is_empty())?;
    let entry = above.trim_start_matches([' ', '-']);
    let column = above.len() - entry.len();
    let (key, value) = entry.split_once(": ")?;
    let is_plain = !value.trim().is_empty() && !value.trim_start().starts_with(['|', '>', '#', '&', '!']);
    (is_plain && indented(line) > column).then_some((key, column + 1))
}

/// Beginning of a message that names the key above.
const DEEPER: &str = "this line is indented deeper than";

fn too_deep(finding: &mut Finding, line: &str, key: &str, column: usize) {
    let key = shortened(key);
    finding.message = format!("{DEEPER} `{key}`, which already has a value");
    finding.expected = format!("{} before it", crate::render::counted(column - 1, "space"));
    finding.hint = Some(format!("indent it like `{key}`"));
    finding.column = line.len() - line.trim_start().len() + 1;
}

/// Adds the message and hint to the finding for a second colon in a line. It is part of a value, or belongs to a map that begins on the
/// line of its key.
fn second_colon(finding: &mut Finding, line: &str) {
    "a second colon in one line".clone_into(&mut finding.message);
    "one key and its value".clone_into(&mut finding.expected);
    let entry = line.trim_start().trim_start_matches("- ");
    let Some((key, value)) = entry.split_once(": ") else { return };
    let inner = value.trim();
    let is_map = inner.ends_with(':') || inner.contains(": [") || inner.contains(": {");
    finding.hint = Some(if is_map {
        format!("start a new line after `{key}:`, and indent it deeper")
    } else {
        format!("write the value in quotation marks: `{key}: \"{}\"`", shortened(inner))
    });
}

/// Adds the message and hint to the finding for an unknown alias. YAML reads a text that begins with an asterisk as an alias.
fn unknown_alias(finding: &mut Finding, line: &str) {
    "unknown alias: an asterisk at the start of a value refers to an alias".clone_into(&mut finding.message);
    "a value that starts with another character".clone_into(&mut finding.expected);
    let rest = line.split_once('*').map_or("", |(_, rest)| rest);
    let name = rest.split([',', ']', '}', '#']).next().unwrap_or_default().trim();
    finding.hint = Some(match name {
        "" => "list each robot or group, as in `[left, right]`".to_owned(),
        name => format!("write `{0}`, or `\"*{0}\"` if the asterisk is part of it", shortened(name)),
    });
}

/// Moves the finding for an error of the parser to the place that the user has to correct, and adds a hint.
fn explain(finding: &mut Finding, whole: &str, text: &str) {
    let line = line_of(text, finding.line);
    if whole.starts_with("mapping values are not allowed") {
        return match deeper_than(text, finding.line) {
            Some((key, column)) => too_deep(finding, line, key, column),
            None => second_colon(finding, line),
        };
    }
    if whole.starts_with("unknown anchor") || whole.contains("while scanning an alias") {
        return unknown_alias(finding, line);
    }
    let Some(begun) = Begun::of(whole, text) else { return };
    let opened = match begun.what {
        "parsing a flow sequence" => Some(("[", "]")),
        "parsing a flow mapping" => Some(("{", "}")),
        _ => None,
    };
    let (message, expected, hint) = if let Some((open, close)) = opened {
        if begun.line == finding.line {
            let hint = format!("separate entries with commas, and close the bracket with `{close}`");
            finding.message = format!("unexpected text after an entry within `{open}`");
            (None, format!("`,` or `{close}`"), hint)
        } else {
            let message = format!("the bracket `{open}` is never closed");
            (
                Some(message),
                format!("a `{close}` that closes it"),
                format!("add `{close}` where the list ends"),
            )
        }
    } else if begun.what == "scanning a quoted scalar" {
        let message = "the quotation mark is never closed".to_owned();
        (
            Some(message),
            "a second quotation mark".to_owned(),
            "add a quotation mark at the end of the text".to_owned(),
        )
    } else if begun.what == "scanning a simple key" {
        let message = NO_COLON.to_owned();
        (
            Some(message),
            "a key, a colon and a value".to_owned(),
            "write the key, a colon, a space and the value".to_owned(),
        )
    } else if begun.what.starts_with("parsing a block") {
        let message = "this line is not indented like the other lines of its block".to_owned();
        let hint = "indent it like the line above, or deeper if it belongs to that line".to_owned();
        finding.message = message;
        (None, "the indentation of the surrounding lines".to_owned(), hint)
    } else {
        return;
    };
    if let Some(message) = message {
        finding.message = message;
        (finding.line, finding.column) = (begun.line, begun.column);
    }
    finding.expected = expected;
    finding.hint = Some(hint);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::parse;
    use crate::render::render;

    const KEYS: [&str; 3] = ["robots", "groups", "id"];

    /// Returns the finding about an invalid text as a user sees it, in all forms.
    fn shown(text: &str) -> String {
        let source = Source { name: "x.yaml".to_owned(), text: text.to_owned() };
        let finding = conceal(parse(&source).unwrap_err(), &source, &KEYS);
        let json = serde_json::to_string(&finding).unwrap();
        format!(
            "{}\n{json}\n{:?}",
            render(std::slice::from_ref(&finding), false),
            crate::sarif::sarif(&[finding])
        )
    }

    #[test]
    fn no_part_of_a_foreign_file_is_shown() {
        for text in [
            "password: \"hunter2\nuser: anna\n",
            "password: hunter2: x\n",
            "user: hunter1\n   password: hunter2\n",
            "user: hunter1\n  - hunter2: 3\n",
            "token: *hunter2\n",
            "token: ${hunter2}: 1\n",
            "\tpassword: hunter2\n",
            "password: [hunter1, hunter2\nuser: anna\n",
            "password: {hunter1 hunter2: 1 hunter3: 2}\n",
            "hunter2\nuser: anna\n",
            "password:hunter2\nuser: anna\n",
            "hunter2: 1\n--- \nhunter3: 2\n",
            "a: &hunter2 1\n a: @hunter2\n",
            "{\"hunter1\": {\"id\": 1, \"robots\": \"hunter2}}",
            "secret:\n  robots: \"hunter2\n",
            "the robots: are hunter2: and\n",
            "%hunter2 directive\n",
        ] {
            let shown = shown(text);
            assert!(!shown.contains("hunter"), "{text:?}:\n{shown}");
            assert!(
                shown.contains("x.yaml:") && shown.contains("the line is not shown"),
                "{text:?}:\n{shown}"
            );
        }
    }

    #[test]
    fn place_of_concealed_line_is_stated() {
        let shown = shown("user: anna\npassword: \"hunter2\n");
        assert!(shown.contains("the quotation mark is never closed"), "{shown}");
        assert!(shown.contains("x.yaml:2:11"), "{shown}");
    }

    #[test]
    fn line_of_a_file_with_a_known_key_is_shown() {
        for text in [
            "robots: {a: 1\n",
            "robots\n  a: 1\n",
            "\"groups\" : \"a\n",
            "other: 1\nid: a: b\n",
            "{\"x\": {\"y\": \":\"}, \"id\": 1, \"z\"\n",
            "{\n  robots: [1\n",
        ] {
            let shown = shown(text);
            assert!(!shown.contains("is not shown"), "{text:?}:\n{shown}");
        }
    }
}
