//! Cubic curves through two points with given slopes. The joint trajectory controller of ROS follows such curves.

/// A point of a curve.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    pub(super) at_s: f64,
    pub(super) value: f64,
    /// The slope at the point, in units per second.
    pub(super) slope: f64,
}

/// Returns the value, at the time `at_s`, of the curve through all points. The value is constant before the first point and after the
/// last one. `None` if there are no points.
pub(super) fn value(points: &[Point], at_s: f64) -> Option<f64> {
    let next = points.partition_point(|point| point.at_s <= at_s);
    match (next.checked_sub(1).map(|index| points[index]), points.get(next)) {
        (Some(from), Some(to)) => Some(between(from, *to, at_s)),
        (Some(last), None) => Some(last.value),
        (None, first) => first.map(|point| point.value),
    }
}

/// Returns the coefficients of the cubic between two points. They apply to powers of the time in seconds since the first point.
pub(super) fn coefficients(from: Point, to: Point) -> Vec<f64> {
    let length = to.at_s - from.at_s;
    let mean = (to.value - from.value) / length;
    let square = (3.0 * mean - 2.0 * from.slope - to.slope) / length;
    let cube = (from.slope + to.slope - 2.0 * mean) / (length * length);
    vec![from.value + 0.0, from.slope + 0.0, square + 0.0, cube + 0.0]
}

fn between(from: Point, to: Point, at_s: f64) -> f64 {
    let length = to.at_s - from.at_s;
    let s = (at_s - from.at_s) / length;
    let (s2, s3) = (s * s, s * s * s);
    from.value * (2.0 * s3 - 3.0 * s2 + 1.0)
        + from.slope * length * (s3 - 2.0 * s2 + s)
        + to.value * (3.0 * s2 - 2.0 * s3)
        + to.slope * length * (s3 - s2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubic_is_reproduced_exactly() {
        let cubic = |t: f64| t * t * t - 2.0 * t + 1.0;
        let slope = |t: f64| 3.0 * t * t - 2.0;
        let points = [0.5, 2.0, 3.0].map(|t| Point { at_s: t, value: cubic(t), slope: slope(t) });
        for t in [0.5, 0.75, 1.9, 2.0, 2.5, 3.0] {
            assert!(value(&points, t).is_some_and(|v| (v - cubic(t)).abs() < 1e-12), "at {t}");
        }
        assert_eq!(value(&points, 0.0), Some(cubic(0.5)));
        let powers = coefficients(points[0], points[1]);
        for t in [0.0, 0.3, 1.0, 1.5] {
            let sum = powers.iter().rev().fold(0.0, |sum, c| sum * t + c);
            assert!((sum - cubic(0.5 + t)).abs() < 1e-12, "after {t}");
        }
        assert_eq!(value(&[], 0.0), None);
    }
}
