//! Statistics of observations: shares and quantiles.

use serde::Serialize;
use urrcp::Span;

/// The relative frequency of an event, with a confidence interval for its probability.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Share {
    /// Number of observations in which the event occurred.
    pub count: u64,
    /// Number of all observations.
    pub of: u64,
    /// `count` divided by `of`; `None` without observations.
    pub share: Option<f64>,
    /// Lower end of the 95 % confidence interval of the probability, by Wilson's score method (Wilson: Probable inference, the law
    /// of succession, and statistical inference, 1927).
    pub least: f64,
    /// Upper end of the 95 % confidence interval.
    pub largest: f64,
}

/// The 97.5 % quantile of the normal distribution.
const Z: f64 = 1.959_963_984_540_054;

impl Share {
    /// Creates the share of `count` occurrences in `of` observations.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "counts are below 2^53")]
    pub fn of(count: usize, of: usize) -> Self {
        let (whole_count, whole_of) = (count as u64, of as u64);
        if of == 0 {
            return Self { count: whole_count, of: whole_of, share: None, least: 0.0, largest: 1.0 };
        }
        let n = of as f64;
        let share = count as f64 / n;
        let centre = (share + Z * Z / (2.0 * n)) / (1.0 + Z * Z / n);
        let half = Z / (1.0 + Z * Z / n) * (share * (1.0 - share) / n + Z * Z / (4.0 * n * n)).sqrt();
        Self {
            count: whole_count,
            of: whole_of,
            share: Some(share),
            // At the limits the method yields exactly 0 or 1, except for rounding errors.
            least: if count == 0 { 0.0 } else { (centre - half).max(0.0) },
            largest: if count == of { 1.0 } else { (centre + half).min(1.0) },
        }
    }
}

/// Quantiles by the nearest-rank method. The p % quantile is the smallest value that is at least as large as p % of all values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Quantiles {
    /// Number of values.
    pub count: usize,
    /// The median.
    #[serde(rename = "p50_ms")]
    pub p50: Span,
    /// The 99 % quantile.
    #[serde(rename = "p99_ms")]
    pub p99: Span,
    /// The largest value.
    #[serde(rename = "max_ms")]
    pub max: Span,
}

impl Quantiles {
    /// Computes the quantiles of `values`, given in any order; `None` without values.
    #[must_use]
    pub fn of(values: impl IntoIterator<Item = Span>) -> Option<Self> {
        let mut values: Vec<Span> = values.into_iter().collect();
        values.sort_unstable();
        let rank = |percent: usize| (values.len() * percent).div_ceil(100).saturating_sub(1);
        let at = |percent| values.get(rank(percent)).copied();
        Some(Self { count: values.len(), p50: at(50)?, p99: at(99)?, max: *values.last()? })
    }
}

#[cfg(test)]
mod tests {
    use urrcp::Span;

    use super::{Quantiles, Share};

    #[test]
    fn quantiles_are_observed_values() {
        let of = |count: i64| Quantiles::of((1..=count).rev().map(Span::from_millis)).unwrap();
        let hundred = of(100);
        assert_eq!([hundred.p50, hundred.p99, hundred.max], [50, 99, 100].map(Span::from_millis));
        let three = of(3);
        assert_eq!([three.p50, three.p99, three.max], [2, 3, 3].map(Span::from_millis));
        assert_eq!(Quantiles::of([]), None);
    }

    #[test]
    fn interval_is_the_wilson_interval() {
        // Expected values from Newcombe: Two-sided confidence intervals for the single proportion, 1998, table I.
        for (count, of, least, largest) in [
            (81, 263, 0.2553, 0.3662),
            (15, 148, 0.0624, 0.1605),
            (0, 20, 0.0, 0.1611),
            (1, 29, 0.0061, 0.1718),
        ] {
            let share = Share::of(count, of);
            assert!(
                (share.least - least).abs() < 5e-5 && (share.largest - largest).abs() < 5e-5,
                "{share:?}"
            );
        }
        assert_eq!(Share::of(0, 0).share, None);
    }
}
