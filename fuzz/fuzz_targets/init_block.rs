//! Parses any text as an initialization block (a robot's description). A valid block keeps the protocol's limits and is unchanged if it
//! is written and read again. All devices of a robot with this block can be driven.
#![no_main]

use std::collections::HashSet;

use libfuzzer_sys::fuzz_target;
use robot_invariants::drive_all;
use urrcp::{ControlParameters, DEVICES_MAX, InitializationBlock, STRING_CHARS_MAX};

fn check_limits(block: &InitializationBlock) {
    assert!((1..=DEVICES_MAX).contains(&block.devices.len()));
    let ids: HashSet<_> = block.devices.iter().map(|device| &device.id).collect();
    assert_eq!(ids.len(), block.devices.len(), "ids are unique");
    let chars = |text: &str| text.chars().count();
    assert!((1..=STRING_CHARS_MAX).contains(&chars(block.id.as_str())));
    for device in &block.devices {
        assert!((1..=STRING_CHARS_MAX).contains(&chars(device.id.as_str())));
        assert!(device.name.as_ref().is_none_or(|name| chars(name.as_str()) <= STRING_CHARS_MAX));
        assert!(device.default_value.is_none_or(f64::is_finite));
        for (_, parameters) in device.available_control_types.iter() {
            let limits = match parameters {
                ControlParameters::Motion(limits) => limits,
                ControlParameters::Script(script) => &script.limits,
                ControlParameters::Sensor(sensor) => {
                    assert!(sensor.min_value <= sensor.max_value && sensor.min_value.is_finite());
                    continue;
                }
                _ => continue,
            };
            assert!(limits.min_value <= limits.max_value && limits.min_value.is_finite());
            assert!(
                limits.granularity > 0.0 && limits.granularity.is_finite() && limits.max_value.is_finite()
            );
            assert!(limits.max_error.is_none_or(|error| error >= 0.0 && error.is_finite()));
        }
    }
}

fuzz_target!(|text: &str| {
    let Ok(block) = serde_json::from_str::<InitializationBlock>(text) else { return };
    check_limits(&block);
    let written = serde_json::to_string(&block).unwrap();
    assert_eq!(serde_json::from_str::<InitializationBlock>(&written).unwrap(), block);
    if let Err(violation) = drive_all(&block) {
        panic!("{violation}");
    }
});
