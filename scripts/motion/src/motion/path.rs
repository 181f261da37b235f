//! A smooth path through points in space, as a function of the distance along it.

use std::f64::consts::TAU;
use std::hash::{Hash as _, Hasher as _};

use super::spline::{Cubic, hermite, natural};

/// Number of parts between two points. The coordinates in each part are cubic functions of the distance along the path.
const PARTS: usize = 32;
/// Number of points of a closed path that are repeated before its first and after its last point. The effect of a point on the slope at
/// another one at least halves with each point between them.
const AROUND: usize = 40;
/// Smallest allowed cosine of the angle between the directions at both ends of a part.
const BEND_MIN: f64 = 0.5;
/// Smallest ratio of horizontal speed to speed along the path for which a heading is defined.
const LEVEL_MIN: f64 = 1e-3;
/// Largest change of the heading within a part, in turns. A larger one means that the path is vertical there.
const HEADING_MAX: f64 = 0.25;
/// Nodes and weights of the five-point Gauss-Legendre rule on the interval from -1 to 1 (NIST DLMF, 3.5).
const GAUSS: [(f64, f64); 5] = [
    (-0.906_179_845_938_664, 0.236_926_885_056_189_1),
    (-0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
    (0.0, 0.568_888_888_888_888_9),
    (0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
    (0.906_179_845_938_664, 0.236_926_885_056_189_1),
];

/// A smooth path through points in space, as a function of the distance along it.
///
/// A cubic spline joins the points; its parameter grows by the square root of the distance between two points (Lee 1989, Choosing nodes
/// in parametric curve interpolation). The spline neither stops nor has corners. It is then divided finely. Each part becomes a cubic
/// function of the distance along the path, with the positions and directions of the spline at its ends. Open paths have no curvature at
/// their ends.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// The x, y and z of the points, in metres. The points and `closed` determine all other fields.
    points: Vec<[f64; 3]>,
    closed: bool,
    /// The distance along the path to the start of each part, and to the end of the last one, in metres.
    far: Vec<f64>,
    /// The parts of the path: x, y and z in metres, and the heading in turns.
    parts: Vec<[Cubic; 4]>,
    /// Upper bounds of the first two derivatives of x, y, z and the heading, per metre.
    bounds: [(f64, f64); 4],
    has_heading: bool,
    /// A hash of everything that determines the path.
    digest: [u64; 2],
}

/// The quantity of a path that a device follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Along {
    /// The x coordinate, in metres.
    X,
    /// The y coordinate, in metres.
    Y,
    /// The z coordinate, in metres.
    Z,
    /// The horizontal direction, in turns from x to y. On a closed path, it keeps growing or falling from lap to lap.
    Heading,
}

/// The error of a path that would reverse on the spot at the point with this index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TurnsBack {
    pub point: usize,
}

impl Path {
    /// Creates a path through at least two points; adjacent points must differ. A closed path has at least three points, and returns to
    /// the first.
    ///
    /// # Errors
    /// Returns an error if the path would reverse on the spot.
    pub fn through(points: &[[f64; 3]], closed: bool) -> Result<Self, TurnsBack> {
        let (around, pieces) = if closed { (AROUND, points.len()) } else { (0, points.len() - 1) };
        let count = points.len();
        let all: Vec<[f64; 3]> = if closed {
            (0..=count + 2 * around).map(|index| points[(index + count * around - around) % count]).collect()
        } else {
            points.to_vec()
        };
        let mut times = vec![0.0];
        for pair in all.windows(2) {
            times.push(times[times.len() - 1] + distance(pair[0], pair[1]).sqrt());
        }
        let splines = [0, 1, 2].map(|axis| {
            let values: Vec<f64> = all.iter().map(|point| point[axis]).collect();
            natural(&times, &values)
        });
        let mut laid = Laid::default();
        for piece in 0..pieces {
            laid.add(splines.each_ref().map(|spline| spline[around + piece]), piece)?;
        }
        let Laid { far, parts, is_steep, .. } = laid;
        let bounds = bounds(&far, &parts);
        let digest = digest(points, closed);
        Ok(Self { points: points.to_vec(), closed, far, parts, bounds, has_heading: !is_steep, digest })
    }

    /// The length of the path in metres; for a closed path, the length of one lap.
    pub fn length(&self) -> f64 {
        self.far.last().copied().unwrap_or(0.0)
    }

