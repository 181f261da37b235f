//! The path of a body through an act: a polyline over time in x, y, z, yaw and the values of the body's joints.

use urrcp::{ControlType, Interpolation, Millis, Script};

use super::Coordinate;
use super::place::Place;

/// A time in seconds since the act's start, and the value then. Two values at the same time are a jump.
type Point = (f64, f64);

/// One coordinate over an act.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Points in order of time, at least one.
    points: Vec<Point>,
    /// Largest error of a value: the deviation of the device's steps from the movement as written.
    error: f64,
}

/// The movement of one device in an act.
pub struct Played<'a> {
    /// Scripts of the device, each with its start time relative to the start of the act.
    pub scripts: &'a [(Millis, &'a Script)],
    /// Control type of all steps; a step of another type makes the coordinate unknown.
    pub control_type: ControlType,
    /// How the device moves between two steps.
    pub interpolation: Interpolation,
    /// Position of the device at the act's start; `None` if it is unknown.
    pub begin: Option<f64>,
    /// Largest deviation of the device's steps from the movement as written, in the device's unit.
    pub error: f64,
}

/// The default is no movement, under position control.
impl Default for Played<'_> {
    fn default() -> Self {
        let control_type = ControlType::Position;
        Self { scripts: &[], control_type, interpolation: Interpolation::default(), begin: None, error: 0.0 }
    }
}

impl Axis {
    /// Returns the largest absolute value of the coordinate.
    pub fn largest(&self) -> f64 {
        self.points.iter().map(|(_, value)| value.abs()).fold(0.0, f64::max)
    }

    /// Creates an axis that is linear between `points`, which are in order of time and at least one.
    pub(super) fn through(points: Vec<Point>) -> Self {
        Self { points, error: 0.0 }
    }

    /// Returns a coordinate over the act. `None` if it is never known: the device's position is unknown, or a step has another control
    /// type.
    pub fn of(coordinate: &Coordinate, played: &Played<'_>) -> Option<Self> {
        let (scale, offset) = match coordinate {
            Coordinate::Fixed(value) => return Some(Self { points: vec![(0.0, *value)], error: 0.0 }),
            Coordinate::Device { scale, offset, .. } => (*scale, *offset),
        };
        let mut points: Vec<Point> = played.begin.map(|begin| (0.0, begin)).into_iter().collect();
        let linear = played.interpolation == Interpolation::Linear;
        for (start, script) in played.scripts {
            // Overlapping cues are reported elsewhere; in this computation, time never decreases.
            let not_before = points.last().map_or(0.0, |(at, _)| *at);
            let start = (start.get() / 1_000.0).max(not_before);
            // The device keeps its value until the script starts.
            points.extend(points.last().map(|(_, last)| (start, *last)));
            for step in script.steps() {
                if step.setpoint.control_type != played.control_type {
                    return None;
                }
                let at = start + step.offset.get() / 1_000.0;
                if !linear {
                    points.extend(points.last().map(|(_, last)| (at, *last)));
                }
                points.push((at, step.setpoint.value));
            }
        }
        points.dedup();
        points.iter_mut().for_each(|(_, value)| *value = offset + scale * *value);
        (!points.is_empty()).then_some(Self { points, error: played.error * scale.abs() })
    }

    fn known_from(&self) -> f64 {
        self.points[0].0
    }

    /// Returns the mean speed between each two values. An instantaneous change counts as a movement since the previous value.
    fn speeds(&self) -> Vec<Stretch> {
        let ends = self.points.iter().enumerate();
        let last_of_its_time =
            |(index, point): &(usize, &Point)| self.points.get(index + 1).is_none_or(|next| next.0 > point.0);
        let values: Vec<Point> = ends.filter(last_of_its_time).map(|(_, point)| *point).collect();
        let way = |pair: &[Point]| {
            let took = pair[1].0 - pair[0].0;
            Stretch {
                from: pair[0].0,
                to: pair[1].0,
                rate: (pair[1].1 - pair[0].1) / took,
                doubt: 2.0 * self.error / took,
            }
        };
        values.windows(2).map(way).collect()
    }
}

/// An interval in which a coordinate changes at a constant rate.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stretch {
    from: f64,
    to: f64,
    rate: f64,
    /// Possible error of the rate, because steps deviate from the movement as written.
    doubt: f64,
}

impl Stretch {
    fn middle(&self) -> f64 {
        f64::midpoint(self.from, self.to)
    }
}

