//! Tests a driver that has only the required methods, and simulated hardware.

use super::*;

#[test]
fn each_driver_option_leaves_the_others_unchanged() {
    let options = DriverOptions::default().with_samples_per_second(40.0).with_readings_per_second(3.0);
    let options = options.with_pings_per_second(7.0);
    let set = [options.samples_per_second, options.readings_per_second, options.pings_per_second];
    assert_eq!(set, [40.0, 3.0, 7.0].map(Some));
}

/// A driver with only the required methods.
struct Plain(Vec<String>);

impl Driver for Plain {
    fn connect(&mut self) -> Result<(), DriverError> {
        Ok(())
    }

    fn set(&mut self, device: &DeviceId, setpoint: &Setpoint) -> Result<(), DriverError> {
        self.0.push(format!("{device} {}", setpoint.value));
        if setpoint.value < 0.0 { Err(DriverError::Refused("below zero".to_owned())) } else { Ok(()) }
    }

    fn read(&mut self, _sensor: &DeviceId) -> Result<f64, DriverError> {
        Ok(0.0)
    }

    fn ping(&mut self) -> Result<(), DriverError> {
        Ok(())
    }
}

#[test]
fn default_driver_receives_only_single_values_in_order() {
    let mut plain = Plain(Vec::new());
    assert!(!plain.takes_ramps() && !plain.takes_frames() && !plain.set_is_acknowledged());
    assert!(plain.lookahead().is_empty() && plain.latency().is_empty() && plain.lifeline().is_none());
    assert_eq!(plain.rates(), Rates::default());
    let value =
        |device: &str, value| (DeviceId::new(device).unwrap(), Setpoint::new(ControlType::Speed, value));
    assert_eq!(plain.set_frame(&[value("a", 1.0), value("b", 2.0)]), Ok(()));
    let refused = Err(DriverError::Refused("below zero".to_owned()));
    assert_eq!(plain.set_frame(&[value("c", -1.0), value("d", 2.0)]), refused);
    assert_eq!(plain.0, ["a 1", "b 2", "c -1"]);
    let ramp = Ramp { control_type: ControlType::Speed, to: 1.0, duration: Duration::ZERO };
    let arm = || DeviceId::new("a").unwrap();
    assert!(plain.ramp(&arm(), ramp).is_err());
    let part = empty_plan(&arm());
    let (then, why) = (crate::Then::Keep, String::new());
    let cancel = PlanCancel { plan: part.plan, device: arm(), then, why };
    let timed = Err(DriverError::Refused("this driver cannot play scripts by itself".to_owned()));
    assert_eq!([plain.plan(&part), plain.cancel(&cancel)], [timed.clone(), timed]);
}

#[test]
fn simulated_reading_is_the_last_set_value_or_the_middle_of_the_range() {
    let block: InitializationBlock = serde_json::from_str(BLOCK).unwrap();
    let mut driver = SimulatedDriver::new(&block);
    let (arm, eye) = (DeviceId::new("arm").unwrap(), DeviceId::new("eye").unwrap());
    driver.connect().unwrap();
    assert_eq!(driver.read(&eye), Ok(4.5));
    assert_eq!(driver.read(&arm), Err(DriverError::Refused("`arm` is not a sensor".to_owned())));
    driver.set(&arm, &Setpoint::new(ControlType::Position, 30.0)).unwrap();
    assert_eq!(driver.read(&arm), Ok(30.0));
    assert!(driver.set_is_acknowledged());
    driver.ping().unwrap();
}
