//! Local times by the rules of the relevant day: the instants at which the clocks show a given time, and the time that they show at a
//! given instant. The caller specifies the time zone, because virtual time has none of its own.

use chrono::{DateTime, Days, FixedOffset, NaiveDateTime, NaiveTime, Offset, SecondsFormat, TimeDelta, Utc};
use urrcp::{Server, Span, Timestamp};

const DAY: Span = Span::from_millis(24 * 3_600 * 1_000);
const DATE: &str = "%-d %b %Y";
/// Format of a time of day, to the millisecond.
const TIME_OF_DAY: &str = "%H:%M:%S%.3f";

/// The rules of a time zone.
#[derive(Clone, Copy, Debug)]
pub struct Zone {
    offset: fn(Timestamp<Server>) -> FixedOffset,
}

/// A time of day that the clocks skip because they are set forward.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{} does not exist on {}: clocks jump from {} to {}",
    .wanted.time(), .wanted.format(DATE), .before.time(), .after.time()
)]
pub struct SkippedTime {
    wanted: NaiveDateTime,
    before: NaiveDateTime,
    after: NaiveDateTime,
    /// The instant at which the clocks skip that time.
    pub at: Timestamp<Server>,
}

impl Zone {
    /// The time zone UTC.
    pub const UTC: Self = Self::new(|_| Utc.fix());

    /// The time zone whose UTC offset at each instant is returned by `offset`.
    #[must_use]
    pub const fn new(offset: fn(Timestamp<Server>) -> FixedOffset) -> Self {
        Self { offset }
    }

    /// The first instant, `from` or later, at which the clocks show a time of day. `time` is the time since midnight.
    ///
    /// # Errors
    /// Fails if the clocks skip this time on the next day on which they would show it.
    pub fn next(self, from: Timestamp<Server>, time: Span) -> Result<Timestamp<Server>, SkippedTime> {
        // If the clocks are set back at midnight, they show times of the previous day again.
        let mut date = self.local(from).date_naive() - Days::new(1);
        loop {
            let wanted = date.and_time(NaiveTime::MIN) + TimeDelta::nanoseconds(time.as_nanos());
            let instants = self.instants(wanted);
            if let Some(at) = instants.iter().find(|at| **at >= from) {
                return Ok(*at);
            }
            let skipped = instants.is_empty().then(|| self.skipped(wanted));
            if let Some(skipped) = skipped.filter(|skipped| skipped.at > from) {
                return Err(skipped);
            }
            date = date + Days::new(1);
        }
    }

    /// The other instant at which the clocks show the same date and time as at `at`, if they are set back in between.
    #[must_use]
    pub fn repeated(self, at: Timestamp<Server>) -> Option<Timestamp<Server>> {
        self.instants(self.local(at).naive_local()).into_iter().find(|other| *other != at)
    }

    /// The time of day, with its UTC offset if the clocks show it twice: `19:30:00.412`, `02:30:00.000 UTC+02:00`.
    #[must_use]
    pub fn time_of_day(self, at: Timestamp<Server>) -> String {
        let time = self.local(at).format(TIME_OF_DAY);
        match self.repeated(at) {
            Some(_) => format!("{time} UTC{}", (self.offset)(at)),
            None => time.to_string(),
        }
    }

    /// The time of day to the second: `19:30:00`.
    #[must_use]
    pub fn seconds_of_day(self, at: Timestamp<Server>) -> String {
        self.local(at).format("%H:%M:%S").to_string()
    }

    /// The time of day, and the date if it is not the date of `today`: `03:30:00.000 on 28 Mar 2027`.
    #[must_use]
    pub fn time_as_of(self, at: Timestamp<Server>, today: Timestamp<Server>) -> String {
        let date = self.local(at).date_naive();
        if date == self.local(today).date_naive() {
            self.time_of_day(at)
        } else {
            format!("{} on {}", self.time_of_day(at), date.format(DATE))
        }
    }

    /// The date and the time of day in the zone: `22 Nov 2026, 19:30:00.412`.
    #[must_use]
    pub fn date_and_time(self, at: Timestamp<Server>) -> String {
        format!("{}, {}", self.local(at).format(DATE), self.time_of_day(at))
    }

    /// The local time in RFC 3339: `2026-10-25T02:30:00+02:00`.
    #[must_use]
    pub fn rfc3339(self, at: Timestamp<Server>) -> String {
        self.local(at).to_rfc3339_opts(SecondsFormat::AutoSi, false)
    }

