//! Draws random shows of groups, and writes them as text.

use std::fmt::Write as _;

use proptest::prelude::*;

use super::{Along, BEAT, Cue, Does, Formation, Path, PathShape, ROBOTS, Shape, Show, Sweep};

fn point(range: std::ops::Range<i64>) -> impl Strategy<Value = [i64; 3]> {
    [range.clone(), range.clone(), range].prop_map(|point| point.map(|part| part * 100))
}

fn formations() -> impl Strategy<Value = Formation> {
    let apart = 6i64..15;
    let shape = prop_oneof![
        3 => prop::collection::vec(point(-30..30), 2..7).prop_map(Shape::Points),
        1 => apart.clone().prop_map(|spacing| Shape::LineSpacing(spacing * 100)),
        1 => (3i64..9).prop_map(|length| Shape::LineLength(length * 1_000)),
        1 => (8i64..30).prop_map(|radius| Shape::CircleRadius(radius * 100)),
        1 => apart.clone().prop_map(|spacing| Shape::CircleSpacing(spacing * 100)),
        1 => (apart.clone(), 1i64..4).prop_map(|(spacing, columns)| Shape::Grid(spacing * 100, columns)),
        1 => (apart, 50i64..120).prop_map(|(spacing, angle)| Shape::Vee(spacing * 100, angle)),
    ];
    let rotate = prop_oneof![
        2 => (-180i64..180).prop_map(Ok),
        1 => [-90i64..90, -90i64..90, -90i64..90].prop_map(Err),
    ];
    let at = [-30i64..30, -30i64..30, 8i64..40].prop_map(|at| at.map(|part| part * 100));
    (shape, at, rotate, 800i64..1_600).prop_map(|(shape, at, rotate, scale)| Formation {
        shape,
        at,
        rotate,
        scale,
    })
}

fn paths() -> impl Strategy<Value = Path> {
    let shape = prop_oneof![
        1 => (5i64..30).prop_map(|radius| PathShape::Circle(radius * 100)),
        // Each point is further along x than the previous one, so that no bend is too sharp.
        2 => prop::collection::vec([5i64..20, -8i64..8, -3i64..4], 1..5).prop_map(|steps| {
            let mut points = vec![[0; 3]];
            for [on, aside, up] in steps {
                let [x, ..] = points[points.len() - 1];
                points.push([x + on * 100, aside * 100, up * 100]);
            }
            PathShape::Points(points)
        }),
    ];
    (shape, -180i64..180, 500i64..1_500).prop_map(|(shape, rotate, scale)| Path { shape, rotate, scale })
}

fn sweeps() -> impl Strategy<Value = Sweep> {
    let along = (paths(), 1i64..4, any::<bool>()).prop_map(|(path, laps, turning)| {
        let laps = if matches!(path.shape, PathShape::Circle(_)) { laps } else { 1 };
        Along { path, laps, turning }
    });
    (
        prop_oneof![Just(0), -400i64..400],
        prop::option::of([-3_000i64..3_000, -3_000i64..3_000]),
        prop_oneof![3 => Just(1_000), 1 => 800i64..2_500],
        point(-20..20),
        prop::option::of(along),
    )
        .prop_map(|(turn, about, grow, shift, along)| {
            let about = about.filter(|_| turn != 0);
            Sweep { turn, about, grow, shift, along }
        })
}

fn forms() -> impl Strategy<Value = Does> {
    // Without a choice between too many and too few places, most shows are rejected.
    let choice = || prop::option::weighted(0.8, any::<bool>());
    (formations(), any::<bool>(), choice(), choice())
        .prop_map(|(formation, longest, spare, evenly)| Does::Form { formation, longest, spare, evenly })
}

fn cues() -> impl Strategy<Value = Cue> {
    let robots = prop::collection::vec(any::<bool>(), ROBOTS).prop_map(|taken| {
        let all: Vec<usize> = (0..ROBOTS).filter(|robot| taken[*robot]).collect();
        if all.is_empty() { vec![0, 2, 4] } else { all }
    });
    let everyone = prop_oneof![robots, Just((0..ROBOTS).rev().collect())];
    let does = prop_oneof![
        1 => prop::collection::vec(point(-40..40), ROBOTS).prop_map(Does::Go),
        1 => Just(Does::Home),
        4 => forms(),
        4 => sweeps().prop_map(Does::Sweep),
    ];
    let canon = prop_oneof![2 => Just(0), 1 => 1i64..900];
    (everyone, does, 12i64..50, any::<bool>(), 0i64..900, canon).prop_map(
        |(robots, does, beats, in_beats, lag, canon)| {
            let over = if in_beats { beats * BEAT } else { beats * BEAT + 7 };
            Cue { robots, does, over, in_beats, lag, canon }
        },
    )
}

