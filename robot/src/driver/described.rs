//! Checks whether a Thrift robot is the robot that the edge is configured for, by means of the robot's own description.

use serde_json::Value;
use urrcp::{ControlParameters, ControlType, Device, DeviceId, InitializationBlock, RobotId};

/// The difference between a robot's description and its initialization block.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(super) enum Mismatch {
    #[error("its id is `{found}`, expected `{expected}`")]
    Id { found: String, expected: RobotId },
    /// `others` lists the devices that the robot has.
    #[error("it has no device `{device}`{others}")]
    NoDevice { device: DeviceId, others: String },
    #[error("its device `{device}` accepts {} to {}, expected {} to {}", accepted[0], accepted[1], expected[0], expected[1])]
    Range { device: DeviceId, accepted: [f64; 2], expected: [f64; 2] },
}

/// Compares a robot's description with its initialization block: its id, if it reports one, the driven devices, and their ranges.
///
/// # Errors
/// The mismatch. A description that cannot be parsed counts as a match.
pub(super) fn fits(schema: &str, block: &InitializationBlock) -> Result<(), Mismatch> {
    let Ok(schema) = serde_json::from_str::<Value>(schema) else {
        tracing::warn!(robot = %block.id, "the robot's description is not JSON, so its devices are not checked");
        return Ok(());
    };
    if let Some(told) = schema.get("id").and_then(Value::as_str).filter(|told| *told != block.id.as_str()) {
        return Err(Mismatch::Id { found: told.to_owned(), expected: block.id.clone() });
    }
    let Some(devices) = schema.get("devices").and_then(Value::as_object) else { return Ok(()) };
    for device in block.devices.iter().filter(|device| range(device).is_some()) {
        let Some(told) = devices.get(device.id.as_str()) else {
            let names: Vec<&str> = devices.keys().map(String::as_str).take(20).collect();
            let others = match &names[..] {
                [] => ", and no other devices either".to_owned(),
                names => format!("; its devices are {}", names.join(", ")),
            };
            return Err(Mismatch::NoDevice { device: device.id.clone(), others });
        };
        let Some((min, max)) = range(device) else { continue };
        let bound = |key| told.get(key).and_then(Value::as_f64);
        let (least, most) =
            (bound("min_value").unwrap_or(f64::NEG_INFINITY), bound("max_value").unwrap_or(f64::INFINITY));
        if min < least || max > most {
            let (device, accepted, expected) = (device.id.clone(), [least, most], [min, max]);
            return Err(Mismatch::Range { device, accepted, expected });
        }
    }
    Ok(())
}

/// Returns the minimum and maximum value of a device that can be moved. `None` for other devices.
fn range(device: &Device) -> Option<(f64, f64)> {
    let mut driven =
        device.available_control_types.iter().filter(|(control_type, _)| is_driven(*control_type));
    driven.find_map(|(_, parameters)| match parameters {
        ControlParameters::Motion(limits) => Some((limits.min_value, limits.max_value)),
        _ => None,
    })
}

/// Whether a driver that receives only numbers can set values of this control type.
pub(super) fn is_driven(control_type: ControlType) -> bool {
    !matches!(control_type, ControlType::Script | ControlType::Sensor)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCHEMA: &str = r#"{"devices": {"left": {"min_value": -100, "max_value": 100}, "lamp": {}}}"#;

    fn block(device: &str, min: f64, max: f64) -> InitializationBlock {
        serde_json::from_value(serde_json::json!({"id": "r", "api_version": "1", "devices": [
            {"id": device, "name": device, "available_control_types":
                {"position": {"min_value": min, "max_value": max, "granularity": 1}}},
            {"id": "eye", "name": "eye", "available_control_types":
                {"sensor": {"min_value": 0, "max_value": 1}}}]}))
        .unwrap()
    }

    #[test]
    fn robot_with_another_id_is_not_the_expected_one() {
        let told = |id: &str| {
            let schema = format!(r#"{{"id": "{id}"}}"#);
            fits(&schema, &block("left", 0.0, 1.0)).map_err(|mismatch| mismatch.to_string())
        };
        assert_eq!(told("r"), Ok(()));
        assert_eq!(told("s"), Err("its id is `s`, expected `r`".into()));
    }

    #[test]
    fn robot_with_other_devices_or_ranges_is_not_the_expected_one() {
        let says = |schema: &str, device: &str, min, max| {
            fits(schema, &block(device, min, max)).map_err(|mismatch| mismatch.to_string())
        };
        assert_eq!(says(SCHEMA, "left", -50.0, 100.0), Ok(()));
        assert_eq!(says(SCHEMA, "lamp", 0.0, 1e9), Ok(()), "no range is told");
        assert_eq!(says("no JSON", "arm", 0.0, 1.0), Ok(()));
        assert_eq!(
            says(SCHEMA, "arm", 0.0, 1.0),
            Err("it has no device `arm`; its devices are lamp, left".into())
        );
        assert_eq!(
            says(r#"{"devices": {}}"#, "arm", 0.0, 1.0),
            Err("it has no device `arm`, and no other devices either".into())
        );
        let narrow = says(SCHEMA, "left", -150.0, 100.0);
        assert_eq!(narrow, Err("its device `left` accepts -100 to 100, expected -150 to 100".into()));
    }

    #[test]
    fn plain_driver_drives_every_control_type_except_script_and_sensor() {
        use ControlType::{Acceleration, Custom, Position, Script, Sensor, Speed};
        assert_eq!([Position, Speed, Acceleration, Custom(3)].map(is_driven), [true; 4]);
        assert_eq!([Script, Sensor].map(is_driven), [false; 2]);
    }
}
