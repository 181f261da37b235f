//! Times that are no whole number of nanoseconds, such as a beat at 110 beats a minute: exact until they are laid on the
//! clock.

use std::cmp::Ordering;

use num_rational::Ratio;
use num_traits::{CheckedAdd, CheckedDiv, CheckedMul};
use urrcp::Span;

/// Most decimals of a number that are read.
const DECIMALS_MAX: usize = 18;
/// Bits of a fraction that is too long to be kept as it is.
const COARSE_BITS: u32 = 20;

/// A time in nanoseconds, as a fraction.
///
/// Sums whose fractions exceed 128 bits are off by less than a millionth of a nanosecond.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Exact(Ratio<i128>);

/// Any other number, as a fraction.
pub type Fraction = Ratio<i128>;

impl Exact {
    /// Zero.
    pub const ZERO: Self = Self(Ratio::ZERO);

    /// So many times a length.
    pub fn times(self, count: Fraction) -> Self {
        let approximate = || near(to_f64(self.0) * to_f64(count));
        Self(self.0.checked_mul(&count).unwrap_or_else(approximate))
    }

    /// How many lengths of another make this one. None if the other is zero.
    pub fn divided_by(self, other: Self) -> Option<Fraction> {
        let approximate = || near(to_f64(self.0) / to_f64(other.0));
        (other != Self::ZERO).then(|| self.0.checked_div(&other.0).unwrap_or_else(approximate))
    }

    /// The sum.
    pub fn plus(self, other: Self) -> Self {
        if self.0.is_integer() && other.0.is_integer() {
            return Self(Ratio::from_integer(self.0.numer().saturating_add(*other.0.numer())));
        }
        Self(sum(self.0, other.0))
    }

    /// The difference.
    pub fn minus(self, other: Self) -> Self {
        self.plus(Self(-other.0))
    }

    /// So many nanoseconds.
    pub const fn of_nanos(nanos: Fraction) -> Self {
        Self(nanos)
    }

    /// In nanoseconds.
    pub const fn nanos(self) -> Fraction {
        self.0
    }

    /// In seconds.
    pub fn seconds(self) -> f64 {
        to_f64(self.0) / 1e9
    }

    /// The last whole nanosecond that is no later.
    pub fn rounded_down(self) -> Span {
        Span::from_nanos(saturated(self.0.numer().div_euclid(*self.0.denom())))
    }

    /// The nearest whole nanosecond, of two the later.
    pub fn rounded(self) -> Span {
        self.plus(Self(Ratio::new_raw(1, 2))).rounded_down()
    }
}

impl From<Span> for Exact {
    fn from(span: Span) -> Self {
        Self(Ratio::from_integer(i128::from(span.as_nanos())))
    }
}

/// Where lengths that count from the start of a cue end on the clock.
///
/// From a start that is known they end on the nearest nanosecond of the exact time, so that bars end where the next ones
/// begin. From an unknown one they are rounded down: any number of lengths one after another ends no later than their sum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Beginning(pub Option<Exact>);

impl Beginning {
    /// The time from the start until this much later.
    pub fn lay(self, length: Exact) -> Span {
        match self.0 {
            Some(start) if !length.0.is_integer() => start.plus(length).rounded() - start.rounded(),
            _ => length.rounded_down(),
        }
    }
}

/// Equal lengths one after another, such as the turns of a movement that is repeated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Laps {
    /// The length of each.
    pub length: Exact,
    /// When the first one begins, where that is fixed.
    pub from: Beginning,
}

impl Laps {
    /// When the lap of this number begins, counted from 0.
    pub fn begin(&self, lap: u32) -> Span {
        self.within(lap, Exact::ZERO)
    }

    /// So much later than a lap begins.
    pub fn within(&self, lap: u32, later: Exact) -> Span {
        self.from.lay(self.length.times(Ratio::from_integer(i128::from(lap))).plus(later))
    }
}

#[cfg(test)]
impl From<Span> for Laps {
    fn from(length: Span) -> Self {
        Self { length: length.into(), from: Beginning::default() }
    }
}

