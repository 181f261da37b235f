//! Verifies by sensors when motions start during a mission (`run --verify-motion`). This module decides which readings are requested
//! around the first movement of each device in an act, and evaluates them.

use std::collections::VecDeque;

use downbeat_fleet::fleet::{Calibration, Lag, Taken};
use downbeat_onset::{Commanded, Readable, Reading, Sample, Trial};
use serde::{Deserialize, Serialize};
use urrcp::{
    ControlParameters, ControlType, Device, DeviceId, Interpolation, RobotId, Server, Span, Step, Timestamp,
};

use super::RobotIndex;
use super::act::Act;
use super::robot_state::{RobotState, Robots};

/// How long before a device's movement the mission starts to read its sensor, if the act is committed by then.
const BEFORE: Span = Span::from_millis(80);
/// How long after the planned start of a device's movement its sensor is read, unless the device receives another command earlier.
const AFTER: Span = Span::from_millis(400);
/// The interval between two requests to the same sensor.
const EVERY: Span = Span::from_millis(4);
/// The maximum time to wait for a sensor's answer.
const ANSWERED: Span = Span::from_millis(250);
/// The uncertainty of an onset (the start of a motion) in standard errors: 95 % of a normal distribution.
const STANDARD_ERRORS: f64 = 2.0;

/// The first movement of one device in an act, and the readings of its sensor around that time.
#[derive(Clone, Debug)]
pub(crate) struct Watched {
    robot: RobotIndex,
    device: DeviceId,
    sensor: DeviceId,
    taken: Taken,
    sensor_delay: Span,
    /// The smallest displacement at which motion is visible, in the unit of the device.
    visible: f64,
    range: Option<(f64, f64)>,
    movement: Movement,
    /// The compensated latency: the planned time from the command to the motion.
    latency: Span,
    /// How the device lags behind its commands, as measured; `None` if unknown.
    lag: Option<Lag>,
    readings: Vec<(Timestamp<Server>, Timestamp<Server>, f64)>,
    /// The time of the last request to the sensor, and whether its answer is pending; `None` before the first request.
    asked: Option<(Timestamp<Server>, bool)>,
}

/// The first movement that a device's steps command.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Movement {
    /// The start of the movement, measured from the start of the act.
    due: Span,
    /// The duration of the movement; zero for a device that does not interpolate.
    lasts: Span,
    /// The commanded start position; `None` for the position that the sensor shows first.
    from: Option<f64>,
    to: f64,
    /// The time of the next command, measured from the start of the act; `None` if no command follows.
    until: Option<Span>,
}

/// The start of a device's motion, as its sensor shows it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionReport {
    /// Id of the robot.
    pub robot: RobotId,
    /// Id of the device.
    pub device: DeviceId,
    /// The planned start of the motion by the scheduler's clock: the time of its command plus the compensated latency.
    pub planned: Timestamp<Server>,
    /// The actual minus the planned start; `None` if the readings do not show the start.
    #[serde(rename = "error_ms")]
    pub error: Option<Span>,
    /// The uncertainty of the start.
    #[serde(rename = "uncertainty_ms", skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<Span>,
    /// The number of readings by which the motion was verified.
    pub readings: usize,
    /// The reason why the readings do not show the start.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unclear: Option<String>,
}

/// How far apart in time the starts of motions are, relative to their planned starts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionSpread {
    /// The largest minus the smallest start error.
    #[serde(rename = "spread_ms")]
    pub spread: Span,
    /// The uncertainty of the spread: the sum of the uncertainties of the earliest and the latest motion.
    #[serde(rename = "uncertainty_ms")]
    pub uncertainty: Span,
    /// The number of compared motions.
    pub motions: usize,
}

impl MotionSpread {
    /// The spread of motions; `None` for fewer than two motions with a known start.
    #[must_use]
    pub fn of(motions: &[MotionReport]) -> Option<Self> {
        let known = || motions.iter().filter_map(|motion| motion.error.zip(motion.uncertainty));
        let (earliest, latest) = known().min().zip(known().max())?;
        let motions = known().count();
        let spread = latest.0 - earliest.0;
        (motions > 1).then_some(Self { spread, uncertainty: latest.1 + earliest.1, motions })
    }
}

