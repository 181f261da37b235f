//! Places that are spread evenly along strokes: the lines of letters, or the paths of a drawing.
//!
//! Strokes are cut where they meet. If there are enough places, each end and each meeting point has one. The other places are spread
//! between them so that the largest distance along a stroke is minimal.

use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashMap};

use super::Point;
use super::crowd::{distance, nearest_pair};
use super::spread::thinned;

/// Distance below which two points are equal, as a share of the longest side of the strokes' bounding box.
const SAME: f64 = 1e-5;
/// Maximum number of comparisons of ends with points of strokes in the search for meeting points. Larger drawings are cut only at common
/// ends.
const COMPARISONS_MAX: usize = 20_000_000;

/// Distance below which two places are too close, as a share of the mean distance between places along the strokes.
const CROWDED: f64 = 0.5;
/// Number of sampled points per place, if places would otherwise be too close. The sampled points that are furthest from each other
/// become the places.
const SAMPLES: usize = 16;

/// Strokes that are cut where they meet.
#[derive(Clone, Debug, PartialEq)]
pub struct Strokes {
    /// Ends and meeting points of the strokes.
    knots: Vec<Point>,
    parts: Vec<StrokePart>,
}

/// A line between two knots, or a closed line without knots.
#[derive(Clone, Debug, PartialEq)]
struct StrokePart {
    points: Vec<Point>,
    /// For each point, its distance from the first point along the line.
    far: Vec<f64>,
    ends: Option<[usize; 2]>,
}

/// A part of the strokes while places are distributed, with the distance between neighbouring places on it.
struct Open {
    part: usize,
    gap: f64,
}

impl Strokes {
    /// Builds strokes from polylines. A polyline that ends where it begins is closed; a polyline with a single point is a dot.
    pub fn of(lines: &[Vec<Point>]) -> Self {
        let points: Vec<Point> = lines.iter().flatten().copied().collect();
        let (_, sides) = super::middle_of(&points);
        let near = sides.into_iter().fold(0.0, f64::max) * SAME;
        let mut knots = Knots { near: near.max(f64::MIN_POSITIVE), all: Vec::new(), cells: HashMap::new() };
        let lines: Vec<Vec<Point>> = lines.iter().map(|line| without_repeats(line, near)).collect();
        let is_closed = |line: &[Point]| {
            line.len() > 2 && line.first().zip(line.last()).is_some_and(|(a, b)| distance(*a, *b) <= near)
        };
        for line in lines.iter().filter(|line| !is_closed(line)) {
            for end in line.first().into_iter().chain(line.last()) {
                knots.of(*end);
            }
        }
        let length: usize = lines.iter().map(Vec::len).sum();
        let thorough = length.saturating_mul(knots.all.len()) <= COMPARISONS_MAX;
        let mut parts = Vec::new();
        for line in lines.iter().filter(|line| line.len() > 1) {
            let line = if thorough { with_knots(line, &knots) } else { line.clone() };
            cut(&line, &mut knots, is_closed(&line), &mut parts);
        }
        Self { knots: knots.all, parts }
    }

    pub(super) fn places(&self, count: usize) -> Vec<Point> {
        let nearest = |places: &[Point]| nearest_pair(places).map_or(f64::INFINITY, |pair| pair.distance);
        let mut places = self.along(count);
        let mut far = nearest(&places);
        if let Some(regular) = self.with_all_knots(count)
            && nearest(&regular) >= far
        {
            (far, places) = (nearest(&regular), regular);
        }
        // Places may be close because strokes cross or are parallel, or because there are fewer places than ends.
        if far < CROWDED * self.length() / real(count.max(1)) {
            let apart = thinned(&self.along(SAMPLES * count), count);
            if nearest(&apart) > far {
                return apart;
            }
        }
        places
    }

    fn length(&self) -> f64 {
        self.parts.iter().map(StrokePart::length).sum()
    }

    /// Returns one place at each knot, and the other places between knots. `None` if there are fewer places than knots.
    fn with_all_knots(&self, count: usize) -> Option<Vec<Point>> {
        let mut left = count.checked_sub(self.knots.len())?;
        let mut inner = vec![0usize; self.parts.len()];
        let gap = |part: &StrokePart, inner: usize| match (part.ends, inner) {
            (Some(_), inner) => part.length() / real(inner + 1),
            // A closed line without a place has priority.
            (None, 0) => 2.0 * part.length(),
            (None, inner) => part.length() / real(inner),
        };
        let mut open: BinaryHeap<Open> =
            self.parts.iter().enumerate().map(|(part, of)| Open { part, gap: gap(of, 0) }).collect();
        while left > 0 {
            let Open { part, .. } = open.pop()?;
            inner[part] += 1;
            left -= 1;
            open.push(Open { part, gap: gap(&self.parts[part], inner[part]) });
        }
        let mut places = Vec::with_capacity(count);
        let mut placed = vec![false; self.knots.len()];
        let mut knot = |places: &mut Vec<Point>, knot: usize| {
            if !std::mem::replace(&mut placed[knot], true) {
                places.push(self.knots[knot]);
            }
        };
        for (part, &inner) in self.parts.iter().zip(&inner) {
            match part.ends {
                Some([from, to]) => {
                    knot(&mut places, from);
                    let step = part.length() / real(inner + 1);
                    places.extend((1..=inner).map(|index| part.at(step * real(index))));
                    knot(&mut places, to);
                }
                None => {
                    let step = part.length() / real(inner.max(1));
                    places.extend((0..inner).map(|index| part.at(step * real(index))));
                }
            }
        }
        (0..self.knots.len()).for_each(|index| knot(&mut places, index));
        Some(places)
    }

