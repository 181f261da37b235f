//! A second, slow evaluation of movements: the meaning of a track is evaluated point by point from the written text, and compared with
//! the steps and the numbers of the plan.
//!
//! The number of movements is `PROPTEST_CASES`, if that is set.

pub(super) mod held;

use proptest::prelude::*;

use held::{Held, Values, as_few_as_can_be};

use super::numbers::{compiled_with, steps, used};
use crate::{Act, Code, DeviceUse};

/// Distance from a jump, in milliseconds, within which the value before the jump and the value after it are both accepted.
pub(super) const NEAR: f64 = 1e-3;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Ease {
    Own,
    Linear,
    Smooth,
    Cubic,
    Step,
}

/// A section of a movement between two values. Times are in milliseconds.
#[derive(Clone, Debug)]
pub(super) struct Way {
    pub(super) begin: f64,
    pub(super) end: f64,
    form: Form,
}

#[derive(Clone, Debug)]
pub(super) enum Form {
    Eased(Ease, f64, f64),
    /// Coefficients of a polynomial in the seconds since the section's start.
    Polynomial(Vec<f64>),
    /// A sine wave: its amplitude, its period in seconds, its phase in cycles, and its centre.
    Wave([f64; 4]),
    /// The function |a + b t| + c, where t is the time since the section's start in seconds.
    Bent([f64; 3]),
    /// The function a t sin(2 pi t / b) + c, where t is the time since the section's start in seconds.
    Growing([f64; 3]),
}

impl Form {
    /// Returns the value after the share `s` of the section, whose whole duration is `seconds`.
    fn at(&self, s: f64, seconds: f64) -> f64 {
        match self {
            Self::Eased(ease, from, to) => {
                let part = match ease {
                    Ease::Own | Ease::Linear => s,
                    Ease::Smooth => 10.0 * s.powi(3) - 15.0 * s.powi(4) + 6.0 * s.powi(5),
                    Ease::Cubic => 3.0 * s * s - 2.0 * s.powi(3),
                    Ease::Step => 0.0,
                };
                from * (1.0 - part) + to * part
            }
            Self::Polynomial(c) => c.iter().enumerate().map(|(k, c)| c * (s * seconds).powi(k as i32)).sum(),
            Self::Wave([amplitude, period, phase, center]) => {
                center + amplitude * (std::f64::consts::TAU * (s * seconds / period + phase)).sin()
            }
            Self::Bent([a, b, c]) => (a + b * s * seconds).abs() + c,
            Self::Growing([a, b, c]) => a * s * seconds * (std::f64::consts::TAU * s * seconds / b).sin() + c,
        }
    }
}

/// A movement as written, and the sections that define its meaning.
#[derive(Clone, Debug)]
pub(super) struct Movement {
    pub(super) yaml: String,
    pub(super) csv: String,
    pub(super) ways: Vec<Way>,
}

fn length(ways: &[Way]) -> f64 {
    ways.last().map_or(0.0, |way| way.end)
}

/// The changes that a cue makes to a movement.
#[derive(Clone, Debug)]
pub(super) struct Change {
    pub(super) yaml: String,
    /// The change turns each value into shift + factor * value.
    factor: f64,
    shift: f64,
    pub(super) backwards: bool,
    pub(super) turns: u32,
    /// Time between the end of a repetition and the start of the next one, in milliseconds; `None` if it is not written.
    pub(super) pause: Option<f64>,
    /// Duration to which the movement is stretched, in milliseconds; `None` if it is not stretched.
    pub(super) duration: Option<f64>,
}

/// Placeholder in the text for the interval between repetitions.
pub(super) const EVERY: &str = "EVERY";

impl Change {
    /// Returns a change that leaves movements as they are.
    pub(super) fn none() -> Self {
        Self {
            yaml: String::new(),
            factor: 1.0,
            shift: 0.0,
            backwards: false,
            turns: 1,
            pause: None,
            duration: None,
        }
    }