impl Watched {
    /// The movements to watch in an act: the first movement of each device whose position a sensor shows.
    pub(crate) fn of(act: &Act, robots: &Robots) -> Vec<Self> {
        let mut all = Vec::new();
        for member in act.members() {
            let state = &robots[member.robot];
            for (device, calibration) in &state.settings.calibrate {
                let mut steps = VecDeque::new();
                for script in member.scripts().iter().filter(|script| script.plan.device == *device) {
                    let start = script.plan.start.span();
                    steps.extend(script.plan.script.steps().iter().map(|step| (start, step)));
                }
                let known = described(state, device);
                let linear = known.is_none_or(|known| known.interpolation == Interpolation::Linear);
                let Some(movement) = first_movement(steps.make_contiguous(), linear) else { continue };
                let known = state.settings.latencies.get(device);
                let latency = known.map_or(Span::ZERO, |known| known.latency.median);
                let lag = known.and_then(|known| known.lag);
                let range = described(state, &calibration.sensor).and_then(range_of);
                let Calibration { sensor, taken, sensor_delay, visible, .. } = calibration.clone();
                let device = device.clone();
                let (readings, asked) = (Vec::new(), None);
                let robot = member.robot;
                all.push(Self {
                    robot,
                    device,
                    sensor,
                    taken,
                    sensor_delay,
                    visible,
                    range,
                    movement,
                    latency,
                    lag,
                    readings,
                    asked,
                });
            }
        }
        all
    }

    pub(crate) const fn robot(&self) -> RobotIndex {
        self.robot
    }

    pub(crate) const fn sensor(&self) -> &DeviceId {
        &self.sensor
    }

    /// The time of the next request to the sensor, in an act that starts at `start`; `None` after the last request.
    pub(crate) fn due(&self, start: Timestamp<Server>) -> Option<Timestamp<Server>> {
        let due = start + self.movement.due;
        let next = match self.asked {
            None => due - BEFORE,
            Some((at, true)) => at + ANSWERED,
            Some((at, false)) => at + EVERY,
        };
        let after =
            (due + self.latency + AFTER).min(self.movement.until.map_or(due + AFTER * 100, |at| start + at));
        (next <= after).then_some(next)
    }

    pub(crate) fn ask(&mut self, now: Timestamp<Server>) {
        self.asked = Some((now, true));
    }

    /// Processes an answer of the sensor. An unexpected answer is ignored, because it belongs to an earlier request whose time is
    /// unknown.
    pub(crate) fn answered(&mut self, arrived: Timestamp<Server>, value: Option<f64>) {
        let Some((asked, true)) = self.asked else { return };
        self.asked = Some((asked, false));
        self.readings.extend(value.map(|value| (asked, arrived, value)));
    }

    pub(crate) fn report(&self, start: Timestamp<Server>, robot: &RobotState) -> MotionReport {
        let due = start + self.movement.due;
        let sample = |(asked, answered, value): &(Timestamp<Server>, Timestamp<Server>, f64)| {
            let reading = Reading { asked: *asked - due, answered: *answered - due, value: *value };
            let (at, uncertainty) = reading.instant(robot.round_trip(), self.taken);
            Sample { at: at - self.sensor_delay, uncertainty, value: *value }
        };
        let samples: Vec<Sample> = self.readings.iter().map(sample).collect();
        let from = self.movement.from.or_else(|| samples.first().map(|sample| sample.value));
        let movement = from.map_or(0.0, |from| self.movement.to - from);
        let readable = Readable { range: self.range, visible: self.visible };
        let trial = Trial { commanded: Commanded::ramp(self.movement.lasts).begins(), movement, samples };
        let found = downbeat_onset::onset(&trial, readable, self.lag);
        // A single motion is not enough to distinguish a late start from a slow one.
        let without_lag = match self.lag {
            Some(_) => found,
            None => downbeat_onset::onset(
                &trial,
                readable,
                Some(Lag { time_constant: Span::ZERO, lags: 1, later: Span::ZERO }),
            ),
        };
        let uncertainty = found.as_ref().ok().map(|onset| {
            let error = onset.standard_error.as_millis_f64() * STANDARD_ERRORS;
            let lag = without_lag.map_or(Span::ZERO, |other| (other.latency - onset.latency).abs());
            onset.uncertainty + Span::from_millis_f64(error) + lag
        });
        MotionReport {
            robot: robot.id.clone(),
            device: self.device.clone(),
            planned: due + self.latency,
            error: found.as_ref().ok().map(|onset| onset.latency - self.latency),
            uncertainty,
            readings: self.readings.len(),
            unclear: found.err().map(|unclear| unclear.to_string()),
        }
    }
}

