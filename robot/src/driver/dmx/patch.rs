//! The channels of a fixture's devices, and the levels for their values.

use std::collections::{BTreeMap, BTreeSet};

use urrcp::{ControlType, DeviceId, InitializationBlock, PatchError, Patched, Setpoint};

/// One value of a device in a universe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Slot {
    /// Index of the channel, from 0. If there is a fine channel, this is the coarse one.
    pub coarse: u16,
    /// Index of the channel for the lower 8 bits of a value with 16 bits.
    pub fine: Option<u16>,
}

/// A slot and the level that it takes: 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Level {
    pub slot: Slot,
    pub level: f64,
}

/// The slots of all devices of a fixture.
#[derive(Clone, Debug)]
pub(super) struct Patch {
    devices: BTreeMap<DeviceId, DeviceSlots>,
}

#[derive(Clone, Debug)]
struct DeviceSlots {
    control_type: ControlType,
    range: (f64, f64),
    slots: Vec<Slot>,
    default: Option<f64>,
}

impl Patch {
    /// Returns the patch of the fixture whose first channel is `first`, 1 to 512.
    pub(super) fn of(block: &InitializationBlock, first: u16) -> Result<Self, PatchError> {
        let slot = |channels: Vec<u16>| {
            let index = |channel: &u16| channel - 1;
            let fine = channels.get(1).map(index);
            channels.first().map(index).map(|coarse| Slot { coarse, fine })
        };
        let patched = |Patched { device, control_type, range, values, .. }: Patched<'_>| {
            let slots = values.into_iter().filter_map(slot).collect();
            (device.id.clone(), DeviceSlots { control_type, range, slots, default: device.default_value })
        };
        Ok(Self { devices: urrcp::patch(block, first)?.into_iter().map(patched).collect() })
    }

    /// Returns the indices of all channels of the fixture, from 0.
    pub(super) fn channels(&self) -> BTreeSet<u16> {
        let slots = self.devices.values().flat_map(|patched| &patched.slots);
        slots.flat_map(|slot| [Some(slot.coarse), slot.fine]).flatten().collect()
    }

    /// Returns the levels of the default values. Devices without a default value are at zero, or at the limit closest to zero.
    pub(super) fn defaults(&self) -> Vec<Level> {
        let of_device = |patched: &DeviceSlots| {
            let value = patched.default.unwrap_or(0.0);
            let level = level(value, patched.range);
            patched.slots.iter().map(|slot| Level { slot: *slot, level }).collect::<Vec<_>>()
        };
        self.devices.values().flat_map(of_device).collect()
    }

    /// Returns the levels for a value of a device.
    pub(super) fn levels(&self, device: &DeviceId, setpoint: &Setpoint) -> Result<Vec<Level>, String> {
        let patched = self.devices.get(device).ok_or_else(|| format!("unknown device `{device}`"))?;
        if setpoint.control_type != patched.control_type {
            return Err(format!(
                "`{device}` takes {}, found {}",
                patched.control_type, setpoint.control_type
            ));
        }
        let values: Vec<f64> = setpoint.values().collect();
        if values.len() != patched.slots.len() {
            let (expected, found) = (patched.slots.len(), values.len());
            return Err(format!("`{device}` has channels for {expected} values, found {found}"));
        }
        let slots = patched.slots.iter().zip(values);
        Ok(slots.map(|(slot, value)| Level { slot: *slot, level: level(value, patched.range) }).collect())
    }
}

/// Returns the share of a value in its range, 0 to 1.
fn level(value: f64, (min, max): (f64, f64)) -> f64 {
    if max > min { ((value - min) / (max - min)).clamp(0.0, 1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(devices: &str) -> InitializationBlock {
        let text = format!(r#"{{"id": "spot", "api_version": "1", "devices": [{devices}]}}"#);
        serde_json::from_str(&text).unwrap()
    }

    fn device(id: &str, channel: &str, min: f64, max: f64) -> String {
        format!(
            r#"{{"id": "{id}"{channel}, "available_control_types": {{"position": {{"min_value": {min}, "max_value": {max}, "granularity": 0.01}},
                "script": {{"max_number_of_steps": 9}}}}}}"#
        )
    }

    fn color(channel: &str) -> String {
        format!(
            r#"{{"id": "color"{channel}, "available_control_types": {{"custom_1": {{"values": 3}},
                "script": {{"min_value": 0, "max_value": 100, "granularity": 1, "max_number_of_steps": 9}}}}}}"#
        )
    }

    fn id(id: &str) -> DeviceId {
        DeviceId::new(id).unwrap()
    }

    const fn coarse(coarse: u16) -> Slot {
        Slot { coarse, fine: None }
    }

    #[test]
    fn value_becomes_its_share_of_the_range() {
        let pan = device("pan", r#", "channel": [2, 3]"#, -270.0, 270.0);
        let patch = Patch::of(&block(&format!("{pan},{}", color(""))), 13).unwrap();
        let at = |value| Setpoint::new(ControlType::Position, value);
        let slot = Slot { coarse: 13, fine: Some(14) };
        assert_eq!(patch.levels(&id("pan"), &at(0.0)), Ok(vec![Level { slot, level: 0.5 }]));
        assert_eq!(patch.levels(&id("pan"), &at(-270.0)), Ok(vec![Level { slot, level: 0.0 }]));
        // The colour follows the channels of the device before it, in the range of its scripts.
        let red = Setpoint { more: [0.0, 50.0].into(), ..Setpoint::new(ControlType::Custom(1), 100.0) };
        let levels = patch.levels(&id("color"), &red).unwrap();
        let expected = [(15, 1.0), (16, 0.0), (17, 0.5)];
        assert_eq!(levels, expected.map(|(at, level)| Level { slot: coarse(at), level }).to_vec());
        assert_eq!(patch.channels().into_iter().collect::<Vec<_>>(), [13, 14, 15, 16, 17]);
    }

    #[test]
    fn default_values_are_the_first_levels() {
        let dimmer = r#"{"id": "dimmer", "default_value": 25, "available_control_types": {"position": {"min_value": 0, "max_value": 100, "granularity": 1}}}"#;
        let patch = Patch::of(&block(dimmer), 1).unwrap();
        assert_eq!(patch.defaults(), [Level { slot: coarse(0), level: 0.25 }]);
    }
}
