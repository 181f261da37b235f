//! Describes the conditions that acts wait for before they start.

use downbeat_scripts::{SensorRange, Wait};

/// Returns the start condition of an act as text. Returns an empty text if the act follows the previous one immediately.
#[must_use]
pub fn waits(wait: &Wait) -> String {
    match wait {
        Wait::Operator => "the operator".to_owned(),
        Wait::Instant(at) => at.to_string(),
        Wait::TimeOfDay(time) => format!("{time} after midnight"),
        Wait::Sensor { robot, sensor, range } => match range {
            SensorRange::Above(bound) => format!("{robot}/{sensor} above {bound}"),
            SensorRange::Below(bound) => format!("{robot}/{sensor} below {bound}"),
            SensorRange::Within(least, most) => format!("{robot}/{sensor} from {least} to {most}"),
        },
        Wait::Done => String::new(),
    }
}
