//! Computes the expected places of robots, and compares them with the actual places.

use proptest::prelude::*;

use super::super::groups::{apart, places};
use super::path::Laid;
use super::{Along, Cue, Does, Formation, GAP, Point, ROBOTS, Shape, Show, Steps, Sweep, fleet, steps_of};
use crate::{Act, Code, Compiled};

/// Permitted deviation of a robot from its place, in metres: the errors of the devices on all axes, plus their grid.
const OFF: f64 = 0.002 * 1.733 + 0.001;
/// Required distance between two bodies, from middle to middle, in metres.
const CLEAR: f64 = 0.4;
const SPEED: f64 = 5.0;
/// Number of sampled times of each cue.
const LOOKS: u32 = 60;
/// Factor by which the distances may exceed those of the best assignment: bodies that must wait or evade take other routes.
const LONGER: f64 = 1.01;

/// Returns the progress, from 0 to 1, of a movement from rest to rest with minimum jerk, after a share of its time.
fn gone(share: f64) -> f64 {
    let s = share.clamp(0.0, 1.0);
    s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
}

fn metres(point: [i64; 3]) -> Point {
    point.map(|part| part as f64 / 1_000.0)
}

/// Rotates a point by roll, pitch and yaw in degrees about fixed axes.
fn rotated([roll, pitch, yaw]: [f64; 3], [x, y, z]: Point) -> Point {
    let about = |degrees: f64, a: f64, b: f64| {
        let (sine, cosine) = degrees.to_radians().sin_cos();
        (a * cosine - b * sine, a * sine + b * cosine)
    };
    let (y, z) = about(roll, y, z);
    let (z, x) = about(pitch, z, x);
    let (x, y) = about(yaw, x, y);
    [x, y, z]
}

impl Formation {
    /// Returns the formation's places for `count` robots, in metres.
    fn places(&self, count: usize) -> Vec<Point> {
        let number = count as f64;
        let length = |value: i64| value as f64 / 1_000.0;
        let ring = |radius: f64| {
            let angle = |index: usize| 360.0 * index as f64 / number;
            (0..count).map(|index| rotated([0.0, 0.0, angle(index)], [radius, 0.0, 0.0])).collect()
        };
        let row = |spacing: f64| {
            (0..count).map(|index| [spacing * (index as f64 - (number - 1.0) / 2.0), 0.0, 0.0]).collect()
        };
        let all: Vec<Point> = match &self.shape {
            Shape::Points(points) => points.iter().copied().map(metres).collect(),
            Shape::LineSpacing(spacing) => row(length(*spacing)),
            Shape::LineLength(_) if count == 1 => vec![[0.0; 3]],
            Shape::LineLength(whole) => row(length(*whole) / (number - 1.0)),
            Shape::CircleRadius(radius) => ring(length(*radius)),
            Shape::CircleSpacing(_) if count == 1 => vec![[0.0; 3]],
            Shape::CircleSpacing(spacing) => {
                ring(length(*spacing) / 2.0 / (180.0 / number).to_radians().sin())
            }
            Shape::Grid(spacing, columns) => {
                let columns = (*columns as usize).min(count);
                let rows = count.div_ceil(columns);
                let off =
                    |index: usize, of: usize| length(*spacing) * (index as f64 - (of as f64 - 1.0) / 2.0);
                (0..count)
                    .map(|index| [off(index % columns, columns), off(index / columns, rows), 0.0])
                    .collect()
            }
            Shape::Vee(spacing, angle) => (0..count)
                .map(|index| {
                    let side = if index % 2 == 1 { 0.5 } else { -0.5 };
                    // An arm lies along y and is then turned to its side.
                    let arm = [0.0, length(*spacing) * (index as f64 / 2.0).ceil(), 0.0];
                    rotated([0.0, 0.0, side * *angle as f64], arm)
                })
                .collect(),
        };
        let middle: Point = match self.shape {
            Shape::Points(_) => std::array::from_fn(|axis| {
                let of = |pick: fn(f64, f64) -> f64, first: f64| {
                    all.iter().map(|place| place[axis]).fold(first, pick)
                };
                (of(f64::min, f64::INFINITY) + of(f64::max, f64::NEG_INFINITY)) / 2.0
            }),
            _ => [0.0; 3],
        };
        let angles = match self.rotate {
            Ok(yaw) => [0.0, 0.0, yaw as f64],
            Err(all) => all.map(|angle| angle as f64),
        };
        let placed = |place: Point| {
            let off = std::array::from_fn(|axis| length(self.scale) * (place[axis] - middle[axis]));
            let turned = rotated(angles, off);
            std::array::from_fn(|axis| turned[axis] + length(self.at[axis]))
        };
        all.into_iter().map(placed).collect()
    }
}

