//! The joint movement of a group of bodies in a cue: into a formation, or as one body that turns, grows and shifts.

use urrcp::Span;

use crate::finding::Place;
use crate::formation::Point;
use crate::transit::Least;

/// The joint movement of a group of bodies.
#[derive(Clone, Debug)]
pub(crate) struct Together {
    pub(crate) action: Action,
    /// Duration of each robot's movement.
    pub(crate) over: Span,
    pub(crate) over_place: Place,
    /// Place of the movement in the file.
    pub(crate) place: Place,
}

impl Together {
    /// Returns the name of the formation into which the group moves; `None` for other movements.
    pub(crate) fn formation(&self) -> Option<&str> {
        match &self.action {
            Action::Form(Form { to: Target::Formation(name), .. }) => Some(name),
            Action::Form(_) | Action::Sweep(_) => None,
        }
    }
}

#[derive(Clone, Debug)]
pub(crate) enum Action {
    Form(Form),
    Sweep(Sweep),
}

/// A movement into a formation.
#[derive(Clone, Debug)]
pub(crate) struct Form {
    pub(crate) to: Target,
    pub(crate) least: Least,
    pub(crate) spare: Option<Spare>,
    pub(crate) thin: Option<Thin>,
}

/// The target of a movement into a formation.
#[derive(Clone, Debug)]
pub(crate) enum Target {
    /// Each body moves to the default values of its devices.
    Home,
    Formation(String),
}

/// What robots do if the formation has no place for them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Spare {
    Stay,
    Home,
}

/// Which places stay empty if the formation has more places than robots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Thin {
    /// The robots take places at even steps through the list; the places between stay empty.
    Evenly,
    /// The places whose omission makes the movements shortest stay empty.
    Nearest,
}

/// A movement of a group as one body that may turn, grow, shift or follow a path.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sweep {
    /// Number of turns about the vertical, from x to y.
    pub(crate) turns: f64,
    /// x and y of the centre of turning and growing, in metres; `None` for the middle of the group.
    pub(crate) about: Option<[f64; 2]>,
    pub(crate) grow: f64,
    pub(crate) shift: Point,
    /// The path along which the group is carried, if any.
    pub(crate) along: Option<Course>,
}

/// The movement of a group along a path.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Course {
    pub(crate) path: String,
    /// Number of laps; `None` if the scenario does not set it.
    pub(crate) laps: Option<u32>,
    /// Whether the group turns with the heading of the path, about the group's middle.
    pub(crate) turning: bool,
    /// Whether each robot follows the previous robot in the cue's list, through the place of the previous robot.
    pub(crate) follow: bool,
    /// Place of the path's use in the file.
    pub(crate) place: Place,
}
