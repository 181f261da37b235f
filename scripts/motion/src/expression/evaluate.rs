//! Evaluates an expression. A fault is an intermediate value like any other, so a fault in a branch that is not taken is ignored.

use super::grammar::{Expression, Function, Span, Step, Two};
use super::number::{Num, sine};
use super::unit::Unit;
use super::{Amount, Fault, Quantity};
use crate::chance::share;
use crate::exact::Fraction;

/// The context of an expression: the values of its variables and the tempo.
pub trait Known {
    /// The value of a variable.
    fn variable(&mut self, name: &str, span: Span) -> Result<Quantity, Fault>;

    /// Converts a time that may contain bars and beats to nanoseconds of clock time.
    fn on_the_clock(&self, amount: &Amount, span: Span) -> Result<Num, Fault>;
}

type Found = Result<Quantity, Fault>;

/// Evaluates an expression in the context `known`.
pub fn evaluate(expression: &Expression, known: &mut dyn Known) -> Found {
    let mut stack: Vec<Found> = Vec::with_capacity(8);
    for (step, span) in &expression.steps {
        let mut pop = || stack.pop().unwrap_or_else(|| Err(incomplete(*span)));
        let found = match step {
            Step::Amount(amount) => Ok(Quantity::Amount(*amount)),
            Step::Truth(truth) => Ok(Quantity::Truth(*truth)),
            Step::Variable(name) => known.variable(name, *span),
            Step::Time => {
                let hint = "`t` is the time and is only defined in the `formula` of a track; write a variable as `$t`";
                Err(Fault::new(*span, "`t` is not defined here", "a number, a time or a variable").hint(hint))
            }
            Step::Negate => pop().and_then(|value| negated(value, *span)),
            Step::Not => pop().and_then(|value| Ok(Quantity::Truth(!truth(value, *span)?))),
            Step::Two(two) => {
                let (right, left) = (pop(), pop());
                left.and_then(|left| of_two(*two, left, right, *span, known))
            }
            Step::Call(function, count) => {
                let mut arguments: Vec<Found> = (0..*count).map(|_| pop()).collect();
                arguments.reverse();
                called(*function, arguments, *span, known)
            }
        };
        stack.push(found.and_then(|value| finite(value, *span)));
    }
    stack.pop().unwrap_or_else(|| Err(incomplete((0, 1))))
}

fn incomplete(span: Span) -> Fault {
    Fault::new(span, "incomplete expression", "a value")
}

fn finite(value: Quantity, span: Span) -> Found {
    match value {
        Quantity::Amount(Amount { number, bars, beats, .. })
            if ![number, bars, beats].iter().all(|part| part.is_finite()) =>
        {
            Err(Fault::new(span, "the result is too large", "a number below 1e308"))
        }
        value => Ok(value),
    }
}

fn truth(value: Quantity, span: Span) -> Result<bool, Fault> {
    match value {
        Quantity::Truth(truth) => Ok(truth),
        Quantity::Amount(amount) => {
            let message = format!("{} instead of true or false", amount.unit.name());
            Err(Fault::new(span, message, "a comparison such as `$index < 3`"))
        }
    }
}

fn amount(value: Quantity, span: Span) -> Result<Amount, Fault> {
    match value {
        Quantity::Amount(amount) => Ok(amount),
        Quantity::Truth(truth) => {
            let message = format!("`{truth}` instead of a number");
            Err(Fault::new(span, message, "a number or a time")
                .hint("use it as a condition: `if($a < 3, 10, 20)`"))
        }
    }
}

fn negated(value: Quantity, span: Span) -> Found {
    Ok(Quantity::Amount(amount(value, span)?.each(Num::negated)))
}

fn of_two(two: Two, left: Quantity, right: Found, span: Span, known: &dyn Known) -> Found {
    match two {
        Two::And | Two::Or => {
            let left = truth(left, span)?;
            if left == (two == Two::Or) {
                return Ok(Quantity::Truth(left));
            }
            Ok(Quantity::Truth(truth(right?, span)?))
        }
        Two::Equal | Two::NotEqual if matches!(left, Quantity::Truth(_)) => {
            let same = truth(left, span)? == truth(right?, span)?;
            Ok(Quantity::Truth(same == (two == Two::Equal)))
        }
        _ => of_amounts(two, amount(left, span)?, amount(right?, span)?, span, known),
    }
}

