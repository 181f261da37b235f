//! Invariants of an act between two events, as stated in `docs/mission.md`.

use std::collections::BTreeSet;

use super::member::{Chain, Part};
use super::{Act, Member, Promised, PromisedStage, Stage, Timing};
use crate::RobotIndex;
use crate::robot_state::{RobotState, Robots};
use crate::script::Script;

impl Act {
    /// Panics if an invariant of the act does not hold.
    pub(crate) fn check(&self, robots: &Robots) {
        self.check_members(robots);
        self.check_stage();
        if let Some(timing) = self.timing() {
            timing.check();
        }
    }

    fn check_members(&self, robots: &Robots) {
        let name = self.name();
        assert!(self.index.get() < self.choreography.acts.len(), "{name}: the choreography contains the act");
        assert!(self.place.len() <= robots.len(), "{name}: every place belongs to a robot of the mission");
        let robots_of: BTreeSet<RobotIndex> = self.members.iter().map(|member| member.robot).collect();
        assert_eq!(robots_of.len(), self.members.len(), "{name}: each robot has at most one part in an act");
        for (place, member) in self.members.enumerated() {
            assert_eq!(
                self.place_of_member(member.robot),
                Some(place),
                "{name}: robots are found by their places"
            );
            member.check(&robots[member.robot]);
        }
        assert!(
            self.readings_asked <= self.written().readings.len(),
            "{name}: an act requests at most the planned readings"
        );
        assert!(
            self.readings.len() <= self.readings_asked,
            "{name}: only readings that were requested are reported"
        );
    }

    fn check_stage(&self) {
        let name = self.name();
        let scripts = || self.members.iter().flat_map(Member::scripts);
        match &self.stage {
            Stage::Waiting(_) | Stage::Ready { .. } => {
                let untouched = |script: &Script| script.is_planned() && !script.was_ever_sent();
                assert!(scripts().all(untouched), "{name}: before the promise, nothing is sent");
            }
            Stage::Promised(Promised { stage: PromisedStage::Recording, .. }) => {
                let unsent = |script: &Script| script.is_planned() && !script.was_ever_sent();
                assert!(scripts().all(unsent), "{name}: nothing is sent before the promise is on the disk");
            }
            Stage::Deserted | Stage::Promised(Promised { stage: PromisedStage::Deserted, .. }) => {
                assert!(
                    self.members.iter().all(|member| !member.takes_part()),
                    "{name}: no robot is left to play the act"
                );
            }
            Stage::Promised(Promised { stage: PromisedStage::Over, .. }) => {
                let over = self.present().all(Member::is_over);
                assert!(over, "{name}: an act is over once nothing of it can still run");
            }
            Stage::Promised(_) => {}
        }
    }
}

impl Member {
    fn check(&self, robot: &RobotState) {
        let id = &robot.id;
        for script in self.scripts() {
            script.check(id);
        }
        let mut devices = BTreeSet::new();
        for chain in &self.chains {
            let Chain { first, completed, unsent, end } = *chain;
            assert!(
                first <= completed && completed <= unsent && unsent <= end,
                "{id}: the scripts of a chain are played in order: {chain:?}"
            );
            let scripts = &self.scripts()[first..end];
            let device = &scripts[0].plan.device;
            assert!(devices.insert(device), "{id}: the scripts of `{device}` form one chain");
            assert!(
                scripts.iter().all(|script| script.plan.device == *device),
                "{id}: all scripts of a chain belong to one device"
            );
            let before = &self.scripts()[first..completed];
            assert!(
                before.iter().all(Script::has_completed),
                "{id}: `{device}` has completed the scripts before `completed`"
            );
            let after = &self.scripts()[unsent..end];
            assert!(
                after.iter().all(|script| script.first_sent_at().is_none()),
                "{id}: `{device}` was sent no script from `unsent` on"
            );
            for (one, next) in scripts.iter().zip(scripts.iter().skip(1)) {
                let ends = one.plan.start.span() + one.duration();
                assert!(ends <= next.plan.start.span(), "{id}: scripts of `{device}` do not overlap");
            }
        }
        if self.part == Part::Taking && self.asked_since.is_some() {
            assert!(self.asked.is_some(), "{id}: the first question for a report has an instant");
        }
        assert!(
            self.asked_since <= self.asked || self.asked.is_none(),
            "{id}: the first question for a report precedes the last"
        );
    }
}

impl Timing {
    fn check(&self) {
        assert!(self.timestamp <= self.decision, "requests are sent before the decision");
        assert!(self.decision <= self.start, "an act is decided before it starts");
        assert!(self.start <= self.end, "an act starts before it ends");
        assert!(self.critical() <= self.brink(), "the critical instant is not after the brink");
        assert!(self.brink() <= self.earliest_start(), "leases end before any robot starts");
        assert!(self.earliest_start() <= self.start, "no robot is planned to start later than the plan");
        assert!(self.begins() <= self.begun(), "the first robot starts no later than the last");
        assert!(self.no_return() <= self.start, "after the start only stopping is possible");
        assert!(self.no_return() <= self.last_withdrawal(), "a failure is known before the last withdrawal");
        assert!(self.last_withdrawal() < self.start, "a withdrawal precedes the start");
        assert!(self.lead.lease > urrcp::Span::ZERO, "scripts wait under a lease");
        assert!(self.ask_again() <= self.decision, "requests are sent again before the decision");
        assert!(self.doubt() >= urrcp::Span::ZERO, "the doubt is an interval");
        if let Some((sent, answered)) = self.round {
            assert!(sent <= answered, "the commitment is answered after it was sent");
        }
    }
}