    /// Returns a copy of the change that first scales the values by the factor `by` about the value `about`.
    pub(super) fn scaled(&self, by: f64, about: f64) -> Self {
        let shift = self.shift + self.factor * about * (1.0 - by);
        Self { factor: self.factor * by, shift, ..self.clone() }
    }

    /// Returns the interval between repetitions of a movement that lasts `once`, in milliseconds.
    fn cycle(&self, once: f64) -> f64 {
        once + self.pause.unwrap_or(0.0)
    }

    /// Returns the length of all repetitions as written, in milliseconds, if a single repetition lasts `once` milliseconds.
    pub(super) fn whole(&self, once: f64) -> f64 {
        self.cycle(once) * f64::from(self.turns) - self.pause.unwrap_or(0.0)
    }

    /// Returns the value after the change.
    pub(super) fn of(&self, value: f64) -> f64 {
        self.shift + self.factor * value
    }
}

impl Movement {
    /// Creates a movement from keyframes (milliseconds and values). The device plays them without further steps.
    pub(super) fn of_keyframes(yaml: &str, moves: bool, keyframes: &[(f64, f64)]) -> Self {
        let ease = if moves { Ease::Own } else { Ease::Step };
        let way = |pair: &[(f64, f64)]| {
            let form = Form::Eased(ease, pair[0].1, pair[1].1);
            Way { begin: pair[0].0, end: pair[1].0, form }
        };
        let ways = match keyframes {
            [(at, to)] => vec![Way { begin: *at, end: *at, form: Form::Eased(Ease::Step, *to, *to) }],
            _ => keyframes.windows(2).map(way).collect(),
        };
        Self { yaml: yaml.to_owned(), csv: String::new(), ways }
    }
}

/// Returns the value that a movement has at a time, after all changes. At a jump, this may be the value before or after the jump.
pub(super) fn meant(movement: &Movement, change: &Change, millis: f64) -> f64 {
    let once = length(&movement.ways);
    let cycle = change.cycle(once);
    let stretch = change.duration.map_or(1.0, |duration| duration / change.whole(once));
    let written = millis / stretch;
    let turn = (written / cycle).floor().min(f64::from(change.turns) - 1.0);
    let within = written - turn * cycle;
    // The device keeps its value until the next repetition.
    if within > once {
        return final_value(movement, change);
    }
    let at = if change.backwards { once - within } else { within };
    let way =
        movement.ways.iter().find(|way| at <= way.end).unwrap_or(&movement.ways[movement.ways.len() - 1]);
    let s = ((at - way.begin) / (way.end - way.begin)).clamp(0.0, 1.0);
    change.of(way.form.at(s, (way.end - way.begin) / 1_000.0))
}

/// Returns the final value of a movement after all changes, as written.
pub(super) fn final_value(movement: &Movement, change: &Change) -> f64 {
    let (first, last) = (&movement.ways[0], &movement.ways[movement.ways.len() - 1]);
    change.of(match (change.backwards, &first.form, &last.form) {
        (true, Form::Eased(_, from, _), _) => *from,
        (true, form, _) => form.at(0.0, 1.0),
        (false, _, Form::Eased(_, _, to)) => *to,
        (false, _, form) => form.at(1.0, (last.end - last.begin) / 1_000.0),
    })
}

/// Returns the value that a device has at a time if it plays the steps `steps`.
pub(super) fn played(steps: &[(f64, f64)], linear: bool, millis: f64) -> f64 {
    let after = steps.partition_point(|step| step.0 <= millis);
    let before = steps[after.saturating_sub(1)];
    match steps.get(after) {
        Some(next) if linear && after > 0 => {
            before.1 + (next.1 - before.1) * (millis - before.0) / (next.0 - before.0)
        }
        _ => before.1,
    }
}

