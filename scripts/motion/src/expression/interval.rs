//! A formula over a time interval: bounds of its value and its first two derivatives, by interval arithmetic (Moore, Kearfott and Cloud,
//! Introduction to Interval Analysis, 2009) and the rules of differentiation.

use super::formula::{Formula, Operation, of_one, of_two, random, sine};
use super::grammar::{Function, Two};

/// The least and the largest value of a quantity over an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bounds(pub(super) f64, pub(super) f64);

impl Bounds {
    const ZERO: Self = Self(0.0, 0.0);

    pub(super) fn largest(self) -> f64 {
        self.0.abs().max(self.1.abs())
    }

    fn is_point(self) -> bool {
        self.0 == self.1
    }

    fn plus(self, other: Self) -> Self {
        Self(self.0 + other.0, self.1 + other.1)
    }

    fn negated(self) -> Self {
        Self(-self.1, -self.0)
    }

    fn times(self, other: Self) -> Self {
        if self == Self::ZERO || other == Self::ZERO {
            return Self::ZERO;
        }
        let all = [self.0 * other.0, self.0 * other.1, self.1 * other.0, self.1 * other.1];
        Self(all.into_iter().fold(f64::INFINITY, f64::min), all.into_iter().fold(f64::NEG_INFINITY, f64::max))
    }

    fn by(self, factor: f64) -> Self {
        self.times(Self(factor, factor))
    }

    fn squared(self) -> Self {
        let (low, high) = (self.0.abs().min(self.1.abs()), self.largest());
        Self(if self.0 <= 0.0 && self.1 >= 0.0 { 0.0 } else { low * low }, high * high)
    }

    /// Bounds of the reciprocal; `None` if the interval contains zero.
    fn inverse(self) -> Option<Self> {
        (self.0 > 0.0 || self.1 < 0.0).then(|| Self(1.0 / self.1, 1.0 / self.0))
    }

    /// Bounds of the sine of an angle in degrees.
    fn sine(self) -> Self {
        if self.1 - self.0 >= 360.0 {
            return Self(-1.0, 1.0);
        }
        // Whether the interval contains this angle, modulo full turns.
        let passes = |peak: f64| ((self.1 - peak) / 360.0).floor() >= ((self.0 - peak) / 360.0).ceil();
        let (a, b) = (sine(self.0), sine(self.1));
        Self(if passes(270.0) { -1.0 } else { a.min(b) }, if passes(90.0) { 1.0 } else { a.max(b) })
    }

    fn is_finite(self) -> bool {
        self.0.is_finite() && self.1.is_finite()
    }
}

/// Bounds of a formula's value, of its slope per second, and of its second derivative.
#[derive(Clone, Copy, Debug)]
pub(super) struct Jet {
    pub(super) value: Bounds,
    pub(super) slope: Bounds,
    pub(super) curvature: Bounds,
}

impl Jet {
    fn constant(value: f64) -> Self {
        Self { value: Bounds(value, value), slope: Bounds::ZERO, curvature: Bounds::ZERO }
    }

    fn is_constant(&self) -> bool {
        self.slope == Bounds::ZERO && self.curvature == Bounds::ZERO && self.value.is_point()
    }

    fn negated(&self) -> Self {
        Self { value: self.value.negated(), slope: self.slope.negated(), curvature: self.curvature.negated() }
    }

    fn plus(&self, other: &Self) -> Self {
        Self {
            value: self.value.plus(other.value),
            slope: self.slope.plus(other.slope),
            curvature: self.curvature.plus(other.curvature),
        }
    }

    fn times(&self, other: &Self) -> Self {
        let slopes = self.slope.times(other.slope).by(2.0);
        Self {
            value: self.value.times(other.value),
            slope: self.slope.times(other.value).plus(self.value.times(other.slope)),
            curvature: self.curvature.times(other.value).plus(slopes).plus(self.value.times(other.curvature)),
        }
    }

    /// Applies a function to this jet, by the chain rule. `value`, `first` and `second` are the bounds of the function and of its first
    /// two derivatives.
    fn through(&self, value: Bounds, first: Bounds, second: Bounds) -> Self {
        Self {
            value,
            slope: first.times(self.slope),
            curvature: second.times(self.slope.squared()).plus(first.times(self.curvature)),
        }
    }

    fn inverse(&self) -> Option<Self> {
        let inverse = self.value.inverse()?;
        let squared = inverse.squared();
        Some(self.through(inverse, squared.negated(), squared.times(inverse).by(2.0)))
    }

    fn sine(&self, shift: f64) -> Self {
        let value = self.value.plus(Bounds(shift, shift));
        let (sine, cosine) = (value.sine(), value.plus(Bounds(90.0, 90.0)).sine());
        let degree = std::f64::consts::PI / 180.0;
        self.through(sine, cosine.by(degree), sine.negated().by(degree * degree))
    }

