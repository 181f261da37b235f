//! Groups that move along a path. Their positions are sampled from the steps of the plan.

use super::groups::{apart, compiled, places, sound, steps};
use crate::Code;

const EIGHT: &str = "points: [[0, 0, 0], [2, 1, 0.5], [4, 0, 0], [4, -1, 0], [2, 0, 0.2], [0, 1, 0], [-1, 0.5, 0]], closed: true";

fn scenario(paths: &str, cues: &str) -> String {
    format!("scenario: s\npaths:\n  way: {{{paths}}}\ncues:\n{cues}")
}

#[test]
fn group_moved_along_path_keeps_its_shape_and_returns() {
    let cue = "  - {robots: [d0, d1, d2], along: {path: way, laps: 2}, over: 40s}\n";
    let act = sound(3, &scenario(EIGHT, cue));
    let steps = steps(&act, 3);
    let begin = places(&steps, 0.0);
    let (mut far, mut at) = (0.0_f64, 0.0);
    while at <= 40_000.0 {
        let now = places(&steps, at);
        for (index, place) in now.iter().enumerate() {
            // Both positions deviate by the permitted error of their steps.
            let gone = |index: usize| -> [f64; 3] {
                std::array::from_fn(|axis| now[index][axis] - begin[index][axis])
            };
            assert!(apart(&gone(index), &gone(0)) < 0.01, "{index} at {at}");
            far = far.max(apart(place, &begin[index]));
        }
        at += 20.0;
    }
    assert!(far > 4.0, "{far}");
    for (place, begin) in places(&steps, 40_000.0).iter().zip(&begin) {
        assert!(apart(place, begin) < 0.005);
    }
}

#[test]
fn circle_path_is_followed_at_its_radius() {
    let act =
        sound(1, &scenario("circle: {radius: 2}, rotate: -90", "  - {robots: d0, along: way, over: 10s}\n"));
    let steps = steps(&act, 1);
    // The robot begins at the lowest point of the circle, whose middle is two metres along y.
    for index in 0..=500 {
        let [x, y, z] = places(&steps, f64::from(index) * 20.0)[0];
        assert!(((x).hypot(y - 2.0) - 2.0).abs() < 0.006 && z.abs() < 1e-9, "{x} {y}");
    }
    assert!(apart(&places(&steps, 5_000.0)[0], &[0.0, 4.0, 0.0]) < 0.006);
}

#[test]
fn group_turning_with_path_turns_about_its_centre() {
    let cue = "  - {robots: [d0, d1], along: {path: way, turning: true}, over: 20s}\n";
    let act = sound(2, &scenario("points: [[0, 0, 0], [3, 0, 0], [4, 1, 0], [4, 5, 0]]", cue));
    let steps = steps(&act, 2);
    for index in 0..=1_000 {
        let now = places(&steps, f64::from(index) * 20.0);
        assert!((apart(&now[0], &now[1]) - 0.7).abs() < 0.01);
    }
    // The row is along x at first, and along y where the path leads along y. The heading at both ends is that of the spline.
    let (first, last) = (places(&steps, 0.0), places(&steps, 20_000.0));
    let heading =
        |places: &[[f64; 3]]| (places[1][1] - places[0][1]).atan2(places[1][0] - places[0][0]).to_degrees();
    assert!(heading(&first).abs() < 0.1);
    assert!((heading(&last) - 90.0).abs() < 20.0, "{}", heading(&last));
    let middle = |places: &[[f64; 3]]| -> [f64; 3] {
        std::array::from_fn(|axis| (places[0][axis] + places[1][axis]) / 2.0)
    };
    let gone: [f64; 3] = std::array::from_fn(|axis| middle(&last)[axis] - middle(&first)[axis]);
    assert!(apart(&gone, &[4.0, 5.0, 0.0]) < 0.01, "{gone:?}");
}

#[test]
fn following_robots_pass_through_places_of_robots_ahead() {
    let cue = "  - {robots: [d3, d2, d1, d0], along: {path: way, follow: true}, over: 20s}\n";
    let act = sound(4, &scenario("points: [[0, 0, 0], [2, 0, 0], [4, 2, 1], [2, 4, 1]]", cue));
    let steps = steps(&act, 4);
    let all: Vec<Vec<[f64; 3]>> = (0..=4_000).map(|index| places(&steps, f64::from(index) * 5.0)).collect();
    let trail = |robot: usize| all.iter().map(move |places| places[robot]).collect::<Vec<_>>();
    // All robots move along one line; the last robot covers its beginning and the first robot its end.
    let line = [trail(0), trail(3)].concat();
    for (robot, behind) in [(2, 0.7), (1, 1.4), (0, 2.1)] {
        for places in all.iter().step_by(50) {
            let near = line.iter().map(|point| apart(point, &places[robot])).fold(f64::INFINITY, f64::min);
            assert!(near < 0.02, "d{robot} is {near} m off");
        }
        let (leader, last) = (trail(3), all.last().unwrap()[robot]);
        let index = leader.iter().position(|point| apart(point, &last) < 0.01).unwrap();
        let left: f64 = leader[index..].windows(2).map(|pair| apart(&pair[0], &pair[1])).sum();
        assert!((left - behind).abs() < 0.1, "d{robot} ends {left} m behind");
    }
}

