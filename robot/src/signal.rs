//! The value of one signal of a device (such as its position or speed) over time, at rest or during a movement.

use urrcp::{ControlType, Device, Limits, Robot, Setpoint, Span, Timestamp};

/// The value of a signal over time: it moves from one value to another, or is at rest.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Signal {
    from: f64,
    since: Timestamp<Robot>,
    to: f64,
    until: Timestamp<Robot>,
    slowing: Option<Slowing>,
}

/// Movement to rest: braking to a standstill, then a movement to the target by speeding up, constant speed and slowing down.
#[derive(Clone, Copy, Debug)]
struct Slowing {
    phases: [Phase; 4],
    /// Minimum of the value; `largest` is its maximum. They prevent rounding errors from exceeding the device's limits.
    least: f64,
    largest: f64,
}

/// A phase of constant acceleration. It lasts until the next phase starts.
#[derive(Clone, Copy, Debug)]
struct Phase {
    since: Timestamp<Robot>,
    value: f64,
    rate: f64,
    acceleration: f64,
}

/// Maximum rates of change of a device's signal.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rates {
    /// Maximum change per second, in the signal's unit. `None`: no limit.
    pub(crate) speed: Option<f64>,
    /// Maximum change of the speed, in the signal's unit per second squared. `None`: no limit.
    pub(crate) acceleration: Option<f64>,
}

impl Signal {
    pub(crate) const fn resting(value: f64, at: Timestamp<Robot>) -> Self {
        Self { from: value, since: at, to: value, until: at, slowing: None }
    }

    pub(crate) const fn ramp(from: f64, since: Timestamp<Robot>, to: f64, until: Timestamp<Robot>) -> Self {
        Self { from, since, to, until, slowing: None }
    }

    /// Whether the signal is moving at `now`.
    pub(crate) fn moves(&self, now: Timestamp<Robot>) -> bool {
        self.since <= now && now < self.until
    }

    /// Returns the signal's final value.
    pub(crate) const fn target(&self) -> f64 {
        self.to
    }

    /// Returns when the signal reaches its final value and comes to rest.
    pub(crate) const fn rests_at(&self) -> Timestamp<Robot> {
        self.until
    }

    pub(crate) fn value(&self, now: Timestamp<Robot>) -> f64 {
        if now >= self.until {
            return self.to;
        }
        if let Some(slowing) = &self.slowing {
            let (phase, seconds) = slowing.at(now);
            let value = phase.value + phase.rate * seconds + phase.acceleration * seconds * seconds / 2.0;
            return value.clamp(slowing.least, slowing.largest);
        }
        let part = (now - self.since).as_millis_f64() / (self.until - self.since).as_millis_f64();
        let part = part.clamp(0.0, 1.0);
        match self.to - self.from {
            way if way.is_finite() => {
                (self.from + way * part).clamp(self.from.min(self.to), self.from.max(self.to))
            }
            // Both ends are finite, but their difference exceeds the range of numbers.
            _ => self.from * (1.0 - part) + self.to * part,
        }
    }

    /// Whether the signal moves to its target at constant speed.
    #[cfg(feature = "host")]
    pub(crate) const fn is_linear(&self) -> bool {
        self.slowing.is_none()
    }

    /// Returns the signal's change per second at `now`.
    fn rate(&self, now: Timestamp<Robot>) -> f64 {
        if now >= self.until || now < self.since {
            return 0.0;
        }
        if let Some(slowing) = &self.slowing {
            let (phase, seconds) = slowing.at(now);
            return phase.rate + phase.acceleration * seconds;
        }
        (self.to - self.from) / ((self.until - self.since).as_millis_f64() / 1_000.0)
    }