/// Returns the times at which values are compared: evenly distributed times, and both sides of every possible jump.
pub(super) fn looked_at(movement: &Movement, change: &Change, steps: &[(f64, f64)]) -> Vec<f64> {
    let once = length(&movement.ways);
    let (cycle, all_turns) = (change.cycle(once), change.whole(once));
    let stretch = change.duration.map_or(1.0, |duration| duration / all_turns);
    let whole = all_turns * stretch;
    let mut times: Vec<f64> = (0..400).map(|i| whole * (f64::from(i) + 0.37) / 400.0).collect();
    let parts = |way: &Way| {
        let (begin, length) = (way.begin, way.end - way.begin);
        (0..=16).map(move |part| begin + length * f64::from(part) / 16.0)
    };
    let bounds = movement.ways.iter().flat_map(parts);
    let bounds = bounds.map(|at| if change.backwards { once - at } else { at });
    let all = (0..change.turns)
        .flat_map(|turn| bounds.clone().map(move |at| (at + cycle * f64::from(turn)) * stretch));
    times.extend(all.chain(steps.iter().map(|step| step.0)).flat_map(|at| [at - NEAR, at + NEAR]));
    times.retain(|at| *at > 0.0 && *at < whole);
    times
}

fn eases() -> impl Strategy<Value = Ease> {
    prop_oneof![
        3 => Just(Ease::Own), 1 => Just(Ease::Linear), 1 => Just(Ease::Smooth), 1 => Just(Ease::Cubic), 1 => Just(Ease::Step)
    ]
}

fn keyframes(linear: bool) -> impl Strategy<Value = Movement> {
    prop::collection::vec((1i32..2_000, -80i32..80, eases()), 2..8).prop_map(move |all| {
        let (mut now, mut yaml, mut ways) = (0, Vec::new(), Vec::new());
        let mut before = 0.0;
        for (index, (after, halves, ease)) in all.into_iter().enumerate() {
            let value = f64::from(halves) / 2.0;
            let begin = f64::from(now);
            now += if index == 0 { 0 } else { after };
            let word = match ease {
                Ease::Own => "",
                Ease::Linear => ", ease: linear",
                Ease::Smooth => ", ease: smooth",
                Ease::Cubic => ", ease: cubic",
                Ease::Step => ", ease: step",
            };
            // Writes every third keyframe with expressions.
            yaml.push(match index % 3 {
                2 => format!("{{at: {now} * 1ms, to: {halves} / 4 * 2{word}}}"),
                _ => format!("{{at: {now}ms, to: {value}{word}}}"),
            });
            if index > 0 {
                let ease = if ease == Ease::Own && !linear { Ease::Step } else { ease };
                ways.push(Way { begin, end: f64::from(now), form: Form::Eased(ease, before, value) });
            }
            before = value;
        }
        Movement { yaml: format!("keyframes: [{}]", yaml.join(", ")), csv: String::new(), ways }
    })
}

fn samples(linear: bool) -> impl Strategy<Value = Movement> {
    let ease = prop_oneof![Just(Ease::Own), Just(Ease::Linear), Just(Ease::Step)];
    (prop::collection::vec((1i32..900, -80i32..80), 2..12), ease).prop_map(move |(rows, ease)| {
        let (mut now, mut csv, mut ways) = (0, "t,v\n".to_owned(), Vec::new());
        let mut before = 0.0;
        let meant = if ease == Ease::Own && !linear { Ease::Step } else { ease };
        for (index, (after, value)) in rows.into_iter().enumerate() {
            let begin = f64::from(now);
            now += if index == 0 { 0 } else { after };
            let value = f64::from(value) / 8.0;
            csv.push_str(&format!("{now},{value}\n"));
            if index > 0 {
                ways.push(Way { begin, end: f64::from(now), form: Form::Eased(meant, before, value) });
            }
            before = value;
        }
        let word = match ease {
            Ease::Linear => ", ease: linear",
            Ease::Step => ", ease: step",
            _ => "",
        };
        Movement {
            yaml: format!("samples: {{file: c.csv, time: t, value: v, time_unit: ms{word}}}"),
            csv,
            ways,
        }
    })
}

