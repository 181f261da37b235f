//! The key `formations`: names with places in space.

#[cfg(test)]
mod tests;

use std::sync::Arc;

use super::kinds;
use crate::ensemble::WrittenFormation;
use crate::fields::{At, Reader};
use crate::files::Files;
use crate::finding::Code;
use crate::formation::cloud::{self, Cloud};
use crate::formation::{
    Ball, Formation, Grid, Line, PLACES_MAX, Placing, Point, Ring, Shape, Strokes, Unfit, Vee, middle_of,
    svg, text,
};
use crate::node::Node;
use crate::shown::shortened;
use downbeat_reader::keys;
use downbeat_reader::keys::Kind;

/// Maximum length or coordinate in metres: far more than robots need, and small enough to prevent overflow.
const METRES_MAX: f64 = 1e6;
/// Maximum number of columns, and of rows, in a grid.
const SIDE_MAX: u32 = 10_000;

/// Maximum number of characters in a `text` formation.
const TEXT_MAX: usize = 200;
/// Default angle between the arms of a V, in degrees. Neighbours on different arms are then as far apart as neighbours on the same arm.
const VEE_ANGLE: f64 = 60.0;

const LENGTH: &str = "a length above 0, in metres, up to 1000000";
const LENGTHS: &str = "lengths above 0 in metres, such as [1, 1, 2]";
const POINT: &str = "a place in metres, such as [1, 0, 2.5]";
const ROTATION: &str = "degrees about the vertical, or [roll, pitch, yaw] in degrees, such as [90, 0, 0]";

/// Keys of a formation that are shapes.
pub(super) const SHAPES: [&str; 9] =
    ["points", "line", "circle", "grid", "v", "sphere", "text", "svg", "cloud"];

keys! {
    /// A set of places in metres. It has exactly one shape.
    pub(super) struct FormationKeys as "formation" {
        /// An explicit list of places.
        points: Kind::List(&kinds::PLACE, 1..=10000),
        /// Along the x axis.
        line: LineKeys::KIND,
        /// Counterclockwise from the x axis.
        circle: CircleKeys::KIND,
        /// Row by row along the x axis.
        grid: GridKeys::KIND,
        /// The tip, then one place on each arm in turn.
        v: VeeKeys::KIND,
        /// Spread evenly over a sphere.
        sphere: SphereKeys::KIND,
        /// Upright letters of strokes, 1 m high by default.
        text: kinds::NAME,
        /// The paths of an SVG file, upright; from the scenario's folder.
        svg: kinds::TEXT,
        /// The points of a PLY or CSV file, or the surface of an STL file; from the scenario's folder.
        cloud: kinds::TEXT,
        /// Position of the middle. Default: 0, or as written for points.
        at: kinds::PLACE,
        rotate: kinds::ROTATION,
        /// Factor about the middle; default 1.
        scale: kinds::NUMBER,
        /// Length of the longest side in metres, for a text, a drawing, a cloud or points; instead of `scale`.
        size: kinds::NUMBER,
    }
}

keys! {
    /// Along the x axis.
    pub(super) struct LineKeys {
        /// Metres between neighbours.
        spacing: kinds::NUMBER,
        /// Metres from the first place to the last.
        length: kinds::NUMBER,
    }
}

keys! {
    /// Counterclockwise from the x axis.
    pub(super) struct CircleKeys {
        /// Metres from the middle.
        radius: kinds::NUMBER,
        /// Metres between neighbours.
        spacing: kinds::NUMBER,
    }
}

keys! {
    /// Row by row along the x axis.
    pub(super) struct GridKeys {
        /// Metres between columns, rows and layers; one number, or one for each.
        #[required]
        spacing: Kind::AnyOf(&[&kinds::NUMBER, &kinds::PLACE]),
        /// Default: a square.
        columns: kinds::NUMBER,
        /// Default: as many as needed. If it is set, the grid continues in layers above.
        rows: kinds::NUMBER,
    }
}

keys! {
    /// The tip, then one place on each arm in turn.
    pub(super) struct VeeKeys {
        /// Metres between neighbours on an arm.
        #[required]
        spacing: kinds::NUMBER,
        /// Degrees between the arms; default 60.
        angle: kinds::NUMBER,
    }
}

keys! {
    /// Spread evenly over a sphere.
    pub(super) struct SphereKeys {
        /// Metres from the middle.
        #[required]
        radius: kinds::NUMBER,
    }
}

