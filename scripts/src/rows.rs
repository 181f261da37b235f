//! Long runs of plain keyframes, such as `- {at: 40ms, to: 12.5, ease: smooth}`, read without a tree of the YAML library, which
//! takes a kilobyte for each.
//!
//! Every run is cut out of the text and a marker put in its place. The library reads what is left. A run counts only if its
//! marker comes back as an item of a list: then the run stood where items stand, and not in a text or a comment. In all
//! other cases the whole text is read by the library alone, so that nothing is read otherwise than it would be by itself.

use std::ops::Deref;
use std::sync::{Arc, OnceLock};

use urrcp::Span;

use crate::duration::{parse_duration, written};
use crate::motion::Easing;
use crate::node::Node;

/// Shorter runs are left to the library.
const ROWS_MIN: usize = 8;
/// Stands around the number of a run; texts that contain it are left to the library.
const MARK: char = '\u{e000}';
/// Longest number of a row, in bytes.
const NUMBER_BYTES_MAX: usize = 40;

/// The items of a list. Those of a long run of keyframes become nodes only where they are looked at.
#[derive(Clone, Debug)]
pub(crate) enum Items {
    Nodes(Vec<Node>),
    Rows(Arc<Rows>),
}

impl Deref for Items {
    type Target = [Node];

    fn deref(&self) -> &[Node] {
        match self {
            Self::Nodes(nodes) => nodes,
            Self::Rows(rows) => {
                rows.nodes.get_or_init(|| (0..rows.len()).map(|row| rows.node(row)).collect())
            }
        }
    }
}

impl PartialEq for Items {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl<'a> IntoIterator for &'a Items {
    type Item = &'a Node;
    type IntoIter = std::slice::Iter<'a, Node>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

/// Keyframes of one device, each with as many values.
#[derive(Debug, Default)]
pub(crate) struct Rows {
    times: Vec<Span>,
    /// Those of each row one after another.
    values: Vec<f64>,
    width: Width,
    /// Of each row; empty if none has any.
    eases: Vec<Option<Easing>>,
    nodes: OnceLock<Vec<Node>>,
}

/// How the values of a row are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Width {
    #[default]
    One,
    /// A list of so many.
    List(usize),
}

impl Width {
    pub(crate) fn count(self) -> usize {
        match self {
            Self::One => 1,
            Self::List(count) => count,
        }
    }
}

/// One keyframe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row<'a> {
    pub(crate) at: Span,
    pub(crate) values: &'a [f64],
    pub(crate) ease: Option<Easing>,
}

impl Rows {
    pub(crate) fn len(&self) -> usize {
        self.times.len()
    }

    pub(crate) fn width(&self) -> Width {
        self.width
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = Row<'_>> {
        (0..self.len()).map(|row| self.row(row))
    }

    fn row(&self, row: usize) -> Row<'_> {
        let width = self.width.count();
        Row {
            at: self.times[row],
            values: &self.values[row * width..(row + 1) * width],
            ease: self.eases.get(row).copied().flatten(),
        }
    }

    fn node(&self, row: usize) -> Node {
        let Row { at, values, ease } = self.row(row);
        let number = |value: &f64| Node::Number(*value);
        let to = match self.width {
            Width::One => number(&values[0]),
            Width::List(_) => Node::List(Items::Nodes(values.iter().map(number).collect())),
        };
        let mut entries = vec![("at".to_owned(), Node::Text(written(at))), ("to".to_owned(), to)];
        let word = Easing::WORDS.iter().find(|(_, easing)| Some(*easing) == ease);
        entries.extend(word.map(|(word, _)| ("ease".to_owned(), Node::Text((*word).to_owned()))));
        Node::Map(entries)
    }

    fn push(&mut self, at: Span, ease: Option<Easing>) {
        if ease.is_some() || !self.eases.is_empty() {
            self.eases.resize(self.times.len(), None);
            self.eases.push(ease);
        }
        self.times.push(at);
    }

    fn shrink(&mut self) {
        self.times.shrink_to_fit();
        self.values.shrink_to_fit();
        self.eases.shrink_to_fit();
    }
}