    /// The distance along the path to one of its points, in metres.
    pub fn far_of(&self, point: usize) -> f64 {
        self.far.get(point * PARTS).copied().unwrap_or_else(|| self.length())
    }

    /// The x, y and z of the points that the path leads through, in metres.
    pub fn points(&self) -> &[[f64; 3]] {
        &self.points
    }

    /// Whether the path returns to its first point.
    pub const fn is_closed(&self) -> bool {
        self.closed
    }

    /// Whether the heading is defined everywhere, because the path is too steep nowhere.
    pub const fn has_heading(&self) -> bool {
        self.has_heading
    }

    /// The value of a quantity at a distance along the path, and its first two derivatives per metre. On a closed path, distances beyond
    /// the length are on further laps.
    pub fn jet(&self, along: Along, metres: f64) -> [f64; 3] {
        let length = self.length();
        let laps = if self.closed { (metres / length).floor() } else { 0.0 };
        let metres = metres - laps * length;
        let part = self.far.partition_point(|far| *far <= metres).clamp(1, self.parts.len()) - 1;
        let whole = self.far[part + 1] - self.far[part];
        let cubic = &self.parts[part][along as usize];
        let [value, slope, bend] = jet(cubic, (metres - self.far[part]) / whole);
        let lapped = if along == Along::Heading { laps * self.turns() } else { 0.0 };
        [value + lapped, slope / whole, bend / (whole * whole)]
    }

    /// The change of the heading from the start to the end of the path, in turns.
    fn turns(&self) -> f64 {
        let ends = self.parts.first().zip(self.parts.last());
        let heading = Along::Heading as usize;
        ends.map_or(0.0, |(first, last)| jet(&last[heading], 1.0)[0] - first[heading][0])
    }

    /// Upper bounds of the first two derivatives of a quantity, per metre.
    pub const fn bounds(&self, along: Along) -> (f64, f64) {
        self.bounds[along as usize]
    }

    /// The ends of the parts between two distances along the path, in metres. If there are many laps, only the first lap, the last lap
    /// and the laps around the middle are included: a body that moves from rest to rest is fastest around the middle.
    pub(super) fn ends(&self, from: f64, to: f64) -> Vec<f64> {
        let length = self.length();
        let lap = |metres: f64| if self.closed { (metres / length).floor() } else { 0.0 };
        let (first, middle, last) = (lap(from), lap(f64::midpoint(from, to)), lap(to));
        let mut laps = vec![first, middle - 1.0, middle, middle + 1.0, last];
        laps.retain(|lap| (first..=last).contains(lap));
        laps.dedup();
        let ends = laps.iter().flat_map(|lap| self.far.iter().map(move |far| lap * length + far));
        ends.filter(|metres| (from..=to).contains(metres)).collect()
    }

    /// A key that distinguishes the path from other paths.
    pub(super) const fn key(&self) -> [u64; 2] {
        self.digest
    }
}

/// A 128-bit hash of everything that determines a path: equal hashes mean equal paths, except for unlikely collisions.
fn digest(points: &[[f64; 3]], closed: bool) -> [u64; 2] {
    [0u8, 1].map(|seed| {
        let mut hasher = std::collections::hash_map::DefaultHasher::new();
        (seed, closed).hash(&mut hasher);
        points.iter().flatten().for_each(|part| part.to_bits().hash(&mut hasher));
        hasher.finish()
    })
}

/// The finished parts of a path that is being created.
#[derive(Default)]
struct Laid {
    far: Vec<f64>,
    parts: Vec<[Cubic; 4]>,
    /// The direction and the heading at the end of the last part.
    last: Option<([f64; 3], f64)>,
    is_steep: bool,
}