/// The expected movement of the robots of a cue. A robot's place depends on the share of its own time that has passed.
struct Course<'a> {
    sweep: &'a Sweep,
    center: Point,
    from: Vec<Point>,
    path: Option<(Laid, &'a Along)>,
}

impl<'a> Course<'a> {
    fn new(sweep: &'a Sweep, from: Vec<Point>) -> Self {
        let mut center: Point =
            std::array::from_fn(|axis| from.iter().map(|place| place[axis]).sum::<f64>() / from.len() as f64);
        if let Some([x, y]) = sweep.about {
            (center[0], center[1]) = (x as f64 / 1_000.0, y as f64 / 1_000.0);
        }
        let path = sweep.along.as_ref().map(|along| (along.path.laid(), along));
        Self { sweep, center, from, path }
    }

    fn place(&self, robot: usize, share: f64) -> Point {
        let share = gone(share);
        let grown = 1.0 + (self.sweep.grow as f64 / 1_000.0 - 1.0) * share;
        let (carried, heading) = match &self.path {
            Some((path, along)) => {
                let (gone, turned) = path.gone(share, along.laps);
                (gone, if along.turning { turned } else { 0.0 })
            }
            None => ([0.0; 3], 0.0),
        };
        let off = std::array::from_fn(|axis| grown * (self.from[robot][axis] - self.center[axis]));
        let turned = rotated([0.0, 0.0, self.sweep.turn as f64 * share + heading], off);
        let shift = metres(self.sweep.shift);
        std::array::from_fn(|axis| self.center[axis] + turned[axis] + shift[axis] * share + carried[axis])
    }
}

/// Returns all assignments of places to robots that use as many places as possible, and each place at most once.
fn assignments(robots: usize, places: usize) -> Vec<Vec<Option<usize>>> {
    fn more(
        robot: usize,
        robots: usize,
        free: &mut Vec<bool>,
        idle: usize,
        own: &mut Vec<Option<usize>>,
        all: &mut Vec<Vec<Option<usize>>>,
    ) {
        if robot == robots {
            all.push(own.clone());
            return;
        }
        for place in 0..free.len() {
            if free[place] {
                free[place] = false;
                own.push(Some(place));
                more(robot + 1, robots, free, idle, own, all);
                own.pop();
                free[place] = true;
            }
        }
        if idle > 0 {
            own.push(None);
            more(robot + 1, robots, free, idle - 1, own, all);
            own.pop();
        }
    }
    let mut all = Vec::new();
    let idle = robots.saturating_sub(places);
    more(0, robots, &mut vec![true; places], idle, &mut Vec::new(), &mut all);
    all
}

/// Returns the sum of all distances, and the longest one.
fn cost(from: &[Point], to: &[Point]) -> (f64, f64) {
    let ways = from.iter().zip(to).map(|(from, to)| apart(from, to));
    ways.fold((0.0, 0.0), |(sum, longest), way| (sum + way, f64::max(longest, way)))
}

fn home(robot: usize) -> Point {
    [robot as f64 * GAP, 0.0, 0.0]
}

