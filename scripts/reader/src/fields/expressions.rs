//! Evaluates the expressions in a document with the values of their variables. Reports errors at the characters that cause them.

#[cfg(test)]
mod tests;
mod tried;

use super::{At, Reader};
use crate::slips;
use downbeat_motion::exact::Exact;
use downbeat_motion::expression::{
    self, Amount, Expression, Fault, Formula, Known, Num, Quantity, Span, Unit, evaluate, fraction,
    names_variables, parse,
};
use downbeat_yaml::duration::{self, parse_duration};
use downbeat_yaml::finding::{Code, Place, Within, names};
use downbeat_yaml::node::Node;
use downbeat_yaml::shown::shortened;

pub use tried::tried;

/// Maximum length, in characters, of an expression whose variables are replaced by their values.
const WRITTEN_MAX: usize = 2_000;
/// Largest number of bars or beats that is converted to a time.
const BEATS_MAX: f64 = 1e9;
const NANOS_MAX: f64 = 1e20;

/// A robot of a cue, as `$index` and `$count` see it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Robot {
    /// The index of the robot in the cue, counted from 0.
    pub index: usize,
    /// The number of robots in the cue.
    pub count: usize,
}

/// The robot whose movement is being read, and the results that depend on this robot.
#[derive(Debug, Default)]
pub struct Robots {
    pub current: Option<Robot>,
    /// Whether `$index` or `$count` has been used for the current robot.
    pub asked: bool,
    /// The results of all expressions that used `$index` or `$count`, as bits. Robots with equal results share a movement.
    pub results: Vec<u64>,
}

/// The hint for `$index` or `$count` at a place where all robots share the value.
const ONE_ROBOT: &str =
    "use it where each robot can have its own value: tracks, parameters, scale, mirror, repeat";

struct Here<'r> {
    reader: &'r mut Reader,
    /// Whether the evaluated expression is itself the value of a variable. It cannot use further variables then.
    inner: bool,
}

impl Known for Here<'_> {
    fn variable(&mut self, name: &str, span: Span) -> Result<Quantity, Fault> {
        let value = if self.inner { None } else { self.reader.scope.get(name).cloned() };
        match (value, self.reader.robots.current) {
            (Some(node), _) => self.of_node(&node, name, span),
            (None, Some(robot)) if matches!(name, "index" | "count") => {
                self.reader.robots.asked = true;
                let number = if name == "index" { robot.index } else { robot.count };
                let number = Num::whole(i128::try_from(number).unwrap_or(i128::MAX));
                Ok(Quantity::Amount(Amount::of(number, Unit::PLAIN)))
            }
            (None, None) if matches!(name, "index" | "count") => {
                let message = format!("`${name}` differs between robots and is not supported here");
                Err(Fault::new(span, message, "a value that all robots share").hint(ONE_ROBOT))
            }
            (None, _) => Err(self.reader.unknown(name, span)),
        }
    }

    fn on_the_clock(&self, amount: &Amount, span: Span) -> Result<Num, Fault> {
        let length = self.reader.on_the_clock(amount, span)?;
        Ok(Num::fraction(length.nanos()))
    }
}

impl Here<'_> {
    fn of_node(&mut self, node: &Node, name: &str, span: Span) -> Result<Quantity, Fault> {
        let text = match node {
            Node::Number(value) if value.is_finite() => {
                return Ok(Quantity::Amount(Amount::of(Num::of(*value), Unit::PLAIN)));
            }
            Node::Bool(value) => return Ok(Quantity::Truth(*value)),
            Node::Text(text) => text,
            Node::Null => return Err(Fault::told(span)),
            _ => return Err(no_quantity(node, name, span)),
        };
        let known = |name: &str| matches!(name, "index" | "count");
        let Ok(expression) = parse(text, &known) else { return Err(no_quantity(node, name, span)) };
        if !self.reader.evaluations.take(expression.steps.len()) {
            return Err(too_many(span));
        }
        // Faults within the value are reported at the name.
        let mut inner = Here { reader: self.reader, inner: true };
        evaluate(&expression, &mut inner).map_err(|fault| Fault {
            span,
            message: format!("`${name}` is `{}`: {}", shortened(text), fault.message),
            ..fault
        })
    }
}

fn no_quantity(node: &Node, name: &str, span: Span) -> Fault {
    let message = format!("`${}` is {}", shortened(name), node.kind());
    Fault { code: Code::Variable, ..Fault::new(span, message, "a variable that is a number or a time") }
}

fn too_many(span: Span) -> Fault {
    let most = downbeat_yaml::budget::EVALUATIONS_MAX;
    let fault = Fault::new(span, "too many expressions", format!("at most {most} steps in total"));
    Fault { code: Code::TooMuch, ..fault.hint("split the scenario into several scenarios") }
}

