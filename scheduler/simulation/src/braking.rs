//! Checks how devices come to rest: within their declared acceleration, without reversing, and from their actual position.

use downbeat_robot::set_log::LogEntry;
use urrcp::{ControlType, Device, DeviceId, Robot, Span, Timestamp};

/// The number of equal intervals into which the duration of a braking is divided.
const INTERVALS: usize = 32;
/// Minimum duration of a braking that is judged. In shorter ones, the rounding of times to nanoseconds matters too much.
const LASTS_LEAST: Span = Span::from_millis(2);
/// Maximum duration for which a device slows down, or returns to its default position at its own speed.
pub(crate) const LASTS_MAX: Span = Span::from_millis(600_000);
/// Maximum relative error of an acceleration, because it is computed from differences of values.
const ERROR: f64 = 0.02;

/// The movement of a device that comes to rest or returns to its default position, sampled at equal intervals.
#[derive(Clone, Debug)]
pub struct Braking {
    /// The id of the device.
    pub device: DeviceId,
    /// The control type (position, speed or acceleration) of the sampled values.
    pub control_type: ControlType,
    /// Start of the braking by the robot's clock.
    pub since: Timestamp<Robot>,
    /// Duration of the braking.
    pub lasts: Span,
    /// The sampled values, one at each end of each interval.
    pub values: Vec<f64>,
}

/// Whether a log entry concerns the given control type.
pub(crate) fn is_of(entry: &LogEntry, control_type: ControlType) -> bool {
    match control_type {
        ControlType::Position => entry.control_type == "position",
        ControlType::Speed => entry.control_type == "speed",
        other => entry.control_type == other.to_string(),
    }
}

impl Braking {
    /// Samples a movement to rest, which starts with the log entry `entry`. `value` returns the value of the device at an instant.
    pub(crate) fn of(
        entry: &LogEntry,
        value: impl Fn(ControlType, Timestamp<Robot>) -> Option<f64>,
    ) -> Option<Self> {
        let control_type = entry.control_type.parse().ok()?;
        let (since, to) = (entry.due, entry.value);
        let rests = |after: Span| {
            value(control_type, since + after).is_some_and(|value| value.to_bits() == to.to_bits())
        };
        let mut least = Span::ZERO;
        let mut largest = Span::from_millis(1);
        while !rests(largest) && largest < LASTS_MAX {
            (least, largest) = (largest, largest * 2);
        }
        while (largest - least).as_nanos() > 1 {
            let middle = least + (largest - least) / 2;
            *(if rests(middle) { &mut largest } else { &mut least }) = middle;
        }
        let intervals = i64::try_from(INTERVALS).ok()?;
        let at = |index| since + Span::from_nanos(largest.as_nanos() / intervals * index);
        let values = (0..=intervals).map(|index| value(control_type, at(index)));
        let values = values.collect::<Option<Vec<f64>>>()?;
        Some(Self { device: entry.device.clone(), control_type, since, lasts: largest, values })
    }

    /// Whether the braking starts with the log entry `entry`.
    #[must_use]
    pub fn is_of(&self, entry: &LogEntry) -> bool {
        self.device == entry.device && self.since == entry.due && is_of(entry, self.control_type)
    }

    /// The length of an interval, in seconds.
    fn interval(&self) -> f64 {
        self.lasts.as_millis_f64() / 1_000.0 / (self.values.len() - 1) as f64
    }

    /// Returns the change of the value per second at an instant, and the error of that rate.
    pub(crate) fn rate(&self, at: Timestamp<Robot>) -> Option<(f64, f64)> {
        let rates = self.rates();
        let index = ((at - self.since).as_millis_f64() / 1_000.0 / self.interval()) as usize;
        let error = rates.windows(2).map(|two| (two[1] - two[0]).abs()).fold(0.0, f64::max);
        Some((*rates.get(index)?, error))
    }

    fn rates(&self) -> Vec<f64> {
        self.values.windows(2).map(|two| (two[1] - two[0]) / self.interval()).collect()
    }

    /// Describes the fault of a movement to rest; `None` if the movement is correct. `rate` contains the change of a position per second
    /// before the braking, and the error of that rate. `stays` states whether the device comes to rest in place, rather than at its
    /// default position.
    #[must_use]
    pub fn flaw(&self, device: &Device, rate: Option<(f64, f64)>, stays: bool) -> Option<String> {
        let accelerates = acceleration(device);
        let (Some(first), Some(last)) = (self.values.first(), self.values.last()) else { return None };
        if self.lasts < LASTS_LEAST {
            return None;
        }
        let interval = self.interval();
        let grain = 1e-5 * (1.0 + first.abs().max(last.abs())) / interval;
        if self.control_type != ControlType::Position {
            let most = accelerates? * (1.0 + ERROR) + grain;
            let steepest = self.rates().into_iter().fold(0.0, |most: f64, rate| most.max(rate.abs()));
            let turns = stays && self.values.windows(2).any(|two| two[1].abs() > two[0].abs());
            let harder = format!(
                "changed its speed by {steepest} per second, but declares a maximum acceleration of {accelerates:?}"
            );
            return (steepest > most)
                .then_some(harder)
                .or_else(|| turns.then(|| "sped up during a stop".to_owned()));
        }
        let rates = self.rates();
        let (before, error) = rate.unwrap_or((rates[0], f64::INFINITY));
        let most = if error.is_finite() { before + before.signum() * error } else { before };
        let fastest = accelerates.map(|accelerates| accelerates.max(harder_at_limit(device, *first, most)));
        let mut change = (rates[0] - before).abs() - error;
        let hard = fastest.and_then(|fastest| {
            let most = fastest * interval * (1.0 + ERROR) + grain;
            change = rates.windows(2).map(|two| (two[1] - two[0]).abs()).fold(change, f64::max);
            (change > most).then(|| {
                format!(
                    "slowed down at {} per second squared, but at most {fastest} is allowed",
                    change / interval
                )
            })
        });
        let turns = stays
            && before.abs() > error
            && rates.iter().any(|rate| rate * before < 0.0 && rate.abs() > grain);
        let speed =
            largest(device, ControlType::Speed).map(|speed| speed.max(before.abs()) * (1.0 + ERROR) + grain);
        let fast = rates
            .iter()
            .copied()
            .filter(|_| !stays)
            .find(|rate| speed.is_some_and(|speed| rate.abs() > speed));
        hard.or_else(|| turns.then(|| "reversed direction during a stop".to_owned())).or_else(|| {
            fast.map(|rate| {
                format!("returned to its default position at {rate} per second, which is too fast")
            })
        })
    }
}

/// Returns the minimum acceleration with which a device must brake to stay within its position limits.
pub(crate) fn harder_at_limit(device: &Device, position: f64, rate: f64) -> f64 {
    let Some(limits) = device.available_control_types.limits(ControlType::Position) else { return 0.0 };
    let room = if rate > 0.0 { limits.max_value - position } else { position - limits.min_value };
    if rate == 0.0 { 0.0 } else { rate * rate / (2.0 * room.max(f64::MIN_POSITIVE)) }
}

/// The largest acceleration that a device declares.
pub(crate) fn acceleration(device: &Device) -> Option<f64> {
    largest(device, ControlType::Acceleration)
}

fn largest(device: &Device, rate: ControlType) -> Option<f64> {
    let limits = device.available_control_types.limits(rate)?;
    Some(limits.min_value.abs().max(limits.max_value.abs())).filter(|rate| *rate > 0.0)
}
