//! Finds robots that declare other latencies than those with which their motions were planned.

use std::collections::HashSet;
use std::fmt;

use downbeat_fleet::fleet::LatencySource;
use downbeat_plan::Choreography;
use downbeat_yaml::duration::written;
use serde::{Deserialize, Serialize};
use urrcp::{DeviceId, InitializationBlock, RobotId, Span};

/// Latencies that differ by at most this are considered equal.
const SAME: Span = Span::from_millis(1);
/// The maximum number of devices that are listed per robot.
const SHOWN_MAX: usize = 12;

/// The devices of one robot that declare a latency other than the one for which the plan compensates.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct LatencyDiffers {
    /// The devices; never empty.
    pub devices: Vec<OtherLatency>,
}

/// A device that declares a latency other than the one for which the plan compensates.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OtherLatency {
    /// Id of the device.
    pub device: DeviceId,
    /// The latency that the robot declares.
    #[serde(rename = "declared_ms")]
    pub declared: Span,
    /// The latency for which the plan compensates.
    #[serde(rename = "compensated_ms")]
    pub compensated: Span,
    /// The source of the compensated latency; `None` if none was known.
    pub from: Option<LatencySource>,
}

impl LatencyDiffers {
    /// Returns the latencies in a robot's own block that differ from those for which the plan compensates; `None` if none differ. A
    /// latency that the fleet's copy of the block already declares is not reported if the fleet file sets another one: its author may
    /// have done so deliberately.
    pub(super) fn of(
        choreography: &Choreography,
        robot: &RobotId,
        known: Option<&InitializationBlock>,
        told: &InitializationBlock,
    ) -> Option<Self> {
        if told.devices.iter().all(|device| device.latency.is_none()) {
            return None;
        }
        let plans = choreography.acts.iter().flat_map(|act| &act.plan.robots);
        let scripts = plans.filter(|plan| plan.robot == *robot).flat_map(|plan| &plan.scripts);
        let moved: HashSet<&DeviceId> = scripts.map(|script| &script.device).collect();
        let differs = |device: &urrcp::Device| {
            let declared = device.actuation_latency()?.median;
            let used = choreography
                .acts
                .iter()
                .find_map(|act| act.latencies.get(robot).and_then(|devices| devices.get(&device.id)));
            let compensated = used.map_or(Span::ZERO, |used| used.latency.median);
            let known = known.and_then(|block| block.device(device.id.as_str()));
            let known = known.and_then(urrcp::Device::actuation_latency);
            let was_known = known.is_some_and(|known| (known.median - declared).abs() <= SAME);
            let chosen = used.is_some_and(|used| used.from != LatencySource::Robot);
            let same = (declared - compensated).abs() <= SAME || was_known && chosen;
            let from = used.map(|used| used.from);
            let other = || OtherLatency { device: device.id.clone(), declared, compensated, from };
            (!same && moved.contains(&device.id)).then(other)
        };
        let devices: Vec<_> = told.devices.iter().filter_map(differs).collect();
        (!devices.is_empty()).then_some(Self { devices })
    }
}

impl fmt::Display for LatencyDiffers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let one = |other: &OtherLatency| {
            let OtherLatency { device, declared, compensated, from } = other;
            let from = from.map_or_else(String::new, |from| format!(" (from the {from})"));
            format!("`{device}` {declared} instead of {compensated}{from}")
        };
        let line = |other: &OtherLatency| format!("{}: {}", other.device, written(other.declared));
        let shown = &self.devices[..self.devices.len().min(SHOWN_MAX)];
        let all: Vec<_> = shown.iter().map(one).collect();
        let lines: Vec<_> = shown.iter().map(line).collect();
        let more = self.devices.len() - shown.len();
        let more = if more > 0 { format!(", and {more} more devices") } else { String::new() };
        write!(
            f,
            "its declared latency differs from the compensated latency: {}{more}; to compensate for the declared latency, set \
             `latency: {{{}}}` in the fleet file",
            all.join(", "),
            lines.join(", ")
        )
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use downbeat_fleet::fleet::DeviceLatency;
    use urrcp::Latency;

    use super::*;
    use crate::bench;

    fn ms(millis: i64) -> Latency {
        Latency { median: Span::from_millis(millis), spread: Span::ZERO }
    }

    /// Returns the report about a device that declares the latency `declared`. The plan compensates for `used`, and the fleet's copy of
    /// the block declares `known`.
    fn differs(
        declared: Option<i64>,
        used: Option<(i64, LatencySource)>,
        known: Option<i64>,
    ) -> Option<String> {
        let mut choreography = downbeat_plan::Choreography::clone(&bench::played(&[&[("a", 0, 400)]]));
        let robot: RobotId = choreography.acts[0].plan.robots[0].robot.clone();
        if let Some((millis, from)) = used {
            let latency = DeviceLatency { latency: ms(millis), from, lag: None };
            let devices = BTreeMap::from([("a".parse().unwrap(), latency)]);
            choreography.acts[0].latencies.insert(robot.clone(), devices);
        }
        let block = |declared: Option<i64>| {
            let device = urrcp::Device::new("a".parse().unwrap());
            let device = match declared {
                Some(millis) => device.with_latency(ms(millis)),
                None => device,
            };
            InitializationBlock::new(robot.clone(), vec![device]).unwrap()
        };
        let told = LatencyDiffers::of(&choreography, &robot, Some(&block(known)), &block(declared));
        told.map(|told| told.to_string())
    }

    #[test]
    fn latency_difference_is_reported_with_the_setting_that_compensates_it() {
        use LatencySource::{File, Fleet, Robot};
        assert_eq!(
            differs(Some(42), None, None).unwrap(),
            "its declared latency differs from the compensated latency: `a` 42 ms instead of 0 ms; \
             to compensate for the declared latency, set `latency: {a: 42ms}` in the fleet file"
        );
        let from_file = differs(Some(42), Some((30, File)), None).unwrap();
        assert!(from_file.contains("`a` 42 ms instead of 30 ms (from the file)"), "{from_file}");
        assert!(differs(Some(42), Some((30, Robot)), Some(30)).is_some());
        for same in [
            differs(None, Some((30, Fleet)), None),
            differs(Some(42), Some((41, Fleet)), None),
            differs(Some(42), Some((42, Robot)), Some(42)),
            // The author of the fleet file knew the latency, and set another one.
            differs(Some(42), Some((30, Fleet)), Some(42)),
        ] {
            assert_eq!(same, None);
        }
    }

    #[test]
    fn few_of_many_devices_are_shown_and_the_rest_counted() {
        let device = |index: usize| OtherLatency {
            device: format!("d{index}").parse().unwrap(),
            declared: Span::from_millis(42),
            compensated: Span::ZERO,
            from: None,
        };
        let text = |count: usize| LatencyDiffers { devices: (0..count).map(device).collect() }.to_string();
        let all = text(SHOWN_MAX);
        assert!(!all.contains("more devices") && all.contains(&format!("`d{}`", SHOWN_MAX - 1)), "{all}");
        let some = text(SHOWN_MAX + 2);
        assert!(some.contains("instead of 0 ms, and 2 more devices; to compensate"), "{some}");
        assert!(!some.contains(&format!("d{SHOWN_MAX}")), "{some}");
    }
}
