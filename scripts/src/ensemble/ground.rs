//! The data that determine the movements of groups, apart from their cues: the fleet, and the formations and paths of the scenario.

use std::collections::HashMap;
use std::sync::Arc;

use crate::finding::Place;
use crate::fleet::Fleet;
use crate::formation::Formation;
use crate::motion::Path;

/// The fleet, and the formations and paths of the scenario.
#[derive(Clone, Copy)]
pub(crate) struct Ground<'a> {
    pub(crate) fleet: &'a Fleet,
    pub(crate) formations: &'a HashMap<String, WrittenFormation>,
    pub(crate) paths: &'a HashMap<String, WrittenPath>,
}

/// A formation as written in the scenario.
#[derive(Clone, Debug)]
pub(crate) struct WrittenFormation {
    /// The formation; `None` if it has a fault, which has been reported.
    pub(crate) formation: Option<Formation>,
    /// Place of the formation's name in the file.
    pub(crate) place: Place,
    /// Key that defines the formation's size, and its value. Distances between the places are proportional to the value.
    pub(crate) size: (&'static str, f64),
}

/// A path as written in the scenario.
#[derive(Clone, Debug)]
pub(crate) struct WrittenPath {
    /// The path; `None` if it has a fault, which has been reported.
    pub(crate) path: Option<Arc<Path>>,
}
