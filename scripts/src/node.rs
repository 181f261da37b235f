//! A YAML document as a tree that keeps what a user may have done wrong: duplicate keys, wrong kinds, foreign tags.
//! Read by serde_yaml, whose limit on nesting bounds it; `rows` spares it long runs of keyframes, `aliases` bounds aliases.

use std::fmt;

use serde::de::{self, Deserialize, Deserializer, EnumAccess, MapAccess, SeqAccess, VariantAccess, Visitor};

use crate::aliases;
use crate::finding::{Code, Finding};
use crate::render::{line_of, line_starts};
use crate::rows::{self, Items};
use crate::source::Source;

/// What some editors begin a file with.
pub(crate) const BYTE_ORDER_MARK: char = '\u{feff}';

/// Any YAML value.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Node {
    Null,
    Bool(bool),
    Number(f64),
    Text(String),
    List(Items),
    Map(Vec<(String, Node)>),
    Tagged(String),
}

impl Node {
    /// What it is, for messages.
    pub(crate) fn kind(&self) -> String {
        match self {
            Self::Null => "nothing".into(),
            Self::Bool(value) => format!("the truth value {value}"),
            Self::Number(value) => format!("the number {value}"),
            Self::Text(text) => format!("the text `{}`", shortened(text)),
            Self::List(_) => "a list".into(),
            Self::Map(_) => "a map".into(),
            Self::Tagged(tag) => format!("a value with the tag `{}`", shortened(tag)),
        }
    }
}

pub(crate) fn shortened(text: &str) -> String {
    match text.char_indices().nth(60) {
        Some((at, _)) => format!("{}...", &text[..at]),
        None => text.to_owned(),
    }
}

/// Reads a whole file as one document.
///
/// # Errors
/// A finding of kind [`Code::Syntax`] with the place where the text stops being YAML.
pub(crate) fn parse(source: &Source) -> Result<Node, Finding> {
    let text = source.text.trim_start_matches(BYTE_ORDER_MARK);
    if text.trim().is_empty() {
        let hint = Some("see `docs/scenario.md` for what goes into it".to_owned());
        let message = "the file is empty".to_owned();
        return Err(Finding::about_file(Code::Syntax, &source.name, message, "a YAML map", hint));
    }
    let condensed = rows::condense(text);
    let left = condensed.as_ref().map_or(text, |condensed| condensed.text.as_str());
    if let Some(finding) = aliases::check(source, left) {
        return Err(finding);
    }
    let root = condensed.and_then(|condensed| {
        let root = serde_yaml::from_str(&condensed.text).ok()?;
        condensed.restore(root, aliases::ALIASED_MAX)
    });
    root.map_or_else(|| parse_whole(source), Ok)
}

/// The same by the library alone.
pub(crate) fn parse_whole(source: &Source) -> Result<Node, Finding> {
    let text = source.text.trim_start_matches(BYTE_ORDER_MARK);
    if let Some(finding) = aliases::check(source, text) {
        return Err(finding);
    }
    serde_yaml::from_str(text).map_err(|error| syntax_finding(source, &error))
}

pub(crate) fn syntax_finding(source: &Source, error: &serde_yaml::Error) -> Finding {
    let whole = error.to_string();
    let end = whole.find(" at line ").unwrap_or(whole.len());
    let message = shortened_to(&whole[..end], 300);
    let mut finding = Finding::about_file(Code::Syntax, &source.name, message, "one YAML document", None);
    if let Some(at) = error.location() {
        (finding.line, finding.column) = line_and_column(&source.text, at.index());
        finding.width = 1;
        finding.source_line = line_of(&source.text, finding.line).to_owned();
    }
    if let Some(hint) = slip(source, &finding) {
        finding.hint = Some(hint);
    } else if whole.contains("repetition limit") {
        finding.hint = Some("the aliases multiply beyond all measure: write less with them".into());
    } else if whole.contains("recursion limit") {
        finding.hint = Some("nothing here nests deeper than a handful of levels".into());
    } else if whole.contains("more than one document") {
        finding.hint = Some("keep one document a file: remove the `---` between them".into());
    }
    finding
}

