//! The movement of a device in a cue, as steps: shared by all robots of a kind, with a separate start for each robot.

use std::sync::Arc;

use urrcp::{ControlType, Setpoint, Span, StopCondition};

use crate::finding::Place;
use crate::motion::{Easing, Shape, Value};
use crate::scenario::{Items, Motion, Track, Vectors};

/// The time that a cue occupies on one device of one robot.
#[derive(Clone, Debug)]
pub(super) struct Segment {
    /// Start of the cue for this robot, since the act's start.
    pub(super) begin: Span,
    pub(super) cue: Arc<str>,
    pub(super) stop_condition: Option<StopCondition>,
    pub(super) part: Arc<TrackSteps>,
}

/// The steps of a track on devices of one kind, shared by all robots of that kind.
#[derive(Debug)]
pub(super) struct TrackSteps {
    pub(super) control_type: ControlType,
    pub(super) steps: Steps,
    /// Duration of the movement; the last step may be earlier.
    pub(super) length: Span,
    pub(super) at_least: usize,
    pub(super) worst: f64,
    pub(super) worst_at: Span,
    /// Whether the movement can begin at any position, so that the device moves from there to the first step.
    pub(super) moves_from_anywhere: bool,
    /// The tolerance for which the steps were created, in the device's unit.
    pub(super) tolerance: f64,
    /// The largest show speed factor (speed of the show relative to the file) at which the movement stays within the limits of the
    /// device.
    pub(super) factor_max: f64,
    /// The quantity to reduce if there are too many steps.
    pub(super) excess: Excess,
    pub(super) items: Items,
    pub(super) place: Place,
}

impl TrackSteps {
    /// Returns a setpoint of the part's control type with these values.
    pub(super) fn setpoint(&self, values: &[f64]) -> Setpoint {
        let mut setpoint = Setpoint::new(self.control_type, values.first().copied().unwrap_or_default());
        setpoint.more = values.get(1..).unwrap_or_default().into();
        setpoint
    }
}

/// The main cause of a large number of steps in a movement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Excess {
    /// Keyframes that each become a step.
    Keyframes,
    /// Many repetitions of the movement.
    Turns,
    /// Curved transitions between keyframes.
    Eases,
    /// A curve that needs many steps to be followed closely.
    Curve,
}

impl Excess {
    pub(super) fn of(track: &Track) -> Self {
        match track.items {
            _ if track.turns > 1 => Self::Turns,
            Items::Keyframes if is_bent(&track.motion) => Self::Eases,
            Items::Keyframes => Self::Keyframes,
            _ => Self::Curve,
        }
    }
}

fn is_bent(motion: &Motion) -> bool {
    let Motion::Curve(curve) = motion else { return false };
    curve.knots.iter().any(|knot| matches!(knot.shape, Shape::Eased(Easing::Smooth | Easing::Cubic)))
}

/// Setpoints with their times since the cue's start.
#[derive(Debug)]
pub(super) enum Steps {
    One(Vec<Value>),
    Several(Vectors),
}

impl Steps {
    pub(super) fn len(&self) -> usize {
        match self {
            Self::One(values) => values.len(),
            Self::Several(vectors) => vectors.len(),
        }
    }

    /// Returns the memory that the steps take in a script, expressed as a number of steps with one value.
    pub(super) fn size(&self) -> usize {
        match self {
            Self::One(values) => values.len(),
            Self::Several(vectors) => vectors.len() + vectors.values().len() / 8,
        }
    }

    fn first_at(&self) -> Option<Span> {
        match self {
            Self::One(values) => values.first().map(|value| value.at),
            Self::Several(vectors) => vectors.first().map(|vector| vector.at),
        }
    }
}

impl Segment {
    pub(super) fn start(&self) -> Span {
        if self.part.moves_from_anywhere {
            self.begin
        } else {
            self.begin + self.part.steps.first_at().unwrap_or_default()
        }
    }

    pub(super) fn first_setpoint(&self) -> Option<Setpoint> {
        match &self.part.steps {
            Steps::One(values) => values.first().map(|first| Setpoint::new(self.part.control_type, first.to)),
            Steps::Several(vectors) => vectors.first().map(|first| self.part.setpoint(first.values)),
        }
    }

    pub(super) fn last_setpoint(&self) -> Option<Setpoint> {
        match &self.part.steps {
            Steps::One(values) => values.last().map(|last| Setpoint::new(self.part.control_type, last.to)),
            Steps::Several(vectors) => vectors.last().map(|last| self.part.setpoint(last.values)),
        }
    }

    pub(super) fn end(&self) -> Span {
        self.begin + self.part.length
    }
}
