//! The limits of the protocol, and the error for a value that exceeds a limit.

use thiserror::Error;

/// Largest number of characters in any string (paper, steps 4 and 5).
pub const STRING_CHARS_MAX: usize = 256;
/// Largest number of devices in an initialization block (paper, step 4). The smallest number is 1.
pub const DEVICES_MAX: usize = 32_000;
/// Largest number of values `control_value`, `control_value_2` ... of one command (our limit, not in the paper).
pub const CONTROL_VALUES_MAX: usize = 256;
/// Largest number of values in the parameters of one custom control type (our limit, not in the paper).
pub const PARAMETERS_MAX: usize = 4_096;
/// Largest total number of values in the parameters of a robot's custom control types (our limit, not in the paper). Each dictionary
/// itself also counts as a value.
pub const ROBOT_PARAMETERS_MAX: usize = 262_144;
/// Largest number of encodings that a robot lists (our limit, not in the paper).
pub const ENCODINGS_MAX: usize = 64;
/// Largest number of steps in one script (our limit, not in the paper). A line of [`LINE_BYTES_MAX`] bytes can contain about as many
/// steps. Frames have the same limit, although their steps are shorter, so that scripts from frames do not need more memory.
pub const SCRIPT_STEPS_MAX: usize = 262_144;
/// Largest number of requests in one inquiry, and of devices in one inquiry (our limit, not in the paper). It equals the maximum number
/// of devices of a robot.
pub const INQUIRY_NAMES_MAX: usize = DEVICES_MAX;
/// Length in bytes of the longest line that a decoder accepts by default (our limit, not in the paper): 16 MiB.
pub const LINE_BYTES_MAX: usize = 16 * 1024 * 1024;
/// Largest offset or period in milliseconds (our limit, not in the paper): 1e11 ms, a little over three years.
pub const OFFSET_MS_MAX: f64 = 1e11;

/// Largest actuation latency of a device, and largest spread of a latency, in milliseconds (our limit, not in the paper).
pub const LATENCY_MS_MAX: f64 = 10_000.0;

/// The error for a value that is outside the limits of the protocol.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum LimitError {
    /// A string is longer than [`STRING_CHARS_MAX`].
    #[error("a string of {chars} characters, expected at most {STRING_CHARS_MAX}")]
    StringTooLong {
        /// The length of the string in characters.
        chars: usize,
    },
    /// An identifier is empty.
    #[error("an empty identifier, expected 1 to {STRING_CHARS_MAX} characters")]
    EmptyIdentifier,
    /// A number is infinite or not a number.
    #[error("expected a finite number")]
    NotFinite,
    /// An offset or period is negative or exceeds [`OFFSET_MS_MAX`].
    #[error("{millis} ms, expected 0 to {OFFSET_MS_MAX} ms")]
    OffsetOutOfRange {
        /// The invalid number of milliseconds.
        millis: f64,
    },
    /// An initialization block lists no device or too many devices.
    #[error("{count} devices, expected 1 to {DEVICES_MAX}")]
    DeviceCount {
        /// The number of listed devices.
        count: usize,
    },
    /// Two devices of one robot have the same id.
    #[error("duplicate device id `{id}`, expected a unique id for each device of a robot")]
    DuplicateDevice {
        /// The id that occurs more than once.
        id: String,
    },
    /// A custom control type has more than [`PARAMETERS_MAX`] values.
    #[error("more than {PARAMETERS_MAX} values in the parameters of one control type")]
    ParameterCount,
    /// The custom control types of a robot have more than [`ROBOT_PARAMETERS_MAX`] values in total.
    #[error("more than {ROBOT_PARAMETERS_MAX} values in the parameters of all custom control types")]
    RobotParameterCount,
    /// A robot lists more than [`ENCODINGS_MAX`] encodings.
    #[error("more than {ENCODINGS_MAX} encodings")]
    EncodingCount,
    /// A script has more than [`SCRIPT_STEPS_MAX`] steps.
    #[error("more than {SCRIPT_STEPS_MAX} steps in one script")]
    StepCount,
    /// An inquiry names more than [`INQUIRY_NAMES_MAX`] requests or devices.
    #[error("more than {INQUIRY_NAMES_MAX} names in one inquiry")]
    NameCount,
    /// A device's default value is outside its range.
    #[error("default_value {value} of device `{id}` is out of range, expected {min} to {max}")]
    DefaultValue {
        /// The id of the device.
        id: String,
        /// The default value of the device.
        value: f64,
        /// Lower bound of the range of the primary control type.
        min: f64,
        /// Upper bound of the range.
        max: f64,
    },
    /// A count that must be at least 1 is 0.
    #[error("{key} is 0, expected at least 1")]
    NoneAtAll {
        /// The key of the count in the message.
        key: &'static str,
    },
    /// An actuation latency, or its spread, is negative or exceeds [`LATENCY_MS_MAX`].
    #[error("a latency of {millis} ms, expected 0 to {LATENCY_MS_MAX} ms")]
    Latency {
        /// The invalid number of milliseconds.
        millis: f64,
    },
    /// A device has a latency spread, but no latency.
    #[error("`latency_spread` of device `{id}` requires a `latency`")]
    SpreadAlone {
        /// The id of the device.
        id: String,
    },
    /// The lower bound of a range exceeds the upper bound.
    #[error("min_value {min} is greater than max_value {max}")]
    EmptyRange {
        /// Lower bound of the range.
        min: f64,
        /// Upper bound of the range.
        max: f64,
    },
    /// No value is both a multiple of the granularity and within the limits.
    #[error(
        "no multiple of the granularity {granularity} lies between min_value {min} and max_value {max}: the device has no \
         settable value"
    )]
    NoMultiple {
        /// The granularity.
        granularity: f64,
        /// Lower bound of the range.
        min: f64,
        /// Upper bound of the range.
        max: f64,
    },
    /// A granularity is not positive.
    #[error("invalid granularity {granularity}, expected a finite number above 0")]
    Granularity {
        /// The invalid granularity.
        granularity: f64,
    },
    /// A bound on an error or delay is negative.
    #[error("invalid {key} {value}, expected a finite number of at least 0")]
    Negative {
        /// The key of the parameter in the message.
        key: &'static str,
        /// The invalid value.
        value: f64,
    },
    /// A script step has an earlier offset than the previous step.
    #[error("step {} is at {millis} ms, before the previous step at {previous} ms", .step + 1)]
    StepsOutOfOrder {
        /// Index of the step, from 0.
        step: usize,
        /// The offset of the step in milliseconds.
        millis: f64,
        /// The offset of the previous step in milliseconds.
        previous: f64,
    },
    /// The protocol has no control type with the given name.
    #[error(
        "unknown control type `{name}`, expected position, speed, acceleration, script, sensor or custom_N"
    )]
    ControlType {
        /// The unknown name.
        name: String,
    },
}
