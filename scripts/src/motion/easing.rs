//! Easings: the way from one keyframe to the next, as a function of s from 0 to 1.

/// How a value is reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Easing {
    /// s
    Linear,
    /// Minimum jerk, 10 s^3 - 15 s^4 + 6 s^5 (Flash and Hogan, J. Neurosci. 5, 1985).
    Smooth,
    /// 3 s^2 - 2 s^3
    Cubic,
    /// The old value until the keyframe's time.
    Step,
}

impl Easing {
    pub(crate) const WORDS: [(&'static str, Self); 4] =
        [("linear", Self::Linear), ("smooth", Self::Smooth), ("cubic", Self::Cubic), ("step", Self::Step)];

    pub(crate) fn at(self, s: f64) -> f64 {
        match self {
            Self::Linear => s,
            Self::Smooth => s * s * s * (10.0 + s * (6.0 * s - 15.0)),
            Self::Cubic => s * s * (3.0 - 2.0 * s),
            Self::Step => 0.0,
        }
    }

    /// Largest slope for s from 0 to 1: at s = 1/2.
    pub(crate) fn slope_max(self) -> f64 {
        match self {
            Self::Linear => 1.0,
            Self::Smooth => 1.875,
            Self::Cubic => 1.5,
            Self::Step => 0.0,
        }
    }

    /// Largest second derivative: of smooth 10/sqrt(3), at s = 1/2 +- sqrt(3)/6; of cubic 6, at the ends.
    pub(crate) fn curvature_max(self) -> f64 {
        match self {
            Self::Linear | Self::Step => 0.0,
            Self::Smooth => 10.0 / 1.732_050_807_568_877_2,
            Self::Cubic => 6.0,
        }
    }
}
