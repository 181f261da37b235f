//! How often a driver is called: the rates that the driver declares and those that its user configures.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::time::Duration;

use urrcp::DeviceId;

use super::DriverOptions;

/// Default number of samples (intermediate values of a movement) per second: the rate at which hobby servos accept values.
pub const SAMPLES_PER_SECOND: f64 = 50.0;
/// Default maximum number of pings per second, which applies in the last second before a start.
pub const PINGS_PER_SECOND: f64 = 40.0;

/// Minimum and maximum number of samples (intermediate values of a movement) per second, for one device.
pub const SAMPLES_BOUNDS: RangeInclusive<f64> = 0.1..=1_000.0;
/// Minimum and maximum number of pings per second. With fewer pings, a start would rely on an old sign of life; more pings only cost
/// time.
pub const PINGS_BOUNDS: RangeInclusive<f64> = 10.0..=200.0;
/// Minimum and maximum number of readings per second of one sensor.
pub const READINGS_BOUNDS: RangeInclusive<f64> = 0.01..=1_000.0;

/// The call rates that a driver prefers. Rates in the [`DriverOptions`] take precedence.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Rates {
    /// Samples (intermediate values) of a movement per second, by device. [`SAMPLES_PER_SECOND`] applies to devices without an entry.
    pub samples_per_second: BTreeMap<DeviceId, f64>,
    /// Maximum number of pings per second. `None`: [`PINGS_PER_SECOND`].
    pub pings_per_second: Option<f64>,
    /// Maximum number of readings per second by sensor. Sensors without an entry have no limit.
    pub readings_per_second: BTreeMap<DeviceId, f64>,
    /// Maximum time for which the hardware may show no sign of life, for a driver that reports these signs by [`Driver::last_sign`].
    ///
    /// [`Driver::last_sign`]: super::Driver::last_sign
    pub silence_max: Option<Duration>,
}

/// Default maximum time for which the hardware may show no sign of life, if its driver reports these signs.
pub const HARDWARE_SILENCE_MAX: Duration = Duration::from_secs(1);

impl Rates {
    /// Returns the interval between two samples (intermediate values) of a movement of this device.
    pub(super) fn sample_period(&self, options: &DriverOptions, device: &DeviceId) -> Duration {
        let option = options.samples_of.get(device).copied().or(options.samples_per_second);
        let rate = option.or_else(|| self.samples_per_second.get(device).copied());
        period(rate.unwrap_or(SAMPLES_PER_SECOND), &SAMPLES_BOUNDS)
    }

    /// Returns the interval between two pings in the last second before a start.
    pub(super) fn ping_period(&self, options: &DriverOptions) -> Duration {
        let rate = options.pings_per_second.or(self.pings_per_second);
        period(rate.unwrap_or(PINGS_PER_SECOND), &PINGS_BOUNDS)
    }

    /// Returns how long a sensor's reading is reused for further requests. `None`: each request reads the sensor again.
    pub(super) fn reading_period(&self, options: &DriverOptions, sensor: &DeviceId) -> Option<Duration> {
        let rate = options.readings_per_second.or_else(|| self.readings_per_second.get(sensor).copied());
        rate.map(|rate| period(rate, &READINGS_BOUNDS))
    }
}

fn period(rate: f64, bounds: &RangeInclusive<f64>) -> Duration {
    Duration::from_secs_f64(1.0 / rate.clamp(*bounds.start(), *bounds.end()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn device_option_overrides_general_option_and_both_override_the_driver() {
        let id = |id: &str| DeviceId::new(id).unwrap();
        let rates = Rates {
            samples_per_second: BTreeMap::from([(id("arm"), 100.0), (id("leg"), 20.0)]),
            ..Rates::default()
        };
        let none = DriverOptions::default();
        let millis = |options: &DriverOptions, device| rates.sample_period(options, &id(device)).as_millis();
        assert_eq!(["arm", "leg", "eye"].map(|device| millis(&none, device)), [10, 50, 20]);
        let all = none.clone().with_samples_per_second(25.0);
        assert_eq!(millis(&all, "arm"), 40);
        let arm = all.with_samples_of(id("arm"), 200.0);
        assert_eq!(["arm", "leg"].map(|device| millis(&arm, device)), [5, 40]);
    }

    #[test]
    fn rates_out_of_bounds_are_clamped() {
        let rates = Rates { pings_per_second: Some(1e9), ..Rates::default() };
        assert_eq!(rates.ping_period(&DriverOptions::default()), Duration::from_millis(5));
        let slow = DriverOptions { pings_per_second: Some(0.0), ..DriverOptions::default() };
        assert_eq!(rates.ping_period(&slow), Duration::from_millis(100));
    }
}
