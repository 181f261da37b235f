//! Times as people read them: local, to the millisecond. Nanoseconds in UTC belong into JSON.

use chrono::{DateTime, Local};
use urrcp::{Span, Timestamp};

/// A time of day, to the millisecond.
const TIME_OF_DAY: &str = "%H:%M:%S%.3f";

fn local<C>(at: Timestamp<C>) -> DateTime<Local> {
    DateTime::from_timestamp_nanos(at.as_nanos()).with_timezone(&Local)
}

/// The time of day on this machine's clocks: `19:30:00.412`.
#[must_use]
pub fn time_of_day<C>(at: Timestamp<C>) -> String {
    local(at).format(TIME_OF_DAY).to_string()
}

/// The time of day where clocks are so far ahead of UTC.
pub(crate) fn time_of_day_at<C>(at: Timestamp<C>, utc_offset: Span) -> String {
    DateTime::from_timestamp_nanos((at + utc_offset).as_nanos()).format(TIME_OF_DAY).to_string()
}

/// The same to the second: `19:30:00`.
#[must_use]
pub fn seconds_of_day<C>(at: Timestamp<C>) -> String {
    local(at).format("%H:%M:%S").to_string()
}

/// With its date: `22 Nov 2026, 19:30:00.412`.
#[must_use]
pub fn date_and_time<C>(at: Timestamp<C>) -> String {
    local(at).format("%-d %b %Y, %H:%M:%S%.3f").to_string()
}