pub(super) fn shows() -> impl Strategy<Value = Show> {
    let acts = prop::collection::vec(prop::collection::vec(cues(), 1..4), 1..3);
    (acts, any::<bool>(), any::<bool>()).prop_map(|(acts, by_sequence, by_include)| Show {
        acts,
        by_sequence,
        by_include,
    })
}

fn thousandths(value: i64) -> String {
    (value as f64 / 1_000.0).to_string()
}

fn list(parts: &[i64]) -> String {
    format!("[{}]", parts.iter().copied().map(thousandths).collect::<Vec<_>>().join(", "))
}

fn points(all: &[[i64; 3]]) -> String {
    format!("[{}]", all.iter().map(|point| list(point)).collect::<Vec<_>>().join(", "))
}

impl Formation {
    fn yaml(&self, size: &str) -> String {
        let shape = match &self.shape {
            Shape::Points(all) => format!("points: {}", points(all)),
            Shape::LineSpacing(spacing) => format!("line: {{spacing: {}}}", thousandths(*spacing)),
            Shape::LineLength(length) => format!("line: {{length: {}}}", thousandths(*length)),
            Shape::CircleRadius(radius) => format!("circle: {{radius: {}}}", thousandths(*radius)),
            Shape::CircleSpacing(spacing) => format!("circle: {{spacing: {}}}", thousandths(*spacing)),
            Shape::Grid(spacing, columns) => {
                format!("grid: {{spacing: {}, columns: {columns}}}", thousandths(*spacing))
            }
            Shape::Vee(spacing, angle) => {
                format!("v: {{spacing: {}, angle: {angle}}}", thousandths(*spacing))
            }
        };
        let rotate = match self.rotate {
            Ok(yaw) => yaw.to_string(),
            Err([roll, pitch, yaw]) => format!("[{roll}, {pitch}, {yaw}]"),
        };
        let scale = thousandths(self.scale);
        format!("{{{shape}, at: {}, rotate: {rotate}, scale: {scale}{size}}}", list(&self.at))
    }
}

impl Path {
    fn yaml(&self, size: &str) -> String {
        let shape = match &self.shape {
            PathShape::Circle(radius) => format!("circle: {{radius: {}}}", thousandths(*radius)),
            PathShape::Points(all) => format!("points: {}", points(all)),
        };
        format!("{{{shape}, rotate: {}, scale: {}{size}}}", self.rotate, thousandths(self.scale))
    }
}

impl Sweep {
    fn yaml(&self, path: &str) -> String {
        let mut yaml = Vec::new();
        match (self.turn, self.about) {
            (0, _) => {}
            (turn, None) => yaml.push(format!("turn: {turn}")),
            (turn, Some(about)) => yaml.push(format!("turn: {{by: {turn}, about: {}}}", list(&about))),
        }
        if self.grow != 1_000 {
            yaml.push(format!("grow: {}", thousandths(self.grow)));
        }
        if self.shift != [0; 3] || (self.turn == 0 && self.grow == 1_000 && self.along.is_none()) {
            yaml.push(format!("shift: {}", list(&self.shift)));
        }
        if let Some(Along { laps, turning, .. }) = &self.along {
            let laps = if *laps == 1 { String::new() } else { format!(", laps: {laps}") };
            yaml.push(format!("along: {{path: {path}{laps}, turning: {turning}}}"));
        }
        yaml.join(", ")
    }
}