impl Reader {
    fn unknown(&self, name: &str, span: Span) -> Fault {
        if self.later.contains(name) {
            let message = format!("the variable `{}` is used before it is defined", shortened(name));
            let fault = Fault::new(span, message, "a variable that is defined above");
            return Fault { code: Code::Variable, ..fault.hint_or(Some(self.move_up(name))) };
        }
        let known = || self.scope.names().chain(["index", "count"]);
        let message = format!("unknown variable `{}`", shortened(name));
        let expected = match self.scope.names().next() {
            Some(_) => format!("one of the variables {}", names(self.scope.names())),
            None => "a name under `variables`".to_owned(),
        };
        let hint = self.did_you_mean(name, known());
        Fault { code: Code::Variable, ..Fault::new(span, message, expected).hint_or(hint) }
    }

    fn on_the_clock(&self, amount: &Amount, span: Span) -> Result<Exact, Fault> {
        let [number, bars, beats] = [amount.number, amount.bars, amount.beats].map(Num::f64);
        if number.abs() > NANOS_MAX || bars.abs() > BEATS_MAX || beats.abs() > BEATS_MAX {
            let expected = format!("at most {}", downbeat_yaml::budget::longest());
            return Err(Fault::new(span, "the time is too long", expected));
        }
        let clock = Exact::of_nanos(amount.number.as_fraction());
        if !amount.is_musical() {
            return Ok(clock);
        }
        match self.music.length(amount.bars.as_fraction(), amount.beats.as_fraction()) {
            Ok(length) => Ok(clock.plus(length)),
            Err(why) => {
                let expected = "a `tempo`, and, if it changes, a cue with a fixed start";
                let fault = Fault::new(span, why.message("beats and bars"), expected).hint(why.hint());
                Err(Fault { code: Code::Music, ..fault })
            }
        }
    }

    fn parsed(&self, text: &str) -> Result<Expression, Fault> {
        let known = |name: &str| self.scope.get(name).is_some() || matches!(name, "index" | "count");
        parse(text, &known)
    }

    fn evaluated(&mut self, text: &str) -> Result<Quantity, Fault> {
        let expression = self.parsed(text)?;
        self.value_of(&expression)
    }

    fn value_of(&mut self, expression: &Expression) -> Result<Quantity, Fault> {
        if !self.evaluations.take(expression.steps.len()) {
            return Err(too_many((0, 1)));
        }
        let asked = std::mem::take(&mut self.robots.asked);
        let found = evaluate(expression, &mut Here { reader: self, inner: false });
        if self.robots.asked {
            let bits = match found {
                Ok(Quantity::Truth(truth)) => [u64::from(truth), 0, 0],
                Ok(Quantity::Amount(Amount { number, bars, beats, .. })) => {
                    [number, bars, beats].map(|part| part.f64().to_bits())
                }
                Err(_) => [u64::MAX; 3],
            };
            self.robots.results.extend(bits);
        }
        self.robots.asked |= asked;
        found
    }

    /// Evaluates the expression `text`, which is the node's text or a part of it.
    pub fn quantity(&mut self, at: &At<'_>, text: &str) -> Option<Quantity> {
        let text = text.trim();
        let told = self.evaluations.is_overdrawn();
        match self.evaluated(text) {
            Ok(value) => Some(value),
            Err(fault) => {
                if !(told && fault.code == Code::TooMuch) {
                    self.faulty(at, text, fault);
                }
                None
            }
        }
    }

    /// Whether the first and the last value of a spread have the same kind of unit. Adds a finding if they differ. True if either cannot
    /// be evaluated.
    pub fn is_alike(&mut self, to: &At<'_>, ends: [&str; 2]) -> bool {
        let unit = |value: Result<Quantity, Fault>| match value {
            Ok(Quantity::Amount(amount)) => Some(amount.unit),
            _ => None,
        };
        let [Some(from), Some(other)] = ends.map(|text| unit(self.evaluated(text))) else { return true };
        if from == other {
            return true;
        }
        let message = format!("a spread from {} to {}", from.name(), other.name());
        let hint = from.hint_of_two(other).map(str::to_owned);
        self.add(Code::Expression, to.place(), message, "two values of the same kind", hint);
        false
    }

    /// Adds a finding for a fault in `text`, a part of the node's text. The place is the faulty characters, or the whole node if it is
    /// not a text.
    fn faulty(&mut self, at: &At<'_>, text: &str, fault: Fault) {
        if fault.is_told() {
            return;
        }
        let Fault { span: (from, to), code, message, expected, hint } = fault;
        let place = match at.node {
            Node::Text(whole) => {
                let ahead = whole.find(text).map(|at| whole[..at].chars().count());
                let within = ahead.map(|ahead| Within {
                    text: whole.as_str().into(),
                    from: ahead + from,
                    width: to.saturating_sub(from).max(1),
                });
                Place { within, ..at.place() }
            }
            _ => at.place(),
        };
        self.add(code, place, message, expected, hint);
    }

