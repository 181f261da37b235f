//! Tests of places along strokes of texts and drawings.

use std::sync::Arc;

use proptest::prelude::*;

use super::super::crowd::{distance, nearest_pair};
use super::super::{Formation, Placing, Point, Shape, Strokes, svg, text};
use super::same;

fn of(lines: &[Vec<Point>]) -> Formation {
    Formation { shape: Shape::Strokes(Arc::new(Strokes::of(lines))), placing: Placing::default() }
}

fn upright(strokes: &[text::FlatStroke]) -> Formation {
    let lines: Vec<Vec<Point>> =
        strokes.iter().map(|line| line.iter().map(|[x, y]| [*x, 0.0, *y]).collect()).collect();
    of(&lines)
}

fn written(word: &str) -> Formation {
    upright(&text::strokes_of(word).unwrap())
}

fn drawn(inner: &str) -> Formation {
    let drawing =
        format!(r#"<svg xmlns="http://www.w3.org/2000/svg" width="100" height="100">{inner}</svg>"#);
    upright(&svg::read(drawing.as_bytes()).unwrap())
}

fn nearest(formation: &Formation, count: usize) -> f64 {
    let places = formation.places(count).unwrap();
    assert_eq!(places.len(), count);
    nearest_pair(&places).unwrap().distance
}

#[test]
fn stroke_has_places_at_its_ends_and_evenly_between() {
    let stroke = of(&[vec![[0.0; 3], [1.0, 0.0, 0.0], [4.0, 0.0, 0.0]]]);
    same(&stroke.places(1).unwrap(), &[[2.0, 0.0, 0.0]]);
    same(&stroke.places(2).unwrap(), &[[0.0; 3], [4.0, 0.0, 0.0]]);
    same(&stroke.places(3).unwrap(), &[[0.0; 3], [2.0, 0.0, 0.0], [4.0, 0.0, 0.0]]);
    assert!(stroke.places(0).unwrap().is_empty());
}

#[test]
fn strokes_are_cut_at_junctions_so_that_places_are_distinct() {
    let letter = written("H");
    same(
        &letter.places(6).unwrap(),
        &[
            [-2.0, 0.0, 0.0],
            [-2.0, 0.0, 3.0],
            [-2.0, 0.0, 6.0],
            [2.0, 0.0, 0.0],
            [2.0, 0.0, 3.0],
            [2.0, 0.0, 6.0],
        ],
    );
    assert!((nearest(&letter, 11) - 1.5).abs() < 1e-9, "{}", nearest(&letter, 11));
}

#[test]
fn closed_path_is_divided_evenly() {
    let square = drawn(r#"<rect x="10" y="10" width="40" height="40"/>"#);
    assert!((nearest(&square, 8) - 20.0).abs() < 1e-3);
    let circle = drawn(r#"<circle cx="50" cy="50" r="40"/>"#);
    for count in [3, 12, 50] {
        let chord = 80.0 * (std::f64::consts::PI / f64::from(count)).sin();
        let nearest = nearest(&circle, usize::try_from(count).unwrap());
        assert!((nearest / chord - 1.0).abs() < 0.01, "{count}: {nearest} of {chord}");
    }
}

#[test]
fn every_letter_gives_any_number_of_distinct_places() {
    for letter in text::letters().chars() {
        let letter = letter.to_string();
        let formation = written(&letter);
        let strokes = text::strokes_of(&letter).unwrap();
        if strokes.iter().all(|stroke| stroke.len() == 1) {
            continue;
        }
        assert_eq!(formation.places(1).unwrap().len(), 1);
        let sides = strokes.iter().flat_map(|stroke| stroke.windows(2));
        let length: f64 = sides.map(|pair| (pair[0][0] - pair[1][0]).hypot(pair[0][1] - pair[1][1])).sum();
        for count in 2..40 {
            let nearest = nearest(&formation, count);
            let even = length / f64::from(u32::try_from(count).unwrap());
            assert!(nearest > 0.25 * even, "{letter} {count}: {nearest} of {even}");
        }
    }
}

#[test]
fn crossing_strokes_have_distinct_places() {
    let cross = of(&[vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]], vec![[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]]);
    for count in 2..30 {
        let even = 4.0 / f64::from(u32::try_from(count).unwrap());
        assert!(nearest(&cross, count) > 0.25 * even, "{count}: {}", nearest(&cross, count));
    }
}

#[test]
fn text_lines_are_centred_and_lowercase_equals_uppercase() {
    assert_eq!(text::strokes_of("go").unwrap(), text::strokes_of("GO").unwrap());
    assert_eq!(text::strokes_of("a%"), Err('%'));
    let all: Vec<[f64; 2]> = text::strokes_of("I\nHI").unwrap().concat();
    let side = |pick: fn(f64, f64) -> f64| all.iter().map(|point| point[0]).reduce(pick).unwrap();
    assert_eq!((side(f64::min), side(f64::max)), (-3.0, 3.0));
    assert_eq!(all.iter().map(|point| point[1]).reduce(f64::min), Some(-10.0));
}

#[test]
fn drawing_has_y_axis_up_and_resolved_groups_and_styles() {
    let line = r#"<g transform="translate(10 20) scale(2)"><path d="M0 0 h10" stroke="red"/></g>"#;
    let hidden = r#"<path d="M0 0 h90" style="display:none" stroke="red"/><path d="M0 0 h90" fill="none"/>"#;
    let used = r##"<defs><path id="p" d="M0 0 v10" stroke="red"/></defs><use href="#p" x="70"/>"##;
    same(&drawn(&format!("{line}{hidden}")).places(2).unwrap(), &[[10.0, 0.0, -20.0], [30.0, 0.0, -20.0]]);
    same(&drawn(used).places(2).unwrap(), &[[70.0, 0.0, 0.0], [70.0, 0.0, -10.0]]);
}

#[test]
fn invalid_drawing_is_refused() {
    let refused = |bytes: &[u8]| svg::read(bytes).unwrap_err().message;
    assert!(refused(b"solid").contains("not an SVG"));
    assert!(refused(b"\xff\xfe").contains("not an SVG"));
    assert!(refused(b"<svg xmlns='http://www.w3.org/2000/svg'/>").contains("no paths"));
}

#[test]
fn deeply_nested_groups_and_multiplied_paths_terminate() {
    let begin = r#"<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">"#;
    let deep = format!(
        "{begin}{}<path d='M0 0h9' stroke='red'/>{}</svg>",
        "<g opacity='0.5'>".repeat(1_000),
        "</g>".repeat(1_000)
    );
    let _ = svg::read(deep.as_bytes());
    let mut laughs = format!("{begin}<path id='a0' d='M0 0h9' stroke='red'/>");
    for level in 1..12 {
        let uses = format!("<use xlink:href='#a{}'/>", level - 1).repeat(10);
        laughs.push_str(&format!("<g id='a{level}'>{uses}</g>"));
    }
    laughs.push_str("</svg>");
    assert!(svg::read(laughs.as_bytes()).is_err());
}

/// Returns a drawing with this content.
fn drawing(content: &str) -> Vec<u8> {
    format!("<svg xmlns='http://www.w3.org/2000/svg'>{content}</svg>").into_bytes()
}

#[test]
fn nested_effects_do_not_multiply() {
    // Each level refers to the level below four times. The library would convert 4^30 paths.
    for (element, property) in
        [("mask", "mask"), ("clipPath", "clip-path"), ("pattern", "fill"), ("marker", "marker-mid")]
    {
        let mut nested = format!("<{element} id='r0'><path d='M0 0L1 1'/></{element}>");
        let mut sheet = String::new();
        for level in 1..30 {
            let below = level - 1;
            let by_attribute = format!("<path {property} = 'url(#r{below})' d='M0 0L1 1L2 0z'/>").repeat(2);
            let by_style =
                format!("<path style='stroke: red; {property}: url(\"#r{below}\")' d='M0 0L1 1L2 0z'/>");
            let by_sheet = format!("<path class='c{level}' d='M0 0L1 1L2 0z'/>");
            sheet.push_str(&format!(".c{level} {{ {} : url(#r{below}) }}", property.to_uppercase()));
            nested.push_str(&format!(
                "<{element} id='r{level}'>{by_attribute}{by_style}{by_sheet}</{element}>"
            ));
        }
        let seen = format!("<path {property}='url(#r29)' stroke='red' d='M0 0L1 1L2 0z'/>");
        let strokes = svg::read(&drawing(&format!("<style>{sheet}</style>{nested}{seen}"))).unwrap();
        assert_eq!(strokes.len(), 1, "{element}");
    }
}

#[test]
fn reading_a_drawing_has_a_time_limit() {
    let paths = "<path d='M0 0L1 1' stroke='red'/>".repeat(20_000);
    let unfit = svg::read_within(drawing(&paths), std::time::Duration::ZERO).unwrap_err();
    assert_eq!(unfit.message, "the drawing takes longer than 0 s to read");
}

#[test]
fn style_sheets_with_excessive_work_are_refused() {
    let paths = format!("{}{}{}", "<g>".repeat(300), "<path d='M0 0L1 1'/>".repeat(800), "</g>".repeat(300));
    for sheet in [
        "*{fill:red;stroke:blue;opacity:1}".repeat(9_000),
        format!("{}{{fill:red}}", "* ".repeat(20_000)),
        ".x g g g g g g g g path{fill:red}".to_owned(),
    ] {
        let told = svg::read(&drawing(&format!("<style>{sheet}</style>{paths}"))).unwrap_err().message;
        assert!(told.contains("style sheets of the drawing are too long"), "{told}");
    }
}

#[test]
fn typical_exported_drawings_are_read() {
    let classes: String =
        (0..200).map(|i| format!(".cls-{i}{{fill:#fff;stroke:#000;stroke-width:2px}}")).collect();
    let paths: String = (0..3_000)
        .map(|i| {
            format!(
                "<g><path id='p{i}' class='cls-{}' d='M{i} 0L1 1' marker-end='url(#arrow)'/></g>",
                i % 200
            )
        })
        .collect();
    let arrow = "<defs><marker id='arrow'><path d='M0 0L1 1L0 2z'/></marker></defs>";
    let sheet = format!("<style>{classes} #layer .cls-1 > path, svg g path {{fill: red}}</style>");
    assert!(svg::read(&drawing(&format!("{sheet}{arrow}{paths}"))).unwrap().len() >= 3_000);
    let itself = "<g id='a'><use href='#a'/><path d='M0 0L1 1' stroke='red'/></g>";
    let _ = svg::read(&drawing(itself));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// For any lines, the places have the requested number and are on the lines.
    #[test]
    fn places_are_on_the_lines(
        lines in prop::collection::vec(prop::collection::vec((0..6i32, 0..6i32), 1..6), 1..5),
        count in 0usize..40,
    ) {
        let lines: Vec<Vec<Point>> = lines.iter()
            .map(|line| line.iter().map(|(x, z)| [f64::from(*x), 0.0, f64::from(*z)]).collect()).collect();
        let places = of(&lines).places(count).unwrap();
        prop_assert_eq!(places.len(), count);
        let off = |place: Point, a: Point, b: Point| {
            let whole = distance(a, b);
            (distance(a, place) + distance(place, b) - whole).abs()
        };
        for place in places {
            let near = lines.iter().any(|line| {
                line.iter().any(|point| distance(*point, place) < 1e-3)
                    || line.windows(2).any(|pair| off(place, pair[0], pair[1]) < 1e-3)
            });
            prop_assert!(near, "{:?} is on none of {:?}", place, lines);
        }
    }

    #[test]
    fn arbitrary_bytes_are_read_as_a_drawing_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        super::super::tried::tried(3, &bytes);
    }

    #[test]
    fn any_readable_path_gives_the_requested_number_of_places(path in "[MmLlHhVvCcSsQqTtAaZz0-9 .,-]{0,60}") {
        let drawing = format!("<svg xmlns='http://www.w3.org/2000/svg'><path d='{path}' stroke='red'/></svg>");
        if let Ok(strokes) = svg::read(drawing.as_bytes()) {
            for count in [1, 2, 7] {
                prop_assert_eq!(upright(&strokes).places(count).unwrap().len(), count);
            }
        }
    }
}
