//! A second evaluation of groups, with random shows. Their bodies form, turn, grow, shift and move along paths, with cues of their own
//! or of a sequence, and with formations and paths of an included file. The expected place of each robot follows from the text and from
//! the previous places; the actual place follows from the steps of the plan. The compiler chooses which robot takes which place, but the
//! places must be those of the formation, and the distances as short as in the best assignment.
//!
//! The number of scenarios is a fifth of the number that `whole` checks.

mod draw;
mod meaning;
mod path;

use std::cell::RefCell;
use std::io::Write as _;

use proptest::prelude::*;
use proptest::test_runner::TestRunner;

use self::draw::shows;
use self::meaning::compare;
use super::groups::{Steps, drone, steps_of};
use crate::space::Space;
use crate::{Compiled, Files, Finding, Fleet, FleetRobot, Source, compile};

type Point = [f64; 3];

/// Number of robots; `GAP` is their initial distance in metres.
const ROBOTS: usize = 5;
const GAP: f64 = 1.0;
/// Length of a beat at the tempo of all shows, in milliseconds.
const BEAT: i64 = 500;

#[derive(Clone, Debug)]
struct Show {
    acts: Vec<Vec<Cue>>,
    /// Whether the cues of each act are written as a sequence, which receives the duration of each cue as a parameter.
    by_sequence: bool,
    /// Whether formations and paths are in a file that is included under a name, with their size as a parameter.
    by_include: bool,
}

/// A cue that follows the previous one.
#[derive(Clone, Debug)]
struct Cue {
    robots: Vec<usize>,
    does: Does,
    /// Duration in milliseconds.
    over: i64,
    in_beats: bool,
    lag: i64,
    /// Delay between the starts of consecutive robots, in milliseconds.
    canon: i64,
}

#[derive(Clone, Debug)]
enum Does {
    /// Each robot moves separately, to places in millimetres.
    Go(Vec<[i64; 3]>),
    Home,
    Form {
        formation: Formation,
        longest: bool,
        /// Whether surplus robots stay where they are or go home; `None` if the key `spare` is not written.
        spare: Option<bool>,
        /// Whether surplus places are omitted at even steps or by distance; `None` if the key `thin` is not written.
        evenly: Option<bool>,
    },
    Sweep(Sweep),
}

/// A movement of the group as one body. Angles are in degrees, lengths in millimetres, and `grow` is in thousandths.
#[derive(Clone, Debug)]
struct Sweep {
    turn: i64,
    about: Option<[i64; 2]>,
    grow: i64,
    shift: [i64; 3],
    along: Option<Along>,
}

#[derive(Clone, Debug)]
struct Along {
    path: Path,
    laps: i64,
    turning: bool,
}

#[derive(Clone, Debug)]
struct Path {
    shape: PathShape,
    rotate: i64,
    scale: i64,
}

#[derive(Clone, Debug)]
enum PathShape {
    Circle(i64),
    Points(Vec<[i64; 3]>),
}

#[derive(Clone, Debug)]
struct Formation {
    shape: Shape,
    at: [i64; 3],
    /// Rotation in degrees: a single number is an angle about the vertical, three numbers are roll, pitch and yaw.
    rotate: Result<i64, [i64; 3]>,
    scale: i64,
}

/// The shape of a formation. Lengths are in millimetres.
#[derive(Clone, Debug)]
enum Shape {
    Points(Vec<[i64; 3]>),
    LineSpacing(i64),
    LineLength(i64),
    CircleRadius(i64),
    CircleSpacing(i64),
    Grid(i64, i64),
    Vee(i64, i64),
}

fn fleet() -> Fleet {
    let robots: Vec<FleetRobot> =
        (0..ROBOTS).map(|index| drone(index, [index as f64 * GAP, 0.0, 0.0])).collect();
    let space = Space { distance: Some(0.2), ..Space::default() };
    Fleet { robots, space, ..Fleet::default() }
}

/// A source of files that always returns the text of the included file.
struct Shapes(String);

impl Files for Shapes {
    fn read(&self, name: &str) -> Result<Source, Finding> {
        Ok(Source { name: name.into(), text: self.0.clone() })
    }
}

impl Show {
    fn compiled(&self) -> (String, Compiled) {
        let (text, shapes) = self.yaml();
        let source = Source { name: "s.yaml".into(), text };
        let compiled = compile(&source, &fleet(), &Shapes(shapes.clone()));
        (format!("{}\n{shapes}", source.text), compiled)
    }
}

/// Numbers of compared shows and of the items in them.
#[derive(Debug, Default)]
struct Tally {
    planned: usize,
    refused: usize,
    cues: usize,
    formed: usize,
    swept: usize,
    carried: usize,
}

impl Tally {
    fn count(&mut self, show: &Show, compiled: &Compiled) {
        if compiled.choreography.is_none() {
            self.refused += 1;
            return;
        }
        self.planned += 1;
        for cue in show.acts.iter().flatten() {
            self.cues += 1;
            match &cue.does {
                Does::Form { .. } => self.formed += 1,
                Does::Sweep(Sweep { along: Some(_), .. }) => self.carried += 1,
                Does::Sweep(_) => self.swept += 1,
                Does::Go(_) | Does::Home => {}
            }
        }
    }
}

#[test]
fn group_movements_match_independent_implementation() {
    let config = ProptestConfig {
        max_shrink_iters: 2_000,
        failure_persistence: None,
        ..ProptestConfig::with_cases(super::whole::scenarios() / 5)
    };
    let tally = RefCell::new(Tally::default());
    let looked_at = TestRunner::new(config).run(&shows(), |show| {
        let (text, compiled) = show.compiled();
        tally.borrow_mut().count(&show, &compiled);
        compare(&show, &compiled)
            .map_err(|error| TestCaseError::fail(format!("{text}\n{:#?}\n{error}", compiled.findings)))
    });
    looked_at.unwrap_or_else(|error| panic!("{error}"));
    let tally = tally.into_inner();
    // Only the reasons are checked for rejected shows, so these must be few.
    assert!(2 * tally.planned > tally.refused, "{tally:?}");
    drop(writeln!(std::io::stderr(), "{tally:?}"));
}
