//! Reads YAML and JSON files of other programs. Unused keys are ignored. Tags are rejected, because only the program that wrote them
//! knows their meaning.

use downbeat_reader::fields::{At, Reader};
use downbeat_yaml::finding::Code;
use downbeat_yaml::node::{self, Node};
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;
use downbeat_yaml::tags::foreign_tags;

use super::sink::{FINDINGS_A_FILE_MAX, Sink, with_short_line};

/// Maximum size of a YAML text that is parsed, in bytes. The parsed tree takes many times the memory of the text.
const YAML_BYTES_MAX: usize = 2 << 20;
const JSON_BYTES_MAX: usize = 6 << 20;
/// Maximum number of commas in a JSON text, which limits the number of values. A short value takes a hundred times its length in memory.
const COMMAS_MAX: usize = 1_000_000;
/// Maximum number of brackets that are open at once.
const DEPTH_MAX: usize = 500;

/// Parses a file, rejects foreign tags, and passes the tree to a reader. Adds the reader's findings, with their places, to the sink.
pub(super) fn read<T>(
    source: &Source,
    sink: &mut Sink,
    read: impl FnOnce(&At<'_>, &mut Reader, &mut Sink) -> Option<T>,
) -> Option<T> {
    let is_json = source.text.trim_start().starts_with('{') && source.text.len() <= JSON_BYTES_MAX;
    if is_json && has_too_many_values(source, sink) {
        return None;
    }
    if is_json && let Ok(document) = serde_json::from_str::<Node>(&source.text) {
        return read_document(&document, source, sink, read);
    }
    if source.text.len() > YAML_BYTES_MAX {
        let message = format!("the file has {} bytes", source.text.len());
        let expected = format!("at most {YAML_BYTES_MAX} bytes, or {JSON_BYTES_MAX} of JSON");
        sink.about(&source.name, Code::ImportLimit, message, &expected, Some("split it into several files"));
        return None;
    }
    if is_too_deep(&source.text) {
        let message = format!("brackets are nested more than {DEPTH_MAX} levels deep");
        let hint = "check the brackets: valid files are nested only a few levels deep";
        sink.about(&source.name, Code::Syntax, message, "a YAML or JSON document", Some(hint));
        return None;
    }
    let document = match node::parse(source) {
        Ok(document) => document,
        Err(mut finding) => {
            finding.expected = "a YAML or JSON document".into();
            if finding.hint.as_deref().is_some_and(|hint| hint.contains("downbeat init")) {
                finding.hint = Some("see `docs/import.md` for the contents of the file".into());
            }
            sink.findings.push(with_short_line(finding));
            return None;
        }
    };
    let tags = foreign_tags(source);
    if !tags.is_empty() {
        sink.findings.extend(tags);
        return None;
    }
    read_document(&document, source, sink, read)
}

/// Like [`read`], but for files that must be JSON.
pub(super) fn read_json<T>(
    source: &Source,
    sink: &mut Sink,
    read: impl FnOnce(&At<'_>, &mut Reader, &mut Sink) -> Option<T>,
) -> Option<T> {
    if has_too_many_values(source, sink) {
        return None;
    }
    match serde_json::from_str::<Node>(&source.text) {
        Ok(document) => read_document(&document, source, sink, read),
        Err(error) => {
            sink.found_json(source, &error);
            None
        }
    }
}

fn read_document<T>(
    document: &Node,
    source: &Source,
    sink: &mut Sink,
    read: impl FnOnce(&At<'_>, &mut Reader, &mut Sink) -> Option<T>,
) -> Option<T> {
    let mut findings = Reader::default();
    let result = read(&At::document(document, 0), &mut findings, sink);
    let sound = findings.found.is_empty();
    sink.located(source, findings);
    result.filter(|_| sound)
}

fn has_too_many_values(source: &Source, sink: &mut Sink) -> bool {
    let commas = memchr::memchr_iter(b',', source.text.as_bytes()).count();
    if commas > COMMAS_MAX {
        let message = format!("the file has too many values, separated by {commas} commas");
        let expected = format!("at most {COMMAS_MAX} values");
        sink.about(&source.name, Code::ImportLimit, message, &expected, Some("split it into several files"));
    }
    commas > COMMAS_MAX
}

/// Whether brackets are nested more deeply than [`DEPTH_MAX`]. The parsing time grows with the square of the depth, and no valid file is
/// nested so deeply.
fn is_too_deep(text: &str) -> bool {
    let mut depth = 0_usize;
    text.bytes().any(|byte| {
        match byte {
            b'[' | b'{' => depth += 1,
            b']' | b'}' => depth = depth.saturating_sub(1),
            _ => {}
        }
        depth > DEPTH_MAX
    })
}

/// Returns the items of `list`, the points of a trajectory. Adds a finding if the list is empty.
pub(super) fn points<'a>(list: &'a At<'a>, findings: &mut Reader) -> Vec<At<'a>> {
    let items = findings.list(list, "a list of points");
    if items.is_empty() && matches!(list.node, Node::List(_)) {
        let message = "the trajectory has no points";
        findings.add(Code::NothingToDo, list.place(), message, "at least one point", None);
    }
    items
}

/// Whether the maximum number of findings is exceeded, so that reading stops.
pub(super) fn is_full(findings: &Reader) -> bool {
    findings.found.len() > FINDINGS_A_FILE_MAX
}

/// The value of a key, if the key exists.
pub(super) fn optional<'a>(at: &'a At<'a>, key: &'static str) -> Option<At<'a>> {
    let Node::Map(entries) = at.node else { return None };
    entries.iter().find(|(name, _)| name == key).map(|(_, node)| at.entry(key, 0, node))
}

/// Returns the value of a key. Adds a finding if the key is missing.
pub(super) fn required<'a>(
    at: &'a At<'a>,
    key: &'static str,
    what: &str,
    findings: &mut Reader,
) -> Option<At<'a>> {
    let Node::Map(_) = at.node else {
        findings.wrong_type(at, &format!("{what}: a map with `{key}`"));
        return None;
    };
    let found = optional(at, key);
    if found.is_none() {
        let message = format!("{what} has no `{key}`");
        findings.add(Code::MissingKey, at.place(), message, format!("a key `{key}`"), None);
    }
    found
}

