//! The joint task of a group of bodies in a cue: to move into a formation, or to turn, grow and shift as one.

use urrcp::Span;

use crate::finding::Place;
use crate::formation::Point;
use crate::transit::Least;

/// The joint task of a group of bodies.
#[derive(Clone, Debug)]
pub(crate) struct Together {
    pub(crate) action: Action,
    /// Time for each of them.
    pub(crate) over: Span,
    pub(crate) over_place: Place,
    /// Its place in the file.
    pub(crate) place: Place,
}

impl Together {
    /// Returns the name of the formation into which they move.
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

/// The target of the bodies.
#[derive(Clone, Debug)]
pub(crate) enum Target {
    /// Each body moves to the default values of its devices.
    Home,
    Formation(String),
}

/// Behaviour of robots without a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Spare {
    Stay,
    Home,
}

/// The places that stay empty if there are fewer robots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Thin {
    /// The places between those at even steps through the list.
    Evenly,
    /// The places whose omission gives the shortest movements.
    Nearest,
}

/// A movement of a group as one body whose size may change.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sweep {
    /// Turns about the vertical, from x to y.
    pub(crate) turns: f64,
    /// x and y of the centre of turning and growing; `None` for the middle of the group.
    pub(crate) about: Option<[f64; 2]>,
    pub(crate) grow: f64,
    pub(crate) shift: Point,
    /// The path along which it is carried.
    pub(crate) along: Option<Course>,
}

/// The movement of a group along a path.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Course {
    pub(crate) path: String,
    /// Number of laps, if the scenario sets it.
    pub(crate) laps: Option<u32>,
    /// Whether it turns with the path, about its middle.
    pub(crate) turning: bool,
    /// Whether each robot follows the previous one in the cue, through its place.
    pub(crate) follow: bool,
    /// Its place in the file.
    pub(crate) place: Place,
}
