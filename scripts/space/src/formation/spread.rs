//! Selects a few of many points, as far from each other as possible, or spreads points over a surface, evenly by area.

use super::Point;
use super::crowd::distance;

/// Approximate maximum number of comparisons of points.
const COMPARISONS_MAX: usize = 200_000_000;
/// Number of points that are sampled on a surface for each place, and the minimum and maximum number of sampled points in total.
const SAMPLES: (usize, usize, usize) = (32, 2_000, 100_000);

/// A triangle of a surface, given by its corners.
pub type Triangle = [Point; 3];

/// Selects `count` points. Each one is the point that is furthest from all points selected before. No two of them are closer to each
/// other than half of the optimum (Gonzalez, Theor. Comput. Sci. 38, 1985).
pub(super) fn thinned(points: &[Point], count: usize) -> Vec<Point> {
    if count >= points.len() || count == 0 {
        return points.iter().copied().take(count).collect();
    }
    let most = (COMPARISONS_MAX / count).max(count);
    let every = points.len().div_ceil(most);
    let mut left: Vec<(Point, f64)> =
        points.iter().step_by(every).map(|point| (*point, f64::INFINITY)).collect();
    let (middle, _) = super::middle_of(points);
    let mut chosen = Vec::with_capacity(count);
    // The first place is the point that is furthest from the middle.
    let mut next = furthest(left.iter().map(|(point, _)| distance(*point, middle)));
    while chosen.len() < count && !left.is_empty() {
        let (place, _) = left.swap_remove(next);
        chosen.push(place);
        for (point, far) in &mut left {
            *far = far.min(distance(*point, place));
        }
        next = furthest(left.iter().map(|(_, far)| *far));
    }
    chosen
}

fn furthest(far: impl Iterator<Item = f64>) -> usize {
    far.enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(index, _)| index)
}

/// Returns `count` places that are spread over a surface.
pub(super) fn over(surface: &[Triangle], count: usize) -> Vec<Point> {
    let (each, least, most) = SAMPLES;
    thinned(&samples(surface, count.saturating_mul(each).clamp(least, most)), count)
}

/// Returns `count` points of a surface, one for each equal part of its area. Their positions within triangles follow the sequence R2
/// (Roberts 2018): the multiples of the powers of one over the plastic number.
#[expect(clippy::cast_precision_loss, reason = "there are few points")]
fn samples(surface: &[Triangle], count: usize) -> Vec<Point> {
    const PLASTIC: f64 = 1.324_717_957_244_746;
    let areas: Vec<f64> = surface.iter().map(area).collect();
    let whole: f64 = areas.iter().sum();
    let (mut triangle, mut before) = (0, 0.0);
    let sample = |index: usize| {
        let at = (index as f64 + 0.5) / count as f64 * whole;
        while triangle + 1 < surface.len() && at > before + areas[triangle] {
            before += areas[triangle];
            triangle += 1;
        }
        let [mut u, mut v] = [PLASTIC, PLASTIC * PLASTIC].map(|base| (0.5 + index as f64 / base).fract());
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        let [a, b, c] = surface[triangle];
        std::array::from_fn(|axis| a[axis] + u * (b[axis] - a[axis]) + v * (c[axis] - a[axis]))
    };
    (0..count).map(sample).collect()
}

/// Returns the area of a triangle in square metres.
pub fn area([a, b, c]: &Triangle) -> f64 {
    let side = |to: &Point| -> Point { std::array::from_fn(|axis| to[axis] - a[axis]) };
    let (p, q) = (side(b), side(c));
    let cross = [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
    distance(cross, [0.0; 3]) / 2.0
}
