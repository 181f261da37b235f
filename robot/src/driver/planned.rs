//! Manages scripts that a driver times by itself: hands them to the driver, ends them, and forwards the driver's reports.

use std::collections::BTreeMap;
use std::time::Instant;

use urrcp::{ControlError, DeviceId, ErrorCode, Robot, Span, Timestamp};

use super::grid::on_grid;
use super::mailbox::{PlanOrder, Sign};
use super::worker::{Lost, News, Worker};
use super::{DriverError, PlanReport};
use crate::clock::{HostClock, HostTime};
use crate::plans::{PlanCancel, PlanEvent, PlanId, PlanPart};

/// A report from a driver's thread about a script that the driver times.
#[derive(Debug)]
pub(crate) enum PlanNews {
    /// An event of a script and its time, as the driver reports them.
    Word { plan: PlanId, at: Timestamp<HostTime>, event: PlanEvent },
    /// The driver refused the part of a script that starts with step `first`.
    Refused { plan: PlanId, first: usize, error: ControlError },
    /// The driver has ended the script because it was ordered to.
    Cancelled(PlanId),
}

/// Change in the difference between two clocks above which the system clock must have been set.
const CLOCK_SET: Span = Span::from_micros(100);

/// The scripts that a driver has received and that have not ended.
#[derive(Debug, Default)]
pub(super) struct Given {
    plans: BTreeMap<PlanId, Have>,
    last: PlanId,
    /// Time by which the driver's clock is ahead of the host's clock. Updated only if a measurement differs by more than [`CLOCK_SET`].
    ahead: Span,
}

#[derive(Debug)]
struct Have {
    device: DeviceId,
    start: Instant,
    /// Time by which the driver's clock was ahead of the host's clock when the script was handed over.
    ahead: Span,
}

impl Given {
    pub(super) fn clear(&mut self) {
        self.plans.clear();
    }

    /// Returns how far the driver's clock is ahead of the host's clock. Small errors in reading the clocks do not change the result, so
    /// that scripts that start together get the same start.
    fn ahead(&mut self, measured: Span) -> Span {
        if (measured - self.ahead).abs() > CLOCK_SET {
            self.ahead = measured;
        }
        self.ahead
    }

    /// Whether the device is following a script at `now`, instead of an earlier movement.
    pub(super) fn is_followed_by(&self, device: &DeviceId, now: Instant) -> bool {
        self.plans.values().any(|have| have.device == *device && have.start <= now)
    }
}

impl Worker {
    pub(super) fn do_plan(&mut self, order: PlanOrder) -> Result<(), Lost> {
        match order {
            PlanOrder::Take(part, clock) => self.hand_over(part, clock),
            PlanOrder::Cancel(cancel) => self.cancel(&cancel),
        }
    }

    /// Hands a part of a script to the driver. A part that is too late is refused, and the robot's state machine then ends the script.
    fn hand_over(&mut self, mut part: PlanPart<Robot>, clock: HostClock) -> Result<(), Lost> {
        let (plan, first) = (part.plan, part.first);
        let now: Timestamp<Robot> = clock.now().assume_clock();
        let stale = part.steps.first().map(|step| step.at + self.tolerance().step);
        let latest = if first == 0 { Some(part.begin_by) } else { stale };
        if let Some(late) = latest.filter(|latest| *latest < now).map(|latest| now - latest) {
            let why = format!("a script reached the hardware {late} too late to be played");
            self.refused(plan, first, ControlError::new(ErrorCode::Late, why));
            return Ok(());
        }
        for step in &mut part.steps {
            let key = (part.device.clone(), step.setpoint.control_type);
            step.setpoint.value = on_grid(self.block(), &key, step.setpoint.value);
        }
        let known = self.given.plans.get(&plan).map(|have| have.ahead);
        let ahead = known.unwrap_or_else(|| self.given.ahead(clock.system_ahead()));
        let (device, start) = (part.device.clone(), clock.instant_of(part.start.assume_clock()));
        let part = part.on_clock(ahead);
        self.touch();
        self.given.last = self.given.last.max(plan);
        // The script is recorded before the call, because the driver may report at once that it has started.
        self.given.plans.insert(plan, Have { device: device.clone(), start, ahead });
        match self.call(Sign::Unknown, |driver| driver.plan(&part)) {
            Ok(()) => Ok(()),
            Err(DriverError::Refused(reason)) => {
                if first == 0 {
                    self.given.plans.remove(&plan);
                }
                let why = format!("the hardware refused a script of `{device}`: {reason}");
                self.refused(plan, first, ControlError::new(ErrorCode::Internal, why));
                Ok(())
            }
            Err(DriverError::Away(reason)) => Err(Lost::Away(reason)),
        }
    }

    fn refused(&self, plan: PlanId, first: usize, error: ControlError) {
        self.tell(News::Plan(PlanNews::Refused { plan, first, error }));
    }

    /// Cancels a script. A script that the driver does not have, or has already ended, is reported as cancelled at once.
    fn cancel(&mut self, cancel: &PlanCancel) -> Result<(), Lost> {
        if self.given.plans.contains_key(&cancel.plan) {
            self.call(Sign::Unknown, |driver| driver.cancel(cancel)).map_err(|error| match error {
                DriverError::Away(reason) => Lost::Away(reason),
                DriverError::Refused(reason) => {
                    Lost::Refused(format!("to end a script of `{}`: {reason}", cancel.device))
                }
            })?;
            let words = self.words();
            self.pass_on(words)?;
            self.given.plans.remove(&cancel.plan);
        }
        self.tell(News::Plan(PlanNews::Cancelled(cancel.plan)));
        Ok(())
    }

    /// Forwards the driver's reports about scripts. A report about a script that has already ended is ignored.
    pub(super) fn pass_on(&mut self, words: Vec<PlanReport>) -> Result<(), Lost> {
        for PlanReport { plan, at, event } in words {
            let Some(have) = self.given.plans.get(&plan) else {
                if plan > self.given.last || plan.0 == 0 {
                    return Err(Lost::Fault(format!(
                        "the driver reported on plan {}, which it never received",
                        plan.0
                    )));
                }
                continue;
            };
            let at = (at - have.ahead).assume_clock();
            let is_over = !matches!(event, PlanEvent::Began | PlanEvent::Step(_) | PlanEvent::AssumedRunning);
            if is_over {
                self.given.plans.remove(&plan);
            }
            self.tell(News::Plan(PlanNews::Word { plan, at, event }));
        }
        Ok(())
    }
}

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "an instant to count from")]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn small_clock_difference_is_not_a_clock_change() {
        let mut given = Given::default();
        let told = [50, 100, 101, 150, 201, 202, -300].map(|micros| given.ahead(Span::from_micros(micros)));
        assert_eq!(told, [0, 0, 101, 101, 101, 202, -300].map(Span::from_micros));
    }

    #[test]
    fn device_follows_a_script_from_its_start() {
        let (mut given, now) = (Given::default(), Instant::now());
        let [arm, wheel] = ["arm", "wheel"].map(|id| DeviceId::new(id).unwrap());
        let start = now + Duration::from_secs(1);
        given.plans.insert(PlanId(1), Have { device: arm.clone(), start, ahead: Span::ZERO });
        assert!(!given.is_followed_by(&arm, now) && given.is_followed_by(&arm, start));
        assert!(!given.is_followed_by(&wheel, start));
        given.clear();
        assert!(!given.is_followed_by(&arm, start));
    }
}
