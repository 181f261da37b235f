//! Keeps track of the moves and sequences that are being read because something else uses them, such as a move within a move.

use std::collections::HashMap;
use std::sync::Arc;

use downbeat_motion::exact::Beginning;
use downbeat_yaml::budget::{Budget, PLAYS_IN_ALL_MAX, PLAYS_MAX, SEQUENCE_CUES_MAX};
use downbeat_yaml::finding::Place;

/// A name in a file, with its place.
#[derive(Clone, Debug, PartialEq)]
pub struct Name {
    /// The name itself.
    pub text: String,
    /// The place of the name.
    pub place: Place,
}

/// A use of a parameter that has neither a default nor a value.
#[derive(Clone, Debug)]
pub struct Unset {
    /// The place that uses the parameter.
    pub place: Place,
    /// The move that has the parameter.
    pub of_move: String,
    /// The name of the parameter.
    pub parameter: String,
}

/// The moves and sequences that are being read, each within the previous one, and the limits on them.
#[derive(Debug)]
pub struct Nesting {
    /// The items from the outermost to the innermost, each as named in messages: `the move `wave``.
    pub inside: Vec<String>,
    /// The index of the copy of an included file whose names take precedence; 0 for the scenario itself.
    pub copy: usize,
    /// Budget for the moves that the movement being read plays.
    pub plays: Budget,
    /// Budget for the moves that all movements of the scenario play.
    pub all_plays: Budget,
    /// Budget for the cues that sequences generate.
    pub cues: Budget,
    /// The number of cues in unused sequences that have been read so far.
    unused_cues: usize,
    /// The number of sequences that are being read, nested in one another.
    pub sequences: usize,
    /// The robots that cues of a sequence use if they name none.
    pub robots: Option<Arc<[Name]>>,
    /// The start of the cue that was read last, if it is fixed.
    pub began: Beginning,
    /// The messages about items that use themselves, each with the index of its finding.
    pub circles: HashMap<String, usize>,
}

impl Default for Nesting {
    fn default() -> Self {
        Self {
            inside: Vec::new(),
            copy: 0,
            plays: Budget::new(PLAYS_MAX),
            all_plays: Budget::new(PLAYS_IN_ALL_MAX),
            cues: Budget::new(SEQUENCE_CUES_MAX),
            unused_cues: 0,
            sequences: 0,
            robots: None,
            began: Beginning::default(),
            circles: HashMap::new(),
        }
    }
}

impl Nesting {
    /// Whether cues of a sequence are being read.
    pub const fn is_in_sequence(&self) -> bool {
        self.sequences > 0
    }

    /// Starts to read an unused sequence, whose cues are not part of the scenario, and gives it its own budget. Returns the remaining
    /// budget for the scenario's cues, for [`Self::end_unused`]. `None` if enough unused cues have been checked.
    pub fn unused_sequence(&mut self) -> Option<Budget> {
        if self.unused_cues > SEQUENCE_CUES_MAX {
            return None;
        }
        Some(std::mem::replace(&mut self.cues, Budget::new(SEQUENCE_CUES_MAX)))
    }

    /// Ends an unused sequence: restores `room`, the budget for the scenario's cues, and counts the cues of the sequence.
    pub fn end_unused(&mut self, room: Budget) {
        let unused = std::mem::replace(&mut self.cues, room);
        self.unused_cues += unused.most() - unused.left();
    }

    /// Resets [`Self::plays`] for the next movement.
    pub fn renew_plays(&mut self) {
        self.plays = Budget::new(PLAYS_MAX);
    }

    /// Whether the movement plays more moves than the limits allow.
    pub const fn has_too_many_plays(&self) -> bool {
        self.plays.is_overdrawn() || self.all_plays.is_overdrawn()
    }
}
