//! Tests of formations as written.

use super::*;
use crate::files::NoFiles;
use crate::finding::Finding;
use crate::node;
use crate::source::Source;

struct One(&'static [u8]);

impl Files for One {
    fn read(&self, name: &str) -> Result<Source, Finding> {
        NoFiles.read(name)
    }

    fn read_bytes(&self, _name: &str) -> Result<Vec<u8>, Finding> {
        Ok(self.0.to_vec())
    }
}

fn read_with(text: &str, files: &dyn Files) -> (Option<Formation>, Vec<(Code, String)>) {
    let source = Source { name: "f.yaml".into(), text: text.to_owned() };
    let node = node::parse(&source).unwrap();
    let mut reader = Reader::default();
    reader.scope.set("a", Node::Number(2.0));
    let WrittenFormation { formation, .. } = read(&mut reader, files, "f", &At::document(&node, 0));
    let found = reader.found.into_iter().map(|found| (found.code, found.message));
    (formation, found.collect())
}

#[track_caller]
fn check(text: &str, count: usize, expected: &[Point]) {
    let (formation, found) = read_with(text, &NoFiles);
    let places = formation.unwrap_or_else(|| panic!("{found:?}")).places(count).unwrap();
    let rounded = |point: &Point| point.map(|part| (part * 1e6).round() / 1e6 + 0.0);
    assert_eq!(places.iter().map(rounded).collect::<Vec<_>>(), expected, "{text}");
}

#[track_caller]
fn fails(text: &str, code: Code, message: &str) {
    let (formation, found) = read_with(text, &NoFiles);
    assert!(formation.is_none(), "{text}");
    assert_eq!(found.len(), 1, "{text}: {found:?}");
    assert!(found[0].0 == code && found[0].1.contains(message), "{text}: {found:?}");
}

#[test]
fn numbers_may_be_expressions_with_units() {
    check(
        "{line: {spacing: 2 * $a}, at: [$a / 2, 1, \"max(1, $a)\"]}",
        2,
        &[[-1.0, 1.0, 2.0], [3.0, 1.0, 2.0]],
    );
    check("{line: {length: 2}, rotate: pi / 2}", 2, &[[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]]);
    check(
        "{circle: {radius: $a}, rotate: [90, 0, 0], scale: 50%  * $a}",
        2,
        &[[2.0, 0.0, 0.0], [-2.0, 0.0, 0.0]],
    );
    check(
        "{grid: {spacing: [1, $a, 1], columns: $a}}",
        4,
        &[[-0.5, -1.0, 0.0], [0.5, -1.0, 0.0], [-0.5, 1.0, 0.0], [0.5, 1.0, 0.0]],
    );
    fails("{line: {spacing: 2s / 1}}", Code::Expression, "time");
    fails("{line: {spacing: 0.1 * $index}}", Code::Expression, "differs between robots");
    fails("{line: {spacing: $b}}", Code::Variable, "unknown variable `b`");
}

#[test]
fn longest_side_is_scaled_to_size() {
    check("{points: [[0, 0, 0], [1, 2, 0]], size: 4}", 2, &[[-0.5, -1.0, 0.0], [1.5, 3.0, 0.0]]);
    check(
        "{points: [[0, 0, 0], [1, 2, 0]], size: 1, at: [0, 0, 1]}",
        2,
        &[[-0.25, -0.5, 1.0], [0.25, 0.5, 1.0]],
    );
    check("{text: I, size: 3}", 2, &[[0.0, 0.0, -1.5], [0.0, 0.0, 1.5]]);
    check("{text: I, scale: 2, at: [0, 0, 1]}", 2, &[[0.0; 3], [0.0, 0.0, 2.0]]);
    fails("{points: [[0, 0, 1]], size: 1}", Code::WrongType, "all places are at the same point");
    fails("{circle: {radius: 1}, size: 1}", Code::UnknownKey, "already defines its size");
    fails("{text: I, size: 3, scale: 1}", Code::UnknownKey, "`size` and `scale` cannot be combined");
    fails("{text: I, size: 0}", Code::WrongType, "the number 0");
}

#[test]
fn point_clouds_keep_their_coordinates_and_drawings_require_size() {
    let csv = One(b"0,0,1\n4,0,1\n");
    let places = |text: &str| read_with(text, &csv).0.unwrap().places(2).unwrap();
    assert_eq!(places("{cloud: a.csv}"), [[0.0, 0.0, 1.0], [4.0, 0.0, 1.0]]);
    assert_eq!(places("{cloud: a.csv, at: [0, 0, 0], size: 2}"), [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]);
    let svg = One(b"<svg xmlns='http://www.w3.org/2000/svg'><path d='M5 5h8' stroke='red'/></svg>");
    let places = |text: &str| read_with(text, &svg).0.unwrap().places(2).unwrap();
    assert_eq!(places("{svg: a.svg, size: 2, at: [0, 0, 1]}"), [[-1.0, 0.0, 1.0], [1.0, 0.0, 1.0]]);
    assert_eq!(places("{svg: a.svg, scale: 0.5}"), [[-2.0, 0.0, 0.0], [2.0, 0.0, 0.0]]);
    let (formation, found) = read_with("{svg: a.svg}", &svg);
    assert!(formation.is_none() && found[0].0 == Code::MissingKey, "{found:?}");
    let (formation, found) = read_with("{cloud: a.stl}", &svg);
    assert!(formation.is_none() && found[0].0 == Code::BadData, "{found:?}");
    fails("{cloud: a.csv}", Code::Unreadable, "cannot read `a.csv`");
}

#[test]
fn each_fault_causes_one_finding() {
    fails("{}", Code::MissingKey, "has 0 shapes");
    fails("{cirle: {radius: 1}}", Code::UnknownKey, "unknown key `cirle`");
    fails("{line: {spacing: 1}, circle: {radius: 1}}", Code::UnknownKey, "has 2 shapes");
    fails("{circle: {radius: -1}}", Code::WrongType, "-1");
    fails("{circle: {radius: 1, spacing: 1}}", Code::MissingKey, "a circle has no size");
    fails("{grid: {spacing: 1, columns: 1e9}}", Code::WrongType, "1000000000");
    fails("{v: {spacing: 1, angle: 180}}", Code::WrongType, "180");
    fails("{sphere: {}}", Code::MissingKey, "no `radius`");
    fails("{points: []}", Code::NothingToDo, "0 places");
    fails("{points: [[0, 1]]}", Code::WrongType, "2 entries");
    fails("{points: [[0, 0, 1e9]]}", Code::WrongType, "1000000000");
    fails("{text: 50%}", Code::UnknownWord, "`%`");
    fails("{text: ' '}", Code::WrongType, "1 characters");
}