/// A text without its runs, and the runs.
pub(crate) struct Condensed {
    pub(crate) text: String,
    runs: Vec<Arc<Rows>>,
}

/// Cuts the runs out; none if there is nothing to cut.
pub(crate) fn condense(text: &str) -> Option<Condensed> {
    if text.contains(MARK) {
        return None;
    }
    let mut condensed = Condensed { text: String::new(), runs: Vec::new() };
    let (mut at, mut kept) = (0, 0);
    while let Some(Start { from, style }) = next_start(text, at) {
        let mut run = Run { text, at: from, style, rows: Rows::default() };
        let end = run.read();
        if run.rows.len() < ROWS_MIN {
            at = from + 1;
            continue;
        }
        run.rows.shrink();
        condensed.text.push_str(&text[kept..from]);
        condensed.text.push_str(&format!("\"{MARK}{}{MARK}\"", condensed.runs.len()));
        condensed.runs.push(Arc::new(run.rows));
        (at, kept) = (end, end);
    }
    condensed.text.push_str(&text[kept..]);
    (!condensed.runs.is_empty()).then_some(condensed)
}

impl Condensed {
    /// Puts the runs into the tree of the text that is left. None if one of them did not stand where items stand, or aliases
    /// multiply them to more than so many values more than there are.
    pub(crate) fn restore(&self, mut root: Node, aliased_max: usize) -> Option<Node> {
        let mut used = vec![0; self.runs.len()];
        self.put_back(&mut root, &mut used)?;
        let again = |(run, used): (&Arc<Rows>, &usize)| run.len().saturating_mul(used.saturating_sub(1));
        let aliased = self.runs.iter().zip(&used).map(again).fold(0, usize::saturating_add);
        (!used.contains(&0) && aliased <= aliased_max).then_some(root)
    }

    fn put_back(&self, node: &mut Node, used: &mut [usize]) -> Option<()> {
        match node {
            Node::Text(text) | Node::Tagged(text) if text.contains(MARK) => None,
            Node::Map(entries) => entries.iter_mut().try_for_each(|(key, node)| {
                (!key.contains(MARK)).then_some(())?;
                self.put_back(node, used)
            }),
            Node::List(Items::Nodes(nodes)) => {
                if let [only] = nodes.as_slice()
                    && let Some(run) = self.run(only, used)
                {
                    *node = Node::List(Items::Rows(run));
                    return Some(());
                }
                self.put_back_among(nodes, used)
            }
            _ => Some(()),
        }
    }

    /// Of a list that has other items as well.
    fn put_back_among(&self, nodes: &mut Vec<Node>, used: &mut [usize]) -> Option<()> {
        if nodes.iter().any(|node| matches!(node, Node::Text(text) if text.contains(MARK))) {
            let mut all = Vec::with_capacity(nodes.len());
            for node in std::mem::take(nodes) {
                match self.run(&node, used) {
                    Some(run) => all.extend((0..run.len()).map(|row| run.node(row))),
                    None => all.push(node),
                }
            }
            *nodes = all;
        }
        nodes.iter_mut().try_for_each(|node| self.put_back(node, used))
    }

    fn run(&self, node: &Node, used: &mut [usize]) -> Option<Arc<Rows>> {
        let Node::Text(text) = node else { return None };
        let index: usize = text.strip_prefix(MARK)?.strip_suffix(MARK)?.parse().ok()?;
        *used.get_mut(index)? += 1;
        Some(self.runs.get(index)?.clone())
    }
}

/// How rows follow each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Style {
    /// `{..}, {..}` within a list in brackets.
    Brackets,
    /// `- {..}` a line, with so many spaces ahead.
    Lines(usize),
    /// `- at: ..` and `to: ..` in lines of their own.
    Blocks(usize),
}

struct Start {
    from: usize,
    style: Style,
}

