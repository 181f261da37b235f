//! What a group of robots does in space: into a formation, or turning, growing, shifting, or along a path as one.
//!
//! From where its robots are, `ways` makes the way of each of them, or says why there is none. `dancer` is a robot with the devices that
//! are its coordinates, `formed`, `swept` and `along` are the ways; `together` is what a group is to do, and `ground` where. The reader of scenarios asks where a group will be; the compiler makes
//! movements of the ways, and tells the faults.

mod along;
mod dancer;
mod formed;
mod ground;
mod swept;
mod together;

use std::sync::Arc;

pub(crate) use along::POINTS_MAX;
pub(crate) use dancer::{Axis, Dancer, axes, coarseness};
pub(crate) use ground::{Ground, WrittenFormation, WrittenPath};
pub(crate) use together::{Action, Course, Form, Spare, Sweep, Target, Thin, Together};

use crate::formation::{PLACES_MAX, Point};
use crate::motion::{Function, Swept};
use crate::transit::Blocked;

/// Most robots of a group: each may have a place of one formation.
pub(crate) const GROUP_MAX: usize = PLACES_MAX;
/// Places that differ less in height, in metres, have one height.
const LEVEL: f64 = 1e-9;

/// What a cue asks of its robots.
#[derive(Clone, Copy)]
pub(crate) struct Asked<'a> {
    pub(crate) together: &'a Together,
    /// How far steps may be off, in units of the devices, if the cue says so.
    pub(crate) tolerance: Option<f64>,
}

impl Asked<'_> {
    /// How long each robot has, in seconds.
    fn seconds(&self) -> f64 {
        self.together.over.as_millis_f64() / 1_000.0
    }
}

/// How one robot moves.
#[derive(Clone, Debug)]
pub(crate) struct Moved {
    /// In seconds since the cue's start.
    pub(crate) begin: f64,
    pub(crate) length: f64,
    /// x, y and z in metres.
    pub(crate) axes: [Swept; 3],
    /// The part of the error that its devices or the cue allow which its steps may use: less than 1 where others are close.
    pub(crate) error_share: f64,
}

impl Moved {
    /// Where it leads, in metres.
    pub(crate) fn end(&self) -> Point {
        self.axes.each_ref().map(|swept| Function::Swept(Box::new(swept.clone())).at(1.0))
    }
}

/// Why a group cannot do what is asked. Robots are given by their number among the dancers.
#[derive(Clone, Debug)]
pub(crate) enum Fault {
    /// Of a formation or a path, which is told where it stands.
    ToldElsewhere,
    /// More robots than [`GROUP_MAX`].
    TooMany,
    UnknownFormation,
    /// More or fewer robots than places, and no choice.
    Count {
        places: usize,
    },
    /// One that cannot change its height.
    Flat {
        dancer: usize,
        why: String,
    },
    /// Those without a default value of each coordinate.
    Homeless(Vec<usize>),
    /// Two places that are nearer than any two of the bodies may be, in metres.
    Crowded {
        places: [usize; 2],
        distance: f64,
        required: f64,
    },
    /// The shortest time that is enough, in seconds.
    TooShort {
        dancer: usize,
        seconds: f64,
    },
    Blocked(Blocked),
    /// All stand in the middle.
    Unmoved,
    UnknownPath,
    /// Laps of a path that does not end where it begins.
    OpenLaps(u32),
    /// A path that is upright somewhere, with which the group would turn.
    NoHeading,
    /// Points of a way, of which there are too many.
    TooManyPoints(usize),
    SamePlace {
        behind: usize,
        ahead: usize,
    },
    TurnsBack {
        dancer: usize,
    },
}

/// The way of each robot.
///
/// # Errors
/// What cannot be done.
pub(crate) fn ways(
    asked: Asked<'_>,
    dancers: &[Dancer<'_>],
    ground: Ground<'_>,
) -> Result<Vec<Moved>, Fault> {
    if dancers.len() > GROUP_MAX {
        return Err(Fault::TooMany);
    }
    match &asked.together.action {
        Action::Form(form) => formed::formed(asked, form, dancers, ground),
        Action::Sweep(sweep) => swept::swept(asked, sweep, dancers, ground),
    }
}

/// The places into which this many robots move, if it is a formation.
///
/// # Errors
/// What is wrong with their number, or the name.
pub(crate) fn places(together: &Together, robots: usize, ground: Ground<'_>) -> Result<(), Fault> {
    match &together.action {
        Action::Form(form) => formed::places(form, robots, ground).map(drop),
        Action::Sweep(_) => Ok(()),
    }
}

/// The ways of a group, as they were found when its cue was read: worth keeping, for a group of many takes its time.
#[derive(Clone, Debug)]
pub(crate) struct Rehearsed {
    from: Vec<(usize, f64, Point)>,
    ways: Arc<Result<Vec<Moved>, Fault>>,
}

impl Rehearsed {
    pub(crate) fn new(dancers: &[Dancer<'_>], ways: Result<Vec<Moved>, Fault>) -> Self {
        Self { from: dancers.iter().map(Dancer::begin).collect(), ways: Arc::new(ways) }
    }

    /// The same ways, if these robots begin at the same places and times.
    pub(crate) fn of(&self, dancers: &[Dancer<'_>]) -> Option<Result<Vec<Moved>, Fault>> {
        let same = self.from.iter().copied().eq(dancers.iter().map(Dancer::begin));
        same.then(|| (*self.ways).clone())
    }
}
