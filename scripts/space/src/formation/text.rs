//! Texts as strokes. The letters are Downbeat's own: `letters.txt` contains the centre line of each stroke, not an outline, so that
//! strokes are one robot wide.

use std::collections::HashMap;
use std::sync::LazyLock;

/// Height of a capital letter, in the unit of `letters.txt`.
pub const LETTER_HEIGHT: f64 = 6.0;
/// Distance between two letters, in the unit of `letters.txt`.
const GAP: f64 = 2.0;
/// Width of a space, in the unit of `letters.txt`.
const SPACE: f64 = 3.0;
/// Distance between the base lines of two lines, in the unit of `letters.txt`.
const LINE_HEIGHT: f64 = 10.0;

/// A stroke in the plane: the points of a polyline, as x and y.
pub type FlatStroke = Vec<[f64; 2]>;

struct Letter {
    width: f64,
    strokes: Vec<FlatStroke>,
}

static LETTERS: LazyLock<HashMap<char, Letter>> = LazyLock::new(|| {
    let lines = include_str!("letters.txt").lines().filter(|line| !line.starts_with('#'));
    lines.filter_map(letter).collect()
});

fn letter(line: &str) -> Option<(char, Letter)> {
    let (name, rest) = line.split_once(' ')?;
    let (width, strokes) = rest.split_once(' ')?;
    let point = |text: &str| {
        let (x, y) = text.split_once(',')?;
        Some([x.parse().ok()?, y.parse().ok()?])
    };
    let stroke = |text: &str| text.split_whitespace().map(point).collect::<Option<FlatStroke>>();
    let strokes = strokes.split('|').map(stroke).collect::<Option<Vec<_>>>()?;
    Some((name.chars().next()?, Letter { width: width.parse().ok()?, strokes }))
}

/// Returns every character that has strokes, in the order of code points.
pub fn letters() -> String {
    let mut all: Vec<char> = LETTERS.keys().copied().collect();
    all.sort_unstable();
    all.into_iter().collect()
}

/// Returns the strokes of a text, in the unit of `letters.txt`. Lower-case letters become capitals; lines are below each other and
/// centred.
///
/// # Errors
/// Returns the first character that has no strokes.
pub fn strokes_of(text: &str) -> Result<Vec<FlatStroke>, char> {
    let mut strokes = Vec::new();
    let mut top = 0.0;
    for line in text.lines() {
        let mut along: f64 = 0.0;
        let mut of_line: Vec<FlatStroke> = Vec::new();
        for c in line.chars().flat_map(char::to_uppercase) {
            if c.is_whitespace() {
                along += SPACE;
                continue;
            }
            let letter = LETTERS.get(&c).ok_or(c)?;
            let moved = |stroke: &FlatStroke| stroke.iter().map(|[x, y]| [x + along, y + top]).collect();
            of_line.extend(letter.strokes.iter().map(moved));
            along += letter.width + GAP;
        }
        let half = (along - GAP).max(0.0) / 2.0;
        of_line.iter_mut().flatten().for_each(|[x, _]| *x -= half);
        strokes.extend(of_line);
        top -= LINE_HEIGHT;
    }
    Ok(strokes)
}
