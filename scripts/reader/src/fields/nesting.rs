//! Items that are being read because something else uses them: moves within moves, cues of sequences.

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

/// A parameter that has neither a default nor a value.
#[derive(Clone, Debug)]
pub struct Unset {
    /// The place that uses the parameter.
    pub place: Place,
    /// The move that has the parameter.
    pub of_move: String,
    /// The name of the parameter.
    pub parameter: String,
}

/// The moves and sequences that are being read, nested in one another.
#[derive(Debug)]
pub struct Nesting {
    /// The items from the outermost to the innermost, each as named in messages: `the move `wave``.
    pub inside: Vec<String>,
    /// The number of the included file's copy whose names take precedence.
    pub copy: usize,
    /// Budget for the moves that the current movement plays.
    pub plays: Budget,
    /// Budget for the moves that all movements play.
    pub all_plays: Budget,
    /// Budget for the cues that sequences generate.
    pub cues: Budget,
    /// The number of cues of unused sequences so far.
    unused_cues: usize,
    /// The number of sequences that are being read.
    pub sequences: usize,
    /// The robots that cues of a sequence use if they name none.
    pub robots: Option<Arc<[Name]>>,
    /// The start of the cue that was read last, as far as it is fixed.
    pub began: Beginning,
    /// Messages about circular uses, each with the index of its finding.
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

    /// Starts an unused sequence, whose cues are not part of the scenario, with its own budget. Returns the remaining budget of the
    /// scenario's cues, for [`Self::end_unused`]. `None` if enough unused cues have been checked.
    pub fn unused_sequence(&mut self) -> Option<Budget> {
        if self.unused_cues > SEQUENCE_CUES_MAX {
            return None;
        }
        Some(std::mem::replace(&mut self.cues, Budget::new(SEQUENCE_CUES_MAX)))
    }

    /// Ends an unused sequence: restores the budget, and counts the cues of the sequence.
    pub fn end_unused(&mut self, room: Budget) {
        let unused = std::mem::replace(&mut self.cues, room);
        self.unused_cues += unused.most() - unused.left();
    }

    /// Resets the budget for moves, for the next movement.
    pub fn renew_plays(&mut self) {
        self.plays = Budget::new(PLAYS_MAX);
    }

    /// Whether the movement plays more moves than the limits allow.
    pub const fn has_too_many_plays(&self) -> bool {
        self.plays.is_overdrawn() || self.all_plays.is_overdrawn()
    }
}
