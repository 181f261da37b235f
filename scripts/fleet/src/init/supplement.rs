//! The key `devices` of a robot in the fleet file, which completes an incomplete description.

use urrcp::{ControlType, Interpolation};

use crate::kinds;
use downbeat_reader::fields::{At, Reader};
use downbeat_reader::{keys, words};
use downbeat_yaml::finding::{Code, did_you_mean, one_of};
use downbeat_yaml::shown::shortened;

keys! {
    /// Values that complete the description of a device.
    pub(crate) struct DeviceKeys as "device" {
        /// The meaning of its values. By default position.
        control_type: words!(CONTROL_TYPES),
        /// Its smallest step. By default the largest power of ten that fits into its range a thousand times.
        granularity: kinds::POSITIVE,
        /// The unit of all its values.
        unit: kinds::TEXT,
        /// The largest number of steps in one script. By default 1000.
        max_number_of_steps: kinds::COUNT,
        /// How the value changes between the steps of a script; `linear` is sampled by the edge.
        interpolation: words!(INTERPOLATIONS),
        /// Replaces the value in the description.
        min_value: kinds::PLAIN_NUMBER,
        /// Replaces the value in the description.
        max_value: kinds::PLAIN_NUMBER,
        /// Replaces the value in the description.
        default_value: kinds::PLAIN_NUMBER,
        /// The largest error by design.
        max_error: kinds::PLAIN_NUMBER,
        /// The number of scripts that it can hold. By default two.
        script_queue: kinds::COUNT,
    }
}

const CONTROL_TYPES: [(&str, ControlType); 3] = [
    ("position", ControlType::Position),
    ("speed", ControlType::Speed),
    ("acceleration", ControlType::Acceleration),
];
const INTERPOLATIONS: [(&str, Interpolation); 2] =
    [("hold", Interpolation::Hold), ("linear", Interpolation::Linear)];

/// The values that complete the description of a device. Each is `None` if the fleet file does not contain it.
#[derive(Clone, Debug, Default)]
pub struct Supplement {
    pub(super) control_type: Option<ControlType>,
    pub(super) granularity: Option<f64>,
    pub(super) unit: Option<String>,
    pub(super) max_number_of_steps: Option<u32>,
    pub(super) interpolation: Option<Interpolation>,
    pub(super) min_value: Option<f64>,
    pub(super) max_value: Option<f64>,
    pub(super) default_value: Option<f64>,
    pub(super) max_error: Option<f64>,
    pub(super) script_queue: Option<u32>,
}

impl Supplement {
    /// Returns an empty list of supplements.
    pub const fn none() -> [(String, Self); 0] {
        []
    }
}

/// Reads the key `devices` of a robot. `known` contains the ids of the devices in the robot's description.
pub fn read(findings: &mut Reader, at: &At<'_>, known: &[&str]) -> Vec<(String, Supplement)> {
    let mut read = Vec::new();
    for (device, at) in findings.entries(at, "a map from each device to the keys that its description lacks")
    {
        if !known.contains(&device) {
            let message = format!("the robot has no device `{}`", shortened(device));
            let expected = one_of(known.iter().copied());
            let hint = did_you_mean(device, known.iter().copied());
            findings.add(Code::UnknownDevice, at.key_place(), message, expected, hint);
            continue;
        }
        read.extend(one(findings, &at).map(|supplement| (device.to_owned(), supplement)));
    }
    read
}

fn one(findings: &mut Reader, at: &At<'_>) -> Option<Supplement> {
    let keys: DeviceKeys<'_> = findings.keys(at, "the device")?;
    let mut number =
        |at: Option<At<'_>>| at.and_then(|at| findings.number(&at, "a number in the device's unit"));
    let (min_value, max_value) = (number(keys.min_value), number(keys.max_value));
    let (default_value, max_error) = (number(keys.default_value), number(keys.max_error));
    Some(Supplement {
        control_type: keys.control_type.and_then(|at| findings.word(&at, &CONTROL_TYPES)),
        granularity: keys
            .granularity
            .and_then(|at| findings.positive(&at, "a number above 0, in the device's unit")),
        unit: keys.unit.and_then(|at| findings.text(&at, "a unit such as deg").map(Into::into)),
        max_number_of_steps: keys.max_number_of_steps.and_then(|at| findings.count(&at, 1, u32::MAX)),
        interpolation: keys.interpolation.and_then(|at| findings.word(&at, &INTERPOLATIONS)),
        min_value,
        max_value,
        default_value,
        max_error,
        script_queue: keys.script_queue.and_then(|at| findings.count(&at, 1, u32::MAX)),
    })
}