#[test]
fn each_path_fault_is_reported_once() {
    let found = |text: &str| {
        let findings = compiled(4, text).findings;
        findings.into_iter().map(|finding| (finding.code, finding.line, finding.message)).collect::<Vec<_>>()
    };
    let text = "scenario: s
paths:
  there: {points: [[0, 0, 0], [1, 0, 0], [0, 0, 0]]}
  twice: {points: [[0, 0, 0], [1, 0, 0], [1, 0, 0]]}
  none: {closed: true}
  ring: {circle: {radius: 1}, closed: true}
  open: {points: [[0, 0, 0], [1, 0, 0]]}
  up: {points: [[0, 0, 0], [0, 0, 1]]}
cues:
  - {cue: a, at: 0s, robots: d0, along: opne, over: 5s}
  - {cue: b, at: 6s, robots: d1, along: {path: open, laps: 2}, over: 5s}
  - {cue: c, at: 12s, robots: d2, along: {path: up, turning: true}, over: 5s}
  - {cue: d, at: 18s, robots: [d0, d1, d2], along: {path: open, follow: true}, over: 5s}
";
    let found = found(text);
    let codes: Vec<_> = found.iter().map(|(code, ..)| *code).collect();
    for (code, wanted) in [
        (Code::WrongType, "bends too sharply at point 2"),
        (Code::WrongType, "points 2 and 3 of the path are the same"),
        (Code::MissingKey, "the path `none` has no shape"),
        (Code::UnknownKey, "a circle is always closed"),
        (Code::UnknownPath, "no path `opne`"),
        (Code::WrongType, "2 laps of `open`"),
        (Code::WrongType, "`up` has no heading where it leads straight up or down"),
    ] {
        assert!(
            found.iter().any(|(own, _, message)| *own == code && message.contains(wanted)),
            "{wanted}: {found:#?}"
        );
    }
    assert_eq!(codes.len(), 7, "{found:#?}");
}

#[test]
fn row_that_cannot_follow_path_is_reported() {
    let cue = "  - {robots: [d0, d1, d2], along: {path: way, follow: true}, over: 20s}\n";
    let compiled = compiled(3, &scenario("points: [[0, 0, 0], [2, 0, 0]]", cue));
    let [finding] = compiled.findings.as_slice() else { panic!("{:#?}", compiled.findings) };
    assert_eq!(finding.code, Code::NotInGroup);
    assert!(finding.message.contains("bends too sharply at `d0`"), "{}", finding.message);
}

#[test]
fn scaled_path_points_must_differ_and_laps_are_bounded() {
    let found = |paths: &str, along: &str| {
        let cue = format!("  - {{robots: [d0, d1], along: {along}, over: 900s}}\n");
        let findings = compiled(2, &scenario(paths, &cue)).findings;
        findings.into_iter().map(|finding| (finding.code, finding.message)).collect::<Vec<_>>()
    };
    let same = found("points: [[0, 0, 0], [1, 0, 0]], scale: 0.0000001", "way");
    assert_eq!(same, [(Code::WrongType, "points 1 and 2 of the path are the same".to_owned())]);
    assert_eq!(found("points: [[0, 0, 0], [0.0000005, 0, 0]], scale: 1000000", "way"), []);
    assert_eq!(found("circle: {radius: 0.0000000001}", "way")[0].0, Code::WrongType);
    let point = |index: u32| {
        let (sine, cosine) = (std::f64::consts::TAU * f64::from(index) / 201.0).sin_cos();
        format!("[{:.3}, {:.3}, 0], ", 9.0 * cosine, 9.0 * sine)
    };
    let many: String = (0..201).map(point).collect();
    let laps = found(&format!("points: [{many}], closed: true"), "{path: way, laps: 50}");
    assert_eq!(laps.iter().map(|(code, _)| *code).collect::<Vec<_>>(), [Code::TooMuch]);
}

#[test]
fn group_gets_hint_for_its_limits_and_cannot_spread_values() {
    let found =
        |cue: &str| compiled(2, &scenario(EIGHT, &format!("  - {{robots: [d0, d1], {cue}}}\n"))).findings;
    let beyond = found("shift: [70, 0, 0], over: 100s");
    let hints: Vec<&str> = beyond.iter().filter_map(|found| found.hint.as_deref()).collect();
    assert_eq!(hints, ["use at most `shift: [49.3, 0, 0]`"], "{beyond:#?}");
    let spread = found("turn: {from: 0, to: 90, across: group}, over: 10s");
    assert_eq!(spread.len(), 1, "{spread:#?}");
    assert!(spread[0].message.contains("spread over the robots"), "{spread:#?}");
}
