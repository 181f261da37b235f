//! Numbers in expressions: exact fractions while they are rational and short enough, otherwise doubles.

use std::cmp::Ordering;

use num_traits::{CheckedAdd, CheckedDiv, CheckedMul, CheckedSub, Zero};

use crate::exact::{Fraction, decimal, near_fraction, to_f64};

/// Maximum number of bits of a numerator or denominator; longer fractions become doubles.
const BITS_MAX: u32 = 110;

/// A number in an expression.
#[derive(Clone, Copy, Debug)]
pub enum Num {
    /// A fraction, without rounding.
    Exact(Fraction),
    /// A number that is rounded to a double.
    Real(f64),
}

impl Num {
    /// The number 0.
    pub const ZERO: Self = Self::Exact(Fraction::ZERO);
    /// The number 1.
    pub const ONE: Self = Self::Exact(Fraction::ONE);

    /// Converts a double to the decimal that was probably written: the shortest one that is parsed as this double.
    pub fn of(value: f64) -> Self {
        match decimal(&value.abs().to_string()) {
            Some(size) => Self::Exact(if value < 0.0 { -size } else { size }),
            None => Self::Real(value),
        }
    }

    /// Creates a number from a whole number.
    pub fn whole(value: i128) -> Self {
        Self::kept(Fraction::from_integer(value))
    }

    /// Creates a number from a fraction. A fraction that is too long becomes a double.
    pub fn fraction(value: Fraction) -> Self {
        Self::kept(value)
    }

    fn kept(value: Fraction) -> Self {
        let short = |part: &i128| 128 - part.unsigned_abs().leading_zeros() <= BITS_MAX;
        if short(value.numer()) && short(value.denom()) {
            Self::Exact(value)
        } else {
            Self::Real(to_f64(value))
        }
    }

    /// Converts the number to the nearest double.
    #[expect(clippy::cast_precision_loss, reason = "both are below 2^53, or rounded as doubles are")]
    pub fn f64(self) -> f64 {
        match self {
            Self::Real(value) => value,
            Self::Exact(value) => {
                let small = |part: &i128| part.unsigned_abs() < 1 << 53;
                if small(value.numer()) && small(value.denom()) {
                    *value.numer() as f64 / *value.denom() as f64
                } else {
                    to_f64(value)
                }
            }
        }
    }

    /// Returns the number as a fraction. For a double, it is the nearest fraction with few decimal digits.
    pub fn as_fraction(self) -> Fraction {
        match self {
            Self::Exact(value) => value,
            Self::Real(value) => near_fraction(value),
        }
    }

    /// Whether the number is zero.
    pub fn is_zero(self) -> bool {
        match self {
            Self::Exact(value) => value.is_zero(),
            Self::Real(value) => value == 0.0,
        }
    }

    /// Whether the number is finite: neither infinite nor NaN.
    pub fn is_finite(self) -> bool {
        self.f64().is_finite()
    }

    fn both(
        self,
        other: Self,
        exact: impl Fn(&Fraction, &Fraction) -> Option<Fraction>,
        real: impl Fn(f64, f64) -> f64,
    ) -> Self {
        if let (Self::Exact(a), Self::Exact(b)) = (self, other)
            && let Some(value) = exact(&a, &b)
        {
            return Self::kept(value);
        }
        Self::Real(real(self.f64(), other.f64()))
    }

    /// The sum of two numbers.
    pub fn plus(self, other: Self) -> Self {
        self.both(other, CheckedAdd::checked_add, |a, b| a + b)
    }

    /// This number minus `other`.
    pub fn minus(self, other: Self) -> Self {
        self.both(other, CheckedSub::checked_sub, |a, b| a - b)
    }

    /// The product of two numbers.
    pub fn times(self, other: Self) -> Self {
        self.both(other, CheckedMul::checked_mul, |a, b| a * b)
    }

    /// This number divided by `other`; `None` if `other` is zero.
    pub fn over(self, other: Self) -> Option<Self> {
        (!other.is_zero()).then(|| self.both(other, CheckedDiv::checked_div, |a, b| a / b))
    }

    /// The remainder of the division by `other`, with the sign of `other`. `None` if `other` is zero.
    pub fn modulo(self, other: Self) -> Option<Self> {
        Some(self.minus(other.times(self.over(other)?.floor())))
    }

    /// The number with the opposite sign.
    pub fn negated(self) -> Self {
        Self::ZERO.minus(self)
    }

    /// The largest whole number that is at most this number.
    pub fn floor(self) -> Self {
        match self {
            Self::Exact(value) => Self::kept(value.floor()),
            Self::Real(value) => Self::Real(value.floor()),
        }
    }

    /// The smallest whole number that is at least this number.
    pub fn ceil(self) -> Self {
        self.negated().floor().negated()
    }

    /// The nearest whole number; halves are rounded away from zero.
    pub fn round(self) -> Self {
        match self {
            Self::Exact(value) => Self::kept(value.round()),
            Self::Real(value) => Self::Real(value.round()),
        }
    }

    /// Compares two numbers: exactly if both are exact, otherwise by [`f64::total_cmp`].
    pub fn compared(self, other: Self) -> Ordering {
        match (self, other) {
            (Self::Exact(a), Self::Exact(b)) => a.cmp(&b),
            _ => self.f64().total_cmp(&other.f64()),
        }
    }

    /// The square root; exact if the root is a fraction.
    pub fn square_root(self) -> Self {
        let root = self.f64().sqrt();
        let exact = Self::of(root);
        if exact.times(exact).compared(self).is_eq() { exact } else { Self::Real(root) }
    }
}

/// The sine of an angle in degrees; exact if the sine is 0, ±1/2 or ±1.
pub fn sine(degrees: Num) -> Num {
    let turn = Num::whole(360);
    let Some(within) = degrees.modulo(turn) else { return Num::ZERO };
    if let Num::Exact(value) = within
        && value.is_integer()
    {
        let half = Fraction::new(1, 2);
        match *value.numer() {
            0 | 180 => return Num::ZERO,
            30 | 150 => return Num::Exact(half),
            90 => return Num::ONE,
            210 | 330 => return Num::Exact(-half),
            270 => return Num::Exact(-Fraction::ONE),
            _ => {}
        }
    }
    Num::Real(within.f64().to_radians().sin())
}
