//! What a device was commanded to do: a movement from one value to another, in parts.

use urrcp::Span;

/// A movement of size one, as consecutive parts: a step, a ramp, or a staircase of steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Commanded {
    pub(super) parts: Vec<Part>,
    /// Whether only its start is observed.
    begins: bool,
}

/// A share of the movement, covered at constant speed; times are in milliseconds since the start of the movement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Part {
    pub(super) begins: f64,
    pub(super) lasts: f64,
    pub(super) share: f64,
}

impl Commanded {
    /// A movement at constant speed within this time; zero is a step.
    #[must_use]
    pub fn ramp(lasts: Span) -> Self {
        let parts = vec![Part { begins: 0.0, lasts: lasts.as_millis_f64().max(0.0), share: 1.0 }];
        Self { parts, begins: false }
    }

    /// The same movement with only its start observed: the readings need not reach its end.
    #[must_use]
    pub fn begins(self) -> Self {
        Self { begins: true, ..self }
    }

    /// A staircase of values that are set and held. Each has its time since the start of the movement and its share of the whole
    /// movement.
    #[must_use]
    pub fn stairs(steps: impl IntoIterator<Item = (Span, f64)>) -> Self {
        let part = |(at, share): (Span, f64)| Part { begins: at.as_millis_f64(), lasts: 0.0, share };
        Self { parts: steps.into_iter().map(part).collect(), begins: false }
    }

    /// Duration of the movement.
    #[must_use]
    pub fn lasts(&self) -> Span {
        Span::from_millis_f64(self.lasts_ms())
    }

    /// Minimum time that the readings have to cover, in milliseconds.
    pub(super) fn shown_ms(&self) -> f64 {
        if self.begins { 0.0 } else { self.lasts_ms() }
    }

    pub(super) fn lasts_ms(&self) -> f64 {
        self.parts.iter().map(|part| part.begins + part.lasts).fold(0.0, f64::max)
    }
}