    fn local(self, at: Timestamp<Server>) -> DateTime<FixedOffset> {
        DateTime::from_timestamp_nanos(at.as_nanos()).with_timezone(&(self.offset)(at))
    }

    /// The instants at which the clocks show this date and time: two if they are set back, none if they skip it.
    fn instants(self, local: NaiveDateTime) -> Vec<Timestamp<Server>> {
        let mut instants = self.candidates(local).to_vec();
        instants.retain(|at| self.local(*at).naive_local() == local);
        instants.dedup();
        instants
    }

    /// The two instants at which the clocks would show this date and time: with the UTC offset of the previous day, and with that of the
    /// next day.
    fn candidates(self, local: NaiveDateTime) -> [Timestamp<Server>; 2] {
        let as_utc = Timestamp::from_nanos(local.and_utc().timestamp_nanos_opt().unwrap_or(i64::MAX));
        let ahead = |at| Span::from_millis(i64::from((self.offset)(at).local_minus_utc()) * 1_000);
        let candidates = [as_utc - DAY, as_utc + DAY].map(|at| as_utc - ahead(at));
        let shows = |at: &Timestamp<Server>| self.local(*at).naive_local() == local;
        debug_assert!(
            candidates.iter().any(shows) || candidates[0] != candidates[1],
            "clocks that do not show a time skip it between two offsets"
        );
        candidates
    }

    fn skipped(self, wanted: NaiveDateTime) -> SkippedTime {
        let [mut at, mut earlier] = self.candidates(wanted);
        let offset = (self.offset)(earlier);
        while at - earlier > Span::from_nanos(1) {
            let middle = earlier + (at - earlier) / 2;
            if (self.offset)(middle) == offset {
                earlier = middle;
            } else {
                at = middle;
            }
        }
        let after = self.local(at);
        SkippedTime {
            wanted,
            before: after.with_timezone(&offset).naive_local(),
            after: after.naive_local(),
            at,
        }
    }
}

