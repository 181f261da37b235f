//! Tests of formations: known coordinates, and even spacing for any number of bodies.

mod files;
mod lines;

use super::*;

fn of(shape: Shape) -> Formation {
    Formation { shape, placing: Placing::default() }
}

#[track_caller]
fn check(shape: Shape, count: usize, expected: &[Point]) {
    same(&of(shape).places(count).unwrap(), expected);
}

#[track_caller]
fn same(places: &[Point], expected: &[Point]) {
    assert_eq!(places.len(), expected.len(), "{places:?}");
    for (place, expected) in places.iter().zip(expected) {
        assert!(crowd::distance(*place, *expected) < 1e-9, "{places:?}, not {expected:?}");
    }
}

#[test]
fn line_is_centred_at_0() {
    check(Shape::Line(Line::Spacing(2.0)), 1, &[[0.0; 3]]);
    check(Shape::Line(Line::Spacing(2.0)), 2, &[[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]);
    check(Shape::Line(Line::Length(3.0)), 3, &[[-1.5, 0.0, 0.0], [0.0; 3], [1.5, 0.0, 0.0]]);
    check(Shape::Line(Line::Length(3.0)), 0, &[]);
}

#[test]
fn circle_begins_at_the_x_axis_and_has_equal_chords() {
    check(
        Shape::Circle(Ring::Radius(2.0)),
        4,
        &[[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [-2.0, 0.0, 0.0], [0.0, -2.0, 0.0]],
    );
    check(Shape::Circle(Ring::Spacing(1.0)), 1, &[[0.0; 3]]);
    check(Shape::Circle(Ring::Spacing(1.0)), 2, &[[0.5, 0.0, 0.0], [-0.5, 0.0, 0.0]]);
    let places = of(Shape::Circle(Ring::Spacing(0.7))).places(23).unwrap();
    for (index, place) in places.iter().enumerate() {
        assert!((crowd::distance(*place, places[(index + 1) % 23]) - 0.7).abs() < 1e-9);
    }
}

#[test]
fn grid_is_filled_row_by_row_and_layer_by_layer() {
    let grid = |columns, rows| Shape::Grid(Grid { spacing: [1.0, 2.0, 3.0], columns, rows });
    check(grid(None, None), 3, &[[-0.5, -1.0, 0.0], [0.5, -1.0, 0.0], [-0.5, 1.0, 0.0]]);
    check(grid(Some(3), None), 3, &[[-1.0, 0.0, 0.0], [0.0; 3], [1.0, 0.0, 0.0]]);
    check(grid(None, Some(3)), 3, &[[0.0, -2.0, 0.0], [0.0; 3], [0.0, 2.0, 0.0]]);
    check(grid(Some(1), Some(1)), 2, &[[0.0, 0.0, -1.5], [0.0, 0.0, 1.5]]);
    check(grid(Some(u32::MAX), Some(u32::MAX)), 2, &[[-0.5, -1.0, 0.0], [0.5, -1.0, 0.0]]);
    check(grid(None, None), 0, &[]);
}

#[test]
fn shape_is_rotated_about_its_centre_and_then_moved() {
    let line = Shape::Line(Line::Spacing(2.0));
    let placing = Placing::default().turned([0.0, 0.0, 90.0], 0.5).moved([1.0, 2.0, 3.0]);
    let turned = Formation { shape: line.clone(), placing }.places(2).unwrap();
    assert_eq!(turned, [[1.0, 1.5, 3.0], [1.0, 2.5, 3.0]], "exact at quarter turns");
    let placing = Placing::default().turned([0.0, -90.0, 0.0], 1.0);
    same(&Formation { shape: line, placing }.places(2).unwrap(), &[[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]);
}

#[test]
fn points_stay_in_place_and_rotate_about_their_centre() {
    let points: [Point; 2] = [[1.0, 0.0, 1.0], [3.0, 0.0, 1.0]];
    let (middle, sides) = middle_of(&points);
    assert_eq!((middle, sides), ([2.0, 0.0, 1.0], [2.0, 0.0, 0.0]));
    let placing = Placing::about(middle);
    let formation = Formation { shape: Shape::Points(points.into()), placing };
    assert_eq!(formation.own_count(), Some(2));
    assert_eq!(formation.places(7).unwrap(), points);
    let formation = Formation { placing: placing.turned([0.0, 0.0, 90.0], 1.0), ..formation };
    assert_eq!(formation.places(0).unwrap(), [[2.0, -1.0, 1.0], [2.0, 1.0, 1.0]]);
}

#[test]
fn too_many_places_are_refused() {
    let line = of(Shape::Line(Line::Spacing(1.0)));
    assert!(line.places(PLACES_MAX).is_ok());
    assert_eq!(line.places(usize::MAX), Err(TooManyPlaces { count: usize::MAX }));
}

#[test]
fn nearest_two_places_are_found() {
    assert_eq!(nearest_pair(&[[0.0; 3]]), None);
    let grid = of(Shape::Grid(Grid { spacing: [1.0; 3], columns: None, rows: None }));
    let mut places = grid.places(1_000).unwrap();
    places.push([0.25, 0.6, 0.1]);
    let slow = (0..places.len()).flat_map(|a| (a + 1..places.len()).map(move |b| (a, b)));
    let slow = slow.map(|(a, b)| crowd::distance(places[a], places[b])).fold(f64::INFINITY, f64::min);
    let pair = nearest_pair(&places).unwrap();
    assert_eq!(pair.distance, slow);
    assert_eq!(pair.places[1], 1_000);
}

#[test]
fn vee_has_its_tip_at_0_and_equal_arms() {
    let vee = Shape::Vee(Vee { spacing: 2.0, angle: 60.0 });
    let up = 3_f64.sqrt();
    check(vee.clone(), 1, &[[0.0; 3]]);
    check(vee, 5, &[[0.0; 3], [-1.0, up, 0.0], [1.0, up, 0.0], [-2.0, 2.0 * up, 0.0], [2.0, 2.0 * up, 0.0]]);
}

#[test]
fn sphere_is_covered_evenly() {
    check(Shape::Sphere(Ball { radius: 2.0 }), 1, &[[2.0, 0.0, 0.0]]);
    check(Shape::Sphere(Ball { radius: 2.0 }), 0, &[]);
    for count in [2, 7, 30, 300, 3_000] {
        let places = of(Shape::Sphere(Ball { radius: 3.0 })).places(count).unwrap();
        assert!(places.iter().all(|place| (crowd::distance(*place, [0.0; 3]) - 3.0).abs() < 1e-9));
        // The nearest two of n evenly spaced places are about sqrt(4 pi / n) apart; the lattice reaches most of that.
        let even = 3.0 * (4.0 * std::f64::consts::PI / f64::from(u32::try_from(count).unwrap())).sqrt();
        let nearest = nearest_pair(&places).unwrap().distance;
        assert!(nearest > 0.75 * even, "{count}: {nearest} of {even}");
    }
}

#[test]
fn drawing_with_only_text_is_reported_as_having_no_paths() {
    let drawing = |content: &str| {
        let text = format!(r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 9 9">{content}</svg>"#);
        super::svg::read(text.as_bytes()).unwrap_err().message
    };
    assert_eq!(
        drawing("<text x='1' y='5'>hi</text>"),
        "the drawing has only text and no paths: convert the text to paths"
    );
    assert_eq!(drawing(""), "the drawing has no paths");
}
