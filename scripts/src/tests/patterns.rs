//! Patterns over a group of robots. A scenario with a pattern compiles to the same result as one in which every time and number is
//! written out.

use std::collections::BTreeMap;

use super::robot;
use crate::space::{Body, Coordinate, Shape};
use crate::{Compiled, Fleet, FleetRobot, NoFiles, Source, compile};

const BLOCK: &str = r#"{"id": "x", "api_version": "1", "devices": [
  {"id": "x", "name": "x", "default_value": 100, "interpolation": "linear", "available_control_types": {
     "position": {"min_value": -500, "max_value": 500, "granularity": 0.01, "max_error": 0.05},
     "script": {"min_value": -500, "max_value": 500, "granularity": 0.01, "max_number_of_steps": 10000}}},
  {"id": "d", "name": "d", "default_value": 0, "interpolation": "linear", "available_control_types": {
     "position": {"min_value": -500, "max_value": 500, "granularity": 0.01, "max_error": 0.05},
     "script": {"min_value": -500, "max_value": 500, "granularity": 0.01, "max_number_of_steps": 10000}}}]}"#;

/// Robots with their places in metres. The last two of the eight robots have no place.
const PLACES: [(&str, Option<[f64; 3]>); 8] = [
    ("a", Some([0.0, 0.0, 0.0])),
    ("b", Some([1.0, 0.0, 2.0])),
    ("c", Some([4.0, 3.0, 0.0])),
    ("e", Some([0.3, 0.0, 0.1])),
    ("f", Some([2.0, 0.0, 0.2])),
    ("h", Some([1.0, 0.0, 0.1])),
    ("i", None),
    ("j", None),
];

fn body(place: [f64; 3]) -> Body {
    let [_, y, z] = place.map(Coordinate::Fixed);
    // The place of the body in x follows from the default value of a device: 100 cm plus its offset.
    let device = urrcp::DeviceId::new("x").unwrap();
    let x = Coordinate::Device { device, scale: 0.01, offset: place[0] - 1.0 };
    Body {
        coordinates: [x, y, z, Coordinate::Fixed(0.0)],
        drive: None,
        shape: Shape::Ball { radius: 0.0 },
        joints: Vec::new(),
        tip: [0.0; 3],
        speed: None,
        acceleration: None,
    }
}

fn fleet() -> Fleet {
    let one = |(name, place): (&str, Option<[f64; 3]>)| {
        let mut init: urrcp::InitializationBlock = serde_json::from_str(BLOCK).unwrap();
        init.id = urrcp::RobotId::new(name).unwrap();
        FleetRobot { id: init.id.clone(), init: Some(init), body: place.map(body), ..robot() }
    };
    let robots: Vec<FleetRobot> = PLACES.map(one).into();
    let group = |ids: &[usize]| ids.iter().map(|index| robots[*index].id.clone()).collect();
    let groups = BTreeMap::from([
        ("four".to_owned(), group(&[0, 1, 2, 3])),
        ("five".to_owned(), group(&[0, 1, 2, 3, 4])),
        ("left".to_owned(), group(&[0, 1])),
        ("right".to_owned(), group(&[2, 3])),
        ("alike".to_owned(), group(&[5, 1, 0])),
        ("lost".to_owned(), group(&[0, 6, 7])),
        ("empty".to_owned(), group(&[])),
    ]);
    Fleet { robots, groups, ..Fleet::default() }
}

fn compiled(text: &str) -> Compiled {
    compile(&Source { name: "s.yaml".into(), text: format!("scenario: s\n{text}") }, &fleet(), &NoFiles)
}

