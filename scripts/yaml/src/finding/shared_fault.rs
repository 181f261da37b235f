//! Joins faults with the same cause, which several robots have, into one finding.

use std::borrow::Cow;
use std::collections::HashSet;
use std::sync::Arc;

use urrcp::RobotId;

use super::{Code, Place, robots_named};

/// A fault of some robots, or of one device on these robots. Faults with the same code and cause are joined into one finding, which
/// describes the largest fault.
pub struct SharedFault {
    /// The code of the finding.
    pub code: Code,
    /// The cause of the fault. Faults with the same code and cause are joined into one finding.
    pub cause: String,
    /// How large the fault is. The finding describes the fault with the largest size.
    pub size: f64,
    /// The name of the device with the fault; empty if the robots themselves have it.
    pub device: String,
    /// The robots that have the fault.
    pub robots: Arc<[RobotId]>,
    /// The place that the user must edit.
    pub place: Place,
    /// The parts of the message before and after the names of the robots. The second part may begin with a verb in singular and plural: `
    /// moves|move at 2 m/s`.
    pub message: [String; 2],
    /// The expected value or form.
    pub expected: String,
    /// How to fix the fault; `None` if there is no hint.
    pub hint: Option<String>,
}

/// The robots and devices that a finding for joined faults concerns, and its message.
#[derive(Clone, Debug, PartialEq)]
pub struct Affected {
    size: f64,
    /// The device with the largest fault; empty if the robots themselves have it.
    device: String,
    message: [String; 2],
    /// The devices with faults, in the order in which they were added, each with the robots of each of its faults.
    devices: Vec<(String, Vec<Arc<[RobotId]>>)>,
}

impl Affected {
    /// Creates the value for the first fault.
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

    /// Adds the robots of another fault. Returns whether that fault is the largest so far.
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
        // Successive faults of one track share their robots.
        if robots.last().is_none_or(|last| !Arc::ptr_eq(last, &fault.robots)) {
            robots.push(fault.robots.clone());
        }
    }

    /// Returns the message, which names all robots and devices.
    pub fn message(&self) -> String {
        let own = self.devices.iter().find(|(device, _)| *device == self.device);
        let [before, after] = &self.message;
        let own = own.map_or(&[][..], |(_, all)| all);
        let mut message = format!("{before}{}{}", named(own), agreeing(after, distinct(own).len()));
        let others = self.devices.iter().filter(|(device, _)| *device != self.device);
        let others: Vec<_> = others.map(|(device, all)| format!("`{device}` of {}", named(all))).collect();
        if !others.is_empty() {
            message += &format!("; the same applies to {}", others.join(", "));
        }
        message
    }
}

/// Returns the ids of all robots in `faults`, each once, in order of first appearance.
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

/// Keeps the singular or the plural of a verb such as ` moves|move` at the beginning of a text, depending on the number of robots.
fn agreeing(text: &str, robots: usize) -> Cow<'_, str> {
    let verbs = text.strip_prefix(' ').and_then(|text| text.split_once(' '));
    let Some((verbs, rest)) = verbs else { return text.into() };
    let Some((one, several)) = verbs.split_once('|') else { return text.into() };
    format!(" {} {rest}", if robots == 1 { one } else { several }).into()
}