    /// Returns the movement from the current state to rest: constant deceleration to a standstill, then a movement to the target `to`, if
    /// any. To avoid a standstill beyond `limits`, the device brakes harder than `rates` permits. Returns `None` if the signal is already
    /// at rest at its target, or if the movement exceeds the range of numbers.
    pub(crate) fn brought_to_rest(
        &self,
        now: Timestamp<Robot>,
        to: Option<f64>,
        rates: Rates,
        limits: Option<&Limits>,
    ) -> Option<Self> {
        let (value, rate) = (self.value(now), self.rate(now));
        let room = limits.map_or(f64::INFINITY, |limits| {
            if rate > 0.0 { limits.max_value - value } else { value - limits.min_value }
        });
        let Some(acceleration) = rates.acceleration else { return self.ramp_home(now, to, rates.speed?) };
        let brake = acceleration.max(rate * rate / (2.0 * room.max(f64::MIN_POSITIVE)));
        let (least, largest) =
            limits.map_or((f64::NEG_INFINITY, f64::INFINITY), |limits| (limits.min_value, limits.max_value));
        let standstill = value + (rate * rate.abs() / (2.0 * brake)).clamp(-room.abs(), room.abs());
        let standstill = standstill.clamp(least, largest);
        let to = to.unwrap_or(standstill);
        let way = (to - standstill).abs();
        if rate == 0.0 && way == 0.0 {
            return None;
        }
        let (direction, a) = ((to - standstill).signum(), acceleration);
        let peak = (a * way).sqrt().min(rates.speed.unwrap_or(f64::INFINITY));
        let going_on = if peak > 0.0 { (way - peak * peak / a) / peak } else { 0.0 };
        let plan = [
            (rate.abs() / brake, rate, -rate.signum() * brake),
            (peak / a, 0.0, direction * a),
            (going_on.max(0.0), direction * peak, 0.0),
            (peak / a, direction * peak, -direction * a),
        ];
        let mut at = (now, value);
        let phases = plan.map(|(seconds, rate, acceleration)| {
            let phase = Phase { since: at.0, value: at.1, rate, acceleration };
            at.0 = at.0 + Span::from_millis_f64(seconds * 1_000.0);
            at.1 += rate * seconds + acceleration * seconds * seconds / 2.0;
            phase
        });
        let numbers = phases.iter().flat_map(|phase| [phase.value, phase.rate, phase.acceleration]);
        if !numbers.chain([to, at.1]).all(f64::is_finite) {
            return None;
        }
        Some(Self {
            from: value,
            since: now,
            to,
            until: at.0,
            slowing: Some(Slowing { phases, least, largest }),
        })
    }
}

impl Signal {
    /// Returns the movement to `to` of a device that declares a maximum speed but no maximum acceleration. `None` if the signal is
    /// already at `to`, or if `to` is `None`.
    fn ramp_home(&self, now: Timestamp<Robot>, to: Option<f64>, speed: f64) -> Option<Self> {
        let (from, to) = (self.value(now), to?);
        let seconds = (to - from).abs() / speed;
        (from != to && seconds.is_finite())
            .then(|| Self::ramp(from, now, to, now + Span::from_millis_f64(seconds * 1_000.0)))
    }

    /// Returns the change of a speed to the value `to` at constant acceleration. `None` if the speed is already `to`.
    pub(crate) fn slowed_to(&self, now: Timestamp<Robot>, to: f64, acceleration: f64) -> Option<Self> {
        let from = self.value(now);
        let seconds = (to - from).abs() / acceleration;
        (from != to).then(|| Self::ramp(from, now, to, now + Span::from_millis_f64(seconds * 1_000.0)))
    }
}

impl Slowing {
    /// Returns the phase at an instant, and the seconds since the start of that phase.
    fn at(&self, now: Timestamp<Robot>) -> (Phase, f64) {
        let phase = self.phases.iter().rev().find(|phase| phase.since <= now).unwrap_or(&self.phases[0]);
        (*phase, (now - phase.since).as_millis_f64().max(0.0) / 1_000.0)
    }
}

/// Whether a device that was driven by this control type continues to move after its last command.
#[cfg(feature = "host")]
pub(crate) const fn is_rate(control_type: ControlType) -> bool {
    !matches!(control_type, ControlType::Position)
}

/// Returns the `default_value` of a signal. Only the device's primary control type has one.
pub(crate) fn default_of(spec: &Device, control_type: ControlType) -> Option<f64> {
    spec.default_value.filter(|_| spec.primary_control_type() == Some(control_type))
}

/// Returns the values that bring a signal to rest: zero for a speed or an acceleration, and `at_rest` for a custom type. A custom type
/// has as many values as were `driven` last. Returns `None` if a signal of this type rests at its current value.
pub(crate) fn rest_of(
    spec: &Device,
    control_type: ControlType,
    driven: Option<&Setpoint>,
) -> Option<Setpoint> {
    match control_type {
        ControlType::Speed | ControlType::Acceleration => Some(Setpoint::new(control_type, 0.0)),
        ControlType::Custom(_) => {
            let count = driven.map_or(1, |driven| driven.values().count());
            spec.available_control_types.at_rest(control_type, count)
        }
        _ => None,
    }
}

/// Pads a setpoint with zeros to as many values as were `driven` last.
pub(crate) fn with_values(first: Setpoint, driven: Option<&Setpoint>) -> Setpoint {
    let more = driven.map_or(0, |driven| driven.more.len());
    Setpoint { more: vec![0.0; more].into(), ..first }
}