/// Returns the scripts of every robot, and the times of each cue.
#[track_caller]
fn scripts(text: &str) -> Vec<String> {
    let compiled = compiled(text);
    let choreography = compiled.choreography.unwrap_or_else(|| panic!("{text}\n{:#?}", compiled.findings));
    let acts = choreography.acts.iter();
    let robots = acts.clone().flat_map(|act| &act.plan.robots);
    let scripts = robots.map(|robot| format!("{:?} {:?}", robot.robot, robot.scripts));
    let cues = acts.flat_map(|act| &act.cues).map(|cue| format!("{:?} {:?}", cue.start, cue.end));
    scripts.chain(cues).collect()
}

#[track_caller]
fn same(with: &str, without: &str) {
    let (with, without) = (scripts(with), scripts(without));
    assert_eq!(with.len(), without.len());
    for (a, b) in with.iter().zip(&without) {
        assert_eq!(a, b);
    }
}

/// Checks that a cue with a canon is equivalent to a cue with a separate delay for each robot, from the list `delays`.
#[track_caller]
fn delayed(group: &str, canon: &str, delays: &[(&str, &str)]) {
    let tracks = "tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 20}, {at: 2s, to: 0}]}";
    let overrides: Vec<String> =
        delays.iter().map(|(robot, delay)| format!("{robot}: {{delay: {delay}}}")).collect();
    same(
        &format!("tempo: 120\ncues: [{{at: 0s, robots: {group}, canon: {canon}, {tracks}}}]\n"),
        &format!(
            "tempo: 120\ncues: [{{at: 0s, robots: {group}, overrides: {{{}}}, {tracks}}}]\n",
            overrides.join(", ")
        ),
    );
}

/// Checks that a value that differs between the robots of a group is equivalent to a separate value for each robot, from the list
/// `values`.
#[track_caller]
fn valued(group: &str, value: &str, values: &[(&str, &str)]) {
    let tracks = |value: &str| {
        format!("tracks: {{d: {{tolerance: 0.1, keyframes: [{{at: 0s, to: 0}}, {{at: 1s, to: {value}}}]}}}}")
    };
    let overrides: Vec<String> =
        values.iter().map(|(robot, value)| format!("{robot}: {{{}}}", tracks(value))).collect();
    same(
        &format!("off_grid: snap\ncues: [{{robots: {group}, {}}}]\n", tracks(value)),
        &format!(
            "off_grid: snap\ncues: [{{robots: {group}, overrides: {{{}}}, {}}}]\n",
            overrides.join(", "),
            tracks("0")
        ),
    );
}

/// Returns each finding with the text at its place (the bracket of a map), its code and its message.
fn found(text: &str) -> Vec<String> {
    let one = |finding: &crate::Finding| {
        let at: String = finding.source_line.chars().skip(finding.column - 1).take(finding.width).collect();
        format!("`{at}` {} {}", finding.code.as_str(), finding.message)
    };
    compiled(text).findings.iter().map(one).collect()
}

#[test]
fn canon_by_index_supports_four_directions() {
    delayed("four", "{step: 100ms}", &[("b", "100ms"), ("c", "200ms"), ("e", "300ms")]);
    delayed("four", "{step: 100ms, direction: backward}", &[("a", "300ms"), ("b", "200ms"), ("c", "100ms")]);
    delayed("four", "{step: 100ms, direction: outward}", &[("a", "100ms"), ("e", "100ms")]);
    delayed("four", "{step: 100ms, direction: inward}", &[("b", "100ms"), ("c", "100ms")]);
    delayed(
        "five",
        "{step: 1 beat, direction: outward}",
        &[("a", "2 beats"), ("b", "1 beat"), ("e", "1 beat"), ("f", "2 beats")],
    );
    delayed("four", "{over: 1s}", &[("b", "1s / 3"), ("c", "2s / 3"), ("e", "1s")]);
}

