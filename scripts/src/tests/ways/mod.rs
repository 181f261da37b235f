//! A second evaluation of transitions between acts, with random acts that have `next`, `wait`, `otherwise` and `on_failure` and move
//! devices from keyframe to keyframe. It determines the possible positions of each device at the start of an act by following every
//! transition. It predicts the faults (errors and warnings) of positions, values and the graph of acts, and compares them with the
//! findings. For valid scenarios, it also predicts the first positions and the limits of selections (`--act`, `--from`, `--only`,
//! `--speed`).
//!
//! The number of scenarios is twice the number that `whole` checks.

mod cases;
pub(super) mod draw;
mod meaning;
pub(super) mod observed;
mod selection;
mod waiting;
mod written;

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::io::Write as _;

use proptest::prelude::*;
use proptest::test_runner::TestRunner;

use self::draw::shows;
use crate::{Compiled, Fleet, FleetRobot, NoFiles, Source, compile};

pub(super) const ROBOTS: [&str; 3] = ["a", "b", "c"];

/// A kind of device that every robot has.
pub(super) struct Kind {
    pub(super) name: &'static str,
    /// Whether the device moves linearly; otherwise it holds each value.
    pub(super) moves: bool,
    /// Largest speed. If it is set, the device can also be driven by speed.
    pub(super) speed: Option<f64>,
    pub(super) limits: [f64; 2],
    pub(super) granularity: f64,
    pub(super) default: Option<f64>,
    /// Number of scripts that the device can hold.
    queue: usize,
    /// Values that are drawn more often than others.
    pub(super) values: [f64; 4],
}

const DEVICES: [Kind; 5] = [
    Kind {
        name: "joint",
        moves: true,
        speed: Some(20.0),
        limits: [-100.0, 100.0],
        granularity: 0.5,
        default: Some(10.0),
        queue: 100,
        values: [10.0, 0.0, 20.0, 30.0],
    },
    // The limits of this device are off its grid.
    Kind {
        name: "slide",
        moves: true,
        speed: None,
        limits: [-50.2, 47.3],
        granularity: 4.0,
        default: Some(8.0),
        queue: 100,
        values: [8.0, 16.0, 44.0, 47.3],
    },
    Kind {
        name: "drum",
        moves: false,
        speed: Some(30.0),
        limits: [0.0, 90.0],
        granularity: 1.0,
        default: Some(0.0),
        queue: 100,
        values: [0.0, 15.0, 30.0, 45.0],
    },
    Kind {
        name: "lamp",
        moves: false,
        speed: None,
        limits: [-3.3, 9.7],
        granularity: 0.5,
        default: None,
        queue: 1,
        values: [0.0, 5.0, 9.5, 9.5],
    },
    Kind {
        name: "rail",
        moves: true,
        speed: None,
        limits: [-50.0, 50.0],
        granularity: 0.1,
        default: None,
        queue: 100,
        values: [0.0, 3.0, 0.3, -20.0],
    },
];
/// The sensor of every robot, with readings from 0 to 9.
const SENSOR: &str = "eye";

