//! An expression over time that yields a double for every `t`. Its units are checked once, when the formula is created.

use std::f64::consts::PI;
use std::sync::Arc;

use super::evaluate::{Known, angle_only, common_unit, plain_only, product, quotient, same_unit};
use super::grammar::{Expression, Function, Span, Step, Two};
use super::unit::Unit;
use super::{Amount, Fault, Quantity};
use crate::chance::share;

/// A formula whose variable is the time in seconds since the start of its track.
#[derive(Clone, Debug, PartialEq)]
pub struct Formula {
    pub(super) steps: Arc<[Operation]>,
}

/// An operation on a stack of doubles. Truth values are 0 and 1; angles are in degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Operation {
    Constant(f64),
    Time,
    Negate,
    Not,
    Two(Two),
    Call(Function),
    /// A random number that depends on this number of arguments.
    Random(usize),
}

/// The kind of an intermediate value: a truth value, or a number in a unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ValueKind {
    Truth,
    In(Unit),
}

impl ValueKind {
    const fn name(self) -> &'static str {
        match self {
            Self::Truth => "a truth value",
            Self::In(unit) => unit.name(),
        }
    }
}

impl Formula {
    /// Whether the formula uses random numbers.
    pub fn is_random(&self) -> bool {
        self.steps.iter().any(|step| matches!(step, Operation::Random(_)))
    }

    /// Compiles an expression and replaces its variables by their values.
    pub fn new(expression: &Expression, known: &mut dyn Known) -> Result<Self, Fault> {
        let mut maker = Maker { steps: Vec::with_capacity(expression.steps.len() + 1), kinds: Vec::new() };
        for (step, span) in &expression.steps {
            match step {
                Step::Amount(amount) => maker.amount(amount, *span, known)?,
                Step::Truth(truth) => {
                    maker.put(Operation::Constant(f64::from(u8::from(*truth))), ValueKind::Truth)
                }
                Step::Variable(name) => match known.variable(name, *span)? {
                    Quantity::Truth(truth) => {
                        maker.put(Operation::Constant(f64::from(u8::from(truth))), ValueKind::Truth);
                    }
                    Quantity::Amount(amount) => maker.amount(&amount, *span, known)?,
                },
                Step::Time => maker.put(Operation::Time, ValueKind::In(Unit::TIME)),
                Step::Negate => {
                    let unit = maker.number(*span)?;
                    maker.put(Operation::Negate, ValueKind::In(unit));
                }
                Step::Not => {
                    maker.truth(*span)?;
                    maker.put(Operation::Not, ValueKind::Truth);
                }
                Step::Two(two) => maker.two(*two, *span)?,
                Step::Call(function, count) => maker.call(*function, *count, *span)?,
            }
        }
        let span = expression.steps.last().map_or((0, 1), |(_, span)| *span);
        let unit = maker.number(span)?;
        if unit.time != 0 || unit.percent {
            let message = format!("the result of the formula is {}", unit.name());
            let hint = (unit == Unit::TIME).then(|| "divide by a time: `10 * t / 1s`".to_owned());
            return Err(Fault::new(span, message, "a number in the device's unit").hint_or(hint));
        }
        // An angle that is used as a number is in radians.
        if unit.angle != 0 {
            maker.steps.push(Operation::Constant(PI.powi(i32::from(unit.angle))));
            maker.steps.push(Operation::Two(Two::Times));
        }
        Ok(Self { steps: maker.steps.into() })
    }

