use std::sync::Arc;

use proptest::prelude::*;
use urrcp::Span;

use super::*;
use crate::fields::{At, Reader};
use downbeat_motion::exact::Fraction;
use downbeat_motion::expression::{Piece, Trouble, is_one, pieces};
use downbeat_motion::music::{Section, Tempo};
use downbeat_yaml::node::Node;

fn reader() -> Reader {
    let mut reader = Reader::default();
    for (name, value) in [("a", Node::Number(3.0)), ("half", Node::Number(0.5)), ("a-b", Node::Number(7.0))] {
        reader.scope.set(name, value);
    }
    for (name, text) in [("pace", "2s"), ("beat", "1 beat"), ("third", "1 / 3"), ("word", "hello")] {
        reader.scope.set(name, Node::Text(text.to_owned()));
    }
    let section = Section { bar: 0, beats_a_minute: Fraction::from_integer(110), beats_a_bar: 4 };
    reader.music.tempo = Some(Arc::new(Tempo::new(&[section])));
    reader.robots.current = Some(Robot { index: 2, count: 8 });
    reader
}

#[track_caller]
fn number(text: &str) -> f64 {
    let (mut reader, node) = (reader(), Node::Text(text.to_owned()));
    let found = reader.number(&At::document(&node, 0), "a number");
    found.unwrap_or_else(|| panic!("{text}: {:?}", reader.found))
}

#[track_caller]
fn nanos(text: &str) -> i64 {
    let (mut reader, node) = (reader(), Node::Text(text.to_owned()));
    let found = reader.duration(&At::document(&node, 0));
    found.unwrap_or_else(|| panic!("{text}: {:?}", reader.found)).as_nanos()
}

/// Reads a wrong number. Returns the characters that the finding marks, its message, and its hint.
#[track_caller]
fn fault(text: &str) -> (String, String, Option<String>) {
    let (mut reader, node) = (reader(), Node::Text(text.to_owned()));
    assert_eq!(reader.number(&At::document(&node, 0), "a number"), None, "{text}");
    assert_eq!(reader.found.len(), 1, "{text}");
    let found = reader.found.remove(0);
    let within = found.place.within.unwrap_or_else(|| panic!("{text} has no place"));
    (text.chars().skip(within.from).take(within.width).collect(), found.message, found.hint)
}

#[test]
fn arithmetic_is_evaluated_as_on_paper() {
    for (text, value) in [
        ("1 + 2 * 3", 7.0),
        ("(1 + 2) * 3", 9.0),
        ("2 - 3 - 4", -5.0),
        ("-$a * -2", 6.0),
        ("8 / 4 / 2", 1.0),
        ("7 % 3 + -7 % 3", 3.0),
        ("mod(-1, 8)", 7.0),
        ("0.1 + 0.2", 0.3),
        ("$third * 3", 1.0),
        ("$a-1", 2.0),
        ("$a-b", 7.0),
        ("$a -$half", 2.5),
        ("sqrt(2) * sqrt(2) - 2", 4.440_892_098_500_626e-16),
        ("sqrt(1 / 4)", 0.5),
        ("min(3, 1, 2) + max(1, 2)", 3.0),
        ("abs(-3) + floor(-1.5) + ceil(1.2) + round(2.5)", 6.0),
        ("50% * 90", 45.0),
        ("20% * 50% * 100", 10.0),
        ("$index", 2.0),
        ("360 * $index / $count", 90.0),
        ("if($index < 3 and not $count == 7, 10, 20)", 10.0),
        ("if($a > 5 or false, 10, 1 + 1)", 2.0),
        ("if($a == 3, 1, 1 / 0)", 1.0),
        ("8s / 4s", 2.0),
        ("$pace / 500ms", 4.0),
        ("$beat * 6 / 2 beats", 3.0),
        ("1 / (2 / 1s) / 1s", 0.5),
    ] {
        assert_eq!(number(text), value, "{text}");
    }
}

