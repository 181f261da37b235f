//! The channels that the devices of a fixture occupy in a universe of DMX512.

use std::collections::BTreeMap;

use crate::{
    CHANNELS_PER_UNIVERSE, Channels, ControlParameters, ControlType, Device, DeviceId, InitializationBlock,
    Limits,
};

/// Range of each value of a `custom_N` if the device's scripts declare none.
const CUSTOM_RANGE: (f64, f64) = (0.0, 255.0);

/// A device of a fixture, and its channels.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Patched<'a> {
    /// The device.
    pub device: &'a Device,
    /// The only control type by which the device is driven, apart from scripts.
    pub control_type: ControlType,
    /// The values for the levels 0 and 1 of the channels, in the device's unit.
    pub range: (f64, f64),
    /// The channels of each value in the universe, 1 to 512: the coarse one, and the fine one if there is one.
    pub values: Vec<Vec<u16>>,
}

/// Why the devices of a fixture cannot be patched.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PatchError {
    /// A channel is beyond the end of the universe.
    #[error(
        "channel {channel} of `{device}` is channel {of_universe} of the universe, expected at most {CHANNELS_PER_UNIVERSE}"
    )]
    BeyondUniverse {
        /// The device with the channel.
        device: DeviceId,
        /// The channel, counted from the fixture's first one, which is 1.
        channel: u16,
        /// The channel in the universe.
        of_universe: u32,
    },
    /// Two devices use the same channel.
    #[error("`{first}` and `{second}` both use channel {channel} of the fixture")]
    UsedTwice {
        /// The device that the description lists first.
        first: DeviceId,
        /// The other device.
        second: DeviceId,
        /// The channel, counted from the fixture's first one, which is 1.
        channel: u16,
    },
    /// A device is driven in no way or in several ways.
    #[error(
        "a DMX channel takes one kind of value: `{device}` has {found}, expected `script` and one of position, speed and custom_N"
    )]
    Kinds {
        /// The device.
        device: DeviceId,
        /// Its control types, separated by commas.
        found: String,
    },
    /// A device is a sensor.
    #[error("`{0}` is a sensor, and DMX fixtures cannot be read")]
    Sensor(DeviceId),
    /// The number of channels does not fit the number of values.
    #[error("`channel` of `{device}` does not fit its values, expected {}", expected_channels(*values))]
    Count {
        /// The device.
        device: DeviceId,
        /// The number of its values.
        values: usize,
    },
}

fn expected_channels(values: usize) -> String {
    match values {
        1 => "one channel, or a coarse and a fine one".to_owned(),
        _ => format!("{values} channels or pairs, one for each value"),
    }
}

/// Returns the channels of each device of the fixture whose first channel in the universe is `first`, 1 to 512. A device without
/// [`Device::channel`] takes the channels after those of the device before it.
///
/// # Errors
/// Returns [`PatchError`] if the channels do not fit the devices or the universe.
pub fn patch(block: &InitializationBlock, first: u16) -> Result<Vec<Patched<'_>>, PatchError> {
    let mut users: BTreeMap<u16, &DeviceId> = BTreeMap::new();
    let mut next = 1;
    let mut patched = Vec::new();
    for device in block.devices.iter() {
        let (mut device, count) = driven(device)?;
        let values = match &device.device.channel {
            Some(channels) => channels_of(device.device, channels, count)?,
            None => (next..).take(count.unwrap_or(1)).map(|channel| vec![channel]).collect(),
        };
        let id = &device.device.id;
        for channel in values.iter().flatten() {
            let of_universe = u32::from(first) + u32::from(*channel) - 1;
            if of_universe > u32::from(CHANNELS_PER_UNIVERSE) {
                return Err(PatchError::BeyondUniverse {
                    device: id.clone(),
                    channel: *channel,
                    of_universe,
                });
            }
            if let Some(other) = users.insert(*channel, id) {
                let (first, second) = (other.clone(), id.clone());
                return Err(PatchError::UsedTwice { first, second, channel: *channel });
            }
            next = next.max(channel + 1);
        }
        let in_universe = |value: Vec<u16>| value.into_iter().map(|channel| first + channel - 1).collect();
        device.values = values.into_iter().map(in_universe).collect();
        patched.push(device);
    }
    Ok(patched)
}

/// Returns how a device is driven, still without channels, and its number of values: `None` if it has as many as channels.
fn driven(device: &Device) -> Result<(Patched<'_>, Option<usize>), PatchError> {
    let types = &device.available_control_types;
    let mut driven = types.iter().filter(|(control_type, _)| *control_type != ControlType::Script);
    let (Some((control_type, parameters)), None) = (driven.next(), driven.next()) else {
        let found: Vec<String> = types.iter().map(|(control_type, _)| control_type.to_string()).collect();
        return Err(PatchError::Kinds { device: device.id.clone(), found: found.join(", ") });
    };
    let range_of = |limits: &Limits| (limits.min_value, limits.max_value);
    let (range, count) = match parameters {
        ControlParameters::Motion(limits) => (range_of(limits), Some(1)),
        ControlParameters::Custom(parameters) => {
            let count = parameters.get("values").and_then(serde_json::Value::as_u64);
            let range = types.script().map_or(CUSTOM_RANGE, |script| range_of(&script.limits));
            (range, count.and_then(|count| usize::try_from(count).ok()))
        }
        _ => return Err(PatchError::Sensor(device.id.clone())),
    };
    Ok((Patched { device, control_type, range, values: Vec::new() }, count))
}

fn channels_of(
    device: &Device,
    channels: &Channels,
    count: Option<usize>,
) -> Result<Vec<Vec<u16>>, PatchError> {
    let values = count.unwrap_or_else(|| channels.count());
    channels.of_values(values).ok_or_else(|| PatchError::Count { device: device.id.clone(), values })
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

    #[test]
    fn impossible_patches_are_refused() {
        let refused = |devices: String, first: u16| patch(&block(&devices), first).unwrap_err().to_string();
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
