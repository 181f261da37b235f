//! Tags of other programs, such as `!!python/tuple` and `!degrees`: refused wherever they stand, never executed.

use saphyr_parser::Event;

use crate::events::Events;
use crate::finding::{Code, Finding};
use crate::render::line_of;
use crate::shown::shortened;
use crate::source::Source;

/// Most tags of one file that are listed.
const TAGS_MAX: usize = 100;
/// Longest line that a finding carries, in characters.
const LINE_CHARS_MAX: usize = 1_000;

/// Every tag that is not of YAML's core schema. The parser that keeps places sees all of them, those too that the other
/// one drops.
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
            format!("the tag `!{}` belongs to another program", shortened(&tag.suffix)),
            "a plain value",
            Some("remove the tag: nothing in a file is ever executed or converted by a tag".to_owned()),
        );
        (finding.line, finding.column) = (extent.start.0, extent.start.1 + 1);
        finding.width = 1;
        finding.source_line = line_of(&source.text, finding.line).chars().take(LINE_CHARS_MAX).collect();
        findings.push(finding);
        findings.len() < TAGS_MAX
    });
    findings
}