/// Reads a finite number. Adds a finding if the node is anything else.
pub(super) fn number(at: &At<'_>, what: &str, findings: &mut Reader) -> Option<f64> {
    match at.node {
        Node::Number(value) if value.is_finite() => Some(*value),
        other => {
            let message = format!("{what} is {}", other.kind());
            let is_cut = matches!(other, Node::Text(text) if text == "...");
            let hint =
                is_cut.then(|| "print the complete message with `ros2 topic echo --full-length`".to_owned());
            findings.add(Code::ImportNumber, at.place(), message, "a finite number", hint);
            None
        }
    }
}

/// Reads a list of finite numbers. Adds a finding for each item that is anything else.
pub(super) fn numbers(at: &At<'_>, what: &str, findings: &mut Reader) -> Option<Vec<f64>> {
    let items = findings.list(at, &format!("{what}: a list of numbers"));
    let mut values = Vec::with_capacity(items.len());
    for (index, item) in items.iter().enumerate() {
        values.extend(number(item, &format!("{what}, number {},", index + 1), findings));
        if is_full(findings) {
            return None;
        }
    }
    (values.len() == items.len() && matches!(at.node, Node::List(_))).then_some(values)
}

/// Reads a list of distinct names.
pub(super) fn unique_names(at: &At<'_>, what: &str, findings: &mut Reader) -> Option<Vec<String>> {
    let mut names: Vec<String> = Vec::new();
    let mut seen = std::collections::HashSet::new();
    for item in findings.list(at, &format!("a list of {what}s")) {
        let name = findings.name(&item, &format!("the name of a {what}"))?;
        if !seen.insert(name.clone()) {
            let message = format!("duplicate {what} `{}`", shortened(&name));
            findings.add(Code::ImportNames, item.place(), message, "unique names", None);
        }
        names.push(name);
    }
    (!names.is_empty()).then_some(names)
}