#[test]
fn plain_angles_are_degrees_and_multiples_of_pi_are_radians() {
    for (text, value) in [
        ("sin(30)", 0.5),
        ("sin(180)", 0.0),
        ("cos(90)", 0.0),
        ("tan(45)", 1.0),
        ("sin(pi)", 0.0),
        ("cos(2 * pi)", 1.0),
        ("sin(pi / 6)", 0.5),
        ("sin(360 * $index / $count)", 1.0),
        ("sin(2 * pi * $index / $count)", 1.0),
    ] {
        assert!((number(text) - value).abs() < 1e-15, "{text}: {}", number(text));
    }
    assert!((number("sin(1.5rad)") - 1.5f64.sin()).abs() < 1e-15);
    assert!((number("2 * pi * $a") - 6.0 * std::f64::consts::PI).abs() < 1e-12);
    let (mut reader, node) = (reader(), Node::Text("pi / 2".to_owned()));
    assert_eq!(reader.degrees(&At::document(&node, 0), "a phase"), Some(90.0));
}

#[test]
fn times_are_calculated_exactly_including_beats() {
    for (text, value) in [
        ("8s / 4", 2_000_000_000),
        ("$pace * 3 / 7 * 7", 6_000_000_000),
        ("1m30s + 00:00:00.5", 90_500_000_000),
        ("$index * 500ms", 1_000_000_000),
        ("if($a < 2, 1s, 250ms)", 250_000_000),
        ("7s % 2s", 1_000_000_000),
        ("max(1s, $pace)", 2_000_000_000),
        // A beat lasts 6/11 s.
        ("11 * $beat", 6_000_000_000),
        ("1 bar 1 beat * 2 + 1 beat", 6_000_000_000),
        ("1 bar - 4 beats + 1us", 1_000),
    ] {
        assert_eq!(nanos(text), value, "{text}");
    }
}

#[test]
fn faults_are_reported_at_their_characters() {
    for (text, at, message) in [
        ("1 + $b", "$b", "unknown variable `b`"),
        ("1 + sine(3)", "sine", "unknown name `sine`"),
        ("2 * (3 + 4", "(", "missing closing bracket"),
        ("2 * 3)", ")", "unexpected `)` after a value"),
        ("$a + ", "+", "unexpected end of the expression"),
        ("$a * 1,5", ",", "unexpected `,` after a value"),
        ("$a + 5s", "+", "a plain number and a time cannot be added"),
        ("$a / ($a - 3)", "/", "division by zero"),
        ("sqrt(-1)", "sqrt", "`sqrt` is not defined for -1"),
        ("$a < 3 ? 1 : 2", "?", "unexpected `?` after a value"),
        ("2 * 3deg", "3deg", "invalid value `3deg`"),
        ("1 < $a < 3", "<", "two comparisons in a row"),
        ("$a + $word", "$word", "`$word` is the text `hello`"),
        ("2 * $pace", "2 * $pace", "the result of the expression is a time"),
        ("1 + t", "t", "`t` is not defined here"),
        ("sin(1, 2)", "sin", "`sin` has 2 arguments"),
        ("$a == 1s", "==", "a plain number and a time cannot be compared"),
        ("sin(90 + pi)", "+", "a plain number and an angle cannot be added"),
        ("tan(90)", "tan", "`tan` is not defined at this angle"),
        ("5 * 3 s", "s", "`s` after a number"),
    ] {
        let (found, said, _) = fault(text);
        assert_eq!((found.as_str(), said.as_str()), (at, message), "{text}");
    }
    assert_eq!(fault("$a * 1,5").2.as_deref(), Some("write a decimal point: `1.5`"));
    assert_eq!(fault("1 + sine(3)").2.as_deref(), Some("did you mean `sin`?"));
    assert_eq!(fault("$a && $b").2.as_deref(), Some("write `and`"));
    assert_eq!(fault("5 * 3 s").2.as_deref(), Some("write `3s`"));
}

