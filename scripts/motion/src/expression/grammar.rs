//! The grammar of expressions: converts a text to steps in order of evaluation, each with the characters that it comes from.
//!
//! ```text
//! any        = all { "or" all }
//! all        = compared { "and" compared }
//! compared   = sum [ ("<" | "<=" | ">" | ">=" | "==" | "!=") sum ]
//! sum        = product { ("+" | "-") product }
//! product    = sign { ("*" | "/" | "%") sign }
//! sign       = "-" sign | "not" compared | primary
//! primary    = NUMBER | TIME | ANGLE | PERCENTAGE | LENGTH | "$" NAME | "t" | "pi" | "true" | "false"
//!            | FUNCTION "(" any { "," any } ")" | "(" any ")"
//! TIME       = "250ms" | "1m30s" | "00:01:30.5"        ANGLE = "1.5rad"        PERCENTAGE = "50%"
//! NUMBER     = "1.5" | "1e-3"
//! LENGTH     = NUMBER ("beat" | "beats" | "bar" | "bars") [NUMBER ("beat" | "beats")]
//! ```
//!
//! A variable's name is the longest known name at its position: `$a-b` is the variable `a-b` if it exists, otherwise `$a` minus `b`.
//! Recursion is limited to a fixed depth.

use super::number::Num;
use super::unit::Unit;
use super::{Amount, Fault};
use crate::exact::decimal;
use downbeat_yaml::duration::{self, parse_duration};
use downbeat_yaml::finding::did_you_mean;
use downbeat_yaml::render::counted;
use downbeat_yaml::shown::shortened;

/// Maximum length of an expression, in characters.
const LENGTH_MAX: usize = 2_000;
/// Maximum nesting depth of an expression.
const DEPTH_MAX: usize = 48;

/// A range of characters in a text: the index of the first one, and the index after the last one.
pub type Span = (usize, usize);

/// One step of an evaluation. It takes values of earlier steps from a stack, and pushes one value.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    Amount(Amount),
    Truth(bool),
    Variable(String),
    Time,
    Negate,
    Not,
    Two(Two),
    Call(Function, usize),
}

/// An operation on two values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Two {
    Plus,
    Minus,
    Times,
    Over,
    Modulo,
    Less,
    LessOrEqual,
    Greater,
    GreaterOrEqual,
    Equal,
    NotEqual,
    And,
    Or,
}

/// A named function with arguments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Function {
    Sin,
    Cos,
    Tan,
    Sqrt,
    Abs,
    Min,
    Max,
    Floor,
    Ceil,
    Round,
    Mod,
    Random,
    If,
}

/// All functions: the name, the function, and the minimum and maximum number of arguments.
pub const FUNCTIONS: [(&str, Function, usize, usize); 13] = [
    ("sin", Function::Sin, 1, 1),
    ("cos", Function::Cos, 1, 1),
    ("tan", Function::Tan, 1, 1),
    ("sqrt", Function::Sqrt, 1, 1),
    ("abs", Function::Abs, 1, 1),
    ("min", Function::Min, 1, 64),
    ("max", Function::Max, 1, 64),
    ("floor", Function::Floor, 1, 1),
    ("ceil", Function::Ceil, 1, 1),
    ("round", Function::Round, 1, 1),
    ("mod", Function::Mod, 2, 2),
    ("random", Function::Random, 1, 8),
    ("if", Function::If, 3, 3),
];
const WORDS: [&str; 7] = ["t", "pi", "true", "false", "and", "or", "not"];
const VALUE: &str = "a number, a time, a variable such as `$a`, a function, or an expression in brackets";

/// A parsed expression.
#[derive(Clone, Debug, PartialEq)]
pub struct Expression {
    /// The steps that evaluate the expression, each with the characters that it comes from.
    pub steps: Vec<(Step, Span)>,
}

impl Expression {
    /// The names of the variables that the expression uses, each with its range of characters in the text.
    pub fn variables(&self) -> impl Iterator<Item = (&str, Span)> {
        self.steps.iter().filter_map(|(step, span)| match step {
            Step::Variable(name) => Some((name.as_str(), *span)),
            _ => None,
        })
    }
}