fn described<'a>(robot: &'a RobotState, device: &DeviceId) -> Option<&'a Device> {
    robot.block.as_ref()?.device(device.as_str())
}

fn range_of(sensor: &Device) -> Option<(f64, f64)> {
    match sensor.available_control_types.get(ControlType::Sensor)? {
        ControlParameters::Sensor(sensor) => Some((sensor.min_value, sensor.max_value)),
        _ => None,
    }
}

/// The first change of position in a device's steps. If the device interpolates linearly, its motion before the first step is ignored,
/// because it depends on where the device is.
fn first_movement(steps: &[(Span, &Step)], linear: bool) -> Option<Movement> {
    let steps: Vec<(Span, f64)> = (steps.iter())
        .filter(|(_, step)| step.setpoint.control_type == ControlType::Position)
        .map(|(start, step)| (*start + step.offset.span(), step.setpoint.value))
        .collect();
    let (first, _) = steps.first()?;
    let place = steps.windows(2).position(|pair| pair[0].1.to_bits() != pair[1].1.to_bits());
    match place {
        Some(place) => {
            let ((begins, from), (ends, to)) = (steps[place], steps[place + 1]);
            let next = steps.get(place + 2).map(|(at, _)| *at);
            Some(if linear {
                Movement { due: begins, lasts: ends - begins, from: Some(from), to, until: Some(ends) }
            } else {
                Movement { due: ends, lasts: Span::ZERO, from: Some(from), to, until: next }
            })
        }
        // The device sets and holds a single value.
        None if !linear => {
            Some(Movement { due: *first, lasts: Span::ZERO, from: None, to: steps[0].1, until: None })
        }
        None => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn movement(steps: &[(i64, f64)], linear: bool) -> Option<Movement> {
        let steps: Vec<Step> = (steps.iter())
            .map(|(at, value)| Step {
                offset: urrcp::Millis::from_span(Span::from_millis(*at)),
                setpoint: urrcp::Setpoint::new(ControlType::Position, *value),
                stop_condition: None,
            })
            .collect();
        let steps: Vec<(Span, &Step)> = steps.iter().map(|step| (Span::from_millis(100), step)).collect();
        first_movement(&steps, linear)
    }

    #[test]
    fn first_change_of_value_is_watched() {
        let ms = Span::from_millis;
        let linear = movement(&[(0, 5.0), (200, 5.0), (1_200, 45.0), (1_300, 0.0)], true).unwrap();
        let expected =
            Movement { due: ms(300), lasts: ms(1_000), from: Some(5.0), to: 45.0, until: Some(ms(1_300)) };
        assert_eq!(linear, expected);
        let held = movement(&[(0, 5.0), (200, 45.0), (900, 0.0)], false).unwrap();
        let expected =
            Movement { due: ms(300), lasts: Span::ZERO, from: Some(5.0), to: 45.0, until: Some(ms(1_000)) };
        assert_eq!(held, expected);
        assert_eq!(movement(&[(0, 5.0)], false).unwrap().due, ms(100));
        assert_eq!(movement(&[(0, 5.0), (900, 5.0)], true), None);
    }

    #[test]
    fn motion_spread_includes_uncertainty_of_first_and_last_motion() {
        let motion = |error: Option<i64>| MotionReport {
            robot: "r".parse().unwrap(),
            device: "d".parse().unwrap(),
            planned: Timestamp::from_nanos(0),
            error: error.map(Span::from_millis),
            uncertainty: error.map(|_| Span::from_millis(1)),
            readings: 40,
            unclear: error.is_none().then(|| "too few".to_owned()),
        };
        assert_eq!(MotionSpread::of(&[motion(Some(3)), motion(None)]), None);
        let spread = MotionSpread::of(&[motion(Some(3)), motion(None), motion(Some(-2))]).unwrap();
        assert_eq!((spread.spread, spread.uncertainty), (Span::from_millis(5), Span::from_millis(2)));
        assert_eq!(spread.motions, 2);
    }

    /// A sensor that shows a ramp of one second, which begins 100 ms after the start of its act.
    fn watched() -> Watched {
        Watched {
            robot: RobotIndex::new(0),
            device: "d".parse().unwrap(),
            sensor: "s".parse().unwrap(),
            taken: Taken::default(),
            sensor_delay: Span::ZERO,
            visible: 0.1,
            range: None,
            movement: movement(&[(0, 5.0), (1_000, 45.0)], true).unwrap(),
            latency: Span::from_millis(40),
            lag: None,
            readings: Vec::new(),
            asked: None,
        }
    }

    #[test]
    fn sensor_gets_one_request_at_a_time_from_before_to_after_the_movement() {
        let start = Timestamp::from_nanos(10_000_000_000);
        let begins = start + Span::from_millis(100);
        let mut watched = watched();
        assert_eq!(watched.due(start), Some(begins - BEFORE));
        watched.ask(begins);
        assert_eq!(watched.due(start), Some(begins + ANSWERED), "it is not waited for longer");
        watched.answered(begins + Span::from_millis(1), Some(5.0));
        assert_eq!(watched.due(start), Some(begins + EVERY));
        watched.answered(begins + Span::from_millis(2), Some(6.0));
        assert_eq!(watched.readings.len(), 1, "nobody had asked again");
        let last = begins + watched.latency + AFTER.min(Span::from_millis(1_000) - watched.latency);
        for (asked, due) in [(last - EVERY, Some(last)), (last - EVERY + Span::from_nanos(1), None)] {
            watched.asked = Some((asked, false));
            assert_eq!(watched.due(start), due);
        }
    }

    #[test]
    fn planned_motion_time_follows_from_command_and_latency() {
        let start = Timestamp::from_nanos(10_000_000_000);
        let robot = crate::bench::robot("r0", crate::bench::Tells::Everything, 2);
        let report = watched().report(start, &robot);
        assert_eq!(report.planned, start + Span::from_millis(140));
        assert_eq!((report.error, report.readings), (None, 0));
        assert!(report.unclear.is_some());
    }

    #[test]
    fn sensor_has_its_declared_range_and_other_devices_have_none() {
        let device = |controls: &str| -> Device {
            serde_json::from_str(&format!(r#"{{"id": "d", "available_control_types": {{{controls}}}}}"#))
                .unwrap()
        };
        let sensor = device(r#""sensor": {"min_value": -20, "max_value": 60}"#);
        assert_eq!(range_of(&sensor), Some((-20.0, 60.0)));
        let arm = device(r#""position": {"min_value": 0, "max_value": 90, "granularity": 1}"#);
        assert_eq!(range_of(&arm), None);
    }

    #[test]
    fn sensor_delay_is_subtracted_from_the_motion_onset() {
        let start = Timestamp::from_nanos(10_000_000_000);
        let robot = crate::bench::robot("r0", crate::bench::Tells::Everything, 2);
        let error = |delay: i64| {
            let mut watched = watched();
            watched.sensor_delay = Span::from_millis(delay);
            let due = start + watched.movement.due;
            // The device begins to follow after 60 ms, at the commanded 40 per second.
            let shown = |millis: i64| 5.0 + 0.04 * (millis - 60).max(0) as f64;
            watched.readings = (-20..100)
                .map(|k| (due + Span::from_millis(4 * k), due + Span::from_millis(4 * k), shown(4 * k)))
                .collect();
            watched.report(start, &robot).error.unwrap()
        };
        let off = (error(0) - error(10) - Span::from_millis(10)).abs();
        assert!(off < Span::from_micros(100), "{} and {}", error(0), error(10));
    }
}
