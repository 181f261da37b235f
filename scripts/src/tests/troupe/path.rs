//! A path that is approximated by a large number of places.

use super::{Path, PathShape, Point};

/// Number of parts into which a circle, or the section between two points, is divided.
const PARTS: usize = 4_000;

/// Places along a path, each with its distance along the path from the path's start.
pub(super) struct Laid {
    places: Vec<(f64, Point)>,
    /// Whether the path is a circle, and the distances are angles in degrees.
    is_circle: bool,
}

fn distance(a: Point, b: Point) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

/// Returns the second derivatives of a natural cubic spline at its knots, by successive elimination of all unknowns.
fn bends(times: &[f64], values: &[f64]) -> Vec<f64> {
    let count = times.len();
    let mut rows = vec![vec![0.0; count + 1]; count];
    for (index, row) in rows.iter_mut().enumerate() {
        if index == 0 || index == count - 1 {
            row[index] = 1.0;
            continue;
        }
        let (before, after) = (times[index] - times[index - 1], times[index + 1] - times[index]);
        (row[index - 1], row[index], row[index + 1]) = (before, 2.0 * (before + after), after);
        let slope = |from: usize, to: usize| (values[to] - values[from]) / (times[to] - times[from]);
        row[count] = 6.0 * (slope(index, index + 1) - slope(index - 1, index));
    }
    for pivot in 0..count {
        let scale = rows[pivot][pivot];
        rows[pivot].iter_mut().for_each(|part| *part /= scale);
        for other in (0..count).filter(|other| *other != pivot) {
            let factor = rows[other][pivot];
            let own = rows[pivot].clone();
            rows[other].iter_mut().zip(own).for_each(|(part, own)| *part -= factor * own);
        }
    }
    rows.iter().map(|row| row[count]).collect()
}

impl Path {
    /// Returns the places along the path, rotated and scaled about the origin. The centre does not matter, because only differences
    /// between places are used.
    pub(super) fn laid(&self) -> Laid {
        let (sine, cosine) = (self.rotate as f64).to_radians().sin_cos();
        let scale = self.scale as f64 / 1_000.0;
        let place =
            |[x, y, z]: Point| [x * cosine - y * sine, x * sine + y * cosine, z].map(|part| part * scale);
        let all: Vec<Point> = match &self.shape {
            PathShape::Circle(radius) => (0..=PARTS)
                .map(|part| {
                    let (y, x) = (std::f64::consts::TAU * part as f64 / PARTS as f64).sin_cos();
                    [x, y, 0.0].map(|part| part * *radius as f64 / 1_000.0)
                })
                .collect(),
            PathShape::Points(points) => {
                let points: Vec<Point> =
                    points.iter().map(|point| point.map(|part| part as f64 / 1_000.0)).collect();
                splined(&points)
            }
        };
        let (mut far, mut before) = (0.0, None);
        let place = |point: Point| {
            let point = place(point);
            far += before.map_or(0.0, |before| distance(before, point));
            before = Some(point);
            (far, point)
        };
        Laid {
            places: all.into_iter().map(place).collect(),
            is_circle: matches!(self.shape, PathShape::Circle(_)),
        }
    }
}

/// Returns points of a spline whose parameter is the sum of the square roots of the distances between points.
fn splined(points: &[Point]) -> Vec<Point> {
    let mut times = vec![0.0];
    for pair in points.windows(2) {
        times.push(times[times.len() - 1] + distance(pair[0], pair[1]).sqrt());
    }
    let values = |axis: usize| points.iter().map(|point| point[axis]).collect::<Vec<_>>();
    let bends = [0, 1, 2].map(|axis| bends(&times, &values(axis)));
    let mut all = Vec::new();
    for index in 0..points.len() - 1 {
        let length = times[index + 1] - times[index];
        for part in 0..PARTS {
            let b = part as f64 / PARTS as f64;
            let a = 1.0 - b;
            all.push(std::array::from_fn(|axis| {
                let bend = (a.powi(3) - a) * bends[axis][index] + (b.powi(3) - b) * bends[axis][index + 1];
                a * points[index][axis] + b * points[index + 1][axis] + bend * length * length / 6.0
            }));
        }
    }
    all.push(points[points.len() - 1]);
    all
}

impl Laid {
    /// Returns the displacement from the first place when a share of all laps has passed, and the change of the heading in degrees.
    pub(super) fn gone(&self, share: f64, laps: i64) -> (Point, f64) {
        let length = self.places[self.places.len() - 1].0;
        let far = share * length * laps as f64;
        let within = if share == 1.0 { length } else { far % length };
        let after = self.places.partition_point(|(at, _)| *at < within).clamp(1, self.places.len() - 1);
        let ((a, from), (b, to)) = (self.places[after - 1], self.places[after]);
        let part = if b > a { (within - a) / (b - a) } else { 0.0 };
        let start = self.places[0].1;
        let gone = std::array::from_fn(|axis| from[axis] + (to[axis] - from[axis]) * part - start[axis]);
        let turned =
            if self.is_circle { 360.0 * share * laps as f64 } else { self.heading(after) - self.heading(1) };
        (gone, turned)
    }

    /// Returns the heading over the ground, in degrees, in the section that ends at place `after`.
    fn heading(&self, after: usize) -> f64 {
        let (from, to) = (self.places[after - 1].1, self.places[after].1);
        (to[1] - from[1]).atan2(to[0] - from[0]).to_degrees()
    }
}
