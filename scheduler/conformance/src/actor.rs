//! Selects the device to move and the values for it: within all declared limits, and with movements no larger than needed.

use urrcp::{ControlType, Device, InitializationBlock, Limits, Setpoint};

use super::requirement::{Unmet, not_applicable};

/// The device that the checks move, with values that it must accept.
#[derive(Clone, Debug)]
pub(super) struct Actor {
    pub(super) device: Device,
    /// The control type of the movement: `position`, `speed`, `acceleration`, or a custom type for which the operator has stated a value.
    pub(super) control_type: ControlType,
    pub(super) limits: Limits,
    /// The value at rest: the first acceptable one of the default value, zero, and the middle of the range.
    pub(super) rest: f64,
    /// A value close to `rest`: one five-hundredth of the range away, but at least one step of the granularity.
    pub(super) near: f64,
    /// Whether scripts for the device may use `control_type`.
    pub(super) in_script: bool,
}

/// Fraction of the range that a movement covers.
const SMALL: f64 = 0.002;

impl Actor {
    /// Selects the first device that scripts can move, or otherwise the first device that can be moved at all. With `custom`, a value that
    /// is safe for custom control types, it selects among the devices with such a type.
    pub(super) fn choose(
        block: &InitializationBlock,
        wanted: Option<&str>,
        custom: Option<f64>,
    ) -> Option<Self> {
        let devices = block.devices.iter().filter(|d| wanted.is_none_or(|id| d.id.as_str() == id));
        let actor = |device| custom.map_or_else(|| Self::of(device), |value| Self::of_custom(device, value));
        Self::first(devices.filter_map(actor).collect())
    }

    /// Selects another device, by the same rule.
    pub(super) fn other(&self, block: &InitializationBlock) -> Option<Self> {
        Self::first(
            block.devices.iter().filter(|device| device.id != self.device.id).filter_map(Self::of).collect(),
        )
    }

    fn first(mut actors: Vec<Self>) -> Option<Self> {
        let by_script = actors.iter().position(|actor| actor.in_script);
        (!actors.is_empty()).then(|| actors.swap_remove(by_script.unwrap_or(0)))
    }

    /// Uses only `value` for the first custom control type of a device, because only the manufacturer knows which values are safe.
    fn of_custom(device: &Device, value: f64) -> Option<Self> {
        let is_custom = |t: &ControlType| matches!(t, ControlType::Custom(_));
        let scripted = device.script_control_types().into_iter().find(is_custom);
        let any = device.available_control_types.iter().map(|(t, _)| t).find(is_custom);
        let limits = Limits { min_value: value, max_value: value, granularity: 1.0, max_error: None };
        Some(Self {
            device: device.clone(),
            control_type: scripted.or(any)?,
            limits,
            rest: value,
            near: value,
            in_script: scripted.is_some(),
        })
    }

    fn of(device: &Device) -> Option<Self> {
        let motion = |t: &ControlType| device.available_control_types.limits(*t).is_some();
        let scripted = device.script_control_types().into_iter().find(motion);
        let any = device.available_control_types.iter().map(|(t, _)| t).find(motion);
        let control_type = scripted.or(any)?;
        let in_script = scripted.is_some();
        let limits = device.available_control_types.limits(control_type)?.clone();
        let fits = |value: &f64| {
            let setpoint = Setpoint::new(control_type, *value);
            device.check(&setpoint).is_ok() && (!in_script || device.check_in_script(&setpoint).is_ok())
        };
        let primary = device.primary_control_type() == Some(control_type);
        let default = device.default_value.filter(|_| primary);
        let middle = limits.nearest(f64::midpoint(limits.min_value, limits.max_value));
        let inner = device.available_control_types.script().map(|script| &script.limits);
        let common = inner.map_or(middle, |inner| {
            let (low, high) = (limits.min_value.max(inner.min_value), limits.max_value.min(inner.max_value));
            limits.nearest(f64::midpoint(low, high))
        });
        let rest = [default, Some(0.0), Some(common), Some(middle)].into_iter().flatten().find(fits)?;
        let range = limits.max_value - limits.min_value;
        let steps = (SMALL * range / limits.granularity).round().max(1.0);
        let away = |steps: f64| limits.nearest(rest + steps * limits.granularity);
        let near = [steps, -steps, 1.0, -1.0].map(away).into_iter().find(fits).unwrap_or(rest);
        Some(Self { device: device.clone(), control_type, limits, rest, near, in_script })
    }

    /// Whether the protocol defines limits for the values of the control type.
    pub(super) const fn is_bounded(&self) -> bool {
        !matches!(self.control_type, ControlType::Custom(_))
    }

    /// The smallest and the largest value that the device accepts.
    pub(super) fn edges(&self) -> [f64; 2] {
        let limits = &self.limits;
        [limits.nearest_settable(limits.min_value), limits.nearest_settable(limits.max_value)]
    }

    /// Two values that the device must refuse: the multiples of the granularity just below its smallest value and just above its largest
    /// value. Returns [`Unmet::NotApplicable`] for a custom control type.
    pub(super) fn beyond(&self) -> Result<[f64; 2], Unmet> {
        if !self.is_bounded() {
            return Err(not_applicable(format!(
                "only the manufacturer of `{}` knows which values of {} it refuses",
                self.device.id, self.control_type
            )));
        }
        let ([low, high], granularity) = (self.edges(), self.limits.granularity);
        Ok([self.limits.nearest(low - granularity), self.limits.nearest(high + granularity)])
    }

    /// A control type that the device lacks.
    pub(super) fn lacks(&self) -> ControlType {
        let candidates =
            [ControlType::Acceleration, ControlType::Speed, ControlType::Position, ControlType::Custom(77)];
        let lacking = candidates.into_iter().find(|t| self.device.available_control_types.get(*t).is_none());
        lacking.unwrap_or(ControlType::Custom(78))
    }

    pub(super) fn is_rate(&self) -> bool {
        self.control_type != ControlType::Position
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(device: &str) -> InitializationBlock {
        let text = format!(r#"{{"id":"r","api_version":"1","devices":[{device}]}}"#);
        serde_json::from_str(&text).unwrap()
    }

    fn actor(types: &str) -> Actor {
        let device =
            format!(r#"{{"id":"d","name":"d","default_value":0,"available_control_types":{{{types}}}}}"#);
        Actor::choose(&block(&device), None, None).unwrap()
    }

    #[test]
    fn values_are_on_grid_and_within_limits_even_if_limits_are_off_grid() {
        let actor = actor(r#""position":{"min_value":-0.07,"max_value":0.32,"granularity":0.05}"#);
        let [low, high] = actor.edges();
        assert!((low + 0.05).abs() < 1e-12 && (high - 0.3).abs() < 1e-12, "{low} {high}");
        let [below, above] = actor.beyond().unwrap();
        assert!((below + 0.1).abs() < 1e-12 && (above - 0.35).abs() < 1e-12, "{below} {above}");
        assert!((actor.rest, actor.near) == (0.0, 0.05));
    }

    #[test]
    fn default_outside_script_limits_is_not_the_rest_value() {
        let actor = actor(
            r#""position":{"min_value":0,"max_value":90,"granularity":1},
               "script":{"min_value":40,"max_value":60,"granularity":1,"max_number_of_steps":8}"#,
        );
        assert!((actor.rest - 50.0).abs() < 1e-12 && (actor.near - 51.0).abs() < 1e-12, "{actor:?}");
    }
}
