//! Times for people: local, to the millisecond. Nanoseconds in UTC belong in JSON.

use chrono::{DateTime, Local};
use urrcp::{Server, Timestamp};

use downbeat_mission::zone::Zone;

/// The time zone of this machine, or the one that the environment variable `TZ` names.
pub const ZONE: Zone =
    Zone::new(|at| *DateTime::from_timestamp_nanos(at.as_nanos()).with_timezone(&Local).offset());

/// The time of day on this machine's clocks: `19:30:00.412`.
#[must_use]
pub fn time_of_day(at: Timestamp<Server>) -> String {
    ZONE.time_of_day(at)
}

/// The time of day, and the date if it is not the date of `today`: `03:30:00.000 on 28 Mar 2027`.
#[must_use]
pub fn time_as_of(at: Timestamp<Server>, today: Timestamp<Server>) -> String {
    ZONE.time_as_of(at, today)
}

/// The same to the second: `19:30:00`.
#[must_use]
pub fn seconds_of_day(at: Timestamp<Server>) -> String {
    ZONE.seconds_of_day(at)
}

/// With the date: `22 Nov 2026, 19:30:00.412`.
#[must_use]
pub fn date_and_time(at: Timestamp<Server>) -> String {
    ZONE.date_and_time(at)
}