/// Returns the value that a signal is assumed to have before any command. For a speed or an acceleration, this is its value at rest,
/// whatever the device's default state: with any other value, a stop would start a movement. For any other signal, it is the default
/// value, else the value at rest, else the permitted value nearest to zero.
pub(crate) fn first_value(spec: &Device, control_type: ControlType) -> f64 {
    let limits = spec.available_control_types.limits(control_type);
    let rest = || rest_of(spec, control_type, None).map(|rest| rest.value);
    let home = || default_of(spec, control_type);
    let first = match control_type {
        ControlType::Speed | ControlType::Acceleration => rest(),
        _ => home().or_else(rest),
    };
    first.unwrap_or_else(|| limits.map_or(0.0, |limits| 0.0_f64.max(limits.min_value).min(limits.max_value)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ramp_is_linear_and_rests_at_its_end() {
        let at = Timestamp::from_nanos;
        let ramp = Signal::ramp(10.0, at(1_000_000), 20.0, at(3_000_000));
        let values = [0, 1_000_000, 2_000_000, 3_000_000, 9_000_000].map(|nanos| ramp.value(at(nanos)));
        assert_eq!(values, [10.0, 10.0, 15.0, 20.0, 20.0]);
    }

    #[test]
    fn ramp_between_ends_with_unrepresentable_distance_is_linear() {
        let at = Timestamp::from_nanos;
        let ramp = Signal::ramp(-1e308, at(0), 1e308, at(4_000_000));
        let values = [1_000_000, 2_000_000, 3_000_000].map(|nanos| ramp.value(at(nanos)));
        assert_eq!(values, [-5e307, 0.0, 5e307]);
    }

    #[test]
    fn coming_to_rest_stays_within_acceleration_and_speed() {
        let at = |millis: i64| Timestamp::from_nanos(millis * 1_000_000);
        let rates = Rates { speed: Some(10.0), acceleration: Some(20.0) };
        // Upwards at 8 per second, stopped at 4 s: 1.6 further in 0.4 s, then back to 0.
        let moving = Signal::ramp(0.0, at(0), 80.0, at(10_000));
        let stopped = moving.brought_to_rest(at(4_000), Some(0.0), rates, None).unwrap();
        assert!((stopped.value(at(4_400)) - 33.6).abs() < 1e-9);
        let dt = 0.001;
        let values: Vec<f64> = (4_000..9_000).map(|millis| stopped.value(at(millis))).collect();
        for window in values.windows(3) {
            let (before, after) = ((window[1] - window[0]) / dt, (window[2] - window[1]) / dt);
            assert!(
                before.abs() <= 10.0 + 1e-6 && ((after - before) / dt).abs() <= 20.0 + 1e-3,
                "{window:?}"
            );
        }
        assert!(stopped.value(stopped.rests_at()).abs() < 1e-9);
        assert!(stopped.rests_at() < at(9_000));
    }

    #[test]
    fn device_brakes_harder_to_stop_within_limits() {
        let at = |millis: i64| Timestamp::from_nanos(millis * 1_000_000);
        let limits = Limits { min_value: 0.0, max_value: 10.0, granularity: 0.1, max_error: None };
        let moving = Signal::ramp(0.0, at(0), 10.0, at(1_000));
        let rates = Rates { speed: None, acceleration: Some(1.0) };
        let stopped = moving.brought_to_rest(at(900), None, rates, Some(&limits)).unwrap();
        assert!((stopped.target() - 10.0).abs() < 1e-9);
        assert!((900..2_000).all(|millis| stopped.value(at(millis)) <= 10.0 + 1e-9));
    }

    #[test]
    fn ramp_with_nonzero_start_comes_to_rest_from_its_own_speed() {
        let at = |millis: i64| Timestamp::from_nanos(millis * 1_000_000);
        let rates = Rates { speed: None, acceleration: Some(20.0) };
        // Up and down at 4 per second: 0.4 further in 0.2 s.
        for (to, standstill) in [(140.0, 120.4), (60.0, 79.6)] {
            let moving = Signal::ramp(100.0, at(0), to, at(10_000));
            let stopped = moving.brought_to_rest(at(5_000), None, rates, None).unwrap();
            assert!((stopped.target() - standstill).abs() < 1e-9, "{}", stopped.target());
            assert_eq!(stopped.rests_at(), at(5_200));
        }
    }

    #[test]
    fn ramp_before_its_start_or_after_its_end_has_no_speed_to_reduce() {
        let at = |millis: i64| Timestamp::from_nanos(millis * 1_000_000);
        let rates = Rates { speed: None, acceleration: Some(20.0) };
        let moving = Signal::ramp(10.0, at(1_000), 20.0, at(2_000));
        for instant in [999, 2_000, 3_000] {
            assert!(moving.brought_to_rest(at(instant), None, rates, None).is_none(), "{instant}");
        }
        assert!(moving.brought_to_rest(at(1_000), None, rates, None).is_some());
    }

    #[test]
    fn device_below_top_speed_reaches_target_by_accelerating_and_braking() {
        let at = |millis: i64| Timestamp::from_nanos(millis * 1_000_000);
        let resting = Signal::resting(10.0, at(0));
        // A distance of 5 at 20 per second squared: half a second for each half, without a phase of constant speed.
        let free = Rates { speed: None, acceleration: Some(20.0) };
        let back = resting.brought_to_rest(at(0), Some(5.0), free, None).unwrap();
        assert_eq!(back.rests_at(), at(1_000));
        let values = [0, 250, 500, 750, 1_000].map(|millis| back.value(at(millis)));
        assert_eq!(values, [10.0, 9.375, 7.5, 5.625, 5.0]);
        // At most 2 per second: 0.1 s each for accelerating and braking over 0.1, and 2.4 s for the rest of the distance.
        let slow = Rates { speed: Some(2.0), acceleration: Some(20.0) };
        let back = resting.brought_to_rest(at(0), Some(5.0), slow, None).unwrap();
        assert_eq!(back.rests_at(), at(2_600));
        assert!((back.value(at(1_300)) - 7.5).abs() < 1e-9, "{}", back.value(at(1_300)));
        assert!((back.value(at(100)) - 9.9).abs() < 1e-9, "{}", back.value(at(100)));
    }

    #[test]
    fn braking_does_not_cross_the_lower_limit() {
        let at = |millis: i64| Timestamp::from_nanos(millis * 1_000_000);
        let limits = Limits { min_value: 2.0, max_value: 10.0, granularity: 0.1, max_error: None };
        let moving = Signal::ramp(10.0, at(0), 2.0, at(800));
        let rates = Rates { speed: None, acceleration: Some(1.0) };
        let stopped = moving.brought_to_rest(at(700), None, rates, Some(&limits)).unwrap();
        assert!((stopped.target() - 2.0).abs() < 1e-9, "{}", stopped.target());
        // The remaining distance of 1 at 10 per second takes 0.2 s.
        assert_eq!(stopped.rests_at(), at(900));
        assert!((700..1_000).all(|millis| stopped.value(at(millis)) >= 2.0));
    }

    #[test]
    fn unrepresentable_stopping_distance_yields_no_motion() {
        let at = |millis: i64| Timestamp::from_nanos(millis * 1_000_000);
        let moving = Signal::ramp(0.0, at(0), 1e300, at(1_000));
        let rates = Rates { speed: None, acceleration: Some(1.0) };
        assert!(moving.brought_to_rest(at(500), None, rates, None).is_none());
    }

    #[test]
    fn speed_change_takes_the_time_given_by_its_acceleration() {
        let at = |millis: i64| Timestamp::from_nanos(millis * 1_000_000);
        let turning = Signal::resting(-8.0, at(0));
        let slowed = turning.slowed_to(at(100), 2.0, 20.0).unwrap();
        assert_eq!((slowed.target(), slowed.rests_at()), (2.0, at(600)));
        assert!((slowed.value(at(350)) + 3.0).abs() < 1e-9);
        assert!(turning.slowed_to(at(100), -8.0, 20.0).is_none(), "it is there");
    }

    #[test]
    fn device_with_only_a_speed_goes_home_at_that_speed_and_stops_at_once() {
        let at = |millis: i64| Timestamp::from_nanos(millis * 1_000_000);
        let rates = Rates { speed: Some(10.0), acceleration: None };
        let resting = Signal::resting(80.0, at(0));
        let home = resting.brought_to_rest(at(0), Some(0.0), rates, None).unwrap();
        assert_eq!((home.target(), home.rests_at()), (0.0, at(8_000)));
        let moving = Signal::ramp(0.0, at(0), 80.0, at(10_000));
        assert!(moving.brought_to_rest(at(5_000), None, rates, None).is_none());
    }

    #[test]
    fn stopping_while_slowing_down_keeps_place_and_time_of_rest() {
        let at = |millis: i64| Timestamp::from_nanos(millis * 1_000_000);
        let rates = Rates { speed: None, acceleration: Some(20.0) };
        let moving = Signal::ramp(0.0, at(0), 80.0, at(10_000));
        let stopped = moving.brought_to_rest(at(4_000), None, rates, None).unwrap();
        let again = stopped.brought_to_rest(at(4_200), None, rates, None).unwrap();
        for signal in [stopped, again] {
            assert!((signal.target() - 33.6).abs() < 1e-6, "{}", signal.target());
            assert!((signal.rests_at() - at(4_400)).abs() < Span::from_micros(1));
        }
    }
}