#[test]
fn wave_runs_across_robot_positions() {
    // x of the robots: a 0, b 1, c 4, e 0.3, f 2.
    delayed("five", "{speed: 2, by: x}", &[("b", "500ms"), ("c", "2s"), ("e", "150ms"), ("f", "1s")]);
    delayed("five", "{step: 1s, by: x}", &[("b", "2s"), ("c", "4s"), ("e", "1s"), ("f", "3s")]);
    delayed("five", "{over: 1s, by: x}", &[("b", "250ms"), ("c", "1s"), ("e", "75ms"), ("f", "500ms")]);
    delayed(
        "five",
        "{speed: 2, by: x, direction: backward}",
        &[("a", "2s"), ("b", "1500ms"), ("e", "1850ms"), ("f", "1s")],
    );
    // The wave begins at x = 2.
    delayed(
        "five",
        "{speed: 1, by: x, direction: outward}",
        &[("a", "2s"), ("b", "1s"), ("c", "2s"), ("e", "1700ms")],
    );
    // c is 5 m from the origin, b the square root of 5 metres, and a is at the origin.
    delayed("[a, c]", "{speed: 2, by: [0, 0, 0]}", &[("c", "2500ms")]);
    delayed("[c, a]", "{speed: 2, by: [4, 3, 0]}", &[("a", "2500ms")]);
    // b and h have the same x and begin together.
    delayed("alike", "{step: 1s, by: x}", &[("h", "1s"), ("b", "1s")]);
    delayed("a", "{speed: 2, by: x}", &[]);
}

#[test]
fn random_canon_is_reproducible() {
    // The numbers come from SplitMix64, applied twice for each, and were calculated independently in another language.
    delayed("four", "{step: 1s, by: random, seed: 7}", &[("a", "1s"), ("c", "2s"), ("e", "3s")]);
    delayed(
        "four",
        "{step: 1s, by: random, seed: 7, direction: backward}",
        &[("a", "2s"), ("b", "3s"), ("c", "1s")],
    );
    let of = |seed: u32| {
        scripts(&format!(
            "cues: [{{robots: five, canon: {{over: 1s, by: random, seed: {seed}}}, tracks: {{d: [{{at: 0s, to: 0}}, {{at: 1s, to: 9}}]}}}}]\n"
        ))
    };
    assert_eq!(of(3), of(3));
    assert_ne!(of(3), of(4));
}

#[test]
fn canon_gaps_may_differ() {
    delayed("four", "100ms * $index", &[("b", "100ms"), ("c", "300ms"), ("e", "600ms")]);
    delayed("four", "3s / $count", &[("b", "750ms"), ("c", "1500ms"), ("e", "2250ms")]);
    delayed(
        "four",
        "{step: 100ms * $index, direction: backward}",
        &[("c", "100ms"), ("b", "300ms"), ("a", "600ms")],
    );
    delayed("a", "3s / ($count - 1)", &[]);
}

#[test]
fn robots_of_cue_may_start_at_different_times() {
    let tracks = "tracks: {d: [{at: 0s, to: 0}, {at: 1 beat, to: 20}, {at: 2s, to: 0}]}";
    same(
        &format!("tempo: 100\ncues: [{{at: 2s + $index * 250ms, robots: four, {tracks}}}]\n"),
        &format!("tempo: 100\ncues: [{{at: 2s, robots: four, canon: 250ms, {tracks}}}]\n"),
    );
    same(
        &format!(
            "cues: [{{cue: m, at: 3s - $index * 1s, canon: 100ms, robots: left, {}}}, {{after: m, robots: left, {0}}}]\n",
            tracks.replace("1 beat", "1s")
        ),
        &format!(
            "cues: [{{cue: m, at: 2s, robots: left, overrides: {{a: {{delay: 1s}}, b: {{delay: 100ms}}}}, {}}}, {{after: m, robots: left, {0}}}]\n",
            tracks.replace("1 beat", "1s")
        ),
    );
    same(
        &format!("cues: [{{at: 1s * $count, robots: four, {}}}]\n", tracks.replace("1 beat", "1s")),
        &format!("cues: [{{at: 4s, robots: four, {}}}]\n", tracks.replace("1 beat", "1s")),
    );
}

