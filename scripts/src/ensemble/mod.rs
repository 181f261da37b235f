//! Movements of a group of robots in space: into a formation, or turning, growing, shifting or following a path as one.
//!
//! `ways` computes the movement of each robot from its current place, or returns the fault that prevents it. `dancer` contains a robot
//! with the devices of its coordinates; `formed`, `swept` and `along` compute the movements; `together` contains the task of a group, and
//! `ground` its context. The reader of scenarios asks for the future places of a group; the compiler turns the results into movements and
//! reports the faults.

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

/// Maximum number of robots in a group: each may have a place of one formation.
pub(crate) const GROUP_MAX: usize = PLACES_MAX;
/// Places whose heights differ by less than this, in metres, are at the same height.
const LEVEL: f64 = 1e-9;

/// The task of a cue for its robots.
#[derive(Clone, Copy)]
pub(crate) struct Asked<'a> {
    pub(crate) together: &'a Together,
    /// Permitted error of steps, in units of the devices, if the cue sets one.
    pub(crate) tolerance: Option<f64>,
}

impl Asked<'_> {
    /// Returns the time for each robot, in seconds.
    fn seconds(&self) -> f64 {
        self.together.over.as_millis_f64() / 1_000.0
    }
}

/// The movement of one robot.
#[derive(Clone, Debug)]
pub(crate) struct Moved {
    /// In seconds since the cue's start.
    pub(crate) begin: f64,
    pub(crate) length: f64,
    /// x, y and z in metres.
    pub(crate) axes: [Swept; 3],
    /// Share of the permitted error (of its devices or the cue) that its steps may use: less than 1 if other robots are close.
    pub(crate) error_share: f64,
}

impl Moved {
    /// Returns the end of the movement, in metres.
    pub(crate) fn end(&self) -> Point {
        self.axes.each_ref().map(|swept| Function::Swept(Box::new(swept.clone())).at(1.0))
    }
}

/// A reason why a group cannot do its task. Robots are identified by their index among the dancers.
#[derive(Clone, Debug)]
pub(crate) enum Fault {
    /// A fault of a formation or a path, which is reported at its own place.
    ToldElsewhere,
    /// More robots than [`GROUP_MAX`].
    TooMany,
    UnknownFormation,
    /// The numbers of robots and places differ, and the cue does not resolve this.
    Count {
        places: usize,
    },
    /// A robot that cannot change its height.
    Flat {
        dancer: usize,
        why: String,
    },
    /// Robots that lack a default value for a coordinate.
    Homeless(Vec<usize>),
    /// The two places are closer than two of the bodies may be, in metres.
    Crowded {
        places: [usize; 2],
        distance: f64,
        required: f64,
    },
    /// `seconds` is the shortest sufficient time.
    TooShort {
        dancer: usize,
        seconds: f64,
    },
    Blocked(Blocked),
    /// All robots are in the middle.
    Unmoved,
    UnknownPath,
    /// Laps along a path that does not end where it begins.
    OpenLaps(u32),
    /// The group would turn with a path that is vertical somewhere.
    NoHeading,
    /// Number of points of a path; it exceeds the limit.
    TooManyPoints(usize),
    SamePlace {
        behind: usize,
        ahead: usize,
    },
    TurnsBack {
        dancer: usize,
    },
}

/// Returns the movement of each robot.
///
/// # Errors
/// The fault that prevents the movements.
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

/// Checks the places into which this many robots move, if the target is a formation.
///
/// # Errors
/// A fault in their number or in the name.
pub(crate) fn places(together: &Together, robots: usize, ground: Ground<'_>) -> Result<(), Fault> {
    match &together.action {
        Action::Form(form) => formed::places(form, robots, ground).map(drop),
        Action::Sweep(_) => Ok(()),
    }
}

/// The movements of a group, computed when its cue was read. They are kept because a large group takes long to compute.
#[derive(Clone, Debug)]
pub(crate) struct Rehearsed {
    from: Vec<(usize, f64, Point)>,
    ways: Arc<Result<Vec<Moved>, Fault>>,
}

impl Rehearsed {
    pub(crate) fn new(dancers: &[Dancer<'_>], ways: Result<Vec<Moved>, Fault>) -> Self {
        Self { from: dancers.iter().map(Dancer::begin).collect(), ways: Arc::new(ways) }
    }

    /// Returns the same movements if these robots begin at the same places and times.
    pub(crate) fn of(&self, dancers: &[Dancer<'_>]) -> Option<Result<Vec<Moved>, Fault>> {
        let same = self.from.iter().copied().eq(dancers.iter().map(Dancer::begin));
        same.then(|| (*self.ways).clone())
    }
}
