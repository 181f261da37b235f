//! A YAML document as a tree. The tree preserves mistakes of the user, such as duplicate keys, wrong types and foreign tags, so that they
//! can be reported. The library serde_yaml parses the document, and its nesting limit bounds the depth of the tree. The module `rows`
//! parses long runs of keyframes instead. `aliases` limits aliases; the number of values is limited again while the tree is built.

mod rows;

use std::cell::Cell;
use std::fmt;

use serde::de::{
    self, Deserialize, DeserializeSeed, Deserializer, EnumAccess, MapAccess, SeqAccess, VariantAccess,
    Visitor,
};

pub use rows::{EASES, Items, Row, Rows, Width};

use crate::aliases;
use crate::composed::compose_text;
use crate::finding::{Code, Finding};
use crate::nesting;
use crate::shown::shortened;
use crate::source::{BYTE_ORDER_MARK, Source};
use crate::syntax::{RECURSION, syntax_finding};

/// Any YAML value.
#[derive(Clone, Debug, PartialEq)]
pub enum Node {
    /// `null`, or no value at all.
    Null,
    /// `true` or `false`.
    Bool(bool),
    /// A number.
    Number(f64),
    /// Text.
    Text(String),
    /// A list.
    List(Items),
    /// A map: its keys and values in the order of the file. A key may occur more than once.
    Map(Vec<(String, Node)>),
    /// The tag of a value with a tag. The value itself is dropped.
    Tagged(String),
}

impl Node {
    /// Describes the type of the value for messages, such as `a list` or `the number 3`.
    pub fn kind(&self) -> String {
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

    /// Converts all keys and texts of the tree to Unicode normalization form C. Long runs of keyframes are left out because they contain
    /// no names.
    pub fn compose(&mut self) {
        match self {
            Self::Text(text) => compose_text(text),
            Self::List(items) => items.nodes_mut().iter_mut().for_each(Self::compose),
            Self::Map(entries) => {
                for (key, value) in entries {
                    compose_text(key);
                    value.compose();
                }
            }
            Self::Null | Self::Bool(_) | Self::Number(_) | Self::Tagged(_) => {}
        }
    }
}

/// Reads a whole file as one document.
///
/// # Errors
/// Returns a finding of kind [`Code::Syntax`] at the place where the text is no longer valid YAML.
pub fn parse(source: &Source) -> Result<Node, Finding> {
    let text = source.text.trim_start_matches(BYTE_ORDER_MARK);
    let says_nothing = |line: &str| ["", "---", "..."].contains(&line) || line.starts_with('#');
    if text.lines().all(|line| says_nothing(line.trim())) {
        return Err(empty(source));
    }
    if let Some(finding) = too_deep(source) {
        return Err(finding);
    }
    let condensed = rows::condense(text);
    let left = condensed.as_ref().map_or(text, |condensed| condensed.text.as_str());
    if let Some(finding) = aliases::check(source, left) {
        return Err(finding);
    }
    let root = condensed.and_then(|condensed| {
        let root = build(&condensed.text).ok()?;
        condensed.restore(root, aliases::ALIASED_MAX)
    });
    root.map_or_else(|| parse_whole(source), Ok)
}

/// Returns a finding if brackets are nested so deeply that the YAML library would take a long time to reject them.
pub fn too_deep(source: &Source) -> Option<Finding> {
    let text = nesting::too_deep(source.text.trim_start_matches(BYTE_ORDER_MARK))?;
    let refused = build(text).err()?;
    refused.is_nesting().then(|| refused.finding(source))
}

/// Returns a finding if [`parse`] refuses the text because of its nesting or its aliases. For readers that pass the text to the YAML library
/// themselves.
pub fn too_large(source: &Source) -> Option<Finding> {
    let found = too_deep(source);
    let is_aliased = || source.text.contains('*');
    found.or_else(|| {
        is_aliased().then(|| parse(source).err())?.filter(|finding| finding.code == Code::TooMuch)
    })
}

fn empty(source: &Source) -> Finding {
    let message =
        if source.text.contains('#') { "the file contains only comments" } else { "the file is empty" };
    let hint = "run `downbeat init first-show` to create a scenario, a fleet and a robot".to_owned();
    Finding::about_file(Code::Syntax, &source.name, message.to_owned(), "a YAML map", Some(hint))
}

/// Like [`parse`], but the YAML library parses the whole text, including long runs of keyframes. Brackets that are nested too deeply are
/// not detected first.
pub fn parse_whole(source: &Source) -> Result<Node, Finding> {
    let text = source.text.trim_start_matches(BYTE_ORDER_MARK);
    if let Some(finding) = aliases::check(source, text) {
        return Err(finding);
    }
    build(text).map_err(|refused| refused.finding(source))
}

/// The reason why no tree was built.
enum Refused {
    Syntax(serde_yaml::Error),
    Aliases,
}

impl Refused {
    fn is_nesting(&self) -> bool {
        matches!(self, Self::Syntax(error) if error.to_string().contains(RECURSION))
    }

