//! Times that are not a whole number of nanoseconds, such as a beat at 110 beats per minute. Such times are kept exactly until they are
//! converted to clock time.

use std::cmp::Ordering;

use num_rational::Ratio;
use num_traits::{CheckedAdd, CheckedDiv, CheckedMul};
use urrcp::Span;

/// Maximum number of digits before the decimal point, and of digits that are read after it.
const DECIMALS_MAX: usize = 18;
/// Fractions that are too long to be kept exactly are rounded to a denominator of 2 to the power of this number.
const COARSE_BITS: u32 = 20;

/// A time in nanoseconds, as a fraction.
///
/// Sums whose fractions exceed 128 bits are off by less than a millionth of a nanosecond.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Exact(Ratio<i128>);

/// A number that is not a time, as a fraction.
pub type Fraction = Ratio<i128>;

impl Exact {
    /// The time 0.
    pub const ZERO: Self = Self(Ratio::ZERO);

    /// This time multiplied by `count`.
    pub fn times(self, count: Fraction) -> Self {
        let approximate = || near(to_f64(self.0) * to_f64(count));
        Self(self.0.checked_mul(&count).unwrap_or_else(approximate))
    }

    /// Returns this length divided by `other`; `None` if `other` is zero.
    pub fn divided_by(self, other: Self) -> Option<Fraction> {
        let approximate = || near(to_f64(self.0) / to_f64(other.0));
        (other != Self::ZERO).then(|| self.0.checked_div(&other.0).unwrap_or_else(approximate))
    }

    /// The sum of two times.
    pub fn plus(self, other: Self) -> Self {
        if self.0.is_integer() && other.0.is_integer() {
            return Self(Ratio::from_integer(self.0.numer().saturating_add(*other.0.numer())));
        }
        Self(sum(self.0, other.0))
    }

    /// This time minus `other`.
    pub fn minus(self, other: Self) -> Self {
        self.plus(Self(-other.0))
    }

    /// Creates a time from a number of nanoseconds.
    pub const fn of_nanos(nanos: Fraction) -> Self {
        Self(nanos)
    }

    /// The time as a number of nanoseconds.
    pub const fn nanos(self) -> Fraction {
        self.0
    }

    /// The time as a number of seconds.
    pub fn seconds(self) -> f64 {
        to_f64(self.0) / 1e9
    }

    /// The time rounded down to a whole nanosecond.
    pub fn rounded_down(self) -> Span {
        Span::from_nanos(saturated(self.0.numer().div_euclid(*self.0.denom())))
    }

    /// The time rounded to the nearest whole nanosecond; halves are rounded up.
    pub fn rounded(self) -> Span {
        self.plus(Self(Ratio::new_raw(1, 2))).rounded_down()
    }
}

impl From<Span> for Exact {
    fn from(span: Span) -> Self {
        Self(Ratio::from_integer(i128::from(span.as_nanos())))
    }
}

/// The start of a cue. It converts lengths that count from that start to clock time.
///
/// If the start is known, a length ends at the nanosecond nearest to the exact time, so that each bar ends where the next one begins. If
/// the start is unknown (`None`), lengths are rounded down. The sum of any number of rounded lengths then does not exceed their exact
/// sum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Beginning(pub Option<Exact>);

impl Beginning {
    /// Converts `length`, which counts from the start of the cue, to clock time.
    pub fn lay(self, length: Exact) -> Span {
        match self.0 {
            Some(start) if !length.0.is_integer() => start.plus(length).rounded() - start.rounded(),
            _ => length.rounded_down(),
        }
    }
}

/// Consecutive equal lengths, such as the repetitions of a movement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Laps {
    /// The length of each lap.
    pub length: Exact,
    /// The start of the first lap, if it is fixed.
    pub from: Beginning,
}

impl Laps {
    /// Returns the clock time from the start of the first lap to the start of the lap `lap`. Laps are counted from 0.
    pub fn begin(&self, lap: u32) -> Span {
        self.within(lap, Exact::ZERO)
    }

    /// Returns the clock time from the start of the first lap to the moment `later` after the start of the lap `lap`.
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

/// Parses a decimal number such as `104.5` exactly. `None` if the text is anything else, is negative or has too many digits.
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

/// Converts a double that is not negative to the fraction that was probably written: the shortest decimal that is parsed as this double.
pub fn fraction(value: f64) -> Fraction {
    decimal(&value.to_string()).unwrap_or_else(|| near(value))
}

/// Like [`fraction`], but also for negative numbers. Very small and very large numbers become the nearest millionth.
pub fn near_fraction(value: f64) -> Fraction {
    let size = decimal(&value.abs().to_string()).unwrap_or_else(|| near(value.abs()));
    if value < 0.0 { -size } else { size }
}

/// Whether a fraction is from `least` to `most`, inclusive.
pub fn within(value: Fraction, least: i128, most: i128) -> bool {
    value.cmp(&Ratio::from_integer(least)) != Ordering::Less
        && value.cmp(&Ratio::from_integer(most)) != Ordering::Greater
}

/// The double nearest to a fraction.
#[expect(clippy::cast_precision_loss, reason = "rounded as doubles are")]
pub fn to_f64(value: Fraction) -> f64 {
    let (whole, rest) = (value.numer() / value.denom(), value.numer() % value.denom());
    whole as f64 + rest as f64 / *value.denom() as f64
}

/// The sum of two fractions; if it is too long for 128 bits, it has an error of less than a millionth.
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

/// Rounds a fraction down to a multiple of 2^-20 (about a millionth), so that the denominators of sums do not grow.
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
    fn decimals_are_read_as_written() {
        assert_eq!(decimal("104.50"), Some(Ratio::new(209, 2)));
        assert_eq!(decimal(".25"), Some(Ratio::new(1, 4)));
        assert_eq!(decimal("7"), Some(Ratio::from_integer(7)));
        assert_eq!(fraction(0.1), Ratio::new(1, 10));
        for wrong in ["", ".", "-1", "1e3", "1.2.3", "x", "9999999999999999999"] {
            assert_eq!(decimal(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn laps_with_known_start_end_exactly_and_others_never_later() {
        let third = Exact(Ratio::new(10, 3));
        let start = Beginning(Some(Exact(Ratio::new(1, 3))));
        let begins = |from| [0, 1, 2, 3].map(|lap| Laps { length: third, from }.begin(lap).as_nanos());
        assert_eq!(begins(start), [0, 4, 7, 10]);
        assert_eq!(begins(Beginning(None)), [0, 3, 6, 10]);
    }

    #[test]
    fn sum_of_many_fractions_stays_accurate() {
        let (mut sum, mut reference) = (Exact::ZERO, 0.0);
        for i in 1..2_000i128 {
            sum = sum.plus(Exact(Ratio::new(60_000_000_000, 2 * i + 1)));
            reference += 60e9 / (2 * i + 1) as f64;
        }
        assert!((to_f64(sum.0) - reference).abs() < 0.01, "{} {reference}", to_f64(sum.0));
    }
}