/// Parses an expression; `known` returns whether a variable exists.
pub fn parse(text: &str, known: &dyn Fn(&str) -> bool) -> Result<Expression, Fault> {
    let chars: Vec<char> = text.chars().take(LENGTH_MAX + 1).collect();
    if chars.len() > LENGTH_MAX {
        let message = format!("the expression has more than {LENGTH_MAX} characters");
        return Err(Fault::new((0, 1), message, format!("at most {LENGTH_MAX}"))
            .hint("move parts of the expression to variables"));
    }
    let mut parser = Parser { chars, at: 0, depth: 0, known, steps: Vec::new() };
    parser.spaces();
    parser.any()?;
    match parser.peek() {
        None => Ok(Expression { steps: parser.steps }),
        Some(found) => Err(parser.left_over(found)),
    }
}

struct Parser<'k> {
    chars: Vec<char>,
    at: usize,
    depth: usize,
    known: &'k dyn Fn(&str) -> bool,
    steps: Vec<(Step, Span)>,
}

const COMPARISONS: [(&str, Two); 6] = [
    ("<=", Two::LessOrEqual),
    (">=", Two::GreaterOrEqual),
    ("==", Two::Equal),
    ("!=", Two::NotEqual),
    ("<", Two::Less),
    (">", Two::Greater),
];
/// Operators of other languages, each with a hint.
const ELSEWHERE: [(&str, &str); 9] = [
    ("+", "a value without a sign is positive: leave out the `+`"),
    ("&&", "write `and`"),
    ("||", "write `or`"),
    ("**", "powers are not supported: write `$a * $a`"),
    ("^", "powers are not supported: write `$a * $a`"),
    ("?", "to choose between two values, write `if($index < 3, 10, 20)`"),
    ("=", "to compare, write `==`"),
    ("!", "write `not`"),
    (";", "separate arguments with commas"),
];

