//! Reads the paths of an SVG drawing as polylines. `usvg` resolves styles, shapes, `use` and transforms. Texts, pictures, masks, clips,
//! filters and markers are ignored, and external files are never read.

mod cost;

use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::time::Duration;

use usvg::roxmltree::{Document, ParsingOptions};
use usvg::tiny_skia_path::{PathSegment, Point as Flat};
use usvg::{Group, ImageHrefResolver, Node, Options, Tree};

use super::Unfit;
use super::text::FlatStroke;

/// Maximum size of a drawing in bytes.
const BYTES_MAX: usize = 16 * 1024 * 1024;
/// Maximum number of points in all polylines of a drawing.
const POINTS_MAX: usize = 200_000;
/// The attributes that determine the course of paths and shapes.
const SHAPES: [&str; 15] =
    ["d", "points", "r", "rx", "ry", "cx", "cy", "x", "y", "x1", "y1", "x2", "y2", "width", "height"];
/// Largest number in the data of a path or shape. With larger numbers, the library would cut a circular arc into more pieces than it can process in a
/// day.
const NUMBER_MAX: f64 = 1e9;
/// Number of lines that approximate a curve; the error is below a thousandth of the curve's length.
const CHORDS: u8 = 32;
/// Maximum time to read a drawing. Drawings within the other limits take less than a tenth of it.
const PATIENCE: Duration = Duration::from_secs(30);
/// Stack size of the thread that reads a drawing. It reads nested groups recursively, at most 1024 levels deep.
const STACK_BYTES: usize = 64 * 1024 * 1024;

const SVG: &str = "http://www.w3.org/2000/svg";

const EXPECTED: &str = "an SVG drawing with at least one visible path";

/// Returns the visible paths of a drawing, with the y axis upward, in the unit of the drawing.
///
/// # Errors
/// Returns the fault if the file is not SVG, has no paths, or has too many.
pub fn read(bytes: &[u8]) -> Result<Vec<FlatStroke>, Unfit> {
    if bytes.len() > BYTES_MAX {
        let message = format!("the drawing has {} bytes", bytes.len());
        return Err(Unfit { message, expected: "an SVG drawing of at most 16 MiB" });
    }
    read_within(bytes.to_vec(), PATIENCE)
}

/// Reads a drawing in a thread of its own, because a drawing that crashes the library must not end this program. If the thread takes
/// longer than `patience`, it is abandoned, and ends with the process at the latest.
pub(super) fn read_within(bytes: Vec<u8>, patience: Duration) -> Result<Vec<FlatStroke>, Unfit> {
    let (read, lines) = sync_channel(1);
    let thread = std::thread::Builder::new().stack_size(STACK_BYTES);
    let started = thread.spawn(move || read.send(lines_of(&bytes)));
    let lines = started.map(|_| lines.recv_timeout(patience));
    match lines {
        Ok(Ok(lines)) => lines,
        Ok(Err(RecvTimeoutError::Timeout)) => {
            let message = format!("the drawing takes longer than {} s to read", patience.as_secs());
            Err(Unfit { message, expected: "a simpler drawing" })
        }
        _ => Err(Unfit { message: "the drawing cannot be read".to_owned(), expected: EXPECTED }),
    }
}

fn lines_of(bytes: &[u8]) -> Result<Vec<FlatStroke>, Unfit> {
    let nothing = || ImageHrefResolver {
        resolve_data: Box::new(|_, _, _| None),
        resolve_string: Box::new(|_, _| None),
    };
    let options = Options { image_href_resolver: nothing(), ..Options::default() };
    let unfit = |error| Unfit { message: format!("this is not an SVG drawing: {error}"), expected: EXPECTED };
    let text = std::str::from_utf8(bytes).map_err(|_| unfit(usvg::Error::NotAnUtf8Str))?;
    let parsing = ParsingOptions { allow_dtd: true, ..ParsingOptions::default() };
    let text = cost::without_effects(text);
    let document = Document::parse_with_options(&text, parsing).map_err(|error| unfit(error.into()))?;
    let shapes = document.descendants().flat_map(|node| node.attributes());
    let shapes = shapes.filter(|attribute| SHAPES.contains(&attribute.name()));
    let mut in_shapes = shapes.flat_map(|attribute| numbers(attribute.value()));
    if let Some(number) = in_shapes.find(|number| number.abs() > NUMBER_MAX) {
        let message =
            format!("a path or shape of the drawing contains a number that is too large: {number:e}");
        return Err(Unfit { message, expected: "numbers of at most one billion in paths and shapes" });
    }
    if let Some(unfit) = cost::excess(&document) {
        return Err(unfit);
    }
    let tree = Tree::from_xmltree(&document, &options).map_err(unfit)?;
    let mut pen = Pen::default();
    pen.group(tree.root());
    if pen.points > POINTS_MAX {
        let message = format!("the paths of the drawing have more than {POINTS_MAX} points");
        return Err(Unfit { message, expected: "a simpler drawing" });
    }
    if pen.lines.is_empty() {
        // The tree contains no texts, because no fonts are loaded, so the document is searched.
        let message = if document.descendants().any(|node| node.has_tag_name((SVG, "text"))) {
            "the drawing has only text and no paths: convert the text to paths"
        } else {
            "the drawing has no paths"
        };
        return Err(Unfit { message: message.to_owned(), expected: EXPECTED });
    }
    Ok(pen.lines)
}

