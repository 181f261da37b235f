//! Bounds of polynomials. The curve lies within the convex hull of the control points of the polynomial's Bernstein form.

use super::{Piece, keyframes};

/// Number of bisections. Each bisection reduces the error of the bounds to about a quarter, so five reduce it to about a thousandth.
const HALVINGS: u32 = 5;

/// Returns a lower and an upper bound of the values of a polynomial piece.
pub(super) fn bounds(piece: &Piece) -> [f64; 2] {
    let mut bounds = [f64::INFINITY, f64::NEG_INFINITY];
    widen(&control_points(&scaled(piece)), HALVINGS, &mut bounds);
    bounds
}

/// Returns an upper bound of the absolute second derivative of a polynomial piece, in units per second squared.
pub(super) fn bend(piece: &Piece) -> f64 {
    let second = piece.coefficients.iter().enumerate().skip(2);
    let coefficients: Vec<f64> = second.map(|(power, c)| (power * (power - 1)) as f64 * c).collect();
    if coefficients.is_empty() {
        return 0.0;
    }
    let [least, most] = bounds(&Piece { length: piece.length, coefficients });
    most.max(-least)
}

/// Returns the coefficients of a polynomial piece whose duration is scaled to 1.
fn scaled(piece: &Piece) -> Vec<f64> {
    let seconds = keyframes::seconds(piece.length);
    let mut power = 1.0;
    let scaled = piece.coefficients.iter().map(|c| {
        let scaled = c * power;
        power *= seconds;
        scaled
    });
    scaled.collect()
}

/// Returns the control points of the polynomial of degree n with coefficients c_i: b_j = sum over i of c_i (j over i) / (n over i). `(n
/// over i)` is a binomial coefficient.
fn control_points(coefficients: &[f64]) -> Vec<f64> {
    let degree = coefficients.len().saturating_sub(1);
    let point = |j: usize| {
        let mut share = 1.0;
        let mut sum = 0.0;
        for (i, c) in coefficients.iter().enumerate().take(j + 1) {
            sum += share * c;
            share *= (j - i) as f64 / (degree - i).max(1) as f64;
        }
        sum
    };
    (0..coefficients.len()).map(point).collect()
}

/// Bisects the curve `halvings` times by de Casteljau's algorithm, and extends `bounds` to contain the resulting control points, which
/// are close to the curve.
fn widen(points: &[f64], halvings: u32, bounds: &mut [f64; 2]) {
    if halvings == 0 || points.len() < 3 {
        for point in points {
            *bounds = [bounds[0].min(*point), bounds[1].max(*point)];
        }
        return;
    }
    let mut left = Vec::with_capacity(points.len());
    let mut right = points.to_vec();
    for end in (0..right.len()).rev() {
        left.push(right[0]);
        (0..end).for_each(|index| right[index] = (right[index] + right[index + 1]) / 2.0);
    }
    widen(&left, halvings - 1, bounds);
    widen(&right, halvings - 1, bounds);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piece(seconds: f64, coefficients: &[f64]) -> Piece {
        Piece { length: keyframes::span(seconds).unwrap(), coefficients: coefficients.to_vec() }
    }

    #[test]
    fn bounds_contain_the_curve_and_are_close_to_it() {
        // 4 t (1 - t) + 1 from 0 to 0.75, which includes its maximum.
        let [least, most] = bounds(&piece(0.75, &[1.0, 4.0, -4.0]));
        assert!((least - 1.0).abs() < 1e-12 && (2.0..2.002).contains(&most), "{least} {most}");
        assert_eq!(bounds(&piece(2.0, &[3.0])), [3.0, 3.0]);
        let curve = [0.3, -2.0, 5.0, 1.0, -7.0, 2.0, 1.0, -0.25];
        let [least, most] = bounds(&piece(1.5, &curve));
        let values =
            (0..=3_000).map(|n| curve.iter().rev().fold(0.0, |sum, c| sum * f64::from(n) / 2_000.0 + c));
        let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
        assert!(
            least <= low && low - least < 0.01 && high <= most && most - high < 0.01,
            "{least} {low} {high} {most}"
        );
    }

    #[test]
    fn parabola_has_constant_bend() {
        assert!((bend(&piece(2.0, &[1.0, 4.0, -4.5])) - 9.0).abs() < 1e-12);
        assert_eq!(bend(&piece(2.0, &[1.0, 4.0])), 0.0);
    }
}
