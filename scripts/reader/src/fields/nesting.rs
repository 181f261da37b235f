//! What is being read because something else uses it: moves within moves, cues of sequences.

use std::collections::HashMap;
use std::sync::Arc;

use downbeat_motion::exact::Beginning;
use downbeat_yaml::budget::{Budget, PLAYS_IN_ALL_MAX, PLAYS_MAX, SEQUENCE_CUES_MAX};
use downbeat_yaml::finding::Place;

/// A name with its place.
#[derive(Clone, Debug, PartialEq)]
pub struct Name {
    /// The name.
    pub text: String,
    /// The place of the name.
    pub place: Place,
}

/// A parameter that has neither a default nor a value.
#[derive(Clone, Debug)]
pub struct Unset {
    /// Where it is used.
    pub place: Place,
    /// The move that has the parameter.
    pub of_move: String,
    /// The name of the parameter.
    pub parameter: String,
}

/// Which moves and sequences are being read, one within another.
#[derive(Debug)]
pub struct Nesting {
    /// The innermost last, each as messages name it: `the move `wave``.
    pub inside: Vec<String>,
    /// The copy of a file whose names are seen first.
    pub copy: usize,
    /// Moves that the movement being read plays.
    pub plays: Budget,
    /// The same for all movements.
    pub all_plays: Budget,
    /// Cues that sequences make.
    pub cues: Budget,
    /// Cues that sequences make which nothing uses.
    unused_cues: usize,
    /// Sequences that are being read.
    pub sequences: usize,
    /// Robots for cues of a sequence that name none.
    pub robots: Option<Arc<[Name]>>,
    /// Where the cue that was read last begins, as far as that is fixed.
    pub began: Beginning,
    /// The message about uses that lead back to themselves, with the number of the finding.
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

    /// Room for a sequence that nothing uses: its cues are none of the scenario. Returns the room that is left for those; none if enough
    /// unused ones have been looked at.
    pub fn unused_sequence(&mut self) -> Option<Budget> {
        if self.unused_cues > SEQUENCE_CUES_MAX {
            return None;
        }
        Some(std::mem::replace(&mut self.cues, Budget::new(SEQUENCE_CUES_MAX)))
    }

    /// Its cues have been read.
    pub fn end_unused(&mut self, room: Budget) {
        let unused = std::mem::replace(&mut self.cues, room);
        self.unused_cues += unused.most() - unused.left();
    }

    /// For the movement that is read next.
    pub fn renew_plays(&mut self) {
        self.plays = Budget::new(PLAYS_MAX);
    }

    /// Whether the movement plays more moves than are read.
    pub const fn has_too_many_plays(&self) -> bool {
        self.plays.is_overdrawn() || self.all_plays.is_overdrawn()
    }
}