    fn finding(&self, source: &Source) -> Finding {
        match self {
            Self::Syntax(error) => syntax_finding(source, error),
            Self::Aliases => aliases::exceeded(source, None),
        }
    }
}

/// Builds the tree of a text with the YAML library.
fn build(text: &str) -> Result<Node, Refused> {
    // `aliases::check` sees only the part that the stricter parser of events reads. Without aliases, two bytes make at most three values.
    let left = Cell::new(text.len().saturating_mul(2).saturating_add(aliases::ALIASED_MAX));
    let read = Value { left: &left }.deserialize(serde_yaml::Deserializer::from_str(text));
    read.map_err(|error| if left.get() == 0 { Refused::Aliases } else { Refused::Syntax(error) })
}

/// For formats without aliases, such as JSON: the number of values is not limited.
impl<'de> Deserialize<'de> for Node {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Value { left: &Cell::new(usize::MAX) }.deserialize(deserializer)
    }
}

/// A value that is read next. `left` is the number of values that may follow.
#[derive(Clone, Copy)]
struct Value<'l> {
    left: &'l Cell<usize>,
}

impl<'de> DeserializeSeed<'de> for Value<'_> {
    type Value = Node;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Node, D::Error> {
        self.left.set(self.left.get().saturating_sub(1));
        if self.left.get() == 0 {
            return Err(de::Error::custom("too many values"));
        }
        deserializer.deserialize_any(self)
    }
}

#[expect(clippy::cast_precision_loss, reason = "all numbers of the language are doubles")]
impl<'de> Visitor<'de> for Value<'_> {
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
        while let Some(node) = seq.next_element_seed(self)? {
            list.push(node);
        }
        Ok(Node::List(Items::Nodes(list)))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Node, A::Error> {
        let mut entries = Vec::new();
        while let Some(key) = map.next_key_seed(self)? {
            entries.push((key_text(key), map.next_value_seed(self)?));
        }
        Ok(Node::Map(entries))
    }

    fn visit_enum<A: EnumAccess<'de>>(self, data: A) -> Result<Node, A::Error> {
        let (tag, content) = data.variant::<String>()?;
        content.newtype_variant::<de::IgnoredAny>()?;
        Ok(Node::Tagged(tag))
    }
}

/// Converts a key of a map to text. A key that is not a scalar becomes a text that is not a valid key of any map.
fn key_text(key: Node) -> String {
    match key {
        Node::Text(text) => text,
        Node::Number(value) => value.to_string(),
        Node::Bool(value) => value.to_string(),
        Node::Null => "null".into(),
        // `{{ x }}`
        Node::Map(entries) if matches!(entries.as_slice(), [(_, Node::Null)]) => {
            format!("{{{}}}", entries[0].0)
        }
        other => other.kind(),
    }
}