/// Where a run may begin.
fn next_start(text: &str, at: usize) -> Option<Start> {
    let bytes = text.as_bytes();
    let mut from = at;
    loop {
        from += text.get(from..)?.find(['{', 'a'])?;
        match (bytes[from], indent_of_dash(&bytes[..from])) {
            (b'{', Some(indent)) => return Some(Start { from, style: Style::Lines(indent) }),
            (b'{', None) => return Some(Start { from, style: Style::Brackets }),
            (_, Some(indent)) if text[from..].starts_with("at: ") => {
                return Some(Start { from, style: Style::Blocks(indent) });
            }
            _ => from += 1,
        }
    }
}

/// How far a dash is indented that alone stands ahead in its line.
fn indent_of_dash(ahead: &[u8]) -> Option<usize> {
    let spaces = ahead.strip_suffix(b"- ")?;
    let indent = spaces.iter().rev().take_while(|byte| **byte == b' ').count();
    matches!(spaces[..spaces.len() - indent].last(), None | Some(b'\n')).then_some(indent)
}

fn blank(bytes: &[u8]) -> bool {
    bytes.iter().all(|byte| *byte == b' ')
}

/// A run that is being read, from the first byte of its first row on.
struct Run<'t> {
    text: &'t str,
    at: usize,
    style: Style,
    rows: Rows,
}

