//! What hardware tells without being asked.

use std::sync::Arc;

use urrcp::{DeviceId, Timestamp};

use super::Mailbox;
use crate::clock::SystemClock;
use crate::plans::{PlanEvent, PlanId};

/// What a driver says of a script that it times by itself.
#[derive(Clone, Debug)]
pub(crate) struct PlanWord {
    pub(super) plan: PlanId,
    pub(super) at: Timestamp<SystemClock>,
    pub(super) event: PlanEvent,
}

/// By this a driver tells readings and faults that nobody asked for, from any thread.
#[derive(Clone, Debug)]
pub struct Pushes(Arc<Mailbox>);

impl Pushes {
    pub(super) const fn into(mailbox: Arc<Mailbox>) -> Self {
        Self(mailbox)
    }

    /// Whether the driver has to shut down.
    pub(super) fn is_over(&self) -> bool {
        self.0.is_closed()
    }

    /// A sensor reads this now, in its unit. A reading that is asked for within the sensor's `max_delay`, or within a second if it has
    /// none, is answered with it. Nothing while the hardware is not connected.
    pub fn reading(&self, sensor: &DeviceId, reading: f64) {
        self.0.read_by_itself(sensor, reading);
    }

    /// This happened then to a script that the driver times by itself. Times are those of the clock by which the script was handed
    /// over: if that clock is set to another time, they go on as before. Nothing while the hardware is not connected.
    pub fn plan(&self, plan: PlanId, at: Timestamp<SystemClock>, event: PlanEvent) {
        self.0.told_of_plan(PlanWord { plan, at, event });
    }

    /// The hardware has failed: everything that runs or waits ends, and the driver is connected again. Nothing while the hardware
    /// is not connected.
    pub fn fault(&self, reason: impl Into<String>) {
        self.0.failed_by_itself(reason.into());
    }
}
