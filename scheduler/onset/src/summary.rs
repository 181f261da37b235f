//! Summary of a device's latency over several trials.

use urrcp::Span;

/// The 95 % quantile of the normal distribution.
const Z95: f64 = 1.644_853_626_951_472_2;
/// The 97.5 % quantile of the normal distribution.
const Z975: f64 = 1.959_963_984_540_054;

/// Summary of the latencies of a device in several trials.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Latencies {
    /// Median latency of the trials.
    pub median: Span,
    /// With 95 % confidence, 95 % of all movements begin at most this much before or after the median: see [`spread_bound`].
    pub spread: Span,
    /// With 97.5 % confidence, 95 % of all movements have at most this latency: see [`quantile_bound`].
    pub p95: Span,
    /// With 95 % confidence, the true median differs from `median` by at most this. Excludes systematic errors: the unknown point within
    /// the sensor's round trip at which the value was taken, and delays that no round trip shows.
    pub median_error: Span,
    /// Number of trials.
    pub trials: usize,
}

impl Latencies {
    /// Summarizes latencies, given in milliseconds. Returns `None` for fewer than three latencies.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "trials are few")]
    pub fn of(latencies: &[f64]) -> Option<Self> {
        let n = latencies.len();
        if n < 3 {
            return None;
        }
        let mut sorted = latencies.to_vec();
        sorted.sort_by(f64::total_cmp);
        let median = f64::midpoint(sorted[(n - 1) / 2], sorted[n / 2]);
        let mean = sorted.iter().sum::<f64>() / n as f64;
        let squares: f64 = sorted.iter().map(|latency| (latency - mean).powi(2)).sum();
        let deviation = (squares / (n as f64 - 1.0)).sqrt();
        let nearest_rank = |values: &[f64]| values[(n * 95).div_ceil(100) - 1];
        // The assumption of a normal distribution never lowers the bound below an observed latency.
        let p95 = quantile_bound(n, mean, deviation).max(nearest_rank(&sorted));
        let mut distances: Vec<f64> = sorted.iter().map(|latency| (latency - median).abs()).collect();
        distances.sort_by(f64::total_cmp);
        // `spread_bound` applies around the mean, so the distance from mean to median is added.
        let spread = spread_bound(n, deviation) + (mean - median).abs();
        let median_error = Z975 * (std::f64::consts::PI / 2.0).sqrt() * deviation / (n as f64).sqrt();
        Some(Self {
            median: Span::from_millis_f64(median),
            spread: Span::from_millis_f64(spread.max(nearest_rank(&distances))),
            p95: Span::from_millis_f64(p95),
            median_error: Span::from_millis_f64(median_error),
            trials: n,
        })
    }
}

/// Returns an upper bound of the 95 % quantile of latencies: the one-sided tolerance limit of a normal distribution (Natrella:
/// Experimental Statistics, NBS Handbook 91, 1963, section 2-2.3; NIST/SEMATECH e-Handbook of Statistical Methods, section 7.2.6.3). The
/// confidence is 97.5 %, so that it is still at least 95 % if the latencies are not quite normally distributed. The highest of 20 trials
/// is a weaker bound: without an assumption on the distribution, 59 trials are needed (Wilks: Determination of sample sizes for setting
/// tolerance limits, Annals of Mathematical Statistics 12(1), 1941).
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "trials are few")]
pub fn quantile_bound(trials: usize, mean: f64, deviation: f64) -> f64 {
    let n = trials.max(3) as f64;
    let a = (1.0 - Z975 * Z975 / (2.0 * (n - 1.0))).max(0.1);
    let b = Z95 * Z95 - Z975 * Z975 / n;
    let factor = (Z95 + (Z95 * Z95 - a * b).max(0.0).sqrt()) / a;
    mean + factor * deviation
}

/// Returns half the width of the interval around the mean that contains 95 % of the values with 95 % confidence: the two-sided tolerance
/// limit of a normal distribution (Howe: Two-sided tolerance limits for normal populations, Journal of the American Statistical
/// Association 64, 1969). The quantile of chi squared is approximated as by Wilson and Hilferty (The distribution of chi-square, PNAS 17,
/// 1931).
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "trials are few")]
pub fn spread_bound(trials: usize, deviation: f64) -> f64 {
    let n = trials.max(3) as f64;
    let free = n - 1.0;
    let term = 2.0 / (9.0 * free);
    let chi_squared = free * (1.0 - term - Z95 * term.sqrt()).powi(3);
    Z975 * (free * (1.0 + 1.0 / n) / chi_squared).sqrt() * deviation
}