/// A shape with its position, rotation and scale, which are initially the defaults.
struct Shaped {
    shape: Shape,
    placing: Placing,
    /// The longest side of the shape's bounding box; `None` if it depends on the number of robots.
    longest: Option<f64>,
    /// Metres per unit of the shape; `None` if the scenario must set it.
    unit: Option<f64>,
    /// The key and the number that define the size of the shape; `None` if no single number does.
    size: Option<(&'static str, f64)>,
}

impl Shaped {
    /// Creates a shape whose middle is at the origin.
    fn around_0(shape: Shape) -> Self {
        Self { shape, placing: Placing::default(), longest: None, unit: Some(1.0), size: None }
    }

    fn of_size(self, key: &'static str, size: f64) -> Self {
        Self { size: Some((key, size)), ..self }
    }
}

/// Reads a formation, and reports its faults.
pub(super) fn read(reader: &mut Reader, files: &dyn Files, name: &str, at: &At<'_>) -> WrittenFormation {
    let before = reader.found.len();
    let read = formation(reader, files, name, at).filter(|_| reader.found.len() == before);
    let (formation, size) = read.unzip();
    WrittenFormation { formation, place: at.key_place(), size: size.unwrap_or(("scale", 1.0)) }
}

/// Reads a formation, and the key that defines its size.
fn formation(
    reader: &mut Reader,
    files: &dyn Files,
    name: &str,
    at: &At<'_>,
) -> Option<(Formation, (&'static str, f64))> {
    let what = format!("the formation `{}`", shortened(name));
    let keys: FormationKeys<'_> = reader.keys(at, &what)?;
    let shaped = shape(reader, files, at, &what, &keys);
    let factor = keys.scale.map_or(Some(1.0), |at| factor(reader, &at));
    let rpy = keys.rotate.map_or(Some([0.0; 3]), |at| rotation(reader, &at));
    let to = keys.at.map(|at| point(reader, &at));
    let shaped = shaped?;
    let scaled = keys.scale.is_some();
    let (factor, size) = match keys.size {
        Some(at) => {
            let factor = sized(reader, &shaped, &at, keys.scale)?;
            (factor, ("size", factor * shaped.longest.unwrap_or(1.0)))
        }
        None => {
            let size = shaped.size.filter(|_| !scaled).unwrap_or(("scale", factor?));
            (unsized_factor(reader, at, &what, &shaped, factor?, scaled)?, size)
        }
    };
    let Shaped { shape, placing, .. } = shaped;
    let placing = placing.turned(rpy?, factor);
    let placing = match to {
        Some(to) => placing.moved(to?),
        None => placing,
    };
    Some((Formation { shape, placing }, size))
}

/// Reads the shape of a formation, which must have exactly one.
fn shape(
    reader: &mut Reader,
    files: &dyn Files,
    at: &At<'_>,
    what: &str,
    keys: &FormationKeys<'_>,
) -> Option<Shaped> {
    let shapes = [
        keys.points,
        keys.line,
        keys.circle,
        keys.grid,
        keys.v,
        keys.sphere,
        keys.text,
        keys.svg,
        keys.cloud,
    ];
    let count = shapes.iter().flatten().count();
    if count != 1 {
        let is_miswritten = SHAPES.iter().any(|name| reader.is_miswritten(at, name));
        if count > 0 || !is_miswritten {
            let code = if count == 0 { Code::MissingKey } else { Code::UnknownKey };
            let expected = format!("exactly one of {}", crate::finding::names(SHAPES));
            reader.add(code, at.place(), format!("{what} has {count} shapes"), expected, None);
        }
        return None;
    }
    let [points, line, circle, grid, vee, sphere, text, svg, cloud] = shapes;
    None.or_else(|| points.map(|at| read_points(reader, &at)))
        .or_else(|| line.map(|at| read_line(reader, &at)))
        .or_else(|| circle.map(|at| read_circle(reader, &at)))
        .or_else(|| grid.map(|at| read_grid(reader, &at)))
        .or_else(|| vee.map(|at| read_vee(reader, &at)))
        .or_else(|| sphere.map(|at| read_sphere(reader, &at)))
        .or_else(|| text.map(|at| read_text(reader, &at)))
        .or_else(|| svg.map(|at| read_svg(reader, files, &at)))
        .or_else(|| cloud.map(|at| read_cloud(reader, files, &at)))?
}

fn read_points(reader: &mut Reader, at: &At<'_>) -> Option<Shaped> {
    let all = reader.list(at, "a list of places such as [1, 0, 2.5]");
    if matches!(at.node, Node::List(_)) && !(1..=PLACES_MAX).contains(&all.len()) {
        let code = if all.is_empty() { Code::NothingToDo } else { Code::TooMuch };
        let message = format!("the formation has {}", crate::render::counted(all.len(), "place"));
        reader.add(code, at.place(), message, format!("1 to {PLACES_MAX} places"), None);
        return None;
    }
    let points: Option<Vec<Point>> = all.iter().map(|at| point(reader, at)).collect();
    let points: Arc<[Point]> = points.filter(|points| !points.is_empty())?.into();
    let (middle, sides) = middle_of(&points);
    let longest = Some(sides.into_iter().fold(0.0, f64::max));
    Some(Shaped { placing: Placing::about(middle), longest, ..Shaped::around_0(Shape::Points(points)) })
}

/// Reads the keys of a line, such as `{spacing: 1}` or `{length: 6}`.
fn read_line(reader: &mut Reader, at: &At<'_>) -> Option<Shaped> {
    let LineKeys { spacing, length: whole } = reader.keys(at, "`line`")?;
    let (line, key, size) = match (spacing, whole) {
        (Some(at), None) => {
            let spacing = length(reader, &at)?;
            (Line::Spacing(spacing), "spacing", spacing)
        }
        (None, Some(at)) => {
            let whole = length(reader, &at)?;
            (Line::Length(whole), "length", whole)
        }
        _ => return one_of_two(reader, at, "a line", ["spacing", "length"]),
    };
    Some(Shaped::around_0(Shape::Line(line)).of_size(key, size))
}

/// Reads the keys of a circle, such as `{radius: 2}` or `{spacing: 1}`.
fn read_circle(reader: &mut Reader, at: &At<'_>) -> Option<Shaped> {
    let CircleKeys { radius, spacing } = reader.keys(at, "`circle`")?;
    let (ring, key, size) = match (radius, spacing) {
        (Some(at), None) => {
            let radius = length(reader, &at)?;
            (Ring::Radius(radius), "radius", radius)
        }
        (None, Some(at)) => {
            let spacing = length(reader, &at)?;
            (Ring::Spacing(spacing), "spacing", spacing)
        }
        _ => return one_of_two(reader, at, "a circle", ["radius", "spacing"]),
    };
    Some(Shaped::around_0(Shape::Circle(ring)).of_size(key, size))
}

/// Reads the keys of a grid, such as `{spacing: 1, columns: 4, rows: 3}`.
fn read_grid(reader: &mut Reader, at: &At<'_>) -> Option<Shaped> {
    let GridKeys { spacing, columns, rows } = reader.keys(at, "`grid`")?;
    let side = |reader: &mut Reader, at: Option<At<'_>>| match at {
        Some(at) => reader.count(&at, 1, SIDE_MAX).map(Some),
        None => Some(None),
    };
    let (columns, rows) = (side(reader, columns), side(reader, rows));
    let spacing = spacing.and_then(|at| match at.node {
        Node::List(_) => each_axis(reader, &at, LENGTHS, length),
        _ => length(reader, &at).map(|length| [length; 3]),
    });
    let grid = Grid { spacing: spacing?, columns: columns?, rows: rows? };
    let [x, y, z] = grid.spacing;
    let shaped = Shaped::around_0(Shape::Grid(grid));
    Some(if x == y && y == z { shaped.of_size("spacing", x) } else { shaped })
}

/// Reads the keys of a V, such as `{spacing: 1, angle: 60}`.
fn read_vee(reader: &mut Reader, at: &At<'_>) -> Option<Shaped> {
    let VeeKeys { spacing, angle } = reader.keys(at, "`v`")?;
    let expected = "an angle of more than 0 and less than 180 degrees between the arms";
    let angle = angle.map_or(Some(VEE_ANGLE), |at| {
        let angle = reader.degrees(&at, expected)?;
        if angle > 0.0 && angle < 180.0 {
            return Some(angle);
        }
        reader.add(
            Code::WrongType,
            at.place(),
            format!("found the number {}", shortened(&angle.to_string())),
            expected,
            None,
        );
        None
    });
    let spacing = spacing.and_then(|at| length(reader, &at));
    let spacing = spacing?;
    let vee = Vee { spacing, angle: angle? };
    Some(Shaped::around_0(Shape::Vee(vee)).of_size("spacing", spacing))
}

/// Reads the key of a sphere, such as `{radius: 2}`.
fn read_sphere(reader: &mut Reader, at: &At<'_>) -> Option<Shaped> {
    let SphereKeys { radius } = reader.keys(at, "`sphere`")?;
    let radius = radius.and_then(|at| length(reader, &at))?;
    Some(Shaped::around_0(Shape::Sphere(Ball { radius })).of_size("radius", radius))
}

/// Reads a text such as `GO` as an upright shape.
fn read_text(reader: &mut Reader, at: &At<'_>) -> Option<Shaped> {
    let expected = "a text of 1 to 200 characters";
    let written = reader.name(at, expected)?;
    if written.trim().is_empty() || written.chars().count() > TEXT_MAX {
        let message =
            format!("the text `{}` has {} characters", shortened(&written), written.chars().count());
        reader.add(Code::WrongType, at.place(), message, expected, None);
        return None;
    }
    match text::strokes_of(&written) {
        Ok(strokes) => Some(upright(&strokes, Some(1.0 / text::LETTER_HEIGHT))),
        Err(c) => {
            let message = format!("the character `{c}` is not supported");
            let hint = Some("draw it as an SVG path, and use `svg`".to_owned());
            let expected = format!("letters, spaces, and these characters: {}", text::letters());
            reader.add(Code::UnknownWord, at.place(), message, expected, hint);
            None
        }
    }
}

/// Reads the path of an SVG file, such as `logo.svg`, as an upright shape.
fn read_svg(reader: &mut Reader, files: &dyn Files, at: &At<'_>) -> Option<Shaped> {
    let (name, bytes) = bytes_of(reader, files, at, "the path of an SVG file")?;
    match svg::read(&bytes) {
        Ok(strokes) => Some(upright(&strokes, None)),
        Err(unfit) => unfit_file(reader, at, &name, unfit),
    }
}

/// Reads the path of a point file, such as `statue.stl`.
fn read_cloud(reader: &mut Reader, files: &dyn Files, at: &At<'_>) -> Option<Shaped> {
    let (name, bytes) = bytes_of(reader, files, at, "the path of a PLY, STL or CSV file")?;
    let cloud = match cloud::read(&name, &bytes) {
        Ok(cloud) => cloud,
        Err(unfit) => return unfit_file(reader, at, &name, unfit),
    };
    let (shape, (middle, sides)) = match cloud {
        Cloud::Points(points) => {
            let sides = middle_of(&points);
            (Shape::Cloud(points.into()), sides)
        }
        Cloud::Surface(surface) => {
            let sides = middle_of(&surface.concat());
            (Shape::Surface(surface.into()), sides)
        }
    };
    let longest = Some(sides.into_iter().fold(0.0, f64::max));
    Some(Shaped { placing: Placing::about(middle), longest, ..Shaped::around_0(shape) })
}

/// Turns strokes into an upright shape whose middle is at the origin.
fn upright(strokes: &[text::FlatStroke], unit: Option<f64>) -> Shaped {
    let lines: Vec<Vec<Point>> =
        strokes.iter().map(|line| line.iter().map(|[x, y]| [*x, 0.0, *y]).collect()).collect();
    let (middle, sides) = middle_of(&lines.concat());
    let shape = Shape::Strokes(Arc::new(Strokes::of(&lines)));
    let longest = Some(sides.into_iter().fold(0.0, f64::max));
    Shaped { placing: Placing::about(middle).moved([0.0; 3]), longest, unit, ..Shaped::around_0(shape) }
}

/// Returns the name and bytes of a file that the scenario refers to.
fn bytes_of(
    reader: &mut Reader,
    files: &dyn Files,
    at: &At<'_>,
    expected: &str,
) -> Option<(String, Vec<u8>)> {
    let name = reader.text(at, expected)?.into_owned();
    match files.read_bytes(&name) {
        Ok(bytes) => Some((name, bytes)),
        Err(finding) if finding.code == Code::OutsideProject => {
            reader.add_named(at.place(), finding);
            None
        }
        Err(finding) => {
            let message = format!("cannot read `{}`: {}", shortened(&name), finding.message);
            let hint = Some("the path is relative to the folder of the scenario".to_owned());
            reader.add(Code::Unreadable, at.place(), message, "a readable file", hint);
            None
        }
    }
}

fn unfit_file(reader: &mut Reader, at: &At<'_>, name: &str, unfit: Unfit) -> Option<Shaped> {
    let message = format!("`{}`: {}", shortened(name), unfit.message);
    reader.add(Code::BadData, at.place(), message, unfit.expected, None);
    None
}

/// Reads the key `size`, and returns the scale factor at which the longest side of the shape has this length.
fn sized(reader: &mut Reader, shaped: &Shaped, at: &At<'_>, scale: Option<At<'_>>) -> Option<f64> {
    let size = length(reader, at)?;
    if scale.is_some() {
        let message = "`size` and `scale` cannot be combined";
        reader.add(Code::UnknownKey, at.key_place(), message, "either `size` or `scale`", None);
        return None;
    }
    match shaped.longest {
        Some(longest) if longest > 0.0 => Some(size / longest),
        Some(_) => {
            reader.add(
                Code::WrongType,
                at.place(),
                "all places are at the same point",
                "`size` only for a shape that is larger than a point",
                None,
            );
            None
        }
        None => {
            let message = "this shape already defines its size";
            let hint = Some("change its `radius`, `length` or `spacing`, or use `scale`".to_owned());
            reader.add(
                Code::UnknownKey,
                at.key_place(),
                message,
                "`size` only for points, a text or a file",
                hint,
            );
            None
        }
    }
}

fn unsized_factor(
    reader: &mut Reader,
    at: &At<'_>,
    what: &str,
    shaped: &Shaped,
    factor: f64,
    scaled: bool,
) -> Option<f64> {
    match shaped.unit {
        Some(unit) => Some(unit * factor),
        None if scaled => Some(factor),
        None => {
            let hint = Some("add `size: 3` to make the longest side 3 m".to_owned());
            reader.add(
                Code::MissingKey,
                at.place(),
                format!("{what} has no `size`"),
                "a key `size` or `scale`",
                hint,
            );
            None
        }
    }
}

fn one_of_two(reader: &mut Reader, at: &At<'_>, what: &str, keys: [&str; 2]) -> Option<Shaped> {
    if keys.iter().any(|key| reader.is_miswritten(at, key)) {
        return None;
    }
    let expected = format!("either `{}` or `{}`", keys[0], keys[1]);
    let hint = Some("add one of them, in metres".to_owned());
    reader.add(Code::MissingKey, at.place(), format!("{what} has no size"), expected, hint);
    None
}

/// Reads a length above 0 in metres.
pub(super) fn length(reader: &mut Reader, at: &At<'_>) -> Option<f64> {
    let value = reader.positive(at, LENGTH)?;
    within(reader, at, value, LENGTH)
}

/// Reads a factor above 0.
pub(super) fn factor(reader: &mut Reader, at: &At<'_>) -> Option<f64> {
    let expected = "a factor above 0, up to 1000000";
    let value = reader.positive(at, expected)?;
    within(reader, at, value, expected)
}

fn within(reader: &mut Reader, at: &At<'_>, value: f64, expected: &str) -> Option<f64> {
    if value.abs() <= METRES_MAX {
        return Some(value);
    }
    let found = shortened(&value.to_string());
    reader.add(Code::WrongType, at.place(), format!("found the number {found}"), expected, None);
    None
}

/// Reads a position: three coordinates in metres.
pub(super) fn point(reader: &mut Reader, at: &At<'_>) -> Option<Point> {
    each_axis(reader, at, POINT, |reader, at| {
        let value = reader.number(at, POINT)?;
        within(reader, at, value, "a coordinate in metres, from -1000000 to 1000000")
    })
}

/// Reads a rotation in degrees. A single number is a rotation about the vertical.
pub(super) fn rotation(reader: &mut Reader, at: &At<'_>) -> Option<Point> {
    match at.node {
        Node::List(_) => each_axis(reader, at, ROTATION, |reader, at| reader.degrees(at, ROTATION)),
        _ => reader.degrees(at, ROTATION).map(|yaw| [0.0, 0.0, yaw]),
    }
}

/// Reads a list of three values, one for each axis.
fn each_axis(
    reader: &mut Reader,
    at: &At<'_>,
    expected: &str,
    read: impl Fn(&mut Reader, &At<'_>) -> Option<f64>,
) -> Option<Point> {
    let parts = reader.list(at, expected);
    if parts.len() != 3 && matches!(at.node, Node::List(_)) {
        let message = format!("found {} entries", parts.len());
        let hint = match parts.as_slice() {
            [x, y] => match (x.node, y.node) {
                (Node::Number(x), Node::Number(y)) => {
                    let height = if expected == LENGTHS { *y } else { 0.0 };
                    Some(format!("add the height as the third value: `[{x}, {y}, {height}]`"))
                }
                _ => None,
            },
            _ => None,
        };
        reader.add(Code::WrongType, at.place(), message, expected, hint);
        return None;
    }
    // One finding is enough: all three values are likely to have the same fault.
    let numbers: Option<Vec<f64>> = parts.iter().map(|part| read(reader, part)).collect();
    Point::try_from(numbers?).ok()
}