impl Cue {
    /// Returns all possible sets of final places of the cue's robots. `None` if the numbers of robots and places differ and the cue does
    /// not state how to handle this.
    fn ends(&self, from: &[Point]) -> Option<Vec<Vec<Point>>> {
        let Does::Form { formation, spare, evenly, .. } = &self.does else { return Some(Vec::new()) };
        let count = self.robots.len();
        let mut places = formation.places(count);
        if places.len() > count && *evenly == Some(true) {
            let many = places.len();
            places = (0..count).map(|index| places[many * index / count]).collect();
        }
        if (places.len() > count && evenly.is_none()) || (places.len() < count && spare.is_none()) {
            return None;
        }
        let end = |(index, place): (usize, &Option<usize>)| match (place, spare) {
            (Some(place), _) => places[*place],
            (None, Some(true)) => home(self.robots[index]),
            (None, _) => from[index],
        };
        let all = assignments(count, places.len());
        Some(all.iter().map(|all| all.iter().enumerate().map(end).collect()).collect())
    }

    fn begin(&self, index: usize) -> f64 {
        (self.canon * index as i64) as f64
    }
}

/// Checks that the final places result from an assignment of places to robots, and that no assignment is much better.
fn formed(cue: &Cue, from: &[Point], ends: &[Point]) -> Result<(), TestCaseError> {
    let Does::Form { longest, .. } = cue.does else { return Ok(()) };
    let Some(all) = cue.ends(from) else { return Err(TestCaseError::fail("a choice that was not made")) };
    let alike = |to: &&Vec<Point>| to.iter().zip(ends).all(|(to, end)| apart(to, end) < OFF);
    let Some(taken) = all.iter().find(alike) else {
        return Err(TestCaseError::fail(format!("{ends:?} are no places for {from:?}: {:?}", all.first())));
    };
    let best =
        |pick: fn((f64, f64)) -> f64| all.iter().map(|to| pick(cost(from, to))).fold(f64::INFINITY, f64::min);
    let (sum, most) = cost(from, taken);
    let (found, least) = if longest { (most, best(|cost| cost.1)) } else { (sum, best(|cost| cost.0)) };
    prop_assert!(found <= LONGER * least + OFF * from.len() as f64, "{found} m, and {least} m are enough");
    Ok(())
}

/// Checks that all robots of the fleet are at their expected places from the start of a cue to its end. Returns their final places.
fn compare_cue(cue: &Cue, start: f64, steps: &Steps, before: &[Point]) -> Result<Vec<Point>, TestCaseError> {
    let now = places(steps, start);
    for robot in 0..ROBOTS {
        prop_assert!(
            apart(&now[robot], &before[robot]) < OFF,
            "d{robot} begins at {:?}, not {:?}",
            now[robot],
            before[robot]
        );
    }
    let from: Vec<Point> = cue.robots.iter().map(|robot| before[*robot]).collect();
    let over = cue.over as f64;
    let mut after = before.to_vec();
    for (index, robot) in cue.robots.iter().enumerate() {
        let waits = places(steps, start + cue.begin(index))[*robot];
        prop_assert!(apart(&waits, &before[*robot]) < OFF, "d{robot} does not wait");
        after[*robot] = places(steps, start + cue.begin(index) + over)[*robot];
    }
    let ends: Vec<Point> = cue.robots.iter().map(|robot| after[*robot]).collect();
    match &cue.does {
        Does::Go(to) => {
            for (index, end) in ends.iter().enumerate() {
                prop_assert!(apart(end, &metres(to[index])) < OFF, "{end:?} is not {:?}", to[index]);
            }
        }
        Does::Home => {
            for (robot, end) in cue.robots.iter().zip(&ends) {
                prop_assert!(apart(end, &home(*robot)) < OFF, "d{robot} is at {end:?}, not at home");
            }
        }
        Does::Form { .. } => formed(cue, &from, &ends)?,
        Does::Sweep(sweep) => {
            let course = Course::new(sweep, from);
            for look in 0..=LOOKS {
                let share = f64::from(look) / f64::from(LOOKS);
                for (index, robot) in cue.robots.iter().enumerate() {
                    let place = places(steps, start + cue.begin(index) + share * over)[*robot];
                    let meant = course.place(index, share);
                    prop_assert!(
                        apart(&place, &meant) < 1.5 * OFF,
                        "d{robot} at {share}: {place:?}, not {meant:?}"
                    );
                }
            }
        }
    }
    let end = start + over + cue.begin(cue.robots.len() - 1);
    let last = places(steps, end);
    for robot in 0..ROBOTS {
        prop_assert!(apart(&last[robot], &after[robot]) < OFF, "d{robot} moves elsewhere meanwhile");
    }
    Ok(after)
}

