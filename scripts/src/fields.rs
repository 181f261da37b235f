//! Reading a tree key by key, collecting every finding on the way.

use crate::duration;
use crate::finding::{Code, Part, Pending, Place, did_you_mean, names};
use crate::node::{Node, shortened};
use urrcp::Span;

/// A node with the way that led to it.
#[derive(Clone, Copy)]
pub(crate) struct At<'a> {
    pub(crate) node: &'a Node,
    trail: Trail<'a>,
}

#[derive(Clone, Copy)]
enum Trail<'a> {
    Document,
    Key(&'a At<'a>, &'a str, usize),
    Index(&'a At<'a>, usize),
}

impl<'a> At<'a> {
    pub(crate) fn document(node: &'a Node) -> Self {
        Self { node, trail: Trail::Document }
    }

    pub(crate) fn item(&'a self, index: usize, node: &'a Node) -> At<'a> {
        At { node, trail: Trail::Index(self, index) }
    }

    pub(crate) fn entry(&'a self, key: &'a str, occurrence: usize, node: &'a Node) -> At<'a> {
        At { node, trail: Trail::Key(self, key, occurrence) }
    }

    /// The place of this node.
    pub(crate) fn place(&self) -> Place {
        Place { path: self.path(), key: false }
    }

    /// The place of the key that leads to it.
    pub(crate) fn key_place(&self) -> Place {
        Place { path: self.path(), key: true }
    }

    fn path(&self) -> Vec<Part> {
        match self.trail {
            Trail::Document => Vec::new(),
            Trail::Key(parent, key, occurrence) => {
                let mut path = parent.path();
                path.push(Part::Key(key.to_owned(), occurrence));
                path
            }
            Trail::Index(parent, index) => {
                let mut path = parent.path();
                path.push(Part::Index(index));
                path
            }
        }
    }
}

/// What has been found so far.
#[derive(Default)]
pub(crate) struct Findings(pub(crate) Vec<Pending>);

impl Findings {
    pub(crate) fn add(
        &mut self,
        code: Code,
        place: Place,
        message: impl Into<String>,
        expected: impl Into<String>,
        hint: Option<String>,
    ) {
        let (message, expected) = (message.into(), expected.into());
        self.0.push(Pending { code, place, message, expected, hint });
    }

    pub(crate) fn wrong_type(&mut self, at: &At<'_>, expected: &str) {
        let hint =
            matches!(at.node, Node::Tagged(_)).then(|| "remove the tag: no tags are supported".to_owned());
        self.add(Code::WrongType, at.place(), format!("found {}", at.node.kind()), expected, hint);
    }

    /// The value of each known key; findings for the others, for duplicates and for missing ones.
    pub(crate) fn map<'a, const N: usize>(
        &mut self,
        at: &'a At<'a>,
        what: &str,
        known: [&'static str; N],
        required: &[&str],
    ) -> Option<[Option<At<'a>>; N]> {
        let Node::Map(entries) = at.node else {
            self.wrong_type(at, &format!("{what}: a map with {}", names(known)));
            return None;
        };
        let mut values: [Option<At<'a>>; N] = [None; N];
        for (key, node) in entries {
            match known.iter().position(|name| name == key) {
                Some(index) if values[index].is_none() => values[index] = Some(at.entry(key, 0, node)),
                Some(index) => self.duplicate(&at.entry(known[index], 1, node), key),
                None => {
                    let hint = match key.as_str() {
                        "<<" => Some("merge keys are not supported: write the keys out".to_owned()),
                        _ => did_you_mean(key, known),
                    };
                    let message = format!("unknown key `{}` in {what}", shortened(key));
                    let place = at.entry(key, 0, node).key_place();
                    self.add(Code::UnknownKey, place, message, format!("one of {}", names(known)), hint);
                }
            }
        }
        for key in required {
            let index = known.iter().position(|name| name == key)?;
            if values[index].is_none() {
                let message = format!("{what} has no `{key}`");
                self.add(Code::MissingKey, at.place(), message, format!("a key `{key}`"), None);
            }
        }
        Some(values)
    }

    /// The entries of a map with free keys, each key once.
    pub(crate) fn entries<'a>(&mut self, at: &'a At<'a>, what: &str) -> Vec<(&'a str, At<'a>)> {
        let Node::Map(entries) = at.node else {
            self.wrong_type(at, &format!("a map from {what}"));
            return Vec::new();
        };
        let mut seen = std::collections::HashSet::new();
        let mut unique = Vec::with_capacity(entries.len());
        for (key, node) in entries {
            match seen.insert(key.as_str()) {
                true => unique.push((key.as_str(), at.entry(key, 0, node))),
                false => self.duplicate(&at.entry(key, 1, node), key),
            }
        }
        unique
    }

