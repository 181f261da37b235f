//! The acceptable readings of a sensor that an act waits for, or that a robot must have before a mission.

use serde::{Deserialize, Serialize};

use downbeat_reader::fields::{At, Reader};
use downbeat_yaml::finding::{Code, names};
use downbeat_yaml::node::Node;

/// The acceptable readings of a sensor, in its unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorRange {
    /// Readings above this value.
    Above(f64),
    /// Readings below this value.
    Below(f64),
    /// Readings from the first to the second value, inclusive.
    Within(f64, f64),
}

impl std::fmt::Display for SensorRange {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Above(bound) => write!(f, "above {bound}"),
            Self::Below(bound) => write!(f, "below {bound}"),
            Self::Within(least, largest) => write!(f, "within {least} and {largest}"),
        }
    }
}

impl SensorRange {
    /// Whether a reading is acceptable.
    #[must_use]
    pub fn contains(self, reading: f64) -> bool {
        match self {
            Self::Above(bound) => reading > bound,
            Self::Below(bound) => reading < bound,
            Self::Within(least, largest) => reading >= least && reading <= largest,
        }
    }
}

/// Reads a range of readings from exactly one of the keys `above`, `below` and `within`.
pub fn sensor_range(
    reader: &mut Reader,
    at: &At<'_>,
    [above, below, within]: [Option<At<'_>>; 3],
) -> Option<SensorRange> {
    let mut bound = |at: &At<'_>| reader.number(at, "a number in the sensor's unit");
    match (above, below, within) {
        (Some(at), None, None) => bound(&at).map(SensorRange::Above),
        (None, Some(at), None) => bound(&at).map(SensorRange::Below),
        (None, None, Some(at)) => {
            let bounds = reader.list(&at, "the minimum and maximum reading, such as [0.2, 0.5]");
            let [least, largest] = bounds.as_slice() else {
                if !matches!(at.node, Node::List(_)) {
                    return None;
                }
                let expected = "the minimum and maximum reading, such as [0.2, 0.5]";
                reader.add(
                    Code::WrongType,
                    at.place(),
                    format!("found {} entries", bounds.len()),
                    expected,
                    None,
                );
                return None;
            };
            let (least, largest) = (reader.number(least, "a number")?, reader.number(largest, "a number")?);
            if least > largest {
                let message = format!("the minimum {least} is larger than the maximum {largest}");
                let hint = Some(format!("write `[{largest}, {least}]`"));
                reader.add(Code::WrongType, at.place(), message, "the smaller reading first", hint);
                return None;
            }
            Some(SensorRange::Within(least, largest))
        }
        (above, below, _) => {
            let expected = names(["above", "below", "within"]);
            let message = "the sensor has no range, or more than one";
            let number = |at: Option<At<'_>>| match at?.node {
                Node::Number(value) => Some(*value),
                _ => None,
            };
            let hint = match (number(above), number(below)) {
                (Some(least), Some(largest)) if least <= largest => {
                    format!("write `within: [{least}, {largest}]`")
                }
                _ => "add the range of readings, as in `below: 0.5`".to_owned(),
            };
            let hint = Some(hint);
            reader.add(Code::MissingKey, at.place(), message, format!("exactly one of {expected}"), hint);
            None
        }
    }
}