/// Checks the distances between robots and their speeds during a cue.
fn within_limits(start: f64, end: f64, steps: &Steps) -> Result<(), TestCaseError> {
    let many = 4 * LOOKS;
    let every = (end - start) / f64::from(many);
    let mut before = places(steps, start);
    for look in 1..=many {
        let now = places(steps, start + every * f64::from(look));
        for one in 0..ROBOTS {
            for other in one + 1..ROBOTS {
                let between = apart(&now[one], &now[other]);
                prop_assert!(between >= CLEAR - 1e-6, "d{one} and d{other} are {between} m apart");
            }
            let speed = (apart(&now[one], &before[one]) - 2.0 * OFF) / (every / 1_000.0);
            prop_assert!(speed <= SPEED, "d{one} has {speed} m/s");
        }
        before = now;
    }
    Ok(())
}

/// Checks that the steps of an act match the meaning of its cues. Returns the final places of the robots.
fn compare_act(written: &[Cue], planned: &Act, before: &[Point]) -> Result<Vec<Point>, TestCaseError> {
    let steps = steps_of(planned, &fleet(), before);
    let mut now = before.to_vec();
    let mut time = 0;
    let cues: Vec<_> = planned.cues.iter().filter(|cue| cue.name != "q").collect();
    prop_assert_eq!(cues.len(), written.len());
    for (cue, planned) in written.iter().zip(cues) {
        let start = time + cue.lag;
        let length = cue.over + cue.canon * (cue.robots.len() as i64 - 1);
        let nanos = |millis: i64| millis * 1_000_000;
        prop_assert_eq!(
            (planned.start.as_nanos(), planned.end.as_nanos()),
            (nanos(start), nanos(start + length))
        );
        now = compare_cue(cue, start as f64, &steps, &now)?;
        within_limits(start as f64, (start + length) as f64, &steps)?;
        time = start + length;
    }
    Ok(now)
}

/// Whether the compiler may report this fault for a show, so that its rejection is correct.
fn may_be(show: &Show, code: Code) -> bool {
    let cues = || show.acts.iter().flatten();
    match code {
        Code::PlacesCount => cues().any(|cue| cue.ends(&[[0.0; 3]; ROBOTS]).is_none()),
        // Nothing moves the robot.
        Code::NotInGroup => {
            let stays = |sweep: &Sweep| sweep.shift == [0; 3] && sweep.along.is_none();
            cues().any(|cue| matches!(&cue.does, Does::Sweep(sweep) if stays(sweep)))
        }
        Code::NearPlaces => cues().any(|cue| match &cue.does {
            Does::Form { formation, .. } => {
                let all = formation.places(cue.robots.len());
                all.iter()
                    .enumerate()
                    .any(|(index, a)| all[index + 1..].iter().any(|b| apart(a, b) < CLEAR + 1e-6))
            }
            _ => false,
        }),
        // Devices reach up to 50 m.
        Code::OutOfRange => cues().any(|cue| matches!(&cue.does, Does::Sweep(sweep) if sweep.grow > 1_000)),
        // Each device of a drone holds one script, and an act may move the device until the act's end.
        Code::ActHasToWait => show.acts.len() > 1,
        Code::TooClose | Code::NoWayPast | Code::BodyTooFast => true,
        _ => false,
    }
}

pub(super) fn compare(show: &Show, compiled: &Compiled) -> Result<(), TestCaseError> {
    for finding in &compiled.findings {
        prop_assert!(may_be(show, finding.code), "{finding:#?}");
    }
    let Some(choreography) = &compiled.choreography else { return Ok(()) };
    let mut now: Vec<Point> = (0..ROBOTS).map(home).collect();
    for (written, planned) in show.acts.iter().zip(&choreography.acts) {
        now = compare_act(written, planned, &now)?;
    }
    Ok(())
}
