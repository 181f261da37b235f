//! A second evaluation of whole scenarios: acts, groups, related cues, zones, tempos, readings, values one or several at a time, numbers
//! that differ between robots, and changes of movements. Times are integers and fractions, computed by the simplest possible method.
//! Movements are evaluated point by point. They are evaluated step by step if the device plays the written keyframes without further
//! steps.
//!
//! The number of scenarios is 150, or `DOWNBEAT_SCENARIOS` if that is set.

mod draw;
mod meaning;
mod spread;
mod steps;
mod times;
mod written;

use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap};
use std::io::Write as _;

use proptest::prelude::*;
use proptest::test_runner::TestRunner;

use self::draw::shows;
use self::spread::Each;
use self::steps::compare;
use super::robot;
use super::verified::held::Values;
use super::verified::{Change, Movement};
use crate::space::{Body, Coordinate, Shape};
use crate::{Code, Compiled, Files, Finding, Fleet, FleetRobot, Severity, Source, compile};

type Nanos = i128;
const MS: Nanos = 1_000_000;

/// The devices of every robot: name, whether the device moves linearly, granularity, and number of steps per script.
const DEVICES: [(&str, bool, f64, usize); 7] = [
    ("pole", true, 0.001, 100_000),
    ("crane", true, 0.5, 100_000),
    ("chain", true, 0.5, 7),
    ("valve", false, 0.5, 100_000),
    ("tap", false, 0.5, 9),
    ("gate", false, 4.0, 100_000),
    ("lamp", false, 1.0, 100_000),
];
/// Index of the device that takes three values at once.
const LAMP: usize = 6;
/// Returns the possible values of a device. If the device has a coarse grid, its limits are not on the grid.
fn settable(device: usize) -> Values {
    match DEVICES[device] {
        (_, _, granularity, _) if granularity > 1.0 => Values(-50.2, 47.3, granularity),
        (_, _, granularity, _) => Values(-1_000.0, 1_000.0, granularity),
    }
}

/// Name of the sensor that every robot has.
const SENSOR: &str = "eye";
const ROBOTS: [&str; 4] = ["a", "b", "c", "d"];
/// Place of each robot along x, in millimetres.
const PLACES: [i128; 4] = [700, -500, 700, 1_300];
/// Names of robots, groups and roles, and lists of names, with the robots to which they refer.
const NAMES: [(&str, &[usize]); 8] = [
    ("a", &[0]),
    ("b", &[1]),
    ("c", &[2]),
    ("pair", &[2, 0]),
    ("all", &[0, 1, 2, 3]),
    ("cast", &[1, 2]),
    ("[c, a]", &[2, 0]),
    ("[d, b, a]", &[3, 1, 0]),
];

/// A cue with one movement.
#[derive(Clone, Debug)]
struct Cue {
    who: usize,
    device: usize,
    movement: Movement,
    /// Keyframes that the device plays without further steps: times in quarters of a beat, and values in quarters of a unit. `None` if
    /// the movement has another form.
    beats: Option<Vec<(Each, Each)>>,
    /// Keyframes with three values each: times in milliseconds, and values. `None` for a device with one value.
    colours: Option<Vec<(i64, [f64; 3])>>,
    /// Times at which the cue's robots read their sensor, in milliseconds from the cue's start.
    reads: Vec<i64>,
    change: Change,
    /// Difference, in milliseconds, between the interval of repetitions (`every`, if it is written) and the longest movement of the cue's
    /// robots.
    pause: Each,
    /// Scaling that replaces the one in `change`: factor in quarters, and value that stays fixed.
    scale: Option<(Each, i64)>,
    tolerance: Option<f64>,
    canon: Option<Canon>,
    late: Option<(usize, i64)>,
    stretch: Option<(i64, i64)>,
    when: When,
    relations: Vec<Relation>,
    zone: Option<usize>,
    apart: Option<usize>,
    /// Whether the cue uses a move with parameters instead of its own tracks.
    by_move: bool,
    /// Whether the cue's move plays other moves. With a fixed start, these are two moves that divide the keyframes between them.
    composed: bool,
    /// Whether numbers that differ between robots are defaults of parameters (`true`) or arguments (`false`); `None` if they are written
    /// directly.
    parameters: Option<bool>,
}

impl Cue {
    /// Whether the cue only sets a value, without a movement.
    fn is_instant(&self) -> bool {
        self.beats.as_ref().is_some_and(|beats| beats.len() == 1)
    }
}

