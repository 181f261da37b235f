//! The key `paths`: named routes through space, along which groups move.

use std::f64::consts::TAU;
use std::sync::Arc;

use super::formations::{factor, length, point, rotation};
use super::kinds;
use crate::ensemble::WrittenPath;
use crate::fields::{At, Reader};
use crate::finding::{Code, Place};
use crate::formation::{Placing, Point, SAME, metres_between};
use crate::motion::Path;
use crate::node::Node;
use crate::shown::shortened;
use downbeat_reader::keys;
use downbeat_reader::keys::{Keys, Kind};

/// Maximum number of points of a path.
const POINTS_MAX: usize = 1_000;
/// Number of points that represent a circle, so that the path deviates from it by less than a millionth of the radius.
const CIRCLE: u32 = 64;

keys! {
    /// A smooth route through space in metres: `points` or a `circle`. Only the differences of its places matter.
    pub(super) struct PathKeys as "path" {
        /// It passes through these points.
        points: Kind::List(&kinds::PLACE, 2..=1000),
        /// Counterclockwise, and from the x axis.
        circle: RoundKeys::KIND,
        /// Whether it leads back from the last point to the first.
        closed: kinds::TRUTH,
        rotate: kinds::ROTATION,
        /// Factor about the origin; default 1.
        scale: kinds::NUMBER,
    }
}

keys! {
    /// Counterclockwise, and from the x axis.
    pub(super) struct RoundKeys {
        /// Metres from the middle.
        #[required]
        radius: kinds::NUMBER,
    }
}

/// The points of a path as written, and whether the path returns from the last to the first.
struct Drawn {
    points: Vec<Point>,
    closed: bool,
    /// Place of each point in the file; empty if the points are not a list.
    places: Vec<Place>,
}

/// Reads a path, and reports its faults.
pub(super) fn read(reader: &mut Reader, name: &str, at: &At<'_>) -> WrittenPath {
    let before = reader.found.len();
    let path = path(reader, name, at).filter(|_| reader.found.len() == before);
    WrittenPath { path: path.map(Arc::new) }
}

fn path(reader: &mut Reader, name: &str, at: &At<'_>) -> Option<Path> {
    let what = format!("the path `{}`", shortened(name));
    let keys: PathKeys<'_> = reader.keys(at, &what)?;
    let closed = keys.closed.map_or(Some(false), |at| reader.truth(&at));
    let factor = keys.scale.map_or(Some(1.0), |at| factor(reader, &at));
    let rpy = keys.rotate.map_or(Some([0.0; 3]), |at| rotation(reader, &at));
    let drawn = match (keys.points, keys.circle) {
        (Some(list), None) => points(reader, &list, closed?),
        (None, Some(circle)) => {
            if let Some(at) = keys.closed {
                let expected = "`closed` only with `points`";
                reader.add(Code::UnknownKey, at.key_place(), "a circle is always closed", expected, None);
            }
            round(reader, &circle)
        }
        (both, _) => {
            if both.is_some() || !PathKeys::NAMES.iter().any(|key| reader.is_miswritten(at, key)) {
                let code = if both.is_some() { Code::UnknownKey } else { Code::MissingKey };
                let count = if both.is_some() { "two shapes" } else { "no shape" };
                let hint = Some("add a shape, as in `points: [[0, 0, 0], [2, 1, 0], [4, 0, 1]]`".to_owned());
                let expected = "exactly one of `points` and `circle`";
                reader.add(code, at.place(), format!("{what} has {count}"), expected, hint);
            }
            None
        }
    };
    let (drawn, placing) = (drawn?, Placing::default().turned(rpy?, factor?));
    let placed: Vec<Point> = drawn.points.iter().map(|point| placing.of(*point)).collect();
    if are_same(reader, at, &drawn, &placed) {
        return None;
    }
    match Path::through(&placed, drawn.closed) {
        Ok(path) => Some(path),
        Err(turns) => {
            let point = turns.point % placed.len();
            let place = drawn.places.get(point).map_or_else(|| at.place(), Place::clone);
            let message = format!("{what} bends too sharply at point {}", point + 1);
            let hint = Some("add a point next to it to make the bend wider".to_owned());
            reader.add(Code::WrongType, place, message, "a path that can be followed without stopping", hint);
            None
        }
    }
}

/// Whether any two neighbouring points of a path coincide. Reports such points.
fn are_same(reader: &mut Reader, at: &At<'_>, drawn: &Drawn, placed: &[Point]) -> bool {
    let count = placed.len();
    let next = |index: usize| (index + 1) % count;
    let steps = if drawn.closed { count } else { count - 1 };
    let apart = |index: &usize| metres_between(placed[*index], placed[next(*index)]);
    let same: Vec<usize> = (0..steps).filter(|index| apart(index) < SAME).collect();
    if drawn.places.is_empty() && !same.is_empty() {
        reader.add(
            Code::WrongType,
            at.place(),
            "the circle is too small",
            "a larger `radius` or `scale`",
            None,
        );
        return true;
    }
    for &index in &same {
        let message = format!("points {} and {} of the path are the same", index + 1, next(index) + 1);
        let hint = (next(index) == 0).then(|| "`closed` already leads back to the first point".to_owned());
        reader.add(Code::WrongType, drawn.places[index].clone(), message, "a different point, or none", hint);
    }
    !same.is_empty()
}

fn points(reader: &mut Reader, at: &At<'_>, closed: bool) -> Option<Drawn> {
    let all = reader.list(at, "a list of points such as [1, 0, 2.5]");
    let least = if closed { 3 } else { 2 };
    if matches!(at.node, Node::List(_)) && !(least..=POINTS_MAX).contains(&all.len()) {
        let code = if all.len() > POINTS_MAX { Code::TooMuch } else { Code::WrongType };
        let message = format!("a path through {}", crate::render::counted(all.len(), "point"));
        let expected = if closed {
            format!("{least} to {POINTS_MAX} points in a closed path")
        } else {
            format!("{least} to {POINTS_MAX} points")
        };
        reader.add(code, at.place(), message, expected, None);
        return None;
    }
    let points: Option<Vec<Point>> = all.iter().map(|at| point(reader, at)).collect();
    let points = points.filter(|points| !points.is_empty())?;
    Some(Drawn { points, closed, places: all.iter().map(At::place).collect() })
}

/// Reads `{radius: 2}`: a circle, counterclockwise from the x axis.
fn round(reader: &mut Reader, at: &At<'_>) -> Option<Drawn> {
    let RoundKeys { radius } = reader.keys(at, "`circle`")?;
    let radius = radius.and_then(|at| length(reader, &at))?;
    let point = |index: u32| {
        let (sine, cosine) = (TAU * f64::from(index) / f64::from(CIRCLE)).sin_cos();
        [radius * cosine, radius * sine, 0.0]
    };
    Some(Drawn { points: (0..CIRCLE).map(point).collect(), closed: true, places: Vec::new() })
}