/// A function that returns the number, the bars or the beats of an amount.
type AmountPart = fn(&Amount) -> Num;

/// Converts two amounts to comparable numbers: beats or bars if that is the only unit of both amounts, otherwise clock time.
fn comparable(a: &Amount, b: &Amount, span: Span, known: &dyn Known) -> Result<(Num, Num), Fault> {
    let only = |of: AmountPart, others: [AmountPart; 2]| {
        let alone = |amount: &Amount| others.iter().all(|other| other(amount).is_zero());
        (alone(a) && alone(b)).then(|| (of(a), of(b)))
    };
    let (number, bars, beats): (AmountPart, AmountPart, AmountPart) = (|a| a.number, |a| a.bars, |a| a.beats);
    let same = only(number, [bars, beats])
        .or_else(|| only(bars, [number, beats]))
        .or_else(|| only(beats, [number, bars]));
    match same {
        Some(both) => Ok(both),
        None => Ok((on_clock(a, span, known)?.number, on_clock(b, span, known)?.number)),
    }
}

fn on_clock(amount: &Amount, span: Span, known: &dyn Known) -> Result<Amount, Fault> {
    if amount.is_musical() {
        Ok(Amount::of(known.on_the_clock(amount, span)?, amount.unit))
    } else {
        Ok(*amount)
    }
}

fn of_amounts(two: Two, a: Amount, b: Amount, span: Span, known: &dyn Known) -> Found {
    let plain = |number: Num, unit: Unit| Ok(Quantity::Amount(Amount::of(number, unit)));
    let unit = match two {
        Two::Times => product(a.unit, b.unit, span)?,
        Two::Over => quotient(a.unit, b.unit, span)?,
        _ => same_unit(two, a.unit, b.unit, span)?,
    };
    match two {
        Two::Plus => Ok(Quantity::Amount(sum(&a, &b, Num::plus))),
        Two::Minus => Ok(Quantity::Amount(sum(&a, &b, Num::minus))),
        // Multiplying a time also multiplies its beats.
        Two::Times if b.unit.is_factor() => {
            Ok(Quantity::Amount(scaled(&a, unit, |part| part.times(b.number))))
        }
        Two::Times if a.unit.is_factor() => {
            Ok(Quantity::Amount(scaled(&b, unit, |part| part.times(a.number))))
        }
        Two::Times => plain(on_clock(&a, span, known)?.number.times(on_clock(&b, span, known)?.number), unit),
        Two::Over if b.unit.is_factor() => {
            let by = divisor(b.number, span)?;
            Ok(Quantity::Amount(scaled(&a, unit, |part| part.over(by).unwrap_or(part))))
        }
        Two::Over => {
            let (a, b) = if a.unit == b.unit {
                comparable(&a, &b, span, known)?
            } else {
                (on_clock(&a, span, known)?.number, on_clock(&b, span, known)?.number)
            };
            plain(a.over(divisor(b, span)?).unwrap_or(a), unit)
        }
        Two::Modulo => {
            let (a, b) = (on_clock(&a, span, known)?.number, on_clock(&b, span, known)?.number);
            plain(a.modulo(divisor(b, span)?).unwrap_or(a), unit)
        }
        _ => {
            let (a, b) = comparable(&a, &b, span, known)?;
            let order = a.compared(b);
            Ok(Quantity::Truth(match two {
                Two::Less => order.is_lt(),
                Two::LessOrEqual => order.is_le(),
                Two::Greater => order.is_gt(),
                Two::GreaterOrEqual => order.is_ge(),
                Two::NotEqual => order.is_ne(),
                _ => order.is_eq(),
            }))
        }
    }
}

fn sum(a: &Amount, b: &Amount, of: fn(Num, Num) -> Num) -> Amount {
    Amount { number: of(a.number, b.number), bars: of(a.bars, b.bars), beats: of(a.beats, b.beats), ..*a }
}