/// Draws pieces of polynomials that meet, except for tiny gaps or jumps.
fn polynomial() -> impl Strategy<Value = Movement> {
    let gap = prop_oneof![2 => Just(0.0), 2 => (-80i32..80).prop_map(|gap| f64::from(gap) * 1e-6), 1 => (-8i32..8).prop_map(f64::from)];
    let piece = (50i32..1_500, prop::collection::vec(-40i32..40, 1..5), gap);
    prop::collection::vec(piece, 1..6).prop_map(|pieces| {
        let (mut now, mut end, mut yaml, mut ways) = (0, 0.0, Vec::new(), Vec::new());
        for (millis, coefficients, gap) in pieces {
            let mut c = vec![end + gap];
            c.extend(coefficients.iter().map(|c| f64::from(*c) / 8.0));
            yaml.push(format!("{{for: {millis}ms, coefficients: {c:?}}}"));
            let form = Form::Polynomial(c);
            end = form.at(1.0, f64::from(millis) / 1_000.0);
            ways.push(Way { begin: f64::from(now), end: f64::from(now + millis), form });
            now += millis;
        }
        Movement { yaml: format!("polynomial: [{}]", yaml.join(", ")), csv: String::new(), ways }
    })
}

fn wave() -> impl Strategy<Value = Movement> {
    (1i32..30, 300i32..4_000, 0i32..8, -20i32..20, 200i32..9_000).prop_map(|(amplitude, period, phase, center, millis)| {
        let yaml = format!(
            "wave: {{amplitude: {amplitude}, period: {period}ms, phase: {}, center: {center}, for: {millis}ms}}",
            45 * phase
        );
        let form = Form::Wave([f64::from(amplitude), f64::from(period) / 1_000.0, f64::from(phase) / 8.0, f64::from(center)]);
        Movement { yaml, csv: String::new(), ways: vec![Way { begin: 0.0, end: f64::from(millis), form }] }
    })
}

/// Draws a movement that starts at a value and becomes faster.
fn travel() -> impl Strategy<Value = Movement> {
    (-40i32..40, -20i32..20, -12i32..12, 200i32..5_000).prop_map(|(from, speed, acceleration, millis)| {
        let (from, speed, acceleration) =
            (f64::from(from), f64::from(speed) / 2.0, f64::from(acceleration) / 2.0);
        let yaml = format!(
            "travel: {{from: {from}, speed: {speed}, acceleration: {acceleration}, for: {millis}ms}}"
        );
        let form = Form::Polynomial(vec![from, speed, acceleration / 2.0]);
        Movement { yaml, csv: String::new(), ways: vec![Way { begin: 0.0, end: f64::from(millis), form }] }
    })
}

/// Draws a smooth curve through points, at rest at both ends.
fn spline() -> impl Strategy<Value = Movement> {
    prop::collection::vec((150i32..1_500, -40i32..40), 2..7).prop_map(|points| {
        let (mut now, mut knots, mut yaml) = (0, Vec::new(), Vec::new());
        for (index, (after, halves)) in points.into_iter().enumerate() {
            now += if index == 0 { 0 } else { after };
            knots.push((f64::from(now) / 1_000.0, f64::from(halves) / 2.0));
            yaml.push(format!("{{at: {now}ms, to: {}}}", f64::from(halves) / 2.0));
        }
        let ways = cubics(&knots).into_iter().zip(knots.windows(2)).map(|(c, pair)| Way {
            begin: pair[0].0 * 1_000.0,
            end: pair[1].0 * 1_000.0,
            form: Form::Polynomial(c),
        });
        Movement { yaml: format!("spline: [{}]", yaml.join(", ")), csv: String::new(), ways: ways.collect() }
    })
}

