//! Reads any text as an expression of every kind, and checks invariants of the results. Used by the fuzzer in `fuzz/`.

use std::sync::Arc;

use urrcp::Span;

use super::Robot;
use crate::fields::{At, Reader};
use downbeat_motion::exact::Fraction;
use downbeat_motion::expression::pieces;
use downbeat_motion::music::{Section, Tempo};
use downbeat_yaml::node::Node;

/// Reads the text as a number, a time, a truth value, the value of a variable and a formula.
///
/// # Panics
/// Panics if a finding points outside the text, a number is not finite, or the pieces of a formula have gaps.
pub fn tried(text: &str) {
    let mut reader = Reader::default();
    for (name, value) in [("a", Node::Number(3.0)), ("a-b", Node::Number(-0.5))] {
        reader.scope.set(name, value);
    }
    for (name, text) in [("pace", "2s"), ("beat", "1 beat"), ("third", "1 / 3"), ("late", "$index * 1s")] {
        reader.scope.set(name, Node::Text(text.to_owned()));
    }
    let section = Section { bar: 0, beats_a_minute: Fraction::from_integer(110), beats_a_bar: 4 };
    reader.music.tempo = Some(Arc::new(Tempo::new(&[section])));
    let node = Node::Text(text.to_owned());
    let at = At::document(&node, 0);
    drop(reader.defined(&at));
    reader.robots.current = Some(Robot { index: 2, count: 8 });
    let number = reader.number(&at, "a number");
    assert!(number.is_none_or(f64::is_finite), "{number:?}");
    let length = reader.duration(&at);
    assert!(length.is_none_or(|length| length >= Span::ZERO), "{length:?}");
    let _ = reader.truth(&at);
    drop(reader.defined(&at));
    if let Some(formula) = reader.formula(&at)
        && let Ok(pieces) = pieces(&formula, Span::from_millis(2_000))
    {
        let mut end = Span::ZERO;
        for piece in &pieces {
            assert!(piece.begin == end && piece.end > end, "{piece:?} after {end}");
            end = piece.end;
        }
        assert!(end == Span::from_millis(2_000), "{end}");
    }
    let chars = text.chars().count();
    for found in &reader.found {
        let inside =
            found.place.within.as_ref().is_none_or(|within| within.from + within.width <= chars.max(1));
        assert!(inside, "{found:?}");
    }
}
