//! The key `formations`: names with places in space.

use std::sync::Arc;

use crate::fields::{At, Reader};
use crate::files::Files;
use crate::finding::{Code, Place};
use crate::formation::{
    Ball, Formation, Grid, Line, PLACES_MAX, Placing, Point, Ring, Shape, Vee, middle_of,
};
use crate::keys::keys;
use crate::node::{Node, shortened};

/// Longest length and furthest coordinate, in metres: far more than robots could play in, and nothing overflows.
const METRES_MAX: f64 = 1e6;
/// Most columns and rows of a grid.
const SIDE_MAX: u32 = 10_000;

/// Degrees between the arms of a V, if nothing is said: neighbours on the two arms are as far apart as those on one.
const VEE_ANGLE: f64 = 60.0;

const LENGTH: &str = "a length above 0, in metres, up to 1000000";
const POINT: &str = "a place in metres, as [1, 0, 2.5]";
const ROTATION: &str = "degrees about the vertical, or [roll, pitch, yaw] in degrees, as [90, 0, 0]";

keys! {
    /// What is said of a formation.
    FormationKeys, FORMATION_KEYS { points, line, circle, grid, v, sphere, at, rotate, scale }
}

/// A formation as written.
#[derive(Clone, Debug)]
pub(crate) struct WrittenFormation {
    /// None if something is wrong with it, which has been told.
    pub(crate) formation: Option<Formation>,
    /// Place of its name.
    pub(crate) place: Place,
}

/// A shape, and how it stands if nothing is said of that.
struct Shaped {
    shape: Shape,
    placing: Placing,
}

impl Shaped {
    /// One with its middle at 0.
    fn around_0(shape: Shape) -> Self {
        Self { shape, placing: Placing::default() }
    }
}

/// Reads one formation.
pub(super) fn read(reader: &mut Reader, files: &dyn Files, name: &str, at: &At<'_>) -> WrittenFormation {
    let before = reader.found.len();
    let formation = formation(reader, files, name, at).filter(|_| reader.found.len() == before);
    WrittenFormation { formation, place: at.key_place() }
}

fn formation(reader: &mut Reader, files: &dyn Files, name: &str, at: &At<'_>) -> Option<Formation> {
    let what = format!("the formation `{}`", shortened(name));
    let keys = FormationKeys::of(reader.map(at, &what, FORMATION_KEYS, &[])?);
    let shaped = shape(reader, files, at, &what, &keys);
    let factor = keys.scale.map_or(Some(1.0), |at| factor(reader, &at));
    let rpy = keys.rotate.map_or(Some([0.0; 3]), |at| rotation(reader, &at));
    let to = keys.at.map(|at| point(reader, &at));
    let Shaped { shape, placing } = shaped?;
    let placing = placing.turned(rpy?, factor?);
    let placing = match to {
        Some(to) => placing.moved(to?),
        None => placing,
    };
    Some(Formation { shape, placing })
}

/// The one shape of a formation.
fn shape(
    reader: &mut Reader,
    _files: &dyn Files,
    at: &At<'_>,
    what: &str,
    keys: &FormationKeys<'_>,
) -> Option<Shaped> {
    let shapes = [keys.points, keys.line, keys.circle, keys.grid, keys.v, keys.sphere];
    let count = shapes.iter().flatten().count();
    if count != 1 {
        let names = &FORMATION_KEYS[..shapes.len()];
        let is_miswritten = names.iter().any(|name| reader.is_miswritten(at, name));
        if count > 0 || !is_miswritten {
            let code = if count == 0 { Code::MissingKey } else { Code::UnknownKey };
            let expected = format!("exactly one of {}", crate::finding::names(names.iter().copied()));
            reader.add(code, at.place(), format!("{what} has {count} shapes"), expected, None);
        }
        return None;
    }
    let [points, line, circle, grid, vee, sphere] = shapes;
    None.or_else(|| points.map(|at| read_points(reader, &at)))
        .or_else(|| line.map(|at| read_line(reader, &at)))
        .or_else(|| circle.map(|at| read_circle(reader, &at)))
        .or_else(|| grid.map(|at| read_grid(reader, &at)))
        .or_else(|| vee.map(|at| read_vee(reader, &at)))
        .or_else(|| sphere.map(|at| read_sphere(reader, &at)))?
}

fn read_points(reader: &mut Reader, at: &At<'_>) -> Option<Shaped> {
    let all = reader.list(at, "a list of places such as [1, 0, 2.5]");
    if matches!(at.node, Node::List(_)) && !(1..=PLACES_MAX).contains(&all.len()) {
        let code = if all.is_empty() { Code::NothingToDo } else { Code::TooMuch };
        let message = format!("the formation has {}", crate::counted(all.len(), "place"));
        reader.add(code, at.place(), message, format!("1 to {PLACES_MAX} places"), None);
        return None;
    }
    let points: Option<Vec<Point>> = all.iter().map(|at| point(reader, at)).collect();
    let points: Arc<[Point]> = points.filter(|points| !points.is_empty())?.into();
    let placing = Placing::about(middle_of(&points).0);
    Some(Shaped { shape: Shape::Points(points), placing })
}

/// `{spacing: 1}` or `{length: 6}`
fn read_line(reader: &mut Reader, at: &At<'_>) -> Option<Shaped> {
    let [spacing, whole] = reader.map(at, "`line`", ["spacing", "length"], &[])?;
    let line = match (spacing, whole) {
        (Some(at), None) => Line::Spacing(length(reader, &at)?),
        (None, Some(at)) => Line::Length(length(reader, &at)?),
        _ => return one_of_two(reader, at, "a line", ["spacing", "length"]),
    };
    Some(Shaped::around_0(Shape::Line(line)))
}