    /// Returns the value of the formula `seconds` after the start of its track; NaN if the formula has no value there.
    pub fn at(&self, seconds: f64) -> f64 {
        let mut stack: Vec<f64> = Vec::with_capacity(8);
        for step in self.steps.iter() {
            let mut pop = || stack.pop().unwrap_or(f64::NAN);
            let value = match step {
                Operation::Constant(value) => *value,
                Operation::Time => seconds,
                Operation::Negate => -pop(),
                Operation::Not => 1.0 - pop(),
                Operation::Two(two) => {
                    let (b, a) = (pop(), pop());
                    of_two(*two, a, b)
                }
                Operation::Call(Function::If) => {
                    let (no, yes, condition) = (pop(), pop(), pop());
                    if condition == 0.0 { no } else { yes }
                }
                Operation::Call(function @ (Function::Min | Function::Max | Function::Mod)) => {
                    let (b, a) = (pop(), pop());
                    match function {
                        Function::Min if a.is_nan() || b.is_nan() => f64::NAN,
                        Function::Min => a.min(b),
                        Function::Max if a.is_nan() || b.is_nan() => f64::NAN,
                        Function::Max => a.max(b),
                        _ => of_two(Two::Modulo, a, b),
                    }
                }
                Operation::Call(function) => of_one(*function, pop()),
                Operation::Random(count) => {
                    let mut from: Vec<f64> = (0..*count).map(|_| pop()).collect();
                    from.reverse();
                    random(&from)
                }
            };
            stack.push(value);
        }
        stack.pop().unwrap_or(f64::NAN)
    }

    /// All data that determines the formula's values, as a key for caches.
    pub fn key(&self) -> impl Iterator<Item = u64> {
        self.steps.iter().flat_map(|step| match *step {
            Operation::Constant(value) => [0, value.to_bits()],
            Operation::Time => [1, 0],
            Operation::Negate => [2, 0],
            Operation::Not => [3, 0],
            Operation::Two(two) => [4, two as u64],
            Operation::Call(function) => [5, function as u64],
            Operation::Random(count) => [6, count as u64],
        })
    }

    /// The number of operations that one evaluation takes.
    pub fn steps(&self) -> usize {
        self.steps.len()
    }
}

pub(super) fn of_two(two: Two, a: f64, b: f64) -> f64 {
    let truth = |truth: bool| f64::from(u8::from(truth));
    match two {
        Two::Plus => a + b,
        Two::Minus => a - b,
        Two::Times => a * b,
        Two::Over => a / b,
        // This must be the calculation that `interval` uses, so that both jump at the same nanosecond.
        Two::Modulo => a - b * (a * (1.0 / b)).floor(),
        Two::Less => truth(a < b),
        Two::LessOrEqual => truth(a <= b),
        Two::Greater => truth(a > b),
        Two::GreaterOrEqual => truth(a >= b),
        Two::Equal => truth(a == b),
        Two::NotEqual => truth(a != b),
        Two::And => truth(a != 0.0 && b != 0.0),
        Two::Or => truth(a != 0.0 || b != 0.0),
    }
}

pub(super) fn of_one(function: Function, value: f64) -> f64 {
    match function {
        Function::Sin => sine(value),
        Function::Cos => sine(value + 90.0),
        Function::Tan => sine(value) / sine(value + 90.0),
        Function::Sqrt => value.sqrt(),
        Function::Abs => value.abs(),
        Function::Floor => value.floor(),
        Function::Ceil => value.ceil(),
        Function::Round => value.round(),
        Function::Min | Function::Max | Function::Mod | Function::Random | Function::If => value,
    }
}

/// A random number from 0 to below 1 that depends on the arguments; NaN if an argument is not finite.
#[expect(clippy::cast_precision_loss, reason = "53 bits")]
pub(super) fn random(from: &[f64]) -> f64 {
    let (part, whole) = share(from);
    if from.iter().all(|number| number.is_finite()) { part as f64 / whole as f64 } else { f64::NAN }
}

/// The sine of an angle in degrees.
pub(super) fn sine(degrees: f64) -> f64 {
    degrees.rem_euclid(360.0).to_radians().sin()
}

struct Maker {
    steps: Vec<Operation>,
    kinds: Vec<ValueKind>,
}

impl Maker {
    fn put(&mut self, step: Operation, kind: ValueKind) {
        self.steps.push(step);
        self.kinds.push(kind);
    }

    /// Pushes an amount as a constant; times are converted to seconds.
    fn amount(&mut self, amount: &Amount, span: Span, known: &dyn Known) -> Result<(), Fault> {
        let number =
            if amount.is_musical() { known.on_the_clock(amount, span)?.f64() } else { amount.number.f64() };
        let value = number * 1e-9f64.powi(i32::from(amount.unit.time));
        self.put(Operation::Constant(value), ValueKind::In(amount.unit));
        Ok(())
    }