#[test]
fn index_is_available_only_within_robot_actions() {
    let (mut reader, node) = (reader(), Node::Text("$index * 2".to_owned()));
    reader.robots.current = None;
    assert_eq!(reader.number(&At::document(&node, 0), "a number"), None);
    assert!(reader.found[0].message.contains("differs between robots"), "{:?}", reader.found);
}

#[test]
fn plain_texts_are_not_expressions() {
    for text in ["front-left", "45,5", "45deg", "hello", "1:30", "-1s", "n.a."] {
        assert!(!is_one(text) || text == "-1s", "{text}");
    }
    for text in ["pay $me now", "cost $5", "a/b.csv", "3/4"] {
        assert!(!names_variables(text), "{text}");
    }
    assert!(names_variables("2 * $a") && names_variables("sin($a)") && names_variables("-$a / 2"));
}

#[test]
fn variables_are_evaluated_where_they_are_defined() {
    let mut reader = reader();
    reader.robots.current = None;
    let mut define = |name: &str, text: &str| {
        let node = Node::Text(text.to_owned());
        let value =
            reader.defined(&At::document(&node, 0)).unwrap_or_else(|| panic!("{text}: {:?}", reader.found));
        reader.scope.set(name, value.clone());
        value
    };
    assert_eq!(define("b", "2 * $a"), Node::Number(6.0));
    assert_eq!(define("slow", "$pace * 2"), Node::Text("4s".into()));
    assert_eq!(define("third", "1 / $a"), Node::Text("(1 / 3)".into()));
    assert_eq!(
        define("phase", "360 * $index / $count + $b"),
        Node::Text("360 * $index / $count + (6)".into())
    );
    assert_eq!(
        define("late", "$phase / 360 * $slow"),
        Node::Text("(360 * $index / $count + (6)) / 360 * (4s)".into())
    );
    reader.robots.current = Some(Robot { index: 1, count: 4 });
    let node = Node::Text("$late * 2".to_owned());
    let late = reader.duration(&At::document(&node, 0));
    assert_eq!(late.map(Span::as_millis_f64), Some(2_133.333_333), "{:?}", reader.found);
    assert_eq!(number("$third * 3"), 1.0);
}

#[test]
fn too_deep_or_too_long_expressions_are_refused() {
    let deep = "(".repeat(1_500);
    assert!(fault(&deep).1.contains("too deeply"));
    assert!(fault(&format!("{}1", "-".repeat(1_500))).1.contains("too deeply"));
    assert!(fault(&"1+".repeat(1_500)).1.contains("more than"));
    let mut reader = reader();
    reader.robots.current = None;
    let mut grown = true;
    for n in 0..200 {
        let text = if n == 0 { "$index + 1".to_owned() } else { format!("$x{} * $x{}", n - 1, n - 1) };
        let node = Node::Text(text);
        match reader.defined(&At::document(&node, 0)) {
            Some(value) => reader.scope.set(format!("x{n}"), value),
            None => {
                grown = false;
                break;
            }
        }
    }
    assert!(!grown, "a variable that is longer than can be");
}

fn formula(text: &str) -> Formula {
    let (mut reader, node) = (reader(), Node::Text(text.to_owned()));
    let found = reader.formula(&At::document(&node, 0));
    found.unwrap_or_else(|| panic!("{text}: {:?}", reader.found))
}

#[test]
fn formulas_give_values_over_time() {
    for (text, seconds, value) in [
        ("$a * cos(2 * pi * t / 8s)", 2.0, 0.0),
        ("$a * cos(360 * t / 8s)", 4.0, -3.0),
        ("10 * t / 1s", 1.5, 15.0),
        ("mod(t, 2s) / 1s", 3.0, 1.0),
        ("if(t < $pace, 1, 5)", 3.0, 5.0),
        ("min(t / 1s, 2, 4)", 3.0, 2.0),
        ("$index", 1.0, 2.0),
        ("t * t / (1s * 1s)", 3.0, 9.0),
    ] {
        assert!((formula(text).at(seconds) - value).abs() < 1e-12, "{text}: {}", formula(text).at(seconds));
    }
    let mut reader = reader();
    for wrong in ["10 * t", "sin(t)", "t < 3s", "t + 1", "$nothing * t / 1s"] {
        let node = Node::Text(wrong.to_owned());
        assert!(reader.formula(&At::document(&node, 0)).is_none(), "{wrong}");
    }
}