impl Cue {
    fn yaml(&self, name: &str, shape: &str, over: Option<&str>) -> String {
        let robots: Vec<String> = self.robots.iter().map(|robot| format!("d{robot}")).collect();
        let mut yaml = format!("robots: [{}]", robots.join(", "));
        let over = over.map_or_else(|| self.over(), str::to_owned);
        match &self.does {
            Does::Go(places) => {
                let track = |axis: usize| {
                    let of = |index: usize| {
                        format!("if($index == {index}, {}, ", thousandths(places[index][axis]))
                    };
                    let all: String = (0..ROBOTS).map(of).collect();
                    let to = format!("\"{all}0{}\"", ")".repeat(ROBOTS));
                    format!("{}: [{{at: {over}, to: {to}}}]", ["x", "y", "z"][axis])
                };
                write!(yaml, ", tracks: {{{}, {}, {}}}", track(0), track(1), track(2)).unwrap();
            }
            Does::Home => write!(yaml, ", form: home, over: {over}").unwrap(),
            Does::Form { longest, spare, evenly, .. } => {
                let mut form = format!("to: {shape}");
                form.push_str(if *longest { ", least: longest" } else { "" });
                form.push_str(spare.map_or("", |home| if home { ", spare: home" } else { ", spare: stay" }));
                form.push_str(
                    evenly.map_or("", |evenly| if evenly { ", thin: evenly" } else { ", thin: nearest" }),
                );
                write!(yaml, ", form: {{{form}}}, over: {over}").unwrap();
            }
            Does::Sweep(sweep) => write!(yaml, ", {}, over: {over}", sweep.yaml(shape)).unwrap(),
        }
        if self.canon > 0 {
            write!(yaml, ", canon: {}ms", self.canon).unwrap();
        }
        format!("cue: {name}, {yaml}")
    }

    fn over(&self) -> String {
        if self.in_beats { format!("{} beats", self.over / BEAT) } else { format!("{}ms", self.over) }
    }
}

impl Show {
    /// Returns the scenario and its included file.
    pub(super) fn yaml(&self) -> (String, String) {
        let (mut formations, mut paths, mut acts) = (String::new(), String::new(), String::new());
        let mut sequences = String::new();
        let size = if self.by_include { " * $size" } else { "" };
        let mut number = 0;
        for (act_number, act) in self.acts.iter().enumerate() {
            let (mut cues, mut declared, mut given) = (String::new(), String::new(), String::new());
            for (index, cue) in act.iter().enumerate() {
                number += 1;
                let own = format!("s{number}");
                match &cue.does {
                    Does::Form { formation, .. } => {
                        writeln!(formations, "  {own}: {}", formation.yaml(size)).unwrap();
                    }
                    Does::Sweep(Sweep { along: Some(along), .. }) => {
                        writeln!(paths, "  {own}: {}", along.path.yaml(size)).unwrap();
                    }
                    _ => {}
                }
                let shape = if self.by_include { format!("lib.{own}") } else { own };
                let over = self.by_sequence.then(|| format!("$o{index}"));
                let after = match index.checked_sub(1) {
                    Some(before) => format!("after: c{before} + {}ms", cue.lag),
                    None => format!("at: {}ms", cue.lag),
                };
                let yaml = cue.yaml(&format!("c{index}"), &shape, over.as_deref());
                writeln!(cues, "      - {{{yaml}, {after}}}").unwrap();
                write!(declared, "o{index}: ~, ").unwrap();
                write!(given, "o{index}: {}, ", cue.over()).unwrap();
            }
            writeln!(acts, "  - act: a{act_number}\n    cues:").unwrap();
            if self.by_sequence {
                writeln!(sequences, "  q{act_number}:\n    parameters: {{{declared}}}\n    cues:\n{cues}")
                    .unwrap();
                writeln!(
                    acts,
                    "      - {{cue: q, at: 0s, sequence: q{act_number}, parameters: {{{given}}}}}"
                )
                .unwrap();
            } else {
                acts.push_str(&cues);
            }
        }
        let section =
            |key: &str, text: String| if text.is_empty() { text } else { format!("{key}:\n{text}") };
        let shapes = section("formations", formations) + &section("paths", paths);
        let mut text = "scenario: s\ntempo: 120\n".to_owned();
        text.push_str(&section("sequences", sequences));
        if self.by_include {
            text.push_str("include: {file: shapes.yaml, as: lib, parameters: {size: 1}}\n");
        } else {
            text.push_str(&shapes);
        }
        (format!("{text}acts:\n{acts}"), format!("parameters: {{size: 7}}\n{shapes}"))
    }
}
