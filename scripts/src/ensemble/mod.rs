//! Movements of a group of robots in space: into a formation, or as one body that turns, grows, shifts or follows a path.
//!
//! `ways` computes the movement of each robot from its current place, or returns the fault that prevents it. `dancer` contains a robot
//! with the devices of its coordinates; `formed`, `swept` and `along` compute the movements. `together` contains the task of a group,
//! and `ground` the data that all groups use. The reader of scenarios asks for the places of a group after its movement. The compiler
//! turns the results into movements of devices and reports the faults.

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

/// Maximum number of robots in a group: a formation can have a place for each of them.
pub(crate) const GROUP_MAX: usize = PLACES_MAX;
/// Places have the same height if their heights differ by less than this, in metres.
const LEVEL: f64 = 1e-9;

/// What a cue asks of its group: the movement, and the permitted error.
#[derive(Clone, Copy)]
pub(crate) struct GroupTask<'a> {
    pub(crate) together: &'a Together,
    /// Permitted error of steps, in units of the devices; `None` if the cue does not set one.
    pub(crate) tolerance: Option<f64>,
}

impl GroupTask<'_> {
    /// Returns the duration of each robot's movement, in seconds.
    fn seconds(&self) -> f64 {
        self.together.over.as_millis_f64() / 1_000.0
    }
}

/// The movement of one robot of a group.
#[derive(Clone, Debug)]
pub(crate) struct DancerMovement {
    /// Start of the movement since the cue's start, in seconds.
    pub(crate) begin: f64,
    pub(crate) length: f64,
    /// Movements along x, y and z, in metres.
    pub(crate) axes: [Swept; 3],
    /// Share of the permitted error (of the robot's devices or the cue) that the robot's steps may use. Less than 1 if other robots are
    /// close.
    pub(crate) error_share: f64,
}

impl DancerMovement {
    /// Returns the robot's place at the end of the movement, in metres.
    pub(crate) fn end(&self) -> Point {
        self.axes.each_ref().map(|swept| Function::Swept(Box::new(swept.clone())).at(1.0))
    }
}

/// A reason why a group cannot make its movement. Robots are identified by their index in the list of dancers.
#[derive(Clone, Debug)]
pub(crate) enum Fault {
    /// A formation or a path has a fault that is already reported at its own place in the file.
    ToldElsewhere,
    /// The group has more robots than [`GROUP_MAX`].
    TooMany,
    UnknownFormation,
    /// The numbers of robots and places differ, and the cue does not set how to handle this.
    Count {
        places: usize,
    },
    /// The group's movement requires a change of height, but a robot cannot change its height.
    Flat {
        dancer: usize,
        why: String,
    },
    /// The robots with these indices have no default value for a coordinate.
    Homeless(Vec<usize>),
    /// Two places of the formation are closer to each other than any two bodies may be. Distances are in metres.
    Crowded {
        places: [usize; 2],
        distance: f64,
        required: f64,
    },
    /// A robot has too little time; `seconds` is the shortest sufficient time.
    TooShort {
        dancer: usize,
        seconds: f64,
    },
    Blocked(Blocked),
    /// All robots are in the middle of the group, so nothing moves them.
    Unmoved,
    UnknownPath,
    /// The cue sets several laps for a path that does not end where it begins; contains their number.
    OpenLaps(u32),
    /// The group should turn with the heading of a path that has no heading, because it is vertical somewhere.
    NoHeading,
    /// The path has too many points; contains their number.
    TooManyPoints(usize),
    SamePlace {
        behind: usize,
        ahead: usize,
    },
    TurnsBack {
        dancer: usize,
    },
}

/// Returns the movement of each robot in the group.
///
/// # Errors
/// Returns the fault that prevents the movements.
pub(crate) fn ways(
    asked: GroupTask<'_>,
    dancers: &[Dancer<'_>],
    ground: Ground<'_>,
) -> Result<Vec<DancerMovement>, Fault> {
    if dancers.len() > GROUP_MAX {
        return Err(Fault::TooMany);
    }
    match &asked.together.action {
        Action::Form(form) => formed::formed(asked, form, dancers, ground),
        Action::Sweep(sweep) => swept::swept(asked, sweep, dancers, ground),
    }
}

/// Checks the places into which `robots` robots move, if the target of the movement is a formation.
///
/// # Errors
/// Returns a fault in the number of places or in the name of the formation.
pub(crate) fn places(together: &Together, robots: usize, ground: Ground<'_>) -> Result<(), Fault> {
    match &together.action {
        Action::Form(form) => formed::places(form, robots, ground).map(drop),
        Action::Sweep(_) => Ok(()),
    }
}

/// The movements of a group, computed when its cue was read. They are kept because computing them takes long for a large group.
#[derive(Clone, Debug)]
pub(crate) struct Rehearsed {
    from: Vec<(usize, f64, Point)>,
    ways: Arc<Result<Vec<DancerMovement>, Fault>>,
}

impl Rehearsed {
    pub(crate) fn new(dancers: &[Dancer<'_>], ways: Result<Vec<DancerMovement>, Fault>) -> Self {
        Self { from: dancers.iter().map(Dancer::begin).collect(), ways: Arc::new(ways) }
    }

    /// Returns the computed movements if `dancers` begin at the places and times for which the movements were computed; `None` otherwise.
    pub(crate) fn of(&self, dancers: &[Dancer<'_>]) -> Option<Result<Vec<DancerMovement>, Fault>> {
        let same = self.from.iter().copied().eq(dancers.iter().map(Dancer::begin));
        same.then(|| (*self.ways).clone())
    }
}