/// Returns, for each two adjacent intervals, the change of speed divided by the mean of their lengths: the second divided difference.
fn changes(speeds: &[Stretch]) -> Vec<Stretch> {
    let change = |pair: &[Stretch]| {
        let (from, to) = (pair[0].middle(), pair[1].middle());
        Stretch {
            from,
            to,
            rate: (pair[1].rate - pair[0].rate) / (to - from),
            doubt: (pair[0].doubt + pair[1].doubt) / (to - from),
        }
    };
    speeds.windows(2).map(change).collect()
}

/// The largest speed or acceleration of a body's middle, and when it occurs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peak {
    /// Start of the interval with this rate, in seconds since the act's start.
    pub from: f64,
    /// End of the interval with this rate, in seconds since the act's start.
    pub to: f64,
    /// Lower bound on the rate of the written movement: steps that deviate from it may have a larger rate.
    pub rate: f64,
}

/// Returns the largest speed and the largest acceleration, over x, y and z together.
pub fn peaks(axes: &[Axis]) -> [Option<Peak>; 2] {
    let speeds: [Vec<Stretch>; 3] = std::array::from_fn(|i| axes[i].speeds());
    let accelerations = speeds.each_ref().map(|speeds| changes(speeds));
    [largest(&speeds), largest(&accelerations)]
}

fn largest(rates: &[Vec<Stretch>; 3]) -> Option<Peak> {
    let mut ends: Vec<f64> = rates.iter().flatten().flat_map(|stretch| [stretch.from, stretch.to]).collect();
    ends.sort_by(f64::total_cmp);
    ends.dedup();
    let mut next = [0; 3];
    let mut peak: Option<Peak> = None;
    for pair in ends.windows(2) {
        let mut squares = 0.0;
        for (rates, next) in rates.iter().zip(&mut next) {
            while rates.get(*next).is_some_and(|stretch| stretch.to <= pair[0]) {
                *next += 1;
            }
            let known = rates.get(*next).filter(|stretch| stretch.from <= pair[0]);
            squares += known.map_or(0.0, |stretch| (stretch.rate.abs() - stretch.doubt).max(0.0).powi(2));
        }
        if peak.is_none_or(|peak| squares.sqrt() > peak.rate) {
            peak = Some(Peak { from: pair[0], to: pair[1], rate: squares.sqrt() });
        }
    }
    peak
}

/// Visits the values of all axes whenever one of them has a point, starting at `from`: first the values just before that moment, then
/// those just after it.
pub(super) fn moments(axes: &[Axis], from: f64, mut visit: impl FnMut(f64, &[f64])) {
    let mut times: Vec<f64> = axes.iter().flat_map(|axis| &axis.points).map(|point| point.0).collect();
    times.retain(|at| *at >= from);
    times.push(from);
    times.sort_by(f64::total_cmp);
    times.dedup();
    let mut cursors: Vec<Cursor<'_>> =
        axes.iter().map(|axis| Cursor { points: &axis.points, next: 0 }).collect();
    let [mut before, mut after] = [(); 2].map(|()| vec![0.0; axes.len()]);
    for at in times {
        for (cursor, values) in cursors.iter_mut().zip(before.iter_mut().zip(&mut after)) {
            (*values.0, *values.1) = cursor.advance(at);
        }
        visit(at, &before);
        visit(at, &after);
    }
}

/// The place of a body at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct Knot {
    /// Time in seconds since the act's start.
    pub at: f64,
    /// Place of the body at this time.
    pub place: Place,
}

/// The places of a body, from the moment at which all its coordinates are known.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// Knots in order of time, at least one; two knots at the same time are a jump.
    knots: Vec<Knot>,
}

impl Path {
    /// Creates the path of a body from `axes`: x, y, z, yaw and the joints. `sure` is whether the place at the act's start is certain; a
    /// jump from it is then a movement as well.
    pub fn of(axes: &[Axis], sure: bool) -> Self {
        let from = axes.iter().map(Axis::known_from).fold(0.0, f64::max);
        let mut knots: Vec<Knot> = Vec::new();
        moments(axes, from, |at, values| {
            if knots.last().is_none_or(|last| last.at < at || !last.place.has(values)) {
                knots.push(Knot { at, place: Place::from_values(values) });
            }
        });
        if from > 0.0 || !sure {
            // Nothing was known before the first moment, so no movement leads to it.
            let first = knots.iter().take_while(|knot| knot.at == from).count();
            knots.drain(..first.saturating_sub(1));
        }
        Self { knots }
    }