impl Laid {
    /// Adds the parts of a piece of the spline. The piece begins at the point with index `point`.
    fn add(&mut self, piece: [Cubic; 3], point: usize) -> Result<(), TurnsBack> {
        if self.far.is_empty() {
            self.far.push(0.0);
        }
        let share = |index: usize| real(index) / real(PARTS);
        for index in 0..PARTS {
            let ends = [share(index), share(index + 1)];
            let length = arc(&piece, ends);
            let [from, to] = ends.map(|s| End::of(&piece, s));
            // In the second half of a piece, it is the next point at which the path reverses.
            let turns_back = TurnsBack { point: point + usize::from(index >= PARTS / 2) };
            let (Some(from), Some(to)) = (from, to) else { return Err(turns_back) };
            let before = self.last.map_or(from.direction, |(direction, _)| direction);
            let bends_little = |a, b| dot(a, b) >= BEND_MIN;
            if !bends_little(before, from.direction) || !bends_little(from.direction, to.direction) {
                return Err(turns_back);
            }
            self.is_steep |= from.is_steep || to.is_steep;
            let heading = self.last.map_or(from.heading, |(_, heading)| nearest_turn(from.heading, heading));
            let next = nearest_turn(to.heading, heading);
            // Within such a small part, the heading only changes this much when the path passes through the vertical.
            self.is_steep |= (next - heading).abs() > HEADING_MAX;
            let axis = |axis: usize| {
                hermite([from.at[axis], to.at[axis]], [from.direction[axis], to.direction[axis]], length)
            };
            let heading = hermite([heading, next], [from.turning, to.turning], length);
            self.parts.push([axis(0), axis(1), axis(2), heading]);
            self.far.push(self.far[self.far.len() - 1] + length);
            self.last = Some((to.direction, next));
        }
        Ok(())
    }
}

/// Position, direction and heading of the path at one end of a part.
struct End {
    at: [f64; 3],
    /// The direction of the path, as a unit vector.
    direction: [f64; 3],
    /// The heading in turns, and its change per metre (`turning`).
    heading: f64,
    turning: f64,
    is_steep: bool,
}

impl End {
    /// Creates the end at the parameter `s` of a piece; `None` if the derivative of the spline is 0 there.
    fn of(piece: &[Cubic; 3], s: f64) -> Option<Self> {
        let [x, y, z] = piece.each_ref().map(|cubic| jet(cubic, s));
        let speed = norm([x[1], y[1], z[1]]);
        let level = x[1].hypot(y[1]);
        // NaN has no direction either.
        if speed.is_nan() || speed <= f64::MIN_POSITIVE {
            return None;
        }
        let is_steep = level < LEVEL_MIN * speed;
        let turning =
            if is_steep { 0.0 } else { (x[1] * y[2] - y[1] * x[2]) / (level * level) / speed / TAU };
        Some(Self {
            at: [x[0], y[0], z[0]],
            direction: [x[1] / speed, y[1] / speed, z[1] / speed],
            heading: y[1].atan2(x[1]) / TAU,
            turning,
            is_steep,
        })
    }
}

/// The length of a piece of the spline between two values of s, in metres.
fn arc(piece: &[Cubic; 3], [from, to]: [f64; 2]) -> f64 {
    let half = (to - from) / 2.0;
    let speed = |s: f64| norm(piece.each_ref().map(|cubic| jet(cubic, s)[1]));
    GAUSS.iter().map(|(place, weight)| weight * speed(from + half * (1.0 + place))).sum::<f64>() * half
}

/// Upper bounds of the first two derivatives of all parts. The second derivative of a cubic is largest at one of its ends. The first
/// derivative is largest at an end or where the second derivative is 0.
fn bounds(far: &[f64], parts: &[[Cubic; 4]]) -> [(f64, f64); 4] {
    let mut bounds = [(0.0_f64, 0.0_f64); 4];
    for (part, ends) in parts.iter().zip(far.windows(2)) {
        let length = ends[1] - ends[0];
        for (cubic, (slope, bend)) in part.iter().zip(&mut bounds) {
            let flat = -cubic[2] / (3.0 * cubic[3]);
            let inner = Some(flat).filter(|s| (0.0..=1.0).contains(s));
            for s in [0.0, 1.0].into_iter().chain(inner) {
                let [_, first, second] = jet(cubic, s);
                (*slope, *bend) =
                    (slope.max((first / length).abs()), bend.max((second / (length * length)).abs()));
            }
        }
    }
    bounds
}

/// The value of a cubic at s, and its first two derivatives.
fn jet(&[a, b, c, d]: &Cubic, s: f64) -> [f64; 3] {
    [a + s * (b + s * (c + s * d)), b + s * (2.0 * c + 3.0 * s * d), 2.0 * c + 6.0 * s * d]
}

/// Returns `heading` plus the whole number of turns that brings it closest to `other`.
fn nearest_turn(heading: f64, other: f64) -> f64 {
    heading + (other - heading).round()
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| a[axis] * b[axis]).sum()
}

fn norm(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    norm(std::array::from_fn(|axis| b[axis] - a[axis]))
}