impl Parser<'_> {
    fn peek(&self) -> Option<char> {
        self.chars.get(self.at).copied()
    }

    fn spaces(&mut self) {
        while self.peek().is_some_and(char::is_whitespace) {
            self.at += 1;
        }
    }

    fn starts_with(&self, word: &str) -> bool {
        word.chars().enumerate().all(|(index, c)| self.chars.get(self.at + index) == Some(&c))
    }

    /// Skips a sign and the spaces after it. Returns the characters of the sign; `None` if the text continues with something else.
    fn take(&mut self, sign: &str) -> Option<Span> {
        if !self.starts_with(sign) {
            return None;
        }
        let from = self.at;
        self.at += sign.chars().count();
        let span = (from, self.at);
        self.spaces();
        Some(span)
    }

    /// The word at the current position, without skipping it.
    fn word(&self) -> String {
        let part = |c: &&char| c.is_alphanumeric() || **c == '_';
        self.chars[self.at..].iter().take_while(part).collect()
    }

    fn take_word(&mut self, word: &str) -> Option<Span> {
        if self.word() == word { self.take(word) } else { None }
    }

    fn text(&self, span: Span) -> String {
        self.chars[span.0..span.1].iter().collect()
    }

    fn add(&mut self, step: Step, span: Span) {
        self.steps.push((step, span));
    }

    fn deeper(&mut self, read: impl FnOnce(&mut Self) -> Result<(), Fault>) -> Result<(), Fault> {
        self.depth += 1;
        if self.depth > DEPTH_MAX {
            let message = "the expression is nested too deeply";
            return Err(Fault::new(self.here(), message, format!("at most {DEPTH_MAX} levels"))
                .hint("move parts of the expression to variables"));
        }
        read(self)?;
        self.depth -= 1;
        Ok(())
    }

    fn here(&self) -> Span {
        if self.at < self.chars.len() {
            (self.at, self.at + 1)
        } else {
            // If the text ends early, points at the last character.
            (self.chars.len().saturating_sub(1), self.chars.len())
        }
    }

    fn any(&mut self) -> Result<(), Fault> {
        self.all()?;
        while let Some(span) = self.take_word("or") {
            self.all()?;
            self.add(Step::Two(Two::Or), span);
        }
        Ok(())
    }

    fn all(&mut self) -> Result<(), Fault> {
        self.compared()?;
        while let Some(span) = self.take_word("and") {
            self.compared()?;
            self.add(Step::Two(Two::And), span);
        }
        Ok(())
    }

    fn compared(&mut self) -> Result<(), Fault> {
        self.sum()?;
        let comparison =
            |parser: &mut Self| COMPARISONS.iter().find_map(|(sign, two)| Some((*two, parser.take(sign)?)));
        if let Some((two, span)) = comparison(self) {
            self.sum()?;
            self.add(Step::Two(two), span);
            if let Some((_, span)) = comparison(self) {
                let message = "two comparisons in a row";
                let hint = "write `0 < $a and $a < 3`";
                return Err(Fault::new(span, message, "`and` between them").hint(hint));
            }
        }
        Ok(())
    }

    fn sum(&mut self) -> Result<(), Fault> {
        self.product()?;
        loop {
            let (two, span) = match (self.take("+"), self.peek()) {
                (Some(span), _) => (Two::Plus, span),
                (None, Some('-')) => (Two::Minus, self.take("-").unwrap_or_default()),
                _ => return Ok(()),
            };
            self.product()?;
            self.add(Step::Two(two), span);
        }
    }

    fn product(&mut self) -> Result<(), Fault> {
        self.sign()?;
        loop {
            if self.starts_with("**") {
                return Ok(());
            }
            let signs = [("*", Two::Times), ("/", Two::Over), ("%", Two::Modulo)];
            let Some((two, span)) = signs.iter().find_map(|(sign, two)| Some((*two, self.take(sign)?)))
            else {
                return Ok(());
            };
            self.sign()?;
            self.add(Step::Two(two), span);
        }
    }

    fn sign(&mut self) -> Result<(), Fault> {
        if let Some(span) = self.take("-") {
            self.deeper(Self::sign)?;
            self.add(Step::Negate, span);
            return Ok(());
        }
        if let Some(span) = self.take_word("not") {
            self.deeper(Self::compared)?;
            self.add(Step::Not, span);
            return Ok(());
        }
        self.primary()
    }

    fn primary(&mut self) -> Result<(), Fault> {
        match self.peek() {
            Some('$') => self.variable(),
            Some('(') => {
                let open = self.take("(").unwrap_or_default();
                self.deeper(Self::any)?;
                self.closed(open)
            }
            Some(c) if c.is_ascii_digit() || c == '.' => self.number(),
            Some(c) if c.is_alphabetic() || c == '_' => self.named(),
            Some(',') => Err(Fault::new(self.here(), "unexpected comma", VALUE).hint_or(self.comma_hint())),
            Some(c) => {
                let found = ELSEWHERE.iter().find(|(sign, _)| self.starts_with(sign));
                let fault = Fault::new(self.here(), format!("unexpected `{c}`"), VALUE);
                Err(fault.hint_or(found.map(|(_, hint)| (*hint).to_owned())))
            }
            None => Err(Fault::new(self.here(), "unexpected end of the expression", VALUE)),
        }
    }

    fn closed(&mut self, open: Span) -> Result<(), Fault> {
        if self.take(")").is_some() {
            return Ok(());
        }
        match self.peek() {
            None => Err(Fault::new(open, "missing closing bracket", "a `)`")),
            Some(found) => Err(self.left_over(found)),
        }
    }

    /// The fault for a character that cannot follow a value.
    fn left_over(&self, found: char) -> Fault {
        let elsewhere = ELSEWHERE.iter().find(|(sign, _)| self.starts_with(sign));
        let hint = match (elsewhere, found) {
            (Some((_, hint)), _) => Some((*hint).to_owned()),
            (None, ',') => self.comma_hint(),
            (None, ')') => Some("this closing bracket has no matching opening bracket".to_owned()),
            (None, c) if c.is_ascii_digit() || matches!(c, '$' | '(') => {
                Some("to multiply, write `*` between the two values".to_owned())
            }
            _ => None,
        };
        let word = self.word();
        let (span, found) = if word.is_empty() {
            (self.here(), found.to_string())
        } else {
            ((self.at, self.at + word.chars().count()), shortened(&word))
        };
        Fault::new(
            span,
            format!("unexpected `{found}` after a value"),
            "an operator such as `+` or `*`, or the end of the expression",
        )
        .hint_or(hint)
    }

    /// Returns the hint to write a decimal point instead of a decimal comma, as in `1,5`. `None` if the comma is not between digits.
    fn comma_hint(&self) -> Option<String> {
        let digit = |c: &&char| c.is_ascii_digit();
        let after: String = self.chars.get(self.at + 1..)?.iter().take_while(digit).collect();
        let ahead: String = self.chars[..self.at].iter().rev().take_while(digit).collect();
        let ahead: String = ahead.chars().rev().collect();
        (!after.is_empty() && !ahead.is_empty()).then(|| format!("write a decimal point: `{ahead}.{after}`"))
    }

    fn variable(&mut self) -> Result<(), Fault> {
        let from = self.at;
        let part = |c: &&char| c.is_alphanumeric() || matches!(**c, '_' | '-');
        let longest: Vec<char> = self.chars[from + 1..].iter().take_while(part).copied().collect();
        let longest: String = longest.into_iter().collect();
        let cuts = longest.match_indices('-').map(|(at, _)| &longest[..at]).rev();
        let name = std::iter::once(longest.as_str()).chain(cuts).find(|name| (self.known)(name));
        let name = name.unwrap_or_else(|| longest.split('-').next().unwrap_or("")).to_owned();
        if name.is_empty() {
            return Err(Fault::new(
                (from, from + 1),
                "a `$` without a name",
                "the name of a variable, as in `$a`",
            ));
        }
        self.at = from + 1 + name.chars().count();
        let span = (from, self.at);
        self.spaces();
        self.add(Step::Variable(name), span);
        Ok(())
    }

    fn named(&mut self) -> Result<(), Fault> {
        let (word, from) = (self.word(), self.at);
        let span = (from, from + word.chars().count());
        self.at = span.1;
        self.spaces();
        let calls = self.peek() == Some('(');
        match word.as_str() {
            "t" if !calls => self.add(Step::Time, span),
            "pi" if !calls => self.add(Step::Amount(Amount::of(Num::ONE, Unit::ANGLE)), span),
            "true" | "false" if !calls => self.add(Step::Truth(word == "true"), span),
            "bar" if self.peek().is_some_and(|c| c.is_ascii_digit()) => {
                let message = "a position in the music instead of a length";
                return Err(Fault::new(span, message, VALUE).hint("write a length such as `3 beats`"));
            }
            _ => return self.call(&word, span, calls),
        }
        Ok(())
    }

    fn call(&mut self, word: &str, span: Span, calls: bool) -> Result<(), Fault> {
        let Some((_, function, least, most)) = FUNCTIONS.iter().find(|(name, ..)| *name == word).copied()
        else {
            return Err(self.unknown(word, span));
        };
        if !calls {
            let expected = format!("`{word}(...)`");
            return Err(Fault::new(span, format!("missing arguments for the function `{word}`"), expected));
        }
        let open = self.take("(").unwrap_or_default();
        let mut count = 0;
        loop {
            self.deeper(Self::any)?;
            count += 1;
            if self.take(",").is_none() {
                break;
            }
        }
        self.closed(open)?;
        if !(least..=most).contains(&count) {
            let expected = match (least, most) {
                (least, most) if least == most => counted(least, "argument"),
                _ => format!("{least} to {most} arguments"),
            };
            return Err(Fault::new(span, format!("`{word}` has {}", counted(count, "argument")), expected));
        }
        self.add(Step::Call(function, count), span);
        Ok(())
    }

    fn unknown(&self, word: &str, span: Span) -> Fault {
        let known = || FUNCTIONS.iter().map(|(name, ..)| *name).chain(WORDS);
        let hint = if (self.known)(word) || matches!(word, "index" | "count") {
            Some(format!("write the variable as `${word}`"))
        } else {
            did_you_mean(word, known()).or_else(|| {
            Some("variable names begin with `$`; names of cues are only valid under `after`, `with` and `before`".to_owned())
        })
        };
        let names: Vec<String> = FUNCTIONS.iter().map(|(name, ..)| format!("`{name}`")).collect();
        let expected = format!("a function ({}), `pi` or a variable such as `$a`", names.join(", "));
        Fault::new(span, format!("unknown name `{}`", shortened(word)), expected).hint_or(hint)
    }

    /// Reads a number with its suffix: `5`, `1m30s`, `00:01:30`, `1.5rad`, `50%`, `3 beats`, `1 bar 2 beats`.
    fn number(&mut self) -> Result<(), Fault> {
        let from = self.at;
        let glued = |c: &char| c.is_ascii_alphanumeric() || matches!(c, '.' | ':');
        while self.peek().as_ref().is_some_and(glued) {
            self.at += 1;
        }
        if self.has_signed_exponent(from) {
            self.at += 1;
            while self.peek().is_some_and(|c| c.is_ascii_alphanumeric()) {
                self.at += 1;
            }
        }
        let span = (from, self.at);
        let text = self.text(span);
        let amount = if let Some(number) = written(&text, span)? {
            if self.is_percentage() {
                self.at += 1;
                let part = number.over(Num::whole(100)).unwrap_or(Num::ZERO);
                Amount::of(part, Unit::PERCENT)
            } else {
                self.spaces();
                self.musical(number)?
            }
        } else if let Some(time) = parse_duration(&text) {
            Amount::of(Num::whole(i128::from(time.as_nanos())), Unit::TIME)
        } else if let Some(radians) = text.strip_suffix("rad").and_then(decimal) {
            let half_turns = Num::fraction(radians).f64() / std::f64::consts::PI;
            Amount::of(Num::Real(half_turns), Unit::ANGLE)
        } else {
            return Err(unreadable(&text, span));
        };
        let span = (from, self.at);
        self.spaces();
        self.add(Step::Amount(amount), (from, span.1));
        Ok(())
    }

    /// Whether the text from the index `from` to the current position is the `1e` of a number such as `1e-3`.
    fn has_signed_exponent(&self, from: usize) -> bool {
        let (digits, exponent) = self.chars[from..self.at].split_at(self.at - from - 1);
        let is_number = digits.iter().all(|c| c.is_ascii_digit() || *c == '.') && !digits.is_empty();
        let follows = |ahead: usize| self.chars.get(self.at + ahead).copied();
        is_number
            && matches!(exponent, ['e' | 'E'])
            && matches!(follows(0), Some('-' | '+'))
            && follows(1).is_some_and(|c| c.is_ascii_digit())
    }

    /// Whether a number is followed by a percent sign. If a divisor follows the `%`, it is an operator instead.
    fn is_percentage(&self) -> bool {
        if self.peek() != Some('%') {
            return false;
        }
        let next = self.chars[self.at + 1..].iter().find(|c| !c.is_whitespace());
        next.is_none_or(|c| !(c.is_alphanumeric() || matches!(c, '$' | '(' | '.')))
    }

    fn musical(&mut self, number: Num) -> Result<Amount, Fault> {
        let mut amount = Amount::of(number, Unit::PLAIN);
        let word = self.word();
        match word.as_str() {
            "beat" | "beats" => amount = Amount::musical(Num::ZERO, number),
            "bar" | "bars" => amount = Amount::musical(number, Num::ZERO),
            "" | "and" | "or" => return Ok(amount),
            _ => {
                let span = (self.at, self.at + word.chars().count());
                let together = format!("{}{word}", number.f64());
                let hint = duration::hint(&format!("{} {word}", number.f64()))
                    .or_else(|| parse_duration(&together).map(|_| format!("write `{together}`")));
                let message = format!("`{}` after a number", shortened(&word));
                let expected = "an operator such as `*`, or a number with a unit, such as `2s`";
                return Err(Fault::new(span, message, expected).hint_or(hint));
            }
        }
        let _ = self.take(&word);
        let beats = self.beats_after(word.starts_with("bar"));
        if let Some((beats, length)) = beats {
            amount = Amount::musical(number, beats);
            self.at += length;
        }
        Ok(amount)
    }

    /// Returns the beats that follow the bars in `1 bar 2 beats`, and the number of characters of that part. `None` if no beats follow.
    fn beats_after(&self, bar: bool) -> Option<(Num, usize)> {
        let rest: String = self.chars.get(self.at..).filter(|_| bar)?.iter().collect();
        let digits = rest.find(|c: char| !(c.is_ascii_digit() || c == '.'))?;
        let beats = decimal(&rest[..digits])?;
        let word = rest[digits..].trim_start();
        let blank = rest.len() - digits - word.len();
        let name = word.split(|c: char| !c.is_alphanumeric()).next()?;
        let known = blank > 0 && matches!(name, "beat" | "beats");
        known.then(|| (Num::fraction(beats), rest[..digits + blank + name.len()].chars().count()))
    }
}