#[test]
fn pieces_end_within_nanoseconds_of_corners_and_jumps() {
    let found =
        |text: &str, seconds: i64| pieces(&formula(text), Span::from_millis(1_000 * seconds)).unwrap();
    // For each time in `wanted`, a piece begins within 2.5 ns of it.
    let cut_at = |pieces: &[Piece], wanted: &[f64]| {
        for wanted in wanted {
            let near = |at: Span| (at.as_millis_f64() - wanted).abs() < 2.5e-6;
            assert!(pieces.iter().any(|piece| near(piece.begin)), "{wanted}: {pieces:?}");
        }
    };
    cut_at(&found("abs(sin(360 * t / 8s + 36))", 8), &[3_200.0, 7_200.0]);
    cut_at(&found("abs(4 - t / 1s)", 8), &[4_000.0]);
    cut_at(&found("mod(t, 3s) / 1s", 8), &[3_000.0, 6_000.0]);
    cut_at(&found("if(t < 450ms, 1, 2)", 8), &[450.0]);
    let smooth = found("sin(360 * t / 8s)", 8);
    assert!(smooth.len() < 64 && smooth.iter().all(|piece| piece.rates.is_some()), "{smooth:?}");
    let trouble = |text: &str| pieces(&formula(text), Span::from_millis(4_000)).unwrap_err();
    assert!(matches!(trouble("1 / (t / 1s - 2)"), Trouble::NoValue(_)));
    assert_eq!(trouble("floor(1000000 * t / 1s)"), Trouble::TooMany);
}

proptest! {
    #[test]
    fn arbitrary_text_never_panics(text in "[-$a-c0-9.()+*/%<>=, tsmi!?&|:]{0,40}") {
        tried(&text);
    }

    /// The slope and the curvature of a formula stay within the computed bounds everywhere in each piece.
    #[test]
    fn slopes_and_curvatures_stay_within_their_bounds(
        kind in 0usize..8, p in 1i32..9, q in 1i32..9,
    ) {
        let text = [
            format!("{p} * sin(360 * t / {q}s)"),
            format!("{p} * t / {q}s * cos(90 * t / 1s)"),
            format!("sqrt({p} + t / {q}s)"),
            format!("{p} / (1 + t / {q}s)"),
            format!("abs({p} - t / 1s) * {q}"),
            format!("max({p} * sin(200 * t / 1s), t / {q}s)"),
            format!("if(t < {p}s, t / 1s, {q} * t / 2s)"),
            format!("mod({p} * t, {q}s) / 1s"),
        ][kind].clone();
        let formula = formula(&text);
        for piece in pieces(&formula, Span::from_millis(6_000)).unwrap() {
            let Some((slope, curvature)) = piece.rates else { continue };
            let (from, to) = (piece.begin.as_millis_f64() / 1e3, piece.end.as_millis_f64() / 1e3);
            if to - from < 1e-4 {
                continue;
            }
            let h = (to - from) / 64.0;
            for part in 0..63 {
                let a = from + h * f64::from(part);
                let (x, y, z) = (formula.at(a), formula.at(a + h / 2.0), formula.at(a + h));
                prop_assert!((z - x).abs() <= slope * h * 1.000_001 + 1e-9, "{text} at {a}");
                prop_assert!((x - 2.0 * y + z).abs() <= curvature * h * h / 4.0 * 1.000_001 + 1e-9, "{text} at {a}");
            }
        }
    }
}
