//! The cubic spline through points that begins and ends at rest.

/// The polynomials between the points, each in s from 0 to 1: c0 + c1 s + c2 s^2 + c3 s^3.
///
/// The clamped cubic spline with zero slope at both ends: among all curves through the points that begin and end at rest,
/// it has the least integral of the squared acceleration (de Boor, A Practical Guide to Splines, chapter IV). Slopes m_i
/// at the points solve m_{i-1}/h_i + 2 m_i (1/h_i + 1/h_{i+1}) + m_{i+1}/h_{i+1} = 3 (d_i/h_i + d_{i+1}/h_{i+1}), with
/// h the lengths of the intervals and d their mean slopes.
pub(crate) fn spline(times: &[f64], values: &[f64]) -> Vec<[f64; 4]> {
    let slopes = slopes(times, values);
    (1..times.len())
        .map(|i| {
            let h = times[i] - times[i - 1];
            let (y0, y1) = (values[i - 1], values[i]);
            let (m0, m1) = (slopes[i - 1] * h, slopes[i] * h);
            [y0, m0, 3.0 * (y1 - y0) - 2.0 * m0 - m1, 2.0 * (y0 - y1) + m0 + m1]
        })
        .collect()
}

/// Thomas' algorithm for the tridiagonal system.
fn slopes(times: &[f64], values: &[f64]) -> Vec<f64> {
    let n = times.len();
    let mut slopes = vec![0.0; n];
    let mut above = vec![0.0; n];
    for i in 1..n.saturating_sub(1) {
        let (before, after) = (times[i] - times[i - 1], times[i + 1] - times[i]);
        let right = 3.0
            * ((values[i] - values[i - 1]) / (before * before)
                + (values[i + 1] - values[i]) / (after * after));
        let pivot = 2.0 * (1.0 / before + 1.0 / after) - above[i - 1] / before;
        above[i] = 1.0 / (after * pivot);
        slopes[i] = (right - slopes[i - 1] / before) / pivot;
    }
    // The last slope is 0, as is its multiplier.
    for i in (1..n.saturating_sub(1)).rev() {
        slopes[i] -= above[i] * slopes[i + 1];
    }
    slopes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spline_goes_through_its_points_smoothly_and_rests_at_both_ends() {
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
}
