//! What an act waits for before it is sent.

use downbeat_scripts::{Wait, Way};
use urrcp::{Server, Span, Timestamp};

use super::act::{ActRun, Stage};
use super::robot_state::Reading;
use super::{Mission, Progress};

/// Between two readings of a sensor that an act waits for.
const POLL: Span = Span::from_millis(100);
const DAY: Span = Span::from_millis(24 * 3_600 * 1_000);

impl Mission {
    /// Looks whether the condition of an act holds.
    pub(super) fn check_wait(&mut self, now: Timestamp<Server>, index: usize) {
        let run = &self.runs[index];
        let act = &self.choreography.acts[run.act];
        let before = self.runs[..index].last().and_then(|run| run.timing.as_ref()).map(|timing| timing.end);
        if let Some(target) = self.fixed_target(run) {
            // An act begins when the one before it has ended, however early it was meant to.
            return self.ready(index, Some(before.map_or(target, |end| end.max(target))));
        }
        if act.wait == Wait::Done {
            return self.ready(index, before);
        }
        let Some(alone_since) = run.alone_since else { return };
        if act.timeout.is_some_and(|timeout| now >= alone_since + timeout) {
            let way = act.on_timeout;
            self.runs.remove(index);
            return self.go_way(now, way);
        }
        match &act.wait {
            Wait::Operator if run.gone => self.ready(index, None),
            Wait::Sensor { robot, sensor, .. } => {
                if run.poll.is_some_and(|at| now < at) {
                    return;
                }
                let (number, robot, sensor) = (run.number, robot.clone(), sensor.clone());
                self.runs[index].poll = Some(now + POLL);
                let whose = self.robots.iter().position(|state| state.id.as_str() == robot);
                if let (Some(robot), Ok(sensor)) = (whose, sensor.parse()) {
                    // An answer that was lost must not be waited for.
                    self.robots[robot].reads.retain(|_, what| *what != Reading::Wait(number));
                    self.read(now, robot, sensor, Reading::Wait(number));
                }
            }
            _ => {}
        }
    }

    fn ready(&mut self, index: usize, target: Option<Timestamp<Server>>) {
        let run = &mut self.runs[index];
        run.target = target;
        run.poll = None;
        run.stage = Stage::Ready;
    }

    /// The instant that the operator or the scenario wants.
    fn fixed_target(&self, run: &ActRun) -> Option<Timestamp<Server>> {
        if let Some(at) = self.options.start_at.filter(|_| run.number == 0) {
            return Some(at);
        }
        match &self.choreography.acts[run.act].wait {
            Wait::Instant(at) => Some(*at),
            Wait::TimeOfDay(time) => Some(next_time_of_day(run.since, *time, self.options.utc_offset)),
            Wait::Done | Wait::Operator | Wait::Sensor { .. } => None,
        }
    }

    pub(super) fn wait_wakeup(&self, run: &ActRun) -> Option<Timestamp<Server>> {
        let timeout = self.choreography.acts[run.act].timeout;
        let over = run.alone_since.zip(timeout).map(|(since, timeout)| since + timeout);
        over.into_iter().chain(run.poll).min()
    }

    /// A reading came for which an act waits.
    pub(super) fn wait_reading(&mut self, now: Timestamp<Server>, number: u32, value: Option<f64>) {
        let Some(index) = self.runs.iter().position(|run| run.number == number) else { return };
        let run = &self.runs[index];
        let Wait::Sensor { range, .. } = &self.choreography.acts[run.act].wait else { return };
        if run.stage == Stage::Waiting && value.is_some_and(|value| range.contains(value)) {
            self.ready(index, None);
            self.advance_run(now, index);
        }
    }

    /// The operator says go: it counts for the act that waits for it, and not ahead of that.
    pub(super) fn go(&mut self) {
        let waits = |run: &&mut ActRun| run.stage == Stage::Waiting && run.alone_since.is_some();
        if let Some(run) = self.runs.iter_mut().find(waits) {
            run.gone = true;
        }
    }

    pub(super) fn announce_wait(&mut self, index: usize) {
        let run = &self.runs[index];
        let act = &self.choreography.acts[run.act];
        let awaits = match (self.fixed_target(run), &act.wait) {
            (Some(at), _) => format!("{at}"),
            (None, Wait::Operator) => "the operator's go".to_owned(),
            (None, Wait::Sensor { robot, sensor, range }) => format!("`{robot}/{sensor}` {range}"),
            (None, _) => return,
        };
        let awaits = match (act.timeout, act.on_timeout) {
            (None, _) => awaits,
            (Some(timeout), Way::End) => format!("{awaits}, for {timeout} at most, then the end"),
            (Some(timeout), Way::Fail) => format!("{awaits}, for {timeout} at most"),
            (Some(timeout), Way::Act(other)) => {
                format!("{awaits}, for {timeout} at most, then `{}`", self.act_name(other))
            }
        };
        let act = self.act_name(run.act);
        self.tell(Progress::Waiting { act, awaits });
    }
}

/// The first instant from `from` on at which clocks show this time of day.
pub(crate) fn next_time_of_day(from: Timestamp<Server>, time: Span, utc_offset: Span) -> Timestamp<Server> {
    let local = from + utc_offset;
    let since_midnight = Span::from_nanos(local.as_nanos().rem_euclid(DAY.as_nanos()));
    let ahead = time - since_midnight;
    from + if ahead < Span::ZERO { ahead + DAY } else { ahead }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_of_day_is_today_or_tomorrow() {
        let hour = Span::from_millis(3_600_000);
        // 1970-01-02T10:00Z, where clocks show 12:00.
        let from = Timestamp::from_nanos((DAY + hour * 10).as_nanos());
        let offset = hour * 2;
        assert_eq!(next_time_of_day(from, hour * 13, offset), from + hour);
        assert_eq!(next_time_of_day(from, hour * 12, offset), from);
        assert_eq!(next_time_of_day(from, hour * 11, offset), from + hour * 23);
    }
}
