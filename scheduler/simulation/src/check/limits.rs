//! (d) No value outside the limits of a device is set.

use urrcp::ControlType;

use super::Verdict;
use super::facts::Facts;

pub(super) fn check(facts: &Facts<'_>, verdict: &mut Verdict) {
    for (robot, log) in facts.ran.logs.iter().enumerate() {
        let block = &facts.drawn().robots[robot].block;
        for entry in log.iter().filter(|entry| entry.control_type == "position") {
            let device = block.device(entry.device.as_str());
            let limits =
                device.and_then(|device| device.available_control_types.limits(ControlType::Position));
            if limits.is_none_or(|l| !(entry.value >= l.min_value && entry.value <= l.max_value)) {
                verdict.violated('d', format!("r{robot} set {} on `{}`", entry.value, entry.device));
            }
        }
    }
}
