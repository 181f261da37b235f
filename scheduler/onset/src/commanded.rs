//! What a device was told to do: a movement from one value to another, in parts.

use urrcp::Span;

/// A movement of size one, as parts one after the other: a step, a ramp, or a stairway of steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Commanded {
    pub(super) parts: Vec<Part>,
    /// It is watched only while it begins.
    begins: bool,
}

/// A share of the movement, covered at constant speed; times are milliseconds since the begin of the movement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Part {
    pub(super) begins: f64,
    pub(super) lasts: f64,
    pub(super) share: f64,
}

impl Commanded {
    /// Covered at constant speed within this time; zero is a step.
    #[must_use]
    pub fn ramp(lasts: Span) -> Self {
        let parts = vec![Part { begins: 0.0, lasts: lasts.as_millis_f64().max(0.0), share: 1.0 }];
        Self { parts, begins: false }
    }

    /// The same movement, of which only the begin is watched: the readings need not reach to its end.
    #[must_use]
    pub fn begins(self) -> Self {
        Self { begins: true, ..self }
    }

    /// Values that are set and held, each at its time since the begin of the movement and with its share of the whole movement.
    #[must_use]
    pub fn stairs(steps: impl IntoIterator<Item = (Span, f64)>) -> Self {
        let part = |(at, share): (Span, f64)| Part { begins: at.as_millis_f64(), lasts: 0.0, share };
        Self { parts: steps.into_iter().map(part).collect(), begins: false }
    }

    /// How long the movement lasts.
    #[must_use]
    pub fn lasts(&self) -> Span {
        Span::from_millis_f64(self.lasts_ms())
    }

    /// For how long readings have to show it, at least, in milliseconds.
    pub(super) fn shown_ms(&self) -> f64 {
        if self.begins { 0.0 } else { self.lasts_ms() }
    }

    pub(super) fn lasts_ms(&self) -> f64 {
        self.parts.iter().map(|part| part.begins + part.lasts).fold(0.0, f64::max)
    }
}
