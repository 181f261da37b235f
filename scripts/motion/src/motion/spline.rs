//! Cubic splines through points: the clamped spline that starts and ends at rest, and the natural one.

/// A cubic polynomial between two points, for s from 0 to 1: the coefficients of c0 + c1 s + c2 s^2 + c3 s^3.
pub type Cubic = [f64; 4];

/// The condition at both ends of a spline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ends {
    /// The slope at both ends is zero.
    Rest,
    /// The curvature at both ends is zero.
    Natural,
}

/// The clamped cubic spline with zero slope at both ends. Of all curves through the points that start and end at rest, it has the
/// smallest integral of the squared acceleration (de Boor, A Practical Guide to Splines, chapter IV). The slopes m_i at the points solve
/// m_{i-1}/h_i + 2 m_i (1/h_i + 1/h_{i+1}) + m_{i+1}/h_{i+1} = 3 (d_i/h_i + d_{i+1}/h_{i+1}), where h_i are the lengths of the intervals
/// and d_i their mean slopes.
pub fn spline(times: &[f64], values: &[f64]) -> Vec<Cubic> {
    between(times, values, &slopes(times, values, Ends::Rest))
}

/// The natural cubic spline, whose curvature is zero at both ends. The first and the last equation for its slopes involve only one
/// interval.
pub(super) fn natural(times: &[f64], values: &[f64]) -> Vec<Cubic> {
    between(times, values, &slopes(times, values, Ends::Natural))
}

fn between(times: &[f64], values: &[f64], slopes: &[f64]) -> Vec<Cubic> {
    let of =
        |i: usize| hermite([values[i - 1], values[i]], [slopes[i - 1], slopes[i]], times[i] - times[i - 1]);
    (1..times.len()).map(of).collect()
}

/// The cubic with the given values and slopes at the two ends of an interval.
pub(super) fn hermite([from, to]: [f64; 2], slopes: [f64; 2], length: f64) -> Cubic {
    let [m0, m1] = slopes.map(|slope| slope * length);
    [from, m0, 3.0 * (to - from) - 2.0 * m0 - m1, 2.0 * (from - to) + m0 + m1]
}

/// The slopes of a spline at its points: solves the tridiagonal system by Thomas' algorithm.
fn slopes(times: &[f64], values: &[f64], ends: Ends) -> Vec<f64> {
    let n = times.len();
    let mut slopes = vec![0.0; n];
    let mut above = vec![0.0; n];
    let free = match ends {
        Ends::Rest => 1..n.saturating_sub(1),
        Ends::Natural => 0..n,
    };
    // The contribution of the interval that ends at a point: the factor of its slope, and the right-hand side.
    let interval = |i: usize| {
        let length = times[i] - times[i - 1];
        (1.0 / length, 3.0 * (values[i] - values[i - 1]) / (length * length))
    };
    for i in free.clone() {
        let (before, known) = if i > 0 { interval(i) } else { (0.0, 0.0) };
        let (after, coming) = if i + 1 < n { interval(i + 1) } else { (0.0, 0.0) };
        let (factor, slope) = if i > 0 { (above[i - 1], slopes[i - 1]) } else { (0.0, 0.0) };
        let pivot = 2.0 * (before + after) - factor * before;
        above[i] = after / pivot;
        slopes[i] = (known + coming - slope * before) / pivot;
    }
    // A prescribed last slope is 0, and so is its multiplier.
    for i in free.rev().filter(|i| i + 1 < n) {
        slopes[i] -= above[i] * slopes[i + 1];
    }
    slopes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spline_passes_smoothly_through_its_points_and_rests_at_both_ends() {
        let (times, values) = ([0.0, 1.0, 3.0, 3.5], [0.0, 2.0, -1.0, 4.0]);
        let pieces = spline(&times, &values);
        let at = |c: &[f64; 4], s: f64| c[0] + s * (c[1] + s * (c[2] + s * c[3]));
        let slope = |c: &[f64; 4], s: f64, h: f64| (c[1] + s * (2.0 * c[2] + 3.0 * s * c[3])) / h;
        let bend = |c: &[f64; 4], s: f64, h: f64| (2.0 * c[2] + 6.0 * s * c[3]) / (h * h);
        let lengths: Vec<_> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        for (i, piece) in pieces.iter().enumerate() {
            assert!((at(piece, 0.0) - values[i]).abs() < 1e-12);
            assert!((at(piece, 1.0) - values[i + 1]).abs() < 1e-12);
        }
        for i in 1..pieces.len() {
            let (before, after) = (&pieces[i - 1], &pieces[i]);
            assert!((slope(before, 1.0, lengths[i - 1]) - slope(after, 0.0, lengths[i])).abs() < 1e-9);
            assert!((bend(before, 1.0, lengths[i - 1]) - bend(after, 0.0, lengths[i])).abs() < 1e-9);
        }
        assert_eq!(slope(&pieces[0], 0.0, lengths[0]), 0.0);
        assert!(slope(&pieces[2], 1.0, lengths[2]).abs() < 1e-12);
    }

    #[test]
    fn natural_spline_is_straight_at_both_ends_and_smooth_between() {
        let (times, values) = ([0.0, 1.0, 3.0, 3.5], [0.0, 2.0, -1.0, 4.0]);
        let pieces = natural(&times, &values);
        let lengths: Vec<_> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let rates = |c: &Cubic, s: f64, h: f64| {
            ((c[1] + s * (2.0 * c[2] + 3.0 * s * c[3])) / h, (2.0 * c[2] + 6.0 * s * c[3]) / (h * h))
        };
        for i in 1..pieces.len() {
            let (before, after) =
                (rates(&pieces[i - 1], 1.0, lengths[i - 1]), rates(&pieces[i], 0.0, lengths[i]));
            assert!((before.0 - after.0).abs() < 1e-9 && (before.1 - after.1).abs() < 1e-9, "{i}");
        }
        assert!(rates(&pieces[0], 0.0, lengths[0]).1.abs() < 1e-9);
        assert!(rates(&pieces[2], 1.0, lengths[2]).1.abs() < 1e-9);
        // Between two points, the spline is a straight line.
        assert_eq!(natural(&[0.0, 2.0], &[1.0, 5.0]), [[1.0, 4.0, 0.0, 0.0]]);
    }
}