/// Returns the numbers in a path's data, regardless of its commands. No spaces are needed between numbers: `1.5.5-2e3` is 1.5, 0.5 and
/// -2000. Two flags of an arc may be parsed as one number with the digits after them.
fn numbers(data: &str) -> impl Iterator<Item = f64> {
    let of_number = |c: char| c.is_ascii_digit() || "+-.eE".contains(c);
    data.split(move |c| !of_number(c)).flat_map(|run| {
        // A sign begins a number unless it belongs to an exponent.
        let run = run.to_ascii_lowercase().replace("e+", "e").replace("e-", "e~").replace('-', "+");
        let numbers = run.split('+').flat_map(|number| {
            let mut parts = number.split('.');
            let whole: Vec<&str> = parts.by_ref().take(2).collect();
            let whole = whole.join(".");
            let further = parts.map(|part| format!("0.{part}"));
            std::iter::once(whole).chain(further).collect::<Vec<_>>()
        });
        let numbers = numbers.filter_map(|number| number.replace('~', "-").parse().ok());
        numbers.collect::<Vec<f64>>()
    })
}

/// Collects the polylines of a drawing, and counts their points.
#[derive(Default)]
struct Pen {
    lines: Vec<FlatStroke>,
    points: usize,
}

impl Pen {
    fn group(&mut self, group: &Group) {
        for node in group.children() {
            match node {
                Node::Group(group) => self.group(group),
                Node::Path(path) if path.is_visible() => {
                    if let Some(data) = path.data().clone().transform(path.abs_transform()) {
                        self.path(data.segments());
                    }
                }
                _ => {}
            }
        }
    }

    fn path(&mut self, segments: impl Iterator<Item = PathSegment>) {
        let (mut begin, mut last) = (Flat::zero(), Flat::zero());
        for segment in segments {
            match segment {
                PathSegment::MoveTo(to) => {
                    self.lines.push(vec![flat(to)]);
                    (begin, last) = (to, to);
                }
                PathSegment::LineTo(to) => {
                    self.to(flat(to));
                    last = to;
                }
                PathSegment::QuadTo(control, to) => {
                    self.curve(&[last, control, to]);
                    last = to;
                }
                PathSegment::CubicTo(first, second, to) => {
                    self.curve(&[last, first, second, to]);
                    last = to;
                }
                PathSegment::Close => {
                    self.to(flat(begin));
                    last = begin;
                }
            }
        }
    }

    fn to(&mut self, point: [f64; 2]) {
        self.points += 1;
        if let Some(line) = self.lines.last_mut().filter(|_| self.points <= POINTS_MAX) {
            line.push(point);
        }
    }

    /// Approximates a Bézier curve by lines, with de Casteljau's algorithm.
    fn curve(&mut self, controls: &[Flat]) {
        for chord in 1..=CHORDS {
            let share = f64::from(chord) / f64::from(CHORDS);
            let mut points: Vec<[f64; 2]> = controls.iter().map(|point| flat(*point)).collect();
            while points.len() > 1 {
                let between = |pair: &[[f64; 2]]| {
                    std::array::from_fn(|axis| pair[0][axis] + share * (pair[1][axis] - pair[0][axis]))
                };
                points = points.windows(2).map(between).collect();
            }
            self.to(points[0]);
        }
    }
}

/// Converts a point of the drawing, and turns its y axis upward.
fn flat(point: Flat) -> [f64; 2] {
    [f64::from(point.x), -f64::from(point.y)]
}
