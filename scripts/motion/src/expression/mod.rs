//! Expressions for numbers, times and truth values: `2 * $height`, `sin(360 * $index / $count)`, `8s / 4`.
//!
//! `grammar` parses them, `evaluate` computes their value, `number` keeps it exact, and `unit` defines the units that can be combined.
//! `formula` is an expression over time, and `pieces` cuts it at corners and jumps. `fields` reads expressions in documents.

mod evaluate;
mod formula;
mod grammar;
mod interval;
mod number;
mod pieces;
mod unit;

use crate::exact::Fraction;
use downbeat_yaml::finding::Code;

pub use evaluate::{Known, evaluate};
pub use formula::Formula;
pub use grammar::{Expression, FUNCTIONS, Span, parse};
pub use number::Num;
pub use pieces::{Piece, Trouble, pieces, seconds_of};
pub use unit::Unit;

/// Divisor that splits long numbers into parts that the parser accepts.
const DIGITS: i128 = 10i128.pow(17);

/// The value of an expression.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Quantity {
    /// A truth value.
    Truth(bool),
    /// A number with its unit.
    Amount(Amount),
}

/// A number with its unit. Times are in nanoseconds, angles in half turns, and percentages are fractions of one. A time may also have
/// bars and beats.
#[derive(Clone, Copy, Debug)]
pub struct Amount {
    /// The number, without the bars and beats of a musical time.
    pub number: Num,
    /// The number of bars of a musical time.
    pub bars: Num,
    /// The number of beats of a musical time.
    pub beats: Num,
    /// The unit of the amount.
    pub unit: Unit,
}

impl PartialEq for Amount {
    fn eq(&self, other: &Self) -> bool {
        let equal = |a: Num, b: Num| a.compared(b).is_eq();
        self.unit == other.unit
            && equal(self.number, other.number)
            && equal(self.bars, other.bars)
            && equal(self.beats, other.beats)
    }
}

impl Amount {
    /// An amount in a unit, without bars and beats.
    pub const fn of(number: Num, unit: Unit) -> Self {
        Self { number, bars: Num::ZERO, beats: Num::ZERO, unit }
    }

    /// A length in bars and beats.
    pub const fn musical(bars: Num, beats: Num) -> Self {
        Self { number: Num::ZERO, bars, beats, unit: Unit::TIME }
    }

    /// Whether the amount has bars or beats.
    pub fn is_musical(&self) -> bool {
        !self.bars.is_zero() || !self.beats.is_zero()
    }

    /// Applies a change to the number, the bars and the beats.
    fn each(&self, change: impl Fn(Num) -> Num) -> Self {
        Self { number: change(self.number), bars: change(self.bars), beats: change(self.beats), ..*self }
    }

    /// The text of an expression that evaluates to this amount.
    pub fn written(&self) -> String {
        match self.unit {
            Unit::TIME => {}
            Unit::PERCENT => return format!("{} * 100%", fraction(self.number.as_fraction())),
            Unit::ANGLE => return format!("{} * pi", fraction(self.number.as_fraction())),
            _ => return fraction(self.number.as_fraction()),
        }
        let mut parts = Vec::new();
        if !self.number.is_zero() || !self.is_musical() {
            parts.push(format!("1us * {}", fraction(self.number.as_fraction() / 1_000)));
        }
        for (number, unit) in [(self.bars, "bar"), (self.beats, "beat")] {
            if !number.is_zero() {
                parts.push(format!("1 {unit} * {}", fraction(number.as_fraction())));
            }
        }
        parts.join(" + ")
    }
}

/// The text of an expression that evaluates to exactly this fraction.
pub fn fraction(value: Fraction) -> String {
    let (sign, size) = if *value.numer() < 0 { ("0 - ", -value) } else { ("", value) };
    if size.is_integer() {
        format!("({sign}{})", whole(*size.numer()))
    } else {
        format!("({sign}{} / {})", whole(*size.numer()), whole(*size.denom()))
    }
}

/// The text of an expression for a whole number, which may have more digits than the parser accepts in one number.
fn whole(value: i128) -> String {
    match (value / DIGITS, value % DIGITS) {
        (0, rest) => rest.to_string(),
        (more, rest) => format!("({more} * {DIGITS} + {rest})"),
    }
}

/// A fault in an expression, with the characters that it concerns.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// The characters that the fault concerns.
    pub span: Span,
    /// The kind of the finding.
    pub code: Code,
    /// The message that describes the fault.
    pub message: String,
    /// The expected value or form.
    pub expected: String,
    /// How to fix the fault; `None` if there is no hint.
    pub hint: Option<String>,
}

impl Fault {
    /// A fault with the code for expressions, without a hint.
    pub fn new(span: Span, message: impl Into<String>, expected: impl Into<String>) -> Self {
        Self { span, code: Code::Expression, message: message.into(), expected: expected.into(), hint: None }
    }

    /// A fault that has already been reported elsewhere.
    pub fn told(span: Span) -> Self {
        Self::new(span, "", "")
    }

    /// Whether the fault has been reported elsewhere.
    pub fn is_told(&self) -> bool {
        self.message.is_empty()
    }

    /// Sets the hint.
    pub fn hint(self, hint: impl Into<String>) -> Self {
        Self { hint: Some(hint.into()), ..self }
    }

    /// Sets the hint, or removes it if `hint` is `None`.
    pub fn hint_or(self, hint: Option<String>) -> Self {
        Self { hint, ..self }
    }
}

/// Whether a text is meant as an expression, where a number, a time or a truth value is expected: it contains a variable, an operator or
/// a bracket, or is a constant.
pub fn is_one(text: &str) -> bool {
    let text = text.trim();
    let begins = text.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '$' | '(' | '-' | '.'));
    let minus = text.get(1..).is_some_and(|rest| rest.contains('-'));
    text.contains(['$', '(', '+', '*', '/', '%', '<', '>', '='])
        || text.contains(" - ")
        || (begins && minus)
        || matches!(text, "pi" | "-pi" | "true" | "false")
        || text.starts_with("not ")
}

/// Whether the value of a variable or a parameter is an expression that must be evaluated at once, because it uses other variables. A
/// text that merely contains a `$` is a plain text.
pub fn names_variables(text: &str) -> bool {
    let text = text.trim();
    let names = text
        .match_indices('$')
        .any(|(at, _)| text[at + 1..].starts_with(|c: char| c.is_alphabetic() || c == '_'));
    let word: String = text.chars().take_while(|c| c.is_alphanumeric()).collect();
    let begins = text.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '$' | '(' | '-' | '.'))
        || (text[word.len()..].starts_with('(') && FUNCTIONS.iter().any(|(name, ..)| *name == word))
        || matches!(word.as_str(), "pi" | "not");
    names && begins
}