#[expect(clippy::cast_precision_loss, reason = "a few dozen parts")]
const fn real(count: usize) -> f64 {
    count as f64
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    const AXES: [Along; 3] = [Along::X, Along::Y, Along::Z];

    fn at(path: &Path, metres: f64) -> [f64; 3] {
        AXES.map(|axis| path.jet(axis, metres)[0])
    }

    fn circle(points: usize) -> Path {
        let point = |index: usize| {
            let (sine, cosine) = (TAU * real(index) / real(points)).sin_cos();
            [2.0 * cosine, 2.0 * sine, 1.0]
        };
        Path::through(&(0..points).map(point).collect::<Vec<_>>(), true).unwrap()
    }

    #[test]
    fn closed_path_through_points_of_a_circle_is_that_circle() {
        let path = circle(64);
        assert!((path.length() - 4.0 * PI).abs() < 4e-6, "{}", path.length());
        for index in 0..1_000 {
            // Three laps.
            let metres = real(index) * 0.0377;
            let (sine, cosine) = (metres / 2.0).sin_cos();
            let place = at(&path, metres);
            // The error is less than a millionth of the radius; the relative error of the length is less than a millionth.
            assert!((place[0].hypot(place[1]) - 2.0).abs() < 2e-6, "{place:?}");
            assert!(distance(place, [2.0 * cosine, 2.0 * sine, 1.0]) < 4e-6 * (1.0 + metres), "{place:?}");
            let turns = metres / 2.0 / TAU + 0.25;
            let [heading, turning, _] = path.jet(Along::Heading, metres);
            assert!(
                (heading - turns).abs() < 1e-4 && (turning * TAU - 0.5).abs() < 2e-3,
                "{heading} {turning}"
            );
        }
        assert_eq!(path.bounds(Along::Z), (0.0, 0.0));
        assert!((path.bounds(Along::X).1 - 0.5).abs() < 2e-3);
    }

    #[test]
    fn paths_pass_evenly_through_their_points_and_rates_match_differences() {
        let points = [[0.0, 0.0, 0.0], [1.0, 2.0, 0.5], [4.0, 2.0, 1.0], [4.5, -1.0, 0.0], [2.0, -1.5, 3.0]];
        for closed in [false, true] {
            let path = Path::through(&points, closed).unwrap();
            for (index, point) in points.iter().enumerate() {
                assert!(distance(at(&path, path.far_of(index)), *point) < 1e-9);
            }
            let step = path.length() / 5_000.0;
            for index in 1..4_999 {
                let metres = real(index) * step;
                let gone = distance(at(&path, metres - step / 2.0), at(&path, metres + step / 2.0));
                assert!((gone / step - 1.0).abs() < 1e-3, "{gone} of {step} at {metres}");
                for along in [Along::X, Along::Y, Along::Z, Along::Heading] {
                    let h = 1e-5;
                    let [before, now, after] = [metres - h, metres, metres + h].map(|at| path.jet(along, at));
                    let (slope, bend) = path.bounds(along);
                    assert!((now[1] - (after[0] - before[0]) / (2.0 * h)).abs() < 1e-4);
                    assert!(now[1].abs() <= slope && now[2].abs() <= bend);
                }
            }
        }
    }

    #[test]
    fn vertical_circle_has_no_heading_for_any_choice_of_points() {
        for index in 0..60 {
            let pitch = (0.05 + 0.1 * real(index)).to_radians();
            let point = |index: usize| {
                let angle = TAU * real(index) / 64.0 + pitch;
                [2.0 * angle.cos(), 0.0, 2.0 * angle.sin()]
            };
            let path = Path::through(&(0..64).map(point).collect::<Vec<_>>(), true).unwrap();
            assert!(!path.has_heading(), "{index}");
        }
    }

    #[test]
    fn path_between_almost_identical_points_is_refused() {
        assert!(Path::through(&[[0.0; 3], [1e-200, 0.0, 0.0]], false).is_err());
    }

    #[test]
    fn path_that_turns_back_is_refused_and_vertical_one_has_no_heading() {
        let there_and_back = [[0.0; 3], [1.0, 0.0, 0.0], [0.0; 3]];
        assert_eq!(Path::through(&there_and_back, false), Err(TurnsBack { point: 1 }));
        let up = Path::through(&[[0.0; 3], [0.0, 0.0, 2.0]], false).unwrap();
        assert!(!up.has_heading() && (up.length() - 2.0).abs() < 1e-12);
        let level = Path::through(&[[0.0; 3], [0.0, 2.0, 0.0]], false).unwrap();
        assert!(level.has_heading());
        assert_eq!(level.jet(Along::Heading, 1.0), [0.25, 0.0, 0.0]);
    }
}