/// A decimal number as written, such as `104.5`. None if it is anything else, is negative or has very many digits.
pub fn decimal(text: &str) -> Option<Fraction> {
    let (whole, part) = text.split_once('.').unwrap_or((text, ""));
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if whole.len() + part.len() == 0 || !digits(whole) || !digits(part) || whole.len() > DECIMALS_MAX {
        return None;
    }
    let part = &part[..part.len().min(DECIMALS_MAX)];
    let numerator: i128 = format!("{whole}{part}").parse().ok()?;
    Some(Ratio::new(numerator, 10i128.pow(u32::try_from(part.len()).ok()?)))
}

/// A number of the language as it was written: doubles are shown by the shortest text that reads as the same one.
pub fn fraction(value: f64) -> Fraction {
    decimal(&value.to_string()).unwrap_or_else(|| near(value))
}

/// The same of any sign; of very small and large numbers the nearest millionth.
pub fn near_fraction(value: f64) -> Fraction {
    let size = decimal(&value.abs().to_string()).unwrap_or_else(|| near(value.abs()));
    if value < 0.0 { -size } else { size }
}

/// Whether a fraction lies within bounds.
pub fn within(value: Fraction, least: i128, most: i128) -> bool {
    value.cmp(&Ratio::from_integer(least)) != Ordering::Less
        && value.cmp(&Ratio::from_integer(most)) != Ordering::Greater
}

/// As a double.
#[expect(clippy::cast_precision_loss, reason = "rounded as doubles are")]
pub fn to_f64(value: Fraction) -> f64 {
    let (whole, rest) = (value.numer() / value.denom(), value.numer() % value.denom());
    whole as f64 + rest as f64 / *value.denom() as f64
}

/// The sum, off by less than a millionth where it is too long for 128 bits.
pub fn sum(a: Fraction, b: Fraction) -> Fraction {
    a.checked_add(&b).unwrap_or_else(|| coarse(a) + coarse(b))
}

fn saturated(value: i128) -> i64 {
    i64::try_from(value).unwrap_or(if value < 0 { i64::MIN } else { i64::MAX })
}

#[expect(clippy::cast_possible_truncation, reason = "`as` saturates, far beyond any time")]
fn near(value: f64) -> Fraction {
    let scale = f64::from(1u32 << COARSE_BITS);
    Ratio::new((value * scale).round() as i128, 1 << COARSE_BITS)
}

/// With a denominator that adds up with others: rounded down to a millionth.
fn coarse(value: Fraction) -> Fraction {
    let (whole, rest) = (value.numer().div_euclid(*value.denom()), value.numer().rem_euclid(*value.denom()));
    let shift = (128 - value.denom().leading_zeros()).saturating_sub(126 - COARSE_BITS);
    let part = ((rest >> shift) << COARSE_BITS) / (value.denom() >> shift);
    Ratio::from_integer(whole) + Ratio::new(part, 1 << COARSE_BITS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimals_are_read_as_they_are_written() {
        assert_eq!(decimal("104.50"), Some(Ratio::new(209, 2)));
        assert_eq!(decimal(".25"), Some(Ratio::new(1, 4)));
        assert_eq!(decimal("7"), Some(Ratio::from_integer(7)));
        assert_eq!(fraction(0.1), Ratio::new(1, 10));
        for wrong in ["", ".", "-1", "1e3", "1.2.3", "x", "9999999999999999999"] {
            assert_eq!(decimal(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn laps_from_a_known_start_end_where_their_sum_ends_and_others_never_later() {
        let third = Exact(Ratio::new(10, 3));
        let start = Beginning(Some(Exact(Ratio::new(1, 3))));
        let begins = |from| [0, 1, 2, 3].map(|lap| Laps { length: third, from }.begin(lap).as_nanos());
        assert_eq!(begins(start), [0, 4, 7, 10]);
        assert_eq!(begins(Beginning(None)), [0, 3, 6, 10]);
    }

    #[test]
    fn a_sum_of_many_fractions_stays_close() {
        let (mut sum, mut reference) = (Exact::ZERO, 0.0);
        for i in 1..2_000i128 {
            sum = sum.plus(Exact(Ratio::new(60_000_000_000, 2 * i + 1)));
            reference += 60e9 / (2 * i + 1) as f64;
        }
        assert!((to_f64(sum.0) - reference).abs() < 0.01, "{} {reference}", to_f64(sum.0));
    }
}
