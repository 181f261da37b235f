//! Finds YAML tags of other programs, such as `!!python/tuple` and `!degrees`. They are rejected everywhere, and never executed.

use saphyr_parser::Event;

use crate::events::Events;
use crate::finding::{Code, Finding};
use crate::render::line_of;
use crate::shown::shortened;
use crate::source::Source;

/// Maximum number of tags that are reported per file.
const TAGS_MAX: usize = 100;
/// Maximum length of the source line in a finding, in characters. Longer lines are cut.
const LINE_CHARS_MAX: usize = 1_000;

/// Returns a finding for each tag outside YAML's core schema. The event parser reports all tags, including those that are dropped when
/// the tree is built.
pub fn foreign_tags(source: &Source) -> Vec<Finding> {
    let mut findings = Vec::new();
    if !source.text.contains('!') {
        return findings;
    }
    Events::of(&source.text).each(|event, extent| {
        let tag = match &event {
            Event::Scalar(_, _, _, tag) | Event::SequenceStart(_, tag) | Event::MappingStart(_, tag) => tag,
            _ => return true,
        };
        let Some(tag) = tag.as_ref().filter(|tag| !tag.is_yaml_core_schema() || tag.suffix.contains('/'))
        else {
            return true;
        };
        let mut finding = Finding::about_file(
            Code::ForeignTag,
            &source.name,
            format!("the tag `!{}` is not supported", shortened(&tag.suffix)),
            "a plain value",
            Some("remove the tag, and write a plain value".to_owned()),
        );
        (finding.line, finding.column) = (extent.start.0, extent.start.1 + 1);
        finding.width = 1;
        finding.source_line = line_of(&source.text, finding.line).chars().take(LINE_CHARS_MAX).collect();
        findings.push(finding);
        findings.len() < TAGS_MAX
    });
    findings
}
