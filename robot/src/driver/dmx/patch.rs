//! The channels of a fixture's devices, and the levels for their values.

use std::collections::{BTreeMap, BTreeSet};

use urrcp::{
    Channels, ControlParameters, ControlType, Device, DeviceId, InitializationBlock, Limits, Setpoint,
};

/// Number of channels in a universe.
pub(super) const CHANNELS: u16 = 512;
/// Range of each value of a `custom_N` if the device's scripts declare none.
const CUSTOM_RANGE: (f64, f64) = (0.0, 255.0);

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
    devices: BTreeMap<DeviceId, Patched>,
}

#[derive(Clone, Debug)]
struct Patched {
    control_type: ControlType,
    range: (f64, f64),
    slots: Vec<Slot>,
    default: Option<f64>,
}

impl Patch {
    /// Returns the patch of the fixture whose first channel is `first`, 1 to 512.
    pub(super) fn of(block: &InitializationBlock, first: u16) -> Result<Self, String> {
        let mut devices = BTreeMap::new();
        let mut users: BTreeMap<u16, &DeviceId> = BTreeMap::new();
        let mut next = 1;
        for device in block.devices.iter() {
            let Driven { control_type, range, count } = driven(device)?;
            let values = match &device.channel {
                Some(channels) => channels_of(device, channels, count)?,
                None => (next..).take(count.unwrap_or(1)).map(|channel| vec![channel]).collect(),
            };
            let mut slots = Vec::new();
            for channels in &values {
                for channel in channels {
                    let last = u32::from(first) + u32::from(*channel) - 1;
                    if last > u32::from(CHANNELS) {
                        return Err(format!(
                            "channel {channel} of `{}` is channel {last} of the universe, expected at most {CHANNELS}",
                            device.id
                        ));
                    }
                    if let Some(other) = users.insert(*channel, &device.id) {
                        return Err(format!(
                            "`{other}` and `{}` both use channel {channel} of the fixture",
                            device.id
                        ));
                    }
                    next = next.max(channel + 1);
                }
                let index = |channel: &u16| first - 1 + channel - 1;
                let (Some(coarse), fine) = (channels.first().map(index), channels.get(1).map(index)) else {
                    continue;
                };
                slots.push(Slot { coarse, fine });
            }
            let patched = Patched { control_type, range, slots, default: device.default_value };
            devices.insert(device.id.clone(), patched);
        }
        Ok(Self { devices })
    }

    /// Returns the indices of all channels of the fixture, from 0.
    pub(super) fn channels(&self) -> BTreeSet<u16> {
        let slots = self.devices.values().flat_map(|patched| &patched.slots);
        slots.flat_map(|slot| [Some(slot.coarse), slot.fine]).flatten().collect()
    }

    /// Returns the levels of the default values. Devices without a default value are at zero, or at the limit closest to zero.
    pub(super) fn defaults(&self) -> Vec<Level> {
        let of_device = |patched: &Patched| {
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

/// How a device is driven.
struct Driven {
    control_type: ControlType,
    range: (f64, f64),
    /// Number of values. `None`: as many as the device has channels.
    count: Option<usize>,
}

/// Returns how a device is driven. It must have only one control type.
fn driven(device: &Device) -> Result<Driven, String> {
    let types = &device.available_control_types;
    let mut driven = types.iter().filter(|(control_type, _)| *control_type != ControlType::Script);
    let (Some((control_type, parameters)), None) = (driven.next(), driven.next()) else {
        let found: Vec<String> = types.iter().map(|(control_type, _)| control_type.to_string()).collect();
        return Err(format!(
            "a DMX channel takes one kind of value: `{}` has {}, expected `script` and one of position, speed and custom_N",
            device.id,
            found.join(", ")
        ));
    };
    let range = |limits: &Limits| (limits.min_value, limits.max_value);
    match parameters {
        ControlParameters::Motion(limits) => {
            Ok(Driven { control_type, range: range(limits), count: Some(1) })
        }
        ControlParameters::Custom(parameters) => {
            let count = parameters.get("values").and_then(serde_json::Value::as_u64);
            let range = types.script().map_or(CUSTOM_RANGE, |script| range(&script.limits));
            let count = count.and_then(|count| usize::try_from(count).ok());
            Ok(Driven { control_type, range, count })
        }
        _ => Err(format!("`{}` is a sensor, and DMX fixtures cannot be read", device.id)),
    }
}

fn channels_of(device: &Device, channels: &Channels, count: Option<usize>) -> Result<Vec<Vec<u16>>, String> {
    let count = count.unwrap_or_else(|| channels.count());
    channels.of_values(count).ok_or_else(|| {
        let one = "one channel, or a coarse and a fine one".to_owned();
        let expected =
            if count == 1 { one } else { format!("{count} channels or pairs, one for each value") };
        format!("`channel` of `{}` does not fit its values, expected {expected}", device.id)
    })
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

    #[test]
    fn impossible_patches_are_refused() {
        let refused = |devices: String, first: u16| Patch::of(&block(&devices), first).unwrap_err();
        let one = |channel: &str| device("pan", channel, 0.0, 1.0);
        let beyond = refused(one(r#", "channel": [5, 6]"#), 508);
        assert_eq!(beyond, "channel 6 of `pan` is channel 513 of the universe, expected at most 512");
        let shared = format!("{},{}", one(r#", "channel": 3"#), color(r#", "channel": [1, 2, 3]"#));
        assert_eq!(refused(shared, 1), "`pan` and `color` both use channel 3 of the fixture");
        let wide = refused(one(r#", "channel": [1, 2, 3]"#), 1);
        assert!(wide.ends_with("expected one channel, or a coarse and a fine one"), "{wide}");
        let few = refused(color(r#", "channel": [1, 2]"#), 1);
        assert!(few.ends_with("expected 3 channels or pairs, one for each value"), "{few}");
        let sensor =
            r#"{"id": "eye", "available_control_types": {"sensor": {"min_value": 0, "max_value": 1}}}"#;
        assert!(refused(sensor.to_owned(), 1).contains("cannot be read"));
    }
}
