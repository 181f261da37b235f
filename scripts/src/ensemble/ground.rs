//! The context of groups beyond their cues: the fleet, and the formations and paths of the scenario.

use std::collections::HashMap;
use std::sync::Arc;

use crate::finding::Place;
use crate::fleet::Fleet;
use crate::formation::Formation;
use crate::motion::Path;

/// The context of groups beyond their cues.
#[derive(Clone, Copy)]
pub(crate) struct Ground<'a> {
    pub(crate) fleet: &'a Fleet,
    pub(crate) formations: &'a HashMap<String, WrittenFormation>,
    pub(crate) paths: &'a HashMap<String, WrittenPath>,
}

/// A formation as written.
#[derive(Clone, Debug)]
pub(crate) struct WrittenFormation {
    /// `None` if it has a fault, which has been reported.
    pub(crate) formation: Option<Formation>,
    /// Place of its name.
    pub(crate) place: Place,
    /// The key that defines its size, with its value; the distances between the places are proportional to it.
    pub(crate) size: (&'static str, f64),
}

/// A path as written.
#[derive(Clone, Debug)]
pub(crate) struct WrittenPath {
    /// `None` if it has a fault, which has been reported.
    pub(crate) path: Option<Arc<Path>>,
}
