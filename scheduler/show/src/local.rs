//! Formats times for people: in local time, to the millisecond. JSON contains nanoseconds in UTC instead.

use chrono::{DateTime, Local};
use urrcp::{Server, Timestamp};

use downbeat_mission::zone::Zone;

/// The time zone of this machine, or the time zone that the environment variable `TZ` names.
pub const ZONE: Zone =
    Zone::new(|at| *DateTime::from_timestamp_nanos(at.as_nanos()).with_timezone(&Local).offset());

/// Formats the local time of day: `19:30:00.412`.
#[must_use]
pub fn time_of_day(at: Timestamp<Server>) -> String {
    ZONE.time_of_day(at)
}

/// Formats the local time of day, followed by the date if it differs from the date of `today`: `03:30:00.000 on 28 Mar 2027`.
#[must_use]
pub fn time_as_of(at: Timestamp<Server>, today: Timestamp<Server>) -> String {
    ZONE.time_as_of(at, today)
}

/// Formats the local time of day to the second: `19:30:00`.
#[must_use]
pub fn seconds_of_day(at: Timestamp<Server>) -> String {
    ZONE.seconds_of_day(at)
}

/// Formats the date and the local time of day: `22 Nov 2026, 19:30:00.412`.
#[must_use]
pub fn date_and_time(at: Timestamp<Server>) -> String {
    ZONE.date_and_time(at)
}
