//! Formats findings for human readers: the line, the fault, the expected value, and how to fix the fault.

use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet};

use std::collections::HashMap;

use crate::finding::{Code, Finding, Severity};
use crate::shown::shown;

/// Maximum number of warnings with the same code that are shown.
const WARNINGS_MAX: usize = 20;
/// Maximum length of the part of a line that is shown, in characters.
const LINE_CHARS_MAX: usize = 160;

/// Returns the text of line `number`, counted from 1; empty if there is no such line. As in YAML, lines end with `\n`, `\r\n` or a lone
/// `\r`.
pub fn line_of(text: &str, number: usize) -> &str {
    let Some(start) = line_starts(text).nth(number.saturating_sub(1)) else { return "" };
    text[start..].split(['\n', '\r']).next().unwrap_or("")
}

/// Returns the byte offset at which each line starts.
pub fn line_starts(text: &str) -> impl Iterator<Item = usize> + '_ {
    let bytes = text.as_bytes();
    let ends = bytes
        .iter()
        .enumerate()
        .filter(move |(at, byte)| **byte == b'\n' || (**byte == b'\r' && bytes.get(at + 1) != Some(&b'\n')));
    std::iter::once(0).chain(ends.map(|(at, _)| at + 1))
}

/// Formats findings in the style of compiler messages, followed by the numbers of errors and warnings.
#[must_use]
pub fn render(findings: &[Finding], colour: bool) -> String {
    let renderer = if colour { Renderer::styled() } else { Renderer::plain() };
    let mut text = String::new();
    let mut shown: HashMap<Code, usize> = HashMap::new();
    for finding in findings {
        let count = shown.entry(finding.code).or_default();
        *count += 1;
        if finding.severity == Severity::Error || *count <= WARNINGS_MAX {
            text.push_str(&render_one(&renderer, finding));
            text.push_str("\n\n");
        }
    }
    let mut hidden: Vec<_> = shown
        .into_iter()
        .filter(|(code, count)| code.severity() == Severity::Warning && *count > WARNINGS_MAX)
        .collect();
    hidden.sort_unstable();
    for (code, count) in hidden {
        let more = counted(count - WARNINGS_MAX, "warning");
        let code = code.as_str();
        text.push_str(&format!("plus {more} with the code {code}: `--format json` lists all of them\n\n"));
    }
    let errors = findings.iter().filter(|finding| finding.severity == Severity::Error).count();
    text.push_str(&format!("{}, {}", counted(errors, "error"), counted(findings.len() - errors, "warning")));
    text
}

/// Writes a number with its noun in singular or plural: `1 robot`, `2 robots`.
#[must_use]
pub fn counted(count: usize, thing: &str) -> String {
    match count {
        1 => format!("1 {thing}"),
        _ => format!("{count} {thing}s"),
    }
}

fn render_one(renderer: &Renderer, finding: &Finding) -> String {
    let level = match finding.severity {
        Severity::Error => Level::ERROR,
        Severity::Warning => Level::WARNING,
    };
    let (message, file) = (shown(&finding.message), shown(&finding.file));
    let title = level.primary_title(&*message).id(finding.code.as_str());
    let lines = shown_lines(finding);
    let mut group = match finding.line {
        0 => title
            .element(annotate_snippets::Origin::path(&*file))
            .element(Level::NOTE.message(format!("expected {}", shown(&finding.expected)))),
        // The line is concealed.
        line if finding.width == 0 => title
            .element(annotate_snippets::Origin::path(&*file).line(line).char_column(finding.column))
            .element(Level::NOTE.message(format!("expected {}", shown(&finding.expected)))),
        _ => {
            let mut group = Group::with_title(title);
            for (number, text, marks) in &lines {
                let marks = marks.iter().map(|mark| {
                    let kind = if mark.primary { AnnotationKind::Primary } else { AnnotationKind::Context };
                    kind.span(mark.span.clone()).label(mark.label.as_str())
                });
                let snippet = Snippet::source(text.as_str()).path(&*file).line_start(*number);
                group = group.element(snippet.annotations(marks));
            }
            group
        }
    };
    let chain: Vec<_> =
        finding.chain().map(|place| format!("{} (line {})", shown(&place.message), place.line)).collect();
    if !chain.is_empty() {
        group = group.element(Level::NOTE.message(chain.join(", ")));
    }
    if let Some(hint) = &finding.hint {
        group = group.element(Level::HELP.message(shown(hint)));
    }
    let rendered = renderer.render(&[group]);
    match lines.iter().flat_map(|line| &line.2).find(|mark| mark.primary) {
        // The renderer reports the column within the shown part of the line.
        Some(mark) if mark.left_out > 0 => {
            let (line, column) =
                finding.chain().next().map_or((finding.line, finding.column), |at| (at.line, at.column));
            let place = |column: usize| format!("{file}:{line}:{column}");
            rendered.replacen(&place(column - mark.left_out), &place(column), 1)
        }
        _ => rendered,
    }
}

/// A marked part of a source line.
struct Mark {
    span: std::ops::Range<usize>,
    label: String,
    primary: bool,
    /// The number of characters at the beginning of the line that are not shown.
    left_out: usize,
}

/// Returns the lines to show for a finding, each with its number and marks. If a chain of places explains the finding, they are the lines
/// of these places; otherwise, the line of the finding with the expected value.
fn shown_lines(finding: &Finding) -> Vec<(usize, String, Vec<Mark>)> {
    let mut places: Vec<_> = finding.chain().enumerate().collect();
    if places.is_empty() {
        let (text, span, left_out) = shown_part(&finding.source_line, finding.column, finding.width);
        let label = format!("expected {}", shown(&finding.expected));
        return vec![(finding.line, text, vec![Mark { span, label, primary: true, left_out }])];
    }
    places.sort_by_key(|(_, place)| (place.line, place.column));
    let mut lines: Vec<(usize, String, Vec<Mark>)> = Vec::new();
    for (index, place) in places {
        let (text, span, left_out) = shown_part(&place.source_line, place.column, place.width);
        let label = format!("{}: {}", index + 1, shown(&place.message));
        let mark = Mark { span, label, primary: index == 0, left_out };
        match lines.last_mut().filter(|(number, shown, _)| *number == place.line && *shown == text) {
            Some((.., marks)) => marks.push(mark),
            None => lines.push((place.line, text, vec![mark])),
        }
    }
    lines
}

/// Returns the part of a line around a place, or the whole line if it is short. Also returns the byte range of the place in that part,
/// and the number of characters left out before the part.
fn shown_part(line: &str, column: usize, width: usize) -> (String, std::ops::Range<usize>, usize) {
    let column = column.saturating_sub(1);
    let first = column.saturating_sub(LINE_CHARS_MAX / 2);
    let chars = line.chars().skip(first).take(LINE_CHARS_MAX);
    let shown: String = chars.map(|c| if c.is_control() && c != '\t' { ' ' } else { c }).collect();
    let byte = |chars: usize| shown.char_indices().nth(chars).map_or(shown.len(), |(at, _)| at);
    let start = byte(column - first);
    let end = byte((column - first).saturating_add(width)).max(start);
    (shown, start..end, first)
}