/// Returns the cubics c0 + c1 t + c2 t^2 + c3 t^3 between points, by solving all conditions on their coefficients as one system of
/// equations.
fn cubics(points: &[(f64, f64)]) -> Vec<Vec<f64>> {
    let pieces = points.len() - 1;
    let row = |entries: &[(usize, usize, f64)], right: f64| {
        let mut row = vec![0.0; 4 * pieces + 1];
        entries.iter().for_each(|(piece, power, factor)| row[4 * piece + power] += factor);
        row[4 * pieces] = right;
        row
    };
    let mut rows = vec![row(&[(0, 1, 1.0)], 0.0)];
    for piece in 0..pieces {
        let (t, from, to) = (points[piece + 1].0 - points[piece].0, points[piece].1, points[piece + 1].1);
        rows.push(row(&[(piece, 0, 1.0)], from));
        rows.push(row(&[(piece, 0, 1.0), (piece, 1, t), (piece, 2, t * t), (piece, 3, t.powi(3))], to));
        let slope = [(piece, 1, 1.0), (piece, 2, 2.0 * t), (piece, 3, 3.0 * t * t)];
        if piece + 1 == pieces {
            rows.push(row(&slope, 0.0));
        } else {
            rows.push(row(&[&slope[..], &[(piece + 1, 1, -1.0)]].concat(), 0.0));
            rows.push(row(&[(piece, 2, 2.0), (piece, 3, 6.0 * t), (piece + 1, 2, -2.0)], 0.0));
        }
    }
    solved(rows).chunks(4).map(<[f64]>::to_vec).collect()
}

/// Solves a system of equations by Gaussian elimination with the largest entry as pivot.
fn solved(mut rows: Vec<Vec<f64>>) -> Vec<f64> {
    let count = rows.len();
    for column in 0..count {
        let largest =
            (column..count).max_by(|a, b| rows[*a][column].abs().total_cmp(&rows[*b][column].abs()));
        rows.swap(column, largest.unwrap());
        let pivot = rows[column].clone();
        for (index, row) in rows.iter_mut().enumerate().filter(|(index, _)| *index != column) {
            let factor = row[column] / pivot[column];
            assert!(factor.is_finite(), "row {index}");
            row.iter_mut().zip(&pivot).for_each(|(entry, pivot)| *entry -= factor * pivot);
        }
    }
    (0..count).map(|index| rows[index][count] / rows[index][index]).collect()
}

/// Draws formulas with one section, with a corner, with a jump, or with many jumps.
fn formula() -> impl Strategy<Value = Movement> {
    (0usize..6, -12i32..13, 1i32..9, -20i32..20, 400i32..5_000).prop_map(|(kind, a, b, c, millis)| {
        let (whole, at) = (f64::from(millis), f64::from(millis) * 0.37);
        let way = |begin: f64, end: f64, form: Form| Way { begin, end, form };
        let (a_, b_, c_) = (f64::from(a), f64::from(b), f64::from(c));
        let (text, ways) = match kind {
            0 => {
                let form = Form::Wave([a_, b_, 0.125, c_]);
                (format!("{a} * sin(2 * pi * t / {b}s + pi / 4) + {c}"), vec![way(0.0, whole, form)])
            }
            1 => {
                let form = Form::Growing([a_, b_, c_]);
                (format!("{a} * t / 1s * sin(360 * t / {b}s) + {c}"), vec![way(0.0, whole, form)])
            }
            2 => {
                let form = Form::Bent([a_, b_, c_]);
                // The corner is sampled, too.
                let corner = (-a_ / b_ * 1_000.0).clamp(0.0, whole);
                let ways = if corner > 0.0 && corner < whole {
                    vec![
                        way(0.0, corner, form),
                        way(corner, whole, Form::Bent([a_ + b_ * corner / 1_000.0, b_, c_])),
                    ]
                } else {
                    vec![way(0.0, whole, form)]
                };
                (format!("abs({a} + {b} * t / 1s) + {c}"), ways)
            }
            3 => {
                let ways = vec![
                    way(0.0, at, Form::Polynomial(vec![c_, b_])),
                    way(at, whole, Form::Polynomial(vec![a_])),
                ];
                (format!("if(t < {}us, {c} + {b} * t / 1s, {a})", at * 1_000.0), ways)
            }
            4 => {
                let period = f64::from(b) * 150.0;
                let mut ways = Vec::new();
                while period * (ways.len() as f64) < whole - 1e-6 {
                    let begin = period * ways.len() as f64;
                    ways.push(way(begin, (begin + period).min(whole), Form::Polynomial(vec![c_, a_])));
                }
                (format!("{a} * (t % {}ms) / 1s + {c}", b * 150), ways)
            }
            _ => {
                let form = Form::Polynomial(vec![c_, a_, b_ / 2.0]);
                (format!("{c} + {a} * t / 1s + {b} * t * t / (2 * 1s * 1s)"), vec![way(0.0, whole, form)])
            }
        };
        Movement { yaml: format!("formula: \"{text}\", for: {millis}ms"), csv: String::new(), ways }
    })
}

