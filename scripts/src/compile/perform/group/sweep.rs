//! A group that turns, grows, shifts and is carried as one.

use super::along::Carrier;
use super::{Dancer, Ground, LEVEL, Moved, Performer};
use crate::compile::check_formations::SAME;
use crate::finding::Code;
use crate::formation::Point;
use crate::motion::Swept;
use crate::scenario::{Sweep, Together};

impl Performer<'_, '_> {
    /// How each robot moves with the group.
    pub(super) fn swept(
        &mut self,
        group: &Together,
        sweep: &Sweep,
        dancers: &[Dancer<'_>],
        tolerance: Option<f64>,
        ground: &Ground<'_>,
    ) -> Option<Vec<Moved>> {
        let mut center = middle(dancers)?;
        let carrier = match &sweep.along {
            Some(course) => Some(self.carrier(group, course, dancers, ground)?),
            None => None,
        };
        if let Some((dancer, what)) = left_behind(sweep, carrier.as_ref(), dancers, center[2]) {
            self.tell_flat(group, what, dancer.member.robot);
            return None;
        }
        if let Some([x, y]) = sweep.about {
            (center[0], center[1]) = (x, y);
        }
        let stays = carrier.is_none() && sweep.shift == [0.0; 3];
        if stays && dancers.iter().all(|dancer| is_center(dancer.from, center, sweep)) {
            self.tell_unmoved(group);
            return None;
        }
        let length = group.over.as_millis_f64() / 1_000.0;
        let moved = |(index, dancer): (usize, &Dancer<'_>)| {
            let mut axes =
                axes(dancer.from, center, sweep, carrier.as_ref().is_some_and(Carrier::is_turning));
            for (swept, carried) in
                axes.iter_mut().zip(carrier.iter().flat_map(|carrier| carrier.carried(index)))
            {
                swept.carried = Some(carried);
            }
            Moved { begin: dancer.member.delay.as_millis_f64() / 1_000.0, length, axes }
        };
        let all: Vec<Moved> = dancers.iter().enumerate().map(moved).collect();
        let needed = |(moved, dancer): (&Moved, &Dancer<'_>)| {
            let limits = self.limits(dancer);
            let (speed, acceleration) = Swept::together(&moved.axes);
            let own = moved.axes.iter().zip(limits.axes);
            let own = own
                .map(|(swept, limits)| time(Swept::together(std::slice::from_ref(swept)), limits))
                .fold(0.0, f64::max);
            let error = dancer.axes.iter().map(|axis| axis.error(tolerance)).fold(0.0, f64::max);
            // The axes of a body have their steps at different times. Where its way bends, the mean speeds of two steps that overlap
            // are then higher together than the speed at any moment, by about so much.
            let stepped = (speed + (error * acceleration / 2.0).sqrt(), acceleration);
            let [shortest, sure] =
                [(speed, acceleration), stepped].map(|whole| time(whole, limits.body).max(own));
            (shortest, sure, dancer.member.robot)
        };
        let times: Vec<(f64, f64, usize)> = all.iter().zip(dancers).map(needed).collect();
        let sure = times.iter().map(|(_, sure, _)| *sure).fold(0.0, f64::max);
        let (shortest, _, robot) = times.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        if shortest > length * (1.0 + 1e-9) {
            self.tell_too_short(group, robot, sure, Code::BodyTooFast);
            return None;
        }
        Some(all)
    }
}

/// Whether turning and growing leave it where it is: it stands in the middle.
fn is_center(from: Point, center: Point, sweep: &Sweep) -> bool {
    let axes = if sweep.grow == 1.0 { 2 } else { 3 };
    (0..axes).all(|axis| (from[axis] - center[axis]).abs() < SAME)
}

/// A robot that cannot follow, because it cannot change its height. Where none can, a group grows on its level.
fn left_behind<'d, 'a>(
    sweep: &Sweep,
    carrier: Option<&Carrier>,
    dancers: &'d [Dancer<'a>],
    middle: f64,
) -> Option<(&'d Dancer<'a>, &'static str)> {
    let mut flat = dancers.iter().filter(|dancer| dancer.is_flat());
    if sweep.shift[2] != 0.0 {
        return Some((flat.next()?, "the group is shifted in height"));
    }
    if carrier.is_some_and(Carrier::climbs) {
        return Some((flat.next()?, "the path leads up or down"));
    }
    let grows = sweep.grow != 1.0 && dancers.iter().any(|dancer| !dancer.is_flat());
    let off = flat.find(|dancer| grows && (dancer.from[2] - middle).abs() > LEVEL)?;
    Some((off, "the group grows in height too"))
}

/// The shortest time for a movement with these largest derivatives by its share of time.
fn time((slope, curvature): (f64, f64), [speed, acceleration]: [f64; 2]) -> f64 {
    (slope / speed).max((curvature / acceleration).sqrt())
}

/// The mean of all places.
#[expect(clippy::cast_precision_loss, reason = "groups are small")]
fn middle(dancers: &[Dancer<'_>]) -> Option<Point> {
    let count = dancers.len() as f64;
    let mean = |axis: usize| dancers.iter().map(|dancer| dancer.from[axis]).sum::<f64>() / count;
    (!dancers.is_empty()).then(|| [mean(0), mean(1), mean(2)])
}

/// x, y and z of a body that is at a place when the group begins.
fn axes(from: Point, center: Point, sweep: &Sweep, turning: bool) -> [Swept; 3] {
    let [x, y, z]: Point = std::array::from_fn(|axis| from[axis] - center[axis]);
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
