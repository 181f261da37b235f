//! One signal of a device: where it rests, or how it moves.

use urrcp::{ControlType, Device, Robot, Timestamp};

/// A signal under way or at rest.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Signal {
    from: f64,
    since: Timestamp<Robot>,
    to: f64,
    until: Timestamp<Robot>,
}

impl Signal {
    pub(crate) const fn resting(value: f64, at: Timestamp<Robot>) -> Self {
        Self { from: value, since: at, to: value, until: at }
    }

    pub(crate) const fn ramp(from: f64, since: Timestamp<Robot>, to: f64, until: Timestamp<Robot>) -> Self {
        Self { from, since, to, until }
    }

    /// Where it rests in the end.
    pub(crate) const fn target(&self) -> f64 {
        self.to
    }

    pub(crate) fn value(&self, now: Timestamp<Robot>) -> f64 {
        if now >= self.until {
            return self.to;
        }
        let part = (now - self.since).as_millis_f64() / (self.until - self.since).as_millis_f64();
        self.from + (self.to - self.from) * part.clamp(0.0, 1.0)
    }
}

/// Whether it is a signal under which the device goes on moving after its last command.
pub(crate) const fn is_rate(control_type: ControlType) -> bool {
    !matches!(control_type, ControlType::Position)
}

/// The value of a signal in the default state, as far as it does not depend on the past: `default_value` for the
/// primary one, else zero, or for a position that cannot be zero the nearest that it can take.
pub(crate) fn resting_value(spec: &Device, control_type: ControlType) -> f64 {
    let default = spec.default_value.filter(|_| spec.primary_control_type() == Some(control_type));
    let limits = spec.available_control_types.limits(control_type).filter(|_| !is_rate(control_type));
    default
        .unwrap_or_else(|| limits.map_or(0.0, |limits| 0.0_f64.max(limits.min_value).min(limits.max_value)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_is_linear_and_rests_where_it_arrives() {
        let at = Timestamp::from_nanos;
        let ramp = Signal::ramp(10.0, at(1_000_000), 20.0, at(3_000_000));
        let values = [0, 1_000_000, 2_000_000, 3_000_000, 9_000_000].map(|nanos| ramp.value(at(nanos)));
        assert_eq!(values, [10.0, 10.0, 15.0, 20.0, 20.0]);
    }
}