pub(super) fn movements(linear: bool) -> impl Strategy<Value = Movement> {
    prop_oneof![
        4 => keyframes(linear).boxed(),
        2 => samples(linear).boxed(),
        4 => polynomial().boxed(),
        2 => wave().boxed(),
        1 => travel().boxed(),
        2 => spline().boxed(),
        3 => formula().boxed(),
    ]
}

pub(super) fn changes() -> impl Strategy<Value = Change> {
    let scale = prop_oneof![3 => Just(None), 1 => (-8i32..9, -10i32..11).prop_map(Some)];
    let duration = prop_oneof![3 => Just(None), 1 => (700i64..20_000).prop_map(Some)];
    let mirror = prop_oneof![5 => Just(None), 1 => Just(Some(None)), 1 => (-10i32..11).prop_map(|about| Some(Some(about)))];
    let pause = prop_oneof![2 => Just(None), 1 => (0i64..900).prop_map(Some)];
    let shape = (scale, mirror, prop::bool::weighted(0.25), 1u32..4, pause, duration);
    shape.prop_map(|(scale, mirror, backwards, turns, pause, duration)| {
        let (mut yaml, mut factor, mut shift) = (String::new(), 1.0, 0.0);
        if let Some((quarters, about)) = scale {
            let by = f64::from(quarters) / 4.0;
            yaml.push_str(&format!(", scale: {{by: {by}, about: {about}}}"));
            (factor, shift) = (by, f64::from(about) * (1.0 - by));
        }
        if let Some(about) = mirror {
            let told = about.map_or("true".to_owned(), |about| format!("{{about: {about}}}"));
            yaml.push_str(&format!(", mirror: {told}"));
            (factor, shift) = (-factor, 2.0 * f64::from(about.unwrap_or(0)) - shift);
        }
        yaml.push_str(if backwards { ", reverse: true" } else { "" });
        yaml.push_str(&match pause {
            Some(_) => format!(", repeat: {{times: {turns}, every: {EVERY}}}"),
            None if turns > 1 => format!(", repeat: {turns}"),
            None => String::new(),
        });
        yaml.push_str(&duration.map_or(String::new(), |duration| format!(", duration: {duration}ms")));
        let [pause, duration] = [pause, duration].map(|millis| millis.map(|millis| millis as f64));
        Change { yaml, factor, shift, backwards, turns, pause, duration }
    })
}

/// Draws a tolerance: none, a multiple of one half (which suits most grids), or any number of hundredths.
pub(super) fn tolerances() -> impl Strategy<Value = Option<f64>> {
    prop_oneof![
        2 => Just(None),
        1 => (1i32..12).prop_map(|halves| Some(f64::from(halves) / 2.0)),
        1 => (20i32..600).prop_map(|hundredths| Some(f64::from(hundredths) / 100.0)),
    ]
}