fn scaled(amount: &Amount, unit: Unit, change: impl Fn(Num) -> Num) -> Amount {
    Amount { unit, ..amount.each(change) }
}

fn divisor(number: Num, span: Span) -> Result<Num, Fault> {
    if number.is_zero() {
        return Err(Fault::new(span, "division by zero", "a divisor other than 0")
            .hint("avoid a divisor of 0, as in `if($a == 0, 0, 1 / $a)`"));
    }
    Ok(number)
}

pub(super) fn product(a: Unit, b: Unit, span: Span) -> Result<Unit, Fault> {
    a.times(b).ok_or_else(|| too_high(span))
}

pub(super) fn quotient(a: Unit, b: Unit, span: Span) -> Result<Unit, Fault> {
    a.over(b).ok_or_else(|| too_high(span))
}

fn too_high(span: Span) -> Fault {
    Fault::new(span, "the power of a time or an angle is too high", "a number, or a time")
}

/// The common unit of two values that are added or compared; a fault if their units differ.
pub(super) fn same_unit(two: Two, a: Unit, b: Unit, span: Span) -> Result<Unit, Fault> {
    if a == b {
        return Ok(a);
    }
    let (a_name, b_name) = (a.name(), b.name());
    let message = match two {
        Two::Plus => format!("{a_name} and {b_name} cannot be added"),
        Two::Minus => format!("{a_name} and {b_name} cannot be subtracted"),
        Two::Modulo => format!("`%` and `mod` need two values of the same kind, found {a_name} and {b_name}"),
        _ => format!("{a_name} and {b_name} cannot be compared"),
    };
    let hint = a.hint_of_two(b).map(str::to_owned);
    Err(Fault::new(span, message, "two values of the same kind").hint_or(hint))
}

/// Returns the unit of all arguments, or a fault if their units differ.
pub(super) fn common_unit(units: &[Unit], span: Span) -> Result<Unit, Fault> {
    let first = units.first().copied().unwrap_or(Unit::PLAIN);
    units.iter().try_for_each(|unit| same_unit(Two::Less, first, *unit, span).map(drop))?;
    Ok(first)
}

/// Returns a fault if an argument of the function `name` is not a plain number.
pub(super) fn plain_only(name: &str, unit: Unit, span: Span) -> Result<(), Fault> {
    if unit == Unit::PLAIN {
        return Ok(());
    }
    let message = format!("`{name}` is not defined for {}", unit.name());
    let hint = (unit == Unit::TIME).then(|| "divide the time by another time: `$a / 1s`".to_owned());
    Err(Fault::new(span, message, "a plain number").hint_or(hint))
}

/// Returns a fault if an argument of the function `name` is not an angle. Plain numbers are angles in degrees.
pub(super) fn angle_only(name: &str, unit: Unit, span: Span) -> Result<(), Fault> {
    if unit == Unit::PLAIN || unit == Unit::ANGLE {
        return Ok(());
    }
    let message = format!("`{name}` is not defined for {}", unit.name());
    let hint = match unit.time {
        0 => None,
        _ => Some("divide the time by another time: `sin(360 * t / 8s)`".to_owned()),
    };
    Err(Fault::new(span, message, "an angle: a plain number in degrees, or a multiple of `pi`").hint_or(hint))
}

