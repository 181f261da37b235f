//! A group that moves as one body: it turns, grows, shifts or follows a path.

use super::along::{Carrier, carrier};
use super::{Axis, Dancer, DancerMovement, Fault, Ground, GroupTask, LEVEL, Sweep};
use crate::formation::{Point, SAME};
use crate::motion::Swept;

/// Returns the movement of each robot when the group moves as one body.
pub(super) fn swept(
    asked: GroupTask<'_>,
    sweep: &Sweep,
    dancers: &[Dancer<'_>],
    ground: Ground<'_>,
) -> Result<Vec<DancerMovement>, Fault> {
    let mut center = middle(dancers);
    let carrier = match &sweep.along {
        Some(course) => Some(carrier(course, dancers, ground)?),
        None => None,
    };
    if let Some((dancer, why)) = left_behind(sweep, carrier.as_ref(), dancers, center[2]) {
        return Err(Fault::Flat { dancer, why: why.to_owned() });
    }
    if let Some([x, y]) = sweep.about {
        (center[0], center[1]) = (x, y);
    }
    let stays = carrier.is_none() && sweep.shift == [0.0; 3];
    if stays && dancers.iter().all(|dancer| is_center(dancer, center, sweep)) {
        return Err(Fault::Unmoved);
    }
    let length = asked.seconds();
    let turning = carrier.as_ref().is_some_and(Carrier::is_turning);
    let moved = |(index, dancer): (usize, &Dancer<'_>)| {
        let mut axes = axes(dancer, center, sweep, turning);
        let carried = carrier.iter().flat_map(|carrier| carrier.carried(index));
        for (swept, carried) in axes.iter_mut().zip(carried) {
            swept.carried = Some(carried);
        }
        DancerMovement { begin: dancer.delay_seconds(), length, axes, error_share: 1.0 }
    };
    let all: Vec<DancerMovement> = dancers.iter().enumerate().map(moved).collect();
    let mut last: Option<Rates> = None;
    let needed = |(moved, dancer): (&DancerMovement, &Dancer<'_>)| {
        let axes = Rates::axes_of(moved);
        let rates = last.take().filter(|rates| rates.axes == axes).unwrap_or_else(|| Rates::of(axes));
        let needed = Needed::of(&rates, dancer, asked, ground);
        last = Some(rates);
        needed
    };
    let times: Vec<Needed> = all.iter().zip(dancers).map(needed).collect();
    let slowest = (0..times.len()).max_by(|a, b| times[*a].shortest.total_cmp(&times[*b].shortest));
    match slowest {
        Some(dancer) if times[dancer].shortest > length * (1.0 + 1e-9) => {
            let seconds = times.iter().map(|needed| needed.sure).fold(0.0, f64::max);
            Err(Fault::TooShort { dancer, seconds })
        }
        _ => Ok(all),
    }
}

/// Largest speed and acceleration of a movement if it lasted 1 s. Robots with equal movements share these values.
struct Rates {
    /// Movements of the coordinates, relative to the place at which the robot begins.
    axes: [Swept; 3],
    body: (f64, f64),
    own: [(f64, f64); 3],
}

impl Rates {
    fn axes_of(moved: &DancerMovement) -> [Swept; 3] {
        let mut axes = moved.axes.clone();
        axes.iter_mut().for_each(|swept| swept.line[0] = 0.0);
        axes
    }

    fn of(axes: [Swept; 3]) -> Self {
        let own = axes.each_ref().map(|swept| Swept::together(std::slice::from_ref(swept)));
        Self { body: Swept::together(&axes), own, axes }
    }
}

/// The duration that a robot needs for its movement, in seconds.
struct Needed {
    shortest: f64,
    /// Duration within which the robot's steps, too, stay within the limits; they can be faster than the movement itself.
    sure: f64,
}

impl Needed {
    fn of(rates: &Rates, dancer: &Dancer<'_>, asked: GroupTask<'_>, ground: Ground<'_>) -> Self {
        let limits = dancer.limits(ground.fleet);
        let (speed, acceleration) = rates.body;
        let own = rates.own.iter().zip(limits.axes);
        let own = own.map(|(rates, limits)| time(rates.0, rates.1, limits)).fold(0.0, f64::max);
        let error = dancer.axes.iter().map(|axis| axis.error(asked.tolerance)).fold(0.0, f64::max);
        // The axes of a body have their steps at different times. Where the body's route bends, the combined mean speed of two
        // overlapping steps exceeds the speed at any moment by about the square root in `stepped`.
        // Steps also end on the grid. With half of the grid, the remaining error allows steps so short that their speed is off by `off`.
        let grid =
            |axis: &Axis<'_>| axis.grid().map_or(0.0, |[scale, _, granularity]| scale.abs() * granularity);
        let moving = || dancer.axes.iter().zip(&rates.axes).filter(|(_, swept)| !swept.is_still());
        let off = moving().map(|(axis, _)| grid(axis) * acceleration).sum::<f64>().sqrt() / 2.0;
        let stepped = speed + (error * acceleration / 2.0).sqrt() + off;
        let [shortest, sure] = [speed, stepped].map(|speed| time(speed, acceleration, limits.body).max(own));
        Self { shortest, sure }
    }
}

/// Whether the robot stays where it is when the group turns and grows, because it is at the centre.
fn is_center(dancer: &Dancer<'_>, center: Point, sweep: &Sweep) -> bool {
    let axes = if sweep.grow == 1.0 || dancer.is_flat() { 2 } else { 3 };
    (0..axes).all(|axis| (dancer.from[axis] - center[axis]).abs() < SAME)
}

/// Returns a robot that cannot follow the group because its height is fixed, and the reason. If all heights are fixed, the group grows
/// only horizontally.
fn left_behind(
    sweep: &Sweep,
    carrier: Option<&Carrier>,
    dancers: &[Dancer<'_>],
    middle: f64,
) -> Option<(usize, &'static str)> {
    let mut flat = (0..dancers.len()).filter(|dancer| dancers[*dancer].is_flat());
    if sweep.shift[2] != 0.0 {
        return Some((flat.next()?, "the group is shifted vertically"));
    }
    if carrier.is_some_and(Carrier::climbs) {
        return Some((flat.next()?, "the path leads up or down"));
    }
    let grows = sweep.grow != 1.0 && dancers.iter().any(|dancer| !dancer.is_flat());
    let off = flat.find(|dancer| grows && (dancers[*dancer].from[2] - middle).abs() > LEVEL)?;
    Some((off, "the group also grows vertically"))
}

/// Returns the shortest duration of a movement within the limits, in seconds. The slope and the curvature are the largest speed and
/// acceleration of the movement if it lasted 1 s.
fn time(slope: f64, curvature: f64, [speed, acceleration]: [f64; 2]) -> f64 {
    (slope / speed).max((curvature / acceleration).sqrt())
}

/// Returns the mean of the places of all robots.
#[expect(clippy::cast_precision_loss, reason = "groups are small")]
fn middle(dancers: &[Dancer<'_>]) -> Point {
    let count = dancers.len().max(1) as f64;
    std::array::from_fn(|axis| dancers.iter().map(|dancer| dancer.from[axis]).sum::<f64>() / count)
}

/// Returns the movements of a body along x, y and z, from its place at the group's start.
fn axes(dancer: &Dancer<'_>, center: Point, sweep: &Sweep, turning: bool) -> [Swept; 3] {
    let from = dancer.from;
    let [x, y, mut z]: Point = std::array::from_fn(|axis| from[axis] - center[axis]);
    if dancer.is_flat() {
        z = 0.0;
    }
    let more = sweep.grow - 1.0;
    let line = |center: f64, shift: f64| [center, shift, 0.0];
    if sweep.turns == 0.0 && !turning {
        let axis = |axis: usize, off: f64| Swept {
            line: [from[axis], more * off + sweep.shift[axis], 0.0],
            ..Swept::default()
        };
        return [axis(0, x), axis(1, y), axis(2, z)];
    }
    let (radius, phase) = (x.hypot(y), y.atan2(x) / std::f64::consts::TAU);
    let about = |axis: usize, phase: f64| Swept {
        line: line(center[axis], sweep.shift[axis]),
        radius: [radius, more * radius],
        phase,
        turns: sweep.turns,
        carried: None,
    };
    let up = Swept { line: [from[2], more * z + sweep.shift[2], 0.0], ..Swept::default() };
    [about(0, phase + 0.25), about(1, phase), up]
}
