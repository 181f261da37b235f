//! What is wrong with many devices for one reason, told once.

use std::collections::HashMap;

use crate::fields::Reader;
use crate::finding::{Code, Place, names};

/// What makes findings one: the code and the cues, or the place.
type Key = (Code, String);

/// Findings about one device each.
#[derive(Default)]
pub(super) struct Together {
    all: Vec<Group>,
    index_of: HashMap<Key, usize>,
}

struct Group {
    worst: Told,
    /// Devices of each of them.
    devices: Vec<String>,
}

/// A finding about one device.
pub(super) struct Told {
    pub(super) code: Code,
    /// What it has in common with others.
    pub(super) cause: String,
    /// How large the fault is; only the largest of several is reported.
    pub(super) size: f64,
    /// The device and its robot.
    pub(super) who: String,
    pub(super) place: Place,
    pub(super) message: String,
    pub(super) expected: String,
    pub(super) hint: Option<String>,
}

impl Together {
    pub(super) fn add(&mut self, told: Told) {
        let key = (told.code, told.cause.clone());
        match self.index_of.get(&key) {
            Some(known) => {
                let group = &mut self.all[*known];
                if !group.devices.contains(&told.who) {
                    group.devices.push(told.who.clone());
                }
                if told.size > group.worst.size {
                    group.worst = told;
                }
            }
            None => {
                self.index_of.insert(key, self.all.len());
                self.all.push(Group { devices: vec![told.who.clone()], worst: told });
            }
        }
    }

    pub(super) fn tell(self, findings: &mut Reader) {
        for Group { worst, devices } in self.all {
            let others: Vec<&str> =
                devices.iter().filter(|who| **who != worst.who).map(String::as_str).collect();
            let message = match others.is_empty() {
                true => worst.message,
                false => format!("{}; the same for {}", worst.message, names(others.iter().copied())),
            };
            findings.add(worst.code, worst.place, message, worst.expected, worst.hint);
        }
    }
}