fn called(function: Function, arguments: Vec<Found>, span: Span, known: &dyn Known) -> Found {
    let name = function.name();
    if function == Function::If {
        return chosen(arguments, span);
    }
    let values: Vec<Quantity> = arguments.into_iter().collect::<Result<_, _>>()?;
    let amounts: Vec<Amount> =
        values.into_iter().map(|value| amount(value, span)).collect::<Result<_, _>>()?;
    let Some(first) = amounts.first().copied() else { return Err(incomplete(span)) };
    let plain = |number: Num| Ok(Quantity::Amount(Amount::of(number, Unit::PLAIN)));
    match function {
        Function::Sin | Function::Cos | Function::Tan => {
            angle_only(name, first.unit, span)?;
            let degrees =
                if first.unit == Unit::ANGLE { first.number.times(Num::whole(180)) } else { first.number };
            let cosine = sine(degrees.plus(Num::whole(90)));
            match function {
                Function::Sin => plain(sine(degrees)),
                Function::Cos => plain(cosine),
                _ => match sine(degrees).over(cosine) {
                    Some(tangent) => plain(tangent),
                    None => Err(Fault::new(
                        span,
                        "`tan` is not defined at this angle",
                        "an angle that is not an odd multiple of 90 degrees",
                    )),
                },
            }
        }
        Function::Floor | Function::Ceil | Function::Round => {
            plain_only(name, first.unit, span)?;
            plain(match function {
                Function::Floor => first.number.floor(),
                Function::Ceil => first.number.ceil(),
                _ => first.number.round(),
            })
        }
        Function::Sqrt => {
            plain_only(name, first.unit, span)?;
            if first.number.compared(Num::ZERO).is_lt() {
                let message = format!("`sqrt` is not defined for {}", first.number.f64());
                return Err(Fault::new(span, message, "a number of at least 0"));
            }
            plain(first.number.square_root())
        }
        Function::Abs => {
            let (own, zero) = comparable(&first, &Amount::of(Num::ZERO, first.unit), span, known)?;
            Ok(Quantity::Amount(if own.compared(zero).is_lt() { first.each(Num::negated) } else { first }))
        }
        Function::Min | Function::Max => {
            let units: Vec<Unit> = amounts.iter().map(|amount| amount.unit).collect();
            common_unit(&units, span)?;
            let mut best = first;
            for other in &amounts[1..] {
                let (a, b) = comparable(&best, other, span, known)?;
                if if function == Function::Min { b.compared(a).is_lt() } else { b.compared(a).is_gt() } {
                    best = *other;
                }
            }
            Ok(Quantity::Amount(best))
        }
        Function::Mod => {
            let Some(second) = amounts.get(1).copied() else { return Err(incomplete(span)) };
            of_two(Two::Modulo, Quantity::Amount(first), Ok(Quantity::Amount(second)), span, known)
        }
        Function::Random => {
            for amount in &amounts {
                plain_only(name, amount.unit, span)?;
            }
            let from: Vec<f64> = amounts.iter().map(|amount| amount.number.f64()).collect();
            let (part, whole) = share(&from);
            plain(Num::fraction(Fraction::new(part.into(), whole.into())))
        }
        Function::If => Err(incomplete(span)),
    }
}

/// Evaluates `if(condition, yes, no)`: returns the selected branch. Both branches must be of the same kind.
fn chosen(arguments: Vec<Found>, span: Span) -> Found {
    let mut arguments = arguments.into_iter();
    let (Some(condition), Some(yes), Some(no)) = (arguments.next(), arguments.next(), arguments.next())
    else {
        return Err(incomplete(span));
    };
    let condition = truth(condition?, span)?;
    match (&yes, &no) {
        (Ok(Quantity::Amount(a)), Ok(Quantity::Amount(b))) if a.unit != b.unit => {
            let message = format!(
                "the two results of `if` are of different kinds: {} and {}",
                a.unit.name(),
                b.unit.name()
            );
            return Err(Fault::new(span, message, "two values of the same kind"));
        }
        (Ok(Quantity::Amount(_)), Ok(Quantity::Truth(_)))
        | (Ok(Quantity::Truth(_)), Ok(Quantity::Amount(_))) => {
            let message = "one result of `if` is a number, but the other is true or false";
            return Err(Fault::new(span, message, "two values of the same kind"));
        }
        _ => {}
    }
    if condition { yes } else { no }
}

impl Unit {
    /// Whether a factor with this unit leaves the unit of the other factor unchanged.
    const fn is_factor(self) -> bool {
        self.time == 0 && self.angle == 0
    }
}

impl Function {
    pub(super) fn name(self) -> &'static str {
        super::FUNCTIONS.iter().find(|(_, function, ..)| *function == self).map_or("", |(name, ..)| *name)
    }
}
