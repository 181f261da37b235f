//! Finds the acts that must wait until a device has room for their scripts. Only acts that follow each other without a pause have to.

use std::collections::{BTreeMap, BTreeSet};

use super::observed::act;
use super::written::name;
use super::{Act, DEVICES, ROBOTS, Show, Target, Waits};
use crate::Code;

/// Time that sending a script takes; `PREPARING` is the time that preparing an act takes. Both are in milliseconds.
const SENDING: i64 = 100;
const PREPARING: i64 = 500;

impl Act {
    /// Returns the time of a device's last step in the act, in milliseconds. For a device that holds its values, the script ends with
    /// this step.
    fn script_ends(&self, device: usize, robot: usize, snap: bool) -> Option<i64> {
        let (_, last) = self.cues_of(device, robot).last()?;
        // A value that does not change is not set again.
        let is_set = |(index, (_, value)): &(usize, &(i64, f64))| {
            *index == 0 || last.set(last.keyframes[index - 1].1, snap) != last.set(*value, snap)
        };
        let ends = last.keyframes.iter().enumerate().rfind(is_set).map_or(0, |(_, (at, _))| *at);
        Some(last.at + ends)
    }
}

impl Show {
    fn follows_at_once(&self, act: usize) -> Option<usize> {
        self.next(act).filter(|next| self.acts[*next].waits == Waits::Done)
    }

    /// Returns the acts that may begin while no device holds any script.
    fn begins(&self) -> BTreeSet<usize> {
        let mut begins = BTreeSet::from([0]);
        begins.extend((0..self.acts.len()).filter(|act| self.acts[*act].waits != Waits::Done));
        for written in &self.acts {
            begins.extend(written.then);
            if let Some(Target::Act(act)) = written.otherwise {
                begins.insert(act);
            }
        }
        begins
    }

    pub(super) fn waiting(&self, facts: &mut BTreeSet<String>) {
        for begin in self.begins() {
            let mut held: BTreeMap<(usize, usize), i64> = BTreeMap::new();
            let (mut now, mut next) = (0, Some(begin));
            for _ in 0..4 * self.acts.len() {
                let Some(index) = next else { break };
                now = self.line_up(index, now, &mut held, facts) + self.acts[index].end();
                next = self.follows_at_once(index);
            }
        }
    }

    /// Adds an act to a series of acts without pauses, after the act before it has ended. Returns the start of the added act.
    fn line_up(
        &self,
        index: usize,
        ended: i64,
        held: &mut BTreeMap<(usize, usize), i64>,
        facts: &mut BTreeSet<String>,
    ) -> i64 {
        let written = &self.acts[index];
        let single = DEVICES.iter().enumerate().filter(|(_, kind)| kind.queue == 1);
        let all = single.flat_map(|(device, _)| (0..ROBOTS.len()).map(move |robot| (device, robot)));
        let used: Vec<_> =
            all.filter_map(|key| Some((key, written.script_ends(key.0, key.1, self.snap)?))).collect();
        let mut begin = ended;
        for free in used.iter().filter_map(|(key, _)| held.get(key)) {
            begin = begin.max(free + SENDING);
            if ended - free < PREPARING {
                facts.insert(act(Code::ActHasToWait, &name(index)));
            }
        }
        held.extend(used.into_iter().map(|(key, ends)| (key, begin + ends)));
        begin
    }
}