/// Delays of the robots in milliseconds. `Speed` is the speed of a wave instead, in quarters of a metre per second.
#[derive(Clone, Copy, Debug)]
enum Canon {
    Even(i64),
    /// A delay between consecutive robots that grows by this amount from robot to robot.
    Growing(i64),
    Backward(i64),
    Outward(i64),
    Inward(i64),
    /// The robots begin in the order of their places.
    Ranked(i64),
    Speed(i64),
    Over(i64),
}

#[derive(Clone, Copy, Debug)]
enum When {
    Free,
    At(i64),
    /// The start of the first robot and the delay between consecutive robots, in milliseconds.
    Each(i64, i64),
    Between(i64, i64),
    Bar(i64),
    EndBy(i64),
}

/// A relation to another cue, which is identified by its index in the act.
#[derive(Clone, Copy, Debug)]
struct Relation {
    word: Word,
    other: usize,
    /// Whether `end of` is written instead of `start of`; `None` if neither is written.
    end: Option<bool>,
    lag: Lag,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Word {
    After,
    With,
    Before,
}

/// Time between two cues, in milliseconds or in quarters of a beat.
#[derive(Clone, Copy, Debug)]
enum Lag {
    None,
    One(i64),
    Range(i64, i64),
    Beats(i64),
}

#[derive(Clone, Debug)]
struct Show {
    /// Tempos in the order of their bars.
    tempos: Vec<Tempo>,
    auto: bool,
    acts: Vec<Vec<Cue>>,
    /// Whether the cues of an act are written as a sequence. Acts with positions in the music are excluded.
    by_sequence: bool,
    /// Whether moves are in a file that is included under a name. The unit of their values is a parameter of the file.
    by_include: bool,
}

#[derive(Clone, Copy, Debug)]
struct Tempo {
    /// Bar in which the tempo begins, from 1.
    bar: i64,
    /// Tempo in hundredths of beats per minute.
    bpm: i64,
    /// Beats per bar, and the note value of a beat; `None` if they are not written.
    signature: Option<(i64, i64)>,
}

struct Csvs(HashMap<String, String>);

impl Files for Csvs {
    fn read(&self, name: &str) -> Result<Source, Finding> {
        Ok(Source { name: name.into(), text: self.0.get(name).cloned().unwrap_or_default() })
    }
}

/// Returns a body that is a point, at a place along x, and never moves.
fn standing(x: f64) -> Body {
    Body {
        coordinates: [x, 0.0, 0.0, 0.0].map(Coordinate::Fixed),
        drive: None,
        shape: Shape::Ball { radius: 0.0 },
        joints: Vec::new(),
        tip: [0.0; 3],
        speed: None,
        acceleration: None,
    }
}

fn fleet() -> Fleet {
    let device = |(index, (name, moves, granularity, most)): (usize, &(&str, bool, f64, usize))| {
        let interpolation = if *moves { "linear" } else { "hold" };
        let error = match (*moves, *granularity) {
            (true, fine) if fine < 0.1 => r#", "max_error": 0.01"#,
            (true, _) => r#", "max_error": 0.5"#,
            (false, coarse) if coarse > 1.0 => r#", "max_error": 4"#,
            (false, _) => "",
        };
        let Values(min, max, _) = settable(index);
        let limits =
            format!(r#""min_value": {min}, "max_value": {max}, "granularity": {granularity}{error}"#);
        if *name == DEVICES[LAMP].0 {
            return format!(
                r#"{{"id": "{name}", "name": "{name}", "available_control_types": {{
                "custom_1": {{"values": 3}}, "script": {{{limits}, "max_number_of_steps": {most}}}}}}}"#
            );
        }
        format!(
            r#"{{"id": "{name}", "name": "{name}", "interpolation": "{interpolation}", "script_queue": 10000, "available_control_types": {{
            "position": {{{limits}}}, "script": {{{limits}, "max_number_of_steps": {most}}}}}}}"#
        )
    };
    let sensor = format!(
        r#"{{"id": "{SENSOR}", "name": "{SENSOR}", "available_control_types": {{"sensor": {{"min_value": 0, "max_value": 9}}}}}}"#
    );
    let devices: Vec<String> = DEVICES.iter().enumerate().map(device).chain([sensor]).collect();
    let bot = |id: &&str| {
        let block = format!(r#"{{"id": "{id}", "api_version": "1", "devices": [{}]}}"#, devices.join(", "));
        let init: urrcp::InitializationBlock = serde_json::from_str(&block).unwrap();
        let place = PLACES[ROBOTS.iter().position(|robot| robot == id).unwrap()] as f64 / 1_000.0;
        FleetRobot { id: init.id.clone(), init: Some(init), body: Some(standing(place)), ..robot() }
    };
    let robots: Vec<FleetRobot> = ROBOTS.iter().map(bot).collect();
    let group = |members: &[usize]| members.iter().map(|robot| robots[*robot].id.clone()).collect();
    let groups =
        BTreeMap::from([("pair".to_owned(), group(&[2, 0])), ("all".to_owned(), group(&[0, 1, 2, 3]))]);
    Fleet { robots, groups, ..Fleet::default() }
}

