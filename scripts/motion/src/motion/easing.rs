//! Easings: the course from one keyframe to the next, as a function of s from 0 to 1.

/// The course from the previous value to the next one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Easing {
    /// The function s: a straight line.
    Linear,
    /// The minimum jerk law, 10 s^3 - 15 s^4 + 6 s^5 (Flash and Hogan, J. Neurosci. 5, 1985).
    Smooth,
    /// The function 3 s^2 - 2 s^3.
    Cubic,
    /// The old value until the keyframe's time.
    Step,
}

impl Easing {
    /// The easings with their names in a scenario.
    pub const WORDS: [(&'static str, Self); 4] =
        [("linear", Self::Linear), ("smooth", Self::Smooth), ("cubic", Self::Cubic), ("step", Self::Step)];

    /// The easing that has this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::WORDS.iter().find(|(word, _)| *word == name).map(|(_, easing)| *easing)
    }

    /// The value of the easing at s.
    pub fn at(self, s: f64) -> f64 {
        match self {
            Self::Linear => s,
            Self::Smooth => s * s * s * (10.0 + s * (6.0 * s - 15.0)),
            Self::Cubic => s * s * (3.0 - 2.0 * s),
            Self::Step => 0.0,
        }
    }

    /// Returns the s at which [`Self::Smooth`] has a given value from 0 to 1, found by bisection.
    pub fn smooth_time(value: f64) -> f64 {
        let (mut early, mut late) = (0.0, 1.0);
        for _ in 0..50 {
            let middle = f64::midpoint(early, late);
            if Self::Smooth.at(middle) < value { early = middle } else { late = middle }
        }
        f64::midpoint(early, late)
    }

    /// Largest slope for s from 0 to 1, at s = 1/2.
    pub fn slope_max(self) -> f64 {
        match self {
            Self::Linear => 1.0,
            Self::Smooth => 1.875,
            Self::Cubic => 1.5,
            Self::Step => 0.0,
        }
    }

    /// Largest second derivative: for smooth, 10/sqrt(3) at s = 1/2 +- sqrt(3)/6; for cubic, 6 at the ends.
    pub fn curvature_max(self) -> f64 {
        match self {
            Self::Linear | Self::Step => 0.0,
            Self::Smooth => 10.0 / 1.732_050_807_568_877_2,
            Self::Cubic => 6.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values at 0, 1/4, 1/2, 3/4 and 1, the largest slope and the largest second derivative, derived by hand from the published formula.
    const fn known(easing: Easing) -> ([f64; 5], f64, f64) {
        match easing {
            // `linear` of CSS (css-easing-1).
            Easing::Linear => ([0.0, 0.25, 0.5, 0.75, 1.0], 1.0, 0.0),
            // Flash and Hogan 1985, equation 1: speed 30 s^2 (1 - s)^2, acceleration 60 s (1 - s) (1 - 2 s).
            Easing::Smooth => {
                ([0.0, 53.0 / 512.0, 0.5, 459.0 / 512.0, 1.0], 15.0 / 8.0, 5.773_502_691_896_258)
            }
            // `smoothstep` of GLSL (8.3): slope 6 s (1 - s), second derivative 6 - 12 s.
            Easing::Cubic => ([0.0, 5.0 / 32.0, 0.5, 27.0 / 32.0, 1.0], 1.5, 6.0),
            // `step-end` of CSS; the keyframe itself sets the value at 1.
            Easing::Step => ([0.0; 5], 0.0, 0.0),
        }
    }

    #[test]
    fn every_easing_except_step_is_symmetric_as_reversal_assumes() {
        for (word, easing) in Easing::WORDS.into_iter().filter(|(_, easing)| *easing != Easing::Step) {
            for s in [0.0, 0.1, 0.25, 0.4, 0.5] {
                let sum = easing.at(s) + easing.at(1.0 - s);
                assert!((sum - 1.0).abs() < 1e-12, "{word}: `Shape::reversed` has to know its reverse");
            }
        }
    }

    const POINTS: u32 = 4_096;

    /// The values at [`POINTS`] + 1 points from 0 to 1, and the distance between them.
    fn sampled(easing: Easing) -> (Vec<f64>, f64) {
        let step = 1.0 / f64::from(POINTS);
        ((0..=POINTS).map(|i| easing.at(f64::from(i) * step)).collect(), step)
    }

    #[test]
    fn every_easing_word_names_an_easing() {
        assert!(downbeat_yaml::node::EASES.iter().all(|word| Easing::named(word).is_some()));
    }

    #[test]
    fn every_easing_matches_its_formula() {
        for (word, easing) in Easing::WORDS {
            for (s, value) in [0.0, 0.25, 0.5, 0.75, 1.0].into_iter().zip(known(easing).0) {
                assert!((easing.at(s) - value).abs() < 1e-12, "{word} at {s}: {}, not {value}", easing.at(s));
            }
        }
    }

    #[test]
    fn largest_slope_of_every_easing_matches_formula_and_samples() {
        for (word, easing) in Easing::WORDS {
            let (_, slope, _) = known(easing);
            assert!((easing.slope_max() - slope).abs() < 1e-12, "{word}: {}", easing.slope_max());
            let (values, step) = sampled(easing);
            let measured = values.windows(2).map(|two| ((two[1] - two[0]) / step).abs()).fold(0.0, f64::max);
            assert!((measured - slope).abs() < 1e-3, "{word}: {measured} between its values");
        }
    }

    #[test]
    fn largest_curvature_of_every_easing_matches_formula_and_samples() {
        for (word, easing) in Easing::WORDS {
            let (_, _, curvature) = known(easing);
            assert!((easing.curvature_max() - curvature).abs() < 1e-12, "{word}: {}", easing.curvature_max());
            let (values, step) = sampled(easing);
            let second = |three: &[f64]| ((three[0] - 2.0 * three[1] + three[2]) / (step * step)).abs();
            let measured = values.windows(3).map(second).fold(0.0, f64::max);
            assert!((measured - curvature).abs() < 5e-3, "{word}: {measured} between its values");
        }
    }
}
