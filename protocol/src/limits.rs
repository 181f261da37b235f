//! The limits that the protocol sets, and the error for a value beyond one.

use thiserror::Error;

/// Largest number of characters in any string (paper, steps 4 and 5).
pub const STRING_CHARS_MAX: usize = 256;
/// Largest number of devices in an initialization block (paper, step 4); the smallest is 1.
pub const DEVICES_MAX: usize = 32_000;
/// Largest number of input parameters `control_value`, `control_value_2` ... of one command (ours).
pub const CONTROL_VALUES_MAX: usize = 256;
/// Largest number of values in the parameters of one custom control type (ours).
pub const PARAMETERS_MAX: usize = 4_096;
/// Largest number of values in the parameters of all custom control types of one robot (ours), each dictionary counted as well.
pub const ROBOT_PARAMETERS_MAX: usize = 262_144;
/// Largest number of encodings that a robot lists (ours).
pub const ENCODINGS_MAX: usize = 64;
/// Largest number of steps of one script on the wire (ours): as many as a line of [`LINE_BYTES_MAX`] may hold. A frame,
/// whose steps are shorter, holds no more, so that a message takes no more memory for coming in one.
pub const SCRIPT_STEPS_MAX: usize = 262_144;
/// Largest number of requests, and of devices, that one inquiry names (ours): as many as a robot has devices.
pub const INQUIRY_NAMES_MAX: usize = DEVICES_MAX;
/// Largest line that a decoder accepts unless told otherwise, in bytes (ours): 16 MiB.
pub const LINE_BYTES_MAX: usize = 16 * 1024 * 1024;
/// Largest offset or period in milliseconds (ours): 1e11 ms, a little over three years.
pub const OFFSET_MS_MAX: f64 = 1e11;

/// Longest actuation latency of a device, and largest spread of one, in milliseconds (ours).
pub const LATENCY_MS_MAX: f64 = 10_000.0;

/// A value lies outside what the protocol allows.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum LimitError {
    /// A string is longer than [`STRING_CHARS_MAX`].
    #[error("a string of {chars} characters, the limit is {STRING_CHARS_MAX}")]
    StringTooLong {
        /// Its length in characters.
        chars: usize,
    },
    /// An identifier is empty.
    #[error("an empty identifier, expected 1 to {STRING_CHARS_MAX} characters")]
    EmptyIdentifier,
    /// A number is infinite or not a number.
    #[error("a number that is not finite")]
    NotFinite,
    /// An offset or period is negative or beyond [`OFFSET_MS_MAX`].
    #[error("{millis} ms, expected 0 to {OFFSET_MS_MAX} ms")]
    OffsetOutOfRange {
        /// The offending number of milliseconds.
        millis: f64,
    },
    /// An initialization block lists no device or too many.
    #[error("{count} devices, expected 1 to {DEVICES_MAX}")]
    DeviceCount {
        /// How many it lists.
        count: usize,
    },
    /// Two devices of one robot bear the same id.
    #[error("the device id `{id}` stands twice, expected ids unique within the robot")]
    DuplicateDevice {
        /// The repeated id.
        id: String,
    },
    /// A custom control type has more than [`PARAMETERS_MAX`] values.
    #[error("more than {PARAMETERS_MAX} values in the parameters of one control type")]
    ParameterCount,
    /// The custom control types of a robot have more than [`ROBOT_PARAMETERS_MAX`] values together.
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
    /// A device's default state lies outside what it can take.
    #[error("default_value {value} of device `{id}`, expected {min} to {max}")]
    DefaultValue {
        /// Which device.
        id: String,
        /// Its default value.
        value: f64,
        /// Lower bound of its first control type.
        min: f64,
        /// Upper bound.
        max: f64,
    },
    /// A count that must be at least 1 is 0.
    #[error("{key} 0, expected at least 1")]
    NoneAtAll {
        /// The key of the count.
        key: &'static str,
    },
    /// An actuation latency, or its spread, is negative or beyond [`LATENCY_MS_MAX`].
    #[error("a latency of {millis} ms, expected 0 to {LATENCY_MS_MAX} ms")]
    Latency {
        /// The offending number of milliseconds.
        millis: f64,
    },
    /// A device has a spread of its latency, but no latency.
    #[error("`latency_spread` of device `{id}` without a `latency`")]
    SpreadAlone {
        /// Which device.
        id: String,
    },
    /// The lower bound lies above the upper one.
    #[error("min_value {min} lies above max_value {max}")]
    EmptyRange {
        /// Lower bound.
        min: f64,
        /// Upper bound.
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
        /// Lower bound.
        min: f64,
        /// Upper bound.
        max: f64,
    },
    /// A granularity is not positive.
    #[error("granularity {granularity}, expected a finite number above 0")]
    Granularity {
        /// The offending granularity.
        granularity: f64,
    },
    /// A bound on an error or delay is negative.
    #[error("{key} {value}, expected a finite number of at least 0")]
    Negative {
        /// Which parameter.
        key: &'static str,
        /// The offending value.
        value: f64,
    },
    /// A script's step starts before the step ahead of it.
    #[error("step {} is at {millis} ms, before the step ahead of it at {previous} ms", .step + 1)]
    StepsOutOfOrder {
        /// Index of the step, from 0.
        step: usize,
        /// Its offset.
        millis: f64,
        /// The offset of the step ahead.
        previous: f64,
    },
    /// The name of a control type is none that the protocol knows.
    #[error("control type `{name}`, expected position, speed, acceleration, script, sensor or custom_N")]
    ControlType {
        /// The unknown name.
        name: String,
    },
}
