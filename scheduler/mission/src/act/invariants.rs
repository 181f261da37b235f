//! Invariants of an act between two events, as stated in `docs/mission.md`.

use std::collections::BTreeSet;

use urrcp::Span;

use super::member::{Chain, Part};
use super::{Act, Member, Promised, PromisedStage, Stage};
use crate::RobotIndex;
use crate::again::AGAIN_MAX;
use crate::invariants::holds;
use crate::robot_state::{RobotState, Robots};
use crate::script::Script;

/// The shortest pending lease that the mission chooses itself.
const LEASE_MIN: Span = Span::from_millis(240);

impl Act {
    /// Panics if an invariant of the act does not hold.
    pub(crate) fn check(&self, robots: &Robots) {
        self.check_members(robots);
        self.check_stage();
        if let Some(timing) = self.timing() {
            timing.check(&self.name());
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
        let prescribed = self.written().plan.stop_condition.pending;
        let lease = self.timing().filter(|_| prescribed.is_none()).map(|timing| timing.lead.lease);
        holds!(
            lease.is_none_or(|lease| lease >= LEASE_MIN),
            name,
            "6 round trips, at least 240 ms, + twice the lateness"
        );
        holds!(self.attempts <= AGAIN_MAX, name, "the mission prepares the act again, at most twice");
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
                holds!(
                    scripts().all(untouched),
                    name,
                    "Before the first request is sent, the journal on disk states what is promised to which robot."
                );
            }
            Stage::Promised(Promised { stage: PromisedStage::Recording, .. }) => {
                let unsent = |script: &Script| script.is_planned() && !script.was_ever_sent();
                holds!(
                    scripts().all(unsent),
                    name,
                    "Before the first request is sent, the journal on disk states what is promised to which robot."
                );
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
            Stage::Promised(Promised { stage: PromisedStage::Preparing(_), .. }) => self.check_order(),
            Stage::Promised(Promised { stage: PromisedStage::Approaching(approach), .. }) => {
                self.check_order();
                assert!(approach.rounds.is_sorted(), "{name}: rounds follow each other");
                if approach.taken_up.is_none() {
                    self.check_acceptances();
                }
            }
            Stage::Promised(Promised { stage: PromisedStage::Committed(_), .. }) => self.check_acceptances(),
            Stage::Promised(Promised {
                stage: PromisedStage::Playing(_) | PromisedStage::Lapsing(_),
                ..
            }) => {}
        }
    }
}

impl Act {
    /// Checks that no later script of a device was sent before the device accepted its first one.
    fn check_order(&self) {
        for member in self.present() {
            let may_follow = |(index, script): (usize, &Script)| {
                !script.is_out() || !script.is_of_this_process() || member.may_follow(index)
            };
            holds!(
                member.scripts().iter().enumerate().all(may_follow),
                self.name(),
                "The second and later scripts of a device are sent once the first is accepted."
            );
        }
    }

    fn check_acceptances(&self) {
        holds!(
            self.present().flat_map(Member::firsts).all(Script::was_accepted),
            self.name(),
            "The act is decided as soon as every robot has accepted every script for which its devices have room"
        );
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
            holds!(
                after.iter().all(|script| script.first_sent_at().is_none()),
                format_args!("{id}/{device}"),
                "nothing overtakes a script that waits"
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
