//! Fixes of findings as edits. An edit follows from the hint of a finding, and is offered only if a check of the edited text no longer
//! reports the finding.

use std::ops::Range;

use downbeat_scripts::{Code, Finding};

use crate::check::{Checked, Job, check};
use crate::file::File;

/// A replacement of a part of a text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Fix {
    /// The bytes that are replaced.
    pub(crate) span: Range<usize>,
    pub(crate) new: String,
}

/// The beginnings of hints that contain the text to write between back-ticks.
const WRITES: [&str; 4] = ["did you mean `", "write `", "use `", "remove it"];

/// Returns the first edit that fixes a finding in a file. `job` is the check that found it, and `before` its result.
pub(crate) fn fix(finding: &Finding, file: &File, job: &Job, before: &Checked) -> Option<Fix> {
    candidates(finding, file).into_iter().find(|fix| is_fixed(finding, file, fix, job, before))
}

fn is_fixed(finding: &Finding, file: &File, fix: &Fix, job: &Job, before: &Checked) -> bool {
    let mut text = file.text.as_str().to_owned();
    text.replace_range(fix.span.clone(), &fix.new);
    let mut job = job.clone();
    if job.path == file.path {
        job.text.clone_from(&text);
    }
    let mut unsaved = job.unsaved.as_ref().clone();
    unsaved.insert(file.path.clone(), text);
    job.unsaved = unsaved.into();
    let after = check(&job);
    // An error in one place can hide errors in others, except a fault of the syntax, which hides all of them.
    !after.has(finding)
        && after.is_readable()
        && (finding.code == Code::Syntax || after.errors() <= before.errors())
}

/// Returns the edits that the hint of a finding may mean.
fn candidates(finding: &Finding, file: &File) -> Vec<Fix> {
    let Some(hint) = finding.hint.as_deref().filter(|_| finding.line > 0) else { return Vec::new() };
    let Some(begin) = WRITES.iter().find(|begin| hint.starts_with(**begin)) else { return Vec::new() };
    let start = file.text.byte_at(finding.line, finding.column);
    let marked = start..file.text.byte_at(finding.line, finding.column + finding.width.max(1));
    if *begin == "remove it" {
        return vec![Fix { span: marked, new: String::new() }];
    }
    let Some(new) = hint.split('`').nth(1) else { return Vec::new() };
    let mut spans = vec![marked.clone()];
    for node in file.tree.nodes.iter().filter(|node| node.span.start == start && node.span != marked) {
        spans.push(node.span.clone());
    }
    if let Some(entry) = new.contains(": ").then(|| entry_at(file, start)).flatten() {
        spans.insert(0, entry);
    }
    spans.into_iter().map(|span| Fix { span, new: new.to_owned() }).collect()
}

/// Returns the bytes of the entry whose key or value begins at a byte.
fn entry_at(file: &File, start: usize) -> Option<Range<usize>> {
    let nodes = &file.tree.nodes;
    let begins = |node: usize| nodes[node].span.start == start;
    let maps = (0..nodes.len()).flat_map(|map| file.tree.entries(map));
    let entry = maps.into_iter().find(|entry| begins(entry.key) || begins(entry.value))?;
    Some(nodes[entry.key].span.start..nodes[entry.value].span.end)
}
