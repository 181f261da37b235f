//! The condition that an act waits for before it is sent.

use downbeat_plan::{Wait, Way};
use urrcp::{Server, Span, Timestamp};

use super::{Act, ActAction, Stage, act_name};
use crate::robot_state::{Reading, Robots};
use crate::zone::SkippedTime;
use crate::{ActIndex, MissionOptions, Progress};

/// Interval between readings of a sensor that an act waits for.
const POLL: Span = Span::from_millis(100);

/// The state of an act whose condition does not hold yet.
#[derive(Clone, Debug, Default)]
pub(super) struct Waiting {
    /// Whether the operator has sent the go.
    go_received: bool,
    /// Whether the act's condition has been reported to the operator.
    announced: bool,
    /// The time of the next reading of the sensor that the act waits for.
    poll: Option<Timestamp<Server>>,
    /// The last reading of the sensor that the act waits for.
    read: Option<f64>,
}

impl Act {
    /// Checks whether the act's condition holds.
    pub(super) fn wait(
        &mut self,
        now: Timestamp<Server>,
        robots: &Robots,
        options: &MissionOptions,
    ) -> Vec<ActAction> {
        let fixed = self.fixed_target(options).map(instant_of);
        let Stage::Waiting(waiting) = &mut self.stage else { return Vec::new() };
        let written = &self.choreography.acts[self.index.get()];
        if let Some(fixed) = fixed {
            // An act begins after the end of the previous act, even if it was planned earlier.
            let target = Some(self.before.map_or(fixed, |end| end.max(fixed)));
            self.stage = Stage::Ready { target, look: None };
            return Vec::new();
        }
        if written.wait == Wait::Done {
            self.stage = Stage::Ready { target: self.before, look: None };
            return Vec::new();
        }
        let Some(alone_since) = self.alone_since else { return Vec::new() };
        if written.timeout.is_some_and(|timeout| now >= alone_since + timeout) {
            return vec![ActAction::TimedOut(written.on_timeout)];
        }
        match &written.wait {
            Wait::Operator if waiting.go_received => {
                self.stage = Stage::Ready { target: None, look: None };
                Vec::new()
            }
            Wait::Sensor { robot, sensor, .. } if waiting.poll.is_none_or(|at| now >= at) => {
                waiting.poll = Some(now + POLL);
                let robot = robots.position(|state| state.id.as_str() == robot);
                let what = Reading::Wait(self.number);
                let read = |(robot, sensor)| ActAction::Read { robot, sensor, what };
                robot.zip(sensor.parse().ok()).map(read).into_iter().collect()
            }
            _ => Vec::new(),
        }
    }

    /// Returns the start that the operator or the scenario specifies, or an error if the local clocks skip that time. `None` if neither
    /// specifies a start.
    fn fixed_target(&self, options: &MissionOptions) -> Option<Result<Timestamp<Server>, SkippedTime>> {
        if let Some(at) = self.fixed {
            return Some(Ok(at));
        }
        match &self.written().wait {
            Wait::Instant(at) => Some(Ok(*at)),
            Wait::TimeOfDay(time) => Some(options.zone.next(self.since, *time)),
            Wait::Done | Wait::Operator | Wait::Sensor { .. } => None,
        }
    }

    /// Returns the start that the operator or the scenario fixes; `None` if neither does.
    pub(crate) fn fixed_start(&self, options: &MissionOptions) -> Option<Timestamp<Server>> {
        self.fixed_target(options).map(instant_of)
    }

    /// Returns the start of an act with a fixed start: the fixed instant, or the end of the previous act if that is later. `None` if the
    /// start is not fixed.
    pub(crate) fn start_to_keep(&self, options: &MissionOptions) -> Option<Timestamp<Server>> {
        self.fixed_start(options).and(self.target())
    }

    pub(super) fn wait_wakeup(&self, waiting: &Waiting) -> Option<Timestamp<Server>> {
        let over = self.alone_since.zip(self.written().timeout).map(|(since, timeout)| since + timeout);
        over.into_iter().chain(waiting.poll).min()
    }

    /// Processes a reading that the act may wait for. Returns the progress to report.
    pub(crate) fn sensor_read(&mut self, value: Option<f64>) -> Option<Progress> {
        let Wait::Sensor { range, .. } = &self.choreography.acts[self.index.get()].wait else { return None };
        let Stage::Waiting(waiting) = &mut self.stage else { return None };
        let before = std::mem::replace(&mut waiting.read, value);
        if value.is_some_and(|value| range.contains(value)) {
            self.stage = Stage::Ready { target: None, look: None };
        }
        (before != value).then(|| Progress::Reading { act: self.name(), value })
    }

    /// Whether the act waits for the operator and has not received a go yet. An earlier act may still be playing.
    pub(crate) fn awaits_operator(&self) -> bool {
        matches!(&self.stage, Stage::Waiting(waiting) if !waiting.go_received && self.written().wait == Wait::Operator)
    }

    /// Accepts the operator's go. Returns `false` if the act does not wait for a go now.
    pub(crate) fn go(&mut self) -> bool {
        let counts = self.is_alone() && self.awaits_operator();
        if let Stage::Waiting(waiting) = &mut self.stage {
            waiting.go_received |= counts;
        }
        counts
    }

    /// Returns a report of the act's condition for users, once the act waits; `None` for an act that follows at once. An act waits for a
    /// time even while an earlier act plays, but for the operator and sensors only after that act has ended.
    pub(crate) fn announcement(&mut self, options: &MissionOptions) -> Option<Progress> {
        let (fixed, alone) = (self.fixed_target(options), self.is_alone());
        let Stage::Waiting(waiting) = &mut self.stage else { return None };
        if waiting.announced || !(fixed.is_some() || alone) {
            return None;
        }
        waiting.announced = true;
        let written = self.written();
        let awaits = match (fixed, &written.wait) {
            (Some(Ok(at)), _) => options.zone.time_as_of(at, self.since),
            (Some(Err(skipped)), _) => {
                format!("{}, because {skipped}", options.zone.time_as_of(skipped.at, self.since))
            }
            (None, Wait::Operator) => "the operator's go".to_owned(),
            (None, Wait::Sensor { robot, sensor, range }) => format!("`{robot}/{sensor}` {range}"),
            (None, _) => return None,
        };
        let awaits = match (written.timeout, written.on_timeout) {
            (None, _) => awaits,
            (Some(timeout), Way::End) => format!("{awaits}, for at most {timeout}, then the mission ends"),
            (Some(timeout), Way::Fail) => format!("{awaits}, for at most {timeout}"),
            (Some(timeout), Way::Act(other)) => {
                format!(
                    "{awaits}, for at most {timeout}, then `{}`",
                    act_name(&self.choreography, ActIndex::new(other))
                )
            }
        };
        Some(Progress::Waiting { act: self.name(), awaits, at: fixed.map(instant_of) })
    }
}

/// Returns the start of an act with this target. A mission that plays can no longer be refused. Therefore, if the local clocks skip the
/// act's time, the act starts at the instant of the skip.
fn instant_of(target: Result<Timestamp<Server>, SkippedTime>) -> Timestamp<Server> {
    target.unwrap_or_else(|skipped| skipped.at)
}
