//! Findings as diagnostics of the protocol.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use downbeat_scripts::{Finding, Severity};
use lsp_types::{
    Diagnostic, DiagnosticRelatedInformation, DiagnosticSeverity, Location, NumberOrString, Position, Range,
};

use crate::address::uri_of;
use crate::text::Text;
use crate::workspace::Workspace;

/// The source of the diagnostics, which editors show next to them.
const SOURCE: &str = "downbeat";

/// Returns the diagnostics of findings by file.
pub(crate) fn by_file(findings: &[Finding], workspace: &Workspace) -> BTreeMap<PathBuf, Vec<Diagnostic>> {
    let mut all: BTreeMap<PathBuf, Vec<Diagnostic>> = BTreeMap::new();
    for finding in findings {
        let path = path_of(finding);
        let diagnostic = match workspace.file(&path) {
            Some(file) => diagnostic(finding, &file.text, &path),
            None => diagnostic(finding, &Text::new(String::new()), &path),
        };
        all.entry(path).or_default().push(diagnostic);
    }
    all
}

/// Returns the canonical path of the file that a finding concerns.
pub(crate) fn path_of(finding: &Finding) -> PathBuf {
    let path = Path::new(&finding.file);
    path.canonicalize().unwrap_or_else(|_| path.to_path_buf())
}

/// Returns the range of a finding in its file.
pub(crate) fn range_of(finding: &Finding, text: &Text) -> Range {
    range(text, finding.line, finding.column, finding.width)
}

fn range(text: &Text, line: usize, column: usize, width: usize) -> Range {
    if line == 0 {
        return Range { start: Position::default(), end: text.position(text.line(0).end) };
    }
    let start = text.byte_at(line, column);
    let end = text.byte_at(line, column + width.max(1));
    text.range(start..end.max(start))
}

fn diagnostic(finding: &Finding, text: &Text, path: &Path) -> Diagnostic {
    let related = uri_of(path).map(|uri| {
        let related = finding.related.iter().map(|place| DiagnosticRelatedInformation {
            location: Location {
                uri: uri.clone(),
                range: range(text, place.line, place.column, place.width),
            },
            message: place.message.clone(),
        });
        related.collect::<Vec<_>>()
    });
    Diagnostic {
        range: range_of(finding, text),
        severity: Some(match finding.severity {
            Severity::Error => DiagnosticSeverity::ERROR,
            Severity::Warning => DiagnosticSeverity::WARNING,
        }),
        code: Some(NumberOrString::String(finding.code.as_str().to_owned())),
        source: Some(SOURCE.to_owned()),
        message: message(finding),
        related_information: related.filter(|related| !related.is_empty()),
        ..Diagnostic::default()
    }
}

fn message(finding: &Finding) -> String {
    let Finding { message, expected, hint, .. } = finding;
    let hint = hint.as_ref().map(|hint| format!("\n{hint}")).unwrap_or_default();
    format!("{message}\nexpected {expected}{hint}")
}