/// `{radius: 2}` or `{spacing: 1}`
fn read_circle(reader: &mut Reader, at: &At<'_>) -> Option<Shaped> {
    let [radius, spacing] = reader.map(at, "`circle`", ["radius", "spacing"], &[])?;
    let ring = match (radius, spacing) {
        (Some(at), None) => Ring::Radius(length(reader, &at)?),
        (None, Some(at)) => Ring::Spacing(length(reader, &at)?),
        _ => return one_of_two(reader, at, "a circle", ["radius", "spacing"]),
    };
    Some(Shaped::around_0(Shape::Circle(ring)))
}

/// `{spacing: 1, columns: 4, rows: 3}`
fn read_grid(reader: &mut Reader, at: &At<'_>) -> Option<Shaped> {
    let [spacing, columns, rows] = reader.map(at, "`grid`", ["spacing", "columns", "rows"], &["spacing"])?;
    let side = |reader: &mut Reader, at: Option<At<'_>>| match at {
        Some(at) => reader.count(&at, 1, SIDE_MAX).map(Some),
        None => Some(None),
    };
    let (columns, rows) = (side(reader, columns), side(reader, rows));
    let spacing = spacing.and_then(|at| match at.node {
        Node::List(_) => each_axis(reader, &at, "lengths above 0 in metres, as [1, 1, 2]", length),
        _ => length(reader, &at).map(|length| [length; 3]),
    });
    let grid = Grid { spacing: spacing?, columns: columns?, rows: rows? };
    Some(Shaped::around_0(Shape::Grid(grid)))
}

/// `{spacing: 1, angle: 60}`
fn read_vee(reader: &mut Reader, at: &At<'_>) -> Option<Shaped> {
    let [spacing, angle] = reader.map(at, "`v`", ["spacing", "angle"], &["spacing"])?;
    let expected = "an angle between the arms above 0 and below 180 degrees";
    let angle = angle.map_or(Some(VEE_ANGLE), |at| {
        let angle = reader.degrees(&at, expected)?;
        if angle > 0.0 && angle < 180.0 {
            return Some(angle);
        }
        reader.add(Code::WrongType, at.place(), format!("found the number {angle}"), expected, None);
        None
    });
    let spacing = spacing.and_then(|at| length(reader, &at));
    let vee = Vee { spacing: spacing?, angle: angle? };
    Some(Shaped::around_0(Shape::Vee(vee)))
}

/// `{radius: 2}`
fn read_sphere(reader: &mut Reader, at: &At<'_>) -> Option<Shaped> {
    let [radius] = reader.map(at, "`sphere`", ["radius"], &["radius"])?;
    let radius = radius.and_then(|at| length(reader, &at))?;
    Some(Shaped::around_0(Shape::Sphere(Ball { radius })))
}

fn one_of_two(reader: &mut Reader, at: &At<'_>, what: &str, keys: [&str; 2]) -> Option<Shaped> {
    if keys.iter().any(|key| reader.is_miswritten(at, key)) {
        return None;
    }
    let expected = format!("either `{}` or `{}`", keys[0], keys[1]);
    let hint = Some("lengths are in metres".to_owned());
    reader.add(Code::MissingKey, at.place(), format!("{what} needs its size"), expected, hint);
    None
}

/// A length above 0 in metres.
fn length(reader: &mut Reader, at: &At<'_>) -> Option<f64> {
    let value = reader.positive(at, LENGTH)?;
    within(reader, at, value, LENGTH)
}

/// A factor above 0.
fn factor(reader: &mut Reader, at: &At<'_>) -> Option<f64> {
    let expected = "a factor above 0, up to 1000000";
    let value = reader.positive(at, expected)?;
    within(reader, at, value, expected)
}

fn within(reader: &mut Reader, at: &At<'_>, value: f64, expected: &str) -> Option<f64> {
    if value.abs() <= METRES_MAX {
        return Some(value);
    }
    reader.add(Code::WrongType, at.place(), format!("found the number {value}"), expected, None);
    None
}

/// A place in metres.
fn point(reader: &mut Reader, at: &At<'_>) -> Option<Point> {
    each_axis(reader, at, POINT, |reader, at| {
        let value = reader.number(at, POINT)?;
        within(reader, at, value, "a coordinate in metres, from -1000000 to 1000000")
    })
}

/// One number turns about the vertical.
fn rotation(reader: &mut Reader, at: &At<'_>) -> Option<Point> {
    match at.node {
        Node::List(_) => each_axis(reader, at, ROTATION, |reader, at| reader.degrees(at, ROTATION)),
        _ => reader.degrees(at, ROTATION).map(|yaw| [0.0, 0.0, yaw]),
    }
}

/// A list of three, one for each axis.
fn each_axis(
    reader: &mut Reader,
    at: &At<'_>,
    expected: &str,
    read: impl Fn(&mut Reader, &At<'_>) -> Option<f64>,
) -> Option<Point> {
    let parts = reader.list(at, expected);
    let numbers: Vec<f64> = parts.iter().take(3).filter_map(|part| read(reader, part)).collect();
    if parts.len() != 3 && matches!(at.node, Node::List(_)) {
        let message = format!("found {} entries", parts.len());
        reader.add(Code::WrongType, at.place(), message, expected, None);
        return None;
    }
    Point::try_from(numbers).ok()
}