/// What people most often write where YAML stumbles: marks of editors, tabs, a colon without a space.
fn slip(source: &Source, finding: &Finding) -> Option<String> {
    let marked = source.text.trim_start_matches(BYTE_ORDER_MARK).contains(BYTE_ORDER_MARK);
    if marked {
        let hint = "a byte order mark stands within the file, as where two files were joined: remove it";
        return Some(hint.to_owned());
    }
    let lines = [finding.line, finding.line.saturating_sub(1)];
    let near = || lines.into_iter().filter(|line| *line > 0).map(|line| line_of(&source.text, line));
    let indented = |line: &str| line[..line.len() - line.trim_start().len()].contains('\t');
    if near().any(indented) {
        return Some("YAML is indented by spaces: replace each tab by some".to_owned());
    }
    near().find_map(|line| without_space_at_all(line.trim_start().trim_start_matches("- ")))
}

/// A hint for `at:0s`, which YAML reads as one word.
pub(crate) fn without_space(key: &str, known: &[&str]) -> Option<String> {
    let (name, rest) = key.split_once(':')?;
    known.contains(&name.trim()).then(|| spaced(name, rest))
}

/// The same where any word may be the key.
pub(crate) fn without_space_at_all(text: &str) -> Option<String> {
    let (name, rest) = text.split_once(':')?;
    let word = !name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || c == '_' || c == '-');
    let joined = rest.starts_with(|c: char| !c.is_whitespace());
    (word && joined).then(|| spaced(name, rest))
}

fn spaced(name: &str, rest: &str) -> String {
    let value = rest.split_whitespace().next().unwrap_or_default();
    format!("write a space after the colon: `{}: {}`", shortened(name), shortened(value))
}

/// Of a byte, both from 1. The parser's own lines also end where those of YAML 1.1 do, which no editor shows so.
fn line_and_column(text: &str, byte: usize) -> (usize, usize) {
    let byte = (0..=byte.min(text.len())).rev().find(|at| text.is_char_boundary(*at)).unwrap_or(0);
    let (line, start) =
        line_starts(text).take_while(|start| *start <= byte).enumerate().last().unwrap_or((0, 0));
    (line + 1, text[start..byte].chars().count() + 1)
}

fn shortened_to(text: &str, chars: usize) -> String {
    text.chars().take(chars).collect()
}

impl<'de> Deserialize<'de> for Node {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(NodeVisitor)
    }
}

struct NodeVisitor;

#[expect(clippy::cast_precision_loss, reason = "all numbers of the language are doubles")]
impl<'de> Visitor<'de> for NodeVisitor {
    type Value = Node;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("any YAML value")
    }

    fn visit_unit<E: de::Error>(self) -> Result<Node, E> {
        Ok(Node::Null)
    }

    fn visit_bool<E: de::Error>(self, value: bool) -> Result<Node, E> {
        Ok(Node::Bool(value))
    }

    fn visit_u64<E: de::Error>(self, value: u64) -> Result<Node, E> {
        Ok(Node::Number(value as f64))
    }

    fn visit_i64<E: de::Error>(self, value: i64) -> Result<Node, E> {
        Ok(Node::Number(value as f64))
    }

    fn visit_u128<E: de::Error>(self, value: u128) -> Result<Node, E> {
        Ok(Node::Number(value as f64))
    }

    fn visit_i128<E: de::Error>(self, value: i128) -> Result<Node, E> {
        Ok(Node::Number(value as f64))
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<Node, E> {
        Ok(Node::Number(value))
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<Node, E> {
        Ok(Node::Text(text.to_owned()))
    }

    fn visit_string<E: de::Error>(self, text: String) -> Result<Node, E> {
        Ok(Node::Text(text))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Node, A::Error> {
        let mut list = Vec::new();
        while let Some(node) = seq.next_element()? {
            list.push(node);
        }
        Ok(Node::List(Items::Nodes(list)))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Node, A::Error> {
        let mut entries = Vec::new();
        while let Some(Key(key)) = map.next_key()? {
            entries.push((key, map.next_value()?));
        }
        Ok(Node::Map(entries))
    }

    fn visit_enum<A: EnumAccess<'de>>(self, data: A) -> Result<Node, A::Error> {
        let (tag, content) = data.variant::<String>()?;
        content.newtype_variant::<de::IgnoredAny>()?;
        Ok(Node::Tagged(tag))
    }
}

/// A key as the text that is there; keys that are no scalars become one that is unknown everywhere.
struct Key(String);

impl<'de> Deserialize<'de> for Key {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Self(match Node::deserialize(deserializer)? {
            Node::Text(text) => text,
            Node::Number(value) => value.to_string(),
            Node::Bool(value) => value.to_string(),
            Node::Null => "null".into(),
            other => other.kind(),
        }))
    }
}
