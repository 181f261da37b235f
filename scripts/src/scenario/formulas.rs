//! A track that is a formula: `formula: "90 * sin(360 * t / 8s)", for: 8s`.

use urrcp::Span;

use super::track::{Written, positive_time};
use crate::expression::{Formula, Piece, Trouble, pieces, seconds_of};
use crate::fields::{At, Reader};
use crate::finding::Code;
use crate::motion::{Between, Curve, FormulaPart, Function, Knot, Shape};

/// The item index of a knot that does not correspond to an item in the file.
const NO_ITEM: u32 = u32::MAX;
/// Assumed number of evaluations of a formula, which counts against the budget of all expressions.
const LOOKS: usize = 64;
/// Share of the largest value: a difference between two values that is below this share is not a jump.
const GAP: f64 = 1e-6;

/// Reads the formula of a track at `formula_at`, and the track's duration.
pub(super) fn moved(
    reader: &mut Reader,
    at: &At<'_>,
    formula_at: &At<'_>,
    length: Option<At<'_>>,
) -> Option<Written> {
    let formula = reader.formula(formula_at);
    let Some(length) = length else {
        let hint = Some("add the duration, as in `for: 8s`".to_owned());
        reader.add(Code::MissingKey, at.place(), "the formula has no `for`", "a key `for`", hint);
        return None;
    };
    let exact = positive_time(reader, &length)?;
    let formula = formula?;
    let length = reader.music.start.lay(exact);
    if !reader.evaluations.take(formula.steps().saturating_mul(LOOKS)) {
        return None;
    }
    match pieces(&formula, length) {
        Ok(pieces) => Some(Written::new(curve(&formula, &pieces), exact)),
        Err(trouble) => {
            let (message, expected) = match trouble {
                Trouble::NoValue(time) => {
                    (format!("the formula has no value at {time}"), "a number at every time")
                }
                Trouble::TooMany => (
                    "the formula has too many turns, corners or jumps".to_owned(),
                    "a movement with fewer pieces",
                ),
            };
            let hint = match trouble {
                Trouble::NoValue(_) => {
                    "use `if` to avoid a division by zero or the root of a negative number"
                }
                Trouble::TooMany if formula.is_random() => {
                    "keep each random number for some time, as in `random(7, floor(t / 2s))`"
                }
                Trouble::TooMany => "use a shorter duration and `repeat` it",
            };
            reader.add(Code::BadMotion, formula_at.place(), message, expected, Some(hint.to_owned()));
            None
        }
    }
}

/// Turns each smooth piece of a formula into a function, and each jump into two knots.
fn curve(formula: &Formula, pieces: &[Piece]) -> Curve {
    let at = |time: Span| formula.at(seconds_of(time));
    let largest =
        pieces.iter().map(|piece| at(piece.begin).abs()).fold(at(length_of(pieces)).abs(), f64::max);
    let begin = Shape::Sampled(Between::Linear);
    let mut knots = vec![Knot { at: Span::ZERO, to: at(Span::ZERO), shape: begin, item: NO_ITEM }];
    let mut functions = Vec::new();
    for (index, piece) in pieces.iter().enumerate() {
        let (before, to) = (knots.last().map_or(0.0, |knot| knot.to), at(piece.end));
        let Some((slope_max, curvature_max)) = piece.rates else {
            let slopes = pieces.iter().skip(index.saturating_sub(1)).take(3).filter_map(|piece| piece.rates);
            let steep = slopes.map(|(slope, _)| slope).fold(0.0, f64::max);
            let moved = 2.0 * steep * (piece.end - piece.begin).as_millis_f64() / 1_000.0;
            let jumps = (to - before).abs() > moved + GAP * largest;
            match jumps {
                false => {}
                // At the very beginning, the value of a formula is the value after the jump; at the very end, the value before it.
                true if index == 0 => knots[0].to = to,
                true if index + 1 == pieces.len() => {}
                true => {
                    knots.push(Knot { at: piece.begin, to, shape: Shape::Meets, item: NO_ITEM });
                    continue;
                }
            }
            let to = if jumps && index + 1 == pieces.len() { before } else { to };
            knots.push(Knot { at: piece.end, to, shape: begin, item: NO_ITEM });
            continue;
        };
        let part = FormulaPart {
            formula: formula.clone(),
            from: seconds_of(piece.begin),
            to: seconds_of(piece.end),
            slope_max,
            curvature_max,
        };
        let number = u32::try_from(functions.len()).unwrap_or(u32::MAX);
        functions.push(Function::Formula(Box::new(part)));
        let shape = Shape::Function { index: number, gain: 1.0, offset: 0.0, reversed: false };
        knots.push(Knot { at: piece.end, to, shape, item: NO_ITEM });
    }
    Curve::new(knots, functions)
}

fn length_of(pieces: &[Piece]) -> Span {
    pieces.last().map_or(Span::ZERO, |piece| piece.end)
}
