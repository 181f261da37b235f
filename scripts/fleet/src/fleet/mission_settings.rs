//! Reads the keys of a robot in the fleet file that a mission uses: `clock`, `wake_up`, `encoding` and `require`. `latency.rs` reads
//! `latency`, and `calibration.rs` reads `calibrate`. The mission receives all of these in one struct, so a new key only has to be added
//! here and where it is used.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use urrcp::{DeviceId, Encoding, InitializationBlock, Span};

use super::{Calibration, DeviceLatency, Handshake, RobotKeys, sensor};
use crate::kinds;
use crate::sensor_range::{SensorRange, sensor_range};
use downbeat_reader::fields::{At, Reader};
use downbeat_reader::keys;
use downbeat_reader::keys::Kind;
use downbeat_yaml::finding::Code;
use downbeat_yaml::node::Node;
use downbeat_yaml::shown::shortened;

pub(super) const CLOCK_WORDS: [(&str, ClockMode); 2] =
    [("ntp", ClockMode::Ntp), ("measured", ClockMode::Measured)];
const ENCODINGS: [Encoding; 2] = [Encoding::Json, Encoding::MessagePack];

keys! {
    /// Acceptable readings.
    pub(crate) struct RangeKeys {
        /// Above this value.
        above: kinds::PLAIN_NUMBER,
        /// Below this value.
        below: kinds::PLAIN_NUMBER,
        /// From the first to the second value.
        within: Kind::List(&kinds::PLAIN_NUMBER, 2..=2),
    }
    also {"minProperties": 1, "maxProperties": 1}
}

/// The properties of a robot that a mission uses in addition to the initialization block.
#[derive(Clone, Debug, PartialEq)]
pub struct MissionSettings {
    /// How the robot's time is synchronized with the server's.
    pub clock: ClockMode,
    /// The largest delay with which the robot wakes up for a start. By default 1 ms, as for a timer of an ordinary operating system.
    pub wake_up: Span,
    /// The encoding of messages to the robot over TCP.
    pub encoding: Encoding,
    /// The readings that the robot's sensors must have before a mission.
    pub require: Vec<Requirement>,
    /// For each device whose latency is known, the time from a command to the first visible motion.
    pub latencies: BTreeMap<DeviceId, DeviceLatency>,
    /// How the latency of the robot's devices may be measured, and which sensors show their positions.
    pub calibrate: BTreeMap<DeviceId, Calibration>,
}

impl Default for MissionSettings {
    fn default() -> Self {
        let (clock, encoding) = (ClockMode::default(), Encoding::default());
        Self {
            clock,
            wake_up: Span::from_millis(1),
            encoding,
            require: Vec::new(),
            latencies: BTreeMap::new(),
            calibrate: BTreeMap::new(),
        }
    }
}

/// How a robot's time is synchronized with the server's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockMode {
    /// The robot and the server follow NTP; measurements only verify that they do.
    #[default]
    Ntp,
    /// The robot has no NTP. Times in messages to the robot are converted to the robot's own time.
    Measured,
}

/// The reading that a sensor must have before a mission.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Requirement {
    /// The id of the sensor.
    pub sensor: DeviceId,
    /// The acceptable readings of the sensor.
    pub range: SensorRange,
}

pub(super) fn read(
    findings: &mut Reader,
    keys: &RobotKeys<'_>,
    init: &InitializationBlock,
    handshake: Handshake,
) -> MissionSettings {
    let default = MissionSettings::default();
    let clock = keys.clock.and_then(|at| findings.word(&at, &CLOCK_WORDS));
    let wake_up = keys.wake_up.and_then(|at| findings.duration(&at));
    let encoding = keys.encoding.and_then(|at| read_encoding(findings, &at, init, handshake));
    let require = keys.require.map(|at| read_require(findings, &at, init, handshake));
    MissionSettings {
        clock: clock.unwrap_or(default.clock),
        wake_up: wake_up.unwrap_or(default.wake_up),
        encoding: encoding.unwrap_or(default.encoding),
        require: require.unwrap_or(default.require),
        ..default
    }
}

/// Reads the encoding of messages. Without a handshake, also checks that the initialization block lists the encoding. In a handshake, the
/// robot itself lists the encodings that it understands.
fn read_encoding(
    findings: &mut Reader,
    at: &At<'_>,
    init: &InitializationBlock,
    handshake: Handshake,
) -> Option<Encoding> {
    let words = ENCODINGS.map(|encoding| (encoding.as_str(), encoding));
    let encoding = findings.word(at, &words)?;
    if handshake == Handshake::Skip && !init.understands(encoding) {
        findings.add(
            Code::InitializationBlock,
            at.place(),
            format!("the robot does not list the encoding `{encoding}`"),
            format!("`json`, or `encodings: [{encoding}]` in its initialization block"),
            Some("with `handshake: skip`, only the init file states the encodings of the robot".to_owned()),
        );
    }
    Some(encoding)
}

/// Reads `require`, such as `{battery: above 30}` or `{battery: {within: [20, 80]}}`.
fn read_require(
    findings: &mut Reader,
    at: &At<'_>,
    init: &InitializationBlock,
    handshake: Handshake,
) -> Vec<Requirement> {
    if handshake == Handshake::Skip {
        let hint = Some("remove `handshake: skip`, or remove `require`".to_owned());
        let message = "`require` is not supported with `handshake: skip`: no sensor is read before the start";
        findings.add(
            Code::NeedsHandshake,
            at.key_place(),
            message,
            "`require` only with `handshake: full`",
            hint,
        );
    }
    let mut required = Vec::new();
    for (name, at) in findings.entries(at, "a map from each sensor to its required reading") {
        let range = read_range(findings, &at);
        let sensor = sensor(findings, name, &at, init);
        required.extend(sensor.zip(range).map(|(sensor, range)| Requirement { sensor, range }));
    }
    required
}

fn read_range(findings: &mut Reader, at: &At<'_>) -> Option<SensorRange> {
    let expected = "`above` or `below` with a number, or {within: [least, largest]}";
    if let Node::Map(_) = at.node {
        let RangeKeys { above, below, within } = findings.keys(at, "the readings")?;
        return sensor_range(findings, at, [above, below, within]);
    }
    let text = findings.text(at, expected)?;
    let words: Vec<&str> = text.split_whitespace().collect();
    let range = match words.as_slice() {
        ["above", bound] => bound.parse().ok().map(SensorRange::Above),
        ["below", bound] => bound.parse().ok().map(SensorRange::Below),
        _ => None,
    };
    if range.is_none() {
        let message = format!("`{}` is not a valid range of sensor readings", shortened(&text));
        let hint = text.trim().split_at_checked(1).and_then(|(sign, bound)| {
            let word = if sign == ">" { "above" } else { "below" };
            let bound = bound.trim_start_matches('=').trim();
            (matches!(sign, "<" | ">") && bound.parse::<f64>().is_ok())
                .then(|| format!("write `{word} {bound}`"))
        });
        findings.add(Code::UnknownWord, at.place(), message, expected, hint);
    }
    range
}