#[test]
fn chase_plays_robots_one_after_another_repeatedly() {
    same(
        "
tempo: 120
moves: {flash: {tracks: {d: [{at: 0s, to: 0}, {at: 0.5 beats, to: 90}, {at: 1 beat, to: 0}]}}}
cues: [{robots: four, move: flash, canon: 1 beat, repeat: {times: 3, every: 1 beat * $count}}]
",
        "
cues:
  - robots: four
    tracks: {d: [{at: 0s, to: 0}, {at: 250ms, to: 90}, {at: 500ms, to: 0}, {at: 2s, to: 0}, {at: 2250ms, to: 90}, {at: 2500ms, to: 0}, {at: 4s, to: 0}, {at: 4250ms, to: 90}, {at: 4500ms, to: 0}]}
    overrides: {b: {delay: 500ms}, c: {delay: 1s}, e: {delay: 1500ms}}
",
    );
}

#[test]
fn repetitions_need_no_wait_after_last_one() {
    let tracks = "tracks: {d: [{at: 0s, to: 0}, {at: 500ms, to: 90}, {at: 1s, to: 0}]}";
    let repeated = |repeat: &str| format!("cues: [{{at: 1s, robots: a, repeat: {repeat}, {tracks}}}]\n");
    for (every, times) in [
        ("{every: 4s, for: 9s}", "{every: 4s, times: 3}"),
        ("{every: 4s, for: 8999ms}", "{every: 4s, times: 2}"),
        ("{every: 4s, for: 1s}", "1"),
        ("{every: 4s, until: 10s}", "{every: 4s, times: 3}"),
        ("{every: 1s, times: 3}", "3"),
        ("{times: 3}", "3"),
        ("{for: 3s}", "3"),
    ] {
        same(&repeated(every), &repeated(times));
    }
}

#[test]
fn response_plays_mirrored_move_of_call() {
    same(
        "
moves: {bow: {tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 30}, {at: 2s, to: 0}]}}}
cues:
  - {cue: call, robots: left, move: bow, repeat: {times: 3, every: 4s}}
  - {cue: response, with: call + 2s, robots: right, move: bow, mirror: true, repeat: {times: 3, every: 4s}}
",
        "
cues:
  - {robots: left, tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 30}, {at: 2s, to: 0}, {at: 4s, to: 0}, {at: 5s, to: 30}, {at: 6s, to: 0}, {at: 8s, to: 0}, {at: 9s, to: 30}, {at: 10s, to: 0}]}}
  - {at: 2s, robots: right, tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: -30}, {at: 2s, to: 0}, {at: 4s, to: 0}, {at: 5s, to: -30}, {at: 6s, to: 0}, {at: 8s, to: 0}, {at: 9s, to: -30}, {at: 10s, to: 0}]}}
",
    );
}

#[test]
fn value_is_spread_from_first_to_last_robot() {
    valued("four", "{from: 0, to: 90, across: group}", &[("b", "30"), ("c", "60"), ("e", "90")]);
    valued(
        "four",
        "{from: 90, to: -90, across: group}",
        &[("a", "90"), ("b", "30"), ("c", "-30"), ("e", "-90")],
    );
    valued("a", "{from: 5, to: 90, across: group}", &[("a", "5")]);
    valued(
        "five",
        "{from: 0, to: 8, across: group, direction: outward}",
        &[("a", "8"), ("b", "4"), ("c", "0"), ("e", "4"), ("f", "8")],
    );
    // `smooth` at a third is 10/27 - 15/81 + 6/243 = 17/81, and at two thirds 1 minus that.
    valued(
        "four",
        "{from: 0, to: 81, across: group, ease: smooth}",
        &[("b", "17"), ("c", "64"), ("e", "81")],
    );
    valued(
        "four",
        "{from: 3, to: 7, across: group, ease: step}",
        &[("a", "3"), ("b", "3"), ("c", "3"), ("e", "7")],
    );
    valued(
        "five",
        "{from: 0, to: 40, across: group, by: x}",
        &[("b", "10"), ("c", "40"), ("e", "3"), ("f", "20")],
    );
    valued("[a, c]", "{from: 0, to: 50, across: group, by: [0, 0, 0]}", &[("c", "50")]);
    valued(
        "four",
        "{from: 1, to: 2 * $count, across: group}",
        &[("a", "1"), ("b", "10 / 3"), ("c", "17 / 3"), ("e", "8")],
    );
    valued(
        "four",
        "{from: 10, to: 50, across: group, by: random, seed: 7}",
        &["a", "b", "c", "e"].map(|robot| (robot, "'10 + 40 * random(7, $index)'")),
    );
}

