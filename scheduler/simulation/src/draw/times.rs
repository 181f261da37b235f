//! Draws missions in which acts wait for times of day around a clock change: times that the clocks skip, times that they show twice, and
//! times on another day. One seed in fifty is such a mission.

use chrono::{FixedOffset, Offset, Utc};
use downbeat_mission::zone::Zone;
use downbeat_plan::Wait;
use downbeat_rehearsal::dry_run::BEGIN;
use fastrand::Rng;
use urrcp::{Server, Span, Timestamp};

use super::{Drawn, millis, one_in};

/// The length of a day.
const DAY: Span = Span::from_millis(24 * 3_600_000);
/// When the operator stops the mission, as the time since its start. Without this stop, an act may wait until the next day.
const ENDS_AT: Span = Span::from_millis(15_000);
/// The maximum time between a clock change and a time of day that the clocks skip or show twice, in milliseconds.
const AROUND_MAX: i64 = 3_000;

/// A change of the local time, as at the start and end of daylight saving time.
#[derive(Clone, Copy, Debug)]
pub struct ClockChange {
    /// Time of the change, relative to the start of the mission.
    pub after: Span,
    /// The UTC offset before the change, in seconds.
    pub before_s: i32,
    /// The UTC offset after the change, in seconds.
    pub after_s: i32,
}

impl ClockChange {
    /// All clock changes. Most are smaller than real changes, so that a mission reaches the times on both sides. The mission begins at
    /// midnight UTC, so that some changes also change the date.
    pub const ALL: [Self; 8] = [
        Self::new(1_500, 3_600, 7_200),
        Self::new(3_000, 7_200, 3_600),
        Self::new(2_000, 0, 3),
        Self::new(4_000, 3, 0),
        Self::new(2_000, -2, 1),
        Self::new(4_000, -4, -7),
        Self::new(1_000, 34_200, 36_000),
        Self::new(5_000, 39_600, 37_800),
    ];

    const fn new(after_ms: i64, before_s: i32, after_s: i32) -> Self {
        Self { after: Span::from_millis(after_ms), before_s, after_s }
    }

    /// The instant of the change.
    #[must_use]
    pub fn at(self) -> Timestamp<Server> {
        BEGIN + self.after
    }

    /// The local time of day at an instant, as the time since midnight.
    #[must_use]
    pub fn time_of_day(self, at: Timestamp<Server>) -> Span {
        let offset = if at < self.at() { self.before_s } else { self.after_s };
        let shown = at - Timestamp::from_nanos(0) + Span::from_millis(i64::from(offset) * 1_000);
        Span::from_nanos(shown.as_nanos().rem_euclid(DAY.as_nanos()))
    }

    /// The amount by which the clocks are set forward; negative if they are set back.
    #[must_use]
    pub fn forward(self) -> Span {
        Span::from_millis(i64::from(self.after_s - self.before_s) * 1_000)
    }
}

/// Returns the time zone of a mission. A time zone is a function without data, so each clock change has its own function.
pub(crate) fn zone(change: Option<usize>) -> Zone {
    const fn of<const INDEX: usize>() -> Zone {
        Zone::new(|at| {
            let change = ClockChange::ALL[INDEX];
            let offset = if at < change.at() { change.before_s } else { change.after_s };
            FixedOffset::east_opt(offset).unwrap_or_else(|| Utc.fix())
        })
    }
    const ZONES: [Zone; ClockChange::ALL.len()] =
        [of::<0>(), of::<1>(), of::<2>(), of::<3>(), of::<4>(), of::<5>(), of::<6>(), of::<7>()];
    change.map_or(Zone::UTC, |change| ZONES[change])
}

/// Makes one act or all acts wait for times of day around a clock change.
pub(super) fn wait_for_times(rng: &mut Rng, mut drawn: Drawn) -> Drawn {
    let index = rng.usize(0..ClockChange::ALL.len());
    let change = ClockChange::ALL[index];
    let (acts, all) = (drawn.choreography.acts.len(), one_in(rng, 3));
    let only = rng.usize(0..acts);
    for act in (0..acts).filter(|act| all || *act == only) {
        let forward = change.forward();
        let time = if one_in(rng, 3) {
            // The clocks skip the time or show it twice.
            let largest = forward.abs().as_nanos().min(AROUND_MAX * 1_000_000);
            let off = Span::from_nanos(rng.i64(0..largest));
            let last = change.time_of_day(change.at() - Span::from_nanos(1)) + Span::from_nanos(1);
            if forward > Span::ZERO { last + off } else { last - off }
        } else {
            change.time_of_day(BEGIN + millis(rng, 500, 9_000))
        };
        let time = Span::from_nanos(time.as_nanos().rem_euclid(DAY.as_nanos()));
        drawn.choreography.acts[act].wait = Wait::TimeOfDay(Span::from_millis(time.as_nanos() / 1_000_000));
        drawn.choreography.acts[act].timeout = None;
    }
    (drawn.clock_change, drawn.ends_at) = (Some(index), Some(ENDS_AT));
    drawn
}

#[cfg(test)]
mod tests {
    use super::super::{FAMILIES, TIMES, reached};
    use crate::Situation::{AtItsTime, AtSkippedTime, AtTimeShownTwice, WaitsForAnotherDay};

    #[test]
    fn acts_start_at_clock_times_shown_once_twice_or_skipped() {
        let reached = reached((TIMES, 20_000), FAMILIES);
        for situation in [AtItsTime, AtTimeShownTwice, AtSkippedTime, WaitsForAnotherDay] {
            assert!(reached.contains_key(&situation), "{situation}");
        }
    }
}