    /// Creates the path of a stationary body until `ends`, in seconds.
    pub fn resting(place: Place, ends: f64) -> Self {
        Self { knots: vec![Knot { at: 0.0, place: place.clone() }, Knot { at: ends, place }] }
    }

    /// Returns the time from which the body's place is known, in seconds.
    pub fn known_from(&self) -> f64 {
        self.knots[0].at
    }

    /// Returns the time of the last knot.
    pub fn ends(&self) -> f64 {
        self.knots[self.knots.len() - 1].at
    }

    /// Returns the knots in order of time.
    pub fn knots(&self) -> &[Knot] {
        &self.knots
    }

    /// Returns the knots from `from` to `to`, and knots at these two times.
    pub(super) fn within(&self, from: f64, to: f64) -> impl Iterator<Item = Knot> + '_ {
        let first = self.knots.partition_point(|knot| knot.at < from);
        let last = self.knots.partition_point(|knot| knot.at <= to);
        let end = |at, index| Knot { at, place: between(&self.knots, at, index) };
        let begin = (self.knots.get(first).is_none_or(|knot| knot.at > from)).then(|| end(from, first));
        let finish = (last == 0 || self.knots[last - 1].at < to).then(|| end(to, last));
        begin.into_iter().chain(self.knots[first..last].iter().cloned()).chain(finish)
    }
}

/// The places of two bodies at one moment.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Both {
    pub(super) at: f64,
    pub(super) places: [Place; 2],
}

/// Returns the moments between `from` and `to` at which one of two bodies has a knot, including both ends. Between two moments, both
/// bodies move linearly.
pub(super) fn together(a: &Path, b: &Path, from: f64, to: f64) -> Vec<Both> {
    let mut paths = [a, b].map(|path| path.within(from, to).collect::<Vec<Knot>>());
    if from > to || paths.iter().any(Vec::is_empty) {
        return Vec::new();
    }
    let mut times: Vec<f64> = paths.iter().flatten().map(|knot| knot.at).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let mut moments: Vec<Both> = Vec::with_capacity(times.len());
    for at in times {
        let [a, b] = paths.each_mut().map(|knots| Sides::at(knots, at));
        for places in [[a.before, b.before], [a.after, b.after]] {
            if moments.last().is_none_or(|last| last.at < at || last.places != places) {
                moments.push(Both { at, places });
            }
        }
    }
    moments
}

/// The places of a body just before a moment and just after it.
struct Sides {
    before: Place,
    after: Place,
}

impl Sides {
    /// Returns the places at the time `at`, which `knots` must cover. Removes knots that later times do not need.
    fn at(knots: &mut Vec<Knot>, at: f64) -> Self {
        let first = knots.partition_point(|knot| knot.at < at);
        let last = knots.partition_point(|knot| knot.at <= at);
        let sides = if first < last {
            Self { before: knots[first].place.clone(), after: knots[last - 1].place.clone() }
        } else {
            let place = between(knots, at, first);
            Self { before: place.clone(), after: place }
        };
        knots.drain(..first.saturating_sub(1));
        sides
    }
}

/// Returns the place at the time `at`, which is between the knot at `index` and the previous one.
fn between(knots: &[Knot], at: f64, index: usize) -> Place {
    let (Some(before), after) = (index.checked_sub(1), knots.get(index)) else {
        return knots[0].place.clone();
    };
    let before = &knots[before];
    let Some(after) = after else { return before.place.clone() };
    before.place.towards(&after.place, (at - before.at) / (after.at - before.at))
}

/// Iterates over the points of an axis in order of time.
struct Cursor<'a> {
    points: &'a [Point],
    /// Index of the first point that is not before the last requested time.
    next: usize,
}

impl Cursor<'_> {
    /// Returns the value just before a time and the value just after it. Requested times must not decrease.
    fn advance(&mut self, at: f64) -> (f64, f64) {
        while self.points.get(self.next).is_some_and(|point| point.0 < at) {
            self.next += 1;
        }
        let before = self.next.checked_sub(1).map(|index| self.points[index]);
        let (Some(next), Some(before)) =
            (self.points.get(self.next), before.or(self.points.first().copied()))
        else {
            let last = self.points[self.points.len() - 1].1;
            return (last, last);
        };
        if next.0 > at {
            let share = if next.0 > before.0 { (at - before.0) / (next.0 - before.0) } else { 0.0 };
            let value = before.1 + share * (next.1 - before.1);
            return (value, value);
        }
        let same = self.points[self.next..].iter().take_while(|point| point.0 == at);
        (next.1, same.last().map_or(next.1, |point| point.1))
    }
}