    fn root(&self) -> Option<Self> {
        if self.is_constant() && self.value.0 >= 0.0 {
            return Some(Self::constant(self.value.0.sqrt()));
        }
        if self.value.0 <= 0.0 {
            return None;
        }
        let root = Bounds(self.value.0.sqrt(), self.value.1.sqrt());
        let inverse = root.inverse()?;
        Some(self.through(root, inverse.by(0.5), inverse.times(inverse.squared()).by(-0.25)))
    }
}

/// Bounds of a formula and its derivatives over an interval in seconds. `None` if the formula may have a corner, a jump or no value
/// there.
pub(super) fn jet(formula: &Formula, from: f64, to: f64) -> Option<Jet> {
    let mut stack: Vec<Option<Jet>> = Vec::with_capacity(8);
    for step in formula.steps.iter() {
        let mut pop = || stack.pop().flatten();
        let next = match step {
            Operation::Constant(value) => Some(Jet::constant(*value)),
            Operation::Time => {
                Some(Jet { value: Bounds(from, to), slope: Bounds(1.0, 1.0), curvature: Bounds::ZERO })
            }
            Operation::Negate => pop().map(|jet| jet.negated()),
            Operation::Not => pop().map(|jet| Jet::constant(1.0 - jet.value.0)),
            Operation::Two(two) => {
                let (b, a) = (pop(), pop());
                logical(*two, a, b).unwrap_or_else(|| a.zip(b).and_then(|(a, b)| two_jets(*two, &a, &b)))
            }
            Operation::Call(Function::If) => {
                let (no, yes, condition) = (pop(), pop(), pop());
                condition.and_then(|condition| if condition.value.0 == 0.0 { no } else { yes })
            }
            Operation::Call(function @ (Function::Min | Function::Max | Function::Mod)) => {
                let (b, a) = (pop(), pop());
                a.zip(b).and_then(|(a, b)| match function {
                    Function::Mod => two_jets(Two::Modulo, &a, &b),
                    _ if a.is_constant() && b.is_constant() && a.value == b.value => Some(a),
                    _ if a.value.1 <= b.value.0 => Some(if *function == Function::Min { a } else { b }),
                    _ if b.value.1 <= a.value.0 => Some(if *function == Function::Min { b } else { a }),
                    _ => None,
                })
            }
            Operation::Call(function) => pop().and_then(|jet| one_jet(*function, &jet)),
            // If an argument varies, the random value jumps all the time.
            Operation::Random(count) => {
                let from: Option<Vec<f64>> =
                    (0..*count).map(|_| pop().filter(Jet::is_constant).map(|jet| jet.value.0)).collect();
                from.map(|mut from| {
                    from.reverse();
                    Jet::constant(random(&from))
                })
            }
        };
        stack.push(next);
    }
    let jet = stack.pop().flatten()?;
    (jet.value.is_finite() && jet.slope.is_finite() && jet.curvature.is_finite()).then_some(jet)
}

/// Returns the result of `and` or `or` if one side alone decides it; otherwise, and for other operators, `None`.
fn logical(two: Two, a: Option<Jet>, b: Option<Jet>) -> Option<Option<Jet>> {
    let decides = match two {
        Two::And => 0.0,
        Two::Or => 1.0,
        _ => return None,
    };
    let decided = [a, b].into_iter().flatten().any(|jet| jet.value.0 == decides);
    decided.then(|| Some(Jet::constant(decides)))
}

fn two_jets(two: Two, a: &Jet, b: &Jet) -> Option<Jet> {
    match two {
        Two::Plus => Some(a.plus(b)),
        Two::Minus => Some(a.plus(&b.negated())),
        Two::Times => Some(a.times(b)),
        Two::Over => Some(a.times(&b.inverse()?)),
        Two::Modulo => {
            let times = a.value.times(b.value.inverse()?);
            let whole = times.0.floor();
            // The end of the interval belongs to the next period, if there is one.
            (whole == times.1.floor()).then(|| a.plus(&b.times(&Jet::constant(-whole))))
        }
        Two::And | Two::Or => Some(Jet::constant(of_two(two, a.value.0, b.value.0))),
        _ if a.is_constant() && b.is_constant() => Some(Jet::constant(of_two(two, a.value.0, b.value.0))),
        _ => {
            let (above, below) = (a.value.0 > b.value.1, a.value.1 < b.value.0);
            // If the two sides do not overlap, every comparison has a definite result.
            (above || below).then(|| Jet::constant(of_two(two, a.value.0, b.value.0)))
        }
    }
}

fn one_jet(function: Function, jet: &Jet) -> Option<Jet> {
    match function {
        Function::Sin => Some(jet.sine(0.0)),
        Function::Cos => Some(jet.sine(90.0)),
        Function::Tan => Some(jet.sine(0.0).times(&jet.sine(90.0).inverse()?)),
        Function::Sqrt => jet.root(),
        Function::Abs if jet.value.0 >= 0.0 => Some(*jet),
        Function::Abs if jet.value.1 <= 0.0 => Some(jet.negated()),
        Function::Floor | Function::Ceil | Function::Round => {
            let (a, b) = (of_one(function, jet.value.0), of_one(function, jet.value.1));
            (a == b).then(|| Jet::constant(a))
        }
        _ => None,
    }
}
