//! The commanded movement of a device from one value to another, as consecutive parts.

use urrcp::Span;

/// A commanded movement, scaled to size one: consecutive parts that form a step, a ramp, or a staircase of steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Commanded {
    pub(super) parts: Vec<MovementPart>,
    /// Whether the readings have to cover only the start of the movement.
    begins: bool,
}

/// A part of the movement, at constant speed. Times are in milliseconds since the start of the movement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MovementPart {
    pub(super) begins: f64,
    pub(super) lasts: f64,
    pub(super) share: f64,
}

impl Commanded {
    /// Creates a movement at constant speed with the duration `lasts`. A duration of zero creates a step.
    #[must_use]
    pub fn ramp(lasts: Span) -> Self {
        let parts = vec![MovementPart { begins: 0.0, lasts: lasts.as_millis_f64().max(0.0), share: 1.0 }];
        Self { parts, begins: false }
    }

    /// Returns this movement, marked as observed only at its start: the readings need not reach its end.
    #[must_use]
    pub fn begins(self) -> Self {
        Self { begins: true, ..self }
    }

    /// Creates a staircase: the device jumps to each value and holds it until the next step. Each step is given as its time since the
    /// start of the movement and its share of the whole movement.
    #[must_use]
    pub fn stairs(steps: impl IntoIterator<Item = (Span, f64)>) -> Self {
        let part = |(at, share): (Span, f64)| MovementPart { begins: at.as_millis_f64(), lasts: 0.0, share };
        Self { parts: steps.into_iter().map(part).collect(), begins: false }
    }

    /// Returns the duration of the movement.
    #[must_use]
    pub fn lasts(&self) -> Span {
        Span::from_millis_f64(self.lasts_ms())
    }

    /// Returns the time, in milliseconds from the start of the movement, up to which readings are required.
    pub(super) fn shown_ms(&self) -> f64 {
        if self.begins { 0.0 } else { self.lasts_ms() }
    }

    pub(super) fn lasts_ms(&self) -> f64 {
        self.parts.iter().map(|part| part.begins + part.lasts).fold(0.0, f64::max)
    }
}
