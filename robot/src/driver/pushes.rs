//! Unsolicited reports of hardware.

use std::sync::Arc;

use urrcp::{DeviceId, Timestamp};

use super::Mailbox;
use crate::clock::SystemClock;
use crate::plans::{PlanEvent, PlanId};

/// A driver's report about a script that it times by itself.
#[derive(Clone, Debug)]
pub(crate) struct PlanReport {
    pub(super) plan: PlanId,
    pub(super) at: Timestamp<SystemClock>,
    pub(super) event: PlanEvent,
}

/// A handle by which a driver reports readings, faults and script events unasked, from any thread.
#[derive(Clone, Debug)]
pub struct Pushes(Arc<Mailbox>);

impl Pushes {
    pub(super) const fn into(mailbox: Arc<Mailbox>) -> Self {
        Self(mailbox)
    }

    /// Whether the driver must shut down.
    pub(super) fn is_over(&self) -> bool {
        self.0.is_closed()
    }

    /// Reports the current reading of a sensor, in its unit. A request within the sensor's `max_delay`, or within a second if it has
    /// none, is answered with this reading. Ignored while the hardware is not connected.
    pub fn reading(&self, sensor: &DeviceId, reading: f64) {
        self.0.read_by_itself(sensor, reading);
    }

    /// Reports an event of a script that the driver times by itself. Times are those of the clock by which the script was handed over: if
    /// that clock is set, they continue as before. Ignored while the hardware is not connected.
    pub fn plan(&self, plan: PlanId, at: Timestamp<SystemClock>, event: PlanEvent) {
        self.0.told_of_plan(PlanReport { plan, at, event });
    }

    /// Reports a fault of the hardware: everything that runs or waits ends, and the driver is connected again. Ignored while the hardware
    /// is not connected.
    pub fn fault(&self, reason: impl Into<String>) {
        self.0.failed_by_itself(reason.into());
    }
}