#[test]
fn parameter_may_be_fraction_with_many_digits() {
    let tracks = |to: &str| {
        format!("tracks: {{d: {{tolerance: 0.1, keyframes: [{{at: 0s, to: 0}}, {{at: 1s, to: {to}}}]}}}}")
    };
    let value = "'-13.5 + -15.75 * random(46, $index)'";
    same(
        &format!(
            "off_grid: snap\nmoves: {{m: {{parameters: {{to: 0}}, {}}}}}\ncues: [{{robots: four, move: m, parameters: {{to: {value}}}}}]\n",
            tracks("$to")
        ),
        &format!("off_grid: snap\ncues: [{{robots: four, {}}}]\n", tracks(value)),
    );
}

#[test]
fn scale_and_repetitions_can_be_spread() {
    let tracks = "tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 20}, {at: 2s, to: 0}]}";
    same(
        &format!(
            "cues: [{{robots: left, scale: {{from: 1, to: 2, across: group}}, repeat: {{from: 1, to: 3, across: group}}, {tracks}}}]\n"
        ),
        &format!("cues: [{{robots: left, overrides: {{b: {{scale: 2, repeat: 3}}}}, {tracks}}}]\n"),
    );
}

#[test]
fn parameters_and_times_can_be_spread() {
    same(
        "
variables: {most: 90}
moves: {lift: {parameters: {to: {from: 0, to: 9, across: group}, time: 1s}, tracks: {d: [{at: 0s, to: 0}, {at: $time, to: $to}]}}}
cues:
  - {robots: four, move: lift, parameters: {to: {from: 0, to: $most, across: group}, time: {from: 1s, to: 4s, across: group}}}
  - {at: 9s, robots: four, move: lift}
  - {at: 19s, robots: four, tracks: {d: {wave: {amplitude: {from: 1, to: 4, across: group}, period: 2s, for: {from: 4s, to: 7s, across: group}}}}}
",
        "
moves: {lift: {parameters: {to: ~, time: 1s}, tracks: {d: [{at: 0s, to: 0}, {at: $time, to: $to}]}}}
cues:
  - {robots: four, move: lift, parameters: {to: 30 * $index, time: 1s + 1s * $index}}
  - {at: 9s, robots: four, move: lift, parameters: {to: 3 * $index}}
  - {at: 19s, robots: four, tracks: {d: {wave: {amplitude: 1 + $index, period: 2s, for: 4s + 1s * $index}}}}
",
    );
}

#[test]
fn followers_repeat_leader_with_delay() {
    same(
        "
roles: {leader: c, followers: [a, b]}
cues: [{robots: [leader, followers], canon: 250ms, tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 20}]}}]
",
        "cues: [{robots: [a, b, c], overrides: {a: {delay: 250ms}, b: {delay: 500ms}}, tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 20}]}}]\n",
    );
}