/// The target of a transition.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Target {
    Act(usize),
    End,
    /// An act that does not exist.
    Nowhere,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Waits {
    Done,
    Operator,
    Time,
    /// The sensor has a reading above this value.
    Above(u32),
    /// The act waits for a sensor, but the sensor does not exist.
    Nothing,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Word {
    Stop,
    Home,
    Without,
}

#[derive(Clone, Debug)]
pub(super) struct Act {
    pub(super) waits: Waits,
    /// Target of the transition after a timeout of the wait; `None` if it is not written.
    pub(super) otherwise: Option<Target>,
    pub(super) next: Option<Target>,
    pub(super) default: Option<Word>,
    pub(super) words: Vec<(usize, Word)>,
    pub(super) then: Option<usize>,
    /// Cues in order; each starts after the end of the previous one.
    pub(super) cues: Vec<Cue>,
}

#[derive(Clone, Debug)]
pub(super) struct Cue {
    pub(super) robots: Vec<usize>,
    pub(super) device: usize,
    /// Start of the cue in milliseconds, since the act's start.
    pub(super) at: i64,
    /// Keyframes as milliseconds since the cue's start, and values: positions or speeds.
    pub(super) keyframes: Vec<(i64, f64)>,
    pub(super) by_speed: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Lease {
    /// The default lease of the scenario language.
    Usual,
    None,
    /// A lease in milliseconds.
    Of(i64),
}

#[derive(Clone, Debug)]
pub(super) struct Show {
    /// Whether values off the grid are moved to the grid.
    pub(super) snap: bool,
    pub(super) lease: Lease,
    pub(super) default: Option<Word>,
    pub(super) acts: Vec<Act>,
}

impl Cue {
    pub(super) fn kind(&self) -> &'static Kind {
        &DEVICES[self.device]
    }

    pub(super) fn end(&self) -> i64 {
        self.at + self.keyframes.last().map_or(0, |(at, _)| *at)
    }
}

impl Act {
    pub(super) fn end(&self) -> i64 {
        self.cues.iter().map(Cue::end).max().unwrap_or(0)
    }
}

/// Creates a fleet of robots with these names.
pub(super) fn fleet_of(robots: &[&str]) -> Fleet {
    let device = |kind: &Kind| {
        let [min, max] = kind.limits;
        let limits =
            format!(r#""min_value": {min}, "max_value": {max}, "granularity": {}"#, kind.granularity);
        let speed = kind.speed.map_or(String::new(), |speed| {
            format!(r#""speed": {{"min_value": -{speed}, "max_value": {speed}, "granularity": 1}}, "#)
        });
        let default = kind.default.map_or(String::new(), |value| format!(r#""default_value": {value}, "#));
        format!(
            r#"{{"id": "{0}", "name": "{0}", {default}"interpolation": "{1}", "script_queue": {2}, "available_control_types": {{
            "position": {{{limits}}}, {speed}"script": {{{limits}, "max_number_of_steps": 1000}}}}}}"#,
            kind.name,
            if kind.moves { "linear" } else { "hold" },
            kind.queue
        )
    };
    let sensor = format!(
        r#"{{"id": "{SENSOR}", "name": "{SENSOR}", "available_control_types": {{"sensor": {{"min_value": 0, "max_value": 9}}}}}}"#
    );
    let devices: Vec<String> = DEVICES.iter().map(device).chain([sensor]).collect();
    let robot = |id: &&str| {
        let block = format!(r#"{{"id": "{id}", "api_version": "1", "devices": [{}]}}"#, devices.join(", "));
        let init: urrcp::InitializationBlock = serde_json::from_str(&block).unwrap();
        FleetRobot { id: init.id.clone(), init: Some(init), ..super::robot() }
    };
    Fleet { robots: robots.iter().map(robot).collect(), ..Fleet::default() }
}

pub(super) fn compiled(text: &str, fleet: &Fleet) -> Compiled {
    compile(&Source { name: "s.yaml".into(), text: text.to_owned() }, fleet, &NoFiles)
}

/// Numbers of compared shows and of the items in them.
#[derive(Debug, Default)]
struct Tally {
    shows: usize,
    planned: usize,
    selections: usize,
    /// Number of findings per code.
    codes: std::collections::BTreeMap<&'static str, usize>,
}

fn compare(show: &Show, tally: &mut Tally) -> Result<(), TestCaseError> {
    let (text, fleet) = (show.yaml(), fleet_of(&ROBOTS));
    let compiled = compiled(&text, &fleet);
    tally.shows += 1;
    tally.planned += usize::from(compiled.choreography.is_some());
    for finding in &compiled.findings {
        *tally.codes.entry(finding.code.as_str()).or_default() += 1;
    }
    let fail = |error: String| TestCaseError::fail(format!("{text}\n{error}\n{:#?}", compiled.findings));
    let (expected, completeness) = show.facts();
    let mut observed = observed::facts(&compiled.findings).map_err(fail)?;
    observed.retain(|fact| completeness.includes(fact));
    let missing: BTreeSet<_> = expected.difference(&observed).collect();
    let excess: BTreeSet<_> = observed.difference(&expected).collect();
    if !missing.is_empty() || !excess.is_empty() {
        return Err(fail(format!("not reported: {missing:#?}\nreported without cause: {excess:#?}")));
    }
    if let Some(choreography) = &compiled.choreography {
        tally.selections +=
            selection::compare(show, choreography, &fleet).map_err(|error| fail(error.to_string()))?;
    }
    Ok(())
}

#[test]
fn findings_on_every_path_match_independent_implementation() {
    let config = ProptestConfig {
        max_shrink_iters: 20_000,
        failure_persistence: None,
        ..ProptestConfig::with_cases(2 * super::whole::scenarios())
    };
    let tally = RefCell::new(Tally::default());
    let looked_at = TestRunner::new(config).run(&shows(), |show| compare(&show, &mut tally.borrow_mut()));
    looked_at.unwrap_or_else(|error| panic!("{error}"));
    drop(writeln!(std::io::stderr(), "{:?}", tally.into_inner()));
}