pub(super) fn scenarios() -> u32 {
    std::env::var("DOWNBEAT_SCENARIOS").ok().and_then(|text| text.parse().ok()).unwrap_or(150)
}

/// Numbers of compared scenarios and of the items in them.
#[derive(Debug, Default)]
struct Tally {
    /// This field and the next two count scenarios with a plan, with contradictory times, and with other errors.
    planned: usize,
    contradictory: usize,
    refused: usize,
    acts: usize,
    cues: usize,
    devices: usize,
    steps: usize,
    /// This field and the next one count cues that could start later, and devices for which every step is known.
    slack: usize,
    to_the_step: usize,
    /// This field and the next three count sensor readings, tracks of several values, values set without a movement, and acts with a
    /// change of tempo.
    readings: usize,
    colours: usize,
    instants: usize,
    tempo_changes: usize,
    /// This field and the next two count values that are spread over the robots, values calculated for each robot, and cues with `every`.
    spreads: usize,
    expressions: usize,
    everys: usize,
    /// Number of cues whose move comes from an included file.
    included: usize,
}

impl Tally {
    fn count(&mut self, show: &Show, compiled: &Compiled) {
        let told = |code: Code| compiled.findings.iter().any(|finding| finding.code == code);
        let Some(choreography) = &compiled.choreography else {
            let contradictory = told(Code::Conflict) || told(Code::NoOrder);
            *(if contradictory { &mut self.contradictory } else { &mut self.refused }) += 1;
            return;
        };
        self.planned += 1;
        for (act, written) in choreography.acts.iter().zip(&show.acts) {
            self.acts += 1;
            self.readings += act.readings.len();
            self.colours += written.iter().filter(|cue| cue.colours.is_some()).count();
            self.instants += written.iter().filter(|cue| cue.is_instant()).count();
            self.tempo_changes += usize::from(show.tempos.len() > 1);
            self.cues += act.cues.len();
            self.slack += act.cues.iter().filter(|cue| cue.slack > urrcp::Span::ZERO).count();
            self.devices += act.devices.len();
            self.steps += act.devices.iter().map(|used| used.steps).sum::<usize>();
            for cue in written {
                let known = (0..cue.robots().len()).filter(|index| cue.as_written(show, *index).is_some());
                self.to_the_step += known.count();
                let differing = cue.differing();
                self.spreads += differing.iter().filter(|each| matches!(each, Each::Spread { .. })).count();
                self.expressions +=
                    differing.iter().filter(|each| matches!(each, Each::Expression { .. })).count();
                self.everys += usize::from(cue.change.pause.is_some());
                self.included += usize::from(cue.by_move && show.by_include);
            }
        }
    }
}

/// Renames the cues of sequences to their names within the sequence, and removes the cue that plays the sequence.
fn without_sequences(mut compiled: Compiled) -> Compiled {
    for act in compiled.choreography.iter_mut().flat_map(|choreography| &mut choreography.acts) {
        act.cues.retain(|cue| cue.name != written::SEQUENCE);
        for cue in &mut act.cues {
            if let Some(own) = cue.name.strip_prefix(&format!("{}.", written::SEQUENCE)) {
                cue.name = own.to_owned();
            }
        }
    }
    compiled
}

#[test]
fn whole_scenarios_match_independent_implementation() {
    let config = ProptestConfig {
        max_shrink_iters: 20_000,
        failure_persistence: None,
        ..ProptestConfig::with_cases(scenarios())
    };
    let tally = RefCell::new(Tally::default());
    let looked_at = TestRunner::new(config).run(&shows(), |show| {
        let mut csvs = HashMap::new();
        let text = show.yaml(&mut csvs);
        let csvs = Csvs(csvs);
        let source = Source { name: "s.yaml".into(), text };
        let compiled = without_sequences(compile(&source, &fleet(), &csvs));
        tally.borrow_mut().count(&show, &compiled);
        compare(&show, &compiled).map_err(|error| {
            let errors = compiled.findings.iter().filter(|finding| finding.severity == Severity::Error);
            let errors: Vec<&str> = errors.map(|finding| finding.message.as_str()).collect();
            TestCaseError::fail(format!("{}\n{:?}\n{errors:#?}\n{error}", source.text, csvs.0))
        })
    });
    looked_at.unwrap_or_else(|error| panic!("{error}"));
    drop(writeln!(std::io::stderr(), "{:?}", tally.into_inner()));
}
