//! Rounds values to multiples of a device's granularity, as decimal numbers.

use urrcp::{Device, InitializationBlock};

use super::Key;

/// Returns a signal's value, rounded to a multiple of the device's granularity, because movements and stops produce values in between.
/// For example, 82 times 0.02 is 1.64, not 1.6400000000000001.
pub(super) fn on_grid(block: &InitializationBlock, key: &Key, value: f64) -> f64 {
    let (device, control_type) = key;
    let device = block.device(device.as_str());
    let Some(limits) = device.and_then(|device| device.available_control_types.limits(*control_type)) else {
        return value;
    };
    if is_default(device, value) && !limits.on_grid(value) {
        return value;
    }
    limits.nearest(value).clamp(limits.min_value, limits.max_value)
}

fn is_default(device: Option<&Device>, value: f64) -> bool {
    device.and_then(|device| device.default_value) == Some(value)
}

#[cfg(test)]
mod tests {
    use urrcp::{ControlType, DeviceId};

    use super::*;

    #[track_caller]
    fn check(granularity: f64, value: f64, expected: &str) {
        let block = serde_json::from_value(serde_json::json!({"id": "r", "api_version": "1", "devices": [
            {"id": "arm", "name": "arm", "default_value": 0.123, "available_control_types":
                {"position": {"min_value": -9.05, "max_value": 9, "granularity": granularity}}}]}));
        let key = (DeviceId::new("arm").unwrap(), ControlType::Position);
        assert_eq!(on_grid(&block.unwrap(), &key, value).to_string(), expected);
    }

    #[test]
    fn value_has_at_most_as_many_decimals_as_its_grid() {
        check(0.02, 82.0 * 0.02, "1.64");
        check(0.02, 1.633, "1.64");
        check(0.1, 3.0 * 0.1, "0.3");
        check(1e-7, 3.0 * 1e-7, "0.0000003");
        check(0.25, -1.3, "-1.25");
        check(1.0, 3.2, "3");
    }

    #[test]
    fn limit_or_default_value_off_the_grid_is_unchanged() {
        check(0.1, -9.05, "-9.05");
        check(0.02, 0.123, "0.123");
    }

    #[test]
    fn value_on_a_grid_without_decimal_form_is_unchanged() {
        let third = 1.0 / 3.0;
        check(third, 2.0 * third, &(2.0 * third).to_string());
    }
}