    /// Spreads places evenly along all parts, one part after another, regardless of their ends.
    fn along(&self, count: usize) -> Vec<Point> {
        let length = self.length();
        if length <= 0.0 {
            let first = self.knots.first().copied().unwrap_or_default();
            return (0..count).map(|index| self.knots.get(index).copied().unwrap_or(first)).collect();
        }
        let step = length / real(count.max(1));
        let (mut part, mut before) = (0, 0.0);
        let place = |index: usize| {
            let far = step * (real(index) + 0.5);
            while part + 1 < self.parts.len() && far > before + self.parts[part].length() {
                before += self.parts[part].length();
                part += 1;
            }
            self.parts[part].at(far - before)
        };
        (0..count).map(place).collect()
    }
}

#[expect(clippy::cast_precision_loss, reason = "there are few places")]
const fn real(count: usize) -> f64 {
    count as f64
}

impl StrokePart {
    fn length(&self) -> f64 {
        self.far.last().copied().unwrap_or(0.0)
    }

    /// Returns the point at the distance `far` from the first point along the line.
    fn at(&self, far: f64) -> Point {
        let next = self.far.partition_point(|at| *at < far).clamp(1, self.points.len() - 1);
        let (from, to) = (self.far[next - 1], self.far[next]);
        let share = ((far - from) / (to - from)).clamp(0.0, 1.0);
        let (a, b) = (self.points[next - 1], self.points[next]);
        std::array::from_fn(|axis| a[axis] + share * (b[axis] - a[axis]))
    }
}

/// Ends and meeting points of strokes, without duplicates.
struct Knots {
    near: f64,
    all: Vec<Point>,
    cells: HashMap<[i64; 3], Vec<usize>>,
}

impl Knots {
    #[expect(clippy::cast_possible_truncation, reason = "saturates, and points so far out are refused")]
    fn cell(&self, point: Point) -> [i64; 3] {
        point.map(|part| (part / self.near).floor() as i64)
    }

    fn found(&self, point: Point) -> Option<usize> {
        let cell = self.cell(point);
        let nearby = (0..27i64).map(|number| {
            let step = [number % 3, number / 3 % 3, number / 9];
            std::array::from_fn::<i64, 3, _>(|axis| cell[axis].saturating_add(step[axis] - 1))
        });
        let mut known = nearby.filter_map(|cell| self.cells.get(&cell)).flatten().copied();
        known.find(|index| distance(self.all[*index], point) <= self.near)
    }

    fn of(&mut self, point: Point) -> usize {
        self.found(point).unwrap_or_else(|| {
            self.cells.entry(self.cell(point)).or_default().push(self.all.len());
            self.all.push(point);
            self.all.len() - 1
        })
    }
}

fn without_repeats(line: &[Point], near: f64) -> Vec<Point> {
    let mut kept: Vec<Point> = Vec::with_capacity(line.len());
    for point in line {
        if kept.last().is_none_or(|last| distance(*last, *point) > near) {
            kept.push(*point);
        }
    }
    kept
}

/// Adds points to the line wherever it passes a knot.
fn with_knots(line: &[Point], knots: &Knots) -> Vec<Point> {
    let mut with = vec![line[0]];
    for pair in line.windows(2) {
        let (a, b) = (pair[0], pair[1]);
        let whole = distance(a, b);
        let mut between: Vec<(f64, Point)> = Vec::new();
        for knot in &knots.all {
            let dot: f64 = (0..3).map(|axis| (knot[axis] - a[axis]) * (b[axis] - a[axis])).sum();
            let far = dot / whole;
            let foot: Point = std::array::from_fn(|axis| a[axis] + far / whole * (b[axis] - a[axis]));
            if far > knots.near && far < whole - knots.near && distance(foot, *knot) <= knots.near {
                between.push((far, *knot));
            }
        }
        between.sort_by(|a, b| a.0.total_cmp(&b.0));
        with.extend(between.into_iter().map(|(_, knot)| knot));
        with.push(b);
    }
    with
}

/// Cuts a line at its knots, and adds the resulting parts to `parts`. A closed line begins at its first knot.
fn cut(line: &[Point], knots: &mut Knots, closed: bool, parts: &mut Vec<StrokePart>) {
    let mut line = line.to_vec();
    if closed {
        match line.iter().position(|point| knots.found(*point).is_some()) {
            None => return parts.push(StrokePart::of(line, None)),
            Some(begin) => {
                line.pop();
                let turn = begin % line.len().max(1);
                line.rotate_left(turn);
                line.push(line[0]);
            }
        }
    }
    let mut from = (0, knots.of(line[0]));
    for index in 1..line.len() {
        if let Some(to) = knots.found(line[index]) {
            parts.push(StrokePart::of(line[from.0..=index].to_vec(), Some([from.1, to])));
            from = (index, to);
        }
    }
}

impl StrokePart {
    fn of(points: Vec<Point>, ends: Option<[usize; 2]>) -> Self {
        let mut far = vec![0.0];
        for pair in points.windows(2) {
            far.push(far[far.len() - 1] + distance(pair[0], pair[1]));
        }
        Self { points, far, ends }
    }
}

impl PartialEq for Open {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Open {}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Open {
    /// The part with the largest gap is the greatest; for equal gaps, the one with the lower index.
    fn cmp(&self, other: &Self) -> Ordering {
        self.gap.total_cmp(&other.gap).then(other.part.cmp(&self.part))
    }
}
