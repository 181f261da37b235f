//! From keyframes to steps: easings, approximated on the device's grid within its error.

use urrcp::{ControlType, Device, Interpolation, Limits, Millis, Setpoint, Span, Step};

use crate::scenario::Keyframe;

/// The way from one keyframe to the next, as a function of s from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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

    fn at(self, s: f64) -> f64 {
        match self {
            Self::Linear => s,
            Self::Smooth => s * s * s * (10.0 + s * (6.0 * s - 15.0)),
            Self::Cubic => s * s * (3.0 - 2.0 * s),
            Self::Step => 0.0,
        }
    }

    /// Largest slope for s from 0 to 1: at s = 1/2.
    fn slope_max(self) -> f64 {
        match self {
            Self::Linear => 1.0,
            Self::Smooth => 1.875,
            Self::Cubic => 1.5,
            Self::Step => 0.0,
        }
    }

    /// Largest second derivative: of smooth 10/sqrt(3), at s = 1/2 +- sqrt(3)/6; of cubic 6, at the ends.
    fn curvature_max(self) -> f64 {
        match self {
            Self::Linear | Self::Step => 0.0,
            Self::Smooth => 10.0 / 1.732_050_807_568_877_2,
            Self::Cubic => 6.0,
        }
    }
}

/// Most parts that one movement is cut into; no device takes scripts of that length.
const PARTS_MAX: f64 = 1e6;

/// The device as far as motion is concerned.
#[derive(Clone, Copy)]
pub(crate) struct Actuator<'a> {
    pub(crate) interpolation: Interpolation,
    pub(crate) control_type: ControlType,
    pub(crate) limits: Option<&'a Limits>,
}

impl<'a> Actuator<'a> {
    pub(crate) fn new(device: &'a Device, control_type: ControlType) -> Self {
        let limits = device.available_control_types.limits(control_type);
        Self { interpolation: device.interpolation, control_type, limits }
    }

    /// The way that keyframes take where they name none: the device's own.
    fn default_easing(&self) -> Easing {
        match self.interpolation {
            Interpolation::Linear => Easing::Linear,
            Interpolation::Hold => Easing::Step,
        }
    }

    fn easing_of(&self, keyframe: &Keyframe) -> Easing {
        keyframe.easing.unwrap_or(self.default_easing())
    }

    /// Whether the first keyframe is reached by moving from wherever the device is.
    pub(crate) fn moves_from_anywhere(&self, first: &Keyframe) -> bool {
        first.at > Span::ZERO
            && self.interpolation == Interpolation::Linear
            && self.easing_of(first) == Easing::Linear
    }

    /// Whether the first keyframe needs a value to begin from, and has none.
    pub(crate) fn lacks_beginning(&self, first: &Keyframe) -> bool {
        first.at > Span::ZERO && self.easing_of(first) != Easing::Step && !self.moves_from_anywhere(first)
    }

    /// The steps of a track, offsets from the cue's start.
    pub(crate) fn steps(&self, keyframes: &[Keyframe]) -> Vec<Step> {
        let mut steps = Vec::with_capacity(keyframes.len());
        if let Some(first) = keyframes.first() {
            steps.push(self.step(first.at.as_millis_f64(), first.to));
        }
        for pair in keyframes.windows(2) {
            self.movement(&pair[0], &pair[1], &mut steps);
        }
        steps
    }

    fn movement(&self, from: &Keyframe, to: &Keyframe, steps: &mut Vec<Step>) {
        let easing = self.easing_of(to);
        let (begin, end) = (from.at.as_millis_f64(), to.at.as_millis_f64());
        let change = to.to - from.to;
        // A device that moves linearly would creep towards a jump unless it is told to stay.
        if easing == Easing::Step && self.interpolation == Interpolation::Linear && change != 0.0 {
            steps.push(self.step(end, from.to));
        }
        let parts = self.parts(easing, change);
        let mut last = from.to;
        for part in 1..parts {
            let s = f64::from(part) / f64::from(parts);
            let value = self.on_grid(from.to + change * easing.at(s));
            if self.interpolation == Interpolation::Linear || value != last {
                steps.push(self.step(begin + (end - begin) * s, value));
                last = value;
            }
        }
        steps.push(self.step(end, to.to));
    }

