//! Reads a run of keyframes from a text, byte by byte.

use urrcp::Span;

use super::{EASES, Rows, Width};
use crate::duration::parse_duration;

/// Maximum length of a number in a row, in bytes.
const NUMBER_BYTES_MAX: usize = 40;

/// The notation of the rows (keyframes) of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Style {
    /// Rows `{..}, {..}` within brackets.
    Brackets,
    /// One row `- {..}` per line. The number is the indentation of the dash in spaces.
    Lines(usize),
    /// Rows `- at: ..` with `to: ..` on the next line. The number is the indentation of the dash in spaces.
    Blocks(usize),
}

pub(super) struct Start {
    pub(super) from: usize,
    pub(super) style: Style,
}

/// Finds the next position, at byte `at` or later, at which a run may begin.
pub(super) fn next_start(text: &str, at: usize) -> Option<Start> {
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

/// Returns the indentation of a dash in spaces, if the last line of `ahead` consists only of spaces, the dash and one space.
fn indent_of_dash(ahead: &[u8]) -> Option<usize> {
    let spaces = ahead.strip_suffix(b"- ")?;
    let indent = spaces.iter().rev().take_while(|byte| **byte == b' ').count();
    matches!(spaces[..spaces.len() - indent].last(), None | Some(b'\n')).then_some(indent)
}

fn blank(bytes: &[u8]) -> bool {
    bytes.iter().all(|byte| *byte == b' ')
}

/// A run that is being read, from the first byte of its first row.
pub(super) struct Run<'t> {
    text: &'t str,
    at: usize,
    style: Style,
    pub(super) rows: Rows,
}

impl<'t> Run<'t> {
    pub(super) fn new(text: &'t str, start: &Start) -> Self {
        Self { text, at: start.from, style: start.style, rows: Rows::default() }
    }

    /// Reads as many rows as possible, and returns the byte offset after the last row.
    pub(super) fn read(&mut self) -> usize {
        let mut end = self.at;
        while self.row().is_some() {
            end = self.at;
            if self.next().is_none() {
                break;
            }
        }
        end
    }

    /// Advances to the beginning of the next row; `None` if the run ends here.
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
        // Rows with lists of values have no easing.
        let row = row.filter(|(_, ease)| ease.is_none() || self.rows.width == Width::One);
        let Some((at, ease)) = row else {
            self.rows.values.truncate(known.0);
            self.at = known.1;
            return None;
        };
        self.rows.push(at, ease);
        Some(())
    }

    /// Reads `{at: 1s, to: 2, ease: smooth}`, with the keys in any order and optional quotes around them.
    fn braces(&mut self) -> Option<(Span, Option<u8>)> {
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

    /// Reads a keyframe in block style: `at`, `to` and an optional `ease`, in this order and each on its own line.
    fn block(&mut self, indent: usize) -> Option<(Span, Option<u8>)> {
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
        let part =
            |byte: u8| byte.is_ascii_digit() || byte.is_ascii_lowercase() || matches!(byte, b'.' | b':');
        let text = self.take_while(part)?;
        let time = short_time(text).or_else(|| parse_duration(text))?;
        if quoted {
            self.byte(b'"')?;
        }
        Some(time)
    }

    /// Reads one number, or a list with as many numbers as in the previous rows.
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
        if self.rows.count() == 0 {
            self.rows.width = width;
        }
        (self.rows.width == width && width.count() <= urrcp::CONTROL_VALUES_MAX).then_some(())
    }

    fn number(&mut self) -> Option<f64> {
        let part = |byte: u8| byte.is_ascii_digit() || matches!(byte, b'-' | b'.' | b'e' | b'+');
        number(self.take_while(part)?)
    }

    fn easing(&mut self) -> Option<u8> {
        let quoted = self.peek() == Some(b'"');
        self.at += usize::from(quoted);
        let word = self.take_while(|byte| byte.is_ascii_lowercase())?;
        let easing = EASES.iter().position(|known| *known == word)?;
        if quoted {
            self.byte(b'"')?;
        }
        u8::try_from(easing).ok()
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

    /// Skips exactly `indent` spaces.
    fn indent(&mut self, indent: usize) -> Option<()> {
        let spaces = self.text.as_bytes().get(self.at..self.at + indent)?;
        blank(spaces).then(|| self.at += indent)
    }

    fn line_end(&mut self) -> Option<()> {
        let _carriage_return = self.byte(b'\r');
        self.byte(b'\n')
    }

    /// Reads bytes as long as `part` accepts them. `None` unless it accepts 1 to [`NUMBER_BYTES_MAX`] bytes.
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

/// Parses a whole number of milliseconds or seconds with at most 7 digits, such as `40ms`; `None` for any other text.
fn short_time(text: &str) -> Option<Span> {
    let (digits, nanos) = match text.strip_suffix("ms") {
        Some(digits) => (digits, 1_000_000),
        None => (text.strip_suffix('s')?, 1_000_000_000),
    };
    // A longer number could exceed the longest time.
    let short = (1..8).contains(&digits.len()) && digits.bytes().all(|byte| byte.is_ascii_digit());
    let value = || digits.bytes().fold(0, |value, digit| value * 10 + i64::from(digit - b'0'));
    short.then(|| Span::from_nanos(value() * nanos))
}

/// Parses a number; `None` unless all YAML parsers read it identically.
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