/// Compares the steps of a plan with the meaning of the movement.
fn verify(
    act: &Act,
    (device, linear): (&str, bool),
    movement: &Movement,
    change: &Change,
    tolerance: f64,
    granularity: f64,
) -> Result<(), TestCaseError> {
    let steps: Vec<(f64, f64)> =
        steps(act, device).into_iter().map(|(at, v)| (at as f64 / 1e6, v[0])).collect();
    let used = used(act, device);
    let whole = change.duration.unwrap_or(change.whole(length(&movement.ways)));
    for end in [act.cues[0].end, act.duration()] {
        prop_assert!((end.as_millis_f64() - whole).abs() < 2e-6, "{end}, not {whole} ms");
    }
    let changes = |pair: &[(f64, f64)]| linear || pair[0].1 != pair[1].1;
    prop_assert!(
        steps[steps.len() - 1].0 < whole + 2e-6 && steps.windows(2).next_back().is_none_or(changes),
        "{:?}",
        steps.last()
    );
    prop_assert!(used.at_least <= used.steps && used.steps == steps.len());
    for (index, step) in steps.iter().enumerate() {
        let on_grid = (step.1 / granularity - (step.1 / granularity).round()).abs() < 1e-6;
        prop_assert!(on_grid, "{step:?} is off the grid");
        prop_assert!(
            index == 0 || steps[index - 1].0 < step.0 || (linear && steps[index - 1].1 != step.1),
            "{step:?} twice"
        );
    }
    let mut worst: (f64, f64) = (0.0, 0.0);
    for at in looked_at(movement, change, &steps) {
        // Times around which more than two steps are close are skipped: the two sides of a jump cannot be distinguished there.
        let crowded = steps.iter().filter(|step| (step.0 - at).abs() < 2.0 * NEAR).count() > 2;
        let off = (played(&steps, linear, at) - meant(movement, change, at)).abs();
        if !crowded && off > worst.0 {
            worst = (off, at);
        }
    }
    let last = (steps[steps.len() - 1].1 - final_value(movement, change)).abs();
    // A jump at the very beginning leaves its first value no time to be sampled.
    let opposite = Change { backwards: !change.backwards, ..change.clone() };
    let first = (steps[0].1 - final_value(movement, &opposite)).abs();
    as_far_off(device, worst, last.max(first), (used.worst_error, tolerance))
}

/// Checks that the plan reports an error that is permitted and equal to `worst`, up to rounding. `worst` is the sampled error, with its
/// time in milliseconds from the start. The last step and values on the grid may deviate by more than the sampled error.
pub(super) fn as_far_off(
    who: &str,
    worst: (f64, f64),
    elsewhere: f64,
    (told, allowed): (f64, f64),
) -> Result<(), TestCaseError> {
    // Close to a jump, a thousandth of a millisecond changes a value slightly.
    let dust = 2e-3;
    prop_assert!(worst.0 <= told + dust, "{who}: off by {} at {} ms, not {told}", worst.0, worst.1);
    prop_assert!(told <= allowed * (1.0 + 1e-9), "{who}: {told} is more than {allowed}");
    let found = worst.0 + allowed / 4.0 + dust;
    prop_assert!(told <= found.max(elsewhere + 1e-9), "{who}: off by {} only, not {told}", worst.0);
    Ok(())
}

/// Checks that a track with `max_steps` has at most that number of steps. If the device holds its values, also checks that the error does
/// not exceed the smallest possible one.
fn with_so_many(
    used: &DeviceUse,
    linear: bool,
    movement: &Movement,
    change: &Change,
    values: Values,
    most: usize,
) -> Result<(), TestCaseError> {
    prop_assert!(used.steps <= most, "{} steps, not {most}", used.steps);
    let is_step = |way: &Way| matches!(way.form, Form::Eased(Ease::Step, ..));
    if linear || !movement.ways.iter().all(is_step) {
        return Ok(());
    }
    let once: Vec<f64> = movement.ways.iter().map(|way| change.of(way.form.at(0.0, 0.0))).collect();
    let turn = || if change.backwards { once.iter().rev().copied().collect() } else { once.clone() };
    let end = final_value(movement, change);
    let waits = |turn: u32| turn + 1 < change.turns && change.pause.is_some_and(|pause| pause > 0.0);
    let levels = (0..change.turns).flat_map(|number| turn().into_iter().chain(waits(number).then_some(end)));
    let levels: Vec<f64> = levels.collect();
    // The last step is the end of the movement, so one less is available.
    let least = least_error(&levels, most - 1, values).max((values.nearest(end) - end).abs());
    prop_assert!(used.worst_error <= least * (1.0 + 1e-6) + 1e-6, "off by {}, not {least}", used.worst_error);
    Ok(())
}