    fn whole(text: &str) -> Span {
        (0, text.trim().chars().count())
    }

    fn wrong_quantity(&mut self, at: &At<'_>, text: &str, found: &str, expected: &str, hint: Option<&str>) {
        let message = format!("the result of the expression is {found}");
        let fault = Fault::new(Self::whole(text), message, expected).hint_or(hint.map(str::to_owned));
        self.faulty(at, text.trim(), fault);
    }

    /// Evaluates an expression as a plain number. An angle, such as `pi / 2`, is converted to radians.
    pub fn number_of(&mut self, at: &At<'_>, text: &str, expected: &str) -> Option<f64> {
        if slips::is_rate(text) {
            self.wrong_type(at, expected);
            return None;
        }
        let value = self.quantity(at, text)?;
        self.plain(at, text, value, expected, std::f64::consts::PI)
    }

    /// Reads an angle in degrees: a plain number, or an expression, in which `pi` stands for 180 degrees.
    pub fn degrees(&mut self, at: &At<'_>, expected: &str) -> Option<f64> {
        let node = self.scalar(at)?.into_owned();
        match &node {
            Node::Text(text) if expression::is_one(text) => {
                let value = self.quantity(at, text)?;
                self.plain(at, text, value, expected, 180.0)
            }
            _ => self.number(at, expected),
        }
    }

    fn plain(
        &mut self,
        at: &At<'_>,
        text: &str,
        value: Quantity,
        expected: &str,
        half_turn: f64,
    ) -> Option<f64> {
        let amount = match value {
            Quantity::Amount(amount) => amount,
            Quantity::Truth(truth) => {
                self.wrong_quantity(at, text, &format!("`{truth}`"), expected, None);
                return None;
            }
        };
        let Unit { time, angle, percent } = amount.unit;
        if time == 0 && !percent {
            let number = amount.number.f64() * half_turn.powi(i32::from(angle));
            if number.is_finite() {
                return Some(number);
            }
        }
        let hint = match amount.unit {
            Unit::PERCENT => Some(if expected.contains("factor") {
                format!("write `{}`", amount.number.f64())
            } else {
                "multiply the percentage by a value: `50% * 90`".to_owned()
            }),
            Unit::TIME => Some("divide the time by another time: `$a / 1s`".to_owned()),
            _ => None,
        };
        self.wrong_quantity(at, text, amount.unit.name(), expected, hint.as_deref());
        None
    }

    /// Evaluates a condition. Adds a finding and returns `None` if the result is neither true nor false.
    pub fn truth_of(&mut self, at: &At<'_>, text: &str) -> Option<bool> {
        match self.quantity(at, text)? {
            Quantity::Truth(truth) => Some(truth),
            Quantity::Amount(amount) => {
                let hint = Some("use a comparison: `$index % 2 == 1`");
                self.wrong_quantity(at, text, amount.unit.name(), "true or false", hint);
                None
            }
        }
    }

    /// Evaluates an expression as a duration that is not negative.
    pub fn time_of(&mut self, at: &At<'_>, text: &str) -> Option<Exact> {
        let amount = match self.quantity(at, text)? {
            Quantity::Amount(amount) if amount.unit == Unit::TIME => amount,
            Quantity::Amount(amount) => {
                let hint = match amount.unit {
                    Unit::PLAIN if duration::of_two_numbers(text).is_some() => duration::of_two_numbers(text),
                    Unit::PLAIN => Some("multiply by a time: `$index * 500ms`".to_owned()),
                    Unit::PERCENT => Some("multiply the percentage by a value: `50% * 8s`".to_owned()),
                    _ => duration::hint(text),
                };
                self.wrong_quantity(at, text, amount.unit.name(), duration::EXPECTED, hint.as_deref());
                return None;
            }
            Quantity::Truth(truth) => {
                self.wrong_quantity(at, text, &format!("`{truth}`"), duration::EXPECTED, None);
                return None;
            }
        };
        let length = match self.on_the_clock(&amount, Self::whole(text)) {
            Ok(length) => length,
            Err(fault) => {
                self.faulty(at, text.trim(), fault);
                return None;
            }
        };
        if length < Exact::ZERO {
            let span = length.rounded();
            let hint = duration::hint(text);
            let found = format!("the negative time {span}");
            self.wrong_quantity(at, text, &found, "a time of at least 0", hint.as_deref());
            return None;
        }
        self.no_longer(at, text, length)
    }

