//! One cause, one finding: the robots that have a fault for the same reason.

use std::borrow::Cow;
use std::collections::HashSet;
use std::sync::Arc;

use urrcp::RobotId;

use super::{Code, Place, robots_named};

/// A fault of some robots, or of a device of theirs. Faults of one code and one cause are one finding, which describes the largest of
/// them.
pub struct SharedFault {
    /// The kind of the finding.
    pub code: Code,
    /// What the fault has in common with others of the same finding.
    pub cause: String,
    /// How large the fault is.
    pub size: f64,
    /// Empty for a fault of the robots themselves.
    pub device: String,
    /// The robots that have the fault.
    pub robots: Arc<[RobotId]>,
    /// Where the user must act.
    pub place: Place,
    /// The message before the names of the robots, and after them, which may begin with the verb for one robot and for several:
    /// ` moves|move at 2 m/s`.
    pub message: [String; 2],
    /// What was expected.
    pub expected: String,
    /// How to fix it.
    pub hint: Option<String>,
}

/// What a finding says of the robots that it concerns.
#[derive(Clone, Debug, PartialEq)]
pub struct Affected {
    size: f64,
    /// Of the largest fault.
    device: String,
    message: [String; 2],
    /// Devices in the order of the faults, each with the robots of every fault.
    devices: Vec<(String, Vec<Arc<[RobotId]>>)>,
}

impl Affected {
    /// The robots of a first fault.
    pub fn by(fault: &SharedFault) -> Self {
        let mut affected = Self {
            size: fault.size,
            device: fault.device.clone(),
            message: fault.message.clone(),
            devices: Vec::new(),
        };
        affected.extend(fault);
        affected
    }

    /// Takes the robots of one more fault. Returns whether that is the largest so far.
    pub fn add(&mut self, fault: &SharedFault) -> bool {
        let is_largest = fault.size > self.size;
        if is_largest {
            (self.size, self.device) = (fault.size, fault.device.clone());
            self.message.clone_from(&fault.message);
        }
        self.extend(fault);
        is_largest
    }

    fn extend(&mut self, fault: &SharedFault) {
        let index = self.devices.iter().position(|(device, _)| *device == fault.device);
        let index = index.unwrap_or_else(|| {
            self.devices.push((fault.device.clone(), Vec::new()));
            self.devices.len() - 1
        });
        let robots = &mut self.devices[index].1;
        // Faults of one track follow each other.
        if robots.last().is_none_or(|last| !Arc::ptr_eq(last, &fault.robots)) {
            robots.push(fault.robots.clone());
        }
    }

    /// The message with all robots and devices.
    pub fn message(&self) -> String {
        let own = self.devices.iter().find(|(device, _)| *device == self.device);
        let [before, after] = &self.message;
        let own = own.map_or(&[][..], |(_, all)| all);
        let mut message = format!("{before}{}{}", named(own), agreeing(after, distinct(own).len()));
        let others = self.devices.iter().filter(|(device, _)| *device != self.device);
        let others: Vec<_> = others.map(|(device, all)| format!("`{device}` of {}", named(all))).collect();
        if !others.is_empty() {
            message += &format!("; the same for {}", others.join(", "));
        }
        message
    }
}

/// Each robot once.
fn distinct(faults: &[Arc<[RobotId]>]) -> Vec<&str> {
    let mut seen = HashSet::new();
    let robots = faults.iter().flat_map(|robots| robots.iter()).map(RobotId::as_str);
    robots.filter(|id| seen.insert(*id)).collect()
}

fn named(faults: &[Arc<[RobotId]>]) -> String {
    match distinct(faults).as_slice() {
        [] => String::new(),
        robots => robots_named(robots.iter().copied()),
    }
}

/// The verb of a text that begins with ` moves|move`, for this many robots.
fn agreeing(text: &str, robots: usize) -> Cow<'_, str> {
    let verbs = text.strip_prefix(' ').and_then(|text| text.split_once(' '));
    let Some((verbs, rest)) = verbs else { return text.into() };
    let Some((one, several)) = verbs.split_once('|') else { return text.into() };
    format!(" {} {rest}", if robots == 1 { one } else { several }).into()
}
