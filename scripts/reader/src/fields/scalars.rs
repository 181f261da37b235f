//! Reads scalar values: numbers, times, words, truth values, and variables in place of them.

use std::borrow::Cow;
use std::sync::Arc;

use urrcp::Span;

use super::{At, Reader, is_spread};
use crate::slips;
use downbeat_motion::exact::{Exact, Laps};
use downbeat_motion::expression;
use downbeat_yaml::budget::longest;
use downbeat_yaml::duration;
use downbeat_yaml::finding::{Code, Place, names, one_of};
use downbeat_yaml::node::Node;
use downbeat_yaml::shown::shortened;

impl Reader {
    /// Returns the node, or the value of the variable if the node names one. Expressions are returned unchanged.
    pub fn scalar<'a>(&mut self, at: &At<'a>) -> Option<Cow<'a, Node>> {
        match at.node {
            Node::Text(text) if self.is_variable(text) => self.variable(at, text).map(Cow::Owned),
            node => Some(Cow::Borrowed(node)),
        }
    }

    /// Like [`Self::scalar`], but for places that do not allow expressions. There, any text that begins with `$` or `-$` is a variable.
    fn plain_scalar<'a>(&mut self, at: &At<'a>) -> Option<Cow<'a, Node>> {
        match at.node {
            Node::Text(text) if text.starts_with('$') || text.starts_with("-$") => {
                self.variable(at, text).map(Cow::Owned)
            }
            node => Some(Cow::Borrowed(node)),
        }
    }

    /// Whether a text is a single variable or its negative.
    pub fn is_variable(&self, text: &str) -> bool {
        let Some(name) = text.strip_prefix('$').or_else(|| text.strip_prefix("-$")) else { return false };
        let is_word = !name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || c == '_');
        match self.scope.get(name) {
            // The negative of a time is an expression.
            Some(Node::Text(value)) if text.starts_with('-') => {
                !expression::is_one(value) && duration::parse_duration(value).is_none()
            }
            Some(_) => true,
            None => is_word && !matches!(name, "index" | "count"),
        }
    }

    /// Returns the place that assigns the parameter that this node names. `None` unless the node names a parameter of a move or a
    /// sequence.
    pub fn given_at(&self, at: &At<'_>) -> Option<Arc<Place>> {
        let Node::Text(text) = at.node else { return None };
        self.scope.place(text.strip_prefix('$')?).cloned()
    }

    fn variable(&mut self, at: &At<'_>, text: &str) -> Option<Node> {
        let (negated, name) = match text.strip_prefix('-') {
            Some(rest) => (true, &rest[1..]),
            None => (false, &text[1..]),
        };
        match (self.scope.get(name), negated) {
            // The fault of its value has already been reported.
            (Some(Node::Null), _) => {}
            (Some(Node::Number(value)), true) => return Some(Node::Number(-value)),
            (Some(value), false) => return Some(value.clone()),
            (Some(_), true) => {
                let message =
                    format!("only numbers can have a minus sign, but `{}` is not a number", shortened(name));
                self.add(Code::Variable, at.place(), message, "a variable that is a number", None);
            }
            // The variables as a whole have already been reported.
            (None, _) if self.is_wrong("variables") => {}
            (None, _) if self.later.contains(name) => {
                let message = format!("the variable `{}` is used before it is defined", shortened(name));
                let hint = Some(self.move_up(name));
                self.add(Code::Variable, at.place(), message, "a variable that is defined above", hint);
            }
            (None, _) => {
                let (hint, expected) = match self.scope.names().next() {
                    Some(_) => (
                        self.did_you_mean(name, self.scope.names()),
                        format!("one of the variables {}", names(self.scope.names())),
                    ),
                    None => (
                        Some(format!("define it, as in `variables: {{{}: 45}}`", shortened(name))),
                        "a name under `variables`".to_owned(),
                    ),
                };
                let message = format!("unknown variable `{}`", shortened(name));
                self.add(Code::Variable, at.place(), message, expected, hint);
            }
        }
        None
    }

    /// Returns a hint for the variable `name`, which is used before or within its definition.
    pub fn move_up(&self, name: &str) -> String {
        format!(
            "define `{}` above the variables that use it, and use only numbers in it, or variables that are defined above it",
            shortened(name)
        )
    }

    /// Reads a text. Adds a finding if the node is anything else.
    pub fn text<'a>(&mut self, at: &At<'a>, expected: &str) -> Option<Cow<'a, str>> {
        match self.plain_scalar(at)? {
            Cow::Borrowed(Node::Text(text)) => Some(Cow::Borrowed(text)),
            Cow::Owned(Node::Text(text)) => Some(Cow::Owned(text)),
            _ => {
                self.wrong_type(at, expected);
                None
            }
        }
    }

    /// Reads a name: a text, or a number that is used as a name.
    pub fn name(&mut self, at: &At<'_>, expected: &str) -> Option<String> {
        match self.plain_scalar(at)?.as_ref() {
            Node::Number(value) => Some(value.to_string()),
            Node::Text(text) => Some(text.clone()),
            _ => {
                self.wrong_type(at, expected);
                None
            }
        }
    }

    /// Reads a number, or an expression that evaluates to one. Adds a finding if the node is anything else.
    pub fn number(&mut self, at: &At<'_>, expected: &str) -> Option<f64> {
        match self.scalar(at)?.as_ref() {
            Node::Number(value) if value.is_finite() => Some(*value),
            node if slips::template(node).is_some() => {
                self.wrong_value(at, node, expected);
                None
            }
            Node::Text(text) if expression::is_one(text) => self.number_of(at, text, expected),
            node if is_spread(node) => {
                let text = self.spread(at)?;
                self.number_of(at, &text, expected)
            }
            node => {
                self.wrong_value(at, node, expected);
                None
            }
        }
    }

    /// Reads a number above 0.
    pub fn positive(&mut self, at: &At<'_>, expected: &str) -> Option<f64> {
        let value = self.number(at, expected)?;
        if value > 0.0 {
            return Some(value);
        }
        let hint = slips::not_positive(expected, value);
        self.add(Code::WrongType, at.place(), format!("found the number {value}"), expected, hint);
        None
    }

    /// Reads a whole number from `least` to `most`.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked by the range")]
    pub fn count(&mut self, at: &At<'_>, least: u32, most: u32) -> Option<u32> {
        let expected = format!("a whole number from {least} to {most}");
        let value = self.number(at, &expected)?;
        if value.fract() == 0.0 && value >= f64::from(least) && value <= f64::from(most) {
            return Some(value as u32);
        }
        let hint = slips::times(&at.place(), value);
        self.add(Code::WrongType, at.place(), format!("found the number {value}"), expected, hint);
        None
    }

    /// Reads `true` or `false`, or an expression that evaluates to either. Adds a finding if the node is anything else.
    pub fn truth(&mut self, at: &At<'_>) -> Option<bool> {
        match self.scalar(at)?.as_ref() {
            Node::Bool(value) => Some(*value),
            Node::Text(text) if expression::is_one(text) => self.truth_of(at, text),
            _ => {
                self.wrong_type(at, "true or false");
                None
            }
        }
    }

    /// Reads a duration in a unit such as seconds, or in beats and bars. Beats and bars are counted from the start of the cue and
    /// converted to clock time.
    pub fn duration(&mut self, at: &At<'_>) -> Option<Span> {
        self.exact(at).map(|length| self.music.start.lay(length))
    }

    /// Like [`Self::duration`], but before rounding to nanoseconds.
    pub fn exact(&mut self, at: &At<'_>) -> Option<Exact> {
        if self.is_template(at, duration::EXPECTED) {
            return None;
        }
        let (found, hint) = match self.scalar(at)?.as_ref() {
            Node::Text(text) => return self.exact_time(at, text),
            Node::Number(value) => {
                let hint = format!("add the unit: `{value}s` or `{value}ms`");
                (format!("the time {value} has no unit"), Some(hint))
            }
            node if is_spread(node) => {
                let text = self.spread(at)?;
                return self.time_of(at, &text);
            }
            Node::Null => ("missing time".to_owned(), Some("write a time, such as `0s`".to_owned())),
            other => {
                (format!("found {} instead of a time", other.kind()), slips::one_time(&at.place(), other))
            }
        };
        self.add(Code::BadDuration, at.place(), found, duration::EXPECTED, hint);
        None
    }

    /// Returns consecutive laps (repetitions) of the given length, the first of which begins at the start of the cue.
    pub fn laps(&self, length: Exact) -> Laps {
        Laps { length, from: self.music.start }
    }

    /// Reads a duration from `text`, which is a part of the node's text.
    pub fn time(&mut self, at: &At<'_>, text: &str) -> Option<Span> {
        self.exact_time(at, text).map(|length| self.music.start.lay(length))
    }

    /// Like [`Self::time`], but before rounding to nanoseconds.
    pub fn exact_time(&mut self, at: &At<'_>, text: &str) -> Option<Exact> {
        let text = text.trim();
        if let Some(name) = text.strip_prefix('$').filter(|_| self.is_variable(text)) {
            let value = self.scope.get(name).cloned();
            return match value {
                Some(node @ (Node::Text(_) | Node::Number(_))) => self.exact(&at.with(&node)),
                _ => self.variable(at, text).and(None),
            };
        }
        if let Some(span) = duration::parse_duration(text) {
            return Some(span.into());
        }
        if let Some(what) = duration::instant(text) {
            let message = format!("`{}` is a {what}", shortened(text));
            let hint = Some(slips::instant(text));
            self.add(
                Code::BadDuration,
                at.place(),
                message,
                "a time since the start of the act or cue, such as 2s",
                hint,
            );
            return None;
        }
        match self.music.span(text) {
            Some(Ok(length)) => return self.no_longer(at, text, length),
            Some(Err(why)) => {
                let expected = "a `tempo`, and, if it changes, a cue with a fixed start";
                self.add(Code::Music, at.place(), why.message(text), expected, Some(why.hint().to_owned()));
            }
            None if expression::is_one(text) && !text.starts_with("-.") => return self.time_of(at, text),
            None => {
                let found = format!("invalid time `{}`", shortened(text));
                let is_number = text.parse::<f64>().is_ok_and(|value| value >= 0.0);
                let hint = match is_number {
                    true => Some(format!("add the unit: `{text}s` or `{text}ms`")),
                    false if self.scope.get(text).is_some() => {
                        Some(format!("write the variable as `${text}`"))
                    }
                    false => slips::time(&at.place(), text).or_else(|| duration::hint(text)),
                };
                self.add(Code::BadDuration, at.place(), found, duration::EXPECTED, hint);
            }
        }
        None
    }

    /// Returns `length`, or adds a finding and returns `None` if it exceeds the longest time that is supported. A time in beats or bars
    /// can exceed it.
    pub fn no_longer(&mut self, at: &At<'_>, text: &str, length: Exact) -> Option<Exact> {
        if length.rounded_down() <= longest() {
            return Some(length);
        }
        let message = format!("the time `{}` is too long", shortened(text));
        let hint = Some("use a shorter time, or a faster `tempo`".to_owned());
        self.add(Code::BadDuration, at.place(), message, format!("at most {}", longest()), hint);
        None
    }

    /// Reads a duration that may be negative.
    pub fn signed_duration(&mut self, at: &At<'_>) -> Option<Span> {
        if let Node::Text(text) = at.node
            && let Some(span) = duration::parse_signed(text)
        {
            return Some(span);
        }
        self.duration(at)
    }

    /// Reads one of the given words, and returns the value that belongs to it.
    pub fn word<T: Copy>(&mut self, at: &At<'_>, words: &[(&'static str, T)]) -> Option<T> {
        self.word_or(at, words, |_| None)
    }

    /// Like [`Self::word`], but `hint` may return a special hint for an unknown word.
    pub fn word_or<T: Copy>(
        &mut self,
        at: &At<'_>,
        words: &[(&'static str, T)],
        hint: impl FnOnce(&str) -> Option<String>,
    ) -> Option<T> {
        let known = || words.iter().map(|(word, _)| *word);
        crate::known::words(at, known());
        let text = self.text(at, &one_of(known()))?;
        if let Some((_, value)) = words.iter().find(|(word, _)| *word == text) {
            return Some(*value);
        }
        let message = format!("unknown word `{}`", shortened(&text));
        let expected = one_of(known());
        let hint =
            hint(&text).or_else(|| slips::word(&text, known())).or_else(|| self.did_you_mean(&text, known()));
        self.add(Code::UnknownWord, at.place(), message, expected, hint);
        None
    }
}