impl Run<'_> {
    /// Takes as many rows as there are; returns where the last one ends.
    fn read(&mut self) -> usize {
        let mut end = self.at;
        while self.row().is_some() {
            end = self.at;
            if self.next().is_none() {
                break;
            }
        }
        end
    }

    /// To the beginning of the next row.
    fn next(&mut self) -> Option<()> {
        match self.style {
            Style::Brackets => {
                self.spaces();
                self.byte(b',')?;
                while matches!(self.peek(), Some(b' ' | b'\n' | b'\r')) {
                    self.at += 1;
                }
                (self.peek() == Some(b'{')).then_some(())
            }
            Style::Lines(indent) | Style::Blocks(indent) => {
                self.line_end()?;
                self.indent(indent)?;
                self.byte(b'-')?;
                self.byte(b' ')
            }
        }
    }

    fn row(&mut self) -> Option<()> {
        let known = (self.rows.values.len(), self.at);
        let row = match self.style {
            Style::Blocks(indent) => self.block(indent + 2),
            Style::Brackets | Style::Lines(_) => self.braces(),
        };
        let row = row.filter(|_| match self.style {
            Style::Brackets => true,
            Style::Lines(_) | Style::Blocks(_) => matches!(self.peek(), None | Some(b'\n' | b'\r')),
        });
        // Lists of values have no easing.
        let row = row.filter(|(_, ease)| ease.is_none() || self.rows.width == Width::One);
        let Some((at, ease)) = row else {
            self.rows.values.truncate(known.0);
            self.at = known.1;
            return None;
        };
        self.rows.push(at, ease);
        Some(())
    }

    /// `{at: 1s, to: 2, ease: smooth}`, the keys also in quotes and in any order.
    fn braces(&mut self) -> Option<(Span, Option<Easing>)> {
        self.byte(b'{')?;
        let (mut at, mut to, mut ease) = (None, None, None);
        loop {
            self.spaces();
            match self.key()? {
                Key::At if at.is_none() => at = Some(self.time()?),
                Key::To if to.is_none() => to = Some(self.values()?),
                Key::Ease if ease.is_none() => ease = Some(self.easing()?),
                _ => return None,
            }
            self.spaces();
            match self.peek()? {
                b',' => self.at += 1,
                b'}' => {
                    self.at += 1;
                    return to.and(at).map(|at| (at, ease));
                }
                _ => return None,
            }
        }
    }

    /// The same in lines of their own, at and to first.
    fn block(&mut self, indent: usize) -> Option<(Span, Option<Easing>)> {
        self.word("at: ")?;
        let at = self.time()?;
        self.line_end()?;
        self.indent(indent)?;
        self.word("to: ")?;
        self.values()?;
        let end = self.at;
        let ease = self.line_end().and_then(|()| self.indent(indent)).and_then(|()| self.word("ease: "));
        if ease.is_none() {
            self.at = end;
            return Some((at, None));
        }
        Some((at, Some(self.easing()?)))
    }

    fn key(&mut self) -> Option<Key> {
        let quoted = self.peek() == Some(b'"');
        self.at += usize::from(quoted);
        let keys = [("at", Key::At), ("to", Key::To), ("ease", Key::Ease)];
        let key = keys.into_iter().find(|(word, _)| self.word(word).is_some()).map(|(_, key)| key)?;
        if quoted {
            self.byte(b'"')?;
        }
        self.byte(b':')?;
        if self.peek() != Some(b' ') && !quoted {
            return None;
        }
        self.spaces();
        Some(key)
    }

    fn time(&mut self) -> Option<Span> {
        let quoted = self.peek() == Some(b'"');
        self.at += usize::from(quoted);
        let part = |byte: u8| byte.is_ascii_digit() || byte.is_ascii_lowercase() || byte == b'.';
        let text = self.take_while(part)?;
        let time = short_time(text).or_else(|| parse_duration(text))?;
        if quoted {
            self.byte(b'"')?;
        }
        Some(time)
    }

    /// One number, or a list of as many as the rows before have.
    fn values(&mut self) -> Option<()> {
        let before = self.rows.values.len();
        let width = match self.peek()? {
            b'[' => {
                self.at += 1;
                loop {
                    self.spaces();
                    let value = self.number()?;
                    self.rows.values.push(value);
                    self.spaces();
                    match self.peek()? {
                        b',' => self.at += 1,
                        b']' => break,
                        _ => return None,
                    }
                }
                self.at += 1;
                Width::List(self.rows.values.len() - before)
            }
            _ => {
                let value = self.number()?;
                self.rows.values.push(value);
                Width::One
            }
        };
        if self.rows.len() == 0 {
            self.rows.width = width;
        }
        (self.rows.width == width && width.count() <= urrcp::CONTROL_VALUES_MAX).then_some(())
    }

    fn number(&mut self) -> Option<f64> {
        let part = |byte: u8| byte.is_ascii_digit() || matches!(byte, b'-' | b'.' | b'e' | b'+');
        number(self.take_while(part)?)
    }

    fn easing(&mut self) -> Option<Easing> {
        let quoted = self.peek() == Some(b'"');
        self.at += usize::from(quoted);
        let word = self.take_while(|byte| byte.is_ascii_lowercase())?;
        let easing = Easing::WORDS.iter().find(|(known, _)| *known == word)?.1;
        if quoted {
            self.byte(b'"')?;
        }
        Some(easing)
    }

    fn peek(&self) -> Option<u8> {
        self.text.as_bytes().get(self.at).copied()
    }

    fn byte(&mut self, byte: u8) -> Option<()> {
        let found = self.peek() == Some(byte);
        self.at += usize::from(found);
        found.then_some(())
    }

    fn word(&mut self, word: &str) -> Option<()> {
        let found = self.text.as_bytes()[self.at..].starts_with(word.as_bytes());
        self.at += if found { word.len() } else { 0 };
        found.then_some(())
    }

    fn spaces(&mut self) {
        while self.peek() == Some(b' ') {
            self.at += 1;
        }
    }

    /// Exactly so many spaces.
    fn indent(&mut self, indent: usize) -> Option<()> {
        let spaces = self.text.as_bytes().get(self.at..self.at + indent)?;
        blank(spaces).then(|| self.at += indent)
    }

    fn line_end(&mut self) -> Option<()> {
        let _carriage_return = self.byte(b'\r');
        self.byte(b'\n')
    }

    /// Some bytes, not none and not very many.
    fn take_while(&mut self, part: impl Fn(u8) -> bool) -> Option<&str> {
        let rest = &self.text.as_bytes()[self.at..];
        let length = rest.iter().take(NUMBER_BYTES_MAX + 1).take_while(|byte| part(**byte)).count();
        let begin = self.at;
        self.at += length;
        if (1..=NUMBER_BYTES_MAX).contains(&length) { self.text.get(begin..begin + length) } else { None }
    }
}