    /// Equal parts that keep the error within the tolerance, max_error or one granularity if that is more.
    ///
    /// A held value is off by at most the slope times the part's length, a linear piece by at most curvature times the
    /// length squared over 8 (de Boor, A Practical Guide to Splines, chapter III); half a granularity goes to rounding.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 1 and PARTS_MAX")]
    fn parts(&self, easing: Easing, change: f64) -> u32 {
        let Some(limits) = self.limits else { return 1 };
        let tolerance = limits.max_error.unwrap_or(0.0).max(limits.granularity) - limits.granularity / 2.0;
        let parts = match self.interpolation {
            Interpolation::Hold => easing.slope_max() * change.abs() / tolerance,
            Interpolation::Linear => (easing.curvature_max() * change.abs() / (8.0 * tolerance)).sqrt(),
        };
        parts.ceil().clamp(1.0, PARTS_MAX) as u32
    }

    fn on_grid(&self, value: f64) -> f64 {
        self.limits.map_or(value, |limits| limits.nearest(value).clamp(limits.min_value, limits.max_value))
    }

    fn step(&self, millis: f64, value: f64) -> Step {
        Step {
            offset: Millis::from_span(Span::from_millis_f64(millis)),
            setpoint: Setpoint::new(self.control_type, value),
            stop_condition: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Place;

    fn keyframe(millis: i64, to: f64, easing: Easing) -> Keyframe {
        Keyframe { at: Span::from_millis(millis), to, easing: Some(easing), place: Place::default() }
    }

    fn value_at(steps: &[Step], interpolation: Interpolation, millis: f64) -> f64 {
        let after = steps.iter().position(|step| step.offset.get() > millis).unwrap_or(steps.len());
        let before = &steps[after - 1];
        match (interpolation, steps.get(after)) {
            (Interpolation::Linear, Some(next)) => {
                let part = (millis - before.offset.get()) / (next.offset.get() - before.offset.get());
                before.setpoint.value + (next.setpoint.value - before.setpoint.value) * part
            }
            _ => before.setpoint.value,
        }
    }

    #[test]
    fn every_easing_stays_within_the_tolerance_all_the_way() {
        let limits = Limits { min_value: -200.0, max_value: 200.0, granularity: 0.5, max_error: Some(1.5) };
        for interpolation in [Interpolation::Linear, Interpolation::Hold] {
            for easing in [Easing::Linear, Easing::Smooth, Easing::Cubic] {
                let actuator =
                    Actuator { interpolation, control_type: ControlType::Position, limits: Some(&limits) };
                let keyframes = [keyframe(0, -30.0, easing), keyframe(1_000, 57.5, easing)];
                let steps = actuator.steps(&keyframes);
                for millis in 0..1_000 {
                    let wanted = -30.0 + 87.5 * easing.at(f64::from(millis) / 1_000.0);
                    let error = (value_at(&steps, interpolation, f64::from(millis)) - wanted).abs();
                    assert!(error <= 1.5, "{easing:?} {interpolation:?}: off by {error} at {millis} ms");
                }
                assert!(steps.iter().all(|step| limits.on_grid(step.setpoint.value)));
            }
        }
    }

    #[test]
    fn a_linear_movement_of_a_linear_device_is_one_step() {
        let limits = Limits { min_value: 0.0, max_value: 100.0, granularity: 1.0, max_error: None };
        let interpolation = Interpolation::Linear;
        let actuator = Actuator { interpolation, control_type: ControlType::Position, limits: Some(&limits) };
        let keyframes = [keyframe(0, 0.0, Easing::Step), keyframe(1_000, 90.0, Easing::Linear)];
        assert_eq!(actuator.steps(&keyframes).len(), 2);
        let jump = [keyframe(0, 0.0, Easing::Step), keyframe(1_000, 90.0, Easing::Step)];
        let offsets: Vec<_> = actuator.steps(&jump).iter().map(|step| step.offset.get()).collect();
        assert_eq!(offsets, [0.0, 1_000.0, 1_000.0], "it stays until the jump");
    }
}
