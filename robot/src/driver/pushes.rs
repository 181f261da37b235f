//! What hardware tells without being asked.

use std::sync::Arc;

use urrcp::DeviceId;

use super::Mailbox;

/// By this a driver tells readings and faults that nobody asked for, from any thread.
#[derive(Clone, Debug)]
pub struct Pushes(Arc<Mailbox>);

impl Pushes {
    pub(super) const fn into(mailbox: Arc<Mailbox>) -> Self {
        Self(mailbox)
    }

    /// A sensor reads this now, in its unit. A reading that is asked for within the sensor's `max_delay`, or within a second if it has
    /// none, is answered with it. Nothing while the hardware is not connected.
    pub fn reading(&self, sensor: &DeviceId, reading: f64) {
        self.0.read_by_itself(sensor, reading);
    }

    /// The hardware has failed: everything that runs or waits ends, and the driver is connected again. Nothing while the hardware
    /// is not connected.
    pub fn fault(&self, reason: impl Into<String>) {
        self.0.failed_by_itself(reason.into());
    }
}