/// Parses a number without a unit; the result is exact if the number is short. `None` if the text is not a number.
fn written(text: &str, span: Span) -> Result<Option<Num>, Fault> {
    if let Some(number) = decimal(text) {
        return Ok(Some(Num::fraction(number)));
    }
    let is_number = text.chars().all(|c| c.is_ascii_digit() || matches!(c, '.' | 'e' | 'E' | '-' | '+'));
    let Some(number) = text.parse::<f64>().ok().filter(|_| is_number) else { return Ok(None) };
    if number.is_finite() {
        Ok(Some(Num::of(number)))
    } else {
        Err(Fault::new(span, "the number is too large", "a number below 1e308"))
    }
}

fn unreadable(text: &str, span: Span) -> Fault {
    let number: String = text.chars().take_while(|c| c.is_ascii_digit() || *c == '.').collect();
    let hint = match &text[number.len()..] {
        "deg" => Some("write only the number, in the expected unit".to_owned()),
        factor @ ("pi" | "t") => Some(format!("to multiply, write `{number} * {factor}`")),
        _ => duration::hint(text),
    };
    let expected = "a number such as 1.5, or a time with its unit, such as 250ms, 2s or 00:01:30";
    Fault::new(span, format!("invalid value `{}`", shortened(text)), expected).hint_or(hint)
}