#[test]
fn robot_positions_follow_from_last_preceding_cue() {
    // x is in centimetres and starts 1 m before the robot's place in the fleet file, so a moves to 3 m, b to 0 m, and c to 1 m.
    let moves = "{cue: m, robots: [a, b, c], tracks: {x: [{at: 0s, to: 100}, {at: 1s, to: 400}]}, overrides: {b: {tracks: {x: [{at: 0s, to: 100}, {at: 1s, to: 0}]}}, c: {tracks: {x: [{at: 0s, to: 100}, {at: 1s, to: -200}]}}}}";
    let nod = "tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 20}, {at: 2s, to: 0}]}";
    same(
        &format!("cues: [{moves}, {{after: m, robots: [a, b, c], canon: {{speed: 1, by: x}}, {nod}}}]\n"),
        &format!(
            "cues: [{moves}, {{after: m, robots: [a, b, c], overrides: {{a: {{delay: 3s}}, c: {{delay: 1s}}}}, {nod}}}]\n"
        ),
    );
}

#[track_caller]
fn finds(cue: &str, expected: &[&str]) {
    let text = format!("cues:\n  - {{robots: four, {cue}}}\n");
    assert_eq!(found(&text), expected, "{text}");
}

#[test]
fn canon_faults_are_reported_at_their_position() {
    let tracks = "tracks: {d: [{at: 0s, to: 0}, {at: 1s, to: 20}]}";
    let canon = |canon: &str, expected: &str| finds(&format!("canon: {canon}, {tracks}"), &[expected]);
    canon("{by: x}", "`{` DB0006 found none or several of `step`, `speed` and `over`");
    canon("{step: 1s, over: 1s}", "`{` DB0006 found none or several of `step`, `speed` and `over`");
    canon("{speed: 1}", "`speed` DB0006 a canon with `speed` requires robots that are ordered by position");
    canon("{speed: 0, by: x}", "`0` DB0003 found the number 0");
    canon("{speed: 1e9, by: x}", "`1e9` DB0003 found the number 1000000000");
    canon("{step: 1s, by: [1, 2]}", "`[` DB0003 found 2 entries");
    canon("{step: 1s, by: random}", "`random` DB0006 `random` needs a seed");
    canon("{step: 1s, seed: 7}", "`seed` DB0004 `seed` has no effect without `by: random`");
    canon("{over: 1s * $count}", "`$count` DB0070 `$count` differs between robots and is not supported here");
    canon("2 * $index", "`2 * $index` DB0070 the result of the expression is a plain number");
    canon("1s / ($index - 1)", "`/` DB0070 division by zero");
    canon(
        "8000h * $index",
        "`8000h * $index` DB0045 the last of 4 robots starts 172800000 s after the start of the cue",
    );
    finds(
        &format!("at: 1s..2s + 1s * $index, {tracks}"),
        &["`1s..2s + 1s * $index` DB0003 a range that differs between robots is not supported"],
    );
    finds(
        &format!("at: 1s - 1s * $index, {tracks}"),
        &["`1s - 1s * $index` DB0070 the result of the expression is the negative time -1 s"],
    );
}

#[test]
fn spread_faults_are_reported_at_their_position() {
    let to = |to: &str, expected: &str| finds(&format!("tracks: {{d: [{{at: 1s, to: {to}}}]}}"), &[expected]);
    to("{from: 1, to: 2}", "`{` DB0006 a spread has no `across`");
    to("{from: 1, across: group}", "`{` DB0006 a spread has no `to`");
    to("{from: 1, to: 2s, across: group}", "`2s` DB0070 a spread from a plain number to a time");
    to("{from: 1s, to: 2s, across: group}", "`{` DB0070 the result of the expression is a time");
    to("{from: 1, to: 2, across: all}", "`all` DB0020 unknown word `all`");
    to("{from: [1], to: 2, across: group}", "`[` DB0003 found a list");
    finds(
        "end_by: {from: 1s, to: 2s, across: group}, tracks: {d: [{at: 0s, to: 0}]}",
        &["`{` DB0003 a value that is spread over the robots is not supported here"],
    );
    let of = |robots: &str| {
        found(&format!(
            "cues: [{{robots: {robots}, canon: {{step: 1s, by: z}}, tracks: {{d: [{{at: 0s, to: {{from: 1, to: 2, across: group, by: x}}}}]}}}}]\n"
        ))
    };
    assert_eq!(
        of("lost"),
        [
            "`{` DB0006 the positions of robots `i`, `j` are unknown",
            "`{` DB0006 the positions of robots `i`, `j` are unknown"
        ]
    );
    assert_eq!(of("empty"), ["`empty` DB0037 the cue `cue 1` has no robots: its groups are empty"]);
}

