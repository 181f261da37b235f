//! Unsolicited reports from hardware.

use std::sync::Arc;
use std::time::Duration;

use urrcp::{DeviceId, Timestamp};

use super::Mailbox;
use super::mailbox::Sampled;
use crate::clock::SystemClock;
use crate::plans::{PlanEvent, PlanId};

/// A driver's report about a script that it times by itself.
#[derive(Clone, Debug)]
pub(crate) struct PlanReport {
    pub(super) plan: PlanId,
    pub(super) at: Timestamp<SystemClock>,
    pub(super) event: PlanEvent,
}

/// A handle that a driver uses to report readings, faults and script events unasked, from any thread.
#[derive(Clone, Debug)]
pub struct Pushes(Arc<Mailbox>);

impl Pushes {
    pub(super) const fn into(mailbox: Arc<Mailbox>) -> Self {
        Self(mailbox)
    }

    /// Whether the driver must shut down, because its mailbox is closed.
    pub(super) fn is_over(&self) -> bool {
        self.0.is_closed()
    }

    /// Reports the current reading of a sensor, in the sensor's unit. The robot answers requests with this reading for the sensor's
    /// `max_delay`, or for one second if it declares none. Ignored while the hardware is not connected.
    pub fn reading(&self, sensor: &DeviceId, reading: f64) {
        self.0.read_by_itself(sensor, Sampled { value: reading, taken: None });
    }

    /// Reports a reading like [`Pushes::reading`], with the time since its value was taken.
    pub fn reading_of_age(&self, sensor: &DeviceId, reading: f64, age: Duration) {
        self.0.read_by_itself(sensor, Sampled { value: reading, taken: self.0.now().checked_sub(age) });
    }

    /// Reports an event of a script that the driver times by itself. `at` is a time on the clock to which the script's times refer. If
    /// this clock is set meanwhile, `at` must be as if it had not been set. Ignored while the hardware is not connected.
    pub fn plan(&self, plan: PlanId, at: Timestamp<SystemClock>, event: PlanEvent) {
        self.0.told_of_plan(PlanReport { plan, at, event });
    }

    /// Reports a fault of the hardware. All running and waiting commands end, and the driver is connected again. Ignored while the
    /// hardware is not connected.
    pub fn fault(&self, reason: impl Into<String>) {
        self.0.failed_by_itself(reason.into());
    }
}
