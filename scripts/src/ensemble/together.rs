//! What a group of bodies is to do together, as a cue says it: to move into a formation, or to turn, grow and shift as one.

use urrcp::Span;

use crate::finding::Place;
use crate::formation::Point;
use crate::transit::Least;

/// What a group of bodies does together.
#[derive(Clone, Debug)]
pub(crate) struct Together {
    pub(crate) action: Action,
    /// How long each of them has.
    pub(crate) over: Span,
    pub(crate) over_place: Place,
    /// Where it stands in the file.
    pub(crate) place: Place,
}

impl Together {
    /// The name of the formation into which they move.
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

/// Into a formation.
#[derive(Clone, Debug)]
pub(crate) struct Form {
    pub(crate) to: Target,
    pub(crate) least: Least,
    pub(crate) spare: Option<Spare>,
    pub(crate) thin: Option<Thin>,
}

/// Where the bodies go.
#[derive(Clone, Debug)]
pub(crate) enum Target {
    /// Each to the default values of its devices.
    Home,
    Formation(String),
}

/// What robots do for which there is no place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Spare {
    Stay,
    Home,
}

/// Which places stay empty if there are fewer robots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Thin {
    /// Those between places at even steps through the list.
    Evenly,
    /// Those that lead to the shortest ways.
    Nearest,
}

/// A group moves as one body would, but for its size.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sweep {
    /// About the vertical, from x to y.
    pub(crate) turns: f64,
    /// x and y about which it turns and grows; the middle of the group if not given.
    pub(crate) about: Option<[f64; 2]>,
    pub(crate) grow: f64,
    pub(crate) shift: Point,
    /// A path along which it is carried.
    pub(crate) along: Option<Course>,
}

/// How a group goes along a path.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Course {
    pub(crate) path: String,
    /// How often, if the scenario says so.
    pub(crate) laps: Option<u32>,
    /// Whether it turns with the path, about its middle.
    pub(crate) turning: bool,
    /// Whether each robot follows the one before it in the cue, through its place.
    pub(crate) follow: bool,
    /// Where it stands in the file.
    pub(crate) place: Place,
}