enum Key {
    At,
    To,
    Ease,
}

/// Whole milliseconds or seconds.
fn short_time(text: &str) -> Option<Span> {
    let (digits, nanos) = match text.strip_suffix("ms") {
        Some(digits) => (digits, 1_000_000),
        None => (text.strip_suffix('s')?, 1_000_000_000),
    };
    // Longer ones may be more than a time can be.
    let short = (1..8).contains(&digits.len()) && digits.bytes().all(|byte| byte.is_ascii_digit());
    let value = || digits.bytes().fold(0, |value, digit| value * 10 + i64::from(digit - b'0'));
    short.then(|| Span::from_nanos(value() * nanos))
}

/// A number that every reader of YAML takes for the same.
fn number(text: &str) -> Option<f64> {
    let digits = text.strip_prefix('-').unwrap_or(text);
    let whole = digits.bytes().take_while(u8::is_ascii_digit).count();
    let after = &digits[whole..];
    let no_zeros = whole == 1 || !digits.starts_with('0');
    let fraction = match after.strip_prefix('.') {
        Some(rest) => rest.starts_with(|c: char| c.is_ascii_digit()),
        None => true,
    };
    let usable = whole > 0 && no_zeros && fraction && text != "-0";
    text.parse().ok().filter(|value: &f64| usable && value.is_finite())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::node::{parse, parse_whole};
    use crate::source::Source;

    fn source(text: &str) -> Source {
        Source { name: "s.yaml".into(), text: text.to_owned() }
    }

    /// A time is told as the same time, not letter for letter.
    fn alike(node: &Node) -> Node {
        match node {
            Node::Text(text) => Node::Text(parse_duration(text).map_or_else(|| text.clone(), written)),
            Node::List(items) => Node::List(Items::Nodes(items.iter().map(alike).collect())),
            Node::Map(entries) => {
                let mut entries: Vec<_> =
                    entries.iter().map(|(key, node)| (key.clone(), alike(node))).collect();
                entries.sort_by(|a, b| a.0.cmp(&b.0));
                Node::Map(entries)
            }
            other => other.clone(),
        }
    }

    /// Reads it both ways; whether a run was found.
    #[track_caller]
    fn same(text: &str) -> bool {
        let source = source(text);
        let (ours, whole) = (parse(&source), parse_whole(&source));
        match (ours, whole) {
            (Ok(ours), Ok(whole)) => {
                assert_eq!(format!("{:?}", alike(&ours)), format!("{:?}", alike(&whole)), "{text}")
            }
            (ours, whole) => assert_eq!(ours.err(), whole.err(), "{text}"),
        }
        condense(text).is_some()
    }

    fn repeated(row: &str, between: &str) -> String {
        [row; 9].join(between)
    }

    #[test]
    fn runs_of_every_style_are_read_as_the_library_reads_them() {
        for row in [
            "{at: 1s, to: 2}",
            "{\"at\":\"40ms\",\"to\":-1.5e-3}",
            "{to: [1, 2.5 ,3], at: 1m30s}",
            "{to: 0, ease: step, at: 2m}",
        ] {
            assert!(same(&format!("a:\n  - {}\nb: 1\n", repeated(row, "\n  - "))));
            assert!(same(&format!("a:\r\n  - {}\r\n", repeated(row, "\r\n  - "))));
            assert!(same(&format!("a: [{}]\n", repeated(row, ", "))));
            assert!(same(&format!("{{\"a\": [\n  {}\n]}}", repeated(row, ",\n  "))));
            assert!(same(&format!("a: [x, {}, {{at: 3}}]\n", repeated(row, ", "))));
        }
        assert!(same(&format!("a:\n- {}\n", repeated("at: 1s\n  to: 2", "\n- "))));
        assert!(same(&format!("a:\n  - {}", repeated("at: 1.5s\n    to: 1\n    ease: smooth", "\n  - "))));
        assert!(same(&format!("a:\n  - {}", repeated("at: 1.5s\n    to: [1, 2]", "\n  - "))));
        assert!(!same(&format!("a: [{}]\n", repeated("{at: 1s, to: [1, 2], ease: step}", ", "))));
        assert!(same(&format!("a: &a [{}]\nb: *a\n", repeated("{at: 1s, to: 2}", ", "))));
    }

    #[test]
    fn what_only_looks_like_a_run_is_read_as_it_stands() {
        let rows = repeated("{at: 1s, to: 2}", ", ");
        let lines = repeated("- {at: 1s, to: 2}", "\n  ");
        for text in [
            format!("a: \"{rows}\"\n"),
            format!("a: '{rows}'\n"),
            format!("a: # {rows}\n  x\n"),
            format!("a: |\n  {lines}\n"),
            format!("a: >\n  {lines}\n"),
            format!("a: \"\n  {lines}\"\n"),
            format!("a: [{rows}\n"),
            format!("a: {{{rows}}}\n"),
            format!("a: x\n  {lines}\n"),
            format!("a:\n  {lines}\n   b: 1\n"),
            format!("a:\n  {lines}: 1\n"),
            format!("a:\n  {lines} # 1\n"),
            format!("a:\n- {}\n  fade: 1\n", repeated("at: 1s\n  to: 2", "\n- ")),
            format!("a: ? [{rows}]\n"),
            format!("a: !x [{rows}]\n"),
            format!("a: [{rows}]\n\u{e000}: 1\n"),
        ] {
            same(&text);
        }
    }

    #[test]
    fn a_single_long_line_takes_no_longer_than_many() {
        let text = format!("a: [{}]\n", "{at: 1s, to: x}, aaaaaaaa, ".repeat(200_000));
        assert!(condense(&text).is_none());
    }

    #[test]
    fn numbers_and_times_are_those_of_the_library() {
        for value in [
            "0",
            "-0",
            "-0.0",
            "007",
            "0.5",
            "1e5",
            "1e400",
            "1.",
            ".5",
            "+1",
            "1-2",
            "12345678901234567890",
            "0x1f",
            "1_0",
            "-",
            "1e",
            "e5",
        ] {
            same(&format!("a: [{}]\n", repeated(&format!("{{at: 1s, to: {value}}}"), ", ")));
        }
        for time in [
            "1",
            "1s",
            "01s",
            "1.5m",
            "999999999s",
            "99999999999ms",
            "100000000000ms",
            "1h2m3s4ms5us",
            "1e5s",
            "1S",
            "s",
            "1.5.5s",
        ] {
            same(&format!("a: [{}]\n", repeated(&format!("{{at: {time}, to: 1}}"), ", ")));
        }
    }

    fn row() -> impl Strategy<Value = String> {
        let at = prop_oneof![4 => (0u32..9_000).prop_map(|ms| format!("{ms}ms")), 1 => "[0-9.smh]{1,4}"];
        let to = prop_oneof![4 => (-9i32..9).prop_map(|v| format!("{}", f64::from(v) / 4.0)), 1 => "[-0-9.e]{1,4}"];
        (at, to, prop::bool::weighted(0.1)).prop_map(|(at, to, eased)| {
            format!("{{at: {at}, to: {to}{}}}", if eased { ", ease: cubic" } else { "" })
        })
    }

    proptest! {
        #[test]
        fn no_text_is_read_otherwise_than_by_the_library(
            rows in prop::collection::vec(row(), 8..30),
            block in any::<bool>(),
            cut in 0usize..400,
            drop in 0usize..3,
            insert in "[\\[\\]{}:,&*!|>'\"#%a-z0-9 \n-]{0,3}",
        ) {
            let text = match block {
                true => format!("x:\n  - {}\ny: 1\n", rows.join("\n  - ")),
                false => format!("x: [{}]\ny: 1\n", rows.join(", ")),
            };
            same(&text);
            let cut = cut.min(text.len());
            let end = (cut + drop).min(text.len());
            same(&format!("{}{insert}{}", &text[..cut], &text[end..]));
        }
    }
}