    /// Reads the value that a variable or a parameter is set to. An expression with variables is evaluated at once. If the result differs
    /// between robots or depends on the tempo, returns an expression whose only variables are `$index` and `$count`.
    pub fn defined(&mut self, at: &At<'_>) -> Option<Node> {
        if let Node::Text(text) = at.node
            && names_variables(text)
            && !self.is_variable(text)
        {
            return match self.definition(text.trim()) {
                Ok(node) => Some(node),
                Err(fault) => {
                    self.faulty(at, text.trim(), fault);
                    None
                }
            };
        }
        self.scalar(at).map(std::borrow::Cow::into_owned)
    }

    fn definition(&mut self, text: &str) -> Result<Node, Fault> {
        let expression = self.parsed(text)?;
        let differs = |name: &str| match self.scope.get(name) {
            Some(Node::Text(value)) => value.contains('$'),
            Some(_) => false,
            None => matches!(name, "index" | "count"),
        };
        if self.robots.current.is_none() && expression.variables().any(|(name, _)| differs(name)) {
            return self.put_in(text, &expression);
        }
        match self.value_of(&expression) {
            // The tempo may only be known later, or at the start of the cue.
            Err(fault) if fault.code == Code::Music => self.put_in(text, &expression),
            value => node_of(value?, Self::whole(text)),
        }
    }

    /// Returns the expression with its variables replaced by their values, except `$index` and `$count`.
    fn put_in(&self, text: &str, expression: &Expression) -> Result<Node, Fault> {
        let chars: Vec<char> = text.chars().collect();
        let (mut written, mut done) = (String::new(), 0);
        for (name, span) in expression.variables() {
            written.extend(&chars[done..span.0]);
            done = span.1;
            match self.scope.get(name) {
                Some(Node::Number(value)) if value.is_finite() => {
                    written.push_str(&fraction(Num::of(*value).as_fraction()));
                }
                Some(Node::Bool(value)) => written.push_str(&value.to_string()),
                Some(Node::Text(value)) => written.push_str(&format!("({value})")),
                Some(Node::Null) => return Err(Fault::told(span)),
                Some(node) => return Err(no_quantity(node, name, span)),
                None if matches!(name, "index" | "count") => written.extend(&chars[span.0..span.1]),
                None => return Err(self.unknown(name, span)),
            }
            if written.chars().count() > WRITTEN_MAX {
                let message = "the expression is too long once its variables are replaced by their values";
                return Err(Fault::new(span, message, format!("at most {WRITTEN_MAX} characters")));
            }
        }
        written.extend(&chars[done..]);
        Ok(Node::Text(written))
    }

    /// Reads a formula that depends on time, and replaces its variables by their values.
    pub fn formula(&mut self, at: &At<'_>) -> Option<Formula> {
        let text = match self.scalar(at)?.into_owned() {
            Node::Number(value) if value.is_finite() => value.to_string(),
            Node::Text(text) => text,
            _ => {
                self.wrong_type(at, "a formula such as \"90 * sin(360 * t / 8s)\"");
                return None;
            }
        };
        let text = text.trim();
        let made = self.parsed(text).and_then(|expression| {
            if !self.evaluations.take(expression.steps.len()) {
                return Err(too_many((0, 1)));
            }
            let asked = std::mem::take(&mut self.robots.asked);
            let formula = Formula::new(&expression, &mut Here { reader: self, inner: false });
            if let (true, Some(robot)) = (self.robots.asked, self.robots.current) {
                self.robots.results.push(robot.index as u64);
            }
            self.robots.asked |= asked;
            formula
        });
        match made {
            Ok(formula) => Some(formula),
            Err(fault) => {
                self.faulty(at, text, fault);
                None
            }
        }
    }
}

/// Converts a value to the node that a variable stores.
fn node_of(value: Quantity, span: Span) -> Result<Node, Fault> {
    let amount = match value {
        Quantity::Truth(truth) => return Ok(Node::Bool(truth)),
        Quantity::Amount(amount) => amount,
    };
    Ok(match amount.unit {
        Unit::PLAIN => {
            let double = amount.number.f64();
            if Num::of(double).compared(amount.number).is_eq() {
                Node::Number(double)
            } else {
                Node::Text(amount.written())
            }
        }
        Unit::TIME => {
            let written = amount.written();
            let short = match amount.number {
                Num::Exact(nanos) if !amount.is_musical() && nanos.is_integer() => {
                    i64::try_from(*nanos.numer()).ok().filter(|nanos| *nanos >= 0)
                }
                _ => None,
            };
            let short = short.map(|nanos| duration::written(urrcp::Span::from_nanos(nanos)));
            Node::Text(short.filter(|short| parse_duration(short).is_some()).unwrap_or(written))
        }
        Unit::PERCENT | Unit::ANGLE => Node::Text(amount.written()),
        unit => {
            let message = format!("the value of a variable is {}", unit.name());
            return Err(Fault::new(span, message, "a number, a time, an angle or a percentage"));
        }
    })
}