    fn number(&mut self, span: Span) -> Result<Unit, Fault> {
        match self.kinds.pop() {
            Some(ValueKind::In(unit)) => Ok(unit),
            _ => Err(Fault::new(span, "true or false instead of a number", "a number or a time")
                .hint("use it as a condition: `if(t < 3s, 10, 20)`")),
        }
    }

    fn truth(&mut self, span: Span) -> Result<(), Fault> {
        match self.kinds.pop() {
            Some(ValueKind::In(unit)) => {
                let message = format!("{} instead of true or false", unit.name());
                Err(Fault::new(span, message, "a comparison such as `t < 3s`"))
            }
            _ => Ok(()),
        }
    }

    fn two(&mut self, two: Two, span: Span) -> Result<(), Fault> {
        let kind = match two {
            Two::And | Two::Or => {
                self.truth(span)?;
                self.truth(span)?;
                ValueKind::Truth
            }
            Two::Equal | Two::NotEqual if self.kinds.last() == Some(&ValueKind::Truth) => {
                self.truth(span)?;
                self.truth(span)?;
                ValueKind::Truth
            }
            _ => {
                let (b, a) = (self.number(span)?, self.number(span)?);
                match two {
                    Two::Times => ValueKind::In(product(a, b, span)?),
                    Two::Over => ValueKind::In(quotient(a, b, span)?),
                    Two::Plus | Two::Minus | Two::Modulo => ValueKind::In(same_unit(two, a, b, span)?),
                    _ => {
                        same_unit(two, a, b, span)?;
                        ValueKind::Truth
                    }
                }
            }
        };
        self.put(Operation::Two(two), kind);
        Ok(())
    }

    fn call(&mut self, function: Function, count: usize, span: Span) -> Result<(), Fault> {
        let name = function.name();
        match function {
            Function::Sin | Function::Cos | Function::Tan => {
                let unit = self.number(span)?;
                angle_only(name, unit, span)?;
                if unit == Unit::ANGLE {
                    self.steps.push(Operation::Constant(180.0));
                    self.steps.push(Operation::Two(Two::Times));
                }
                self.put(Operation::Call(function), ValueKind::In(Unit::PLAIN));
            }
            Function::Sqrt | Function::Floor | Function::Ceil | Function::Round => {
                plain_only(name, self.number(span)?, span)?;
                self.put(Operation::Call(function), ValueKind::In(Unit::PLAIN));
            }
            Function::Abs => {
                let unit = self.number(span)?;
                self.put(Operation::Call(function), ValueKind::In(unit));
            }
            Function::Min | Function::Max | Function::Mod => {
                let units: Vec<Unit> = (0..count).map(|_| self.number(span)).collect::<Result<_, _>>()?;
                let unit = common_unit(&units, span)?;
                // Several arguments are combined pairwise.
                (1..count.max(1)).for_each(|_| self.steps.push(Operation::Call(function)));
                self.kinds.push(ValueKind::In(unit));
            }
            Function::Random => {
                for _ in 0..count {
                    plain_only(name, self.number(span)?, span)?;
                }
                self.put(Operation::Random(count), ValueKind::In(Unit::PLAIN));
            }
            Function::If => {
                let (no, yes) = (self.kinds.pop(), self.kinds.pop());
                self.truth(span)?;
                let (Some(no), Some(yes)) = (no, yes) else { return Ok(()) };
                if no != yes {
                    let message = format!(
                        "the two results of `if` are of different kinds: {} and {}",
                        yes.name(),
                        no.name()
                    );
                    let hint = match (yes, no) {
                        (ValueKind::In(yes), ValueKind::In(no)) => yes.hint_of_two(no).map(str::to_owned),
                        _ => None,
                    };
                    return Err(Fault::new(span, message, "two values of the same kind").hint_or(hint));
                }
                self.put(Operation::Call(function), yes);
            }
        }
        Ok(())
    }
}