#[test]
fn unused_move_requires_no_robot_positions() {
    let spread = "{from: 1, to: 2, across: group, by: x}";
    let text = format!(
        "moves: {{m: {{tracks: {{d: [{{at: 0s, to: {spread}}}]}}}}}}\ncues: [{{robots: lost, tracks: {{d: [{{at: 0s, to: 0}}]}}}}]\n"
    );
    assert_eq!(found(&text), Vec::<String>::new());
}

#[test]
fn overlapping_or_ambiguous_repetitions_are_reported() {
    let repeat = |repeat: &str, expected: &str| {
        finds(
            &format!("repeat: {repeat}, tracks: {{d: [{{at: 0s, to: 0}}, {{at: 2s, to: 0}}]}}"),
            &[expected],
        );
    };
    repeat("{times: 2, every: 1s}", "`1s` DB0041 a movement of 2 s cannot be repeated every 1 s");
    repeat("{times: 2, for: 9s}", "`{` DB0003 found none or several of `times`, `until` and `for`");
    repeat("{every: 3s}", "`{` DB0003 found none or several of `times`, `until` and `for`");
    repeat("{every: 3s, for: 1s}", "`{` DB0041 1 s is too short for a movement of 2 s");
}

#[test]
fn extreme_numbers_in_large_groups_are_refused() {
    let cues = "  - {robots: four, canon: {speed: 0.001, by: [1e300, -1e300, 0]}, tracks: {d: [{at: 0s, to: {from: -1e300, to: 1e300, across: group, by: y}}]}}\n".repeat(200);
    assert!(!found(&format!("cues:\n{cues}")).is_empty());
}

#[test]
fn random_formula_draws_new_value_per_robot_and_turn() {
    let track = |text: &str| {
        format!("off_grid: snap\ncues: [{{robots: left, tracks: {{d: {{tolerance: 0.01, {text}}}}}}}]\n")
    };
    let steps = |text: &str| -> Vec<Vec<(f64, f64)>> {
        let choreography = compiled(text).choreography.unwrap_or_else(|| panic!("{:?}", found(text)));
        let robots = choreography.acts[0].plan.robots.clone();
        let steps = |robot: &crate::plan::RobotPlan| {
            let steps = robot.scripts.iter().flat_map(|planned| planned.script.steps());
            steps.map(|step| (step.offset.span().as_millis_f64(), step.setpoint.value)).collect()
        };
        robots.iter().map(steps).collect()
    };
    let robots = steps(&track("formula: 'round(100 * random(7, $index, floor(t / 2s)))', for: 6s"));
    // The values of drawn(7, index, turn) were calculated in another language.
    for (robot, expected) in robots.iter().zip([[61.0, 10.0, 29.0], [98.0, 62.0, 48.0]]) {
        for (turn, value) in expected.into_iter().enumerate() {
            let middle = turn as f64 * 2_000.0 + 1_000.0;
            let (_, before) = *robot.iter().rev().find(|(at, _)| *at <= middle).unwrap();
            let (_, after) = *robot.iter().find(|(at, _)| *at >= middle).unwrap();
            assert_eq!((before, after), (value, value), "{robot:?}");
        }
    }
    let text = track("formula: 'random(t / 1s)', for: 6s");
    assert!(
        found(&text)[0].contains("DB0041 the formula has too many turns, corners or jumps"),
        "{:?}",
        found(&text)
    );
}