/// Returns the least error with which at most `most` consecutive values on a grid can represent the given sequence of levels. Tries every
/// way to divide the sequence.
fn least_error(levels: &[f64], most: usize, values: Values) -> f64 {
    let held = |part: &[f64]| {
        let low = part.iter().copied().fold(f64::INFINITY, f64::min);
        let high = part.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let nearest = values.nearest(f64::midpoint(low, high));
        let around = [nearest - values.2, nearest, nearest + values.2].map(|value| values.nearest(value));
        around.iter().map(|value| (value - low).abs().max((high - value).abs())).fold(f64::INFINITY, f64::min)
    };
    // best[n]: the least error for the first n levels.
    let mut best = vec![f64::INFINITY; levels.len() + 1];
    best[0] = 0.0;
    for _ in 0..most {
        let before = best.clone();
        for end in 1..=levels.len() {
            let with = |begin: usize| before[begin].max(held(&levels[begin..end]));
            best[end] = (0..end).map(with).fold(before[end], f64::min);
        }
    }
    best[levels.len()]
}

proptest! {
    #[test]
    fn steps_and_figures_match_independent_implementation(
        (linear, movement) in any::<bool>().prop_flat_map(|linear| (Just(linear), movements(linear))),
        change in changes(),
        tolerance in tolerances(),
        most in prop_oneof![3 => Just(None), 1 => (2usize..30).prop_map(Some)],
        fine in any::<bool>(),
    ) {
        let (device, values, own) = match (linear, fine) {
            (true, true) => ("pole", Values(-100.0, 100.0, 0.001), 0.01),
            (true, false) => ("crane", Values(-1_000.0, 1_000.0, 0.5), 0.5),
            (false, true) => ("valve", Values(-1_000.0, 1_000.0, 0.5), 0.5),
            (false, false) => ("dial", Values(-50.2, 47.3, 4.0), 4.0),
        };
        let mut wish = tolerance.map_or(String::new(), |tolerance: f64| format!("tolerance: {tolerance}, "));
        wish.push_str(&most.map_or(String::new(), |most| format!("max_steps: {most}, ")));
        let text = format!(
            "off_grid: snap\ncues: [{{at: 0s, robots: bot, tracks: {{{device}: {{{wish}{}}}}}{}}}]\n",
            movement.yaml,
            change.yaml.replace(EVERY, &format!("{}ms", change.cycle(length(&movement.ways)))),
        );
        let csv: &'static str = Box::leak(movement.csv.clone().into_boxed_str());
        let compiled = compiled_with(&text, csv);
        let known = [Code::OutOfRange, Code::ToleranceTooTight];
        match compiled.choreography {
            Some(choreography) => {
                let act = &choreography.acts[0];
                let used = used(act, device);
                let allowed = tolerance.unwrap_or(own);
                let is_thinned = tolerance.is_some() || most.is_some();
                let is_fitted = !movement.yaml.starts_with("keyframes") && change.pause.is_none();
                let fewest = || if !linear && (is_thinned || is_fitted) { as_few_as_can_be(used, &Held::of(&movement, &change, values), allowed, most) } else { Ok(()) };
                let so_many = |most| with_so_many(used, linear, &movement, &change, values, most);
                verify(act, (device, linear), &movement, &change, allowed, values.2)
                    .and_then(|()| most.map_or(Ok(()), so_many))
                    .and_then(|()| fewest())
                    .map_err(|error| TestCaseError::fail(format!("{text}\n{}\n{error}", movement.csv)))?;
            }
            None => {
                let codes: Vec<_> = compiled.findings.iter().map(|finding| finding.code).filter(|code| code.severity() == crate::Severity::Error).collect();
                prop_assert!(codes.iter().all(|code| known.contains(code)), "{text}\n{codes:?}");
            }
        }
    }
}