impl SkippedTime {
    /// The nearest times to the skipped one that the clocks show, to the second.
    #[must_use]
    pub fn nearest(&self) -> String {
        format!("{} and {}", (self.before - TimeDelta::seconds(1)).time(), self.after.time())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR: Span = Span::from_millis(3_600_000);
    const MINUTE: Span = Span::from_millis(60_000);

    fn at(text: &str) -> Timestamp<Server> {
        serde_json::from_value(text.into()).unwrap()
    }

    fn east(minutes: i32) -> FixedOffset {
        FixedOffset::east_opt(minutes * 60).unwrap()
    }

    /// The clocks go forward in spring from 02:00 to 03:00, and back in autumn from 03:00 to 02:00.
    const BERLIN: Zone = Zone::new(|instant| {
        let summers = [
            ("2026-03-29T01:00:00Z", "2026-10-25T01:00:00Z"),
            ("2027-03-28T01:00:00Z", "2027-10-31T01:00:00Z"),
        ];
        let summer = summers.iter().any(|(begin, end)| instant >= at(begin) && instant < at(end));
        east(if summer { 120 } else { 60 })
    });

    /// The clocks go back one minute after midnight, to 23:01 of the previous day.
    const ST_JOHNS: Zone =
        Zone::new(|instant| east(if instant < at("2006-10-29T02:31:00Z") { -150 } else { -210 }));

    #[track_caller]
    fn check(zone: Zone, from: &str, hour: i64, minute: i64, next: &str) {
        assert_eq!(zone.next(at(from), HOUR * hour + MINUTE * minute), Ok(at(next)));
    }

    #[test]
    fn time_of_day_is_today_or_tomorrow() {
        check(BERLIN, "2026-07-01T10:00:00Z", 13, 0, "2026-07-01T11:00:00Z");
        check(BERLIN, "2026-07-01T10:00:00Z", 12, 0, "2026-07-01T10:00:00Z");
        check(BERLIN, "2026-07-01T10:00:00Z", 11, 59, "2026-07-02T09:59:00Z");
        // If clocks are ahead of UTC, it is already tomorrow.
        check(BERLIN, "2026-07-01T22:30:00Z", 0, 45, "2026-07-01T22:45:00Z");
        check(Zone::UTC, "2026-07-01T22:30:00Z", 0, 45, "2026-07-02T00:45:00Z");
    }

    #[test]
    fn time_across_a_clock_change_follows_the_rules_of_its_own_date() {
        check(BERLIN, "2027-03-27T20:00:00Z", 3, 30, "2027-03-28T01:30:00Z");
        check(BERLIN, "2027-03-27T20:00:00Z", 1, 30, "2027-03-28T00:30:00Z");
        check(BERLIN, "2027-03-28T00:30:00Z", 3, 0, "2027-03-28T01:00:00Z");
        check(BERLIN, "2026-10-24T20:00:00Z", 3, 30, "2026-10-25T02:30:00Z");
        check(BERLIN, "2026-10-24T20:00:00Z", 19, 0, "2026-10-25T18:00:00Z");
    }

    #[test]
    fn skipped_time_is_refused_with_the_nearest_valid_times() {
        let skipped = BERLIN.next(at("2027-03-27T20:00:00Z"), HOUR * 2 + MINUTE * 30).unwrap_err();
        assert_eq!(
            skipped.to_string(),
            "02:30:00 does not exist on 28 Mar 2027: clocks jump from 02:00:00 to 03:00:00"
        );
        assert_eq!(skipped.nearest(), "01:59:59 and 03:00:00");
        assert_eq!(skipped.at, at("2027-03-28T01:00:00Z"));
        assert!(BERLIN.next(at("2027-03-27T20:00:00Z"), HOUR * 2).is_err());
    }

    #[test]
    fn time_just_skipped_by_clocks_is_tomorrow() {
        check(BERLIN, "2027-03-28T01:00:00Z", 2, 30, "2027-03-29T00:30:00Z");
        // Today's 02:30 has passed, and the clocks skip tomorrow's.
        assert!(BERLIN.next(at("2027-03-27T01:31:00Z"), HOUR * 2 + MINUTE * 30).is_err());
    }

    #[test]
    fn first_future_occurrence_of_a_repeated_time_is_used() {
        let [first, second] = ["2026-10-25T00:30:00Z", "2026-10-25T01:30:00Z"];
        check(BERLIN, "2026-10-24T20:00:00Z", 2, 30, first);
        check(BERLIN, first, 2, 30, first);
        check(BERLIN, "2026-10-25T00:30:01Z", 2, 30, second);
        check(BERLIN, "2026-10-25T01:30:01Z", 2, 30, "2026-10-26T01:30:00Z");
        assert_eq!(BERLIN.repeated(at(first)), Some(at(second)));
        assert_eq!(BERLIN.repeated(at(second)), Some(at(first)));
        assert_eq!(BERLIN.repeated(at("2026-10-25T02:00:00Z")), None);
    }

    #[test]
    fn clocks_set_back_at_midnight_repeat_times_of_the_previous_day() {
        check(ST_JOHNS, "2006-10-29T02:30:30Z", 23, 30, "2006-10-29T03:00:00Z");
        check(ST_JOHNS, "2006-10-29T02:40:00Z", 0, 0, "2006-10-29T03:30:00Z");
    }

    #[test]
    fn time_is_shown_by_rules_of_its_date_and_with_date_if_on_another_day() {
        let (eve, day) = (at("2027-03-27T20:00:00Z"), at("2027-03-28T01:30:00Z"));
        assert_eq!(BERLIN.time_as_of(eve, eve), "21:00:00.000");
        assert_eq!(BERLIN.time_as_of(day, eve), "03:30:00.000 on 28 Mar 2027");
        assert_eq!(BERLIN.time_as_of(day, at("2027-03-27T23:00:00Z")), "03:30:00.000");
        assert_eq!(BERLIN.date_and_time(day), "28 Mar 2027, 03:30:00.000");
    }

    #[test]
    fn repeated_time_is_shown_with_its_utc_offset() {
        let [first, second] = ["2026-10-25T00:30:00Z", "2026-10-25T01:30:00Z"].map(at);
        assert_eq!(BERLIN.time_of_day(first), "02:30:00.000 UTC+02:00");
        assert_eq!(BERLIN.time_of_day(second), "02:30:00.000 UTC+01:00");
        assert_eq!(BERLIN.rfc3339(second), "2026-10-25T02:30:00+01:00");
        let eve = at("2026-10-24T20:00:00Z");
        assert_eq!(BERLIN.time_as_of(first, eve), "02:30:00.000 UTC+02:00 on 25 Oct 2026");
    }
}
