//! Checks invariant (d): no position, speed or acceleration outside the limits of a device is set.

use urrcp::ControlType;

use super::Verdict;
use super::facts::Facts;

pub(super) fn check(facts: &Facts<'_>, verdict: &mut Verdict) {
    for (robot, log) in facts.ran.logs.iter().enumerate() {
        let block = &facts.drawn().robots[robot].block;
        for entry in log {
            let device = block.device(entry.device.as_str());
            let limits = device.zip(entry.control_type.parse::<ControlType>().ok());
            let limits = limits.and_then(|(device, of)| device.available_control_types.limits(of));
            if limits.is_none_or(|l| !(entry.value >= l.min_value && entry.value <= l.max_value)) {
                verdict.violated(
                    'd',
                    format!("r{robot} set {} {} on `{}`", entry.control_type, entry.value, entry.device),
                );
            }
        }
    }
}
