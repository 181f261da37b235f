//! Findings as people read them: the line, what is wrong with it, what was expected, how to mend it.

use annotate_snippets::{AnnotationKind, Level, Renderer, Snippet};

use crate::finding::{Finding, Severity};

/// Longest part of a line that is shown, in characters.
const LINE_CHARS_MAX: usize = 160;

/// The text of line `number`, counted from 1.
pub(crate) fn line_of(text: &str, number: usize) -> &str {
    text.lines().nth(number.saturating_sub(1)).unwrap_or("")
}

/// All findings in the style of compilers, with a closing count.
#[must_use]
pub fn render(findings: &[Finding], colour: bool) -> String {
    let renderer = if colour { Renderer::styled() } else { Renderer::plain() };
    let mut text = String::new();
    for finding in findings {
        text.push_str(&render_one(&renderer, finding));
        text.push_str("\n\n");
    }
    let errors = findings.iter().filter(|finding| finding.severity == Severity::Error).count();
    text.push_str(&format!("{}, {}", counted(errors, "error"), counted(findings.len() - errors, "warning")));
    text
}

/// `1 robot`, `2 robots`.
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
    let title = level.primary_title(finding.message.as_str()).id(finding.code.as_str());
    let (line, span) = shown_part(finding);
    let mut group = match finding.line {
        0 => title.element(annotate_snippets::Origin::path(finding.file.as_str())),
        number => title.element(
            Snippet::source(line.as_str()).path(finding.file.as_str()).line_start(number).annotation(
                AnnotationKind::Primary.span(span).label(format!("expected {}", finding.expected)),
            ),
        ),
    };
    if finding.line == 0 {
        group = group.element(Level::NOTE.message(format!("expected {}", finding.expected)));
    }
    if let Some(hint) = &finding.hint {
        group = group.element(Level::HELP.message(hint.as_str()));
    }
    renderer.render(&[group])
}

/// The line or a part of it round the place, and the place in it in bytes.
fn shown_part(finding: &Finding) -> (String, std::ops::Range<usize>) {
    let column = finding.column.saturating_sub(1);
    let first = column.saturating_sub(LINE_CHARS_MAX / 2);
    let chars = finding.source_line.chars().skip(first).take(LINE_CHARS_MAX);
    let shown: String = chars.map(|c| if c.is_control() && c != '\t' { ' ' } else { c }).collect();
    let byte = |chars: usize| shown.char_indices().nth(chars).map_or(shown.len(), |(at, _)| at);
    let start = byte(column - first);
    let end = byte((column - first).saturating_add(finding.width)).max(start);
    (shown, start..end)
}