    fn duplicate(&mut self, at: &At<'_>, key: &str) {
        let hint = Some("keep one of them".to_owned());
        let message = format!("the key `{}` stands twice in this map", shortened(key));
        self.add(Code::DuplicateKey, at.key_place(), message, "each key once", hint);
    }

    pub(crate) fn list<'a>(&mut self, at: &'a At<'a>, expected: &str) -> Vec<At<'a>> {
        match at.node {
            Node::List(items) => items.iter().enumerate().map(|(i, node)| at.item(i, node)).collect(),
            _ => {
                self.wrong_type(at, expected);
                Vec::new()
            }
        }
    }

    pub(crate) fn text<'a>(&mut self, at: &At<'a>, expected: &str) -> Option<&'a str> {
        match at.node {
            Node::Text(text) => Some(text),
            _ => {
                self.wrong_type(at, expected);
                None
            }
        }
    }

    /// A name: text, or a number that someone uses as one.
    pub(crate) fn name(&mut self, at: &At<'_>, expected: &str) -> Option<String> {
        match at.node {
            Node::Number(value) => Some(value.to_string()),
            _ => self.text(at, expected).map(str::to_owned),
        }
    }

    pub(crate) fn number(&mut self, at: &At<'_>, expected: &str) -> Option<f64> {
        match at.node {
            Node::Number(value) if value.is_finite() => Some(*value),
            _ => {
                self.wrong_type(at, expected);
                None
            }
        }
    }

    pub(crate) fn duration(&mut self, at: &At<'_>) -> Option<Span> {
        self.parsed_duration(at, duration::parse_duration)
    }

    pub(crate) fn signed_duration(&mut self, at: &At<'_>) -> Option<Span> {
        self.parsed_duration(at, duration::parse_signed)
    }

    fn parsed_duration(&mut self, at: &At<'_>, parse: fn(&str) -> Option<Span>) -> Option<Span> {
        let (found, hint) = match at.node {
            Node::Text(text) => match parse(text) {
                Some(span) => return Some(span),
                None => (format!("the time `{}` cannot be read", shortened(text)), None),
            },
            Node::Number(value) => {
                let hint = format!("add the unit: `{value}s` or `{value}ms`");
                (format!("the time {value} has no unit"), Some(hint))
            }
            other => (format!("found {} where a time belongs", other.kind()), None),
        };
        self.add(Code::BadDuration, at.place(), found, duration::EXPECTED, hint);
        None
    }

    /// One of a few words.
    pub(crate) fn word<T: Copy>(&mut self, at: &At<'_>, words: &[(&'static str, T)]) -> Option<T> {
        let known = || words.iter().map(|(word, _)| *word);
        let text = self.text(at, &format!("one of {}", names(known())))?;
        if let Some((_, value)) = words.iter().find(|(word, _)| *word == text) {
            return Some(*value);
        }
        let message = format!("unknown word `{}`", shortened(text));
        let expected = format!("one of {}", names(known()));
        self.add(Code::UnknownWord, at.place(), message, expected, did_you_mean(text, known()));
        None
    }
}
